"""The Python entry: run a case or go on with it, get its trajectory."""

import logging
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np

from particlerb.case.reader import CaseSource, load
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.files import number_of, path_of
from particlerb.model.balance import Entries
from particlerb.record.trajectory import Trajectory, open_trajectory
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.resume import look_at, resume_pending
from particlerb.simulation.run import run_prepared
from particlerb.simulation.run_warnings import lost_energy, remedy_of, run_warnings, told_of
from particlerb.simulation.whole_run import Prepared, Run, RunError

_LOG: Final = logging.getLogger(__name__)
_NUMBER: Final = re.compile(r"(?<![\w\[])(?<!\w[.-])\d[\d.e+-]*(?![\w\]])")  # no part of a name


def prepared_from(case: CaseSource, overrides: Sequence[str], allow_code: bool) -> Prepared:
    """A case made ready to run; warnings of its plan are logged. Raises as `run`."""
    prepared = prepare_accurately(to_system(load(case, overrides, allow_code)))
    log_warnings(prepared.plan.warnings)
    return prepared


def log_warnings(warnings: Sequence[str], known: frozenset[str] = frozenset()) -> frozenset[str]:
    """Let `logging` have warnings of kinds that are not known; the kinds of all of them."""
    for warning in warnings:
        if kind_of(warning) not in known:
            _LOG.warning(warning)
    return frozenset(map(kind_of, warnings))


def kind_of(warning: str) -> str:
    """A warning without its numbers, which each step of a control loop may change."""
    return _NUMBER.sub("", warning)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the balance
def warn_of_lost_energy(run: Run, time: float, known: Entries | None) -> Entries | None:
    """Log that the energy errs by much, at the end [s], or that steps were too long.

    Its balance there; None where that is not finite.
    """
    if known is None:
        with suppress(RunError), THREADS.using(run.system.run.threads):
            _, entries, error = run.frames_at(np.array([time]), np.zeros(1, np.bool_))
            known = entries if error is None else None
    told = [tension] if (tension := run.tension()) else []
    if known is not None:
        _, remedy = remedy_of(run.system.run, run.groups)
        told = [*lost_energy(remedy, run.drift()), *told]
    log_warnings(told_of(told))
    return known


def run(
    case: CaseSource,
    output: str | Path | None = None,
    *,
    overwrite: bool = False,
    overrides: Sequence[str] = (),
    allow_code: bool = False,
) -> Trajectory:
    """Run a case; its warnings go to `logging`, which shows them if nobody configures it.

    Parameters
    ----------
    case : path, str, mapping or Case
        A text may be the name of an example too. A mapping has the keys of a case file; initial
        values may be arrays, a row per body.
    output : path, optional
        File to write; left out, the trajectory is kept in memory.
    overwrite : bool
        Whether an existing file may be replaced.
    overrides : sequence of str
        `"run.dt=1e-4"`: set before the case is checked.
    allow_code : bool
        Whether Python code that the case names may be run, with the rights of this program.

    Returns
    -------
    Trajectory
        Open; close it, or use it in a `with` statement.

    Raises
    ------
    CaseError
        With all problems of the case.
    TypeError
        If an argument is none of these.
    FileExistsError, OSError
        Of the file.
    RunError
        If the run fails; the frames until then are in the file.
    """
    path = None if output is None else path_of(output, "output")
    prepared = prepared_from(case, overrides, allow_code)
    outcome = run_prepared(prepared, path, overwrite)
    log_warnings(run_warnings(prepared, outcome))
    return open_trajectory(path) if path else Trajectory(outcome.file)


def resume(path: str | Path, t_end: float | None = None, *, allow_code: bool = False) -> Trajectory:
    """Go on with a run that was killed, interrupted, or that is to end later; bit for bit.

    Parameters
    ----------
    path : path
        File of the run; it grows.
    t_end : float, optional
        Where to end [s]; left out, where its case says.
    allow_code : bool
        Whether Python code in the file may be run, with the rights of this program.

    Returns
    -------
    Trajectory
        Open; close it, or use it in a `with` statement.

    Raises
    ------
    ResumeError
        If it cannot go on: why.
    CaseError
        If the case is wrong with this end.
    TypeError
        If an argument is none of these.
    FileNotFoundError, TrajectoryError, OSError
        Of the file.
    RunError
        If the run fails; the frames until then are in the file.
    """
    file = path_of(path, "what is resumed")
    until = None if t_end is None else number_of(t_end, "t_end")
    pending = look_at(file, until, allow_code=allow_code)
    log_warnings(pending.warnings)
    log_warnings(run_warnings(pending.prepared, resume_pending(pending)))
    return open_trajectory(file)
