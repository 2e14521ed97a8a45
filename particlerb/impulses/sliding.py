"""Friction of what keeps sliding or rolling: opposite to the mean velocity of a step.

Impulses of the step before tell, all together, how velocities will change in this one, but for an
error of order h². Where that is less than half of a slip, it continues, and half of its turn is
taken back in what the solve asks for: the direction is that of the mean of both drifts, and the
order 2. Only the turn is: what ends nevertheless is not thrown back along where it came from.
"""

import math
from typing import Final

from particlerb.compiled.barrier import Team, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.impulses import records as col
from particlerb.impulses.records import ImpulseRows, Impulses, Partners, Rolling
from particlerb.impulses.rolling import ACROSS, DRIVEN, turning
from particlerb.impulses.rows import approach, in_frame, velocity_between
from particlerb.maths.vec3 import Floats, Vec3

_MOST_CHANGED: Final = 0.5  # of a slip in a step: with more it may end
_LEAST_SLIP_SHARE: Final = 0.01  # of what approaches without bouncing: with less it sticks
_LEAST_RUBBING_SHARE: Final = 0.5  # of the bound: as normals turn, what slides is not quite there


@inline
def _take_half_turn_back(
    lean: Floats, k: int, at: int, came: Vec3, now: Vec3, least: float
) -> None:
    """Write half of what turns a slip of more than `least` across n, negative, if it continues."""
    x, y = now[1] - came[1], now[2] - came[2]
    square = came[1] * came[1] + came[2] * came[2]
    if square > max(least * least, (x * x + y * y) / (_MOST_CHANGED * _MOST_CHANGED)):
        turn = 0.5 * (came[1] * y - came[2] * x) / square
        lean[k, at + 1], lean[k, at + 2] = turn * came[2], -turn * came[1]


@inline
def _let_roll_on(
    rolling: Rolling | None, partners: Partners, rows: ImpulseRows, k: int, n: float, least: float
) -> None:
    """The same for what rolls, with n and `least` as there."""
    if rolling is None:
        return
    m, limit = rolling.impulse, rolling.limit
    if math.hypot(m[k, 1], m[k, 2]) > limit[k, ACROSS] * n:
        came, now = turning(partners.before, rows, k), turning(partners.velocity, rows, k)
        _take_half_turn_back(limit, k, DRIVEN, came, now, least / rows.limits[k, col.RADIUS])


@kernel
def let_slide_on(impulses: Impulses, team: Team) -> None:
    """Take half of a turn back in contacts that slide; velocities are those of a warm start.

    Not in contacts of a body which something joins that bore nothing before (`has_moved`).
    """
    partners, rows, before = impulses.partners, impulses.rows, impulses.partners.before
    first, end = share_of(team, 0, impulses.counts[0])
    for k in range(first, end):
        a, b, r = rows.partner_a[k], rows.partner_b[k], rows.impulse
        n, least = _LEAST_RUBBING_SHARE * r[k, 0], _LEAST_SLIP_SHARE * rows.limits[k, col.SLOW]
        if n <= 0.0 or partners.has_moved[a] or partners.has_moved[b]:
            continue
        if r[k, 1] * r[k, 1] + r[k, 2] * r[k, 2] > (rows.frame[k, col.FRICTION] * n) ** 2:
            came = in_frame(rows.frame, k, velocity_between(before, rows.frame, k, a, b))
            now = approach(partners, rows, k)
            _take_half_turn_back(rows.limits, k, col.LEAN, came, now, least)
        _let_roll_on(rows.rolling, partners, rows, k, n, least)
