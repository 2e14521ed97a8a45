"""Rows of constraints at a pose: residuals, gradients, rates, and impulses along the gradients.

| row | g | ∂g/∂x_a | ∂g/∂θ_a | ∂g/∂θ_b |
|-|-|-|-|-|
| along, u in b | u·d | u | r_a × u | u × (r_b + d) |
| along, u in the world | u·d | u | r_a × u | u × r_b |
| dot | n·u | 0 | n × u | -n × u |
| distance | (d·d - l²)/(2 l) | d/l | r_a × d/l | d/l × r_b |
| rack, screw, gear | see wheels.py | | | |
| turn, n across u | angle of n from r_b | 0 | u | -u |
| rotation, nothing but springs | u·φ | 0 | u | -u |

d = x_a + r_a - x_b - r_b, ∂g/∂x_b = -∂g/∂x_a, θ the turn in world axes; φ the rotation vector of a
against b: the potential k φ²/2 has the torque -k φ. J = R I Rᵀ. Of a row with a drive g has -c(t)
more.
See docs/joints.md.
"""

from math import atan2, copysign, inf, pi
from typing import Final, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline, kernel, unfused_kernel, unsigned
from particlerb.compiled.lanes import any_of, choose, lane, opposite
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.drives import course
from particlerb.joints.records import ConstraintRows, Drives, JointData, Joints
from particlerb.joints.wheels import rolled, tangent, with_turns
from particlerb.maths.quaternion import (
    Matrix,
    Quat,
    conjugate,
    matrix,
    multiply,
    tensor,
    to_body,
    to_world,
    turn,
)
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add,
    add_scaled,
    component_product,
    cross,
    dot,
    norm,
    scale,
    subtract,
)

_WHOLE_TURN: Final = 2.0 * pi
_FAR_TURNED: Final = 1e-4  # times far over size: rounding of places there turns bodies to and fro
Three: TypeAlias = tuple[Vec3, Vec3, Vec3]


@inline
def orientation(y: Floats, k: int) -> Quat:
    """Orientation of body k."""
    row = unsigned(k)
    return y[row, col.Q], y[row, col.Q + 1], y[row, col.Q + 2], y[row, col.Q + 3]


@inline
def put_pose(y: Floats, k: int, x: Vec3, q: Quat) -> None:
    """Write where body k is."""
    put_row3(y, k, x, col.X)
    y[k, col.Q], y[k, col.Q + 1], y[k, col.Q + 2], y[k, col.Q + 3] = q


@inline
def by_inverse_inertia(inv_inertia: Floats, q: Quat, k: int, v: Vec3) -> Vec3:
    """J⁻¹ v in world axes, of body k with the orientation q."""
    return to_world(q, component_product(row3(inv_inertia, k), to_body(q, v)))


@inline
def arms(rows: ConstraintRows, y: Floats, r: int) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """r_a (or n), r_b, u and d of row r, in world axes."""
    return arms_at(rows, y, r, rotations(rows, y, r))


@inline
def rotations(rows: ConstraintRows, y: Floats, r: int) -> tuple[Matrix, Matrix]:
    """Rotation matrices of the bodies of row r."""
    return matrix(orientation(y, rows.a[r])), matrix(orientation(y, rows.b[r]))


@inline
def arms_at(
    rows: ConstraintRows, y: Floats, r: int, R: tuple[Matrix, Matrix]
) -> tuple[Vec3, Vec3, Vec3, Vec3]:
    """Do the work of `arms`, with the rotation matrices of both bodies."""
    ra, rb = turn(R[0], row3(rows.vector_a, r)), turn(R[1], row3(rows.vector_b, r))
    u, kind = row3(rows.axis, r), rows.kind[r]
    if kind not in (kinds.WORLD_ALONG, kinds.ROTATION):
        u = turn(R[0] if kind == kinds.OWN_TURN else R[1], u)
    between = subtract(row3(y, rows.a[r], col.X), row3(y, rows.b[r], col.X))
    return ra, rb, u, subtract(between, subtract(rb, ra))


@inline
def is_of_directions(kind: int) -> bool:
    """Whether no points are in a row of a kind."""
    return kind == kinds.DOT or kind >= kinds.TURN


@inline
def _rotation(rows: ConstraintRows, y: Floats, r: int) -> Vec3:
    """Rotation vector of the bodies of row r against each other, world axes, at most π long."""
    x, z = row3(rows.vector_a, r), row3(rows.vector_b, r)
    turned = multiply(orientation(y, rows.a[r]), (z[0], x[0], x[1], x[2]))
    q = multiply(turned, conjugate(orientation(y, rows.b[r])))
    v = q[1], q[2], q[3]
    s = norm(v)
    turns = s > 0.0
    f = choose(turns, 2.0 * atan2(s, abs(q[0])) / choose(turns, s, 1.0), 2.0)
    return scale(copysign(f, q[0]), v)


@inline
def coordinate(rows: ConstraintRows, y: Floats, r: int) -> float:
    """Coordinate of row r [m or rad]; angles between -π and π."""
    ra, rb, u, d = arms(rows, y, r)
    kind = rows.kind[r]
    if kind == kinds.ROTATION:
        along: float = dot(u, _rotation(rows, y, r))
        return along
    if kind >= kinds.TURN:
        return atan2(dot(ra, cross(u, rb)), dot(ra, rb))
    return norm(d) if kind == kinds.STRETCH else dot(u, d)


@inline
def shorter(kind: int, away: float) -> float:
    """A difference of coordinates; of angles the shorter way."""
    return away - _WHOLE_TURN * np.floor(away / _WHOLE_TURN + 0.5) if kind >= kinds.TURN else away


@inline
def residual(rows: ConstraintRows, drives: Drives, y: Floats, r: int, t: float) -> float:
    """g of row r at a time."""
    kind = rows.kind[r]
    if kind >= kinds.TURN:
        target = course(drives, rows.drive[r], t)[0]
        return shorter(kind, coordinate(rows, y, r) - target)
    ra, _, u, d = arms(rows, y, r)
    if kind == kinds.DOT:
        return dot(ra, u)
    if kind == kinds.DISTANCE:
        length = rows.length[r]
        stretch: float = 0.5 * (dot(d, d) / length - length)
        return stretch
    along: float = dot(u, d) - course(drives, rows.drive[r], t)[0]
    return along


@inline
def is_of_other_bodies(rows: ConstraintRows, lo: int, r: int) -> bool:
    """Whether row r ties other bodies than the one before, or is the first from lo on."""
    return r == lo or rows.a[r] != rows.a[r - 1] or rows.b[r] != rows.b[r - 1]


@unfused_kernel
def residuals(joints: Joints, data: JointData, lo: int, hi: int, t: float) -> tuple[float, int]:
    """g of rows lo to hi at t; the largest over its size and what rounding leaves, and its row.

    Rows that are no number are the largest, the last of them before all.
    """
    rows, y, g = joints.rows, data.y, data.g
    worst, where, d = 0.0, lo, (0.0, 0.0, 0.0)
    if lo == hi:
        return worst, where
    R, far, turned = rotations(rows, y, lo), 0.0, 1.0
    for r in range(lo, hi):
        kind = rows.kind[r]
        if is_of_other_bodies(rows, lo, r):
            x, R = row3(y, rows.a[r], col.X), rotations(rows, y, r)
            far = abs(x[0]) + abs(x[1]) + abs(x[2])
            turned = max(1.0, _FAR_TURNED * far / rows.size[r])
        if lane(data.compliance[r], 0) != 0.0:  # as in all lanes
            g[r] = 0.0
        elif kind == kinds.WORLD_ALONG:
            if r == lo or not joints.beside[r] or lane(data.compliance[r - 1], 0) != 0.0:
                d = arms_at(rows, y, r, R)[3]
            g[r] = dot(row3(rows.axis, r), d) - course(joints.drives, rows.drive[r], t)[0]
        elif kind == kinds.DOT:
            n, u = row3(rows.vector_a, r), row3(rows.axis, r)
            g[r] = dot(turn(R[0], n), turn(R[1], u))
        elif kind in (kinds.RACK, kinds.GEAR):
            _, _, u, d = arms_at(rows, y, r, R)
            g[r] = rolled(joints.rolls, rows, r, R, u, d)
        else:
            g[r] = residual(rows, joints.drives, y, r, t)
        share = abs(g[r]) / (turned if is_of_directions(kind) else rows.size[r] + far)
        is_larger = opposite(share <= worst) & ((worst <= inf) | opposite(share <= inf))
        worst = choose(is_larger, share, worst)
        if any_of(is_larger):
            where = r
    return worst, where


@inline
def _inverse_inertias(joints: Joints, r: int, R: tuple[Matrix, Matrix]) -> tuple[Matrix, Matrix]:
    """The same of both bodies of row r."""
    a, b = joints.rows.a[r], joints.rows.b[r]
    inverse_a = tensor(R[0], row3(joints.inv_inertia, a))
    return inverse_a, tensor(R[1], row3(joints.inv_inertia, b))


@inline
def _by_turning(rows: ConstraintRows, r: int, ra: Vec3, rb: Vec3, u: Vec3, d: Vec3) -> Three:
    """∂g/∂x_a, ∂g/∂θ_a and ∂g/∂θ_b of row r from its arms."""
    kind = rows.kind[r]
    if is_of_directions(kind):
        by_a = cross(ra, u) if kind == kinds.DOT else u
        return (0.0, 0.0, 0.0), by_a, scale(-1.0, by_a)
    by_x, arm = u, rb
    if kind in (kinds.ALONG, kinds.RACK, kinds.GEAR):
        arm = add(rb, d)
        by_x = tangent(u, d) if kind == kinds.GEAR else u
    elif kind == kinds.DISTANCE:
        by_x = scale(1.0 / rows.length[r], d)
    elif kind == kinds.STRETCH:
        by_x = scale(1.0 / max(norm(d), 1e-300), d)
    return by_x, cross(ra, by_x), cross(by_x, arm)


@unfused_kernel
def linearise(joints: Joints, data: JointData, lo: int, hi: int) -> None:
    """Gradients of rows lo to hi, and J⁻¹ times them."""
    rows, y, gradient = joints.rows, data.y, data.gradient
    if lo == hi:
        return
    R = rotations(rows, y, lo)
    inverse = _inverse_inertias(joints, lo, R)
    ra, rb, u, d = arms_at(rows, y, lo, R)
    for r in range(lo, hi):
        if is_of_other_bodies(rows, lo, r):
            R = rotations(rows, y, r)
            inverse = _inverse_inertias(joints, r, R)
        if joints.beside[r]:
            u = row3(rows.axis, r)
        else:
            ra, rb, u, d = arms_at(rows, y, r, R)
        by_x, by_a, by_b = _by_turning(rows, r, ra, rb, u, d)
        by_a, by_b = with_turns(joints.rolls, rows, r, R, by_a, by_b)
        put_row3(gradient, r, by_x)
        put_row3(gradient, r, by_a, 3)
        put_row3(gradient, r, by_b, 6)
        put_row3(gradient, r, turn(inverse[0], by_a), 9)
        put_row3(gradient, r, turn(inverse[1], by_b), 12)


@inline
def rate(joints: Joints, gradient: Floats, r: int, y: Floats, at: int) -> float:
    """Row r of G M⁻¹ times momenta, or loads, that stand in y from `at` on."""
    a, b = joints.rows.a[r], joints.rows.b[r]
    v = subtract(
        scale(joints.inv_mass[a], row3(y, a, at)), scale(joints.inv_mass[b], row3(y, b, at))
    )
    speed = dot(row3(gradient, r), v)
    speed += dot(row3(gradient, r, 9), row3(y, a, at + 3))
    return speed + dot(row3(gradient, r, 12), row3(y, b, at + 3))


@unfused_kernel
def rates(joints: Joints, data: JointData, lo: int, hi: int) -> float:
    """z = -ġ of rows lo to hi; the largest over its size [1/s], or NaN."""
    worst = 0.0
    for r in range(lo, hi):
        speed = rate(joints, data.gradient, r, data.y, col.P) + data.dg_dt[r]
        soft = data.compliance[r]
        is_in = soft < inf
        speed = choose(is_in, speed + choose(is_in, soft, 0.0) * data.impulse[r], 0.0)
        data.z[r] = -speed
        speed = abs(speed) / joints.rows.size[r]
        worst = choose((worst <= inf) & opposite(speed <= worst), speed, worst)
    return worst


@inline
def _two_at(y: Floats, k: int, at: int) -> tuple[Vec3, Vec3]:
    """Momenta, or loads, of body k that stand in y from `at` on."""
    return row3(y, k, at), row3(y, k, at + 3)


@inline
def _put_two(inv_mass: Floats, y: Floats, k: int, of: tuple[Vec3, Vec3], at: int) -> None:
    """Write them, if it moves."""
    if lane(inv_mass[k], 0) > 0.0:
        put_row3(y, k, of[0], at)
        put_row3(y, k, of[1], at + 3)


@kernel
def add_impulses(
    rows: ConstraintRows, inv_mass: Floats, gradient: Floats, z: Floats, lo: int, hi: int,
    y: Floats, at: int,
) -> None:  # fmt: skip
    """(P, L) += Gᵀ z of rows lo to hi, on momenta or loads that stand in y from `at` on."""
    if lo == hi:
        return
    a, b = rows.a[lo], rows.b[lo]
    of_a, of_b = _two_at(y, a, at), _two_at(y, b, at)
    for r in range(lo, hi):
        if rows.a[r] != a or rows.b[r] != b:
            _put_two(inv_mass, y, a, of_a, at)
            _put_two(inv_mass, y, b, of_b, at)
            a, b = rows.a[r], rows.b[r]
            of_a, of_b = _two_at(y, a, at), _two_at(y, b, at)
        by_x, f = row3(gradient, r), z[r]
        of_a = add_scaled(f, by_x, of_a[0]), add_scaled(f, row3(gradient, r, 3), of_a[1])
        of_b = add_scaled(-f, by_x, of_b[0]), add_scaled(f, row3(gradient, r, 6), of_b[1])
    _put_two(inv_mass, y, a, of_a, at)
    _put_two(inv_mass, y, b, of_b, at)
