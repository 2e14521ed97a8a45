"""The classical Runge-Kutta method of order 4 on (x, Q, P, L), with Q normalised after each step.

A baseline: what textbooks and many programs use. Neither symmetric nor symplectic: energy drifts
in proportion to the time. L of free bodies is constant, since it is a variable.

Source: Baraff, Physically Based Modeling: Rigid Body Simulation (SIGGRAPH course notes, 1997), for
the form; Kutta 1901 for the method.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel_from
from particlerb.forces.kernels import Acting, shift_time
from particlerb.forces.registry import STAGE
from particlerb.integrators.slopes import (
    ACCEPTED,
    Pose,
    add_pose,
    on_sphere,
    pose,
    put_pose,
    slopes,
)
from particlerb.maths.quaternion import add_scaled4, length, matrix, matrix_along
from particlerb.maths.vec3 import Floats
from particlerb.model.block import SCRATCH, get, get3, get4, put, put3, put4
from particlerb.model.load import STATE_ROWS
from particlerb.model.state import State
from particlerb.stepping.coupled import CoupledMotion, stages_of
from particlerb.stepping.external_work import book
from particlerb.stepping.loop import SteppedMotion, advance_blocks
from particlerb.stepping.motion import Group

ORDER: Final = 4
FREE_ORDER: Final = 4
IS_ADAPTIVE: Final = False
KEEPS_RODS: Final = False
ACCEPTS: Final = ACCEPTED
SUMMARY: Final = "order 4, baseline; Runge-Kutta on (x, Q, P, L); energy drifts; any force"
COST: Final = 6.0  # ns per body-step, roughly
EVALUATIONS: Final = 4  # of the forces in a step
REACH: Final = 2.82  # largest hω of an oscillator that stays bounded
LONGEST: Final = 0.5  # rad in one step above which it is worth a warning
WEIGHTS: Final = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)  # of the slopes
NEXT: Final = (0.5, 0.5, 1.0, 0.0)  # where the next slope is taken, in steps
WHERE: Final = (0.0, 0.5, 0.5, 1.0)  # each slope is taken, in steps
LENGTH: Final = SCRATCH  # row of |q| there


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Four slopes, weighed 1 : 2 : 2 : 1."""
    third, sixth = dt * (1.0 / 3.0), dt * (1.0 / 6.0)
    for b in range(n):
        y = pose(rows, b)
        k1, e1 = slopes(acting, rows, b, y, matrix(y.q))
        y2 = add_pose(0.5 * dt, k1, y)
        shift_time(acting, rows, b, 0.5 * dt)
        k2, e2 = slopes(acting, rows, b, y2, matrix_along(y2.q))
        y3 = add_pose(0.5 * dt, k2, y)
        k3, e3 = slopes(acting, rows, b, y3, matrix_along(y3.q))
        y4 = add_pose(dt, k3, y)
        shift_time(acting, rows, b, dt)
        k4, e4 = slopes(acting, rows, b, y4, matrix_along(y4.q))
        y = add_pose(sixth, k1, add_pose(third, k2, add_pose(third, k3, add_pose(sixth, k4, y))))
        put_pose(rows, b, on_sphere(y))
        book(books, rows, b, sixth, e1)
        book(books, rows, b, third, e2)
        book(books, rows, b, third, e3)
        book(books, rows, b, sixth, e4)


@inline
def pose_at(rows: Floats, at: int, b: int) -> Pose:
    """State of body b from row `at` on."""
    return Pose(
        get3(rows, at, b), get4(rows, at + 3, b), get3(rows, at + 7, b), get3(rows, at + 10, b)
    )


@inline
def put_pose_at(rows: Floats, at: int, b: int, y: Pose) -> None:
    """Write the state of body b."""
    put3(rows, at, b, y.x)
    put4(rows, at + 3, b, y.q)
    put3(rows, at + 7, b, y.p)
    put3(rows, at + 10, b, y.L)


@inline
def stage(
    k: int,
    is_asymmetric: bool,
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    opening: float,
    dt: float,
) -> None:
    """One slope, where bodies act on each other: the next needs those of all before it.

    The state at the beginning, and the sum so far, are in the rows STAGE; those of the state have
    where the next slope is taken, with q/|q|, as forces between bodies want it, and |q| in LENGTH.
    """
    for b in range(n):
        y = pose(rows, b)
        R = matrix(y.q)
        if k > 0:
            stretch = get(rows, LENGTH, b) - 1.0
            y = Pose(y.x, add_scaled4(stretch, y.q, y.q), y.p, y.L)
        shift_time(acting, rows, b, WHERE[k] * dt)
        slope, entry = slopes(acting, rows, b, y, R)
        if k == 0:
            put_pose_at(rows, STAGE, b, y)
            put_pose_at(rows, STAGE + STATE_ROWS, b, y)
        first, total = pose_at(rows, STAGE, b), pose_at(rows, STAGE + STATE_ROWS, b)
        total = add_pose(WEIGHTS[k] * dt, slope, total)
        put_pose_at(rows, STAGE + STATE_ROWS, b, total)
        after = total if k == 3 else add_pose(NEXT[k] * dt, slope, first)
        put(rows, LENGTH, b, length(after.q))
        put_pose(rows, b, on_sphere(after))
        book(books, rows, b, WEIGHTS[k] * dt, entry)


advance = kernel_from(advance_blocks, "rk4", step=step, EDGE=0.0)
together = stages_of("rk4", stage, 4, 0.0, flows=False)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> SteppedMotion:
    """Set off from a state at a time [s]."""
    del tolerance
    if group.terms.is_coupled:
        return CoupledMotion(together, COST, group, state, start, dt)
    return SteppedMotion(advance, COST, group, state, start, dt)
