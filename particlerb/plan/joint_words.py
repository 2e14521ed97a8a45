"""What a plan says of joints, and the fastest rates that they bring: both at the start."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from particlerb.impulses import records as impulses
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.reactions import (
    MAX_SINGULAR,
    factorise_all,
    find_multipliers,
    forces_of_joints,
    null_vectors,
    weighted_gradient,
)
from particlerb.joints.records import JointData, Joints, joint_data_at
from particlerb.joints.rows import linearise
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, lengths
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.plan.merging import why_rows
from particlerb.plan.segments import GroupPlan, Plan
from particlerb.rotors.rotor_class import POINT, ROD
from particlerb.words import count_of

_MAX_CLUSTER_ROWS: Final = 1500  # of a cluster whose redundant rows are looked for
_MIN_NULL_COMPONENT: Final = 1e-6  # share of a null vector of Gᵀ from which on a row is in it
_MAX_ROWS_NAMED: Final = 8
_OWN_RATIO: Final = 2.0  # of the rate of a hanging rod by itself to that about its pivot


def joint_rates(joints: Joints, bodies: Bodies, state: State, force: Floats) -> Floats:
    """Estimate of the rate of each body of a group on its joints at the start, (n,) [rad/s].

    A link turns against the forces f that it carries at arms r with ω² = Σ |f| |r| / I: of a rod
    between two joints under tension T that is 12 T/(m l), its fastest mode in a chain; a point
    between two distances has 4 T/(m l). A joint is taken to carry the weight of its body at least.
    Where masses are far apart, that of their cluster as a whole is taken if it is less.

    Parameters
    ----------
    joints, bodies, state
        Of the group.
    force : ndarray, shape (3, n) [N]
        Of gravity and pushes.
    """
    data = joint_data_at(joints, state)
    data.change[:-1, :3] = force.T[joints.order]
    factorise_all(joints, data, 0.0)
    find_multipliers(joints, data, data.change)
    carried = np.linalg.norm(forces_of_joints(joints, data, data.z)[:, :3], axis=1)
    first = joints.program.start[:-1]
    weight = np.linalg.norm(data.change[:, :3], axis=1)
    squared, loaded = np.zeros(joints.inv_mass.size), []
    is_distance = joints.rows.kind[first] == kinds.DISTANCE
    ends = (joints.rows.a, joints.rows.vector_a), (joints.rows.b, joints.rows.vector_b)
    for bodies_of, arms in ends:
        end = bodies_of[first]
        load = np.maximum(carried, weight[end])
        turning = _softness(arms[first], joints.inv_inertia[end])
        across = 2.0 * joints.inv_mass[end] / joints.rows.length[first]
        np.add.at(squared, end, load * (turning + np.where(is_distance, across, 0.0)))
        loaded.append((end, arms[first], load))
    for c in np.flatnonzero(joints.clusters.is_uneven).tolist():
        part = squared[slice(*joints.clusters.body[c : c + 2])]
        np.minimum(part, _fastest_squared(joints, data, c, loaded), out=part)
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
    rates = np.empty(bodies.mass.size)
    rates[joints.order] = np.sqrt(squared[:-1])
    return rates


def _fastest_squared(
    joints: Joints, data: JointData, c: int, ends: Sequence[tuple[Ints, Floats, Floats]]
) -> float:
    """Largest ω² [1/s²] of cluster c in motions that its joints leave free; inf: not known.

    By itself a light link between heavy ones would be fast, but it moves with them alone. The ends
    of joints are their bodies, arms [m] and loads [N].
    """
    rows, start = joints.rows, joints.program.start
    first, last = joints.clusters.body[c : c + 2]
    lo, hi = start[joints.clusters.joint[c : c + 2]]
    weighted = weighted_gradient(joints, data, c)[rows.action[lo:hi] == col.HOLDS]
    if len(weighted) > _MAX_CLUSTER_ROWS or not np.isfinite(weighted).all():
        return np.inf
    _, size, ways = np.linalg.svd(weighted)
    free = ways[(size > MAX_SINGULAR * size.max(initial=0.0)).sum() :]
    free = free.reshape(-1, last - first, 6)
    strains = list[Floats]()
    for end, arm, load in ends:
        inside = np.flatnonzero((first <= end) & (end < last))
        k, r, f, row = end[inside], arm[inside], load[inside], start[inside]
        size = lengths(r.T)
        f_over_r = f / np.where(size > 0.0, size, 1.0)
        turns = free[:, k - first, 3:] * np.sqrt(joints.inv_inertia[k])
        strains.append(np.cross(turns, r) * np.sqrt(f_over_r)[:, None])
        squared = (
            2.0 * f * joints.inv_mass[k] / rows.length[row] * (rows.kind[row] == kinds.DISTANCE)
        )
        strains.append(free[:, k - first, :3] * np.sqrt(squared)[:, None])
    stacked = np.concatenate(strains, axis=1).reshape(len(free), -1)
    return (_OWN_RATIO * float(np.linalg.norm(stacked, 2))) ** 2 if len(free) else 0.0


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


def joint_line(system: System, plan: Plan) -> str:
    """What joints hold, what they leave free, and which rows depend on others."""
    setup = joints_of(system)
    assert setup is not None
    types = [system.joint[k].type for k in setup.record.tolist()]
    counts = ", ".join(f"{types.count(kind)} {kind}" for kind in dict.fromkeys(types))
    clusters = bodies = free = 0
    dependent: list[str] = []
    n_dependent = 0
    for group in plan.groups:
        joints = group.segments[0].terms.joints
        if joints is None:
            continue
        count = _Count(system, group, joints)
        clusters, bodies, free = clusters + count.clusters, bodies + count.bodies, free + count.free
        dependent += [setup.names[k] for k in count.dependent]
        n_dependent += count.n_dependent
    lasting = np.repeat(setup.until > 0.0, np.diff(setup.start))
    rows = int((setup.rows.action[lasting] == col.HOLDS).sum())
    held = f"{count_of(bodies, 'body', 'bodies')} in {count_of(clusters, 'cluster')}"
    line = f"{counts}; {held}, {count_of(rows, 'row')}"
    if n_dependent:
        names = ", ".join(dependent[:_MAX_ROWS_NAMED])
        more = ", ..." if len(dependent) > _MAX_ROWS_NAMED else ""
        line += f", {n_dependent} of them redundant among those of {names}{more}"
        line += " (only sums of their reactions are determined)"
    line = f"{line}; {count_of(free, 'degree')} of freedom" if bodies else counts
    counts_of = np.bincount(setup.bounds.kind, minlength=3).tolist()
    words = {impulses.STOP: "stops", impulses.MOTOR: "motors with a largest load"}
    words[impulses.RUBS] = "joints with friction"
    bounded = [f"{counts_of[kind]} {word}" for kind, word in words.items() if counts_of[kind]]
    line += f"; by impulses: {', '.join(bounded)}" if bounded else ""
    reasons = why_rows(system)
    line += f"; fixed joints keep their rows because of {' and '.join(reasons)}" if reasons else ""
    return line + _merged_words(system)


def _merged_words(system: System) -> str:
    """Which bodies are merged; empty where none are."""
    if system.merging is None:
        return ""
    bodies = np.flatnonzero(system.merging.is_merged)
    names = ", ".join(system.names[b] for b in bodies[:_MAX_ROWS_NAMED].tolist())
    more = ", ..." if bodies.size > _MAX_ROWS_NAMED else ""
    parts = np.unique(system.merging.host[bodies]).size
    return f"; {bodies.size} bodies are merged into {parts}: {names}{more}"


class _Count:
    """Clusters, bodies, degrees of freedom and redundant rows of a group at the start."""

    def __init__(self, system: System, group: GroupPlan, joints: Joints) -> None:
        state = State(*(values[:, group.members] for values in system.state))
        data = joint_data_at(joints, state)
        linearise(joints, data, 0, joints.rows.kind.size)
        rotor_class = group.bodies.rotor_class[joints.order]
        freedom = 6 - (rotor_class == ROD) - 3 * (rotor_class == POINT)
        freedom *= joints.inv_mass[:-1] > 0.0
        self.clusters = self.bodies = self.free = self.n_dependent = 0
        self.dependent: list[int] = []
        clusters, start = joints.clusters, joints.program.start
        for c, (lo, hi) in enumerate(pairwise(clusters.joint.tolist())):
            if lo == hi:
                continue
            freedoms = freedom[clusters.body[c] : clusters.body[c + 1]]
            rows = int((joints.rows.action[start[lo] : start[hi]] == col.HOLDS).sum())
            null = np.zeros((0, rows))
            if not rows:
                continue
            if clusters.smallest_pivot[c] > 0.0 and rows <= _MAX_CLUSTER_ROWS:
                null = null_vectors(joints, data, c)
            self.clusters += 1
            self.bodies += freedoms.size
            self.free += int(freedoms.sum()) - rows + len(null)
            self.n_dependent += len(null)
            if len(null):
                hit = np.flatnonzero(np.abs(null).max(axis=0) > _MIN_NULL_COMPONENT) + start[lo]
                dependent = np.unique(np.searchsorted(start, hit, side="right") - 1)
                self.dependent += joints.number[dependent].tolist()
