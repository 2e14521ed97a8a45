"""Constant world forces at body points, however many: one force and one lever tensor per body.

Forces F_i at body points r_i give the force Σ F_i and the torque Σ (R r_i) × F_i. With the lever
tensor T = Σ r_i F_iᵀ the torque is the axial vector of R T, τ_x = (R T)_yz - (R T)_zy, and
-Σ F_i·(x + R r_i) = -F·x - tr(R T) is a potential of all of them.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Rows
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot
from particlerb.model.block import get3

LEVER_ROWS: Final = 9


class Push(NamedTuple):
    """Parameters of the term for n bodies."""

    force: Floats  # (3, n) [N], world frame: Σ F_i
    lever: Floats  # (9, n) [N m]: row 3 j + l is T_lj, l in the rotor frame, j in the world frame


@inline
def kick_force(force: int | None, rows: Floats, at: int, b: int, dt: float, p: Vec3) -> Vec3:
    """p + F dt, with F constant in the world: pushes and gravity."""
    if force is None:
        return p
    return add_scaled(dt, get3(rows, at, b), p)


@inline
def kick_lever(
    lever: int | None, rows: Floats, at: int, b: int, R: Rows, dt: float, L: Vec3
) -> Vec3:
    """L + axial(R T) dt."""
    if lever is None:
        return L
    x, y, z = R
    t_x, t_y, t_z = get3(rows, at, b), get3(rows, at + 3, b), get3(rows, at + 6, b)
    torque = (
        dot(y, t_z) - dot(z, t_y),
        dot(z, t_x) - dot(x, t_z),
        dot(x, t_y) - dot(y, t_x),
    )
    return add_scaled(dt, torque, L)


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
