"""Bodies that collide at the instants of their impacts, and fly in closed form in between."""

from typing import Final

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.events import records as col
from particlerb.events.advance import advance
from particlerb.events.flight import states_at
from particlerb.events.predict import set_all
from particlerb.events.records import empty_data, empty_state
from particlerb.impulses import records as impulses
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, State, store_all
from particlerb.rotors.single_turn import STEADY_COLUMNS, TURN_COLUMNS
from particlerb.stepping.event_scene import bounds_of, order_of, scene_of
from particlerb.stepping.motion import Motion, MotionError, SegmentGroup
from particlerb.stepping.saved_arrays import IN_FILES, Saved, to_arrays

_PER_CALL: Final = 100_000  # events: progress and Ctrl-C in between
_REASONS: Final = {
    col.ENDLESS: "impacts follow each other ever faster: give a longer contact.contact_time, "
    "or law = 'impulse' where something lies on something",
    col.FAR: "it has flown through as many cells as 32 bits number: begin nearer, or end earlier",
    col.OVERLAP: "it overlaps what it hits by more than rounding: an impact was missed",
}
_SEARCH: Final = "the search for its next impact does not end: it slides along what it touches"


class EventMotion(Motion):
    """A group of bodies that collide by events; see `motion.Motion`."""

    def __init__(
        self, group: SegmentGroup, state: State, start: float, before: Motion | None = None
    ) -> None:
        self.group, self.start = group, start
        self.order, n_moving = order_of(group, state)
        self.scene = scene_of(group, state, self.order, n_moving)
        n, n_cells = self.order.size, int(np.prod(self.scene.cells))
        columns = STEADY_COLUMNS if self.scene.turns is None else TURN_COLUMNS
        self.state = empty_state(n, n_moving, n_cells, columns)
        self.data = empty_data(int(np.diff(self.scene.kind[:, col.FIRST_SPHERE]).max()))
        if before is not None:
            self.continue_tally(before.impulse_tally())
            # Who has run the segment before has counted it:
            self.state.tally[impulses.GROSS_WORK] = 0.0
        self.state.tally[impulses.RENEWED] -= n_moving  # as each looks for its first event
        self.state.flight[:, col.BOUND] = bounds_of(group)[1][self.order]
        THREADS.alone(set_all, self.scene, self.state, self.order, state)
        self.tallies: dict[int, Floats] = {}

    def run_to(self, time: float) -> None:
        """Take all events until a time [s].

        Raises
        ------
        MotionError
            If impacts do not come to an end, or one was missed.
        """
        until, ends = time - self.start, col.MORE
        while ends == col.MORE:
            ends, b = THREADS.alone(advance, self.scene, self.state, self.data, until, _PER_CALL)
        if ends != col.DONE:
            now = self.start + float(self.state.sums[col.EPOCH] + self.state.heap_time[0])
            what = f"at t = {now:.9g} s body {self.group.members[self.order[b]]} cannot continue"
            raise MotionError(f"{what}: {_REASONS.get(ends, _SEARCH)}")

    def state_at(self, time: float) -> tuple[State, Floats]:
        """State of all bodies at a time [s], and (7,) of external work until then."""
        self.run_to(time)
        n, elapsed, moment = self.order.size, time - self.start, np.zeros(3)
        state = State(*(np.zeros((rows, n)) for rows in (3, 4, 3, 3)))
        local = elapsed - float(self.state.sums[col.EPOCH])
        THREADS.alone(states_at, self.scene, self.state, local, self.order, state, moment)
        external = self.state.sums[col.SUM_EXTERNAL : col.MOMENT].copy()
        g = np.array(self.scene.gravity)
        external[1:4] += self.scene.body[:, col.BODY_MASS].sum() * g * elapsed
        external[4:7] += np.cross(moment, g)
        return state, external

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; external work, (T, 7)."""
        external, self.tallies = np.zeros((times.size, 7)), {}
        for k, row in enumerate(rows.tolist()):
            state, external[k] = self.state_at(float(times[k]))
            store_all(frames, row, self.group.members, self.group.bodies.rotor_frame, state)
            self.tallies[row] = self.state.tally.copy()
        return external

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) of external work until then."""
        return self.state_at(stop)

    def gross_work(self) -> float:
        """Gross work of impacts since the start [J]."""
        return float(self.state.tally[impulses.GROSS_WORK])

    def impulse_tallies(self, rows: Ints) -> dict[int, Floats]:
        """What was counted, in rows of the frames of the last `record`."""
        return self.tallies

    def impulse_tally(self) -> Floats:
        """What is counted of impacts."""
        return self.state.tally

    def checkpoint(self) -> Saved:
        """All that events have changed."""
        return to_arrays(self.state)

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        for name, values in self.state._asdict().items():
            values[:] = saved[IN_FILES.get(name, name)]
