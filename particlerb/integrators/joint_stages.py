"""Stages of bodies that joints tie together: the drift that keeps joints, and the projection.

Where a group has no joints, the compiler leaves all of it out.
"""

from math import nan

from particlerb.compiled.barrier import Team, share_of
from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.compiled.lanes import LANES
from particlerb.contact.prescribed_motion import (
    PrescribedBodies,
    prescribed_acceleration,
    prescribed_in,
    prescribed_momenta,
    prescribed_pose,
)
from particlerb.forces.kernels import Acting, kick_potential
from particlerb.forces.registry import STAGE
from particlerb.integrators.external_work import add_entry
from particlerb.integrators.pair_stages import meet_all
from particlerb.joints import records as col
from particlerb.joints.actions import finish_damping, soften, softened, work_of_motor
from particlerb.joints.breaking import break_overloaded, foresee_breaks, sum_half_step
from particlerb.joints.coordinates import count_turns, store_turns
from particlerb.joints.packs import (
    Packs,
    data_of,
    drift_pack,
    exchange_past,
    numbers_of,
    put_in_lane,
    take_from_lane,
)  # fmt: skip
from particlerb.joints.records import JointData, Jointed
from particlerb.joints.rows import by_inverse_inertia, put_pose
from particlerb.joints.solver import constrained_drift, project_momenta
from particlerb.maths.quaternion import Matrix
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import ZERO, Floats, Vec3, add_scaled, cross, dot, scale, subtract
from particlerb.model.block import COM, get, get3, get4, put, put3
from particlerb.model.load import STATE_ROWS


@inline
def keep_kick(
    acting: Acting, rows: Floats, b: int, R: Matrix, dt: float, old: tuple[Vec3, Vec3],
    new: tuple[Vec3, Vec3],
) -> None:  # fmt: skip
    """Keep what forces without potential gave body b in a kick."""
    p, spin = kick_potential(acting, rows, b, get3(rows, COM, b), R, dt, old[0], old[1])
    put3(rows, STAGE, b, subtract(new[0], p))
    put3(rows, STAGE + 3, b, subtract(new[1], spin))


@inline
def _gather(jointed: Jointed, blocks: Floats, c: int) -> None:
    """States of cluster c."""
    joints, data, block, lane = jointed.joints, jointed.data, jointed.block, jointed.lane
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        for i in range(STATE_ROWS):
            data.y[k, i] = get(blocks[block[k]], COM + i, lane[k])


@inline
def set_prescribed(
    prescribed: PrescribedBodies | None, data: JointData, time: float, dt: float, first: int,
    end: int,
) -> None:  # fmt: skip
    """Put prescribed bodies, of first to end, where they are, with momenta if dt is 0."""
    if prescribed is None:
        return
    y, motion = data.y, data.motion
    for k in prescribed_in(prescribed, first, end):
        b = prescribed.body[k]
        x, q, v, w = prescribed_pose(prescribed, k, time)
        put_pose(y, b, x, q)
        put_row3(motion, b, v)
        put_row3(motion, b, w, 3)
        put_row3(motion, b, prescribed_acceleration(prescribed, k, time), 6)
        if dt == 0.0:
            p, spin = prescribed_momenta(prescribed, k, q, v, w)
            put_row3(y, b, p, col.P)
            put_row3(y, b, spin, col.L)
        x, q, v, w = prescribed_pose(prescribed, k, time + dt)
        put_pose(data.end_pose, b, x, q)


@inline
def _scatter(jointed: Jointed, blocks: Floats, c: int) -> None:
    """States of cluster c, back into the blocks; nothing but NaN where it was lost."""
    joints, data, block, lane = jointed.joints, jointed.data, jointed.block, jointed.lane
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        for i in range(STATE_ROWS):
            put(blocks[block[k]], COM + i, lane[k], nan if data.failed_row[c] else data.y[k, i])


@inline
def _add_impulses_of_world(
    sums_external: Flag, jointed: Jointed, blocks: Floats, c: int, at: Floats
) -> None:
    """Add the impulses of joints with the world of cluster c, whose bodies were at `at`."""
    if sums_external is None:
        return
    joints, data, block, lane = jointed.joints, jointed.data, jointed.block, jointed.lane
    start = joints.program.start
    for r in range(start[joints.clusters.joint[c]], start[joints.clusters.joint[c + 1]]):
        a, b, z = joints.rows.a[r], joints.rows.b[r], data.impulse[r]
        by_x = row3(data.gradient, r)
        if joints.inv_mass[b] == 0.0 and joints.inv_mass[a] > 0.0:
            impulse = scale(z, by_x)
            turning = add_scaled(z, row3(data.gradient, r, 3), cross(row3(at, a, col.X), impulse))
            add_entry(sums_external, blocks[block[a]], lane[a], 1.0, (0.0, impulse, turning))
        elif joints.inv_mass[a] == 0.0 and joints.inv_mass[b] > 0.0:
            impulse = scale(-z, by_x)
            turning = add_scaled(z, row3(data.gradient, r, 6), cross(row3(at, b, col.X), impulse))
            add_entry(sums_external, blocks[block[b]], lane[b], 1.0, (0.0, impulse, turning))


@inline
def _correct_work(
    sums_external: Flag, jointed: Jointed, blocks: Floats, c: int, kick_dt: float
) -> None:
    """Add the work that forces without potential do along what joints changed of the velocities.

    A kick has added it with the velocities before the impulses of the joints; one of no length has
    given nothing.
    """
    if sums_external is None or jointed.keeps_kick is None or kick_dt == 0.0:
        return
    joints, data, block, lane = jointed.joints, jointed.data, jointed.block, jointed.lane
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        rows, b = blocks[block[k]], lane[k]
        by_joints = subtract(row3(data.y, k, col.P), get3(rows, COM + col.P, b))
        turning = subtract(row3(data.y, k, col.L), get3(rows, COM + col.L, b))
        q = get4(rows, COM + col.Q, b)
        spin = by_inverse_inertia(joints.inv_inertia, q, k, turning)
        gain = joints.inv_mass[k] * dot(get3(rows, STAGE, b), by_joints)
        gain += dot(get3(rows, STAGE + 3, b), spin)
        add_entry(sums_external, rows, b, 0.5, (gain, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))


@inline
def add_work_of_row(
    sums_external: Flag, jointed: Jointed, blocks: Floats, r: int, work: float
) -> None:
    """Add work of what acts along row r, on the first of its bodies that is in a block."""
    n = jointed.block.size
    k = jointed.joints.rows.a[r] if jointed.joints.rows.a[r] < n else jointed.joints.rows.b[r]
    add_entry(sums_external, blocks[jointed.block[k]], jointed.lane[k], 1.0, (work, ZERO, ZERO))


@inline
def _add_work_of_drives(sums_external: Flag, jointed: Jointed, blocks: Floats, c: int) -> None:
    """Add the work -λ ∂g/∂t of constraints of cluster c that move by themselves."""
    if sums_external is None or not jointed.joints.moves:
        return
    data, start, joint = jointed.data, jointed.joints.program.start, jointed.joints.clusters.joint
    for r in range(start[joint[c]], start[joint[c + 1]]):
        if data.dg_dt[r] != 0.0:
            add_work_of_row(sums_external, jointed, blocks, r, -data.dg_dt[r] * data.impulse[r])


@inline
def _add_work_of_motors(sums_external: Flag, jointed: Jointed, blocks: Floats, c: int) -> None:
    """Add the work of constant motors of cluster c in a drift."""
    if sums_external is None or not jointed.joints.acts:
        return
    joints, data = jointed.joints, jointed.data
    start, joint = joints.program.start, joints.clusters.joint
    for r in range(start[joint[c]], start[joint[c + 1]]):
        if joints.rows.action[r] != col.HOLDS:
            add_work_of_row(sums_external, jointed, blocks, r, work_of_motor(joints, data, r))


@inline
def _finish_projection(
    sums_external: Flag, jointed: Jointed, blocks: Floats, c: int, kick_dt: float
) -> None:
    """Add what joints of cluster c did in a projection."""
    sum_half_step(jointed.joints, jointed.data, c, True)
    _add_impulses_of_world(sums_external, jointed, blocks, c, jointed.data.y)
    _add_work_of_drives(sums_external, jointed, blocks, c)
    _correct_work(sums_external, jointed, blocks, c, kick_dt)


@inline
def _finish_damping(
    sums_external: Flag, jointed: Jointed, blocks: Floats, c: int, span: float
) -> None:
    """Take cluster c from the middle of damping over a span to its end."""
    joints, data, block, lane = jointed.joints, jointed.data, jointed.block, jointed.lane
    start, joint = joints.program.start, joints.clusters.joint
    for r in range(start[joint[c]], start[joint[c + 1]]):
        half = data.impulse[r]
        data.impulse[r] = 2.0 * half
        if joints.rows.action[r] != col.HOLDS and half != 0.0:
            work = -2.0 * data.compliance[r] * half * half
            add_work_of_row(sums_external, jointed, blocks, r, work)
    sum_half_step(joints, data, c, False)
    _add_impulses_of_world(sums_external, jointed, blocks, c, data.y)
    _add_work_of_drives(sums_external, jointed, blocks, c)
    for k in range(joints.clusters.body[c], joints.clusters.body[c + 1]):
        entry = finish_damping(joints, data, k, span)
        add_entry(sums_external, blocks[block[k]], lane[k], 1.0, entry)


@inline
def _share_of(team: Team | None, n: int) -> tuple[int, int]:
    """Which of n clusters, or packs, this thread moves."""
    return (0, n) if team is None else share_of(team, 0, n)


@inline
def _drift_alone(
    jointed: Jointed, blocks: Floats, c: int, kick_dt: float, t: float, dt: float
) -> None:
    """Kick of springs and constrained drift of cluster c."""
    body, time = jointed.joints.clusters.body, jointed.start + t
    _gather(jointed, blocks, c)
    set_prescribed(jointed.prescribed, jointed.data, time, dt, body[c], body[c + 1])
    constrained_drift(jointed.joints, jointed.data, c, kick_dt, t, dt)
    if dt == jointed.data.clock[1]:  # and not a part of a step, to a frame
        foresee_breaks(jointed.joints, jointed.data, c, kick_dt, t)


@inline
def _finish_drift(
    sums_external: Flag, jointed: Jointed, blocks: Floats, c: int, kick_dt: float
) -> None:
    """Add what joints of cluster c did in a drift, and give its states back."""
    _add_impulses_of_world(sums_external, jointed, blocks, c, jointed.data.pose)
    _add_work_of_drives(sums_external, jointed, blocks, c)
    _add_work_of_motors(sums_external, jointed, blocks, c)
    _correct_work(sums_external, jointed, blocks, c, kick_dt)
    _scatter(jointed, blocks, c)


@inline
def _gather_pack(
    packs: Packs, jointed: Jointed, blocks: Floats, p: int, t: float, dt: float
) -> None:
    """States of pack p, with what is prescribed as in `set_prescribed`."""
    joints, data, time = jointed.joints, jointed.data, jointed.start + t
    body = joints.clusters.body
    for i in range(LANES):
        c = packs.cluster[p, i] if packs.cluster[p, i] >= 0 else packs.cluster[p, 0]
        _gather(jointed, blocks, c)
        set_prescribed(jointed.prescribed, data, time, dt, body[c], body[c + 1])
        put_in_lane(packs, joints, data, p, i, c)


@inline
def _drift_packs(
    jointed: Jointed, team: Team | None, sums_external: Flag, blocks: Floats, kick_dt: float,
    t: float, dt: float,
) -> None:  # fmt: skip
    """Constrained drift of clusters in packs; those that are lost there drift anew alone."""
    packs = jointed.packs
    if packs is None:
        return
    joints, data = numbers_of(packs.joints), data_of(packs.data)
    first, end = _share_of(team, packs.cluster.shape[0])
    for p in range(first, end):
        _gather_pack(packs, jointed, blocks, p, t, dt)
        drift_pack(joints, data, p, kick_dt, t, dt)
        for i in range(LANES):
            c = packs.cluster[p, i]
            if c < 0:
                continue
            if packs.data.failed_row[LANES * p + i] == 0:
                take_from_lane(sums_external, packs, jointed.joints, jointed.data, p, i, c)
            else:
                exchange_past(packs, jointed.joints, jointed.data, p, i, c)
                _drift_alone(jointed, blocks, c, kick_dt, t, dt)
                exchange_past(packs, jointed.joints, jointed.data, p, i, c)
            _finish_drift(sums_external, jointed, blocks, c, kick_dt)


@kernel
def drift_clusters(
    jointed: Jointed | None, team: Team | None, sums_external: Flag, blocks: Floats, kick_dt: float,
    ahead: float, dt: float,
) -> None:  # fmt: skip
    """Kick of springs and constrained drift of all clusters, if there are joints.

    The drift begins so long [s] after the step did.
    """
    if jointed is None:
        return
    meet_all(team)  # clusters are of all blocks
    t = jointed.data.clock[0] + ahead
    _drift_packs(jointed, team, sums_external, blocks, kick_dt, t, dt)
    first, end = _share_of(team, jointed.alone.size)
    for k in range(first, end):
        c = jointed.alone[k]
        _drift_alone(jointed, blocks, c, kick_dt, t, dt)
        _finish_drift(sums_external, jointed, blocks, c, kick_dt)
    meet_all(team)
    if team is None or team.thread == 0:
        count_turns(jointed.joints.coordinates, jointed.data.y, jointed.data.turned)


@inline
def _project_packs(
    jointed: Jointed, team: Team | None, sums_external: Flag, blocks: Floats, kick_dt: float,
    span: float,
) -> None:  # fmt: skip
    """Kick of springs, projection and damping of clusters in packs, where something damps."""
    packs = jointed.packs
    if packs is None:
        return
    joints, data, t = numbers_of(packs.joints), data_of(packs.data), jointed.data.clock[0]
    first, end = _share_of(team, packs.cluster.shape[0])
    for p in range(first, end):
        of_pack = packs.cluster[p]
        _gather_pack(packs, jointed, blocks, p, t, 0.0)
        project_momenta(joints, data, p, kick_dt, t, 0.0)
        for i in range(LANES):
            c = of_pack[i]
            if c >= 0:
                take_from_lane(sums_external, packs, jointed.joints, jointed.data, p, i, c)
                _finish_projection(sums_external, jointed, blocks, c, kick_dt)
                soften(jointed.joints, jointed.data, c, span)
            put_in_lane(packs, jointed.joints, jointed.data, p, i, max(c, of_pack[0]))
        if span > 0.0:
            project_momenta(softened(joints, data), data, p, 0.0, t, span)
        for i in range(LANES):
            c = of_pack[i]
            if c >= 0 and span > 0.0:
                take_from_lane(sums_external, packs, jointed.joints, jointed.data, p, i, c)
                _finish_damping(sums_external, jointed, blocks, c, span)
            if c >= 0:
                _scatter(jointed, blocks, c)


@kernel
def project_clusters(
    jointed: Jointed | None, team: Team | None, sums_external: Flag, blocks: Floats, kick_dt: float,
    span: float,
) -> None:  # fmt: skip
    """Kick of springs, projection of the momenta and damping over a span, as above."""
    if jointed is None:
        return
    meet_all(team)
    joints, data, t = jointed.joints, jointed.data, jointed.data.clock[0]
    if jointed.damps is not None:
        _project_packs(jointed, team, sums_external, blocks, kick_dt, span)
    body, time = joints.clusters.body, jointed.start + t
    first, end = _share_of(team, body.size - 1 if jointed.damps is None else jointed.alone.size)
    for k in range(first, end):
        c = k if jointed.damps is None else jointed.alone[k]
        _gather(jointed, blocks, c)
        set_prescribed(jointed.prescribed, data, time, 0.0, body[c], body[c + 1])
        project_momenta(joints, data, c, kick_dt, t, 0.0)
        _finish_projection(sums_external, jointed, blocks, c, kick_dt)
        if jointed.damps is not None and span > 0.0:
            soften(joints, data, c, span)
            project_momenta(softened(joints, data), data, c, 0.0, t, span)
            _finish_damping(sums_external, jointed, blocks, c, span)
        _scatter(jointed, blocks, c)
    meet_all(team)


@kernel
def keep_coordinates(jointed: Jointed | None, stored: Floats, frame: int) -> None:
    """Keep the coordinates of joints for a frame, if there are joints."""
    if jointed is not None:
        store_turns(jointed.data.turned, stored, frame)


@inline
def count_impulses(
    jointed: Jointed | None, team: Team | None, is_drift: bool, is_first: bool = False
) -> None:
    """Count what joints carried in a drift, or a projection with its damping, if any may break."""
    if jointed is None or team is None or jointed.joints.breaks is None:
        return
    data = jointed.data
    impulse = data.impulse if is_drift else data.half_step
    for r in range(data.step_impulse.size if team.thread == 0 else 0):
        data.step_impulse[r] = impulse[r] + (0.0 if is_first else data.step_impulse[r])


@inline
def let_joints_break(jointed: Jointed | None, team: Team | None, dt: float) -> None:
    """Break joints that have carried too much, at the end of a step that does not go to a frame."""
    if jointed is None or team is None:
        return
    if team.thread == 0 and dt == jointed.data.clock[1]:
        break_overloaded(jointed.joints, jointed.data, dt)
