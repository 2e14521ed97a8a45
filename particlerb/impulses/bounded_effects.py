"""What rows within bounds do beside the solve: push-out of stops, and the work of all."""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.impulses.bounded import push_along, rate_along
from particlerb.impulses.records import Bounded, Partners
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Bools, Floats, add_scaled, cross, dot, scale

_MAX_OVERRUN: Final = 1e-12  # [rad or m] what a stop may be overrun by


@inline
def find_overrun(bounded: Bounded, velocity: Floats, dt: float) -> bool:
    """Find by how much stops are overrun at the next middle of a step; whether any is."""
    values, is_overrun = bounded.values, False
    for k in range(bounded.kind.size):
        u = rate_along(bounded, velocity, k)
        comes = dt * (u + values[k, col.B_LEAN])
        lower, upper = values[k, col.B_GAP] + comes, values[k, col.B_GAP + 1] - comes
        parts, slow = u if lower < upper else -u, values[k, col.B_SLOW]
        is_left = values[k, col.B_LEAST] == -math.inf or values[k, col.B_MOST] == math.inf
        is_left |= parts > slow and values[k, col.B_IMPULSE] == 0.0
        is_left |= values[k, col.B_LARGEST] == 0.0
        gap = math.inf if is_left else min(lower, upper)
        values[k, col.B_OLD], values[k, col.B_SLOPE] = 0.0, gap
        values[k, col.B_CHANGE] = 1.0 if lower < upper else -1.0
        is_overrun = is_overrun or gap < -_MAX_OVERRUN
    return is_overrun


@inline
def push_back_from_stops(bounded: Bounded, move: Floats, has_moved: Bools, share: float) -> None:
    """Moves that take away a share of that."""
    values = bounded.values
    for k in range(bounded.kind.size):
        gap, sign = values[k, col.B_SLOPE], values[k, col.B_CHANGE]
        if gap == math.inf or (gap >= -_MAX_OVERRUN and not has_moved[bounded.partner_a[k]]):
            continue
        comes = sign * rate_along(bounded, move, k)
        push = values[k, col.B_OLD] - (share * gap + comes) / values[k, col.B_INVERSE]
        more = max(push, 0.0) - values[k, col.B_OLD]
        if more != 0.0:
            values[k, col.B_OLD] += more
            push_along(bounded, move, k, sign * more)
            for j in range(bounded.start[k], bounded.start[k + 1]):
                has_moved[bounded.member[j]] = True


# What they have done


@inline
def sum_works_along(bounded: Bounded, partners: Partners, tally: Floats) -> None:
    """Sum what these impulses have done, as `work` does for contacts."""
    values = bounded.values
    for k in range(bounded.kind.size):
        u = 0.5 * rate_along(bounded, partners.before, k)
        u += 0.5 * rate_along(bounded, partners.velocity, k)
        hit, pressed = values[k, col.B_IMPACT], values[k, col.B_IMPULSE]
        kinds = col.PRESSING_WORK, col.MOTOR_WORK, col.FRICTION_WORK
        tally[col.IMPACT_WORK] += hit * u
        tally[kinds[bounded.kind[k]]] += pressed * u
        moved = _sum_outside(bounded, partners, k, hit + pressed)
        tally[col.BOUNDARY_WORK] += moved
        mine = bounded.partner_a[k]
        if partners.inverse[mine, 0] == 0.0:
            mine = bounded.partner_b[k]
        partners.external[mine, 0] += (hit + pressed) * u + moved
        partners.external[mine, 7] += abs(hit * u) + abs(pressed * u) + abs(moved)


@inline
def _sum_outside(bounded: Bounded, partners: Partners, k: int, r: float) -> float:
    """Add what the world or a held body has given along row k; the work [J] of its motion."""
    a, b, gradient, moved = bounded.partner_a[k], bounded.partner_b[k], bounded.gradient, 0.0
    for mine, other, at, of in ((a, b, 0, 6), (b, a, 6, 0)):
        is_outside = a == b or partners.inverse[other, 0] == 0.0
        if not is_outside or partners.inverse[mine, 0] == 0.0:
            continue
        p, m = scale(r, row3(gradient, k, at)), scale(r, row3(gradient, k, at + 3))
        m = add_scaled(1.0, m, cross(row3(partners.position, mine), p))
        for i in range(3):
            partners.external[mine, 1 + i] += p[i]
            partners.external[mine, 4 + i] += m[i]
        moved -= r * dot(row3(gradient, k, of), row3(partners.velocity, other))
        moved -= r * dot(row3(gradient, k, of + 3), row3(partners.velocity, other, 3))
        break
    return moved
