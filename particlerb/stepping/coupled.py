"""Bodies that act on each other, on a grid of steps: all blocks take every stage together.

A method brings `stage(k, is_asymmetric, acting, books, rows, n, opening, dt)` for a block of
bodies, how many STAGES a step has, and its EDGE as in `stepped`. Before each stage the forces
between the bodies are evaluated. Dashpots act between the kick and the drift of `strang` as exact
flows, in one order before the drift and in the reverse order after it, so the order stays two.

The loop over steps is written once: compiled whole for small scenes, and as Python that spreads
each stage over threads for large ones. Both take the same sums in the same order.
"""

from collections.abc import Callable
from functools import partial
from types import FunctionType
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel, kernel_from
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of
from particlerb.forces.kernels import Acting, set_time
from particlerb.forces.links import Links, damp_links
from particlerb.forces.registry import PAIR, STAGE
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, rows3
from particlerb.model.block import (
    BOOKED,
    CHANGING,
    COM,
    STRIDE,
    L,
    P,
    Q,
    copy_changing,
    get,
    in_blocks,
    into_blocks,
    out_of_blocks,
    put,
)
from particlerb.model.load import LOAD_ROWS, POWER, STATE_ROWS
from particlerb.model.state import Frames, State, store_frame
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.stepping.external_work import store_sums
from particlerb.stepping.loop import PAUSE, Schedule, SteppedMotion, close
from particlerb.stepping.motion import Group
from particlerb.stepping.pair_forces import (
    PairForces,
    PairTerms,
    clear,
    loads_over_threads,
    pair_loads,
)

MOMENTA: Final = 7  # row of a state from which on p and L are
STAGE_ROWS: Final = 2 * STATE_ROWS  # for methods that keep a state and a sum of slopes


class Layout(NamedTuple):
    """Which bodies of a group are in which block: asymmetric ones first, in blocks of their own."""

    first: Ints  # (blocks,)
    size: Ints  # (blocks,)
    asymmetric: int  # blocks


def layout_of(rotor_class: Ints) -> Layout:
    """Blocks for bodies of which the asymmetric ones come first."""
    n, asymmetric = rotor_class.size, int((rotor_class == ASYMMETRIC).sum())
    assert (rotor_class[:asymmetric] == ASYMMETRIC).all()
    first = np.r_[np.arange(0, asymmetric, BLOCK), np.arange(asymmetric, n, BLOCK)]
    ends = np.minimum(first + BLOCK, np.where(first < asymmetric, asymmetric, n))
    return Layout(first, ends - first, -(-asymmetric // BLOCK))


@inline
def gather_block(rows: Floats, y: Floats, lo: int, n: int) -> None:
    """States of a block whose first body is lo, into y (13, n_bodies)."""
    for c in range(STATE_ROWS):
        out = y[c, lo : lo + n]
        for b in range(out.size):
            out[b] = get(rows, c, b)


@inline
def gather(blocks: Floats, layout: Layout, y: Floats) -> None:
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


@kernel
def damp(
    blocks: Floats,
    layout: Layout,
    links: Links | None,
    y: Floats,
    booked: Floats,
    dt: float,
    backwards: bool,
) -> None:
    """Flow of all dashpots over dt; their work and what the world gave is booked."""
    gather(blocks, layout, y)
    clear(booked)
    damp_links(links, y, booked, dt, backwards)
    scatter(y, blocks, layout, P, MOMENTA)
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for c in range(LOAD_ROWS - POWER):
            for b in range(layout.size[k]):
                value = get(rows, BOOKED + c, b) + booked[POWER + c, lo + b]
                put(rows, BOOKED + c, b, value)


@kernel
def copy_blocks(source: Floats, target: Floats, layout: Layout) -> None:
    """Copy what changes with time."""
    for k in range(layout.first.size):
        copy_changing(source[k], target[k], layout.size[k])


@kernel
def store_blocks(
    blocks: Floats,
    layout: Layout,
    books: int | None,
    rotor_frame: Floats,
    members: Ints,
    frames: Frames,
    sums: Floats,
    f: int,
    first: int,
    last: int,
) -> None:
    """Write the bodies of some blocks into frame f."""
    for k in range(first, last):
        rows, lo, n = blocks[k], layout.first[k], layout.size[k]
        local = rows.reshape(rows.size // STRIDE, STRIDE)
        com, q = rows3(local[COM : COM + 3], 0, n), rows4(local[Q : Q + 4], 0, n)
        p, spin = rows3(local[P : P + 3], 0, n), rows3(local[L : L + 3], 0, n)
        turn = rows4(rotor_frame, lo, lo + n)
        store_frame(frames, f, members[lo : lo + n], turn, com, q, p, spin)
        store_sums(sums, f, k, books, rows, n)


@inline
def stage(
    k: int,
    is_asymmetric: bool,
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    opening: float,
    dt: float,
) -> None:
    """Stage k of a step dt of a block; stands for that of a method."""
    raise NotImplementedError


def move_blocks(
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    k: int,
    opening: float,
    dt: float,
    first: int,
    last: int,
) -> None:
    """Stage k of some blocks; `kernel_from` puts a method's stage in."""
    for i in range(first, last):
        is_asymmetric = i < layout.asymmetric
        stage(k, is_asymmetric, acting, books, blocks[i], layout.size[i], opening, dt)


@kernel
def close_blocks(
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    dt: float,
    first: int,
    last: int,
) -> None:
    """Make the open kick of some blocks."""
    for i in range(first, last):
        close(acting, books, blocks[i], layout.size[i], dt)


@kernel
def set_times(
    blocks: Floats, layout: Layout, acting: Acting, t: float, first: int, last: int
) -> None:
    """Begin a step of some blocks at a time [s] since the segment began."""
    for i in range(first, last):
        set_time(acting, blocks[i], layout.size[i], t)


@inline
def move(
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    k: int,
    opening: float,
    dt: float,
) -> None:
    """Stage k of all blocks; stands for that of a method."""
    raise NotImplementedError


STAGES: Final = 1  # stands for the number of a method
EDGE: Final = 0.0  # and for its edge


def advance_together(
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    pairs: PairTerms,
    flows: int | None,
    schedule: Schedule,
    rotor_frame: Floats,
    members: Ints,
    frames: Frames,
    sums: Floats,
    saved: Floats,
) -> None:
    """Take a group through a schedule, like `stepped.advance_blocks`."""
    dt, behind, steps, rest, frame = schedule
    links, attraction, work, with_dashpots, y, load, booked = pairs
    is_open = EDGE * dt if behind > 0 else 0.0
    taken = behind
    for s in range(steps.size):
        was_open = is_open
        for i in range(steps[s] + 1):  # the last is the partial step to a frame
            h = dt
            if i == steps[s]:
                if frame[s] < 0:
                    break
                copy_blocks(blocks, saved, layout)
                h, was_open = rest[s], is_open
            if h > 0.0:
                set_times(blocks, layout, acting, taken * dt, 0, len(blocks))
                if flows is not None:
                    damp(blocks, layout, links, y, booked, is_open, True)
                for k in range(STAGES):
                    gather(blocks, layout, y)
                    pair_loads(links, attraction, work, with_dashpots, y, load)
                    scatter(load, blocks, layout, PAIR, 0)
                    if flows is not None:
                        move(blocks, layout, acting, books, k, EDGE * h + is_open, 0.0)
                        damp(blocks, layout, links, y, booked, EDGE * h, False)
                        move(blocks, layout, acting, books, k, 0.0, h)
                    else:
                        move(blocks, layout, acting, books, k, EDGE * h + is_open, h)
                is_open = EDGE * h
            taken += 1 if i < steps[s] else 0
        if frame[s] != PAUSE and is_open > 0.0:
            set_times(blocks, layout, acting, taken * dt + rest[s], 0, len(blocks))
            if flows is not None:
                damp(blocks, layout, links, y, booked, is_open, True)
            gather(blocks, layout, y)
            pair_loads(links, attraction, work, with_dashpots, y, load)
            scatter(load, blocks, layout, PAIR, 0)
            close_blocks(blocks, layout, acting, books, is_open, 0, len(blocks))
        if frame[s] >= 0:
            store_blocks(
                blocks, layout, books, rotor_frame, members, frames, sums, frame[s], 0, len(blocks)
            )
            copy_blocks(saved, blocks, layout)
            is_open = was_open


class Stages(NamedTuple):
    """A method for bodies that act on each other."""

    compiled: Callable[..., None]  # a whole schedule
    spread: Callable[..., None]  # the same from Python, over threads
    number: int
    edge: float
    has_flows: bool  # whether dashpots act as flows, and not as loads
    move_blocks: Callable[..., None]  # a stage of some blocks


def stages_of(
    name: str, stage: Callable[..., None], count: int, edge: float, flows: bool
) -> Stages:
    """Kernels of a method, from its stage."""
    move_some = kernel_from(move_blocks, f"{name}_stage", stage=stage)

    def move_all(
        blocks: Floats, layout: Layout, acting: Acting, books: int | None, k: int, opening: float,
        dt: float,
    ) -> None:  # fmt: skip
        through = partial(move_some, blocks, layout, acting, books, k, opening, dt)
        n = int(layout.size.sum())
        THREADS.share(through, len(blocks), n)

    own: dict[str, Any] = {"STAGES": count, "EDGE": edge}
    here = kernel_from(move_here, f"{name}_here", move_blocks=move_some)
    compiled = kernel_from(advance_together, f"{name}_together", move=here, **own)
    own |= {"move": move_all, "pair_loads": loads_over_threads}
    names = advance_together.__globals__ | own
    spread: Any = FunctionType(advance_together.__code__, names, f"{name}_spread")
    return Stages(compiled, spread, count, edge, flows, move_some)


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Advance a block by dt; stands for the step of a method."""
    raise NotImplementedError


def whole_step(
    k: int,
    is_asymmetric: bool,
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    opening: float,
    dt: float,
) -> None:
    """Stage of a method that has one; `kernel_from` puts its step in."""
    step(acting, books, rows, n, opening, dt)


def one_stage(name: str, step: Callable[..., None], edge: float, flows: bool) -> Stages:
    """Kernels of a method that evaluates the forces once, from its step in `stepped`."""
    return stages_of(name, kernel_from(whole_step, f"{name}_whole", step=step), 1, edge, flows)


def move_here(
    blocks: Floats,
    layout: Layout,
    acting: Acting,
    books: int | None,
    k: int,
    opening: float,
    dt: float,
) -> None:
    """Stage k of all blocks, on this thread."""
    move_blocks(blocks, layout, acting, books, k, opening, dt, 0, len(blocks))


class CoupledMotion(SteppedMotion):
    """A group of bodies that act on each other; see `motion.Motion`.

    Parameters
    ----------
    stages : Stages
        Of the method.
    cost : float
        Estimate of the time for one step of one body without its neighbours [ns].
    keeps_spin, own :
        As for `SteppedMotion`.
    """

    def __init__(
        self,
        stages: Stages,
        cost: float,
        group: Group,
        state: State,
        start: float,
        dt: float,
        keeps_spin: bool = True,
        own: Floats | None = None,
    ) -> None:
        n = group.members.size
        self.stages = stages
        self.forces = PairForces(group.terms, n, not stages.has_flows)
        links = group.terms.links
        is_damped = links is not None and links.damping is not None
        self.flows = 1 if stages.has_flows and is_damped else None
        self.layout = layout_of(group.bodies.rotor_class)
        full = self.layout.size.tolist()
        self.slots = np.concatenate([k * BLOCK + np.arange(m) for k, m in enumerate(full)])
        cost += stages.number * self.forces.cost / n
        super().__init__(stages.compiled, cost, group, state, start, dt, keeps_spin, own)
        self.saved = np.empty((len(self.blocks), CHANGING * STRIDE))

    def make_blocks(self, parts: list[tuple[int, Floats]], n_rows: int) -> Floats:
        """Blocks in which asymmetric bodies have blocks of their own, with room for stages."""
        room = len(self.layout.first) * BLOCK
        assert n_rows <= STAGE
        spaced = [(at, self.spaced(values)) for at, values in parts]
        return in_blocks(room, STAGE + STAGE_ROWS, spaced)

    def spaced(self, values: Floats) -> Floats:
        """Rows of all bodies with the gaps of the blocks between them."""
        room = np.zeros((len(values), len(self.layout.first) * BLOCK))
        room[:, self.slots] = values
        return room

    def put_values(self, at: int, values: Floats) -> None:
        """Write rows of all bodies, (count, n)."""
        into_blocks(self.blocks, at, self.spaced(values))

    def values(self, at: int, count: int) -> Floats:
        """Some rows of all bodies, (count, n)."""
        room = len(self.blocks) * BLOCK
        return np.ascontiguousarray(out_of_blocks(self.blocks, at, count, room)[:, self.slots])

    def run(self, schedule: Schedule, count: int, frames: Frames, sums: Floats) -> None:
        """Go through a schedule."""
        group = self.group
        large = self.forces.is_large
        advance: Callable[..., None] = self.stages.spread if large else self.stages.compiled
        pairs = self.forces.for_python if large else self.forces.pairs
        through = partial(
            advance, self.blocks, self.layout, acting_of(group.terms), self.account.books, pairs,
            self.flows, schedule, group.bodies.rotor_frame, group.members, frames, sums,
            self.saved,
        )  # fmt: skip
        if large:
            through()
        else:
            THREADS.alone(through)
