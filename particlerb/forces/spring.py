"""Springs from a point of the body to an anchor that is fixed in the world.

With d from the body point to the anchor and l = |d|: F = k (l - l₀) d/l at the point, and the
potential k (l - l₀)²/2. A spring of no length has no direction and gives no force.
"""

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Force, Kick, Momenta, Rates, Resolved, Term, in_columns
from particlerb.maths.quaternion import Matrix, turn
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross, dot, scale, subtract
from particlerb.model.block import get, get3
from particlerb.model.bodies import Bodies
from particlerb.model.state import (
    State,
    body_orientation,
    lengths,
    over_columns,
    rotate,
    rotate_back,
)

if TYPE_CHECKING:
    from particlerb.case.forces import SpringTable
    from particlerb.model.system import System

_LENGTH_FLOOR_SQUARED: Final = 1e-300  # [m²] keeps 1/l finite where the spring has no length


class Spring(NamedTuple):
    """Parameters of one spring on each of n bodies."""

    at: Floats  # (3, n) [m], rotor frame, from the centre of mass
    anchor: Floats  # (3, n) [m], world frame
    stiffness: Floats  # (n,) [N/m]
    rest_length: Floats  # (n,) [m]


@inline
def _kick_spring(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + F dt,  L + (R r) × F dt."""
    arm = turn(R, get3(rows, at, b))
    d = subtract(subtract(get3(rows, at + 3, b), x), arm)
    stiffness, rest = get(rows, at + 6, b), get(rows, at + 7, b)
    force = scale(stiffness * (1.0 - rest / np.sqrt(dot(d, d) + _LENGTH_FLOOR_SQUARED)), d)
    return add_scaled(dt, force, p), add_scaled(dt, cross(arm, force), L)


@inline
def change_along(stiffness: float, rest: float, d: Vec3, rate: Vec3) -> tuple[Vec3, Vec3]:
    """Force of a spring along d, and its rate of change where d changes at a rate [m/s]."""
    squared = dot(d, d) + _LENGTH_FLOOR_SQUARED
    share = rest / np.sqrt(squared)
    bent = add_scaled(share * dot(d, rate) / squared, d, scale(1.0 - share, rate))
    return scale(stiffness * (1.0 - share), d), scale(stiffness, bent)


@inline
def _change_spring(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """F + Ḟ,  τ + (ω × R r) × F + (R r) × Ḟ."""
    arm, (v, w) = turn(R, get3(rows, at, b)), motion
    moved = cross(w, arm)
    d = subtract(subtract(get3(rows, at + 3, b), x), arm)
    rate = scale(-1.0, add_scaled(1.0, v, moved))
    force, change = change_along(get(rows, at + 6, b), get(rows, at + 7, b), d, rate)
    turned = add_scaled(1.0, cross(moved, force), cross(arm, change))
    return add_scaled(1.0, change, F), add_scaled(1.0, turned, tau)


KICK: Final = Kick(
    "spring", 8, _kick_spring, has_potential=True, is_many=True, change=_change_spring
)


def _spring_energy(spring: Spring, com: Floats, q: Floats) -> Floats:
    """k (l - l₀)²/2, (n,) [J]."""
    d = spring.anchor - com - rotate(q, spring.at)
    stretch = np.linalg.norm(d, axis=0) - spring.rest_length
    return 0.5 * spring.stiffness * stretch * stretch


def _spring_rates(spring: Spring, bodies: Bodies, state: State) -> Rates:
    """k (1/M + r²/I) with the smallest moment."""
    softness = bodies.inv_mass + lengths(spring.at) ** 2 * bodies.inv_inertia.max(axis=0)
    return Rates(squared=spring.stiffness * softness)


def resolve(table: "SpringTable", members: Ints, system: "System") -> Resolved:
    """Point, anchor, stiffness and rest length; of each body where it is that of t = 0."""
    length: Any = table.rest_length
    if length == "initial":
        length = lengths(places(system, members, table.at) - np.array(table.anchor)[:, None])
    return [(members, in_columns(table.at, table.anchor or (), table.stiffness, length))]


def places(system: "System", bodies: Ints, at: Floats | tuple[float, float, float]) -> Floats:
    """Places of points of bodies at t = 0, (3, n) [m], world frame.

    Parameters
    ----------
    system : System
        Gives the state at t = 0.
    bodies : ndarray, shape (n,)
        Of the system.
    at : tuple of 3 floats, or ndarray of shape (3, n) [m]
        Body frame, from the centre of mass; one point for all, or one for each.
    """
    points = np.array(at, dtype=np.float64)
    points = np.tile(points[:, None], bodies.size) if points.ndim == 1 else points

    def placed(of: Ints, points: Floats) -> Floats:
        q = body_orientation(system.state.q[:, of], system.bodies.rotor_frame[:, of])
        return system.state.com[:, of] + rotate(q, points)

    return over_columns(placed, bodies, points)


def _term_of(table: "SpringTable", numbers: Floats, bodies: Bodies, start: float) -> Spring:
    """One spring on each body."""
    arm = rotate_back(bodies.rotor_frame, numbers[:3])
    return Spring(arm, numbers[3:6], numbers[6], numbers[7])


FORCE: Final = Force(resolve, _term_of, has_arm=True)
TERMS: Final = (Term(Spring, "spring", KICK, _spring_rates, energy=_spring_energy),)
