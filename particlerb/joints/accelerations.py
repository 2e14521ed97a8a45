"""Second derivatives of constraints: what they are without reactions.

| row | convective part of g̈ |
|-|-|
| along, rack, screw, u in b | u·k + 2 u̇·ḋ + ü·d |
| along, u in the world | u·k |
| dot | n̈·u + 2 ṅ·u̇ + n·ü |
| distance | (ḋ·ḋ + d·k)/l |
| turn | u̇·(ω_a - ω_b) |
| gear | v·(k - ω_b × ḋ), v as in wheels.py |

k = ω_a × (ω_a × r_a) - ω_b × (ω_b × r_b), u̇ = ω × u, ü = ω × u̇; the rest as in rows.py. The turns
themselves change by J⁻¹ (τ - ω × L), positions by F/M.
"""

from typing import NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.drives import course
from particlerb.joints.records import JointData, Joints
from particlerb.joints.rows import arms_at, is_of_other_bodies, rate, rotations
from particlerb.joints.wheels import tangent
from particlerb.maths.quaternion import Matrix, turn, turn_back
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import (
    ZERO,
    Floats,
    Vec3,
    add,
    add_scaled,
    component_product,
    cross,
    dot,
    subtract,
)


class _Spin(NamedTuple):
    """How a body turns, world axes."""

    w: Vec3  # [rad/s]
    lost: Vec3  # J⁻¹ (ω × L) [rad/s²]


@inline
def _spin_of(joints: Joints, data: JointData, k: int, R: Matrix) -> _Spin:
    """How body k turns in an orientation."""
    inverse, m = row3(joints.inv_inertia, k), turn_back(R, row3(data.y, k, col.L))
    w = component_product(inverse, m)
    lost = turn(R, component_product(inverse, cross(w, m)))
    return _Spin(add(turn(R, w), row3(data.motion, k, 3)), lost)


@inline
def _velocity(joints: Joints, data: JointData, k: int) -> Vec3:
    """Velocity of body k [m/s]."""
    return add_scaled(joints.inv_mass[k], row3(data.y, k, col.P), row3(data.motion, k))


@inline
def _convective(
    joints: Joints, data: JointData, r: int, R: tuple[Matrix, Matrix], wa: Vec3, wb: Vec3
) -> float:
    """Convective part of row r, along no fixed direction of the world."""
    rows, kind = joints.rows, joints.rows.kind[r]
    ra, rb, u, d = arms_at(rows, data.y, r, R)
    ra1, rb1, u1 = cross(wa, ra), cross(wb, rb), cross(wb, u)
    if kind >= kinds.TURN:
        return dot(u1 if kind == kinds.TURN else cross(wa, u), subtract(wa, wb))
    ra2, rb2, u2 = cross(wa, ra1), cross(wb, rb1), cross(wb, u1)
    if kind == kinds.DOT:
        return dot(ra2, u) + 2.0 * dot(ra1, u1) + dot(ra, u2)
    a, b = rows.a[r], rows.b[r]
    k = subtract(ra2, rb2)
    va, vb = _velocity(joints, data, a), _velocity(joints, data, b)
    d1 = subtract(add(va, ra1), add(vb, rb1))
    if kind == kinds.GEAR:
        return dot(tangent(u, d), subtract(k, cross(wb, d1)))
    if kind in (kinds.ALONG, kinds.RACK):
        return dot(u, k) + 2.0 * dot(u1, d1) + dot(u2, d)
    convective: float = (dot(d1, d1) + dot(d, k)) / rows.length[r]
    return convective


@inline
def driven_along(joints: Joints, data: JointData, r: int) -> float:
    """The part of -g̈ of row r by its drive, and by bodies that move as prescribed."""
    rows, motion = joints.rows, data.motion
    by = subtract(row3(motion, rows.a[r], 6), row3(motion, rows.b[r], 6))
    by_drive = course(joints.drives, rows.drive[r], data.clock[0])[2]
    return by_drive - dot(row3(data.gradient, r), by)


@inline
def _centripetal(joints: Joints, r: int, R: tuple[Matrix, Matrix], wa: Vec3, wb: Vec3) -> Vec3:
    """k of row r."""
    ra = turn(R[0], row3(joints.rows.vector_a, r))
    rb = turn(R[1], row3(joints.rows.vector_b, r))
    return subtract(cross(wa, cross(wa, ra)), cross(wb, cross(wb, rb)))


@kernel
def convective_along(joints: Joints, data: JointData, r: int) -> float:
    """Convective part of ẍ of row r, a coordinate."""
    R = rotations(joints.rows, data.y, r)
    wa = _spin_of(joints, data, joints.rows.a[r], R[0]).w
    wb = _spin_of(joints, data, joints.rows.b[r], R[1]).w
    return _convective(joints, data, r, R, wa, wb)


@kernel
def accelerations(joints: Joints, data: JointData, lo: int, hi: int, load: Floats) -> None:
    """z = -g̈ of rows lo to hi under loads (n + 1, 6), force and torque, without reactions."""
    if lo == hi:
        return
    rows, gradient, k = joints.rows, data.gradient, ZERO
    R = rotations(rows, data.y, lo)
    spin_a = _spin_of(joints, data, rows.a[lo], R[0])
    spin_b = _spin_of(joints, data, rows.b[lo], R[1])
    for r in range(lo, hi):
        if r > lo and is_of_other_bodies(rows, lo, r):
            R = rotations(rows, data.y, r)
            spin_a = _spin_of(joints, data, rows.a[r], R[0])
            spin_b = _spin_of(joints, data, rows.b[r], R[1])
        if rows.kind[r] == kinds.WORLD_ALONG:
            if r == lo or not joints.beside[r]:
                k = _centripetal(joints, r, R, spin_a.w, spin_b.w)
            acceleration = dot(row3(rows.axis, r), k)
        else:
            acceleration = _convective(joints, data, r, R, spin_a.w, spin_b.w)
        acceleration += rate(joints, gradient, r, load, 0)
        acceleration -= driven_along(joints, data, r)
        acceleration -= dot(row3(gradient, r, 3), spin_a.lost)
        data.z[r] = dot(row3(gradient, r, 6), spin_b.lost) - acceleration
