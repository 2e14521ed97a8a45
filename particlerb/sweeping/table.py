"""The table of a sweep: one CSV, to which only the driver appends, so that a kill loses nothing."""

import csv
import errno
import io
import math
import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from particlerb.compiled.helper import no_collection
from particlerb.files import Closing
from particlerb.maths.vec3 import Floats
from particlerb.record.output_path import appearing, is_at, output_path, remove, sync, sync_open
from particlerb.record.writer_lock import WriterLock
from particlerb.sweeping.rows import Row
from particlerb.sweeping.variants import Variant

_Table = str | PathLike[str] | None
_FIRST_COLUMNS = ("run", "hash", "status", "energy_drift", "checks_missed")
VALID_UNTIL = "valid_until"


class SweepRows(NamedTuple):
    """What a sweep came to."""

    columns: tuple[str, ...]
    """run, hash, status, energy_drift, checks_missed, then the axes, then the values."""
    rows: tuple[tuple[Any, ...], ...]
    """In the order of the variants; numbers where they are some."""
    n_axes: int
    replicates: int = 1
    """Rows of each variant, one after the other; run.seed is then the last axis."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the columns of the axes."""
        return self.columns[len(_FIRST_COLUMNS) : len(_FIRST_COLUMNS) + self.n_axes]

    @property
    def values(self) -> tuple[str, ...]:
        """Names of the columns of values."""
        return self.columns[len(_FIRST_COLUMNS) + self.n_axes :]

    def column(self, name: str) -> list[Any]:
        """One of the columns; NaN where a run that failed has no value."""
        k = self.columns.index(name)
        return [row[k] if k < len(row) else math.nan for row in self.rows]

    def means(self) -> "Means":
        """Means over replicates, a row for each variant."""
        n, names = self.replicates, ("energy_drift", *self.values)
        axes = self.axes if n == 1 else self.axes[:-1]
        first = [self.column(name)[::n] for name in axes]
        is_done = np.reshape([status == "done" for status in self.column("status")], (-1, n))
        heads, parts = list[str](), list[list[float]]()
        for name in names:
            is_end = name == VALID_UNTIL  # of which a mean says little: few runs end early
            values = np.where(is_done, np.reshape(self.column(name), (-1, n)), np.nan)
            heads += [name, f"{name}.{'least' if is_end else 'error'}"]
            parts += (_median_and_least if is_end else _mean_and_error)(values.astype(float))
        rows = zip(*first, is_done.sum(axis=1).tolist(), *parts, strict=True)
        return Means((*axes, "done", *heads), tuple(rows))


class Means(NamedTuple):
    """Means over replicates: of runs that are done, with their standard errors."""

    columns: tuple[str, ...]
    """The axes, done, then energy_drift and each value, each followed by its standard error.

    Of valid_until the median, followed by the least.
    """
    rows: tuple[tuple[Any, ...], ...]
    """One for each variant; NaN where too few runs are done."""

    def column(self, name: str) -> list[Any]:
        """One of the columns."""
        k = self.columns.index(name)
        return [row[k] for row in self.rows]


def _mean_and_error(values: Floats) -> tuple[list[float], list[float]]:
    """Mean of the finite entries of each row, and its standard error √(Σ(x - mean)²/(n(n - 1)))."""
    is_known = np.isfinite(values)
    n = is_known.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(is_known, values, 0.0).sum(axis=1) / n
        away = np.where(is_known, values - mean[:, None], 0.0)
        error = np.sqrt((away**2).sum(axis=1) / (n * (n - 1)))
    return mean.tolist(), error.tolist()


def _median_and_least(values: Floats) -> tuple[list[float], list[float]]:
    """Median and least of the finite entries of each row; NaN where there is none."""
    known = [row[np.isfinite(row)] for row in values]
    kept = [row if row.size else np.array([np.nan]) for row in known]
    return [float(np.median(row)) for row in kept], [float(row.min()) for row in kept]


def means_beside(table: Path) -> Path:
    """Where the means over replicates are."""
    return table.with_name(f"{table.stem}_means{table.suffix}")


def _text(lines: Sequence[Sequence[Any]]) -> bytes:
    """Lines of a CSV."""
    text = io.StringIO(newline="")
    csv.writer(text).writerows(lines)
    return text.getvalue().encode()


def _append(path: Path, lines: Sequence[Sequence[Any]]) -> None:
    """Append lines, which are on the disk when this returns."""
    with path.open("ab") as file:
        file.write(_text(lines))
        file.flush()
        sync_open(file.fileno())


def _write(path: Path, lines: Sequence[Sequence[Any]]) -> None:
    """A CSV in place of what is there; a kill leaves one of both."""
    with appearing(path) as (new,):
        new.write_bytes(_text(lines))


class TableFile(Closing):
    """Rows of a sweep, in a file if there is a path; what the file has is known already.

    Each variant has n rows, its replicates.

    Raises
    ------
    ValueError
        If there is a file that is no table with these columns.
    OSError
        If it cannot be read or written, or if another sweep writes it, or if there is a file where
        the means of a new table are to be. Also later, where another program takes or changes it.
    """

    def __init__(
        self, table: _Table, axes: Sequence[str], values: Sequence[str], overwrite: bool, n: int
    ) -> None:
        self.columns, self.n_axes = (*_FIRST_COLUMNS, *axes, *values), len(axes)
        self.replicates = n
        self.path = path = None if table is None else Path(table)
        self.known: dict[str, tuple[Any, ...]] = {}  # rows that are done, by their hash
        self._order: list[str] = []  # hashes in the file
        self._was_there = False  # whether rows were in it before
        self._size = 0  # of the file [bytes]
        self._lock: WriterLock | None = None
        if path is None:
            return
        was_there = path.exists()
        if n > 1 and not was_there:
            output_path(means_beside(path), overwrite)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = WriterLock(path)
        try:
            if overwrite and (n > 1 or was_there):  # those of other rows
                remove(means_beside(path))
            self._read(path, overwrite)
        except BaseException:
            self.close()
            raise

    def _read(self, path: Path, overwrite: bool) -> None:
        """Note what the file has, which gets its first line if it has none."""
        content = b"" if overwrite else path.read_bytes()
        end = content.rfind(b"\n") + 1
        lines = list(csv.reader(io.StringIO(content[:end].decode("utf-8", "replace"))))
        is_ours = _text([self.columns]).startswith(content)
        if not is_ours and (not lines or tuple(lines[0]) != self.columns):
            raise ValueError(f"{path} has other columns than this sweep: give another name")
        os.truncate(path, end)  # behind it is a last line that was torn
        if not lines:
            _append(path, [self.columns])
            sync(path.parent)
        self._size = path.stat().st_size
        rows = [line for line in lines[1:] if line[2:3] == ["done"]]
        try:
            if any(len(row) != len(self.columns) for row in rows):
                raise ValueError
            self._order = [line[1] for line in lines[1:]]
            self.known = {row[1]: _parsed(row) for row in rows}
            self._was_there = len(lines) > 1
        except (IndexError, ValueError):
            raise ValueError(f"{path} has lines that are no rows: give another name") from None

    @no_collection()  # Python would look at all rows again and again
    def add(self, rows: Sequence[tuple[Variant, Row]]) -> None:
        """Add rows."""
        lines, hashes = list[tuple[Any, ...]](), [variant.hash for variant, _ in rows]
        for variant, (number, *told, values) in rows:
            lines.append((number, variant.hash, *told, *_cells_of(variant), *values))
        self.known.update(zip(hashes, lines, strict=True))
        self._order += hashes
        if self.path is not None:
            self._refuse_if_disturbed(self.path)
            _append(self.path, lines)
            self._size = self.path.stat().st_size

    def _refuse_if_disturbed(self, path: Path) -> None:
        """Raise OSError where another program has taken the table, or rows of it."""
        assert self._lock is not None
        descriptor = self._lock.fileno()
        if not is_at(path, descriptor) or os.fstat(descriptor).st_size != self._size:
            told = "was moved, removed, replaced or changed by another program meanwhile"
            raise OSError(errno.EIO, told, str(path))

    @no_collection()
    def finish(self, variants: Sequence[Variant]) -> SweepRows:
        """Rows of all variants in their order; the file then has these and no others.

        Means over replicates are written beside it.
        """
        if self.path is not None:
            self._refuse_if_disturbed(self.path)
        first, stop = len(_FIRST_COLUMNS), len(_FIRST_COLUMNS) + self.n_axes
        known = [self.known[v.hash] for v in variants]
        numbers = [row[0] for row in known]
        is_new = not self._was_there  # else cells were read
        rows = tuple(
            row
            if is_new and row[0] == v.number
            else (v.number, *row[1:first], *_cells_of(v), *row[stop:])
            for v, row in zip(variants, known, strict=True)
        )
        if self.path is not None and (
            self._order != [v.hash for v in variants] or numbers != list(range(len(variants)))
        ):
            _write(self.path, [self.columns, *rows])
        result = SweepRows(self.columns, rows, self.n_axes, self.replicates)
        if self.path is not None and self.replicates > 1:
            means = result.means()
            _write(means_beside(self.path), [means.columns, *means.rows])
        return result

    def close(self) -> None:
        """Let others write it."""
        if self._lock is not None:
            self._lock.close()


def _cells_of(variant: Variant) -> list[Any]:
    """Values of the axes as a table has them."""
    return [x if isinstance(x, (float, str, int)) else repr(x) for x in variant.values]


def _parsed(line: Sequence[str]) -> tuple[Any, ...]:
    """Row of a line of the file."""
    number, variant_hash, status, *rest = line
    return (int(number), variant_hash, status, *map(_number, rest))


def _number(text: str) -> Any:
    """Number of a text, or the text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
