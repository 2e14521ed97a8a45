"""Tables of particles in text files: point masses x y z m [r], spheres x y z r.

A header names the columns in any order; without one there are exactly x y z m, x y z m r or, for
spheres, x y z r. Values are separated by commas, or all by blanks; what follows a # or % is a
comment. Every message says file, line and reason.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from particlerb.files import File, content
from particlerb.geometry.particles import Particles, one_kind
from particlerb.maths.vec3 import Bools, Floats, Ints

COMMENT: Final = re.compile(r"[#%].*")
_NUMBER: Final = re.compile(r"[+-]?\.?\d")
_OTHER_NAMES: Final = {"mass": "m", "radius": "r"}
_NOT_NEGATIVE: Final = ("m", "r")


class _Columns(NamedTuple):
    """What a kind of file holds."""

    required: tuple[str, ...]
    optional: tuple[str, ...]

    @property
    def text(self) -> str:
        """Names for a message."""
        return ", ".join([*self.required, *(f"[{name}]" for name in self.optional)])


POINTS: Final = _Columns(("x", "y", "z", "m"), ("r",))
SPHERES: Final = _Columns(("x", "y", "z", "r"), ())


class Lines(NamedTuple):
    """A table with the lines where its rows stand."""

    column: dict[str, Floats]  # each (n,)
    line: Ints  # (n,) numbers from 1
    path: str

    @property
    def position(self) -> Floats:
        """[m], shape (n, 3)."""
        return np.stack([self.column[name] for name in "xyz"], axis=1)


def read_points(file: str | Path | File) -> Particles:
    """Point masses, or balls, of one kind from a file with columns x, y, z, m and optionally r.

    Parameters
    ----------
    file : path of the file, or its content
        x, y, z, r in metres, m in kilograms.

    Returns
    -------
    Particles
        One kind, in the order of the lines.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        With file, line and reason: a missing, unknown or repeated column, a wrong number of
        values, no number, a number not finite, a negative mass or radius, no rows, no mass, two
        masses or two balls at one place.
    """
    table = _read_table(content(file), POINTS)
    mass, radius = table.column["m"], table.column.get("r", np.zeros(len(table.line)))
    for is_matter in (mass > 0.0, radius > 0.0):
        _refuse_twins(table.position, np.asarray(is_matter), table)
    if not mass.any():
        raise ValueError(f"{table.path}: no mass: all values of m are 0")
    return one_kind(table.position, mass, radius)


def read_spheres(file: str | Path | File) -> tuple[Floats, Floats]:
    """Centres (n, 3) and radii (n,) [m] from a file with columns x, y, z, r.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        As `read_points`; a radius has to be positive.
    """
    table = _read_table(content(file), SPHERES)
    radius = table.column["r"]
    if not (radius > 0.0).all():
        i = int(np.argmin(radius > 0.0))
        where = f"{table.path}:{table.line[i]}"
        raise ValueError(f"{where}: r = {radius[i]}: a sphere has a positive radius")
    return table.position, radius


def columns_of(file: str | Path | File) -> _Columns:
    """Kind of a file by its header, or by its number of columns: four are x y z r.

    Raises
    ------
    FileNotFoundError, ValueError
        As `read_points`.
    """
    cells = _lines_of(content(file))[0][1]
    if _is_header(cells):
        return POINTS if {"m", "mass"} & {cell.lower() for cell in cells} else SPHERES
    return POINTS if len(cells) == len(POINTS.required) + 1 else SPHERES


def _lines_of(file: File) -> list[tuple[int, list[str]]]:
    """Cells of the lines that are neither blank nor comments, with their numbers."""
    try:
        text = file.data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{file.name}: not a text file: a table of numbers is needed") from None
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        if content := COMMENT.sub("", line).strip():
            lines.append((number, split(content)))
    if not lines:
        raise ValueError(f"{file.name}: empty; expected rows with {POINTS.text} or {SPHERES.text}")
    return lines


def split(content: str) -> list[str]:
    """Cells of a line, between commas or semicolons where there are any, else between blanks."""
    for separator in (",", ";"):
        if separator in content:
            return [cell.strip() for cell in content.split(separator)]
    return content.split()


def _is_header(cells: Sequence[str]) -> bool:
    """Whether a first line names columns: it has x, y or z, and no number."""
    return bool({"x", "y", "z"} & {cell.lower() for cell in cells}) and not any(
        _NUMBER.match(cell) for cell in cells
    )


def _read_table(file: File, columns: _Columns) -> Lines:
    """Table of a file; see `read_points`."""
    lines, path = _lines_of(file), file.name
    first, cells = lines[0]
    if _is_header(cells):
        names = header(cells, columns, f"{path}:{first}")
        lines = lines[1:]
        if not lines:
            raise ValueError(f"{path}:{first}: no particles below the header")
    else:
        names = [*columns.required, *columns.optional][: max(len(cells), len(columns.required))]
    table = numbers(lines, names, path)
    column = {name: np.ascontiguousarray(table[:, k]) for k, name in enumerate(names)}
    return Lines(column, np.array([number for number, _ in lines]), path)


def header(cells: Sequence[str], columns: _Columns, where: str) -> list[str]:
    """Names of the columns; ValueError for a missing, unknown or repeated one."""
    names = [_OTHER_NAMES.get(cell.lower(), cell.lower()) for cell in cells]
    if missing := [name for name in columns.required if name not in names]:
        raise ValueError(f"{where}: column {', '.join(missing)} is missing; found {names}")
    known = (*columns.required, *columns.optional)
    if unknown := [name for name in names if name not in known]:
        raise ValueError(f"{where}: unknown column {unknown[0]!r}; known are {', '.join(known)}")
    if len(set(names)) < len(names):
        raise ValueError(f"{where}: a column is given twice: {names}")
    return names


def numbers(lines: Sequence[tuple[int, list[str]]], names: Sequence[str], path: str) -> Floats:
    """Values (n, columns): all at once, and line by line only to say which one is wrong."""
    try:
        table = np.array([cells for _, cells in lines], dtype=np.float64)
        is_whole = table.ndim == 2 and table.shape[1] == len(names)
    except ValueError:
        is_whole = False
    if is_whole and np.isfinite(table).all():
        low = [table[:, k].min() >= 0.0 for k, name in enumerate(names) if name in _NOT_NEGATIVE]
        if all(low):
            return table
    return np.array([row(cells, names, f"{path}:{number}") for number, cells in lines])


def row(cells: Sequence[str], names: Sequence[str], where: str) -> list[float]:
    """Numbers of one line in the order of the header; ValueError says what is wrong with which."""
    if len(cells) != len(names):
        raise ValueError(f"{where}: {len(cells)} values for the {len(names)} columns {names}")
    values = []
    for name, cell in zip(names, cells, strict=True):
        try:
            value = float(cell)
        except ValueError:
            raise ValueError(f"{where}: {name} = {cell!r} is not a number") from None
        if not math.isfinite(value):
            raise ValueError(f"{where}: {name} = {cell} is not finite")
        if name in _NOT_NEGATIVE and value < 0.0:
            raise ValueError(f"{where}: {name} = {cell} is negative")
        values.append(value)
    return values


def _refuse_twins(position: Floats, chosen: Bools, table: Lines) -> None:
    """ValueError if two of the chosen particles are at one place."""
    index = np.flatnonzero(chosen)
    pair = _twins(position[index])
    if pair is not None:
        a, b = sorted(int(index[k]) for k in pair)
        raise ValueError(
            f"{table.path}:{table.line[b]}: at {position[b].tolist()}, where the particle of line"
            f" {table.line[a]} is: leave one out, or give one the mass of both"
        )


def _twins(position: Floats) -> tuple[int, int] | None:
    """Two points (n, 3) with equal coordinates; None if there are none."""
    order = np.lexsort(position.T)
    same = np.flatnonzero((np.diff(position[order], axis=0) == 0.0).all(axis=1))
    if same.size == 0:
        return None
    return int(order[same[0]]), int(order[same[0] + 1])
