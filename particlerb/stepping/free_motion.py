"""Motion in closed form, at any time at once: a parabola, and a rotation without steps.

For bodies on which forces act that are constant in the world: through the centre of mass, where the
body turns freely (rotors/exact.py), or on the axis of a symmetric body, where it is Lagrange's top
(rotors/tops.py). Any time costs the same; the error does not depend on how many frames were asked
for.
"""

from collections.abc import Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.maths.quaternion import load4, rows4, store4
from particlerb.maths.vec3 import Floats, Ints, Rows3, add_scaled, load3, rows3, store3
from particlerb.model.block import BOOKED, COM, STRIDE, L, P, Q, in_blocks
from particlerb.model.bodies import taken
from particlerb.model.comparison import CONJUGATE
from particlerb.model.state import Frames, State, quaternion_product, rotate, store_frame
from particlerb.rotors.exact import (
    HyperbolicTurn,
    SteadyTurn,
    ThetaTurn,
    Turn,
    by_kind,
    orientation,
    prepare,
    turn_block,
)
from particlerb.rotors.tops import N_THETA, prepare_tops
from particlerb.stepping.closed_forms import Levers, lever_of, levers_on
from particlerb.stepping.motion import Group, constant_force, force_of
from particlerb.stepping.saved_arrays import Saved
from particlerb.stepping.top_rows import top_block, tops_at

_AXIS_3: Final = np.array([[0.0], [0.0], [1.0]])
_TURNING: Final = [0, 4, 5, 6]  # of what is booked: work and angular impulse


class _Part(NamedTuple):
    """Bodies of one kind of turn, as the kernel takes them; one of five kinds is not None."""

    state: State  # of the whole group, as the next three
    force: Floats
    inv_mass: Floats
    rotor_frame: Floats
    which: Ints  # of the group are these
    steady: SteadyTurn | None = None
    theta: ThetaTurn | None = None
    hyperbolic: HyperbolicTurn | None = None
    top: Floats | None = None  # blocks of the tables of rotors/tops.py
    near: Floats | None = None

    @property
    def turn(self) -> Turn:
        """That of bodies that turn freely."""
        found = self.steady or self.theta or self.hyperbolic
        assert found is not None
        return found


class _Turned(NamedTuple):
    """What a force on their axis gives tops."""

    axes: Floats  # (4, n) from those in which it acts on axis 3 to the rotor frame
    first: Floats  # (4,) sums of its work, up to a constant, and of L, when the segment begins


@inline
def _parabola(
    start: Rows3, p0: Rows3, force: Rows3, inv_mass: Floats, t: float, com: Rows3, p: Rows3
) -> None:
    """x = x₀ + (p₀ t + F t²/2)/M,  p = p₀ + F t."""
    for b in range(inv_mass.size):
        p_b, F = load3(p0, b), load3(force, b)
        store3(p, b, add_scaled(t, F, p_b))
        way = add_scaled(0.5 * t, F, p_b)
        store3(com, b, add_scaled(t * inv_mass[b], way, load3(start, b)))


@inline
def _add_given(local: Floats, n: int, given: Floats) -> None:
    """Sums over the bodies of a block of the work of what turns them, and of L."""
    work, x, y, z = 0.0, 0.0, 0.0, 0.0
    for b in range(n):
        work += local[BOOKED, b]
        x, y, z = x + local[L, b], y + local[L + 1, b], z + local[L + 2, b]
    given[0], given[1], given[2], given[3] = work, x, y, z


@kernel
def _fly_blocks(
    part: _Part,
    times: Floats,
    rows: Ints,
    members: Ints,
    frames: Frames,
    given: Floats | None,
    first: int,
    last: int,
) -> None:
    """All frames of some blocks of one kind of turn; times count from the state."""
    state, force, inv_mass, rotor_frame, which, steady, theta, hyperbolic, top, near = part
    out, own = np.empty((BOOKED + 1) * STRIDE), np.empty((17, BLOCK))
    local, place = out.reshape((BOOKED + 1, STRIDE)), np.empty(BLOCK, np.int64)
    for k in range(first, last):
        lo, hi = k * BLOCK, min((k + 1) * BLOCK, which.size)
        n = hi - lo
        com, p, q = (
            rows3(local[COM : COM + 3], 0, n),
            rows3(local[P : P + 3], 0, n),
            rows4(local[Q : Q + 4], 0, n),
        )
        start, p0, spin = rows3(own[0:3], 0, n), rows3(own[3:6], 0, n), rows3(own[6:9], 0, n)
        F, frame, inverse = rows3(own[9:12], 0, n), rows4(own[12:16], 0, n), own[16, :n]
        for b in range(n):
            j = which[lo + b]
            place[b], inverse[b] = members[j], inv_mass[j]
            store3(start, b, load3(rows3(state.com, 0, inv_mass.size), j))
            store3(p0, b, load3(rows3(state.p, 0, inv_mass.size), j))
            store3(spin, b, load3(rows3(state.L, 0, inv_mass.size), j))
            store3(F, b, load3(rows3(force, 0, inv_mass.size), j))
            store4(frame, b, load4(rows4(rotor_frame, 0, inv_mass.size), j))
        if given is not None:
            spin = rows3(local[L : L + 3], 0, n)
        for f in range(times.size):
            turn_block(steady, theta, hyperbolic, times[f], lo, hi, q)
            top_block(top, near, k, times[f], n, out)
            _parabola(start, p0, F, inverse, times[f], com, p)
            store_frame(frames, rows[f], place[:n], frame, com, q, p, spin)
            if given is not None:
                _add_given(local, n, given[k, f])


class FreeMotion:
    """A group of bodies in closed form, sorted into kinds of turn; see `motion.Motion`."""

    def __init__(self, group: Group, state: State, start: float) -> None:
        self.group, self.state, self.start = group, state, start
        self.force = force_of(group)[1]
        self.constant = constant_force(group, state)
        self.parts = list(self.sorted_parts())

    def sorted_parts(self) -> Iterator[tuple[Ints, _Part, _Turned | None]]:
        """Bodies of each kind of turn, what the kernel takes, and what turns them."""
        bodies, state = self.group.bodies, self.state
        moving = state, self.force, bodies.inv_mass, bodies.rotor_frame
        lever = lever_of(self.group.terms)
        if lever is not None:
            levers = levers_on(bodies, lever)
            yield from self.top_parts(levers)
            free = np.flatnonzero(levers.is_free)
            bodies, state = taken(bodies, free), taken(state, free)
        for which, turn in prepare(bodies.inertia, bodies.rotor_class, state.q, state.L):
            own = which if lever is None else free[which]
            yield own, _Part(*moving, own, *by_kind(turn)), None

    def top_parts(self, levers: Levers) -> Iterator[tuple[Ints, _Part, _Turned]]:
        """The same of tops, in the axes in which the force acts on axis 3."""
        bodies, index = self.group.bodies, np.flatnonzero(levers.is_top)
        tops, axes = taken(levers.tops, index), levers.axes[:, index]
        state = taken(self.state, index)
        q = quaternion_product(state.q, axes)
        work = (tops.lever * rotate(q, _AXIS_3)).sum(axis=0)
        for which, table in prepare_tops(tops, q, state.L):
            own = index[which]
            blocks = in_blocks(which.size, len(table), [(0, table)])
            kind: Any = {"top" if len(table) == N_THETA else "near": blocks}
            frame = bodies.rotor_frame.copy()
            frame[:, own] = quaternion_product(frame[:, own], axes[:, which])
            part = _Part(self.state, self.force, bodies.inv_mass, frame, own, **kind)
            first = np.array([work[which].sum(), *state.L[:, which].sum(axis=1)])
            yield own, part, _Turned(axes[:, which], first)

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        booked = self.constant.booked(elapsed)
        for which, part, turned in self.parts:
            n_blocks = -(-which.size // BLOCK)
            given = None if turned is None else np.empty((n_blocks, times.size, 4))
            fly = partial(_fly_blocks, part, elapsed, rows, self.group.members, frames, given)
            THREADS.spread(fly, which.size, which.size * times.size)
            if turned is not None and given is not None:
                booked[:, _TURNING] += given.sum(axis=0) - turned.first
        return booked

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        t = stop - self.start
        com, q, p, L = self.state
        q, L = q.copy(), L.copy()
        booked = self.constant.booked(np.array([t]))[0]
        for which, part, turned in self.parts:
            if turned is None:
                q[:, which] = orientation(part.turn, t)
                continue
            end, spin, work = (
                np.empty((4, which.size)),
                np.empty((3, which.size)),
                np.empty(which.size),
            )
            THREADS.alone(tops_at, part.top, part.near, t, end, spin, work)
            q[:, which], L[:, which] = quaternion_product(end, turned.axes * CONJUGATE), spin
            booked[_TURNING] += np.array([work.sum(), *spin.sum(axis=1)]) - turned.first
        inv_mass = self.group.bodies.inv_mass
        com = com + t * inv_mass * (p + 0.5 * t * self.force)
        return State(com, q, p + t * self.force, L), booked

    def checkpoint(self) -> Saved:
        """Nothing: all follows from the start."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""
