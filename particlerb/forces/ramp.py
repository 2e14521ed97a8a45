"""Loads that are linear in time, between two knots of a table: F(t) = F̄ + s ΔF/2, s in [-1, 1].

They have no potential: kicks add the work. A kick takes the load at its own time, so the
impulse of a splitting is the trapezoidal sum of its kicks, which is exact for what is linear.
"""

from bisect import bisect_right
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Kick, Momenta, Rates, Term
from particlerb.maths.quaternion import Matrix, turn
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, cross
from particlerb.model.block import get, get3, put3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, lengths


class Ramp(NamedTuple):
    """Parameters of the term for n bodies: constant axes in the world."""

    force: Floats  # (3, n) [N], midway between the knots
    torque: Floats  # (3, n) [N m] of a free couple
    force_change: Floats  # (3, n) [N], from midway to the later knot
    torque_change: Floats  # (3, n) [N m]
    clock: Floats  # (2, n) when midway is [s], since the segment began; 2/(t₁ - t₀) [1/s]
    arm: Floats  # (3, n) [m], where the force acts, rotor frame


class FollowerRamp(NamedTuple):
    """Parameters of the term for n bodies: constant axes in the body."""

    force: Floats  # as in Ramp, rotor frame
    torque: Floats  # with that of the force about the centre of mass
    force_change: Floats
    torque_change: Floats
    clock: Floats


_CHANGE_ROW: Final = 6  # first row of the changes, after force and torque
_CLOCK_ROW: Final = 12
_ARM_ROW: Final = 14
_NOW_ROW: Final = 17  # force and torque at the time of the kick
_ROWS: Final = 23


@inline
def _set_load(rows: Floats, at: int, b: int, t: float) -> None:
    """Force and torque at the time t."""
    s = (t - get(rows, at + _CLOCK_ROW, b)) * get(rows, at + _CLOCK_ROW + 1, b)
    for k in (0, 3):
        now = add_scaled(s, get3(rows, at + _CHANGE_ROW + k, b), get3(rows, at + k, b))
        put3(rows, at + _NOW_ROW + k, b, now)


@inline
def _kick_ramp(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + F dt,  L + (τ + (R r) × F) dt."""
    force, arm = get3(rows, at + _NOW_ROW, b), turn(R, get3(rows, at + _ARM_ROW, b))
    torque = add_scaled(1.0, cross(arm, force), get3(rows, at + _NOW_ROW + 3, b))
    return add_scaled(dt, force, p), add_scaled(dt, torque, L)


@inline
def _kick_follower_ramp(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + R F dt,  L + R τ dt."""
    force, torque = turn(R, get3(rows, at + _NOW_ROW, b)), turn(R, get3(rows, at + _NOW_ROW + 3, b))
    return add_scaled(dt, force, p), add_scaled(dt, torque, L)


@inline
def _change_ramp(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """τ + (ω × R r) × F."""
    arm = cross(motion[1], turn(R, get3(rows, at + _ARM_ROW, b)))
    return F, add_scaled(1.0, cross(arm, get3(rows, at + _NOW_ROW, b)), tau)


@inline
def add_turning(omega: Vec3, R: Matrix, force: Vec3, torque: Vec3, F: Vec3, tau: Vec3) -> Momenta:
    """F and τ with ω × R of both added, given in the body: the rates of loads that follow it."""
    dF, dtau = cross(omega, turn(R, force)), cross(omega, turn(R, torque))
    return add_scaled(1.0, dF, F), add_scaled(1.0, dtau, tau)


@inline
def _change_follower_ramp(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """F + ω × R F,  τ + ω × R τ."""
    force, torque = get3(rows, at + _NOW_ROW, b), get3(rows, at + _NOW_ROW + 3, b)
    return add_turning(motion[1], R, force, torque, F, tau)


_RAMP_KICK: Final = Kick(
    "ramp", _ROWS, _kick_ramp, is_many=True, at_time=_set_load, change=_change_ramp
)
_FOLLOWER_KICK: Final = Kick(
    "follower_ramp", _ROWS, _kick_follower_ramp, is_many=True, at_time=_set_load,
    change=_change_follower_ramp,
)  # fmt: skip


def _ramp_rates(ramp: Ramp | FollowerRamp, bodies: Bodies, state: State) -> Rates:
    """The torque that spins a body up on average, and that about which it oscillates."""
    turning = lengths(ramp.torque_change)
    if isinstance(ramp, Ramp):
        turning = turning + lengths(ramp.arm) * (lengths(ramp.force) + lengths(ramp.force_change))
    return Rates(spinning=lengths(ramp.torque), turning=turning)


RAMP_TERMS: Final = (
    Term(Ramp, "load that changes with time", _RAMP_KICK, _ramp_rates),
    Term(
        FollowerRamp, "load fixed in the body that changes with time", _FOLLOWER_KICK, _ramp_rates
    ),
)


class Course(NamedTuple):
    """A vector (3, n) that is linear in time in a segment."""

    midway: Floats
    change: Floats  # from midway to the end
    clock: Floats  # (2, n), as in Ramp

    @property
    def is_constant(self) -> bool:
        """Whether it does not change."""
        return not self.change.any()

    def turned(self, into: Any) -> "Course":
        """The same in other axes, by a linear function of (3, n)."""
        return self._replace(midway=into(self.midway), change=into(self.change))


def course_of(table: Any, numbers: Floats, start: float) -> Course:
    """The load of a [[force]] from the time `start` [s] on, its numbers made by `load_values`."""
    if table.timed is None:
        return Course(numbers[3:6], np.zeros_like(numbers[3:6]), np.zeros_like(numbers[:2]))
    times, values = table.timed.times, table.timed.values
    k = bisect_right(times, start) - 1
    before, after = values[k][:, None], values[k + 1][:, None]
    half, acts = 0.5 * (times[k + 1] - times[k]), numbers[3]
    clock = np.array([[times[k] - start + half], [1.0 / half]])
    parts = 0.5 * before + 0.5 * after, 0.5 * after - 0.5 * before, clock
    wide: Any = parts
    if acts.size > 1:
        wide = [np.broadcast_to(part, (len(part), acts.size)) for part in parts]  # views
    if acts.all():
        return Course(*wide)
    return Course(wide[0] * acts, wide[1] * acts, wide[2])  # zero on some bodies of a group


def load_values(table: Any, arm: Any = (0.0, 0.0, 0.0)) -> tuple[Any, Any]:
    """Values of a load with its arm: the vector, or 1 where knots have it."""
    return arm, getattr(table, table.load_key) if table.timed is None else 1.0


def vectors_of(table: Any, numbers: Floats) -> Floats:
    """All values of a load, (3, k): the one it has, or those of its knots."""
    return numbers[3:6] if table.timed is None else np.ascontiguousarray(table.timed.values.T)
