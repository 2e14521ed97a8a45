"""A fixed centre that attracts with an inverse-square field, and turns bodies by its gradient.

With r from the centre to the body, d = |r|, n = r/d and the inertia tensor I in the world, to
second order in the size of the body over d (MacCullagh's formula)

    U = -μ M/d - μ (tr I - 3 n·I n)/(2 d³),
    F = -μ M n/d² + 3 μ ((5 n·I n - tr I) n - 2 I n)/(2 d⁴),   τ = 3 μ n × I n/d³.

F and τ are the exact derivatives of U, hence energy, and angular momentum about the centre, are
constants of the motion. Source: Hughes, Spacecraft Attitude Dynamics (1986), section 8.1.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Rows, turn, turn_back
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, cross, dot, scale, subtract
from particlerb.model.block import get, get3
from particlerb.model.state import turned_back

CENTRAL_ROWS: Final = 8


class Central(NamedTuple):
    """Parameters of one centre for each of n bodies."""

    centre: Floats  # (3, n) [m], world frame
    mu: Floats  # (n,) [m³/s²], G times the mass of the centre
    mass: Floats  # (n,) [kg], of the body
    inertia: Floats  # (3, n) [kg m²], principal moments, rotor frame


@inline
def kick_centres(
    centres: tuple[int, ...] | None,
    rows: Floats,
    at: int,
    b: int,
    x: Vec3,
    R: Rows,
    dt: float,
    p: Vec3,
    L: Vec3,
) -> tuple[Vec3, Vec3]:
    """p + Σ F dt,  L + Σ τ dt."""
    if centres is None:
        return p, L
    for k in range(len(centres)):  # the length is known while compiling: this is unrolled
        first = at + k * CENTRAL_ROWS
        r = subtract(x, get3(rows, first, b))
        mu, mass = get(rows, first + 3, b), get(rows, first + 4, b)
        inertia = get3(rows, first + 5, b)
        inverse = 1.0 / np.sqrt(dot(r, r))
        n = scale(inverse, r)
        m = turn_back(R, n)
        moved = turn(R, (inertia[0] * m[0], inertia[1] * m[1], inertia[2] * m[2]))
        size = mu * inverse * inverse
        trace = inertia[0] + inertia[1] + inertia[2]
        near = 1.5 * size * inverse * inverse
        along = near * (5.0 * dot(n, moved) - trace) - size * mass
        force = add_scaled(-2.0 * near, moved, scale(along, n))
        torque = scale(3.0 * size * inverse, cross(n, moved))
        p, L = add_scaled(dt, force, p), add_scaled(dt, torque, L)
    return p, L


def central_work(central: Central, com: Floats, q: Floats) -> Floats:
    """-U, (n,) [J]: what the field has done, up to a constant."""
    r = com - central.centre
    d = np.linalg.norm(r, axis=0)
    m = turned_back(q, r / d)
    near = central.inertia.sum(axis=0) - 3.0 * (m * m * central.inertia).sum(axis=0)
    work: Floats = central.mu * (central.mass / d + 0.5 * near / (d * d * d))
    return work
