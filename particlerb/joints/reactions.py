"""What joints carry: multipliers λ of A λ = -(G M⁻¹ (F, τ - ω × L) + convective part of g̈).

They follow from the state alone. Where rows depend on others, only sums are determined; of all
solutions the one of least norm is taken, torques divided by the size of the joint.
"""

from typing import Final

import numpy as np

from particlerb.compiled.jit import unfused_kernel
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.accelerations import accelerations
from particlerb.joints.actions import add_stored_energy
from particlerb.joints.block_cholesky import solve
from particlerb.joints.records import JointData, Joints
from particlerb.joints.solver import factorise_cluster
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.state import rotate, rotate_back
from particlerb.model.worlds import Worlds

MAX_SINGULAR: Final = 1e-10  # over the largest singular value: of null vectors
_NULL_ROUNDING: Final = 1e-8  # share of the largest component of a null vector


@unfused_kernel
def factorise_all(joints: Joints, data: JointData, t: float) -> None:
    """Gradients of all rows and the factors of A in the states y at t."""
    for c in range(joints.clusters.body.size - 1):
        factorise_cluster(joints, data, c, 0.0, t)


@unfused_kernel
def find_multipliers(joints: Joints, data: JointData, load: Floats) -> None:
    """z = λ [N, or N m] of all rows by these factors, under loads (n + 1, 6), force and torque."""
    start, joint = joints.program.start, joints.clusters.joint
    for c in range(joints.clusters.body.size - 1):
        accelerations(joints, data, start[joint[c]], start[joint[c + 1]], load)
        solve(joints.program, joints.clusters, data.factor, data.z, c)


def weighted_gradient(joints: Joints, data: JointData, c: int) -> Floats:
    """G M⁻¹ᐟ² of cluster c in the pose of its gradients, (rows, 6 bodies).

    Torque rows are divided by the size of their joint.
    """
    body = joints.clusters.body[c : c + 2]
    lo, hi = joints.program.start[joints.clusters.joint[c : c + 2]]
    n, rows = body[1] - body[0], joints.rows
    weighted = np.zeros((hi - lo, n + 1, 6))
    index = np.arange(hi - lo)
    for end, sign, at in ((rows.a[lo:hi], 1.0, 3), (rows.b[lo:hi], -1.0, 6)):
        column = np.minimum(end - body[0], n)
        q = data.y[end, 3:7]
        weighted[index, column, :3] = sign * data.gradient[lo:hi, :3]
        weighted[index, column, :3] *= np.sqrt(joints.inv_mass[end])[:, None]
        turning = rotate_back(q.T, data.gradient[lo:hi, at : at + 3].T)
        weighted[index, column, 3:] = turning.T * np.sqrt(joints.inv_inertia[end])
    return np.ascontiguousarray(weighted[:, :n].reshape(hi - lo, -1))


def dependent_rows(weighted: Floats) -> Floats:
    """Null vectors of Gᵀ, (redundant, rows); none where all rows are independent, or lost."""
    if not (weighted.size and np.isfinite(weighted).all()):
        return np.zeros((0, len(weighted)))
    U, singular_values, _ = np.linalg.svd(weighted)
    size = np.zeros(len(U))
    size[: singular_values.size] = singular_values
    null: Floats = U[:, size <= MAX_SINGULAR * singular_values[0]].T
    return null


def null_vectors(joints: Joints, data: JointData, c: int) -> Floats:
    """Null vectors of Gᵀ of cluster c, (redundant, rows), 0 in rows that hold nothing."""
    lo, hi = joints.program.start[joints.clusters.joint[c : c + 2]]
    holds = joints.rows.action[lo:hi] == col.HOLDS
    dependent = dependent_rows(weighted_gradient(joints, data, c)[holds])
    null = np.zeros((len(dependent), hi - lo))
    null[:, holds] = dependent
    return null


def make_least(joints: Joints, data: JointData) -> Bools:
    """Make λ in z the one of least norm, of clusters with closed loops.

    Returns
    -------
    ndarray, shape (j, 6)
        Which components of forces and torques dependent rows leave open: a null vector of Gᵀ has
        something there.
    """
    is_open = np.zeros((joints.number.size, 6), dtype=np.bool_)
    sizes = np.where(_is_turning(joints), _joint_sizes(joints), 1.0)
    for c in np.flatnonzero(joints.clusters.smallest_pivot > 0.0):
        lo, hi = joints.program.start[joints.clusters.joint[c : c + 2]]
        null = null_vectors(joints, data, int(c))
        if len(null):  # λ' = λ / size: along the null vectors of the rows times the size
            along = null / sizes[lo:hi]
            basis, _ = np.linalg.qr(along.T)
            scaled = data.z[lo:hi] / sizes[lo:hi]
            data.z[lo:hi] = (scaled - basis @ (basis.T @ scaled)) * sizes[lo:hi]
        for vector in null:
            z = np.zeros(data.z.size)
            z[lo:hi] = vector
            reactions = np.abs(forces_of_joints(joints, data, z))
            reactions[:, 3:] /= _joint_sizes(joints)[joints.program.start[:-1], None]
            is_open |= reactions > _NULL_ROUNDING * reactions.max()
    return is_open


def _is_turning(joints: Joints) -> Bools:
    """Which rows have torques for multipliers."""
    return np.asarray((joints.rows.kind == kinds.DOT) | (joints.rows.kind >= kinds.TURN))


def _joint_sizes(joints: Joints) -> Floats:
    """Size of the joint of each row [m]; 1 where all of its rows are of directions."""
    start, size = joints.program.start, np.where(_is_turning(joints), 0.0, joints.rows.size)
    largest = np.maximum.reduceat(size, start[:-1])
    return np.repeat(np.where(largest > 0.0, largest, 1.0), np.diff(start))


def forces_of_joints(joints: Joints, data: JointData, z: Floats) -> Floats:
    """Force and torque on the first body of each joint from λ = z, at its point, (j, 6) [N, N m].

    World axes. The point is where `at` is on the first body.
    """
    by_x, by_a = data.gradient[:, :3], data.gradient[:, 3:6]
    start = joints.program.start[:-1]
    if not start.size:
        return np.zeros((0, 6))
    force = np.add.reduceat(z[:, None] * by_x, start)
    turning = np.add.reduceat(z[:, None] * by_a, start)
    arm = rotate(data.y[joints.rows.a[start], 3:7].T, joints.rows.vector_a[start].T)
    return np.hstack([force, turning - np.cross(arm.T, force)])


def energy_of_joints(
    joints: Joints, com: Floats, q: Floats, worlds: Worlds | None = None
) -> Floats | float:
    """Energy of springs and stops in joints [J], bodies (3, n) [m] and (4, n) as in their group.

    Of worlds, (n_worlds,).
    """
    sums = np.zeros(1 if worlds is None else len(worlds.bodies))
    if not joints.acts:
        return sums if worlds is not None else 0.0
    y = np.zeros((joints.inv_mass.size, col.STATE))
    y[-1, col.Q] = 1.0
    y[:-1, : col.P] = np.vstack([com, q]).T[joints.order]
    none = np.zeros(joints.order.size, dtype=np.int64)
    world = none if worlds is None else worlds.numbers[joints.order]
    add_stored_energy(joints, y, world, sums)
    return sums if worlds is not None else float(sums[0])
