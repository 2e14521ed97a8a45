"""Scenes that share a batch: which bodies belong to each, and sums over each alone.

Worlds have as many bodies each, numbered one world after the other. A sum over a world takes its
bodies in the order, and in the blocks, in which a run of that world alone would take them: it has
the same bits. Where there is one scene only there is no `Worlds`, and a sum is one number.

Why it is so: docs/decisions/0023.
"""

from typing import NamedTuple

import numpy as np

from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.superblocks import over_blocks, summed


class WorldsDifferError(Exception):
    """Scenes that cannot share a batch: what differs."""


class Worlds(NamedTuple):
    """Which bodies of a group belong to which scene."""

    bodies: Ints
    """Rows of the group, shape (n_worlds, m), in their order."""

    @property
    def numbers(self) -> Ints:
        """World of each body of the group, shape (n_worlds m,)."""
        world = np.empty(self.bodies.size, dtype=np.int64)
        world[self.bodies] = np.arange(len(self.bodies))[:, None]
        return world


def worlds_among(world: Ints, n_worlds: int) -> Worlds:
    """Worlds of bodies that are numbered by their world, (n,).

    Raises
    ------
    WorldsDifferError
        If some have more bodies here than others.
    """
    if np.unique(np.bincount(world, minlength=n_worlds)).size != 1:
        raise WorldsDifferError("bodies that advance together are not as many in each")
    return Worlds(np.argsort(world, kind="stable").reshape(n_worlds, -1))


def part_of_worlds(worlds: Worlds | None, index: Ints) -> Worlds | None:
    """Worlds of some bodies of a group, ascending."""
    if worlds is None:
        return None
    return worlds_among(worlds.numbers[index], len(worlds.bodies))


def shape_of(worlds: Worlds | None) -> tuple[int, ...]:
    """Shape of one number for each world."""
    return () if worlds is None else (len(worlds.bodies),)


def over_bodies(values: Floats, worlds: Worlds | None) -> Floats:
    """Sums over the last axis of (..., n): (...) of one scene, or (n_worlds, ...).

    NumPy's order of adding depends on the order of the axes in memory: that is always this one.
    """
    if worlds is None:
        return np.asarray(np.ascontiguousarray(values).sum(axis=-1))
    by_world = np.ascontiguousarray(np.moveaxis(values.take(worlds.bodies, axis=-1), -2, 0))
    return np.asarray(by_world.sum(axis=-1))


def over_pairs(values: Floats, first: Ints, worlds: Worlds | None) -> Floats | float:
    """Sum over pairs of bodies, (s,), of which the first are these; of each world, (n_worlds,)."""
    if worlds is None:
        return float(values.sum())
    return over_bodies(values, worlds_among(worlds.numbers[first], len(worlds.bodies)))


def over_all(values: Floats, worlds: Worlds | None) -> Floats:
    """Sums over all components and bodies, (k, n), of one scene or of each world."""
    if worlds is None:
        return np.asarray(values.sum())
    by_world = np.ascontiguousarray(np.moveaxis(values.take(worlds.bodies, axis=-1), -2, 0))
    return np.asarray(by_world.reshape(len(by_world), -1).sum(axis=-1))


def bins_of(block: Ints, worlds: Worlds | None) -> Ints:
    """Where each of n bodies is summed: a bin for each block, of one scene or of each world.

    Parameters
    ----------
    block : ndarray, shape (n,) or (m,)
        Block of each body of the scene, or of one world alone.
    """
    if worlds is None:
        return block
    n_worlds, bins = len(worlds.bodies), np.empty(worlds.bodies.size, dtype=np.int64)
    bins[worlds.bodies] = (int(block.max()) + 1) * np.arange(n_worlds)[:, None] + block
    return bins


def bins_among(index: Ints, worlds: Worlds | None, size: int) -> tuple[Ints, int]:
    """Bins of some bodies of a group, ascending, in blocks of a size in each world; and how many.

    Worlds may have more or fewer of these bodies: all have as many bins.
    """
    n = index.size
    if worlds is None:
        return np.arange(n) // size, -(-n // size)
    world = worlds.numbers[index]
    count = np.bincount(world, minlength=len(worlds.bodies))
    place = np.arange(n) - (np.cumsum(count) - count)[world]
    in_each = -(-int(count.max()) // size)
    return in_each * world + place // size, in_each * len(worlds.bodies)


def over_bins(sums: Floats, worlds: Worlds | None) -> Floats:
    """Sums over the bins, (T, bins, ..), of one scene or of each world: (T, ..), (T, n_worlds, ..).

    Those of one scene are blocks of 256 bodies, and are summed by superblocks.
    """
    if worlds is None:
        return summed(over_blocks(sums))
    n_worlds, (n_frames, bins, *width) = len(worlds.bodies), sums.shape
    return np.asarray(sums.reshape(n_frames, n_worlds, bins // n_worlds, *width).sum(axis=2))
