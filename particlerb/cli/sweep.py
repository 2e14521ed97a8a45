"""Command `sweep`: variants of a case, a row each in one table."""

import argparse
import math
import shlex
import sys
import tomllib
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from tqdm import tqdm

from particlerb.case.problems import CaseError
from particlerb.cli.common import PICTURES, named_output, read_case, to_write, writing
from particlerb.cli.exit_codes import DONE, FAILED, INTERRUPTED, MISSED, Ending, ending, tamed
from particlerb.record.output_path import appearing
from particlerb.sweeping.driver import sweep
from particlerb.sweeping.executors import NoExecutorError, Workers, cluster
from particlerb.sweeping.table import SweepRows, means_beside


def sweep_command(options: argparse.Namespace) -> int:
    """`sweep`: run all variants that the table does not have yet, where it is asked to."""
    if options.executor == "local":
        return _sweep(options, None)
    with (
        ending(NoExecutorError),
        cluster(options.executor, options.workers, options.address) as workers,
    ):
        return DONE if workers is None else _sweep(options, workers)


def _sweep(options: argparse.Namespace, workers: Workers | None) -> int:
    """The same on workers of a cluster, or in processes of this machine."""
    case = read_case(options)
    stem = case.path.stem if case.path else "case"
    path = named_output(options, Path("output") / f"{stem}_sweep.csv")
    if path.suffix.lower() in PICTURES:
        raise Ending(f"{path}: the table of a sweep is a CSV file; --plot draws a PNG beside it")
    path, picture = to_write(path, True, case.path), path.with_suffix(".png")
    if options.plot and not path.exists():
        to_write(picture, options.overwrite)
    axes = dict(_axis(text) for text in options.axes) or None
    with (
        ending(CaseError, ValueError, FileExistsError),
        tqdm(unit="run", delay=0.5, disable=None) as bar,
    ):
        try:
            executor, n = workers or (None, options.workers)
            run = partial(sweep, executor=executor, workers=n, progress=bar.update)
            table = run(case, path, axes=axes, overwrite=options.overwrite)
        except KeyboardInterrupt:
            again = f"python -m particlerb {shlex.join(sys.argv[1:])}"
            rest = f"{path} has the rows so far; the same command continues: {again}"
            raise Ending(f"interrupted: {rest}", INTERRUPTED) from None
    print(tamed(summary(table)))
    written = [path, *([means_beside(path)] if table.replicates > 1 else [])]
    if options.plot:
        written += [picture] * _plot(table, case.title or stem, picture)
    print(f"written: {', '.join(map(str, written))}")
    if any(status != "done" for status in table.column("status")):
        return FAILED
    return MISSED if any(table.column("checks_missed")) else DONE


def _axis(text: str) -> tuple[str, Any]:
    """Key and values of an option: KEY=[a, b], or KEY={ low = a, high = b, n = 5 }."""
    key, _, values = text.partition("=")
    try:
        found = tomllib.loads(f"v = {values}")["v"]
        if not isinstance(found, list | dict):
            raise ValueError
        return key.strip(), found
    except ValueError:
        raise Ending(f"--axis {text}: must be KEY=[a, b] or KEY={{low=a, high=b, n=5}}") from None


def _plot(table: SweepRows, title: str, path: Path) -> bool:
    """Draw the values over the axes that are numbers, if there are such: not over replicates."""
    from particlerb.studies.charts.sweep import draw_sweep

    columns = {name: table.column(name) for name in (*table.axes, *table.values, "energy_drift")}
    numbers = {
        name: np.array(column, dtype=np.float64)
        for name, column in columns.items()
        if all(isinstance(x, (int, float)) for x in column)
    }
    varied = table.axes if table.replicates == 1 else table.axes[:-1]
    axes = [(name, numbers[name]) for name in varied if name in numbers]
    values = [(name, numbers[name]) for name in table.values or ("energy_drift",)]
    if axes:
        with writing(path), appearing(path) as (new,):
            draw_sweep(title, axes, values, new)
    return bool(axes)


def summary(table: SweepRows) -> str:
    """How many runs are done, why others failed, and the range of each value."""
    status = Counter(table.column("status"))
    lines = [f"{len(table.rows)} runs, {status.pop('done', 0)} done"]
    lines += [f"  {n} {why}" for why, n in status.most_common()]
    missed = sum(n > 0 for n in table.column("checks_missed"))
    lines += [f"  {missed} missed a check"] if missed else []
    is_repeated = table.replicates > 1
    means = table.means() if is_repeated else table
    if is_repeated:
        lines.append(f"  means over {table.replicates} replicates of {len(means.rows)} variants:")
    width = max(map(len, table.columns))
    last = f" {'error':>12}" if is_repeated else ""
    lines.append(f"  {'':{width}} {'least':>12} {'median':>12} {'largest':>12}{last}")
    for name in means.columns if is_repeated else (*table.axes, "energy_drift", *table.values):
        numbers = _finite(means.column(name))
        if numbers and name != "done" and not name.endswith(".error"):
            least, middle, most = min(numbers), median(numbers), max(numbers)
            text = f"  {name:{width}} {least:12.6g} {middle:12.6g} {most:12.6g}"
            if is_repeated and f"{name}.error" in means.columns:
                errors = _finite(means.column(f"{name}.error"))
                text += f" {max(errors, default=math.nan):12.6g}"
            lines.append(text)
    lines += ["  error: the largest standard error of a mean"] if is_repeated else []
    lines += [] if table.values else ["  no results: a [[sweep.value]] in the case adds a column"]
    return "\n".join(lines)


def _finite(column: Sequence[Any]) -> list[float]:
    """Its finite numbers."""
    return [x for x in column if isinstance(x, (int, float)) and math.isfinite(x)]
