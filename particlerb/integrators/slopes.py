"""The equations of motion as slopes of (x, Q, P, L), Baraff's form, for methods that need them.

ẋ = P/M, Q̇ = ½ Q (0, Ω), Ṗ = F, L̇ = τ with Ω = I⁻¹ Rᵀ L; docs/theory.md, (1.1). Between the steps
Q leaves the unit sphere: R is that of Q/|Q| (`matrix_along`), and Q̇ takes Q as it is.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline
from particlerb.forces.kernels import Acting, Entry, less_internal, load_at, with_power
from particlerb.forces.kinds import BODIES, POSE, TIME, VELOCITY
from particlerb.maths.quaternion import (
    Matrix,
    Quat,
    add_scaled4,
    normalised,
    times_vector,
    turn_back,
)
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, L, P, Q, get, get3, get4, put3, put4

ACCEPTED: Final = frozenset({POSE, VELOCITY, TIME, BODIES})  # what these methods take: no contact


class Pose(NamedTuple):
    """State of one body, or its slopes."""

    x: Vec3
    q: Quat
    p: Vec3
    L: Vec3


@inline
def pose(rows: Floats, b: int, at: int = COM) -> Pose:
    """State of body b, whose rows begin at `at`."""
    p, spin = get3(rows, at + P, b), get3(rows, at + L, b)
    return Pose(get3(rows, at, b), get4(rows, at + Q, b), p, spin)


@inline
def put_pose(rows: Floats, b: int, y: Pose, at: int = COM) -> None:
    """Write the state of body b into rows from `at` on."""
    put3(rows, at, b, y.x)
    put4(rows, at + Q, b, y.q)
    put3(rows, at + P, b, y.p)
    put3(rows, at + L, b, y.L)


@inline
def add_pose(a: float, k: Pose, y: Pose) -> Pose:
    """y + a k."""
    return Pose(
        add_scaled(a, k.x, y.x),
        add_scaled4(a, k.q, y.q),
        add_scaled(a, k.p, y.p),
        add_scaled(a, k.L, y.L),
    )


@inline
def on_sphere(y: Pose) -> Pose:
    """The same with |q| = 1."""
    return Pose(y.x, normalised(y.q), y.p, y.L)


@inline
def slopes(acting: Acting, rows: Floats, b: int, y: Pose, R: Matrix) -> tuple[Pose, Entry]:
    """Slopes of body b in a state with the rotation matrix R, and its rates of external work."""
    m = turn_back(R, y.L)
    w = component_product(get3(rows, INV_INERTIA, b), m)
    v = scale(get(rows, INV_MASS, b), y.p)
    F, tau, own_force, own_torque = load_at(acting, rows, b, y.x, R, y.p, y.L)
    power = dot(subtract(F, own_force), v) + dot(turn_back(R, subtract(tau, own_torque)), w)
    turning = add_scaled(1.0, tau, cross(y.x, F))
    entry = less_internal(acting, rows, b, y.x, 1.0, (power, F, turning))
    entry = with_power(acting, rows, b, y.x, R, 1.0, entry)
    return Pose(v, times_vector(y.q, scale(0.5, w)), F, tau), entry
