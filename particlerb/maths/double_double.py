"""Numbers of 32 digits as unevaluated sums (high, low) of two doubles.

For differences that cancel while a body is prepared: the separatrix discriminant of a free body
loses in doubles every digit that its angular momentum still has. `_fused` is the one rounding of
a b + c that everything rests on; it is an instruction of its own, so that no compiler setting can
change it.

Sources: Dekker, Numer. Math. 18, 224 (1971); Knuth, The Art of Computer Programming 2, 4.2.2;
Joldes, Muller, Popescu, ACM Trans. Math. Softw. 44, 15res (2017), algorithms 6 and 11.
"""

from typing import Any, TypeAlias

from particlerb.compiled.instructions import instruction
from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Vec3

_DoubleDouble: TypeAlias = tuple[float, float]
Wide3: TypeAlias = tuple[_DoubleDouble, _DoubleDouble, _DoubleDouble]
_SPLIT_FACTOR = 134217729.0  # 2²⁷ + 1


def split(a: float) -> _DoubleDouble:
    """Two halves of 26 bits with a = high + low (Veltkamp)."""
    scaled = _SPLIT_FACTOR * a
    high = scaled - (scaled - a)
    return high, a - high


def _plain_fused(a: float, b: float, c: float) -> float:
    """a b + c with the product exact (Dekker), so that a b - round(a b) is exact as well."""
    product = a * b
    (a1, a2), (b1, b2) = split(a), split(b)
    rest = ((a1 * b1 - product) + a1 * b2 + a2 * b1) + a2 * b2
    return (product + c) + rest


def exact_difference(a: Any, b: Any, c: Any, d: Any) -> Any:
    """a b - c d of arrays, to two roundings: zero only where it is."""
    p, r = a * b, c * d
    return (p - r) + (_plain_fused(a, b, -p) - _plain_fused(c, d, -r))


@instruction(_plain_fused)
def _fused(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c in one rounding: LLVM's fma, which vectorises."""
    return builder.fma(a, b, c)


@inline
def two_sum(a: float, b: float) -> _DoubleDouble:
    """a + b without error (Knuth)."""
    s = a + b
    c = s - a
    return s, (a - (s - c)) + (b - c)


@inline
def two_product(a: float, b: float) -> _DoubleDouble:
    """a b without error."""
    product = a * b
    return product, _fused(a, b, -product)


@inline
def renormalise(high: float, low: float) -> _DoubleDouble:
    """high + low, its low part at most half an ulp; needs |high| >= |low| or high = 0."""
    s = high + low
    return s, low - (s - high)


@inline
def add(x: _DoubleDouble, y: _DoubleDouble) -> _DoubleDouble:
    """x + y, error below 2⁻¹⁰⁵ of the result also where it cancels (accurate addition)."""
    s, e = two_sum(x[0], y[0])
    t, f = two_sum(x[1], y[1])
    s, e = renormalise(s, e + t)
    return renormalise(s, e + f)


@inline
def times(x: _DoubleDouble, a: float) -> _DoubleDouble:
    """x a, relative error below 2⁻¹⁰⁴."""
    high, low = two_product(x[0], a)
    return renormalise(high, _fused(x[1], a, low))


@inline
def multiply(x: _DoubleDouble, y: _DoubleDouble) -> _DoubleDouble:
    """x y, relative error below 2⁻¹⁰³."""
    high, low = two_product(x[0], y[0])
    return renormalise(high, low + (x[0] * y[1] + x[1] * y[0]))


@inline
def reciprocal(x: _DoubleDouble) -> _DoubleDouble:
    """1 / x, relative error below 2⁻¹⁰⁰: one Newton step on the quotient of doubles."""
    r = 1.0 / x[0]
    error = _fused(-x[1], r, _fused(-x[0], r, 1.0))
    return renormalise(r, r * error)


@inline
def minus(x: _DoubleDouble) -> _DoubleDouble:
    """-x."""
    return -x[0], -x[1]


@inline
def _cross_part(a: float, b: float, c: float, d: float) -> _DoubleDouble:
    """a b - c d."""
    return add(two_product(a, b), two_product(-c, d))


@inline
def _cross_part_wide(a: float, b: _DoubleDouble, c: float, d: _DoubleDouble) -> _DoubleDouble:
    """a b - c d with b and d of 32 digits."""
    return add(times(b, a), times(d, -c))


@inline
def to_body(q: tuple[float, float, float, float], v: Vec3) -> Wide3:
    """Rᵀ v for the rotation of q / |q|: v + w t + u × t, u = (-x, -y, -z), t = 2 u × v / |q|²."""
    w, x, y, z = q[0], -q[1], -q[2], -q[3]
    norm = add(add(two_product(w, w), two_product(x, x)), add(two_product(y, y), two_product(z, z)))
    inv = reciprocal((0.5 * norm[0], 0.5 * norm[1]))
    t1 = multiply(inv, _cross_part(y, v[2], z, v[1]))
    t2 = multiply(inv, _cross_part(z, v[0], x, v[2]))
    t3 = multiply(inv, _cross_part(x, v[1], y, v[0]))
    turned1 = add(times(t1, w), _cross_part_wide(y, t3, z, t2))
    turned2 = add(times(t2, w), _cross_part_wide(z, t1, x, t3))
    turned3 = add(times(t3, w), _cross_part_wide(x, t2, y, t1))
    return (add((v[0], 0.0), turned1), add((v[1], 0.0), turned2), add((v[2], 0.0), turned3))
