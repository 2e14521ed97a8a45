"""Free rotation in closed form: where a body points at any time, without steps.

A body belongs to one of three kinds of turn, and `turns_of` sorts them: `SteadyTurn` needs no
elliptic function, `ThetaTurn` is the rule for asymmetric bodies, `HyperbolicTurn` takes those
next to the separatrix. `turn_block` evaluates one kind for a block of bodies.
The theory and its errors stand in docs/free_rotation.md.
"""

from collections.abc import Callable
from itertools import accumulate, pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from particlerb.compiled.jit import inline, splice, unfused_kernel
from particlerb.compiled.threads import THREADS
from particlerb.maths.quaternion import Quat, Rows4, multiply
from particlerb.maths.rows import column3, column4, put_column4, rows3, rows4
from particlerb.maths.trig import cos_sin_half_turns
from particlerb.maths.vec3 import Bools, Floats, Ints, rows_of
from particlerb.rotors.exact_setup import (
    MOMENTUM_ROWS,
    NEAR_ROWS,
    STEADY_ROWS,
    THETA_ROWS,
    Bytes,
    Tumblers,
    moduli,
    near_table,
    steady_table,
    theta_table,
)
from particlerb.rotors.rotor_class import ASYMMETRIC, POINT, SPHERE, SYMMETRIC
from particlerb.rotors.theta import (
    NearCoefficients,
    ThetaCoefficients,
    near_local,
    oriented,
    theta_local,
)

_BODIES_PER_BLOCK = 256
CROSSOVER = 0.02943725152285942  # k′² = 17 - 12 √2, where K′ = K/2


class SteadyTurn(NamedTuple):
    """q(t) = exp(t a) q0 exp(t b), a fixed in the world, b along rotor axis 3; 9 doubles a body."""

    axis: Floats
    """Unit vector along a; (3, n)."""
    clock: Floats
    """|a|/2 and b/2 [rad/s]; (2, n)."""
    start: Floats
    """q0; (4, n)."""


class ThetaTurn(NamedTuple):
    """Asymmetric bodies with K′ >= K/2; 84 bytes a body."""

    clock: Floats
    """x at t = 0, rate of x [rad/s], ν [rad/s]; (3, n)."""
    left: Floats
    """Q_L/|P|, from the frame with axis 3 along L into the world; (4, n)."""
    right: Bytes
    """P in small integers, from the rotor frame into that of axes 1, 2, 3; (4, n)."""
    series: Floats
    """√h cosh b, s √h sinh b, s κ/√h; (3, n)."""


class HyperbolicTurn(NamedTuple):
    """Asymmetric bodies near the separatrix, K′ < K/2; 196 bytes a body."""

    clock: Floats
    """x at t = 0, rate of x [rad/s], ν [rad/s]; (3, n)."""
    left: Floats
    """Q_L/|P|; (4, n)."""
    right: Bytes
    """P; (4, n)."""
    scale: Floats
    """2/T, r, s, κ, phase per x; (5, n)."""
    cosines: Floats
    """cos η, r cos 3η, r⁴ cos 5η, r⁹ cos 7η, r² cos 3η, r⁶ cos 5η; (6, n)."""
    sines: Floats
    """The same of sines; (6, n)."""


Turn: TypeAlias = SteadyTurn | ThetaTurn | HyperbolicTurn


@splice
def _steady_rows(turn: SteadyTurn, t: float, lo: int, hi: int, q: Rows4) -> None:
    """q(t) of steadily turning bodies."""
    axis, start = rows3(turn.axis, lo, hi), rows4(turn.start, lo, hi)
    world, body = turn.clock[0, lo:hi], turn.clock[1, lo:hi]
    for b in range(hi - lo):
        cos, sin, _ = cos_sin_half_turns(world[b] * t)
        cos_b, sin_b, _ = cos_sin_half_turns(body[b] * t)
        n = column3(axis, b)
        q_b = multiply(column4(start, b), (cos_b, 0.0, 0.0, sin_b))
        put_column4(q, b, multiply((cos, sin * n[0], sin * n[1], sin * n[2]), q_b))


@inline
def _frame_rows(right: Bytes, lo: int, hi: int) -> tuple[Bytes, Bytes, Bytes, Bytes]:
    """Rows of P between two bodies."""
    return right[0, lo:hi], right[1, lo:hi], right[2, lo:hi], right[3, lo:hi]


@inline
def _load_frame(rows: tuple[Bytes, Bytes, Bytes, Bytes], b: int) -> Quat:
    """P of body b."""
    return float(rows[0][b]), float(rows[1][b]), float(rows[2][b]), float(rows[3][b])


@splice
def _theta_rows(turn: ThetaTurn, t: float, lo: int, hi: int, q: Rows4) -> None:
    """q(t) = Q_L g(t) P of asymmetric bodies, (11)."""
    start, rate, nu = rows3(turn.clock, lo, hi)
    left, right = rows4(turn.left, lo, hi), _frame_rows(turn.right, lo, hi)
    series = rows3(turn.series, lo, hi)
    for b in range(hi - lo):
        of = ThetaCoefficients(*column3(series, b))
        local = theta_local(start[b] + rate[b] * t, of)
        put_column4(q, b, oriented(column4(left, b), nu[b] * t, local, _load_frame(right, b)))


@splice
def _hyperbolic_rows(turn: HyperbolicTurn, t: float, lo: int, hi: int, q: Rows4) -> None:
    """q(t) = Q_L g(t) P of bodies near the separatrix."""
    start, rate, nu = rows3(turn.clock, lo, hi)
    left, right = rows4(turn.left, lo, hi), _frame_rows(turn.right, lo, hi)
    fall, r, s, kappa = rows4(turn.scale, lo, hi)
    phase = turn.scale[4, lo:hi]
    cos03, sin03 = rows4(turn.cosines, lo, hi), rows4(turn.sines, lo, hi)
    cos4, cos5 = turn.cosines[4, lo:hi], turn.cosines[5, lo:hi]
    sin4, sin5 = turn.sines[4, lo:hi], turn.sines[5, lo:hi]
    for b in range(hi - lo):
        c, d = column4(cos03, b), column4(sin03, b)
        of = NearCoefficients(
            fall[b],
            r[b],
            s[b],
            kappa[b],
            phase[b],
            (c[0], c[1], c[2], c[3], cos4[b], cos5[b]),
            (d[0], d[1], d[2], d[3], sin4[b], sin5[b]),
        )
        local, delta = near_local(start[b] + rate[b] * t, of)
        put_column4(
            q, b, oriented(column4(left, b), nu[b] * t + delta, local, _load_frame(right, b))
        )


@inline
def turn_block(
    steady: SteadyTurn | None,
    theta: ThetaTurn | None,
    hyperbolic: HyperbolicTurn | None,
    t: float,
    lo: int,
    hi: int,
    q: Rows4,
) -> None:
    """Write q(t) of bodies lo to hi of one group into four rows of length hi - lo.

    Exactly one of the three groups is not None; Numba leaves the other branches out, since None is
    a type.
    """
    if steady is not None:
        _steady_rows(steady, t, lo, hi, q)
    if theta is not None:
        _theta_rows(theta, t, lo, hi, q)
    if hyperbolic is not None:
        _hyperbolic_rows(hyperbolic, t, lo, hi, q)


@unfused_kernel
def turn_all(
    steady: SteadyTurn | None,
    theta: ThetaTurn | None,
    hyperbolic: HyperbolicTurn | None,
    t: float,
    q: Floats,
) -> None:
    """`turn_block` for every block."""
    n = q.shape[1]
    for lo in range(0, n, _BODIES_PER_BLOCK):
        hi = min(lo + _BODIES_PER_BLOCK, n)
        turn_block(steady, theta, hyperbolic, t, lo, hi, rows4(q, lo, hi))


def orientation(turn: Turn, t: float) -> Floats:
    """Orientations at time t [s], rotor frame to world, shape (4, n)."""
    q = np.empty((4, turn[0].shape[1]))
    THREADS.alone(turn_all, *by_kind(turn), float(t), q)
    return q


def by_kind(turn: Turn) -> tuple[SteadyTurn | None, ThetaTurn | None, HyperbolicTurn | None]:
    """The turn in its place among the first three arguments of `turn_block`."""
    return (
        turn if isinstance(turn, SteadyTurn) else None,
        turn if isinstance(turn, ThetaTurn) else None,
        turn if isinstance(turn, HyperbolicTurn) else None,
    )


def turns_of(
    inertia: Floats, rotor_class: NDArray[np.integer], q: Floats, L: Floats
) -> list[tuple[Ints, Turn]]:
    """Sort bodies into kinds of turn, with the constants of each.

    Parameters
    ----------
    inertia : ndarray, shape (3, n) [kg m²]
        Principal moments; rotor axis 3 is the symmetry axis of a symmetric top and that of a rod.
    rotor_class : ndarray, shape (n,)
        Codes of `rotor_class`.
    q : ndarray, shape (4, n)
        Orientations at t = 0, rotor frame to world.
    L : ndarray, shape (3, n) [kg m²/s]
        Angular momenta about com, world.

    Returns
    -------
    list of (ndarray, Turn)
        Indices of bodies and their constants in that order; each body is in exactly one.
    """
    moments, turned, spin = rows_of(inertia), rows_of(q), rows_of(L)
    n, (asymmetric,) = rotor_class.size, (rotor_class == ASYMMETRIC).nonzero()
    modulus, n_turning, n_theta = np.empty(n), 0, 0
    modulus.fill(-1.0)  # also of those that are not asymmetric
    if asymmetric.size:
        bodies = Tumblers(moments, turned, np.empty((MOMENTUM_ROWS, n)), np.empty((2, n)))
        n_turning, n_theta = THREADS.alone(moduli, bodies, spin, asymmetric, CROSSOVER, modulus)
    groups: list[tuple[Ints, Turn]] = []
    if n_theta:
        indices = _those(n_theta, n, lambda: modulus >= CROSSOVER)
        table, right = np.empty((THETA_ROWS, n_theta)), np.empty((4, n_theta), np.int8)
        THREADS.alone(theta_table, bodies, indices, table, right)
        clock, left, series = split(table, 3, 4, 3)
        groups.append((indices, ThetaTurn(clock, left, right, series)))
    if n_near := n_turning - n_theta:
        indices = _those(n_near, n, lambda: ~((modulus < 0.0) | (modulus >= CROSSOVER)))
        table, right = np.empty((NEAR_ROWS, n_near)), np.empty((4, n_near), np.int8)
        THREADS.alone(near_table, bodies, indices, table, right)
        clock, left, *rest = split(table, 3, 4, 5, 6, 6)
        groups.append((indices, HyperbolicTurn(clock, left, right, *rest)))
    if n_steady := n - n_turning:
        indices = _those(n_steady, n, lambda: modulus < 0.0)
        table = np.empty((STEADY_ROWS, n_steady))
        inverse = _steady_inverse(inertia[:, indices], rotor_class[indices], modulus[indices])
        THREADS.alone(steady_table, inverse, turned, spin, indices, table)
        groups.append((indices, SteadyTurn(*split(table, 3, 2, 4))))
    return groups


def _those(count: int, n: int, are: Callable[[], Bools]) -> Ints:
    """Numbers of the bodies, of n, that are; they are so many."""
    return np.arange(n) if count == n else are().nonzero()[0]


def split(table: Floats, *counts: int) -> list[Floats]:
    """Consecutive rows of a table, so many each."""
    ends = [0, *accumulate(counts)]
    return [table[first:last] for first, last in pairwise(ends)]


def _steady_inverse(inertia: Floats, rotor_class: NDArray[np.integer], modulus: Floats) -> Floats:
    """1/I of the turn about L and 1/I3 - 1/I1 of that about rotor axis 3, (2, n) [1/(kg m²)].

    Of an asymmetric body that spins about a principal axis, I is the moment of that axis.
    """
    about = inertia[(-modulus).astype(np.int64) - 1, np.arange(modulus.size)]
    has_axis = (rotor_class == SPHERE) | (rotor_class == SYMMETRIC)
    inverse = np.zeros((2, modulus.size))
    np.divide(1.0, about, out=inverse[0], where=rotor_class != POINT)
    np.divide(inertia[0] - inertia[2], inertia[0], out=inverse[1], where=has_axis)
    np.divide(inverse[1], inertia[2], out=inverse[1], where=has_axis)
    return inverse
