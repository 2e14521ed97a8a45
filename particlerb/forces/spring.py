"""Springs from a point of the body to an anchor that is fixed in the world.

With d from the body point to the anchor and l = |d|: F = k (l - l₀) d/l at the point, and the
potential k (l - l₀)²/2. A spring of no length has no direction and gives no force.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.quaternion import Rows, turn
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, cross, dot, scale, subtract
from particlerb.model.block import get, get3
from particlerb.model.state import turned

SPRING_ROWS: Final = 8
TINY: Final = 1e-300  # keeps 1/l finite where the spring has no length


class Spring(NamedTuple):
    """Parameters of one spring on each of n bodies."""

    at: Floats  # (3, n) [m], rotor frame, from the centre of mass
    anchor: Floats  # (3, n) [m], world frame
    stiffness: Floats  # (n,) [N/m]
    rest_length: Floats  # (n,) [m]


@inline
def kick_springs(
    springs: tuple[int, ...] | None,
    rows: Floats,
    at: int,
    b: int,
    x: Vec3,
    R: Rows,
    dt: float,
    p: Vec3,
    L: Vec3,
) -> tuple[Vec3, Vec3]:
    """p + Σ F dt,  L + Σ (R r) × F dt."""
    if springs is None:
        return p, L
    for k in range(len(springs)):  # the length is known while compiling: this is unrolled
        first = at + k * SPRING_ROWS
        arm = turn(R, get3(rows, first, b))
        d = subtract(subtract(get3(rows, first + 3, b), x), arm)
        stiffness, rest = get(rows, first + 6, b), get(rows, first + 7, b)
        force = scale(stiffness * (1.0 - rest / np.sqrt(dot(d, d) + TINY)), d)
        p, L = add_scaled(dt, force, p), add_scaled(dt, cross(arm, force), L)
    return p, L


def spring_energy(spring: Spring, com: Floats, q: Floats) -> Floats:
    """k (l - l₀)²/2, (n,) [J]."""
    d = spring.anchor - com - turned(q, spring.at)
    stretch = np.linalg.norm(d, axis=0) - spring.rest_length
    energy: Floats = 0.5 * spring.stiffness * stretch * stretch
    return energy
