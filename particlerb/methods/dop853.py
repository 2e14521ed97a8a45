"""DOP853: Runge-Kutta of order 8 that chooses its own steps, with dense output; any smooth force.

The oracle: it shares nothing with the splittings but the forces. Sixteen bodies at a time take the
same steps, in SIMD lanes, as long as the error estimate of each stays below the tolerance. Frames
come from the dense output of order 7, so they change nothing in the motion. What it does not do is
keep energy or |q| by construction: their drift shows its error.

Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I (1993), section
II.10; coefficients in dop853_table.py.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Final

import numpy as np

from particlerb._jit import inline, kernel
from particlerb.bodies.block import (
    BOOKED,
    CHANGING,
    COM,
    INV_INERTIA,
    INV_MASS,
    STRIDE,
    L,
    P,
    Q,
    get,
    get3,
    get4,
    in_blocks,
    out_of_blocks,
    put,
    put3,
    put4,
    state_of,
    state_rows,
)
from particlerb.bodies.state import Frames, State, room_for, store_frame
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, rows3
from particlerb.methods.dop853_table import STAGES, A, D, E
from particlerb.methods.motion import Account, Group
from particlerb.methods.rates import Pose, slopes
from particlerb.terms import Acting, acting_of, row_count, rows_of_terms
from particlerb.threads import BLOCK, THREADS

ORDER: Final = 8
FREE_ORDER: Final = 8
IS_ADAPTIVE: Final = True
KEEPS_RODS: Final = False
ACCEPTS: Final = frozenset({"gravity", "push", "follower", "torque", "drag", "spring", "central"})
SUMMARY: Final = "order 8, adaptive by run.tolerance, dense output; the oracle; any force"
COST: Final = 400.0  # ns per body-step, roughly
NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between
SHRINK: Final = 0.2  # of a step at most, growth at most, and prudence: as the authors take them
GROW: Final = 5.0
SAFETY: Final = 0.9
ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)  # of what a step computes
LEAST_STEP: Final = 1e-14  # relative to the time: below it nothing moves any more
PACK: Final = 16  # bodies that take the same steps; BLOCK is a multiple of it
ALONE: Final = 13  # numbers of a body: x, q, p, L; what it books follows where it books
WORK: Final = 1024  # rows of a pack from which on a stage and its slopes lie, after all loads


@kernel
def take_slopes(
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    w: int,
    y: Floats,
    slope: Floats,
) -> None:
    """Slopes of a pack in the states y."""
    for c in range(ALONE):
        for b in range(n):
            put(rows, WORK + c, b, y[c * w + b])
    for b in range(n):
        now = Pose(
            get3(rows, WORK, b),
            get4(rows, WORK + 3, b),
            get3(rows, WORK + 7, b),
            get3(rows, WORK + 10, b),
        )
        rate, (power, force, turning) = slopes(acting, rows, b, now)
        put3(rows, WORK + CHANGING, b, rate.x)
        put4(rows, WORK + CHANGING + 3, b, rate.q)
        put3(rows, WORK + CHANGING + 7, b, rate.p)
        put3(rows, WORK + CHANGING + 10, b, rate.L)
        if books is not None:
            put(rows, WORK + CHANGING + 13, b, power)
            put3(rows, WORK + CHANGING + 14, b, force)
            put3(rows, WORK + CHANGING + 17, b, turning)
    for c in range(y.size // w):
        for b in range(n):
            slope[c * w + b] = get(rows, WORK + CHANGING + c, b)


@kernel
def add_rows(h: float, weights: Floats, K: Floats, count: int, out: Floats) -> None:
    """out ← out + h Σ w_k K_k over the first rows: four at a time, to load `out` less often."""
    k = 0
    while k + 4 <= count:
        a, b, c, d = (
            h * weights[k],
            h * weights[k + 1],
            h * weights[k + 2],
            h * weights[k + 3],
        )
        p, q, r, s = K[k], K[k + 1], K[k + 2], K[k + 3]
        for i in range(out.size):
            out[i] += (a * p[i] + b * q[i]) + (c * r[i] + d * s[i])
        k += 4
    while k < count:
        a, p = h * weights[k], K[k]
        for i in range(out.size):
            out[i] += a * p[i]
        k += 1


@kernel
def take_stages(
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    w: int,
    y: Floats,
    K: Floats,
    new: Floats,
    h: float,
    i: int,
    j: int,
) -> None:
    """Slopes of the stages i .. j - 1 of a step h; `new` is the state of the last one."""
    for stage in range(i, j):
        new[:] = y
        add_rows(h, A[stage], K, stage, new)
        take_slopes(acting, books, rows, n, w, new, K[stage])


@inline
def larger(w: int, y: Floats, new: Floats, lo: int, hi: int, b: int) -> float:
    """Larger of the lengths of two vectors of body b."""
    old_size, new_size = 0.0, 0.0
    for c in range(lo, hi):
        old_size += y[c * w + b] ** 2
        new_size += new[c * w + b] ** 2
    return math.sqrt(max(old_size, new_size))


@inline
def moved(w: int, y: Floats, new: Floats, b: int) -> float:
    """Way of the centre of mass of body b."""
    way = 0.0
    for c in range(3):
        way += (new[c * w + b] - y[c * w + b]) ** 2
    return math.sqrt(way)


@inline
def largest_moment(rows: Floats, b: int) -> float:
    """Largest principal moment of body b [kg m²]; 0 for a point."""
    least = np.inf
    for inverse in get3(rows, INV_INERTIA, b):
        if inverse > 0.0:
            least = min(least, inverse)
    return 1.0 / least


@inline
def scales_of(
    rows: Floats, w: int, y: Floats, new: Floats, b: int, h: float, tolerance: float
) -> tuple[float, float, float, float]:
    """What errors of x, q, p and L of body b are relative to.

    For x the larger of the way and the radius of gyration, for p and L their lengths. Where a body
    comes to rest all of these are rounding, of positions and so of the forces that hold it: none
    is taken for smaller than what rounding makes of it in a step.
    """
    noise = ROUNDING / tolerance
    mass, moment = 1.0 / get(rows, INV_MASS, b), largest_moment(rows, b)
    size = math.sqrt(moment / mass)
    way = max(moved(w, y, new, b), size, noise * larger(w, y, new, 0, 3, b))
    p = max(
        larger(w, y, new, 7, 10, b),
        noise * mass * max(way, larger(w, y, new, 0, 3, b)) / h,
    )
    return way, 1.0, p, max(larger(w, y, new, 10, 13, b), noise * moment / h)


@kernel
def errors_of(
    rows: Floats,
    n: int,
    w: int,
    y: Floats,
    K: Floats,
    new: Floats,
    h: float,
    tolerance: float,
    errors: Floats,
) -> float:
    """Write the error estimate of each body over the tolerance; the largest of those that live.

    A body that is not a number any more has no say in the steps of the others.
    """
    five, three = np.zeros(y.size), np.zeros(y.size)
    add_rows(1.0, E[0], K, 13, five)
    add_rows(1.0, E[1], K, 13, three)
    worst = 0.0
    for b in range(n):
        sum5, sum3 = 0.0, 0.0
        scales = scales_of(rows, w, y, new, b, h, tolerance)
        for (lo, hi), scale in zip(((0, 3), (3, 7), (7, 10), (10, 13)), scales):  # noqa: B905
            for c in range(lo, hi):
                e5, e3 = five[c * w + b], three[c * w + b]
                if e5 != 0.0 or e3 != 0.0:
                    sum5 += (e5 / scale) ** 2
                    sum3 += (e3 / scale) ** 2
        errors[b] = 0.0
        if sum5 != 0.0:
            errors[b] = abs(h) * sum5 / math.sqrt((sum5 + 0.01 * sum3) * 13.0) / tolerance
        if not np.isnan(y[b]) and not errors[b] <= worst:
            worst = errors[b]
    return worst


@inline
def normalise(values: Floats, n: int, w: int) -> None:
    """Make |q| = 1."""
    for b in range(n):
        norm = 0.0
        for c in range(Q, Q + 4):
            norm += values[c * w + b] ** 2
        for c in range(Q, Q + 4):
            values[c * w + b] /= math.sqrt(norm)


@kernel
def find_step(
    acting: Acting, books: int | None, rows: Floats, n: int, w: int, y: Floats, K: Floats,
    new: Floats, t: float, h: float, tolerance: float,
) -> tuple[float, float]:  # fmt: skip
    """Longest step up to h that is accurate, and the one to try after it; `new` is its end.

    Bodies for which no step is short enough become NaN: their state is not finite, or the forces
    are not smooth. The others go on.
    """
    errors = np.zeros(PACK)
    take_slopes(acting, books, rows, n, w, y, K[0])
    longest = h
    while True:
        take_stages(acting, books, rows, n, w, y, K, new, h, 1, 13)
        error = errors_of(rows, n, w, y, K, new, h, tolerance, errors)
        if error < 1.0:
            factor = GROW if error == 0.0 else min(GROW, SAFETY * error ** (-1.0 / 8.0))
            normalise(new, n, w)
            return h, h * max(factor, SHRINK)
        h *= max(SHRINK, SAFETY * error ** (-1.0 / 8.0)) if error < np.inf else SHRINK
        if not h > LEAST_STEP * t:
            h = longest
            for b in range(n):
                for c in range(y.size // w):
                    if not errors[b] < 1.0:
                        y[c * w + b] = np.nan


@kernel
def interpolate(
    n: int,
    w: int,
    y: Floats,
    new: Floats,
    K: Floats,
    h: float,
    share: float,
    out: Floats,
) -> None:
    """State at a share of a step by the polynomial of order 7; |q| = 1."""
    rest = 1.0 - share
    out[:] = 0.0
    for i in range(4):
        add_rows(h, D[3 - i], K, STAGES, out)
        for c in range(out.size):
            out[c] *= share if i % 2 == 0 else rest
    for c in range(out.size):
        change = new[c] - y[c]
        value = (out[c] + 2.0 * change - h * (K[12, c] + K[0, c])) * share
        value = (value + h * K[0, c] - change) * rest
        out[c] = y[c] + (value + change) * share
    normalise(out, n, w)


@inline
def take_pack(blocks: Floats, pack: int, n: int, w: int, rows: Floats, y: Floats) -> None:
    """Bring the bodies of a pack to the first lanes of rows, and their vectors to y."""
    block, first = pack * PACK // BLOCK, pack * PACK % BLOCK
    source = blocks[block]
    for r in range(source.size // STRIDE):
        for b in range(n):
            put(rows, r, b, get(source, r, first + b))
    for c in range(y.size // w):
        for b in range(n):
            y[c * w + b] = get(source, c, first + b)


@inline
def give_pack(y: Floats, w: int, blocks: Floats, pack: int, n: int) -> None:
    """Write the vectors of a pack back."""
    block, first = pack * PACK // BLOCK, pack * PACK % BLOCK
    target = blocks[block]
    for c in range(y.size // w):
        for b in range(n):
            put(target, c, first + b, y[c * w + b])


@kernel
def advance(
    blocks: Floats,
    acting: Acting,
    books: int | None,
    clock: Floats,
    tolerance: float,
    times: Floats,
    index: Ints,
    until: float,
    stop: float,
    rotor_frame: Floats,
    members: Ints,
    frames: Frames,
    sums: Floats,
    first: int,
    last: int,
) -> None:
    """All frames of some blocks, then on to the step around `until`, or to `stop` if it is finite.

    The clock (2, packs) has the time from which a pack's next step starts, and the step to try.
    """
    size = ALONE if books is None else CHANGING
    rows = np.zeros((WORK + 2 * CHANGING) * STRIDE)
    w = min(members.size, PACK)  # a body that is alone pays for itself only
    y, new, out = np.zeros(size * w), np.zeros(size * w), np.zeros(size * w)
    K = np.zeros((STAGES, size * w))
    packs = -(-members.size // PACK)
    for pack in range(first * BLOCK // PACK, min(last * BLOCK // PACK, packs)):
        lo = pack * PACK
        n = min(members.size - lo, PACK)
        take_pack(blocks, pack, n, w, rows, y)
        t, h = clock[0, pack], clock[1, pack]
        h, h_next = find_step(acting, books, rows, n, w, y, K, new, t, h, tolerance)
        is_dense = False
        for f in range(times.size):
            while times[f] > t + h:
                t += h
                y[:] = new
                h, h_next = find_step(acting, books, rows, n, w, y, K, new, t, h_next, tolerance)
                is_dense = False
            out[:] = y
            if times[f] > t or not h > 0.0:
                if not is_dense:
                    take_stages(acting, books, rows, n, w, y, K, out, h, 13, STAGES)
                    is_dense = True
                interpolate(n, w, y, new, K, h, (times[f] - t) / h, out)
            shown = out.reshape(size, w)
            store_frame(
                frames, index[f], members[lo : lo + n], rows4(rotor_frame, lo, lo + n),
                rows3(shown[COM : COM + 3], 0, n), rows4(shown[Q : Q + 4], 0, n),
                rows3(shown[P : P + 3], 0, n), rows3(shown[L : L + 3], 0, n),
            )  # fmt: skip
            for c in range(size - ALONE):
                for b in range(n):
                    sums[index[f], lo // BLOCK, c] += shown[BOOKED + c, b]
        while t + h < until:
            t += h
            y[:] = new
            h, h_next = find_step(acting, books, rows, n, w, y, K, new, t, h_next, tolerance)
        while t < stop < np.inf:  # the last step may have to be cut again
            h, h_next = find_step(
                acting, books, rows, n, w, y, K, new, t, min(stop - t, h), tolerance
            )
            y[:] = new
            if not h > 0.0:
                break
            t = stop if h >= stop - t else t + h
        clock[0, pack], clock[1, pack] = t, h
        give_pack(y, w, blocks, pack, n)


class AdaptiveMotion:
    """A group of bodies, each with steps of its own; see `motion.Motion`."""

    def __init__(
        self,
        group: Group,
        state: State,
        start: float,
        first_step: float,
        tolerance: float,
    ) -> None:
        self.group, self.start, self.tolerance = group, start, tolerance
        n, terms = group.members.size, group.terms
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        assert row_count(terms) <= WORK
        self.blocks = in_blocks(n, row_count(terms), parts)
        self.account = Account(group, state)
        self.clock = np.zeros((2, -(-n // PACK)))
        self.clock[1] = first_step

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        sums = self.advance(elapsed, rows, np.inf, frames)
        return self.account.of_frames(elapsed, rows, frames, sums)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        none = room_for(0, 0, np.empty((0, 4)))
        elapsed = stop - self.start
        self.advance(np.empty(0), np.empty(0, dtype=np.int64), elapsed, none)
        n = self.group.members.size
        state, sums = (
            state_of(self.blocks, n),
            out_of_blocks(self.blocks, BOOKED, 7, n).sum(axis=1),
        )
        return state, self.account.of_state(elapsed, state.com, state.q, state.L, sums)

    def advance(self, times: Floats, rows: Ints, stop: float, frames: Frames) -> Floats:
        """Through all times; sums of what was booked, for each row of the frames."""
        group = self.group
        n = group.members.size
        sums = np.zeros((frames.position.shape[0], len(self.blocks), 7))
        for lo, hi, until in self.calls(times, stop):
            cut = stop if until == stop else np.inf
            through = partial(
                advance, self.blocks, acting_of(group.terms), self.account.books, self.clock,
                self.tolerance, times[lo:hi], rows[lo:hi], until, cut, group.bodies.rotor_frame,
                group.members, frames, sums,
            )  # fmt: skip
            THREADS.spread(through, n, int(n * (hi - lo + 1) * COST))
        return np.asarray(sums.sum(axis=1))

    def calls(self, times: Floats, stop: float) -> Iterator[tuple[int, int, float]]:
        """Ranges of frames, and times to go to after them, of about a second each."""
        most = max(1.0, NANOSECONDS_PER_CALL / (COST * self.group.members.size))
        done = 0
        while done < times.size:
            horizon = self.horizon(most)
            reached = max(int(np.searchsorted(times, horizon, side="right")), done)
            if reached == done and self.horizon(2.0 * most) < times[done]:
                yield done, done, horizon
            else:
                yield done, max(reached, done + 1), 0.0
                done = max(reached, done + 1)
        while stop < np.inf and self.horizon(most) < stop:
            yield done, done, self.horizon(most)
        if stop < np.inf:
            yield done, done, stop

    def horizon(self, steps: float) -> float:
        """Time that every body will have reached after so many more steps, about."""
        ahead = self.clock[0] + steps * self.clock[1]
        return float(np.min(ahead, initial=np.inf, where=np.isfinite(ahead)))


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> AdaptiveMotion:
    """Set off from a state at a time [s]; dt is the first step to try."""
    return AdaptiveMotion(group, state, start, dt, tolerance)
