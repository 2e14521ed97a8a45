"""Constant world torques: free couples. No potential in general; the work is booked by kicks."""

from typing import NamedTuple

from particlerb._jit import inline
from particlerb.maths.vec3 import Floats, Rows3, add_scaled, load3, rows3, store3


class Torque(NamedTuple):
    """Parameters of the term for n bodies."""

    torque: Floats  # (3, n) [N m], world frame, the sum for each body


@inline
def kick_torque(torque: Torque | None, L: Rows3, lo: int, hi: int, dt: float) -> None:
    """L ← L + τ dt."""
    if torque is None:
        return
    tau = rows3(torque.torque, lo, hi)
    for b in range(tau[0].size):
        store3(L, b, add_scaled(dt, load3(tau, b), load3(L, b)))
