"""Damping from the coefficient of restitution.

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

# Restitution and ratio of damping


def phase_over_sine(ratio: float) -> float:
    """θ/sin θ with cos θ = ζ; η/sinh η with cosh η = ζ beyond 1."""
    if ratio == 1.0:
        return 1.0
    sine = math.sqrt(abs(1.0 - ratio) * (1.0 + ratio))
    return (math.acos(ratio) if ratio < 1.0 else math.acosh(ratio)) / sine


def damping_ratio(restitution: float, attract: bool = False) -> float:
    """Ratio of damping ζ that gives a coefficient of restitution: see the top of the module.

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
