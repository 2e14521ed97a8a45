"""Designs of a sweep: combinations, values side by side, drawn runs, tables of runs, replicates."""

import csv
import io
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from particlerb.case.overrides import toml_value
from particlerb.case.problems import CaseError, file_problem, problem_at
from particlerb.case.schema import Case
from particlerb.case.sweep import SEED, Spread, SweepTable
from particlerb.compiled.helper import no_collection
from particlerb.files import Files


@no_collection()
def written_out(case: Case, sweep: SweepTable) -> SweepTable:
    """A sweep whose runs are those of a file, or are repeated, as values side by side.

    Replicates follow each other: `run.seed` is the last axis, from the seed of the case on.

    Raises
    ------
    CaseError
        If the file is no table of runs.
    """
    if sweep.file is not None:
        columns = _columns(case, sweep.file)
        sweep = SweepTable(axes=columns, design="zip", **asked_of(sweep))
    if sweep.replicates == 1:
        return sweep
    first = case.run.seed
    seeds = range(first, first + sweep.replicates)
    rows = [(*row, seed) for row in rows_of(sweep) for seed in seeds]
    axes = dict(zip((*sweep.axes, SEED), zip(*rows, strict=True), strict=True))
    return sweep.model_copy(update={"axes": axes, "design": "zip", "runs": None})


def asked_of(sweep: SweepTable) -> dict[str, Any]:
    """What a sweep asks of each variant, whichever there are."""
    return sweep.model_dump(include={"value", "replicates", "valid_within"})


def _columns(case: Case, name: str) -> dict[str, list[Any]]:
    """Values of a table of runs: a header of keys, then values of TOML, or texts.

    Raises
    ------
    CaseError
        With the line, where it has not as many values as the header.
    """
    files = case.source.files
    try:  # a new row must not change the others: the file does not go along with the case
        file = Files(files.folder, files.contents).read(name)
        text = io.StringIO(file.data.decode("utf-8-sig"), newline="")
        reader = csv.reader(text, skipinitialspace=True, strict=True)
        stripped = ([cell.strip() for cell in line] for line in reader)
        lines = [(reader.line_num, cells) for cells in stripped if any(cells)]
    except (ValueError, csv.Error) as error:
        raise CaseError([problem_at(case, "sweep.file", str(error))]) from None
    (_, keys), *rows = lines or [(1, [])]
    problems = [] if rows else [file_problem(None, "needs a row of keys, and rows of values")]
    if len(set(keys)) < len(keys):
        problems.append(file_problem(None, f"a column is given twice: {keys}"))
    problems += [file_problem(None, "a column has no key")] if "" in keys else []
    problems += [
        file_problem(None, f"needs a value for each of {keys}")._replace(line=k, column=1)
        for k, row in rows
        if len(row) != len(keys) or "" in row
    ]
    if problems:
        raise CaseError(problem._replace(file=file.name) for problem in problems)
    columns = zip(*(row for _, row in rows), strict=True)
    return {key: [toml_value(cell) for cell in col] for key, col in zip(keys, columns, strict=True)}


def rows_of(sweep: SweepTable) -> Iterator[tuple[Any, ...]]:
    """Values of the axes, a row for each run."""
    axes, n = list(sweep.axes.values()), sweep.runs or 0
    if sweep.design == "zip":
        yield from zip(*map(_listed, axes), strict=True)
    elif n:
        yield from zip(*(_drawn(sweep, k, axis, n) for k, axis in enumerate(axes)), strict=True)
    else:
        yield from itertools.product(*map(_listed, axes))


def _listed(axis: tuple[Any, ...] | Spread) -> tuple[Any, ...]:
    """Values of an axis in their order."""
    if not isinstance(axis, Spread):
        return axis
    n = axis.n or 1
    return tuple(axis.at(k / max(n - 1, 1)) for k in range(n))


def _drawn(sweep: SweepTable, k: int, axis: tuple[Any, ...] | Spread, n: int) -> list[Any]:
    """Values of axis k for n runs: in a Latin hypercube each n-th of it has one of them."""
    stream = np.random.default_rng([sweep.seed, k])
    shares = stream.uniform(size=n)
    if sweep.design == "latin":
        shares = (stream.permutation(n) + shares) / n
    if isinstance(axis, Spread):
        return [axis.at(share) for share in shares.tolist()]
    return [axis[int(share * len(axis))] for share in shares.tolist()]
