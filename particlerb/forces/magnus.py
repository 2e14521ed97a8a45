"""Magnus lift of a spinning body: F = c ω × v, across the spin and the way; no torque.

It does no work. For an ideal flow about a sphere c is half the mass of the fluid in its place
(Rubinow and Keller, J. Fluid Mech. 11, 447 (1961), have c = π a³ ρ at small Reynolds numbers). At
a fixed pose L and so ω stay, and p turns about ω at the rate c |ω|/M: that is the flow of it
alone, of which splittings make one half before and one half after the other kicks.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.drag import angular_velocity
from particlerb.forces.kinds import Force, Kick, Momenta, Rates, Term, numbers_of
from particlerb.maths.quaternion import Matrix, to_world
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, cross, scale
from particlerb.model.block import get
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, lengths, omega_world
from particlerb.rotors.symmetric_split import turn_by


class Magnus(NamedTuple):
    """Parameters of the term for n bodies."""

    share: Floats  # (n,), c/M


@inline
def _magnus_load(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, p: Vec3, L: Vec3, F: Vec3, tau: Vec3
) -> Momenta:
    """F + c ω × v."""
    return add_scaled(get(rows, at, b), cross(angular_velocity(rows, b, R, L), p), F), tau


@inline
def _magnus_flow(rows: Floats, at: int, b: int, R: Matrix, dt: float, p: Vec3, L: Vec3) -> Momenta:
    """p turned about ω by c |ω| dt/M; up to a whole turn."""
    half = scale(0.5 * dt * get(rows, at, b), angular_velocity(rows, b, R, L))
    return to_world(turn_by(half, (1.0, 0.0, 0.0, 0.0)), p), L


KICK: Final = Kick("magnus", 1, load=_magnus_load, flow=_magnus_flow)


def _magnus_rates(magnus: Magnus, bodies: Bodies, state: State) -> Rates:
    """The rate at which the way turns."""
    return Rates(rate=np.abs(magnus.share) * lengths(omega_world(bodies, state)))


FORCE: Final = Force(
    numbers_of(lambda table: (table.coefficient,)),
    lambda _, numbers, bodies, start: Magnus(numbers[0] * bodies.inv_mass),
)
TERMS: Final = (Term(Magnus, "Magnus lift", KICK, _magnus_rates),)
