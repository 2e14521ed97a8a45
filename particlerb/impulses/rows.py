"""One contact: its frame and inverse mass, how its partners move, and what an impulse does."""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.mechanisms import count_members, member, push_mechanism
from particlerb.impulses.records import ImpulseRows, Impulses, Mechanisms, Partners
from particlerb.maths.quaternion import Matrix, tensor
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add, add_scaled, cross, dot, scale, subtract

_STICKING_SHARE: Final = 1.0 - 1e-6  # of μ times the normal force: with less friction it sticks
_SLIP_SHARE: Final = 0.1  # of what drives and turning change: with less slip it sticks
_CAME_SHARE: Final = 2.0  # of what came across the normal: so much turning gives back at most
_MIN_SCHUR_SHARE: Final = 1e-6  # of an inverse mass without joints: with less, friction is nothing


@inline
def put_inverse(inverse: Floats, b: int, mass: float, moments: Vec3, R: Matrix) -> None:
    """Write 1/M and the inverse inertia in world axes of partner b, turned by R."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = tensor(R, moments)
    for at, value in enumerate((mass, xx, xy, xz, yy, yz, zz)):
        inverse[b, at] = value


@inline
def inverse_inertia_times(inverse: Floats, b: int, m: Vec3) -> Vec3:
    """I⁻¹ m of a partner, world axes."""
    xx, xy, xz = inverse[b, 1], inverse[b, 2], inverse[b, 3]
    yy, yz, zz = inverse[b, 4], inverse[b, 5], inverse[b, 6]
    x, y, z = m
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@inline
def velocity_between(velocity: Floats, frame: Floats, c: int, a: int, b: int) -> Vec3:
    """Velocity [m/s] of the first partner of contact c relative to the second, at the point."""
    va = cross(row3(velocity, a, 3), row3(frame, c, col.ARM))
    vb = cross(row3(velocity, b, 3), row3(frame, c, col.ARM + 3))
    va, vb = add(va, row3(velocity, a)), add(vb, row3(velocity, b))
    return subtract(va, vb)


@inline
def in_frame(frame: Floats, c: int, v: Vec3) -> Vec3:
    """Components of a vector along n, t₁, t₂ of contact c."""
    return (
        dot(row3(frame, c, col.NORMAL), v),
        dot(row3(frame, c, col.TANGENT), v),
        dot(row3(frame, c, col.TANGENT + 3), v),
    )


@inline
def in_world(frame: Floats, c: int, r: Vec3) -> Vec3:
    """A vector of components along n, t₁, t₂ of contact c."""
    along = scale(r[0], row3(frame, c, col.NORMAL))
    along = add_scaled(r[1], row3(frame, c, col.TANGENT), along)
    return add_scaled(r[2], row3(frame, c, col.TANGENT + 3), along)


@inline
def push(
    velocity: Floats, inverse: Floats, mechanisms: Mechanisms | None, b: int, p: Vec3, m: Vec3
) -> None:
    """Change velocities by an impulse p [N s] and an angular impulse m [N m s] on partner b."""
    if push_mechanism(mechanisms, velocity, b, p, m) or inverse[b, 0] == 0.0:
        return
    put_row3(velocity, b, add_scaled(inverse[b, 0], p, row3(velocity, b)))
    turn = inverse_inertia_times(inverse, b, m)
    put_row3(velocity, b, add_scaled(1.0, turn, row3(velocity, b, 3)), 3)


@inline
def push_apart(
    velocity: Floats, inverse: Floats, mechanisms: Mechanisms | None, frame: Floats, c: int,
    a: int, b: int, p: Vec3,
) -> None:  # fmt: skip
    """Change velocities by the impulse p [N s] on the first partner, and -p on the second."""
    other = scale(-1.0, p)
    push(velocity, inverse, mechanisms, a, p, cross(row3(frame, c, col.ARM), p))
    push(velocity, inverse, mechanisms, b, other, cross(row3(frame, c, col.ARM + 3), other))


@inline
def _across(n: Vec3) -> tuple[Vec3, Vec3]:
    """Two unit vectors across a unit vector and each other."""
    t = (0.0, n[2], -n[1]) if abs(n[0]) < 0.6 else (-n[2], 0.0, n[0])
    t = scale(1.0 / math.sqrt(dot(t, t)), t)
    return t, cross(n, t)


@inline
def _diagonal_turn(s11: float, s22: float, s12: float) -> tuple[float, float]:
    """Cosine and sine of Jacobi's turn, after which the matrix is diagonal."""
    if abs(s12) <= 1e-14 * (s11 + s22):
        return 1.0, 0.0
    z = (s22 - s11) / (2.0 * s12)
    t = (1.0 if z >= 0.0 else -1.0) / (abs(z) + math.sqrt(1.0 + z * z))
    c = 1.0 / math.sqrt(1.0 + t * t)
    return c, -t * c


@inline
def write_frame(partners: Partners, rows: ImpulseRows, c: int, normal: Vec3, point: Vec3) -> None:
    """Write frame and inverse mass of contact c, whose partners are known, at a point [m]."""
    between = rows.partner_a[c], rows.partner_b[c]
    write_frame_of(rows.frame, partners.inverse, partners.position, c, between, normal, point)


@inline
def write_frame_of(
    frame: Floats, inverse: Floats, place: Floats, c: int, between: tuple[int, int], normal: Vec3,
    point: Vec3,
) -> None:  # fmt: skip
    """Write frame and inverse mass of contact c between two partners at a point [m]."""
    a, b = between
    arm_a, arm_b = subtract(point, row3(place, a)), subtract(point, row3(place, b))
    put_row3(frame, c, normal, col.NORMAL)
    put_row3(frame, c, arm_a, col.ARM)
    put_row3(frame, c, arm_b, col.ARM + 3)
    t1, t2 = _across(normal)
    na, nb = cross(arm_a, normal), cross(arm_b, normal)
    xa, xb, ya, yb = cross(arm_a, t1), cross(arm_b, t1), cross(arm_a, t2), cross(arm_b, t2)
    turn_a, turn_b = inverse_inertia_times(inverse, a, na), inverse_inertia_times(inverse, b, nb)
    mass = inverse[a, 0] + inverse[b, 0]
    w = mass + dot(na, turn_a) + dot(nb, turn_b)
    w1, w2 = dot(xa, turn_a) + dot(xb, turn_b), dot(ya, turn_a) + dot(yb, turn_b)
    turn_a, turn_b = inverse_inertia_times(inverse, a, xa), inverse_inertia_times(inverse, b, xb)
    w11 = mass + dot(xa, turn_a) + dot(xb, turn_b)
    w12 = dot(ya, turn_a) + dot(yb, turn_b)
    turn_a, turn_b = inverse_inertia_times(inverse, a, ya), inverse_inertia_times(inverse, b, yb)
    w22 = mass + dot(ya, turn_a) + dot(yb, turn_b)
    put_matrix(frame, c, (t1, t2), (w, w1, w2), (w11, w12, w22))


@inline
def put_matrix(
    frame: Floats, c: int, across: tuple[Vec3, Vec3], by_normal: Vec3, by_tangents: Vec3
) -> None:
    """Write the inverse mass of contact c, W_nn, W_n1, W_n2 and W_11, W_12, W_22, and tangents."""
    (t1, t2), (w, w1, w2), (w11, w12, w22) = across, by_normal, by_tangents
    s11, s22, s12 = w11 - w1 * w1 / w, w22 - w2 * w2 / w, w12 - w1 * w2 / w
    c_, s_ = _diagonal_turn(s11, s22, s12)
    put_row3(frame, c, add_scaled(c_, t1, scale(s_, t2)), col.TANGENT)
    put_row3(frame, c, add_scaled(-s_, t1, scale(c_, t2)), col.TANGENT + 3)
    frame[c, col.INVERSE] = w
    frame[c, col.COUPLING], frame[c, col.COUPLING + 1] = c_ * w1 + s_ * w2, c_ * w2 - s_ * w1
    frame[c, col.SCHUR] = c_ * c_ * s11 + 2.0 * c_ * s_ * s12 + s_ * s_ * s22
    frame[c, col.SCHUR + 1] = s_ * s_ * s11 - 2.0 * c_ * s_ * s12 + c_ * c_ * s22
    _put_shares(frame, c)


@inline
def _put_shares(frame: Floats, c: int) -> None:
    """Write by what a sweep multiplies velocities, once for all sweeps."""
    a1, a2, share = frame[c, col.COUPLING], frame[c, col.COUPLING + 1], 1.0 / frame[c, col.INVERSE]
    frame[c, col.SHARE] = share
    largest = max(frame[c, col.SCHUR], frame[c, col.SCHUR + 1])
    frame[c, col.RUBBING] = 1.0 / (largest + share * (a1 * a1 + a2 * a2))


@inline
def approach(partners: Partners, rows: ImpulseRows, c: int) -> Vec3:
    """Velocity [m/s] in contact c along n, t₁, t₂."""
    a, b = rows.partner_a[c], rows.partner_b[c]
    return in_frame(rows.frame, c, velocity_between(partners.velocity, rows.frame, c, a, b))


@inline
def approach_at_end(partners: Partners, rows: ImpulseRows, c: int) -> Vec3:
    """The same as it will be at the end of the step, but for the normal one: see `lean`."""
    u, limits = approach(partners, rows, c), rows.limits
    return u[0], u[1] + limits[c, col.LEAN + 1], u[2] + limits[c, col.LEAN + 2]


@inline
def driven_by(partners: Partners, rows: ImpulseRows, c: int, dt: float) -> Vec3:
    """What drives change the velocity in contact c by in half a step [m/s], along n, t₁, t₂.

    At a point of both bodies: so all contacts of a pair ask for what rigid bodies can have at once.
    """
    a, b, before = rows.partner_a[c], rows.partner_b[c], partners.before
    by_a = cross(row3(before, a, 15), row3(rows.frame, c, col.ARM))
    by_b = cross(row3(before, b, 15), row3(rows.frame, c, col.ARM + 3))
    by_a, by_b = add(row3(before, a, 12), by_a), add(row3(before, b, 12), by_b)
    return in_frame(rows.frame, c, scale(0.5 * dt, subtract(by_a, by_b)))


@inline
def lean(
    partners: Partners, rows: ImpulseRows, c: int, changes: Vec3, force: Vec3, dt: float,
    slop: float,
) -> None:  # fmt: skip
    """Let the solve of contact c ask for what its velocity is at the end of the step.

    Until then it changes without impulses, as the normal turns and as bodies turn. So what rolls or
    slides along what is bent leaves the middle of a step as it came there; without this, each step
    would take from its energy what the normal has turned towards it. No more than what came is
    given back, and across the normal twice that, to what stuck in the step before or does not slip:
    several contacts of a pair ask for what rigid bodies can have at once. What drives and
    prescribed motions accelerate counts in full. What moves in contact over what is bent away
    from it lies beyond in the middle, which is not counted as a gap.

    Parameters
    ----------
    partners, rows, c
        Contact, whose frame and limits are known.
    changes : tuple of 3 floats [m/s²]
        How its velocity changes without drives, world axes.
    force : tuple of 3 floats [N]
        Of the step before.
    dt : float [s]
    slop : float [m]
    """
    a, b, limits = rows.partner_a[c], rows.partner_b[c], rows.limits
    n_by, x_by, y_by = driven_by(partners, rows, c, dt)
    n, x, y = in_frame(rows.frame, c, scale(0.5 * dt, changes))
    came, u, v = in_frame(rows.frame, c, velocity_between(partners.before, rows.frame, c, a, b))
    limits[c, col.SLOW] += 4.0 * max(-n - n_by, 0.0)
    pressed, f, g = in_frame(rows.frame, c, force)
    if rows.frame[c, col.LEAST_VELOCITY] < 0.0 and pressed <= 0.0:
        rows.frame[c, col.LEAST_VELOCITY] -= n_by
        put_row3(limits, c, (n_by, x_by, y_by), col.LEAN)
        return
    n = n_by + min(max(came - n_by, min(n, 0.0)), max(n, 0.0))
    gap = limits[c, col.GAP] - 0.25 * dt * max(n, 0.0)
    rows.frame[c, col.LEAST_VELOCITY] = (-gap / dt if gap > slop else 0.0) - n
    is_within = f * f + g * g < (_STICKING_SHARE * rows.frame[c, col.FRICTION] * pressed) ** 2
    slip, u, v = (u - x_by - x) ** 2 + (v - y_by - y) ** 2, u - x_by, v - y_by
    sticks = is_within or slip <= _SLIP_SHARE**2 * ((x + x_by) ** 2 + (y + y_by) ** 2)
    if sticks and pressed > 0.0:
        size, most = x * x + y * y, _CAME_SHARE**2 * (u * u + v * v)
        share = math.sqrt(most / size) if size > most else 1.0
        x_by, y_by = x_by + share * x, y_by + share * y
    put_row3(limits, c, (n, x_by, y_by), col.LEAN)


@inline
def give(partners: Partners, rows: ImpulseRows, c: int, r: Vec3) -> None:
    """Give momenta: r [N s] along n, t₁, t₂ of contact c to the first partner, -r to the second."""
    a, b, momenta = rows.partner_a[c], rows.partner_b[c], partners.impulse
    p = in_world(rows.frame, c, r)
    turn_a = cross(row3(rows.frame, c, col.ARM), p)
    turn_b = cross(row3(rows.frame, c, col.ARM + 3), p)
    put_row3(momenta, a, add_scaled(1.0, p, row3(momenta, a)))
    put_row3(momenta, b, add_scaled(-1.0, p, row3(momenta, b)))
    put_row3(momenta, a, add_scaled(1.0, turn_a, row3(momenta, a, 3)), 3)
    put_row3(momenta, b, add_scaled(-1.0, turn_b, row3(momenta, b, 3)), 3)


@inline
def change_by(partners: Partners, rows: ImpulseRows, c: int, r: Vec3) -> None:
    """Change velocities by r [N s] along n, t₁, t₂ of contact c."""
    a, b, p = rows.partner_a[c], rows.partner_b[c], in_world(rows.frame, c, r)
    inverse, mechanisms = partners.inverse, partners.mechanisms
    push_apart(partners.velocity, inverse, mechanisms, rows.frame, c, a, b, p)


@inline
def clear_moves(partners: Partners, a: int, b: int) -> None:
    """No move of two partners, and of all that joints tie to them."""
    move, mechanisms = partners.move, partners.mechanisms
    for body in (a, b):
        for j in range(count_members(mechanisms, body)):
            put_row3(move, member(mechanisms, body, j), ZERO)
            put_row3(move, member(mechanisms, body, j), ZERO, 3)


@inline
def _moved_along(partners: Partners, frame: Floats, c: int, a: int, b: int, along: Vec3) -> Vec3:
    """What a unit impulse in contact c does to its velocity, along n, t₁, t₂."""
    move = partners.move
    clear_moves(partners, a, b)
    push_apart(move, partners.inverse, partners.mechanisms, frame, c, a, b, along)
    return in_frame(frame, c, velocity_between(move, frame, c, a, b))


@inline
def write_through_joints(partners: Partners, rows: ImpulseRows, c: int) -> None:
    """Write the inverse mass of contact c whose partners move as their joints let them.

    Where these let the two neither approach nor part, the contact is left out.
    """
    a, b, frame = rows.partner_a[c], rows.partner_b[c], rows.frame
    n, t1, t2 = (
        row3(frame, c, col.NORMAL), row3(frame, c, col.TANGENT), row3(frame, c, col.TANGENT + 3),
    )  # fmt: skip
    by_n = _moved_along(partners, frame, c, a, b, n)
    by_1 = _moved_along(partners, frame, c, a, b, t1)
    by_2, free = _moved_along(partners, frame, c, a, b, t2), frame[c, col.INVERSE]
    if by_n[0] <= col.LOCKED_SHARE * free:
        frame[c, col.LEAST_VELOCITY], rows.limits[c, col.RESTITUTION] = col.NEVER, 0.0
        return
    changes = in_world(frame, c, row3(rows.limits, c, col.LEAN))
    put_matrix(frame, c, (t1, t2), by_n, (by_1[1], by_1[2], by_2[2]))
    put_row3(rows.limits, c, in_frame(frame, c, changes), col.LEAN)  # tangents are others now
    for i in range(2):
        frame[c, col.SCHUR + i] = max(frame[c, col.SCHUR + i], _MIN_SCHUR_SHARE * free)
    _put_shares(frame, c)


@inline
def write_through_pistons(impulses: Impulses) -> None:
    """Write the inverse masses of contacts with walls that slide, where there are no joints."""
    _, partners, rows, count, _, _ = impulses
    mechanisms = partners.mechanisms
    if mechanisms is None:
        return
    for c in range(count[0]):
        if mechanisms.number[rows.partner_b[c]] >= 0:
            write_through_joints(partners, rows, c)
