"""Contact among the stages of a step: kinematics, forces of contacts, loads.

Kinematics are where spheres and walls are at an instant, and how fast: `contact_kinematics` before
a step and `contact_kinematics_later` within one let `kinematics_at` find them, block by block
(`pair_force.body_kinematics`) and of walls (`wall_poses`).

Each does nothing where there is no contact: None is a type, and the compiler leaves the rest out.
Threads have blocks of bodies of their own, `first` to `end`, and take their shares of the
contacts. What contacts keep (tangential springs, overlaps) belongs to the grid of steps: a partial
step to a frame works on a copy.

Lists of pairs hold while no body has moved by more than half the skin. Where one has, `kinematics`
says so before the step, and the host makes new lists.
"""

from typing import Final

import numpy as np

from particlerb.compiled.barrier import Team, largest, meet, share_of
from particlerb.compiled.jit import inline, kernel
from particlerb.contact.body_loads import collect_loads, sum_piston_loads
from particlerb.contact.contact_model import Evaluation, Growth, Instant, LoadTimes, MovingContact
from particlerb.contact.neighbour_list import N_SHELLS, SHELL_GAPS, max_displacement
from particlerb.contact.pair_force import body_kinematics, max_point_speed, max_speeds, put_velocity
from particlerb.contact.piston import (
    drift_pistons,
    kick_pistons,
    piston_poses,
    pistons_have_moved,
    take_loads,
)
from particlerb.contact.prescribed_motion import (
    PrescribedBodies,
    prescribed_in,
    prescribed_momenta,
    prescribed_pose,
)
from particlerb.contact.records import Records
from particlerb.contact.sphere_contacts import sphere_contact_forces
from particlerb.contact.wall_contacts import wall_contact_forces
from particlerb.contact.wall_motion import put_poses
from particlerb.forces.registry import PAIR, STEADY
from particlerb.integrators.pair_stages import BlockShare, PairTerms
from particlerb.maths.rows import column3_at
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.block import (
    COM,
    L,
    P,
    Q,
    gather_block,
    get,
    get3,
    get4,
    put,
    put3,
    put4,
    scatter_block,
)
from particlerb.model.load import CONTACT_ROWS

_IMPULSE_SKIN_SHARE: Final = 0.45  # of the skin, and of what the step after it brings
SKIN_SHARE: Final = 0.4  # that bodies may use up before a step: a frame may lie ahead


# Bodies and walls at the instant of an evaluation


@kernel
def contact_kinematics(
    contact: MovingContact | None,
    team: Team | None,
    pairs: PairTerms | None,
    share: BlockShare,
    instant: Instant,
) -> bool:
    """Find the kinematics of an instant; whether the lists hold for the step that follows.

    Parameters
    ----------
    contact, team, pairs : MovingContact, Team, PairTerms
        None where there are none.
    share : BlockShare
    instant : Instant
    """
    if contact is None or team is None:
        return True
    note_step_start(contact, instant)
    reached = kinematics_at(contact, team, pairs, share, instant, None)
    return keep_extremes(contact, instant, *reached)


@kernel
def note_step_start(contact: MovingContact, instant: Instant) -> None:
    """Note when a step begins; all threads write the same."""
    step_start = contact.workspace.step_start
    step_start.time[0], step_start.before[0] = instant.time, instant.before


@kernel
def keep_extremes(
    contact: MovingContact, instant: Instant, path: float, v: float, w: float
) -> bool:
    """Keep the largest displacement and speeds; whether the lists hold for the step that follows.

    The second half of `contact_kinematics`. All threads write the same.
    """
    setup, _, lists, memory, _ = contact
    _, after, time, _ = instant
    allowance, arm = SKIN_SHARE * setup.skin, lists.max_contact_arm if setup.rules is None else 0.0
    reached = note_extremes(memory.extremes, instant, path, v, w, arm)
    used, is_too_far = path, False
    if lists.spheres.stages is not None and path > 0.0:  # contacts are found within the step too
        used = reached
    if setup.rules is not None:  # what closes within the step after the next drift is to be listed
        ahead = after * (v + 4.0 * w * lists.max_contact_arm)
        is_too_far = path + 1.5 * ahead > _IMPULSE_SKIN_SHARE * setup.skin
    return not (is_too_far or used > allowance or time >= memory.valid_until)


@kernel
def note_extremes(
    extremes: Records, instant: Instant, path: float, v: float, w: float, arm: float
) -> float:
    """Write them, and return how far a point gets until the next instant [m].

    Points that touch are within an arm [m]; 0: what bodies have moved counts alone.
    """
    if arm > 0.0:
        path += max(instant.before, instant.after) * (v + 4.0 * w * arm)
    extremes.displacement[0] = max(extremes.displacement[0], path)
    extremes.speed[0], extremes.angular_speed[0] = v, w
    return path


@kernel
def contact_kinematics_later(
    contact: MovingContact | None,
    team: Team | None,
    pairs: PairTerms | None,
    share: BlockShare,
    later: float,
) -> None:
    """Find them anew, so many seconds after the step began."""
    if contact is None or team is None:
        return
    time = contact.workspace.step_start.time[0] + later
    instant = Instant(0.0, 0.0, time, 0.0)
    path, v, w = kinematics_at(contact, team, pairs, share, instant, None)
    keep_extremes(contact, instant, path, v, w)


@kernel
def kinematics_at(
    contact: MovingContact, team: Team, pairs: PairTerms | None, share: BlockShare,
    instant: Instant, which: Bools | None,
) -> tuple[float, float, float]:  # fmt: skip
    """Find where spheres and walls are at an instant, and how fast; of some bodies, or of all.

    Returns
    -------
    path, v, w : float [m, m/s, rad/s]
        The largest of all bodies of the team: how far a point has moved, speed, angular speed.
    """
    setup, workspace, lists, memory, _ = contact
    time, ahead = instant.time, instant.ahead
    model, t, path, v, w = setup.model, memory.start + time, 0.0, 0.0, 0.0
    allowance = SKIN_SHARE * setup.skin
    blocks, layout, first, end = share
    for k in range(first, end):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        _put_prescribed(model.prescribed, t, rows, workspace.bodies, lo, n)
        path = max(path, farthest(memory.listed_pose, rows, setup.max_arm, lo, n, which))
        body_kinematics(model, workspace, rows, memory.momenta, ahead, lo, n, which)
        if setup.rules is None:
            speeds = max_speeds(workspace.bodies, lo, lo + n, which)
            v, w = max(v, speeds[0]), max(w, speeds[1])
        else:
            v = max(v, max_point_speed(workspace.bodies, lists.max_contact_arm, lo, lo + n))
        if pairs is not None:
            gather_block(rows, pairs.y, lo, n)
    wall_poses(contact, team, time, ahead)
    if team.thread == 0 and pistons_have_moved(setup.pistons, memory.pistons, allowance):
        path = np.inf
    return largest(team, path, v, w)


@kernel
def wall_poses(contact: MovingContact | None, team: Team | None, time: float, ahead: float) -> None:
    """Find where walls are at a time [s] since the segment began."""
    if contact is None or team is None:
        return
    setup, memory, poses = contact.setup, contact.memory, contact.workspace.poses
    if team.thread == 0:
        put_poses(setup.motions, memory.start + time, poses)
        piston_poses(setup.pistons, memory.pistons, ahead, poses)


@inline
def _put_prescribed(
    prescribed: PrescribedBodies | None, t: float, rows: Floats, bodies: Records, lo: int, n: int
) -> None:
    """Write prescribed bodies into their block, and how fast they are for contacts."""
    if prescribed is None:
        return
    for k in prescribed_in(prescribed, lo, lo + n):
        b = prescribed.body[k]
        slot = b - lo
        x, q, v, omega = prescribed_pose(prescribed, k, t)
        p, spin = prescribed_momenta(prescribed, k, q, v, omega)
        put_velocity(bodies, b, v, omega)
        put3(rows, COM, slot, x)
        put4(rows, Q, slot, q)
        put3(rows, P, slot, p)
        put3(rows, L, slot, spin)


@inline
def farthest(
    listed_pose: Floats, rows: Floats, reach: Floats, lo: int, n: int, which: Bools | None
) -> float:
    """How far a body of a block has moved since the lists were made [m]: see `has_moved`."""
    path, then = 0.0, listed_pose
    for k in range(n):
        b = lo + k
        if which is not None and not which[b]:
            continue
        x, q = column3_at(then, b), (then[3, b], then[4, b], then[5, b], then[6, b])
        moved = max_displacement(x, q, get3(rows, COM, k), get4(rows, Q, k), reach[b])
        path = max(path, moved if moved < np.inf else np.inf)  # what is not a number has moved too
    return path


@kernel
def close_prescribed(contact: MovingContact | None, share: BlockShare, time: float) -> None:
    """Write prescribed bodies as they are at a frame."""
    if contact is None:
        return
    prescribed, t = contact.setup.model.prescribed, contact.memory.start + time
    blocks, layout, first, end = share
    for k in range(first, end):
        lo, n = layout.first[k], layout.size[k]
        _put_prescribed(prescribed, t, blocks[k], contact.workspace.bodies, lo, n)


@kernel
def place_bodies(contact: MovingContact, share: BlockShare, instant: Instant, which: Bools) -> None:
    """Find where the spheres of some bodies are, and how fast: those that come late."""
    setup, workspace, _, memory, _ = contact
    blocks, layout, first, end = share
    for k in range(first, end):
        lo, n, ahead = layout.first[k], layout.size[k], instant.ahead
        body_kinematics(setup.model, workspace, blocks[k], memory.momenta, ahead, lo, n, which)


# Loads


@inline
def forces_over(contact: MovingContact, times: LoadTimes, team: Team) -> None:
    """Find forces of contacts that stand for the times of a method."""
    since = contact.workspace.step_start.before[0]
    shares = times.shares
    before, after = shares.mean * since, shares.mean * times.dt
    growth = Growth(shares.before * since, shares.after * times.dt, since, times.slope)
    find_contact_forces(contact, before, after, growth, team)


@kernel
def find_contact_forces(
    contact: MovingContact, before: float, after: float, growth: Growth, team: Team
) -> None:
    """Find the forces of contacts in shells that have come into reach, each shared out equally.

    Where shells without ghosts stand before the others, those and walls have been evaluated.
    """
    setup, workspace, lists, memory, _ = contact
    spheres, walls, skin, thread = lists.spheres, lists.walls, setup.skin, team.thread
    between = Evaluation(setup.model, workspace, spheres, before, after, growth, thread)
    outside = Evaluation(setup.model, workspace, walls, before, after, growth, thread)
    extremes = memory.extremes
    reached, w = extremes.displacement[0], extremes.angular_speed[0]
    v = extremes.speed[0] + w * lists.max_contact_arm
    end_spheres, end_walls = 0 if lists.inner is None else lists.inner[N_SHELLS - 1], 0
    for s in range(N_SHELLS):
        if SHELL_GAPS[s] * skin <= 2.0 * reached:  # both may come
            first, end = share_of(team, end_spheres, spheres.shell_ends[s])
            sphere_contact_forces(between, v, w, first, end)
        if lists.inner is None and SHELL_GAPS[s] * skin <= reached:
            first, end = share_of(team, end_walls, walls.shell_ends[s])
            wall_contact_forces(outside, (s, first, end))
        end_spheres, end_walls = spheres.shell_ends[s], walls.shell_ends[s]


def without_ghosts(contact: MovingContact) -> MovingContact:
    """All contacts but those of ghosts, which are on other ranks."""
    spheres, inner = contact.lists.spheres, contact.lists.inner
    assert inner is not None
    lists = contact.lists._replace(spheres=spheres._replace(shell_ends=inner), inner=None)
    return contact._replace(lists=lists)


def find_all_forces(
    contact: MovingContact, before: float, after: float, growth: Growth, team: Team
) -> None:
    """Find the forces of all contacts, those of ghosts too."""
    for part in (without_ghosts(contact), contact):
        find_contact_forces(part, before, after, growth, team)


@kernel
def contact_loads(
    contact: MovingContact | None,
    team: Team | None,
    pairs: PairTerms | None,
    share: BlockShare,
    times: LoadTimes,
) -> None:
    """Evaluate contacts after `contact_kinematics`, and write all loads of other bodies.

    Takes what `contact_kinematics` does.
    """
    if contact is None or team is None:
        return
    setup, workspace, lists, memory, _ = contact
    mean, model, span = times.shares.mean, setup.model, times.span
    later = mean * times.dt - mean * workspace.step_start.before[0]
    forces_over(contact, times, team)
    meet(team)
    blocks, layout, first, end = share
    for k in range(first, end):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        for c in range(CONTACT_ROWS):
            for b in range(n):
                put(rows, PAIR + c, b, 0.0)
        if pairs is not None:
            scatter_block(pairs.load, rows, PAIR, 0, lo, n)
        collect_loads(model, workspace, lists, rows, PAIR, STEADY, lo, n, later, span)
    if team.thread == 0:
        sums = workspace.piston_loads
        sum_piston_loads(setup.pistons, sums, lists.walls, model)
        take_loads(setup.pistons, memory.pistons, sums, later)


@kernel
def put_loads_of_pairs(team: Team | None, pairs: PairTerms | None, share: BlockShare) -> None:
    """Write forces without touching alone, once the first thread of a team has found them."""
    if team is None or pairs is None:
        return
    meet(team)
    blocks, layout, first, end = share
    for k in range(first, end):
        scatter_block(pairs.load, blocks[k], PAIR, 0, layout.first[k], layout.size[k])


@kernel
def keep_momenta(contact: MovingContact | None, share: BlockShare) -> None:
    """Keep the momenta of the drift before this kick."""
    if contact is None:
        return
    momenta = contact.memory.momenta
    blocks, layout, first, end = share
    for k in range(first, end):
        rows, lo = blocks[k], layout.first[k]
        for c in range(6):
            for b in range(layout.size[k]):
                momenta[c, lo + b] = get(rows, P + c, b)


# Walls that slide: the first thread moves them


@kernel
def kick_walls(
    contact: MovingContact | None, team: Team | None, closing: float, opening: float, is_step: bool
) -> None:
    """Kick pistons over the end of a step and the beginning of another [s]."""
    if contact is None or team is None:
        return
    if team.thread == 0:
        kick_pistons(contact.setup.pistons, contact.memory.pistons, closing, opening, is_step)


@kernel
def drift_walls(contact: MovingContact | None, team: Team | None, dt: float) -> None:
    """Let pistons drift."""
    if contact is None or team is None:
        return
    if team.thread == 0:
        drift_pistons(contact.setup.pistons, contact.memory.pistons, dt)
