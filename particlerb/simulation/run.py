"""The loop: plan, segments, frames, recorder.

Groups advance one after the other through a batch of times; then the batch is complete, the energy
balance is taken and the recorder appends it. Frames and times that only a check asks for change
nothing in the motion, so a run can be prolonged, or recorded more finely, without changing a bit.
"""

import hashlib
from pathlib import Path
from typing import Any, Final

import numpy as np

from particlerb.case.to_system import to_case
from particlerb.compiled.threads import THREADS
from particlerb.model.superblocks import Range, parts_of, superblocks
from particlerb.model.system import System
from particlerb.plan.describe import describe
from particlerb.plan.joints import assembled
from particlerb.plan.make_plan import make_plan
from particlerb.plan.remove_overlaps import remove_overlaps
from particlerb.ranks import ALONE, Ranks, as_agreed, end_all, ending_all
from particlerb.record.checkpoint import Checkpoint
from particlerb.record.frame_values import FrameError
from particlerb.record.layout import tables_of
from particlerb.record.memory import Memory, Nowhere
from particlerb.record.part_recorder import PartRecorder
from particlerb.record.provenance import texts_of
from particlerb.record.writer import Recorder
from particlerb.simulation.frame_times import BATCH_FRAMES, Batch, batches
from particlerb.simulation.group_run import tally_of
from particlerb.simulation.joint_values import at_row, broken_joints, labels_of, refuse_checks
from particlerb.simulation.outcome import Outcome, Probe, Progress, Reached
from particlerb.simulation.run_warnings import remedy_of
from particlerb.simulation.shares import part_of
from particlerb.simulation.whole_run import Prepared, Run, RunError

_NOT_OF_MOTION: Final = {"run": {"t_end", "threads"}, "output": {"log"}}


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


def prepare(system: System, describes: bool = True) -> Prepared:
    """Bodies and plan of a system, which nobody may want described.

    Raises
    ------
    CaseError
        With all problems that show here.
    """
    system = made_ready(system)
    plan = make_plan(system)
    return Prepared(system, plan, describe(system, plan) if describes else "")


def run_prepared(
    prepared: Prepared,
    path: Path | None,
    overwrite: bool = False,
    progress: Progress = lambda n: None,
    ranks: Ranks = ALONE,
) -> Outcome:
    """Run a prepared system into a file, or on ranks into a file in parts.

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
    ranks : Ranks
        That share the scene; each gives the whole of it, or its part. ALONE: it is not shared.

    Raises
    ------
    FileExistsError
        If there is a file that may not be replaced.
    OSError
        If the file cannot be made, or written: what was committed stays.
    RunError
        If the run fails; the frames until then are committed.
    """
    if ranks is not ALONE:
        prepared = share_of_rank(prepared, ranks)
    system = prepared.system
    content, hashed = content_of(prepared, ranks)
    recorder: Recorder | Memory | PartRecorder
    if path is None:
        recorder = Memory(system, content)
    elif ranks is ALONE:
        recorder = Recorder(path, system, content, overwrite)
    else:
        first = path, system, content, parts_of(system.n_of_scene)
        recorder = PartRecorder.create(*first, run=hashed, ranks=ranks, overwrite=overwrite)
    del content
    with THREADS.using(system.run.threads):
        return advance(prepared, recorder, None, progress, ranks)


def share_of_rank(prepared: Prepared, ranks: Ranks, hashed: str = "") -> Prepared:
    """The share of a rank in a prepared system, which then need not be kept; raises as `part_of`.

    Itself where it has been set up apart, or is such a share. `hashed`: its identity, if known.
    """
    if prepared.is_part or prepared.hash_of_scene:
        return prepared
    _, remedy = remedy_of(prepared.system.run, prepared.plan.groups)
    hashed = hashed or identity(prepared)
    return part_of(prepared, ranks)._replace(hash_of_scene=hashed, remedy=remedy)


def content_of(prepared: Prepared, ranks: Ranks = ALONE) -> tuple[dict[str, Any], str]:
    """What a file has that does not change, on the rank that writes it, and the identity in it."""
    system = prepared.system
    hashed = prepared.hash_of_scene or identity(prepared, ranks if prepared.is_part else ALONE)
    if ranks.number > 0:
        return {}, hashed
    texts = {"plan": prepared.text, "identity": hashed, **prepared.parameters}
    return tables_of(system, labels_of(system)) | texts_of(system, texts), hashed


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # it is found in the frames
def advance(
    prepared: Prepared,
    recorder: Any,
    checkpoint: Checkpoint | None,
    progress: Progress,
    ranks: Ranks = ALONE,
    first_batch: int = 0,
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
        run = Run(prepared, ranks)
        state: Any = run.checkpoints if isinstance(recorder, PartRecorder) else run.checkpoint
        if checkpoint is None:
            recorder.save_checkpoint(state)
        else:
            ranks.together(lambda: _restore(run, checkpoint))
        for batch in batches(prepared.system, run.n_frames, ranks, first_batch, run.passed):
            reached, error = _one_batch(run, recorder, batch)
            progress(reached)
            if error is not None:
                raise as_agreed(error)
            if batch.is_whole_end:
                recorder.save_checkpoint(state)
            recorder.commit_if_due(None if batch.is_odd else state)
            if any(ranks.gathered(THREADS.is_ending)):
                THREADS.is_ending = False
                if not batch.is_odd:
                    recorder.save_checkpoint(state)
                raise as_agreed(KeyboardInterrupt())
    except BaseException as problem:
        end_all(ranks, problem)
        with ending_all(ranks):
            recorder.finish()
        if isinstance(problem, FrameError):
            raise RunError(str(problem)) from None
        raise
    with ending_all(ranks):
        recorder.finish()
    return Outcome(
        run.drift(),
        tuple(run.probes),
        recorder.file,
        run.flown(),
        run.contact_turn(),
        run.tree_error(),
        tally_of(run.group_runs),
        broken_joints(run.setup, run.joints),
        run.tension(),
        run.passed,
    )


def _restore(run: Run, checkpoint: Checkpoint) -> None:
    """Go on from a checkpoint; RunError where it does not fit."""
    try:
        run.restore(checkpoint.n_frames, dict(checkpoint.arrays))
    except (LookupError, TypeError, ValueError) as reason:
        raise RunError(f"the checkpoint does not fit: {reason}") from None


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
    time, energy, lost = (float(np.max(values[-1])) if sound else np.nan for values in told)
    counts = [one.motion.count_contacts() for one in run.group_runs if run.ranks is ALONE]
    known = [n for n in counts if n is not None]
    return Reached(rows.size, time, energy, lost, sum(known) if known else None), error


def identity(prepared: Prepared, ranks: Ranks = ALONE) -> str:
    """Hash of what decides the motion: the records without its end, threads and log, bodies, plan.

    Ranks that have set up their own bodies find it together.
    """
    system = prepared.system
    hasher = hashlib.sha256(to_case(system).model_dump_json(exclude=_NOT_OF_MOTION).encode())
    for values in system.particles:
        hasher.update(np.ascontiguousarray(values).tobytes())
    own = [_digest(prepared, of) for of in superblocks(system.n_bodies)]
    for digests in ranks.gathered(own):
        hasher.update(b"".join(digests))
    return hasher.hexdigest()


def _digest(prepared: Prepared, of: Range) -> bytes:
    """Hash of some bodies and their plan."""
    system, hasher = prepared.system, hashlib.sha256()
    for values in (*system.bodies, *system.state, system.kind):
        hasher.update(np.ascontiguousarray(values[..., of.first : of.stop]).tobytes())
    planned = []
    for group in prepared.plan.groups:
        here = group.members[(group.members >= of.first) & (group.members < of.stop)]
        planned += [(int(here.min()), here, group.segments)] if here.size else []
    for _, members, segments in sorted(planned, key=lambda one: one[0]):
        for s in segments:
            hasher.update(repr((s.start, s.stop, s.method, s.dt, s.tolerance)).encode())
        hasher.update((members + prepared.first).tobytes())
    return hasher.digest()


def run_unrecorded(prepared: Prepared) -> Outcome:
    """Run a prepared system for its drift and its probes alone; raises as `run_prepared`."""
    with THREADS.using(prepared.system.run.threads):
        return advance(prepared, Nowhere(), None, lambda reached: None, first_batch=BATCH_FRAMES)
