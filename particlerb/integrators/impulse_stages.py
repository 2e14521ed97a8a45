"""Impulses of contacts among the stages of a step: kinematics, velocities, solves, momenta.

All happens in the middle of a step. Threads move their own blocks of bodies, share finding contacts
and, where there are many, solving them (`impulses.colours`); the rest is done by the first one.
"""

import math
from typing import Final

from particlerb.compiled.barrier import Team, meet
from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.contact.contact_model import MovingContact
from particlerb.contact.impulse_contacts import find_impulse_contacts, keep_impulses
from particlerb.contact.piston import keep_pistons, move_pistons, push_pistons
from particlerb.contact.prescribed_motion import prescribed_acceleration
from particlerb.contact.wall_motion import PrescribedMotion, acceleration_at, motion_in
from particlerb.forces.kernels import Acting, kick_potential, shift_time
from particlerb.impulses import records as col
from particlerb.impulses.bounded import keep_bounded
from particlerb.impulses.colours import who_solves
from particlerb.impulses.impacts import take_impacts
from particlerb.impulses.push_out import push_out
from particlerb.impulses.records import Impulses, Partners
from particlerb.impulses.rolling import write_rolling
from particlerb.impulses.rows import approach, put_inverse, write_through_pistons
from particlerb.impulses.solver import leave_out_what_leans, leave_out_what_will_bounce, solve
from particlerb.impulses.work import sum_works
from particlerb.integrators.contact_stages import contact_kinematics_later
from particlerb.integrators.external_work import add_entry
from particlerb.integrators.impulse_work import (
    add_work_along_solve,
    add_work_among_joints,
    add_work_of_impulses,
    half_work_of_pairs,
    keep_kick_start,
    stored_in_joints,
)
from particlerb.integrators.pair_stages import BlockShare, Layout, PairTerms
from particlerb.joints.records import Jointed
from particlerb.joints.responses import find_bounded, find_responses, move_to_joints
from particlerb.joints.rows import put_pose
from particlerb.maths.quaternion import Matrix, add_scaled4, matrix, multiply, normalised, turn_back
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import (
    ZERO,
    Floats,
    Vec3,
    add,
    component_product,
    cross,
    dot,
    norm,
    scale,
    subtract,
)
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, L, P, Q, get, get3, get4, put3, put4

_MAX_MOVES: Final = 4  # of a push-out, and back to where joints hold
_MOMENTUM_ROUNDING: Final = 1e-9  # of momenta, beside impulses of a kick


@kernel
def midpoint_kinematics(
    contact: MovingContact | None, team: Team | None, pairs: PairTerms | None, acting: Acting,
    share: BlockShare, dt: float,
) -> None:  # fmt: skip
    """Find kinematics, and take loads that depend on time, in the middle of a step."""
    for k in range(share.first, share.end):
        for b in range(share.layout.size[k]):
            shift_time(acting, share.blocks[k], b, 0.5 * dt)
    if share.first == 0 and pairs is not None:
        pairs.clock[0] = pairs.clock[1] + 0.5 * dt
    contact_kinematics_later(contact, team, pairs, share, 0.5 * dt)


# Velocities


@inline
def _free_turning(R: Matrix, moments: Vec3, omega: Vec3) -> Vec3:
    """How ω changes without torque [rad/s²], by Euler's equations; `moments` are inverse ones."""
    x, y, z = moments
    if (x == y and y == z) or x * y * z == 0.0:
        return ZERO
    p, q, r = turn_back(R, omega)
    m = (
        x * (z - y) / (y * z) * q * r,
        y * (x - z) / (z * x) * r * p,
        z * (y - x) / (x * y) * p * q,
    )
    return dot(R[0], m), dot(R[1], m), dot(R[2], m)


@kernel
def gather_velocities(
    contact: MovingContact | None, blocks: Floats, layout: Layout, first: int, end: int
) -> None:
    """Bring velocities of bodies to where contacts are solved."""
    if contact is None or contact.workspace.impulses is None:
        return
    inv_mass, bodies = contact.setup.model.inv_mass, contact.workspace.bodies
    partners = contact.workspace.impulses.partners
    for k in range(first, end):
        rows, lo = blocks[k], layout.first[k]
        for i in range(layout.size[k]):
            b = lo + i
            v, omega = row3(bodies.velocity, b), row3(bodies.angular_velocity, b)
            put_row3(partners.before, b, v)
            put_row3(partners.before, b, omega, 3)
            R, moments = matrix(get4(rows, Q, i)), get3(rows, INV_INERTIA, i)
            put_row3(partners.before, b, _free_turning(R, moments, omega), 9)
            put_inverse(partners.inverse, b, get(rows, INV_MASS, i), moments, R)
            if inv_mass[b] > 0.0:
                v = scale(inv_mass[b], get3(rows, P, i))
                m = component_product(moments, turn_back(R, get3(rows, L, i)))
                omega = (dot(R[0], m), dot(R[1], m), dot(R[2], m))
            put_row3(partners.velocity, b, v)
            put_row3(partners.velocity, b, omega, 3)
            put_row3(partners.position, b, get3(rows, COM, i))


@inline
def _put_accelerations(
    partners: Partners, b: int, motion: PrescribedMotion, by: Vec3, t: float
) -> None:
    """Write how partner b is accelerated by turning, and with the centre of its motion."""
    driven = acceleration_at(motion, motion.centre, t)
    put_row3(partners.before, b, subtract(by, driven), 6)
    put_row3(partners.before, b, driven, 12)


@inline
def _gather_walls(contact: MovingContact, partners: Partners, dt: float) -> None:
    """The same of walls, which come behind the bodies, after a kick of dt [s] of pistons."""
    poses, n = contact.workspace.poses, contact.setup.max_arm.size
    t = contact.memory.start + contact.workspace.step_start.time[0] + dt
    prescribed = contact.setup.model.prescribed
    if prescribed is not None:
        for k in range(prescribed.body.size):
            by = prescribed_acceleration(prescribed, k, t)
            _put_accelerations(
                partners, prescribed.body[k], motion_in(prescribed.motions, k), by, t
            )
    for w in range(poses.size):
        motion = motion_in(contact.setup.motions, w)
        _put_accelerations(partners, n + w, motion, acceleration_at(motion, ZERO, t), t)
        for to in (partners.velocity, partners.before):
            put_row3(to, n + w, row3(poses.velocity, w))
            put_row3(to, n + w, row3(poses.angular_velocity, w), 3)
        put_row3(partners.position, n + w, row3(poses.position, w))
    push_pistons(contact.setup.pistons, partners.velocity, n, dt)
    for b in range(n, n + poses.size):
        by = subtract(row3(partners.velocity, b), row3(partners.before, b))
        partners.speeds[b, 2] = norm(by)


@inline
def _size_of_kick(contact: MovingContact, partners: Partners) -> float:
    """All impulses of a kick, and of momenta what is as good as none [N s]."""
    moved = 0.0
    for b in range(contact.setup.max_arm.size):
        by = subtract(row3(partners.velocity, b), row3(partners.before, b))
        mass = partners.inverse[b, 0]
        size = 2.0 * norm(by) + _MOMENTUM_ROUNDING * norm(row3(partners.velocity, b))
        moved += size / mass if mass > 0.0 else 0.0
    return moved


# Momenta


@inline
def _apply_impulses(impulses: Impulses, blocks: Floats, layout: Layout) -> None:
    """Add impulses to the momenta of all bodies."""
    impulse = impulses.partners.impulse
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for i in range(layout.size[k]):
            if get(rows, INV_MASS, i) > 0.0:
                put3(rows, P, i, add(get3(rows, P, i), row3(impulse, lo + i)))
                put3(rows, L, i, add(get3(rows, L, i), row3(impulse, lo + i, 3)))
            put_row3(impulse, lo + i, ZERO)
            put_row3(impulse, lo + i, ZERO, 3)


@inline
def _let_joints_hold(jointed: Jointed | None, impulses: Impulses) -> None:
    """Let contacts feel what joints tie to their partners, if there is anything, and pistons."""
    if jointed is None:
        write_through_pistons(impulses)
    else:
        find_responses(jointed.joints, jointed.data, impulses)


@kernel
def bounce(
    contact: MovingContact | None, jointed: Jointed | None, team: Team | None, blocks: Floats,
    layout: Layout, dt: float,
) -> None:  # fmt: skip
    """Find contacts of a step, and let those bounce that touch and approach."""
    if contact is None or team is None or contact.workspace.impulses is None:
        return
    setup, workspace, impulses = contact.setup, contact.workspace, contact.workspace.impulses
    meet(team)
    if team.thread == 0:
        _gather_walls(contact, impulses.partners, 0.5 * dt)
        if jointed is not None:
            find_bounded(jointed.joints, jointed.data, impulses, dt)
    extremes = contact.memory.extremes
    find_impulse_contacts(setup, workspace, contact.lists, impulses, team, extremes, dt)
    if team.thread == 0:
        _let_joints_hold(jointed, impulses)
        write_rolling(impulses.partners, impulses.rows, impulses.counts[0], dt)
        take_impacts(impulses)
        _apply_impulses(impulses, blocks, layout)
        keep_kick_start(impulses.partners, blocks, layout)
    meet(team)


@inline
def _turning_energy(moments: Vec3, R: Matrix, spin: Vec3) -> float:
    """½ L·I⁻¹ L [J]."""
    m = turn_back(R, spin)
    return 0.5 * dot(component_product(moments, m), m)


@inline
def _move(acting: Acting, sums_external: Flag, rows: Floats, i: int, dx: Vec3, turn: Vec3) -> float:
    """Move a body, and add the work; that work [J].

    The work is that against the mean of the forces before and after, and what a turn with the same
    angular momentum does to the energy of rotation; the angular momentum about the origin changes
    by dx × p.
    """
    x, q, p, spin = get3(rows, COM, i), get4(rows, Q, i), get3(rows, P, i), get3(rows, L, i)
    R, moments = matrix(q), get3(rows, INV_INERTIA, i)
    F, tau = kick_potential(acting, rows, i, x, R, 1.0, ZERO, ZERO)
    x = add(x, dx)
    turning = multiply((0.0, turn[0], turn[1], turn[2]), q)
    q = normalised(add_scaled4(0.5, turning, q))
    after = matrix(q)
    F_after, tau_after = kick_potential(acting, rows, i, x, after, 1.0, ZERO, ZERO)
    work = -0.5 * (dot(add(F, F_after), dx) + dot(add(tau, tau_after), turn))
    work += _turning_energy(moments, after, spin) - _turning_energy(moments, R, spin)
    put3(rows, COM, i, x)
    put4(rows, Q, i, q)
    add_entry(sums_external, rows, i, 1.0, (work, ZERO, cross(dx, p)))
    return work


@inline
def _move_bodies(
    contact: MovingContact, jointed: Jointed | None, pairs: PairTerms | None, impulses: Impulses,
    acting: Acting, sums_external: Flag, share: BlockShare,
) -> None:  # fmt: skip
    """Move all bodies that are to be moved, add the work; `_move` takes springs as before it."""
    move, mechanisms = impulses.partners.move, impulses.partners.mechanisms
    blocks, layout = share.blocks, share.layout
    pistons, state = contact.setup.pistons, contact.memory.pistons
    stored = half_work_of_pairs(pairs, move, blocks, layout) - stored_in_joints(jointed)
    impulses.tally[col.PUSH_OUT_WORK] += move_pistons(
        pistons, state, move, contact.setup.max_arm.size
    )
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for i in range(layout.size[k]):
            b, dx, turn = lo + i, row3(move, lo + i), row3(move, lo + i, 3)
            if dot(dx, dx) + dot(turn, turn) > 0.0:
                work = _move(acting, sums_external, rows, i, dx, turn)
                impulses.tally[col.PUSH_OUT_WORK] += work
                contact.workspace.gross_work[b] += abs(work)
                if jointed is not None and mechanisms is not None and mechanisms.number[b] >= 0:
                    own = mechanisms.first[mechanisms.number[b]] + mechanisms.local[b]
                    put_pose(jointed.data.y, own, get3(rows, COM, i), get4(rows, Q, i))
    stored += stored_in_joints(jointed) - half_work_of_pairs(pairs, move, blocks, layout)
    impulses.tally[col.PUSH_OUT_WORK] += stored
    contact.workspace.gross_work[0] += abs(stored)
    add_entry(sums_external, blocks[0], 0, 1.0, (stored, ZERO, ZERO))


@inline
def _note_overlap(contact: MovingContact, impulses: Impulses, dt: float) -> None:
    """Note the first contact that is going to be too deep, for the host to say.

    Or that bears too much: how deep is inf then, and its impulse is in the place of the radius.
    """
    workspace, rows, k = contact.workspace, impulses.rows, impulses.counts[1]
    if k == -1 or workspace.deepest[0, 0] > 0.0:
        return
    deepest, limits = workspace.deepest[0], rows.limits
    if k >= 0:
        deepest[0] = -limits[k, col.GAP] - dt * approach(impulses.partners, rows, k)[0]
        deepest[1], ahead = limits[k, col.RADIUS], 1.5 * dt
    else:
        k, ahead = -2 - k, 0.5 * dt
        deepest[0], deepest[1] = math.inf, rows.impulse[k, 0]
    deepest[2], deepest[3] = rows.partner_a[k], rows.partner_b[k]
    deepest[4] = workspace.step_start.time[0] + ahead


@kernel
def press(
    contact: MovingContact | None, jointed: Jointed | None, team: Team | None, acting: Acting,
    sums_external: Flag, share: BlockShare, dt: float,
) -> None:  # fmt: skip
    """Solve all contacts of a step."""
    if contact is None or team is None or contact.workspace.impulses is None:
        return
    impulses, rows = contact.workspace.impulses, contact.workspace.impulses.rows
    blocks, layout = share.blocks, share.layout
    meet(team)
    solving = who_solves(team, rows.colours)
    if solving.thread < solving.size:
        partners, bounded, pistons = impulses.partners, rows.bounded, contact.setup.pistons
        is_first, n = team.thread == 0, contact.setup.max_arm.size
        if is_first:
            push_pistons(pistons, partners.velocity, n, 0.5 * dt)
        leave_out_what_will_bounce(impulses, solving)
        leave_out_what_leans(impulses, solving, dt)
        moved = _size_of_kick(contact, partners)
        time = contact.memory.start + contact.workspace.step_start.time[0] + 0.5 * dt
        solve(impulses, solving, moved, time)
        if is_first:
            add_work_along_solve(sums_external, acting, partners, blocks, layout, 0.5 * dt)
            _apply_impulses(impulses, blocks, layout)
        sum_works(impulses, solving)
        if is_first:
            add_work_of_impulses(contact, impulses, sums_external, blocks, layout)
            add_work_among_joints(sums_external, jointed, partners, blocks)
            keep_pistons(pistons, contact.memory.pistons, partners.velocity, n)
            if jointed is not None and bounded is not None:  # not for a step to a frame
                keep_bounded(bounded, dt, dt == jointed.data.clock[1])
        keep_impulses(contact.lists, impulses, solving, dt)
    meet(team)


@kernel
def move_apart(
    contact: MovingContact | None, jointed: Jointed | None, pairs: PairTerms | None,
    team: Team | None, acting: Acting, sums_external: Flag, share: BlockShare, dt: float,
) -> None:  # fmt: skip
    """Push out of each other what overlaps, where joints have borne their part of the solve."""
    if contact is None or team is None or contact.workspace.impulses is None:
        return
    impulses, rows = contact.workspace.impulses, contact.workspace.impulses.rows
    solving = who_solves(team, rows.colours)
    if solving.thread < solving.size:
        tries = 0
        moves = push_out(impulses, solving, dt) and team.thread == 0
        if team.thread == 0:
            _note_overlap(contact, impulses, dt)
        while moves and tries < _MAX_MOVES:
            _move_bodies(contact, jointed, pairs, impulses, acting, sums_external, share)
            moves, tries = False, tries + 1
            if jointed is not None:  # to where joints hold
                moves = move_to_joints(jointed.joints, jointed.data, impulses.partners)
    meet(team)
