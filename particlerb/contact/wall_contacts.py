"""Contacts of spheres with walls: one for each connected piece of a wall within a sphere.

A sphere of radius r around x that reaches a wall holds a part of it, which may fall into pieces:
two in the corner of a box, one on a plane or over a ridge, however it is cut into triangles. Each
piece is one contact. Its elastic energy is

    U(x) = Σ c f(r - d)              d distance of x to a point that counts, c its `euler_count`

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
once the sphere reaches its edges: see `wall_pieces._MIN_RING_SHARE`.

Sources: Hadwiger, Vorlesungen über Inhalt, Oberfläche und Isoperimetrie (1957), the Euler
characteristic as a sum over convex parts; Banchoff, American Mathematical Monthly 77, 475 (1970),
how it changes at the vertices of a polyhedron.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.contact_model import ContactList, ContactModel, Evaluation
from particlerb.contact.pair_force import (
    Collision,
    contact_force,
    end_contact,
    inv_effective_mass,
    note_overlap,
    start_contact,
    velocity_at,
)
from particlerb.contact.records import Records
from particlerb.contact.wall_pieces import (
    SphereAtWall,
    WallPiece,
    approach_velocity,
    end_leftovers,
    hand_over_history,
    join_pieces,
    next_piece,
    piece_at,
    point_in_reach,
    write_points,
)
from particlerb.contact.walls import PLANE, normal_rate, primitive_at, wall_velocity
from particlerb.maths.quaternion import to_body, to_world
from particlerb.maths.rows import put_row3, row3, row4
from particlerb.maths.vec3 import ZERO, Vec3, add_scaled, cross, dot, norm, scale, subtract


@inline
def wall_normal_rate(on: Evaluation, at: SphereAtWall, piece: WallPiece, normal: Vec3) -> Vec3:
    """ṅ [1/s] of a piece of a wall, world axes; of several points only by how the wall turns."""
    if on.growth.slope is None:
        return ZERO
    walls, poses = on.model.walls, on.workspace.poses
    turning = cross(row3(poses.angular_velocity, at.wall), normal)
    if piece.points > 1 or norm(piece.gap) <= 0.0:
        return turning
    primitive = primitive_at(walls.kind, walls.parameter, on.contacts.other[piece.nearest])
    v, away = to_body(at.q, approach_velocity(on.workspace, at)), to_body(at.q, scale(-1.0, normal))
    return subtract(turning, to_world(at.q, normal_rate(primitive, at.y, away, v)))


_MAX_WALL_OVERLAP: Final = 0.8  # with a thin wall, in radii: beyond 1 it pushes to its other side


class _Survey(NamedTuple):
    """What there is around a sphere at a wall."""

    n_nearest: int  # how many points are nearer than all around them
    n_others: int  # and how many more count
    n_active: int  # how many contacts have been active
    last_nearest: int  # the last contact with a nearest point
    gap: Vec3  # and the gap there [m], frame of the wall


@inline
def _one_norm(v: Vec3) -> float:
    """|v₁| + |v₂| + |v₃|: at least the length, and without a root."""
    return abs(v[0]) + abs(v[1]) + abs(v[2])


@inline
def _end_of(model: ContactModel, contacts: ContactList, first: int, most: int) -> int:
    """Where contacts end that are of the same sphere and the same wall as the first."""
    wall, c = model.walls.wall, first + 1
    sphere, w = contacts.sphere[first], wall[contacts.other[first]]
    while c < most and contacts.sphere[c] == sphere and wall[contacts.other[c]] == w:
        c += 1
    return c


@inline
def _sphere_at_wall(on: Evaluation, c: int, end: int) -> SphereAtWall:
    """The sphere and the wall of contacts c to end."""
    spheres, walls, contacts = on.model.spheres, on.model.walls, on.contacts
    xyzr, bodies, poses = on.workspace.xyzr, on.workspace.bodies, on.workspace.poses
    i, w = contacts.sphere[c], walls.wall[contacts.other[c]]
    a, x, radius = spheres.body[i], row3(xyzr, i), xyzr[i, 3]
    d, q = subtract(x, row3(poses.position, w)), row4(poses.orientation, w)
    arm = _one_norm(subtract(x, row3(bodies.position, a))) + 2.0 * radius
    speed = bodies.speed[a] + bodies.angular_speed[a] * arm + _one_norm(row3(poses.velocity, w))
    speed += _one_norm(row3(poses.angular_velocity, w)) * (_one_norm(d) + 2.0 * radius)
    displacement = max(on.before, on.after) * speed
    return SphereAtWall(c, end, x, to_body(q, d), q, radius, a, w, displacement)


@kernel
def wall_contact_forces(on: Evaluation, part: tuple[int, int, int]) -> None:
    """Forces of contacts of spheres with walls, whose poses are those of this instant.

    `part` is a shell and what this thread does of it: spheres and walls whose contacts begin there.
    """
    contacts, (shell, c, end) = on.contacts, part
    least = contacts.shell_ends[shell - 1] if shell > 0 else 0
    most = contacts.shell_ends[shell]
    if least < c < end:
        c = _end_of(on.model, contacts, c - 1, end)
    while c < end:
        until = _end_of(on.model, contacts, c, most)
        at = _sphere_at_wall(on, c, until)
        around = _survey(on, at)
        c, nearest = until, around.last_nearest
        is_same = around.n_active == 1 and around.n_nearest == 1 and contacts.active[nearest]
        if (around.n_active == 0 or is_same) and around.n_others == 0 and around.n_nearest <= 1:
            if around.n_nearest == 1:
                gap = to_world(at.q, around.gap)
                piece = WallPiece(nearest, 1, gap, gap, gap, 0.0, at.radius - norm(gap), False)
                _piece_forces(on, at, piece)
            continue
        write_points(on, at)
        join_pieces(contacts, at)
        root = next_piece(contacts, at)
        while root >= 0:
            piece = piece_at(on, at, root)
            hand_over_history(on, at, root, piece.nearest)
            _piece_forces(on, at, piece)
            root = next_piece(contacts, at)
        end_leftovers(on, at)


@inline
def _survey(on: Evaluation, at: SphereAtWall) -> _Survey:
    """What there is around a sphere."""
    nearest, others, active, last, gap = 0, 0, 0, -1, at.y
    for c in range(at.first, at.end):
        count, is_nearest, away = point_in_reach(on, at, c)
        if is_nearest:
            nearest, last, gap = nearest + 1, c, away
        elif count != 0:
            others += 1
        active += 1 if on.contacts.active[c] else 0
    return _Survey(nearest, others, active, last, gap)


@inline
def _velocity_of_wall(poses: Records, w: int, x: Vec3, gap: Vec3, point: Vec3) -> Vec3:
    """Velocity of a wall [m/s] at a point at a gap below a centre x."""
    omega = row3(poses.angular_velocity, w)
    foot = subtract(subtract(x, row3(poses.position, w)), gap)
    v = wall_velocity(poses, w, foot)
    return add_scaled(1.0, cross(omega, add_scaled(1.0, gap, subtract(point, x))), v)


@inline
def _piece_forces(on: Evaluation, at: SphereAtWall, piece: WallPiece) -> None:
    """Find the forces of a piece; end its contact if it is out of reach."""
    model, contacts = on.model, on.contacts
    bodies, poses = on.workspace.bodies, on.workspace.poses
    x, radius, a, w = at.x, at.radius, at.body, at.wall
    c, gap, distance = piece.nearest, piece.gap, norm(piece.gap)
    overlap = radius - distance
    normal = scale(-1.0 / distance, gap) if distance > 0.0 else (0.0, 0.0, 1.0)
    point = add_scaled(radius - 0.5 * overlap, normal, x)
    moving = _velocity_of_wall(poses, w, x, gap, point)
    relative = subtract(velocity_at(bodies, a, point), moving)
    omega = subtract(row3(bodies.angular_velocity, a), row3(poses.angular_velocity, w))
    if overlap <= -0.5 * max(on.before, on.after) * abs(dot(relative, normal)):
        if contacts.active[c]:
            end_contact(on, c)
        return
    primitive = contacts.other[c]
    material = model.spheres.material[contacts.sphere[c]]
    pair = model.pair_of[material, model.wall_material[primitive]]
    if contacts.history.inv_effective_mass[c] == 0.0:
        inv_mass = inv_effective_mass(model, bodies, a, point, normal)
        inv_mass += dot(normal, row3(poses.piston_axis, w)) ** 2
        if inv_mass == 0.0:  # neither can move: there is no force
            return
        start_contact(on, pair, c, inv_mass, radius)
    is_thin = model.walls.kind[primitive] != PLANE
    if piece.is_too_weak or (piece.overlap > _MAX_WALL_OVERLAP * radius and is_thin):
        note_overlap(on, piece.overlap, radius, a, model.inv_mass.size + w)
    turning = wall_normal_rate(on, at, piece, normal)
    now = Collision(overlap, normal, point, relative, omega, moving, radius, turning)
    contact_force(on, pair, c, now)
    contacts.active[c], forces = True, contacts.forces
    put_row3(forces.correction_impulse, c, (0.0, 0.0, 0.0))
    if piece.points > 1:
        put_row3(forces.elastic, c, piece.elastic)
        put_row3(forces.correction_impulse, c, piece.correction_impulse)
        forces.elastic_energy[c] = piece.energy
        forces.boundary_power[c] = dot(piece.elastic, moving)
        forces.correction_time[c] = 0.0
