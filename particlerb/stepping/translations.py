"""Centres of mass under a constant force, with drag, or on springs; turns about a fixed line.

Each function writes positions and momenta of a block, and adds up what the forces have given since
the start, from integrals of their own: work without gravity's, impulse, and angular impulse about
the world's origin. Formulas: docs/closed_forms.md.
"""

import math
from typing import Any, Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Quat, multiply
from particlerb.maths.rows import column3, column4, put_column3, rows3, rows4
from particlerb.maths.trig import cos_sin_half_turns, decay
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Rows3,
    Vec3,
    add,
    add_scaled,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.block import L, Q, put3, put4

_SPIN_FLOOR: Final = 1e-300  # in place of |L| = 0
_PHI3_TERMS: Final = tuple(1.0 / math.factorial(n) for n in range(20, 2, -1))  # the last first
N_EXTERNAL: Final = 7  # work, impulse, angular impulse


class ExternalWork(NamedTuple):
    """Work [J], impulse [N s] and angular impulse [N m s] of forces on bodies since the start."""

    sums: Floats  # (bins, 7)
    bins: Ints  # (n,) of each body


class Damping(NamedTuple):
    """Linear drag on n bodies."""

    rate: Floats  # (n,) [1/s] γ = c/M
    pushed: Floats  # (3, n) [N] constant force without gravity


class Oscillator(NamedTuple):
    """Springs of no rest length from the centres of mass of n bodies to places in the world."""

    squared: Floats  # (n,) [1/s²] ω² = Σ k/M
    balance: Floats  # (3, n) [m] where forces are in balance
    pushed: Floats  # (3, n) [N]


class Spinning(NamedTuple):
    """n bodies that turn about a fixed line, by a constant torque, with drag on the rotation."""

    rate: Floats  # (n,) [1/s] c_r/I
    inv_inertia: Floats  # (n,) [1/(kg m²)] about the line
    q: Floats  # (4, n) at the start
    L: Floats  # (3, n) [kg m²/s]
    torque: Floats  # (3, n) [N m] along L


class Centres(NamedTuple):
    """Rows of a block: what is given, and what is written."""

    start: Rows3
    p0: Rows3
    force: Rows3
    inv_mass: Floats
    com: Rows3
    p: Rows3


@inline
def decays(x: float) -> Quat:
    """e^{-x} and φ₁, φ₂, φ₃ of x >= 0, φ_k(x) = Σ (-x)ⁿ/(n + k)!, to a few roundings."""
    small = min(x, 1.0)
    third = 0.0
    for c in _PHI3_TERMS:
        third = c - small * third
    second = 0.5 - small * third
    first = 1.0 - small * second
    exp = 1.0 - small * first
    if x > 1.0:
        exp = decay(-x)
        first = (1.0 - exp) / x
        second = (1.0 - first) / x
        third = (0.5 - second) / x
    return exp, first, second, third


@inline
def _integrals(rate: float, t: float) -> Quat:
    """e^{-γt}, its integrals E₁ and E₂, and G = ∫ E₁² dt."""
    x = rate * t
    exp, first, second, third = decays(x)
    psi = second - third - 0.5 * x * second * second
    if x > 1.0:
        psi = (x - 0.5 * (1.0 - exp) * (3.0 - exp)) / (x * x * x)
    return exp, t * first, t * t * second, t * t * t * psi


@inline
def _squared(exp: float, E1: float, G: float, p: Vec3, F: Vec3) -> float:
    """∫ (p e^{-γt} + F E₁)² dt."""
    return 0.5 * E1 * (1.0 + exp) * dot(p, p) + E1 * E1 * dot(p, F) + G * dot(F, F)


@inline
def parabola(of: Centres, t: float) -> None:
    """x = x₀ + (p₀ t + F t²/2)/M,  p = p₀ + F t."""
    start, p0, force, inv_mass, com, p = of
    for b in range(inv_mass.size):
        p_b, F = column3(p0, b), column3(force, b)
        put_column3(p, b, add_scaled(t, F, p_b))
        way = add_scaled(0.5 * t, F, p_b)
        put_column3(com, b, add_scaled(t * inv_mass[b], way, column3(start, b)))


@inline
def add_external(external: ExternalWork, j: int, work: float, impulse: Vec3, angular: Vec3) -> None:
    """Add what body j of a part was given to the sums of its bin; world axes."""
    sums = external.sums[external.bins[j]]
    sums[0] += work
    for k in range(3):
        sums[1 + k] += impulse[k]
        sums[4 + k] += angular[k]


@inline
def damped(of: Centres, drag: Damping, lo: int, t: float, external: ExternalWork) -> None:
    """p = p₀ e^{-γt} + F E₁,  x = x₀ + (p₀ E₁ + F E₂)/M; E_k = tᵏ φ_k(γt)."""
    start, p0, force, inv_mass, com, p = of
    n = inv_mass.size
    rate, pushed = drag.rate[lo : lo + n], rows3(drag.pushed, lo, lo + n)
    for b in range(n):
        p_b, F, x0, inv = column3(p0, b), column3(force, b), column3(start, b), inv_mass[b]
        exp, E1, E2, G = _integrals(rate[b], t)
        J = add_scaled(E1, p_b, scale(E2, F))
        put_column3(p, b, add_scaled(exp, p_b, scale(E1, F)))
        put_column3(com, b, add_scaled(inv, J, x0))
        square = _squared(exp, E1, G, p_b, F)
        work = inv * (dot(column3(pushed, b), J) - rate[b] * square)
        impulse = add_scaled(-rate[b], J, scale(t, F))
        turned = inv * (E2 - rate[b] * (2.0 * G - E1 * E2))
        angular = add_scaled(turned, cross(p_b, F), cross(x0, impulse))
        add_external(external, lo + b, work, impulse, angular)


@inline
def sprung(of: Centres, spring: Oscillator, lo: int, t: float, external: Any) -> None:
    """x = a + (x₀ - a) cos ωt + (p₀/M) sin ωt/ω, about the place of balance a."""
    start, p0, _, inv_mass, com, p = of
    n = inv_mass.size
    squared, balance = spring.squared[lo : lo + n], rows3(spring.balance, lo, lo + n)
    pushed = rows3(spring.pushed, lo, lo + n)
    for b in range(n):
        x0, a, v = column3(start, b), column3(balance, b), scale(inv_mass[b], column3(p0, b))
        omega = math.sqrt(squared[b])
        cos_half, sin_half, _ = cos_sin_half_turns(0.5 * omega * t)
        cos, sine = 1.0 - 2.0 * sin_half * sin_half, 2.0 * sin_half * cos_half / omega
        fall = 2.0 * sin_half * sin_half / squared[b]  # (1 - cos ωt)/ω²
        y = subtract(x0, a)
        moved = add_scaled(-squared[b] * fall, y, scale(sine, v))
        put_column3(com, b, add(x0, moved))
        M = 1.0 / inv_mass[b]
        put_column3(p, b, scale(M, add_scaled(cos, v, scale(-squared[b] * sine, y))))
        if external is not None:
            lost = add_scaled(sine, y, scale(fall, v))  # ∫ (x - a) dt
            k = M * squared[b]
            turned = cross(add_scaled(sine, x0, scale(fall, v)), a)  # lost × a, as y + a = x₀
            work, angular = dot(column3(pushed, b), moved), scale(k, turned)
            add_external(external, lo + b, work, scale(-k, lost), angular)


@inline
def add_drift(of: Centres, drift: Floats, lo: int, t: float) -> None:
    """Add a parabola, common to bodies that move relative to it: x += V t + g t²/2."""
    n = of.inv_mass.size
    V = rows3(drift, lo, lo + n)
    for b in range(n):
        inv = of.inv_mass[b]
        fall = scale(inv * t, column3(of.force, b))
        moved = add_scaled(0.5, fall, column3(V, b))
        put_column3(of.com, b, add_scaled(t, moved, column3(of.com, b)))
        gained = add_scaled(1.0, fall, column3(V, b))
        put_column3(of.p, b, add_scaled(1.0 / inv, gained, column3(of.p, b)))


@inline
def spun(of: Spinning, lo: int, hi: int, t: float, out: Floats, external: ExternalWork) -> None:
    """L = L₀ e^{-λt} + τ E₁, and q turned by (L₀ E₁ + τ E₂)/I, in rows of a block."""
    L0, q0, torque = rows3(of.L, lo, hi), rows4(of.q, lo, hi), rows3(of.torque, lo, hi)
    for b in range(hi - lo):
        rate, inverse = of.rate[lo + b], of.inv_inertia[lo + b]
        L_b, tau = column3(L0, b), column3(torque, b)
        exp, E1, E2, G = _integrals(rate, t)
        J = add_scaled(E1, L_b, scale(E2, tau))
        size = math.sqrt(dot(J, J))
        cos, sin, _ = cos_sin_half_turns(0.5 * inverse * size)
        axis = scale(sin / max(size, _SPIN_FLOOR), J)
        put4(out, Q, b, multiply((cos, axis[0], axis[1], axis[2]), column4(q0, b)))
        put3(out, L, b, add_scaled(exp, L_b, scale(E1, tau)))
        work = inverse * (dot(tau, J) - rate * _squared(exp, E1, G, L_b, tau))
        turned = add_scaled(-rate, J, scale(t, tau))
        add_external(external, lo + b, work, (0.0, 0.0, 0.0), turned)
