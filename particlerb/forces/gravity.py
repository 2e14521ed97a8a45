"""Uniform gravity: the same acceleration everywhere, through the centre of mass."""

from typing import NamedTuple

from particlerb.maths.vec3 import Floats


class UniformGravity(NamedTuple):
    """Parameters of the term for n bodies."""

    mass: Floats  # (n,) [kg]
    acceleration: Floats  # (3,) [m/s²], world frame
