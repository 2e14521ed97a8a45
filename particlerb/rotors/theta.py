"""Closed-form free rotation of asymmetric bodies as two theta functions (docs/free_rotation.md).

`reduce` brings a body into the form of the theory: axes 1, 2, 3 with the middle moment in the
middle, L circling about axis 3. `theta_local` and `near_local` evaluate the two forms of the
solution, `theta_constants` and `near_constants` prepare them. (n) are formulas of the document.
"""

import math
from typing import NamedTuple, TypeAlias

from particlerb.compiled.jit import inline
from particlerb.maths import double_double as dd
from particlerb.maths.elliptic import imaginary_phase, landen, nome, phase
from particlerb.maths.quaternion import Quat, multiply
from particlerb.maths.trig import PI, angle_of, cos_sin_half_turns, decay, half_turns, logarithm
from particlerb.maths.vec3 import Vec3

TINY = 1e-300  # added to positive denominators that underflow can make zero
_Axis: TypeAlias = tuple[float, float, float]  # moment; component of L in 32 digits: high, low
_Six: TypeAlias = tuple[float, float, float, float, float, float]


class _Reduced(NamedTuple):
    """A body in the form of the theory."""

    m: Vec3
    """Components of L along axes 1, 2, 3, the last >= 0."""
    inertia: Vec3
    d12: float
    """|I1 - I2|, and so on."""
    d13: float
    d23: float
    k: float
    kc: float
    """k′ = √(1 - k²)."""
    s: float
    """+1 where L circles about the axis of the largest moment, else -1."""
    frame: Quat
    """From the rotor frame into that of axes 1, 2, 3: small integers, not of length 1."""


class _EllipticRates(NamedTuple):
    """What both forms of the solution are made from."""

    lam: float
    """Rate λ of the elliptic argument."""
    base: float
    """The part of ν that stands before the logarithmic derivative."""
    ratio: float
    """|β/α| where L is in the plane of axes 1 and 3."""
    sn: float
    cn: float
    """sn u and cn u at t = 0."""
    root_sigma: float
    root_gamma: float
    """sn(v0, k′) and cn(v0, k′), (8)."""


class ThetaCoefficients(NamedTuple):
    """What both theta functions are made of, (12): three numbers instead of fifteen."""

    cosh: float
    """√h cosh b with h = q²; h^(1/4) at most, so that nothing overflows."""
    sinh: float
    """s √h sinh b."""
    kappa: float
    """s κ/√h."""


class NearCoefficients(NamedTuple):
    """Constants of the form near the separatrix."""

    fall: float
    """2/T."""
    r: float
    s: float
    kappa: float
    turn: float
    """Phase per x, 2sη/π."""
    cosines: _Six
    """cos η, r cos 3η, r⁴ cos 5η, r⁹ cos 7η, r² cos 3η, r⁶ cos 5η."""
    sines: _Six


class _Clock(NamedTuple):
    """x = start + rate t; common phase nu t."""

    start: float
    rate: float
    nu: float


@inline
def _exchange(x: _Axis, y: _Axis, swap: bool) -> tuple[_Axis, _Axis]:
    """(x, y) -> (y, -x), a quarter turn."""
    return (
        (y[0] if swap else x[0], y[1] if swap else x[1], y[2] if swap else x[2]),
        (x[0] if swap else y[0], -x[1] if swap else y[1], -x[2] if swap else y[2]),
    )


@inline
def _discriminant(a: _Axis, b: _Axis, c: _Axis) -> float:
    """Lc² (Ic - Ib) Ia - La² (Ib - Ia) Ic in 32 digits: the sign of (2)."""
    upper, lower = (c[1], c[2]), (a[1], a[2])
    upper = dd.times(dd.multiply(dd.multiply(upper, upper), dd.two_sum(c[0], -b[0])), a[0])
    lower = dd.times(dd.multiply(dd.multiply(lower, lower), dd.two_sum(b[0], -a[0])), c[0])
    return dd.add(upper, dd.minus(lower))[0]


@inline
def _sort_axes(a: _Axis, b: _Axis, c: _Axis) -> tuple[_Axis, _Axis, _Axis, Quat]:
    """Axes by rising moment, and the (unnormalised) product of the quarter turns that do it."""
    swap = a[0] > b[0]
    a, b = _exchange(a, b, swap)
    frame = (1.0, 0.0, 0.0, -1.0 if swap else 0.0)
    swap = b[0] > c[0]
    b, c = _exchange(b, c, swap)
    frame = multiply((1.0, -1.0 if swap else 0.0, 0.0, 0.0), frame)
    swap = a[0] > b[0]
    a, b = _exchange(a, b, swap)
    return a, b, c, multiply((1.0, 0.0, 0.0, -1.0 if swap else 0.0), frame)


@inline
def reduce(inertia: Vec3, m: dd.Wide3) -> _Reduced:
    """Sort the axes, choose axis 3, measure the distance from the separatrix: (2), (3).

    `m` is L in the rotor frame, in 32 digits.
    """
    a, b, c, frame = _sort_axes(
        (inertia[0], m[0][0], m[0][1]),
        (inertia[1], m[1][0], m[1][1]),
        (inertia[2], m[2][0], m[2][1]),
    )
    D = _discriminant(a, b, c)
    swap = D < 0.0 or (D == 0.0 and c[0] - b[0] <= b[0] - a[0])
    a, c = _exchange(a, c, swap)
    frame = multiply((1.0, 0.0, 1.0 if swap else 0.0, 0.0), frame)
    flip = c[1] < 0.0
    sign = -1.0 if flip else 1.0
    frame = multiply((0.0 if flip else 1.0, 1.0 if flip else 0.0, 0.0, 0.0), frame)
    d12, d13, d23 = abs(a[0] - b[0]), abs(a[0] - c[0]), abs(b[0] - c[0])
    inside = (a[1] * a[1] * d13 / a[0] + b[1] * b[1] * d23 / b[0]) * d12
    outside = abs(D) / (a[0] * c[0]) * d13
    inv = 1.0 / (inside + outside + TINY)
    return _Reduced(
        (a[1], sign * b[1], sign * c[1]),
        (a[0], b[0], c[0]),
        d12,
        d13,
        d23,
        math.sqrt(max(inside * inv, TINY)),
        math.sqrt(max(outside * inv, TINY)),
        -1.0 if swap else 1.0,
        frame,
    )


@inline
def square(q: Quat) -> float:
    """|q|²."""
    return q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]


@inline
def _unit2(s: float, c: float) -> tuple[float, float]:
    """(s, c) made a unit vector; (0, 1) if both are zero."""
    largest = max(abs(s), abs(c))
    inv = 1.0 / max(largest, TINY)
    s, c = s * inv, c * inv if largest > TINY else 1.0
    inv = 1.0 / math.sqrt(s * s + c * c)
    return s * inv, c * inv


@inline
def rates(body: _Reduced) -> _EllipticRates:
    """Amplitudes, rates and initial sn, cn: (3), (4)."""
    m1, m2, m3 = body.m
    I1, I2, I3 = body.inertia
    d12, d13, d23 = body.d12, body.d13, body.d23
    sigma, gamma = I1 * d23 / (I2 * d13), I3 * d12 / (I2 * d13)  # their sum is 1
    e1 = m2 * m2 * (d12 / I2) + m3 * m3 * (d13 / I3)
    lam = math.sqrt(e1 / I1) * math.sqrt(d23 / I2 / I3)
    A1 = math.sqrt(m1 * m1 + m2 * m2 * sigma)
    A3 = math.sqrt(m3 * m3 + m2 * m2 * gamma)
    G = math.sqrt(m1 * m1 + m2 * m2 + m3 * m3)
    root = math.sqrt(sigma)
    sn, cn = _unit2(body.s * m2 * root, m1)  # both times A1
    ratio = A1 / (G + A3)
    base = 0.5 * (A3 / I3 + ratio * A1 / I1)
    return _EllipticRates(lam, base, ratio, sn, cn, root, math.sqrt(gamma))


@inline
def _theta_at_zero(q: float, S: float) -> Vec3:
    """Of nome q and S = sinh b: θ₄(ib), its derivative by b, θ₁(ib) / (2 i q^¼ S).

    X and Z are 2qⁿ cosh 2nb and 2qⁿ sinh 2nb, which stay below 1 where cosh 2nb overflows.
    """
    q2 = q * q
    q4, q6 = q2 * q2, q2 * q2 * q2
    X1, Z1 = q * (2.0 + 4.0 * S * S), 4.0 * q * S * math.sqrt(1.0 + S * S)
    X2, Z2 = X1 * X1 - 2.0 * q2, X1 * Z1
    X3, Z3 = X1 * X2 - q2 * X1, Z1 * (X2 + q2)
    term1 = q2 + q * X1  # qⁿ⁽ⁿ⁺¹⁾ sinh (2n+1)b / sinh b
    term2 = q4 * (X2 + q2 + q * X1)
    term3 = q6 * q2 * (q * (X3 + q2 * X1) + q2 * (X2 + q2))
    return (
        1.0 - X1 + q2 * X2 - q6 * X3,
        -2.0 * Z1 + 4.0 * q2 * Z2 - 6.0 * q6 * Z3,
        1.0 - term1 + term2 - term3,
    )


@inline
def theta_constants(body: _Reduced) -> tuple[_Clock, ThetaCoefficients]:
    """Constants for K′ >= K/2, all of them algebraic but the angle x at t = 0: (8) to (10)."""
    rate = rates(body)
    chain = landen(body.k, body.kc)
    sin_x, cos_x = phase(chain, rate.sn, rate.cn)
    S = imaginary_phase(chain, rate.root_sigma / max(rate.root_gamma, TINY)) + TINY
    theta4, slope, theta1 = _theta_at_zero(chain.nome_squared, S)
    x_rate = rate.lam / chain.period
    clock = _Clock(angle_of(cos_x, sin_x), x_rate, rate.base - body.s * x_rate * slope / theta4)
    root = max(math.sqrt(chain.nome_squared), 0.25 * chain.k1)  # k₁/4 where the square underflows
    kappa = rate.ratio * theta4 / (theta1 * S)
    return clock, ThetaCoefficients(
        root * math.sqrt(1.0 + S * S), body.s * (root * S), body.s * (kappa / root)
    )


@inline
def theta_local(x: float, of: ThetaCoefficients) -> Quat:
    """(α, β) of (7) as a quaternion, without e^{iνt} and a positive factor; by (12)."""
    cos, sin, sign = cos_sin_half_turns(x)
    U1 = 2.0 - 4.0 * sin * sin
    U2 = U1 * U1 - 1.0
    U3 = U1 * (U2 - 1.0)
    C, S, kappa = of
    h, X, Z = (C - S) * (C + S), C * C + S * S, C * S
    p = h * h
    p2, p3, w = p * p, p * p * p, 4.0 * X * X - p
    even1, odd1 = p, 2.0 * h * X
    even2, odd2 = p2 * odd1, p2 * w
    even3, odd3 = p3 * odd2, p2 * even2 * (w - p)
    cosines = 0.5 * p * (w - p) * (U2 - 1.0) - p3 * X * (w - 2.0 * p) * (U3 - U1)
    alpha_re = (1.0 - X * U1) + cosines
    alpha_im = (8.0 * Z) * (sin * cos) * ((2.0 * p * X * U1 - 1.0) - p3 * w * U2)
    E = 1.0 + ((even1 - (odd1 + even2) * U1) + ((odd2 + even3) * U2 - odd3 * U3))
    F = ((even1 + odd2) * U1 - odd1) + (even3 * U3 - (even2 + odd3) * U2)
    kappa = sign * kappa
    return alpha_re, (C * kappa) * sin * (E + F), (S * kappa) * cos * (F - E), alpha_im


@inline
def twist(q: Quat, phase: float) -> Quat:
    """q e^{iφ}: q after a turn by 2φ about axis 3."""
    cos, sin, _ = cos_sin_half_turns(phase)
    return (
        q[0] * cos - q[3] * sin,
        q[1] * cos + q[2] * sin,
        q[2] * cos - q[1] * sin,
        q[3] * cos + q[0] * sin,
    )


@inline
def oriented(left: Quat, phase: float, local: Quat, right: Quat) -> Quat:
    """Q_L e^{iφ} g P with g = (α, β) made a unit, (11).

    The root is taken beside the products, not before them: a shorter chain of instructions.
    """
    inv = 1.0 / math.sqrt(square(local))
    q = multiply(twist(left, phase), multiply(local, right))
    return q[0] * inv, q[1] * inv, q[2] * inv, q[3] * inv


@inline
def near_constants(body: _Reduced) -> tuple[_Clock, NearCoefficients]:
    """Constants for K′ < K/2, (15): nome and moduli are those of the complementary modulus."""
    rate = rates(body)
    chain = landen(body.kc, body.k)
    twice = phase(chain, rate.root_sigma, rate.root_gamma)  # sin 2η, cos 2η
    eta = 0.5 * angle_of(twice[1], twice[0])
    cos1 = math.sqrt(0.5 + 0.5 * twice[1])
    sin1 = 0.5 * twice[0] / cos1
    c2, s2 = twice[1], twice[0]
    cos3, sin3 = cos1 * c2 - sin1 * s2, sin1 * c2 + cos1 * s2
    cos5, sin5 = cos3 * c2 - sin3 * s2, sin3 * c2 + cos3 * s2
    cos7, sin7 = cos5 * c2 - sin5 * s2, sin5 * c2 + cos5 * s2
    r2 = nome(body.kc, body.k)
    r = math.sqrt(r2)
    r4 = r2 * r2
    r6 = r4 * r2
    r12 = r6 * r6
    fall = -(2.0 / PI) * logarithm(r)
    sinh = imaginary_phase(chain, abs(rate.sn) / max(abs(rate.cn), 1e-150))
    x = logarithm(sinh + math.sqrt(1.0 + sinh * sinh)) / fall
    x = PI - x if rate.cn < 0.0 else x
    x = -x if rate.sn < 0.0 else x
    lam = rate.lam / chain.period
    den = cos1 + r2 * cos3 + r6 * cos5 + r12 * cos7
    num = sin1 + 3.0 * r2 * sin3 + 5.0 * r6 * sin5 + 7.0 * r12 * sin7
    alternating = sin1 - r2 * sin3 + r6 * sin5 - r12 * sin7
    omega = lam / fall
    turn = 2.0 * body.s * eta / PI
    nu = rate.base + 0.5 * body.s * lam * num / den - turn * omega
    return _Clock(x, omega, nu), NearCoefficients(
        fall,
        r,
        body.s,
        rate.ratio * den / (alternating + TINY),
        turn,
        (cos1, r * cos3, r4 * cos5, r4 * r4 * r * cos7, r2 * cos3, r6 * cos5),
        (sin1, r * sin3, r4 * sin5, r4 * r4 * r * sin7, r2 * sin3, r6 * sin5),
    )


@inline
def near_local(x: float, of: NearCoefficients) -> tuple[Quat, float]:
    """The same near the separatrix, (14), and ±δ; divided by ½ exp |ξ|, so that nothing grows."""
    x, sign = half_turns(x)
    y = decay(-of.fall * abs(x))
    z = of.r / y
    side = 1.0 if x >= 0.0 else -1.0
    c, s = of.cosines, of.sines
    z2, y2 = z * z, y * y
    even_c, odd_c = c[0] + c[2] * z2, z * (c[1] + c[3] * z2)
    even_s, odd_s = s[0] + s[2] * z2, z * (s[1] + s[3] * z2)
    fall_even_c, fall_odd_c = y * (c[0] + c[5] * y2), c[4] * y2
    fall_even_s, fall_odd_s = y * (s[0] + s[5] * y2), s[4] * y2
    p_re = (even_c + odd_c) + (fall_even_c + fall_odd_c)
    p_im = side * ((even_s + odd_s) - (fall_even_s + fall_odd_s))
    w_re = side * ((even_c - odd_c) - (fall_even_c - fall_odd_c))
    w_im = -((even_s - odd_s) + (fall_even_s - fall_odd_s))
    kappa = sign * of.kappa
    return (p_re, of.s * kappa * w_re, kappa * w_im, -of.s * p_im), of.turn * x
