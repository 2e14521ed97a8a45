"""A group of bodies on a grid of steps: its blocks, and the calls of the loop."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from particlerb.compiled.jit import flag, for_types_of
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.forces.registry import STAGE
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout
from particlerb.integrators.stages import MovingBodies, RotorClasses
from particlerb.maths.vec3 import Bools, Floats, Ints, differences
from particlerb.model.block import (
    CHANGING,
    ROTOR,
    STRIDE,
    changing,
    in_blocks,
    into_blocks,
    out_of_blocks,
    state_rows,
)
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import Frames, State, room_for
from particlerb.model.worlds import bins_of, over_bins
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.jointed_motion import JointedMotion, jointed_in
from particlerb.stepping.loop import (
    CLOSE,
    PAUSE,
    Copies,
    Position,
    Recording,
    Schedule,
    compiled_loop,
    grid_position,
    grid_stop,
    loop_over_threads,
)
from particlerb.stepping.motion import ForceAccount, SegmentGroup
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.saved_arrays import Saved

NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between
_STAGE_ROWS: Final = 2 * STATE_ROWS  # for methods that keep a state and a sum of slopes


def _layout_of(is_asymmetric: Bools) -> Layout:
    """Blocks for bodies of which the asymmetric ones come first and have blocks of their own."""
    n, asymmetric = is_asymmetric.size, int(is_asymmetric.sum())
    assert is_asymmetric[:asymmetric].all()
    first = np.concatenate((np.arange(0, asymmetric, BLOCK), np.arange(asymmetric, n, BLOCK)))
    ends = np.minimum(first + BLOCK, np.where(first < asymmetric, asymmetric, n))
    return Layout(first, ends - first, -(-asymmetric // BLOCK))


def _pairs_of(method: Method, group: SegmentGroup, start: float) -> PairForces | None:
    """Forces between bodies that do not touch; None where there are none."""
    terms, n = group.terms, group.members.size
    if all(term is None for term in (terms.links, terms.user_pairs, terms.attraction)):
        return None
    return PairForces(terms, n, not method.has_dashpot_flows, start, group.worlds)


class SteppedMotion(JointedMotion):
    """A group of bodies on a grid of steps; see `motion.Motion`."""

    steps_done = 0  # of the segment
    memory: Floats | None = None  # blocks that were here before

    def __init__(
        self, method: Method, group: SegmentGroup, state: State, start: float, dt: float
    ) -> None:
        self.method, self.group, self.start, self.dt = method, group, start, dt
        self.first = state
        terms, n = group.terms, group.members.size
        self.forces = _pairs_of(method, group, start)
        self.is_coupled = self.forces is not None or terms.joints is not None
        is_asymmetric = group.bodies.rotor_class == ASYMMETRIC
        acts_together = terms.is_coupled or terms.contact is not None
        has_own_blocks = terms.is_coupled or method.rotor_constants is not None
        self.layout = _layout_of(is_asymmetric & has_own_blocks)
        full = self.layout.size.tolist()
        self.slots = np.concatenate([k * BLOCK + np.arange(m) for k, m in enumerate(full)])
        self.bins = self.bins_of(is_asymmetric & has_own_blocks)
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        rotors = RotorClasses()
        if method.rotor_constants is not None:
            rotors = RotorClasses(flag(bool(is_asymmetric.any())), flag(not is_asymmetric.all()))
            constants = method.rotor_constants(group.bodies.inv_inertia[:, is_asymmetric])
            rotor = np.zeros((len(constants), n))
            rotor[:, is_asymmetric] = constants
            parts.append((ROTOR, rotor))
        n_rows = STAGE + _STAGE_ROWS if acts_together else row_count(terms)
        assert row_count(terms) <= STAGE
        spaced = [(at, self.spaced(values)) for at, values in parts]
        unused = row_count(terms), STAGE
        self.blocks = in_blocks(len(full) * BLOCK, n_rows, spaced, self.memory, unused)
        self.saved = np.empty((len(full), CHANGING * STRIDE))
        self.single: tuple[Frames, Schedule, Recording] | None = None  # of `pose`,
        self.pose_loop: Callable[..., Position] | None = None  # and for it
        self.account = ForceAccount(group, state, method.keeps_angular_momentum)
        self.jointed = jointed_in(
            group, state, self.slots, start, dt, packed=not method.takes_impulses
        )
        links, user_pairs = terms.links, terms.user_pairs
        has_dashpots = links is not None and links.damping is not None
        has_dashpots |= user_pairs is not None and bool(user_pairs.takes_velocities.any())
        self.moving = MovingBodies(
            self.blocks,
            self.layout,
            acting_of(terms),
            self.account.books,
            rotors,
            None if self.forces is None else self.forces.pairs,
            flag(has_dashpots and method.has_dashpot_flows),
            self.jointed,
        )
        self.cost = method.cost * n  # [ns] of a step, roughly
        self.cost += 0.0 if self.forces is None else method.evaluations * self.forces.cost

    def reset(self, first: Floats, dt: float) -> None:
        """Start once more, with what changes in blocks as it was at first, and another step.

        Joints keep more than that: bodies that they hold cannot.
        """
        assert self.jointed is None
        changing(self.blocks)[:], self.dt, self.steps_done = first, dt, 0

    def spaced(self, values: Floats) -> Floats:
        """Rows of all bodies with the gaps of the blocks between them."""
        if self.slots[-1] == self.slots.size - 1:
            return values
        spaced = np.zeros((len(values), len(self.layout.first) * BLOCK))
        spaced[:, self.slots] = values
        return spaced

    def bins_of(self, in_own_blocks: Bools) -> Ints:
        """Where each body is summed: a bin for each block, of one scene or of each world."""
        worlds, layout = self.group.worlds, self.layout
        if worlds is not None:
            layout = _layout_of(in_own_blocks[worlds.bodies[0]])
        return bins_of(np.repeat(np.arange(layout.size.size), layout.size), worlds)

    @property
    def n_bins(self) -> int:
        """Bins in which bodies are summed."""
        return int(self.bins.max(initial=-1)) + 1

    def values(self, at: int, count: int) -> Floats:
        """Some rows of all bodies, (count, n)."""
        n = len(self.blocks) * BLOCK
        return np.ascontiguousarray(out_of_blocks(self.blocks, at, count, n)[:, self.slots])

    def checkpoint(self) -> Saved:
        """States on the grid with what was booked, and the steps until there."""
        saved = {"changing": self.values(0, CHANGING), "done": np.array(self.steps_done)}
        return saved | self.kept_of_joints()

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        into_blocks(self.blocks, 0, self.spaced(saved["changing"]))
        self.steps_done = int(saved["done"])
        self.restore_joints(saved)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        sums = self.advance(*grid_position(elapsed, self.dt, self.start), rows, frames)
        return self.account.of_frames(elapsed, rows, frames, sums)

    def pose(self, time: float, frames: Frames) -> None:
        """Write the states at a time [s] into the first row of the frames, and book nothing."""
        steps, partial = grid_stop(time - self.start, self.dt, self.start)
        count = steps - self.steps_done
        touches = self.group.terms.contact is not None
        if touches or count * self.cost > NANOSECONDS_PER_CALL or self.turned.size:
            super().pose(time, frames)
            return
        if self.single is None or self.single[0] is not frames:
            schedule = Schedule(self.dt, np.zeros(1, np.int64), np.zeros(1), np.zeros(1, np.int64))
            self.single = frames, schedule, self.recording(frames)
        _, schedule, recording = self.single
        schedule.steps[0], schedule.partial[0] = count, partial
        recording.sums.fill(0.0)
        if self.pose_loop is None:
            arguments = self._arguments(schedule, recording)
            self.pose_loop = for_types_of(self.loop_over_steps(), *arguments, 1, 0, 1)
        self._run_through_loop(self.pose_loop, schedule, recording)
        self.steps_done = steps

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        self.close(stop)
        return self.account.at_end(self.shown_values(), stop - self.start)

    def shown_values(self) -> Floats:
        """What changes of the bodies that are shown here, (CHANGING, n)."""
        return self.values(0, CHANGING)

    def close(self, stop: float) -> None:
        """Go to the end of the segment, where the last kick is closed."""
        elapsed = np.array([stop - self.start])
        none = room_for(0, 0, np.empty((0, 4)))
        self.advance(*grid_position(elapsed, self.dt, self.start), np.array([CLOSE]), none)

    def advance(self, steps: Ints, partial: Floats, rows: Ints, frames: Frames) -> Floats:
        """Go through stops given by their distance from the start; sums of what was booked."""
        recording = self.recording(frames)
        counts = differences(steps, self.steps_done)
        for schedule in self.schedules(counts, partial, rows):
            self.run(schedule, recording)
            self.steps_done += int(schedule.steps.sum())
        return self.total(recording.sums)

    def total(self, sums: Floats) -> Floats:
        """Sums of bins, (T, bins, ..), over all bodies, or over those of each world."""
        return over_bins(sums, self.group.worlds)

    def recording(self, frames: Frames) -> Recording:
        """Where frames go, with room for what is booked and for coordinates of joints."""
        n_frames, shown = len(frames.position), self.account.group
        sums = np.zeros((n_frames, self.n_bins, 7))
        self.coordinates = np.zeros((n_frames, *self.turned.shape))
        where = shown.bodies.rotor_frame, shown.members, frames, sums, self.bins
        return Recording(*where, self.coordinates)

    def run(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule."""
        self._run_through_loop(self.loop_over_steps(), schedule, recording)

    def _arguments(self, schedule: Schedule, recording: Recording) -> tuple[Any, ...]:
        """What the loop takes before its range of blocks."""
        position = Position(0, 0, self.steps_done)
        return self.moving, schedule, recording, Copies(self.saved), position

    def _run_through_loop(
        self, loop: Callable[..., Position], schedule: Schedule, recording: Recording
    ) -> None:
        """Go through a schedule with the loop of `loop_over_steps`."""
        n, n_blocks = self.group.members.size, len(self.blocks)
        arguments = self._arguments(schedule, recording)
        if not self.is_coupled:
            stops = sum(schedule.steps.tolist()) + schedule.steps.size
            THREADS.share(partial(loop, *arguments, 1), n_blocks, n * stops)
        elif self.is_spread:
            loop(*arguments, n_blocks, 0, n_blocks)
        else:
            THREADS.alone(loop, *arguments, n_blocks, 0, n_blocks)

    @property
    def is_spread(self) -> bool:
        """Whether large forces spread themselves over threads."""
        return self.forces is not None and self.forces.is_large

    def loop_over_steps(self, touches: bool = False) -> Callable[..., Position]:
        """The loop; large forces bring one of their own."""
        if self.forces is not None and self.forces.is_large:
            return loop_over_threads(self.method, self.forces, touches)
        return compiled_loop(self.method, self.is_coupled or touches, touches)

    def schedules(self, counts: Ints, partial: Floats, rows: Ints) -> Iterator[Schedule]:
        """Schedules of a bounded number of steps, with pauses where a frame is further away."""
        stops: list[tuple[int, float, int]] = []
        total, most = 0, max(1, int(NANOSECONDS_PER_CALL / self.cost))
        for count, h, row in zip(counts.tolist(), partial.tolist(), rows.tolist(), strict=True):
            left = count
            while total + left > most:
                stops.append((most - total, 0.0, PAUSE))
                left -= most - total
                yield self.schedule(stops)
                stops, total = [], 0
            stops.append((left, h, row))
            total += left
        if stops:
            yield self.schedule(stops)

    def schedule(self, stops: list[tuple[int, float, int]]) -> Schedule:
        """Stops as arrays."""
        steps, partial, frame = zip(*stops, strict=True)
        return Schedule(self.dt, np.array(steps), np.array(partial), np.array(frame))
