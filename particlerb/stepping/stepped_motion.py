"""A group of bodies on a grid of steps: its blocks, and the calls of the loop."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from particlerb.compiled.jit import for_types_of
from particlerb.compiled.threads import THREADS
from particlerb.forces import acting_of
from particlerb.integrators.external_work import NOT_STEADY
from particlerb.integrators.method import Method
from particlerb.maths.vec3 import Floats, Ints, differences
from particlerb.model.block import CHANGING, changing
from particlerb.model.state import Frames, State, room_for
from particlerb.model.totals import N_TOTALS, no_totals
from particlerb.model.worlds import over_bins
from particlerb.stepping.jointed_motion import JointedMotion
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
from particlerb.stepping.saved_arrays import Saved
from particlerb.stepping.stepped_bodies import SteppedBodies

NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between
_NO_FRAMES: Final = room_for(0, 0, np.empty((0, 4)))


class SteppedMotion(JointedMotion):
    """A group of bodies on a grid of steps; see `motion.Motion`."""

    steps_done = 0  # of the segment

    def __init__(
        self, method: Method, group: SegmentGroup, state: State, start: float, dt: float,
        here: tuple[SegmentGroup, State] | None = None,
    ) -> None:  # fmt: skip
        self.method, self.group, self.start, self.dt = method, group, start, dt
        self.account = ForceAccount(group, state, method.keeps_angular_momentum)
        sums_external = self.account.sums_external
        self.bodies = SteppedBodies(method, *(here or (group, state)), start, dt, sums_external)
        self.jointed, self.bins = self.bodies.jointed, self.bodies.bins
        self.n_bins = int(self.bins.max(initial=-1)) + 1
        self.single: tuple[Frames, Schedule, Recording] | None = None  # of single stops,
        self.single_loop: Callable[..., Position] | None = None  # and for them
        self.cost = method.cost * group.members.size + self.bodies.cost  # [ns] of a step, roughly

    def reset(self, first: Floats, dt: float) -> None:
        """Start once more, with what changes in blocks as it was at first, and another step.

        Joints keep more than that: bodies that they hold cannot.
        """
        assert self.jointed is None
        changing(self.bodies.blocks)[:], self.dt, self.steps_done = first, dt, 0

    def continues(
        self, method: Method, group: SegmentGroup, state: State, start: float, dt: float
    ) -> bool:
        """Continue in the next segment, in the same blocks, where loads of the same kinds act."""
        account = ForceAccount(group, state, method.keeps_angular_momentum)
        kinds = method, acting_of(group.terms), account.sums_external
        is_coupled, now = group.terms.is_coupled or self.group.terms.is_coupled, self.bodies.moving
        if is_coupled or kinds != (self.method, now.acting, now.sums_external):
            return False
        self.group, self.account, self.start, self.dt = group, account, start, dt
        self.steps_done = 0
        self.bodies.begin(group, state)
        if self.single is not None:
            frames, schedule, recording = self.single
            is_summed = account.sums_external is not None  # else recordings have steady forces
            self.single = (frames, schedule._replace(dt=dt), recording) if is_summed else None
        return True

    def checkpoint(self) -> Saved:
        """States on the grid with external work, and the steps until there."""
        saved = {"changing": self.bodies.values(0, CHANGING), "done": np.array(self.steps_done)}
        return saved | self.kept_of_joints()

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.bodies.put(0, saved["changing"])
        self.steps_done = int(saved["done"])
        self.restore_joints(saved)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        elapsed = times - self.start
        sums = self.advance(*grid_position(elapsed, self.dt, self.start), rows, frames)
        if self.account.steady is not NOT_STEADY:
            return self.account.of_steady(elapsed, sums[rows])
        return self.account.of_frames(elapsed, rows, frames, sums)

    def pose(self, time: float, frames: Frames) -> None:
        """Write the states at a time [s] into the first row of the frames, and add no work."""
        if not self._stops_once(time, 0, frames):
            super().pose(time, frames)

    def _stops_once(self, time: float, row: int, frames: Frames) -> bool:
        """Go to a time [s], for a row of the frames or CLOSE, where one call of the loop does."""
        steps, partial = grid_stop(time - self.start, self.dt, self.start)
        count = steps - self.steps_done
        touches, turns = self.group.terms.contact is not None, self.jointed is not None
        if touches or count * self.cost > NANOSECONDS_PER_CALL or (turns and self.turned.size):
            return False
        single, loop = self.single, self.single_loop
        if single is None or single[0] is not frames:
            schedule = Schedule(self.dt, np.zeros(1, np.int64), np.zeros(1), np.zeros(1, np.int64))
            single = self.single = frames, schedule, self.recording(frames)
            loop, self.single_loop = self.loop_over_steps(), None
        _, schedule, recording = single
        schedule.steps[0], schedule.partial[0], schedule.frame[0] = count, partial, row
        recording.sums.fill(0.0)
        if loop is None:
            arguments = self._arguments(schedule, recording)
            loop = self.single_loop = for_types_of(self.loop_over_steps(), *arguments, 1, 0, 1)
        self._run_through_loop(loop, schedule, recording)
        self.steps_done = steps
        return True

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        self.close(stop)
        return self.account.at_end(self.bodies.values(0, CHANGING), stop - self.start)

    def close(self, stop: float) -> None:
        """Go to the end of the segment, where the last kick is closed."""
        if not self._stops_once(stop, CLOSE, _NO_FRAMES):
            elapsed = np.array([stop - self.start])
            where = grid_position(elapsed, self.dt, self.start)
            self.advance(*where, np.array([CLOSE]), _NO_FRAMES)

    def advance(self, steps: Ints, partial: Floats, rows: Ints, frames: Frames) -> Floats:
        """Go through stops given by their distance from the start; sums of external work."""
        recording = self.recording(frames)
        counts = differences(steps, self.steps_done)
        for schedule in self.schedules(counts, partial, rows):
            self.run(schedule, recording)
        if self.sums is not None and recording.totals is not None:
            self.sums += over_bins(recording.totals.sums[rows], self.group.worlds)
        return self.total(recording.sums)

    def total(self, sums: Floats) -> Floats:
        """Sums of bins, (T, bins, ..), over all bodies, or over those of each world."""
        return over_bins(sums, self.group.worlds)

    def recording(self, frames: Frames) -> Recording:
        """Where frames go, with room for external work and for coordinates of joints."""
        n_frames, shown = len(frames.position), self.account.group
        sums = np.zeros((n_frames, self.n_bins, 7))
        self.coordinates = np.zeros((n_frames, *self.turned.shape))
        where = shown.bodies.rotor_frame, shown.members, frames, sums, self.bins
        if shown.terms.contact is not None:
            return Recording(*where, self.coordinates, None, None)
        totals, gravity = no_totals(shown.bodies), shown.terms.gravity
        if self.sums is not None:
            totals = totals._replace(sums=np.zeros((n_frames, self.n_bins, N_TOTALS)))
        if gravity is not None:
            totals = totals._replace(gravity=gravity.acceleration)
        return Recording(*where, self.coordinates, self.account.steady, totals)

    def run(self, schedule: Schedule, recording: Recording) -> None:
        """Go through a schedule."""
        self._run_through_loop(self.loop_over_steps(), schedule, recording)
        self.steps_done += int(schedule.steps.sum())

    def _arguments(self, schedule: Schedule, recording: Recording) -> tuple[Any, ...]:
        """What the loop takes before its range of blocks."""
        position = Position(0, 0, self.steps_done)
        return self.bodies.moving, schedule, recording, Copies(self.bodies.copy), position

    def _run_through_loop(
        self, loop: Callable[..., Position], schedule: Schedule, recording: Recording
    ) -> None:
        """Go through a schedule with the loop of `loop_over_steps`."""
        n, n_blocks = self.group.members.size, len(self.bodies.blocks)
        arguments = self._arguments(schedule, recording)
        if not self.bodies.is_coupled:
            stops = sum(schedule.steps.tolist()) + schedule.steps.size
            THREADS.share(partial(loop, *arguments, 1), n_blocks, n * stops)
        elif self.bodies.is_spread:
            loop(*arguments, n_blocks, 0, n_blocks)
        else:
            THREADS.alone(loop, *arguments, n_blocks, 0, n_blocks)

    def loop_over_steps(self, touches: bool = False) -> Callable[..., Position]:
        """The loop; large forces bring one of their own."""
        forces = self.bodies.forces
        if forces is not None and forces.is_large:
            return loop_over_threads(self.method, forces, touches)
        return compiled_loop(self.method, self.bodies.is_coupled or touches, touches)

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
