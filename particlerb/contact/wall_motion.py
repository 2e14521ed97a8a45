"""How walls move, and driven bodies: x = c + d(t) + R(t) (p - c).

d = s + v t + A sin(2π f t + φ), R = exp(ω t) T. Shift s and turn T are those of a motion that has
changed on the way: it goes on from where the one before has led to.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.contact.records import MOTION, POSE, Records, to_floats, zero_records
from particlerb.maths.quaternion import Quat, conjugate, multiply, to_world
from particlerb.maths.rows import put_row3, put_row4, row3, row4
from particlerb.maths.vec3 import Floats, Vec3, add, add_scaled, cross, dot, scale, subtract


class PrescribedMotion(NamedTuple):
    """How a wall moves; all zero for one at rest."""

    centre: Vec3 = (0.0, 0.0, 0.0)  # [m] at t = 0
    velocity: Vec3 = (0.0, 0.0, 0.0)  # [m/s] of the centre
    angular_velocity: Vec3 = (0.0, 0.0, 0.0)  # [rad/s]
    amplitude: Vec3 = (0.0, 0.0, 0.0)  # [m]
    frequency: float = 0.0  # [1/s]
    phase: float = 0.0  # [rad]
    shift: Vec3 = (0.0, 0.0, 0.0)  # [m]
    turn: Quat = (1.0, 0.0, 0.0, 0.0)


@inline
def motion_in(records: Records, k: int) -> PrescribedMotion:
    """Motion of record k."""
    return PrescribedMotion(
        row3(records.centre, k),
        row3(records.velocity, k),
        row3(records.angular_velocity, k),
        row3(records.amplitude, k),
        records.frequency[k],
        records.phase[k],
        row3(records.shift, k),
        row4(records.turn, k),
    )


def motion_records(motions: Sequence[PrescribedMotion]) -> Records:
    """Motions as records MOTION, (n,), for `motion_in`."""
    return np.array([tuple(motion) for motion in motions], dtype=MOTION).view(Records)


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
    centre, velocity, omega, amplitude, frequency, phase, shift, turned = motion
    rate = 2.0 * math.pi * frequency
    angle = rate * t + phase
    displacement = add_scaled(math.sin(angle), amplitude, scale(t, velocity))
    v = add_scaled(rate * math.cos(angle), amplitude, velocity)
    speed = math.sqrt(dot(omega, omega))
    half = 0.5 * speed * t
    f = math.sin(half) / speed if speed > 0.0 else 0.0
    q = (math.cos(half), f * omega[0], f * omega[1], f * omega[2])
    if turned[1] != 0.0 or turned[2] != 0.0 or turned[3] != 0.0:
        q = multiply(q, turned)
    arm = to_world(q, centre)
    x = add(shift, subtract(add_scaled(1.0, centre, displacement), arm))
    return x, q, subtract(v, cross(omega, arm)), omega


@inline
def acceleration_at(motion: PrescribedMotion, p: Vec3, t: float) -> Vec3:
    """Acceleration of a point p of a wall at a time [m/s²]."""
    _, turn, _, omega = pose_at(motion, t)
    arm = to_world(turn, subtract(p, motion.centre))
    rate = 2.0 * math.pi * motion.frequency
    oscillating = -rate * rate * math.sin(rate * t + motion.phase)
    return add_scaled(oscillating, motion.amplitude, cross(omega, cross(omega, arm)))


@inline
def put_poses(motions: Records, t: float, poses: Records) -> None:
    """Write the poses of all walls at a time; `motions` from `motion_records`."""
    for w in range(motions.size):
        x, q, v, omega = pose_at(motion_in(motions, w), t)
        put_row3(poses.position, w, x)
        put_row4(poses.orientation, w, q)
        put_row3(poses.velocity, w, v)
        put_row3(poses.angular_velocity, w, omega)


def continued(before: PrescribedMotion, after: PrescribedMotion, t: float) -> PrescribedMotion:
    """A motion about the same centre that begins at a time where another one has led to."""
    plain = after._replace(shift=PrescribedMotion().shift, turn=PrescribedMotion().turn)
    (x, q, _, _), (y, turn, _, _) = pose_at(before, t), pose_at(plain, t)
    gone, going = (
        add_scaled(1.0, to_world(rotation, after.centre), place)
        for place, rotation in ((x, q), (y, turn))
    )
    return plain._replace(shift=subtract(gone, going), turn=multiply(conjugate(turn), q))


def poses_at(motions: Sequence[PrescribedMotion], t: float) -> Records:
    """Poses of all walls, (n_walls,) records POSE."""
    poses = zero_records(POSE, len(motions))
    for pose, motion in zip(to_floats(poses), motions, strict=True):
        pose[:13] = np.concatenate([np.atleast_1d(part) for part in pose_at(motion, t)])
    return poses


def wall_displacement(
    motions: Sequence[PrescribedMotion], duration: float, reach: Sequence[float]
) -> float:
    """How far a point of a wall may move in a time [m], within a `reach` of each wall's centre."""
    displacement = [0.0]
    for (_, velocity, omega, amplitude, frequency, *_), far in zip(motions, reach, strict=True):
        oscillation = min(2.0, 2.0 * math.pi * frequency * duration) * math.hypot(*amplitude)
        speed = math.hypot(*velocity) + far * math.hypot(*omega)
        displacement.append(duration * speed + oscillation)
    return max(displacement)


def farthest_distances(
    motions: Sequence[PrescribedMotion], t: float, points: Floats
) -> list[float]:
    """From the centre of each wall to the farthest of the points (3, n), at most [m]."""
    lower, upper = points.min(axis=1), points.max(axis=1)
    distances = []
    for motion in motions:
        x, q, _, _ = pose_at(motion, t)
        centre = np.array(add_scaled(1.0, to_world(q, motion.centre), x))
        distances.append(float(np.linalg.norm(np.maximum(upper - centre, centre - lower))))
    return distances
