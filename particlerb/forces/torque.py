"""Constant world torques: free couples. No potential in general; the work is booked by kicks."""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Floats, Vec3, add_scaled
from particlerb.model.block import get3

TORQUE_ROWS: Final = 3


class Torque(NamedTuple):
    """Parameters of the term for n bodies."""

    torque: Floats  # (3, n) [N m], world frame, the sum for each body


@inline
def kick_torque(torque: int | None, rows: Floats, at: int, b: int, dt: float, L: Vec3) -> Vec3:
    """L + τ dt."""
    if torque is None:
        return L
    return add_scaled(dt, get3(rows, at, b), L)
