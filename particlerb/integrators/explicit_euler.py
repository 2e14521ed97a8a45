"""Explicit Euler on (x, Q, v, ω): each slope at the beginning of the step.

A baseline: what one writes first, and what several engines do with the gyroscopic term. Energy
grows in each step, by (hω)² of an oscillation; a spinning body changes even its angular momentum,
because its rates advance in its own axes, I ω̇ = Rᵀτ - ω × I ω. See docs/stability.md.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel_from
from particlerb.forces.kernels import Acting
from particlerb.integrators.slopes import (
    ACCEPTED,
    Pose,
    add_pose,
    on_sphere,
    pose,
    put_pose,
    slopes,
)
from particlerb.maths.quaternion import matrix, turn, turn_back
from particlerb.maths.vec3 import Floats, add_scaled, cross, multiplied3
from particlerb.model.block import INV_INERTIA, get3
from particlerb.model.state import State
from particlerb.stepping.coupled import CoupledMotion, one_stage
from particlerb.stepping.external_work import book
from particlerb.stepping.loop import SteppedMotion, advance_blocks
from particlerb.stepping.motion import Group

ORDER: Final = 1
FREE_ORDER: Final = 1
IS_ADAPTIVE: Final = False
KEEPS_RODS: Final = False
ACCEPTS: Final = ACCEPTED
SUMMARY: Final = "order 1, baseline; explicit Euler on rates in the body; energy grows; any force"
COST: Final = 3.0  # ns per body-step, roughly
EVALUATIONS: Final = 1  # of the forces in a step
REACH: Final = 0.0  # largest hω of an oscillator that stays bounded (none)
LONGEST: Final = 0.5  # rad in one step above which it is worth a warning


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """All slopes at the beginning; the rotor's momentum in its own axes."""
    for b in range(n):
        y = pose(rows, b)
        R = matrix(y.q)
        slope, entry = slopes(acting, rows, b, y, R)
        m = turn_back(R, y.L)
        w = multiplied3(get3(rows, INV_INERTIA, b), m)
        m = add_scaled(dt, add_scaled(1.0, turn_back(R, slope.L), cross(m, w)), m)
        after = on_sphere(add_pose(dt, slope, y))
        put_pose(rows, b, Pose(after.x, after.q, after.p, turn(matrix(after.q), m)))
        book(books, rows, b, dt, entry)


advance = kernel_from(advance_blocks, "explicit_euler", step=step, EDGE=0.0)
together = one_stage("explicit_euler", step, 0.0, flows=False)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> SteppedMotion:
    """Set off from a state at a time [s]."""
    del tolerance
    if group.terms.is_coupled:
        return CoupledMotion(together, COST, group, state, start, dt, keeps_spin=False)
    return SteppedMotion(advance, COST, group, state, start, dt, keeps_spin=False)
