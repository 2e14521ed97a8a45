"""Uniform gravity: the same acceleration everywhere, through the centre of mass."""

from typing import NamedTuple

from particlerb._jit import inline
from particlerb.maths.vec3 import Floats, Rows3, add_scaled, load3, store3


class UniformGravity(NamedTuple):
    """Parameters of the term for n bodies."""

    mass: Floats  # (n,) [kg]
    acceleration: Floats  # (3,) [m/s²], world frame


@inline
def kick_gravity(gravity: UniformGravity | None, p: Rows3, lo: int, hi: int, dt: float) -> None:
    """p ← p + M g dt."""
    if gravity is None:
        return
    mass = gravity.mass[lo:hi]
    g = (gravity.acceleration[0], gravity.acceleration[1], gravity.acceleration[2])
    for b in range(mass.size):
        store3(p, b, add_scaled(dt * mass[b], g, load3(p, b)))
