"""Both forms of the motion of Lagrange's top: thetas of the nome, and those next to the separatrix.

α and β are, without a common real factor, e^{i(νt + φ)} times a local function of x, which turns
by π in half a period of the nutation: entire functions, so that both poles are ordinary points.
`theta_constants` and `near_constants` prepare them, `theta_local` and `near_local` evaluate them.
(Tn) are formulas of docs/closed_forms.md.
"""

import math
from typing import Final, NamedTuple, TypeAlias

from particlerb.compiled.jit import inline
from particlerb.maths.elliptic import Landen, imaginary_phase, landen, nome, phase
from particlerb.maths.trig import PI, angle_of, decay, half_turns, logarithm
from particlerb.rotors.lagrange import Pair, Reduced, phases, sign_of

_MIN_KC: Final = 0.17
Five: TypeAlias = tuple[float, float, float, float, float]
Local: TypeAlias = tuple[Pair, Pair]  # the functions of α and β


class Clock(NamedTuple):
    """x = start + rate t, and phases φ + ν t of α and β."""

    start: float
    rate: float
    nu: Pair
    phase: Pair


class ThetaTop(NamedTuple):
    """Polynomials in U = 2 cos 2x: parts of α over sin x, cos x, of β over cos x, sin x."""

    alpha_sin: Five
    alpha_cos: Five
    beta_cos: Five
    beta_sin: Five


class NearTop(NamedTuple):
    """Constants of the form next to the separatrix, (T8)."""

    fall: float  # πK/K′ over π: ξ = fall x
    r: float  # exp(-πK/K′)
    kappa: float
    odd_cos: tuple[float, float, float]  # cos η, cos 3η, cos 5η of α
    odd_sin: tuple[float, float, float]
    even_cos: Pair  # cos 2η, cos 4η of β
    even_sin: Pair
    turns: Pair  # phases per x of α and β


@inline
def _sums(S: float, q: float) -> tuple[Five, Five]:
    """q^{n(n+1)} cosh (2n+1)b over e^b, and with sinh, n < 5, from S = sinh b; e^{-2b} >= q."""
    e = S + math.sqrt(1.0 + S * S)
    rho, less = 1.0 / (e * e), 2.0 * S / e
    g, r2, q2 = q * q / rho, rho * rho, q * q
    q6, r4 = q2 * q2 * q2, r2 * r2
    m1 = 0.5 * g
    m2 = 0.5 * g * g * q2
    m3 = 0.5 * g * g * g * q6
    m4 = 0.5 * (g * g) * (g * g) * (q6 * q6)
    o3 = 1.0 + rho + r2
    o5 = o3 + rho * r2 + r4
    o7 = o5 + r4 * rho + r4 * r2
    o9 = o7 + r4 * r2 * rho + r4 * r4
    return (
        0.5 + 0.5 * rho,
        m1 + m1 * rho * r2,
        m2 + m2 * rho * r4,
        m3 + m3 * rho * r2 * r4,
        m4 + m4 * rho * r4 * r4,
    ), (0.5 * less, m1 * less * o3, m2 * less * o5, m3 * less * o7, m4 * less * o9)


@inline
def _times_odd(c: Five) -> Five:
    """Coefficients of the derivative by b, or by x."""
    return c[0], 3.0 * c[1], 5.0 * c[2], 7.0 * c[3], 9.0 * c[4]


@inline
def _total(c: Five) -> float:
    """Sum, the smallest first."""
    return c[0] + (c[1] + (c[2] + (c[3] + c[4])))


@inline
def _scaled(k: float, c: Five, s: float) -> Five:
    """k c, every second one times s."""
    return k * c[0], k * s * c[1], k * c[2], k * s * c[3], k * c[4]


@inline
def _over_sin(c: Five) -> Five:
    """Σ cₙ sin (2n+1)x / sin x as a polynomial in U."""
    return (
        c[0] + c[1] - c[2] - c[3] + c[4],
        c[1] + c[2] - 2.0 * c[3] - 2.0 * c[4],
        c[2] + c[3] - 3.0 * c[4],
        c[3] + c[4],
        c[4],
    )


@inline
def _over_cos(c: Five) -> Five:
    """Σ cₙ cos (2n+1)x / cos x as a polynomial in U."""
    return (
        c[0] - c[1] - c[2] + c[3] + c[4],
        c[1] - c[2] - 2.0 * c[3] + 2.0 * c[4],
        c[2] - c[3] - 3.0 * c[4],
        c[3] - c[4],
        c[4],
    )


@inline
def _value(c: Five, U: float) -> float:
    """Polynomial."""
    return (c[0] + U * c[1]) + (U * U) * ((c[2] + U * c[3]) + (U * U) * c[4])


@inline
def _slope(c: Five, U: float) -> float:
    """Its derivative."""
    return (c[1] + U * (2.0 * c[2])) + (U * U) * (3.0 * c[3] + U * (4.0 * c[4]))


@inline
def theta_local(cos: float, sin: float, of: ThetaTop) -> tuple[Local, Local]:
    """Local functions and their derivatives by x, (T7)."""
    U, slope = 2.0 - 4.0 * sin * sin, -8.0 * sin * cos
    a, b = _value(of.alpha_sin, U), _value(of.alpha_cos, U)
    c, d = _value(of.beta_cos, U), _value(of.beta_sin, U)
    da, db = slope * _slope(of.alpha_sin, U), slope * _slope(of.alpha_cos, U)
    dc, dd = slope * _slope(of.beta_cos, U), slope * _slope(of.beta_sin, U)
    return ((sin * a, cos * b), (cos * c, sin * d)), (
        (cos * a + sin * da, cos * db - sin * b),
        (cos * dc - sin * c, cos * d + sin * dd),
    )


@inline
def _rates(local: Local, rate: float) -> Local:
    """Derivatives by t from those by x."""
    f, g = local
    return (rate * f[0], rate * f[1]), (rate * g[0], rate * g[1])


@inline
def theta_constants(of: Reduced) -> tuple[Clock, ThetaTop]:
    """Constants for K′ >= K/2: five terms of the thetas, (T5) to (T7); else without a meaning."""
    chain = landen(of.k, max(of.kc, _MIN_KC))
    q = max(math.sqrt(chain.nome_squared), 0.25 * chain.k1)  # k₁/4 where the square underflows
    sin, cos = phase(chain, of.argument[0], of.argument[1])
    rate = of.lam / chain.period
    sa, sb = of.signs
    ca, ha = _sums(imaginary_phase(chain, of.zeros[0]), q)
    cb, hb = _sums(imaginary_phase(chain, of.zeros[1]), q)
    nu = (
        of.bases[0] - sa * rate * _total(_times_odd(ha)) / _total(ca),
        of.bases[1] - sb * rate * _total(_times_odd(hb)) / _total(cb),
    )
    kappa = of.ratio / math.sqrt(of.kc) * _total(cb) / _total(ca)
    inv = 1.0 / max(kappa, 1.0)
    top = ThetaTop(
        _over_sin(_scaled(kappa * inv, ca, -1.0)),
        _over_cos(_scaled(-sa * kappa * inv, ha, -1.0)),
        _over_cos(_scaled(inv, cb, 1.0)),
        _over_sin(_scaled(sb * inv, hb, 1.0)),
    )
    local, slopes = theta_local(cos, sin, top)
    return Clock(angle_of(cos, sin), rate, nu, phases(local, _rates(slopes, rate), nu, of)), top


@inline
def near_local(x: float, of: NearTop) -> tuple[Local, Local]:
    """Local functions and their derivatives by x for |x| <= π/2, next to the separatrix, (T8)."""
    side, r, root, T = sign_of(x), of.r, math.sqrt(of.r), of.fall
    y, r4 = decay(-abs(x) * T), (r * r) * (r * r)
    z = root / y
    z2, y2, kappa = z * z, y * y, of.kappa
    p1, p3, p5 = kappa * z, kappa * r * z2 * z, kappa * r4 * (z2 * z2) * z
    m1, m3 = kappa * root * y, kappa * root * (r * r) * y2 * y
    e2, e4, f2, f4 = z2, r * r * z2 * z2, r * y2, r4 * y2 * y2
    c1, c3, c5 = of.odd_cos
    s1, s3, s5 = of.odd_sin
    (c2, c4), (s2, s4) = of.even_cos, of.even_sin
    f = (
        side * (c1 * (p1 - m1) - c3 * (p3 - m3) + c5 * p5),
        s3 * (p3 + m3) - s1 * (p1 + m1) - s5 * p5,
    )
    g = (1.0 - c2 * (e2 + f2)) + c4 * (e4 + f4), side * (s2 * (e2 - f2) - s4 * (e4 - f4))
    df = (
        T * (c1 * (p1 + m1) - 3.0 * c3 * (p3 + m3) + 5.0 * c5 * p5),
        side * T * (3.0 * s3 * (p3 - m3) - s1 * (p1 - m1) - 5.0 * s5 * p5),
    )
    dg = (
        side * T * (4.0 * c4 * (e4 - f4) - 2.0 * c2 * (e2 - f2)),
        T * (2.0 * s2 * (e2 + f2) - 4.0 * s4 * (e4 + f4)),
    )
    return (f, g), (df, dg)


class _Angle(NamedTuple):
    """What comes from the zero of α or of β: η = πw/2K′, with the sign of the rotation."""

    cos: float
    sin: float
    cos2: float
    sin2: float
    turn: float  # 2η/π, the phase per x
    rate: float  # all of the logarithmic derivative per x
    theta4: float  # θ₄(η)


@inline
def _angle(t: float, sign: float, chain: Landen, r: float, fall: float) -> _Angle:
    """From t = sc(w, k′)."""
    n = 1.0 / math.sqrt(1.0 + t * t) if t < 1e100 else 0.0
    sin, cos = phase(chain, t * n if t < 1e100 else 1.0, n)
    sin, r4 = sign * sin, (r * r) * (r * r)
    turn = sign * angle_of(cos, sign * sin) * (2.0 / PI)
    c2, s2 = cos * cos - sin * sin, 2.0 * cos * sin
    theta4 = 1.0 - 2.0 * r * c2 + 2.0 * r4 * (c2 * c2 - s2 * s2)
    rate = turn + fall * (4.0 * r * s2 - 16.0 * r4 * c2 * s2) / theta4
    return _Angle(cos, sin, c2, s2, turn, rate, theta4)


@inline
def near_constants(of: Reduced) -> tuple[Clock, NearTop]:
    """Constants for K′ < K/2, (T8): nome and moduli are those of the complementary modulus."""
    chain, r = landen(of.kc, of.k), nome(of.kc, of.k)
    fall, r4 = -logarithm(r) / PI, (r * r) * (r * r)
    sn, cn = of.argument
    sinh = imaginary_phase(chain, abs(sn) / max(abs(cn), 1e-150))
    x = logarithm(sinh + math.sqrt(1.0 + sinh * sinh)) / fall
    x = PI - x if cn < 0.0 else x
    rate = of.lam / (chain.period * fall)
    a = _angle(of.zeros[0], of.signs[0], chain, r, fall)
    b = _angle(of.zeros[1], of.signs[1], chain, r, fall)
    cos3, sin3 = a.cos * a.cos2 - a.sin * a.sin2, a.sin * a.cos2 + a.cos * a.sin2
    cos5, sin5 = cos3 * a.cos2 - sin3 * a.sin2, sin3 * a.cos2 + cos3 * a.sin2
    nu = of.bases[0] - rate * a.rate, of.bases[1] - rate * b.rate
    re = a.cos * (1.0 - r) - cos3 * (r - r4) + cos5 * r4
    im = a.sin * (1.0 + r) - sin3 * (r + r4) + sin5 * r4
    top = NearTop(
        fall,
        r,
        of.ratio * b.theta4 / (math.sqrt(re * re + im * im) * math.sqrt(math.sqrt(r) * of.kc)),
        (a.cos, cos3, cos5),
        (a.sin, sin3, sin5),
        (b.cos2, b.cos2 * b.cos2 - b.sin2 * b.sin2),
        (b.sin2, 2.0 * b.cos2 * b.sin2),
        (a.turn, b.turn),
    )
    remainder, _ = half_turns(x)
    local, slopes = near_local(remainder, top)
    (f, g), (df, dg) = local, _rates(slopes, rate)
    ua, ub = rate * a.turn, rate * b.turn
    slopes = (df[0] - ua * f[1], df[1] + ua * f[0]), (dg[0] - ub * g[1], dg[1] + ub * g[0])
    phase_a, phase_b = phases(local, slopes, nu, of)
    return Clock(x, rate, nu, (phase_a - a.turn * remainder, phase_b - b.turn * remainder)), top
