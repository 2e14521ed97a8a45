"""Command `mass`, and bodies by name from whatever describes them: a case, a table or a mesh."""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Final

import h5py
import numpy as np

from particlerb.case.matter import Matter, matter_of, matter_of_mesh, matter_of_spheres
from particlerb.case.problems import CaseError, nearest
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.cli.common import find_case, read_case
from particlerb.cli.exit_codes import DONE, Ending, ending
from particlerb.export.bodies import NamedBody
from particlerb.geometry.fill import mesh_particles
from particlerb.geometry.mass_properties import mass_properties, of_kind
from particlerb.geometry.mesh import MESH_SUFFIXES, read_mesh
from particlerb.geometry.overlapping_spheres import spheres
from particlerb.geometry.particle_files import POINTS, columns_of, read_points, read_spheres
from particlerb.geometry.particles import Particles, kind_of, scaled_to_mass
from particlerb.model.state import omega_world
from particlerb.studies.mass_report import record_of, text_of

_TABLE_SUFFIXES: Final = (".csv", ".txt", ".dat", ".xyzr", ".xyz")
_DEFAULT_DENSITY: Final = 1.0  # [kg/m³] where neither the file nor an option says one


def is_case(name: str) -> bool:
    """Whether a file is no table and no mesh of a single body."""
    return find_case(name).suffix.lower() not in _READERS


def holds_bodies(name: str) -> bool:
    """Whether a file is a case, a table or a mesh, rather than a trajectory."""
    return Path(name).suffix.lower() in (".toml", "", *_READERS) and not h5py.is_hdf5(name)


def named_bodies(options: argparse.Namespace, wanted: str | None) -> list[NamedBody]:
    """Kinds of bodies of a command line: of its file, or the wanted one.

    Raises
    ------
    Ending
        If the file or the body is wrong, or options do not go with it.
    """
    if not is_case(options.file):
        return [_body_of_file(find_case(options.file), wanted, options)]
    for option in ("mass", "density", "scale", "spin"):
        if getattr(options, option, None) is not None:
            raise Ending(f"--{option}: a case says it itself; change it with --set")
    return _bodies_of_case(case_of(options), wanted)


def case_of(options: argparse.Namespace) -> Case:
    """The case of a command line."""
    options.case = options.file
    return read_case(options)


def _bodies_of_case(case: Case, wanted: str | None) -> list[NamedBody]:
    """One body of each name and kind of a case."""
    with ending(CaseError):
        system = to_system(case, keeps_all=True)
    try:
        bodies = np.arange(system.n_bodies) if wanted is None else system.names.find(wanted)
    except KeyError:
        hint = nearest(str(wanted), [body.name for body in case.body])
        raise Ending(f"{wanted}: no such body; {hint}") from None
    speed = np.linalg.norm(omega_world(system.bodies, system.state), axis=0)
    named = []
    alike = np.stack([system.block[bodies], system.kind[bodies]])
    _, first, group = np.unique(alike, axis=1, return_index=True, return_inverse=True)
    for i in np.sort(first):
        b, k = bodies[i], system.kind[bodies[i]]
        local = kind_of(system.particles, k)
        particles = local._replace(position=local.position + system.properties.com[k])
        spin = float(speed[bodies][group.ravel() == group.flat[i]].max())
        body = system.body[system.block[b]]
        notes = [line for name, line in system.notes if name.partition(", part ")[0] == body.name]
        matter = matter_of(system.files, body)._replace(notes=tuple(notes))
        properties = of_kind(system.properties, k)
        named.append(NamedBody(system.names[b], particles, properties, matter, spin))
    return named


def _body_of_file(path: Path, wanted: str | None, options: argparse.Namespace) -> NamedBody:
    """The one body of a file."""
    if wanted is not None:
        raise Ending(f"{wanted}: {path} is one body; only a case has names")
    if options.overrides:
        raise Ending("--set: only a case has keys")
    try:
        particles, matter = _READERS[path.suffix.lower()](path, options)
        spin = getattr(options, "spin", None) or 0.0
        return NamedBody(path.stem, particles, mass_properties(particles), matter, spin)
    except OSError as error:
        raise Ending(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        message = str(error)
        raise Ending(message if str(path) in message else f"{path}: {message}") from None


def _table_body(path: Path, options: argparse.Namespace) -> tuple[Particles, Matter]:
    """Points or spheres of a table."""
    scale = options.scale or 1.0
    if columns_of(path) is POINTS:
        if options.density is not None:
            raise Ending("--density: points bring their masses; --mass rescales them")
        points = read_points(path)
        points = points._replace(position=points.position * scale, radius=points.radius * scale)
        return points if options.mass is None else scaled_to_mass(points, options.mass), Matter()
    centre, radius = (array * scale for array in read_spheres(path))
    return spheres(centre, radius, *_amount(options)), matter_of_spheres(centre, radius)


def _amount(options: argparse.Namespace) -> tuple[float | None, float | None]:
    """Mass and density of uniform matter, one of them given."""
    if options.mass is None and options.density is None:
        return None, _DEFAULT_DENSITY
    return options.mass, options.density


def mesh_body(path: Path, options: argparse.Namespace) -> tuple[Particles, Matter]:
    """A closed mesh, as six points with its exact mass properties."""
    mesh = read_mesh(path, options.scale or 1.0)
    return mesh_particles(mesh, *_amount(options)).particles, matter_of_mesh(mesh)


_READERS: Final[dict[str, Callable[[Path, argparse.Namespace], tuple[Particles, Matter]]]] = {
    **dict.fromkeys(_TABLE_SUFFIXES, _table_body),
    **dict.fromkeys(MESH_SUFFIXES, mesh_body),
}


def mass_command(options: argparse.Namespace) -> int:
    """`mass`: mass properties of the bodies of a case, of a table of points or spheres."""
    records = []
    for body in named_bodies(options, options.body):
        with ending(ValueError, about=options.file):
            records.append(record_of(body))
    if options.json:
        print(json.dumps(records))
    else:
        print("\n\n".join(map(text_of, records)))
    return DONE
