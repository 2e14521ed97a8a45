"""Packs of mechanisms of the same structure: each of them is a lane of SIMD.

What a cluster is made of, its bodies and joints and how they are tied, is the same for all of a
pack; masses, places of joints and states are of each lane. A pack is a cluster of joints whose
numbers are packs (see compiled/lanes.py): one program serves all.
"""

from collections import defaultdict
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, config, inline, unfused_kernel
from particlerb.compiled.lanes import LANES, as_packs, lane
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.actions import gives_way
from particlerb.joints.iterations import find_impulses, remember
from particlerb.joints.records import Actions, Clusters, ConstraintRows, Drives, JointData, Joints
from particlerb.joints.setup import programs_of
from particlerb.joints.solver import begin_drift, is_whole
from particlerb.maths.vec3 import Bools, Floats, Ints

MIN_ALIKE: Final = 16  # mechanisms: fewer are not worth the time to compile this


class Packs(NamedTuple):
    """Clusters of joints by packs; numbers have lanes as the last axis."""

    joints: Joints
    data: JointData
    cluster: Ints  # (packs, LANES) of the group; -1: the first one once more, and of no interest
    row: Ints  # (m, LANES) of the group


def _like(joints: Joints) -> dict[bytes, list[int]]:
    """Mechanisms of the same structure; bodies without joints are none."""
    rows, clusters, start = joints.rows, joints.clusters, joints.program.start
    world, found = joints.inv_mass.size - 1, defaultdict[bytes, list[int]](list)
    holds, is_driven = rows.action == col.HOLDS, rows.drive != col.AT_REST
    for c in np.flatnonzero(np.diff(clusters.joint)).tolist():
        first, last = clusters.body[c : c + 2]
        own = start[clusters.joint[c] : clusters.joint[c + 1] + 1]
        of = slice(own[0], own[-1])
        ends = [np.where(end == world, -1, end - first) for end in (rows.a[of], rows.b[of])]
        moments = joints.inv_inertia[first:last]
        moves, turns = joints.inv_mass[first:last] > 0.0, moments > 0.0
        is_top = moments[:, 0] == moments[:, 1]
        kinds = (
            own - own[0], *ends, rows.kind[of], joints.beside[of], holds[of],
            is_driven[of], joints.prescribed[first:last], moves, turns, is_top,
            clusters.is_uneven[c : c + 1], clusters.smallest_pivot[c : c + 1],
        )  # fmt: skip
        found[b"".join(array.tobytes() for array in kinds)].append(c)
    return found


def packs_of(joints: Joints, data: JointData) -> tuple[Packs | None, Ints]:
    """Packs of the clusters of joints, and those that are in none.

    There are none where few are alike, or nothing is compiled; what rolls or may break is in none.
    """
    none = None, np.arange(joints.clusters.body.size - 1)
    if config.DISABLE_JIT or joints.bounds is not None:
        return none
    packs, alone = list[list[int]](), np.flatnonzero(np.diff(joints.clusters.joint) == 0).tolist()
    leaves = _may_leave(joints)
    for like in _like(joints).values():
        fit = [c for c in like if not leaves[c]]
        if len(fit) < MIN_ALIKE:
            alone += like
            continue
        alone += [c for c in like if leaves[c]]
        packs += [fit[k : k + LANES] for k in range(0, len(fit), LANES)]
    if not packs:
        return none
    cluster = np.array([[*pack, *[-1] * (LANES - len(pack))] for pack in packs])
    packed, row = _packed(joints, np.where(cluster < 0, cluster[:, :1], cluster))
    return Packs(packed, _room(packed, data), cluster, row), np.array(alone, dtype=np.int64)


def _may_leave(joints: Joints) -> Bools:
    """Clusters with joints that roll or may break, for which packs have no code."""
    rows, start, first = joints.rows, joints.program.start[:-1], joints.clusters.joint
    leaves = np.logical_or.reduceat(np.isin(rows.kind, (kinds.RACK, kinds.GEAR)), start)
    if joints.breaks is not None:
        leaves |= np.isfinite(joints.breaks.force) | np.isfinite(joints.breaks.torque)
    return np.diff(np.append(0, np.cumsum(leaves))[first]) > 0


def _ranges(first: Ints, which: Ints) -> Ints:
    """Numbers from first[k] to first[k + 1] of some k, one behind the other."""
    return np.concatenate([np.arange(first[k], first[k + 1]) for k in which])


def _packed(joints: Joints, cluster: Ints) -> tuple[Joints, Ints]:
    """Joints of packs of clusters (packs, LANES), and rows of the group (m, LANES)."""
    clusters, start, rows = joints.clusters, joints.program.start, joints.rows
    world, leading = joints.inv_mass.size - 1, cluster[:, 0]
    body = np.stack([np.append(_ranges(clusters.body, lane), world) for lane in cluster.T], -1)
    row = np.stack([_ranges(start[clusters.joint], lane) for lane in cluster.T], -1)
    place = np.zeros(world + 1, dtype=np.int64)
    place[body[:, 0]] = np.arange(len(body))
    sizes, counts = (np.diff(of)[leading] for of in (clusters.body, clusters.joint))
    joint = _ranges(clusters.joint, leading)
    own_start = np.append(0, np.cumsum(np.diff(start)[joint]))
    of_lanes = {
        name: np.stack([getattr(rows, name)[lane] for lane in row.T], -1)
        for name in ("vector_a", "vector_b", "axis", "length", "size")
    }
    of_pack = ConstraintRows._make(array[row[:, 0]] for array in rows)
    actions, action = _by_lane(joints.actions, rows.action, row)
    drives, drive = _by_lane(joints.drives, rows.drive, row)
    of_pack = of_pack._replace(
        a=place[of_pack.a], b=place[of_pack.b], action=action, drive=drive, **of_lanes
    )
    label, holds = np.arange(len(leading)), action == col.HOLDS
    made, program = programs_of(
        np.append(0, np.cumsum(sizes)), np.repeat(label, counts), np.repeat(label, sizes), of_pack,
        own_start, joints.inv_mass[body[:, 0]], np.logical_or.reduceat(holds, own_start[:-1]),
    )  # fmt: skip
    packed = joints._replace(
        order=joints.order[:0], inv_mass=joints.inv_mass[body],
        inv_inertia=np.stack([joints.inv_inertia[lane] for lane in body.T], -1), rows=of_pack,
        clusters=made._replace(even_inv_mass=clusters.even_inv_mass[body]), program=program,
        number=joints.number[joint], drag=joints.drag[body[:, 0]], actions=Actions(*actions),
        beside=joints.beside[row[:, 0]], prescribed=joints.prescribed[body[:, 0]],
        drives=Drives(*drives), breaks=None, rolls=None,
    )  # fmt: skip
    return packed, row


def _by_lane(of: Actions | Drives, which: Ints, row: Ints) -> tuple[list[Floats], Ints]:
    """What acts along rows (m, LANES), or prescribes them, one of each; and which, or -1."""
    is_there = which[row[:, 0]] >= 0
    taken = which[row[is_there]]
    numbers = [np.ascontiguousarray(np.moveaxis(array[taken], 1, -1)) for array in of]
    return numbers, np.where(is_there, np.cumsum(is_there) - 1, -1)


def past_of(packs: Packs | None, data: JointData) -> Floats:
    """`JointData.past` of all joints of a group."""
    past = data.past.copy()
    if packs is not None:
        for k in reversed(range(LANES)):  # the first lane last: others may stand for it
            past[packs.row[:, k]] = packs.data.past[..., k]
    return past


def set_past(packs: Packs | None, data: JointData, past: Floats) -> None:
    """Go on from what it was; older checkpoints have fewer steps."""
    data.past[:, : past.shape[1]] = past
    if packs is not None:
        packs.data.past[:] = np.moveaxis(data.past[packs.row], 1, -1)


def _room(joints: Joints, data: JointData) -> JointData:
    """Room for what packs read and write; the clock is that of all joints."""
    n, m = len(joints.inv_mass), joints.rows.kind.size
    of_bodies = {"y", "pose", "motion", "end_pose", "change", "inv_mass", "inv_inertia"}
    width = int(np.diff(joints.program.start).max())
    world = np.zeros((n, col.STATE, LANES))
    world[-1, col.Q] = 1.0
    room = {
        name: np.zeros((n if name in of_bodies else m, *array.shape[1:], LANES))
        for name, array in data._asdict().items()
    }
    return data._replace(
        **room
        | {
            "y": world,
            "factor": np.zeros((len(joints.program.pair), width, width, LANES)),
            "past": np.full((m, col.PAST, LANES), np.nan),
            "failed_row": np.zeros(LANES * (len(joints.clusters.body) - 1), dtype=np.int64),
            "turned": data.turned[:0], "clock": data.clock, "broken": data.broken[:0],
            "load": data.load[:0],
        }
    )  # fmt: skip


@unfused_kernel
def drift_pack(
    joints: Joints, data: JointData, c: int, kick_dt: float, t: float, dt: float
) -> None:
    """Kick and drift of `constrained_drift` for a pack of clusters.

    Those that no impulses keep, or whose stops give way, are lost, and remember nothing of it:
    `failed_row` is 1.
    """
    clusters, start = joints.clusters, joints.program.start
    lo, hi = start[clusters.joint[c]], start[clusters.joint[c + 1]]
    guesses = begin_drift(joints, data, c, kick_dt, t, dt)
    is_lost, _ = find_impulses(joints, data, c, t, dt, guesses)
    if joints.acts:
        for r in range(lo, hi):
            is_lost = is_lost | gives_way(joints.rows, joints.actions, r, data.pose, data.y)
    if is_whole(data, dt):
        remember(data, lo, hi, kick_dt, is_lost)
    for k in range(LANES):
        data.failed_row[LANES * c + k] = lane(is_lost, k)


@inline
def put_in_lane(packs: Packs, joints: Joints, data: JointData, p: int, i: int, c: int) -> None:
    """States of cluster c of a group, and what is prescribed or damps, into lane i of pack p."""
    body, of_pack = joints.clusters.body, packs.data
    at = packs.joints.clusters.body[p] - body[c]
    for k in range(body[c], body[c + 1]):
        for j in range(col.STATE):
            of_pack.y[at + k, j, i] = data.y[k, j]
        if joints.prescribed[k]:
            for j in range(col.P):
                of_pack.end_pose[at + k, j, i] = data.end_pose[k, j]
            for j in range(9):
                of_pack.motion[at + k, j, i] = data.motion[k, j]
        if joints.damps:
            of_pack.inv_mass[at + k, i] = data.inv_mass[k]
            for j in range(3):
                of_pack.inv_inertia[at + k, j, i] = data.inv_inertia[k, j]


@inline
def take_from_lane(
    sums_external: Flag, packs: Packs, joints: Joints, data: JointData, p: int, i: int, c: int
) -> None:
    """States of cluster c, lane i of pack p, and what external work is found from."""
    start, joint, body = joints.program.start, joints.clusters.joint, joints.clusters.body
    of_pack, at = packs.data, packs.joints.clusters.body[p] - body[c]
    for k in range(body[c], body[c + 1]):
        for j in range(col.STATE):
            data.y[k, j] = of_pack.y[at + k, j, i]
    own = packs.joints.program.start[packs.joints.clusters.joint[p]] - start[joint[c]]
    for r in range(start[joint[c]], start[joint[c + 1]]):
        data.impulse[r] = of_pack.impulse[own + r, i]
    if sums_external is None:
        return
    for k in range(body[c], body[c + 1]):
        for j in range(col.P if joints.acts else 3):  # of motors work is found from coordinates
            data.pose[k, j] = of_pack.pose[at + k, j, i]
    for r in range(start[joint[c]], start[joint[c + 1]]):
        if joints.moves or joints.damps:
            data.dg_dt[r] = of_pack.dg_dt[own + r, i]
            data.compliance[r] = of_pack.compliance[own + r, i]
        if joints.inv_mass[joints.rows.a[r]] == 0.0 or joints.inv_mass[joints.rows.b[r]] == 0.0:
            for j in range(9):
                data.gradient[r, j] = of_pack.gradient[own + r, j, i]


@inline
def exchange_past(packs: Packs, joints: Joints, data: JointData, p: int, i: int, c: int) -> None:
    """Exchange what cluster c, lane i of pack p, remembers of its impulses."""
    start, joint, past = joints.program.start, joints.clusters.joint, packs.data.past
    at = packs.joints.program.start[packs.joints.clusters.joint[p]] - start[joint[c]]
    for r in range(start[joint[c]], start[joint[c + 1]]):
        for j in range(past.shape[1]):
            mine, its = data.past[r, j], past[at + r, j, i]
            data.past[r, j], past[at + r, j, i] = its, mine


@inline
def numbers_of(joints: Joints) -> Joints:
    """Joints of packs, as kernels take them."""
    rows, clusters, actions = joints.rows, joints.clusters, joints.actions
    return Joints(
        joints.order,
        as_packs(joints.inv_mass),
        as_packs(joints.inv_inertia),
        ConstraintRows(
            rows.kind, rows.a, rows.b, as_packs(rows.vector_a), as_packs(rows.vector_b),
            as_packs(rows.axis), as_packs(rows.length), as_packs(rows.size), rows.action,
            rows.drive, rows.wheel,
        ),
        Clusters(
            clusters.body, clusters.joint, clusters.block, clusters.smallest_pivot,
            clusters.is_uneven, as_packs(clusters.even_inv_mass),
        ),
        joints.program, joints.number,
        Actions(
            as_packs(actions.stiffness), as_packs(actions.rest), as_packs(actions.damping),
            as_packs(actions.lower), as_packs(actions.upper), as_packs(actions.stop),
            as_packs(actions.stop_damping), as_packs(actions.motor), as_packs(actions.has_motor),
        ),
        joints.drag, joints.beside, joints.acts, joints.damps, joints.coordinates,
        Drives(as_packs(joints.drives.polynomial), as_packs(joints.drives.wave)),
        joints.prescribed, joints.moves, None, None, None,
    )  # fmt: skip


@inline
def data_of(data: JointData) -> JointData:
    """Their data."""
    return JointData(
        as_packs(data.y), as_packs(data.pose), as_packs(data.gradient), as_packs(data.motion),
        as_packs(data.end_pose), as_packs(data.change), as_packs(data.inv_mass),
        as_packs(data.inv_inertia), as_packs(data.g), as_packs(data.dg_dt), as_packs(data.z),
        as_packs(data.impulse), as_packs(data.half_step), as_packs(data.step_impulse),
        as_packs(data.last_g), as_packs(data.last_gain), as_packs(data.scale),
        as_packs(data.compliance), as_packs(data.past), as_packs(data.factor), data.failed_row,
        data.turned, data.clock, data.broken, data.load,
    )  # fmt: skip
