"""Jacobi's elliptic functions by the descending Landen transformation, without a transcendental.

One step replaces the modulus k by k₁ = (1 - k′)/(1 + k′), which is about k²/4, and keeps the
fraction u/K of the period; so the angle πu/2K of an elliptic argument u is what is left of its
amplitude when the modulus has gone. Five steps take every modulus with k′ >= 0.17 below 5e-11,
where sn and sin differ by k²/4 < 1e-21. All sums have positive terms: nothing cancels.

Sources: DLMF 19.8(ii), 22.7(i); the nome series DLMF 19.5.5, its coefficients OEIS A002103.
"""

import math
from typing import NamedTuple

from particlerb.compiled.jit import inline


class Landen(NamedTuple):
    """Moduli after one to five Landen steps, and what belongs to them."""

    k1: float
    k2: float
    k3: float
    k4: float
    k5: float
    period: float
    """K / (π/2), the product of all 1 + kᵢ."""
    nome_squared: float
    """q² with q = exp(-πK′/K)."""


@inline
def _next_modulus(k: float, kc: float) -> tuple[float, float]:
    """k₁ = k²/(1 + k′)² and k₁′ = 2√k′/(1 + k′)."""
    inv = 1.0 / (1.0 + kc)
    return (k * inv) * (k * inv), 2.0 * math.sqrt(kc) * inv


@inline
def nome(k: float, kc: float) -> float:
    """q = exp(-πK′/K) for k′ >= 0.7: ε + 2ε⁵ + 15ε⁹ + 150ε¹³ + …, 2ε = (1 - √k′)/(1 + √k′)."""
    sum1 = 1.0 + math.sqrt(kc)
    epsilon = 0.5 * (k * k) / ((1.0 + kc) * (sum1 * sum1))
    e4 = (epsilon * epsilon) * (epsilon * epsilon)
    return epsilon + epsilon * (e4 * (2.0 + e4 * (15.0 + e4 * 150.0)))


@inline
def landen(k: float, kc: float) -> Landen:
    """Descend from the modulus k = √(1 - k′²), k′ >= 0.17; the nome of k₁ is q²."""
    k1, kc1 = _next_modulus(k, kc)
    k2, kc2 = _next_modulus(k1, kc1)
    k3, kc3 = _next_modulus(k2, kc2)
    k4, _ = _next_modulus(k3, kc3)
    k5 = 0.25 * (k4 * k4)  # k4 is below 2e-5
    period = (1.0 + k1) * (1.0 + k2) * (1.0 + k3) * (1.0 + k4) * (1.0 + k5)
    return Landen(k1, k2, k3, k4, k5, period, nome(k1, kc1))


@inline
def _descend(k1: float, s: float, c: float, root: float) -> tuple[float, float, float]:
    """(sn, cn) of the modulus before one step into those after it, modulus k₁ (DLMF 22.7.2).

    `root` is (1 + k₁) dn before the step; the last one is dn after it.
    """
    s1 = 2.0 * s / ((1.0 + k1) + root)
    part = k1 * (s1 * s1)
    dn = math.sqrt(1.0 - k1 * part)
    return s1, c * (1.0 + part) / dn, dn


@inline
def phase(chain: Landen, s: float, c: float) -> tuple[float, float]:
    """Sine and cosine of πu/2K from sn u and cn u; the last step to first order in k₅ < 5e-11."""
    k1, k2, k3, k4, k5, _, _ = chain
    other = 1.0 - k1
    s, c, dn = _descend(k1, s, c, math.sqrt(other * other + 4.0 * k1 * (c * c)))
    s, c, dn = _descend(k2, s, c, (1.0 + k2) * dn)
    s, c, dn = _descend(k3, s, c, (1.0 + k3) * dn)
    s, c, dn = _descend(k4, s, c, (1.0 + k4) * dn)
    s, c = s - s * (k5 * (c * c)), c + c * (k5 * (s * s))
    inv = 1.0 / math.sqrt(s * s + c * c)
    return s * inv, c * inv


@inline
def _descend_imaginary(k1: float, t: float) -> float:
    """The same step for sn(iv) = i t: t₁ = 2t/(1 + k₁ + √((1 + k₁)² + 4 k₁ t²))."""
    sum1 = 1.0 + k1
    return 2.0 * t / (sum1 + math.sqrt(sum1 * sum1 + (4.0 * k1 * t) * t))


@inline
def imaginary_phase(chain: Landen, t: float) -> float:
    """Return sinh(πv/2K) from t = sn(iv)/i = sn(v, k′)/cn(v, k′) >= 0."""
    t = _descend_imaginary(chain.k1, t)
    t = _descend_imaginary(chain.k2, t)
    t = _descend_imaginary(chain.k3, t)
    t = _descend_imaginary(chain.k4, t)
    return _descend_imaginary(chain.k5, t)
