"""Variants in a worker: runs without a file, one by one or in a batch, and their rows."""

import os
import signal
import threading
from collections.abc import Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.output import SweepValue
from particlerb.case.overrides import with_values
from particlerb.case.problems import CaseError, Path, Source
from particlerb.case.reader import build
from particlerb.case.side_by_side import side_by_side
from particlerb.case.to_system import to_system
from particlerb.compiled.helper import no_collection
from particlerb.compiled.threads import THREADS
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.run import prepare, run_unrecorded
from particlerb.simulation.whole_run import RunError
from particlerb.sweeping.rows import Row, asking, failed
from particlerb.sweeping.together import rows_of, rows_together


class Task(NamedTuple):
    """Variants that one worker runs, one after the other or in a batch."""

    numbers: tuple[int, ...]
    values: tuple[tuple[Any, ...], ...]  # of the axes, for each
    paths: tuple[Path, ...]  # of the axes
    source: Source  # of the case that they are variants of
    asked: tuple[SweepValue, ...]
    is_batch: bool = False
    attempt: int = 0


def start_worker(driver: Connection) -> None:
    """One thread, as there is a worker on every core; the driver alone hears of Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(driver,), daemon=True).start()
    THREADS.use(1)


def _end_after(driver: Connection) -> None:
    """End this process where the other end of a pipe is closed, or the process that has it ends."""
    wait([driver])
    os._exit(1)


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the frames, and the row
def work(task: Task) -> list[Row]:
    """Rows of a task; a variant that fails fails alone."""
    if task.is_batch and len(task.numbers) > 1:
        try:
            with no_collection():  # it would look at the records of all variants again and again
                return rows_together(task.numbers, batch_of(task), task.asked)
        except (CaseError, RunError, WorldsDifferError, ArithmeticError, ValueError):
            pass  # each alone says what is wrong
    rows = []
    for number, values in zip(task.numbers, task.values, strict=True):
        try:
            raw = with_values(task.source.raw, task.paths, values)
            rows.append(_row(number, task.source._replace(raw=raw), task.asked))
        except (CaseError, RunError, ArithmeticError, ValueError) as error:
            lines = str(error).splitlines() or [type(error).__name__]
            rows.append(failed(number, lines[0]))
    return rows


def batch_of(task: Task) -> System:
    """All variants of a task as worlds of one system; raises as `side_by_side`."""
    return side_by_side(task.source, task.paths, task.values)


def _row(number: int, source: Source, asked: Sequence[SweepValue]) -> Row:
    """Run a variant."""
    system = asking(to_system(build(source, ())), asked)
    is_free = system.run.accuracy is None
    prepared = prepare(system, describes=False) if is_free else prepare_accurately(system)
    system = prepared.system.with_run(threads=1)
    outcome = run_unrecorded(prepared._replace(system=system))
    return rows_of((number,), system, asked, outcome)[0]
