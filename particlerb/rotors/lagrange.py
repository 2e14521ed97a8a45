"""Lagrange's top: a symmetric body that a constant force turns about its centre, by its axis 3.

`reduced` brings a body into the form of the theory, docs/closed_forms.md: roots of its cubic,
modulus, rates, each with relative accuracy also where roots meet (sleeping tops, regular
precession) or reach a pole. Formulas there are named here as (T1) and so on.

All is in the frame with z against the force. The orientation is the pair α = q₀ + i q₃ and
β = q₁ + i q₂. The body is a sphere of moment A here: its spin about axis 3 is added later. Units
of time are chosen by the caller such that ω and β are neither huge nor tiny.
"""

import math
from typing import Final, NamedTuple, TypeAlias

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Quat
from particlerb.maths.trig import angle_of
from particlerb.maths.vec3 import Vec3

TINY: Final = 1e-150  # added to positive denominators that can be zero
_MIN_DIVISOR: Final = 1e-200  # of what is divided by, or has a root taken
Pair: TypeAlias = tuple[float, float]  # also the real and the imaginary part of a number


class Reduced(NamedTuple):
    """A top in the form of the theory."""

    lam: float  # rate λ of the elliptic argument
    k: float
    kc: float  # k′
    argument: Pair  # sn, cn of the elliptic argument at t = 0
    zeros: Pair  # sc(w, k′) of w of α and of β, (T4)
    bases: Pair  # of ν of α and of β, before the logarithmic derivative, (T5)
    ratio: float  # of |α| and |β|, (T6) without thetas
    signs: Pair  # of ω·z + ω·e₃ and of ω·z - ω·e₃
    axial: float  # ω·e₃
    values: tuple[Pair, Pair]  # α, β at t = 0
    rates: tuple[Pair, Pair]  # their rates


class _Roots(NamedTuple):
    """Where the roots u₁ <= u₂ of the cubic are, seen from the poles and from the start u₀."""

    above1: float  # 1 + u₁
    above2: float
    below1: float  # 1 - u₁
    below2: float
    from1: float  # u₀ - u₁
    to2: float  # u₂ - u₀
    third: float  # β (u₃ - 1)


@inline
def sign_of(x: float) -> float:
    """1 or -1."""
    return 1.0 if x >= 0.0 else -1.0


@inline
def _split(difference: float, product: float) -> Pair:
    """r, s >= 0 with r - s and r s given: nothing cancels."""
    large = 0.5 * (math.sqrt(difference * difference + 4.0 * product) + abs(difference))
    small = product / max(large, TINY)
    return (large, small) if difference > 0.0 else (small, large)


@inline
def _lone_root(beta: float, axial: float, less: float, offset: float) -> tuple[float, bool]:
    """h = β(u - 1) of the root apart from the other two, and whether it is the lowest.

    Of h³ + g₂ h² + g₁ h + g₀: by τ³ - 3τ = 2c with √3 <= τ <= 2 from the inflection on, then two
    Newton steps on the form (h - offset)(h + 2β) h = (β less - axial h)², where less cancels.
    """
    g2, g1 = 2.0 * beta - offset - axial * axial, 2.0 * beta * (axial * less - offset)
    centre = -g2 / 3.0
    radius = math.sqrt(max(centre * centre - g1 / 3.0, _MIN_DIVISOR))
    value = ((centre + g2) * centre + g1) * centre - (beta * less) * (beta * less)
    c = min(abs(value) / (2.0 * (radius * radius) * radius), 1.0)
    tau = 1.7320508075688772 + c * (0.3333333 + c * (-0.0962250 + 0.0308992 * c))
    for _ in range(3):
        tau -= (tau * (tau * tau - 3.0) - 2.0 * c) / (3.0 * (tau * tau - 1.0))
    h = centre - radius * tau if value > 0.0 else centre + radius * tau
    for _ in range(2):
        k = beta * less - axial * h
        slope = (3.0 * h + 2.0 * g2) * h + g1
        error = h * (h - offset) * (h + 2.0 * beta) - k * k
        h -= error / (slope + TINY * sign_of(slope))
    return h, value > 0.0


@inline
def _roots(
    beta: float, axial: float, sides: Pair, poles: Pair, across: float, rate: float, twice: float
) -> _Roots:
    """Roots by products and sums of positive terms, (T3); one alone is solved for.

    sides: ω·z ± ω·e₃; poles: 1 ± u₀; across: |ω × e₃|²; rate, twice: u̇ and 2ü.
    """
    (more, less), (above, below) = sides, poles
    offset, square = across - beta * below, rate * rate
    h, is_lowest = _lone_root(beta, axial, less, offset)
    third = max(h, 0.0)
    full = third + beta * below + TINY
    to2, from1 = _split((twice + beta * (square / full)) / full, square / full)
    below1 = min(-h / max(beta, TINY), 2.0) if is_lowest else below + from1
    below1 = max(below1, TINY)
    above2, below2 = above + to2, less * less / (below1 * third + TINY)
    if is_lowest or third < 0.5 * beta:  # u₂ and u₃ from their sum and their product
        above1, near = 2.0 - below1, below1 - below
        sum_ = offset + axial * axial - beta * above1
        seen = (square / (near + TINY) - twice) / (near + TINY)
        size = abs(offset) + axial * axial + beta * above1
        if near > 0.1 and abs(seen) + 2.0 * beta * below < size:
            sum_ = seen - 2.0 * beta * below
        third, below2 = _split(sum_, beta * less * less / below1)
        below2 = below2 / beta
    if is_lowest:
        above2, from1, to2 = 2.0 - below2, max(below1 - below, 0.0), max(below - below2, 0.0)
        product = square / (third + beta * below + TINY)
        if from1 < to2:
            from1 = product / to2
        else:
            to2 = product / max(from1, TINY)
    above1 = more * more / (above2 * (third + 2.0 * beta) + TINY)
    return _Roots(above1, above2, below1, below2, from1, to2, third)


@inline
def reduced(g: Quat, omega: Vec3, beta: float) -> Reduced:
    """(T1) to (T6) of orientation g and ω in the frame of z; β = 2c/A."""
    w, x, y, z = g
    n = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w * n, x * n, y * n, z * n
    ex, ey = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)  # e₃ beside z
    above, below = 2.0 * (w * w + z * z), 2.0 * (x * x + y * y)
    ox, oy, oz = omega
    u, side = above - 1.0, ex * ox + ey * oy
    less, more = below * oz - side, above * oz + side
    axial, rate = 0.5 * (more - less), ox * ey - oy * ex
    ax, ay = oy * u - oz * ey, oz * ex - ox * u
    across = ax * ax + ay * ay + rate * rate
    twice = 2.0 * axial * (below * above * oz - u * side) - beta * (below * above)
    twice -= 2.0 * u * across
    of = _roots(beta, axial, (more, less), (above, below), across, rate, twice)
    d, full = max(of.from1 + of.to2, TINY), of.third + beta * of.below1 + TINY
    sn, cn = math.sqrt(of.from1 / d), math.sqrt(of.to2 / d) * sign_of(rate)
    if of.from1 + of.to2 <= TINY:
        sn, cn = 0.0, 1.0
    n = 1.0 / math.sqrt(sn * sn + cn * cn)
    kc = math.sqrt(max((of.third + beta * of.below2) / full, _MIN_DIVISOR))
    return Reduced(
        0.5 * math.sqrt(full),
        math.sqrt(beta * d / full),
        kc,
        (sn * n, cn * n),
        (math.sqrt(of.above1 / d), math.sqrt(of.below2 / d) * math.sqrt(full / (of.third + TINY))),
        (more / (2.0 * of.above2 + TINY), less / (2.0 * of.below1 + TINY)),
        math.sqrt(of.above2 / max(of.below1, _MIN_DIVISOR)),
        (sign_of(more), sign_of(less)),
        axial,
        ((w, z), (x, y)),
        (
            (-0.5 * (ox * x + oy * y + oz * z), 0.5 * (oz * w + ox * y - oy * x)),
            (0.5 * (ox * w + oy * z - oz * y), 0.5 * (oy * w + oz * x - ox * z)),
        ),
    )


@inline
def _fitted(f: Pair, df: Pair, value: Pair, rate: Pair, weight: float) -> float:
    """Phase of value/f and rate/df at once: well defined where f passes through zero."""
    re = f[0] * value[0] + f[1] * value[1] + weight * (df[0] * rate[0] + df[1] * rate[1])
    im = f[0] * value[1] - f[1] * value[0] + weight * (df[0] * rate[1] - df[1] * rate[0])
    n = math.sqrt(re * re + im * im)
    return angle_of(re / n, im / n) if n > TINY else 0.0


@inline
def phases(local: tuple[Pair, Pair], slopes: tuple[Pair, Pair], nu: Pair, of: Reduced) -> Pair:
    """Phases of α and β at t = 0 from local functions, their rates without phases, and ν."""
    (f, g), (df, dg) = local, slopes
    df = df[0] - nu[0] * f[1], df[1] + nu[0] * f[0]
    dg = dg[0] - nu[1] * g[1], dg[1] + nu[1] * g[0]
    growth = -(f[0] * df[0] + f[1] * df[1] + g[0] * dg[0] + g[1] * dg[1])
    growth /= f[0] * f[0] + f[1] * f[1] + g[0] * g[0] + g[1] * g[1]  # of the real factor left out
    weight = 1.0 / (4.0 * of.lam * of.lam + nu[0] * nu[0] + nu[1] * nu[1] + TINY)
    df = (df[0] + growth * f[0], df[1] + growth * f[1])
    dg = (dg[0] + growth * g[0], dg[1] + growth * g[1])
    return (
        _fitted(f, df, of.values[0], of.rates[0], weight),
        _fitted(g, dg, of.values[1], of.rates[1], weight),
    )
