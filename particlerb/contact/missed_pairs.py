"""A watch on the lists of contacts: a contact has to act wherever two overlap.

Some bodies are compared with all others and with all walls, without cells and lists. Two that
overlap by more than they come nearer in two steps overlapped at the last evaluation of the forces
too: then a contact must have acted. It takes a small share of the time, by counts of what is done
and never by the clock, so that a run is watched at the same steps wherever it runs.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.pair_force import ContactList, ContactModel, ContactSpheres, NeighbourLists
from particlerb.contact.wall_motion import PrescribedMotion, wall_displacement
from particlerb.contact.wall_search import primitive, squared_distance
from particlerb.contact.walls import touch
from particlerb.maths.quaternion import to_body
from particlerb.maths.vec3 import (
    Bools,
    Floats,
    Ints,
    Vec3,
    dot,
    load3,
    rows3,
    subtract,
)

BODIES: Final = 256  # that are looked at in one go
SHARE: Final = 0.01  # of the time that looking may take
TO_LOOK: Final = 2e5  # ns of a look, roughly,
TO_COMPARE: Final = 3.5  # of two bodies, or two spheres,
TO_COMPARE_WALL: Final = 30.0  # and of a body with a primitive of a wall
STEPS: Final = 2.0  # in which two may have come to overlap since the last evaluation
SLIGHT: Final = 1e-3  # overlap, in the smaller radius, that is none yet


class WatchedBodies(NamedTuple):
    """Where bodies are, and how fast they may come."""

    place: Floats  # (n_spheres, 4) [m] centre and radius
    com: Floats  # (3, n) [m]
    velocity: Floats  # (3, n) [m/s]
    turning: Floats  # (n,) |angular velocity| [rad/s]
    bound: Floats  # (n,) [m] from the centre of mass to the surface of the farthest sphere
    swing: Floats  # (n,) [m/s] by which it may have been faster within the last steps
    is_left_out: Bools  # (n,) bodies that are not watched among each other, nor with walls


class Missed(NamedTuple):
    """The deepest overlap at which nothing acts."""

    depth: float  # [m] 0 where there is none
    body: int
    other: int  # body, or ~w for wall w
    compared: int  # pairs of spheres that were compared


@inline
def is_active_pair(spheres: ContactSpheres, lists: NeighbourLists, i: int, j: int) -> bool:
    """Whether a contact acts between two spheres."""
    a, contacts, (offset, entry) = spheres.body[i], lists.spheres, lists.of_spheres
    found = False
    for k in range(offset[a], offset[a + 1]):
        c = entry[k]
        c = c if c >= 0 else ~c
        one, two = contacts.first[c], contacts.second[c]
        if (one == i and two == j) or (one == j and two == i):
            found = found or contacts.active[c]
    return found


@inline
def is_active_on_wall(scene: ContactModel, lists: NeighbourLists, i: int, p: int) -> bool:
    """Whether primitive p is in the list of sphere i, and one of its wall acts."""
    contacts: ContactList = lists.walls
    a, wall, (offset, entry) = scene.spheres.body[i], scene.walls.wall, lists.of_walls
    is_listed, is_active = False, False
    for k in range(offset[a], offset[a + 1]):
        c = entry[k]
        if contacts.first[c] == i:
            is_listed = is_listed or contacts.second[c] == p
            is_active = is_active or (contacts.active[c] and wall[contacts.second[c]] == wall[p])
    return is_listed and is_active


@inline
def length(v: Vec3) -> float:
    """|v|."""
    return float(np.sqrt(dot(v, v)))


@kernel
def missed_pairs(
    scene: ContactModel,
    lists: NeighbourLists,
    bodies: WatchedBodies,
    dt: float,
    which: Ints,
    worst: Missed,
) -> Missed:
    """Compare the spheres of some bodies with those of all others."""
    spheres, (place, com, velocity, turning, bound, swing, is_left_out) = scene.spheres, bodies
    n, offset = bound.size, spheres.offset
    x, v = rows3(com, 0, n), rows3(velocity, 0, n)
    depth, body, other, compared = worst
    for b in range(n):
        x_b = load3(x, b)
        for a in which:
            apart = subtract(load3(x, a), x_b)
            most = bound[a] + bound[b]
            if dot(apart, apart) >= most * most or a == b or (is_left_out[a] and is_left_out[b]):
                continue
            comes = length(subtract(load3(v, a), load3(v, b))) + swing[a] + swing[b]
            comes += bound[a] * turning[a] + bound[b] * turning[b]
            for i in range(offset[a], offset[a + 1]):
                x_i = (place[i, 0], place[i, 1], place[i, 2])
                compared += 1
                if length(subtract(x_i, x_b)) >= bound[b] + place[i, 3]:
                    continue
                for j in range(offset[b], offset[b + 1]):
                    compared += 1
                    d = subtract((place[j, 0], place[j, 1], place[j, 2]), x_i)
                    delta = place[i, 3] + place[j, 3] - length(d)
                    least = SLIGHT * min(place[i, 3], place[j, 3]) + STEPS * dt * comes
                    if delta > max(least, depth) and not is_active_pair(spheres, lists, i, j):
                        depth, body, other = delta, min(a, b), max(a, b)
    return Missed(depth, body, other, compared)


@kernel
def missed_walls(
    scene: ContactModel,
    lists: NeighbourLists,
    bodies: WatchedBodies,
    poses: Floats,
    swings: Floats,
    dt: float,
    which: Ints,
    worst: Missed,
) -> Missed:
    """Compare the spheres of some bodies with all walls; `swings` as that of bodies, (n_walls,)."""
    spheres, walls = scene.spheres, scene.walls
    place, com, velocity, turning, bound, swing, is_left_out = bodies
    n, offset = bound.size, spheres.offset
    x, v = rows3(com, 0, n), rows3(velocity, 0, n)
    depth, body, other, compared = worst
    for a in which:
        if is_left_out[a]:
            continue
        x_a, v_a = load3(x, a), load3(v, a)
        for p in range(walls.kind.size):
            w = walls.wall[p]
            X = (poses[w, 0], poses[w, 1], poses[w, 2])
            q = (poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6])
            one = primitive(walls.kind, walls.parameter, p)
            if squared_distance(one, to_body(q, subtract(x_a, X))) >= bound[a] * bound[a]:
                continue
            for i in range(offset[a], offset[a + 1]):
                compared += 1
                x_i, radius = (place[i, 0], place[i, 1], place[i, 2]), place[i, 3]
                gap, moving = touch(walls, poses, p, x_i)
                comes = length(subtract(v_a, moving)) + swing[a] + swings[w]
                comes += bound[a] * turning[a]
                least, delta = SLIGHT * radius + STEPS * dt * comes, radius - length(gap)
                if delta > max(least, depth) and not is_active_on_wall(scene, lists, i, p):
                    depth, body, other = delta, a, ~w
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
        self.credit += SHARE * work
        return self.credit >= max(self.price, price_of(n, n_primitives, 0))

    def look(
        self,
        scene: ContactModel,
        lists: NeighbourLists,
        bodies: WatchedBodies,
        poses: Floats,
        swings: Floats,
        dt: float,
    ) -> Missed:
        """The deepest overlap of the bodies whose turn it is at which nothing acts."""
        n, n_primitives = bodies.bound.size, scene.walls.kind.size
        which = (self.next + np.arange(min(n, BODIES))) % n
        self.next = (self.next + which.size) % n
        missed = missed_pairs(scene, lists, bodies, dt, which, Missed(0.0, 0, 0, 0))
        missed = missed_walls(scene, lists, bodies, poses, swings, dt, which, missed)
        self.price = price_of(n, n_primitives, missed.compared)
        self.credit -= self.price
        return missed


def price_of(n: int, n_primitives: int, compared: int) -> float:
    """Time of a look [ns], roughly."""
    each = TO_COMPARE * n + TO_COMPARE_WALL * n_primitives
    return TO_LOOK + min(n, BODIES) * each + TO_COMPARE * compared


def bounding_radii(spheres: ContactSpheres, n: int) -> Floats:
    """From the centre of mass of each body to the surface of its farthest sphere, (n,) [m]."""
    bound = np.zeros(n)
    far = np.sqrt((spheres.arm**2).sum(axis=0)) + spheres.radius
    np.maximum.at(bound, spheres.body, far)
    return bound


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
