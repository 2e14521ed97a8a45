"""Forces at body points, however many constant ones: one force and one lever tensor per body.

Constant in the world, forces F_i at body points r_i give the force Σ F_i and the torque
Σ (R r_i) × F_i. With the lever tensor T = Σ r_i F_iᵀ the torque is the axial vector of R T,
τ_x = (R T)_yz - (R T)_zy, and -Σ F_i·(x + R r_i) = -F·x - tr(R T) is a potential of all of them.

Follower loads are constant in the body and turn with it: a thruster at a body point r gives the
body force F and the body torque r × F. They have no potential: kicks add their work.

A force that changes with time is a `Ramp` between two knots, each for itself.

Why it is so: docs/decisions/0003.
"""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Force, Kick, Momenta, Rates, Term, numbers_of, refuse_overflow
from particlerb.forces.ramp import (
    RAMP_TERMS,
    FollowerRamp,
    Ramp,
    add_turning,
    course_of,
    load_values,
    vectors_of,
)
from particlerb.maths.quaternion import Matrix, turn
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot, scale
from particlerb.model.block import get3
from particlerb.model.bodies import Bodies
from particlerb.model.state import in_rotor_frame, lengths, rotate_back

if TYPE_CHECKING:
    from particlerb.case.forces import ImpulseTable, PushTable


class Push(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], world frame: Σ F_i
    lever: Floats  # (9, n) [N m]: row 3 j + l is T_lj, l in the rotor frame, j in the world frame


class Follower(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], rotor frame
    torque: Floats  # (3, n) [N m], rotor frame, about the centre of mass


@inline
def _kick_force(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + F dt, with F constant in the world: pushes and gravity."""
    return add_scaled(dt, get3(rows, at, b), p), L


@inline
def _kick_lever(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """L + axial(R T) dt."""
    X, Y, Z = R
    t_x, t_y, t_z = get3(rows, at, b), get3(rows, at + 3, b), get3(rows, at + 6, b)
    torque = (dot(Y, t_z) - dot(Z, t_y), dot(Z, t_x) - dot(X, t_z), dot(X, t_y) - dot(Y, t_x))
    return p, add_scaled(dt, torque, L)


@inline
def lever_trace(rows: Floats, at: int, b: int, R: Matrix) -> float:
    """tr(R T) [J]."""
    (X, Y, Z), t_x, t_y = R, get3(rows, at, b), get3(rows, at + 3, b)
    return dot(X, t_x) + dot(Y, t_y) + dot(Z, get3(rows, at + 6, b))


@inline
def _change_lever(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """τ + R T ω - tr(R T) ω."""
    _, w = motion
    t_x, t_y, t_z = get3(rows, at, b), get3(rows, at + 3, b), get3(rows, at + 6, b)
    along = add_scaled(w[2], t_z, add_scaled(w[1], t_y, scale(w[0], t_x)))
    trace = lever_trace(rows, at, b, R)
    return F, add_scaled(-trace, w, add_scaled(1.0, turn(R, along), tau))


@inline
def _kick_follower(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + R F dt,  L + R τ dt."""
    force, torque = turn(R, get3(rows, at, b)), turn(R, get3(rows, at + 3, b))
    return add_scaled(dt, force, p), add_scaled(dt, torque, L)


@inline
def _change_follower(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """F + ω × R F,  τ + ω × R τ."""
    return add_turning(motion[1], R, get3(rows, at, b), get3(rows, at + 3, b), F, tau)


FORCE_KICK: Final = Kick(
    "force", 3, _kick_force, has_potential=True, is_steady=True, is_uniform=True
)
LEVER_KICK: Final = Kick(
    "lever", 9, _kick_lever, has_potential=True, is_steady=True, change=_change_lever
)
_FOLLOWER_KICK: Final = Kick("follower", 6, _kick_follower, change=_change_follower)


def _parts_of_push(push: Push) -> list[tuple[Kick, Floats]]:
    """Rows of the force and of the lever, as far as they are there."""
    parts = (FORCE_KICK, push.force), (LEVER_KICK, push.lever)
    return [(kick, values) for kick, values in parts if values.any()]


def lever_work(lever: Floats, q: Floats) -> Floats:
    """tr(R T), (n,) [J]: what the forces have done by turning the bodies, up to a constant.

    With the roundings of `lever_trace`.
    """
    w, x, y, z = q
    x2, y2, z2 = 2.0 * q[1:]
    t_x, t_y, t_z = lever.reshape(3, 3, -1)
    X = (1.0 - (y * y2 + z * z2)) * t_x[0] + (x * y2 - w * z2) * t_x[1] + (x * z2 + w * y2) * t_x[2]
    Y = (x * y2 + w * z2) * t_y[0] + (1.0 - (x * x2 + z * z2)) * t_y[1] + (y * z2 - w * x2) * t_y[2]
    Z = (x * z2 - w * y2) * t_z[0] + (y * z2 + w * x2) * t_z[1] + (1.0 - (x * x2 + y * y2)) * t_z[2]
    return np.asarray(X + Y + Z)


def _push_work(push: Push, com: Floats, q: Floats, t: Floats) -> Floats:
    """F·x + tr(R T), (n,) [J]: what the forces have done, up to a constant."""
    return np.asarray(lever_work(push.lever, q) + (push.force * com).sum(axis=0))


def _push_rates(push: Push, *_: object) -> Rates:
    """The torque about which a body oscillates."""
    return Rates(turning=lengths(push.lever))


def _follower_rates(follower: Follower, *_: object) -> Rates:
    """The torque that spins a body up."""
    return Rates(spinning=lengths(follower.torque))


def constant_force(force: Floats, arm: Floats) -> Push:
    """A force (3, n) [N], world frame, at points (3, n) [m], rotor frame."""
    return Push(force, (force[:, None] * arm).reshape(9, -1))  # [j, l] = F_j r_l


def _term_of(
    table: "PushTable", numbers: Floats, bodies: Bodies, start: float
) -> Push | Follower | Ramp | FollowerRamp:
    """A push in the world, or a load that follows the body; constant, or not."""
    arm, course = in_rotor_frame(bodies.rotor_frame, numbers[:3]), course_of(table, numbers, start)
    if table.frame == "world":
        if course.is_constant:
            return constant_force(course.midway, arm)
        none = np.broadcast_to(0.0, arm.shape)
        return Ramp(course.midway, none, course.change, none, course.clock, arm)
    local = course.turned(lambda vector: rotate_back(bodies.rotor_frame, vector))
    turning = local.turned(lambda vector: np.cross(arm, vector, axis=0))
    if local.is_constant:
        return Follower(local.midway, turning.midway)
    return FollowerRamp(local.midway, turning.midway, local.change, turning.change, local.clock)


def refuse_large(table: "PushTable | ImpulseTable", numbers: Floats, com: Floats) -> None:
    """Raise ForceError where the torque is beyond float64."""
    size = float(np.abs(vectors_of(table, numbers)).max())
    arm = float(np.abs(numbers[:3]).max())
    refuse_overflow(f"arm {arm!r} m and {table.type}", "at", arm, size)


FORCE: Final = Force(
    numbers_of(lambda table: load_values(table, table.at)), _term_of, has_arm=True,
    check=refuse_large,
)  # fmt: skip
TERMS: Final = (
    Term(
        Push, "push", FORCE_KICK, _push_rates, _push_work, split=_parts_of_push, more=(LEVER_KICK,)
    ),
    Term(Follower, "load fixed in the body", _FOLLOWER_KICK, _follower_rates),
    *RAMP_TERMS,
)
