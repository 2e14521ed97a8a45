"""Search for pairs of spheres that touch or soon may, by a grid of cells."""

import math
from functools import lru_cache
from typing import Final

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.contact.cell_grid import (
    UNIT,
    CellGrid,
    FoundPairs,
    PairList,
    SortedSpheres,
    SphereBodies,
    find_bounds,
    find_neighbours,
    number_cells,
    place_sorted,
    sort_by_cell,
    sort_by_first,
    sort_by_second,
    spread,
)
from particlerb.maths.vec3 import Floats, Ints

COST: Final = 15  # body-steps that finding the neighbours of a sphere takes
_MAX_CELLS_PER_SPHERE: Final = 4  # beyond, cells are numbered modulo a prime
_MIN_CELLS: Final = 64
_AT_ONCE = 65536  # spheres that `neighbours` looks at
_LAYER_MARGIN: Final = 1e-9  # by which its layers overlap, of their places and reach: they round
_INITIAL_CAPACITY: Final = 8  # neighbours per sphere that fit at first
_MAX_LEVELS: Final = 40  # anything smaller than the largest sphere by 2^40 is as good as a point
KEY_BITS: Final = 32  # bits of a number of a body in a key of a pair
LARGEST_NUMBER: Final = 2**31 - 1  # of a body, a sphere, a contact in lists
_NO_PAIRS: Final = np.zeros(0, dtype=np.int64)
_PLACE_ROUNDING: Final = 2.0**-50  # of a place far from the origin, relative
_CELL_ROUNDING: Final = 2.0**-50  # of the number of a cell, relative


class SphereSearch:
    """Finds neighbours among the spheres of bodies, again and again; owns the memory for it.

    Parameters
    ----------
    radius : ndarray, shape (n,) [m]
        Not negative.
    body : ndarray, shape (n,)
        Body of each sphere, ascending.
    apart : ndarray, shape (k,), optional
        Pairs of bodies that do not touch each other, as `pair_keys` has them, ascending.
    world : ndarray, shape (n_bodies,), optional
        Scene of each body, where there are several: those of different ones are no pairs.
    """

    def __init__(
        self, radius: Floats, body: Ints, apart: Ints = _NO_PAIRS, world: Ints | None = None
    ) -> None:
        n = radius.size
        self.world = None if world is None or not world.any() else world[body]
        self.body, self.apart = body, apart
        level = levels_of(radius)
        before = np.searchsorted(body, body, side="left")
        self.owners = SphereBodies(radius, level, before, np.searchsorted(body, body, side="right"))
        self.n_levels = int(level.max(initial=-1)) + 1
        self.widest = np.zeros(self.n_levels)
        np.maximum.at(self.widest, level, 2.0 * radius)
        self.everyone = np.arange(n)
        self.population = np.bincount(level, minlength=self.n_levels)
        self.capacity = _INITIAL_CAPACITY * UNIT
        self.integers: dict[str, Ints] = {}
        self.xyzr = np.zeros((n, 4))
        self.is_odd = False

    def pairs(self, points: Floats, skin: float, indices: Ints | None = None) -> PairList:
        """Pairs of spheres of different bodies with |x_i - x_j| < r_i + r_j + skin, each once.

        Parameters
        ----------
        points : ndarray, shape (3, n) [m]
            Centres.
        skin : float
            Not negative [m].
        indices : ndarray, shape (k,), optional
            Spheres that take part, ascending; left out: all.

        Returns
        -------
        PairList
            Views of this object's memory: they last until the call after the next one, so that
            what belongs to contacts can be carried over from the list before.

        Raises
        ------
        FloatingPointError
            If a position is not finite.
        """
        indices = self.everyone if indices is None else indices
        points, skin = self._side_by_side(points, skin)
        n, owners = indices.size, self.owners
        if not n:
            return PairList(indices, indices, np.zeros(self.everyone.size + 1, dtype=np.int64))
        grid = self.grid(self.bounds(points, indices), skin)
        cell = self.ints("cell", n)
        spread(lambda lo, hi: number_cells(points, indices, owners.level, grid, cell, lo, hi), n)
        begin = self.ints("begin", int(grid.base[-1]) + 2)
        spheres = SortedSpheres(self.ints("number", n), self.xyzr[:n], begin)
        THREADS.alone(sort_by_cell, indices, cell, begin, spheres.number)
        spread(lambda lo, hi: place_sorted(points, owners.radius, spheres, lo, hi), n)
        unsorted = self.search(grid, spheres, skin)
        while unsorted.missing.any():
            self.capacity += int(unsorted.missing.max())
            unsorted = self.search(grid, spheres, skin)
        return self._without_apart(self.sorted_pairs(unsorted))

    def _side_by_side(self, points: Floats, skin: float) -> tuple[Floats, float]:
        """Points with the worlds beside each other, and a skin that is wider by the rounding."""
        if self.world is None:
            return points, skin
        x, points = points[0], points.copy()
        room = x.max() - x.min() + 2.0 * (self.widest.max() + skin)
        points[0] += room * self.world
        return points, skin + _PLACE_ROUNDING * (np.abs(x).max() + room * self.world.max())

    def _without_apart(self, pairs: PairList) -> PairList:
        """Pairs whose bodies may touch each other."""
        if not self.apart.size:
            return pairs
        keys = pair_keys(self.body[pairs.sphere], self.body[pairs.other])
        may_touch = ~np.isin(keys, self.apart)
        first, second = pairs.sphere[may_touch], pairs.other[may_touch]
        return PairList(first, second, np.searchsorted(first, np.arange(self.everyone.size + 1)))

    def search(self, grid: CellGrid, spheres: SortedSpheres, skin: float) -> FoundPairs:
        """Pairs as they are found, as far as there is memory."""
        n, owners = spheres.number.size, self.owners
        units = -(-n // UNIT)
        pair = self.ints("pair", units * self.capacity)
        pairs = FoundPairs(pair, self.ints("n_found", units), self.ints("missing", units))
        spread(lambda lo, hi: find_neighbours(grid, spheres, owners, skin, pairs, lo, hi), n, COST)
        return pairs

    def sorted_pairs(self, unsorted: FoundPairs) -> PairList:
        """Sort what was found."""
        self.is_odd = not self.is_odd
        n, m = self.everyone.size, int(unsorted.n_found.sum())
        start = self.ints("start", n + 2, turns=True)
        first, second = (self.ints(name, m, turns=True) for name in ("first", "second"))
        pairs = PairList(first, second, start[:-1])
        THREADS.alone(sort_by_first, unsorted, start, second)
        spread(lambda lo, hi: sort_by_second(pairs, lo, hi), n)
        return pairs

    def bounds(self, points: Floats, indices: Ints) -> Floats:
        """Corners of the smallest box around the centres, (2, 3) [m]."""
        n = indices.size
        bounds = np.empty((-(-n // UNIT), 6))
        spread(lambda lo, hi: find_bounds(points, indices, bounds, lo, hi), n)
        corners = np.stack([bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])
        if not np.isfinite(corners).all():
            raise FloatingPointError("the place of a sphere is not finite")
        return corners

    def grid(self, corners: Floats, skin: float) -> CellGrid:
        """Cells in a box (2, 3) [m] that are wide enough for each level's spheres."""
        extent = corners[1] - corners[0]
        width = self.widest + skin
        width = np.maximum(
            width + _CELL_ROUNDING * (extent.max() + width), np.finfo(np.float64).tiny
        )
        strides, cells = np.zeros((self.n_levels, 2), dtype=np.int64), [0]
        is_dense = np.zeros(self.n_levels, dtype=np.bool_)
        for level, population in enumerate(self.population):
            most = _MAX_CELLS_PER_SPHERE * int(population) + _MIN_CELLS
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
        """Memory for integers, which grows; of what `turns` there are two, used in turn."""
        key = f"{name}, {self.is_odd}" if turns else name
        if key not in self.integers or self.integers[key].size < size:
            self.integers[key] = np.zeros(size + size // 4, dtype=np.int64)
        return self.integers[key][:size]


def pair_keys(a: Ints, b: Ints) -> Ints:
    """One number for each pair of bodies a and b below 2³¹, in either order, (k,)."""
    return np.minimum(a, b) << KEY_BITS | np.maximum(a, b)


def bodies_of_keys(keys: Ints) -> tuple[Ints, Ints]:
    """The two bodies of each pair with a key, (k,) and (k,), the lower numbers first."""
    return keys >> KEY_BITS, keys & ((1 << KEY_BITS) - 1)


def neighbours(
    points: Floats,
    radius: Floats,
    body: Ints,
    skin: float,
    apart: Ints = _NO_PAIRS,
    world: Ints | None = None,
) -> PairList:
    """Pairs of spheres of different bodies nearer than `skin`: see `SphereSearch.pairs`.

    Of many it looks at a layer of space at a time, with what may be near from the next ones, so
    that the search takes little memory.
    """
    n, reach = radius.size, 2.0 * float(radius.max(initial=0.0)) + skin
    first = np.arange(0, n, _AT_ONCE)
    axis = int(np.argmax(np.ptp(points, axis=1))) if n else 0
    order = np.argsort(points[axis])
    along = points[axis, order]
    highest = along[np.minimum(first + _AT_ONCE, n) - 1]
    last = np.searchsorted(along, highest + _LAYER_MARGIN * (reach + np.abs(highest)) + reach)
    if first.size < 2 or (last - first).sum() > 2 * n or not np.isfinite(along).all():
        return SphereSearch(radius, body, apart, world).pairs(points, skin)
    found = []
    for lo, hi in zip(first.tolist(), last.tolist(), strict=True):
        some, is_here = np.sort(order[lo:hi]), np.zeros(n, dtype=np.bool_)
        is_here[order[lo : lo + _AT_ONCE]] = True
        search = SphereSearch(radius[some], body[some], apart, world)
        near = search.pairs(np.ascontiguousarray(points[:, some]), skin)
        pairs = some[np.stack(near[:2])]
        found.append(pairs[:, is_here[pairs].any(axis=0)])
    pairs = np.concatenate(found, axis=1)
    sphere, other = pairs[:, np.lexsort(pairs[::-1])]
    return PairList(sphere, other, np.searchsorted(sphere, np.arange(n + 1)))


def levels_of(radius: Floats) -> Ints:
    """Level of each sphere, (n,): radii on one are within a factor of two, 0 is the finest."""
    largest = float(radius.max(initial=0.0))
    if largest == 0.0:
        return np.zeros(radius.size, dtype=np.int64)
    _, exponent = np.frexp(radius / largest)  # the share is in [2^(e - 1), 2^e)
    height = np.where(radius == largest, 0, exponent).astype(np.int64)
    height = np.maximum(np.where(radius == 0.0, -_MAX_LEVELS, height), -_MAX_LEVELS)
    return np.unique(height, return_inverse=True)[1]


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
