"""Resistance to rolling and spinning: angular impulses of contacts.

Where two roll on each other with ω across the normal, the angular impulse m on the first is
opposite to ω, or ends it, and at most μ_r R* times the normal impulse in size:

    m = P(m - ω / λ),   P the projection onto the disc of radius μ_r R* r_n

λ is the largest inverse inertia across the normal. About the normal the same holds with the
interval ± μ_t R* r_n and the inverse inertia λ_n there; where W couples the two, both λ are 1 + κ
times as large, κ = |W_n1, W_n2| / √(λ λ_n), so that steps of both at once lower the energy. In sums
beside contacts m counts by λ / W_nn, so that one of N m s is as large as one of N s with the same
energy. Where no material resists either, nothing of this is compiled.

Source: Ai, Chen, Rotter and Ooi, Powder Technology 206, 269 (2011), the bound.
"""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.cone import on_disc
from particlerb.impulses.records import ImpulseRows, Partners, Rolling
from particlerb.impulses.rows import clear_moves, in_frame, in_world, push
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add, dot, scale, subtract

ACROSS: Final = 0  # columns of `Rolling.limit`: μ_r R* and λ across the normal
ABOUT: Final = 2  # the same about it
DRIVEN: Final = 4  # [rad/s] what drives change ω by until the end of the step, along n, t₁, t₂

_MAX_ITERATIONS: Final = 200  # of an impact
_CHANGE_TOLERANCE: Final = 1e-14  # relative change at which an impact is solved


@inline
def turning(velocity: Floats, rows: ImpulseRows, k: int) -> Vec3:
    """Relative angular velocity [rad/s] of contact k along n, t₁, t₂."""
    a, b = rows.partner_a[k], rows.partner_b[k]
    return in_frame(rows.frame, k, subtract(row3(velocity, a, 3), row3(velocity, b, 3)))


@inline
def turning_at_end(rolling: Rolling, partners: Partners, rows: ImpulseRows, k: int) -> Vec3:
    """The same as drives have it at the end of the step."""
    return add(turning(partners.velocity, rows, k), row3(rolling.limit, k, DRIVEN))


@inline
def _turn(partners: Partners, velocity: Floats, rows: ImpulseRows, k: int, m: Vec3) -> None:
    """Change velocities by the angular impulse m of contact k."""
    along, inverse, mechanisms = in_world(rows.frame, k, m), partners.inverse, partners.mechanisms
    push(velocity, inverse, mechanisms, rows.partner_a[k], ZERO, along)
    push(velocity, inverse, mechanisms, rows.partner_b[k], ZERO, scale(-1.0, along))


@inline
def _give(partners: Partners, rows: ImpulseRows, k: int, m: Vec3) -> None:
    """Give angular momenta."""
    along, momenta = in_world(rows.frame, k, m), partners.impulse
    a, b = rows.partner_a[k], rows.partner_b[k]
    put_row3(momenta, a, add(row3(momenta, a, 3), along), 3)
    put_row3(momenta, b, subtract(row3(momenta, b, 3), along), 3)


@inline
def on_the_disc(rolling: Rolling, k: int, m: Vec3, n: float) -> Vec3:
    """m, or the nearest that a normal impulse n lets be."""
    x, y = on_disc(m[1], m[2], rolling.limit[k, ACROSS] * n)
    most = rolling.limit[k, ABOUT] * n
    return min(max(m[0], -most), most), x, y


@inline
def step_against(rolling: Rolling, k: int, omega: Vec3) -> Vec3:
    """-ω / λ of contact k."""
    across, about = -1.0 / rolling.limit[k, ACROSS + 1], -1.0 / rolling.limit[k, ABOUT + 1]
    return about * omega[0], across * omega[1], across * omega[2]


@inline
def _nearest(rolling: Rolling, partners: Partners, rows: ImpulseRows, k: int) -> Vec3:
    """P of contact k with the velocities of now."""
    step = step_against(rolling, k, turning_at_end(rolling, partners, rows, k))
    return on_the_disc(rolling, k, add(row3(rolling.impulse, k), step), rows.impulse[k, 0])


@inline
def square_of(rolling: Rolling, rows: ImpulseRows, k: int, m: Vec3) -> float:
    """What m counts beside impulses [(N s)²]."""
    across, about = rolling.limit[k, ACROSS + 1], rolling.limit[k, ABOUT + 1]
    square: float = across * (m[1] * m[1] + m[2] * m[2]) + about * m[0] * m[0]
    return square / float(rows.frame[k, col.INVERSE])


@inline
def _turned_by(partners: Partners, rows: ImpulseRows, k: int, m: Vec3) -> Vec3:
    """What an angular impulse m of contact k does to its angular velocity."""
    clear_moves(partners, rows.partner_a[k], rows.partner_b[k])
    _turn(partners, partners.move, rows, k, m)
    return turning(partners.move, rows, k)


@inline
def write_rolling(partners: Partners, rows: ImpulseRows, count: int, dt: float) -> None:
    """Write λ of all contacts, whose frames are known; what joints hold is not resisted.

    And what drives change until the end of a step of dt [s].
    """
    rolling = rows.rolling
    if rolling is None:
        return
    for k in range(count):
        a, b, inverse, limit = rows.partner_a[k], rows.partner_b[k], partners.inverse, rolling.limit
        driven = subtract(row3(partners.before, a, 15), row3(partners.before, b, 15))
        put_row3(limit, k, in_frame(rows.frame, k, scale(0.5 * dt, driven)), DRIVEN)
        n = _turned_by(partners, rows, k, (1.0, 0.0, 0.0))
        t1 = _turned_by(partners, rows, k, (0.0, 1.0, 0.0))
        t2 = _turned_by(partners, rows, k, (0.0, 0.0, 1.0))
        half = 0.5 * (t1[1] - t2[2])
        largest = 0.5 * (t1[1] + t2[2]) + math.sqrt(half * half + t1[2] * t1[2])
        free = inverse[a, 1] + inverse[a, 4] + inverse[a, 6]
        free += inverse[b, 1] + inverse[b, 4] + inverse[b, 6]
        limit[k, ACROSS + 1], limit[k, ABOUT + 1] = largest, n[0]
        for at in (ACROSS, ABOUT):
            if limit[k, at + 1] <= col.LOCKED_SHARE * free:
                limit[k, at], limit[k, at + 1] = 0.0, 1.0
        across, about = limit[k, ACROSS + 1], limit[k, ABOUT + 1]
        if limit[k, ACROSS] > 0.0 and limit[k, ABOUT] > 0.0:
            coupling = math.sqrt((n[1] * n[1] + n[2] * n[2]) / (across * about))
            limit[k, ACROSS + 1] += coupling * across
            limit[k, ABOUT + 1] += coupling * about


@inline
def bounce_rolling(partners: Partners, rows: ImpulseRows, k: int, n: float) -> None:
    """Resist rolling in an impact of contact k with the normal impulse n.

    The step of a sweep again and again: each lowers the energy, and the end is that of the law,
    whatever the moments of the two are.
    """
    rolling = rows.rolling
    if rolling is None:
        return
    m = ZERO
    for _ in range(_MAX_ITERATIONS):
        step = step_against(rolling, k, turning(partners.velocity, rows, k))
        nearer = on_the_disc(rolling, k, add(m, step), n)
        change = subtract(nearer, m)
        if dot(change, change) <= _CHANGE_TOLERANCE * _CHANGE_TOLERANCE * dot(nearer, nearer):
            break
        m = nearer
        _turn(partners, partners.velocity, rows, k, change)
    _give(partners, rows, k, m)
    put_row3(rolling.impact, k, add(row3(rolling.impact, k), m))


# What the solver does with those of contacts `first` to `end`


@inline
def warm_start_rolling(partners: Partners, rows: ImpulseRows, first: int, end: int) -> None:
    """Take the angular impulses of the step before, in the frames of now and within the discs."""
    rolling = rows.rolling
    if rolling is None:
        return
    for k in range(first, end):
        m = in_frame(rows.frame, k, row3(rolling.impulse, k))
        m = on_the_disc(rolling, k, m, rows.impulse[k, 0])
        put_row3(rolling.impulse, k, m)
        _turn(partners, partners.velocity, rows, k, m)


@inline
def sweep_rolling(partners: Partners, rows: ImpulseRows, first: int, end: int) -> float:
    """One step of each contact; the sum of all squared changes [(N s)²]."""
    changed = 0.0
    rolling = rows.rolling
    if rolling is None:
        return changed
    for k in range(first, end):
        old = row3(rolling.impulse, k)
        put_row3(rolling.old, k, old)
        m = _nearest(rolling, partners, rows, k)
        change = subtract(m, old)
        square = square_of(rolling, rows, k, change)
        if square > 0.0:
            put_row3(rolling.impulse, k, m)
            _turn(partners, partners.velocity, rows, k, change)
        changed += square
    return changed


@inline
def mix_rolling(
    partners: Partners, rows: ImpulseRows, first: int, end: int, beta: float, is_last: bool
) -> None:
    """Go on along the direction of before: see `solver`."""
    rolling = rows.rolling
    if rolling is None:
        return
    impulse, direction = rolling.impulse, rolling.direction
    for k in range(first, end):
        change = subtract(row3(impulse, k), row3(rolling.old, k))
        on = scale(beta, row3(direction, k))
        if not is_last and dot(on, on) > 0.0:
            put_row3(impulse, k, add(row3(impulse, k), on))
            _turn(partners, partners.velocity, rows, k, on)
        put_row3(direction, k, add(on, change))


@inline
def miss_of_rolling(partners: Partners, rows: ImpulseRows, first: int, end: int) -> Vec3:
    """Squares of how far these are from a solution [(N s)², (m/s)²], and of their size [(N s)²]."""
    rolling = rows.rolling
    off, left, size = 0.0, 0.0, 0.0
    if rolling is None:
        return ZERO
    for k in range(first, end):
        miss = subtract(row3(rolling.impulse, k), _nearest(rolling, partners, rows, k))
        square = square_of(rolling, rows, k, miss)
        off += square
        left += rows.frame[k, col.INVERSE] ** 2 * square
        size += square_of(rolling, rows, k, row3(rolling.impulse, k))
    return off, left, size


@inline
def push_by_rolling(partners: Partners, rows: ImpulseRows, count: int) -> None:
    """Change velocities by all of these."""
    rolling = rows.rolling
    if rolling is None:
        return
    for k in range(count):
        _turn(partners, partners.velocity, rows, k, row3(rolling.impulse, k))


@inline
def into_the_discs(rows: ImpulseRows, count: int) -> None:
    """Take away what the normal impulses of now do not let be."""
    rolling = rows.rolling
    if rolling is None:
        return
    for k in range(count):
        m = on_the_disc(rolling, k, row3(rolling.impulse, k), rows.impulse[k, 0])
        put_row3(rolling.impulse, k, m)


@inline
def keep_best_rolling(rows: ImpulseRows, best: Floats, k: int, goes_back: bool) -> None:
    """Keep the angular impulse of contact k behind its impulse, or go back to what is kept."""
    rolling = rows.rolling
    if rolling is None:
        return
    if goes_back:
        put_row3(rolling.impulse, k, row3(best, k, 3))
    else:
        put_row3(best, k, row3(rolling.impulse, k), 3)


@inline
def give_rolling(partners: Partners, rows: ImpulseRows, first: int, end: int) -> None:
    """Give the angular momenta of all of these."""
    rolling = rows.rolling
    if rolling is None:
        return
    for k in range(first, end):
        _give(partners, rows, k, row3(rolling.impulse, k))


@inline
def rolled(partners: Partners, rows: ImpulseRows, k: int) -> tuple[Vec3, float]:
    """Angular impulse of a step on the first of contact k, world axes, and its work [J]."""
    rolling = rows.rolling
    if rolling is None:
        return ZERO, 0.0
    m = add(row3(rolling.impulse, k), row3(rolling.impact, k))
    turned = add(turning(partners.before, rows, k), turning(partners.velocity, rows, k))
    return in_world(rows.frame, k, m), 0.5 * dot(m, turned)
