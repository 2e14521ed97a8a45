"""Impulses: a jump of the momenta of some bodies at one instant, P += J and L += r × J."""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.forces.kinds import Force, numbers_of
from particlerb.forces.push import refuse_large
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, in_rotor_frame, omega_world, rotate, rotate_back

if TYPE_CHECKING:
    from particlerb.case.forces import ImpulseTable


class Impulse(NamedTuple):
    """One impulse on each of n bodies."""

    at: Floats  # (3, n) [m], rotor frame, from the centre of mass
    impulse: Floats  # (3, n) [N s], world frame, or rotor frame where `follows`
    follows: bool  # whether the direction is given in the body


def apply_impulse(impulse: Impulse, bodies: Bodies, state: State) -> tuple[State, Floats]:
    """State after the jump, and the external work of each body, (7, n).

    That is work, impulse and angular impulse about the origin.
    The work is ½(v⁻ + v⁺)·J + ½(ω⁻ + ω⁺)·(r × J), exactly the change of kinetic energy.
    """
    at, J, follows = impulse
    if follows:
        J = rotate(state.q, J)
    turn = np.cross(rotate(state.q, at), J, axis=0)
    after = state._replace(p=state.p + J, L=state.L + turn)
    velocity = 0.5 * bodies.inv_mass * (state.p + after.p)
    omega = 0.5 * (omega_world(bodies, state) + omega_world(bodies, after))
    work = (velocity * J + omega * turn).sum(axis=0)
    about_origin = turn + np.cross(state.com, J, axis=0)
    return after, np.vstack([work, J, about_origin])


def _impulse_of(table: "ImpulseTable", numbers: Floats, bodies: Bodies) -> Impulse:
    """The impulse of a [[force]] on n bodies."""
    arm, J = in_rotor_frame(bodies.rotor_frame, numbers[:3]), numbers[3:6]
    follows = table.frame == "body"
    J = rotate_back(bodies.rotor_frame, J) if follows else J
    return Impulse(arm, np.ascontiguousarray(J), follows)


FORCE: Final = Force(
    numbers_of(lambda table: (table.at, table.impulse)), jump=_impulse_of, has_arm=True,
    check=refuse_large,
)  # fmt: skip
