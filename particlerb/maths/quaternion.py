"""Unit quaternions as tuples (w, x, y, z), scalar first, that turn body vectors into world vectors.

v_world = q v_body q⁻¹; a product a b turns by b first, then by a. q and -q are the same rotation.
"""

import math
from typing import TypeAlias

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, component_product, cross, dot

Quat: TypeAlias = tuple[float, float, float, float]
Rows4: TypeAlias = tuple[Floats, Floats, Floats, Floats]
Matrix: TypeAlias = tuple[Vec3, Vec3, Vec3]  # of a rotation matrix


@inline
def multiply(a: Quat, b: Quat) -> Quat:
    """Hamilton product a b."""
    return (
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


@inline
def times_vector(q: Quat, v: Vec3) -> Quat:
    """q (0, v)."""
    w, x, y, z = q
    return (
        -x * v[0] - y * v[1] - z * v[2],
        w * v[0] + y * v[2] - z * v[1],
        w * v[1] - x * v[2] + z * v[0],
        w * v[2] + x * v[1] - y * v[0],
    )


@inline
def add_scaled4(a: float, x: Quat, y: Quat) -> Quat:
    """y + a x."""
    return y[0] + a * x[0], y[1] + a * x[1], y[2] + a * x[2], y[3] + a * x[3]


@inline
def length(q: Quat) -> float:
    """|q|."""
    return math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])


@inline
def normalised(q: Quat) -> Quat:
    """q/|q|."""
    f: float = 1.0 / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return f * q[0], f * q[1], f * q[2], f * q[3]


@inline
def conjugate(q: Quat) -> Quat:
    """Inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


@inline
def to_world(q: Quat, v: Vec3) -> Vec3:
    """R v = v + w t + u × t with u = (x, y, z), t = 2 u × v."""
    u = (q[1], q[2], q[3])
    t = cross(u, v)
    t = (t[0] + t[0], t[1] + t[1], t[2] + t[2])
    return add_scaled(1.0, cross(u, t), add_scaled(q[0], t, v))


@inline
def to_body(q: Quat, v: Vec3) -> Vec3:
    """Rᵀ v."""
    return to_world((q[0], -q[1], -q[2], -q[3]), v)


@inline
def matrix(q: Quat) -> Matrix:
    """Rows of the rotation matrix R of a unit quaternion; cheaper than `to_world` from three on."""
    return _scaled_matrix(q, 2.0)


@inline
def matrix_along(q: Quat) -> Matrix:
    """Rows of the rotation matrix of q/|q|, for any q but 0."""
    return _scaled_matrix(q, 2.0 / (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]))


@inline
def _scaled_matrix(q: Quat, double: float) -> Matrix:
    """Rows of the rotation matrix of q/|q|, with double = 2/|q|²."""
    w, x, y, z = q
    x2, y2, z2 = double * x, double * y, double * z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz = x * y2, x * z2, y * z2
    wx, wy, wz = w * x2, w * y2, w * z2
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


@inline
def turn(R: Matrix, v: Vec3) -> Vec3:
    """R v."""
    return dot(R[0], v), dot(R[1], v), dot(R[2], v)


@inline
def turn_back(R: Matrix, v: Vec3) -> Vec3:
    """Rᵀ v."""
    x, y, z = R
    return (
        x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
        x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
        x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
    )


@inline
def tensor(R: Matrix, a: Vec3) -> Matrix:
    """R diag(a) Rᵀ."""
    x, y, z = component_product(a, R[0]), component_product(a, R[1]), component_product(a, R[2])
    xy, xz, yz = dot(x, R[1]), dot(x, R[2]), dot(y, R[2])
    return (dot(x, R[0]), xy, xz), (xy, dot(y, R[1]), yz), (xz, yz, dot(z, R[2]))
