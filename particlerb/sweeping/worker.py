"""Variants in a worker: runs without a file, one by one or in a batch, and their rows."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.output import Asked
from particlerb.case.overrides import with_value
from particlerb.case.problems import CaseError, Path, Source
from particlerb.case.reader import build
from particlerb.case.side_by_side import side_by_side
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError
from particlerb.plan.joints import joints_of
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.checks import joint_quantity, limits, quantity
from particlerb.simulation.impulse_values import impulse_quantity
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.run import run_unrecorded
from particlerb.simulation.whole_run import RunError
from particlerb.sweeping.rows import Row, asked_as_checks, failed
from particlerb.sweeping.together import rows_together


class Task(NamedTuple):
    """Variants that one worker runs, one after the other or in a batch."""

    numbers: tuple[int, ...]
    values: tuple[tuple[Any, ...], ...]  # of the axes, for each
    paths: tuple[Path, ...]  # of the axes
    source: Source  # of the case that they are variants of
    asked: tuple[Asked, ...]
    is_batch: bool = False
    attempt: int = 0

    def raw(self, k: int) -> Any:
        """Data of variant k of these."""
        changed: Any = self.source.raw
        for path, value in zip(self.paths, self.values[k], strict=True):
            changed = with_value(changed, path, value)
        return changed


def start_worker() -> None:
    """One thread, as there is a worker on every core; the driver alone hears of Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    driver = multiprocessing.parent_process()
    if driver is not None:
        threading.Thread(target=_end_after, args=(driver,), daemon=True).start()
    THREADS.use(1)


def _end_after(driver: Any) -> None:
    """End this process where the one that started it is gone: a killed driver leaves nobody."""
    driver.join()
    os._exit(1)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the frames, and the row
def work(task: Task) -> list[Row]:
    """Rows of a task; a variant that fails fails alone."""
    if task.is_batch and len(task.numbers) > 1:
        try:
            return rows_together(task.numbers, batch_of(task), task.asked)
        except (CaseError, RunError, WorldsDifferError, ArithmeticError, ValueError):
            pass  # each alone says what is wrong
    rows = []
    for k, number in enumerate(task.numbers):
        try:
            rows.append(_row(number, task.source._replace(raw=task.raw(k)), task.asked))
        except (CaseError, RunError, ArithmeticError, ValueError) as error:
            lines = str(error).splitlines() or [type(error).__name__]
            rows.append(failed(number, lines[0]))
    return rows


def batch_of(task: Task) -> System:
    """All variants of a task as worlds of one system; raises as `side_by_side`."""
    return side_by_side(task.source, task.paths, task.values)


def _row(number: int, source: Source, asked: Sequence[Asked]) -> Row:
    """Run a variant."""
    system = to_system(build(source, ()))
    check = system.check.model_copy(update={"value": asked_as_checks(asked)})
    prepared = prepare_accurately(system._replace(check=check))
    system = prepared.system.with_run(threads=1)
    outcome = run_unrecorded(prepared._replace(system=system))
    missed = sum(not one.holds for one in limits(check, outcome.drift))
    values = [x for one in asked for x in _found(one, system, outcome)]
    return Row(number, "done", outcome.drift.energy, missed, tuple(values))


def _found(asked: Asked, system: System, outcome: Outcome) -> list[float]:
    """Numbers of a value that is asked for."""
    time = system.run.t_end if asked.time is None else asked.time
    probe = next(probe for probe in outcome.probes if probe.time == time)
    if asked.body is not None:
        bodies = system.names.find(asked.body)
        found = [quantity(asked, system, int(b), probe.frame) for b in bodies]
    elif asked.joint is None:
        found = [impulse_quantity(asked, probe.tally)]
    else:
        setup = joints_of(system)
        assert setup is not None
        found = [joint_quantity(asked, setup, probe.joints)]
    return [x for one in found for x in np.ravel(one).tolist()]
