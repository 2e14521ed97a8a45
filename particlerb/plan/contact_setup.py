"""Contact of a system, resolved: materials, walls, who may touch whom, and what starts wrong.

`contact_of` makes arrays of what its records say. A body takes part with its particles of positive
radius. Only pairs of materials that can meet need numbers: those of two bodies of which one can
move, and of such a body and a wall. What overlaps at t = 0 is found with the search of the
contacts themselves, so that no step is quadratic.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.contact import (
    AnyWall,
    BoxWall,
    ContactTable,
    CylinderWall,
    MeshWall,
    Pair,
    PlaneWall,
    Prescribed,
)
from particlerb.case.placement import normalised, quaternion_of_euler
from particlerb.case.problems import CaseError, Problem, nearest
from particlerb.case.schema import Body, Euler
from particlerb.case.source import problem_at
from particlerb.contact.piston import Pistons
from particlerb.contact.restitution import (
    damping_ratio,
    effective_modulus,
    effective_shear_modulus,
)
from particlerb.contact.sphere_search import neighbours
from particlerb.contact.wall_motion import PrescribedMotion, poses_at
from particlerb.contact.wall_search import WallSearch
from particlerb.contact.wall_shapes import box, cylinder, joined, plane, surface, unit
from particlerb.contact.walls import Walls, gaps
from particlerb.forces.spring import places
from particlerb.geometry.mesh import triangles_of
from particlerb.maths.vec3 import Bools, Floats, Ints, Vec3
from particlerb.model.state import lengths, turned
from particlerb.model.system import System
from particlerb.plan.links import and_more, is_among, particles_of

NOTHING: Final = -1  # material of a body that touches nothing
TANGENTIAL: Final = 2.0 / 7.0  # default tangential over normal stiffness
ROUNDING: Final = 1e-9  # share of a radius, or of a coordinate, by which rounding may overlap
MOST_NAMED: Final = 3  # overlaps that a message names
APART: Final = "move them apart, say contact.relax = true, or allow it by contact.overlap"


class MaterialPairs(NamedTuple):
    """Numbers of every pair of k materials; symmetric, and zero where a pair cannot meet."""

    stiffness: Floats  # (k, k) [N/m] hooke, normal
    tangential_stiffness: Floats  # (k, k) [N/m] hooke
    modulus: Floats  # (k, k) [Pa] hertz, E*
    shear_modulus: Floats  # (k, k) [Pa] hertz, G*
    restitution: Floats  # (k, k)
    damping_ratio: Floats  # (k, k) ζ that gives the restitution with this law
    friction: Floats  # (k, k)
    rolling_friction: Floats  # (k, k)
    can_meet: Bools  # (k, k)


class ContactSetup(NamedTuple):
    """All that records say about contact."""

    law: str  # hooke or hertz
    attract: bool  # whether damping may pull
    skin: float | None  # [m] None: chosen
    relax: bool  # whether what overlaps at the start is pushed apart
    allow_unstable: bool  # whether a step above the limit is taken
    materials: Sequence[str]  # (k,) names; a single "" where there are none
    pairs: MaterialPairs
    body: Ints  # (m,) bodies of the system that may touch, ascending
    material: Ints  # (n_bodies,) code; NOTHING for the others
    fixed: Bools  # (n_bodies,) whether a body is held: it stays, or moves as prescribed
    driven: Ints  # (n_driven,) bodies of the system that move as prescribed, ascending,
    drives: tuple[PrescribedMotion, ...]  # (n_driven,) and how
    walls: Walls  # primitives of all walls
    motions: tuple[PrescribedMotion, ...]  # (n_walls,)
    pistons: Pistons | None  # walls that slide
    wall_names: tuple[str, ...]  # (n_walls,)
    wall_material: Ints  # (n_walls,) code


def contact_of(system: System) -> ContactSetup | None:
    """Contact of a system; None where nothing touches.

    Raises
    ------
    CaseError
        With all that is wrong: nothing that could touch, a body without radius, a material or a
        number that is missing, a file of triangles that cannot be read; and, where nothing of
        these is wrong, with what overlaps or lies beyond a wall at t = 0.
    """
    if system.contact is None:
        return None
    names = [material.name for material in system.material] or [""]
    problems = [*without_radius(system), *without_material(system, names)]
    codes = {name: k for k, name in enumerate(names)}
    code = np.array([codes.get(body.material or names[0], 0) for body in system.body])
    touches = np.array([body.contact for body in system.body])
    block = system.block
    material = np.where(touches[block], code[block], NOTHING)
    fixed = np.array([body.is_held for body in system.body])[block]
    driven = np.flatnonzero([system.body[i].motion is not None for i in block])
    parts: list[Walls] = []
    for number, table in enumerate(system.wall):
        try:
            parts.append(wall_of(system, number, table))
        except CaseError as error:
            problems += error.problems
    wall_material = np.array(
        [codes.get(w.material or names[0], 0) for w in system.wall], dtype=np.int64
    )
    can_meet = meetings(len(names), material, fixed, wall_material)
    if not problems and not can_meet.any():
        problems.append(nothing_meets(system))
    pairs, missing = pairs_of(system, system.contact, names, can_meet)
    if problems or missing:
        raise CaseError([*problems, *missing])
    contact = ContactSetup(
        law=system.contact.law,
        attract=system.contact.attract,
        skin=system.contact.skin,
        relax=system.contact.relax,
        allow_unstable=system.contact.allow_unstable,
        materials=names,
        pairs=pairs,
        body=np.flatnonzero(material != NOTHING),
        material=material,
        fixed=fixed,
        driven=driven,
        drives=tuple(drive_of(system.body[block[b]], system.state.com[:, b]) for b in driven),
        walls=joined(parts),
        motions=tuple(motion_of(table.motion, middle(table)) for table in system.wall),
        pistons=pistons_of(system),
        wall_names=tuple(table.name for table in system.wall),
        wall_material=wall_material,
    )
    spheres = spheres_of(system, contact)
    wrong = [
        *beyond_walls(system, contact, spheres),
        *overlapping(system, contact, spheres),
    ]
    if wrong:
        raise CaseError(wrong)
    return contact


# Who may touch whom


def without_radius(system: System) -> list[Problem]:
    """What is wrong with bodies of which no particle has a radius."""
    largest = np.maximum.reduceat(system.particles.radius, system.particles.offset[:-1])
    bare = [
        i
        for i, first in enumerate(system.names.first[:-1])
        if system.body[i].contact and largest[system.kind[first]] == 0.0
    ]
    hint = 'take shape = { type = "sphere", .. }, give `points` a radius, or say contact = false'
    reason = "no particle has a radius: nothing can touch this body"
    return [
        problem_at(system, f"body[{i}].{'part' if system.body[i].part else 'shape'}", reason, hint)
        for i in bare
    ]


def without_material(system: System, names: Sequence[str]) -> list[Problem]:
    """What is wrong with bodies and walls that do not say which of several materials they have."""
    if len(names) == 1:
        return []
    keys = [
        f"body[{i}]" for i, body in enumerate(system.body) if body.contact and not body.material
    ]
    keys += [f"wall[{i}]" for i, wall in enumerate(system.wall) if not wall.material]
    hint = nearest("", names)
    return [
        problem_at(system, f"{key}.material", "missing: there are several", hint) for key in keys
    ]


def meetings(n_materials: int, material: Ints, fixed: Bools, walls: Ints) -> Bools:
    """Which pairs of materials can meet, (k, k).

    Parameters
    ----------
    n_materials : int
        k.
    material, fixed : ndarray, shape (n_bodies,)
        As in `ContactSetup`.
    walls : ndarray, shape (n_walls,)
        Code of each wall.
    """
    here = material != NOTHING
    moving = np.bincount(material[here & ~fixed], minlength=n_materials)
    still = np.bincount(material[here & fixed], minlength=n_materials)
    still += np.bincount(walls, minlength=n_materials)
    met = (moving[:, None] > 0) & ((moving + still)[None, :] > 0)
    own = (moving > 1) | ((moving == 1) & (still > 0))
    np.fill_diagonal(met, own)
    return np.asarray(met | met.T)


def nothing_meets(system: System) -> Problem:
    """A system in which contact is on and has no effect."""
    reason = "nothing can touch: this takes two bodies, or a body and a wall, of which one can move"
    return problem_at(system, "contact", reason, "add a [[wall]] or a body, or leave [contact] out")


# Numbers of pairs


def pairs_of(
    system: System, table: ContactTable, names: Sequence[str], can_meet: Bools
) -> tuple[MaterialPairs, list[Problem]]:
    """Numbers of all pairs that can meet, and what is wrong where some are missing."""
    pairs = MaterialPairs._make(
        [*np.zeros((len(MaterialPairs._fields) - 1, *can_meet.shape)), can_meet]
    )
    own = {frozenset(pair.materials): (i, pair) for i, pair in enumerate(table.pair)}
    problems: list[Problem] = []
    is_hertz = table.law == "hertz"
    if is_hertz:
        problems += without_moduli(system, can_meet)
    for a, b in np.argwhere(np.triu(can_meet)).tolist():
        number, pair = own.get(frozenset((names[a], names[b])), (-1, None))
        needed = ["restitution", "friction"] + ([] if is_hertz else ["stiffness"])
        missing = [key for key in needed if number_of(table, pair, key) is None]
        if missing:
            problems += [missing_number(system, names, a, b, number, missing)]
            continue
        for key in (*needed, "rolling_friction"):
            both(getattr(pairs, key), a, b, number_of(table, pair, key) or 0.0)
        ratio = damping_ratio(float(pairs.restitution[a, b]), table.attract)
        both(pairs.damping_ratio, a, b, ratio)
        if is_hertz:
            continue
        tangential = number_of(table, pair, "tangential_stiffness")
        if tangential is None:
            tangential = TANGENTIAL * float(pairs.stiffness[a, b])
        both(pairs.tangential_stiffness, a, b, tangential)
    if is_hertz and not problems:
        add_moduli(system, pairs)
    return pairs, problems


def number_of(table: ContactTable, pair: Pair | None, key: str) -> float | None:
    """Number of a pair, its own or that of all pairs."""
    value: float | None = None if pair is None else getattr(pair, key)
    if value is None:
        value = getattr(table, key)
    return value


def both(array: Floats, a: int, b: int, value: float) -> None:
    """Write a number of a pair, which has no first."""
    array[a, b] = array[b, a] = value


def missing_number(
    system: System, names: Sequence[str], a: int, b: int, number: int, missing: Sequence[str]
) -> Problem:
    """Numbers that a pair needs and that are nowhere given."""
    listed = " and ".join(f"`{key}`" for key in missing)
    if len(names) == 1:
        reason = f"missing: contact needs {listed}"
        return problem_at(system, f"contact.{missing[0]}", reason, "give it in [contact]")
    which = f"{names[a]} with {names[b]}" if a != b else f"{names[a]} with itself"
    if number >= 0:
        key, reason = f"contact.pair[{number}].{missing[0]}", f"missing: {which} needs {listed}"
        return problem_at(system, key, reason, "give it here, or in [contact] for all pairs")
    reason = f"missing: {which}, which can touch, has no {listed}"
    hint = f'add [[contact.pair]] with materials = ["{names[a]}", "{names[b]}"]'
    return problem_at(system, "contact.pair", reason, f"{hint}, or give {listed} in [contact]")


def without_moduli(system: System, can_meet: Bools) -> list[Problem]:
    """What hertz lacks: materials that can touch, with both of their constants."""
    if not system.material:
        reason = "hertz needs a [[material]] with `young` and `poisson`"
        return [problem_at(system, "contact.law", reason, 'add it, or take law = "hooke"')]
    return [
        problem_at(system, f"material[{k}].{key}", "missing: hertz needs it", "give it")
        for k in np.flatnonzero(can_meet.any(axis=0)).tolist()
        for key in ("young", "poisson")
        if getattr(system.material[k], key) is None
    ]


def add_moduli(system: System, pairs: MaterialPairs) -> None:
    """Write E* and G* of all pairs that can meet."""
    for a, b in np.argwhere(pairs.can_meet).tolist():
        one, other = system.material[a], system.material[b]
        young = (one.young or 0.0, other.young or 0.0)
        poisson = (one.poisson or 0.0, other.poisson or 0.0)
        pairs.modulus[a, b] = effective_modulus(young, poisson)
        pairs.shear_modulus[a, b] = effective_shear_modulus(young, poisson)


# Walls


def wall_of(system: System, number: int, table: AnyWall) -> Walls:
    """Primitives of a wall.

    Raises
    ------
    CaseError
        If its file cannot be read.
    """
    if isinstance(table, PlaneWall):
        return plane(table.point, table.normal)
    if isinstance(table, BoxWall):
        return box(table.lower, table.upper, table.open)
    if isinstance(table, CylinderWall):
        caps = ("-" not in table.open, "+" not in table.open)
        return cylinder(table.centre, table.axis, table.radius, table.length, caps)
    return mesh_of(system, number, table)


def motion_of(motion: Prescribed | None, own: Vec3) -> PrescribedMotion:
    """Motion about a centre, one's own where none is given."""
    if motion is None:
        return PrescribedMotion(own)
    centre = own if motion.centre is None else motion.centre
    swing = motion.oscillation
    if swing is None:
        return PrescribedMotion(centre, motion.velocity, motion.angular_velocity)
    return PrescribedMotion(
        centre,
        motion.velocity,
        motion.angular_velocity,
        swing.amplitude,
        swing.frequency,
        swing.phase,
    )


def drive_of(body: Body, com: Floats) -> PrescribedMotion:
    """Motion of a driven body whose centre of mass is at `com` at t = 0, where it may be displaced.

    Its centre is where it is not.
    """
    motion = motion_of(body.motion, (0.0, 0.0, 0.0))
    if body.motion is None or body.motion.centre is not None:
        return motion
    x, y, z = com - body.motion.shift
    return motion._replace(centre=(x, y, z))


def pistons_of(system: System) -> Pistons | None:
    """Walls that slide, if there are any."""
    wall = [w for w, table in enumerate(system.wall) if table.piston is not None]
    given = [table.piston for table in system.wall if table.piston is not None]
    if not given:
        return None
    of_wall = np.full(len(system.wall), -1)
    of_wall[wall] = np.arange(len(wall))
    axis = np.array([unit(one.axis) for one in given])
    mass = np.array([one.mass for one in given])
    return Pistons(
        np.array(wall),
        of_wall,
        axis,
        mass,
        np.array([one.load for one in given]) + mass * (axis @ system.acceleration),
        np.array([one.limits or (-np.inf, np.inf) for one in given]),
        np.array([[0.0, one.velocity] for one in given]),
    )


def middle(table: AnyWall) -> Vec3:
    """Point of a wall about which it turns unless its record says otherwise [m]."""
    if isinstance(table, PlaneWall):
        return table.point
    if isinstance(table, BoxWall):
        x, y, z = (0.5 * (a + b) for a, b in zip(table.lower, table.upper, strict=True))
        return x, y, z
    return table.centre if isinstance(table, CylinderWall) else table.position


def mesh_of(system: System, number: int, table: MeshWall) -> Walls:
    """Surface of the triangles of a file, where its record puts it.

    Raises
    ------
    CaseError
        If trimesh is not there, or cannot read the file, or finds no triangle in it.
    """
    key = f"wall[{number}].file"
    try:
        places, faces = triangles_of(system.files.read(table.file))
        corners = places[faces]
    except (ValueError, IndexError) as error:
        raise CaseError([problem_at(system, key, str(error), "give an STL file")]) from None
    if not corners.size:
        reason = "has no triangle: it is empty, cut off, or no STL file"
        raise CaseError([problem_at(system, key, reason, "write it again, as binary or ASCII STL")])
    if not np.isfinite(corners).all():
        reason = "has a corner that is not finite"
        raise CaseError([problem_at(system, key, reason, "give an STL file")])
    given = table.orientation
    q = quaternion_of_euler(given.euler_deg) if isinstance(given, Euler) else np.array(given)
    vertices, own = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    turns = np.tile(normalised(q)[:, None], len(vertices))
    vertices = turned(turns, table.scale * vertices.T).T + np.array(table.position)
    made = surface(vertices, own.reshape(-1, 3))
    if not made.kind.size:
        raise CaseError(
            [problem_at(system, key, "has no triangle with an area", "give an STL file")]
        )
    return made


# What starts wrong


class SetupSpheres(NamedTuple):
    """Particles with a radius of the bodies that may touch, at t = 0."""

    place: Floats  # (3, n) [m], world frame
    radius: Floats  # (n,) [m]
    body: Ints  # (n,) body of the system


def spheres_of(system: System, contact: ContactSetup) -> SetupSpheres:
    """Where the spheres of a system are at t = 0."""
    index, owner = particles_of(system, contact.body)
    solid = system.particles.radius[index] > 0.0
    index, owner = index[solid], owner[solid]
    place = places(system, owner, system.particles.position[index].T)
    return SetupSpheres(np.ascontiguousarray(place), system.particles.radius[index], owner)


def allowed(system: System, spheres: SetupSpheres) -> float:
    """Overlap that is no mistake [m]: what is allowed, or rounding."""
    size = max(float(spheres.radius.max()), float(np.abs(spheres.place).max()))
    given = system.contact.overlap if system.contact is not None else 0.0
    return max(given, ROUNDING * size)


def overlapping(system: System, contact: ContactSetup, spheres: SetupSpheres) -> Iterator[Problem]:
    """What is wrong with bodies that overlap: which, how deep, and how many."""
    if contact.relax:
        return
    found = neighbours(spheres.place, spheres.radius, spheres.body, 0.0)
    i, j = found.first, found.second
    distance = lengths(spheres.place[:, j] - spheres.place[:, i])
    depth = spheres.radius[i] + spheres.radius[j] - distance
    a, b = spheres.body[i], spheres.body[j]
    wrong = (depth > allowed(system, spheres)) & ~(contact.fixed[a] & contact.fixed[b])
    if not wrong.any():
        return
    a, b, depth = np.minimum(a, b)[wrong], np.maximum(a, b)[wrong], depth[wrong]
    order = np.lexsort((-depth, b, a))
    a, b, depth = a[order], b[order], depth[order]
    first = np.concatenate([[True], (np.diff(a) != 0) | (np.diff(b) != 0)])
    a, b, depth = a[first], b[first], depth[first]
    named = np.argsort(-depth, kind="stable")[:MOST_NAMED]
    which = ", ".join(
        f"{system.names[int(a[k])]} and {system.names[int(b[k])]} by {depth[k]:.3g} m"
        for k in named
    )
    reason = f"bodies overlap at t = 0: {which}{and_more(a.size - named.size)}"
    yield problem_at(system, f"body[{system.block[b[named[0]]]}]", reason, APART)


def beyond_walls(system: System, contact: ContactSetup, spheres: SetupSpheres) -> Iterator[Problem]:
    """What is wrong with bodies that overlap a wall, or lie on its other side."""
    moving = np.flatnonzero(~contact.fixed[spheres.body])
    is_moving = is_among(spheres.body[moving], system)
    depth = np.full((len(system.wall), len(system.kind)), -np.inf)
    if not contact.relax:
        poses = poses_at(contact.motions, 0.0)
        i, p, _ = WallSearch(contact.walls, spheres.radius).pairs(spheres.place, poses, 0.0, moving)
        gap = lengths(gaps(contact.walls, poses, spheres.place, i, p))
        owner = (contact.walls.wall[p], spheres.body[i])
        np.maximum.at(depth, owner, spheres.radius[i] - gap)
    for number, table in enumerate(system.wall):
        motion = contact.motions[number]
        outside = (room_in(table, motion, system.state.com) <= 0.0) & is_moving
        if outside.any():
            yield outside_problem(system, number, np.flatnonzero(outside))
        if not contact.relax:
            room = room_in(table, motion, spheres.place[:, moving])
            beyond = moving[room <= 0.0]
            further = spheres.radius[beyond] - room[room <= 0.0]
            np.maximum.at(depth[number], spheres.body[beyond], further)
        wrong = np.flatnonzero((depth[number] > allowed(system, spheres)) & ~outside)
        if wrong.size:
            named = wrong[np.argsort(-depth[number, wrong], kind="stable")[:MOST_NAMED]]
            which = ", ".join(f"{system.names[int(b)]} by {depth[number, b]:.3g} m" for b in named)
            more = and_more(wrong.size - named.size)
            reason = f"overlaps bodies at t = 0: {which}{more}"
            yield problem_at(system, f"wall[{number}]", reason, APART)


def room_in(table: AnyWall, motion: PrescribedMotion, points: Floats) -> Floats:
    """Distance of points (3, n) from the nearest face around them [m], negative beyond it.

    Closed faces count as endless and open ones not at all. It is inf where points may be anywhere.
    """
    shift = math.sin(motion.phase) * np.array(motion.amplitude)
    away = points - (np.array(middle(table)) + shift)[:, None]
    if isinstance(table, PlaneWall):
        return np.asarray(normalised(np.array(table.normal)) @ away)
    if isinstance(table, BoxWall) and table.inside:
        half = 0.5 * (np.array(table.upper) - np.array(table.lower))[:, None]
        room = np.concatenate([half + away, half - away])
        closed = [f"{sign}{axis}" not in table.open for sign in "-+" for axis in "xyz"]
        return np.asarray(room[closed].min(axis=0))
    if isinstance(table, CylinderWall) and table.inside:
        axis = normalised(np.array(table.axis))
        along = axis @ away
        least = table.radius - lengths(away - axis[:, None] * along)
        for end, sign in (("-", 1.0), ("+", -1.0)):
            if end not in table.open:
                least = np.minimum(least, 0.5 * table.length + sign * along)
        return least
    return np.full(points.shape[1], np.inf)


def outside_problem(system: System, number: int, bodies: Ints) -> Problem:
    """Bodies on the wrong side of a wall."""
    listed = ", ".join(system.names[int(b)] for b in bodies[:MOST_NAMED])
    more = and_more(max(bodies.size - MOST_NAMED, 0))
    table, verb = system.wall[number], "is" if bodies.size == 1 else "are"
    where, hint = f"outside the {table.type}", "move the wall or the body, or say inside = false"
    if isinstance(table, PlaneWall):
        where, hint = "behind the plane", "bodies are where the normal points"
    reason = f"{listed}{more} {verb} {where} at t = 0"
    return problem_at(system, f"wall[{number}]", reason, hint)
