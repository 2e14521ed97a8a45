"""Limits of the step of a ball that rests on a floor, by theory and measured: for `stability`.

A contact of `hooke` that is pressed by the weight and never opens is an oscillator with a dashpot,
hω of the step and ratio ζ. The closed forms are those of the linear motion and share nothing with
the methods.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from particlerb.contact.contact_model import ContactModel, ContactSpheres, GroupContact
from particlerb.contact.law import TANGENTIAL_DAMPING, Law
from particlerb.contact.wall_motion import PrescribedMotion, motion_records
from particlerb.contact.wall_shapes import joined, plane
from particlerb.forces import Terms
from particlerb.forces.gravity import UniformGravity
from particlerb.stepping.motion import MotionError
from particlerb.studies.stability_limits import Limit, damped_semi_implicit, rk4_factor, root
from particlerb.studies.stability_runs import StabilityScene, history, scene

RATIOS: Final = (0.0, 0.2, 0.5, 1.0)  # ζ
_RADIUS: Final = 100.0  # [m] far more than the overlap of the weight, 1 m or less
_TOUCH: Final = 1e-6  # of that overlap: what the ball is off at first
_N_STEPS: Final = 240
_STEPS_SAMPLED: Final = 30  # at half the time, and at the end
_MAX_HALVINGS: Final = 16  # of steps hω up to 8


def resting(z: float, zeta: float) -> tuple[StabilityScene, float]:
    """A ball of 1 kg with hω = z for h = 1 s, and the overlap at which it rests [m]."""
    k, weight = z * z, min(z * z, 1.0)
    deep = weight / k
    moved = scene(np.full(3, 4e3), np.zeros((1, 3)), position=(0, 0, _RADIUS - (1 + _TOUCH) * deep))
    bodies, ones, none = moved.bodies, np.ones(1), np.zeros(1, dtype=np.int64)
    body = none, none, none, np.array([0, 1])
    spheres = ContactSpheres(np.zeros((3, 1)), _RADIUS * ones, *body, none[:0], none)
    damping = TANGENTIAL_DAMPING * ones
    law = Law(k * ones, 0.0 * ones, zeta * ones, damping, 0.0 * ones, None, None, None)
    floor = joined([plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))])
    pair = np.zeros((1, 1), dtype=np.int64)
    model = ContactModel(spheres, law, pair, none, floor, bodies.inv_mass, bodies.inv_inertia)
    contact = GroupContact(
        model, motion_records([PrescribedMotion()]), np.zeros(1), 0.6 * _RADIUS, False, False, 0,
        allow_unstable=True,
    )  # fmt: skip
    gravity = UniformGravity(bodies.mass, np.array([0.0, 0.0, -weight]))
    return moved._replace(terms=Terms(gravity=gravity, contact=contact)), deep


def grows(method: str, z: float, zeta: float) -> bool:
    """Whether the ball oscillates more and more: at the end more than at half the time."""
    moved, deep = resting(z, zeta)
    looked_at = np.arange(1 - _STEPS_SAMPLED, 1)
    times = np.concatenate([_N_STEPS // 2 + looked_at, _N_STEPS + looked_at])
    try:
        frames = history(moved, method, 1.0, times.astype(np.float64))
    except MotionError:
        return True
    off = np.abs(frames.position[:, 0, 2] - (_RADIUS - deep)) / (_TOUCH * deep)
    first, last = off[:_STEPS_SAMPLED].max(), off[_STEPS_SAMPLED:].max()
    beats = 1.0 if zeta > 0.0 else 1.1  # undamped ones near the limit
    return not last < 1e3 or bool(last > beats * first and last > 1e-2)


def measured(method: str, zeta: float) -> float:
    """Largest hω at which the ball stays at rest, by bisection."""
    low, high = 0.0, 8.0
    for _ in range(_MAX_HALVINGS):
        z = 0.5 * (low + high)
        low, high = (low, z) if grows(method, z, zeta) else (z, high)
    return low


def _four_slopes(zeta: float) -> float:
    """hω from which a root of the oscillator leaves the region of stability of rk4."""
    rate = complex(-zeta, math.sqrt(max(1.0 - zeta * zeta, 0.0)))
    return root(lambda z: abs(rk4_factor(z * rate)) - 1.0, 1.0, 4.0)


THEORY: Final[dict[str, Callable[[float], float]]] = {
    "strang": lambda zeta: 2.0,
    "semi_implicit_euler": damped_semi_implicit,
    "explicit_euler": lambda zeta: 2.0 * zeta,  # up to ζ = 1
    "rk4": _four_slopes,
}
"""Largest hω of a resting ball with damping ratio ζ, by method."""


def contact_limits(method: str) -> tuple[Limit, ...]:
    """Limits of a method that takes contact; explicit Euler has none without damping."""
    limits = []
    for zeta in RATIOS:
        theory = THEORY[method](zeta)
        if theory > 0.0:
            name = f"resting contact, ζ = {zeta}: largest hω"
            limits.append(Limit(method, name, theory, measured(method, zeta), zeta))
    return tuple(limits)
