"""One step of DOP853 for bodies side by side: stages, error estimate, dense output.

The bodies' vectors lie in flat arrays: number c of body b is y[c * w + b], and K has a row of all
of them for every stage.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), section
II.10; coefficients in dop853_table.py.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.forces.kernels import Acting, set_time
from particlerb.forces.registry import STAGE
from particlerb.integrators.dop853_table import END, N_STAGES, D, E
from particlerb.integrators.slopes import pose, put_pose, slopes
from particlerb.maths.quaternion import matrix_along
from particlerb.maths.vec3 import Floats
from particlerb.model.block import CHANGING, INV_INERTIA, INV_MASS, Q, get, get3, put, put3
from particlerb.model.load import STATE_ROWS

_MIN_STEP_FACTOR, _MAX_STEP_FACTOR, _SAFETY_FACTOR = 0.2, 5.0, 0.9  # as the authors take them
_STEP_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of what a step computes
LEAST_STEP: Final = 1e-14  # relative to the time: below it nothing moves any more


class Equations(NamedTuple):
    """What is integrated, and how well."""

    acting: Acting
    sums_external: Flag  # whether external work is summed
    tolerance: float


class Pack(NamedTuple):
    """Bodies of a block, at both ends of a step."""

    rows: Floats  # of a block: constants of the bodies and of the forces
    n: int
    w: int  # n or more
    y: Floats  # states at the start of the step
    new: Floats  # at its end


@kernel
def take_slopes(
    equations: Equations, rows: Floats, n: int, w: int, t: float, y: Floats, slope: Floats
) -> None:
    """Slopes of a pack in the states y at a time [s] since the segment began."""
    acting = equations.acting
    set_time(acting, rows, n, t)
    for c in range(STATE_ROWS):
        for b in range(n):
            put(rows, STAGE + c, b, y[c * w + b])
    for b in range(n):
        now = pose(rows, b, STAGE)
        rate, (power, force, turning) = slopes(acting, rows, b, now, matrix_along(now.q))
        put_pose(rows, b, rate, STAGE + CHANGING)
        if equations.sums_external is not None:
            put(rows, STAGE + CHANGING + 13, b, power)
            put3(rows, STAGE + CHANGING + 14, b, force)
            put3(rows, STAGE + CHANGING + 17, b, turning)
    for c in range(y.size // w):
        for b in range(n):
            slope[c * w + b] = get(rows, STAGE + CHANGING + c, b)


@kernel
def add_rows(h: float, weights: Floats, K: Floats, count: int, out: Floats) -> None:
    """out ← out + h Σ w_k K_k over the first rows of K (stages, size): four at a time.

    So `out` (size,) is loaded less often.
    """
    k = 0
    while k + 4 <= count:
        a, b, c, d = (h * weights[k], h * weights[k + 1], h * weights[k + 2], h * weights[k + 3])
        p, q, r, s = K[k], K[k + 1], K[k + 2], K[k + 3]
        for i in range(out.size):
            out[i] += (a * p[i] + b * q[i]) + (c * r[i] + d * s[i])
        k += 4
    while k < count:
        a, p = h * weights[k], K[k]
        for i in range(out.size):
            out[i] += a * p[i]
        k += 1


@inline
def _larger(pack: Pack, lo: int, hi: int, b: int) -> float:
    """Length of numbers lo to hi of body b, at the start of the step or at its end."""
    old_size, new_size = 0.0, 0.0
    for c in range(lo, hi):
        old_size += pack.y[c * pack.w + b] ** 2
        new_size += pack.new[c * pack.w + b] ** 2
    return math.sqrt(max(old_size, new_size))


@inline
def _displacement(pack: Pack, b: int) -> float:
    """Of the centre of mass of body b in a step [m]."""
    square = 0.0
    for c in range(3):
        square += (pack.new[c * pack.w + b] - pack.y[c * pack.w + b]) ** 2
    return math.sqrt(square)


@inline
def _largest_moment(rows: Floats, b: int) -> float:
    """Largest principal moment of body b [kg m²]; 0 for a point."""
    least = np.inf
    for inverse in get3(rows, INV_INERTIA, b):
        if inverse > 0.0:
            least = min(least, inverse)
    return 1.0 / least


@inline
def _scales_of(pack: Pack, b: int, h: float, tolerance: float) -> tuple[float, float, float, float]:
    """What errors of x, q, p and L of body b are relative to.

    For x the larger of displacement and radius of gyration, for p and L their lengths. Where a body
    comes to rest all of these are rounding, of positions and so of the forces that hold it: none
    is taken for smaller than what rounding makes of it in a step.
    """
    noise = _STEP_ROUNDING / tolerance
    mass, moment = 1.0 / get(pack.rows, INV_MASS, b), _largest_moment(pack.rows, b)
    size, distance = math.sqrt(moment / mass), _larger(pack, 0, 3, b)
    x = max(_displacement(pack, b), size, noise * distance)
    p = max(_larger(pack, 7, 10, b), noise * mass * max(x, distance) / h)
    return x, 1.0, p, max(_larger(pack, 10, 13, b), noise * moment / h)


@kernel
def differences(K: Floats, five: Floats, three: Floats) -> None:
    """Differences (size,) from the embedded results of orders 5 and 3, by slopes (stages, size)."""
    five[:], three[:] = 0.0, 0.0
    add_rows(1.0, E[0], K, END, five)
    add_rows(1.0, E[1], K, END, three)


@kernel
def errors_of(
    pack: Pack, five: Floats, three: Floats, h: float, tolerance: float, errors: Floats
) -> float:
    """Write the error of each body (w,) over the tolerance; the largest of those that live.

    A body that is not a number any more has no say in the steps of the others.
    """
    worst, w = 0.0, pack.w
    for b in range(pack.n):
        sum5, sum3 = 0.0, 0.0
        scales = _scales_of(pack, b, h, tolerance)
        for (lo, hi), scale in zip(((0, 3), (3, 7), (7, 10), (10, 13)), scales):  # noqa: B905
            for c in range(lo, hi):
                e5, e3 = five[c * w + b], three[c * w + b]
                if e5 != 0.0 or e3 != 0.0:
                    sum5 += (e5 / scale) ** 2
                    sum3 += (e3 / scale) ** 2
        errors[b] = 0.0
        if sum5 != 0.0:
            errors[b] = abs(h) * sum5 / math.sqrt((sum5 + 0.01 * sum3) * 13.0) / tolerance
        if worst <= np.inf and not (np.isnan(pack.y[b]) or errors[b] <= worst):
            worst = errors[b]
    return worst


@inline
def normalise(values: Floats, n: int, w: int) -> None:
    """Make |q| = 1."""
    for b in range(n):
        norm = 0.0
        for c in range(Q, Q + 4):
            norm += values[c * w + b] ** 2
        for c in range(Q, Q + 4):
            values[c * w + b] /= math.sqrt(norm)


@inline
def factor_of(error: float) -> float:
    """By how much the next step is longer than the one with this error over the tolerance."""
    if error == 0.0:
        return _MAX_STEP_FACTOR
    if not error < np.inf:
        return _MIN_STEP_FACTOR
    most = _MAX_STEP_FACTOR if error < 1.0 else 1.0
    factor: float = _SAFETY_FACTOR * error ** (-1.0 / 8.0)
    return max(_MIN_STEP_FACTOR, min(most, factor))


@kernel
def interpolate(K: Floats, y: Floats, new: Floats, h: float, share: float, out: Floats) -> None:
    """State (size,) at a share of a step by the polynomial of order 7; |q| is not quite 1."""
    rest = 1.0 - share
    out[:] = 0.0
    for i in range(4):
        add_rows(h, D[3 - i], K, N_STAGES, out)
        for c in range(out.size):
            out[c] *= share if i % 2 == 0 else rest
    for c in range(out.size):
        change = new[c] - y[c]
        value = (out[c] + 2.0 * change - h * (K[END, c] + K[0, c])) * share
        value = (value + h * K[0, c] - change) * rest
        out[c] = y[c] + (value + change) * share
