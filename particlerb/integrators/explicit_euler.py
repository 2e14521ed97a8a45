"""Explicit Euler on (x, Q, v, ω): each slope at the beginning of the step.

A baseline: what one writes first, and what several engines do with the gyroscopic term. Energy
grows in each step, by (hω)² of an oscillation; a spinning body changes even its angular momentum,
because its rates advance in its own axes, I ω̇ = Rᵀτ - ω × I ω. See docs/stability.md.
"""

from typing import Final

from particlerb.contact.contact_model import OLD_VELOCITIES, LoadTimes
from particlerb.forces.kinds import CONTACT, PISTONS
from particlerb.integrators.contact_limits import explicit
from particlerb.integrators.contact_stages import drift_walls, kick_walls
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
from particlerb.integrators.stages import MovingBodies, loads, shown_at, stage, stages
from particlerb.maths.quaternion import matrix, turn, turn_back
from particlerb.maths.vec3 import add_scaled, component_product, cross
from particlerb.model.block import INV_INERTIA, get3


@stage
def _advance_rates(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """All slopes at the beginning; the rotor's momentum in its own axes."""
    acting, sums_external = moving.acting, moving.sums_external
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            y = pose(rows, b)
            R = matrix(y.q)
            slope, entry = slopes(acting, rows, b, y, R)
            m = turn_back(R, y.L)
            w = component_product(get3(rows, INV_INERTIA, b), m)
            m = add_scaled(dt, add_scaled(1.0, turn_back(R, slope.L), cross(m, w)), m)
            after = on_sphere(add_pose(dt, slope, y))
            put_pose(rows, b, Pose(after.x, after.q, after.p, turn(matrix(after.q), m)))
            add_entry(sums_external, rows, b, dt, entry)


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """One stage, with all loads taken at the beginning; springs of contacts take old velocities."""
    loads(moving, first, end, LoadTimes(dt, dt, OLD_VELOCITIES, None))
    drift_walls(moving.contact, moving.team, dt)
    kick_walls(moving.contact, moving.team, dt, 0.0, True)
    _advance_rates(moving, first, end, dt)


METHOD: Final = Method(
    summary="order 1, baseline; explicit Euler on rates in the body; energy grows; any force",
    order=1,
    accepts=ACCEPTED | {CONTACT, PISTONS},
    cost=3.0,
    evaluations=1,
    keeps_angular_momentum=False,
    stability_limit=0.0,
    max_turn=0.5,
    step=step,
    show=shown_at(LoadTimes(0.0, 0.0, OLD_VELOCITIES, None)),
    contact_limit=explicit,
)
