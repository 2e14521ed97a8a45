"""A watch on the lists of contacts: a contact has to act wherever two overlap.

Some bodies are compared with all others and with all walls, without cells and lists. Two that
overlap by more than they come nearer in two steps overlapped at the last evaluation of the forces
too: then a contact must have acted. It takes a small share of the time, by counts of what is done
and never by the clock, so that a run is watched at the same steps wherever it runs.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.contact_model import ContactModel, ContactSpheres, NeighbourLists
from particlerb.contact.records import Records
from particlerb.contact.sphere_search import KEY_BITS
from particlerb.contact.wall_motion import PrescribedMotion, wall_displacement
from particlerb.contact.walls import gap_and_velocity, in_frame_of, primitive_at, squared_distance
from particlerb.maths.rows import column3, row3, rows3
from particlerb.maths.vec3 import Bools, Floats, Ints, dot, norm, subtract

_BODIES_PER_LOOK: Final = 256
MAX_SHARE: Final = 0.01  # of the time, that looking may take
_NS_PER_LOOK: Final = 2e5  # roughly, without comparisons
_NS_PER_PAIR: Final = 3.5  # of bodies or spheres that are compared
_NS_PER_WALL_PAIR: Final = 30.0  # of a body and a primitive of a wall that are compared
_STEPS: Final = 2.0  # in which two may have come to overlap since the last evaluation
_MIN_OVERLAP: Final = 1e-3  # in the smaller radius: less is none yet


class WatchedBodies(NamedTuple):
    """Where bodies are, and how fast they may come."""

    xyzr: Floats  # (n_spheres, 4) [m] centre and radius
    com: Floats  # (3, n) [m]
    velocity: Floats  # (3, n) [m/s]
    angular_speed: Floats  # (n,) [rad/s]
    bounding_radius: Floats  # (n,) [m] from the centre of mass to the farthest surface of a sphere
    extra_speed: Floats  # (n,) [m/s] by which it may have been faster within the last steps
    is_left_out: Bools  # (n,) bodies that are not watched among each other, nor with walls


class Missed(NamedTuple):
    """The deepest overlap at which nothing acts."""

    depth: float  # [m] 0 where there is none
    body: int
    other: int  # body, or ~w for wall w
    compared: int  # pairs of spheres that were compared


@inline
def _is_apart(spheres: ContactSpheres, a: int, b: int) -> bool:
    """Whether two bodies do not touch each other."""
    is_apart = False
    for key in spheres.excluded:
        is_apart = is_apart or key == min(a, b) << KEY_BITS | max(a, b)
    return is_apart


@inline
def _has_contact(spheres: ContactSpheres, lists: NeighbourLists, i: int, j: int) -> bool:
    """Whether a contact acts between two spheres."""
    a, contacts, (offset, entry) = spheres.body[i], lists.spheres, lists.sphere_incidence
    is_active = _is_apart(spheres, a, spheres.body[j])
    for k in range(offset[a], offset[a + 1]):
        c = entry[k]
        c = c if c >= 0 else ~c
        first, second = contacts.sphere[c], contacts.other[c]
        if (first == i and second == j) or (first == j and second == i):
            is_active = is_active or contacts.active[c]
    return is_active


@inline
def _has_wall_contact(model: ContactModel, lists: NeighbourLists, i: int, p: int) -> bool:
    """Whether primitive p is in the list of sphere i, and one of its wall acts."""
    contacts, (offset, entry) = lists.walls, lists.wall_incidence
    a, wall = model.spheres.body[i], model.walls.wall
    is_listed, is_active = False, False
    for k in range(offset[a], offset[a + 1]):
        c = entry[k]
        if contacts.sphere[c] == i:
            is_listed = is_listed or contacts.other[c] == p
            is_active = is_active or (contacts.active[c] and wall[contacts.other[c]] == wall[p])
    return is_listed and is_active


@kernel
def _missed_pairs(
    model: ContactModel,
    lists: NeighbourLists,
    bodies: WatchedBodies,
    dt: float,
    indices: Ints,
    worst: Missed,
) -> Missed:
    """Compare the spheres of some bodies with those of all others."""
    spheres, (xyzr, com, velocity, turning, bound, extra, is_left_out) = model.spheres, bodies
    n, offset = bound.size, spheres.offset
    x, v = rows3(com, 0, n), rows3(velocity, 0, n)
    depth, body, other, compared = worst
    for b in range(n):
        x_b = column3(x, b)
        for a in indices:
            apart = subtract(column3(x, a), x_b)
            most = bound[a] + bound[b]
            is_other = a == b or spheres.world[a] != spheres.world[b]
            is_other = is_other or (is_left_out[a] and is_left_out[b])
            if dot(apart, apart) >= most * most or is_other:
                continue
            comes = norm(subtract(column3(v, a), column3(v, b))) + extra[a] + extra[b]
            comes += bound[a] * turning[a] + bound[b] * turning[b]
            for i in range(offset[a], offset[a + 1]):
                x_i = row3(xyzr, i)
                compared += 1
                if norm(subtract(x_i, x_b)) >= bound[b] + xyzr[i, 3]:
                    continue
                for j in range(offset[b], offset[b + 1]):
                    compared += 1
                    overlap = xyzr[i, 3] + xyzr[j, 3] - norm(subtract(row3(xyzr, j), x_i))
                    least = _MIN_OVERLAP * min(xyzr[i, 3], xyzr[j, 3]) + _STEPS * dt * comes
                    if overlap > max(least, depth) and not _has_contact(spheres, lists, i, j):
                        depth, body, other = overlap, min(a, b), max(a, b)
    return Missed(depth, body, other, compared)


@kernel
def _missed_walls(
    model: ContactModel,
    lists: NeighbourLists,
    bodies: WatchedBodies,
    poses: Records,
    extra_speeds: Floats,
    dt: float,
    indices: Ints,
    worst: Missed,
) -> Missed:
    """Compare the spheres of some bodies with all walls; `extra_speeds` (n_walls,) of these."""
    spheres, walls = model.spheres, model.walls
    xyzr, com, velocity, turning, bound, extra, is_left_out = bodies
    n, offset = bound.size, spheres.offset
    x, v = rows3(com, 0, n), rows3(velocity, 0, n)
    depth, body, other, compared = worst
    for a in indices:
        if is_left_out[a]:
            continue
        x_a, v_a = column3(x, a), column3(v, a)
        for p in range(walls.kind.size):
            w = walls.wall[p]
            primitive = primitive_at(walls.kind, walls.parameter, p)
            if squared_distance(primitive, in_frame_of(poses, w, x_a)) >= bound[a] * bound[a]:
                continue
            for i in range(offset[a], offset[a + 1]):
                compared += 1
                x_i, radius = row3(xyzr, i), xyzr[i, 3]
                gap, moving = gap_and_velocity(walls, poses, p, x_i)
                comes = norm(subtract(v_a, moving)) + extra[a] + extra_speeds[w]
                comes += bound[a] * turning[a]
                least, overlap = _MIN_OVERLAP * radius + _STEPS * dt * comes, radius - norm(gap)
                if overlap > max(least, depth) and not _has_wall_contact(model, lists, i, p):
                    depth, body, other = overlap, a, ~w
    return Missed(depth, body, other, compared)


class Watch:
    """Looks now and then whether contacts act wherever bodies overlap."""

    def __init__(self) -> None:
        self.credit = 0.0  # [ns] that looking may take
        self.price = 0.0  # [ns] of the last look; 0 before the first
        self.next = 0  # body

    def saved(self) -> Floats:
        """For a checkpoint."""
        return np.array([self.credit, self.price, self.next])

    def restore(self, saved: Floats) -> None:
        """Go on from what was saved."""
        self.credit, self.price = float(saved[0]), float(saved[1])
        self.next = int(saved[2])

    def is_due(self, n: int, n_primitives: int, work: float) -> bool:
        """Whether to look now, after so much more work [ns]."""
        self.credit += MAX_SHARE * work
        return self.credit >= max(self.price, price_of(n, n_primitives, 0))

    def look(
        self,
        model: ContactModel,
        lists: NeighbourLists,
        bodies: WatchedBodies,
        poses: Records,
        extra_speeds: Floats,
        dt: float,
    ) -> Missed:
        """The deepest overlap of the bodies whose turn it is at which nothing acts."""
        n, n_primitives = bodies.bounding_radius.size, model.walls.kind.size
        indices = (self.next + np.arange(min(n, _BODIES_PER_LOOK))) % n
        self.next = (self.next + indices.size) % n
        missed = _missed_pairs(model, lists, bodies, dt, indices, Missed(0.0, 0, 0, 0))
        missed = _missed_walls(model, lists, bodies, poses, extra_speeds, dt, indices, missed)
        self.price = price_of(n, n_primitives, missed.compared)
        self.credit -= self.price
        return missed


def price_of(n: int, n_primitives: int, compared: int) -> float:
    """Time of a look [ns], roughly."""
    each = _NS_PER_PAIR * n + _NS_PER_WALL_PAIR * n_primitives
    return _NS_PER_LOOK + min(n, _BODIES_PER_LOOK) * each + _NS_PER_PAIR * compared


def bounding_radii(spheres: ContactSpheres, n: int) -> Floats:
    """From the centre of mass of each body to the surface of its farthest sphere, (n,) [m]."""
    bounding_radius = np.zeros(n)
    radius = np.sqrt((spheres.arm**2).sum(axis=0)) + spheres.radius
    np.maximum.at(bounding_radius, spheres.body, radius)
    return bounding_radius


def peak_speed(motion: PrescribedMotion, dt: float) -> float:
    """Speed [m/s] that what moves as prescribed may have had in a step without turning."""
    return wall_displacement([motion], dt, [0.0]) / dt


def all_inactive(lists: NeighbourLists) -> NeighbourLists:
    """The same lists, with no contact that acts."""
    spheres, walls = (
        contacts._replace(active=np.zeros_like(contacts.active))
        for contacts in (lists.spheres, lists.walls)
    )
    return lists._replace(spheres=spheres, walls=walls)
