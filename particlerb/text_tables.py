"""Tables of numbers in text files, with messages that name file and line.

A header names the columns in any order; without one they come in the order in which they are
listed. Values are separated by commas, or all by blanks, and each may stand in double quotes, which
keep no separator; what follows a # or % is a comment.
"""

import math
import re
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from particlerb.files import File

_COMMENT: Final = re.compile(r"[#%].*")
_QUOTED: Final = re.compile(r'^"\s*([^"]*?)\s*"$')
_NUMBER_START: Final = re.compile(r"[+-]?\.?\d")
_OTHER_NAMES: Final = {"mass": "m", "radius": "r", "time": "t"}
_NOT_NEGATIVE: Final = ("m", "r", "t")


class Columns(NamedTuple):
    """What a kind of file holds."""

    required: tuple[str, ...]
    optional: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Names for a message."""
        return ", ".join([*self.required, *(f"[{name}]" for name in self.optional)])


class Lines(NamedTuple):
    """A table with the lines where its rows stand."""

    column: dict[str, NDArray[np.float64]]  # each (n,)
    line: NDArray[np.int64]  # (n,) numbers from 1
    path: str

    @property
    def vectors(self) -> NDArray[np.float64]:
        """Columns x, y, z, shape (n, 3)."""
        return np.stack([self.column[name] for name in "xyz"], axis=1)


def lines_of(file: File, expected: str) -> list[tuple[int, list[str]]]:
    """Cells of the lines that are neither blank nor comments, with their numbers.

    Raises
    ------
    ValueError
        If it is no text, or there is no such line.
    """
    try:
        text = file.data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{file.name}: not a text file: a table of numbers is needed") from None
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        if content := _COMMENT.sub("", line).strip():
            cells = _split(content)
            lines.append((number, [_QUOTED.sub(r"\1", c) if '"' in c else c for c in cells]))
    if not lines:
        raise ValueError(f"{file.name}: empty; expected rows with {expected}")
    return lines


def _split(content: str) -> list[str]:
    """Cells of a line, between commas or semicolons where there are any, else between blanks."""
    for separator in (",", ";"):
        if separator in content:
            return [cell.strip() for cell in content.split(separator)]
    return content.split()


def is_header(cells: Sequence[str]) -> bool:
    """Whether a first line names columns: it has x, y or z, and no number."""
    return bool({"x", "y", "z"} & {cell.lower() for cell in cells}) and not any(
        _NUMBER_START.match(cell) for cell in cells
    )


def read_table(file: File, columns: Columns) -> Lines:
    """Table of a file.

    Raises
    ------
    ValueError
        With file, line and reason: no rows, a missing, unknown or repeated column, a wrong number
        of values, no number, a number not finite, a negative mass, radius or time.
    """
    lines, path = lines_of(file, columns.text), file.name
    first, cells = lines[0]
    if is_header(cells):
        names = _header(cells, columns, f"{path}:{first}")
        lines = lines[1:]
        if not lines:
            raise ValueError(f"{path}:{first}: no rows below the header")
    else:
        names = [*columns.required, *columns.optional][: max(len(cells), len(columns.required))]
    table = _numbers(lines, names, path)
    column = {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(names)}
    return Lines(column, np.array([number for number, _ in lines]), path)


def _header(cells: Sequence[str], columns: Columns, where: str) -> list[str]:
    """Names of the columns; ValueError for a missing, unknown or repeated one."""
    names = [_OTHER_NAMES.get(cell.lower(), cell.lower()) for cell in cells]
    if missing := [name for name in columns.required if name not in names]:
        raise ValueError(f"{where}: column {', '.join(missing)} is missing; found {names}")
    allowed = (*columns.required, *columns.optional)
    if unknown := [name for name in names if name not in allowed]:
        raise ValueError(f"{where}: unknown column {unknown[0]!r}; known are {', '.join(allowed)}")
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: a column is given twice: {names}")
    return names


def _numbers(
    lines: Sequence[tuple[int, list[str]]], names: Sequence[str], path: str
) -> NDArray[np.float64]:
    """Values (n, columns): all at once, and line by line only to say which one is wrong."""
    try:
        table = np.array([cells for _, cells in lines], dtype=np.float64)
        is_whole = table.ndim == 2 and table.shape[1] == len(names)
        is_whole &= not any("_" in cell for _, cells in lines for cell in cells)
    except ValueError:
        is_whole = False
    if is_whole and np.isfinite(table).all():
        low = [table[:, k].min() >= 0.0 for k, name in enumerate(names) if name in _NOT_NEGATIVE]
        if all(low):
            return table
    return np.array([_row(cells, names, f"{path}:{number}") for number, cells in lines])


def _row(cells: Sequence[str], names: Sequence[str], where: str) -> list[float]:
    """Numbers of one line in the order of the header; ValueError says what is wrong with which."""
    if len(cells) != len(names):
        raise ValueError(f"{where}: {len(cells)} values for the {len(names)} columns {names}")
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            value = float("" if "_" in cell else cell)  # 1_0 would be 10
        except ValueError:
            raise ValueError(f"{where}: {name} = {cell!r} is not a number") from None
        if not math.isfinite(value):
            raise ValueError(f"{where}: {name} = {cell} is not finite")
        if name in _NOT_NEGATIVE and value < 0.0:
            raise ValueError(f"{where}: {name} = {cell} is negative")
        values.append(value)
    return values
