"""The loop over steps: grid of time, frames, partial steps, blocks.

Steps stand on a grid that starts with the segment. A frame is reached by a partial step from a
copy, so that what is recorded never changes the motion. Where bodies do not act on each other, a
block takes all its steps before the next one does, in the cache; where they do, all blocks take
each step together.

Why it is so: docs/decisions/0007.
"""

import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, inline, kernel, kernel_from
from particlerb.contact.contact_model import NO_GROWTH, ContactChanges, Growth, Instant, Slope
from particlerb.integrators.contact_copies import restore_contacts, save_contacts, store_contacts
from particlerb.integrators.contact_stages import (
    close_prescribed,
    find_all_forces,
    find_contact_forces,
)
from particlerb.integrators.external_work import Steady, put_gained, store_sums
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare, Layout, put_pair_loads
from particlerb.integrators.stages import (
    MovingBodies,
    close,
    kinematics,
    over_threads,
    set_times,
    stages,
    store_coordinates,
)
from particlerb.maths.rows import rows3, rows4
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, STRIDE, L, P, Q, copy_changing
from particlerb.model.state import Frames, store_frame
from particlerb.model.totals import N_TOTALS, BlockRows, FrameTotals, sum_block
from particlerb.stepping.pair_forces import PairForces

PAUSE: Final = -1  # a stop without a frame: the host asks for progress and interrupts
CLOSE: Final = -2  # the end of the motion: make the open kick, behind the last partial step
POSES: Final = -1  # in place of a stop: those of bodies and walls, as before a step
ALL_CONTACTS: Final = -2  # all contacts
FRAME: Final = -3  # what contacts have, in a row of the frames
_TIME_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of a time that is a sum of steps


class Schedule(NamedTuple):
    """When to step and when to record: one entry per stop."""

    dt: float  # [s]
    steps: Ints  # (T,) whole steps before the stop
    partial: Floats  # (T,) [s] length of the partial step from there to the frame
    frame: Ints  # (T,) row of the frames to write, or PAUSE, or CLOSE


class Position(NamedTuple):
    """Where the loop is: before a step on the grid, or before a partial one."""

    stop: int  # of the schedule; or POSES, ALL_CONTACTS, FRAME
    step: int  # of those before that stop; a row for FRAME
    steps_done: int  # of the segment


class Copies(NamedTuple):
    """What a partial step to a frame changes."""

    blocks: Floats
    contact: ContactChanges | None = None
    saved: ContactChanges | None = None  # memory for the copies of these


class Recording(NamedTuple):
    """Where frames go."""

    rotor_frame: Floats  # (4, n)
    members: Ints  # (n,) which bodies of the scene these are
    frames: Frames
    sums: Floats  # (T, bins, 7) external work
    bins: Ints  # (n,) where each body is summed: see model/worlds.py
    turned: Floats  # (T, c, 3) of joints
    steady: Steady | None  # None, and so below, for all motions of a kind: of these nobody asks
    totals: FrameTotals | None


@kernel
def copy_blocks(source: Floats, target: Floats, sizes: Ints, first: int, end: int) -> None:
    """Copy what a step changes."""
    for k in range(first, end):
        copy_changing(source[k], target[k], sizes[k])


@kernel
def store_blocks(
    blocks: Floats,
    layout: Layout,
    sums_external: Flag,
    recording: Recording,
    frame: int,
    first: int,
    end: int,
) -> None:
    """Write the bodies of some blocks into a frame."""
    rotor_frame, members, frames, sums, bins, _, steady, totals = recording
    for k in range(first, end):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        local = rows.reshape(rows.size // STRIDE, STRIDE)
        com, q = rows3(local[COM : COM + 3], 0, n), rows4(local[Q : Q + 4], 0, n)
        p, spin = rows3(local[P : P + 3], 0, n), rows3(local[L : L + 3], 0, n)
        turn = rows4(rotor_frame, lo, lo + n)
        store_frame(frames, frame, members[lo : lo + n], turn, com, q, p, spin)
        if totals is not None and totals.sums.shape[0] > 0:
            g, mass = totals.gravity, totals.mass[lo : lo + n]
            inverse = rows3(local[INV_INERTIA : INV_INERTIA + 3], 0, n)
            summed = BlockRows(com, q, p, spin, mass, local[INV_MASS, :n], inverse)
            room = np.empty((N_TOTALS, n))
            sum_block(summed, (g[0], g[1], g[2]), bins[lo : lo + n], k, totals.sums[frame], room)
        is_asked = sums_external is not None
        if steady is not None and steady.force.shape[1] > 0:
            put_gained(steady, rows, lo, n)
            is_asked = True
        if is_asked:
            store_sums(sums[frame], bins[lo : lo + n], rows)


@stages
def _save(moving: MovingBodies, first: int, end: int, saved: Copies) -> None:
    """Copy what a partial step changes."""
    copy_blocks(moving.blocks, saved.blocks, moving.layout.size, first, end)
    save_contacts(moving.team, saved.contact, saved.saved)


@stages
def _restore(moving: MovingBodies, first: int, end: int, saved: Copies, is_frame: bool) -> None:
    """Go back to what was saved."""
    copy_blocks(saved.blocks, moving.blocks, moving.layout.size, first, end)
    restore_contacts(moving.contact, moving.team, saved.contact, saved.saved, is_frame)


@stages
def _store(moving: MovingBodies, first: int, end: int, recording: Recording, frame: int) -> None:
    """Write some blocks, and contacts, into a frame."""
    store_blocks(moving.blocks, moving.layout, moving.sums_external, recording, frame, first, end)
    store_contacts(moving.contact, moving.team, frame)
    store_coordinates(moving, recording.turned, frame)


@stages
def _close_at(
    moving: MovingBodies, first: int, end: int, open_kick: float, instant: Instant
) -> None:
    """Make the open kick, if there is one."""
    if open_kick > 0.0:
        kinematics(moving, first, end, instant)
        set_times(moving, first, end, instant.time)
        close(moving, first, end, open_kick)


@stages
def finish(moving: MovingBodies, first: int, end: int, open_kick: float, instant: Instant) -> None:
    """Close the last step, for a frame or the end; where nothing is open, there is nothing to do.

    Stands for that of a method.
    """


@stages
def part_of_step(
    moving: MovingBodies, first: int, end: int, asked: Position, time: float, growth: Growth
) -> None:
    """Find where spheres and walls are, and how fast; stands for all that may be asked for."""
    kinematics(moving, first, end, Instant(0.0, 0.0, time, 0.0))


@stages
def _part_with_contacts(
    moving: MovingBodies, first: int, end: int, asked: Position, time: float, growth: Growth
) -> None:
    """Do a part of a step with contacts."""
    contact: Any = moving.contact  # there is one, and a team
    team: Any = moving.team
    if asked.stop == POSES:
        kinematics(moving, first, end, Instant(0.0, 0.0, time, 0.0))
    elif asked.stop == ALL_CONTACTS:
        find_contact_forces(contact, 0.0, 0.0, growth, team)
    else:
        store_contacts(contact, team, asked.step)


@inline
def _ratio(a: float, b: float) -> float:
    """a / b, 0 where a is."""
    return a / b if a > 0.0 else 0.0


@inline
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Advance blocks by dt; stands for the step of a method."""
    raise NotImplementedError


CLOSING_KICK: Final = 0.0  # stands for that of a method
GROWTH: Final = NO_GROWTH  # stands for that of a method's contacts


def advance(
    moving: MovingBodies,
    schedule: Schedule,
    recording: Recording,
    saved: Copies,
    position: Position,
    together: int,
    first: int,
    end: int,
) -> Position:
    """Take blocks through a schedule, so many of them together: one, or all.

    From a position, which only all blocks together may have inside the schedule, to its end, or to
    the step before which new lists of contacts have to be made. Asked so, they do a part of a step
    at a time on the grid, with what is compiled for steps.
    """
    dt, steps, partial, frame = schedule
    if position.stop < 0:
        part_of_step(moving, first, end, position, position.steps_done * dt, GROWTH)
        return position
    step_number = position.steps_done
    for lo in range(first, end, together):
        hi = min(lo + together, end)
        begin, step_number = position.step, position.steps_done
        last_step = dt if step_number > 0 else 0.0
        open_kick = CLOSING_KICK * last_step
        last_kick = open_kick * min(step_number, 2)
        for s in range(position.stop, steps.size):
            step_on_grid, kick_on_grid = last_step, last_kick
            for i in range(begin, steps[s] + 1):
                is_partial = i == steps[s]
                if is_partial and frame[s] < 0 and partial[s] == 0.0:
                    break
                h = partial[s] if is_partial else dt
                time = step_number * dt
                instant = Instant(last_step, h, time, _ratio(open_kick, last_kick))
                if h > 0.0 and not kinematics(moving, lo, hi, instant):
                    return Position(s, i, step_number)
                if is_partial:
                    _save(moving, lo, hi, saved)
                    step_on_grid, kick_on_grid = last_step, last_kick
                if h > 0.0:
                    set_times(moving, lo, hi, time)
                    step(moving, lo, hi, open_kick, h)
                    last_kick = open_kick + CLOSING_KICK * h
                    last_step, open_kick = h, CLOSING_KICK * h
                step_number += 0 if is_partial else 1
            begin, time = 0, step_number * dt + partial[s]
            if frame[s] != PAUSE:
                instant = Instant(last_step, 0.0, time, _ratio(open_kick, last_kick))
                finish(moving, lo, hi, open_kick, instant)
                own_blocks = BlockShare(moving.blocks, moving.layout, lo, hi)
                close_prescribed(moving.contact, own_blocks, time)
            if frame[s] >= 0:
                _store(moving, lo, hi, recording, frame[s])
                _restore(moving, lo, hi, saved, recording.frames.is_frame[frame[s]])
                last_step, last_kick = step_on_grid, kick_on_grid
                open_kick = CLOSING_KICK * last_step
    return Position(steps.size, 0, step_number)


def _parts_of(
    method: Method, is_coupled: bool, touches: bool
) -> tuple[tuple[Callable[..., None], Callable[..., None]], ...]:
    """What stands for a method in `advance`, each with what the method has in its place."""
    chosen = (method.coupled_step if is_coupled else None) or method.step
    assert chosen is not None
    closing = method.show if touches and method.show is not None else finish
    closing = _close_at if method.closing_kick > 0.0 else closing
    part = _part_with_contacts if touches and not method.takes_impulses else part_of_step
    return (step, chosen), (finish, closing), (part_of_step, part)


def _constants_of(method: Method) -> dict[str, Any]:
    """What stands in `advance` for constants of a method; where no step is made no spring grows."""
    slope = Slope(0.0, 0.0, 0.0, True) if method.takes_slopes else None
    return {"CLOSING_KICK": method.closing_kick, "GROWTH": NO_GROWTH._replace(slope=slope)}


@cache
def compiled_loop(
    method: Method, is_coupled: bool, touches: bool = False
) -> Callable[..., Position]:
    """The loop with the step of a method, compiled."""
    name = f"{method.name}_coupled" if is_coupled else method.name
    name += "_touching" if touches else ""
    parts = _parts_of(method, is_coupled, touches)
    return kernel_from(advance, name, *parts, **_constants_of(method))


def loop_over_threads(
    method: Method, forces: PairForces, touches: bool = False
) -> Callable[..., Position]:
    """The same as Python, which spreads forces between bodies, and stages, over threads.

    A tree is grown and walked from Python, and a large direct sum has shares of pairs and not of
    bodies; so neither can stand in a compiled loop.
    """
    parts = *_parts_of(method, True, touches), (put_pair_loads, forces.put_loads)
    return over_threads(advance, *parts, **_constants_of(method))


def _one_step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """The step of a method by itself, and its times."""
    if moving.contact is not None:
        set_times(moving, first, end, moving.contact.workspace.step_start.time[0])
    step(moving, first, end, open_kick, dt)


@kernel
def _one_close(moving: MovingBodies, first: int, end: int, open_kick: float) -> None:
    """The open kick by itself, and its times."""
    if moving.contact is not None:
        set_times(moving, first, end, moving.contact.workspace.step_start.time[0])
    close(moving, first, end, open_kick)


def _no_times(moving: MovingBodies, first: int, end: int, t: float) -> None:
    """Stands for `set_times` where what kicks begins with it: to enter a kernel takes time."""


def loop_over_ranks(
    method: Method,
    find_kinematics: Callable[..., bool],
    write_frame: Callable[..., None],
    show_contacts: Callable[..., None],
    enter_kick: Callable[..., None],
    settle: Callable[[], Any],
) -> Callable[..., Position]:
    """The same as Python, where ranks share bodies that touch.

    Parameters
    ----------
    method : Method
    find_kinematics, write_frame, show_contacts : callable
        In place of the stages that find where spheres and walls are, that write a frame, and that
        write what contacts have into it: these exchange bodies.
    enter_kick : callable
        Enters a kernel `(moving, first, end, open_kick)`, or with a step too, with all threads:
        takes it, then `moving`, ...
    settle : callable
        Called before anything is saved.
    """
    name = f"{method.name}_touching"
    (_, chosen), *_ = _parts_of(method, True, True)
    one_step = partial(enter_kick, kernel_from(_one_step, name, (step, chosen)))
    shown = store_contacts, show_contacts
    part = over_threads(_part_with_contacts, (find_contact_forces, find_all_forces), shown)
    copy = over_threads(_save)

    def save(moving: MovingBodies, first: int, end: int, saved: Copies) -> None:
        settle()
        copy(moving, first, end, saved)

    one_close = close, partial(enter_kick, _one_close)
    kicks = (step, one_step), (finish, _close_at), one_close, (set_times, _no_times)
    frames = (_save, save), (_store, write_frame)
    others = (kinematics, find_kinematics), (part_of_step, part)
    return over_threads(advance, *kicks, *frames, *others, **_constants_of(method))


def grid_position(elapsed: Floats, dt: float, start: float = 0.0) -> tuple[Ints, Floats]:
    """Whole steps before each time, and what remains [s]; 0 where only rounding remains.

    Times since the start are differences, and round like what they are differences of.
    """
    nearest = np.rint(elapsed / dt)
    on_grid = np.abs(elapsed - nearest * dt) <= _TIME_ROUNDING * (np.abs(elapsed) + abs(start))
    steps = np.where(on_grid, nearest, np.floor(elapsed / dt))
    return steps.astype(np.int64), np.where(on_grid, 0.0, elapsed - steps * dt)


def grid_stop(elapsed: float, dt: float, start: float = 0.0) -> tuple[int, float]:
    """The same of one time."""
    steps = round(elapsed / dt)
    if abs(elapsed - steps * dt) <= _TIME_ROUNDING * (abs(elapsed) + abs(start)):
        return steps, 0.0
    steps = math.floor(elapsed / dt)
    return steps, elapsed - steps * dt
