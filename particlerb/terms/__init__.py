"""The forces that can act on bodies, one per file, and `Terms`, which gathers them for a kernel.

A term that does not act is None: None is a type, so Numba leaves its code out while compiling.
"""

from typing import NamedTuple

from particlerb._jit import inline
from particlerb.maths.quaternion import Rows4
from particlerb.maths.vec3 import Rows3
from particlerb.terms.follower import Follower, kick_follower
from particlerb.terms.gravity import UniformGravity, kick_gravity
from particlerb.terms.push import Push, kick_push
from particlerb.terms.torque import Torque, kick_torque


class Terms(NamedTuple):
    """What acts on a group of bodies during one segment of time."""

    gravity: UniformGravity | None = None
    push: Push | None = None
    follower: Follower | None = None
    torque: Torque | None = None


@inline
def kick(terms: Terms, q: Rows4, p: Rows3, L: Rows3, lo: int, hi: int, dt: float) -> None:
    """Momenta of bodies lo..hi over dt at a fixed pose: each term adds its own."""
    gravity, push, follower, torque = terms
    kick_gravity(gravity, p, lo, hi, dt)
    kick_push(push, q, p, L, lo, hi, dt)
    kick_follower(follower, q, p, L, lo, hi, dt)
    kick_torque(torque, L, lo, hi, dt)
