"""Centres of mass on springs without length, with drag or with damping along a line.

x'' + 2γ x' + ω² (x - a) = 0 about the place of balance a. All follows from S, where S'' + 2γ S' +
ω² S = 0, S(0) = 0, S'(0) = 1, from its derivative V, and from the integrals of S, S² and V². They
are written so that nothing cancels on either side of the critical damping γ = ω, nor for short
times: formulas (O2) to (O5) of docs/closed_forms.md.
"""

import math
from typing import Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.maths.rows import column3, put_column3, rows3
from particlerb.maths.trig import cos_sin_half_turns
from particlerb.maths.vec3 import Floats, add, add_scaled, cross, dot, scale, subtract
from particlerb.stepping.translations import Centres, ExternalWork, add_external, decays

_RATE_FLOOR: Final = 1e-150  # in place of ω² - γ² = 0
_MAX_SERIES_ARGUMENT: Final = 0.25  # the larger of γt and ωt: below, integrals are series
_INVERSE: Final = tuple(1.0 / n for n in range(1, 21))


class DampedOscillator(NamedTuple):
    """As `translations.Oscillator`, with a force against the velocity."""

    squared: Floats  # (n,) [1/s²] ω² = Σ k/M
    balance: Floats  # (3, n) [m]
    pushed: Floats  # (3, n) [N]
    rate: Floats  # (n,) [1/s] 2γ = c/M


class _Oscillation(NamedTuple):
    """Of one oscillator after a time t."""

    S: float  # [s] displacement of what starts at the velocity 1
    V: float  # its velocity
    B: float  # [s²] ∫ S dt
    A: float  # [s] ∫ e^{-2γt} dt
    SS: float  # [s³] ∫ S² dt
    VV: float  # [s] ∫ V² dt


@inline
def _short(g: float, w: float) -> tuple[float, float]:
    """∫ S dt/t² and ∫ S² dt/t³ as series, for g = 2γt and w = ω²t²."""
    before, now, first = 0.0, 1.0, 0.5
    low, mid, high, second = 0.0, 0.0, 1.0, 1.0 / 3.0
    for n in range(1, 18):
        over1, over2, over3 = _INVERSE[n], _INVERSE[n + 1], _INVERSE[n - 1]
        before, now = now, -over1 * (g * now + w * over3 * before)
        first += now * over2
        square = (2.0 * g * g + 4.0 * w) * mid + 4.0 * g * w * over3 * low
        low, mid, high = mid, high, -over2 * (3.0 * g * high + over1 * square)
        second += high * _INVERSE[n + 2]
    return first, second


@inline
def oscillation(rate: float, squared: float, t: float) -> _Oscillation:
    """What follows from the equation of motion alone."""
    gamma = 0.5 * rate
    apart = (gamma - math.sqrt(squared)) * (gamma + math.sqrt(squared))
    is_over = apart > 0.0
    kappa = math.sqrt(max(apart, 0.0))
    fast = gamma + kappa
    slow = squared / fast if is_over else gamma
    exp, first, _, _ = decays(slow * t)
    E_slow = t * first
    step, first, _, _ = decays(2.0 * kappa * t)
    E_step = t * first
    omega = math.sqrt(max(-apart, 0.0)) + _RATE_FLOOR
    cos, sin, _ = cos_sin_half_turns(0.5 * omega * t)
    S = exp * E_step if is_over else exp * (2.0 * sin * cos / omega)
    C = 0.5 * exp * (1.0 + step) if is_over else exp * (1.0 - 2.0 * sin * sin)
    A = 0.5 * E_slow * (1.0 + exp)
    SS_over = A
    if is_over:
        E_fast = (slow * E_slow + exp * (2.0 * kappa) * E_step) / fast
        A = (slow * E_slow + exp * fast * E_fast) / rate
        ends = 0.5 * (E_slow * (1.0 + exp) + E_fast * (1.0 + exp * step))
        SS_over = (ends - 2.0 * A) / (4.0 * apart)
    else:
        E_fast = E_slow
    SS = (A - S * C - gamma * S * S) / (2.0 * squared)
    V, B = C - gamma * S, (1.0 - C - gamma * S) / squared
    if kappa > 0.5 * gamma:
        SS = SS_over
        V, B = exp * (fast * step - slow) / (2.0 * kappa), (E_slow - E_fast) / (2.0 * kappa)
    if max(gamma * gamma, squared) * t * t < _MAX_SERIES_ARGUMENT * _MAX_SERIES_ARGUMENT:
        one, two = _short(rate * t, squared * t * t)
        B, SS = t * t * one, t * t * t * two
    return _Oscillation(S, V, B, A, SS, S * C + squared * SS)


@inline
def braked(
    of: Centres, spring: DampedOscillator, lo: int, t: float, external: ExternalWork
) -> None:
    """x = x₀ + V₀ S - ω² B (x₀ - a)."""
    start, p0, _, inv_mass, com, p = of
    n = inv_mass.size
    rates, squares = spring.rate[lo : lo + n], spring.squared[lo : lo + n]
    balance, pushed = rows3(spring.balance, lo, lo + n), rows3(spring.pushed, lo, lo + n)
    for b in range(n):
        x0, a, v = column3(start, b), column3(balance, b), scale(inv_mass[b], column3(p0, b))
        rate, squared, M = rates[b], squares[b], 1.0 / inv_mass[b]
        S, V, B, A, SS, VV = oscillation(rate, squared, t)
        y = subtract(x0, a)
        moved = add_scaled(-squared * B, y, scale(S, v))
        put_column3(com, b, add(x0, moved))
        put_column3(p, b, scale(M, add_scaled(V, v, scale(-squared * S, y))))
        lost = add_scaled(S + rate * B, y, scale(B, v))  # ∫ (x - a) dt
        square = VV * dot(v, v) + squared * (squared * SS * dot(y, y) - S * S * dot(y, v))
        impulse = scale(-M, add_scaled(squared, lost, scale(rate, moved)))
        angular = add_scaled(-rate * A, cross(y, v), scale(-rate, cross(a, moved)))
        turned = cross(add_scaled(S + rate * B, x0, scale(B, v)), a)  # lost × a, as y + a = x₀
        angular = scale(M, add_scaled(squared, turned, angular))
        work = dot(column3(pushed, b), moved) - rate * M * square
        add_external(external, lo + b, work, impulse, angular)
