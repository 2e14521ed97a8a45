"""What the steps of integrators are made of: loads, kicks, flows of dashpots, drifts.

A stage works on the blocks `first` to `last`, `last` excluded, of `MovingBodies`. Where a loop over
steps runs as Python, to spread large sums over threads, `over_threads` puts kernels that spread
each stage in the place of those that are compiled into the loop: the sums are the same to the bit.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

from particlerb.compiled.jit import Flag, in_python, inline, kernel, splice
from particlerb.compiled.threads import THREADS
from particlerb.forces.attraction import Attraction, Work, attraction_loads
from particlerb.forces.kernels import Acting, load_at, prepare_kick, set_time
from particlerb.forces.links import Links, damp_links, link_loads
from particlerb.forces.registry import PAIR
from particlerb.integrators.joint_stages import drift_jointed, project_jointed
from particlerb.integrators.kick import kick_body
from particlerb.joints.records import Jointed
from particlerb.maths.quaternion import matrix
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import BOOKED, COM, L, P, Q, get, get3, get4, put
from particlerb.model.load import LOAD_ROWS, POWER, STATE_ROWS

Function = TypeVar("Function", bound=Callable[..., Any])
_MOMENTA: Final = 7  # row of a state from which on p and L are
_STAGES: Final[dict[int, Callable[..., None]]] = {}  # kernels that are spread, by id of the stage


class Layout(NamedTuple):
    """Which bodies of a group are in which block: asymmetric ones first, where that matters.

    A block has bodies in the order of the group, which is that of their numbers in the scene
    within each class of rotors; all sums over bodies are taken in this order, block by block.
    """

    first: Ints  # (blocks,)
    size: Ints  # (blocks,)
    asymmetric: int  # blocks


class RotorClasses(NamedTuple):
    """Which kinds of blocks there are, for methods that step asymmetric bodies in another way."""

    asymmetric: Flag = None
    symmetric: Flag = None


class PairTerms(NamedTuple):
    """Forces between the bodies of a group, and room to evaluate them."""

    links: Links | None
    attraction: Attraction | None
    work: Work | None
    with_dashpots: bool  # whether they are among the loads, and not flows
    y: Floats  # (13, n) states
    load: Floats  # (13, n), rows of model/load.py
    booked: Floats  # (13, n) the same rows, of flows


class MovingBodies(NamedTuple):
    """Bodies in blocks with what acts on them, as stages take them."""

    blocks: Floats  # (blocks, rows * STRIDE), see model/block.py
    layout: Layout
    acting: Acting
    books: Flag  # whether work and impulses are summed up
    rotors: RotorClasses
    pairs: PairTerms | None  # None: no body acts on another without touching it
    dashpots: Flag  # whether they act as flows
    jointed: Jointed | None = None  # None: no joint holds them


def stage(function: Function) -> Function:
    """Compile a stage `(moving, first, last, ...)` whose blocks have nothing to do with others."""
    inlined = inline(function)
    _STAGES[id(inlined)] = kernel(function)
    return inlined


def over_threads(function: Function, **names: Any) -> Function:
    """A function made of stages, as Python that spreads each of them over threads."""
    plain = getattr(function, "py_func", function)
    for name, value in plain.__globals__.items():
        if id(value) in _STAGES:
            names.setdefault(name, partial(_spread_stage, _STAGES[id(value)]))
    return in_python(function, **names)


def _spread_stage(
    kernel: Callable[..., None], moving: MovingBodies, first: int, last: int, *others: Any
) -> None:
    """Call a stage for shares of the blocks."""
    assert first == 0
    n = int(moving.layout.size.sum())
    THREADS.share(lambda lo, hi: kernel(moving, lo, hi, *others), last, n)


# Loads


@inline
def gather_block(rows: Floats, y: Floats, lo: int, n: int) -> None:
    """States of a block whose first body is lo, into y (13, n_bodies)."""
    for c in range(STATE_ROWS):
        out = y[c, lo : lo + n]
        for b in range(out.size):
            out[b] = get(rows, c, b)


@inline
def _gather(blocks: Floats, layout: Layout, y: Floats) -> None:
    """States of all blocks, into y (13, n)."""
    for k in range(layout.first.size):
        gather_block(blocks[k], y, layout.first[k], layout.size[k])


@inline
def scatter_block(values: Floats, rows: Floats, at: int, first: int, lo: int, n: int) -> None:
    """Rows of values (rows, n_bodies) from `first` on, into the rows of a block from `at` on."""
    for c in range(first, values.shape[0]):
        own = values[c, lo : lo + n]
        for b in range(own.size):
            put(rows, at + c - first, b, own[b])


@inline
def scatter(values: Floats, blocks: Floats, layout: Layout, at: int, first: int) -> None:
    """Rows of values (rows, n) from `first` on, into the rows of all blocks from `at` on."""
    for k in range(layout.first.size):
        scatter_block(values, blocks[k], at, first, layout.first[k], layout.size[k])


@inline
def _attraction_into(
    attraction: Attraction | None, work: Work | None, y: Floats, load: Floats
) -> None:
    """Add the loads of a direct sum, if there is one."""
    if attraction is None or work is None:
        return
    attraction_loads(attraction, work, y, load)


@inline
def clear(load: Floats) -> None:
    """Make all loads zero."""
    for c in range(load.shape[0]):
        for b in range(load.shape[1]):
            load[c, b] = 0.0


@inline
def pair_loads(
    links: Links | None,
    attraction: Attraction | None,
    work: Work | None,
    with_dashpots: bool,
    y: Floats,
    load: Floats,
) -> None:
    """Loads in the state y, on this thread.

    Takes what `PairTerms` has one by one: unpacking it in each call costs more than two points.
    """
    clear(load)
    link_loads(links, y, load, with_dashpots)
    _attraction_into(attraction, work, y, load)


@inline
def _put_pair_loads(pairs: PairTerms | None, blocks: Floats, layout: Layout) -> None:
    """Loads of all bodies at their poses of now, if any acts on another."""
    if pairs is None:
        return
    links, attraction, work, with_dashpots, y, load, _ = pairs
    _gather(blocks, layout, y)
    pair_loads(links, attraction, work, with_dashpots, y, load)
    scatter(load, blocks, layout, PAIR, 0)


@splice
def loads(moving: MovingBodies) -> None:
    """Write what bodies do to each other into their rows PAIR."""
    _put_pair_loads(moving.pairs, moving.blocks, moving.layout)


@kernel
def gather_states(moving: MovingBodies, y: Floats) -> None:
    """`_gather`, for loops that run as Python."""
    _gather(moving.blocks, moving.layout, y)


@kernel
def scatter_loads(moving: MovingBodies, load: Floats) -> None:
    """`scatter` into the rows PAIR, for such loops."""
    scatter(load, moving.blocks, moving.layout, PAIR, 0)


# Kicks and flows


@stage
def set_times(moving: MovingBodies, first: int, last: int, t: float) -> None:
    """Take loads that depend on time at t [s] since the segment began."""
    for k in range(first, last):
        set_time(moving.acting, moving.blocks[k], moving.layout.size[k], t)


@stage
def kick(moving: MovingBodies, first: int, last: int, dt: float) -> None:
    """Exact flow of the forces at a fixed pose, drag included."""
    for k in range(first, last):
        rows, n = moving.blocks[k], moving.layout.size[k]
        prepare_kick(moving.acting, rows, n, dt)
        for b in range(n):
            kick_body(moving.acting, moving.books, rows, b, dt)


@inline
def damp(
    dashpots: Flag,
    pairs: PairTerms | None,
    blocks: Floats,
    layout: Layout,
    dt: float,
    backwards: bool,
) -> None:
    """Do the work of `flow_dashpots`, if there are any."""
    if dashpots is None or pairs is None:
        return
    links, _, _, _, y, _, booked = pairs
    _gather(blocks, layout, y)
    clear(booked)
    damp_links(links, y, booked, dt, backwards)
    scatter(y, blocks, layout, P, _MOMENTA)
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for c in range(LOAD_ROWS - POWER):
            for b in range(layout.size[k]):
                value = get(rows, BOOKED + c, b) + booked[POWER + c, lo + b]
                put(rows, BOOKED + c, b, value)


@kernel
def flow_dashpots(moving: MovingBodies, dt: float, backwards: bool) -> None:
    """Exact flow of each dashpot over dt, one after the other; their work is booked."""
    damp(moving.dashpots, moving.pairs, moving.blocks, moving.layout, dt, backwards)


@inline
def _drift_held(jointed: Jointed | None, books: Flag, blocks: Floats, dt: float) -> None:
    """Do the work of `constrained_drift`, if there are joints."""
    if jointed is None:
        return
    joints, work, block, lane = jointed
    drift_jointed(books, joints, work, blocks, block, lane, dt)


@kernel
def constrained_drift(moving: MovingBodies, dt: float) -> None:
    """Drift over dt with the impulses of joints that let it end where they hold."""
    _drift_held(moving.jointed, moving.books, moving.blocks, dt)


@inline
def _project_held(jointed: Jointed | None, books: Flag, blocks: Floats) -> None:
    """Do the work of `project`, if there are joints."""
    if jointed is None:
        return
    joints, work, block, lane = jointed
    project_jointed(books, joints, work, blocks, block, lane)


@kernel
def project(moving: MovingBodies) -> None:
    """Take from the momenta what would break a joint."""
    _project_held(moving.jointed, moving.books, moving.blocks)


@kernel
def gather_loads(moving: MovingBodies, t: float, out: Floats) -> None:
    """Force and torque on all bodies (6, n) at t [s] since the segment began."""
    last = moving.layout.first.size
    set_times(moving, 0, last, t)
    loads(moving)
    for k in range(last):
        rows, lo = moving.blocks[k], moving.layout.first[k]
        prepare_kick(moving.acting, rows, moving.layout.size[k], 1.0)
        for b in range(moving.layout.size[k]):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            F, tau, _, _ = load_at(moving.acting, rows, b, x, R, get3(rows, P, b), get3(rows, L, b))
            for i in range(3):
                out[i, lo + b] = F[i]
                out[3 + i, lo + b] = tau[i]


@kernel
def close(moving: MovingBodies, first: int, last: int, open_kick: float) -> None:
    """Make the kick that the last step has left open."""
    if open_kick > 0.0:
        flow_dashpots(moving, open_kick, True)
        loads(moving)
        kick(moving, first, last, open_kick)
        project(moving)
