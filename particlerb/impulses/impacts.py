"""Restitution, by impacts one after the other: Newton's law u⁺ = -e u⁻ with Coulomb's friction.

Contacts that touch and approach faster than what their forces give in two steps bounce in the order
of the list, again and again until none is left. So a hit runs through a row of balls, whatever
their masses. Friction can make a single impact gain energy where e > 0; then e is halved for this
impact, and it gains none. What hits at the same time from several sides is resolved in this order
too: the result does not change from run to run, but it need not have the symmetry of the hit.

Sources: Kane and Levinson, Dynamics (1985), for impacts that gain energy; Moreau, Unilateral
contact and dry friction in finite freedom dynamics (1988), for restitution in time stepping.
"""

from typing import Final

from particlerb.compiled.jit import inline, lean_kernel
from particlerb.impulses.bounded import bounce_at_stops
from particlerb.impulses.cone import impulse_alone
from particlerb.impulses.records import (
    COUPLING,
    GAP,
    IMPACTS,
    INVERSE,
    RESTITUTION,
    SCHUR,
    SLOW,
    UNENDED,
    Bounded,
    Impulses,
)
from particlerb.impulses.rows import approach, change_by, give
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot

_PASSES: Final = 20  # over all contacts, at most
_HALVINGS: Final = 6  # of a restitution that would gain energy; then it is 0
_ROUNDING: Final = 1e-14


@inline
def _changed(frame: Floats, k: int, u: Vec3, r: Vec3) -> Vec3:
    """u + W r of contact k."""
    w, a1, a2 = frame[k, INVERSE], frame[k, COUPLING], frame[k, COUPLING + 1]
    both = a1 * a2 / w
    return (
        u[0] + w * r[0] + a1 * r[1] + a2 * r[2],
        u[1] + a1 * r[0] + (frame[k, SCHUR] + a1 * a1 / w) * r[1] + both * r[2],
        u[2] + a2 * r[0] + both * r[1] + (frame[k, SCHUR + 1] + a2 * a2 / w) * r[2],
    )


@inline
def impact(frame: Floats, k: int, u: Vec3, restitution: float) -> Vec3:
    """Impulse [N s] along n, t₁, t₂ of an impact of contact k that approaches with u [m/s]."""
    e = restitution
    for left in range(_HALVINGS, -1, -1):
        r = impulse_alone(frame, k, u, -e * u[0])
        work = dot(r, add_scaled(1.0, u, _changed(frame, k, u, r)))
        if work <= _ROUNDING * abs(r[0] * u[0]):
            break
        e = 0.5 * e if left > 1 else 0.0
    return r


@lean_kernel
def take_impacts(impulses: Impulses, bounded: Bounded | None) -> None:
    """Let contacts bounce, and give momenta."""
    _, partners, rows, count, tally, _ = impulses
    frame, limits = rows.frame, rows.limits
    for _ in range(_PASSES):
        hits = 0
        for k in range(count[0]):
            if limits[k, GAP] > 0.0 or limits[k, RESTITUTION] == 0.0:
                continue
            u = approach(partners, rows, k)
            if u[0] >= -limits[k, SLOW]:
                continue
            r = impact(frame, k, u, limits[k, RESTITUTION])
            change_by(partners, rows, k, r)
            give(partners, rows, k, r)
            for i in range(3):
                rows.impact[k, i] += r[i]
            hits += 1
        if bounded is not None:
            hits += bounce_at_stops(bounded, partners)
        tally[IMPACTS] += hits
        if hits == 0:
            return
    tally[UNENDED] += 1.0
