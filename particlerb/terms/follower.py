"""Follower loads: a force and a torque that are constant in the body frame and turn with it.

A thruster at a body point r gives the body force F and the body torque r × F; any number of them
add up to one of each. They have no potential, so their work is booked kick by kick.
"""

from typing import NamedTuple

from particlerb._jit import inline
from particlerb.maths.quaternion import Rows4, load4, to_world
from particlerb.maths.vec3 import Floats, Rows3, add_scaled, load3, rows3, store3


class Follower(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], rotor frame
    torque: Floats  # (3, n) [N m], rotor frame, about the centre of mass


@inline
def kick_follower(
    follower: Follower | None, q: Rows4, p: Rows3, L: Rows3, lo: int, hi: int, dt: float
) -> None:
    """p ← p + R F dt,  L ← L + R τ dt."""
    if follower is None:
        return
    force, torque = rows3(follower.force, lo, hi), rows3(follower.torque, lo, hi)
    for b in range(force[0].size):
        q_b = load4(q, b)
        store3(p, b, add_scaled(dt, to_world(q_b, load3(force, b)), load3(p, b)))
        store3(L, b, add_scaled(dt, to_world(q_b, load3(torque, b)), load3(L, b)))
