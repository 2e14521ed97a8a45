"""Commands of the studies: what accuracy costs, where methods fail, how sums converge."""

import argparse
import contextlib
import csv
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from tqdm import tqdm

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli.common import read_case, to_write, writing
from particlerb.cli.exit_codes import DONE, Ending, ending
from particlerb.record.output_path import appearing, remove


def chart_command(options: argparse.Namespace) -> int:
    """`chart`: error against time for all methods on a case."""
    from particlerb.studies import chart, contact_laws, work_precision_table
    from particlerb.studies.charts.work_precision import draw_chart

    case = read_case(options)
    by_impulses = case.contact is not None and case.contact.law == "impulse"
    kind = contact_laws.LawStudy if by_impulses else None
    asked = options.methods, options.peers
    paths = _outputs(options, f"chart_{case.path.stem if case.path else 'case'}")
    with _measuring("curve") as bar:
        system = to_system(case)
        bar.total = chart.curve_count(system, *asked)
        how = options.error, options.budget, bar.update, options.processor_time
        results = chart.chart(system, *asked, *how, kind=kind)
    return _show(results, work_precision_table, {"": draw_chart}, paths)


def stability_command(options: argparse.Namespace) -> int:
    """`stability`: where each method fails."""
    from particlerb.studies import stability, stability_table
    from particlerb.studies.charts.stability import pictures

    paths = _outputs(options, "stability", ("maps", "limits", "drifts"))
    with _measuring("map") as bar:
        bar.total = stability.n_tasks(options.methods)
        results = stability.stability(options.methods, options.budget, bar.update)
    return _show(results, stability_table, pictures(results), paths)


def converge_command(options: argparse.Namespace) -> int:
    """`converge`: summed inertia tensors beside the analytic ones."""
    from particlerb.studies import convergence
    from particlerb.studies.charts.convergence import draw_convergence

    paths = _outputs(options, "converge")
    with _measuring("shape") as bar:
        bar.total = len(convergence.arrangements(options.shapes))
        results = convergence.converge(options.shapes, options.most, bar.update)
    return _show(results, convergence, {"": draw_convergence}, paths)


@contextlib.contextmanager
def _measuring(unit: str) -> Iterator[Any]:
    """A progress bar, of which the user sees nothing in the first half second."""
    with ending(CaseError, ValueError), tqdm(unit=unit, disable=None, delay=0.5) as bar:
        yield bar


def _show(
    results: Any,
    words: ModuleType,
    pictures: Mapping[str, Callable[[Any, Path], None]],
    paths: Mapping[str, list[Path]],
) -> int:
    """Print the table of a study, write its rows and those pictures that are drawn of it.

    `words` has `table` and `csv_rows` of such results.
    """
    print(words.table(results))
    written, old = list(paths["csv"]), [path for name in pictures for path in paths[name]]
    with writing(written[0]), appearing(written[0]) as (new,):
        with new.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(words.csv_rows(results))
        for path in reversed(old):  # a picture of other rows must not stand beside these
            with writing(path):
                remove(path)
    for name, draw in pictures.items():
        for path in paths[name]:
            with writing(path), appearing(path) as (new,):
                draw(results, new)
            written.append(path)
    print(f"written: {', '.join(map(str, written))}")
    return DONE


def _outputs(
    options: argparse.Namespace, stem: str, names: Sequence[str] = ("",)
) -> dict[str, list[Path]]:
    """Files that a study writes: CSV, and PNG and SVG of each picture; none may exist unless told.

    What stands in the way is found now, and not after the study.
    """
    base = Path(options.output) if options.output else Path("output") / stem
    try:
        if not base.name or base.is_dir():
            raise Ending(f"{base} is a folder: name files with -o")
        if base.suffix in (".csv", ".png", ".svg"):
            base = base.with_suffix("")
        paths = {"csv": [base.with_name(f"{base.name}.csv")]}
        for name in names:
            stem = f"{base.name}_{name}" if name else base.name
            paths[name] = [base.with_name(f"{stem}{suffix}") for suffix in (".png", ".svg")]
        for path in itertools.chain(*paths.values()):
            to_write(path, options.overwrite)
        base.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise Ending(f"{base} cannot be made: {error.strerror}") from None
    return paths
