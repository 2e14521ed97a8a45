"""Commands of the studies: what accuracy costs, where methods fail, how sums converge."""

import argparse
import csv
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from tqdm import tqdm

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli.common import read_case, to_write
from particlerb.cli.endings import DONE, Ending, ending


class _Shown(NamedTuple):
    """How a study runs, and how its result is told and drawn."""

    total: Callable[[], int]
    """Steps of its progress bar."""
    unit: str
    run: Callable[[Callable[[int], object]], Any]
    words: ModuleType
    """With `table` and `csv_rows` of a result."""
    draw: Callable[[Any, Path], None]


def chart_command(options: argparse.Namespace) -> int:
    """`chart`: error against time for all methods on a case."""
    from particlerb.studies import work_precision, work_precision_table
    from particlerb.studies.charts.work_precision import draw_chart

    case = read_case(options)
    asked = options.methods, options.peers
    study = _Shown(
        lambda: work_precision.curve_count(*asked),
        "curve",
        lambda tick: work_precision.chart(
            to_system(case), *asked, options.error, options.budget, tick
        ),
        work_precision_table,
        draw_chart,
    )
    return show(options, f"chart_{case.path.stem if case.path else 'case'}", study)


def stability_command(options: argparse.Namespace) -> int:
    """`stability`: where each method fails."""
    from particlerb.studies import stability, stability_table
    from particlerb.studies.charts.stability import draw_stability

    study = _Shown(
        lambda: stability.n_tasks(options.methods),
        "map",
        lambda tick: stability.stability(options.methods, options.budget, tick),
        stability_table,
        draw_stability,
    )
    return show(options, "stability", study)


def converge_command(options: argparse.Namespace) -> int:
    """`converge`: summed inertia tensors beside the analytic ones."""
    from particlerb.studies import convergence
    from particlerb.studies.charts.convergence import draw_convergence

    study = _Shown(
        lambda: len(convergence.arrangements(options.shapes)),
        "shape",
        lambda tick: convergence.converge(options.shapes, options.most, tick),
        convergence,
        draw_convergence,
    )
    return show(options, "converge", study)


def show(options: argparse.Namespace, stem: str, study: _Shown) -> int:
    """Run a study with a progress bar, print its table, write its rows and pictures."""
    paths = _outputs(options, stem)
    with (
        ending(CaseError, ValueError),
        tqdm(total=study.total(), unit=study.unit, disable=None, delay=0.5) as bar,
    ):
        found = study.run(bar.update)
    print(study.words.table(found))
    rows, *pictures = paths
    with rows.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(study.words.csv_rows(found))
    for picture in pictures:
        study.draw(found, picture)
    print(f"written: {', '.join(map(str, paths))}")
    return DONE


def _outputs(options: argparse.Namespace, stem: str) -> list[Path]:
    """Files that a study writes: CSV, PNG and SVG of one name; none may exist unless told.

    What stands in the way is found now, and not after the study.
    """
    base = Path(options.output) if options.output else Path("output") / stem
    try:
        if not base.name or base.is_dir():
            raise Ending(f"{base} is a folder: name files with -o")
        if base.suffix in (".csv", ".png", ".svg"):
            base = base.with_suffix("")
        paths = [base.with_name(base.name + suffix) for suffix in (".csv", ".png", ".svg")]
        for path in paths:
            to_write(path, options.overwrite)
        base.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Ending(f"{base} cannot be made: {error.strerror}") from None
    return paths
