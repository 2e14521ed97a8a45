"""Contacts of spheres with walls: one for each connected piece of a wall within a sphere.

A sphere of radius r around x that reaches a wall holds a part of it, which may fall into pieces:
two in the corner of a box, one on a plane or over a ridge, however it is cut into triangles. Each
piece is one contact. Its elastic energy is

    U(x) = Σ c f(r - d)              d distance of x to a point that counts, c as `count_of` says

with f of the law. Over faces, edges and vertices this is ∫ f'(r - ρ) χ(ρ) dρ, where χ is the Euler
characteristic of what a sphere of radius ρ around x holds: for a convex part of the wall f of its
distance alone, and, as a sum over convex parts with signs, differentiable wherever x is not on the
wall itself. In a valley two faces count; as soon as the sphere reaches the edge between them, that
takes off what they have in common, and has taken off all of a face where this ends to count. So
energy is conserved over edges, seams and vertices at any angle, and a surface that is cut more
finely does not become stiffer.

The force of a piece is the sum of its parts, all along lines through x; friction, dashpots and the
torque against rolling are those of one contact with that force. What a contact keeps belongs to the
piece: it stands with the point of it that is nearest to x, and goes from primitive to primitive
with it. Where pieces join, what the hardest pressed one keeps stays; where one falls apart, the
part that goes on with it keeps it. A fine ring all around a sphere takes off nearly all of itself
once the sphere reaches its edges: see GIVES_WAY.

Sources: Hadwiger, Vorlesungen über Inhalt, Oberfläche und Isoperimetrie (1957), the Euler
characteristic as a sum over convex parts; Banchoff, American Mathematical Monthly 77, 475 (1970),
how it changes at the vertices of a polyhedron.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.contact.law import Touch, lag, normal_force, normal_spring, overlap_of
from particlerb.contact.pair_force import (
    AT,
    DRIVEN,
    ELASTIC,
    LAG,
    PRESSURE,
    SOFTNESS,
    SPEED,
    SPIN,
    STORED,
    TURNING,
    ContactList,
    ContactModel,
    Workspace,
    act,
    begin,
    column,
    forget,
    note_deep,
    put_column,
    softness,
    velocity,
)
from particlerb.contact.walls import NEAR, PLANE, Primitive, away_from, count_of, nearest, row3
from particlerb.maths.quaternion import Quat, to_body, to_world
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, cross, dot, scale, subtract

COUNT: Final = 0  # columns, behind those of what a contact does: how often its point counts,
LOWEST: Final = 1  # whether it is nearer to x than all around it,
PIECE: Final = 2  # the first contact of the piece, DONE where that is dealt with,
AWAY: Final = 3  # vector from it to x [m], world axes; of what acts `loads.LATE`
SPOT: Final = 6
HANDLED: Final = -1.0
DEEPEST: Final = 0.8  # overlap with a thin wall, in radii: beyond 1 it pushes to its other side
GIVES_WAY: Final = 0.25  # share of its hardest part that a ring has to press with


class Meeting(NamedTuple):
    """A sphere and a wall near to each other; their contacts stand together in the list."""

    first: int
    end: int
    x: Vec3  # [m] centre, world frame,
    y: Vec3  # and in the frame of the wall
    q: Quat  # of the wall
    radius: float  # [m]
    body: int
    wall: int
    way: float  # [m] by which a point of the sphere moves along the wall in a step, at most


class Pressed(NamedTuple):
    """A piece of a wall as one contact."""

    lead: int  # contact of its nearest point
    points: int  # that count
    gap: Vec3  # [m] to the centre of the sphere, along its force, world axes
    elastic: Vec3  # [N] mean force of its springs over a kick, if more than one point counts,
    late: Vec3  # [N s] times their lags, see `laws.lag`
    stored: float  # [J] and their energy
    deepest: float  # [m] overlap of its nearest point
    gives_way: bool  # whether it is a ring that presses too little


class Seen(NamedTuple):
    """What a look at the contacts of a sphere and a wall shows."""

    lowest: int  # how many points are nearest among all around them,
    others: int  # and how many more count
    held: int  # how many contacts have acted
    lone: int  # the last with a nearest point,
    away: Vec3  # and the gap there [m], frame of the wall


@lean
def length(v: Vec3) -> float:
    """|v|."""
    return math.sqrt(dot(v, v))


@lean
def one_norm(v: Vec3) -> float:
    """|v₁| + |v₂| + |v₃|: at least the length, and without a root."""
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@lean
def primitive_of(scene: ContactModel, contacts: ContactList, c: int) -> Primitive:
    """Primitive of a contact."""
    kind, rows, _, _ = scene.walls
    p = contacts.second[c]
    a, b, third, n = row3(rows, p, 0), row3(rows, p, 3), row3(rows, p, 6), row3(rows, p, 9)
    return Primitive(kind[p], a, b, third, n)


@lean
def end_of(scene: ContactModel, contacts: ContactList, first: int, most: int) -> int:
    """Where contacts end that are of the same sphere and the same wall as the first."""
    wall, c = scene.walls.wall, first + 1
    own, w = contacts.first[first], wall[contacts.second[first]]
    while c < most and contacts.first[c] == own and wall[contacts.second[c]] == w:
        c += 1
    return c


@lean
def meeting_at(
    scene: ContactModel, room: Workspace, contacts: ContactList, c: int, end: int, longer: float
) -> Meeting:
    """The sphere and the wall of contacts c to end; `longer` is the longer drift around now [s]."""
    place, bodies, poses = room.xyzr, room.bodies, room.poses
    i, w = contacts.first[c], scene.walls.wall[contacts.second[c]]
    a, x, radius = scene.spheres.body[i], column(place, i, 0), place[i, 3]
    d, q = subtract(x, column(poses, w, 0)), (poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6])
    arm = one_norm(subtract(x, column(bodies, a, AT))) + 2.0 * radius
    speed = bodies[a, SPEED] + bodies[a, TURNING] * arm + one_norm(column(poses, w, 7))
    speed += one_norm(column(poses, w, 10)) * (one_norm(d) + 2.0 * radius)
    return Meeting(c, end, x, to_body(q, d), q, radius, a, w, longer * speed)


@lean
def spot_of(one: Primitive, around: Floats, meeting: Meeting) -> tuple[int, bool, Vec3]:
    """How often a primitive counts in reach, whether it is nearest, and the gap, wall's frame."""
    away, reach = away_from(one, meeting.y), meeting.radius + 0.5 * meeting.way
    if dot(away, away) >= reach * reach:
        return 0, False, away
    count, is_lowest = count_of(one, around, meeting.y)
    return count, is_lowest, away


@lean_kernel
def wall_contact_forces(
    scene: ContactModel,
    room: Workspace,
    contacts: ContactList,
    before: float,
    after: float,
    bounds: tuple[int, int, int, int],
    rank: int,
) -> None:
    """Forces of contacts of spheres with walls, whose poses in `room` are those of this instant.

    `bounds` are those of a shell, and between them those of the share of this thread: of spheres
    and walls whose contacts begin there.
    """
    least, c, end, most = bounds
    acts = contacts.active
    if least < c < end:
        c = end_of(scene, contacts, c - 1, end)
    while c < end:
        until = end_of(scene, contacts, c, most)
        meeting = meeting_at(scene, room, contacts, c, until, max(before, after))
        seen = look_around(scene, contacts, meeting)
        c, lone = until, seen.lone
        is_plain = seen.held == 0 or (seen.held == 1 and seen.lowest == 1 and acts[lone])
        if is_plain and seen.others == 0 and seen.lowest <= 1:
            if seen.lowest == 1:
                gap = to_world(meeting.q, seen.away)
                deepest = meeting.radius - length(gap)
                piece = Pressed(lone, 1, gap, gap, gap, 0.0, deepest, False)
                press(scene, room, contacts, meeting, piece, before, after, rank)
            continue
        spread_out(scene, contacts, meeting)
        join(contacts, meeting)
        root = next_piece(contacts, meeting)
        while root >= 0:
            piece = piece_at(scene, room, contacts, meeting, root, before, after)
            inherit(scene, contacts, meeting, root, piece.lead)
            press(scene, room, contacts, meeting, piece, before, after, rank)
            root = next_piece(contacts, meeting)
        forget_rest(contacts, meeting)


@lean
def look_around(scene: ContactModel, contacts: ContactList, meeting: Meeting) -> Seen:
    """What there is around a sphere."""
    lowest, others, held, lone, gap = 0, 0, 0, -1, meeting.y
    for c in range(meeting.first, meeting.end):
        one = primitive_of(scene, contacts, c)
        count, is_lowest, away = spot_of(one, scene.walls.around, meeting)
        if is_lowest:
            lowest, lone, gap = lowest + 1, c, away
        elif count != 0:
            others += 1
        held += 1 if contacts.active[c] else 0
    return Seen(lowest, others, held, lone, gap)


@lean
def press(
    scene: ContactModel,
    room: Workspace,
    contacts: ContactList,
    meeting: Meeting,
    piece: Pressed,
    before: float,
    after: float,
    rank: int,
) -> None:
    """Find the forces of a piece; forget it if it is out of reach."""
    bodies, poses = room.bodies, room.poses
    _, _, x, _, _, radius, a, w, _ = meeting
    lead, points, gap, elastic, late, stored, deepest, gives_way = piece
    distance = length(gap)
    delta = radius - distance
    normal = scale(-1.0 / distance, gap) if distance > 0.0 else (0.0, 0.0, 1.0)
    point = add_scaled(radius - 0.5 * delta, normal, x)
    omega = column(poses, w, 10)
    foot = subtract(subtract(x, column(poses, w, 0)), gap)
    moving = add_scaled(1.0, cross(omega, foot), column(poses, w, 7))
    moving = add_scaled(1.0, cross(omega, add_scaled(1.0, gap, subtract(point, x))), moving)
    relative = subtract(velocity(bodies, a, point), moving)
    turning = subtract(column(bodies, a, SPIN), omega)
    if delta <= -0.5 * max(before, after) * abs(dot(relative, normal)):
        if contacts.active[lead]:
            forget(contacts, lead)
        return
    primitive, law = contacts.second[lead], scene.law
    material = scene.spheres.material[contacts.first[lead]]
    pair = scene.pair_of[material, scene.wall_material[primitive]]
    if contacts.history[lead, SOFTNESS] == 0.0:
        soft = softness(scene, bodies, a, point, normal)
        soft += dot(normal, column(poses, w, 13)) ** 2  # of a piston
        begin(law, pair, contacts, lead, soft, radius)
    if gives_way or (deepest > DEEPEST * radius and scene.walls.kind[primitive] != PLANE):
        note_deep(room, rank, deepest, radius, a)
    act(
        law, pair, contacts, lead, delta, normal, point, relative, turning, moving, radius, before,
        after,
    )  # fmt: skip
    done, beside = contacts.forces, spots_at(contacts) + AWAY
    put_column(done, lead, beside, (0.0, 0.0, 0.0))
    if points > 1:
        put_column(done, lead, ELASTIC, elastic)
        put_column(done, lead, beside, late)
        done[lead, STORED], done[lead, DRIVEN] = stored, dot(elastic, moving)
        done[lead, LAG] = 0.0


# Where more than one point counts, or what was kept has to go elsewhere


@lean
def spots_at(contacts: ContactList) -> int:
    """Where the columns of points begin."""
    at: int = contacts.forces.shape[1] - SPOT
    return at


@lean
def spread_out(scene: ContactModel, contacts: ContactList, meeting: Meeting) -> None:
    """Write the points that count."""
    done, at = contacts.forces, spots_at(contacts)
    for c in range(meeting.first, meeting.end):
        one = primitive_of(scene, contacts, c)
        count, is_lowest, away = spot_of(one, scene.walls.around, meeting)
        done[c, at + COUNT], done[c, at + LOWEST] = count, 1.0 if is_lowest else 0.0
        done[c, at + PIECE] = c
        put_column(done, c, at + AWAY, to_world(meeting.q, away))


@lean
def is_below(contacts: ContactList, meeting: Meeting, c: int, away: Vec3, slack: float) -> float:
    """How far a point of the wall is outside of the cap around the nearest point of contact c [m].

    The cap is what the sphere cuts out of the plane there; negative inside.
    """
    nearer = column(contacts.forces, c, spots_at(contacts) + AWAY)
    d = subtract(nearer, away)
    cap = max(meeting.radius * meeting.radius - dot(nearer, nearer), 0.0)
    return length(d) - math.sqrt(cap) - slack


@lean
def join(contacts: ContactList, meeting: Meeting) -> None:
    """Write of which piece each point is: what counts beside the nearest joins those around it."""
    done, at = contacts.forces, spots_at(contacts)
    first, end, changes = meeting.first, meeting.end, 1
    while changes > 0:
        changes = 0
        for e in range(first, end):
            if done[e, at + COUNT] == 0.0 or done[e, at + LOWEST] > 0.0:
                continue
            away, least, best = column(done, e, at + AWAY), float(end), math.inf
            for c in range(first, end):
                if done[c, at + LOWEST] > 0.0:
                    out = max(is_below(contacts, meeting, c, away, 0.0), 0.0)
                    if out < best or (out == best and done[c, at + PIECE] < least):
                        least, best = done[c, at + PIECE], out
            done[e, at + PIECE] = least
            for c in range(first, end):
                is_other = done[c, at + LOWEST] > 0.0 and done[c, at + PIECE] != least
                if is_other and is_below(contacts, meeting, c, away, 0.0) <= 0.0:
                    done[c, at + PIECE] = least
                    changes += 1


@lean
def next_piece(contacts: ContactList, meeting: Meeting) -> int:
    """First contact of a piece that is not dealt with; -1: there is none."""
    done, at = contacts.forces, spots_at(contacts)
    for c in range(meeting.first, meeting.end):
        if done[c, at + LOWEST] > 0.0 and done[c, at + PIECE] == c:
            return c
    return -1


@lean
def nearing(room: Workspace, meeting: Meeting) -> Vec3:
    """Velocity of the centre of a sphere relative to the wall there [m/s]."""
    poses, w = room.poses, meeting.wall
    d = subtract(meeting.x, column(poses, w, 0))
    moving = add_scaled(1.0, cross(column(poses, w, 10), d), column(poses, w, 7))
    return subtract(velocity(room.bodies, meeting.body, meeting.x), moving)


@lean
def piece_at(
    scene: ContactModel,
    room: Workspace,
    contacts: ContactList,
    meeting: Meeting,
    root: int,
    before: float,
    after: float,
) -> Pressed:
    """The piece that begins with a contact, its points summed.

    Of each the mean force over the kick is taken along its own δ + δ̇ t, as of a contact.
    """
    done, at, law, radius = contacts.forces, spots_at(contacts), scene.law, meeting.radius
    material = scene.spheres.material[contacts.first[root]]
    pair = scene.pair_of[material, scene.wall_material[contacts.second[root]]]
    lead, points, total, pushes, hardest = root, 0, 0.0, 0.0, 0.0
    zero, v = (0.0, 0.0, 0.0), nearing(room, meeting)
    force, elastic, late, stored, least = zero, zero, zero, 0.0, math.inf
    for c in range(meeting.first, meeting.end):
        count, away = done[c, at + COUNT], column(done, c, at + AWAY)
        if count == 0.0 or done[c, at + PIECE] != root:
            continue
        distance = max(length(away), NEAR)
        normal, delta = scale(-1.0 / distance, away), radius - distance
        push, energy = normal_spring(law, pair, delta, radius)
        force = add_scaled(count * push, normal, force)
        touch = Touch(delta, 0.0, dot(v, normal), zero, 1.0, 0.0, radius)
        mean = normal_force(law, pair, touch, before, after)
        elastic = add_scaled(-count * mean.elastic, normal, elastic)
        lagging = -count * mean.elastic * lag(mean, touch, before, after)
        late = add_scaled(lagging, normal, late)
        points, total, pushes = points + 1, total + count, pushes + count * push
        stored, hardest = stored + count * energy, max(hardest, push)
        if done[c, at + LOWEST] > 0.0 and distance < least:
            lead, least = c, distance
    size, gap = length(elastic), column(done, lead, at + AWAY)
    if points > 1 and size > 0.0:
        delta = overlap_of(law, pair, length(force), radius)
        gap = scale(max(radius - delta, NEAR) / size, elastic)
    gives_way = total <= 0.0 and pushes < GIVES_WAY * hardest
    return Pressed(lead, points, gap, elastic, late, stored, radius - least, gives_way)


@lean
def inherit(
    scene: ContactModel, contacts: ContactList, meeting: Meeting, root: int, lead: int
) -> None:
    """Hand what a piece has kept, of its points or of what was one of them, to a contact of it.

    The piece counts as dealt with then.
    """
    done, at, kept, acts = contacts.forces, spots_at(contacts), contacts.history, contacts.active
    first, end, heir = meeting.first, meeting.end, -1
    for c in range(first, end):
        is_one = acts[c] and is_of(scene, contacts, meeting, c, root)
        if is_one and (heir < 0 or kept[c, PRESSURE] > kept[heir, PRESSURE]):
            heir = c
    if heir >= 0 and heir != lead:
        for k in range(kept.shape[1]):
            kept[lead, k] = kept[heir, k]
        acts[lead] = True
    for c in range(first, end):
        if c != lead and acts[c] and is_of(scene, contacts, meeting, c, root):
            forget(contacts, c)
    for c in range(first, end):
        if done[c, at + PIECE] == root:
            done[c, at + PIECE] = HANDLED


@lean
def is_of(scene: ContactModel, contacts: ContactList, meeting: Meeting, c: int, root: int) -> bool:
    """Whether contact c is of a piece, or has been where the piece is now."""
    done, at = contacts.forces, spots_at(contacts)
    if done[c, at + COUNT] != 0.0:
        return bool(done[c, at + PIECE] == root)
    d = subtract(meeting.y, nearest(primitive_of(scene, contacts, c), meeting.y))
    away, found = to_world(meeting.q, d), False
    for m in range(meeting.first, meeting.end):
        if done[m, at + LOWEST] > 0.0 and done[m, at + PIECE] == root:
            found = found or is_below(contacts, meeting, m, away, meeting.way) <= 0.0
    return found


@lean
def forget_rest(contacts: ContactList, meeting: Meeting) -> None:
    """Forget contacts whose points have ended, and have handed on nothing."""
    done, at = contacts.forces, spots_at(contacts)
    for c in range(meeting.first, meeting.end):
        if contacts.active[c] and done[c, at + PIECE] >= 0.0:
            forget(contacts, c)
