"""Newton's method for what resists rolling and spinning: its parts of what newton.py does.

The disc is as wide as the normal impulse r_n makes it. So an angular impulse changes by

    dm = -c - K dω + q dr_n

with q across the edge of the disc where m is on it, and 0 inside. About the normal an interval is
in the place of the disc.
"""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses.records import ImpulseRows, Partners, Rolling
from particlerb.impulses.rolling import (
    ABOUT,
    ACROSS,
    on_the_disc,
    square_of,
    step_against,
    turning,
    turning_at_end,
)
from particlerb.impulses.rows import in_world
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Vec3, add, add_scaled, scale, subtract

_C, _K, _Q, _KN = 0, 3, 6, 9  # columns of `Rolling.slopes`: c; K_11, K_12, K_22; q; K_nn
_TORQUE_FLOOR: Final = 1e-300


@inline
def linearise_rolling(partners: Partners, rows: ImpulseRows, k: int, small: float) -> float:
    """Write c, K and q of contact k; the square of what it misses [(N s)²].

    The slope of P is 1 inside; on the edge g along it, and none across.
    """
    rolling = rows.rolling
    if rolling is None:
        return 0.0
    slopes, m = rolling.slopes, row3(rolling.impulse, k)
    n, limit, full = max(rows.impulse[k, 0], 0.0), rolling.limit, 1.0 + small
    z = add(m, step_against(rolling, k, turning_at_end(rolling, partners, rows, k)))
    f = subtract(m, on_the_disc(rolling, k, z, n))
    share, radius = 1.0 / limit[k, ACROSS + 1], limit[k, ACROSS] * n
    size = max(math.sqrt(z[1] * z[1] + z[2] * z[2]), _TORQUE_FLOOR)
    if abs(z[0]) <= limit[k, ABOUT] * n:
        c, slopes[k, _KN], q = f[0] / small, 1.0 / (small * limit[k, ABOUT + 1]), 0.0
    else:
        c, slopes[k, _KN], q = f[0] / full, 0.0, math.copysign(limit[k, ABOUT] / full, z[0])
    if size <= radius:
        put_row3(slopes, k, (c, f[1] / small, f[2] / small), _C)
        put_row3(slopes, k, (share / small, 0.0, share / small), _K)
        put_row3(slopes, k, (q, 0.0, 0.0), _Q)
    else:
        x, y, g = z[1] / size, z[2] / size, radius / size
        along = (f[2] * x - f[1] * y) / (full - g)
        out, stiff = (f[1] * x + f[2] * y) / full, share * g / (full - g)
        put_row3(slopes, k, (c, out * x - along * y, out * y + along * x), _C)
        put_row3(slopes, k, (stiff * y * y, -stiff * x * y, stiff * x * x), _K)
        wider = limit[k, ACROSS] / full
        put_row3(slopes, k, (q, wider * x, wider * y), _Q)
    return square_of(rolling, rows, k, f)


@inline
def _change(rolling: Rolling, k: int, omega: Vec3, dn: float) -> Vec3:
    """K dω - q dr_n of contact k, with dω along n, t₁, t₂."""
    (k11, k12, k22), kn = row3(rolling.slopes, k, _K), rolling.slopes[k, _KN]
    by = (kn * omega[0], k11 * omega[1] + k12 * omega[2], k12 * omega[1] + k22 * omega[2])
    return add_scaled(-dn, row3(rolling.slopes, k, _Q), by)


@inline
def rolling_by(rows: ImpulseRows, k: int, omega: Vec3, dn: float) -> Vec3:
    """K dω - q dr_n of contact k in world axes, with dω in its frame."""
    rolling = rows.rolling
    if rolling is None:
        return ZERO
    return in_world(rows.frame, k, _change(rolling, k, omega, dn))


@inline
def rolling_c(rows: ImpulseRows, k: int, dn: float) -> Vec3:
    """-c + q dr_n of contact k in world axes."""
    rolling = rows.rolling
    if rolling is None:
        return ZERO
    c, q = row3(rolling.slopes, k, _C), row3(rolling.slopes, k, _Q)
    return in_world(rows.frame, k, subtract(scale(dn, q), c))


@inline
def solve_rolling(partners: Partners, rows: ImpulseRows, k: int) -> None:
    """Find the step of contact k from the moves of its partners and the step of its impulse."""
    rolling = rows.rolling
    if rolling is None:
        return
    by = _change(rolling, k, turning(partners.move, rows, k), rows.direction[k, 0])
    put_row3(rolling.direction, k, scale(-1.0, add(row3(rolling.slopes, k, _C), by)))
    put_row3(rolling.old, k, row3(rolling.impulse, k))


@inline
def step_rolling(rows: ImpulseRows, k: int, share: float) -> None:
    """Take a share of that step; with 0, go back to where it began."""
    rolling = rows.rolling
    if rolling is not None:
        m = add_scaled(share, row3(rolling.direction, k), row3(rolling.old, k))
        put_row3(rolling.impulse, k, m)
