"""What every method on a grid of steps shares: blocks, frames, the grid, booking.

Steps stand on a grid that starts with the segment. A frame is reached by a partial step from a
copy, so that what is recorded never changes the motion. A method brings a step for a block of
bodies, `step(acting, books, rows, n, opening, dt)`, and its `edge`: the share of dt of the kick
with which a step ends, 0 where it ends with none. That kick stays open, and the next step makes
it together with its own first one, over `opening`.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.forces.kernels import Acting, prepare_kick, set_time
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, rows3
from particlerb.model.block import (
    BOOKED,
    CHANGING,
    COM,
    OWN,
    STRIDE,
    L,
    P,
    Q,
    copy_changing,
    in_blocks,
    into_blocks,
    out_of_blocks,
    state_rows,
)
from particlerb.model.state import Frames, State, room_for, store_frame
from particlerb.stepping.external_work import store_sums
from particlerb.stepping.kicks import kick
from particlerb.stepping.motion import Group, WorkAccount
from particlerb.stepping.saved_arrays import Saved

PAUSE: Final = -1  # a stop without a frame: the host asks for progress and interrupts
CLOSE: Final = -2  # the end of the segment: make the open kick
NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between
TIME_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of a time that is a sum of steps


class Schedule(NamedTuple):
    """When to step and when to record: one entry per stop."""

    dt: float  # [s]
    done: int  # steps of the segment that lie behind
    steps: Ints  # (T,) whole steps before the stop
    rest: Floats  # (T,) [s] length of the partial step from there to the frame
    frame: Ints  # (T,) row of the frames to write, or PAUSE, or CLOSE


@inline
def close(acting: Acting, books: int | None, rows: Floats, n: int, dt: float) -> None:
    """Make the open kick of a block."""
    if dt == 0.0:
        return
    prepare_kick(acting, rows, n, dt)
    for b in range(n):
        kick(acting, books, rows, b, dt)


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Advance a block by dt; stands for the step of a method."""
    raise NotImplementedError


EDGE: Final = 0.0  # stands for the edge of a method


def advance_blocks(
    blocks: Floats,
    acting: Acting,
    books: int | None,
    schedule: Schedule,
    rotor_frame: Floats,
    members: Ints,
    frames: Frames,
    sums: Floats,
    first: int,
    last: int,
) -> None:
    """Take some blocks through a schedule; `kernel_from` puts a method's step and edge in."""
    dt, behind, steps, rest, frame = schedule
    saved = np.empty(CHANGING * STRIDE)
    for k in range(first, last):
        rows, lo = blocks[k], k * BLOCK
        n = min(members.size - lo, BLOCK)
        index, turn = members[lo : lo + n], rows4(rotor_frame, lo, lo + n)
        is_open = EDGE * dt if behind > 0 else 0.0
        taken = behind
        for s in range(steps.size):
            was_open = is_open
            for i in range(steps[s] + 1):  # the last is the partial step to a frame
                h = dt
                if i == steps[s]:
                    if frame[s] < 0:
                        break
                    copy_changing(rows, saved, n)
                    h, was_open = rest[s], is_open
                if h > 0.0:
                    set_time(acting, rows, n, taken * dt)
                    step(acting, books, rows, n, EDGE * h + is_open, h)
                    is_open = EDGE * h
                taken += 1 if i < steps[s] else 0
            if frame[s] != PAUSE:
                set_time(acting, rows, n, taken * dt + rest[s])
                close(acting, books, rows, n, is_open)
            if frame[s] >= 0:
                local = rows.reshape(rows.size // STRIDE, STRIDE)
                com, q = rows3(local[COM : COM + 3], 0, n), rows4(local[Q : Q + 4], 0, n)
                p, spin = rows3(local[P : P + 3], 0, n), rows3(local[L : L + 3], 0, n)
                store_frame(frames, frame[s], index, turn, com, q, p, spin)
                store_sums(sums, frame[s], k, books, rows, n)
                copy_changing(saved, rows, n)
                is_open = was_open


def grid_position(elapsed: Floats, dt: float, start: float = 0.0) -> tuple[Ints, Floats]:
    """Whole steps before each time, and what remains [s]; 0 where only rounding remains.

    Times since the start are differences, and round like what they are differences of.
    """
    nearest = np.rint(elapsed / dt)
    on_grid = np.abs(elapsed - nearest * dt) <= TIME_ROUNDING * (np.abs(elapsed) + abs(start))
    steps = np.where(on_grid, nearest, np.floor(elapsed / dt))
    return steps.astype(np.int64), np.where(on_grid, 0.0, elapsed - steps * dt)


class SteppedMotion:
    """A group of bodies on a grid of steps; see `motion.Motion`.

    Parameters
    ----------
    advance : kernel
        Made from `advance_blocks`.
    cost : float
        Estimate of the time for one step of one body [ns].
    keeps_spin : bool
        Whether L changes by torques alone, as it should.
    own : ndarray, shape (rows, n), optional
        Constants of the method for each body.
    """

    def __init__(
        self,
        advance: Callable[..., None],
        cost: float,
        group: Group,
        state: State,
        start: float,
        dt: float,
        keeps_spin: bool = True,
        own: Floats | None = None,
    ) -> None:
        self.advance_blocks, self.group, self.start, self.dt = advance, group, start, dt
        n, terms = group.members.size, group.terms
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        parts += [] if own is None else [(OWN, own)]
        self.blocks = self.make_blocks(parts, row_count(terms))
        self.done = 0
        self.account = WorkAccount(group, state, keeps_spin)
        self.most = max(1, int(NANOSECONDS_PER_CALL / (cost * n)))

    def make_blocks(self, parts: list[tuple[int, Floats]], n_rows: int) -> Floats:
        """Blocks of the group with these rows."""
        return in_blocks(self.group.members.size, n_rows, parts)

    def values(self, at: int, count: int) -> Floats:
        """Some rows of all bodies, (count, n)."""
        return out_of_blocks(self.blocks, at, count, self.group.members.size)

    def put_values(self, at: int, values: Floats) -> None:
        """Write rows of all bodies, (count, n)."""
        into_blocks(self.blocks, at, values)

    def checkpoint(self) -> Saved:
        """States on the grid with what was booked, and the steps until there."""
        return {"changing": self.values(0, CHANGING), "done": np.array(self.done)}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.put_values(0, saved["changing"])
        self.done = int(saved["done"])

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        sums = self.advance(*grid_position(elapsed, self.dt, self.start), rows, frames)
        return self.account.of_frames(elapsed, rows, frames, sums)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        elapsed = np.array([stop - self.start])
        steps, _ = grid_position(elapsed, self.dt, self.start)
        none = room_for(0, 0, np.empty((0, 4)))
        self.advance(steps, np.zeros(1), np.array([CLOSE]), none)
        sums = self.values(BOOKED, 7).sum(axis=1)
        state = State(*(self.values(*rows) for rows in ((COM, 3), (Q, 4), (P, 3), (L, 3))))
        given = self.account.of_state(stop - self.start, state.com, state.q, state.L, sums)
        return state, given

    def advance(self, steps: Ints, rest: Floats, rows: Ints, frames: Frames) -> Floats:
        """Go through stops given by their distance from the start; sums of what was booked."""
        sums = np.zeros((frames.position.shape[0], len(self.blocks), 7))
        for schedule in self.calls(np.diff(steps, prepend=self.done), rest, rows):
            count = int(schedule.steps.sum())
            self.run(schedule, count, frames, sums)
            self.done += count
        return np.asarray(sums.sum(axis=1))

    def run(self, schedule: Schedule, count: int, frames: Frames, sums: Floats) -> None:
        """Go through a schedule of so many steps."""
        group = self.group
        n = group.members.size
        through = partial(
            self.advance_blocks, self.blocks, acting_of(group.terms), self.account.books,
            schedule, group.bodies.rotor_frame, group.members, frames, sums,
        )  # fmt: skip
        THREADS.spread(through, n, n * (count + schedule.steps.size))

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
