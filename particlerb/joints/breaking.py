"""Joints that break: a load above a limit releases them at the end of the step.

The impulse of a drift over its kick is the load at its start. Rows of a broken joint are left out
as those are of coordinates along which nothing acts.
"""

from math import inf, sqrt

from particlerb.compiled.jit import lean
from particlerb.joints.records import Breaks, Joints, Work
from particlerb.joints.rows import attitude, vector
from particlerb.maths.quaternion import to_world
from particlerb.maths.vec3 import add_scaled, cross, dot, row3, subtract


@lean
def leave_out(breaks: Breaks | None, joints: Joints, work: Work, c: int) -> None:
    """Leave out the rows of broken joints of cluster c."""
    if breaks is None:
        return
    start = joints.program.start
    for j in range(joints.clusters.joint[c], joints.clusters.joint[c + 1]):
        if work.broken[j] < inf:
            for r in range(start[j], start[j + 1]):
                work.compliance[r] = inf


@lean
def break_joints(
    breaks: Breaks | None, joints: Joints, work: Work, c: int, kick_dt: float, end: float
) -> None:
    """Let joints of cluster c break at a time whose impulses over a kick are too large."""
    if breaks is None:
        return
    start, nothing = joints.program.start, (0.0, 0.0, 0.0)
    for j in range(joints.clusters.joint[c], joints.clusters.joint[c + 1]):
        impulse, turning = nothing, nothing
        for r in range(start[j], start[j + 1]):
            impulse = add_scaled(work.total[r], vector(work.gradient, r, 0), impulse)
            turning = add_scaled(work.total[r], vector(work.gradient, r, 3), turning)
        first = start[j]
        arm = to_world(attitude(work.pose, joints.rows.a[first]), row3(joints.rows.first, first))
        turning = subtract(turning, cross(arm, impulse))
        force, torque = sqrt(dot(impulse, impulse)), sqrt(dot(turning, turning))
        if force > kick_dt * breaks.force[j] or torque > kick_dt * breaks.torque[j]:
            work.broken[j] = min(work.broken[j], end)
