"""Restitution, by impacts one after the other: Newton's law u⁺ = -e u⁻ with Coulomb's friction.

Contacts that touch and approach faster than what their forces give in two steps bounce, stops of
joints too, the one first that closed first by its speed of now; again and again until none is left.
So a hit runs through a row of balls, whatever their masses, and the order of the bodies does not
matter. What closed at the same time, to rounding, bounces at once: u⁺ >= -e u⁻, with impulses
only where u⁺ = -e u⁻. So what falls flat, or into a wedge, keeps the symmetry of the hit. Friction
can make an impact gain energy where e > 0; then e is halved for this contact, and it gains none.

Sources: Kane and Levinson, Dynamics (1985), for impacts that gain energy; Moreau, Unilateral
contact and dry friction in finite freedom dynamics (1988), for restitution in time stepping.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.bounded import bounce_at_stop, time_since_stop
from particlerb.impulses.cone import impulse_alone
from particlerb.impulses.records import ImpulseRows, Impulses, Partners
from particlerb.impulses.rolling import bounce_rolling
from particlerb.impulses.rows import approach, change_by, give
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add_scaled, dot, scale, subtract

_MAX_PASSES: Final = 20  # over all contacts
_MIN_CONTACTS_COUNTED: Final = 1000  # with fewer there are as many visits as of so many
_MAX_HALVINGS: Final = 6  # of a restitution that would gain energy; then it is 0
_WORK_ROUNDING: Final = 1e-14
_INSTANT_SHARE: Final = 1e-6  # of the slop: gaps that differ by less closed at the same time
_AT_ONCE: Final = 300  # steps of impacts at once
_AT_ONCE_TOLERANCE: Final = 1e-15  # relative change of their impulses that ends them
_AT_ONCE_ROUNDING: Final = 1e-12  # of their work

# Columns of `ImpulseRows.order`
_SINCE: Final = 0  # [s] when it closed; restitution of impacts at once
_WHICH: Final = 1
_CAME: Final = 2  # velocity [m/s] along n, t₁, t₂
_CHANGE: Final = 5  # of the impulse [N s]
_SHARE: Final = 8  # of it that is taken: one over the number of impacts of the body that has most


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
            order[n, _SINCE], order[n, _WHICH] = -limits[k, col.GAP] / speed, k
            n += 1
    if rows.bounded is not None:
        for k in range(rows.bounded.kind.size):
            order[n, _SINCE], order[n, _WHICH] = (
                time_since_stop(rows.bounded, partners.velocity, k),
                ~k,
            )
            n += order[n, _SINCE] >= 0.0
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
def _keep_impact(partners: Partners, rows: ImpulseRows, k: int, r: Vec3) -> bool:
    """Give momenta of an impact that has changed velocities, and resist rolling."""
    give(partners, rows, k, r)
    bounce_rolling(partners, rows, k, r[0])
    for i in range(3):
        rows.impact[k, i] += r[i]
    return r[0] > 0.0


@inline
def _bounce(impulses: Impulses, k: int) -> bool:
    """Let contact k bounce, if it still approaches; whether it did."""
    _, partners, rows, _, _, _ = impulses
    u = approach(partners, rows, k)
    if u[0] >= -rows.limits[k, col.SLOW]:
        return False
    r = impact(rows.frame, k, u, rows.limits[k, col.RESTITUTION])
    change_by(partners, rows, k, r)
    return _keep_impact(partners, rows, k, r)


@inline
def _end_of_instant(impulses: Impulses, first: int, n: int) -> int:
    """Behind the last row of the order that closed when the first one did."""
    rules, partners, rows, _, _, _ = impulses
    order, k = rows.order, int(rows.order[first, _WHICH])
    if first + 1 == n or k < 0:
        return first + 1
    speed = -approach(partners, rows, k)[0]
    if speed <= rows.limits[k, col.SLOW]:
        return first + 1
    least, end = order[first, _SINCE] - _INSTANT_SHARE * rules.slop / speed, first + 1
    while end < n and order[end, _WHICH] >= 0.0 and order[end, _SINCE] >= least:
        end += 1
    return end


@inline
def _step_at_once(impulses: Impulses, first: int, end: int) -> bool:
    """A share of what each impact alone would still give; whether that changes anything."""
    _, partners, rows, _, _, _ = impulses
    order, changed, size = rows.order, 0.0, 0.0
    for i in range(first, end):
        k = int(order[i, _WHICH])
        r, least = row3(rows.old, k), -order[i, _SINCE] * order[i, _CAME]
        alone = _changed(rows.frame, k, approach(partners, rows, k), scale(-1.0, r))
        change = subtract(impulse_alone(rows.frame, k, alone, least), r)
        put_row3(order, i, scale(order[i, _SHARE], change), _CHANGE)
        changed, size = changed + dot(change, change), size + dot(r, r)
    if changed <= _AT_ONCE_TOLERANCE * _AT_ONCE_TOLERANCE * size:
        return False
    for i in range(first, end):
        k, change = int(order[i, _WHICH]), row3(order, i, _CHANGE)
        put_row3(rows.old, k, add_scaled(1.0, change, row3(rows.old, k)))
        change_by(partners, rows, k, change)
    return True


@inline
def _gain_none(impulses: Impulses, first: int, end: int, is_last: bool) -> bool:
    """Halve the restitution of contacts that have gained energy, at last to 0; whether none has."""
    _, partners, rows, _, _, _ = impulses
    order, gain_none = rows.order, True
    for i in range(first, end):
        k, came = int(order[i, _WHICH]), row3(order, i, _CAME)
        r = row3(rows.old, k)
        work = dot(r, add_scaled(1.0, came, approach(partners, rows, k)))
        if work > _AT_ONCE_ROUNDING * abs(r[0] * came[0]) and order[i, _SINCE] > 0.0:
            order[i, _SINCE] = 0.0 if is_last else 0.5 * order[i, _SINCE]
            gain_none = False
    return gain_none


@inline
def _bounce_at_once(impulses: Impulses, first: int, end: int) -> int:
    """Let rows of the order bounce at once; how many did.

    Jacobi's method with exact steps: no contact is before another.
    """
    _, partners, rows, _, _, _ = impulses
    order, move = rows.order, partners.move
    for i in range(first, end):
        k = int(order[i, _WHICH])
        order[i, _SINCE] = rows.limits[k, col.RESTITUTION]
        put_row3(order, i, approach(partners, rows, k), _CAME)
        put_row3(rows.old, k, ZERO)
        move[rows.partner_a[k], 0] = move[rows.partner_b[k], 0] = 0.0
    for i in range(first, end):
        k = int(order[i, _WHICH])
        for b in (rows.partner_a[k], rows.partner_b[k]):
            move[b, 0] += 1.0 if partners.inverse[b, 0] > 0.0 else 0.0
    for i in range(first, end):
        k = int(order[i, _WHICH])
        most = max(move[rows.partner_a[k], 0], move[rows.partner_b[k], 0])
        order[i, _SHARE] = 1.0 / (most if partners.mechanisms is None else end - first)
    for left in range(_MAX_HALVINGS, -1, -1):
        for _ in range(_AT_ONCE):
            if not _step_at_once(impulses, first, end):
                break
        if _gain_none(impulses, first, end, left <= 1):
            break
    n = 0
    for i in range(first, end):
        k = int(order[i, _WHICH])
        n += _keep_impact(partners, rows, k, row3(rows.old, k))
    return n


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
        end = 0
        while end < n:
            first, k = end, int(order[end, _WHICH])
            end = _end_of_instant(impulses, first, n)
            if end > first + 1:
                tally[col.IMPACTS] += _bounce_at_once(impulses, first, end)
            elif k >= 0:
                tally[col.IMPACTS] += _bounce(impulses, k)
            elif bounded is not None:
                tally[col.IMPACTS] += bounce_at_stop(bounded, impulses.partners, ~k)
    tally[col.UNENDED] += 1.0
