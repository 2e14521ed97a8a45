"""Sines and cosines that vectorise: reduction modulo π and polynomials, no call of libm.

Numba has no vector library for libm since 0.62, so a call of `math.sin` stops SIMD. A half angle
of a quaternion may be reduced modulo π, because q and -q are the same rotation.
"""

from particlerb._jit import inline

INV_PI = 0.3183098861837907
PI_HIGH = 3.141592651605606  # the first 29 bits of π: a product with an integer below 2²⁴ is exact
PI_LOW = 1.984187159361081e-09  # π - PI_HIGH
ROUNDING = 6755399441055744.0  # 1.5 · 2⁵²: adding and subtracting it rounds to an integer


@inline
def reduce_modulo_pi(x: float) -> tuple[float, float]:
    """Return (r, n) with x = r + n π, |r| <= π/2, n integral.

    The error of r is that of one rounding of r for |x| < 2²⁴ π; beyond, it grows like x's own.
    """
    n = (x * INV_PI + ROUNDING) - ROUNDING
    return (x - n * PI_HIGH) - n * PI_LOW, n


@inline
def cos_sinc(y: float) -> tuple[float, float]:
    """Return cos √y and sin √y / √y for 0 <= y <= (π/2)², to 4e-17 and 1e-17 before rounding.

    Both are entire functions of y; interpolated at the Chebyshev points of the interval.
    """
    cos = 4.6088093988032985e-14
    cos = cos * y - 1.1462886384313275e-11
    cos = cos * y + 2.0876561258872958e-09
    cos = cos * y - 2.755731637975365e-07
    cos = cos * y + 2.48015872772945e-05
    cos = cos * y - 0.0013888888888772296
    cos = cos * y + 0.04166666666666386
    cos = cos * y - 0.4999999999999997
    cos = cos * y + 1.0
    sinc = 2.721486441670626e-15
    sinc = sinc * y - 7.643018364326954e-13
    sinc = sinc * y + 1.6058940571674158e-10
    sinc = sinc * y - 2.5052106884617687e-08
    sinc = sinc * y + 2.7557319211166023e-06
    sinc = sinc * y - 0.0001984126984120831
    sinc = sinc * y + 0.008333333333333186
    sinc = sinc * y - 0.16666666666666666
    sinc = sinc * y + 1.0
    return cos, sinc
