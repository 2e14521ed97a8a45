"""Slopes of bodies that joints hold: accelerations with multipliers, for methods that need slopes.

    Ṗ = F + ∂gᵀ/∂x λ,  L̇ = τ + ∂gᵀ/∂θ λ,  A λ = -(g̈ without them)

Of trees joints/trees.py has the same without multipliers.
The states drift off the joints by the error of the steps, and so does what is between them: at the
end of every fourth step, and in frames, they are brought back, in the metric of the masses.

Source: Hairer and Wanner, Solving Ordinary Differential Equations II (1996), sections VII.1 and
VII.2; the rows in joints/rows.py.
"""

from math import nan

from particlerb.compiled.jit import Flag, inline, kernel, unfused_kernel
from particlerb.integrators.joint_stages import set_prescribed
from particlerb.joints import records as col
from particlerb.joints.actions import action_force
from particlerb.joints.coordinates import count_turns, store_turns
from particlerb.joints.drives import set_moving
from particlerb.joints.reactions import factorise_all, find_multipliers
from particlerb.joints.records import Jointed
from particlerb.joints.rows import add_impulses, by_inverse_inertia, linearise, orientation
from particlerb.joints.solver import constrained_drift, keep_rates
from particlerb.joints.trees import accelerate_tree
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add, cross, dot, scale, subtract
from particlerb.model.block import EXTERNAL

_MAX_TURN = 2.0  # rad of two bodies against each other in a step, by their rates at its start
_WORK_ROW, _IMPULSE_ROW, _ANGULAR_ROW = EXTERNAL, EXTERNAL + 1, EXTERNAL + 4


@inline
def _put_state(jointed: Jointed, states: Floats, w: int) -> None:
    """States of the mechanisms, from blocks (blocks, 13 w or more), with |q| = 1."""
    y = jointed.data.y
    for k in range(jointed.block.size):
        row, lane, square = states[jointed.block[k]], jointed.lane[k], 0.0
        for c in range(col.STATE):
            y[k, c] = row[c * w + lane]
        for c in range(col.Q, col.P):
            square += y[k, c] * y[k, c]
        for c in range(col.Q, col.P):
            y[k, c] /= square**0.5


@inline
def _give_slopes(jointed: Jointed, slope: Floats, w: int) -> None:
    """Forces and torques back; bodies that nothing moves have no slopes, and add no work."""
    for k in range(jointed.block.size):
        row, lane = slope[jointed.block[k]], jointed.lane[k]
        for i in range(6):
            row[(col.P + i) * w + lane] = jointed.data.change[k, i]
        if jointed.joints.inv_mass[k] == 0.0:
            row[lane::w] = 0.0


@inline
def _add_rates(
    sums_external: Flag,
    jointed: Jointed,
    slope: Floats,
    w: int,
    k: int,
    power: float,
    F: Vec3,
    tau: Vec3,
) -> None:
    """Add rates to body k: power [W], force [N] and torque about the origin [N m]."""
    if sums_external is None:
        return
    row, lane = slope[jointed.block[k]], jointed.lane[k]
    row[_WORK_ROW * w + lane] += power
    for i in range(3):
        row[(_IMPULSE_ROW + i) * w + lane] += F[i]
        row[(_ANGULAR_ROW + i) * w + lane] += tau[i]


@inline
def _add_rates_of_row(
    sums_external: Flag, jointed: Jointed, slope: Floats, w: int, r: int, z: float, power: float
) -> None:
    """Add the power of what acts along row r, and what z of it has from the world."""
    if sums_external is None:
        return
    joints, data = jointed.joints, jointed.data
    a, b = joints.rows.a[r], joints.rows.b[r]
    k = a if joints.inv_mass[a] > 0.0 else b
    F, tau = ZERO, ZERO
    if joints.inv_mass[a] == 0.0 or joints.inv_mass[b] == 0.0:
        F = scale(z if k == a else -z, row3(data.gradient, r))
        turning = scale(z, row3(data.gradient, r, 3 if k == a else 6))
        tau = add(turning, cross(row3(data.y, k, col.X), F))
    _add_rates(sums_external, jointed, slope, w, k, power, F, tau)


@unfused_kernel
def add_actions(sums_external: Flag, jointed: Jointed, slope: Floats, w: int) -> None:
    """Add to the loads what springs, stops, motors, dampers and drag do, and their work."""
    joints, data = jointed.joints, jointed.data
    for r in range(joints.rows.kind.size):
        if joints.rows.action[r] != col.HOLDS:
            force, power = action_force(joints, data, r)
            data.z[r] = force
            add_impulses(
                joints.rows, joints.inv_mass, data.gradient, data.z, r, r + 1, data.change, 0
            )
            power -= force * data.dg_dt[r]
            _add_rates_of_row(sums_external, jointed, slope, w, r, force, power)
    _drag(sums_external, jointed, slope, w)


@inline
def _drag(sums_external: Flag, jointed: Jointed, slope: Floats, w: int) -> None:
    """Add the drag of all bodies to the loads, if something damps."""
    if jointed.damps is None:
        return
    joints, y, load = jointed.joints, jointed.data.y, jointed.data.change
    for k in range(jointed.block.size):
        v = scale(joints.inv_mass[k], row3(y, k, col.P))
        spin = by_inverse_inertia(joints.inv_inertia, orientation(y, k), k, row3(y, k, col.L))
        F, tau = scale(-joints.drag[k, 0], v), scale(-joints.drag[k, 1], spin)
        for i in range(3):
            load[k, i] += F[i]
            load[k, 3 + i] += tau[i]
        about_origin = add(tau, cross(row3(y, k, col.X), F))
        _add_rates(sums_external, jointed, slope, w, k, dot(F, v) + dot(tau, spin), F, about_origin)


@inline
def _add_what_holds(sums_external: Flag, jointed: Jointed, slope: Floats, w: int) -> None:
    """Add what keeps the joints to the loads in `data.change`, and their work."""
    joints, data, tree = jointed.joints, jointed.data, jointed.tree
    if tree is None:
        find_multipliers(joints, data, data.change)
        m = joints.rows.kind.size
        for r in range(m):
            _add_rates_of_row(
                sums_external, jointed, slope, w, r, data.z[r], -data.z[r] * data.dg_dt[r]
            )
        add_impulses(joints.rows, joints.inv_mass, data.gradient, data.z, 0, m, data.change, 0)
        return
    accelerate_tree(joints, tree, data.y, data.change)
    for i in range(tree.body.size):
        if joints.inv_mass[tree.before[i]] == 0.0:
            k = tree.body[i]
            at = subtract(row3(data.y, k, col.X), row3(tree.bodies.com, k))
            F = row3(tree.bodies.b, k)
            about_origin = add(row3(tree.bodies.b, k, 3), cross(at, F))
            _add_rates(sums_external, jointed, slope, w, k, 0.0, F, about_origin)


@kernel
def add_reactions(
    sums_external: Flag, jointed: Jointed | None, states: Floats, slope: Floats, w: int, t: float
) -> None:
    """Add what joints do at t [s] since the segment began to slopes without them, if there are any.

    Parameters
    ----------
    states, slope : ndarray, (blocks, rows * w)
        Number c of a body stands at c * w + lane: x, q, p, L, and of slopes rates of external work.
    """
    if jointed is None:
        return
    joints, data = jointed.joints, jointed.data
    _put_state(jointed, states, w)
    set_prescribed(jointed.prescribed, jointed.data, jointed.start + t, 0.0, 0, jointed.block.size)
    data.clock[0] = t
    for k in range(jointed.block.size):
        for i in range(6):
            data.change[k, i] = slope[jointed.block[k], (col.P + i) * w + jointed.lane[k]]
    if jointed.tree is None:
        factorise_all(joints, data, t)
    else:
        for r in range(joints.rows.kind.size):
            if joints.rows.action[r] != col.HOLDS:
                linearise(joints, data, r, r + 1)
    if joints.acts or joints.damps:
        add_actions(sums_external, jointed, slope, w)
    _add_what_holds(sums_external, jointed, slope, w)
    _give_slopes(jointed, slope, w)


@kernel
def bring_back(jointed: Jointed | None, states: Floats, w: int, t: float) -> None:
    """Bring states (blocks, rows * w) at t [s] to where joints hold, and their momenta.

    Bodies are moved by impulses along the gradients from rest, over a second. One factor of A is
    enough, as what is off is small.
    """
    if jointed is None:
        return
    joints, data, n = jointed.joints, jointed.data, jointed.block.size
    joint, body, start = joints.clusters.joint, joints.clusters.body, joints.program.start
    _put_state(jointed, states, w)
    set_prescribed(jointed.prescribed, jointed.data, jointed.start + t, 0.0, 0, n)
    data.motion[:] = 0.0  # else teeth would be passed meanwhile
    for k in range(n):
        for i in range(6):
            data.change[k, i], data.y[k, col.P + i] = data.y[k, col.P + i], 0.0
    for c in range(body.size - 1):
        constrained_drift(joints, data, c, 0.0, t - 1.0, 1.0)
    for k in range(n):
        for i in range(6):
            data.y[k, col.P + i] = data.change[k, i]
    set_prescribed(jointed.prescribed, jointed.data, jointed.start + t, 0.0, 0, n)
    for c in range(body.size - 1):
        lo, hi = start[joint[c]], start[joint[c + 1]]
        linearise(joints, data, lo, hi)
        set_moving(joints, data, lo, hi, t)
        keep_rates(joints, data, c, lo, hi)
        if data.failed_row[c] > 0:
            data.y[body[c] : body[c + 1]] = nan
    for k in range(n):
        for i in range(col.STATE):
            states[jointed.block[k], i * w + jointed.lane[k]] = data.y[k, i]


@inline
def _spin(jointed: Jointed, k: int) -> float:
    """Size of the angular velocity of body k [rad/s]; of what stands still 0."""
    y, inverse = jointed.data.y, jointed.joints.inv_inertia
    w = by_inverse_inertia(inverse, orientation(y, k), k, row3(y, k, col.L))
    w = add(w, row3(jointed.data.motion, k, 3))  # of what moves as prescribed
    return dot(w, w) ** 0.5


@kernel
def count_on(jointed: Jointed | None, states: Floats, w: int, t: float, h: float) -> float:
    """Take the coordinates of joints on to these states; a step h, or the longest that counts them.

    In it no two bodies of a joint turn against each other by half a turn.
    """
    if jointed is None:
        return h
    _put_state(jointed, states, w)
    set_prescribed(jointed.prescribed, jointed.data, jointed.start + t, 0.0, 0, jointed.block.size)
    count_turns(jointed.joints.coordinates, jointed.data.y, jointed.data.turned)
    rows, fastest = jointed.joints.rows, 0.0
    for r in range(rows.kind.size):
        fastest = max(fastest, _spin(jointed, rows.a[r]) + _spin(jointed, rows.b[r]))
    return min(h, _MAX_TURN / fastest) if fastest > 0.0 else h


@kernel
def store_coordinates(
    jointed: Jointed | None, states: Floats, w: int, stored: Floats, frame: int
) -> None:
    """Keep them for a frame with these states, on from where they are tracked."""
    if jointed is None:
        return
    _put_state(jointed, states, w)
    store_turns(jointed.data.turned, stored, frame)
    count_turns(jointed.joints.coordinates, jointed.data.y, stored[frame])
