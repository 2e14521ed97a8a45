"""Room for contacts of a group of bodies: what an evaluation writes, keeps and shows.

Where contacts have no stiffness, impulses stand in place of forces: docs/decisions/0022.
"""

from typing import Any, Final

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.contact import records
from particlerb.contact.contact_model import (
    ContactChanges,
    ContactFrames,
    ContactMemory,
    GroupContact,
    MovingContact,
    NeighbourLists,
    Workspace,
)
from particlerb.contact.piston import PARTS, initial_piston_state, with_pistons
from particlerb.contact.sphere_contacts import ROOM
from particlerb.forces import has_potential
from particlerb.impulses import records as col
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.records import Impulses, room_for_partners, room_for_rows
from particlerb.integrators.stages import MovingBodies
from particlerb.joints.responses import bounded_of, mechanisms_of, pairs_through
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import aligned_zeros
from particlerb.model.state import State
from particlerb.stepping.contact_lists import ContactLists
from particlerb.stepping.loop import Copies
from particlerb.stepping.motion import MotionError, SegmentGroup

_SKIN_STEPS: Final = 5.0  # steps of the fastest body for which a skin is wide enough, at least
_MIN_SKIN_STEPS: Final = 4.0  # of a skin that the case gives
_ROOM_FACTOR: Final = 1.25  # for contacts


def room_for_contact(
    group: SegmentGroup, state: State, start: float, threads: int, lists: NeighbourLists,
    bins: Ints, n_bins: int,
) -> MovingContact:  # fmt: skip
    """Contact of bodies that set off from a state at a time [s], with lists, summed in bins."""
    setup, n = group.terms.known_contact, group.members.size
    y, pistons = np.vstack(state), initial_piston_state(setup.pistons)
    xyzr, deepest = np.zeros((setup.model.spheres.radius.size, 4)), np.zeros((threads, 5))
    poses = records.zero_records(records.POSE, len(setup.motions))
    bodies = records.zero_records(records.BODY, n)
    step_start = records.zero_records(records.STEP_START, 1)
    loads, impulses = np.zeros((len(pistons), 4, PARTS)), room_for_impulses(group, setup)
    gross_work = np.zeros(n)
    pack = aligned_zeros(threads * ROOM).reshape(threads, ROOM)
    workspace = Workspace(
        xyzr, poses, bodies, deepest, gross_work, step_start, loads, pack, impulses
    )
    extremes = records.zero_records(records.EXTREMES, 1)
    memory = ContactMemory(y[7:].copy(), y[:7].copy(), start, np.inf, pistons, extremes)
    frames = room_for_frames(0, bins, n_bins, len(pistons), impulses is not None)
    return MovingContact(setup, workspace, lists, memory, frames)


def room_for_frames(
    n: int, bins: Ints, n_bins: int, n_pistons: int, with_tally: bool
) -> ContactFrames:
    """Room for what n frames show of contacts, summed in bins."""
    pistons = records.zero_records(records.PISTON, n, n_pistons)
    tally = np.zeros((n, col.TALLY if with_tally else 0))
    return ContactFrames(np.zeros((n, n_bins)), np.zeros(bins.size), bins, pistons, tally)


def copies_of(contact: MovingContact, blocks: Floats) -> Copies:
    """What a partial step changes of contacts, and memory for copies; that for blocks is there."""
    _, workspace, lists, memory, _ = contact
    tally = np.zeros(0) if workspace.impulses is None else workspace.impulses.tally
    histories = lists.spheres.history, lists.walls.history
    gross_work = workspace.gross_work
    changes = ContactChanges(memory.momenta, *histories, memory.pistons, gross_work, tally)
    empty: list[Any] = [np.empty_like(values) for values in changes]
    return Copies(blocks, changes, ContactChanges(*empty))


# Impulses


def room_for_impulses(group: SegmentGroup, setup: GroupContact) -> Impulses | None:
    """Room for impulses of a group; None where contacts have a stiffness."""
    if setup.rules is None:
        return None
    n, joints = group.members.size + len(setup.motions), group.terms.joints
    mechanisms = None if joints is None else mechanisms_of(joints, n)
    if setup.pistons is not None:
        mechanisms = with_pistons(mechanisms, setup.pistons, n)
    others = group.terms._replace(contact=None)
    keeps_kick = flag(joints is None and not has_potential(others))
    partners = room_for_partners(n, mechanisms, keeps_kick)
    if setup.pistons is not None:
        first = group.members.size
        partners.inverse[first + setup.pistons.wall, 0] = 1.0 / setup.pistons.mass
    count = np.array([0, -1])
    nothing = np.zeros(0, dtype=np.int64)
    newton = room_for_newton(np.zeros(0, dtype=np.bool_), nothing, nothing, 0)
    bounded = None if joints is None or mechanisms is None else bounded_of(joints, mechanisms)
    rows = room_for_rows(0, bounded, setup.model.law.rolling is not None)
    return Impulses(setup.rules, partners, rows, count, np.zeros(col.TALLY), newton)


def with_room(contact: MovingContact) -> MovingContact:
    """Contact with room for impulses of all pairs of its lists; as it is where there are none."""
    setup, workspace, lists, *_ = contact
    if workspace.impulses is None:
        return contact
    n, impulses = lists.spheres.sphere.size + lists.walls.sphere.size, workspace.impulses
    if n > impulses.rows.partner_a.size:
        bounded, with_rolling = impulses.rows.bounded, impulses.rows.rolling is not None
        rows = room_for_rows(int(_ROOM_FACTOR * n), bounded, with_rolling)
        impulses = impulses._replace(rows=rows)
    if impulses.rules.newton:
        owner, (first, second, *_) = setup.model.spheres.body, lists.spheres
        moves, n = impulses.partners.inverse[:, 0] > 0.0, setup.model.inv_mass.size
        moves[:n] = setup.model.inv_mass > 0.0
        body, other = owner[first], owner[second]
        if setup.pistons is not None:
            wall = setup.model.walls.wall[lists.walls.other]
            slides = setup.pistons.of_wall[wall] >= 0
            body = np.append(body, owner[lists.walls.sphere[slides]])
            other = np.append(other, n + wall[slides])
        a, b = pairs_through(impulses.partners.mechanisms, body, other)
        newton = room_for_newton(moves, a, b, impulses.rows.partner_a.size)
        impulses = impulses._replace(newton=newton)
    return contact._replace(workspace=workspace._replace(impulses=impulses))


def widen_skin(lists: ContactLists, contact: MovingContact, dt: float, now: float) -> None:
    """Let the skin of lists for impulses hold what bodies can cross in some steps.

    Raises
    ------
    MotionError
        If it is fixed, and too thin for the speeds of now [s].
    """
    setup, memory = contact.setup, contact.memory
    if setup.rules is None:
        return
    path = dt * float(memory.extremes.speed[0])
    path = max(path, dt * np.abs(memory.pistons.velocity).max(initial=0.0))
    if setup.is_skin_fixed and setup.skin < _MIN_SKIN_STEPS * path:
        raise MotionError(
            f"at t = {now:.6g} s a body moves by {path:.3g} m in a step of"
            f" {dt:.3g} s, and contact.skin = {setup.skin:.3g} m does not"
            f" hold what it may meet: leave out contact.skin, or take a shorter run.dt"
        )
    if not setup.is_skin_fixed:
        lists.least_skin = max(lists.contact.skin, _SKIN_STEPS * path)
        lists.skin = max(lists.skin, lists.least_skin)


def without_pistons(moving: MovingBodies) -> MovingBodies:
    """Bodies among walls that do not slide: it is for all ranks together to move these."""
    contact = moving.contact
    assert contact is not None
    return moving._replace(contact=contact._replace(setup=contact.setup._replace(pistons=None)))
