"""Goes on with the run of a file, bit for bit as if it had never stopped.

The file has the case, all that it reads, what was chosen for it, and a checkpoint. Bodies and plan
are made anew and must come out as they were; frames behind the checkpoint are computed again and
must be those that the file has. Nothing is written before all of that is known to fit.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from particlerb.case.problems import Source
from particlerb.case.reader import build
from particlerb.case.run import RunTable, frame_count
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import Floats
from particlerb.model.superblocks import own_parts
from particlerb.ranks import ALONE, Ranks, as_agreed
from particlerb.record.checked_reading import require_self_contained, text_at, trajectory_errors
from particlerb.record.checkpoint import Checkpoint, CheckpointError, read_checkpoint, states_of
from particlerb.record.output_file import DamagedError
from particlerb.record.part_recorder import PartRecorder
from particlerb.record.parts import Parts, parts_in
from particlerb.record.provenance import stored_case, versions
from particlerb.record.schema import PARAMETERS
from particlerb.record.trajectory import TrajectoryError, open_trajectory
from particlerb.record.vtkhdf import is_finished
from particlerb.record.writer import Recorder
from particlerb.record.writer_lock import InUseError
from particlerb.simulation.accuracy import prepare_again
from particlerb.simulation.frame_times import frame_times
from particlerb.simulation.outcome import Outcome, Progress, joined, of_no_body
from particlerb.simulation.run import advance, identity, share_of_rank
from particlerb.simulation.set_up_apart import prepared_apart
from particlerb.simulation.shares import attraction_of, part_of
from particlerb.simulation.whole_run import SHARED, Prepared
from particlerb.stepping.saved_arrays import Saved

_UNVERIFIED_WARNING = (
    "particlerb: warning: run.accuracy was verified until the earlier t_end only; method and step"
    " stay as they were chosen"
)
_DECISIVE = ("particlerb", "sources", "python", "numpy", "numba")  # what may change the bits


class ResumeError(Exception):
    """A run that cannot be gone on with: why, and what would be right."""


class _Pending(NamedTuple):
    """A run that can be gone on with."""

    path: Path
    prepared: Prepared
    checkpoint: Checkpoint | None  # None: from the start
    start: int  # frames that lie behind it
    n_before: int  # frames of the file that stay
    is_prolonged: bool  # whether it ends at another time than it was to
    warnings: tuple[str, ...]
    parts: Parts | None  # where the bodies lie, if these are several files


def look_at(
    path: Path,
    t_end: float | None = None,
    threads: int | None = None,
    allow_code: bool = False,
    ranks: Ranks = ALONE,
) -> _Pending:
    """What there is to do for a file; it is only read.

    Parameters
    ----------
    path : Path
        File of a run.
    t_end : float, optional
        Where to end [s]; left out, where the case says.
    threads : int, optional
        In place of those that the case says.
    allow_code : bool
        Whether code in it may be run.
    ranks : Ranks
        That share the scene; each is to look at the file.

    Raises
    ------
    ResumeError
        If it cannot be gone on with, or if nothing is left to do.
    CaseError
        If the case of the file is wrong with this end.
    FileNotFoundError, TrajectoryError
        If the file is not there, or no trajectory.
    """
    case, stepping, parts = ranks.together(lambda: _case_in(path, t_end, threads, allow_code))
    if ranks.count > 1 and parts is None:
        told = f"{path} is one file, which one process writes: continue without --mpi"
        raise as_agreed(ResumeError(told))
    prepared = prepared_apart(case, ranks) if stepping is None else None
    if prepared is None:
        prepared = ranks.together(lambda: prepare_again(to_system(case), stepping))
    hashed = identity(prepared, ranks if prepared.is_part else ALONE)
    pending = ranks.together(lambda: _looked_at(path, prepared, hashed, parts))
    if parts is None:
        return pending
    share = ranks.together(lambda: share_of_rank(prepared, ranks, hashed))
    return _from_parts(pending._replace(prepared=share), parts, ranks)


def _case_in(
    path: Path, t_end: float | None, threads: int | None, allow_code: bool
) -> tuple[Case, str | None, Parts | None]:
    """Case of a file that can be gone on with, how that was stepped for its accuracy, its parts."""
    with open_trajectory(path) as trajectory:
        file = trajectory.file
        require_self_contained(file)
        _refuse_other_version(path, _text_in(file, "versions"), _text_in(file, "git_revision"))
        if _text_in(file, "case_resolved") is None or _text_in(file, "identity") is None:
            raise ResumeError(f"{path} does not say how it was made, so it cannot be continued")
        source = stored_case(file)
        if allow_code:
            source = source._replace(files=source.files.copied(True))
        return _case_of(source, t_end, threads), _text_in(file, "stepping"), parts_in(file)


def _looked_at(path: Path, prepared: Prepared, hashed: str, parts: Parts | None) -> _Pending:
    """What there is to do, where the state behind parts is not known yet."""
    system = prepared.system
    with open_trajectory(path) as trajectory:
        file, n = trajectory.file, trajectory.n_frames
        if hashed != _text_in(file, "identity"):
            told = "its case gives other bodies or another plan than the run had"
            raise ResumeError(f"{path}: {told}: it was changed in the file; run it anew")
        n_kept = _frames_that_stay(path, trajectory.time, system.run)
        with trajectory_errors(file):
            if n_kept == frame_count(system.run) and is_finished(file, n):
                raise ResumeError(
                    f"{path} has nothing left to do: all {n} frames until"
                    f" t = {system.run.t_end!r} s are there; --t-end prolongs the run"
                )
        try:
            checkpoint = read_checkpoint(file) if n and parts is None else None
        except CheckpointError as error:
            raise ResumeError(f"{error}: it cannot be continued; run the case anew") from None
        start = checkpoint.n_frames if checkpoint else 0
        if start > n_kept:
            raise ResumeError(f"{path}: the checkpoint lies behind the frames; run the case anew")
        is_prolonged = stored_case(file).raw["run"]["t_end"] != system.run.t_end
    warnings = prepared.plan.warnings
    if is_prolonged and system.run.accuracy is not None:
        warnings = (*warnings, _UNVERIFIED_WARNING)
    return _Pending(path, prepared, checkpoint, start, n_kept, is_prolonged, warnings, parts)


def _from_parts(pending: _Pending, parts: Parts, ranks: Ranks) -> _Pending:
    """From the last state that all parts have; a kill may have left some of them ahead of it."""
    every = range(len(parts.ranges))
    is_copied = attraction_of(pending.prepared.plan) is not None
    numbers = every if is_copied else own_parts(len(every), ranks)
    looked_at = numbers or range(1)
    paths = parts.paths(pending.path)
    saved = ranks.together(lambda: [states_of(paths[k]) for k in looked_at])
    each = [set(states) for rank in ranks.gathered([list(one) for one in saved]) for states in rank]
    common = [n for n in set.intersection(*each) if n <= pending.n_before]
    if not common:
        told = "its parts have no whole checkpoint in common: it cannot be continued"
        raise as_agreed(ResumeError(f"{pending.path}: {told}; run the case anew"))
    start = max(common)

    def state_of() -> Saved:
        state = joined([states[start] for states in saved])
        return state if numbers else of_no_body(state)

    try:
        return pending._replace(checkpoint=Checkpoint(start, ranks.together(state_of)), start=start)
    except (LookupError, TypeError, ValueError) as error:
        raise ResumeError(f"{pending.path}: checkpoints of its parts do not fit: {error}") from None


def resume_pending(
    pending: _Pending, progress: Progress = lambda n: None, ranks: Ranks = ALONE
) -> Outcome:
    """Go on with a run.

    Raises
    ------
    ResumeError
        If another process writes the file.
    KeyboardInterrupt, OSError, RunError
        As in `run.advance`.
    """
    path, prepared, checkpoint, start, n_kept, is_prolonged, _, _ = pending
    system = prepared.system
    recorder: Recorder | PartRecorder
    try:
        if pending.parts is None:
            if checkpoint and any(name.startswith(f"{SHARED}.") for name in checkpoint.arrays):
                prepared = part_of(prepared, ranks)  # parts were made one file
            recorder = Recorder.reopen(path, system, start, n_kept, is_prolonged=is_prolonged)
        else:
            of_parts = path, prepared.system, pending.parts, ranks
            recorder = PartRecorder.reopen(*of_parts, start, n_kept, is_prolonged=is_prolonged)
    except InUseError:
        raise ResumeError(f"{path} is being written by another run") from None
    except DamagedError as error:
        raise ResumeError(str(error)) from None
    with THREADS.using(system.run.threads):
        return advance(prepared, recorder, checkpoint, progress, ranks)


def _text_in(file: h5py.File, name: str) -> str | None:
    """Text of /parameters; None where there is none."""
    try:
        return text_at(file, f"{PARAMETERS}/{name}")
    except TrajectoryError:
        return None


def _refuse_other_version(path: Path, stored: str | None, revision: str | None) -> None:
    """Raise ResumeError where other versions have made the file."""
    try:
        made: Any = json.loads(stored or "")
    except ValueError:
        made = None
    if not isinstance(made, dict):
        raise ResumeError(f"{path} does not say which versions made it, so it cannot be continued")
    now = versions()
    for name in _DECISIVE:
        if name in made and name in now and made[name] == now[name]:
            continue
        if name == "sources":
            at = f" (git revision {revision[:12]})" if revision else ""
            other = f"other sources of particlerb {made.get('particlerb')}{at}"
        else:
            other = f"{name} {made.get(name)}, and this is {now.get(name)}"
        told = f"{path} was made with {other}: it would not continue bit for bit"
        raise ResumeError(f"{told}; install what it was made with, or run the case anew")


def _case_of(source: Source, t_end: float | None, threads: int | None) -> Case:
    """Case of a file, with another end or other threads if they are given."""
    options = {"t_end": t_end, "threads": threads}
    changes = {key: value for key, value in options.items() if value is not None}
    run = source.raw.get("run")
    raw = {**source.raw, "run": {**run, **changes}} if isinstance(run, dict) else source.raw
    return build(source._replace(raw=raw), ())


def _frames_that_stay(path: Path, times: Floats, run: RunTable) -> int:
    """Number of frames that a run has too: not the one at an earlier t_end.

    Raises
    ------
    ResumeError
        If it ends before them.
    """
    total = frame_count(run)
    if len(times) > total or times[-1:].max(initial=0.0) > run.t_end:
        told = f"{path} has frames until t = {float(times[-1])!r} s"
        raise ResumeError(f"{told}, and cannot end before them at t = {run.t_end!r} s")
    is_same = times == frame_times(run, 0, total)[: len(times)]
    return len(times) if is_same.all() else int(np.argmin(is_same))
