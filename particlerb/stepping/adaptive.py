"""Bodies that choose their own steps, by DOP853: all together, or sixteen at a time.

Where bodies act on each other all of them take the same steps. Otherwise sixteen do, side by side
in SIMD lanes, as long as the error estimate of each stays below the tolerance.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.forces.registry import MANY
from particlerb.integrators.dop853 import BODIES_PER_CLOCK
from particlerb.integrators.dop853_stages import CommonSteps, room_for_vectors
from particlerb.integrators.dop853_step import Equations
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout, pair_loads
from particlerb.integrators.stages import over_threads
from particlerb.joints.trees import tree_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import (
    CHANGING,
    STRIDE,
    get,
    in_blocks,
    into_blocks,
    out_of_blocks,
    put,
    state_rows,
)
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import Frames, State, room_for
from particlerb.stepping.adaptive_loop import Leg, advance_steps
from particlerb.stepping.jointed_motion import JointedMotion, jointed_in
from particlerb.stepping.loop import Recording
from particlerb.stepping.motion import ForceAccount, SegmentGroup
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.saved_arrays import Saved
from particlerb.stepping.stepped_motion import NANOSECONDS_PER_CALL


@kernel
def _advance_packs(
    equations: Equations, blocks: Floats, clock: Floats, leg: Leg, recording: Recording, first: int,
    end: int,
) -> None:  # fmt: skip
    """Advance the packs of some blocks; the clock is (packs, 3)."""
    size, n = STATE_ROWS if equations.sums_external is None else CHANGING, recording.members.size
    rows = np.zeros((1, max(blocks.shape[1], MANY * STRIDE)))
    layout = Layout(np.zeros(1, np.int64), np.zeros(1, np.int64), 0)
    width = min(n, BODIES_PER_CLOCK)  # a body that is alone pays for itself only
    vectors = room_for_vectors(1, size, width, np.zeros(0))
    pack = CommonSteps(equations, rows, layout, None, None, vectors)
    for lo in range(first * BLOCK, min(end * BLOCK, n), BODIES_PER_CLOCK):
        layout.first[0], layout.size[0] = lo, min(n - lo, BODIES_PER_CLOCK)
        block, at = blocks[lo // BLOCK], lo % BLOCK
        for r in range(block.size // STRIDE):
            for b in range(layout.size[0]):
                put(rows[0], r, b, get(block, r, at + b))
        advance_steps(pack, clock[lo // BODIES_PER_CLOCK], leg, recording)
        for r in range(size):
            for b in range(layout.size[0]):
                put(block, r, at + b, get(rows[0], r, b))


class AdaptiveMotion(JointedMotion):
    """A group of bodies that choose their own steps; see `motion.Motion`."""

    def __init__(
        self,
        method: Method,
        group: SegmentGroup,
        state: State,
        start: float,
        first_step: float,
        tolerance: float,
    ) -> None:
        self.group, self.start = group, start
        n, terms = group.members.size, group.terms
        self.account = ForceAccount(group, state)
        self.equations = Equations(acting_of(terms), self.account.sums_external, tolerance)
        self.forces = PairForces(terms, n, True, start) if terms.is_coupled else None
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        self.blocks = in_blocks(n, row_count(terms), parts)
        first = np.arange(0, n, BLOCK)
        self.layout = Layout(first, np.minimum(BLOCK, n - first), 0)
        self.jointed = jointed_in(group, state, np.arange(n), start, 0.0)
        if self.jointed is not None:
            self.jointed = self.jointed._replace(tree=tree_of(self.jointed.joints))
        size = STATE_ROWS if self.account.sums_external is None else CHANGING
        n_common, hold = len(first) if terms.is_coupled else 0, np.full_like(super().broken, np.inf)
        self.vectors = room_for_vectors(n_common, size, int(self.layout.size[0]), hold)
        self.clock = np.zeros((1 if terms.is_coupled else -(-n // BODIES_PER_CLOCK), 3))
        self.clock[:, 1] = first_step  # [s], behind the time [s]; steps taken are last
        self.cost = method.cost * n  # [ns] of a step of all, roughly
        self.cost += 0.0 if self.forces is None else method.evaluations * self.forces.cost

    @property
    def broken(self) -> Floats:
        """When joints have broken [s], (j,): inf where they hold."""
        return self.vectors.broken

    def checkpoint(self) -> Saved:
        """States at the start of each step, when that is, how long it is, and which."""
        changing = out_of_blocks(self.blocks, 0, CHANGING, self.group.members.size)
        saved = {"changing": changing, "clock": self.clock.T.copy()}
        return saved | self.kept_of_joints()

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        into_blocks(self.blocks, 0, saved["changing"])
        self.clock[:] = saved["clock"].T
        self.restore_joints(saved)

    def advance_some(self, leg: Leg, recording: Recording) -> None:
        """Advance all bodies: together, or packs of them over threads."""
        shared = self.clock[0], leg, recording
        if self.forces is None:
            through = partial(_advance_packs, self.equations, self.blocks, self.clock, *shared[1:])
            stops = leg.times.size + 1
            THREADS.spread(through, self.group.members.size, int(stops * self.cost))
            return
        forces, acting = self.forces, self.equations.acting
        pairs = None if acting.pair is None else forces.pairs
        arguments = self.blocks, self.layout, pairs, self.jointed, self.vectors
        bodies = CommonSteps(self.equations, *arguments)
        if forces.is_large:
            evaluate = pair_loads, lambda *_: forces.evaluate()
            over_threads(advance_steps, evaluate)(bodies, *shared)
        else:
            THREADS.alone(advance_steps, bodies, *shared)
        if self.breaks:
            self.clock[0, 1] = self.vectors.tried[0]

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        elapsed = times - self.start
        sums = self.advance(elapsed, rows, np.inf, frames)
        return self.account.of_frames(elapsed, rows, frames, sums)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        elapsed, none = stop - self.start, room_for(0, 0, np.empty((0, 4)))
        self.advance(np.empty(0), np.empty(0, dtype=np.int64), elapsed, none)
        values = out_of_blocks(self.blocks, 0, CHANGING, self.group.members.size)
        return self.account.at_end(values, elapsed)

    def advance(self, times: Floats, rows: Ints, stop: float, frames: Frames) -> Floats:
        """Through all times; sums of external work, for each row of the frames."""
        group = self.group
        sums = np.zeros((frames.position.shape[0], len(self.blocks), 7))
        where, nobody = (group.bodies.rotor_frame, group.members), np.zeros(0, dtype=np.int64)
        self.coordinates = np.zeros((len(frames.position), *self.turned.shape))
        recording = Recording(*where, frames, sums, nobody, self.coordinates, None, None)
        for lo, hi, until in self.calls(times, stop):
            cut = stop if until == stop else np.inf
            self.advance_some(Leg(times[lo:hi], rows[lo:hi], until, cut), recording)
        return np.asarray(sums.sum(axis=1))

    def calls(self, times: Floats, stop: float) -> Iterator[tuple[int, int, float]]:
        """Ranges of frames, and times to go to after them, of about a second each."""
        most = max(1.0, NANOSECONDS_PER_CALL / self.cost)
        done = 0
        while done < times.size:
            horizon = self.horizon(most)
            reached = max(int(np.searchsorted(times, horizon, side="right")), done)
            if reached == done and self.horizon(2.0 * most) < times[done]:
                yield done, done, horizon
            else:
                yield done, max(reached, done + 1), 0.0
                done = max(reached, done + 1)
        while stop < np.inf and self.horizon(most) < stop:
            yield done, done, self.horizon(most)
        if stop < np.inf:
            yield done, done, stop

    def horizon(self, steps: float) -> float:
        """Time that every body will have reached after so many more steps, about."""
        ahead = self.clock[:, 0] + steps * self.clock[:, 1]
        return float(np.min(ahead, initial=np.inf, where=np.isfinite(ahead)))
