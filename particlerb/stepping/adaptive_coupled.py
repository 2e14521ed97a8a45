"""DOP853 for bodies that act on each other: one step for all of them, by the loop of `adaptive`.

The step is as long as the error estimate of the worst body allows. The vectors of block k are one
row of arrays (blocks, size * w), in the order of `dop853_step`. Where forces between the bodies
are worth several threads, the same loops run as Python and spread them.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline, kernel, kernel_from
from particlerb.compiled.plain import in_python
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import row_count, rows_of_terms
from particlerb.forces.registry import STAGE
from particlerb.integrators.dop853_step import (
    ALONE,
    LEAST_STEP,
    Equations,
    Pack,
    add_rows,
    differences,
    errors_of,
    factor_of,
    interpolate,
    normalise,
    take_slopes,
)
from particlerb.integrators.dop853_table import END, NODES, STAGES, A
from particlerb.integrators.joint_slopes import (
    add_reactions,
    bring_back,
    count_on,
    store_coordinates,
)
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout, PairTerms, pair_loads, scatter_loads
from particlerb.joints.breaking import break_by_multipliers, let_go, may_break
from particlerb.joints.records import Breaks, Jointed
from particlerb.joints.trees import tree_of
from particlerb.maths.vec3 import Floats
from particlerb.model.block import CHANGING, assign, in_blocks, state_rows
from particlerb.model.state import State
from particlerb.stepping.adaptive import AdaptiveRun, Leg, advance_steps, store_vectors
from particlerb.stepping.common_vectors import (
    CommonVectors,
    give_blocks,
    spread_out,
    take_blocks,
)
from particlerb.stepping.jointed_motion import jointed_in
from particlerb.stepping.loop import Recording
from particlerb.stepping.motion import SegmentGroup
from particlerb.stepping.pair_forces import PairForces
from particlerb.stepping.saved_arrays import Saved

_LOOKS: Final = 8  # in a step, for loads under which joints break,
_HALVINGS: Final = 50  # and between two of them, for the instant
_Maker: TypeAlias = Callable[..., Callable[..., Any]]


class _AllBodies(NamedTuple):
    """All bodies of a group, as `advance_steps` takes them."""

    equations: Equations
    blocks: Floats
    layout: Layout
    pairs: PairTerms
    jointed: Jointed | None
    breaks: Breaks | None
    vectors: CommonVectors


@inline
def _pack_of(blocks: Floats, layout: Layout, common: CommonVectors, k: int, K: Floats) -> Pack:
    """Bodies of block k as a pack."""
    return Pack(blocks[k], layout.size[k], common.width, common.y[k], common.new[k], K)


@kernel
def _slopes_of_blocks(
    equations: Equations, blocks: Floats, layout: Layout, w: int, t: float, y: Floats,
    slope: Floats,
) -> None:  # fmt: skip
    """Slopes of all blocks in the states y, with the loads in their rows."""
    own = slope.reshape(y.shape)
    for k in range(layout.first.size):
        take_slopes(equations, blocks[k], layout.size[k], w, t, y[k], own[k])


def _common_slopes(bodies: _AllBodies, t: float, y: Floats, slope: Floats) -> None:
    """Slopes of all bodies in the states y at a time [s] since the segment began."""
    links, own, attraction, work, with_dashpots, clock, states, load, _ = bodies.pairs
    layout, w = bodies.layout, bodies.vectors.width
    if bodies.equations.acting.pair is not None:
        spread_out(y, layout, w, states)
        clock[0] = clock[2] + t
        pair_loads(links, own, attraction, work, with_dashpots, clock, states, load)
        scatter_loads(load, bodies.blocks, layout)
    _slopes_of_blocks(bodies.equations, bodies.blocks, layout, w, t, y, slope)
    books = bodies.equations.books
    add_reactions(books, bodies.jointed, y, slope.reshape(y.shape), w, t)


@kernel
def _add_stages(h: float, stage: int, K: Floats, y: Floats, new: Floats) -> None:
    """State where the slope of a stage is taken."""
    assign(new, y)
    add_rows(h, A[stage], K, stage, new.reshape(new.size))


@inline
def _let_go(breaks: Breaks | None, bodies: _AllBodies, t: float) -> bool:
    """Let joints go that have broken by t; whether any held until now."""
    if breaks is None:
        return False
    jointed = bodies.jointed
    assert jointed is not None
    return let_go(jointed.work, bodies.vectors.broken, jointed.start + t)


def _begin(bodies: _AllBodies, t: float) -> None:
    """`begin` of all bodies."""
    _let_go(bodies.breaks, bodies, t)
    _common_slopes(bodies, t, bodies.vectors.y, bodies.vectors.K[0])


def _go_on(bodies: _AllBodies, t: float) -> None:
    """`go_on` of all bodies."""
    assign(bodies.vectors.y, bodies.vectors.new)
    assign(bodies.vectors.K[0], bodies.vectors.K[END])
    if _let_go(bodies.breaks, bodies, t):
        _common_slopes(bodies, t, bodies.vectors.y, bodies.vectors.K[0])


def _common_stages(bodies: _AllBodies, at: Floats, t: float, h: float, i: int, j: int) -> None:
    """Slopes of the stages i .. j - 1 of a step h from t; `at` is the state of the last one."""
    K, y = bodies.vectors.K, bodies.vectors.y
    for stage in range(i, j):
        _add_stages(h, stage, K, y, at)
        _common_slopes(bodies, t + NODES[stage] * h, at, K[stage])


@kernel
def _common_error(
    blocks: Floats, layout: Layout, vectors: CommonVectors, h: float, tolerance: float
) -> float:
    """Largest error of a step over the tolerance, of the bodies that are numbers."""
    five, three, K, errors = vectors.five, vectors.three, vectors.K, vectors.errors
    differences(K, five.reshape(five.size), three.reshape(three.size))
    worst = 0.0
    for k in range(layout.first.size):
        pack = _pack_of(blocks, layout, vectors, k, K)
        error = errors_of(pack, five[k], three[k], h, tolerance, errors[k])
        if not error <= worst:
            worst = error
    return worst


@kernel
def _normalise_blocks(values: Floats, layout: Layout, w: int) -> None:
    """Make |q| = 1."""
    for k in range(layout.first.size):
        normalise(values[k], layout.size[k], w)


@kernel
def _give_up(layout: Layout, vectors: CommonVectors) -> None:
    """Make bodies NaN whose error no step is short enough for."""
    y, w = vectors.y, vectors.width
    for k in range(layout.first.size):
        for b in range(layout.size[k]):
            for c in range(y.shape[1] // w):
                if not vectors.errors[k, b] < 1.0:
                    y[k, c * w + b] = np.nan


def _finish_step(bodies: _AllBodies, t: float, h: float) -> None:
    """Bring the end of a step to where joints hold, and find the slopes there."""
    common = bodies.vectors
    _normalise_blocks(common.new, bodies.layout, common.width)
    bring_back(bodies.jointed, common.new, common.width, t + h)
    _common_slopes(bodies, t + h, common.new, common.K[END])


def _breaks_at(breaks: Breaks, bodies: _AllBodies, t: float, h: float, share: float) -> bool:
    """Whether joints carry too much at a share of a step; until it is forgotten, they break."""
    common, jointed = bodies.vectors, bodies.jointed
    assert jointed is not None
    _show(bodies, t, h, share)
    _common_slopes(bodies, t + share * h, common.out, common.five.reshape(common.five.size))
    at = jointed.start + (t + share * h)
    let_go(jointed.work, common.broken, jointed.start + t)
    return break_by_multipliers(breaks, jointed.joints, jointed.work, common.broken, at)


def _up_to_a_break(breaks: Breaks | None, bodies: _AllBodies, t: float, h: float) -> float:
    """Step that ends at the instant at which a joint breaks, if one does within h; or h."""
    if breaks is None:
        return h
    common, before, after = bodies.vectors, 0.0, LEAST_STEP
    common.tried[0] = h
    if not may_break(breaks, common.broken):
        return h
    _take_last_stages(bodies, t, h)
    for k in range(1, _LOOKS + 1):
        if _breaks_at(breaks, bodies, t, h, after):
            break
        before, after = after, k / _LOOKS
    if not _breaks_at(breaks, bodies, t, h, after):
        return h
    for _ in range(_HALVINGS if before > 0.0 else 0):
        middle = 0.5 * (before + after)
        if _breaks_at(breaks, bodies, t, h, middle):
            after = middle
        else:
            before = middle
    _breaks_at(breaks, bodies, t, h, after)
    h *= after
    _common_stages(bodies, common.new, t, h, 1, END)
    _add_stages(h, END, common.K, common.y, common.new)
    _finish_step(bodies, t, h)
    return h


def _find_common_step(bodies: _AllBodies, t: float, h: float) -> tuple[float, float]:
    """Longest step up to h that is accurate, and the one to try after it; see `find_step`."""
    layout, common = bodies.layout, bodies.vectors
    h = count_on(bodies.jointed, common.y, common.width, h)
    tolerance = bodies.equations.tolerance
    longest = h
    while True:
        _common_stages(bodies, common.new, t, h, 1, END)
        _add_stages(h, END, common.K, common.y, common.new)
        error = _common_error(bodies.blocks, layout, common, h, tolerance)
        if error < 1.0:
            _finish_step(bodies, t, h)
            return _up_to_a_break(bodies.breaks, bodies, t, h), h * factor_of(error)
        h *= factor_of(error)
        if not h > LEAST_STEP * t:
            h = longest
            _give_up(layout, common)


def _take_last_stages(bodies: _AllBodies, t: float, h: float) -> None:
    """`take_last_stages` of all bodies."""
    _common_stages(bodies, bodies.vectors.out, t, h, END + 1, STAGES)


@kernel
def _interpolate_blocks(common: CommonVectors, h: float, share: float) -> None:
    """State at a share of a step, into `out`."""
    size = common.y.size
    y, new, out = common.y.reshape(size), common.new.reshape(size), common.out.reshape(size)
    interpolate(common.K, y, new, h, share, out)


def _show(bodies: _AllBodies, t: float, h: float, share: float) -> None:
    """`show` of all bodies."""
    common = bodies.vectors
    _interpolate_blocks(common, h, share)
    _normalise_blocks(common.out, bodies.layout, common.width)
    bring_back(bodies.jointed, common.out, common.width, t + share * h)


@kernel
def _store_blocks(layout: Layout, common: CommonVectors, recording: Recording, frame: int) -> None:
    """Write `out` into a frame."""
    for k in range(layout.first.size):
        lo, n = layout.first[k], layout.size[k]
        store_vectors(recording, frame, lo, n, common.out[k], common.width, k)


def _write(bodies: _AllBodies, recording: Recording, frame: int) -> None:
    """`write` of all bodies."""
    common = bodies.vectors
    _store_blocks(bodies.layout, common, recording, frame)
    store_coordinates(bodies.jointed, common.out, common.width, recording.turned, frame)


def _family(make: _Maker, **names: Any) -> Callable[..., None]:
    """`advance_steps` of all bodies and what it calls, made anew with other globals."""
    moving = {"begin": _begin, "go_on": _go_on, "find": _find_common_step}
    shown = {"take_last_stages": _take_last_stages, "show": _show, "write": _write}
    called = _common_slopes, _common_stages, _take_last_stages, _show, _finish_step, _breaks_at
    for function in (*called, _up_to_a_break, _begin, _go_on, _find_common_step, _write):
        names[function.__name__] = make(function, **names)
    functions = {key: names[own.__name__] for key, own in (moving | shown).items()}
    return make(advance_steps, **functions)


_compiled = _family(partial(kernel_from, name="here"))


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
        self.jointed = jointed_in(group, state, np.arange(n), start, 0.0)
        if self.jointed is not None:
            self.jointed = self.jointed._replace(tree=tree_of(self.jointed.joints))
        self.vectors = self.make_vectors(ALONE if self.account.books is None else CHANGING)
        self.clock = np.array([[0.0, first_step, 0.0]])
        self.cost = method.cost * n + method.evaluations * self.forces.cost
        take_blocks(self.blocks, self.layout, self.vectors)

    def make_vectors(self, size: int) -> CommonVectors:
        """Vectors of `size` numbers for each body."""
        width = int(self.layout.size[0])
        shape = (len(self.blocks), size * width)
        y, new, out, five, three = (np.zeros(shape) for _ in range(5))
        K = np.zeros((STAGES, shape[0] * shape[1]))
        return CommonVectors(
            y, new, out, five, three, K, np.zeros((len(self.blocks), width)), width,
            np.full_like(super().broken, np.inf), np.zeros(1),
        )  # fmt: skip

    @property
    def broken(self) -> Floats:
        """When joints have broken [s], (j,): inf where they hold."""
        return self.vectors.broken

    def write_back(self) -> None:
        """Bring the vectors back to the blocks."""
        give_blocks(self.blocks, self.layout, self.vectors)

    def checkpoint(self) -> Saved:
        """States at the start of the step, when that is, and how long the step is."""
        saved = {"y": self.vectors.y.copy(), "clock": self.clock[0, :2].copy()}
        saved |= {"broken": self.broken.copy()} if self.breaks else {}
        return saved | ({"turned": self.turned.copy()} if self.turned.size else {})

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        self.vectors.y[:] = saved["y"]
        self.clock[0, :2] = saved["clock"]
        if self.breaks:
            self.broken[:] = saved["broken"]
        if self.turned.size:
            self.turned[:] = saved["turned"]

    def advance_some(self, leg: Leg, recording: Recording) -> None:
        """All bodies together."""
        common, joints = self.vectors, self.group.terms.joints
        breaks = None if joints is None else joints.breaks
        bodies = _AllBodies(
            self.equations,
            self.blocks,
            self.layout,
            self.forces.pairs,
            self.jointed,
            breaks,
            common,
        )
        arguments = bodies, common.y, common.out, self.clock[0], leg, recording
        if self.forces.is_large:
            _family(in_python, pair_loads=lambda *_: self.forces.evaluate())(*arguments)
        else:
            THREADS.alone(_compiled, *arguments)
        if breaks is not None:
            self.clock[0, 1] = common.tried[0]
