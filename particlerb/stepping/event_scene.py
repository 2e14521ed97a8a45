"""What collisions by events work on, from a group of bodies: their order, cells, walls."""

from typing import Final

import numpy as np

from particlerb.contact.contact_model import GroupContact
from particlerb.contact.walls import DISC, FACE, PLANE, SIDE, Walls
from particlerb.events.records import EventScene
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import State
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.motion import SegmentGroup

_ROUNDING: Final = 1e-15  # of a radius: a centre nearer to the centre of mass is there
_WIDER: Final = 1.0 + 1e-9
_CELLS: Final = 8.0  # that are passed until times are counted anew
_MOST_CELLS: Final = 4  # for each body, roughly
_SOLID: Final = (PLANE, FACE, SIDE, DISC)  # edges, vertices and rims are of these


def _contact_of(group: SegmentGroup) -> GroupContact:
    """Contact of a group that has it."""
    assert group.terms.contact is not None
    return group.terms.contact


def bounds_of(group: SegmentGroup) -> tuple[Floats, Floats]:
    """Of each body (n,): farthest centre of a sphere, farthest point [m]; 0: a ball."""
    spheres, n = _contact_of(group).model.spheres, group.members.size
    distance = np.sqrt((spheres.arm**2).sum(axis=0))
    reach, bound = np.zeros(n), np.zeros(n)
    np.maximum.at(reach, spheres.body, distance)
    np.maximum.at(bound, spheres.body, distance + spheres.radius)
    is_ball = (np.diff(spheres.offset) == 1) & (reach <= _ROUNDING * bound)
    return np.where(is_ball, 0.0, np.maximum(reach, np.finfo(float).tiny)), bound


def _points_of(walls: Walls) -> Floats:
    """Points that finite walls reach to, (3, m) [m]."""
    found = [np.zeros((3, 0))]
    for kind, row in zip(walls.kind.tolist(), walls.parameter, strict=True):
        if kind == FACE:
            found.append(row[:9].reshape(3, 3).T)
        elif kind == SIDE:
            found += [row[:3, None] + s * (row[7] + row[6]) for s in (-1.0, 1.0)]
    return np.concatenate(found, axis=1)


def _grid(group: SegmentGroup, com: Floats) -> tuple[float, Floats, Ints]:
    """Width of cells [m], corner of the first, and how many along each axis."""
    contact = _contact_of(group)
    bound = bounds_of(group)[1]
    points = np.concatenate([com, _points_of(contact.model.walls)], axis=1)
    low, high = points.min(axis=1), points.max(axis=1)
    least = 2.0 * _WIDER * float(bound.max())
    size = np.maximum(high - low, least)
    width = max(least, float((size.prod() / bound.size) ** (1.0 / 3.0)))
    count = np.maximum(np.ceil(size / width).astype(np.int64), 3)
    while count.prod() > _MOST_CELLS * bound.size + 27:
        count = np.maximum(count // 2, 3)
        if (count == 3).all():
            break
    return width, low - 0.5 * width, count


def order_of(group: SegmentGroup, state: State) -> tuple[Ints, int]:
    """Bodies in the order of their cells, those that are held last; how many move."""
    width, origin, count = _grid(group, state.com)
    cell = np.floor((state.com - origin[:, None]) / width).astype(np.int64) % count[:, None]
    number = (cell[0] * count[1] + cell[1]) * count[2] + cell[2]
    is_held = group.bodies.inv_mass == 0.0
    order = np.lexsort((np.arange(number.size), number, is_held))
    return order, int((~is_held).sum())


def scene_of(group: SegmentGroup, state: State, order: Ints, n_moving: int) -> EventScene:
    """Constants of a group, its bodies in an order."""
    contact, bodies = _contact_of(group), group.bodies
    model, spheres, rules = contact.model, contact.model.spheres, contact.events
    assert rules is not None
    reach, _ = bounds_of(group)
    width, origin, cells = _grid(group, state.com)
    sizes = np.diff(spheres.offset)[order]
    first = np.concatenate([[0], np.cumsum(sizes)])
    which = np.repeat(spheres.offset[order] - first[:-1], sizes) + np.arange(first[-1])
    walls = model.walls
    solid = np.isin(walls.kind, _SOLID)
    gravity = np.zeros(3)
    if group.terms.gravity is not None:
        gravity = group.terms.gravity.acceleration.copy()
    inertia = np.ascontiguousarray(bodies.inertia[:, order].T)
    inverse = np.ascontiguousarray(bodies.inv_inertia[:, order].T)
    return EventScene(
        gravity=gravity,
        n_moving=n_moving,
        mass=bodies.mass[order],
        inv_mass=bodies.inv_mass[order],
        inertia=inertia,
        inv_inertia=inverse,
        is_asymmetric=(bodies.rotor_class[order] == ASYMMETRIC) & (bodies.inv_mass[order] > 0.0),
        bend=_bends(inertia, inverse),
        reach=reach[order],
        first=first,
        arm=np.ascontiguousarray(spheres.arm[:, which].T),
        radius=spheres.radius[which],
        material=spheres.material[spheres.offset[order]],
        pair_of=model.pair_of,
        restitution=rules.restitution,
        friction=model.law.friction,
        wall_kind=walls.kind[solid],
        wall_parameter=np.ascontiguousarray(walls.parameter[solid]),
        wall_material=model.wall_material[solid],
        contact_time=rules.contact_time,
        period=_period(state.p * bodies.inv_mass, gravity, width),
        looks_around=bool(reach.any() or (gravity.any() and n_moving < order.size)),
        cell_width=width,
        origin=origin,
        cells=cells,
    )


def _period(velocity: Floats, gravity: Floats, width: float) -> float:
    """A power of two near the time [s] in which the fastest body, or one that falls, passes cells.

    Subtracted from a later time it leaves no error.
    """
    g = float(np.linalg.norm(gravity))
    speed = max(float(np.linalg.norm(velocity, axis=0).max()), np.sqrt(g * width))
    return float(2.0 ** np.rint(np.log2(_CELLS * width / speed))) if speed > 0.0 else np.inf


def _bends(inertia: Floats, inverse: Floats) -> Floats:
    """1 + max |I_j - I_k|/I_i /√3 of each body: see `flight.set_spin`."""
    pairs = np.abs(inertia[:, [1, 0, 0]] - inertia[:, [2, 2, 1]])
    rods = inertia[:, 2] == 0.0
    ratio = np.where(rods[:, None], 0.0, pairs * inverse)
    return np.asarray(1.0 + ratio.max(axis=1) / np.sqrt(3.0))
