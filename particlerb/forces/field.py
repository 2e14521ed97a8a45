"""A uniform field that acts on charges and on a dipole of the body: F = Σ q E, τ = (Σ q r + d) × E.

A moment of charges turns a body by m × E, as an arm r does by r × F: so a steady field is a push.
One that turns with the angular velocity Ω has E(t) = E∥ + E⊥ cos |Ω|t + (Ω/|Ω|) × E sin |Ω|t and
the potential U = -q E·x - (R m)·E; bodies gain ∂U/∂t = -(q x + R m)·(Ω × E) beside its loss.
"""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import (
    Force,
    ForceError,
    Kick,
    Momenta,
    Rates,
    Resolved,
    Term,
    by_its_arm,
    in_columns,
    refuse_overflow,
)
from particlerb.forces.push import Push
from particlerb.maths.quaternion import Matrix, turn
from particlerb.maths.trig import cos_sin_half_turns
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross, dot, scale
from particlerb.model.block import get, get3, put3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, in_rotor_frame, lengths, rotate

if TYPE_CHECKING:
    from particlerb.case.forces import UniformField
    from particlerb.model.system import System

_MOMENT_ROUNDING: Final = 1e-14  # share of a moment of charges that is its rounding


class RotatingField(NamedTuple):
    """Parameters of the term for n bodies."""

    along: Floats  # (3, n) part of E along Ω, world frame
    across: Floats  # (3, n) the other part, when the segment begins
    ahead: Floats  # (3, n) where that will be a quarter of a turn later
    rate: Floats  # (n,) |Ω| [rad/s]
    moment: Floats  # (3, n) of charges and dipole, rotor frame
    charge: Floats  # (n,)


_FIELD_ROW: Final = 14  # first row after the parameters: E now, and its rate of change
_RATE_ROW: Final = 17


@inline
def _turn_field(rows: Floats, at: int, b: int, t: float) -> None:
    """Set E and Ω × E to the time t."""
    rate = get(rows, at + 9, b)
    cos, sin, sign = cos_sin_half_turns(rate * t)
    across, ahead = scale(sign, get3(rows, at + 3, b)), scale(sign, get3(rows, at + 6, b))
    now = add_scaled(sin, ahead, add_scaled(cos, across, get3(rows, at, b)))
    put3(rows, at + _FIELD_ROW, b, now)
    put3(rows, at + _RATE_ROW, b, scale(rate, add_scaled(cos, ahead, scale(-sin, across))))


@inline
def _kick_field(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + q E dt,  L + (R m) × E dt."""
    E, moment = get3(rows, at + _FIELD_ROW, b), turn(R, get3(rows, at + 10, b))
    return add_scaled(dt * get(rows, at + 13, b), E, p), add_scaled(dt, cross(moment, E), L)


@inline
def _field_power(rows: Floats, at: int, b: int, x: Vec3, R: Matrix, power: float) -> float:
    """∂U/∂t = -(q x + R m)·(Ω × E)."""
    moment = turn(R, get3(rows, at + 10, b))
    return power - dot(add_scaled(get(rows, at + 13, b), x, moment), get3(rows, at + _RATE_ROW, b))


KICK: Final = Kick(
    "rotating_field", 20, _kick_field, has_potential=True, is_many=True, at_time=_turn_field,
    power=_field_power,
)  # fmt: skip


def _field_work(field: RotatingField, com: Floats, q: Floats, t: Floats) -> Floats:
    """-U, (n,) [J], at times t (n,) [s]."""
    angle = field.rate * t
    E = field.along + np.cos(angle) * field.across + np.sin(angle) * field.ahead
    return np.asarray(((field.charge * com + rotate(q, field.moment)) * E).sum(axis=0))


def _field_rates(field: RotatingField, bodies: Bodies, state: State) -> Rates:
    """The torque about which a body oscillates, and the turn of the field."""
    strength = np.hypot(lengths(field.along), lengths(field.across))
    return Rates(turning=lengths(field.moment) * strength, rate=field.rate)


@np.errstate(over="ignore")  # `_refuse_large` finds what is
def resolve(table: "UniformField", members: Ints, system: "System") -> Resolved:
    """Moment of charges, field and total charge; for each kind where particles have charges.

    The charges q_i at r_i and a dipole d turn the body like Σ q_i r_i + d, by whatever it is more
    than the rounding of this sum: charges in proportion to the masses have none.
    """
    if not table.needs_particles:
        q = in_columns(table.charge)
        moment = q * in_columns(table.at) + in_columns(table.dipole)
        return [(members, in_columns(moment.T, table.field, q[0], table.angular_velocity))]
    charges, kinds = np.atleast_2d(table.charge), system.kind[members]
    _refuse_count(charges.shape[1], members, system)
    resolved: Resolved = []
    for kind in np.unique(kinds).tolist():
        rows = slice(system.particles.offset[kind], system.particles.offset[kind + 1])
        r = system.particles.position[rows]  # with the rounding of places in the axes of the shape
        size = lengths(r.T) + lengths(system.properties.com[kind])
        of_kind = table.of_bodies(kinds == kind)
        own = charges if isinstance(table.charge, tuple) else charges[kinds == kind]
        moment = np.array([q @ r for q in own])
        moment[lengths(moment.T) <= _MOMENT_ROUNDING * (np.abs(own) @ size)] = 0.0
        moment = (moment.T + in_columns(of_kind.dipole)).T
        numbers = in_columns(moment, table.field, own.sum(axis=1), table.angular_velocity)
        resolved.append((members[kinds == kind], numbers))
    return resolved


def _refuse_count(charges: int, members: Ints, system: "System") -> None:
    """Raise ForceError where there is not a charge for each particle."""
    count = np.diff(system.particles.offset)[system.kind[members]]
    if (count == charges).all():
        return
    b = int(np.argmax(count != charges))
    reason = f"{{name}} has {count[b]} particles, the list {charges} charges"
    hint = "give one for each in its order (`particlerb mass` counts them), or one number"
    raise ForceError("charge", reason, hint, b)


def _term_of(
    table: "UniformField", numbers: Floats, bodies: Bodies, start: float
) -> Push | RotatingField:
    """The force on the charge, and the moment as the lever of the field; or a field that turns."""
    moment = in_rotor_frame(bodies.rotor_frame, numbers[:3])
    E, charge = numbers[3:6], numbers[6]
    rate = lengths(numbers[7:10])
    if not rate.any():
        return Push(charge * E, (E[:, None] * moment).reshape(9, -1))
    axis = numbers[7:10] / np.where(rate > 0.0, rate, 1.0)
    along = axis * (axis * E).sum(axis=0)
    across, ahead = E - along, np.cross(axis, E, axis=0)
    cos, sin = np.cos(rate * start), np.sin(rate * start)
    return RotatingField(
        along, cos * across + sin * ahead, cos * ahead - sin * across, rate, moment, charge
    )


def _refuse_large(table: "UniformField", numbers: Floats, com: Floats) -> None:
    """Raise ForceError where the force or the torque is beyond float64."""
    moment, size = float(np.abs(numbers[:3]).max()), float(np.abs(numbers[3:6]).max())
    charge = float(np.abs(numbers[6]).max())
    what = f"charge {charge!r} with moment {moment!r} and {table.type}"
    refuse_overflow(what, "field", max(moment, charge), size, "load")


def turning(table: "UniformField", is_point: bool) -> tuple[str, str]:
    """Key and hint where it turns a point, or a rod about its axis."""
    if np.any(table.dipole):
        return "dipole", "leave it out" if is_point else "give a dipole along the rod's axis"
    if table.needs_particles:
        return "charge", "give one number, the charge of the body"
    return by_its_arm(table, is_point)


FORCE: Final = Force(resolve, _term_of, has_arm=True, check=_refuse_large, turning=turning)
TERMS: Final = (Term(RotatingField, "rotating field", KICK, _field_rates, _field_work),)
