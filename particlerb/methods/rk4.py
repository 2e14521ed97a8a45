"""The classical Runge-Kutta method of order 4 on (x, Q, P, L), with Q normalised after each step.

A baseline: what textbooks and many programs use. Neither symmetric nor symplectic: energy drifts
in proportion to the time. L of free bodies is constant, since it is a variable.

Source: Baraff, Physically Based Modeling: Rigid Body Simulation (SIGGRAPH course notes, 1997), for
the form; Kutta 1901 for the method.
"""

from typing import Final

from particlerb._jit import inline, kernel_from
from particlerb.bodies.state import State
from particlerb.maths.vec3 import Floats
from particlerb.methods.booking import book
from particlerb.methods.motion import Group
from particlerb.methods.rates import add_pose, on_sphere, pose, put_pose, slopes
from particlerb.methods.stepped import SteppedMotion, advance_blocks
from particlerb.terms import Acting

ORDER: Final = 4
FREE_ORDER: Final = 4
IS_ADAPTIVE: Final = False
KEEPS_RODS: Final = False
ACCEPTS: Final = frozenset({"gravity", "push", "follower", "torque", "drag", "spring", "central"})
SUMMARY: Final = "order 4, baseline; Runge-Kutta on (x, Q, P, L); energy drifts; any force"
COST: Final = 6.0  # ns per body-step, roughly


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Four slopes, weighed 1 : 2 : 2 : 1."""
    third, sixth = dt * (1.0 / 3.0), dt * (1.0 / 6.0)
    for b in range(n):
        y = pose(rows, b)
        k1, e1 = slopes(acting, rows, b, y)
        k2, e2 = slopes(acting, rows, b, add_pose(0.5 * dt, k1, y))
        k3, e3 = slopes(acting, rows, b, add_pose(0.5 * dt, k2, y))
        k4, e4 = slopes(acting, rows, b, add_pose(dt, k3, y))
        y = add_pose(sixth, k1, add_pose(third, k2, add_pose(third, k3, add_pose(sixth, k4, y))))
        put_pose(rows, b, on_sphere(y))
        book(books, rows, b, sixth, e1)
        book(books, rows, b, third, e2)
        book(books, rows, b, third, e3)
        book(books, rows, b, sixth, e4)


advance = kernel_from(advance_blocks, "rk4", step=step, EDGE=0.0)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> SteppedMotion:
    """Set off from a state at a time [s]."""
    del tolerance
    return SteppedMotion(advance, COST, group, state, start, dt)
