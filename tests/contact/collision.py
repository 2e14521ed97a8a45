"""What one collision does, in closed form: restitution, overlap and duration."""

import math
from typing import Final

from particlerb.contact.restitution import phase_over_sine

NODES: Final = 60  # of the quadrature, on either side; its error is below 1e-13
REACH: Final = 3.4  # its outermost nodes are e^{-47} of the interval from the ends


def restitution(ratio: float, attract: bool = False) -> float:
    """Coefficient of restitution that a ratio of damping ζ >= 0 gives."""
    if not attract:
        return math.exp(-2.0 * ratio * phase_over_sine(ratio))
    if ratio >= 1.0:
        return 0.0
    return math.exp(-math.pi * ratio / math.sqrt((1.0 - ratio) * (1.0 + ratio)))


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
