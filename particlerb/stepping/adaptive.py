"""Bodies that each choose their own steps, by DOP853, and the loop over such steps.

Sixteen bodies at a time take the same steps, in SIMD lanes, as long as the error estimate of each
stays below the tolerance. Frames come from the dense output of order 7, so they change nothing in
the motion.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel, kernel_from
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.forces import acting_of, row_count, rows_of_terms
from particlerb.forces.registry import STAGE as WORK
from particlerb.integrators.dop853 import PACK
from particlerb.integrators.dop853_step import (
    ALONE,
    Equations,
    Pack,
    find_step,
    interpolate,
    normalise,
    take_slopes,
    take_stages,
)
from particlerb.integrators.dop853_table import END, STAGES
from particlerb.integrators.method import Method
from particlerb.joints.records import Jointed
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
    assign,
    get,
    in_blocks,
    into_blocks,
    out_of_blocks,
    put,
    state_of,
    state_rows,
)
from particlerb.model.state import Frames, State, room_for, store_frame
from particlerb.stepping.jointed_motion import JointedMotion
from particlerb.stepping.loop import Recording
from particlerb.stepping.motion import SegmentGroup, WorkAccount
from particlerb.stepping.saved_arrays import Saved

NANOSECONDS_PER_CALL: Final = 1e9  # about a second: progress and Ctrl-C in between


class Leg(NamedTuple):
    """Frames to write, and how far to go after them; times are since the segment began."""

    times: Floats  # (T,) [s] of the frames
    rows: Ints  # (T,) of the frames
    until: float  # [s] on to the step around it
    stop: float  # [s] or exactly to here, if that is finite


class _OnePack(NamedTuple):
    """Bodies that take the same steps, as `advance_steps` takes them."""

    equations: Equations
    pack: Pack
    out: Floats  # states at a frame
    first: int  # body of the group


def begin(bodies: Any, t: float) -> None:
    """Slopes at the start of a step."""
    raise NotImplementedError


def go_on(bodies: Any, t: float) -> None:
    """The end of a step, with its slopes, is the start of the next one, from t on."""
    raise NotImplementedError


def find(bodies: Any, t: float, h: float) -> tuple[float, float]:
    """Longest step up to h from t that is accurate, and the one to try after it."""
    raise NotImplementedError


def take_last_stages(bodies: Any, t: float, h: float) -> None:
    """Slopes that dense output needs beside those of the step."""
    raise NotImplementedError


def show(bodies: Any, t: float, h: float, share: float) -> None:
    """State at a share of the step from t, for a frame."""
    raise NotImplementedError


def write(bodies: Any, recording: Recording, frame: int) -> None:
    """Write what is shown into a frame."""
    raise NotImplementedError


def advance_steps(
    bodies: Any, y: Floats, out: Floats, clock: Floats, leg: Leg, recording: Recording
) -> None:
    """All frames, then on to the step around `until`, or to `stop` if it is finite.

    The functions above stand for those of bodies of one kind.

    Parameters
    ----------
    bodies
        What these functions take.
    y, out : ndarray
        States of the bodies at the start of a step, and for a frame.
    clock : ndarray, (3,)
        Time from which the next step starts, step to try [s], and steps taken.
    leg, recording : Leg, Recording
    """
    times, rows, until, stop = leg
    t, h, taken = clock[0], clock[1], clock[2]
    begin(bodies, t)
    h, h_next = find(bodies, t, h)
    is_dense = False
    for f in range(times.size):
        while times[f] > t + h:
            t, taken = t + h, taken + 1.0
            go_on(bodies, t)
            h, h_next = find(bodies, t, h_next)
            is_dense = False
        assign(out, y)
        if times[f] > t or not h > 0.0:
            if not is_dense:
                take_last_stages(bodies, t, h)
                is_dense = True
            show(bodies, t, h, (times[f] - t) / h)
        write(bodies, recording, rows[f])
    while t + h < until:
        t, taken = t + h, taken + 1.0
        go_on(bodies, t)
        h, h_next = find(bodies, t, h_next)
    h_next = h
    while t < stop < np.inf:  # the last step may have to be cut again
        h, h_next = find(bodies, t, min(stop - t, h_next))
        ahead = stop if h >= stop - t else t + h
        go_on(bodies, ahead)
        if not h > 0.0:
            break
        t, taken = ahead, taken + 1.0
    clock[0], clock[1], clock[2] = t, h, taken


@inline
def _take_pack(blocks: Floats, pack: int, n: int, w: int, rows: Floats, y: Floats) -> None:
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
def _give_pack(y: Floats, w: int, blocks: Floats, pack: int, n: int) -> None:
    """Write the vectors of a pack back."""
    block, first = pack * PACK // BLOCK, pack * PACK % BLOCK
    target = blocks[block]
    for c in range(y.size // w):
        for b in range(n):
            put(target, c, first + b, y[c * w + b])


@inline
def store_vectors(
    recording: Recording, f: int, lo: int, n: int, out: Floats, w: int, block: int
) -> None:
    """Write bodies from vectors as `dop853_step` has them into frame f, and what they book."""
    shown = out.reshape(out.size // w, w)
    com, q = rows3(shown[COM : COM + 3], 0, n), rows4(shown[Q : Q + 4], 0, n)
    p, spin = rows3(shown[P : P + 3], 0, n), rows3(shown[L : L + 3], 0, n)
    members, turn = recording.members[lo : lo + n], rows4(recording.rotor_frame, lo, lo + n)
    store_frame(recording.frames, f, members, turn, com, q, p, spin)
    for c in range(shown.shape[0] - ALONE):
        for b in range(n):
            recording.sums[f, block, c] += shown[BOOKED + c, b]


@inline
def _begin(bodies: _OnePack, t: float) -> None:
    """`begin` of a pack."""
    rows, n, w, y, _, K = bodies.pack
    take_slopes(bodies.equations, rows, n, w, t, y, K[0])


@inline
def _go_on(bodies: _OnePack, _t: float) -> None:
    """`go_on` of a pack."""
    _, _, _, y, new, K = bodies.pack
    assign(y, new)
    assign(K[0], K[END])


@inline
def _find(bodies: _OnePack, t: float, h: float) -> tuple[float, float]:
    """`find` of a pack."""
    return find_step(bodies.equations, bodies.pack, t, h)


@inline
def _take_last_stages(bodies: _OnePack, t: float, h: float) -> None:
    """`take_last_stages` of a pack."""
    take_stages(bodies.equations, bodies.pack, bodies.out, t, h, END + 1, STAGES)


@inline
def _show(bodies: _OnePack, t: float, h: float, share: float) -> None:
    """`show` of a pack."""
    _, n, w, y, new, K = bodies.pack
    interpolate(K, y, new, h, share, bodies.out)
    normalise(bodies.out, n, w)


@inline
def _write(bodies: _OnePack, recording: Recording, frame: int) -> None:
    """`write` of a pack."""
    lo, pack = bodies.first, bodies.pack
    store_vectors(recording, frame, lo, pack.n, bodies.out, pack.w, lo // BLOCK)


_advance_pack = kernel_from(
    advance_steps, "alone",
    begin=_begin, go_on=_go_on, find=_find, take_last_stages=_take_last_stages, show=_show,
    write=_write,
)  # fmt: skip


@kernel
def _advance_blocks(
    equations: Equations, blocks: Floats, clock: Floats, leg: Leg, recording: Recording, first: int,
    last: int,
) -> None:  # fmt: skip
    """Advance the packs of some blocks; the clock is (packs, 3)."""
    size, members = ALONE if equations.books is None else CHANGING, recording.members
    rows = np.zeros((WORK + 2 * CHANGING) * STRIDE)
    w = min(members.size, PACK)  # a body that is alone pays for itself only
    y, new, out = np.zeros(size * w), np.zeros(size * w), np.zeros(size * w)
    K = np.zeros((STAGES, size * w))
    packs = -(-members.size // PACK)
    for k in range(first * BLOCK // PACK, min(last * BLOCK // PACK, packs)):
        lo = k * PACK
        n = min(members.size - lo, PACK)
        _take_pack(blocks, k, n, w, rows, y)
        bodies = _OnePack(equations, Pack(rows, n, w, y, new, K), out, lo)
        _advance_pack(bodies, y, out, clock[k], leg, recording)
        _give_pack(y, w, blocks, k, n)


class AdaptiveRun(JointedMotion):
    """What groups of bodies with steps of their own choice share; see `motion.Motion`."""

    blocks: Floats
    clock: Floats  # (..., 3) time [s] from which a step starts, step [s] to try, steps taken
    cost: float  # [ns] of a step of all, roughly
    jointed: Jointed | None = None

    def __init__(self, group: SegmentGroup, state: State, start: float, tolerance: float) -> None:
        self.group, self.start = group, start
        self.account = WorkAccount(group, state)
        self.equations = Equations(acting_of(group.terms), self.account.books, tolerance)

    def advance_some(self, leg: Leg, recording: Recording) -> None:
        """Advance all bodies."""
        raise NotImplementedError

    def write_back(self) -> None:
        """Bring states back to the blocks, where they were elsewhere."""

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        sums = self.advance(elapsed, rows, np.inf, frames)
        return self.account.of_frames(elapsed, rows, frames, sums)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        elapsed, n = stop - self.start, self.group.members.size
        none = room_for(0, 0, np.empty((0, 4)))
        self.advance(np.empty(0), np.empty(0, dtype=np.int64), elapsed, none)
        self.write_back()
        state = state_of(self.blocks, n)
        sums = out_of_blocks(self.blocks, BOOKED, 7, n).sum(axis=1)
        return state, self.account.of_state(elapsed, state.com, state.q, state.L, sums)

    def advance(self, times: Floats, rows: Ints, stop: float, frames: Frames) -> Floats:
        """Through all times; sums of what was booked, for each row of the frames."""
        group = self.group
        sums = np.zeros((frames.position.shape[0], len(self.blocks), 7))
        where, nobody = (group.bodies.rotor_frame, group.members), np.zeros(0, dtype=np.int64)
        self.coordinates = np.zeros((len(frames.position), *self.turned.shape))
        recording = Recording(*where, frames, sums, nobody, self.coordinates)
        for lo, hi, until in self.calls(times, stop):
            cut = stop if until == stop else np.inf
            self.advance_some(Leg(times[lo:hi], rows[lo:hi], until, cut), recording)
        return np.asarray(sums.sum(axis=1))

    def calls(self, times: Floats, stop: float) -> Iterator[tuple[int, int, float]]:
        """Ranges of frames, and times to go to after them, of about a second each."""
        most = max(1.0, NANOSECONDS_PER_CALL / self.cost)
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
        ahead = self.clock[:, 0] + steps * self.clock[:, 1]
        return float(np.min(ahead, initial=np.inf, where=np.isfinite(ahead)))


class AdaptiveMotion(AdaptiveRun):
    """A group of bodies, each with steps of its own; see `motion.Motion`."""

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
        self.cost = method.cost * n
        parts = state_rows(state, group.bodies) + rows_of_terms(terms)
        assert row_count(terms) <= WORK
        self.blocks = in_blocks(n, row_count(terms), parts)
        self.clock = np.zeros((-(-n // PACK), 3))
        self.clock[:, 1] = first_step

    def checkpoint(self) -> Saved:
        """States at the start of each pack's step, when that is, and how long the step is."""
        n = self.group.members.size
        changing = out_of_blocks(self.blocks, 0, CHANGING, n)
        return {"changing": changing, "clock": self.clock[:, :2].T.copy()}

    def restore(self, saved: Saved) -> None:
        """Go on from what was saved."""
        into_blocks(self.blocks, 0, saved["changing"])
        self.clock[:, :2] = saved["clock"].T

    def advance_some(self, leg: Leg, recording: Recording) -> None:
        """Packs of bodies over threads."""
        through = partial(_advance_blocks, self.equations, self.blocks, self.clock, leg, recording)
        THREADS.spread(through, self.group.members.size, int((leg.times.size + 1) * self.cost))
