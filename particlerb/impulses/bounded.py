"""Stops, motors and friction of joints: numbers within bounds, solved with the contacts.

One row is a coordinate of a joint with its rate u and an impulse r along it. Without r the rate
may be anything from `least` to `most`; the impulse that keeps it there is `largest` in size at
most:

    r = P(r - (u - least)/W, r - (u - most)/W),   P(a, b) = max(a, min(b, 0)) within ± largest

For a stop the ends are those at which the coordinate would meet it at the end of a step, and no
impulse is too large; a motor has its speed for both ends, friction 0. W is the inverse mass that
the mechanism has along the coordinate. In sums beside contacts an impulse counts by W over the
inverse mass of both bodies, so that one of N m s is as large as one of N s with the same energy.
Where a scene has no such rows, nothing of this is compiled.
"""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.records import Bounded, Mechanisms, Partners
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Vec3, dot

FLOOR_SHARE: Final = 1e-6  # of all impulses of the kick: what carries less carries nothing
ROUNDING: Final = 2.0**-51  # of the terms of a velocity
_REST_RATE_SHARE: Final = 1e-12  # of the rate
_CLOSED_SHARE: Final = 1e-6  # of the distance of a step: a gap that is 0 but for rounding


@inline
def _rate(bounded: Bounded, y: Floats, k: int, at: int) -> float:
    """Rate of the coordinate of row k with velocities that stand in y from `at` on."""
    rate = 0.0
    for end, of in ((bounded.partner_a[k], 0), (bounded.partner_b[k], 6)):
        rate += dot(row3(bounded.gradient, k, of), row3(y, end, at))
        rate += dot(row3(bounded.gradient, k, of + 3), row3(y, end, at + 3))
    return rate


@inline
def rate_along(bounded: Bounded, velocity: Floats, k: int) -> float:
    """Rate of the coordinate of row k with these velocities."""
    return _rate(bounded, velocity, k, 0)


@inline
def push_along(bounded: Bounded, velocity: Floats, k: int, r: float) -> None:
    """Change velocities by an impulse along row k."""
    for j in range(bounded.start[k], bounded.start[k + 1]):
        for i in range(6):
            velocity[bounded.member[j], i] += r * bounded.response[j, i]


@inline
def ends_of(values: Floats, k: int, u: float) -> tuple[float, float]:
    """Impulses of row k by which its rate would be the least one, and the most."""
    r, inverse = values[k, col.B_IMPULSE], values[k, col.B_INVERSE]
    return r - (u - values[k, col.B_LEAST]) / inverse, r - (u - values[k, col.B_MOST]) / inverse


@inline
def inverse_of(values: Floats, k: int) -> float:
    """Sum of the inverse masses of both bodies of row k [1/kg]; 0 where it is left out."""
    weight = values[k, col.B_WEIGHT]
    return values[k, col.B_INVERSE] / weight if weight > 0.0 else 0.0


@inline
def within(values: Floats, k: int, r: float) -> float:
    """r, or the nearest impulse that row k may have."""
    largest = values[k, col.B_LARGEST]
    return max(-largest, min(largest, r))


@inline
def _nearest(values: Floats, k: int, u: float) -> float:
    """P of row k with the rate u."""
    by_least, by_most = ends_of(values, k, u)
    return within(values, k, max(by_least, min(by_most, 0.0)))


# A row for a step


@inline
def write_gradient(
    bounded: Bounded, k: int, by_a: Vec3, turning_a: Vec3, by_b: Vec3, turning_b: Vec3
) -> None:
    """Write how the coordinate of row k changes with the velocities of both of its bodies."""
    for i in range(3):
        bounded.gradient[k, i], bounded.gradient[k, 3 + i] = by_a[i], turning_a[i]
        bounded.gradient[k, 6 + i], bounded.gradient[k, 9 + i] = by_b[i], turning_b[i]


@inline
def write_response(
    bounded: Bounded, mechanisms: Mechanisms, k: int, mass: float, free: float
) -> None:
    """Write what a unit impulse along row k does to its mechanism, and W.

    Parameters
    ----------
    bounded, mechanisms, k
        With the gradient of the row.
    mass : float [1/kg]
        Sum of the inverse masses of both bodies.
    free : float
        Inverse mass of the row without joints. Where these hold the coordinate, it is left out.
    """
    first, last, response = bounded.start[k], bounded.start[k + 1], bounded.response
    for j in range(first, last):
        for i in range(6):
            response[j, i] = 0.0
    for b, at in ((bounded.partner_a[k], 0), (bounded.partner_b[k], 6)):
        c = mechanisms.number[b]
        if c < 0:
            continue
        to = mechanisms.start[c] + 36 * mechanisms.local[b] * (last - first)
        for of in range(at, at + 6):
            for j in range(first, last):
                for i in range(6):
                    response[j, i] += bounded.gradient[k, of] * mechanisms.response[to]
                    to += 1
    inverse, values = 0.0, bounded.values
    for b, at in ((bounded.partner_a[k], 0), (bounded.partner_b[k], 6)):
        for i in range(6):
            inverse += bounded.gradient[k, at + i] * response[first + mechanisms.local[b], i]
    is_free = inverse > col.LOCKED_SHARE * free
    values[k, col.B_INVERSE], values[k, col.B_WEIGHT] = 1.0, 0.0
    if is_free:
        values[k, col.B_INVERSE], values[k, col.B_WEIGHT] = inverse, inverse / mass


@inline
def lean_along(
    bounded: Bounded, partners: Partners, k: int, convective: float, speed: float, dt: float
) -> None:
    """Write what the rate of row k changes by until the end of a step of dt [s], without forces.

    As `rows.lean` of contacts: what a brake or a stop holds stands at the ends of steps. No more
    than what came is given back of what turns, and all of what drives accelerate.
    """
    values, before = bounded.values, partners.before
    driven = 0.5 * dt * _rate(bounded, before, k, 12)
    turned = 0.5 * dt * (convective + _rate(bounded, before, k, 6))
    came = rate_along(bounded, before, k) - speed - driven
    values[k, col.B_SLOW] = col.REST_KICKS * abs(turned + driven)
    turned = min(max(came, min(turned, 0.0)), max(turned, 0.0))
    values[k, col.B_LEAN] = driven + turned


@inline
def write_bounds(
    bounded: Bounded, partners: Partners, k: int, speed: float, largest: float, dt: float
) -> None:
    """Write what rate and impulse row k may have in a step of dt [s], and begin with its force.

    Parameters
    ----------
    bounded, partners, k
        With gaps, restitution, velocities before and after half a kick, and what they change by.
    speed : float
        That a motor or friction keeps.
    largest : float
        Impulse with which.
    """
    values = bounded.values
    before = rate_along(bounded, partners.before, k)
    after = rate_along(bounded, partners.velocity, k)
    lean, force = values[k, col.B_LEAN], values[k, col.B_FORCE]
    values[k, col.B_LEAST] = values[k, col.B_MOST] = speed - lean
    if bounded.kind[k] == col.STOP:
        # bodies go straight from step to step, and lie beyond the stop in the middle
        values[k, col.B_GAP] -= 0.25 * dt * lean if force > 0.0 else 0.0
        values[k, col.B_GAP + 1] += 0.25 * dt * lean if force < 0.0 else 0.0
        for side in (col.B_GAP, col.B_GAP + 1):
            if 0.0 < values[k, side] <= _CLOSED_SHARE * dt * abs(after):
                values[k, side] = 0.0
        lower, upper = values[k, col.B_GAP], values[k, col.B_GAP + 1]
        at_lower, at_upper = lower <= 0.0 or force > 0.0, upper <= 0.0 or force < 0.0
        values[k, col.B_LEAST] = -max(lower, 0.0) / dt - (lean if at_lower else 0.0)
        values[k, col.B_MOST] = max(upper, 0.0) / dt - (lean if at_upper else 0.0)
        values[k, col.B_LEAN] = lean if at_lower or at_upper else 0.0
    values[k, col.B_LARGEST] = largest
    if values[k, col.B_WEIGHT] == 0.0:
        values[k, col.B_LARGEST] = values[k, col.B_RESTITUTION] = 0.0
    values[k, col.B_SLOW] += col.REST_KICKS * abs(after - before) + _REST_RATE_SHARE * abs(after)
    values[k, col.B_IMPULSE], values[k, col.B_IMPACT] = dt * values[k, col.B_FORCE], 0.0


# What the solver does with them


@inline
def warm_start_bounded(bounded: Bounded, velocity: Floats) -> None:
    """Take the forces of the step before."""
    for k in range(bounded.kind.size):
        r = within(bounded.values, k, bounded.values[k, col.B_IMPULSE])
        if r > 0.0 and bounded.values[k, col.B_LEAST] == -math.inf:
            r = 0.0
        if r < 0.0 and bounded.values[k, col.B_MOST] == math.inf:
            r = 0.0
        bounded.values[k, col.B_IMPULSE] = r
        push_along(bounded, velocity, k, r)


@inline
def sweep_bounded(bounded: Bounded, velocity: Floats) -> float:
    """One step of each row; the sum of all squared changes [(N s)²]."""
    values, changed = bounded.values, 0.0
    for k in range(bounded.kind.size):
        old = values[k, col.B_IMPULSE]
        values[k, col.B_OLD] = old
        r = _nearest(values, k, rate_along(bounded, velocity, k))
        if r != old:
            values[k, col.B_IMPULSE] = r
            push_along(bounded, velocity, k, r - old)
        changed += values[k, col.B_WEIGHT] * (r - old) * (r - old)
    return changed


@inline
def mix_bounded(bounded: Bounded, velocity: Floats, beta: float, is_last: bool) -> None:
    """Go on along the direction of before: see `solver`."""
    values = bounded.values
    for k in range(bounded.kind.size):
        change = values[k, col.B_IMPULSE] - values[k, col.B_OLD]
        on = beta * values[k, col.B_DIRECTION]
        if not is_last and on != 0.0:
            values[k, col.B_IMPULSE] += on
            push_along(bounded, velocity, k, on)
        values[k, col.B_DIRECTION] = on + change


@inline
def miss_of_bounded(bounded: Bounded, velocity: Floats) -> Vec3:
    """Squares of how far these are from a solution [(N s)², (m/s)²], and of their size [(N s)²]."""
    off, left, size, values = 0.0, 0.0, 0.0, bounded.values
    for k in range(bounded.kind.size):
        miss = values[k, col.B_IMPULSE] - _nearest(values, k, rate_along(bounded, velocity, k))
        square = values[k, col.B_WEIGHT] * miss * miss
        off += square
        left += inverse_of(values, k) ** 2 * square
        size += values[k, col.B_WEIGHT] * values[k, col.B_IMPULSE] ** 2
    return off, left, size


@inline
def scales_of_bounded(bounded: Bounded, velocity: Floats) -> Vec3:
    """Squares for `solver.Scales`, the speed first: shares of what is slow, and of all terms."""
    size, off, left, values = 0.0, 0.0, 0.0, bounded.values
    for k in range(bounded.kind.size):
        u, inverse = rate_along(bounded, velocity, k), values[k, col.B_INVERSE]
        miss = max(values[k, col.B_LEAST] - u, u - values[k, col.B_MOST], 0.0)
        miss = min(miss, values[k, col.B_LARGEST] * inverse)
        least, by = FLOOR_SHARE * values[k, col.B_SLOW], 0.0
        for i in range(6):
            by += abs(bounded.gradient[k, i] * velocity[bounded.partner_a[k], i])
            by += abs(bounded.gradient[k, 6 + i] * velocity[bounded.partner_b[k], i])
        by *= ROUNDING
        if values[k, col.B_WEIGHT] > 0.0:
            size += (miss * miss + least * least) / values[k, col.B_WEIGHT]
            off += values[k, col.B_WEIGHT] * (by / inverse) ** 2
            left += by * by / values[k, col.B_WEIGHT]
    return size, off, left


@inline
def push_by_bounded(bounded: Bounded, velocity: Floats) -> None:
    """Change velocities by all of these impulses."""
    for k in range(bounded.kind.size):
        push_along(bounded, velocity, k, bounded.values[k, col.B_IMPULSE])


@inline
def _give(bounded: Bounded, momenta: Floats, k: int, r: float) -> None:
    """Give momenta: an impulse along row k."""
    for i in range(6):
        momenta[bounded.partner_a[k], i] += r * bounded.gradient[k, i]
        momenta[bounded.partner_b[k], i] += r * bounded.gradient[k, 6 + i]


@inline
def give_bounded(bounded: Bounded, momenta: Floats) -> None:
    """Give the momenta of all of these impulses."""
    for k in range(bounded.kind.size):
        _give(bounded, momenta, k, bounded.values[k, col.B_IMPULSE])


@inline
def keep_best_bounded(bounded: Bounded, goes_back: bool) -> None:
    """Keep these impulses, or go back to those that are kept."""
    here, there = (col.B_BEST, col.B_IMPULSE) if goes_back else (col.B_IMPULSE, col.B_BEST)
    for k in range(bounded.kind.size):
        bounded.values[k, there] = bounded.values[k, here]


@inline
def keep_bounded(bounded: Bounded, dt: float, is_whole: bool) -> None:
    """Keep the impulses of a step of dt [s] as forces: to be shown, and for the next whole one."""
    values = bounded.values
    for k in range(bounded.kind.size):
        values[k, col.B_SHOWN] = (values[k, col.B_IMPULSE] + values[k, col.B_IMPACT]) / dt
        if is_whole:
            values[k, col.B_FORCE] = values[k, col.B_IMPULSE] / dt


# Stops that bounce


@inline
def _approach(values: Floats, k: int, u: float) -> tuple[float, float]:
    """Gap of the stop of row k that the rate u leads to, and the speed towards it."""
    return (values[k, col.B_GAP], -u) if u < 0.0 else (values[k, col.B_GAP + 1], u)


@inline
def time_since_stop(bounded: Bounded, velocity: Floats, k: int) -> float:
    """Since when row k is beyond its stop [s], if it goes on there and is to bounce; else -1."""
    values, u = bounded.values, rate_along(bounded, velocity, k)
    gap, speed = _approach(values, k, u)
    if values[k, col.B_RESTITUTION] > 0.0 and gap <= 0.0 and speed > values[k, col.B_SLOW]:
        return -gap / speed
    return -1.0


@inline
def bounce_at_stop(bounded: Bounded, partners: Partners, k: int) -> bool:
    """Let row k bounce, if it is still to: u⁺ = -e u⁻; whether it did."""
    if time_since_stop(bounded, partners.velocity, k) < 0.0:
        return False
    u, values = rate_along(bounded, partners.velocity, k), bounded.values
    r = -(1.0 + values[k, col.B_RESTITUTION]) * u / values[k, col.B_INVERSE]
    push_along(bounded, partners.velocity, k, r)
    _give(bounded, partners.impulse, k, r)
    values[k, col.B_IMPACT] += r
    return True


@inline
def leave_out_stops(bounded: Bounded, velocity: Floats) -> None:
    """Leave out stops that are not met yet, and will bounce when they are."""
    values = bounded.values
    for k in range(bounded.kind.size):
        u = rate_along(bounded, velocity, k)
        gap, speed = _approach(values, k, u)
        if values[k, col.B_RESTITUTION] > 0.0 and gap > 0.0 and speed > values[k, col.B_SLOW]:
            values[k, col.B_LEAST if u < 0.0 else col.B_MOST] = -math.inf if u < 0.0 else math.inf
