"""Where tops point at any time, block by block: the tables of rotors/tops.py, evaluated.

Orientation, angular momentum, and the work of the force since the axis was level with the centre,
in the rows of a block. All numbers are in two flat buffers, or LLVM would not vectorise the loop.
"""

import math

from particlerb.compiled.jit import inline, splice
from particlerb.maths.quaternion import Quat, multiply, to_world
from particlerb.maths.trig import cos_sin_half_turns, half_turns
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot
from particlerb.model.block import EXTERNAL, L, Q, get, get3, get4, put, put3, put4
from particlerb.rotors.lagrange import Pair
from particlerb.rotors.lagrange_forms import Five, Local, NearTop, ThetaTop, near_local, theta_local
from particlerb.rotors.tops import AXIAL, DELTA, LEFT, OWN


@inline
def _composed(
    local: Local, rates: Local, a: Vec3, b: Vec3, sign: float, left: Quat, of: Quat
) -> tuple[Quat, Vec3, float]:
    """q, L and -c u of local functions and their rates, turned by phases (cos, sin, sign).

    L_x + i L_y = 2A (α β̇ - β α̇), (T9); of: ν of β less that of α, A, L·z, c.
    """
    (f, g), (df, dg) = local, rates
    alpha, beta = f[0] * f[0] + f[1] * f[1], g[0] * g[0] + g[1] * g[1]
    inv = 1.0 / (alpha + beta)
    n = sign * math.sqrt(inv)
    s, r = a[2] * n, b[2] * n
    q = multiply(
        left,
        (
            s * (f[0] * a[0] - f[1] * a[1]),
            r * (g[0] * b[0] - g[1] * b[1]),
            r * (g[0] * b[1] + g[1] * b[0]),
            s * (f[0] * a[1] + f[1] * a[0]),
        ),
    )
    h = dg[0] - of[0] * g[1], dg[1] + of[0] * g[0]
    re = (f[0] * h[0] - f[1] * h[1]) - (g[0] * df[0] - g[1] * df[1])
    im = (f[0] * h[1] + f[1] * h[0]) - (g[0] * df[1] + g[1] * df[0])
    k = 2.0 * of[1] * inv * (a[2] * b[2])
    cos, sin = k * (a[0] * b[0] - a[1] * b[1]), k * (a[0] * b[1] + a[1] * b[0])
    momentum = to_world(left, (re * cos - im * sin, re * sin + im * cos, of[2]))
    return q, momentum, of[3] * ((beta - alpha) * inv)


@inline
def _get5(rows: Floats, at: int, b: int) -> Five:
    """Five numbers of body b from row `at` on."""
    x, y, z = get3(rows, at, b)
    return x, y, z, get(rows, at + 3, b), get(rows, at + 4, b)


@inline
def _put_turned(
    rows: Floats,
    b: int,
    t: float,
    local: Local,
    slopes: Local,
    sign: float,
    turns: Pair,
    out: Floats,
) -> None:
    """Write q, L and -c u of body b; slopes are by x, turns are phases beside the clock's."""
    _, rate, nu_a = get3(rows, 0, b)
    phase_a, nu_b, phase_b = get3(rows, 3, b)
    (f0, f1), (g0, g1) = slopes
    rates = (rate * f0, rate * f1), (rate * g0, rate * g1)
    u = cos_sin_half_turns(phase_a + (nu_a * t + turns[0]))
    v = cos_sin_half_turns(phase_b + (nu_b * t + turns[1]))
    left, of = get4(rows, LEFT, b), get4(rows, DELTA, b)
    q, momentum, work = _composed(local, rates, u, v, sign, left, of)
    axis = (
        2.0 * (q[1] * q[3] + q[0] * q[2]),
        2.0 * (q[2] * q[3] - q[0] * q[1]),
        (q[0] * q[0] + q[3] * q[3]) - (q[1] * q[1] + q[2] * q[2]),
    )
    momentum = add_scaled(get(rows, AXIAL, b) - dot(momentum, axis), axis, momentum)
    put4(out, Q, b, q)
    put3(out, L, b, momentum)
    put(out, EXTERNAL, b, work)


@splice
def _theta_rows(rows: Floats, t: float, n: int, out: Floats) -> None:
    """q(t), L(t) and -c u(t) of tops."""
    for b in range(n):
        cos, sin, sign = cos_sin_half_turns(get(rows, 0, b) + get(rows, 1, b) * t)
        alpha = _get5(rows, OWN, b), _get5(rows, OWN + 5, b)
        beta = _get5(rows, OWN + 10, b), _get5(rows, OWN + 15, b)
        local, slopes = theta_local(cos, sin, ThetaTop(alpha[0], alpha[1], beta[0], beta[1]))
        _put_turned(rows, b, t, local, slopes, sign, (0.0, 0.0), out)


@splice
def _near_rows(rows: Floats, t: float, n: int, out: Floats) -> None:
    """q(t), L(t) and -c u(t) of tops next to the separatrix."""
    for b in range(n):
        x, sign = half_turns(get(rows, 0, b) + get(rows, 1, b) * t)
        fall, r, kappa, c1, c3 = _get5(rows, OWN, b)
        c5, s1, s3, s5, c2 = _get5(rows, OWN + 5, b)
        c4, s2, s4, turn_a, turn_b = _get5(rows, OWN + 10, b)
        turns = turn_a, turn_b
        top = NearTop(fall, r, kappa, (c1, c3, c5), (s1, s3, s5), (c2, c4), (s2, s4), turns)
        local, slopes = near_local(x, top)
        _put_turned(rows, b, t, local, slopes, sign, (turn_a * x, turn_b * x), out)


@inline
def top_block(
    top: Floats | None, near: Floats | None, k: int, t: float, n: int, out: Floats
) -> None:
    """Write q(t), L(t) and -c u(t) of the n bodies of block k into rows Q, L and EXTERNAL.

    The blocks of one of the two tables are None, or of both: Numba leaves their code out.
    """
    if top is not None:
        _theta_rows(top[k], t, n, out)
    if near is not None:
        _near_rows(near[k], t, n, out)
