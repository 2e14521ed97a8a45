"""Compositions of `rattle`: the same step several times, forth and back, of a higher order.

A symmetric method of order 2 with the lengths γ₁ h, ..., γₛ h, a palindrome of sum 1, has order 4,
6 or 8. Some γ are negative: forces without a potential have no sense there. The kick between two
stages is one kick.

Source: Suzuki, Phys. Lett. A 146, 319 (1990); Kahan and Li, Math. Comput. 66, 1089 (1997);
Hairer, Lubich, Wanner, Geometric Numerical Integration, V.3.2.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from particlerb.contact.contact_model import NOW
from particlerb.forces.kinds import BODIES, JOINTS, POSE
from particlerb.integrators.method import Method
from particlerb.integrators.rattle import METHOD
from particlerb.integrators.stages import MovingBodies, constrained_drift, kick, loads, stages_with
from particlerb.maths.vec3 import Floats

WEIGHTS: Final = (1.0,)  # stands for those of a method


def _coupled_step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Stages of a step."""
    ahead = 0.0
    for k in range(len(WEIGHTS)):
        h = WEIGHTS[k] * dt
        loads(moving, first, end, NOW)
        kick(moving, first, end, 0.5 * h + open_kick)
        constrained_drift(moving, 0.5 * h + open_kick, ahead, h)
        open_kick, ahead = 0.5 * h, ahead + h


def composed(order: int, limit: float, first: Sequence[float]) -> Method:
    """Composition whose weights begin so, up to the middle one, which follows from the sum.

    The limit is the largest hω below its first resonance.
    """
    weights = (*first, 1.0 - 2.0 * sum(first), *reversed(first))
    return METHOD._replace(
        summary=f"order {order}, symplectic; {len(weights)} stages of rattle; forces of the pose",
        order=order,
        accepts=frozenset({POSE, BODIES, JOINTS}),
        cost=METHOD.cost * len(weights),
        evaluations=len(weights),
        stability_limit=limit,
        closing_kick=0.5 * weights[-1],
        weights=weights,
        coupled_step=stages_with(_coupled_step, WEIGHTS=weights),
    )


def half_trace(
    kicks: Sequence[float], drifts: Sequence[float], z: Floats, gradient: float = 0.0
) -> Floats:
    """½ tr of a step of kicks and drifts of oscillators, hω = z (k,); bounded while |½ tr| <= 1.

    The last kick, which closes the step, is the first one again. All others may be bent: of kicks
    by -ω² x, and of ω⁴ x as its rate of change along a motion with that as velocity.
    """
    (x, p), (y, q) = (np.ones_like(z), np.zeros_like(z)), (np.zeros_like(z), np.ones_like(z))
    bent = (0.0, *(gradient for _ in kicks[1:]), 0.0)
    for given, bend, drift in zip((*kicks, kicks[0]), bent, (*drifts, 0.0), strict=True):
        push = given * z - bend * z**3
        p, q = p - push * x, q - push * y
        x, y = x + drift * z * p, y + drift * z * q
    return 0.5 * (x + q)


def kicks_of(weights: Sequence[float]) -> list[float]:
    """Kicks of a composition, as `half_trace` takes them, from the lengths of its stages."""
    return [0.5 * weights[0], *(0.5 * (one + other) for one, other in pairwise(weights))]


def growth_of(weights: Sequence[float], z: Floats) -> Floats:
    """Logarithms of the growth in a step of oscillators with hω = z; 0: they stay bounded."""
    half = np.abs(half_trace(kicks_of(weights), weights, z))
    return np.asarray(np.arccosh(np.where(half > 1.0, half, 1.0)))
