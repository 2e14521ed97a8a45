"""Pieces of a wall within a sphere: which points form one, its force, and whose history it takes.

Needed where more than one point counts, or where a history has to go to another contact: see
`wall_contacts`.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.contact.contact_model import ContactList, Evaluation, Workspace
from particlerb.contact.law import (
    ContactState,
    correction_time,
    normal_force,
    normal_spring,
    overlap_of,
)
from particlerb.contact.pair_force import end_contact, velocity_at
from particlerb.contact.walls import (
    NEAR,
    euler_count,
    gap_vector,
    nearest,
    primitive_at,
    wall_velocity,
)
from particlerb.maths.quaternion import Quat, to_world
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Vec3, add_scaled, dot, norm, scale, subtract

_HANDLED_PIECE: Final = -1.0  # of points that have been dealt with
_MIN_RING_SHARE: Final = 0.25  # of its hardest part, that a ring has to press with


class SphereAtWall(NamedTuple):
    """A sphere and a wall near to each other; their contacts stand together in the list."""

    first: int
    end: int
    x: Vec3  # [m] centre, world frame
    y: Vec3  # [m] centre, frame of the wall
    q: Quat  # of the wall
    radius: float  # [m]
    body: int
    wall: int
    displacement: float  # [m] of a point of the sphere along the wall in a step, at most


class WallPiece(NamedTuple):
    """A piece of a wall as one contact."""

    nearest: int  # contact of its nearest point
    points: int  # that count
    gap: Vec3  # [m] to the centre of the sphere, along its force, world axes
    elastic: Vec3  # [N] mean force of its springs over a kick, if more than one point counts
    correction_impulse: Vec3  # [N s] these times their `law.correction_time`
    energy: float  # [J] of its springs
    overlap: float  # [m] of its nearest point
    is_too_weak: bool  # whether it is a ring that presses too little


@inline
def point_in_reach(on: Evaluation, at: SphereAtWall, c: int) -> tuple[int, bool, Vec3]:
    """`euler_count` of the primitive of contact c, 0 out of reach; and the gap, wall's frame."""
    walls = on.model.walls
    primitive = primitive_at(walls.kind, walls.parameter, on.contacts.other[c])
    away, reach = gap_vector(primitive, at.y), at.radius + 0.5 * at.displacement
    if dot(away, away) >= reach * reach:
        return 0, False, away
    count, is_nearest = euler_count(primitive, walls.around, at.y)
    return count, is_nearest, away


@inline
def write_points(on: Evaluation, at: SphereAtWall) -> None:
    """Write the points that count, each as a piece of its own."""
    forces = on.contacts.forces
    for c in range(at.first, at.end):
        count, is_nearest, away = point_in_reach(on, at, c)
        forces.count[c], forces.is_nearest[c] = count, 1.0 if is_nearest else 0.0
        forces.piece[c] = c
        put_row3(forces.gap, c, to_world(at.q, away))


@inline
def _outside_cap(
    contacts: ContactList, at: SphereAtWall, c: int, away: Vec3, slack: float
) -> float:
    """How far a point of the wall is outside of the cap around the nearest point of contact c [m].

    The cap is what the sphere cuts out of the plane there; negative inside.
    """
    gap = row3(contacts.forces.gap, c)
    d = subtract(gap, away)
    cap = max(at.radius * at.radius - dot(gap, gap), 0.0)
    return norm(d) - math.sqrt(cap) - slack


@inline
def join_pieces(contacts: ContactList, at: SphereAtWall) -> None:
    """Write of which piece each point is: what counts beside the nearest joins those around it."""
    forces, changes = contacts.forces, 1
    while changes > 0:
        changes = 0
        for e in range(at.first, at.end):
            if forces.count[e] == 0.0 or forces.is_nearest[e] > 0.0:
                continue
            away, least, best = row3(forces.gap, e), float(at.end), math.inf
            for c in range(at.first, at.end):
                if forces.is_nearest[c] > 0.0:
                    out = max(_outside_cap(contacts, at, c, away, 0.0), 0.0)
                    if out < best or (out == best and forces.piece[c] < least):
                        least, best = forces.piece[c], out
            forces.piece[e] = least
            for c in range(at.first, at.end):
                is_other = forces.is_nearest[c] > 0.0 and forces.piece[c] != least
                if is_other and _outside_cap(contacts, at, c, away, 0.0) <= 0.0:
                    forces.piece[c] = least
                    changes += 1


@inline
def next_piece(contacts: ContactList, at: SphereAtWall) -> int:
    """First contact of a piece that is not dealt with; -1: there is none."""
    for c in range(at.first, at.end):
        if contacts.forces.is_nearest[c] > 0.0 and contacts.forces.piece[c] == c:
            return c
    return -1


@inline
def approach_velocity(workspace: Workspace, at: SphereAtWall) -> Vec3:
    """Velocity of the centre of a sphere relative to the wall there [m/s]."""
    d = subtract(at.x, row3(workspace.poses.position, at.wall))
    moving = wall_velocity(workspace.poses, at.wall, d)
    return subtract(velocity_at(workspace.bodies, at.body, at.x), moving)


@inline
def piece_at(on: Evaluation, at: SphereAtWall, root: int) -> WallPiece:
    """The piece that begins with a contact, its points summed.

    Of each the mean force over the kick is taken along its own δ + δ̇ t, as of a contact.
    """
    model, contacts, before, after = on.model, on.contacts, on.before, on.after
    points, law, radius = contacts.forces, model.law, at.radius
    material = model.spheres.material[contacts.sphere[root]]
    pair = model.pair_of[material, model.wall_material[contacts.other[root]]]
    first, n_points, total, pushes, hardest = root, 0, 0.0, 0.0, 0.0
    v, force, elastic, impulse = approach_velocity(on.workspace, at), ZERO, ZERO, ZERO
    energy, least = 0.0, math.inf
    for c in range(at.first, at.end):
        count, away = points.count[c], row3(points.gap, c)
        if count == 0.0 or points.piece[c] != root:
            continue
        distance = max(norm(away), NEAR)
        normal, overlap = scale(-1.0 / distance, away), radius - distance
        push, stored = normal_spring(law, pair, overlap, radius)
        force = add_scaled(count * push, normal, force)
        state = ContactState(overlap, 0.0, dot(v, normal), ZERO, 1.0, 0.0, radius)
        mean = normal_force(law, pair, state, before, after)
        elastic = add_scaled(-count * mean.elastic, normal, elastic)
        time = correction_time(mean, state, before, after)
        impulse = add_scaled(-count * mean.elastic * time, normal, impulse)
        n_points, total, pushes = n_points + 1, total + count, pushes + count * push
        energy, hardest = energy + count * stored, max(hardest, push)
        if points.is_nearest[c] > 0.0 and distance < least:
            first, least = c, distance
    size, gap = norm(elastic), row3(points.gap, first)
    if n_points > 1 and size > 0.0:
        overlap = overlap_of(law, pair, norm(force), radius)
        gap = scale(max(radius - overlap, NEAR) / size, elastic)
    is_too_weak = total <= 0.0 and pushes < _MIN_RING_SHARE * hardest
    return WallPiece(first, n_points, gap, elastic, impulse, energy, radius - least, is_too_weak)


@inline
def hand_over_history(on: Evaluation, at: SphereAtWall, root: int, to: int) -> None:
    """Hand the history of a piece, of its points or of what was one of them, to a contact of it.

    The piece counts as dealt with then.
    """
    contacts = on.contacts
    history, active, pieces = contacts.history, contacts.active, contacts.forces.piece
    source = -1
    for c in range(at.first, at.end):
        is_one = active[c] and _belongs_to(on, at, c, root)
        if is_one and (source < 0 or history.normal_force[c] > history.normal_force[source]):
            source = c
    if source >= 0 and source != to:
        history[to] = history[source]
        if contacts.stages is not None:
            contacts.stages[to] = contacts.stages[source]
        active[to] = True
    for c in range(at.first, at.end):
        if c != to and active[c] and _belongs_to(on, at, c, root):
            end_contact(on, c)
    for c in range(at.first, at.end):
        if pieces[c] == root:
            pieces[c] = _HANDLED_PIECE


@inline
def _belongs_to(on: Evaluation, at: SphereAtWall, c: int, root: int) -> bool:
    """Whether contact c is of a piece, or has been where the piece is now."""
    contacts, points, walls = on.contacts, on.contacts.forces, on.model.walls
    if points.count[c] != 0.0:
        return bool(points.piece[c] == root)
    primitive = primitive_at(walls.kind, walls.parameter, contacts.other[c])
    away, belongs = to_world(at.q, subtract(at.y, nearest(primitive, at.y))), False
    for m in range(at.first, at.end):
        if points.is_nearest[m] > 0.0 and points.piece[m] == root:
            belongs = belongs or _outside_cap(contacts, at, m, away, at.displacement) <= 0.0
    return belongs


@inline
def end_leftovers(on: Evaluation, at: SphereAtWall) -> None:
    """End contacts whose points have ended, and have handed on nothing."""
    contacts = on.contacts
    for c in range(at.first, at.end):
        if contacts.active[c] and contacts.forces.piece[c] >= 0.0:
            end_contact(on, c)
