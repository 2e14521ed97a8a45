"""From a case to a `System`: particles of every kind, constants, and the initial state.

What lies behind this module knows of no case. Bodies of the same shape, parts and mass are copies
of one kind, whatever block they are of, so their particles are stored and summed once; only random
clouds are a kind each. Spin that a body cannot have (of a point, about a rod's axis) is an error
where the case gives it, and left out where it was drawn at random.
"""

from functools import partial
from typing import Any

import numpy as np

from particlerb.case.bodies import Body, NormalDistribution, ShapePart
from particlerb.case.matter import solid_of, spheres_of
from particlerb.case.output import FIELDS_OF_LAWS
from particlerb.case.placement import Placement, placement_of, quaternion_of, random_stream
from particlerb.case.problems import Problem, problem_at, refuse
from particlerb.case.reader import CaseSource, load
from particlerb.case.reduction import reduced
from particlerb.case.schema import Case
from particlerb.case.shapes import AnyShape, Cloud, MeshShape, PointsShape, SpheresShape
from particlerb.files import Files
from particlerb.geometry import shapes
from particlerb.geometry.fill import FilledShape, coarsest_within, mesh_particles
from particlerb.geometry.mass_properties import MassProperties, mass_properties
from particlerb.geometry.mesh import read_mesh
from particlerb.geometry.overlapping_spheres import spheres
from particlerb.geometry.particle_files import read_points
from particlerb.geometry.particles import (
    Particles,
    concatenate,
    one_kind,
    scaled_to_mass,
    transformed,
    united,
)
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, bodies_of_kind
from particlerb.model.state import initial_state, kinetic_energy, rotate, rotation_matrix
from particlerb.model.system import System
from particlerb.rotors.rotor_class import POINT, ROD

_MIN_INERTIA = 1e-307  # [kg] of a mass, [kg m²] of a moment of inertia
_OUT_OF_RANGE = "its volume or moment of inertia is out of the range of float64"
_OUT_OF_MEMORY = "its particles do not fit into the memory: take a smaller n"
_SPIN_ROUNDING = 1e-12  # share of an angular velocity about a rod that is its rounding


def to_system(source: CaseSource, keeps_all: bool = False, part: range | None = None) -> System:
    """System of a case, or of a part of its bodies.

    Parameters
    ----------
    source : str, path, Mapping or Case
        As `load` takes it.
    keeps_all : bool
        Whether to keep particles that nothing needs once they are summed.
    part : range, optional
        Bodies of the scene, in which no body is drawn, and no force needs particles.

    Raises
    ------
    CaseError
        If a shape has no particles or moments that no body has, a CSV file is malformed, or a
        body spins where it cannot, or faster than its energy can tell; and as `load`.
    """
    case = load(source)
    placement = placement_of(case, part)
    notes: list[tuple[str, str]] = []
    particles, properties, first_kind = kinds(case, notes)
    kind = _kinds_of_bodies(case, placement, first_kind)
    bodies = bodies_of_kind(properties, kind)
    omega = _possible_spin(case, placement, bodies)
    position = placement.position
    for i, body in enumerate(case.body):
        if body.motion is not None:
            position[placement.block == i] += body.motion.shift
    counts, centred = np.diff(particles.offset), centred_at_com(particles, properties)
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused
        state = initial_state(bodies, position, placement.orientation, placement.velocity, omega)
        _refuse_overflow(case, placement, kinetic_energy(bodies, state))
    return System(
        **records(case),
        names=placement.names,
        block=placement.block,
        kind=kind,
        first_kind=first_kind,
        particles=centred if keeps_all else reduced(case, placement, kind, centred, properties),
        properties=properties,
        summed=counts,
        reach=farthest(centred),
        bodies=bodies,
        state=state,
        notes=tuple(notes),
    )


def _refuse_overflow(case: Case, placement: Placement, energy: Floats) -> None:
    """Raise CaseError where bodies are so fast that their energies [J] are no numbers."""
    first = {int(placement.block[b]): b for b in np.flatnonzero(~np.isfinite(energy))[::-1]}
    why = "moves or spins so fast that its kinetic energy is too large for float64"
    problems = [
        problem_at(case, f"body[{i}]", f"{placement.names[b]} {why}", "give smaller velocities")
        for i, b in sorted(first.items())
    ]
    refuse(problems)


def centred_at_com(particles: Particles, properties: MassProperties) -> Particles:
    """Particles with the centre of mass of each kind at the origin."""
    shift = np.repeat(properties.com, np.diff(particles.offset), axis=0)
    return particles._replace(position=particles.position - shift)


def records(case: Case) -> dict[str, Any]:
    """What a system holds of its case."""
    keys = Case.model_fields.keys() & System._fields
    held = {key: getattr(case, key) for key in (*keys, "source")}
    shown = FIELDS_OF_LAWS.get(case.contact.law, ()) if case.contact else ()
    if any(joint.breaks_at is not None for joint in case.joint):
        shown = (*shown, "joint_break_time")
    if shown:  # how well impulses are solved, and which joints have broken
        fields = dict.fromkeys((*case.output.fields, *shown))
        held["output"] = case.output.model_copy(update={"fields": tuple(fields)})
    return held


def with_records(system: System, case: Case) -> System:
    """The bodies of a system as they are, with all else as a case with the same bodies says."""
    return system._replace(**records(case))


def to_case(system: System) -> Case:
    """Case that states all records of a system, defaults included."""
    keys = Case.model_fields.keys() & System._fields
    case = Case.model_construct(**{key: getattr(system, key) for key in keys})
    case._source = system.source
    return case


def farthest(particles: Particles) -> Floats:
    """Largest distance of a particle from the origin, its radius included, of each kind [m]."""
    reach = np.linalg.norm(particles.position, axis=1) + particles.radius
    return np.asarray(np.maximum.reduceat(reach, particles.offset[:-1]))


def kinds(case: Case, notes: list[tuple[str, str]]) -> tuple[Particles, MassProperties, Ints]:
    """Particles of all kinds, their mass properties, and the (first) kind of each block."""
    sets, owners, first, problems = list[Particles](), list[int](), list[int](), list[Problem]()
    kinds_of_matter: dict[tuple[object, ...], tuple[int, list[tuple[str, str]]]] = {}
    n_kinds = 0

    def blame(i: int, error: Exception) -> None:
        key = f"body[{i}].shape" if case.body[i].shape is not None else f"body[{i}].part"
        words = {ArithmeticError: _OUT_OF_RANGE, MemoryError: _OUT_OF_MEMORY}
        why = next((words[kind] for kind in words if isinstance(error, kind)), error)
        problems.append(problem_at(case, key, f"{case.body[i].name}: {why}"))

    for i, body in enumerate(case.body):
        weights = (None if one is None else np.array(one).tobytes() for one in body.matter)
        matter = (i if body.is_drawn else -1, body.shape, body.part, *weights)
        if matter not in kinds_of_matter:
            try:
                particles, lines = _particle_sets(case, i, body)
            except (ValueError, ArithmeticError, MemoryError) as error:
                blame(i, error)
                continue
            sets.append(particles)
            owners.append(i)
            kinds_of_matter[matter] = n_kinds, lines
            n_kinds += len(particles.offset) - 1
        kind, lines = kinds_of_matter[matter]
        first.append(kind)
        notes += [(body.name + part, line) for part, line in lines]
    try:
        together = concatenate(sets)
        properties = mass_properties(together)
        _refuse_underflow(properties)
    except (ValueError, ArithmeticError):  # of which?
        for i, particles in zip(owners, sets, strict=True):
            try:
                _refuse_underflow(mass_properties(particles))
            except (ValueError, ArithmeticError) as error:
                blame(i, error)
    refuse(problems)
    return together, properties, np.array(first)


def _refuse_underflow(properties: MassProperties) -> None:
    """Raise ValueError where 1 / M or 1 / I would overflow."""
    sizes = np.append(properties.mass, properties.moments)
    sizes = sizes[sizes > 0.0]
    if sizes.min(initial=1.0) < _MIN_INERTIA:
        told = f"mass or moment of inertia {float(sizes.min())!r} is too small"
        raise ValueError(f"{told}: its inverse is too large for float64")


def _particle_sets(case: Case, i: int, body: Body) -> tuple[Particles, list[tuple[str, str]]]:
    """Particles of a block: one set, or one for each mass, or body where they are random clouds.

    Also what is to be said of them: which part of the body, empty for the whole, and a line.
    """
    files, stream = case.source.files, random_stream(case.run.seed, i, "shape")

    if body.shape is not None:
        each = [_shape_particles(files, body.shape, one, stream) for one in body.matter_of_kinds]
        return concatenate([one.particles for one in each]), [("", line) for line in each[0].lines]
    sets = list[Particles]()
    for _ in body.matter_of_kinds:
        parts = [part_particles(files, part, stream) for part in body.part]
        sets.append(united(concatenate([part.particles for part in parts])))
    lines = [(f", part {j}", line) for j, part in enumerate(parts) for line in part.lines]
    return concatenate(sets), lines


def part_particles(files: Files, part: ShapePart, stream: np.random.Generator) -> FilledShape:
    """Particles of one part of a record, where it stands in its body."""
    filled = _shape_particles(files, part.shape, (part.mass, part.density), stream)
    placed = transformed(filled.particles, turn_of(part), part.position)
    return filled._replace(particles=placed)


def turn_of(part: ShapePart) -> Floats:
    """Rotation matrix (3, 3) from the axes of the shape of a part to those of its body."""
    return rotation_matrix(quaternion_of(part.orientation))


def _shape_particles(
    files: Files, shape: AnyShape, matter: tuple[Any, Any], stream: np.random.Generator
) -> FilledShape:
    """Particles of a shape in its own axes, and what is to be said of them.

    Mass [kg] or density [kg/m³] is a number, or a column (k, 1) for as many kinds.
    """
    mass, density = matter
    if isinstance(shape, Cloud):
        return FilledShape(shapes.cloud(shape.n, shape.radius, mass or 0.0, stream))
    if isinstance(shape, PointsShape):
        if shape.file is not None:
            particles = read_points(files.read(shape.file))
        else:
            particles = one_kind(shape.position or (), shape.mass or (), shape.radius)
        return FilledShape(particles if mass is None else scaled_to_mass(particles, mass))
    if isinstance(shape, SpheresShape):
        return FilledShape(spheres(*spheres_of(files, shape), mass, density, shape.overlap))
    if isinstance(shape, MeshShape):
        mesh = read_mesh(files.read(shape.file), shape.scale)
        how = shape.arrangement, shape.n, shape.inertia_error
        return mesh_particles(mesh, mass, density, *how)
    parameters = shape.model_dump(exclude={"type", "inertia_error"})
    if mass is None:
        mass = density * solid_of(shape).volume
    particles_of = partial(getattr(shapes, shape.type), **parameters, mass=mass)
    wanted = getattr(shape, "inertia_error", None)
    if wanted is None:
        return FilledShape(particles_of())
    return coarsest_within(solid_of(shape), wanted, lambda n: particles_of(n=n))


def _kinds_of_bodies(case: Case, placement: Placement, first_kind: Ints) -> Ints:
    """Kind of each body."""
    kind = first_kind[placement.block]
    for i, body in enumerate(case.body):
        if body.is_varied:
            kind[placement.block == i] += body.kinds
    return np.asarray(kind, dtype=np.int64)


def _possible_spin(case: Case, placement: Placement, bodies: Bodies) -> Floats:
    """Angular velocities without what points and rods cannot have.

    Raises
    ------
    CaseError
        If the case itself, and no random draw, gives a point a spin or a rod one about its axis.
    """
    possible, size, rounding = spins_of(placement, bodies)
    problems: list[Problem] = []
    for i, body in enumerate(case.body):
        wrong = np.flatnonzero((placement.block == i) & (size > rounding))
        if wrong.size and not isinstance(body.angular_velocity, NormalDistribution):
            problems.append(_spin_problem(case, i, int(wrong[0]), placement, bodies))
    refuse(problems)
    return possible


def spins_of(placement: Placement, bodies: Bodies) -> tuple[Floats, Floats, Floats]:
    """Angular velocities that bodies can have, what was taken off, and what rounds of it, (n,)."""
    omega = placement.angular_velocity
    axes, about = _spins_about_axes(placement, bodies)
    points, rods = bodies.rotor_class == POINT, bodies.rotor_class == ROD
    impossible = np.zeros_like(omega)
    impossible[points] = omega[points]
    impossible[rods] = about[rods, None] * axes[rods]
    size, total = np.abs(impossible).max(axis=1), np.abs(omega).max(axis=1)
    return np.asarray(omega - impossible), size, _SPIN_ROUNDING * total


def _spins_about_axes(placement: Placement, bodies: Bodies) -> tuple[Floats, Floats]:
    """Third axes of the rotor frames in the world, (n, 3), and the spins about them, (n,)."""
    q = np.ascontiguousarray(placement.orientation.T)
    axes = np.zeros((3, len(placement.block)))
    axes[2] = 1.0
    axes = rotate(q, rotate(bodies.rotor_frame, axes)).T
    return axes, np.einsum("ij,ij->i", placement.angular_velocity, axes)


def _spin_problem(case: Case, i: int, b: int, placement: Placement, bodies: Bodies) -> Problem:
    """What is wrong with the spin of body b, in full precision."""
    key, name = f"body[{i}].angular_velocity", placement.names[b]
    if bodies.rotor_class[b] == POINT:
        value = placement.angular_velocity[b].tolist()
        reason = f"{name} is a point (all moments are zero): it cannot spin, got {value} rad/s"
        return problem_at(case, key, reason, "leave angular_velocity out, or give it extent")
    about = _spins_about_axes(placement, bodies)[1]
    reason = (
        f"{name} is a rod, moments {sorted(bodies.inertia[:, b].tolist())} kg m²: it cannot spin"
        f" about its own axis, got {float(about[b])!r} rad/s about it"
    )
    return problem_at(case, key, reason, "give an angular velocity across the rod")
