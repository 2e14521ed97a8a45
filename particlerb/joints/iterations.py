"""Impulses of a drift that let it end where the constraints hold: guesses, iterations, mixing.

What is done, and why, is said in solver.py. Numbers may be packs (compiled/lanes.py): then a
cluster is one of a pack of clusters, each a lane.
"""

from math import inf
from typing import Final

from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.compiled.lanes import any_of, choose, opposite
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.block_cholesky import solve
from particlerb.joints.drives import carry
from particlerb.joints.records import JointData, Joints
from particlerb.joints.rows import add_impulses, orientation, rate, residuals
from particlerb.joints.wheels import nearest
from particlerb.maths.quaternion import to_body
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats
from particlerb.rotors.symmetric_split import symmetric_split, symmetric_top

_MOST_ITERATIONS: Final = 60
_RESIDUAL_ROUNDING: Final = 1e-15  # residuals, over their size, that are as good as none
_LAST_RESIDUAL: Final = 1e-10  # below it an iteration that gains little is the last
GAIN_RATIO: Final = 0.5  # of a residual by that before: with more an iteration gains little
_MAX_MIXED: Final = 1e-2  # residual: from farther off, guessed or mixed, another branch is near
_STRAYED_RATIO: Final = 100.0  # of the least residual so far, or the last: a loop leaves its branch


@inline
def fly(joints: Joints, data: JointData, c: int, dt: float) -> None:
    """Drift of cluster c from where it began, with the momenta of now."""
    y, pose = data.y, data.pose
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        path = dt * joints.inv_mass[k]
        for i in range(3):
            y[k, col.X + i] = pose[k, col.X + i] + path * y[k, col.P + i]
        q = orientation(pose, k)
        m = to_body(q, row3(y, k, col.L))
        a = row3(joints.inv_inertia, k)
        q = symmetric_split(q, m, a, dt) if any_of(a[0] != a[1]) else symmetric_top(q, m, a, dt)
        y[k, col.Q], y[k, col.Q + 1], y[k, col.Q + 2], y[k, col.Q + 3] = q
    carry(joints, data, joints.clusters.body[c], joints.clusters.body[c + 1])


@inline
def add_gains(joints: Joints, data: JointData, lo: int, hi: int) -> None:
    """Add impulses z of rows lo to hi to the momenta, and to `total`."""
    for r in range(lo, hi):
        data.impulse[r] += data.z[r]
    add_impulses(joints.rows, joints.inv_mass, data.gradient, data.z, lo, hi, data.y, col.P)


@inline
def _foreseen(past: Floats, r: int) -> float:
    """Impulse of row r over its kick that a polynomial through those of the last steps foresees."""
    all_known, known = 0.0, 0.0
    for i in range(0, col.PAST, 4):  # summed in pairs: fewer of them wait for each other
        all_known += (past[r, i] + past[r, i + 1]) + (past[r, i + 2] + past[r, i + 3])
    is_known = abs(all_known) < inf
    if any_of(opposite(is_known)):
        for i in range(col.PAST):
            known += choose(abs(past[r, i]) < inf, past[r, i], 0.0)
    return choose(is_known, all_known, known)


@inline
def warm_start(joints: Joints, data: JointData, c: int, kick_dt: float) -> None:
    """Begin with the impulses that a polynomial through those of the last steps foresees.

    Rows that the factor leaves out have none.
    """
    start, first = joints.program.start, joints.clusters.joint[c]
    last = joints.clusters.joint[c + 1]
    for j in range(first, last):
        d = joints.clusters.block[c] + j - first
        for r in range(start[j], start[j + 1]):
            is_in = data.factor[d, r - start[j], r - start[j]] != 0.0
            data.z[r] = choose(is_in, kick_dt * _foreseen(data.past, r), 0.0)
    add_gains(joints, data, start[first], start[last])


@inline
def remember(data: JointData, lo: int, hi: int, kick_dt: float, is_lost: bool) -> None:
    """Keep the impulses of rows lo to hi for the guess of the next step, if they are none lost."""
    for r in range(lo, hi):
        force = data.impulse[r] / kick_dt
        for i in range(col.PAST):
            before = data.past[r, i]
            data.past[r, i] = choose(is_lost, before, force)
            force -= before


@inline
def take_back(joints: Joints, data: JointData, c: int, taken: bool) -> None:
    """Begin the drift of cluster c anew, without impulses of rows that hold, if they are taken."""
    clusters, start = joints.clusters, joints.program.start
    for k in range(clusters.body[c], clusters.body[c + 1]):
        for i in range(col.P, col.STATE):
            data.y[k, i] = choose(taken, data.pose[k, i], data.y[k, i])
    for r in range(start[clusters.joint[c]], start[clusters.joint[c + 1]]):
        if joints.rows.action[r] == col.HOLDS:
            data.impulse[r] = choose(taken, 0.0, data.impulse[r])


@inline
def _share_of_last(joints: Joints, data: JointData, lo: int, hi: int) -> float:
    """How much of the last gain to take back, so that the residual over the sizes is least."""
    along, square = 0.0, 0.0
    for r in range(lo, hi):
        relative = data.g[r] / joints.rows.size[r]
        change = relative - data.last_g[r] / joints.rows.size[r]
        along, square = along + change * relative, square + change * change
    changes = square > 0.0
    return choose(changes, along / choose(changes, square, 1.0), 0.0)


@inline
def _count_teeth(
    rolls: Flag, joints: Joints, data: JointData, lo: int, hi: int, dt: float, worst: float
) -> float:
    """Residuals of what rolls, with the teeth that it passes by its rates as no impulses hold it.

    Returns the largest of all over its size.
    """
    if rolls is None:
        return worst
    rows = joints.rows
    for r in range(lo, hi):
        if (
            rows.kind[r] in (kinds.RACK, kinds.GEAR)
            and data.compliance[r] == 0.0
            and data.impulse[r] == 0.0
        ):
            passed = dt * (rate(joints, data.gradient, r, data.y, col.P) + data.dg_dt[r])
            data.g[r] = nearest(data.g[r], passed, rows.wheel[r, 11])
            worst = max(worst, abs(data.g[r]) / rows.size[r])
    return worst


@kernel
def find_impulses(
    joints: Joints, data: JointData, c: int, t: float, dt: float, is_guessed: bool
) -> tuple[bool, int]:
    """Drift with impulses along the gradients so that g = 0 at its end: see above.

    Returns whether there are none, and a row that does not converge. Of a pack each lane rests,
    bit for bit, once it has converged.
    """
    clusters, start = joints.clusters, joints.program.start
    lo, hi = start[clusters.joint[c]], start[clusters.joint[c + 1]]
    before, least, mixes, where = 1e300, 1e300, clusters.smallest_pivot[c] == 0.0, lo
    is_first, goes_on, is_lost = True, True, False
    for _ in range(_MOST_ITERATIONS):
        fly(joints, data, c, dt)
        worst, where = residuals(joints, data, lo, hi, t + dt)
        if is_first:
            worst = _count_teeth(joints.rolls, joints, data, lo, hi, dt, worst)
            if is_guessed:
                is_guessed, is_far = False, worst > _MAX_MIXED
                if any_of(is_far):
                    take_back(joints, data, c, is_far)
                    continue
            is_first = False
        gains_little = (worst < _LAST_RESIDUAL) & (worst > GAIN_RATIO * before)
        goes_on = goes_on & opposite((worst <= _RESIDUAL_ROUNDING) | gains_little)
        if not mixes:
            is_lost = is_lost | (goes_on & (worst > _STRAYED_RATIO * least))
            goes_on = goes_on & opposite(is_lost)
        if not any_of(goes_on):
            break
        least = max(min(least, worst), _LAST_RESIDUAL)
        share = 0.0
        if mixes:
            share = choose(before < _MAX_MIXED, _share_of_last(joints, data, lo, hi), 0.0)
        before = worst
        for r in range(lo, hi):
            data.z[r] = (share * (data.g[r] - data.last_g[r]) - data.g[r]) / dt
            data.last_g[r] = data.g[r]
        solve(joints.program, joints.clusters, data.factor, data.z, c)
        for r in range(lo, hi):
            gain = data.z[r] - share * data.last_gain[r]
            data.last_gain[r] = gain
            data.z[r] = choose(goes_on, gain, 0.0)
        add_gains(joints, data, lo, hi)
    return is_lost | goes_on, where
