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
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import (
    Bools,
    Floats,
    Ints,
    Vec3,
    load3,
    rows3,
    subtract,
)
from particlerb.model.block import unsigned

UNIT: Final = 1024  # spheres a kernel takes at a time
WORK: Final = 15  # body-steps that finding the neighbours of a sphere takes
CELLS: Final = 4  # per sphere, at most: beyond, cells are numbered modulo a prime
FEWEST_CELLS: Final = 64
ROOM: Final = 8  # neighbours per sphere that fit at first
FINEST: Final = 40  # levels: anything smaller than the largest sphere by 2^40 is as good as a point
AHEAD: Final = 8  # candidates written at a time, more than most runs have
HALF: Final = 32  # bits: numbers of spheres are below 2^31
LOWER: Final = (1 << HALF) - 1
ROUNDING: Final = 2.0**-50  # of the number of a cell, relative


class PairList(NamedTuple):
    """Pairs of spheres, sorted by the first and then by the second.

    The first is the one on the finer level; on the same level, the one with the lower number.
    """

    first: Ints  # (n_pairs,) sphere
    second: Ints  # (n_pairs,) sphere
    start: Ints  # (n + 1,) pairs with i as the first are start[i] to start[i + 1]


class CellGrid(NamedTuple):
    """Cells of each level, the finest level first."""

    origin: Floats  # (3,) [m]
    per_metre: Floats  # (n_levels,) [1/m] one over the width
    strides: Ints  # (n_levels, 2) from a column to the next one in x, in y
    base: Ints  # (n_levels + 1,) cells of level l are base[l] to base[l + 1]
    is_dense: Bools  # (n_levels,) whether each cell has a number of its own


class Sorted(NamedTuple):
    """Spheres in the order of their cells."""

    number: Ints  # (n,) which sphere it is
    place: Floats  # (n, 4) [m] centre and radius
    begin: Ints  # (n_cells + 2,) spheres of cell c are begin[c] to begin[c + 1]


class Owners(NamedTuple):
    """What does not change with the places of the spheres."""

    radius: Floats  # (n,) [m]
    level: Ints  # (n,)
    before: Ints  # (n,) first sphere of the same body
    after: Ints  # (n,) first sphere after those of the same body


class FoundPairs(NamedTuple):
    """Neighbours as they are found, those of a unit together."""

    pair: Ints  # (n_units * room,) the first sphere in the upper half of the bits
    found: Ints  # (n_units,) how many there are
    missing: Ints  # (n_units,) how many would not fit, at most


# Cells


@inline
def cell_at(d: Vec3, per_metre: float, stride: tuple[int, int], n: int, is_dense: bool) -> int:
    """Number, within its level, of the cell of a point at d from the origin.

    Arrays that enter a function in a loop are counted there, by all threads in one place: so this
    takes numbers.
    """
    a, b, c = int(d[0] * per_metre), int(d[1] * per_metre), int(d[2] * per_metre)
    if is_dense:
        return (a + 1) * stride[0] + (b + 1) * stride[1] + c + 1
    return ((a % n) * stride[0] % n + (b % n) * stride[1] % n + c % n) % n


@kernel
def find_bounds(points: Floats, which: Ints, bounds: Floats, first: int, last: int) -> None:
    """Write the smallest box around the spheres of each unit, (n_units, 6) [m].

    A place that is not finite makes a bound that is not.
    """
    rows = rows3(points, 0, points.shape[1])
    for unit in range(first, last):
        for k in range(3):
            lo, hi, wrong = math.inf, -math.inf, 0
            for at in range(unit * UNIT, min((unit + 1) * UNIT, which.size)):
                x = rows[k][which[at]]
                lo, hi = min(lo, x), max(hi, x)
                wrong += 0 if abs(x) < math.inf else 1
            bounds[unit, k], bounds[unit, 3 + k] = lo, math.inf if wrong else hi


@kernel
def number_cells(
    points: Floats, which: Ints, level: Ints, grid: CellGrid, cell: Ints, first: int, last: int
) -> None:
    """Write the number of the cell of each sphere of units first to last."""
    origin, per_metre, strides, cells, is_dense = grid
    rows, zero = rows3(points, 0, points.shape[1]), (origin[0], origin[1], origin[2])
    for at in range(first * UNIT, min(last * UNIT, which.size)):
        i = which[at]
        own = level[i]
        base, stride = cells[own], (strides[own, 0], strides[own, 1])
        d, n = subtract(load3(rows, i), zero), cells[own + 1] - base
        cell[at] = base + cell_at(d, per_metre[own], stride, n, is_dense[own])


@kernel
def sort_by_cell(which: Ints, cell: Ints, begin: Ints, number: Ints) -> None:
    """Sort spheres by cell, keeping their order within: a counting sort."""
    begin[:] = 0
    for at in range(which.size):
        begin[cell[at] + 2] += 1
    for c in range(2, begin.size):
        begin[c] += begin[c - 1]
    for at in range(which.size):
        slot = begin[cell[at] + 1]  # walks from the first of the cell to the first after it
        begin[cell[at] + 1] = slot + 1
        number[slot] = which[at]


@kernel
def place_sorted(points: Floats, radius: Floats, spheres: Sorted, first: int, last: int) -> None:
    """Write the places of the sorted spheres of units first to last."""
    number, place, _ = spheres
    rows = rows3(points, 0, points.shape[1])
    for at in range(first * UNIT, min(last * UNIT, number.size)):
        i = number[at]
        place[at, 0], place[at, 1], place[at, 2] = load3(rows, i)
        place[at, 3] = radius[i]


# Neighbours


@kernel
def find_neighbours(
    grid: CellGrid,
    spheres: Sorted,
    owners: Owners,
    skin: float,
    found: FoundPairs,
    first: int,
    last: int,
) -> None:
    """Find the neighbours of the sorted spheres of units first to last.

    On its own level a sphere looks at those after it, in 14 of 27 cells; on coarser ones at all.
    Branches would be guessed wrong too often: candidates are written some ahead at a time, then
    every one becomes a pair, which is kept by moving on.
    """
    origin, per_metre, strides, cells, is_dense = grid
    x0, y0, z0 = origin[0], origin[1], origin[2]
    number, place, begin = spheres
    _, levels, before, after = owners
    pair, count, missing = found
    room, top = pair.size // missing.size, cells.size - 1
    for unit in range(first, last):
        k, end, lost = unit * room, (unit + 1) * room, 0
        for own in range(unit * UNIT, min((unit + 1) * UNIT, number.size)):
            i = number[own]
            x, y, z, r = place[own, 0], place[own, 1], place[own, 2], place[own, 3] + skin
            low, high, finest = before[i], after[i], levels[i]
            for level in range(finest, top):
                k0 = k
                base, n = cells[level], cells[level + 1] - cells[level]
                a, b = strides[level, 0], strides[level, 1]
                d = (x - x0, y - y0, z - z0)
                middle = cell_at(d, per_metre[level], (a, b), n, is_dense[level])
                is_own = level == finest
                for column in range(4 if is_own else 0, 9):
                    c = middle + (column // 3 - 1) * a + (column % 3 - 1) * b - 1
                    left = 3
                    if is_own and column == 4:
                        c, left = middle, 2
                    if c < 0 or c >= n:
                        c %= n
                    while left > 0:  # twice, where a run goes on at the first cell
                        stop = min(c + left, n)
                        lo, hi = begin[base + c], begin[base + stop]
                        if is_own and c == middle:
                            lo = own + 1
                        left, c = left - (stop - c), 0
                        if k + (hi - lo) + AHEAD > end:
                            lost += hi - lo + AHEAD
                            hi = lo
                        for some in range(lo, hi, AHEAD):
                            for other in range(AHEAD):
                                pair[unsigned(k + some - lo + other)] = some + other
                        k += hi - lo
                last_one, k = k, k0
                for at in range(unsigned(k0), unsigned(last_one)):
                    other = unsigned(pair[at])
                    dx, dy = place[other, 0] - x, place[other, 1] - y
                    dz, reach = place[other, 2] - z, place[other, 3] + r
                    j = number[other]
                    f, s = (j, i) if is_own and j < i else (i, j)
                    pair[unsigned(k)] = (f << HALF) | s
                    is_near = dx * dx + dy * dy + dz * dz < reach * reach
                    k += int(is_near & ((j >= high) | (j < low)))
        count[unit], missing[unit] = k - unit * room, lost


@kernel
def sort_by_first(found: FoundPairs, start: Ints, second: Ints) -> None:
    """Sort pairs by the first sphere: a counting sort."""
    pair, count, missing = found
    room = pair.size // missing.size
    start[:] = 0
    for unit in range(count.size):
        for at in range(unit * room, unit * room + count[unit]):
            start[(pair[at] >> HALF) + 2] += 1
    for i in range(2, start.size):
        start[i] += start[i - 1]
    for unit in range(count.size):
        for at in range(unit * room, unit * room + count[unit]):
            i = pair[at] >> HALF
            second[start[i + 1]] = pair[at] & LOWER
            start[i + 1] += 1


@kernel
def sort_by_second(pairs: PairList, first: int, last: int) -> None:
    """Sort the pairs of each sphere of units first to last by the second: there are few."""
    firsts, seconds, start = pairs
    for i in range(first * UNIT, min(last * UNIT, start.size - 1)):
        lo = start[i]
        for k in range(lo, start[i + 1]):
            j, slot = seconds[k], k
            firsts[k] = i
            while slot > lo and seconds[slot - 1] > j:
                seconds[slot] = seconds[slot - 1]
                slot -= 1
            seconds[slot] = j


class SphereSearch:
    """Finds neighbours among the spheres of bodies, again and again; owns the room for it.

    Parameters
    ----------
    radius : ndarray, shape (n,) [m]
        Not negative.
    body : ndarray, shape (n,)
        Body of each sphere, ascending.
    """

    def __init__(self, radius: Floats, body: Ints) -> None:
        n = radius.size
        level = levels_of(radius)
        before = np.searchsorted(body, body, side="left")
        self.owners = Owners(radius, level, before, np.searchsorted(body, body, side="right"))
        self.n_levels = int(level.max(initial=-1)) + 1
        self.widest = np.zeros(self.n_levels)
        np.maximum.at(self.widest, level, 2.0 * radius)
        self.everyone = np.arange(n)
        self.population = np.bincount(level, minlength=self.n_levels)
        self.room = ROOM * UNIT
        self.integers: dict[str, Ints] = {}
        self.place = np.zeros((n, 4))
        self.is_odd = False

    def pairs(self, points: Floats, skin: float, which: Ints | None = None) -> PairList:
        """Pairs of spheres of different bodies with |x_i - x_j| < r_i + r_j + skin, each once.

        Parameters
        ----------
        points : ndarray, shape (3, n) [m]
            Centres.
        skin : float
            Not negative [m].
        which : ndarray, shape (k,), optional
            Spheres that take part, ascending; left out: all.

        Returns
        -------
        Pairs
            Views of this object's room: they last until the call after the next one, so that
            what belongs to contacts can be carried over from the list before.

        Raises
        ------
        FloatingPointError
            If a place is not finite.
        """
        which = self.everyone if which is None else which
        n, owners = which.size, self.owners
        if not n:
            return PairList(which, which, np.zeros(self.everyone.size + 1, dtype=np.int64))
        grid = self.grid(self.bounds(points, which), skin)
        cell = self.ints("cell", n)
        spread(lambda lo, hi: number_cells(points, which, owners.level, grid, cell, lo, hi), n)
        begin = self.ints("begin", int(grid.base[-1]) + 2)
        spheres = Sorted(self.ints("number", n), self.place[:n], begin)
        THREADS.alone(sort_by_cell, which, cell, begin, spheres.number)
        spread(lambda lo, hi: place_sorted(points, owners.radius, spheres, lo, hi), n)
        found = self.found(grid, spheres, skin)
        while found.missing.any():
            self.room += int(found.missing.max())
            found = self.found(grid, spheres, skin)
        return self.listed(found)

    def found(self, grid: CellGrid, spheres: Sorted, skin: float) -> FoundPairs:
        """Pairs as they are found, as far as there is room."""
        n, owners = spheres.number.size, self.owners
        units = -(-n // UNIT)
        pair = self.ints("pair", units * self.room)
        found = FoundPairs(pair, self.ints("found", units), self.ints("missing", units))
        spread(lambda lo, hi: find_neighbours(grid, spheres, owners, skin, found, lo, hi), n, WORK)
        return found

    def listed(self, found: FoundPairs) -> PairList:
        """Sort what was found."""
        self.is_odd = not self.is_odd
        n, m = self.everyone.size, int(found.found.sum())
        start = self.ints("start", n + 2, turns=True)
        first, second = (self.ints(name, m, turns=True) for name in ("first", "second"))
        pairs = PairList(first, second, start[:-1])
        THREADS.alone(sort_by_first, found, start, second)
        spread(lambda lo, hi: sort_by_second(pairs, lo, hi), n)
        return pairs

    def bounds(self, points: Floats, which: Ints) -> Floats:
        """Corners of the smallest box around the centres, (2, 3) [m]."""
        n = which.size
        bounds = np.empty((-(-n // UNIT), 6))
        spread(lambda lo, hi: find_bounds(points, which, bounds, lo, hi), n)
        corners = np.stack([bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])
        if not np.isfinite(corners).all():
            raise FloatingPointError("the place of a sphere is not finite")
        return corners

    def grid(self, corners: Floats, skin: float) -> CellGrid:
        """Cells that are wide enough for each level's spheres."""
        extent = corners[1] - corners[0]
        width = self.widest + skin
        width = np.maximum(width + ROUNDING * (extent.max() + width), np.finfo(np.float64).tiny)
        strides, cells = np.zeros((self.n_levels, 2), dtype=np.int64), [0]
        is_dense = np.zeros(self.n_levels, dtype=np.bool_)
        for level, population in enumerate(self.population):
            most = CELLS * int(population) + FEWEST_CELLS
            shape = np.floor(extent / width[level]) + 3.0  # one more on each side
            if shape.prod() <= most:
                _, b, c = shape.astype(np.int64)
                strides[level] = b * c, c
                is_dense[level] = True
                cells.append(cells[-1] + int(shape.prod()))
            else:
                *strides[level], number = modular_strides(most)
                cells.append(cells[-1] + number)
        return CellGrid(corners[0], 1.0 / width, strides, np.array(cells), is_dense)

    def ints(self, name: str, size: int, turns: bool = False) -> Ints:
        """Room for integers, which grows; of what `turns` there are two, used in turn."""
        key = f"{name}, {self.is_odd}" if turns else name
        if key not in self.integers or self.integers[key].size < size:
            self.integers[key] = np.zeros(size + size // 4, dtype=np.int64)
        return self.integers[key][:size]


def spread(kernel_of: Callable[[int, int], object], n: int, work: int = 1) -> None:
    """Call kernel_of(first, last) for ranges of units that cover n spheres."""
    THREADS.share(kernel_of, -(-n // UNIT), work * n)


def neighbours(points: Floats, radius: Floats, body: Ints, skin: float) -> PairList:
    """Pairs of spheres of different bodies nearer than `skin`: see `SphereSearch.pairs`."""
    return SphereSearch(radius, body).pairs(points, skin)


def levels_of(radius: Floats) -> Ints:
    """Level of each sphere: radii on a level are within a factor of two, 0 is the finest."""
    largest = float(radius.max(initial=0.0))
    if largest == 0.0:
        return np.zeros(radius.size, dtype=np.int64)
    _, exponent = np.frexp(radius / largest)  # the share is in [2^(e - 1), 2^e)
    height = np.where(radius == largest, 0, exponent).astype(np.int64)
    height = np.maximum(np.where(radius == 0.0, -FINEST, height), -FINEST)
    level: Ints = np.unique(height, return_inverse=True)[1]
    return level


@lru_cache
def modular_strides(least: int) -> tuple[int, int, int]:
    """Strides in x and y of cells that are numbered modulo a prime, and that prime.

    Among 3 × 3 × 3 cells no two have the same number: for steps from -2 to 2 in all directions
    a da + b db + dc is 0 only where all three are.
    """
    n = least | 1
    while any(n % k == 0 for k in range(3, math.isqrt(n) + 1, 2)):
        n += 2
    steps = np.array([s for s in np.ndindex(5, 5, 5) if s != (2, 2, 2)]) - 2
    a, b = int(0.6180339887 * n), int(0.7548776662 * n)
    while not (steps @ np.array([a, b, 1]) % n).all():
        a, b = a + 1, b - 1
    return a, b, n
