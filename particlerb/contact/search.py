"""Pairs of spheres that touch or soon may: cells, lists, and when a list has to be made anew.

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

from particlerb._jit import inline, kernel
from particlerb.bodies.block import unsigned
from particlerb.maths.quaternion import Quat, conjugate, load4, multiply, rows4
from particlerb.maths.vec3 import (
    Bools,
    Floats,
    Indices,
    Ints,
    Vec3,
    add_scaled,
    load3,
    rows3,
    subtract,
)
from particlerb.threads import THREADS

UNIT: Final = 1024  # spheres a kernel takes at a time
WORK: Final = 15  # body-steps that finding the neighbours of a sphere takes
CELLS: Final = 4  # per sphere, at most: beyond, cells are numbered modulo a prime
FEWEST_CELLS: Final = 64
ROOM: Final = 8  # neighbours per sphere that fit at first
FINEST: Final = 40  # levels: anything smaller than the largest sphere by 2^40 is as good as a point
AHEAD: Final = 8  # candidates written at a time, more than most runs have
HALF: Final = 32  # bits: numbers of spheres are below 2^31
LOWER: Final = (1 << HALF) - 1
SMALLEST_PATCH: Final = 1.0 / 64  # half of the side, on a cube of side 2
ROUNDING: Final = 2.0**-50  # of the number of a cell, relative


class Pairs(NamedTuple):
    """Pairs of spheres, sorted by the first and then by the second.

    The first is the one on the finer level; on the same level, the one with the lower number.
    """

    first: Ints  # (n_pairs,) sphere
    second: Ints  # (n_pairs,) sphere
    start: Ints  # (n + 1,) pairs with i as the first are start[i] to start[i + 1]


class Grid(NamedTuple):
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


class Found(NamedTuple):
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
    points: Floats, which: Ints, level: Ints, grid: Grid, cell: Ints, first: int, last: int
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
    grid: Grid, spheres: Sorted, owners: Owners, skin: float, found: Found, first: int, last: int
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
def sort_by_first(found: Found, start: Ints, second: Ints) -> None:
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
def sort_by_second(pairs: Pairs, first: int, last: int) -> None:
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


class Search:
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

    def pairs(self, points: Floats, skin: float, which: Ints | None = None) -> Pairs:
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
            return Pairs(which, which, np.zeros(self.everyone.size + 1, dtype=np.int64))
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

    def found(self, grid: Grid, spheres: Sorted, skin: float) -> Found:
        """Pairs as they are found, as far as there is room."""
        n, owners = spheres.number.size, self.owners
        units = -(-n // UNIT)
        pair = self.ints("pair", units * self.room)
        found = Found(pair, self.ints("found", units), self.ints("missing", units))
        spread(lambda lo, hi: find_neighbours(grid, spheres, owners, skin, found, lo, hi), n, WORK)
        return found

    def listed(self, found: Found) -> Pairs:
        """Sort what was found."""
        self.is_odd = not self.is_odd
        n, m = self.everyone.size, int(found.found.sum())
        start = self.ints("start", n + 2, turns=True)
        first, second = (self.ints(name, m, turns=True) for name in ("first", "second"))
        pairs = Pairs(first, second, start[:-1])
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

    def grid(self, corners: Floats, skin: float) -> Grid:
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
        return Grid(corners[0], 1.0 / width, strides, np.array(cells), is_dense)

    def ints(self, name: str, size: int, turns: bool = False) -> Ints:
        """Room for integers, which grows; of what `turns` there are two, used in turn."""
        key = f"{name}, {self.is_odd}" if turns else name
        if key not in self.integers or self.integers[key].size < size:
            self.integers[key] = np.zeros(size + size // 4, dtype=np.int64)
        return self.integers[key][:size]


def spread(kernel_of: Callable[[int, int], object], n: int, work: int = 1) -> None:
    """Call kernel_of(first, last) for ranges of units that cover n spheres."""
    THREADS.share(kernel_of, -(-n // UNIT), work * n)


def neighbours(points: Floats, radius: Floats, body: Ints, skin: float) -> Pairs:
    """Pairs of spheres of different bodies that are nearer than `skin`: see `Search.pairs`."""
    return Search(radius, body).pairs(points, skin)


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


# Contacts of each body


class Incidence(NamedTuple):
    """Contacts of each body."""

    offset: Ints  # (n_bodies + 1,) those of body b are entries offset[b] to offset[b + 1]
    entry: Indices  # (n_entries,) k where the body is the first of contact k, ~k where the second


@kernel
def sort_contacts(first_body: Ints, second_body: Ints, offset: Ints, entry: Indices) -> None:
    """Sort contacts by body, ascending within: a counting sort of both sides."""
    offset[:] = 0
    for k in range(first_body.size):
        offset[first_body[k] + 2] += 1
        if second_body[k] >= 0:
            offset[second_body[k] + 2] += 1
    for b in range(2, offset.size):
        offset[b] += offset[b - 1]
    for k in range(first_body.size):
        b = first_body[k] + 1
        entry[offset[b]] = k
        offset[b] += 1
        b = second_body[k] + 1
        if b > 0:
            entry[offset[b]] = ~k
            offset[b] += 1


def incidence(first_body: Ints, second_body: Ints, n_bodies: int) -> Incidence:
    """Contacts of each body.

    Parameters
    ----------
    first_body, second_body : ndarray, shape (n_contacts,)
        Bodies of each contact; -1 as the second for something that is no body, as a wall.
    n_bodies : int
    """
    offset = np.empty(n_bodies + 2, dtype=np.int64)
    entry = np.empty(first_body.size + int((second_body >= 0).sum()), dtype=np.int32)
    THREADS.alone(sort_contacts, first_body, second_body, offset, entry)
    return Incidence(offset[:-1], entry)


# What contacts keep from list to list


class Kept(NamedTuple):
    """What contacts keep, found by the numbers of the two."""

    keys: Ints  # (m,) ascending, see `key_of`
    rows: Ints  # (m,) row of `values` that belongs to a key
    values: Floats  # (m, ..)


@inline
def key_of(i: int, j: int) -> int:
    """Number of a pair, ascending if the pairs are."""
    return (i << HALF) | j


@kernel
def order_contacts(
    pairs: tuple[Ints, Ints],
    numbers: tuple[Ints, Ints],
    place: Floats,
    skin: float,
    old: Kept,
    new: Kept,
    first: Indices,
    second: Indices,
) -> int:
    """Write a new list of contacts, and what they keep, zeros for those not in the old one.

    Pairs that are nearer than the skin come first: few others act before the next list.

    Parameters
    ----------
    pairs : tuple of 2 ndarray, shape (m,)
        Sphere, and sphere or primitive of a wall; sorted.
    numbers : tuple of 2 ndarray
        Of the spheres, and of what is second, below 2^31 and ascending with them: the old list is
        found by these.
    place : ndarray, shape (n_spheres, 4) [m]
        Centre and radius.
    skin : float [m]
        Negative where the second are no spheres: then all stay in their order.
    old, new : Kept
        Before; and what is written.
    first, second : ndarray, shape (m,)
        The list.

    Returns
    -------
    int
        How many are near.
    """
    firsts, seconds = pairs
    number, other = numbers
    near, far, before = 0, 0, 0
    if skin >= 0.0:
        for k in range(firsts.size):
            far += int(is_within(place, firsts[k], seconds[k], skin))
    n_near = far
    for k in range(firsts.size):
        i, j = firsts[k], seconds[k]
        if skin >= 0.0 and is_within(place, i, j, skin):
            row, near = near, near + 1
        else:
            row, far = far, far + 1
        key = key_of(number[i], other[j])
        while before < old.keys.size and old.keys[before] < key:
            before += 1
        is_old = before < old.keys.size and old.keys[before] == key
        new.keys[k], new.rows[k], first[row], second[row] = key, row, i, j
        for c in range(new.values.shape[1]):
            new.values[row, c] = old.values[old.rows[before], c] if is_old else 0.0
    return n_near


@inline
def is_within(place: Floats, i: int, j: int, skin: float) -> bool:
    """Whether the gap between two spheres is smaller than the skin."""
    dx, dy = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1]
    dz, reach = place[j, 2] - place[i, 2], place[i, 3] + place[j, 3] + skin
    found: bool = dx * dx + dy * dy + dz * dz < reach * reach
    return found


# When a list has to be made anew


@inline
def way_of(x0: Vec3, q0: Quat, x1: Vec3, q1: Quat, reach: float) -> float:
    """How far a point of a body has moved [m], at most; see `has_moved`."""
    d = subtract(x1, x0)
    _, u, v, w = multiply(q1, conjugate(q0))
    moved = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return moved + 2.0 * math.sqrt(u * u + v * v + w * w) * reach


@kernel
def has_moved(then: Floats, now: Floats, reach: Floats, allowance: float) -> bool:
    """Whether a point of a body may have moved by more than the allowance.

    A point within `reach` of the centre of mass has moved by |Δx| + 2 sin(φ/2) reach at most, φ
    the angle of the turn. Of two bodies both may move: a list with a skin lasts for skin/2.

    Parameters
    ----------
    then, now : ndarray, shape (7 or more, n_bodies)
        Centre of mass [m] and unit quaternion of each body, in the same frame both times.
    reach : ndarray, shape (n_bodies,) [m]
        Distance from the centre of mass to the farthest centre of the body's spheres.
    allowance : float
        [m]
    """
    n = reach.size
    x0, q0 = rows3(then, 0, n), rows4(then[3:7], 0, n)
    x1, q1 = rows3(now, 0, n), rows4(now[3:7], 0, n)
    far = 0
    for b in range(n):
        moved = way_of(load3(x0, b), load4(q0, b), load3(x1, b), load4(q1, b), reach[b])
        far += 0 if moved <= allowance else 1  # what is not a number has moved too
    return far > 0


# Spheres that nothing can reach


@inline
def on_unit_sphere(face: int, u: float, v: float) -> Vec3:
    """Direction of a point of the cube's face: (±1, u, v) in turn, of length 1."""
    w = 1.0 if face < 3 else -1.0
    f = 1.0 / math.sqrt(1.0 + u * u + v * v)
    if face % 3 == 0:
        return f * w, f * u, f * v
    if face % 3 == 1:
        return f * v, f * w, f * u
    return f * u, f * v, f * w


@inline
def largest_cover(x: Vec3, spheres: Floats, near: Ints, lo: int, hi: int, depth: float) -> float:
    """How deep x is inside the deepest of some balls that are smaller by `depth` [m]."""
    best = -math.inf
    for k in range(lo, hi):
        j = near[k]
        d = subtract(x, (spheres[j, 0], spheres[j, 1], spheres[j, 2]))
        best = max(best, spheres[j, 3] - depth - math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]))
    return best


@kernel
def find_outer(
    spheres: Floats, offset: Ints, near: Ints, depth: float, stack: Floats, is_outer: Bools
) -> None:
    """Write which spheres are not covered: see `outer_spheres`.

    The sphere is seen as a cube, whose faces are halved in both directions until a patch is inside
    one ball altogether, its middle is in none, or the patch is small.

    Parameters
    ----------
    spheres : ndarray, shape (n, 4) [m]
        Centre, and radius with that of the smallest ball from outside.
    offset, near : ndarray, shapes (n + 1,) and (n_near,)
        Balls that reach into ball i are near[offset[i]] to near[offset[i + 1]].
    depth : float
        [m]
    stack : ndarray, shape (room, 4)
        Face, first corner and size of patches that are not decided.
    is_outer : ndarray, shape (n,)
    """
    for i in range(offset.size - 1):
        lo, hi, left = offset[i], offset[i + 1], 6
        x, R = (spheres[i, 0], spheres[i, 1], spheres[i, 2]), spheres[i, 3]
        for face in range(6):
            stack[face, 0], stack[face, 1], stack[face, 2], stack[face, 3] = face, -1.0, -1.0, 2.0
        is_outer[i] = False
        while left > 0 and not is_outer[i]:
            left -= 1
            face, u, v = int(stack[left, 0]), stack[left, 1], stack[left, 2]
            half = 0.5 * stack[left, 3]
            middle, size = on_unit_sphere(face, u + half, v + half), 0.0
            for corner in range(4):
                end = on_unit_sphere(
                    face, u + 2.0 * half * (corner // 2), v + 2.0 * half * (corner % 2)
                )
                d = subtract(end, middle)
                size = max(size, math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]))
            at = add_scaled(R - 0.5 * depth, middle, x)
            cover = largest_cover(at, spheres, near, lo, hi, depth)
            if cover >= R * size + 0.5 * depth:
                continue
            if half < SMALLEST_PATCH or cover < -0.5 * depth:
                is_outer[i] = True
                continue
            for part in range(4):
                stack[left, 0], stack[left, 3] = face, half
                stack[left, 1], stack[left, 2] = u + half * (part // 2), v + half * (part % 2)
                left += 1


def outer_spheres(position: Floats, radius: Floats, smallest: float, depth: float = 0.0) -> Bools:
    """Whether something from outside can touch each sphere of a body, (n,); true if in doubt.

    A ball of radius ρ touches sphere i where its centre is within r_i + ρ of x_i. The others keep
    it out of a place that is deeper than r_j + ρ - δ in ball j; if these cover the shell from r_i
    + ρ - δ to r_i + ρ around x_i, nothing gets there. A larger ball that touches contains one of
    radius ρ that touches there too, so that the smallest decides. Spheres that are left out rely on
    others which are left out too, but the first to be touched would have to be one of them.

    Parameters
    ----------
    position : ndarray, shape (3, n) [m]
        In any frame.
    radius : ndarray, shape (n,) [m]
    smallest : float
        ρ: radius of the smallest ball that may come [m]; 0 for edges and vertices of walls.
    depth : float
        δ: largest overlap of a contact [m].
    """
    n, reach = radius.size, radius + smallest
    first, second, _ = Search(reach, np.arange(n)).pairs(position, 0.0)
    offset, entry = incidence(first, second, n)
    near = np.where(entry >= 0, second[entry], first[~entry])
    spheres = np.column_stack([position.T, reach])
    is_outer, stack = np.ones(n, dtype=np.bool_), np.empty((6 + 3 * 32, 4))
    find_outer(spheres, offset, near, depth, stack, is_outer)
    return is_outer
