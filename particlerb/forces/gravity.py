"""Uniform gravity: the same acceleration everywhere, through the centre of mass."""

from typing import NamedTuple

from particlerb.forces.kinds import Kick
from particlerb.forces.push import FORCE_KICK
from particlerb.maths.vec3 import Floats


class UniformGravity(NamedTuple):
    """Parameters of the term for n bodies."""

    mass: Floats  # (n,) [kg]
    acceleration: Floats  # (3,) [m/s²], world frame


def parts_of_gravity(gravity: UniformGravity) -> list[tuple[Kick, Floats]]:
    """A force that is constant in the world."""
    return [(FORCE_KICK, gravity.mass * gravity.acceleration[:, None])]
