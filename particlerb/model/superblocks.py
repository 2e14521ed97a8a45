"""Superblocks: 65 536 bodies each, of which each is summed alone, and then all in their order.

So a sum has the same bits for any number of ranks, each of which has whole superblocks. Files of
ranks are cut there too, in parts that depend on the number of bodies only.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.threads import BLOCK
from particlerb.maths.vec3 import Floats, Ints
from particlerb.ranks import ALONE, Ranks

SUPERBLOCK = 256 * BLOCK
_MAX_PARTS: Final = 1024


class Range(NamedTuple):
    """Bodies `first` to `stop`, that one excluded."""

    first: int
    stop: int


def superblocks(n: int) -> list[Range]:
    """Superblocks of n bodies."""
    if 0 < n <= SUPERBLOCK:
        return [Range(0, n)]
    return [Range(first, min(first + SUPERBLOCK, n)) for first in range(0, n, SUPERBLOCK)]


def superblock_of(first: int, last: int) -> int:
    """Superblock in which both of these bodies lie; -1: they lie in two."""
    return first // SUPERBLOCK if first // SUPERBLOCK == last // SUPERBLOCK else -1


def parts_of(n: int) -> list[Range]:
    """Ranges of n bodies that are files of their own: whole superblocks, as many in each."""
    size = SUPERBLOCK * -(-n // (SUPERBLOCK * _MAX_PARTS))
    return [Range(first, min(first + size, n)) for first in range(0, n, size)]


def own_parts(n_parts: int, ranks: Ranks) -> range:
    """Parts that a rank moves and writes."""
    first, stop = (k * n_parts // ranks.count for k in (ranks.number, ranks.number + 1))
    return range(first, stop)


def writers(n_parts: int, n_ranks: int) -> Ints:
    """Rank that moves and writes each part: see `own_parts`."""
    stops = np.array([k * n_parts // n_ranks for k in range(1, n_ranks + 1)])
    return stops.searchsorted(np.arange(n_parts), side="right")


def range_of(n: int, ranks: Ranks) -> Range:
    """Bodies, of n, that a rank writes: those of its parts; none where there are fewer of these."""
    ranges = parts_of(n)
    parts = own_parts(len(ranges), ranks)
    if not parts:
        return Range(0, 0)
    return Range(ranges[parts[0]].first, ranges[parts[-1]].stop)


def over_blocks(blocks: Floats) -> list[Floats]:
    """Sums of blocks of bodies, (T, n_blocks, ..), over each superblock, (T, ..)."""
    if blocks.shape[1] == 1:
        return [blocks[:, 0]]
    ranges = superblocks(blocks.shape[1] * BLOCK)
    return [np.add.reduce(blocks[:, a // BLOCK : b // BLOCK], axis=1) for a, b in ranges]


def summed(sums: Sequence[Floats], ranks: Ranks = ALONE) -> Floats:
    """Sum over all superblocks, in their order; `sums` has one array for each of this rank.

    One after the other: NumPy's sums take another order where there is one frame only. Of a single
    superblock it is the array itself.
    """
    rows = sums if ranks is ALONE else [row for of_rank in ranks.gathered(sums) for row in of_rank]
    if len(rows) == 1:
        return rows[0]
    total: Floats = rows[0].copy()
    for row in rows[1:]:
        total += row
    return total


def sum_by_number(
    values: Floats, number: Ints, ranks: Ranks = ALONE, size: int | None = None
) -> float:
    """Sum of values of bodies, (n,), in the order of their numbers, superblock by superblock.

    `size` is one more than the largest number; left out, that is one of these.
    """
    room = np.zeros(int(number.max(initial=-1)) + 1 if size is None else size)
    room[number] = values
    sums = [room[first:stop].sum() for first, stop in superblocks(room.size)]
    return float(summed(sums, ranks))
