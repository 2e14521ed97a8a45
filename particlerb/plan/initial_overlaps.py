"""What is wrong where bodies are put: some overlap, or lie beyond a wall.

Overlaps are found with the search of the contacts themselves, so that no step is quadratic.
"""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from particlerb.case.contact import AnyWall, BoxWall, CylinderWall, PlaneWall
from particlerb.case.placement import unit_vectors
from particlerb.case.problems import Problem, problem_at, refuse
from particlerb.compiled.beside import compile_beside
from particlerb.contact.cell_grid import find_bounds
from particlerb.contact.sphere_search import neighbours
from particlerb.contact.wall_motion import pose_at, poses_at
from particlerb.contact.wall_search import WallSearch
from particlerb.contact.walls import gaps
from particlerb.forces.spring import places
from particlerb.maths.quaternion import conjugate
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import as_frame, lengths, over_columns, rotate, store_all
from particlerb.model.system import System
from particlerb.model.totals import sum_blocks, totals
from particlerb.plan.links import and_more, is_among, particles_of
from particlerb.plan.obstacles import middle

if TYPE_CHECKING:
    from particlerb.plan.contact_setup import SystemContact

_OVERLAP_ROUNDING: Final = 1e-9  # share of a radius, or of a coordinate
_MAX_OVERLAPS_NAMED: Final = 3  # in a message
_APART_HINT: Final = "move them apart"
_RELAX_HINT: Final = f"{_APART_HINT}, or say contact.relax = true"
_ALLOW_HINT: Final = f"{_APART_HINT}, say contact.relax = true, or allow it by contact.overlap"


class _SetupSpheres(NamedTuple):
    """Particles with a radius of the bodies that may touch, at t = 0."""

    place: Floats  # (3, n) [m], world frame
    radius: Floats  # (n,) [m]
    body: Ints  # (n,) body of the system


class Elsewhere(NamedTuple):
    """What was put elsewhere in a simulation: all else is where it came by itself."""

    bodies: Bools  # (n,)
    walls: Bools  # (n_walls,)


def refuse_misplaced(
    system: System,
    contact: "SystemContact",
    later: float | None = None,
    moved: Elsewhere | None = None,
) -> None:
    """Raise CaseError with all that overlaps or lies beyond a wall in the state of a system.

    That is one at t = 0, or `later` [s], where something was put elsewhere: then what contacts
    press together is no mistake, but for what springs would push out on the other side.
    """
    if moved is None:
        moved = Elsewhere(np.ones(system.n_bodies, bool), np.ones(len(system.wall), bool))
    if not (moved.bodies.any() or moved.walls.any()):
        return
    spheres = spheres_of(system, contact)
    if not spheres.radius.size:
        return
    given = system, contact, spheres, later, moved
    if system.wall:
        first = partial(as_frame, system.bodies, system.state)
        search = find_bounds, lambda: list(_overlapping(*given))
        sums = sum_blocks, lambda: totals(first(), system.bodies, np.zeros(3))
        compile_beside([search, (store_all, first), sums])
    refuse([*_beyond_walls(*given), *_overlapping(*given)])


def spheres_of(system: System, contact: "SystemContact") -> _SetupSpheres:
    """Where the spheres of a system are in its state."""
    index, of_body = particles_of(system, contact.body)
    solid = system.particles.radius[index] > 0.0
    index, owner = index[solid], contact.body[of_body[solid]]
    place = places(system, owner, system.particles.position[index].T)
    return _SetupSpheres(np.ascontiguousarray(place), system.particles.radius[index], owner)


def _allowed(contact: "SystemContact", spheres: _SetupSpheres) -> float:
    """Overlap that is no mistake [m]: what is allowed, or rounding."""
    size = max(float(spheres.radius.max()), float(np.abs(spheres.place).max()))
    return max(contact.record.overlap, _OVERLAP_ROUNDING * size)


def _hint(contact: "SystemContact", is_deep: bool = False) -> str:
    """What to do about an overlap; impacts at instants cannot begin with one."""
    if contact.record.law == "events":
        return _APART_HINT
    return _RELAX_HINT if is_deep else _ALLOW_HINT


def _with_images(spheres: _SetupSpheres, contact: "SystemContact") -> _SetupSpheres:
    """Spheres within the box that repeats, and again beyond its upper sides what is near lower."""
    if not any(contact.record.periodic or ()):
        return spheres  # they stand by bodies
    place, radius, body = spheres
    for k, side in enumerate(contact.record.periodic or ()):
        if side > 0.0:
            place = place.copy()
            place[k] %= side
            near = place[k] < 2.0 * radius.max()
            beyond = place[:, near]
            beyond[k] += side
            place = np.concatenate([place, beyond], axis=1)
            radius, body = np.append(radius, radius[near]), np.append(body, body[near])
    order = np.argsort(body, kind="stable")
    return _SetupSpheres(np.ascontiguousarray(place[:, order]), radius[order], body[order])


def _overlapping(
    system: System, contact: "SystemContact", spheres: _SetupSpheres, later: float | None,
    moved: Elsewhere,
) -> Iterator[Problem]:  # fmt: skip
    """What is wrong with bodies that overlap: which, how deep, and how many.

    More than the smaller radius cannot be allowed: springs would push out on the other side.
    """
    if contact.record.relax and later is None:
        return
    spheres = _with_images(spheres, contact)
    place, radius, body = spheres
    pairs = neighbours(place, radius, body, 0.0, contact.excluded, system.world)
    i, j = pairs.sphere, pairs.other
    depth = radius[i] + radius[j] - lengths(place[:, j] - place[:, i])
    a, b, most = body[i], body[j], np.minimum(radius[i], radius[j])
    wrong = depth > (most if later else np.minimum(_allowed(contact, spheres), most))
    wrong &= ~(contact.fixed[a] & contact.fixed[b]) & (moved.bodies[a] | moved.bodies[b])
    if not wrong.any():
        return
    is_deep = bool((depth > most)[wrong].any())
    a, b, depth = np.minimum(a, b)[wrong], np.maximum(a, b)[wrong], depth[wrong]
    order = np.lexsort((-depth, b, a))
    a, b, depth = a[order], b[order], depth[order]
    first = np.concatenate([[True], (np.diff(a) != 0) | (np.diff(b) != 0)])
    a, b, depth = a[first], b[first], depth[first]
    named = np.argsort(-depth, kind="stable")[:_MAX_OVERLAPS_NAMED]
    names = system.names
    each = (f"{names[int(a[k])]} and {names[int(b[k])]} by {depth[k]:.3g} m" for k in named)
    listed = ", ".join(each)
    reason = f"bodies overlap at t = {later or 0:g}: {listed}{and_more(a.size - named.size)}"
    key = f"body[{system.block[b[named[0]]]}]"
    yield problem_at(system, key, reason, _APART_HINT if later else _hint(contact, is_deep))


def _beyond_walls(
    system: System, contact: "SystemContact", spheres: _SetupSpheres, later: float | None,
    moved: Elsewhere,
) -> Iterator[Problem]:  # fmt: skip
    """What is wrong with bodies that overlap a wall, or lie on its other side.

    Where a wall that slides is `later`, nobody says here.
    """
    moving = np.flatnonzero(~contact.fixed[spheres.body])
    is_moving = is_among(spheres.body[moving], system)
    depth = np.full((len(system.wall), len(system.kind)), -np.inf)
    may_overlap = contact.record.relax or later is not None
    if not may_overlap:
        poses = poses_at(contact.motions, 0.0)
        i, p, _ = WallSearch(contact.walls, spheres.radius).pairs(spheres.place, poses, 0.0, moving)
        gap = lengths(gaps(contact.walls, poses, spheres.place, i, p))
        owner = (contact.walls.wall[p], spheres.body[i])
        np.maximum.at(depth, owner, spheres.radius[i] - gap)
    for number, table in enumerate(system.wall):
        pose = pose_at(contact.motions[number], later or 0.0)
        outside = (_room_in(table, pose, system.state.com) <= 0.0) & is_moving
        outside &= moved.bodies | moved.walls[number]
        if outside.any() and not (later and table.piston):
            yield _outside_problem(system, number, np.flatnonzero(outside), later or 0.0)
        if not may_overlap:
            room = over_columns(partial(_room_in, table, pose), spheres.place[:, moving])
            beyond = moving[room <= 0.0]
            further = spheres.radius[beyond] - room[room <= 0.0]
            np.maximum.at(depth[number], spheres.body[beyond], further)
        wrong = np.flatnonzero((depth[number] > _allowed(contact, spheres)) & ~outside)
        if wrong.size:
            named = wrong[np.argsort(-depth[number, wrong], kind="stable")[:_MAX_OVERLAPS_NAMED]]
            listed = ", ".join(f"{system.names[int(b)]} by {depth[number, b]:.3g} m" for b in named)
            reason = f"overlaps bodies at t = 0: {listed}{and_more(wrong.size - named.size)}"
            yield problem_at(system, f"wall[{number}]", reason, _hint(contact))


def _room_in(table: AnyWall, pose: tuple[Any, ...], points: Floats) -> Floats:
    """Distance of points (3, n) from the nearest face around them [m], negative beyond it.

    Closed faces count as endless and open ones not at all. It is inf where points may be anywhere.
    """
    shift, turn = (np.array(part)[:, None] for part in (pose[0], conjugate(pose[1])))
    away = rotate(turn, points - shift) - np.array(middle(table))[:, None]
    if isinstance(table, PlaneWall):
        return np.asarray(unit_vectors(np.array(table.normal)) @ away)
    if isinstance(table, BoxWall) and table.inside:
        half = 0.5 * (np.array(table.upper) - np.array(table.lower))[:, None]
        room = np.concatenate([half + away, half - away])
        closed = [f"{sign}{axis}" not in table.open for sign in "-+" for axis in "xyz"]
        return np.asarray(room[closed].min(axis=0))
    if isinstance(table, CylinderWall) and table.inside:
        axis = unit_vectors(np.array(table.axis))
        along = axis @ away
        least = table.radius - lengths(away - axis[:, None] * along)
        for end, sign in (("-", 1.0), ("+", -1.0)):
            if end not in table.open:
                least = np.minimum(least, 0.5 * table.length + sign * along)
        return least
    return np.full(points.shape[1], np.inf)


def _outside_problem(system: System, number: int, bodies: Ints, time: float) -> Problem:
    """Bodies on the wrong side of a wall."""
    listed = ", ".join(system.names[int(b)] for b in bodies[:_MAX_OVERLAPS_NAMED])
    more = and_more(max(bodies.size - _MAX_OVERLAPS_NAMED, 0))
    table, verb = system.wall[number], "is" if bodies.size == 1 else "are"
    where, hint = f"outside the {table.type}", "move the wall or the body, or say inside = false"
    if isinstance(table, PlaneWall):
        where, hint = "behind the plane", "bodies are where the normal points"
    reason = f"{listed}{more} {verb} {where} at t = {time:g}"
    return problem_at(system, f"wall[{number}]", reason, hint)
