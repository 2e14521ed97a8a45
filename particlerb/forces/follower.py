"""Follower loads: a force and a torque that are constant in the body frame and turn with it.

A thruster at a body point r gives the body force F and the body torque r × F; any number of them
add up to one of each. They have no potential, so their work is booked kick by kick.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Rows, turn
from particlerb.maths.vec3 import Floats, Vec3, add_scaled
from particlerb.model.block import get3

FOLLOWER_ROWS: Final = 6


class Follower(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], rotor frame
    torque: Floats  # (3, n) [N m], rotor frame, about the centre of mass


@inline
def kick_follower(
    follower: int | None, rows: Floats, at: int, b: int, R: Rows, dt: float, p: Vec3, L: Vec3
) -> tuple[Vec3, Vec3]:
    """p + R F dt,  L + R τ dt."""
    if follower is None:
        return p, L
    force, torque = turn(R, get3(rows, at, b)), turn(R, get3(rows, at + 3, b))
    return add_scaled(dt, force, p), add_scaled(dt, torque, L)
