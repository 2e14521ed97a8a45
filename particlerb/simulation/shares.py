"""The share of one rank in a scene: its bodies, and the groups that move them."""

from typing import Final, NamedTuple

import numpy as np

from particlerb.case.run import frame_count
from particlerb.forces import Terms
from particlerb.model.superblocks import Range, own_parts, parts_of
from particlerb.plan.segments import chosen, is_coupled
from particlerb.ranks import NoRanksError, Ranks
from particlerb.record.file_size import estimated_size
from particlerb.simulation.whole_run import Prepared

BYTES_SET_UP: Final = 720  # of memory for each body of the scene, pushed: benchmarks/ranks.py
BYTES_MOVED: Final = 2050  # beside these for each body that a rank moves, likewise
BYTES_SAVED: Final = 200  # of a checkpoint for each body, likewise
_COUPLING: Final = {
    "contact": "contact",
    "links": "springs between bodies",
    "own_pairs": "forces between bodies",
    "attraction": "attraction",
    "joints": "joints",
}


def refuse_coupled(prepared: Prepared) -> None:
    """Raise NoRanksError where bodies act on each other: they cannot be shared among ranks."""
    system, groups = prepared.system, prepared.plan.groups
    coupled: list[Terms] = [s.terms for g in groups if is_coupled(g) for s in g.segments]
    names = [
        name
        for key, name in _COUPLING.items()
        if any(getattr(terms, key) is not None for terms in coupled)
    ]
    if system.joint and "joints" not in names:
        names.append("joints")
    if names:
        raise NoRanksError(
            f"--mpi shares bodies that do not act on each other: this case has {', '.join(names)};"
            " free bodies and those that forces of the world push may run so, others without --mpi"
        )


def share_of(n_bodies: int, ranks: Ranks) -> Range:
    """Bodies of a rank.

    Raises
    ------
    NoRanksError
        If there are more ranks than parts.
    """
    ranges = parts_of(n_bodies)
    if ranks.count > len(ranges):
        least = ranges[0].stop
        raise NoRanksError(
            f"{ranks.count} ranks are too many for {n_bodies} bodies: a rank takes {least} or more,"
            f" so {len(ranges)} may share them"
        )
    own = own_parts(len(ranges), ranks)
    return Range(ranges[own[0]].first, ranges[own[-1]].stop)


def part_of(prepared: Prepared, ranks: Ranks) -> Prepared:
    """The share of a rank in a prepared system.

    Raises
    ------
    NoRanksError
        If bodies act on each other, or ranks are too many.
    """
    refuse_coupled(prepared)
    first, stop = share_of(prepared.system.n_bodies, ranks)
    groups = []
    for group in prepared.plan.groups:
        own = np.flatnonzero((group.members >= first) & (group.members < stop))
        if own.size:
            groups.append(chosen(group, own, group.members[own] - first))
    plan = prepared.plan._replace(groups=tuple(groups))
    return prepared._replace(system=prepared.system.part(first, stop), plan=plan, first=first)


class Shares(NamedTuple):
    """How ranks share a scene: the most that one of them has."""

    parts: int
    """Files that bodies lie in."""
    in_part: int
    """Bodies of each."""
    bytes_of_part: int
    """Size of each, with two states from which the run can be continued."""
    own_parts: int
    bodies: int
    moving_bytes: int
    """Memory while bodies move, beside that of the set-up."""
    set_up_bytes: int
    """Memory of the set-up, which is of the whole scene on each rank."""
    most: int
    """Ranks at most."""


def shares_of(prepared: Prepared, n_ranks: int) -> Shares:
    """How so many ranks would share a prepared system.

    Raises
    ------
    NoRanksError
        As `part_of`.
    """
    refuse_coupled(prepared)
    system, ranks = prepared.system, Ranks()
    ranks.count = n_ranks
    ranks.number = n_ranks - 1  # the last rank has most parts
    share_of(system.n_bodies, ranks)
    ranges = parts_of(system.n_bodies)
    own, in_part = len(own_parts(len(ranges), ranks)), ranges[0].stop
    bodies = min(own * in_part, system.n_bodies)
    n_bytes = estimated_size(system, frame_count(system.run)) * in_part // system.n_bodies
    return Shares(
        len(ranges), in_part, n_bytes + 2 * BYTES_SAVED * in_part, own, bodies,
        BYTES_MOVED * bodies, BYTES_SET_UP * system.n_bodies, len(ranges),
    )  # fmt: skip
