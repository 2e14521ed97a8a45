"""Forces between the bodies of a group that do not touch, among the stages of a step.

They take states as one array (13, n) and give loads as another; the rows of blocks are brought
there and back. Threads that share a step meet where one of them does this for all.
"""

from typing import Final, NamedTuple

from particlerb.compiled.barrier import Team, meet
from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.forces.attraction import Attraction, Fields, attraction_loads
from particlerb.forces.links import Links, damp_links, link_loads
from particlerb.forces.registry import PAIR
from particlerb.forces.user_pairs import UserPairs, flow_user_pairs, user_pair_loads
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import EXTERNAL, P, gather_block, get, put, scatter_block
from particlerb.model.load import LOAD_ROWS, POWER

_MOMENTA_ROW: Final = 7  # of a state, from which on p and L are


class Layout(NamedTuple):
    """Which bodies of a group are in which block: asymmetric ones first, where that matters.

    A block has bodies in the order of the group, which is that of their numbers in the scene
    within each class of rotors; all sums over bodies are taken in this order, block by block.
    """

    first: Ints  # (blocks,)
    size: Ints  # (blocks,)
    asymmetric: int  # blocks


class BlockShare(NamedTuple):
    """Blocks of bodies that a thread works on."""

    blocks: Floats  # all of the group
    layout: Layout
    first: int
    end: int  # excluded


class PairTerms(NamedTuple):
    """Forces between the bodies of a group, and room to evaluate them."""

    links: Links | None
    user_pairs: UserPairs | None
    attraction: Attraction | None
    fields: Fields | None
    with_dashpots: bool  # whether they are among the loads, and not flows
    clock: Floats  # [s] (3,): of the loads, when the step began, and the segment
    y: Floats  # (13, n) states
    load: Floats  # (13, n), rows of model/load.py; of users without a potential (19, n)
    flows: Floats  # (13, n) the same rows, of flows; room for gradients


@kernel
def gather_states(blocks: Floats, layout: Layout, y: Floats) -> None:
    """States of all blocks, into y (13, n)."""
    for k in range(layout.first.size):
        gather_block(blocks[k], y, layout.first[k], layout.size[k])


@kernel
def scatter(values: Floats, blocks: Floats, layout: Layout, at: int, first: int) -> None:
    """Rows of values (rows, n) from `first` on, into the rows of all blocks from `at` on."""
    for k in range(layout.first.size):
        scatter_block(values, blocks[k], at, first, layout.first[k], layout.size[k])


@inline
def pair_loads(
    links: Links | None,
    user_pairs: UserPairs | None,
    attraction: Attraction | None,
    fields: Fields | None,
    with_dashpots: bool,
    clock: Floats,
    y: Floats,
    load: Floats,
) -> None:
    """Loads in the state y, on this thread.

    Takes what `PairTerms` has one by one: unpacking it in each call costs more than two points.
    """
    load[:] = 0.0
    link_loads(links, y, load, with_dashpots)
    user_pair_loads(user_pairs, clock[0], y, load, with_dashpots)
    attraction_loads(attraction, fields, y, load)


@inline
def put_pair_loads(
    team: Team | None, pairs: PairTerms | None, blocks: Floats, layout: Layout
) -> None:
    """Loads of all bodies at their poses of now, if any acts on another without touching it.

    In a team the first thread evaluates them: `contact_stages` gathers states and scatters loads.
    """
    if pairs is None:
        return
    links, user_pairs, attraction, fields, with_dashpots, clock, y, load, _ = pairs
    if team is None:
        gather_states(blocks, layout, y)
        pair_loads(links, user_pairs, attraction, fields, with_dashpots, clock, y, load)
        scatter(load, blocks, layout, PAIR, 0)
    elif team.thread == 0:
        pair_loads(links, user_pairs, attraction, fields, with_dashpots, clock, y, load)


@kernel
def flow_pairs(
    dashpots: Flag,
    team: Team | None,
    pairs: PairTerms | None,
    blocks: Floats,
    layout: Layout,
    dt: float,
    backwards: bool,
) -> None:
    """Flow of each dashpot, and pair of users, over dt, one after the other, if there are any.

    Their work is added. In a team the first thread does it while the others wait.
    """
    if dashpots is None or pairs is None:
        return
    meet_all(team)
    if team is None or team.thread == 0:
        links, user_pairs, _, _, _, clock, y, _, flows = pairs
        gather_states(blocks, layout, y)
        flows[:] = 0.0
        if backwards:
            flow_user_pairs(user_pairs, clock[0], y, flows, dt, backwards)
        damp_links(links, y, flows, dt, backwards)
        if not backwards:
            flow_user_pairs(user_pairs, clock[0], y, flows, dt, backwards)
        scatter(y, blocks, layout, P, _MOMENTA_ROW)
        for k in range(layout.first.size):
            rows, lo = blocks[k], layout.first[k]
            for c in range(LOAD_ROWS - POWER):
                for b in range(layout.size[k]):
                    value = get(rows, EXTERNAL + c, b) + flows[POWER + c, lo + b]
                    put(rows, EXTERNAL + c, b, value)
    meet_all(team)


@inline
def meet_all(team: Team | None) -> None:
    """Wait for all of a team, if there is one."""
    if team is not None:
        meet(team)
