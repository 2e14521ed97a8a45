"""Pairs of points that are near each other, by a grid of cells.

Time and memory grow with the pairs, and not with their square.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import lengths

MOST_AT_ONCE: Final = 1_000_000  # pairs that are looked at together
_MAX_PAIRS_SOUGHT: Final = 30_000_000  # pairs that are looked at for the distance in a message


@np.errstate(over="ignore", under="ignore")
def near(here: Floats, there: Floats, reach: float) -> Iterator[tuple[Ints, Ints, Floats]]:
    """Pairs (i, j) of points of two sets that are at most `reach` apart, and their distance [m].

    A point has its neighbours in its own cell of a grid of that width and in the 26 around it. The
    cells of `there` are sorted by column and height, so that three of them lie side by side and
    nine columns are looked up. Only cells with points have a number, however far apart they are.

    Parameters
    ----------
    here, there : ndarray, shapes (3, n) and (3, m) [m]
    reach : float
        Positive [m].
    """
    n = here.shape[1]
    cells = [numbered_cells(np.floor(axis / reach)) for axis in np.hstack([here, there])]
    width, height = int(cells[1].max()) + 2, int(cells[2].max()) + 2
    column, level = cells[0] * width + cells[1], cells[2]
    columns, column_number = np.unique(column[n:], return_inverse=True)
    cell = column_number * height + level[n:]
    order = np.argsort(cell, kind="stable")
    cell = cell[order]
    for to_the_side in (-width - 1, -width, -width + 1, -1, 0, 1, width - 1, width, width + 1):
        neighbour = column[:n] + to_the_side
        k = np.minimum(np.searchsorted(columns, neighbour), columns.size - 1)
        middle = k * height + level[:n]
        start = np.searchsorted(cell, middle - 1, side="left")
        stop = np.searchsorted(cell, middle + 1, side="right")
        count = np.where(columns[k] == neighbour, stop - start, 0)
        for lo, hi in chunks(count):
            i = np.repeat(np.arange(lo, hi), count[lo:hi])
            before = np.cumsum(count[lo:hi]) - count[lo:hi]
            j = order[np.repeat(start[lo:hi] - before, count[lo:hi]) + np.arange(i.size)]
            share = lengths((there[:, j] - here[:, i]) / reach)
            close = share <= 1.0
            yield i[close], j[close], reach * share[close]


def numbered_cells(cells: Floats) -> Ints:
    """Numbers from 1 of cells on a line, of which two differ by 1 only if the cells do."""
    distinct, inverse = np.unique(cells, return_inverse=True)
    gaps = np.minimum(np.diff(distinct), 2.0).astype(np.int64)
    return np.concatenate([[1], 1 + np.cumsum(gaps)])[inverse]


def chunks(count: Ints) -> Iterator[tuple[int, int]]:
    """Ranges of rows that together have about MOST_AT_ONCE entries, or a row that has more."""
    total = np.cumsum(count)
    lo = 0
    while lo < count.size and total[-1] > (total[lo - 1] if lo else 0):
        most = (int(total[lo - 1]) if lo else 0) + MOST_AT_ONCE
        hi = max(int(np.searchsorted(total, most, side="right")), lo + 1)
        yield lo, hi
        lo = hi


def nearest_distance(first: Ints, second: Ints, here: Floats, there: Floats, reach: float) -> float:
    """Distance of the nearest points of different bodies [m], all further apart than `reach`.

    Among very many at about the same distance it is that of the first _MAX_PAIRS_SOUGHT pairs.
    """
    nearest, sought = np.inf, 0
    while not np.isfinite(nearest):
        reach *= 2.0
        for i, j, distance in near(here, there, reach):
            between_bodies = distance[first[i] != second[j]]
            nearest = min(nearest, float(between_bodies.min(initial=np.inf)))
            sought += i.size
            if sought > _MAX_PAIRS_SOUGHT and np.isfinite(nearest):
                break
    return nearest
