"""What collisions by events work on, from a group of bodies: their order, cells, walls."""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.contact.sphere_search import LARGEST_NUMBER
from particlerb.contact.walls import DISC, FACE, PLANE, SIDE, Walls
from particlerb.events import records as col
from particlerb.events.records import EventScene
from particlerb.impulses import records as impulses
from particlerb.impulses.records import EventRules
from particlerb.maths.vec3 import Floats, Indices, Ints, Vec3
from particlerb.model.state import State
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.motion import MotionError, SegmentGroup

_CENTRE_ROUNDING: Final = 1e-15  # of a radius: a centre nearer to the centre of mass is there
_WIDTH_MARGIN: Final = 1.0 + 1e-9
_CELLS: Final = 8.0  # that are passed until times are counted anew
_CELLS_PER_BODY: Final = 3.0  # a body meets few others in each that it enters
_MAX_CELLS_PER_BODY: Final = 8  # roughly
_SOLID_KINDS: Final = (PLANE, FACE, SIDE, DISC)  # edges, vertices and rims are of these


def _rules_of(group: SegmentGroup) -> EventRules:
    """How a group collides by events."""
    rules = group.terms.known_contact.events
    assert rules is not None
    return rules


def bounds_of(group: SegmentGroup) -> tuple[Floats, Floats]:
    """Of each body (n,): farthest centre of a sphere, farthest point [m]; 0: a ball."""
    spheres, n = group.terms.known_contact.model.spheres, group.members.size
    distance = np.sqrt((spheres.arm**2).sum(axis=0))
    reach, bound = np.zeros(n), np.zeros(n)
    np.maximum.at(reach, spheres.body, distance)
    np.maximum.at(bound, spheres.body, distance + spheres.radius)
    is_ball = (np.diff(spheres.offset) == 1) & (reach <= _CENTRE_ROUNDING * bound)
    return np.where(is_ball, 0.0, np.maximum(reach, np.finfo(float).tiny)), bound


def _points_of(walls: Walls) -> Floats:
    """Points that finite walls reach to, (3, m) [m]."""
    points = [np.zeros((3, 0))]
    for kind, row in zip(walls.kind.tolist(), walls.parameter, strict=True):
        if kind == FACE:
            points.append(row[:9].reshape(3, 3).T)
        elif kind == SIDE:
            points += [row[:3, None] + s * (row[7] + row[6]) for s in (-1.0, 1.0)]
    return np.concatenate(points, axis=1)


class _Grid(NamedTuple):
    """Cells of a scene."""

    width: Floats  # (3,) [m]
    origin: Floats  # (3,) [m] corner of the first
    cells: Ints  # (3,) along each axis


def _grid(group: SegmentGroup, com: Floats) -> _Grid:
    """Cells as wide as two bodies at least, and as many as some for each body, where these are.

    Where they repeat, cells begin anew; elsewhere those beyond the last one share its lists.
    """
    contact = group.terms.known_contact
    bound, box = bounds_of(group)[1], _rules_of(group).box
    points = np.concatenate([com, _points_of(contact.model.walls)], axis=1)
    low, high = points.min(axis=1), points.max(axis=1)
    least = 2.0 * _WIDTH_MARGIN * float(bound.max())
    size = np.where(np.isfinite(box), box, np.maximum(high - low, least))
    width = max(least, float((size.prod() / (_CELLS_PER_BODY * bound.size)) ** (1.0 / 3.0)))
    span = np.maximum(size, high - low)  # beyond a box that repeats
    narrowest = np.minimum(width, box / impulses.LEAST_CELLS)
    if (span / narrowest).max() > LARGEST_NUMBER:
        raise MotionError(
            f"bodies lie within {span.max():.3g} m, in cells of {narrowest.min():.3g} m: their"
            f" numbers end at {LARGEST_NUMBER}; take bodies that are nearer to each other"
        )
    count = np.maximum(np.ceil(size / width).astype(np.int64), 3)
    while count.prod() > _MAX_CELLS_PER_BODY * bound.size + 27:
        count = np.maximum(count // 2, 3)
        if (count == 3).all():
            break
    fits = np.floor(np.where(np.isfinite(box), box, 0.0) / width).astype(np.int64)
    count = np.where(np.isfinite(box), np.maximum(fits, impulses.LEAST_CELLS), count)
    return _Grid(np.where(np.isfinite(box), box / count, width), low - 0.5 * width, count)


def order_of(group: SegmentGroup, state: State) -> tuple[Ints, int]:
    """Bodies in the order of their cells, those that are held last; how many move."""
    grid = _grid(group, state.com)
    cell = np.floor((state.com.T - grid.origin) / grid.width).astype(np.int64) % grid.cells
    number = (cell[:, 0] * grid.cells[1] + cell[:, 1]) * grid.cells[2] + cell[:, 2]
    is_held = group.bodies.inv_mass == 0.0
    order = np.lexsort((np.arange(number.size), number, is_held))
    return order, int((~is_held).sum())


def scene_of(group: SegmentGroup, state: State, order: Ints, n_moving: int) -> EventScene:
    """Constants of a group, its bodies in an order."""
    contact, rules, walls = group.terms.known_contact, _rules_of(group), _solid(group)
    model, spheres = contact.model, contact.model.spheres
    reach, bound = bounds_of(group)
    grid = _grid(group, state.com)
    sizes = np.diff(spheres.offset)[order]
    first = np.concatenate([[0], np.cumsum(sizes)])
    sphere_order = np.repeat(spheres.offset[order] - first[:-1], sizes) + np.arange(first[-1])
    gravity = np.zeros(3)
    if group.terms.gravity is not None:
        gravity = group.terms.gravity.acceleration.copy()
    body = _constants(group, reach)[order]
    kind = np.zeros((order.size + 1, col.N_KIND), dtype=np.int64)
    kind[:, col.FIRST_SPHERE] = first
    kind[:-1, col.MATERIAL] = spheres.material[spheres.offset[order]]
    kind[:-1, col.IS_ASYMMETRIC] = group.bodies.rotor_class[order] == ASYMMETRIC
    kind[:-1, col.IS_ASYMMETRIC] *= body[:, col.BODY_INV_MASS] > 0.0
    near_first, near = _walls_near(walls, grid, float(bound.max()))
    friction = model.law.friction
    return EventScene(
        gravity=three(gravity),
        n_moving=n_moving,
        body=body,
        kind=kind,
        sphere=np.vstack([spheres.arm, spheres.radius]).T[sphere_order].copy(),
        pair_of=model.pair_of,
        rules=np.stack([rules.restitution, friction], axis=1),
        wall_kind=walls.kind,
        wall_parameter=walls.parameter,
        wall_material=model.wall_material[np.isin(model.walls.kind, _SOLID_KINDS)],
        wall_first=near_first,
        wall_near=near,
        contact_time=rules.contact_time,
        period=_period(state.p * group.bodies.inv_mass, gravity, float(grid.width.max())),
        around=flag(bool(reach.any() or (gravity.any() and n_moving < order.size))),
        turns=flag(bool(kind[:, col.IS_ASYMMETRIC].any())),
        rubs=flag(bool(reach.any() or friction.any())),
        box=_box(rules.box),
        cell_width=three(grid.width),
        origin=three(grid.origin),
        cells=(int(grid.cells[0]), int(grid.cells[1]), int(grid.cells[2])),
    )


def three(values: Floats) -> Vec3:
    """Three numbers as a tuple."""
    return float(values[0]), float(values[1]), float(values[2])


def _box(box: Floats) -> tuple[Vec3, Vec3] | None:
    """Sides of a periodic box and their inverses; 0 where it has no end."""
    if np.isinf(box).all():
        return None
    return three(np.where(np.isinf(box), 0.0, box)), three(1.0 / box)


def _solid(group: SegmentGroup) -> Walls:
    """Primitives with a surface."""
    walls = group.terms.known_contact.model.walls
    solid = np.isin(walls.kind, _SOLID_KINDS)
    parameter = np.ascontiguousarray(walls.parameter[solid])
    return walls._replace(kind=walls.kind[solid], parameter=parameter)


def _constants(group: SegmentGroup, reach: Floats) -> Floats:
    """`EventScene.body` in the order of the group."""
    bodies = group.bodies
    body = np.zeros((reach.size, col.N_BODY))
    body[:, col.BODY_MASS] = bodies.mass
    body[:, col.BODY_INV_MASS] = bodies.inv_mass
    body[:, col.BODY_REACH] = reach
    body[:, col.BODY_INERTIA : col.BODY_INERTIA + 3] = bodies.inertia.T
    body[:, col.BODY_INV_INERTIA : col.BODY_INV_INERTIA + 3] = bodies.inv_inertia.T
    body[:, col.BODY_CURVED] = _bends(bodies.inertia.T, bodies.inv_inertia.T)
    return body


def _walls_near(walls: Walls, grid: _Grid, bound: float) -> tuple[Indices, Indices]:
    """Primitives that a body in a cell may touch, cell by cell, and all; see `EventScene`.

    That is by planes through them, and by distances from the axis of a tube.
    """
    numbers = np.indices(tuple(grid.cells)).reshape(3, -1)
    middle = grid.origin[:, None] + grid.width[:, None] * (numbers + 0.5)
    far = _WIDTH_MARGIN * (0.5 * float(np.linalg.norm(grid.width)) + bound)
    near = np.ones((walls.kind.size, middle.shape[1] + 1), dtype=bool)
    for p, (kind, row) in enumerate(zip(walls.kind.tolist(), walls.parameter, strict=True)):
        along = row[9:12] if kind == FACE else row[3:6]
        d = middle - row[:3, None]
        away = np.abs(along @ d)
        if kind == PLANE:
            away = along @ d
        elif kind == SIDE:
            away = np.abs(np.linalg.norm(d - np.outer(along, along @ d), axis=0) - row[6])
        near[p, :-1] = away <= far
    first = np.concatenate([[0], np.cumsum(near.sum(axis=0))])
    return first.astype(np.int32), np.nonzero(near.T)[1].astype(np.int32)


def _period(velocity: Floats, gravity: Floats, width: float) -> float:
    """A power of two near the time [s] in which the fastest body, or one that falls, passes cells.

    Subtracted from a later time it leaves no error. Where nothing moves it has no end.
    """
    g = float(np.linalg.norm(gravity))
    speed = max(float(np.linalg.norm(velocity, axis=0).max()), np.sqrt(g * width))
    return float(2.0 ** np.rint(np.log2(_CELLS * width / speed))) if speed > 0.0 else 2.0**1000


def _bends(inertia: Floats, inverse: Floats) -> Floats:
    """1 + max |I_j - I_k|/I_i /√3 of each body: see `flight.set_spin`."""
    pairs = np.abs(inertia[:, [1, 0, 0]] - inertia[:, [2, 2, 1]])
    rods = inertia[:, 2] == 0.0
    ratio = np.where(rods[:, None], 0.0, pairs * inverse)
    return np.asarray(1.0 + ratio.max(axis=1) / np.sqrt(3.0))
