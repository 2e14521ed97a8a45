"""DOP853 for bodies that act on each other: one step for all of them.

The step is as long as the error estimate of the worst body allows. The vectors of block k are one
row of arrays (blocks, size * w), in the order of `dop853_step`. Where forces between the bodies
are worth several threads, the same loops run as Python and spread them.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, in_python, kernel, kernel_from
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.forces.kernels import Acting
from particlerb.forces.registry import PAIR, STAGE
from particlerb.integrators.dop853_step import (
    ALONE,
    LEAST_STEP,
    add_rows,
    differences,
    errors_of,
    factor_of,
    interpolate,
    normalise,
    take_slopes,
)
from particlerb.integrators.dop853_table import NODES, STAGES, A
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout, PairTerms, pair_loads, scatter
from particlerb.maths.quaternion import load4, normalised, rows4, store4
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import (
    CHANGING,
    Q,
    assign,
    get,
    in_blocks,
    put,
    state_rows,
)
from particlerb.model.state import Frames, State
from particlerb.stepping.adaptive import AdaptiveRun, store_vectors
from particlerb.stepping.loop import Recording
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.saved_arrays import Saved


class _CommonVectors(NamedTuple):
    """Vectors of all bodies, (blocks, size * w) each."""

    y: Floats
    new: Floats
    out: Floats
    five: Floats
    three: Floats
    K: Floats  # (STAGES, blocks * size * w)
    errors: Floats  # (blocks, w)
    width: int  # w


@kernel
def _spread_out(y: Floats, layout: Layout, w: int, states: Floats) -> None:
    """Vectors into states (13, n), with |q| = 1."""
    for k in range(layout.first.size):
        lo = layout.first[k]
        for c in range(ALONE):
            for b in range(layout.size[k]):
                states[c, lo + b] = y[k, c * w + b]
        own = rows4(states[Q : Q + 4], lo, lo + layout.size[k])
        for b in range(layout.size[k]):
            store4(own, b, normalised(load4(own, b)))


@kernel
def _slopes_of_blocks(
    acting: Acting,
    books: Flag,
    blocks: Floats,
    layout: Layout,
    w: int,
    t: float,
    y: Floats,
    slope: Floats,
) -> None:
    """Slopes of all blocks in the states y, with the loads in their rows."""
    own = slope.reshape(y.shape)
    for k in range(layout.first.size):
        take_slopes(acting, books, blocks[k], layout.size[k], w, t, y[k], own[k])


def _common_slopes(
    acting: Acting,
    books: Flag,
    blocks: Floats,
    layout: Layout,
    pairs: PairTerms,
    w: int,
    t: float,
    y: Floats,
    slope: Floats,
) -> None:
    """Slopes of all bodies in the states y at a time [s] since the segment began."""
    links, own, attraction, work, with_dashpots, clock, states, load, _ = pairs
    _spread_out(y, layout, w, states)
    clock[0] = clock[2] + t
    pair_loads(links, own, attraction, work, with_dashpots, clock, states, load)
    scatter(load, blocks, layout, PAIR, 0)
    _slopes_of_blocks(acting, books, blocks, layout, w, t, y, slope)


@kernel
def _add_stages(h: float, stage: int, K: Floats, y: Floats, new: Floats) -> None:
    """State where the slope of a stage is taken."""
    assign(new, y)
    add_rows(h, A[stage], K, stage, new.reshape(new.size))


def _common_stages(
    acting: Acting, books: Flag, blocks: Floats, layout: Layout, pairs: PairTerms,
    room: _CommonVectors,
    new: Floats, t: float, h: float, i: int, j: int,
) -> None:  # fmt: skip
    """Slopes of the stages i .. j - 1 of a step h from t; `new` is the state of the last one."""
    for stage in range(i, j):
        _add_stages(h, stage, room.K, room.y, new)
        now = t + NODES[stage] * h
        _common_slopes(acting, books, blocks, layout, pairs, room.width, now, new, room.K[stage])


@kernel
def _common_error(
    blocks: Floats, layout: Layout, room: _CommonVectors, h: float, tolerance: float
) -> float:
    """Largest error of a step over the tolerance, of the bodies that are numbers."""
    y, new, _, five, three, K, errors, w = room
    differences(K, five.reshape(five.size), three.reshape(three.size))
    worst = 0.0
    for k in range(layout.first.size):
        n = layout.size[k]
        error = errors_of(blocks[k], n, w, y[k], five[k], three[k], new[k], h, tolerance, errors[k])
        if not error <= worst:
            worst = error
    return worst


@kernel
def _normalise_blocks(values: Floats, layout: Layout, w: int) -> None:
    """Make |q| = 1."""
    for k in range(layout.first.size):
        normalise(values[k], layout.size[k], w)


@kernel
def _give_up(layout: Layout, room: _CommonVectors) -> None:
    """Make bodies NaN whose error no step is short enough for."""
    for k in range(layout.first.size):
        for b in range(layout.size[k]):
            for c in range(room.y.shape[1] // room.width):
                if not room.errors[k, b] < 1.0:
                    room.y[k, c * room.width + b] = np.nan


def _find_common_step(
    acting: Acting, books: Flag, blocks: Floats, layout: Layout, pairs: PairTerms,
    room: _CommonVectors,
    t: float, h: float, tolerance: float,
) -> tuple[float, float]:  # fmt: skip
    """Longest step up to h that is accurate, and the one to try after it; see `find_step`."""
    _common_slopes(acting, books, blocks, layout, pairs, room.width, t, room.y, room.K[0])
    longest = h
    while True:
        _common_stages(acting, books, blocks, layout, pairs, room, room.new, t, h, 1, 13)
        error = _common_error(blocks, layout, room, h, tolerance)
        if error < 1.0:
            _normalise_blocks(room.new, layout, room.width)
            return h, h * factor_of(error)
        h *= factor_of(error)
        if not h > LEAST_STEP * t:
            h = longest
            _give_up(layout, room)


@kernel
def _interpolate_blocks(layout: Layout, room: _CommonVectors, h: float, share: float) -> None:
    """State at a share of a step, into `out`."""
    y, new, out, _, _, K, _, w = room
    own = K.reshape((K.shape[0], y.shape[0], y.shape[1]))
    for k in range(layout.first.size):
        slopes = np.ascontiguousarray(own[:, k])
        interpolate(layout.size[k], w, y[k], new[k], slopes, h, share, out[k])


@kernel
def _store_blocks(
    layout: Layout, room: _CommonVectors, rotor_frame: Floats, members: Ints, frames: Frames,
    sums: Floats, f: int,
) -> None:  # fmt: skip
    """Write `out` into frame f."""
    w = room.width
    for k in range(layout.first.size):
        lo, n = layout.first[k], layout.size[k]
        own = members[lo : lo + n], rows4(rotor_frame, lo, lo + n)
        store_vectors(frames, f, *own, room.out[k], w, sums, k)


def advance_together(
    acting: Acting, books: Flag, blocks: Floats, layout: Layout, pairs: PairTerms,
    room: _CommonVectors,
    clock: Floats, tolerance: float, times: Floats, index: Ints, until: float, stop: float,
    rotor_frame: Floats, members: Ints, frames: Frames, sums: Floats,
) -> None:  # fmt: skip
    """All frames, then on to the step around `until`, or to `stop` if it is finite.

    The clock has the time from which the next step starts, the step to try, and the steps taken.
    """
    y, new, out = room.y, room.new, room.out
    t, h, taken = clock[0], clock[1], clock[2]
    h, h_next = _find_common_step(acting, books, blocks, layout, pairs, room, t, h, tolerance)
    is_dense = False
    for f in range(times.size):
        while times[f] > t + h:
            t, taken = t + h, taken + 1.0
            assign(y, new)
            h, h_next = _find_common_step(
                acting, books, blocks, layout, pairs, room, t, h_next, tolerance
            )
            is_dense = False
        assign(out, y)
        if times[f] > t or not h > 0.0:
            if not is_dense:
                _common_stages(acting, books, blocks, layout, pairs, room, out, t, h, 13, STAGES)
                is_dense = True
            _interpolate_blocks(layout, room, h, (times[f] - t) / h)
        _store_blocks(layout, room, rotor_frame, members, frames, sums, index[f])
    while t + h < until:
        t, taken = t + h, taken + 1.0
        assign(y, new)
        h, h_next = _find_common_step(
            acting, books, blocks, layout, pairs, room, t, h_next, tolerance
        )
    while t < stop < np.inf:  # the last step may have to be cut again
        h, h_next = _find_common_step(
            acting, books, blocks, layout, pairs, room, t, min(stop - t, h), tolerance
        )
        assign(y, new)
        if not h > 0.0:
            break
        t, taken = stop if h >= stop - t else t + h, taken + 1.0
    clock[0], clock[1], clock[2] = t, h, taken


def family(make: Callable[..., Callable[..., Any]], **names: Any) -> Callable[..., None]:
    """`advance_together` and what it calls, made anew with other globals."""
    for function in (_common_slopes, _common_stages, _find_common_step, advance_together):
        names[function.__name__] = make(function, **names)
    advance: Callable[..., None] = names["advance_together"]
    return advance


compiled = family(partial(kernel_from, name="here"))


class CoupledAdaptiveMotion(AdaptiveRun):
    """A group of bodies that act on each other, with common steps; see `motion.Motion`."""

    def __init__(
        self,
        method: Method,
        group: SegmentGroup,
        state: State,
        start: float,
        first_step: float,
        tolerance: float,
    ) -> None:
        super().__init__(group, state, start, tolerance)
        n, terms = group.members.size, group.terms
        assert row_count(terms) <= STAGE
        self.forces = PairForces(terms, n, True, start)
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        self.blocks = in_blocks(n, STAGE + 2 * CHANGING, parts)
        first = np.arange(0, n, BLOCK)
        self.layout = Layout(first, np.minimum(BLOCK, n - first), 0)
        self.room = self.make_room(ALONE if self.account.books is None else CHANGING)
        self.clock = np.array([0.0, first_step, 0.0])
        self.cost = method.cost * n + method.evaluations * self.forces.cost
        _take_blocks(self.blocks, self.layout, self.room)

    def make_room(self, size: int) -> _CommonVectors:
        """Vectors of `size` numbers for each body."""
        width = int(self.layout.size[0])
        shape = (len(self.blocks), size * width)
        y, new, out, five, three = (np.zeros(shape) for _ in range(5))
        K = np.zeros((STAGES, shape[0] * shape[1]))
        return _CommonVectors(
            y, new, out, five, three, K, np.zeros((len(self.blocks), width)), width
        )

    def write_back(self) -> None:
        """Bring the vectors back to the blocks."""
        _give_blocks(self.blocks, self.layout, self.room)

    def checkpoint(self) -> Saved:
        """States at the start of the step, when that is, and how long the step is."""
        return {"y": self.room.y.copy(), "clock": self.clock[:2].copy()}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.room.y[:] = saved["y"]
        self.clock[:2] = saved["clock"]

    def advance_some(
        self, times: Floats, rows: Ints, until: float, stop: float, recording: Recording
    ) -> None:
        """All bodies together; see `AdaptiveRun`."""
        arguments = (
            acting_of(self.group.terms), self.account.books, self.blocks, self.layout,
            self.forces.pairs, self.room, self.clock, self.tolerance, times, rows, until, stop,
            *recording[:4],
        )  # fmt: skip
        if self.forces.is_large:
            family(in_python, pair_loads=lambda *_: self.forces.evaluate())(*arguments)
        else:
            THREADS.alone(compiled, *arguments)


@kernel
def _take_blocks(blocks: Floats, layout: Layout, room: _CommonVectors) -> None:
    """Bring the states of all blocks into vectors."""
    w = room.width
    for k in range(layout.first.size):
        for c in range(room.y.shape[1] // w):
            for b in range(layout.size[k]):
                room.y[k, c * w + b] = get(blocks[k], c, b)


@kernel
def _give_blocks(blocks: Floats, layout: Layout, room: _CommonVectors) -> None:
    """Write the vectors back."""
    w = room.width
    for k in range(layout.first.size):
        for c in range(room.y.shape[1] // w):
            for b in range(layout.size[k]):
                put(blocks[k], c, b, room.y[k, c * w + b])
