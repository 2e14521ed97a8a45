"""Explicit Euler on (x, Q, P, L), with Q normalised after each step.

A baseline: the usual first program after Baraff's notes. All slopes are taken at the beginning of
the step. The momenta of free bodies are constant, since they are variables, but their energy grows
until they spin about the axis of the smallest moment; an oscillation gains (hω)² in each step.

Source: Baraff, Physically Based Modeling: Rigid Body Simulation (SIGGRAPH course notes, 1997).
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel_from
from particlerb.forces.kernels import Acting
from particlerb.integrators.slopes import ACCEPTED, add_pose, on_sphere, pose, put_pose, slopes
from particlerb.maths.quaternion import matrix
from particlerb.maths.vec3 import Floats
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
SUMMARY: Final = "order 1, baseline; explicit Euler on (x, Q, P, L); energy grows; any force"
COST: Final = 3.0  # ns per body-step, roughly
EVALUATIONS: Final = 1  # of the forces in a step
REACH: Final = 0.0  # largest hω of an oscillator that stays bounded (none)
LONGEST: Final = 0.5  # rad in one step above which it is worth a warning


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """One slope, at the beginning."""
    for b in range(n):
        y = pose(rows, b)
        slope, entry = slopes(acting, rows, b, y, matrix(y.q))
        put_pose(rows, b, on_sphere(add_pose(dt, slope, y)))
        book(books, rows, b, dt, entry)


advance = kernel_from(advance_blocks, "momentum_euler", step=step, EDGE=0.0)
together = one_stage("momentum_euler", step, 0.0, flows=False)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> SteppedMotion:
    """Set off from a state at a time [s]."""
    del tolerance
    if group.terms.is_coupled:
        return CoupledMotion(together, COST, group, state, start, dt)
    return SteppedMotion(advance, COST, group, state, start, dt)
