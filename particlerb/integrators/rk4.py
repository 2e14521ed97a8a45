"""The classical Runge-Kutta method of order 4 on (x, Q, P, L), with Q normalised after each step.

A baseline: what textbooks and many programs use. Neither symmetric nor symplectic: energy drifts
in proportion to the time. L of free bodies is constant, since it is a variable.

Source: Baraff, Physically Based Modeling: Rigid Body Simulation (SIGGRAPH course notes, 1997), for
the form; Kutta 1901 for the method.
"""

from typing import Final

from particlerb.contact.contact_model import BY_SLOPES, LoadTimes, Slope
from particlerb.forces.kernels import shift_time
from particlerb.forces.kinds import CONTACT
from particlerb.forces.registry import STAGE
from particlerb.integrators.contact_limits import four_slopes
from particlerb.integrators.external_work import add_entry
from particlerb.integrators.method import Method
from particlerb.integrators.slopes import (
    ACCEPTED,
    Pose,
    add_pose,
    on_sphere,
    pose,
    put_pose,
    slopes,
)
from particlerb.integrators.stages import (
    MovingBodies,
    kinematics_later,
    loads,
    shown_at,
    stage,
    stages,
)
from particlerb.maths.quaternion import add_scaled4, length, matrix, matrix_along
from particlerb.model.block import SCRATCH, get, put
from particlerb.model.load import STATE_ROWS

_WEIGHTS: Final = (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)  # of the slopes
_NEXT_SLOPE_TIMES: Final = (0.5, 0.5, 1.0, 0.0)  # in steps
_SLOPE_TIMES: Final = (0.0, 0.5, 0.5, 1.0)  # in steps
_LENGTH_ROW: Final = SCRATCH  # of |q| where a slope is taken
_SUM_ROW: Final = STAGE + STATE_ROWS  # of the slopes so far; the state at the beginning is at STAGE


@stage
def _four_slopes(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """Four slopes, weighed 1 : 2 : 2 : 1."""
    acting, sums_external = moving.acting, moving.sums_external
    third, sixth = dt * (1.0 / 3.0), dt * (1.0 / 6.0)
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
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
            y = add_pose(
                sixth, k1, add_pose(third, k2, add_pose(third, k3, add_pose(sixth, k4, y)))
            )
            put_pose(rows, b, on_sphere(y))
            add_entry(sums_external, rows, b, sixth, e1)
            add_entry(sums_external, rows, b, third, e2)
            add_entry(sums_external, rows, b, third, e3)
            add_entry(sums_external, rows, b, sixth, e4)


@stage
def _one_slope(moving: MovingBodies, first: int, end: int, k: int, dt: float) -> None:
    """One slope, where bodies act on each other: the next needs those of all before it.

    The state at the beginning, and the sum so far, have rows of their own; those of the state have
    where the next slope is taken, with q/|q|, as forces between bodies want it; |q| is in
    _LENGTH_ROW.
    """
    acting, sums_external = moving.acting, moving.sums_external
    for block in range(first, end):
        rows = moving.blocks[block]
        for b in range(moving.layout.size[block]):
            y = pose(rows, b)
            R = matrix(y.q)
            if k > 0:
                stretch = get(rows, _LENGTH_ROW, b) - 1.0
                y = Pose(y.x, add_scaled4(stretch, y.q, y.q), y.p, y.L)
            shift_time(acting, rows, b, _SLOPE_TIMES[k] * dt)
            slope, entry = slopes(acting, rows, b, y, R)
            if k == 0:
                put_pose(rows, b, y, STAGE)
                put_pose(rows, b, y, _SUM_ROW)
            start = pose(rows, b, STAGE)
            total = add_pose(_WEIGHTS[k] * dt, slope, pose(rows, b, _SUM_ROW))
            put_pose(rows, b, total, _SUM_ROW)
            after = total if k == 3 else add_pose(_NEXT_SLOPE_TIMES[k] * dt, slope, start)
            put(rows, _LENGTH_ROW, b, length(after.q))
            put_pose(rows, b, on_sphere(after))
            add_entry(sums_external, rows, b, _WEIGHTS[k] * dt, entry)


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """All slopes of one body after the other."""
    _four_slopes(moving, first, end, dt)


@stages
def coupled_step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """One slope of all bodies after the other, and of the tangential springs of contacts."""
    for k in range(len(_WEIGHTS)):
        if k > 0:
            kinematics_later(moving, first, end, _SLOPE_TIMES[k] * dt)
        slope = Slope(dt, _WEIGHTS[k], _NEXT_SLOPE_TIMES[k], k == 0)
        loads(moving, first, end, LoadTimes(dt, _WEIGHTS[k] * dt, BY_SLOPES, slope))
        _one_slope(moving, first, end, k, dt)


METHOD: Final = Method(
    summary="order 4, baseline; Runge-Kutta on (x, Q, P, L); energy drifts; any force",
    order=4,
    accepts=ACCEPTED | {CONTACT},
    cost=9.0,
    evaluations=4,
    stability_limit=2.82,
    max_turn=0.5,
    step=step,
    coupled_step=coupled_step,
    show=shown_at(LoadTimes(0.0, 0.0, BY_SLOPES, Slope(0.0, 0.0, 0.0, True))),
    takes_slopes=True,
    contact_limit=four_slopes,
)
