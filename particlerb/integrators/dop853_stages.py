"""The stages of a step of DOP853 for bodies that take the same ones; the loop calls them.

A step is as long as the error estimate of the worst body allows. The vectors of block k are one row
of arrays (blocks, size * w), in the order of `dop853_step`.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.forces.registry import PAIR
from particlerb.integrators.dop853_step import (
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
from particlerb.integrators.dop853_table import END, N_STAGES, NODES, A
from particlerb.integrators.joint_slopes import add_reactions, bring_back, count_on
from particlerb.integrators.pair_stages import Layout, PairTerms, pair_loads, scatter
from particlerb.integrators.stages import caller_of_stages, inlined_caller
from particlerb.joints.breaking import break_by_multipliers, let_go, may_break
from particlerb.joints.records import Jointed
from particlerb.maths.quaternion import normalised
from particlerb.maths.rows import column4, put_column4, rows4
from particlerb.maths.vec3 import Floats
from particlerb.model.block import Q, assign, get, put
from particlerb.model.load import STATE_ROWS

_LOOKS_PER_STEP: Final = 8  # for loads under which joints break
_MAX_HALVINGS: Final = 50  # between two of them, for the instant


class CommonVectors(NamedTuple):
    """Vectors of all bodies, (blocks, size * w) each."""

    y: Floats
    new: Floats
    out: Floats
    five: Floats
    three: Floats
    K: Floats  # (N_STAGES, blocks * size * w)
    errors: Floats  # (blocks, w)
    width: int  # w
    broken: Floats  # (j,) [s] when joints break, since t = 0; inf: they hold
    tried: Floats  # (1,) [s] the step before it was cut where one breaks


class CommonSteps(NamedTuple):
    """Bodies that take the same steps, and what acts on them."""

    equations: Equations
    blocks: Floats
    layout: Layout
    pairs: PairTerms | None  # None: no body acts on another
    jointed: Jointed | None
    vectors: CommonVectors


@kernel
def room_for_vectors(n_blocks: int, size: int, width: int, broken: Floats) -> CommonVectors:
    """Vectors of `size` numbers for each body, and what has broken."""
    shape = (n_blocks, size * width)
    return CommonVectors(
        np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape),
        np.zeros((N_STAGES, shape[0] * shape[1])), np.zeros((n_blocks, width)), width, broken,
        np.zeros(1),
    )  # fmt: skip


@kernel
def spread_out(y: Floats, layout: Layout, w: int, states: Floats) -> None:
    """Vectors into states (13, n), with |q| = 1."""
    for k in range(layout.first.size):
        lo = layout.first[k]
        for c in range(STATE_ROWS):
            for b in range(layout.size[k]):
                states[c, lo + b] = y[k, c * w + b]
        orientations = rows4(states[Q : Q + 4], lo, lo + layout.size[k])
        for b in range(layout.size[k]):
            put_column4(orientations, b, normalised(column4(orientations, b)))


@kernel
def take_blocks(blocks: Floats, layout: Layout, vectors: CommonVectors) -> None:
    """Bring the states of all blocks into vectors."""
    w = vectors.width
    for k in range(layout.first.size):
        for c in range(vectors.y.shape[1] // w):
            for b in range(layout.size[k]):
                vectors.y[k, c * w + b] = get(blocks[k], c, b)


@kernel
def give_blocks(blocks: Floats, layout: Layout, vectors: CommonVectors) -> None:
    """Write the vectors back."""
    w = vectors.width
    for k in range(layout.first.size):
        for c in range(vectors.y.shape[1] // w):
            for b in range(layout.size[k]):
                put(blocks[k], c, b, vectors.y[k, c * w + b])


@kernel
def slopes_of_blocks(
    equations: Equations, blocks: Floats, layout: Layout, w: int, t: float, y: Floats,
    slope: Floats,
) -> None:  # fmt: skip
    """Slopes of all blocks in the states y, with the loads in their rows."""
    slopes = slope.reshape(y.shape)
    for k in range(layout.first.size):
        take_slopes(equations, blocks[k], layout.size[k], w, t, y[k], slopes[k])


@caller_of_stages
def _put_loads(
    pairs: PairTerms | None, blocks: Floats, layout: Layout, w: int, t: float, y: Floats
) -> None:
    """Loads in the states y between bodies, if there are any, into the rows of the blocks."""
    if pairs is None:
        return
    links, user_pairs, attraction, fields, with_dashpots, clock, states, load, _ = pairs
    spread_out(y, layout, w, states)
    clock[0] = clock[2] + t
    pair_loads(links, user_pairs, attraction, fields, with_dashpots, clock, states, load)
    scatter(load, blocks, layout, PAIR, 0)


@inlined_caller
def _take_slopes(bodies: CommonSteps, t: float, y: Floats, slope: Floats) -> None:
    """Slopes of all bodies in the states y at a time [s] since the segment began."""
    layout, w = bodies.layout, bodies.vectors.width
    _put_loads(bodies.pairs, bodies.blocks, layout, w, t, y)
    slopes_of_blocks(bodies.equations, bodies.blocks, layout, w, t, y, slope)
    sums_external = bodies.equations.sums_external
    add_reactions(sums_external, bodies.jointed, y, slope.reshape(y.shape), w, t)


@kernel
def _add_stages(h: float, stage: int, K: Floats, y: Floats, new: Floats) -> None:
    """State where the slope of a stage is taken."""
    assign(new, y)
    add_rows(h, A[stage], K, stage, new.reshape(new.size))


@inline
def _let_go(bodies: CommonSteps, t: float) -> bool:
    """Let joints go that have broken by t; whether any held until now."""
    jointed = bodies.jointed
    if jointed is None or jointed.joints.breaks is None:
        return False
    return let_go(jointed.data, bodies.vectors.broken, jointed.start + t)


@caller_of_stages
def first_slopes(bodies: CommonSteps, t: float) -> None:
    """Slopes at the start of a step."""
    _let_go(bodies, t)
    _take_slopes(bodies, t, bodies.vectors.y, bodies.vectors.K[0])


@caller_of_stages
def next_slopes(bodies: CommonSteps, t: float) -> None:
    """The end of a step, with its slopes, is the start of the next one, from t on."""
    assign(bodies.vectors.y, bodies.vectors.new)
    assign(bodies.vectors.K[0], bodies.vectors.K[END])
    if _let_go(bodies, t):
        _take_slopes(bodies, t, bodies.vectors.y, bodies.vectors.K[0])


@caller_of_stages
def _take_stages(bodies: CommonSteps, at: Floats, t: float, h: float, i: int, j: int) -> None:
    """Slopes of the stages i .. j - 1 of a step h from t; `at` is the state of the last one."""
    K, y = bodies.vectors.K, bodies.vectors.y
    for stage in range(i, j):
        _add_stages(h, stage, K, y, at)
        _take_slopes(bodies, t + NODES[stage] * h, at, K[stage])


@kernel
def _error_of(
    blocks: Floats, layout: Layout, vectors: CommonVectors, h: float, tolerance: float
) -> float:
    """Largest error of a step over the tolerance, or NaN, of the bodies that were numbers."""
    five, three, K, errors = vectors.five, vectors.three, vectors.K, vectors.errors
    differences(K, five.reshape(five.size), three.reshape(three.size))
    worst = 0.0
    for k in range(layout.first.size):
        y, new = vectors.y[k], vectors.new[k]
        pack = Pack(blocks[k], layout.size[k], vectors.width, y, new)
        error = errors_of(pack, five[k], three[k], h, tolerance, errors[k])
        if worst <= np.inf and not error <= worst:
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


@caller_of_stages
def _finish_step(bodies: CommonSteps, t: float, h: float, brings_back: bool) -> None:
    """Slopes at the end of a step, which is brought to where joints hold, or not yet."""
    common = bodies.vectors
    _normalise_blocks(common.new, bodies.layout, common.width)
    if brings_back:
        bring_back(bodies.jointed, common.new, common.width, t + h)
    _take_slopes(bodies, t + h, common.new, common.K[END])


@caller_of_stages
def _breaks_at(bodies: CommonSteps, t: float, h: float, share: float) -> bool:
    """Whether joints carry too much at a share of a step; until it is forgotten, they break."""
    common, jointed = bodies.vectors, bodies.jointed
    if jointed is None or jointed.joints.breaks is None:
        return False
    show(bodies, t, h, share)
    _take_slopes(bodies, t + share * h, common.out, common.five.reshape(common.five.size))
    at = jointed.start + (t + share * h)
    let_go(jointed.data, common.broken, jointed.start + t)
    return break_by_multipliers(jointed.joints, jointed.data, common.broken, at)


@caller_of_stages
def _up_to_a_break(bodies: CommonSteps, t: float, h: float) -> float:
    """Step that ends at the instant at which a joint breaks, if one does within h; or h."""
    jointed, before, after = bodies.jointed, 0.0, LEAST_STEP
    if jointed is None or jointed.joints.breaks is None:
        return h
    common = bodies.vectors
    common.tried[0] = h
    if not may_break(jointed.joints.breaks, common.broken):
        return h
    take_last_stages(bodies, t, h)
    for k in range(1, _LOOKS_PER_STEP + 1):
        if _breaks_at(bodies, t, h, after):
            break
        before, after = after, k / _LOOKS_PER_STEP
    if not _breaks_at(bodies, t, h, after):
        return h
    for _ in range(_MAX_HALVINGS if before > 0.0 else 0):
        middle = 0.5 * (before + after)
        if _breaks_at(bodies, t, h, middle):
            after = middle
        else:
            before = middle
    _breaks_at(bodies, t, h, after)
    h *= after
    _take_stages(bodies, common.new, t, h, 1, END)
    _add_stages(h, END, common.K, common.y, common.new)
    _finish_step(bodies, t, h, True)
    return h


@caller_of_stages
def find_step(bodies: CommonSteps, t: float, h: float, brings_back: bool) -> tuple[float, float]:
    """Longest step up to h that is accurate, and the one to try after it; K[0] is known."""
    layout, common = bodies.layout, bodies.vectors
    h = count_on(bodies.jointed, common.y, common.width, t, h)
    tolerance = bodies.equations.tolerance
    longest = h
    while True:
        _take_stages(bodies, common.new, t, h, 1, END)
        _add_stages(h, END, common.K, common.y, common.new)
        error = _error_of(bodies.blocks, layout, common, h, tolerance)
        if error < 1.0:
            _finish_step(bodies, t, h, brings_back)
            return _up_to_a_break(bodies, t, h), h * factor_of(error)
        h *= factor_of(error)
        if not h > LEAST_STEP * t:
            h = longest
            _give_up(layout, common)


@caller_of_stages
def take_last_stages(bodies: CommonSteps, t: float, h: float) -> None:
    """Slopes that dense output needs beside those of the step."""
    _take_stages(bodies, bodies.vectors.out, t, h, END + 1, N_STAGES)


@caller_of_stages
def show(bodies: CommonSteps, t: float, h: float, share: float) -> None:
    """State at a share of the step from t, for a frame."""
    common = bodies.vectors
    size = common.y.size
    y, new, out = common.y.reshape(size), common.new.reshape(size), common.out.reshape(size)
    interpolate(common.K, y, new, h, share, out)
    _normalise_blocks(common.out, bodies.layout, common.width)
    bring_back(bodies.jointed, common.out, common.width, t + share * h)
