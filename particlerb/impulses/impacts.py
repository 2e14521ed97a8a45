"""Restitution, by impacts one after the other: Newton's law u⁺ = -e u⁻ with Coulomb's friction.

Contacts that touch and approach faster than what their forces give in two steps bounce, stops of
joints too, the one first that closed first by its speed of now; again and again until none is left.
So a hit runs through a row of balls, whatever their masses, and the order of the bodies does not
matter. Friction can make a single impact gain energy where e > 0; then e is halved for this impact,
and it gains none. What closes at the same time on several sides is resolved one after the other
too: the result does not change from run to run, but it need not have the symmetry of the hit.

Sources: Kane and Levinson, Dynamics (1985), for impacts that gain energy; Moreau, Unilateral
contact and dry friction in finite freedom dynamics (1988), for restitution in time stepping.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded import bounce_at_stop, time_since_stop
from particlerb.impulses.cone import impulse_alone
from particlerb.impulses.records import Impulses
from particlerb.impulses.rolling import bounce_rolling
from particlerb.impulses.rows import approach, change_by, give
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot

_MAX_PASSES: Final = 20  # over all contacts
_MIN_CONTACTS_COUNTED: Final = 1000  # with fewer there are as many visits as of so many
_MAX_HALVINGS: Final = 6  # of a restitution that would gain energy; then it is 0
_WORK_ROUNDING: Final = 1e-14


@inline
def _changed(frame: Floats, k: int, u: Vec3, r: Vec3) -> Vec3:
    """u + W r of contact k."""
    w, a1, a2 = frame[k, col.INVERSE], frame[k, col.COUPLING], frame[k, col.COUPLING + 1]
    mixed = a1 * a2 / w
    return (
        u[0] + w * r[0] + a1 * r[1] + a2 * r[2],
        u[1] + a1 * r[0] + (frame[k, col.SCHUR] + a1 * a1 / w) * r[1] + mixed * r[2],
        u[2] + a2 * r[0] + mixed * r[1] + (frame[k, col.SCHUR + 1] + a2 * a2 / w) * r[2],
    )


@inline
def impact(frame: Floats, k: int, u: Vec3, restitution: float) -> Vec3:
    """Impulse [N s] along n, t₁, t₂ of an impact of contact k that approaches with u [m/s]."""
    e = restitution
    for left in range(_MAX_HALVINGS, -1, -1):
        r = impulse_alone(frame, k, u, -e * u[0])
        work = dot(r, add_scaled(1.0, u, _changed(frame, k, u, r)))
        if work <= _WORK_ROUNDING * abs(r[0] * u[0]):
            break
        e = 0.5 * e if left > 1 else 0.0
    return r


@inline
def _find_impacts(impulses: Impulses) -> int:
    """Find what touches and approaches, and for how long [s]; how many there are.

    Contacts have their numbers, stops ~k.
    """
    rules, partners, rows, count, _, _ = impulses
    limits, order, n = rows.limits, rows.order, 0
    for k in range(count[0]):
        if limits[k, col.GAP] > rules.slop or limits[k, col.RESTITUTION] == 0.0:
            continue
        speed = -approach(partners, rows, k)[0]
        if speed > limits[k, col.SLOW]:
            order[n, 0], order[n, 1] = -limits[k, col.GAP] / speed, k
            n += 1
    if rows.bounded is not None:
        for k in range(rows.bounded.kind.size):
            order[n, 0], order[n, 1] = time_since_stop(rows.bounded, partners.velocity, k), ~k
            n += order[n, 0] >= 0.0
    return n


@inline
def _put_first_first(order: Floats, n: int) -> None:
    """Sort n rows, the largest first, by Shell's method."""
    step = n // 2
    while step > 0:
        for i in range(step, n):
            time, index, j = order[i, 0], order[i, 1], i
            while j >= step and order[j - step, 0] < time:
                order[j, 0], order[j, 1] = order[j - step, 0], order[j - step, 1]
                j -= step
            order[j, 0], order[j, 1] = time, index
        step //= 2


@inline
def _bounce(impulses: Impulses, k: int) -> bool:
    """Let contact k bounce, if it still approaches; whether it did."""
    _, partners, rows, _, _, _ = impulses
    u = approach(partners, rows, k)
    if u[0] >= -rows.limits[k, col.SLOW]:
        return False
    r = impact(rows.frame, k, u, rows.limits[k, col.RESTITUTION])
    change_by(partners, rows, k, r)
    give(partners, rows, k, r)
    bounce_rolling(partners, rows, k, r[0])
    for i in range(3):
        rows.impact[k, i] += r[i]
    return True


@kernel
def take_impacts(impulses: Impulses) -> None:
    """Let contacts bounce, and give momenta."""
    tally, order, m = impulses.tally, impulses.rows.order, impulses.counts[0]
    bounded = impulses.rows.bounded
    for _ in range(max(_MAX_PASSES, _MAX_PASSES * _MIN_CONTACTS_COUNTED // max(m, 1))):
        n = _find_impacts(impulses)
        if n == 0:
            return
        _put_first_first(order, n)
        for i in range(n):
            k = int(order[i, 1])
            if k >= 0:
                tally[col.IMPACTS] += _bounce(impulses, k)
            elif bounded is not None:
                tally[col.IMPACTS] += bounce_at_stop(bounded, impulses.partners, ~k)
    tally[col.UNENDED] += 1.0
