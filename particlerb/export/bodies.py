"""Single bodies as other programs read them: inertial data in full, and the particles.

Every format states mass, centre of mass and tensor as given here, so that the other code need not
find them again from spheres that overlap. `carriers` are the particles that go along: the spheres
with which a body touches, or its masses where it has none. One function per format; each returns
the files to write, by suffix. They know of no command line.

Sources: docs.lammps.org for `molecule` and `fix rigid`, mujoco.readthedocs.io for MJCF,
ymport.textClumps of YADE, gsd.readthedocs.io for the shapes in gsd files.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from particlerb.case.matter import Matter
from particlerb.export import ExportError, gsd_hoomd, sphere_union
from particlerb.geometry.mass_properties import MassProperties
from particlerb.geometry.particles import Particles, one_kind
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import quaternions
from particlerb.record.output_path import appearing
from particlerb.rotors.rotor_class import NAMES, POINT, ROD

COMMENT: Final = "made by particlerb; SI units"
SMALLEST: Final = 1e-6  # diameter of a point in LAMMPS, of the size of its body


class NamedBody(NamedTuple):
    """One kind of body, as a case, a table or a mesh gives it."""

    name: str
    particles: Particles
    """In the axes in which it was given."""
    properties: MassProperties
    """Arrays of length one, in the same axes."""
    matter: Matter = Matter()
    """What is known beside the sums."""
    spin: float = 0.0
    """[rad/s], the fastest of the bodies of this kind."""


def carriers(particles: Particles, total: float) -> Particles:
    """Spheres of a body of a mass [kg], or its masses where it has no radius; all have mass.

    Spheres without mass, whose matter is elsewhere, share the body's by their volume: other codes
    want a mass of every particle, and do not use it once they are told that of the body.
    """
    position, mass, radius, _ = particles
    chosen = radius > 0.0 if radius.any() else mass > 0.0
    position, mass, radius = position[chosen], mass[chosen], radius[chosen]
    if not (mass > 0.0).all() or (radius.any() and not np.isclose(mass.sum(), total, rtol=1e-12)):
        weight = radius**3
        mass = total * weight / weight.sum()
    return one_kind(position, mass, radius)


def _carriers_of(body: NamedBody) -> Particles:
    """The same of an exported body."""
    return carriers(body.particles, float(body.properties.mass[0]))


def _in_principal_axes(body: NamedBody, position: Floats) -> Floats:
    """Positions (n, 3) [m] from the com, in the principal axes."""
    return np.asarray((position - body.properties.com[0]) @ body.properties.axes[0])


def export_bodies(bodies: Sequence[NamedBody], path: Path, to: str) -> list[Path]:
    """Write bodies for another program.

    Parameters
    ----------
    bodies : sequence of NamedBody
    path : Path
        File to write; a second one beside it differs in its suffix.
    to : str
        One of `BODY_FORMATS`.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    ExportError
        If the format cannot hold such a body, or a library is missing.
    OSError
        If a file cannot be written.
    """
    if to == "gsd":
        with appearing(path) as (unfinished,):
            _write_gsd(bodies, unfinished)
        return [path]
    texts = {"lammps": lammps, "mjcf": mjcf, "yade": yade}[to](bodies)
    return write_texts(path, texts)


def write_texts(path: Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts: the first at the path, the others beside it by their suffixes; the files."""
    written = [path, *(path.with_suffix(suffix) for suffix in list(texts)[1:])]
    with appearing(*written) as unfinished:
        for file, text in zip(unfinished, texts.values(), strict=True):
            file.write_text(text, encoding="utf-8", errors="surrogateescape")  # names of files
    return written


def numbers(*values: Any) -> str:
    """Numbers with the digits that give back the same float64, between blanks."""
    flat = np.concatenate([np.atleast_1d(np.asarray(value, dtype=float)) for value in values])
    return " ".join(repr(float(value)) for value in flat.reshape(-1))


def possible(moments: Floats) -> Floats:
    """Principal moments (3,), the largest at most the sum of the others, as MuJoCo demands.

    Rounding may have put that of a plate above it.
    """
    lowered = moments.ravel().copy()
    k = int(np.argmax(lowered))
    lowered[k] = min(lowered[k], lowered[k - 1] + lowered[k - 2])
    return lowered


def six(tensor: Floats) -> Floats:
    """xx yy zz xy xz yz of a tensor (3, 3)."""
    return tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _refuse_degenerate(body: NamedBody, to: str, *classes: int) -> None:
    """ExportError for a body without extent in a code that does not have such."""
    code = int(body.properties.rotor_class[0])
    if code in classes:
        raise ExportError(f"{body.name} is a {NAMES[code]}: {to} needs three positive moments")


def lammps(bodies: Sequence[NamedBody]) -> dict[str, str]:
    """A molecule file, and the infile of `fix rigid` for one such molecule where the file has it.

    In principal axes with the com at the origin, because the products of inertia in the header of a
    molecule are taken in another order (yz xz xy, LAMMPS of July 2025) than its manual says. Bodies
    that `fix deposit` or `fix pour` add to fix rigid/small have what the header says; those that
    are there from the start need the infile, which holds for a body that stands as in the file.
    """
    if len(bodies) != 1:
        names = ", ".join(body.name for body in bodies)
        raise ExportError(f"lammps files hold one body: name one of {names}")
    body = bodies[0]
    _refuse_degenerate(body, "fix rigid", POINT)
    mass, com, _, moments, axes, _ = (array[0] for array in body.properties)
    carrying = _carriers_of(body)
    place = _in_principal_axes(body, carrying.position)
    reach = np.linalg.norm(place, axis=1).max()
    diameter = np.where(carrying.radius > 0.0, 2.0 * carrying.radius, SMALLEST * reach)
    columns = {
        "Coords": map(numbers, place),
        "Types": ["1"] * len(place),
        "Diameters": map(numbers, diameter),
        "Masses": map(numbers, carrying.mass),
    }
    sections = [
        "\n".join([name, "", *(f"{k} {text}" for k, text in enumerate(column, 1))])
        for name, column in columns.items()
    ]
    facts = [
        f"# {body.name}, {COMMENT}; from the com, principal axes",
        f"# com {numbers(com)} (as given)",
        f"# axes {numbers(axes.T)} (rows are the principal axes as given)",
    ]
    header = [
        f"{len(carrying.mass)} atoms",
        f"{numbers(mass)} mass",
        f"{numbers(np.zeros(3))} com",
        f"{numbers(moments, np.zeros(3))} inertia",
    ]
    infile = [
        *facts,
        "# id, mass, com, inertia xx yy zz xy xz yz, velocity, angular momentum, image flags",
        "1",
        f"1 {numbers(mass, np.zeros(3), moments, np.zeros(9))} 0 0 0",
    ]
    molecule = ["\n".join(facts), "\n".join(header), *sections]
    return {".mol": "\n\n".join(molecule) + "\n", ".rigid": "\n".join(infile) + "\n"}


def mjcf(bodies: Sequence[NamedBody]) -> dict[str, str]:
    """An MJCF model: a free body each, its spheres as geoms without mass, points as sites."""
    root = ET.Element("mujoco", model=bodies[0].name)
    root.append(ET.Comment(f" {COMMENT} "))
    world = ET.SubElement(root, "worldbody")
    for body in bodies:
        _refuse_degenerate(body, "MuJoCo", POINT, ROD)
        mass, com, _, moments, axes, _ = body.properties
        element = ET.SubElement(world, "body", name=body.name)
        ET.SubElement(element, "freejoint")
        inertial = {"pos": numbers(com), "mass": numbers(mass), "quat": numbers(quaternions(axes))}
        ET.SubElement(element, "inertial", inertial, diaginertia=numbers(possible(moments)))
        carrying = _carriers_of(body)
        add_spheres(element, carrying.position, carrying.radius, {})
    ET.indent(root)
    return {".xml": ET.tostring(root, encoding="unicode") + "\n"}


def add_spheres(
    element: ET.Element, position: Floats, radius: Floats, touching: Mapping[str, str]
) -> None:
    """Add spheres (n, 3), (n,) [m] as geoms without mass, points as sites."""
    for x, r in zip(position, radius, strict=True):
        place = {"type": "sphere", "pos": numbers(x)}
        if r > 0.0:
            ET.SubElement(element, "geom", {**place, **touching}, size=numbers(r), mass="0")
        else:
            ET.SubElement(element, "site", place)


def yade(bodies: Sequence[NamedBody]) -> dict[str, str]:
    """Clumps for ymport.textClumps: x y z r id, in principal axes with the com at the origin.

    Mass and moments stand in comments, with the lines that set them.
    """
    what = "x y z r clump, for yade.ymport.textClumps: from the com, principal axes"
    lines = [f"# {COMMENT}; {what}"]
    for k, body in enumerate(bodies):
        mass, com, _, moments, axes, _ = (array[0] for array in body.properties)
        carrying = _carriers_of(body)
        if not carrying.radius.any():
            raise ExportError(f"{body.name} has no particle with a radius: YADE holds spheres")
        lines += [
            f"# clump {k} {body.name}",
            f"# mass {numbers(mass)}",
            f"# inertia {numbers(moments)}",
            f"# axes {numbers(axes.T)}  (rows are the principal axes as given)",
            f"# com {numbers(com)}  (as given)",
            "# set both after loading: O.bodies[id].state.mass = mass, .state.inertia = inertia",
        ]
        local = _in_principal_axes(body, carrying.position)
        lines += [f"{numbers(p, r)} {k}" for p, r in zip(local, carrying.radius, strict=True)]
    return {".txt": "\n".join(lines) + "\n"}


def _write_gsd(bodies: Sequence[NamedBody], path: Path) -> None:
    """One frame with one particle per body, turned to its principal axes; float64 in the log."""
    hoomd = gsd_hoomd(path)
    frame = hoomd.Frame()
    particles = frame.particles
    columns = zip(*(body.properties for body in bodies), strict=True)
    mass, com, tensor, moments, axes, _ = map(np.concatenate, columns)
    particles.N, particles.typeid = len(bodies), np.arange(len(bodies))
    particles.types = [body.name.encode() for body in bodies]
    particles.type_shapes = [_shape_of(body) for body in bodies]
    particles.mass, particles.moment_inertia = mass, moments
    particles.position, particles.orientation = com, quaternions(axes)
    reach = max(float(np.abs(body.particles.position).max()) for body in bodies)
    edge = 2.02 * (reach + max(float(body.particles.radius.max()) for body in bodies)) or 1.0
    frame.configuration.box = [edge, edge, edge, 0, 0, 0]
    frame.log = {"mass": mass, "com": com, "inertia_tensor": tensor.reshape(-1, 9)}
    with hoomd.open(path, "w") as file:
        file.append(frame)


def _shape_of(body: NamedBody) -> dict[str, Any]:
    """Shape of a body for OVITO; none where it has no radius."""
    carrying = _carriers_of(body)
    if not carrying.radius.any():
        return {}
    return sphere_union(_in_principal_axes(body, carrying.position), carrying.radius)


BODY_FORMATS: Final = {"lammps": ".mol", "mjcf": ".xml", "yade": ".txt", "gsd": ".gsd"}
"""Suffixes of files, by the names of formats."""


def file_name(name: str) -> str:
    """Name of a body as that of a file."""
    return re.sub(r"[^\w.-]+", "_", name)
