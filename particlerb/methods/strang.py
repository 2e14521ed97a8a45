"""Strang splitting, kick - drift - kick, with the symmetric-top rotor: the default under force.

Order 2, symmetric, symplectic where the forces have a potential. The drift is exact for points,
rods, spheres and symmetric tops. Steps stand on a grid that starts with the segment. A frame is
reached by a partial step from a copy, so that what is recorded never changes the motion; the half
kick at the end of a step stays open, and the next step makes it a whole one.

Source: Strang, SIAM J. Numer. Anal. 5, 506 (1968); the rotor: rotors/symmetric_split.py.
"""

from collections.abc import Iterator
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from particlerb._jit import inline, kernel
from particlerb.bodies.bodies import Bodies
from particlerb.bodies.state import Frames, State, multiplied, room_for, store_frame
from particlerb.maths.quaternion import Rows4, load4, rows4, store4, to_body
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Rows3,
    add_scaled,
    load3,
    rows3,
    store3,
)
from particlerb.methods.booking import booked_kick, store_sums
from particlerb.methods.motion import Group, constant_force
from particlerb.rotors.symmetric_split import symmetric_split
from particlerb.terms import Terms
from particlerb.terms.follower import Follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.push import Push, lever_work
from particlerb.terms.torque import Torque
from particlerb.threads import BLOCK, THREADS

ORDER: Final = 2
ACCEPTS: Final = frozenset({"gravity", "push", "follower", "torque"})
SUMMARY: Final = "order 2, symplectic; kick-drift-kick with a symmetric-top rotor; any force"
PAUSE: Final = -1  # a stop without a frame: the host asks for progress and interrupts
CLOSE: Final = -2  # the end of the segment: make the open half kick


class Schedule(NamedTuple):
    """When to step and when to record: one entry per stop."""

    dt: float  # [s]
    done: int  # steps of the segment that lie behind
    steps: Ints  # (T,) whole steps before the stop
    rest: Floats  # (T,) [s] length of the partial step from there to the frame
    frame: Ints  # (T,) row of the frames to write, or PAUSE, or CLOSE


@inline
def drift(
    com: Rows3, q: Rows4, p: Rows3, L: Rows3, inv_mass: Floats, inv_inertia: Rows3, dt: float
) -> None:
    """x ← x + p dt/M,  q ← q after free rotation over dt."""
    for b in range(inv_mass.size):
        q_b = load4(q, b)
        m = to_body(q_b, load3(L, b))
        store3(com, b, add_scaled(dt * inv_mass[b], load3(p, b), load3(com, b)))
        store4(q, b, symmetric_split(q_b, m, load3(inv_inertia, b), dt))


@inline
def extra_kicks(frame: int) -> int:
    """Kicks after the last whole step: two around a partial drift, one to close, or none."""
    if frame >= 0:
        return 2
    return 1 if frame == CLOSE else 0


@kernel
def copy_columns(source: Floats, from_column: int, target: Floats, to_column: int, n: int) -> None:
    """Copy n columns of one array into another of as many rows."""
    for row in range(source.shape[0]):
        for b in range(n):
            target[row, to_column + b] = source[row, from_column + b]


@inline
def own_booked(local: Floats, booked: Floats | None, lo: int, n: int) -> Floats | None:
    """Rows of the block in which it books, if it does."""
    if booked is None:
        return None
    copy_columns(booked, lo, local[13:20], 0, n)
    return local[13:20]


@kernel
def follow(
    local: Floats,
    saved: Floats,
    before: Floats,
    bodies: Bodies,
    terms: Terms,
    own: Floats | None,
    lo: int,
    hi: int,
    schedule: Schedule,
    members: Ints,
    frames: Frames,
    sums: Floats,
    k: int,
) -> None:
    """Take block k through a schedule, in rows of its own."""
    n = hi - lo
    com, q = rows3(local[0:3], 0, n), rows4(local[3:7], 0, n)
    p, L = rows3(local[7:10], 0, n), rows3(local[10:13], 0, n)
    inv_mass, inv_inertia = bodies.inv_mass[lo:hi], rows3(bodies.inv_inertia, lo, hi)
    rotor_frame = rows4(bodies.rotor_frame, lo, hi)
    dt, done, steps, rest, frame = schedule
    for s in range(steps.size):
        for i in range(steps[s] + extra_kicks(frame[s])):
            kick_dt = dt if done > 0 else 0.5 * dt  # the open half kick and the next one
            drift_dt = dt
            if i < steps[s]:
                done += 1
            elif i == steps[s]:  # close the step, or go on towards the frame on a copy
                copy_columns(local, 0, saved, 0, n)
                kick_dt = 0.5 * rest[s] + (0.5 * dt if done > 0 else 0.0)
                drift_dt = rest[s]
            else:
                kick_dt = 0.5 * rest[s]
                drift_dt = 0.0
            if kick_dt != 0.0:
                booked_kick(
                    terms, own, before, com, q, p, L, inv_mass, inv_inertia, lo, hi, kick_dt
                )
            if drift_dt != 0.0:
                drift(com, q, p, L, inv_mass, inv_inertia, drift_dt)
        if frame[s] >= 0:
            store_frame(frames, frame[s], members[lo:hi], rotor_frame, com, q, p, L)
            store_sums(sums, frame[s], k, own, n)
            copy_columns(saved, 0, local, 0, n)


@kernel
def advance_blocks(
    state: State,
    bodies: Bodies,
    gravity: UniformGravity | None,
    push: Push | None,
    follower: Follower | None,
    torque: Torque | None,
    booked: Floats | None,
    schedule: Schedule,
    members: Ints,
    frames: Frames,
    sums: Floats,
    first: int,
    last: int,
) -> None:
    """All steps and frames of some blocks."""
    local, saved, before = np.empty((20, BLOCK)), np.empty((20, BLOCK)), np.empty((12, BLOCK))
    for k in range(first, last):
        lo, hi = k * BLOCK, min((k + 1) * BLOCK, members.size)
        n = hi - lo
        copy_columns(state.com, lo, local[0:3], 0, n)
        copy_columns(state.q, lo, local[3:7], 0, n)
        copy_columns(state.p, lo, local[7:10], 0, n)
        copy_columns(state.L, lo, local[10:13], 0, n)
        own = own_booked(local, booked, lo, n)
        terms = Terms(gravity, push, follower, torque)
        follow(local, saved, before, bodies, terms, own, lo, hi, schedule, members, frames, sums, k)
        copy_columns(local[0:3], 0, state.com, lo, n)
        copy_columns(local[3:7], 0, state.q, lo, n)
        copy_columns(local[7:10], 0, state.p, lo, n)
        copy_columns(local[10:13], 0, state.L, lo, n)
        if booked is not None:
            copy_columns(local[13:20], 0, booked, lo, n)


BODY_STEPS_PER_CALL: Final = 200_000_000  # about a second: progress and Ctrl-C in between
TIME_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of a time that is a sum of steps


def grid_position(elapsed: Floats, dt: float) -> tuple[Ints, Floats]:
    """Whole steps before each time, and what remains [s]; 0 where only rounding remains."""
    nearest = np.rint(elapsed / dt)
    on_grid = np.abs(elapsed - nearest * dt) <= TIME_ROUNDING * np.abs(elapsed)
    steps = np.where(on_grid, nearest, np.floor(elapsed / dt))
    return steps.astype(np.int64), np.where(on_grid, 0.0, elapsed - steps * dt)


class DrivenMotion:
    """A group of bodies under force, on a grid of steps; see `motion.Motion`."""

    def __init__(self, group: Group, state: State, start: float, dt: float) -> None:
        self.group, self.start, self.dt = group, start, dt
        self.first = state
        self.state = State(*(a.copy() for a in state))
        self.done = 0
        self.constant = constant_force(group, state)
        n = group.members.size
        books = group.terms.follower is not None or group.terms.torque is not None
        self.booked = np.zeros((7, n)) if books else None
        self.most = max(1, BODY_STEPS_PER_CALL // n)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        sums = self.advance(*grid_position(elapsed, self.dt), rows, frames)
        own, frame = self.group.members, self.group.bodies.rotor_frame
        given = np.empty((times.size, 7))
        for k, row in enumerate(rows):
            q = multiplied(np.ascontiguousarray(frames.orientation[row, own].T), frame)
            com = frames.position[row, own].T
            L = frames.angular_momentum[row, own].T
            given[k] = self.given(elapsed[k], com, q, L, sums[row])
        return given

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        elapsed = np.array([stop - self.start])
        steps, _ = grid_position(elapsed, self.dt)
        none = room_for(0, 0, np.empty((0, 4)))
        self.advance(steps, np.zeros(1), np.array([CLOSE]), none)
        sums = np.zeros(7) if self.booked is None else self.booked.sum(axis=1)
        com, q, _, L = self.state
        return self.state, self.given(float(elapsed[0]), com, q, L, sums)

    def advance(self, steps: Ints, rest: Floats, rows: Ints, frames: Frames) -> Floats:
        """Go through stops given by their distance from the start; sums of what was booked."""
        group = self.group
        blocks = -(-group.members.size // BLOCK)
        sums = np.zeros((frames.position.shape[0], blocks, 7))
        for schedule in self.calls(np.diff(steps, prepend=self.done), rest, rows):
            step = partial(
                advance_blocks,
                self.state,
                group.bodies,
                *group.terms,
                self.booked,
                schedule,
                group.members,
                frames,
                sums,
            )
            n, count = group.members.size, int(schedule.steps.sum())
            THREADS.spread(step, n, n * (count + schedule.steps.size))
            self.done += count
        return np.asarray(sums.sum(axis=1))

    def calls(self, counts: Ints, rest: Floats, rows: Ints) -> Iterator[Schedule]:
        """Schedules of a bounded number of steps, with pauses where a frame is further away."""
        stops: list[tuple[int, float, int]] = []
        total = 0
        for count, h, row in zip(counts.tolist(), rest.tolist(), rows.tolist(), strict=True):
            left = count
            while total + left > self.most:
                stops.append((self.most - total, 0.0, PAUSE))
                left -= self.most - total
                yield self.schedule(stops)
                stops, total = [], 0
            stops.append((left, h, row))
            total += left
        if stops:
            yield self.schedule(stops)

    def schedule(self, stops: list[tuple[int, float, int]]) -> Schedule:
        """Stops as arrays, from where the group is now."""
        steps, rest, frame = zip(*stops, strict=True)
        return Schedule(self.dt, self.done, np.array(steps), np.array(rest), np.array(frame))

    def given(self, elapsed: float, com: Floats, q: Floats, L: Floats, sums: Floats) -> Floats:
        """Work, impulse and angular impulse until a state.

        The work of a push is the loss of its potential. Where no force is without potential, the
        centre of mass is on its parabola and the rest is closed form, but for the angular impulse
        about the centre of mass: only kicks change L, so it is the change of L.
        """
        push = self.group.terms.push
        turning = 0.0
        if push is not None:
            turning = (lever_work(push.lever, q) - lever_work(push.lever, self.first.q)).sum()
        if self.booked is None:
            given: Floats = self.constant.booked(np.array([elapsed]))[0]
            given[0] += turning
            given[4:] += (L - self.first.L).sum(axis=1)
            return given
        given = sums.copy()
        if push is not None:
            given[0] += turning + (push.force * (com - self.first.com)).sum()
        return given


BEGIN: Final = DrivenMotion
