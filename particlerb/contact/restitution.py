"""Damping from the coefficient of restitution, and what one collision does, in closed form.

Both laws are one. A collision with `hooke` is m δ̈ = -(k δ + c δ̇). With `hertz` it is m δ̈ =
-(K δ^{3/2} + α √(m K) δ^{1/4} δ̇); with u = δ^{5/4} and dτ = δ^{1/4} dt that is du/dτ = (5/4) v,
m dv/dτ = -(K u + α √(m K) v): a linear oscillator again, with the ratio of damping ζ = α/√5 where
hooke has ζ = c/(2 √(m k)). With ζ = cos θ (cosh beyond 1), the velocity passes zero at the phase θ,
after which the peak is e^{-ζθ/sin θ} of that without damping; the force passes zero at the phase
2θ, where a contact that does not attract ends, with e = e^{-2ζθ/sin θ}. One that attracts goes on
to the phase π: e = e^{-πζ/sin θ}.

So every 0 < e <= 1 can be had. A clamped contact has e = e^{-2} = 0.135 at critical damping, and
e ≈ 1/(4ζ²) far beyond: none has e = 0. One that attracts has e = 0 at critical damping: the bodies
stay together.

Sources: Schwager and Pöschel, Granular Matter 9, 465 (2007), clamped hooke; Tsuji, Tanaka and
Ishida, Powder Technology 71, 239 (1992), the damping of hertz; Antypov and Elliott, EPL 94, 50004
(2011), that it is linear in u.
"""

import math
from typing import Final

NODES: Final = 60  # of the quadrature, on either side; its error is below 1e-13
REACH: Final = (
    3.4  # of the quadrature: its outermost nodes are e^{-47} of the interval from the ends
)


# Restitution and ratio of damping


def phase_over_sine(ratio: float) -> float:
    """θ/sin θ with cos θ = ζ; η/sinh η with cosh η = ζ beyond 1."""
    if ratio == 1.0:
        return 1.0
    sine = math.sqrt(abs(1.0 - ratio) * (1.0 + ratio))
    return (math.acos(ratio) if ratio < 1.0 else math.acosh(ratio)) / sine


def restitution(ratio: float, attract: bool = False) -> float:
    """Coefficient of restitution that a ratio of damping ζ >= 0 gives."""
    if not attract:
        return math.exp(-2.0 * ratio * phase_over_sine(ratio))
    if ratio >= 1.0:
        return 0.0
    return math.exp(-math.pi * ratio / math.sqrt((1.0 - ratio) * (1.0 + ratio)))


def damping_ratio(restitution: float, attract: bool = False) -> float:
    """Ratio of damping ζ that gives a coefficient of restitution: the inverse of `restitution`.

    Raises
    ------
    ValueError
        If no damping gives it: above 1, below 0, and 0 unless the contact attracts.
    """
    least = "0 <=" if attract else "0 <"
    if not (0.0 <= restitution <= 1.0 and (attract or restitution > 0.0)):
        raise ValueError(f"no damping gives a restitution of {restitution:g}: {least} e <= 1")
    if restitution == 0.0:
        return 1.0
    if restitution == 1.0:
        return 0.0
    decay = -math.log(restitution)
    if attract:
        return decay / math.hypot(math.pi, decay)
    low, high = 0.0, 1.0 / math.sqrt(restitution)  # cosh(x) <= e^x, x coth x >= x
    while low < (middle := 0.5 * (low + high)) < high:
        if 2.0 * middle * phase_over_sine(middle) < decay:
            low = middle
        else:
            high = middle
    return low


# Materials


def effective_modulus(young: tuple[float, float], poisson: tuple[float, float]) -> float:
    """E* [Pa] of two materials: 1/E* = (1 - ν₁²)/E₁ + (1 - ν₂²)/E₂; infinite E: rigid."""
    return 1.0 / sum((1.0 - nu * nu) / E for E, nu in zip(young, poisson, strict=True))


def effective_shear_modulus(young: tuple[float, float], poisson: tuple[float, float]) -> float:
    """G* [Pa] of two materials: 1/G* = (2 - ν₁)/G₁ + (2 - ν₂)/G₂ with G = E/(2 (1 + ν))."""
    pairs = zip(young, poisson, strict=True)
    return 1.0 / sum((2.0 - nu) * 2.0 * (1.0 + nu) / E for E, nu in pairs)


def effective_radius(first: float, second: float) -> float:
    """R* [m]: 1/R* = 1/R₁ + 1/R₂; infinite R: a plane."""
    return 1.0 / (1.0 / first + 1.0 / second)


# One collision


def hooke_overlap(stiffness: float, mass: float, speed: float, ratio: float = 0.0) -> float:
    """Peak overlap [m] of a collision with `hooke`: v √(m/k) e^{-ζθ/sin θ}."""
    return speed * math.sqrt(mass / stiffness) * math.exp(-ratio * phase_over_sine(ratio))


def hooke_duration(
    stiffness: float, mass: float, ratio: float = 0.0, attract: bool = False
) -> float:
    """Duration [s] of a collision with `hooke`: the phase 2θ, or π, over √(k/m) sin θ."""
    return math.sqrt(mass / stiffness) * end_phase(ratio, attract)


def hertz_overlap(
    modulus: float, radius: float, mass: float, speed: float, ratio: float = 0.0
) -> float:
    """Peak overlap [m] of a collision with `hertz`: (15 m v²/(16 √R* E*))^{2/5} e^{-4ζθ/(5 sin θ)}.

    Parameters
    ----------
    modulus, radius : float [Pa, m]
        E* and R*.
    mass, speed : float [kg, m/s]
        Effective mass, and how fast the two approach.
    ratio : float
        ζ.
    """
    power = 15.0 * mass * speed * speed / (16.0 * math.sqrt(radius) * modulus)
    return math.pow(power, 0.4) * math.exp(-0.8 * ratio * phase_over_sine(ratio))


def hertz_duration(
    modulus: float,
    radius: float,
    mass: float,
    speed: float,
    ratio: float = 0.0,
    attract: bool = False,
) -> float:
    """Duration [s] of a collision with `hertz`; 2.868 (m²/(R* E*² v))^{1/5} without damping.

    That is (4/5) ∫ u^{-1/5} ds in units of the time δ/v, δ the peak without damping, from the touch
    to the end of u = e^{-ζs} sin(s sin θ)/sin θ. Parameters as for `hertz_overlap`.
    """
    return 0.8 * stretch(ratio, attract) * hertz_overlap(modulus, radius, mass, speed) / speed


def end_phase(ratio: float, attract: bool) -> float:
    """When a collision ends, in units of √(m/k)."""
    if not attract:
        return 2.0 * phase_over_sine(ratio)
    if ratio >= 1.0:
        return math.inf
    return math.pi / math.sqrt((1.0 - ratio) * (1.0 + ratio))


def stretch(ratio: float, attract: bool) -> float:
    """∫ u^{-1/5} ds from the touch to the end, √π Γ(2/5)/Γ(9/10) for ζ = 0.

    By the double exponential rule, which needs no smooth ends.
    """
    end, total = end_phase(ratio, attract), 0.0
    if math.isinf(end):
        return end
    for j in range(-NODES, NODES + 1):
        t = j * REACH / NODES
        x = 0.5 * math.pi * math.sinh(t)
        share = 1.0 / (1.0 + math.exp(-2.0 * x))
        weight = end * 0.25 * math.pi * math.cosh(t) / math.cosh(x) ** 2
        total += weight * displacement(share * end, ratio) ** -0.2
    return total * REACH / NODES


def displacement(s: float, ratio: float) -> float:
    """e^{-ζs} sin(s sin θ)/sin θ, of an oscillator that starts at 0 with the velocity 1."""
    sine = math.sqrt(abs(1.0 - ratio) * (1.0 + ratio))
    if sine < 1e-8:
        return s * math.exp(-s)
    wave = math.sin(sine * s) if ratio < 1.0 else math.sinh(sine * s)
    return math.exp(-ratio * s) * wave / sine
