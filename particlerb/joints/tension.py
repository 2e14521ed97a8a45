"""How fast what joints carry lets a mechanism oscillate across it: limits of the step.

Of multipliers λ, -λ·g is a potential. Its second derivatives, the geometric stiffness K, bring
bodies back that move as joints let them: a string is tense, a loaded column is not. Among motions
that joints leave free, ω² is the largest eigenvalue of K M⁻¹: leapfrog is stable while hω < 2.
"""

from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np

from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.reactions import (
    MAX_SINGULAR,
    factorise_all,
    find_multipliers,
    forces_of_joints,
    weighted_gradient,
)
from particlerb.joints.records import JointData, Joints, P, Q, joint_data_at
from particlerb.joints.rows import add_impulses, linearise
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import State, lengths, quaternion_product, rotate, rotate_back

_MAX_CLUSTER_ROWS: Final = 1500  # of a cluster whose free motions are looked for
_OWN_RATIO: Final = 2.0  # of the rate of a hanging rod by itself to that about its pivot
_MOVE: Final = 1e-6  # [rad], or over the size of a joint
Ends: TypeAlias = Sequence[tuple[Ints, Floats, Floats]]  # of joints: body, arm [m], load [N]


def loaded_joints(joints: Joints, state: State, force: Floats) -> JointData:
    """Data of joints in a state with multipliers z, under forces (3, n) [N] on their group."""
    data = joint_data_at(joints, state)
    data.change[:-1, :3] = force.T[joints.order]
    factorise_all(joints, data, 0.0)
    find_multipliers(joints, data, data.change)
    return data


def joint_rates(joints: Joints, state: State, force: Floats) -> Floats:
    """Estimate of the rate of each body of a group on its joints at the start, (n,) [rad/s].

    A link turns against the forces f that it carries at arms r with ω² = Σ |f| |r| / I: of a rod
    between two joints under tension T that is 12 T/(m l), its fastest mode in a chain; a point
    between two distances has 4 T/(m l). A joint is taken to carry the weight of its body at least.
    Where masses are far apart, that of their cluster as a whole is taken if it is less.

    Parameters
    ----------
    joints, state
        Of the group.
    force : ndarray, shape (3, n) [N]
        Of gravity and pushes.
    """
    data = loaded_joints(joints, state, force)
    weight = np.linalg.norm(data.change[:, :3], axis=1)
    ends = loaded_ends(joints, data, data.z, weight)
    squared = bound_squared(joints, ends)
    for c in np.flatnonzero(joints.clusters.is_uneven).tolist():
        part = squared[slice(*joints.clusters.body[c : c + 2])]
        np.minimum(part, _fastest_along_arms(joints, data, c, ends), out=part)
    rows = joints.rows
    soft = np.flatnonzero(rows.action != col.HOLDS)
    g, actions = data.gradient[soft], joints.actions
    stiffness = (actions.stiffness + actions.stop)[rows.action[soft]]
    inverse = (joints.inv_mass[rows.a] + joints.inv_mass[rows.b])[soft] * (g[:, :3] ** 2).sum(1)
    inverse += (g[:, 3:9] * g[:, 9:15]).sum(1)
    for end in (rows.a, rows.b):
        np.add.at(squared, end[soft], stiffness * inverse)
    driven = np.flatnonzero(rows.drive != col.AT_REST)
    for end in (rows.a, rows.b):
        np.add.at(squared, end[driven], joints.drives.wave[rows.drive[driven], 1] ** 2)
    rates = np.empty(joints.order.size)
    rates[joints.order] = np.sqrt(squared[:-1])
    return rates


def loaded_ends(joints: Joints, data: JointData, z: Floats, weight: Floats) -> Ends:
    """Both ends of joints with what they carry by multipliers z, or a weight (n + 1,) if more."""
    carried = np.linalg.norm(forces_of_joints(joints, data, z)[:, :3], axis=1)
    first, rows = joints.program.start[:-1], joints.rows
    return [
        (bodies[first], arms[first], np.maximum(carried, weight[bodies[first]]))
        for bodies, arms in ((rows.a, rows.vector_a), (rows.b, rows.vector_b))
    ]


def bound_squared(joints: Joints, ends: Ends) -> Floats:
    """No less than ω² of each body, (n + 1,) [1/s²], across what the ends of its joints carry."""
    first, squared = joints.program.start[:-1], np.zeros(joints.inv_mass.size)
    is_distance = joints.rows.kind[first] == kinds.DISTANCE
    for end, arms, load in ends:
        turning = _softness(arms, joints.inv_inertia[end])
        across = 2.0 * joints.inv_mass[end] / joints.rows.length[first]
        np.add.at(squared, end, load * (turning + np.where(is_distance, across, 0.0)))
    return squared


def _fastest_along_arms(joints: Joints, data: JointData, c: int, ends: Ends) -> float:
    """Largest ω² [1/s²] of cluster c if its joints pull along their arms; inf: not known.

    By itself a light link between heavy ones would be fast, but it moves with them alone.
    """
    free = _free_motions(joints, data, c)
    if free is None or not len(free):
        return np.inf if free is None else 0.0
    (first, last), start = joints.clusters.body[c : c + 2], joints.program.start
    strains = list[Floats]()
    for end, arm, load in ends:
        inside = np.flatnonzero((first <= end) & (end < last))
        k, r, f, row = end[inside], arm[inside], load[inside], start[inside]
        size = lengths(r.T)
        f_over_r = f / np.where(size > 0.0, size, 1.0)
        turns = free[:, k - first, 3:] * np.sqrt(joints.inv_inertia[k])
        strains.append(np.cross(turns, r) * np.sqrt(f_over_r)[:, None])
        is_distance = joints.rows.kind[row] == kinds.DISTANCE
        squared = 2.0 * f * joints.inv_mass[k] / joints.rows.length[row] * is_distance
        strains.append(free[:, k - first, :3] * np.sqrt(squared)[:, None])
    stacked = np.concatenate(strains, axis=1).reshape(len(free), -1)
    return (_OWN_RATIO * float(np.linalg.norm(stacked, 2))) ** 2


def _free_motions(joints: Joints, data: JointData, c: int) -> Floats | None:
    """Motions that the joints of cluster c leave free, (d, n, 6); None: too many to be looked for.

    Orthonormal, of √M v and √I ω, turns in rotor frames; by the gradients in `data`.
    """
    first, last = joints.clusters.body[c : c + 2]
    lo, hi = joints.program.start[joints.clusters.joint[c : c + 2]]
    holds = (joints.rows.action[lo:hi] == col.HOLDS) & (data.compliance[lo:hi] < np.inf)
    weighted = weighted_gradient(joints, data, c)[holds]
    if len(weighted) > _MAX_CLUSTER_ROWS or not np.isfinite(weighted).all():
        return None
    _, size, ways = np.linalg.svd(weighted)
    free = ways[(size > MAX_SINGULAR * size.max(initial=0.0)).sum() :]
    return np.asarray(free.reshape(-1, last - first, 6))


def row_softness(joints: Joints) -> Floats:
    """Most that ω² of either body can be over |λ| of each row alone, (2, m)."""
    rows, found = joints.rows, np.empty((2, joints.rows.kind.size))
    is_turning = (rows.kind == kinds.DOT) | (rows.kind >= kinds.TURN)
    is_distance = rows.kind == kinds.DISTANCE
    ends = (rows.a, rows.vector_a), (rows.b, rows.vector_b)
    for k, (end, arm) in enumerate(ends):
        inverse = joints.inv_inertia[end]
        turning = np.where(is_turning, inverse.max(axis=1), _softness(arm, inverse))
        across = 2.0 * joints.inv_mass[end] / rows.length
        found[k] = turning + np.where(is_distance, across, 0.0)
    found[:, rows.action != col.HOLDS] = 0.0
    return found


def _softness(arm: Floats, inv_inertia: Floats) -> Floats:
    """Largest (r × n)·I⁻¹(r × n)/|r| over unit vectors n, (k,) [1/(kg m)].

    It is 0 where r is 0, and inf where it overflows.
    """
    across = np.cross(arm[:, None], np.eye(3))  # r × n of the three axes
    form = np.einsum("kia,ka,kja->kij", across, inv_inertia, across)
    size, softness = lengths(arm.T), np.full(len(arm), np.inf)
    is_finite = np.isfinite(form).all(axis=(1, 2))
    largest = np.linalg.eigvalsh(form[is_finite])[:, -1]
    softness[is_finite] = largest / np.where(size > 0.0, size, 1.0)[is_finite]
    return softness


def tension_rates(joints: Joints, data: JointData, c: int) -> tuple[Floats, Ints]:
    """All ω [rad/s] of the geometric stiffness of multipliers z in cluster c, (k,).

    And joints that they are about. Poses, gradients and z are those of an instant; data are written
    over.
    """
    joint = slice(*joints.clusters.joint[c : c + 2])
    rows = joints.program.start[joint]
    free = _free_motions(joints, data, c) if rows.size else None
    if free is None or not len(free):
        return np.zeros(0), np.zeros(0, dtype=np.int64)
    carried = np.where(joints.rows.action == col.HOLDS, data.z, 0.0)
    force = lengths(forces_of_joints(joints, data, carried)[:, :3].T)
    stiffness = _stiffness(joints, data, c, free, carried)
    squared, shapes = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    shapes, squared = shapes[:, squared > 0.0], squared[squared > 0.0]
    moved = np.tensordot(shapes, free, (0, 0))
    share = np.zeros((squared.size, joints.inv_mass.size))
    share[:, slice(*joints.clusters.body[c : c + 2])] = (moved * moved).sum(axis=2)
    of_joint = (share[:, joints.rows.a[rows]] + share[:, joints.rows.b[rows]]) * force[joint]
    return np.sqrt(squared), joint.start + of_joint.argmax(axis=1)


def fastest_tension(joints: Joints, state: State, force: Floats) -> float:
    """Largest ω [rad/s] of the cluster whose bound is largest, in a state under forces (3, n)."""
    data = loaded_joints(joints, state, force)
    ends = loaded_ends(joints, data, data.z, np.zeros(joints.inv_mass.size))
    c = cluster_of(joints, int(bound_squared(joints, ends)[:-1].argmax()))
    return float(tension_rates(joints, data, c)[0].max(initial=0.0))


def cluster_of(joints: Joints, body: int) -> int:
    """The cluster in which a body is."""
    return int(np.searchsorted(joints.clusters.body, body, side="right")) - 1


def _stiffness(joints: Joints, data: JointData, c: int, free: Floats, carried: Floats) -> Floats:
    """Geometric stiffness among free motions of cluster c, (d, d) [1/s²]: see `tension_rates`.

    By the change of Gᵀ λ over small moves forth and back; but for the half of a turned torque,
    which is not symmetric and drops out of the mean with the transposed.
    """
    first, last = joints.clusters.body[c : c + 2]
    lo, hi = joints.program.start[joints.clusters.joint[c : c + 2]]
    y, size = data.y[first:last].copy(), float(joints.rows.size[lo:hi].max())
    q = y[:, Q:P].T
    inverse = np.column_stack([*[joints.inv_mass[first:last]] * 3, joints.inv_inertia[first:last]])
    moves, changes = free * np.sqrt(inverse), np.empty_like(free)
    for k, move in enumerate(moves):
        v, w = move[:, :3], rotate(q, move[:, 3:].T)
        pace = max(np.abs(v).max() / size, np.abs(w).max())
        dt = _MOVE / pace if pace > 0.0 else 1.0
        pull = []
        for step in (dt, -dt):
            turn = np.vstack([np.ones(len(v)), 0.5 * step * w])
            data.y[first:last, :3] = y[:, :3] + step * v
            data.y[first:last, Q:P] = (quaternion_product(turn, q) / lengths(turn)).T
            linearise(joints, data, lo, hi)
            data.change[first:last] = 0.0
            numbers = joints.rows, joints.inv_mass, data.gradient, carried, lo, hi
            add_impulses(*numbers, data.change, 0)
            pull.append(data.change[first:last].copy())
        changes[k] = (pull[1] - pull[0]) / (2.0 * dt)
        changes[k, :, 3:] = rotate_back(q, changes[k, :, 3:].T).T
    data.y[first:last] = y
    return np.asarray(
        (changes * np.sqrt(inverse)).reshape(len(free), -1) @ free.reshape(len(free), -1).T
    )
