"""Loops that prepare the three kinds of turn, one table of constants each.

A block of bodies is copied into the rows of one scratch array, worked on there and copied out:
LLVM sees that rows of one array do not overlap, and vectorises a loop that writes 28 of them.
The last block is filled up with copies of its last body: a loop of fixed length compiles faster.
`moduli` finds the momenta in the rotor frame in 32 digits, which the tables take from it.
Moments and momenta are divided by powers of two on the way in, so that no power of them leaves
the range of doubles; `unit` is (1 / unit of I, 1 / unit of L) of each body.
"""

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from particlerb.compiled.jit import config, inline, splice, unfused_kernel
from particlerb.maths import double_double as dd
from particlerb.maths.quaternion import Quat, Rows4, conjugate, multiply
from particlerb.maths.rows import column3, column4, put_column3, put_column4
from particlerb.maths.trig import scale_of
from particlerb.maths.vec3 import Floats, Ints, Rows3, Vec3, scale
from particlerb.rotors.theta import (
    TINY,
    NearCoefficients,
    ThetaCoefficients,
    near_constants,
    near_local,
    reduce,
    square,
    theta_constants,
    theta_local,
    twist,
)

BODIES_PER_BLOCK = 1 if config.DISABLE_JIT else 32
IN_PYTHON: Final = {"BODIES_PER_BLOCK": 1}
_MIN_SCALE = 1e-290
_N_INPUTS = 14  # rows: I (3), q (4), L in the rotor frame (6), rate
MOMENTUM_ROWS = 6  # L in the rotor frame in 32 digits: high and low of each component
STEADY_ROWS, THETA_ROWS, NEAR_ROWS = 9, 10, 24
Pair: TypeAlias = tuple[float, float]
Bytes: TypeAlias = NDArray[np.int8]


class Tumblers(NamedTuple):
    """Bodies of which some are asymmetric; the last two are written by `moduli`, for these."""

    inertia: Rows3  # (n,) each [kg m²]
    q: Rows4  # (n,) each, rotor frame to world
    momentum: Floats  # (MOMENTUM_ROWS, n) in their units
    units: Floats  # (2, n)


@inline
def _ordered(x: Pair, y: Pair) -> tuple[Pair, Pair]:
    """The pair with the smaller first entry first."""
    swap = x[0] > y[0]
    return (
        (y[0] if swap else x[0], y[1] if swap else x[1]),
        (x[0] if swap else y[0], x[1] if swap else y[1]),
    )


@inline
def complementary_modulus(inertia: Vec3, m: Vec3) -> float:
    """k′² in doubles, (3); -1, -2, -3 for a spin about axis 1, 2, 3 exactly, -1 for a sphere."""
    x, y = _ordered((inertia[0], m[0] * m[0]), (inertia[1], m[1] * m[1]))
    y, z = _ordered(y, (inertia[2], m[2] * m[2]))
    x, y = _ordered(x, y)
    d12, d13, d23 = y[0] - x[0], z[0] - x[0], z[0] - y[0]
    D = z[1] * (d23 / z[0]) - x[1] * (d12 / x[0])
    above = (x[1] * (d13 / x[0]) + y[1] * (d23 / y[0])) * d12
    below = (z[1] * (d13 / z[0]) + y[1] * (d12 / y[0])) * d23
    outside = abs(D) * d13
    modulus = outside / ((above if D > 0.0 else below) + outside + TINY)
    on1, on2, on3 = m[0] == 0.0, m[1] == 0.0, m[2] == 0.0
    modulus = -3.0 if on1 and on2 else modulus
    modulus = -2.0 if on1 and on3 else modulus
    return -1.0 if (on2 and on3) or d13 == 0.0 else modulus


@inline
def unit_of(v: Vec3) -> float:
    """1 / the largest power of two in the largest component."""
    return scale_of(max(abs(v[0]), abs(v[1]), abs(v[2]), _MIN_SCALE))


@unfused_kernel
def moduli(
    bodies: Tumblers, L: Rows3, indices: Ints, crossover: float, out: Floats
) -> tuple[int, int]:
    """`complementary_modulus` of bodies `indices`, their units, and L in their rotor frames.

    How many are asymmetric in their motion, and how many of these are beyond the crossover.
    """
    inertia, q, momentum, units = bodies
    s = np.empty((_N_INPUTS + 1, BODIES_PER_BLOCK))
    n_turning, n_theta = 0, 0
    for lo in range(0, indices.size, BODIES_PER_BLOCK):
        hi = min(lo + BODIES_PER_BLOCK, indices.size)
        moment = rows3_from(s, 0)
        turn = rows4_from(s, 3)
        spin = rows3_from(s, 7)
        result = s[_N_INPUTS]
        high, low = rows3_from(s, 7), rows3_from(s, 10)
        for b in range(BODIES_PER_BLOCK):
            j = indices[min(lo + b, hi - 1)]
            inertia_j, L_j = column3(inertia, j), column3(L, j)
            units[0, j], units[1, j] = unit_of(inertia_j), unit_of(L_j)
            put_column3(moment, b, scale(units[0, j], inertia_j))
            put_column3(spin, b, scale(units[1, j], L_j))
            put_column4(turn, b, column4(q, j))
        for b in range(BODIES_PER_BLOCK):
            m = dd.to_body(column4(turn, b), column3(spin, b))
            put_column3(high, b, (m[0][0], m[1][0], m[2][0]))
            put_column3(low, b, (m[0][1], m[1][1], m[2][1]))
            result[b] = complementary_modulus(column3(moment, b), (m[0][0], m[1][0], m[2][0]))
        for b in range(hi - lo):
            j = indices[lo + b]
            out[j] = result[b]
            for i in range(MOMENTUM_ROWS):
                momentum[i, j] = s[7 + i, b]
            n_turning += not result[b] < 0.0  # what is no number turns, too
            n_theta += result[b] >= crossover
    return n_turning, n_theta


@unfused_kernel
def _fill(bodies: Tumblers, indices: Ints, lo: int, hi: int, s: Floats) -> None:
    """Copy bodies indices[lo:hi] into the first rows of a scratch block; the last one fills it."""
    inertia, q, momentum, units = bodies
    moment, turn = rows3_from(s, 0), rows4_from(s, 3)
    for b in range(BODIES_PER_BLOCK):
        j = indices[min(lo + b, hi - 1)]
        put_column3(moment, b, scale(units[0, j], column3(inertia, j)))
        put_column4(turn, b, column4(q, j))
        for i in range(MOMENTUM_ROWS):
            s[7 + i, b] = momentum[i, j]
        s[13, b] = units[0, j] / units[1, j]


@unfused_kernel
def _drain(s: Floats, lo: int, hi: int, table: Floats, frame: Bytes) -> None:
    """Copy the results of a block into their places."""
    for i in range(table.shape[0]):
        for b in range(hi - lo):
            table[i, lo + b] = s[_N_INPUTS + 4 + i, b]
    for i in range(4):
        for b in range(hi - lo):
            frame[i, lo + b] = s[_N_INPUTS + i, b]


@inline
def world_factor(q: Quat, local: Quat, frame: Quat) -> Quat:
    """Q_L / |P|, so that Q_L g P is q at t = 0 though P is not of length 1."""
    left = multiply(q, conjugate(multiply(local, frame)))
    inv = 1.0 / math.sqrt(square(left) * square(frame))
    return left[0] * inv, left[1] * inv, left[2] * inv, left[3] * inv


@splice
def rows3_from(s: Floats, i: int) -> Rows3:
    """Three rows of a scratch block."""
    return s[i], s[i + 1], s[i + 2]


@splice
def rows4_from(s: Floats, i: int) -> Rows4:
    """Four rows of a scratch block."""
    return s[i], s[i + 1], s[i + 2], s[i + 3]


@splice
def _inputs(s: Floats) -> tuple[Rows3, Rows4, Floats, Rows3, Rows3]:
    """Moments, q, unit of I over that of L, and L in its high and its low digits."""
    return rows3_from(s, 0), rows4_from(s, 3), s[13], rows3_from(s, 7), rows3_from(s, 10)


@splice
def _results(s: Floats) -> tuple[Rows3, Rows4, Rows4]:
    """Clock, left and right of a turn; its coefficients are behind."""
    return rows3_from(s, 18), rows4_from(s, 21), rows4_from(s, 14)


@inline
def _pairs(high: Vec3, low: Vec3) -> tuple[Pair, Pair, Pair]:
    """Numbers of 32 digits."""
    return (high[0], low[0]), (high[1], low[1]), (high[2], low[2])


@inline
def theta_turn(
    inertia: Vec3, m: dd.Wide3, q: Quat, rate: float
) -> tuple[Vec3, Quat, Quat, ThetaCoefficients]:
    """Clock, left, right and coefficients of a ThetaTurn, L in the rotor frame; see `exact`."""
    body = reduce(inertia, m)
    time, of = theta_constants(body)
    left = world_factor(q, theta_local(time.start, of), body.frame)
    return (time.start, time.rate * rate, time.nu * rate), left, body.frame, of


@inline
def near_turn(
    inertia: Vec3, m: dd.Wide3, q: Quat, rate: float
) -> tuple[Vec3, Quat, Quat, NearCoefficients]:
    """The same of a HyperbolicTurn."""
    body = reduce(inertia, m)
    time, of = near_constants(body)
    local, delta = near_local(time.start, of)
    left = twist(world_factor(q, local, body.frame), -delta)
    return (time.start, time.rate * rate, time.nu * rate), left, body.frame, of


@unfused_kernel
def theta_table(bodies: Tumblers, indices: Ints, table: Floats, right: Bytes) -> None:
    """Constants of ThetaTurn: right, and in one table clock, left, series."""
    s = np.empty((_N_INPUTS + 4 + THETA_ROWS, BODIES_PER_BLOCK))
    for lo in range(0, indices.size, BODIES_PER_BLOCK):
        hi = min(lo + BODIES_PER_BLOCK, indices.size)
        _fill(bodies, indices, lo, hi, s)
        moment, turn, rate, high, low = _inputs(s)
        (clock, left, right_of), series = _results(s), rows3_from(s, 25)
        for b in range(BODIES_PER_BLOCK):
            m = _pairs(column3(high, b), column3(low, b))
            constants = theta_turn(column3(moment, b), m, column4(turn, b), rate[b])
            put_column3(clock, b, constants[0])
            put_column4(left, b, constants[1])
            put_column4(right_of, b, constants[2])
            put_column3(series, b, constants[3])
        _drain(s, lo, hi, table, right)


@unfused_kernel
def near_table(bodies: Tumblers, indices: Ints, table: Floats, right: Bytes) -> None:
    """Constants of HyperbolicTurn: right, and in one table clock, left, scale, cosines, sines."""
    s = np.empty((_N_INPUTS + 4 + NEAR_ROWS, BODIES_PER_BLOCK))
    for lo in range(0, indices.size, BODIES_PER_BLOCK):
        hi = min(lo + BODIES_PER_BLOCK, indices.size)
        _fill(bodies, indices, lo, hi, s)
        moment, turn, rate, high, low = _inputs(s)
        clock, left, right_of = _results(s)
        scale, phase = rows4_from(s, 25), s[29]
        cosines = (rows3_from(s, 30), rows3_from(s, 33))
        sines = (rows3_from(s, 36), rows3_from(s, 39))
        for b in range(BODIES_PER_BLOCK):
            m = _pairs(column3(high, b), column3(low, b))
            constants = near_turn(column3(moment, b), m, column4(turn, b), rate[b])
            of = constants[3]
            put_column3(clock, b, constants[0])
            put_column4(left, b, constants[1])
            put_column4(right_of, b, constants[2])
            put_column4(scale, b, (of.fall, of.r, of.s, of.kappa))
            phase[b] = of.turn
            put_column3(cosines[0], b, of.cosines[:3])
            put_column3(cosines[1], b, of.cosines[3:])
            put_column3(sines[0], b, of.sines[:3])
            put_column3(sines[1], b, of.sines[3:])
        _drain(s, lo, hi, table, right)


@unfused_kernel
def steady_table(inv_inertia: Floats, q: Rows4, L: Rows3, indices: Ints, table: Floats) -> None:
    """Constants of SteadyTurn: axis, clock, start."""
    for b in range(indices.size):
        q_b, L_b = column4(q, indices[b]), column3(L, indices[b])
        G = np.sqrt(L_b[0] * L_b[0] + L_b[1] * L_b[1] + L_b[2] * L_b[2])
        inv = 1.0 / max(G, TINY)
        for i in range(3):
            table[i, b] = L_b[i] * inv
        table[3, b] = 0.5 * G * inv_inertia[0, b]
        table[4, b] = 0.5 * dd.to_body(q_b, L_b)[2][0] * inv_inertia[1, b]
        for i in range(4):
            table[5 + i, b] = q_b[i]
