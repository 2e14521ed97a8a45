"""Runs the variants of a case on an executor and keeps their rows in a table.

A dead worker costs its tasks an attempt; a case that kills its worker each time costs its own row.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial
from itertools import zip_longest
from os import PathLike
from typing import Any, Final

from particlerb.case.problems import CaseError, Path, file_problem, path_of, problem_at
from particlerb.case.reader import CaseSource, load
from particlerb.case.run import frame_count
from particlerb.case.schema import Case
from particlerb.case.sweep import SweepTable
from particlerb.case.to_system import to_system
from particlerb.case.values import plain
from particlerb.model.system import System
from particlerb.plan.case_forces import loads_of
from particlerb.simulation.joint_values import refuse_checks
from particlerb.sweeping.designs import asked_of, written_out
from particlerb.sweeping.executors import processes
from particlerb.sweeping.rows import Row, asking, columns, failed
from particlerb.sweeping.table import VALID_UNTIL, SweepRows, TableFile
from particlerb.sweeping.together import may_share
from particlerb.sweeping.variants import Variant, built, label, variants
from particlerb.sweeping.worker import Task, work

_AXIS_HINT: Final = "give it a table [sweep], or --axis 'run.t_end=[1, 2]'; in Python axes={..}"
_MAX_ATTEMPTS: Final = 3  # of a task whose worker dies
_MAX_FAILED: Final = 100  # variants at the beginning that cost their own rows
_MAX_STARTS: Final = 20  # of workers that die before they do anything
_END: Final = ("run", "t_end")
_DIED: Final = "the worker died"
_MAX_VARIANTS_IN_TASK: Final = 16  # that run one after the other
_MAX_VARIANTS_IN_BATCH: Final = 1024  # that run together
_MAX_BYTES_IN_BATCH: Final = 256_000_000  # of frames that are kept
_SECONDS_PER_VARIANT: Final = 1e-4  # beside its motion, about
_SECONDS_PER_BODY_STEP: Final = 2e-8
_SECONDS_PER_CONTACT_STEP: Final = 4e-7  # of a body that may touch

Progress = Callable[[int], object]
Pool = Callable[[], AbstractContextManager[Any]]  # makes an executor


def sweep(
    case: CaseSource,
    table: str | PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    axes: Mapping[str, Any] | None = None,
    executor: Executor | None = None,
    workers: int | None = None,
    allow_code: bool = False,
    progress: Progress = lambda n: None,
) -> SweepRows:
    """Run all variants of a case.

    Parameters
    ----------
    case : path, str, mapping, Scene or Case
        With a table [sweep], if `axes` are not given.
    table : path, optional
        CSV file of the rows: those that it has are not run again, so what was stopped goes on.
        With replicates their means are beside it, in table_means.csv.
    overwrite : bool
        Whether to forget what a table has; without, a file where new means are to be is an error.
    axes : mapping, optional
        Keys of the case and their values, in place of [sweep.axes]: all combinations.
    executor : concurrent.futures.Executor, optional
        Where to run them; left out, in processes on this machine.
    workers : int, optional
        Processes, if no executor is given; left out, one for each core.
    allow_code : bool
        Whether Python code that the case names may be run.
    progress : callable
        Called with the number of rows that were added.

    Returns
    -------
    SweepRows
        Names of the columns, and the rows in the order of the variants.

    Raises
    ------
    CaseError, OSError
        If a variant is not a case, before anything runs: all that is wrong; of the table.
    """
    base = load(case, (), allow_code)
    asked = written_out(base, _asked(base, axes))
    all_variants = variants(base, asked)
    system, names = _first_system(base, asked, all_variants)
    axis_names = list(map(label, asked.axes))
    with TableFile(table, axis_names, names, overwrite, asked.replicates) as file:
        left = [variant for variant in all_variants if variant.hash not in file.known]
        progress(len(all_variants) - len(left))

        def take(rows: list[Row]) -> None:
            file.add([(all_variants[row.number], row) for row in rows])
            progress(len(rows))

        n = workers or os.cpu_count() or 1
        if left:
            _drive(executor, _tasks(base, system, asked, left, n), n, take)
        return file.finish(all_variants)


def _asked(base: Case, axes: Mapping[str, Any] | None) -> SweepTable:
    """The table [sweep], with other axes in place of what it says if they are given."""
    if axes is None:
        if base.sweep is None:
            wrong = file_problem(base.path, "does not say what to vary", _AXIS_HINT)
            raise CaseError([wrong])
        return base.sweep
    kept = {} if base.sweep is None else asked_of(base.sweep)
    return SweepTable(axes=plain(axes), **kept)


def _first_system(
    base: Case, asked: SweepTable, all_variants: list[Variant]
) -> tuple[System, list[str]]:
    """System of the first variant that is one, and columns of what is asked for.

    Raises
    ------
    CaseError
        If its code is not allowed, or if a variant has other columns, or has ended by then.
    """
    paths = list(map(path_of, asked.axes))
    system = _first_of(base, paths, all_variants[:_MAX_FAILED])
    ends = [one.values[k] for k, path in enumerate(paths) if path == _END for one in all_variants]
    numbers = [end for end in ends if isinstance(end, int | float)]  # others cost their own rows
    first = _columns_of(base, asked, system, min(numbers, default=system.run.t_end))
    matters = [k for k, path in enumerate(paths) if _matters(path)]
    others = all_variants[:0:-1] if matters else []
    for variant in {repr([one.values[k] for k in matters]): one for one in others}.values():
        try:
            other = to_system(built(base, paths, variant.values))
        except CaseError:
            continue  # it costs its own row
        for k, names in enumerate(_columns_of(base, asked, other, other.run.t_end)):
            if names != first[k]:
                pairs = zip_longest(first[k], names)
                name = next(one or another for one, another in pairs if one != another)
                reason = f"has {len(first[k])} columns in one run, and {len(names)}, or others, in"
                reason += f" another: the first that differs is {name}"
                hint = "name one body, which all runs have"
                raise CaseError([problem_at(base, f"sweep.value[{k}]", reason, hint)])
    told = [] if asked.valid_within is None else [VALID_UNTIL]
    return system, [name for names in first for name in names] + told


def _first_of(base: Case, paths: list[Path], variants: list[Variant]) -> System:
    """System of the first of some variants that is one; CaseError of the first where none is."""
    errors = list[CaseError]()
    for variant in variants:
        try:
            system = to_system(built(base, paths, variant.values))
            loads_of(system)  # whose code may have to be allowed
        except CaseError as error:
            errors.append(error)
        else:
            return system
    raise errors[0]


def _matters(path: Path) -> bool:
    """Whether values of a key may bring other bodies, joints or names."""
    is_whole = path[0] == "body" and (len(path) < 3 or path[2] in ("count", "name"))
    return is_whole or path[0] == "joint" or path == ("run",)


def _columns_of(base: Case, asked: SweepTable, system: System, t_end: float) -> list[list[str]]:
    """Columns of each value that is asked for; CaseError where a system has none, or has ended."""
    for k, one in enumerate(asked.value):
        wrong: tuple[str, str] | None = None
        if one.time is not None and one.time > t_end:
            wrong = "time", f"must be <= run.t_end = {t_end!r}, got {one.time!r}"
        elif one.joint is not None and not system.joint:
            wrong = "joint", "there is no [[joint]]"
        elif one.body is not None and not system.names.has(one.body):
            wrong = "body", f'there is no body "{one.body}"'
        if wrong is not None:
            raise CaseError([problem_at(base, f"sweep.value[{k}].{wrong[0]}", wrong[1])])
    refuse_checks(asking(system, asked.value)._replace(source=base.source), "sweep")
    return [columns(one, system) for one in asked.value]


def _tasks(
    base: Case, system: System, asked: SweepTable, left: list[Variant], n: int
) -> Iterator[Task]:
    """Tasks: one variant first, which compiles, then a few at a time, or many in a batch."""
    paths = tuple(map(path_of, asked.axes))
    raw = {key: value for key, value in base.source.raw.items() if key != "sweep"}
    source, share = base.source._replace(raw=raw, text=""), may_share(system)
    alike: dict[Any, list[Variant]] = {}
    for variant in left[1:]:
        alike.setdefault(variant.like if share else None, []).append(variant)
    fewest, most = 1, _MAX_VARIANTS_IN_TASK
    if share:  # as much work as it takes to start another worker, at least
        steps = 0.0 if base.run.dt is None else base.run.t_end / base.run.dt
        each = _SECONDS_PER_BODY_STEP if system.contact is None else _SECONDS_PER_CONTACT_STEP
        seconds = _SECONDS_PER_VARIANT + each * steps * system.n_bodies
        most = _MAX_VARIANTS_IN_BATCH
        if asked.valid_within is not None:  # of each, and of its twin, all frames are kept
            held = 2 * 13 * 8 * system.n_bodies * frame_count(system.run)
            most = min(most, _MAX_BYTES_IN_BATCH // held + 1)
        fewest = min(most, int(1.0 / seconds) + 1)
    for group in ([left[0]], *alike.values()):
        size = min(most, max(fewest, len(group) // (8 * n)))
        for lo in range(0, len(group), size):
            numbers, values, *_ = zip(*group[lo : lo + size], strict=True)
            yield Task(numbers, values, paths, source, asked.value, share, 0, asked.valid_within)


def _drive(
    executor: Executor | None, tasks: Iterator[Task], n: int, take: Callable[[list[Row]], None]
) -> None:
    """Keep some tasks under way until all are done: on an executor, or in so many processes.

    The first one runs alone, as it compiles, and so does who was there when a worker died.
    """
    waiting, lost = deque(tasks), list[tuple[Task, str]]()
    running: dict[Future[list[Row]], Task] = {}
    at_once, is_broken = 1, False
    pool: Pool = partial(processes, n) if executor is None else partial(nullcontext, executor)
    with ExitStack() as stack:
        executor = _awake(stack, pool)
        while waiting or running:
            while waiting and not lost and len(running) < _room(waiting[0], running, at_once):
                task = waiting.popleft()
                try:
                    running[executor.submit(work, task)] = task
                except BrokenExecutor:
                    lost.append((task, _DIED))
                    is_broken = True
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in [one for one in running if one in done]:  # rows come in their order
                task = running.pop(future)
                try:
                    rows = future.result()
                except BrokenExecutor:
                    lost.append((task, _DIED))
                    is_broken = True
                except Exception as error:  # a killed worker of dask, or a fault of ours
                    lost.append((task, f"{type(error).__name__}: {error}".splitlines()[0]))
                else:
                    take(rows)
                    at_once = 2 * n
            if is_broken:
                lost += [(task, _DIED) for task in running.values()]
                running.clear()
                stack.pop_all().close()
                executor = _awake(stack, pool)
                is_broken = False
            for task, why in lost:
                waiting.extendleft(_again(task, why, take))
            lost.clear()


def _awake(stack: ExitStack, pool: Pool) -> Executor:
    """An executor with a worker that has started: who dies before costs no task an attempt."""
    for _ in range(_MAX_STARTS):
        executor = stack.enter_context(pool())
        try:
            executor.submit(os.getpid).result()
        except BrokenExecutor:
            stack.pop_all().close()
        else:
            return executor
    return stack.enter_context(pool())


def _room(task: Task, running: Mapping[Any, Task], at_once: int) -> int:
    """How many tasks may run at once when this one is among them."""
    return 1 if any(one.attempt for one in (task, *running.values())) else at_once


def _again(task: Task, why: str, take: Callable[[list[Row]], None]) -> list[Task]:
    """Tasks of a task that was lost: each variant alone; none after the last attempt."""
    if task.attempt + 1 == _MAX_ATTEMPTS:
        take([failed(number, why) for number in task.numbers])
        return []
    return [
        task._replace(numbers=(number,), values=(values,), attempt=task.attempt + 1)
        for number, values in zip(task.numbers, task.values, strict=True)
    ]
