"""What a plan says of joints."""

from itertools import pairwise
from typing import Final

import numpy as np

from particlerb.impulses import records as impulses
from particlerb.joints import records as col
from particlerb.joints.reactions import null_vectors
from particlerb.joints.records import Joints, joint_data_at
from particlerb.joints.rows import linearise
from particlerb.model.state import State
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.plan.merging import why_rows
from particlerb.plan.segments import GroupPlan, Plan
from particlerb.rotors.rotor_class import POINT, ROD
from particlerb.words import count_of

_MAX_CLUSTER_ROWS: Final = 1500  # of a cluster whose redundant rows are looked for
_MIN_NULL_COMPONENT: Final = 1e-6  # share of a null vector of Gᵀ from which on a row is in it
_MAX_ROWS_NAMED: Final = 8


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
