"""Free rotation over one step by the symmetric-top splitting, order 2; exact for symmetric tops.

H = [a₂ |m|²/2 + (a₃ - a₂) m₃²/2] + (a₁ - a₂) m₁²/2 with a = 1/I and m = Rᵀ L. The bracket is a
symmetric top and has a closed flow, the rest is a turn about axis 1; they follow each other as
half - whole - half. With the axes ordered so that a₁ and a₂ are closest, the error is smallest;
where they are equal the rest vanishes and the flow is exact.

Source: Touma and Wisdom, Astron. J. 107, 1189 (1994); Dullweber, Leimkuhler and McLachlan,
J. Chem. Phys. 107, 5840 (1997). See docs/theory.md, section 5.
"""

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Quat, multiply
from particlerb.maths.trig import cos_sinc, reduce_modulo_pi
from particlerb.maths.vec3 import Vec3, dot, scale

_QUARTER_TURN_SQUARED = 2.4674011002723395  # (π/2)²


@inline
def _half_and_whole(half_angle: float) -> Quat:
    """Cosine and sine of half an angle up to a common sign, and of the whole one."""
    x, _ = reduce_modulo_pi(half_angle)
    c, s = cos_sinc(x * x)
    s = x * s
    return c, s, 1 - 2 * s * s, 2 * s * c


@inline
def _turn_about_1(half_angle: float, m: Vec3, q: Quat) -> tuple[Vec3, Quat]:
    """Turn a body about its axis 1: new body components of a world vector m, new orientation."""
    c, s, cos, sin = _half_and_whole(half_angle)
    m = (m[0], cos * m[1] + sin * m[2], cos * m[2] - sin * m[1])
    q = (c * q[0] - s * q[1], c * q[1] + s * q[0], c * q[2] + s * q[3], c * q[3] - s * q[2])
    return m, q


@inline
def _turn_about_3(half_angle: float, m: Vec3, q: Quat) -> tuple[Vec3, Quat]:
    """Turn a body about its axis 3: new body components of a world vector m, new orientation."""
    c, s, cos, sin = _half_and_whole(half_angle)
    m = (cos * m[0] + sin * m[1], cos * m[1] - sin * m[0], m[2])
    q = (c * q[0] - s * q[3], c * q[1] + s * q[2], c * q[2] - s * q[1], c * q[3] + s * q[0])
    return m, q


@inline
def turn_by(half: Vec3, q: Quat) -> Quat:
    """q exp(half): turn about a body axis; `half` is half the rotation vector [rad].

    Through half that angle: no root and no division. For |half| <= π, a whole turn; larger
    angles are cut to it, so that q stays a rotation where a step is far too long.
    """
    c, s = cos_sinc(min(0.25 * dot(half, half), _QUARTER_TURN_SQUARED))
    v = scale(c * s, half)
    return multiply(q, (2 * c * c - 1, v[0], v[1], v[2]))


@inline
def _renormalised(q: Quat) -> Quat:
    """One Newton step towards |q| = 1: enough where a product of unit quaternions was rounded."""
    f = 1.5 - 0.5 * (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return f * q[0], f * q[1], f * q[2], f * q[3]


@inline
def _turn_of_top(q: Quat, m: Vec3, a: Vec3, dt: float) -> tuple[Vec3, Quat]:
    """Exact turn where a[0] is a[1]: new body components of m, new orientation."""
    q = turn_by(scale(0.5 * dt * a[1], m), q)
    return _turn_about_3(0.5 * dt * (a[2] - a[1]) * m[2], m, q)


@inline
def symmetric_top(q: Quat, m: Vec3, a: Vec3, dt: float) -> Quat:
    """The same as `symmetric_split`, bit for bit, where a[0] is a[1]."""
    return _renormalised(_turn_of_top(q, m, a, dt)[1])


@inline
def symmetric_split(q: Quat, m: Vec3, a: Vec3, dt: float) -> Quat:
    """Orientation after dt; m = Rᵀ L in the rotor frame, a = 1/I with a[0], a[1] closest."""
    k = 0.25 * dt * (a[0] - a[1])
    m, q = _turn_about_1(k * m[0], m, q)
    m, q = _turn_of_top(q, m, a, dt)
    _, q = _turn_about_1(k * m[0], m, q)
    return _renormalised(q)
