"""Joints that break: the instant at which a load passes its limit, and the step in which it does.

The impulse of a joint from the middle of a step to that of the next, over this time, is its load
between them, of second order. From the loads of two steps the next one is foreseen: where it passes
the limit, the joint breaks within that step. There the joint gives its impulse up to that instant,
and its rows are left out, as those are of coordinates along which nothing acts. So the error of the
instant is of order two. A load that is too large at once breaks its joint at the end of the step.

Where steps have any length, joints break where the dense output says that a load is at its limit:
a step ends there. In the next one `broken` is -inf, and their rows are left out.

Where contacts have no stiffness, the load is the impulse of a whole step over this, those of
impacts included, and a joint breaks at the end of the first step in which it is too large; its
time is the middle of that step.
"""

from math import inf
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.joints import records as col
from particlerb.joints.records import Breaks, JointData, Joints
from particlerb.joints.rows import add_impulses, orientation
from particlerb.maths.quaternion import to_world
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, add_scaled, cross, norm, subtract

_SAME_INSTANT: Final = 1e-9  # over a step: instants as near as this are one


@inline
def leave_out(joints: Joints, data: JointData, c: int, t: float) -> None:
    """Leave out the rows of joints of cluster c that have broken before t, and no others."""
    if joints.breaks is None:
        return
    now = data.clock[2] + t - _SAME_INSTANT * data.clock[1]
    for j in range(joints.clusters.joint[c], joints.clusters.joint[c + 1]):
        _set_held(joints, data, j, data.broken[j] >= now)


@inline
def _set_held(joints: Joints, data: JointData, j: int, is_held: bool) -> None:
    """Say whether the rows of joint j hold, or are left out."""
    start = joints.program.start
    for r in range(start[j], start[j + 1]):
        if joints.rows.action[r] == col.HOLDS:
            data.compliance[r] = 0.0 if is_held else inf


@inline
def let_break(joints: Joints, data: JointData, c: int, kick_dt: float, t: float, dt: float) -> bool:
    """Whether joints of cluster c break within a drift from t on, whose impulses are known.

    Of its impulses only those remain that such joints give until they break; their rows are left
    out.
    """
    start, begin, least = joints.program.start, data.clock[2] + t, _SAME_INSTANT * data.clock[1]
    lo, hi = joints.clusters.joint[c], joints.clusters.joint[c + 1]
    any_breaks = False
    for j in range(lo, hi):
        any_breaks = any_breaks or -least <= data.broken[j] - begin < dt - least
    if not any_breaks:
        return False
    for j in range(lo, hi):
        later = data.broken[j] - begin
        breaks_now = -least <= later < dt - least
        share = (kick_dt - 0.5 * dt + later) / kick_dt if breaks_now else 0.0
        for r in range(start[j], start[j + 1]):
            if joints.rows.action[r] == col.HOLDS:
                data.z[r] = (share - 1.0) * data.impulse[r]
                data.impulse[r] *= share
            else:
                data.z[r] = 0.0
        if breaks_now:
            _set_held(joints, data, j, False)
    first, last = start[lo], start[hi]
    add_impulses(joints.rows, joints.inv_mass, data.gradient, data.z, first, last, data.y, col.P)
    return True


@inline
def sum_half_step(joints: Joints, data: JointData, c: int, is_first: bool) -> None:
    """Keep the impulses of the rows of cluster c, or add them to those that are kept."""
    if joints.breaks is None:
        return
    start, joint = joints.program.start, joints.clusters.joint
    for r in range(start[joint[c]], start[joint[c + 1]]):
        data.half_step[r] = data.impulse[r] if is_first else data.half_step[r] + data.impulse[r]


@inline
def _impulses(
    joints: Joints, data: JointData, j: int, kept: Floats, pose: Floats
) -> tuple[float, float]:
    """Sizes of the impulse of joint j, kept by rows, and of its moment about its point."""
    start, impulse, turning = joints.program.start, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for r in range(start[j], start[j + 1]):
        impulse = add_scaled(kept[r], row3(data.gradient, r), impulse)
        turning = add_scaled(kept[r], row3(data.gradient, r, 3), turning)
    first = start[j]
    arm = to_world(orientation(pose, joints.rows.a[first]), row3(joints.rows.vector_a, first))
    return norm(impulse), norm(subtract(turning, cross(arm, impulse)))


@inline
def break_by_multipliers(joints: Joints, data: JointData, broken: Floats, t: float) -> bool:
    """Whether joints that hold carry more than they can, by z in the states y; they break at t."""
    any_breaks, breaks = False, joints.breaks
    if breaks is None:
        return any_breaks
    for j in range(broken.size):
        force, torque = _impulses(joints, data, j, data.z, data.y)
        is_too_much = force > breaks.force[j] or torque > breaks.torque[j]
        if is_too_much and broken[j] == inf:
            broken[j], any_breaks = t, True
    return any_breaks


@inline
def may_break(breaks: Breaks, broken: Floats) -> bool:
    """Whether a joint with a limit still holds."""
    for j in range(broken.size):
        if broken[j] == inf and min(breaks.force[j], breaks.torque[j]) < inf:
            return True
    return False


@inline
def let_go(data: JointData, broken: Floats, t: float) -> bool:
    """Leave out what has broken by t, and forget what broke later; whether any held until now."""
    any_breaks = False
    for j in range(broken.size):
        has_broken = broken[j] <= t
        any_breaks = any_breaks or (has_broken and data.broken[j] == inf)
        data.broken[j] = -inf if has_broken else inf
        broken[j] = broken[j] if has_broken else inf
    return any_breaks


@inline
def _ahead(load: float, before: float, limit: float) -> float:
    """In how many steps a load reaches a limit; before: one step ago, negative if not known."""
    if load > limit:
        return 0.0
    return (limit - load) / (load - before) if 0.0 <= before < load else inf


@inline
def foresee_breaks(joints: Joints, data: JointData, c: int, kick_dt: float, t: float) -> None:
    """Find which joints of cluster c break until the end of the next step.

    A whole step from t on has been done, with impulses over a kick.
    """
    breaks = joints.breaks
    if breaks is None:
        return
    sum_half_step(joints, data, c, not joints.damps)
    is_first, dt = t == 0.0, data.clock[1]
    span = dt if joints.damps and not is_first else kick_dt
    for j in range(joints.clusters.joint[c], joints.clusters.joint[c + 1]):
        if data.broken[j] < inf:
            continue
        force, torque = _impulses(joints, data, j, data.half_step, data.pose)
        force, torque = force / span, torque / span
        steps = _ahead(force, data.load[j, 0], breaks.force[j])
        steps = min(steps, _ahead(torque, data.load[j, 1], breaks.torque[j]))
        if steps < 2.0:
            data.broken[j] = data.clock[2] + t + dt * max(steps, 1.0)
        data.load[j, 0] = -1.0 if is_first else force
        data.load[j, 1] = -1.0 if is_first else torque


@inline
def break_overloaded(joints: Joints, data: JointData, dt: float) -> None:
    """Break joints that have carried too much in a step of dt [s], of which it is the middle."""
    breaks = joints.breaks
    if breaks is None:
        return
    for j in range(data.broken.size):
        force, torque = _impulses(joints, data, j, data.step_impulse, data.pose)
        is_too_much = force > dt * breaks.force[j] or torque > dt * breaks.torque[j]
        if is_too_much and data.broken[j] == inf:
            data.broken[j] = data.clock[2] + data.clock[0]
