"""Prescribed motion of coordinates: what they are at a time, and how fast that changes.

A row with a drive holds g = x - c(t) = 0, x its coordinate. What moves it does the work
-λ ∂g/∂t = λ ċ, added with each impulse of the row: so the energy less external work is that of
the extended phase space, in which the method is symplectic.
"""

from math import cos, sin

from particlerb.compiled.jit import inline
from particlerb.joints import records as col
from particlerb.joints.records import Drives, JointData, Joints
from particlerb.maths.vec3 import Vec3


@inline
def course(drives: Drives, k: int, t: float) -> Vec3:
    """c, ċ and c̈ of drive k at a time [s]; zero where there is none."""
    if k == col.AT_REST:
        return 0.0, 0.0, 0.0
    p, amplitude, rate = drives.polynomial, drives.wave[k, 0], drives.wave[k, 1]
    along, across = sin(rate * t + drives.wave[k, 2]), cos(rate * t + drives.wave[k, 2])
    c = p[k, 0] + t * (p[k, 1] + t * (p[k, 2] + t * p[k, 3])) + amplitude * along
    speed = p[k, 1] + t * (2.0 * p[k, 2] + 3.0 * t * p[k, 3]) + amplitude * rate * across
    return c, speed, 2.0 * p[k, 2] + 6.0 * t * p[k, 3] - amplitude * rate * rate * along


@inline
def set_moving(joints: Joints, data: JointData, lo: int, hi: int, t: float) -> None:
    """∂g/∂t of rows lo to hi at a time, if any moves by itself."""
    if not joints.moves:
        return
    for r in range(lo, hi):
        data.dg_dt[r] = -course(joints.drives, joints.rows.drive[r], t)[1]
        data.dg_dt[r] += _by_carried(joints, data, r)


@inline
def _by_carried(joints: Joints, data: JointData, r: int) -> float:
    """What bodies that move as prescribed do to g of row r, per second."""
    gradient, motion, a, b = data.gradient, data.motion, joints.rows.a[r], joints.rows.b[r]
    speed = 0.0
    for i in range(3):
        speed += gradient[r, i] * (motion[a, i] - motion[b, i])
        speed += gradient[r, 3 + i] * motion[a, 3 + i] + gradient[r, 6 + i] * motion[b, 3 + i]
    return speed


@inline
def carry(joints: Joints, data: JointData, first: int, end: int) -> None:
    """Put bodies first to end that move as prescribed where they are at the end of a drift."""
    for b in range(first, end):
        if joints.prescribed[b]:
            for i in range(col.P):
                data.y[b, i] = data.end_pose[b, i]
