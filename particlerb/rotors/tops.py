"""Loops that prepare tops: one table of constants for those next to the separatrix, one for others.

The theory is in `lagrange` and `lagrange_forms`; stepping/top_rows.py evaluates the tables. Blocks
of bodies are worked on in rows of a scratch array, as in `exact_setup`.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, splice, unfused_kernel
from particlerb.compiled.threads import THREADS
from particlerb.maths.quaternion import Quat, Rows4, conjugate, multiply, to_body
from particlerb.maths.rows import column3, column4, put_column3
from particlerb.maths.vec3 import Floats, Ints, Rows3, Vec3
from particlerb.rotors.exact import CROSSOVER
from particlerb.rotors.exact_setup import BODIES_PER_BLOCK, rows3_from, rows4_from
from particlerb.rotors.lagrange import Pair, Reduced, reduced
from particlerb.rotors.lagrange_forms import Clock, Five, near_constants, theta_constants

IN_PYTHON: Final = {"BODIES_PER_BLOCK": 1}
_MIN_RATE_UNIT: Final = 1e-290

# Rows of both tables: x = start + rate t; ν and φ of α, of β; frame of z (4); ν of β less that of
# α, A, L·z, c = |a F|; L·e₃; then the polynomials of `ThetaTop`, or the numbers of `NearTop`.
LEFT, DELTA, AXIAL, OWN = 6, 10, 14, 15
N_THETA: Final = OWN + 20
N_NEAR: Final = OWN + 15
_N_INPUTS: Final = 11  # rows: ω (3), a F / A (3), q (4), stretch
_RATE_ROWS: Final = [1, 2, 4, DELTA]  # rows in units of a rate


class Tops(NamedTuple):
    """Bodies that turn like Lagrange's top."""

    moment: Floats  # (n,) [kg m²] A, across axis 3
    stretch: Floats  # (n,) ½ (A/C - 1) for the moment C about axis 3; 0 where there is no spin
    lever: Floats  # (3, n) [N m] a F, for the force F at a on axis 3; world frame
    spins: Floats  # (n,) 1, or 0 of rods, which cannot spin about axis 3


@inline
def _up_frame(x: float, y: float, z: float) -> Quat:
    """Quaternion that turns the z axis into this unit vector."""
    n = 1.0 / math.sqrt(2.0 + 2.0 * abs(z))
    return (n * (1.0 + z), -n * y, n * x, 0.0) if z > 0.0 else (-n * y, n * (1.0 - z), 0.0, n * x)


@inline
def _seen(omega: Rows3, pull: Rows3, q: Rows4, b: int) -> tuple[Quat, Vec3, Reduced]:
    """Frame of z against the force, ω there, and the top in the form of the theory."""
    x, y, z = column3(pull, b)
    size = math.sqrt(x * x + y * y + z * z)
    left = (1.0, 0.0, 0.0, 0.0)
    if size > 0.0:
        left = _up_frame(-x / size, -y / size, -z / size)
    omega_up = to_body(left, column3(omega, b))
    return left, omega_up, reduced(multiply(conjugate(left), column4(q, b)), omega_up, 2.0 * size)


@splice
def _store5(table: Floats, first: int, b: int, values: Five) -> None:
    """Five rows; a loop over the values would keep loops over bodies out of SIMD lanes."""
    put_column3(rows3_from(table, first), b, values[:3])
    table[first + 3, b], table[first + 4, b] = values[3:]


@inline
def _store(
    table: Floats, b: int, clock: Clock, spin: float, left: Quat, delta: float, momentum: Pair
) -> None:
    """Rows that both kinds have; the moment, and the force, come later."""
    nu, phase = clock.nu, clock.phase
    _store5(table, 0, b, (clock.start, clock.rate, nu[0] + spin, phase[0], nu[1] - spin))
    _store5(table, 5, b, (phase[1], *left))
    _store5(table, 10, b, (delta, 0.0, momentum[0], 0.0, momentum[1]))


@unfused_kernel
def _theta_table(inputs: Floats, table: Floats) -> None:
    """Rows of `ThetaTop` of all bodies, and k′² of all behind them."""
    n, s = inputs.shape[1], np.empty((N_THETA + 1 + _N_INPUTS, BODIES_PER_BLOCK))
    omega, pull = rows3_from(s, N_THETA + 1), rows3_from(s, N_THETA + 4)
    q, stretch = rows4_from(s, N_THETA + 7), s[N_THETA + 11]
    for lo in range(0, n, BODIES_PER_BLOCK):
        hi = min(lo + BODIES_PER_BLOCK, n)
        for i in range(_N_INPUTS):
            for b in range(BODIES_PER_BLOCK):
                s[N_THETA + 1 + i, b] = inputs[i, min(lo + b, hi - 1)]
        for b in range(BODIES_PER_BLOCK):
            left, omega_up, of = _seen(omega, pull, q, b)
            clock, top = theta_constants(of)
            delta = clock.nu[1] - clock.nu[0]
            _store(s, b, clock, of.axial * stretch[b], left, delta, (omega_up[2], of.axial))
            _store5(s, OWN, b, top.alpha_sin)
            _store5(s, OWN + 5, b, top.alpha_cos)
            _store5(s, OWN + 10, b, top.beta_cos)
            _store5(s, OWN + 15, b, top.beta_sin)
            s[N_THETA, b] = of.kc * of.kc
        for i in range(N_THETA + 1):
            for b in range(hi - lo):
                table[i, lo + b] = s[i, b]


@unfused_kernel
def _near_table(inputs: Floats, table: Floats) -> None:
    """Rows of `NearTop`."""
    n, stretch = inputs.shape[1], inputs[10]
    omega, pull, q = rows3_from(inputs, 0), rows3_from(inputs, 3), rows4_from(inputs, 6)
    for b in range(n):
        left, omega_up, of = _seen(omega, pull, q, b)
        clock, top = near_constants(of)
        turn_a, turn_b = top.turns
        delta = (clock.nu[1] + clock.rate * turn_b) - (clock.nu[0] + clock.rate * turn_a)
        _store(table, b, clock, of.axial * stretch[b], left, delta, (omega_up[2], of.axial))
        numbers = (top.fall, top.r, top.kappa, *top.odd_cos, *top.odd_sin, *top.even_cos)
        for k, value in enumerate((*numbers, *top.even_sin, *top.turns)):
            table[OWN + k, b] = value


def prepare_tops(tops: Tops, q: Floats, L: Floats) -> list[tuple[Ints, Floats]]:
    """Sort tops into kinds and prepare each.

    Parameters
    ----------
    tops : Tops
    q : ndarray, shape (4, n)
        Orientations at t = 0, axis 3 from the centre to where the force acts, to the world.
    L : ndarray, shape (3, n) [kg m²/s]
        Angular momenta about the centre, world.

    Returns
    -------
    list of (ndarray, ndarray)
        Indices of bodies and their table, of N_THETA rows or, next to the separatrix, N_NEAR; each
        body is in exactly one.

    References
    ----------
    Klein and Sommerfeld, Über die Theorie des Kreisels, chapter VI; Whittaker, Analytical
    Dynamics, sections 71 to 73; docs/closed_forms.md.
    """
    omega, pull = L / tops.moment, tops.lever / tops.moment
    unit = np.maximum(np.abs(omega).max(axis=0), np.sqrt(np.abs(pull).max(axis=0)))
    unit = np.exp2(np.round(np.log2(np.maximum(unit, _MIN_RATE_UNIT))))
    inputs = np.concatenate((omega / unit, pull / unit / unit, q, tops.stretch[None]))
    table = np.empty((N_THETA + 1, unit.size))
    THREADS.alone(_theta_table, inputs, table)
    tables, modulus = [], table[N_THETA]
    if (indices := np.flatnonzero(modulus >= CROSSOVER)).size:
        tables.append((indices, _in_units(table[:-1].take(indices, axis=1), tops, unit, indices)))
    if (indices := np.flatnonzero(modulus < CROSSOVER)).size:
        near = np.empty((N_NEAR, indices.size))
        THREADS.alone(_near_table, inputs.take(indices, axis=1), near)
        tables.append((indices, _in_units(near, tops, unit, indices)))
    return tables


def _in_units(table: Floats, tops: Tops, unit: Floats, indices: Ints) -> Floats:
    """Table with rates in rad/s, the moments, and the sizes of the levers."""
    table[_RATE_ROWS] *= unit[indices]
    moment, size = tops.moment[indices], np.sqrt((tops.lever * tops.lever).sum(axis=0))[indices]
    table[DELTA + 1], table[DELTA + 3] = moment, size
    table[DELTA + 2] *= moment * unit[indices]
    table[AXIAL] *= moment * unit[indices] * tops.spins[indices]
    return table
