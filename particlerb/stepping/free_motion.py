"""Free motion in closed form: a parabola and the theta functions of rotors/exact.py. No step.

For bodies on which nothing acts but forces through the centre of mass that are constant in the
world. Any time costs the same; the error does not depend on how many frames were asked for.
"""

from functools import partial
from typing import TypeAlias

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.maths.quaternion import rows4
from particlerb.maths.vec3 import Floats, Ints, Rows3, add_scaled, load3, rows3, store3
from particlerb.model.bodies import taken
from particlerb.model.state import Frames, State, store_frame
from particlerb.rotors.exact import (
    HyperbolicTurn,
    SteadyTurn,
    ThetaTurn,
    Turn,
    orientation,
    prepare,
    turn_block,
)
from particlerb.stepping.motion import Group, constant_force, force_of
from particlerb.stepping.saved_arrays import Saved

_Part: TypeAlias = tuple[
    State,
    Floats,
    Floats,
    Floats,
    SteadyTurn | None,
    ThetaTurn | None,
    HyperbolicTurn | None,
]


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


@kernel
def _fly_blocks(
    state: State,
    force: Floats,
    inv_mass: Floats,
    rotor_frame: Floats,
    steady: SteadyTurn | None,
    theta: ThetaTurn | None,
    hyperbolic: HyperbolicTurn | None,
    times: Floats,
    rows: Ints,
    members: Ints,
    frames: Frames,
    first: int,
    last: int,
) -> None:
    """All frames of some blocks of one kind of turn; times count from the state."""
    local = np.empty((10, BLOCK))
    for k in range(first, last):
        lo, hi = k * BLOCK, min((k + 1) * BLOCK, inv_mass.size)
        n = hi - lo
        com, p, q = rows3(local[0:3], 0, n), rows3(local[3:6], 0, n), rows4(local[6:10], 0, n)
        start, p0, L = rows3(state.com, lo, hi), rows3(state.p, lo, hi), rows3(state.L, lo, hi)
        F, frame = rows3(force, lo, hi), rows4(rotor_frame, lo, hi)
        for f in range(times.size):
            turn_block(steady, theta, hyperbolic, times[f], lo, hi, q)
            _parabola(start, p0, F, inv_mass[lo:hi], times[f], com, p)
            store_frame(frames, rows[f], members[lo:hi], frame, com, q, p, L)


class FreeMotion:
    """A group of free bodies, sorted into kinds of turn; see `motion.Motion`."""

    def __init__(self, group: Group, state: State, start: float) -> None:
        self.group, self.state, self.start = group, state, start
        self.force = force_of(group)[1]
        self.constant = constant_force(group, state)
        bodies = group.bodies
        self.turns = prepare(bodies.inertia, bodies.rotor_class, state.q, state.L)
        self.parts = [self.part(which, turn) for which, turn in self.turns]

    def part(self, which: Ints, turn: Turn) -> _Part:
        """Arguments of the kernel for the bodies of one kind of turn."""
        bodies = self.group.bodies
        return (
            taken(self.state, which),
            np.ascontiguousarray(self.force[:, which]),
            bodies.inv_mass[which],
            np.ascontiguousarray(bodies.rotor_frame[:, which]),
            turn if isinstance(turn, SteadyTurn) else None,
            turn if isinstance(turn, ThetaTurn) else None,
            turn if isinstance(turn, HyperbolicTurn) else None,
        )

    def record(self, times: Floats, rows: Ints, frames: Frames) -> Floats:
        """Write the states at these times into rows of the frames; return (T, 7) booked."""
        elapsed = times - self.start
        for (which, _), part in zip(self.turns, self.parts, strict=True):
            fly = partial(_fly_blocks, *part, elapsed, rows, self.group.members[which], frames)
            THREADS.spread(fly, which.size, which.size * times.size)
        return self.constant.booked(elapsed)

    def finish(self, stop: float) -> tuple[State, Floats]:
        """State at the end of the segment, and (7,) booked until then."""
        t = stop - self.start
        com, q, p, L = self.state
        q = q.copy()
        for which, turn in self.turns:
            q[:, which] = orientation(turn, t)
        inv_mass = self.group.bodies.inv_mass
        com = com + t * inv_mass * (p + 0.5 * t * self.force)
        return State(com, q, p + t * self.force, L), self.constant.booked(np.array([t]))[0]

    def checkpoint(self) -> Saved:
        """Nothing: all follows from the start."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Do nothing."""
