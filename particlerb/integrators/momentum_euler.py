"""Explicit Euler on (x, Q, P, L), with Q normalised after each step.

A baseline: the usual first program after Baraff's notes. All slopes are taken at the beginning of
the step. The momenta of free bodies are constant, since they are variables, but their energy grows
until they spin about the axis of the smallest moment; an oscillation gains (hω)² in each step.

Source: Baraff, Physically Based Modeling: Rigid Body Simulation (SIGGRAPH course notes, 1997).
"""

from typing import Final

from particlerb.contact.contact_model import NOW
from particlerb.integrators.external_work import add_entry
from particlerb.integrators.method import Method
from particlerb.integrators.slopes import ACCEPTED, add_pose, on_sphere, pose, put_pose, slopes
from particlerb.integrators.stages import MovingBodies, loads, stage, stages
from particlerb.maths.quaternion import matrix


@stage
def _advance_momenta(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """One slope, at the beginning."""
    acting, sums_external = moving.acting, moving.sums_external
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            y = pose(rows, b)
            slope, entry = slopes(acting, rows, b, y, matrix(y.q))
            put_pose(rows, b, on_sphere(add_pose(dt, slope, y)))
            add_entry(sums_external, rows, b, dt, entry)


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """One stage, with all loads taken at the beginning."""
    loads(moving, first, end, NOW)
    _advance_momenta(moving, first, end, dt)


METHOD: Final = Method(
    summary="order 1, baseline; explicit Euler on (x, Q, P, L); energy grows; any force",
    order=1,
    accepts=ACCEPTED,
    cost=3.0,
    evaluations=1,
    stability_limit=0.0,
    max_turn=0.5,
    step=step,
)
