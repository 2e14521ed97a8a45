"""Sines, cosines, angles, exponentials that vectorise: polynomials, no call of libm.

Numba has no vector library for libm since 0.62, so a call of `math.sin` stops SIMD. A half angle
of a quaternion may be reduced modulo π, because q and -q are the same rotation.
"""

import math
from typing import Any

from particlerb.compiled.instructions import BITS, instruction
from particlerb.compiled.jit import inline

_INV_PI = 0.3183098861837907
_PI_HIGH = 3.141592651605606  # the first 29 bits of π: a product with an integer below 2²⁴ is exact
_PI_LOW = 1.984187159361081e-09  # π - _PI_HIGH
PI = 3.141592653589793
_HALF_PI = 1.5707963267948966
_INV_LOG2 = 1.4426950408889634
_SQRT2 = 1.4142135623730951
_LOG2_HIGH = 0.6931471787393093  # log 2 to 29 bits, and the rest
_LOG2_LOW = 1.8206359985041462e-09
_MIN_EXPONENT = -700.0  # exp of it is 1e-304
_INTEGER_SHIFT = 6755399441055744.0  # 1.5 · 2⁵²: adding and subtracting it rounds to an integer
_TWO_52_BITS = 0x4330000000000000  # bits of 2⁵²: an integer below 2⁵² added to them gives that sum


@inline
def reduce_modulo_pi(x: float) -> tuple[float, float]:
    """Return (r, n) with x = r + n π, |r| <= π/2, n integral.

    The error of r is that of one rounding of r for |x| < 2²⁴ π; beyond, it grows like x's own.
    """
    n = (x * _INV_PI + _INTEGER_SHIFT) - _INTEGER_SHIFT
    return (x - n * _PI_HIGH) - n * _PI_LOW, n


@inline
def cos_sinc(y: float) -> tuple[float, float]:
    """Return cos √y and sin √y / √y for 0 <= y <= (π/2)², to 4e-17 and 1e-17 before rounding.

    Both are entire functions of y; interpolated at the Chebyshev points of the interval.
    """
    y2 = y * y
    y4 = y2 * y2
    cos = (
        (1.0 - 0.4999999999999997 * y)
        + (0.04166666666666386 - 0.0013888888888772296 * y) * y2
        + (
            (2.48015872772945e-05 - 2.755731637975365e-07 * y)
            + (2.0876561258872958e-09 - 1.1462886384313275e-11 * y + 4.6088093988032985e-14 * y2)
            * y2
        )
        * y4
    )
    sinc = (
        (1.0 - 0.16666666666666666 * y)
        + (0.008333333333333186 - 0.0001984126984120831 * y) * y2
        + (
            (2.7557319211166023e-06 - 2.5052106884617687e-08 * y)
            + (1.6058940571674158e-10 - 7.643018364326954e-13 * y + 2.721486441670626e-15 * y2) * y2
        )
        * y4
    )
    return cos, sinc


@inline
def half_turns(x: float) -> tuple[float, float]:
    """Return r and (-1)ⁿ with x = r + n π, |r| <= π/2, for every x.

    A phase too large to have a meaningful angle gets one all the same.
    """
    r, n = reduce_modulo_pi(x)
    r = max(-_HALF_PI, min(_HALF_PI, r))  # in this order: a NaN turns into a number
    odd = n - 2.0 * ((0.5 * n + _INTEGER_SHIFT) - _INTEGER_SHIFT)
    return r, 1.0 if odd * odd < 0.5 else -1.0


@inline
def cos_sin_half_turns(x: float) -> tuple[float, float, float]:
    """Return (-1)ⁿ cos x, (-1)ⁿ sin x and (-1)ⁿ, n half turns being taken off."""
    r, sign = half_turns(x)
    cos, sinc = cos_sinc(r * r)
    return cos, r * sinc, sign


@inline
def angle_of(cos: float, sin: float) -> float:
    """Angle in [-π, π] of a unit vector: a quarter of it has its tangent within ±0.4143.

    atan y / y is an even function, interpolated at the Chebyshev points of y² <= (√2 - 1)².
    """
    tan_half = sin / (1.0 + abs(cos))
    tan = tan_half / (1.0 + math.sqrt(1.0 + tan_half * tan_half))
    y = tan * tan
    series = -0.017805397205419446
    series = series * y + 0.03796525745386593
    series = series * y - 0.05035102456601552
    series = series * y + 0.05846878297330872
    series = series * y - 0.06662951813629191
    series = series * y + 0.07692045330902225
    series = series * y - 0.09090896809064027
    series = series * y + 0.11111110744919658
    series = series * y - 0.14285714279250245
    series = series * y + 0.19999999999940893
    series = series * y - 0.3333333333333312
    angle = 4.0 * (tan + tan * (series * y))
    supplement = (PI if sin >= 0.0 else -PI) - angle
    return angle if cos >= 0.0 else supplement


def _plain_power_of_two(rounded: float) -> float:
    """2ⁿ of n + _INTEGER_SHIFT."""
    return math.ldexp(1.0, int(rounded - _INTEGER_SHIFT))


@instruction(_plain_power_of_two)
def _power_of_two(builder: Any, rounded: Any) -> Any:
    """2ⁿ of n + _INTEGER_SHIFT: the last bits of that sum are n, shifted into the exponent."""
    exponent = builder.add(builder.bitcast(rounded, BITS), BITS(1023))
    return builder.bitcast(builder.shl(exponent, BITS(52)), rounded.type)


@inline
def decay(x: float) -> float:
    """Return exp x for x <= 0; below _MIN_EXPONENT it is exp(_MIN_EXPONENT), as good as zero."""
    x = x if x > _MIN_EXPONENT else _MIN_EXPONENT
    rounded = x * _INV_LOG2 + _INTEGER_SHIFT
    n = rounded - _INTEGER_SHIFT
    y = (x - n * _LOG2_HIGH) - n * _LOG2_LOW
    exp = 2.09215799649503e-09
    exp = exp * y + 2.5114869528657765e-08
    exp = exp * y + 2.7557251904174915e-07
    exp = exp * y + 2.7557224958392624e-06
    exp = exp * y + 2.4801587350110797e-05
    exp = exp * y + 0.000198412699092171
    exp = exp * y + 0.001388888888887189
    exp = exp * y + 0.008333333333309528
    exp = exp * y + 0.04166666666666669
    exp = exp * y + 0.16666666666666702
    exp = exp * y + 0.5
    exp = exp * y + 1.0
    exp = exp * y + 1.0
    return exp * _power_of_two(rounded)


def _plain_exponent(x: float) -> float:
    """Floor of log₂ x."""
    return math.frexp(x)[1] - 1.0


@instruction(_plain_exponent)
def exponent(builder: Any, x: Any) -> Any:
    """Floor of log₂ x of a normal x > 0: the exponent bits, as a double."""
    bits = builder.lshr(builder.bitcast(x, BITS), BITS(52))
    double = builder.bitcast(builder.add(bits, BITS(_TWO_52_BITS)), x.type)
    return builder.fsub(double, x.type(2.0**52 + 1023.0))


@inline
def scale_of(x: float) -> float:
    """2⁻ⁿ of a normal x > 0 with x = m 2ⁿ, 1 <= m < 2; n is 1022 at most."""
    return _power_of_two(_INTEGER_SHIFT - min(exponent(x), 1022.0))


@inline
def logarithm(x: float) -> float:
    """Return log x for a normal x > 0: n log 2 + 2 artanh s with |s| <= 0.1716."""
    n = exponent(x)
    mantissa = x * _power_of_two(_INTEGER_SHIFT - n)
    large = mantissa > _SQRT2
    n = n + 1.0 if large else n
    mantissa = 0.5 * mantissa if large else mantissa
    s = (mantissa - 1.0) / (mantissa + 1.0)
    y = s * s
    series = 0.14809710360655276
    series = series * y + 0.1531252814836419
    series = series * y + 0.18183631680229329
    series = series * y + 0.22222197056726048
    series = series * y + 0.2857142876064168
    series = series * y + 0.3999999999930234
    series = series * y + 0.6666666666666765
    series = series * y + 2.0
    return n * _LOG2_HIGH + (s * series + n * _LOG2_LOW)
