"""Attraction among very many bodies: a tree over their centres of mass, in time n log n.

The tree is grown and filled anew at each evaluation (cells.py), then gone through from the root
(walk.py). Cells A and B with

    2 (ρ_A² + ρ_B²) < θ² |X_A - X_B|²,  ρ the distance of the furthest particle from X,

meet as a whole (multipole.py): for cells alike that is ρ_A + ρ_B < θ |X_A - X_B|, and others do not
err by more. Otherwise the larger one is split, and buckets meet particle by particle. What a pair
does depends on both alike, so that A meets B where B meets A, with the opposite force to rounding;
each cell sums its own side in a fixed order, whatever thread does it.
Source of the mutual walk: Dehnen, J. Comput. Phys. 179, 27 (2002).
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces.attraction import Attraction
from particlerb.forces.gravity_tree.cells import (
    BALL,
    DEEPEST,
    Cells,
    Kinds,
    Nodes,
    TreePoints,
    add_loads,
    fill_cells,
    grow,
    place_points,
    room_for_nodes,
)
from particlerb.forces.gravity_tree.lanes import BUCKET
from particlerb.forces.gravity_tree.multipole import MOMENT, ROWS, TERMS
from particlerb.forces.gravity_tree.walk import RANGES, Scratch, walk
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import aligned_zeros

_WALK_PARTS: Final = 64  # that are shared out
_MIN_PART_PARTICLES: Final = 1024  # well above what its way from the root costs
_BODY_STEPS_PER_PARTICLE: Final = 32  # that a particle in the tree takes as long as
BREAK_EVEN: Final = 8_000  # particles from which on it is faster than a direct sum, at 1e-4


def _tree_of_each(arm: Floats, offset: Ints) -> tuple[Ints, list[Nodes]]:
    """Order of the particles, and the trees of bodies of more than BUCKET of them."""
    order, trees = np.arange(arm.shape[1]), []
    none, stack = room_for_nodes(0), np.zeros((5, 2 * DEEPEST), dtype=np.int64)
    for b in range(offset.size - 1):
        lo, hi = int(offset[b]), int(offset[b + 1])
        if hi - lo <= BUCKET:
            trees.append(none)
            continue
        local, ones = np.arange(hi - lo), np.ones(hi - lo, dtype=np.int64)
        nodes = room_for_nodes(2 * (hi - lo))
        items = (arm[:, lo:hi].copy(), local, ones)
        count = grow(items, none, np.zeros(1, dtype=np.int64), nodes, stack)
        order[lo:hi] = lo + local
        trees.append(Nodes(*(row[:count].copy() for row in nodes)))
    return order, trees


def _kinds_of(attraction: Attraction) -> Kinds:
    """Bring the particles of each body into the order of its own tree."""
    order, trees = _tree_of_each(attraction.arm, attraction.offset)
    sizes = [tree.second.size for tree in trees]
    joined = Nodes(*(np.concatenate(rows) for rows in zip(*trees, strict=True)))
    arm = np.ascontiguousarray(attraction.arm[:, order])
    node_offset = np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])
    return Kinds(arm, attraction.mass[order], attraction.offset, joined, node_offset)


class Tree:
    """Attraction of a group of bodies, by a tree that is grown anew at each evaluation."""

    def __init__(self, attraction: Attraction, angle: float) -> None:
        """Prepare for evaluations.

        Parameters
        ----------
        attraction : Attraction
            Particles; no two of different bodies at one place unless softened.
        angle : float [rad]
            θ: cells meet as a whole if both seen from the other's centre appear smaller; see
            opening_angle.py.
        """
        self.kinds, self.angle, self.softening = _kinds_of(attraction), angle, attraction.softening
        n_bodies, n_points = attraction.offset.size - 1, attraction.mass.size
        self.gravitation = float(attraction.gm.sum() / attraction.mass.sum())
        n_nodes = 2 * n_bodies + self.kinds.nodes.second.size
        self.nodes = room_for_nodes(n_nodes)
        self.cells = Cells(
            np.zeros((n_nodes + n_points, BALL)), np.zeros((n_nodes, TERMS)), np.zeros(n_nodes)
        )
        self.points = TreePoints(
            np.zeros((3, n_points)), np.zeros(n_points), np.zeros(n_points), np.zeros((3, n_points))
        )
        self.order, self.begin = np.arange(n_bodies), np.zeros(n_bodies + 1, dtype=np.int64)
        self.weight = np.diff(attraction.offset)
        self.count = 0

    def loads(self, y: Floats, load: Floats) -> None:
        """Add force and torque of all bodies; y and load with the component first.

        Parameters
        ----------
        y : ndarray, shape (13, n_bodies)
            Centre of mass [m], unit quaternion from rotor frame to world; the rest is not used.
        load : ndarray, shape (rows, n_bodies) [N, N m]
            Force in rows 0 to 2, torque about the centre of mass in rows 3 to 5, world axes.
        """
        self.walk(y)
        tree = self.kinds, y, self.order, self.begin, self.points
        self.spread_bodies(partial(add_loads, *tree, self.gravitation, load))

    def potential_energy(self, y: Floats) -> float:
        """U [J] of which the loads are the derivatives, as long as the same cells meet."""
        self.walk(y)
        return self.gravitation * float(self.cells.energy[: self.count].sum())

    def walk(self, y: Floats) -> None:
        """Grow the tree around bodies at y (13, n) and find the fields at all particles."""
        self.grow(y)
        scratch = self.scratch()
        tree = (self.nodes, self.points, self.cells)
        THREADS.alone(fill_cells, *tree, scratch.rows, scratch.powers, self.count)
        pieces, square = self.pieces(), self.angle * self.angle

        def part(first: int, end: int) -> None:
            start, stop = int(pieces[first]), int(pieces[end])
            walk(tree, self.scratch(), square, self.softening, start, stop)

        THREADS.share(part, pieces.size - 1, _BODY_STEPS_PER_PARTICLE * self.points.mass.size)

    def grow(self, y: Floats) -> None:
        """Write nodes and places of particles of bodies at y (13, n)."""
        kinds, order = self.kinds, np.arange(self.order.size)
        items = (y[:3].copy(), order, self.weight.copy())
        stack = np.zeros((5, 2 * DEEPEST), dtype=np.int64)
        self.count = grow(items, kinds.nodes, kinds.node_offset, self.nodes, stack)
        self.order = order
        np.cumsum(items[2], out=self.begin[1:])
        ball = self.cells.ball[self.nodes.second.size :]
        self.spread_bodies(partial(place_points, kinds, y, order, self.begin, self.points, ball))

    def spread_bodies(self, part: Callable[[int, int], object]) -> None:
        """Call part(first, last) for ranges of bodies."""
        n = self.order.size
        THREADS.spread(
            lambda first, end: part(first * BLOCK, min(end * BLOCK, n)), n, self.points.mass.size
        )

    def pieces(self) -> Ints:
        """First cells of the parts of the walk, and the number of cells; not of threads."""
        nodes, count = self.nodes, self.count
        most = max(_MIN_PART_PARTICLES, self.points.mass.size // _WALK_PARTS)
        size = nodes.stop[:count] - nodes.first[:count]
        is_piece = (size <= most) | (nodes.second[:count] == 0)
        starts, k = [], 0
        while k < count:
            if is_piece[k]:
                starts.append(k)
                k = int(nodes.end[k])
            else:
                k += 1
        return np.array([*starts, count])

    def scratch(self) -> Scratch:
        """Room of one thread; most of `meets` is never touched."""
        most = int(self.weight.max())
        levels = self.order.size.bit_length() + most.bit_length() + 4
        return Scratch(
            aligned_zeros(ROWS * BUCKET),
            aligned_zeros(MOMENT * BUCKET),
            np.zeros(TERMS),
            np.zeros(TERMS),
            np.zeros((DEEPEST + 2, TERMS)),
            np.zeros(BUCKET, dtype=np.int64),
            np.zeros(2 * RANGES, dtype=np.int64),
            np.zeros((5, 4 * DEEPEST), dtype=np.int64),
            np.empty(levels * (self.points.mass.size + self.count), dtype=np.int64),
        )
