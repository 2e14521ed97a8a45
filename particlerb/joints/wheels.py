r"""Bodies that roll on each other: racks, screws and gears, each as one row between two bodies.

Body a turns by θ against b about n, which is fixed in b; g = s + k θ, and

    ∂g/∂x_a = v,   ∂g/∂θ_a = r_a × v + k n,   ∂g/∂θ_b = v × (r_b + d) - k n

| row | s | k | v |
|-|-|-|-|
| rack, screw | u·d, u fixed in b | - radius, - lead/2π | u |
| gear | k φ_b z_b/z_a, and θ = φ_a | pitch radius of a | d × n/\|d × n\| |

φ are the angles of marks, one in each body, from the line of centres, so that a carrier may turn. v
is where teeth push, at the pitch point. One tooth, or turn, is as good as the next: g is taken
modulo the pitch, and no turns need be counted. Other joints keep axes along n, and distances: so of
g̈ neither ṅ nor v̇ of a gear is a part.
"""

from math import atan2
from typing import Final

import numpy as np

from particlerb.compiled.jit import Flag, inline
from particlerb.joints import kinds
from particlerb.joints.records import ConstraintRows
from particlerb.maths.quaternion import Matrix, turn
from particlerb.maths.vec3 import Vec3, add_scaled, cross, dot, norm, scale

_MAX_ASKEW: Final = 1e-4  # rad, or over the radius: what holds the axes leaves less


@inline
def _three(rows: ConstraintRows, r: int, at: int) -> Vec3:
    """A direction of the wheel of row r."""
    return rows.wheel[r, at], rows.wheel[r, at + 1], rows.wheel[r, at + 2]


@inline
def _angle(n: Vec3, v: Vec3, w: Vec3) -> float:
    """Angle from v to w about n."""
    return atan2(dot(n, cross(v, w)), dot(v, w))


@inline
def rolled(
    rolls: Flag, rows: ConstraintRows, r: int, R: tuple[Matrix, Matrix], u: Vec3, d: Vec3
) -> float:
    """g of a row that rolls [m]."""
    if rolls is None:
        return 0.0
    n, k = turn(R[1], _three(rows, r, 0)), rows.wheel[r, 9]
    a, b = turn(R[0], _three(rows, r, 3)), turn(R[1], _three(rows, r, 6))
    if rows.kind[r] == kinds.GEAR:
        line = scale(-1.0, d)
        g = k * (_angle(n, line, a) + rows.wheel[r, 10] * _angle(n, line, b))
    else:
        g = dot(u, d) + k * _angle(n, b, a)
    return nearest(g, 0.0, rows.wheel[r, 11])


@inline
def nearest(g: float, to: float, period: float) -> float:
    """Of g and all that differ from it by periods, the nearest to a number."""
    shifted: float = g - period * np.floor((g - to) / period + 0.5)
    return shifted


@inline
def out_of_mesh(
    rows: ConstraintRows,
    r: int,
    R: tuple[Matrix, Matrix],
    arms: tuple[Vec3, Vec3],
    before: tuple[Matrix, Matrix],
    arms_before: tuple[Vec3, Vec3],
    turned: tuple[Vec3, Vec3],
) -> int:
    """1 where row r has passed teeth since the pose before, 2 where its axes have left their place.

    `arms` are u and d; `turned` is about how far a and b have turned, to count whole turns.
    """
    n, k, (u, d) = turn(R[1], _three(rows, r, 0)), rows.wheel[r, 9], arms
    a, b = turn(R[0], _three(rows, r, 3)), turn(R[1], _three(rows, r, 6))
    first, mark = turn(before[0], _three(rows, r, 3)), turn(before[1], _three(rows, r, 6))
    n0, pitch = turn(before[1], _three(rows, r, 0)), rows.wheel[r, 11]
    angle, far = _angle(n, b, a) - _angle(n0, mark, first), dot(n, turned[0]) - dot(n, turned[1])
    if rows.kind[r] == kinds.GEAR:
        apart = k * (1.0 + rows.wheel[r, 10])
        swept = _angle(n, b, scale(-1.0, d)) - _angle(n0, mark, scale(-1.0, arms_before[1]))
        s = -apart * nearest(swept, -dot(n, turned[1]), 2.0 * np.pi)
        off = norm(cross(n, d)) / abs(apart) - 1.0
    else:
        s = dot(u, d) - dot(arms_before[0], arms_before[1])
        off = dot(d, cross(n, u)) / k
    on: float = (
        rolled(True, rows, r, before, *arms_before) + s + k * nearest(angle, far, 2.0 * np.pi)
    )
    askew: float = max(abs(off), abs(dot(n, a)))
    return 2 if askew > _MAX_ASKEW else int(abs(on) > 0.5 * pitch)


@inline
def tangent(n: Vec3, d: Vec3) -> Vec3:
    """Where teeth of a gear push."""
    across = cross(d, n)
    return scale(1.0 / max(norm(across), 1e-300), across)


@inline
def with_turns(
    rolls: Flag, rows: ConstraintRows, r: int, R: tuple[Matrix, Matrix], by_a: Vec3, by_b: Vec3
) -> tuple[Vec3, Vec3]:
    """∂g/∂θ of both bodies of a row, with ± k n where it rolls."""
    if rolls is None or rows.kind[r] not in (kinds.RACK, kinds.GEAR):
        return by_a, by_b
    n, k = turn(R[1], _three(rows, r, 0)), rows.wheel[r, 9]
    return add_scaled(k, n, by_a), add_scaled(-k, n, by_b)
