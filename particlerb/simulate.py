"""The loop: plan, segments, frames, recorder.

Groups advance one after the other through a batch of times; then the batch is complete, the ledger
is written and the recorder appends it. Frames and times that only a check asks for change nothing
in the motion, so a run can be prolonged, or recorded more finely, without changing a bit of it.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numba
import numpy as np

from particlerb.bodies.scene import Scene, assemble
from particlerb.bodies.state import Frames, State, as_frame, multiplied, room_for, turned_back
from particlerb.case.schema import Case
from particlerb.describe import describe
from particlerb.ledger import Drift, Entries, Ledger, totals
from particlerb.maths.vec3 import Floats, Ints
from particlerb.methods import METHODS
from particlerb.methods.motion import Motion
from particlerb.plan import GroupPlan, Plan, Segment, make_plan
from particlerb.record.writer import Recorder
from particlerb.rotors.rotor_class import ROD
from particlerb.terms.impulse import apply_impulse

BATCH_BYTES = 8_000_000  # of frames that are held before they are written
BATCH_FRAMES = 1024
FRAME_ROUNDING = 1e-9  # share of run.every within which t_end counts as one of its multiples
ROD_ROUNDING = 1e-9  # share of L along a rod that stepping may leave

Progress = Callable[[int], object]
config: Any = numba.config


class RunError(Exception):
    """A run that failed: what, where, when."""


class Probe(NamedTuple):
    """State of all bodies at a time that a check asks for."""

    time: float
    frame: Frames  # one row


class Outcome(NamedTuple):
    """What a run leaves beside its file."""

    drift: Drift
    probes: tuple[Probe, ...]
    file: h5py.File  # closed, or open if it is in memory


class Prepared(NamedTuple):
    """A case made ready to run."""

    case: Case
    scene: Scene
    plan: Plan
    text: str  # the plan in words


def prepare(case: Case) -> Prepared:
    """Bodies and plan of a case.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    scene = assemble(case)
    plan = make_plan(case, scene)
    return Prepared(case, scene, plan, describe(case, scene, plan))


def frame_times(case: Case) -> Floats:
    """Times of the frames [s]: the multiples of run.every, and t_end."""
    every, t_end = case.run.every, case.run.t_end
    times = np.float64(every) * np.arange(int(t_end / every + FRAME_ROUNDING) + 1)
    if t_end - times[-1] > FRAME_ROUNDING * every:
        return np.append(times, np.float64(t_end))
    times[-1] = t_end
    return times


class Traveller:
    """One group on its way through its segments."""

    def __init__(self, plan: GroupPlan, state: State) -> None:
        self.plan = plan
        self.before = np.zeros(7)  # booked in earlier segments
        self.number = 0
        self.motion = self.begin(plan.segments[0], state)

    @property
    def segment(self) -> Segment:
        """The segment that it is in."""
        return self.plan.segments[self.number]

    def begin(self, segment: Segment, state: State) -> Motion:
        """Apply the impulses at the start of a segment and set off."""
        for jump in segment.jumps:
            state, booked = apply_impulse(jump, self.plan.bodies, state)
            self.before += booked
        motion: Motion = METHODS[segment.method].BEGIN(
            self.plan.group(segment), state, segment.start, segment.dt
        )
        return motion

    def cross(self) -> None:
        """Go from this segment into the next."""
        state, booked = self.motion.finish(self.segment.stop)
        self.before += booked
        self.number += 1
        self.motion = self.begin(self.segment, state)

    def record(self, times: Floats, frames: Frames) -> Floats:
        """Write rows 0.. of the frames at ascending times; return (T, 7) booked since t = 0.

        A frame at the instant of an edge shows the state after it.
        """
        booked = np.empty((times.size, 7))
        done = 0
        while done < times.size:
            until = int(np.searchsorted(times, self.segment.stop, side="left"))
            if until > done:
                rows = np.arange(done, until)
                booked[rows] = self.before + self.motion.record(times[rows], rows, frames)
                done = until
            if done < times.size:
                self.cross()
        return booked


class Run:
    """A prepared case on its way."""

    def __init__(self, prepared: Prepared) -> None:
        case, self.scene, plan, _ = prepared
        self.gravity = np.array(case.gravity.acceleration if case.gravity else (0.0, 0.0, 0.0))
        initial = as_frame(self.scene.bodies, self.scene.state)
        self.last = initial.last
        self.ledger = Ledger(totals(initial, self.scene.bodies, self.gravity))
        self.travellers = [
            Traveller(group, State(*(a[:, group.members] for a in self.scene.state)))
            for group in plan.groups
        ]

    def frames_at(self, times: Floats) -> tuple[Frames, Entries]:
        """Frames at ascending times, not before those asked for earlier, and their ledger.

        Raises
        ------
        RunError
            If a state is not finite, or a torque has turned a rod about its own axis.
        """
        frames = room_for(times.size, len(self.scene.kind), self.last)
        booked = np.zeros((times.size, 7))
        for traveller in self.travellers:
            booked += traveller.record(times, frames)
        self.refuse_nonsense(times, frames)
        now = totals(frames, self.scene.bodies, self.gravity)
        return frames, self.ledger.enter(now, booked)

    def refuse_nonsense(self, times: Floats, frames: Frames) -> None:
        """Raise RunError where the last of the frames cannot be a state."""
        for name in ("position", "orientation", "linear_momentum", "angular_momentum"):
            wrong = np.argwhere(~np.isfinite(getattr(frames, name)[-1]))
            if len(wrong):
                body = self.scene.names[int(wrong[0][0])]
                raise RunError(
                    f"{name} of {body} is not finite at t = {times[-1]!r} s: the step is too long"
                    " for this force, or a number too large for float64"
                )
        rods = np.flatnonzero(self.scene.bodies.rotor_class == ROD)
        if rods.size:
            self.refuse_spinning_rods(rods, times, frames)

    def refuse_spinning_rods(self, rods: Ints, times: Floats, frames: Frames) -> None:
        """Raise RunError where a torque in the world has left L along a rod."""
        q = multiplied(frames.orientation[-1, rods].T, self.scene.bodies.rotor_frame[:, rods])
        m = turned_back(q, frames.angular_momentum[-1, rods].T)
        wrong = np.flatnonzero(np.abs(m[2]) > ROD_ROUNDING * np.linalg.norm(m, axis=0))
        if wrong.size:
            name = self.scene.names[int(rods[wrong[0]])]
            raise RunError(
                f"{name} is a rod, and by t = {times[-1]!r} s a torque has turned it about its own"
                " axis, about which it has no inertia: apply forces at points of the rod instead"
            )


def run_prepared(
    prepared: Prepared,
    path: Path | None,
    overwrite: bool = False,
    progress: Progress = lambda n: None,
) -> Outcome:
    """Run a prepared case into a file.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.
    path : Path or None
        Where to; None for memory.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : callable
        Called with the number of frames that were added.

    Raises
    ------
    FileExistsError, OSError
        Of the file.
    RunError
        If the run fails; the frames until then are committed.
    """
    case = prepared.case
    if case.run.threads is not None:
        numba.set_num_threads(min(case.run.threads, config.NUMBA_NUM_THREADS))
    frame_time = frame_times(case)
    probe_time = probe_times(case)
    times = np.union1d(frame_time, probe_time)
    is_frame, is_probe = np.isin(times, frame_time), np.isin(times, probe_time)
    recorder = Recorder(path, case, prepared.scene, prepared.text, overwrite)
    try:
        run = Run(prepared)
        probes = []
        for batch in batches(times.size, len(prepared.scene.kind)):
            frames, entries = run.frames_at(times[batch])
            rows = np.flatnonzero(is_frame[batch])
            if rows.size:
                recorder.append(times[batch][rows], frames, rows, entries)
                progress(rows.size)
            for row in np.flatnonzero(is_probe[batch]):
                probes.append(Probe(float(times[batch][row]), one_row(frames, int(row))))
    finally:
        recorder.commit()
        if path is not None:
            recorder.file.close()
    return Outcome(run.ledger.drift(), tuple(probes), recorder.file)


def probe_times(case: Case) -> Floats:
    """Times at which the checks want to know a value [s]."""
    wanted = [case.run.t_end if v.time is None else v.time for v in case.check.value]
    return np.unique(np.array(wanted, dtype=np.float64))


def batches(n_times: int, n_bodies: int) -> Iterator[slice]:
    """Slices of times that are held together before they are written."""
    size = int(min(max(BATCH_BYTES // (n_bodies * 13 * 8), 1), BATCH_FRAMES))
    for lo in range(0, n_times, size):
        yield slice(lo, min(lo + size, n_times))


def one_row(frames: Frames, row: int) -> Frames:
    """One row of the frames."""
    position, orientation, p, L, last = frames
    one = slice(row, row + 1)
    return Frames(position[one], orientation[one], p[one], L[one], last)
