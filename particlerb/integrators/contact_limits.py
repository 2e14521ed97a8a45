"""Steps up to which bodies stay at rest on damped contacts, as hω with a damping ratio ζ.

A dashpot of ratio ζ at one contact damps a body on n of them with ζ√n: all formulas below are taken
at 2ζ, four contacts, where they are smaller there.
"""

import math
from typing import Final

_MIN_RK4_LIMIT: Final = 2.61  # |hλ| on the boundary of the stability region, where Re λ < 0


def old_velocity(zeta: float) -> float:
    """Of dashpots at the velocity of the drift before, Störmer-Verlet else: 2 (√(1 + ζ²) - ζ)."""
    return 2.0 / (math.hypot(1.0, 2.0 * zeta) + 2.0 * zeta)


def explicit(zeta: float) -> float:
    """2ζ, and for ζ > 1 that of the faster of two real rates; none without damping."""
    return min(2.0 * zeta, 2.0 / _faster_rate(2.0 * zeta))


def four_slopes(zeta: float) -> float:
    """√8 without damping; with it no root leaves the stability region below 2.61, at any ζ."""
    return _MIN_RK4_LIMIT / _faster_rate(2.0 * zeta) if zeta > 0.0 else math.sqrt(8.0)


def _faster_rate(zeta: float) -> float:
    """Size of the larger root of λ² + 2ζλ + 1."""
    return zeta + math.sqrt((zeta - 1.0) * (zeta + 1.0)) if zeta > 1.0 else 1.0
