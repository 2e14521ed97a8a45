"""Superblocks: 65 536 bodies each, of which each is summed alone, and then all in their order.

So a sum has the same bits for any number of ranks, each of which has whole superblocks. Files of
ranks are cut there too, in parts that depend on the number of bodies only.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

from particlerb.compiled.threads import BLOCK
from particlerb.maths.vec3 import Floats
from particlerb.ranks import ALONE, Ranks

SUPERBLOCK = 256 * BLOCK
_MOST_PARTS: Final = 1024


class Range(NamedTuple):
    """Bodies `first` to `stop`, that one excluded."""

    first: int
    stop: int


def superblocks(n: int) -> Iterator[Range]:
    """Superblocks of n bodies."""
    for first in range(0, n, SUPERBLOCK):
        yield Range(first, min(first + SUPERBLOCK, n))


def parts_of(n: int) -> list[Range]:
    """Ranges of n bodies that are files of their own: whole superblocks, as many in each."""
    each = SUPERBLOCK * -(-n // (SUPERBLOCK * _MOST_PARTS))
    return [Range(first, min(first + each, n)) for first in range(0, n, each)]


def own_parts(n_parts: int, ranks: Ranks) -> range:
    """Parts that a rank moves and writes."""
    first, stop = (k * n_parts // ranks.count for k in (ranks.number, ranks.number + 1))
    return range(first, stop)


def summed(own: Sequence[Floats], ranks: Ranks = ALONE) -> Floats:
    """Sum over all superblocks, in their order; `own` has one array for each of this rank.

    One after the other: NumPy's sums take another order where there is one frame only. Of a single
    superblock it is the array itself.
    """
    rows = [row for of_rank in ranks.gathered(own) for row in of_rank]
    if len(rows) == 1:
        return rows[0]
    total: Floats = rows[0].copy()
    for row in rows[1:]:
        total += row
    return total
