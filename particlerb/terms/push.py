"""Constant world forces at body points, however many: one force and one lever tensor per body.

Forces F_i at body points r_i give the force Σ F_i and the torque Σ (R r_i) × F_i. With the lever
tensor T = Σ r_i F_iᵀ the torque is the axial vector of R T, τ_x = (R T)_yz - (R T)_zy, and
-Σ F_i·(x + R r_i) = -F·x - tr(R T) is a potential of all of them.
"""

from typing import NamedTuple

import numpy as np

from particlerb._jit import inline
from particlerb.maths.quaternion import Rows4, load4, matrix
from particlerb.maths.vec3 import Floats, Rows3, add_scaled, dot, load3, rows3, store3


class Push(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], world frame: Σ F_i
    lever: Floats  # (9, n) [N m]: row 3 j + l is T_lj, l in the rotor frame, j in the world frame


@inline
def kick_push(push: Push | None, q: Rows4, p: Rows3, L: Rows3, lo: int, hi: int, dt: float) -> None:
    """p ← p + Σ F_i dt,  L ← L + axial(R T) dt."""
    if push is None:
        return
    force = rows3(push.force, lo, hi)
    tx = rows3(push.lever[0:3], lo, hi)
    ty = rows3(push.lever[3:6], lo, hi)
    tz = rows3(push.lever[6:9], lo, hi)
    for b in range(force[0].size):
        store3(p, b, add_scaled(dt, load3(force, b), load3(p, b)))
        x, y, z = matrix(load4(q, b))
        t_x, t_y, t_z = load3(tx, b), load3(ty, b), load3(tz, b)
        torque = (
            dot(y, t_z) - dot(z, t_y),
            dot(z, t_x) - dot(x, t_z),
            dot(x, t_y) - dot(y, t_x),
        )
        store3(L, b, add_scaled(dt, torque, load3(L, b)))


def lever_work(lever: Floats, q: Floats) -> Floats:
    """tr(R T), (n,) [J]: what the forces have done by turning the bodies, up to a constant."""
    w, x, y, z = q
    t = lever.reshape(3, 3, -1)
    trace: Floats = (
        (1 - 2 * (y * y + z * z)) * t[0, 0]
        + (1 - 2 * (x * x + z * z)) * t[1, 1]
        + (1 - 2 * (x * x + y * y)) * t[2, 2]
        + 2 * (x * y - w * z) * t[0, 1]
        + 2 * (x * z + w * y) * t[0, 2]
        + 2 * (x * y + w * z) * t[1, 0]
        + 2 * (y * z - w * x) * t[1, 2]
        + 2 * (x * z - w * y) * t[2, 0]
        + 2 * (y * z + w * x) * t[2, 1]
    )
    return np.asarray(trace)
