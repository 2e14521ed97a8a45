"""How walls move, and driven bodies: x = c + d(t) + R(t) (p - c).

d = v t + A sin(2π f t + φ), R = exp(ω t).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Quat, to_world
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add_scaled,
    cross,
    dot,
    scale,
    subtract,
)


class PrescribedMotion(NamedTuple):
    """How a wall moves; all zero for one at rest."""

    centre: Vec3 = (0.0, 0.0, 0.0)  # [m] at t = 0
    velocity: Vec3 = (0.0, 0.0, 0.0)  # [m/s] of the centre
    angular_velocity: Vec3 = (0.0, 0.0, 0.0)  # [rad/s]
    amplitude: Vec3 = (0.0, 0.0, 0.0)  # [m]
    frequency: float = 0.0  # [1/s]
    phase: float = 0.0  # [rad]


@inline
def motion_in(rows: Floats, k: int) -> PrescribedMotion:
    """Motion from the numbers of a row."""
    return PrescribedMotion(
        (rows[k, 0], rows[k, 1], rows[k, 2]),
        (rows[k, 3], rows[k, 4], rows[k, 5]),
        (rows[k, 6], rows[k, 7], rows[k, 8]),
        (rows[k, 9], rows[k, 10], rows[k, 11]),
        rows[k, 12],
        rows[k, 13],
    )


def motion_rows(motions: Sequence[PrescribedMotion]) -> Floats:
    """Numbers of motions, (n, 14), for `motion_in`."""
    rows = [[*m.centre, *m.velocity, *m.angular_velocity, *m.amplitude, *m[4:]] for m in motions]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 14)


@inline
def pose_at(motion: PrescribedMotion, t: float) -> tuple[Vec3, Quat, Vec3, Vec3]:
    """Pose of a wall's frame at a time, in closed form.

    Returns
    -------
    x, q : tuples of 3 and 4 floats [m, -]
        A point p of the wall is at x + R p.
    v, omega : tuples of 3 floats [m/s, rad/s]
        Velocity of the frame's origin, where p = 0, and angular velocity.
    """
    centre, velocity, omega, amplitude, frequency, phase = motion
    rate = 2.0 * math.pi * frequency
    turned = rate * t + phase
    way = add_scaled(math.sin(turned), amplitude, scale(t, velocity))
    v = add_scaled(rate * math.cos(turned), amplitude, velocity)
    speed = math.sqrt(dot(omega, omega))
    half = 0.5 * speed * t
    f = math.sin(half) / speed if speed > 0.0 else 0.0
    q = (math.cos(half), f * omega[0], f * omega[1], f * omega[2])
    arm = to_world(q, centre)
    x = subtract(add_scaled(1.0, centre, way), arm)
    return x, q, subtract(v, cross(omega, arm)), omega


def write_poses(motions: Sequence[PrescribedMotion], t: float, poses: Floats) -> None:
    """Write position, orientation, velocity and angular velocity of each wall, (n_walls, 13)."""
    for wall, motion in enumerate(motions):
        poses[wall] = [number for part in pose_at(motion, t) for number in part]


def poses_at(motions: Sequence[PrescribedMotion], t: float) -> Floats:
    """Poses of all walls, (n_walls, 13): see `write_poses`."""
    poses = np.empty((len(motions), 13))
    write_poses(motions, t, poses)
    return poses


def wall_displacement(
    motions: Sequence[PrescribedMotion], duration: float, reach: Sequence[float]
) -> float:
    """How far a point of a wall may move in a time [m], within a `reach` of each wall's centre."""
    ways = [0.0]
    for (_, velocity, omega, amplitude, frequency, _), far in zip(motions, reach, strict=True):
        swing = min(2.0, 2.0 * math.pi * frequency * duration) * math.hypot(*amplitude)
        ways.append(duration * (math.hypot(*velocity) + far * math.hypot(*omega)) + swing)
    return max(ways)


def farthest_distances(
    motions: Sequence[PrescribedMotion], t: float, points: Floats
) -> list[float]:
    """From the centre of each wall to the farthest of the points (3, n), at most [m]."""
    lower, upper = points.min(axis=1), points.max(axis=1)
    found = []
    for motion in motions:
        x, q, _, _ = pose_at(motion, t)
        centre = np.array(add_scaled(1.0, to_world(q, motion.centre), x))
        found.append(float(np.linalg.norm(np.maximum(upper - centre, centre - lower))))
    return found
