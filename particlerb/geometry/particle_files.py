"""Tables of particles in text files: point masses x y z m [r], spheres x y z r.

Every message says file, line and reason; `text_tables` has the format.
"""

from pathlib import Path
from typing import Final

import numpy as np

from particlerb.files import File, content
from particlerb.geometry.particles import Particles, one_kind
from particlerb.maths.vec3 import Bools, Floats
from particlerb.text_tables import Columns, Lines, is_header, lines_of, read_table

POINTS: Final = Columns(("x", "y", "z", "m"), ("r",))
SPHERES: Final = Columns(("x", "y", "z", "r"))


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
    table = read_table(content(file), POINTS)
    mass, radius = table.column["m"], table.column.get("r", np.zeros(len(table.line)))
    for is_matter in (mass > 0.0, radius > 0.0):
        _refuse_twins(table.vectors, np.asarray(is_matter), table)
    if not mass.any():
        raise ValueError(f"{table.path}: no mass: all values of m are 0")
    return one_kind(table.vectors, mass, radius)


def read_spheres(file: str | Path | File) -> tuple[Floats, Floats]:
    """Centres (n, 3) and radii (n,) [m] from a file with columns x, y, z, r.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        As `read_points`; a radius has to be positive.
    """
    table = read_table(content(file), SPHERES)
    radius = table.column["r"]
    if not (radius > 0.0).all():
        i = int(np.argmin(radius > 0.0))
        where = f"{table.path}:{table.line[i]}"
        raise ValueError(f"{where}: r = {radius[i]}: a sphere has a positive radius")
    return table.vectors, radius


def columns_of(file: str | Path | File) -> Columns:
    """Kind of a file by its header, or by its number of columns: four are x y z r.

    Raises
    ------
    FileNotFoundError, ValueError
        As `read_points`.
    """
    cells = lines_of(content(file), f"{POINTS.text} or {SPHERES.text}")[0][1]
    if is_header(cells):
        return POINTS if {"m", "mass"} & {cell.lower() for cell in cells} else SPHERES
    return POINTS if len(cells) == len(POINTS.required) + 1 else SPHERES


def _refuse_twins(position: Floats, chosen: Bools, table: Lines) -> None:
    """ValueError if two of the chosen particles are at one place."""
    index = np.flatnonzero(chosen)
    order = index[np.lexsort(position[index].T)]
    same = np.flatnonzero((np.diff(position[order], axis=0) == 0.0).all(axis=1))
    if same.size:
        a, b = sorted(order[same[0] : same[0] + 2].tolist())
        raise ValueError(
            f"{table.path}:{table.line[b]}: at {position[b].tolist()}, where the particle of line"
            f" {table.line[a]} is: leave one out, or give one the mass of both"
        )
