"""DOP853: Runge-Kutta of order 8 that chooses its own steps, with dense output; any smooth force.

The oracle: it shares nothing with the splittings but the forces. Each body takes steps of its own,
as long as the error estimate of a step stays below the tolerance. Frames come from the dense output
of order 7, so they change nothing in the motion. What it does not do is keep energy or |q| by
construction: their drift shows its error.

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
    L,
    P,
    Q,
    get,
    in_blocks,
    out_of_blocks,
    put,
    state_of,
    state_rows,
)
from particlerb.bodies.state import Frames, State, multiplied, room_for, store_frame
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, rows3
from particlerb.methods.dop853_table import STAGES, A, D, E
from particlerb.methods.motion import Group
from particlerb.methods.rates import Pose, slopes
from particlerb.terms import Acting, acting_of, row_count, rows_of_terms, work_of_potentials
from particlerb.threads import BLOCK, THREADS

ORDER: Final = 8
FREE_ORDER: Final = 8
IS_ADAPTIVE: Final = True
KEEPS_RODS: Final = False
ACCEPTS: Final = frozenset({"gravity", "push", "follower", "torque", "drag", "spring", "central"})
SUMMARY: Final = "order 8, adaptive by run.tolerance, dense output; the oracle; any force"
COST: Final = 2500.0  # ns per body-step, roughly
NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between
SHRINK: Final = 0.2  # of a step at most, growth at most, and prudence: as the authors take them
GROW: Final = 5.0
SAFETY: Final = 0.9
LEAST_STEP: Final = 1e-14  # relative to the time: below it nothing moves any more
SIZE: Final = CHANGING  # of the vector of a body: x, q, p, L, booked


@kernel
def slope_into(acting: Acting, rows: Floats, b: int, y: Floats, slope: Floats) -> None:
    """Slopes of body b in the state y."""
    now = Pose(
        (y[0], y[1], y[2]), (y[3], y[4], y[5], y[6]), (y[7], y[8], y[9]), (y[10], y[11], y[12])
    )
    rate, (power, force, turning) = slopes(acting, rows, b, now)
    slope[0], slope[1], slope[2] = rate.x
    slope[3], slope[4], slope[5], slope[6] = rate.q
    slope[7], slope[8], slope[9] = rate.p
    slope[10], slope[11], slope[12] = rate.L
    slope[BOOKED] = power
    slope[14], slope[15], slope[16] = force
    slope[17], slope[18], slope[19] = turning


@kernel
def take_stages(
    acting: Acting,
    rows: Floats,
    b: int,
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
        for k in range(stage):
            share = h * A[stage, k]
            if share != 0.0:
                for c in range(SIZE):
                    new[c] += share * K[k, c]
        slope_into(acting, rows, b, new, K[stage])


@inline
def largest(y: Floats, new: Floats, lo: int, hi: int) -> float:
    """Larger of the lengths of two vectors."""
    a, b = 0.0, 0.0
    for c in range(lo, hi):
        a += y[c] * y[c]
        b += new[c] * new[c]
    return math.sqrt(max(a, b))


@inline
def moved(y: Floats, new: Floats) -> float:
    """Way of the centre of mass."""
    way = 0.0
    for c in range(3):
        way += (new[c] - y[c]) ** 2
    return math.sqrt(way)


@inline
def size_of(rows: Floats, b: int) -> float:
    """Radius of gyration of body b [m], about the axis of its largest moment; 0 for a point."""
    least = min(
        get(rows, INV_INERTIA, b),
        get(rows, INV_INERTIA + 1, b),
        get(rows, INV_INERTIA + 2, b),
    )
    return math.sqrt(get(rows, INV_MASS, b) / least) if least > 0.0 else 0.0


@inline
def error_of(K: Floats, y: Floats, new: Floats, extent: float, h: float) -> float:
    """Error estimate of a step, relative to what is turned over; smaller than 1 is accurate."""
    five, three = 0.0, 0.0
    for lo, hi in ((0, 3), (3, 7), (7, 10), (10, 13)):
        scale = 1.0 if lo == 3 else largest(y, new, lo, hi)
        if lo == 0:
            scale = max(moved(y, new), extent)
        for c in range(lo, hi):
            e5, e3 = 0.0, 0.0
            for k in range(13):
                e5 += E[0, k] * K[k, c]
                e3 += E[1, k] * K[k, c]
            if e5 != 0.0 or e3 != 0.0:
                five += (e5 / scale) ** 2
                three += (e3 / scale) ** 2
    if five == 0.0:
        return 0.0
    return abs(h) * five / math.sqrt((five + 0.01 * three) * 13.0)


@kernel
def find_step(
    acting: Acting, rows: Floats, b: int, y: Floats, K: Floats, new: Floats, t: float, h: float,
    tolerance: float,
) -> tuple[float, float]:  # fmt: skip
    """Longest step up to h that is accurate, and the one to try after it; `new` is its end.

    NaN where no step is: the state is not finite, or the forces are not smooth.
    """
    slope_into(acting, rows, b, y, K[0])
    extent = size_of(rows, b)
    while True:
        take_stages(acting, rows, b, y, K, new, h, 1, 13)
        error = error_of(K, y, new, extent, h) / tolerance
        if error < 1.0:
            factor = GROW if error == 0.0 else min(GROW, SAFETY * error ** (-1.0 / 8.0))
            norm = np.sqrt(new[3] ** 2 + new[4] ** 2 + new[5] ** 2 + new[6] ** 2)
            for c in range(Q, Q + 4):
                new[c] /= norm
            return h, h * max(factor, SHRINK)
        factor = max(SHRINK, SAFETY * error ** (-1.0 / 8.0)) if error < np.inf else SHRINK
        h *= factor
        if not h > LEAST_STEP * t:
            new[:] = np.nan
            return np.nan, np.nan


@kernel
def interpolate(y: Floats, new: Floats, K: Floats, h: float, share: float, out: Floats) -> None:
    """State at a share of a step by the polynomial of order 7; |q| = 1."""
    for c in range(SIZE):
        change = new[c] - y[c]
        value = 0.0
        for i in range(4):
            last = 0.0
            for k in range(STAGES):
                last += D[3 - i, k] * K[k, c]
            value = (value + h * last) * (share if i % 2 == 0 else 1.0 - share)
        value = (value + 2.0 * change - h * (K[12, c] + K[0, c])) * share
        value = (value + h * K[0, c] - change) * (1.0 - share)
        out[c] = y[c] + (value + change) * share
    norm = np.sqrt(out[3] ** 2 + out[4] ** 2 + out[5] ** 2 + out[6] ** 2)
    for c in range(Q, Q + 4):
        out[c] /= norm


@kernel
def advance(
    blocks: Floats,
    acting: Acting,
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

    The clock (2, n) has the time from which a body's next step starts, and the step to try.
    """
    shown = np.zeros((CHANGING, 1))
    y, new, out, K = np.empty(SIZE), np.empty(SIZE), np.empty(SIZE), np.zeros((STAGES, SIZE))
    for i in range(first * BLOCK, min(last * BLOCK, members.size)):
        k, b = i // BLOCK, i % BLOCK
        rows = blocks[k]
        t, h = clock[0, i], clock[1, i]
        for c in range(SIZE):
            y[c] = get(rows, c, b)
        h, h_next = find_step(acting, rows, b, y, K, new, t, h, tolerance)
        is_dense = False
        for f in range(times.size):
            while times[f] > t + h:
                t += h
                y[:] = new
                h, h_next = find_step(acting, rows, b, y, K, new, t, h_next, tolerance)
                is_dense = False
            out[:] = y
            if times[f] > t or not h > 0.0:
                if not is_dense:
                    take_stages(acting, rows, b, y, K, out, h, 13, STAGES)
                    is_dense = True
                interpolate(y, new, K, h, (times[f] - t) / h, out)
            shown[:, 0] = out
            store_frame(
                frames, index[f], members[i : i + 1], rows4(rotor_frame, i, i + 1),
                rows3(shown[COM : COM + 3], 0, 1), rows4(shown[Q : Q + 4], 0, 1),
                rows3(shown[P : P + 3], 0, 1), rows3(shown[L : L + 3], 0, 1),
            )  # fmt: skip
            for c in range(7):
                sums[index[f], k, c] += out[BOOKED + c]
        while t + h < until:
            t += h
            y[:] = new
            h, h_next = find_step(acting, rows, b, y, K, new, t, h_next, tolerance)
        while t < stop < np.inf:  # the last step may have to be cut again
            h, h_next = find_step(acting, rows, b, y, K, new, t, min(stop - t, h), tolerance)
            y[:] = new
            if not h > 0.0:
                break
            t = stop if h >= stop - t else t + h
        clock[0, i], clock[1, i] = t, h
        for c in range(SIZE):
            put(rows, c, b, y[c])


class AdaptiveMotion:
    """A group of bodies, each with steps of its own; see `motion.Motion`."""

    def __init__(
        self, group: Group, state: State, start: float, first_step: float, tolerance: float
    ) -> None:
        self.group, self.start, self.tolerance = group, start, tolerance
        n, terms = group.members.size, group.terms
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        self.blocks = in_blocks(n, row_count(terms), parts)
        self.work_before = work_of_potentials(terms, state.com, state.q)
        self.clock = np.zeros((2, n))
        self.clock[1] = first_step

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        given = self.advance(times - self.start, rows, np.inf, frames)[rows]
        own, frame = self.group.members, self.group.bodies.rotor_frame
        for k, row in enumerate(rows):
            q = multiplied(np.ascontiguousarray(frames.orientation[row, own].T), frame)
            given[k, 0] += self.work_of(frames.position[row, own].T, q)
        return given

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        none = room_for(0, 0, np.empty((0, 4)))
        self.advance(np.empty(0), np.empty(0, dtype=np.int64), stop - self.start, none)
        n = self.group.members.size
        state, given = state_of(self.blocks, n), out_of_blocks(self.blocks, BOOKED, 7, n)
        booked: Floats = given.sum(axis=1)
        booked[0] += self.work_of(state.com, state.q)
        return state, booked

    def advance(self, times: Floats, rows: Ints, stop: float, frames: Frames) -> Floats:
        """Through all times; sums of what was booked, for each row of the frames."""
        group = self.group
        n = group.members.size
        sums = np.zeros((frames.position.shape[0], len(self.blocks), 7))
        for lo, hi, until in self.calls(times, stop):
            cut = stop if until == stop else np.inf
            through = partial(
                advance, self.blocks, acting_of(group.terms), self.clock, self.tolerance,
                times[lo:hi], rows[lo:hi], until, cut, group.bodies.rotor_frame, group.members,
                frames, sums,
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

    def work_of(self, com: Floats, q: Floats) -> float:
        """What forces with a potential have done since the start [J]."""
        return work_of_potentials(self.group.terms, com, q) - self.work_before


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> AdaptiveMotion:
    """Set off from a state at a time [s]; dt is the first step to try."""
    return AdaptiveMotion(group, state, start, dt, tolerance)
