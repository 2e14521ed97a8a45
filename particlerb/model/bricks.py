"""Bricks: boxes that fill space, one for each rank, with about as many bodies in each.

They are made by cutting space in two across its longest extent, again and again, by counts. A body
belongs to the brick that its centre of mass is in. Where the cuts are changes no bit of a run.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple, Self

import numpy as np

from particlerb.maths.vec3 import Floats, Ints
from particlerb.ranks import Ranks

SPARE: Final = 4.0  # skins beyond one within which a rank has copies, so that they serve for longer
_N_BINS: Final = 1024  # places where space may be cut, and then where the bin of the cut may
_MAX_REFINEMENTS: Final = 6  # beyond them places differ by rounding
_MAX_CUT_ERROR: Final = 0.01  # bodies by which a cut may miss, in those of a brick
_MAX_IMBALANCE: Final = 1.2  # bodies of the fullest brick, over the mean, from which on edges move


class _Node(NamedTuple):
    """A box that is cut, or a brick."""

    number: int
    first: int  # of the bricks in it,
    bricks: int  # and how many there are
    points: Ints  # in it
    box: Floats  # (2, 3) [m] its corners

    @property
    def lower(self) -> int:
        """Bricks below the cut."""
        return self.bricks // 2


class Bricks:
    """As many bricks as there are ranks.

    Parameters
    ----------
    points : ndarray, shape (3, n) [m]
        Centres of mass of bodies of this rank; of all ranks together they are to be shared.
    ranks : Ranks
    """

    def __init__(self, points: Floats, ranks: Ranks) -> None:
        self.count = ranks.count
        self.axis = np.zeros(self.count, dtype=np.int64)
        self.place = np.zeros(self.count)
        points = points[:, np.isfinite(points).all(axis=0)]
        self.boxes = np.empty((self.count, 2, 3))
        for level in self._levels(points):
            for node in level:
                self.boxes[node.first] = node.box
            if inner := [node for node in level if node.bricks > 1]:
                self._cut(points, inner, ranks)

    def _levels(self, points: Floats) -> Iterator[list[_Node]]:
        """All of space, then the parts of its cut, and so on: a brick comes after what holds it."""
        space = np.array([[-np.inf] * 3, [np.inf] * 3])
        level = [_Node(0, 0, self.count, np.arange(points.shape[1]), space)]
        while level:
            yield level
            level = [part for node in level for part in self._parts(points, node)]

    def _parts(self, points: Floats, node: _Node) -> Iterator[_Node]:
        """The two boxes of a cut; none of a brick."""
        number, first, bricks, index, box = node
        if bricks == 1:
            return
        axis, place, lower = self.axis[number], self.place[number], node.lower
        is_below = points[axis, index] < place
        below, beyond = box.copy(), box.copy()
        below[1, axis] = beyond[0, axis] = place
        yield _Node(number + 1, first, lower, index[is_below], below)
        yield _Node(number + lower, first + lower, bricks - lower, index[~is_below], beyond)

    def _cut(self, points: Floats, level: list[_Node], ranks: Ranks) -> None:
        """Cut boxes of a level, all ranks together."""
        corners = np.full((len(level), 6), -np.inf)
        for k, node in enumerate(level):
            inside = points[:, node.points]
            corners[k, :3] = (-inside).max(1, initial=-np.inf)
            corners[k, 3:] = inside.max(1, initial=-np.inf)
        corners = ranks.largest(corners)
        low, high = np.where(np.isfinite(corners), corners, 0.0).reshape(-1, 2, 3).swapaxes(0, 1)
        low = -low
        axes = np.argmax(high - low, axis=1)
        ends = np.stack([corner[np.arange(len(level)), axes] for corner in (low, high)], axis=1)
        for node, axis in zip(level, axes.tolist(), strict=True):
            self.axis[node.number] = axis
        for _ in range(_MAX_REFINEMENTS):
            if self._refine(points, level, ends, ranks):
                break

    def _refine(self, points: Floats, level: list[_Node], ends: Floats, ranks: Ranks) -> bool:
        """Cut boxes where counts of bins between two ends (m, 2) say; whether that is near enough.

        The ends become those of the bin in which the right place is.
        """
        counts = np.zeros((len(level), _N_BINS + 2), dtype=np.int64)
        edges = np.linspace(ends[:, 0], ends[:, 1], _N_BINS + 1, axis=1)
        for k, node in enumerate(level):
            along = points[self.axis[node.number], node.points]
            place = np.searchsorted(edges[k], along, side="right")
            counts[k] = np.bincount(place, minlength=_N_BINS + 2)
        below: Ints = np.cumsum(ranks.added(counts), axis=1)  # each edge, all at the end
        is_near = True
        for k, node in enumerate(level):
            target = below[k, -1] * node.lower / node.bricks
            edge = int(np.argmin(np.abs(below[k, :-1] - target)))
            self.place[node.number] = edges[k, edge]
            missed = below[k, edge] - target
            is_near &= bool(abs(missed) <= max(1.0, _MAX_CUT_ERROR * target / node.lower))
            at = min(max(edge - (missed > 0), 0), _N_BINS - 1)
            ends[k] = edges[k, at : at + 2]
        return is_near

    def owners(self, points: Floats) -> Ints:
        """Ranks in whose bricks points (3, n) are; what is not a number is in one of them too."""
        owner = np.zeros(points.shape[1], dtype=np.int64)
        for level in self._levels(points):
            for node in level:
                owner[node.points] = node.first
        return owner

    def distances(self, points: Floats, k: int) -> Floats:
        """Of points (3, n) from brick k [m]; 0 in it."""
        low, high = self.boxes[k, :, :, None]
        apart = np.maximum(np.maximum(low - points, points - high), 0.0)
        return np.asarray(np.sqrt((apart * apart).sum(axis=0)))

    def fitted(self, points: Floats, counts: Ints, ranks: Ranks) -> Self:
        """These bricks, or new ones where bodies, so many in each, are shared too unevenly."""
        is_even = counts.max() <= _MAX_IMBALANCE * counts.mean() and counts.min() > 0
        return self if is_even else type(self)(points, ranks)


def shares_of_bricks(points: Floats, reach: Floats, skin: float, ranks: Ranks) -> tuple[int, int]:
    """Bodies of the fullest brick, and copies of the one that has most, before a run.

    Parameters
    ----------
    points, reach : ndarray, shapes (3, n) and (n,) [m]
        Centres of mass of all bodies, and how far each reaches.
    skin : float [m]
    ranks : Ranks
        Of which one asks for all.
    """
    bricks = Bricks(points, ranks)
    near = reach + float(reach.max(initial=0.0))
    owner, far = bricks.owners(points), near + (1.0 + SPARE) * skin
    near_by = ((bricks.distances(points, k) < far) & (owner != k) for k in range(ranks.count))
    return int(np.bincount(owner).max(initial=0)), max(int(copies.sum()) for copies in near_by)
