"""Variants in a worker: runs without a file, one by one or in a batch, and their rows."""

import os
import signal
import threading
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
from particlerb.plan.remove_overlaps import remove_overlaps
from particlerb.simulation.accuracy import prepare_accurately, prepare_again
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.run import prepare, run_unrecorded
from particlerb.simulation.whole_run import Prepared, RunError
from particlerb.sweeping.rows import Row, asking, failed
from particlerb.sweeping.together import rows_of, rows_together
from particlerb.sweeping.validity import courses, displaced, valid_until


class Task(NamedTuple):
    """Variants that one worker runs, one after the other or in a batch."""

    numbers: tuple[int, ...]
    values: tuple[tuple[Any, ...], ...]  # of the axes, for each
    paths: tuple[Path, ...]  # of the axes
    source: Source  # of the case that they are variants of
    asked: tuple[SweepValue, ...]
    is_batch: bool = False
    attempt: int = 0
    valid_within: float | None = None  # share of a change, see [sweep]


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
                return rows_together(task.numbers, batch_of(task), task.asked, task.valid_within)
        except (CaseError, RunError, WorldsDifferError, ArithmeticError, ValueError):
            pass  # each alone says what is wrong
    rows = []
    for number, values in zip(task.numbers, task.values, strict=True):
        try:
            raw = with_values(task.source.raw, task.paths, values)
            rows.append(_row(number, task.source._replace(raw=raw), task))
        except (CaseError, RunError, ArithmeticError, ValueError) as error:
            lines = str(error).splitlines() or [type(error).__name__]
            rows.append(failed(number, lines[0]))
    return rows


def batch_of(task: Task) -> System:
    """All variants of a task as worlds of one system, twice where each has a twin.

    Raises as `side_by_side`.
    """
    times = 1 if task.valid_within is None else 2
    return side_by_side(task.source, task.paths, task.values * times)


def _row(number: int, source: Source, task: Task) -> Row:
    """Run a variant, and its twin if one is asked for."""
    asked, share = task.asked, task.valid_within
    start = asking(to_system(build(source, ())), asked, share is not None)
    is_free = start.run.accuracy is None
    prepared = prepare(start, describes=False) if is_free else prepare_accurately(start)
    run, until = _ran(prepared), None
    if share is not None:
        twin = displaced(remove_overlaps(start), prepared.plan)
        other = _ran(prepare_again(twin, prepared.parameters.get("stepping")))
        pairs = zip(courses(asked, *run), courses(asked, *other), strict=True)
        until = valid_until(run[1], pairs, share)
    return rows_of((number,), run[0], asked, run[1], until)[0]


def _ran(prepared: Prepared) -> tuple[System, Outcome]:
    """Run on one thread; the system, and what its run left."""
    system = prepared.system.with_run(threads=1)
    return system, run_unrecorded(prepared._replace(system=system))
