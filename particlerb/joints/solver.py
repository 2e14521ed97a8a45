"""A drift that ends where the constraints hold, and momenta that keep them: RATTLE's two halves.

    solve ν: g(drift_h(q₀, p + G₀ᵀ ν)) = 0,   and   solve μ: G M⁻¹ (p + Gᵀ μ) = 0

by simplified Newton iterations with A = G₀ M⁻¹ G₀ᵀ: fly, ν -= A⁻¹ g/h, fly again. The error shrinks
by a factor of order ω h each time. The last two iterations are mixed so that the residual would be
least (Anderson's mixing), which saves up to a fifth of them; not in loops, which may pass singular
poses: there it may lead to another branch. It goes on until the residual no longer falls; where
that of a loop rises a hundredfold, it is on its way to another branch, and rows rest instead.
Each cluster is solved by itself, so that its bits do not depend on others. Whole steps begin with a
guess of ν from those before, which saves up to half of them; checkpoints keep what it needs. Its
error turns a body of 1e-6 of the mass of its neighbours a million times as far: where masses of a
cluster differ by more than a hundredfold, and where the guess leaves residuals above 1e-2, there is
none.

Source: Andersen, J. Comput. Phys. 52, 24 (1983); Reich, SIAM J. Numer. Anal. 33, 475 (1996);
Hairer, Lubich, Wanner, Geometric Numerical Integration, VII.1; of the mixing: Walker and Ni, SIAM
J. Numer. Anal. 49, 1715 (2011).
"""

from math import inf
from typing import Final

from particlerb.compiled.jit import Flag, inline, kernel, unfused_kernel
from particlerb.compiled.lanes import any_of, choose, lane
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.actions import gives_way, kick_actions, set_compliance
from particlerb.joints.block_cholesky import assemble, factorise, solve
from particlerb.joints.breaking import leave_out, let_break
from particlerb.joints.drives import set_moving
from particlerb.joints.iterations import (
    GAIN_RATIO,
    add_gains,
    find_impulses,
    remember,
    take_back,
    warm_start,
)
from particlerb.joints.records import JointData, Joints
from particlerb.joints.rows import (
    arms_at,
    by_inverse_inertia,
    is_of_directions,
    linearise,
    orientation,
    rates,
    residuals,
    rotations,
)
from particlerb.joints.wheels import out_of_mesh
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Vec3, add, dot, scale

_MAX_PASSES: Final = 4  # of a projection of momenta
_MAX_PIVOT_DECADES: Final = 7  # by which the pivot below which rows rest grows, from 1e-8 on
_MAX_RESTING: Final = 1e-4  # residual of a row that rests, over its size


@inline
def factorise_cluster(joints: Joints, data: JointData, c: int, span: float, t: float) -> None:
    """G and the factor of A of cluster c at its pose and at t; rows that damp do so over a span."""
    clusters, start = joints.clusters, joints.program.start
    lo, hi = clusters.joint[c], clusters.joint[c + 1]
    for r in range(start[lo], start[hi]):
        set_compliance(joints, data, r, span)
        data.impulse[r] = 0.0
    leave_out(joints, data, c, t)
    linearise(joints, data, start[lo], start[hi])
    set_moving(joints, data, start[lo], start[hi], t)
    factorise_gradients(joints, data, c)


@inline
def factorise_gradients(joints: Joints, data: JointData, c: int) -> None:
    """Factor of A of cluster c from its gradients."""
    clusters, start = joints.clusters, joints.program.start
    lo, hi = start[clusters.joint[c]], start[clusters.joint[c + 1]]
    judges = clusters.is_uneven[c] and clusters.smallest_pivot[c] > 0.0
    if judges:
        _judge(joints, data, c, lo, hi)
    block = clusters.block
    assemble(joints.program, joints.rows, joints.inv_mass, data, block[c], block[c + 1])
    if judges:
        for r in range(lo, hi):
            data.scale[r] = choose(data.last_gain[r] == 0.0, inf, 0.0)
    factorise(joints.program, clusters, data, c, not judges)


@kernel
def _judge(joints: Joints, data: JointData, c: int, lo: int, hi: int) -> None:
    """Whether rows lo to hi depend on those before, as `last_gain` 0, were all masses of one size.

    Which rows do does not depend on masses, but the pivots do: where these are far apart, those of
    rows that count may be as small as the rounding of the others.
    """
    clusters, gradient = joints.clusters, data.gradient
    block, first = clusters.block, clusters.joint[c]
    _even_out(joints, gradient, lo, hi, joints.inv_mass, clusters.even_inv_mass)
    assemble(joints.program, joints.rows, clusters.even_inv_mass, data, block[c], block[c + 1])
    factorise(joints.program, clusters, data, c, True)
    for j in range(first, clusters.joint[c + 1]):
        at = joints.program.start[j]
        for r in range(at, joints.program.start[j + 1]):
            data.last_gain[r] = data.factor[block[c] + j - first, r - at, r - at]
    _even_out(joints, gradient, lo, hi, clusters.even_inv_mass, joints.inv_mass)


@inline
def _even_out(
    joints: Joints, gradient: Floats, lo: int, hi: int, before: Floats, after: Floats
) -> None:
    """J⁻¹ times gradients of rows lo to hi, when 1/M of bodies becomes another."""
    for r in range(lo, hi):
        for at, k in ((9, joints.rows.a[r]), (12, joints.rows.b[r])):
            by = after[k] / before[k] if lane(before[k], 0) > 0.0 else 1.0
            for i in range(at, at + 3):
                gradient[r, i] *= by


@inline
def is_whole(data: JointData, dt: float) -> bool:
    """Whether a drift is no stage of a composition, nor a part of a step to a frame."""
    return dt == data.clock[1]


@inline
def begin_drift(
    joints: Joints, data: JointData, c: int, kick_dt: float, t: float, dt: float
) -> bool:
    """Factor of A, kick of springs, and a guess of impulses; whether there is one."""
    clusters, start = joints.clusters, joints.program.start
    lo, hi = start[clusters.joint[c]], start[clusters.joint[c + 1]]
    for k in range(clusters.body[c], clusters.body[c + 1]):
        for i in range(col.P):
            data.pose[k, i] = data.y[k, i]
    factorise_cluster(joints, data, c, 0.0, t)
    kick_actions(joints, data, lo, hi, kick_dt)
    for k in range(clusters.body[c], clusters.body[c + 1]):
        for i in range(col.P, col.STATE):
            data.pose[k, i] = data.y[k, i]
    guesses = is_whole(data, dt) and not clusters.is_uneven[c]
    if guesses:
        warm_start(joints, data, c, kick_dt)
    return guesses


@unfused_kernel
def constrained_drift(
    joints: Joints, data: JointData, c: int, kick_dt: float, t: float, dt: float
) -> None:
    """Kick of springs at t, and drift of cluster c over dt with impulses so that g = 0 at its end.

    `data.impulse` has these impulses, `data.failed_row` the row that does not converge.
    """
    clusters, start = joints.clusters, joints.program.start
    lo, hi = start[clusters.joint[c]], start[clusters.joint[c + 1]]
    guesses = begin_drift(joints, data, c, kick_dt, t, dt)
    _fly_to_joints(joints, data, c, t, dt, guesses)
    if data.failed_row[c] > 0 and clusters.smallest_pivot[c] > 0.0:
        _pass_singular_pose(joints, data, c, t, dt)
    if is_whole(data, dt):
        remember(data, lo, hi, kick_dt, False)
    if joints.breaks is not None and let_break(joints, data, c, kick_dt, t, dt):
        factorise_gradients(joints, data, c)
        _fly_to_joints(joints, data, c, t, dt, False)
    _see_teeth(joints.rolls, joints, data, c, dt)
    if joints.acts or joints.bounds is not None:
        for r in range(lo, hi):
            if gives_way(joints.rows, joints.actions, r, data.pose, data.y):
                data.failed_row[c] = 1 + r + 2 * joints.rows.kind.size


@inline
def _turn(joints: Joints, data: JointData, k: int, dt: float) -> Vec3:
    """How far body k turns in a drift, if it went on as it begins."""
    omega = by_inverse_inertia(
        joints.inv_inertia, orientation(data.pose, k), k, row3(data.y, k, col.L)
    )
    return scale(dt, add(omega, row3(data.motion, k, 3)))


@inline
def _see_teeth(rolls: Flag, joints: Joints, data: JointData, c: int, dt: float) -> None:
    """Give cluster c up where teeth were passed in a drift, or axes have left their place."""
    if rolls is None:
        return
    rows, start, pose = joints.rows, joints.program.start, data.pose
    lo, hi = start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]
    for r in range(lo, hi):
        if rows.kind[r] in (kinds.RACK, kinds.GEAR) and data.compliance[r] == 0.0:
            R, before = rotations(rows, data.y, r), rotations(rows, pose, r)
            _, _, u, d = arms_at(rows, data.y, r, R)
            _, _, u0, d0 = arms_at(rows, pose, r, before)
            turned = _turn(joints, data, rows.a[r], dt), _turn(joints, data, rows.b[r], dt)
            wrong = out_of_mesh(rows, r, R, (u, d), before, (u0, d0), turned)
            if wrong > 0:
                data.failed_row[c] = 1 + r + (wrong - 1) * rows.kind.size


@kernel
def _pass_singular_pose(joints: Joints, data: JointData, c: int, t: float, dt: float) -> None:
    """Drift anew without the rows that all but depend on others: for this step they rest.

    They are as few as let the others converge by impulses that bodies as slow as these can give
    each other, and leave all but closed themselves: with one that all but depends on others left
    in, the others meet in another branch, or where all of them lock.
    """
    clusters, start, share = joints.clusters, joints.program.start, joints.clusters.smallest_pivot
    first, end, usual = clusters.joint[c], clusters.joint[c + 1], share[c]
    lo, hi = start[first], start[end]
    for _ in range(_MAX_PIVOT_DECADES):
        share[c] *= 10.0
        take_back(joints, data, c, True)
        factorise_gradients(joints, data, c)
        for j in range(first, end):
            d = clusters.block[c] + j - first
            for r in range(start[j], start[j + 1]):
                is_left_out = data.factor[d, r - start[j], r - start[j]] == 0.0
                if joints.rows.action[r] == col.HOLDS and is_left_out:
                    data.compliance[r] = inf
        data.failed_row[c] = 0
        _fly_to_joints(joints, data, c, t, dt, False)
        for r in range(lo, hi):
            if joints.rows.action[r] == col.HOLDS:
                data.compliance[r] = 0.0
        leave_out(joints, data, c, t)
        _, where = residuals(joints, data, lo, hi, t + dt)
        worst = 0.0
        for r in range(lo, hi):
            worst = max(worst, abs(data.g[r]) / joints.rows.size[r])
        if data.failed_row[c] == 0 and worst <= _MAX_RESTING and _is_weak(joints, data, c, lo, hi):
            break
        data.failed_row[c] = 1 + where
    share[c] = usual


@inline
def _is_weak(joints: Joints, data: JointData, c: int, lo: int, hi: int) -> bool:
    """Whether no impulse of rows lo to hi is above √(2 M T), where the drift begins."""
    T, M, largest = 0.0, 0.0, 0.0
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        p, spin, inverse = row3(data.pose, k, col.P), row3(data.pose, k, col.L), joints.inv_mass[k]
        turning = by_inverse_inertia(joints.inv_inertia, orientation(data.pose, k), k, spin)
        T += 0.5 * (inverse * dot(p, p) + dot(spin, turning))
        M += 1.0 / inverse if inverse > 0.0 else 0.0
    for r in range(lo, hi):
        arm = joints.rows.size[r] if is_of_directions(joints.rows.kind[r]) else 1.0
        largest = max(largest, abs(data.impulse[r]) / arm)
    return largest * largest <= 2.0 * M * T


@inline
def _fly_to_joints(
    joints: Joints, data: JointData, c: int, t: float, dt: float, is_guessed: bool
) -> None:
    """Drift of `find_impulses`; later steps of what is lost are not numbers."""
    is_lost, where = find_impulses(joints, data, c, t, dt, is_guessed)
    if is_lost and data.failed_row[c] == 0:
        data.failed_row[c] = 1 + where


@unfused_kernel
def project_momenta(
    joints: Joints, data: JointData, c: int, kick_dt: float, t: float, span: float
) -> None:
    """Kick of springs; take from the momenta of cluster c what would break its joints at t.

    `total` has the impulses. Over a span, dampers take half of what they will, and drag, where the
    masses have it in them.
    """
    clusters, start = joints.clusters, joints.program.start
    first, last = clusters.joint[c], clusters.joint[c + 1]
    lo, hi = start[first], start[last]
    factorise_cluster(joints, data, c, span, t)
    kick_actions(joints, data, lo, hi, kick_dt)
    keep_rates(joints, data, c, lo, hi)


@inline
def keep_rates(joints: Joints, data: JointData, c: int, lo: int, hi: int) -> None:
    """Take from the momenta what breaks rows lo to hi, those of cluster c, by the factor of A."""
    before, goes_on = 1e300, True
    for _ in range(_MAX_PASSES):
        worst = rates(joints, data, lo, hi)
        goes_on = goes_on & (worst > 0.0) & (worst < GAIN_RATIO * before)
        if not any_of(goes_on):
            return
        before = worst
        solve(joints.program, joints.clusters, data.factor, data.z, c)
        for r in range(lo, hi):
            data.z[r] = choose(goes_on, data.z[r], 0.0)
        add_gains(joints, data, lo, hi)
