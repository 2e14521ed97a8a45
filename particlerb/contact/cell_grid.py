"""Pairs of spheres that touch or soon may, by cells.

A sphere has its neighbours in its own cell and the 26 around it. Spheres are sorted by cell, those
of a column one after another, so that three cells are one run. Cells are numbered without gaps
where the spheres fill their box; where they do not, by a linear map modulo a prime, which needs no
more memory than there are spheres: far cells may then share a number, the 27 around a sphere never.
Spheres of very different size lie on levels, each with its own cells; the finer of two looks for
the coarser, so that no large cell is full of small spheres.

References
----------
Ogarko and Luding, Computer Physics Communications 183, 931 (2012): levels of cells.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel, unsigned
from particlerb.compiled.threads import THREADS
from particlerb.maths.rows import column3, rows3
from particlerb.maths.vec3 import Bools, Floats, Ints, Vec3, subtract

UNIT: Final = 1024  # spheres a kernel takes at a time
_WRITE_AHEAD: Final = 8  # candidates written at a time, more than most runs have
_PAIR_BITS: Final = 32  # numbers of spheres are below 2^31
_LOWER_BITS: Final = (1 << _PAIR_BITS) - 1


class PairList(NamedTuple):
    """Pairs of spheres, sorted by the first and then by the second.

    The first is the one on the finer level; on the same level, the one with the lower number.
    """

    sphere: Ints  # (n_pairs,) sphere
    other: Ints  # (n_pairs,) sphere
    start: Ints  # (n + 1,) pairs with i as the first are start[i] to start[i + 1]


class CellGrid(NamedTuple):
    """Cells of each level, the finest level first."""

    origin: Floats  # (3,) [m]
    per_metre: Floats  # (n_levels,) [1/m] one over the width
    strides: Ints  # (n_levels, 2) from a column to the next one in x, in y
    base: Ints  # (n_levels + 1,) cells of level l are base[l] to base[l + 1]
    is_dense: Bools  # (n_levels,) whether each cell has a number of its own


class SortedSpheres(NamedTuple):
    """Spheres in the order of their cells."""

    number: Ints  # (n,) which sphere it is
    xyzr: Floats  # (n, 4) [m] centre and radius
    begin: Ints  # (n_cells + 2,) spheres of cell c are begin[c] to begin[c + 1]


class SphereBodies(NamedTuple):
    """What does not change with the positions of the spheres."""

    radius: Floats  # (n,) [m]
    level: Ints  # (n,)
    before: Ints  # (n,) first sphere of the same body
    after: Ints  # (n,) first sphere after those of the same body


class FoundPairs(NamedTuple):
    """Neighbours as they are found, those of a unit together."""

    pair: Ints  # (n_units * capacity,) see `pair_key`
    n_found: Ints  # (n_units,) how many there are
    missing: Ints  # (n_units,) how many would not fit, at most


# Cells


@inline
def pair_key(i: int, j: int) -> int:
    """Number of a pair, ascending if the pairs are."""
    return (i << _PAIR_BITS) | j


@inline
def _cell_at(d: Vec3, per_metre: float, stride: tuple[int, int], n: int, is_dense: bool) -> int:
    """Number, within its level, of the cell of a point at d from the origin.

    Arrays that enter a function in a loop are counted there, by all threads in one place: so this
    takes numbers.
    """
    a, b, c = int(d[0] * per_metre), int(d[1] * per_metre), int(d[2] * per_metre)
    if is_dense:
        return (a + 1) * stride[0] + (b + 1) * stride[1] + c + 1
    return ((a % n) * stride[0] % n + (b % n) * stride[1] % n + c % n) % n


@kernel
def find_bounds(points: Floats, indices: Ints, bounds: Floats, first: int, end: int) -> None:
    """Write the smallest box around the spheres of each unit, (n_units, 6) [m].

    A position that is not finite makes a bound that is not.
    """
    rows = rows3(points, 0, points.shape[1])
    for unit in range(first, end):
        for k in range(3):
            lo, hi, wrong = math.inf, -math.inf, 0
            for at in range(unit * UNIT, min((unit + 1) * UNIT, indices.size)):
                x = rows[k][indices[at]]
                lo, hi = min(lo, x), max(hi, x)
                wrong += 0 if abs(x) < math.inf else 1
            bounds[unit, k], bounds[unit, 3 + k] = lo, math.inf if wrong else hi


@kernel
def number_cells(
    points: Floats, indices: Ints, level: Ints, grid: CellGrid, cell: Ints, first: int, end: int
) -> None:
    """Write the cell (k,) of spheres `indices` among points (3, n) [m], units first to end."""
    origin, per_metre, strides, cells, is_dense = grid
    rows, zero = rows3(points, 0, points.shape[1]), (origin[0], origin[1], origin[2])
    for at in range(first * UNIT, min(end * UNIT, indices.size)):
        i = indices[at]
        k = level[i]
        base, stride = cells[k], (strides[k, 0], strides[k, 1])
        d, n = subtract(column3(rows, i), zero), cells[k + 1] - base
        cell[at] = base + _cell_at(d, per_metre[k], stride, n, is_dense[k])


@kernel
def sort_by_cell(indices: Ints, cell: Ints, begin: Ints, number: Ints) -> None:
    """Sort k spheres by their cells (k,), keeping their order within: a counting sort."""
    begin[:] = 0
    for at in range(indices.size):
        begin[cell[at] + 2] += 1
    for c in range(2, begin.size):
        begin[c] += begin[c - 1]
    for at in range(indices.size):
        slot = begin[cell[at] + 1]  # walks from the first of the cell to the first after it
        begin[cell[at] + 1] = slot + 1
        number[slot] = indices[at]


@kernel
def place_sorted(
    points: Floats, radius: Floats, spheres: SortedSpheres, first: int, end: int
) -> None:
    """Write centres and radii of the sorted spheres of units first to end, [m]."""
    number, xyzr, _ = spheres
    rows = rows3(points, 0, points.shape[1])
    for at in range(first * UNIT, min(end * UNIT, number.size)):
        i = number[at]
        xyzr[at, 0], xyzr[at, 1], xyzr[at, 2] = column3(rows, i)
        xyzr[at, 3] = radius[i]


# Neighbours


@inline
def _run_of_cells(
    middle: int, column: int, stride: tuple[int, int], n: int, same_level: bool
) -> tuple[int, int]:
    """First cell of one of 9 columns around the middle, and how many are looked at: 3, or 2."""
    if same_level and column == 4:
        return middle, 2
    c = middle + (column // 3 - 1) * stride[0] + (column % 3 - 1) * stride[1] - 1
    return (c % n if c < 0 or c >= n else c), 3


@kernel
def find_neighbours(
    grid: CellGrid,
    spheres: SortedSpheres,
    owners: SphereBodies,
    skin: float,
    pairs: FoundPairs,
    first: int,
    end: int,
) -> None:
    """Find the neighbours of the sorted spheres of units first to end.

    On its own level a sphere looks at those after it, in 14 of 27 cells; on coarser ones at all.
    Branches would be guessed wrong too often: candidates are written some ahead at a time, then
    every one becomes a pair, which is kept by moving on.
    """
    origin, per_metre, strides, cells, is_dense = grid
    (number, xyzr, begin), (_, levels, before, after) = spheres, owners
    pair, count, missing = pairs
    x0, y0, z0 = origin[0], origin[1], origin[2]
    capacity, top = pair.size // missing.size, cells.size - 1
    for unit in range(first, end):
        k, full, lost = unit * capacity, (unit + 1) * capacity, 0
        for here in range(unit * UNIT, min((unit + 1) * UNIT, number.size)):
            i = number[here]
            x, y, z, r = xyzr[here, 0], xyzr[here, 1], xyzr[here, 2], xyzr[here, 3] + skin
            low, high, finest = before[i], after[i], levels[i]
            for level in range(finest, top):
                k0 = k
                base, n = cells[level], cells[level + 1] - cells[level]
                a, b = strides[level, 0], strides[level, 1]
                d = (x - x0, y - y0, z - z0)
                middle = _cell_at(d, per_metre[level], (a, b), n, is_dense[level])
                same_level = level == finest
                for column in range(4 if same_level else 0, 9):
                    c, left = _run_of_cells(middle, column, (a, b), n, same_level)
                    while left > 0:  # twice, where a run goes on at the first cell
                        stop = min(c + left, n)
                        lo, hi = begin[base + c], begin[base + stop]
                        if same_level and c == middle:
                            lo = here + 1
                        left, c = left - (stop - c), 0
                        if k + (hi - lo) + _WRITE_AHEAD > full:
                            lost += hi - lo + _WRITE_AHEAD
                            hi = lo
                        for some in range(lo, hi, _WRITE_AHEAD):
                            for other in range(_WRITE_AHEAD):
                                pair[unsigned(k + some - lo + other)] = some + other
                        k += hi - lo
                last_one, k = k, k0
                for at in range(unsigned(k0), unsigned(last_one)):
                    other = unsigned(pair[at])
                    dx, dy = xyzr[other, 0] - x, xyzr[other, 1] - y
                    dz, cutoff = xyzr[other, 2] - z, xyzr[other, 3] + r
                    j = number[other]
                    f, s = (j, i) if same_level and j < i else (i, j)
                    pair[unsigned(k)] = pair_key(f, s)
                    is_near = dx * dx + dy * dy + dz * dz < cutoff * cutoff
                    k += int(is_near & ((j >= high) | (j < low)))
        count[unit], missing[unit] = k - unit * capacity, lost


@kernel
def sort_by_first(pairs: FoundPairs, start: Ints, second: Ints) -> None:
    """Sort pairs by the first of n spheres into start (n + 2,): a counting sort."""
    pair, count, missing = pairs
    capacity = pair.size // missing.size
    start[:] = 0
    for unit in range(count.size):
        for at in range(unit * capacity, unit * capacity + count[unit]):
            start[(pair[at] >> _PAIR_BITS) + 2] += 1
    for i in range(2, start.size):
        start[i] += start[i - 1]
    for unit in range(count.size):
        for at in range(unit * capacity, unit * capacity + count[unit]):
            i = pair[at] >> _PAIR_BITS
            second[start[i + 1]] = pair[at] & _LOWER_BITS
            start[i + 1] += 1


@kernel
def sort_by_second(pairs: PairList, first: int, end: int) -> None:
    """Sort the pairs of each sphere of units first to end by the second: there are few."""
    firsts, seconds, start = pairs
    for i in range(first * UNIT, min(end * UNIT, start.size - 1)):
        lo = start[i]
        for k in range(lo, start[i + 1]):
            j, slot = seconds[k], k
            firsts[k] = i
            while slot > lo and seconds[slot - 1] > j:
                seconds[slot] = seconds[slot - 1]
                slot -= 1
            seconds[slot] = j


def spread(kernel_of: Callable[[int, int], object], n: int, work: int = 1) -> None:
    """Call kernel_of(first, last) for ranges of units that cover n spheres."""
    THREADS.share(kernel_of, -(-n // UNIT), work * n)
