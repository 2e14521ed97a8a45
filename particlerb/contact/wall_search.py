"""Primitives of walls near spheres: lists of them by cells in each wall's frame."""

import math
from typing import Final, NamedTuple, Self

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.cell_grid import UNIT, PairList, sort_by_second, spread
from particlerb.contact.neighbour_list import shell_of
from particlerb.contact.records import Records
from particlerb.contact.walls import (
    DISC,
    EDGE,
    FACE,
    PLANE,
    RIM,
    SIDE,
    Walls,
    in_frame_of,
    primitive_at,
    squared_distance,
)
from particlerb.maths.rows import column3, row3, rows3
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, subtract

COST: Final = 4  # body-steps that finding what is near a sphere takes
_MAX_RATIO: Final = 64  # number of cells of a flat or thin wall, over that of a compact one
_MAX_CELLS_PER_PRIMITIVE: Final = 8
_MIN_REACH_SHARE: Final = 0.5  # share of the reach of lists below which narrower ones are made
_CELLS_PER_SPHERE: Final = 0.25  # more: most of a wide heap is far from all walls
_MIN_CELLS: Final = 512


class _WallLists(NamedTuple):
    """Primitives of each wall that a sphere may touch, by the cell of its centre.

    The first list of a wall is for all centres, the others are those of its cells.
    """

    origin: Floats  # (n_walls, 3) [m], wall's frame
    per_metre: Floats  # (n_walls,) [1/m] one over the width of a cell
    shape: Ints  # (n_walls, 3)
    first: Ints  # (n_walls + 1,) lists of wall w are first[w] to first[w + 1]
    begin: Ints  # (n_lists + 1,) entries of list k are begin[k] to begin[k + 1]
    entry: Ints  # (n_entries,) primitive


@kernel
def _list_primitives(
    walls: Walls, lists: _WallLists, corners: Ints, cutoff: float, is_counting: bool
) -> None:
    """Count, or write, the primitives within the cutoff of each cell.

    Parameters
    ----------
    walls, lists : Walls, WallLists
        Counting, `begin` gets the number for list k at k + 2; writing, it is a sum of these, and
        is left as it is meant.
    corners : ndarray, shape (n_primitives, 6)
        First and last cell in each direction that a primitive is near to.
    cutoff : float [m]
    is_counting : bool
    """
    kind, rows, wall, _ = walls
    origin, per_metre, shape, first, begin, entry = lists
    for p in range(kind.size):
        w, primitive = wall[p], primitive_at(kind, rows, p)
        zero, step = row3(origin, w), 1.0 / per_metre[w]
        far = cutoff + 0.5 * math.sqrt(3.0) * step * (1.0 + 1e-9)
        for i in range(corners[p, 0], corners[p, 3] + 1):
            for j in range(corners[p, 1], corners[p, 4] + 1):
                for k in range(corners[p, 2], corners[p, 5] + 1):
                    middle = add_scaled(step, (i + 0.5, j + 0.5, k + 0.5), zero)
                    cell = first[w] + 1 + (i * shape[w, 1] + j) * shape[w, 2] + k
                    cell = first[w] if kind[p] == PLANE else cell
                    if kind[p] != PLANE and squared_distance(primitive, middle) > far * far:
                        continue
                    if not is_counting:
                        entry[begin[cell + 1]] = p
                    begin[cell + (2 if is_counting else 1)] += 1


@inline
def _list_of(x: Vec3, zero: Vec3, per_metre: float, shape: tuple[int, int, int], first: int) -> int:
    """List of the cell of a centre; -1 outside of all cells."""
    i, j, k = subtract(x, zero)
    i, j, k = math.floor(i * per_metre), math.floor(j * per_metre), math.floor(k * per_metre)
    if min(i, j, k) < 0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
        return -1
    return first + 1 + int((i * shape[1] + j) * shape[2] + k)


@kernel
def _find_candidates(
    walls: Walls,
    lists: _WallLists,
    poses: Records,
    points: Floats,
    cutoff: Floats,
    indices: Ints,
    pairs: PairList,
    is_counting: bool,
    first_unit: int,
    end_unit: int,
) -> None:
    """Count, or write, the primitives within the cutoff of the spheres of units first to end.

    Counting, the number of sphere i is written to start[i + 1].
    """
    kind, rows, _, _ = walls
    origin, per_metre, shape, first, begin, entry = lists
    _, second, start = pairs
    centres = rows3(points, 0, points.shape[1])
    for at in range(first_unit * UNIT, min(end_unit * UNIT, indices.size)):
        i = indices[at]
        count, square = 0, cutoff[i] * cutoff[i]
        if not is_counting and start[i + 1] == start[i]:
            continue
        for w in range(per_metre.size):
            x = in_frame_of(poses, w, column3(centres, i))
            shape_w = (shape[w, 0], shape[w, 1], shape[w, 2])
            cell = _list_of(x, row3(origin, w), per_metre[w], shape_w, first[w])
            for index in (first[w], cell):
                for k in range(begin[max(index, 0)], begin[index + 1]):
                    p = entry[k]
                    if squared_distance(primitive_at(kind, rows, p), x) < square:
                        if not is_counting:
                            second[start[i] + count] = p
                        count += 1
        if is_counting:
            start[i + 1] = count


@kernel
def find_wall_shells(
    walls: Walls,
    poses: Records,
    points: Floats,
    radius: Floats,
    skin: float,
    pairs: PairList,
    shell: Ints,
) -> None:
    """Write the shell (n_pairs,) of each pair of a sphere and a primitive: see `order_contacts`."""
    kind, rows, wall, _ = walls
    firsts, seconds, _ = pairs
    centres = rows3(points, 0, points.shape[1])
    for k in range(firsts.size):
        i, p = firsts[k], seconds[k]
        x = in_frame_of(poses, wall[p], column3(centres, i))
        square = squared_distance(primitive_at(kind, rows, p), x)
        shell[k] = shell_of(square, radius[i], skin)


class WallSearch:
    """Finds the primitives of walls near spheres, again and again.

    Parameters
    ----------
    walls : Walls
    radius : ndarray, shape (n,) [m]
        Of the spheres.
    """

    def __init__(self, walls: Walls, radius: Floats) -> None:
        self.walls, self.radius = walls, radius
        self.everyone = np.arange(radius.size)
        self.cutoff = -1.0
        self.lists: _WallLists | None = None  # made where they are first needed

    def go_on(self, before: Self) -> None:
        """Take the cells over from a search for other spheres at the same walls."""
        self.cutoff, self.lists = before.cutoff, before.lists

    def pairs(
        self, points: Floats, poses: Records, skin: float, indices: Ints | None = None
    ) -> PairList:
        """Pairs of a sphere and a primitive that is nearer to its centre than r + skin.

        Parameters
        ----------
        points : ndarray, shape (3, n) [m]
            Centres.
        poses : records POSE, shape (n_walls,)
            Of the walls at the same time.
        skin : float
            Not negative [m].
        indices : ndarray, shape (k,), optional
            Spheres that take part, ascending; left out: all.

        Returns
        -------
        PairList
            The sphere is the first, the primitive the second; sorted by both.
        """
        indices = self.everyone if indices is None else indices
        n, walls = self.everyone.size, self.walls
        start = np.zeros(n + 1, dtype=np.int64)
        cutoff = self.radius + skin
        if not indices.size or not walls.kind.size:
            return PairList(self.everyone[:0], self.everyone[:0], start)
        lists = self.lists
        if lists is None or not self.cutoff * _MIN_REACH_SHARE <= cutoff.max() <= self.cutoff:
            self.cutoff = float(cutoff.max())
            self.lists = lists = lists_of(walls, self.cutoff, int(_CELLS_PER_SPHERE * n))

        def visit(pairs: PairList, is_counting: bool) -> None:
            spread(
                lambda lo, hi: _find_candidates(
                    walls, lists, poses, points, cutoff, indices, pairs, is_counting, lo, hi
                ),
                indices.size,
                COST,
            )

        visit(PairList(self.everyone[:0], self.everyone[:0], start), True)
        np.cumsum(start, out=start)
        first, second = np.empty((2, int(start[-1])), dtype=np.int64)
        pairs = PairList(first, second, start)
        visit(pairs, False)
        spread(lambda lo, hi: sort_by_second(pairs, lo, hi), n)
        return pairs


def lists_of(walls: Walls, cutoff: float, more: int = 0) -> _WallLists:
    """Lists for centres within the cutoff [m] of primitives; `more` cells for many spheres."""
    lower, upper = bounding_boxes(walls)
    n_walls = int(walls.wall.max(initial=-1)) + 1
    shape, origin = np.zeros((n_walls, 3), dtype=np.int64), np.zeros((n_walls, 3))
    width = np.ones(n_walls)
    corners = np.zeros((walls.kind.size, 6), dtype=np.int64)
    for w in range(n_walls):
        indices = np.flatnonzero((walls.wall == w) & (walls.kind != PLANE))
        if not indices.size:
            continue
        low, high = lower[indices] - cutoff, upper[indices] + cutoff
        origin[w] = low.min(axis=0)
        extent = high.max(axis=0) - origin[w]
        cells = _MAX_CELLS_PER_PRIMITIVE * indices.size + _MIN_CELLS + more
        width[w] = max(np.cbrt(extent.prod() / cells), 2.0 * cutoff)
        while (np.floor(extent / width[w]) + 1.0).prod() > _MAX_RATIO * cells:  # a long thin wall
            width[w] *= 2.0
        shape[w] = np.floor(extent / width[w]) + 1
        corners[indices, :3] = (low - origin[w]) / width[w]
        corners[indices, 3:] = (high - origin[w]) / width[w]
        corners[indices, 3:] = np.minimum(corners[indices, 3:], shape[w] - 1)
    first = np.concatenate([[0], np.cumsum(shape.prod(axis=1) + 1)])
    begin = np.zeros(first[-1] + 2, dtype=np.int64)
    lists = _WallLists(origin, 1.0 / width, shape, first, begin, np.zeros(0, dtype=np.int64))
    _list_primitives(walls, lists, corners, cutoff, True)
    np.cumsum(begin, out=begin)
    lists = lists._replace(entry=np.empty(begin[-1], dtype=np.int64))
    _list_primitives(walls, lists, corners, cutoff, False)
    return lists


def bounding_boxes(walls: Walls) -> tuple[Floats, Floats]:
    """Opposite corners of the box around each primitive, (n_primitives, 3) [m]; not of planes."""
    kind, parameter, _, _ = walls
    a, b, c = parameter[:, :3], parameter[:, 3:6], parameter[:, 6:9]
    lower, upper = a.copy(), a.copy()
    for kinds, others in (((FACE, EDGE), b), ((FACE,), c)):
        mask = np.isin(kind, kinds)
        lower[mask] = np.minimum(lower[mask], others[mask])
        upper[mask] = np.maximum(upper[mask], others[mask])
    mask = np.isin(kind, (SIDE, DISC, RIM))
    half = np.where(kind == SIDE, c[:, 1], 0.0)[:, None] * np.abs(b)
    half += c[:, :1] * np.sqrt(np.maximum(1.0 - b * b, 0.0))
    lower[mask] -= half[mask]
    upper[mask] += half[mask]
    return lower, upper
