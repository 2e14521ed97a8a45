"""Commands of the studies: what accuracy costs, where methods fail, how sums converge."""

import argparse
import csv
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from particlerb.cli.common import DONE, Ending, read_case, to_write


def chart_command(options: argparse.Namespace) -> int:
    """`chart`: error against time for all methods on a case."""
    from particlerb.case.problems import CaseError
    from particlerb.studies import work_precision as study

    case = read_case(options)
    stem = case.path.stem if case.path else "case"
    paths = outputs(options, f"chart_{stem}")
    try:
        curves = study.curve_count(options.methods, options.peers)
        found = measured(
            curves,
            "curve",
            lambda tick: study.chart(
                case, options.methods, options.peers, options.error, options.budget, tick
            ),
        )
    except CaseError as error:
        raise Ending(str(error)) from None
    except ValueError as error:
        raise Ending(str(error)) from None
    print(study.table(found))
    from particlerb.studies.charts.work_precision import draw_chart

    write(paths, study.csv_rows(found), lambda path: draw_chart(found, path))
    return DONE


def stability_command(options: argparse.Namespace) -> int:
    """`stability`: where each method fails."""
    from particlerb.studies import stability as study

    paths = outputs(options, "stability")
    try:
        found = measured(
            study.n_tasks(options.methods),
            "map",
            lambda tick: study.stability(options.methods, options.budget, tick),
        )
    except ValueError as error:
        raise Ending(str(error)) from None
    print(study.table(found))
    from particlerb.studies.charts.stability import draw_stability

    write(paths, study.csv_rows(found), lambda path: draw_stability(found, path))
    return DONE


def converge_command(options: argparse.Namespace) -> int:
    """`converge`: summed inertia tensors beside the analytic ones."""
    from particlerb.studies import convergence as study

    paths = outputs(options, "converge")
    try:
        found = measured(
            len(study.arrangements(options.shapes)),
            "shape",
            lambda tick: study.converge(options.shapes, options.most, tick),
        )
    except ValueError as error:
        raise Ending(str(error)) from None
    print(study.table(found))
    from particlerb.studies.charts.convergence import draw_convergence

    write(paths, study.csv_rows(found), lambda path: draw_convergence(found, path))
    return DONE


def measured(total: int, unit: str, study: Callable[[Callable[[int], object]], Any]) -> Any:
    """Result of a study, with a progress bar."""
    from tqdm import tqdm

    with tqdm(total=total, unit=unit, disable=None, delay=0.5) as bar:
        return study(bar.update)


def outputs(options: argparse.Namespace, stem: str) -> list[Path]:
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


def write(
    paths: Sequence[Path], rows: Iterable[Sequence[object]], draw: Callable[[Path], None]
) -> None:
    """Write table and pictures; say where they are."""
    table, *pictures = paths
    with table.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    for picture in pictures:
        draw(picture)
    print(f"written: {', '.join(str(path) for path in paths)}")
