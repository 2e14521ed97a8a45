"""The loop: plan, segments, frames, recorder.

Groups advance one after the other through a batch of times; then the batch is complete, the energy
balance is taken and the recorder appends it. Frames and times that only a check asks for change
nothing in the motion, so a run can be prolonged, or recorded more finely, without changing a bit.
"""

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.to_system import to_case
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.balance import EnergyBalance, Entries, Totals, totals
from particlerb.model.bodies import taken
from particlerb.model.state import Frames, State, as_frame, room_for
from particlerb.model.system import System
from particlerb.plan.describe import describe
from particlerb.plan.joints import asked_of_joints, assembled, joints_of
from particlerb.plan.make_plan import make_plan
from particlerb.plan.merging import merged
from particlerb.plan.remove_overlaps import remove_overlaps
from particlerb.plan.segments import Plan
from particlerb.record.checkpoint import Checkpoint
from particlerb.record.frame_values import NewFrames
from particlerb.record.layout import tables_of
from particlerb.record.memory import Memory
from particlerb.record.provenance import texts_of
from particlerb.record.writer import OtherFrameError, Recorder
from particlerb.simulation.frame_times import Batch, batches
from particlerb.simulation.group_run import (
    GroupRun,
    counted,
    initial_energies,
    own_failure,
    record_all,
    tally_of,
)
from particlerb.simulation.impulse_values import impulse_fields
from particlerb.simulation.joint_values import (
    JointValues,
    LoadReader,
    at_row,
    broken_joints,
    labels_of,
    recorded_values,
    refuse_checks,
    room_for_values,
)
from particlerb.simulation.outcome import Outcome, Progress, Reached, TreeError
from particlerb.simulation.probes import Probe, restored_probes, saved_probes
from particlerb.simulation.state_checks import StateChecks
from particlerb.stepping.motion import MotionError
from particlerb.stepping.saved_arrays import Saved, under, within


class RunError(Exception):
    """A run that failed: what, where, when."""


class Prepared(NamedTuple):
    """A system made ready to run."""

    system: System
    plan: Plan
    text: str  # the plan in words
    parameters: Mapping[str, str] = MappingProxyType({})  # more for /parameters of the file


def made_ready(system: System) -> System:
    """The system with its bodies where they begin: apart, and where all joints fit.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    system = assembled(remove_overlaps(system))
    refuse_checks(system)
    return system


def prepare(system: System) -> Prepared:
    """Bodies and plan of a system.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    system = made_ready(system)
    plan = make_plan(system)
    return Prepared(system, plan, describe(system, plan))


class Run:
    """A prepared system on its way."""

    def __init__(self, prepared: Prepared) -> None:
        self.system, plan = prepared.system, prepared.plan
        self.moving = merged(self.system)  # with bodies that move as one
        self.gravity = self.system.acceleration
        initial = as_frame(self.moving.bodies, self.moving.state)
        self.last = initial.last
        self.single: tuple[Frames, Frames] | None = None  # room, and its first row, of `pose_at`
        self.room = initial  # used again and again: fresh memory costs more than what fills it
        self.checks = StateChecks(self.moving, plan)
        self.group_runs = [
            GroupRun(group, taken(self.moving.state, group.members)) for group in plan.groups
        ]
        self.counted = counted(plan.groups, self.moving.bodies)
        energies = initial_energies(self.group_runs, initial)
        self.balance = EnergyBalance(self.totals_of(initial, *energies))
        self.before = np.zeros(7)  # booked before the last restart,
        self.turned_over_before = 0.0  # and gross work of contacts [J]

        asks = self.system.joint and asked_of_joints(self.system)
        self.setup = joints_of(self.system) if asks else None
        self.loads = LoadReader.of(self.moving) if self.setup is not None else None
        self.joints: JointValues | None = None  # in rows of the last frames, where asked for
        self.tallies: dict[int, Floats] = {}  # what was counted of impulses, in these rows
        self.n_frames = 0  # that lie behind
        self.probes: list[Probe] = []

    def totals_of(self, frames: Frames, potential: Floats, kinetic: Floats) -> Totals:
        """Totals of frames; the energies are those beside the bodies' own."""
        n_worlds = self.system.n_worlds
        return totals(frames, self.counted, self.gravity, potential, kinetic, n_worlds)

    def finish(self, time: float) -> State:
        """State of all bodies at the time of the last frame [s]; the run ends, or restarts."""
        whole = State(*(values.copy() for values in self.moving.state))
        for group_run in self.group_runs:
            state, booked = group_run.finish(time)
            self.before += booked
            for values, own in zip(whole, state, strict=True):
                values[:, group_run.plan.members] = own
        self.turned_over_before += sum(t.turned_over() for t in self.group_runs)
        return whole if self.moving.merging is None else self.moving.merging.apart(whole)

    def restart(self, system: System, plan: Plan, state: State, last: Entries) -> None:
        """Go on from a state, where the run was finished, by another plan.

        What changes the energy and the momenta is booked: `last` are the entries before it.
        Contacts keep what they kept where their group stays the same.
        """
        known = {t.plan.members.tobytes(): t.motion for t in self.group_runs}
        self.system, self.gravity, self.moving = system, system.acceleration, merged(system)
        if self.moving.merging is not None:
            state = self.moving.merging.together(state)
        self.checks = StateChecks(self.moving, plan)
        self.group_runs = [
            GroupRun(group, taken(state, group.members), known.get(group.members.tobytes()))
            for group in plan.groups
        ]
        self.counted = counted(plan.groups, self.moving.bodies)
        frame = as_frame(self.moving.bodies, state)
        energies = initial_energies(self.group_runs, frame)
        now = self.totals_of(frame, *energies)
        self.before[0] += (now.kinetic_energy + now.potential_energy - last.energy)[-1]
        self.before[1:4] += (now.linear_momentum - last.linear_momentum)[-1]
        self.before[4:] += (now.angular_momentum - last.angular_momentum)[-1]

    def checkpoint(self) -> Saved:
        """All that a run that goes on from here has to know, beside its system."""
        saved = {"last": self.last.copy()} | under("ledger", self.balance.checkpoint())
        for k, group_run in enumerate(self.group_runs):
            saved |= under(f"group.{k}", group_run.checkpoint())
        return saved | saved_probes(self.probes)

    def restore(self, n_frames: int, saved: Saved) -> None:
        """Go on behind so many frames from what was saved then."""
        self.n_frames = n_frames
        self.last[:] = saved["last"]
        self.balance.restore(within("ledger", saved))
        for k, group_run in enumerate(self.group_runs):
            group_run.restore(within(f"group.{k}", saved))
        self.probes = restored_probes(saved, self.last)

    def flown(self) -> float | None:
        """Share of body-steps of touching bodies that were saved by closed forms."""
        saved, steps = np.sum([one.motion.flown for one in self.group_runs], axis=0)
        return float(saved / steps) if steps else None

    def swing(self) -> float:
        """Fastest swing of bodies on their contacts that was seen, ω dt [rad]."""
        motions = [one.motion for one in self.group_runs]
        return max((motion.contact_frequency * motion.dt for motion in motions), default=0.0)

    def tree_error(self) -> TreeError | None:
        """What the tree of the attraction has erred at frames; None where none was asked for."""
        runs = [run for run in self.group_runs if run.angle]
        fitted = [TreeError(r.angle, r.tree_error, r.terms.tree_accuracy) for r in runs]
        return fitted[0] if fitted else None  # bodies that attract each other are one group

    def frames_at(self, times: Floats, is_frame: Bools) -> tuple[Frames, Entries, RunError | None]:
        """States at ascending times, not before those asked for earlier, and their energy balance.

        Where a state is not finite, or a torque has turned a rod about its own axis, they end
        before it, and the error says so. The next call writes over the frames.
        """
        if times.size > len(self.room.position):
            self.room = room_for(times.size, len(self.system.kind), self.last)
            if self.moving.merging is not None:
                self.moving.merging.clear(self.room)
        frames = self.room.rows(slice(times.size))
        frames.is_frame[:] = is_frame
        if self.setup is not None:
            self.joints = room_for_values(self.setup, times.size)
        try:
            booked, energies = record_all(self.group_runs, times, frames, self.joints)
        except Exception as failure:
            if words := own_failure(failure, self.group_runs):
                raise RunError(words) from None
            raise
        self.tallies = next((one.tallies for one in self.group_runs if one.tallies), {})
        booked += self.before
        now = self.totals_of(frames, *energies)
        sizes = now.kinetic_energy + now.potential_energy + now.momentum_size + now.spin_size
        is_finite = bool(np.isfinite(sizes).all())
        sound, problem = self.checks.sound_frames(times, frames, is_finite, self.group_runs)
        error = RunError(problem) if problem else None
        if sound < times.size:
            frames = frames.rows(slice(sound))
            now = self.totals_of(frames, *(e[:sound] for e in energies))
        turned_over = self.turned_over_before + sum(t.turned_over() for t in self.group_runs)
        entries = self.balance.enter(now, booked[:sound], turned_over)
        if self.moving.merging is not None:
            frames = self.moving.merging.shown(frames)
        if self.loads is not None and self.joints is not None:
            self.loads.read(times[:sound], frames, self.joints)
        return frames, entries, error

    def pose_at(self, time: float) -> tuple[Frames, RunError | None]:
        """States at a time [s], not before those asked for earlier, alone: nothing is booked.

        Where one is not finite, or a torque has turned a rod about its own axis, the error says so.
        The next call writes over the frame.
        """
        if self.single is None or self.single[0] is not self.room:
            self.single = self.room, self.room.rows(slice(1))
        frames = self.single[1]
        frames.is_frame[0] = True
        try:
            for group_run in self.group_runs:
                group_run.pose_at(time, frames)
        except Exception as failure:
            if words := own_failure(failure, self.group_runs):
                raise RunError(words) from None
            raise
        is_finite = math.isfinite(sum(np.add.reduce(values, axis=None) for values in frames[:4]))
        problem = ""
        if not is_finite or self.checks.rods.size:
            times = np.array([time])
            _, problem = self.checks.sound_frames(times, frames, is_finite, self.group_runs)
        if self.moving.merging is not None:
            frames = self.moving.merging.shown(frames)
        return frames, RunError(problem) if problem else None

    def to_record(self, times: Floats, frames: Frames, rows: Ints, entries: Entries) -> NewFrames:
        """What is recorded of rows of the last frames, which are at these times [s]."""
        fields = recorded_values(self.joints, self.system.output.fields, rows)
        fields |= impulse_fields(self.tallies, rows.tolist())
        asked = next((t.contacts for t in self.group_runs if t.contacts), {})
        contacts = [asked[row] for row in rows.tolist()] if asked else []
        return NewFrames(times[rows], frames, rows, entries, contacts, fields)


def run_prepared(
    prepared: Prepared,
    path: Path | None,
    overwrite: bool = False,
    progress: Progress = lambda n: None,
) -> Outcome:
    """Run a prepared system into a file.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.
    path : Path or None
        Where to; None for memory.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : callable
        Called with what was reached, after some frames.

    Raises
    ------
    FileExistsError
        If there is a file that may not be replaced.
    OSError
        If the file cannot be made, or written: what was committed stays.
    RunError
        If the run fails; the frames until then are committed.
    """
    system = prepared.system
    own = {"plan": prepared.text, "identity": identity(prepared), **prepared.parameters}
    content = tables_of(system, labels_of(system)) | texts_of(system, own)
    recorder: Recorder | Memory = Memory(system, content)
    if path is not None:
        recorder = Recorder(path, system, content, overwrite)
    with THREADS.using(system.run.threads):
        return advance(prepared, recorder, None, progress)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # it is found in the frames
def advance(
    prepared: Prepared,
    recorder: Any,
    checkpoint: Checkpoint | None,
    progress: Progress,
) -> Outcome:
    """Run a prepared system to its end, from its start or from a checkpoint.

    Raises
    ------
    KeyboardInterrupt
        If a signal has asked for the end; behind a whole frame, the first time.
    OSError, RunError
        As in `run_prepared`.
    """
    try:
        run = Run(prepared)
        if checkpoint is None:
            recorder.save_checkpoint(run.checkpoint)
        else:
            try:
                run.restore(checkpoint.n_frames, dict(checkpoint.arrays))
            except (LookupError, TypeError, ValueError) as reason:
                raise RunError(f"the checkpoint does not fit: {reason}") from None
        for batch in batches(prepared.system, run.n_frames):
            reached, error = _one_batch(run, recorder, batch)
            progress(reached)
            if error is not None:
                raise error
            if batch.is_whole_end:
                recorder.save_checkpoint(run.checkpoint)
            recorder.commit_if_due(None if batch.is_odd else run.checkpoint)
            if THREADS.is_ending:
                THREADS.is_ending = False
                if not batch.is_odd:
                    recorder.save_checkpoint(run.checkpoint)
                raise KeyboardInterrupt
    except (MotionError, FloatingPointError, OtherFrameError) as problem:
        raise RunError(str(problem)) from None
    finally:
        recorder.finish()
    return Outcome(
        run.balance.drift(run.counted, run.moving.state.com, prepared.system.run.t_end),
        tuple(run.probes),
        recorder.file,
        run.flown(),
        run.swing(),
        run.tree_error(),
        tally_of(run.group_runs),
        broken_joints(run.setup, run.joints),
    )


def _one_batch(run: "Run", recorder: Any, batch: Batch) -> tuple[Reached, RunError | None]:
    """Compute and append a batch; what it reached, and what was wrong behind that."""
    frames, entries, error = run.frames_at(batch.times, batch.is_frame)
    sound = len(frames.position)
    rows = np.flatnonzero(batch.is_frame[:sound])
    if rows.size:
        recorder.append(run.to_record(batch.times, frames, rows, entries))
    for row in np.flatnonzero(batch.is_probe[:sound]):
        values = None if run.joints is None else at_row(run.joints, int(row))
        probed = frames.copied_row(int(row)), values, run.tallies.get(int(row))
        run.probes.append(Probe(float(batch.times[row]), *probed))
    run.n_frames += rows.size
    told = (batch.times[:sound], *entries[2:5:2])  # of several worlds, the largest
    last = (np.max(values[-1]) if sound else np.nan for values in told)
    return Reached(rows.size, *map(float, last)), error


def identity(prepared: Prepared) -> str:
    """Hash of what decides the motion: the records without its end and threads, bodies, plan."""
    system, plan = prepared.system, prepared.plan
    found = hashlib.sha256(
        to_case(system).model_dump_json(exclude={"run": {"t_end", "threads"}}).encode()
    )
    for values in (*system.bodies, *system.state, *system.particles, system.kind):
        found.update(np.ascontiguousarray(values).tobytes())
    for group in plan.groups:
        for s in group.segments:
            found.update(repr((s.start, s.stop, s.method, s.dt, s.tolerance)).encode())
        found.update(group.members.tobytes())
    return found.hexdigest()
