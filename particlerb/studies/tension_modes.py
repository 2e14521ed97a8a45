"""Limits of the step of what a tension brings back, by theory and measured: for `stability`.

A light point in the middle of two rods, from which a heavy one hangs, oscillates across them: its
frequency comes from what the rods carry, ω² = (T + T')/(m l) for tensions T and T' above and below,
and no force has a potential. To first order a stage of `rattle` is one of leapfrog there.
"""

from typing import Final

import numpy as np

from particlerb.forces import Terms
from particlerb.forces.gravity import UniformGravity
from particlerb.integrators import METHODS
from particlerb.integrators.composition import kicks_of
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.records import ConstraintRows
from particlerb.joints.setup import NO_ACTIONS, joints_among
from particlerb.maths.vec3 import Bools, Floats
from particlerb.studies.stability_limits import Limit, limit, splitting_limit
from particlerb.studies.stability_runs import StabilityScene, bodies_of, history, scene

_GRAVITY: Final = 1e-5  # [m/s²] so that in a step of 1 s the heavy point falls far less than 1 m
_FIRST_DISPLACEMENT: Final = 1e-10  # [m] across the rods
_MAX_BOUNDED_DISPLACEMENT: Final = 1e-6  # [m]; far more changes the tension
_N_STEPS: Final = 1000
_LIMIT_RANGE: Final = 1.9, 3.4  # of hω: the first resonances are narrow


def tense(z: Floats) -> StabilityScene:
    """Light points with hω = z for h = 1 s on rods of 1 m, and then the points of 1 kg below."""
    n = z.size
    mass = np.append(2.0 * _GRAVITY / (z * z - _GRAVITY), np.ones(n))
    bodies = bodies_of(np.zeros((2 * n, 3)), mass)
    upper, none = np.arange(n), np.zeros((2 * n, 3))
    rows = ConstraintRows(
        np.full(2 * n, kinds.DISTANCE), np.arange(2 * n), np.append(np.full(n, 2 * n), upper),
        none, none, none, np.ones(2 * n), np.ones(2 * n), np.full(2 * n, col.HOLDS),
        np.full(2 * n, col.AT_REST), np.zeros((2 * n, col.WHEEL)),
    )  # fmt: skip
    joints = joints_among(np.arange(2 * n), np.arange(2 * n + 1), rows, bodies, NO_ACTIONS)
    gravity = UniformGravity(bodies.mass, np.array([0.0, 0.0, -_GRAVITY]))
    moved = scene(np.zeros(3), np.zeros((2 * n, 3)), Terms(gravity=gravity, joints=joints))
    moved.state.com[0, :n], moved.state.com[2] = _FIRST_DISPLACEMENT, np.repeat([-1.0, -2.0], n)
    return moved._replace(bodies=bodies)


def stays_across(method: str, moved: StabilityScene, steps: int) -> Bools:
    """Whether so many steps of 1 s leave the points near the line of the rods."""
    frames = history(moved, method, 1.0, np.rint(steps * np.linspace(0.125, 1.0, 8)))
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(frames.position[..., 0]) < _MAX_BOUNDED_DISPLACEMENT).all(axis=0))


def tension_limits(method: str) -> tuple[Limit]:
    """Largest hω of `rattle` or a composition of it."""
    largest = limit(method, tense, *_LIMIT_RANGE, steps=_N_STEPS, is_bounded=stays_across)
    return (Limit(method, "tension in rods: largest hω", theory_of(method), largest),)


def theory_of(method: str) -> float:
    """hω from which a composition of leapfrog is not bounded."""
    weights = METHODS[method].weights
    return splitting_limit(kicks_of(weights), weights)
