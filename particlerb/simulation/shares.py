"""The share of one rank in a scene: its bodies, and the groups that move them."""

from typing import Final

import numpy as np

from particlerb.forces import Terms
from particlerb.model.superblocks import Range, own_parts, parts_of
from particlerb.plan.segments import chosen, is_coupled
from particlerb.ranks import NoRanksError, Ranks
from particlerb.simulation.whole_run import Prepared

_COUPLING: Final = {
    "contact": "contact",
    "links": "springs between bodies",
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
