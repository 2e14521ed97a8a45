"""Semi-implicit Euler with an implicit gyroscopic term: what game engines do.

Velocities first, from the forces at the old pose; then positions, from the new velocities. The
gyroscopic term is taken at the end of the step and solved by one Newton step in body axes, which
never blows up, but damps: a tumbling body loses energy, and angular momentum too.

Source: Catto, Numerical Methods (Game Developers Conference 2015), the solver that Bullet and
others use.
"""

from typing import Final

from particlerb.compiled.jit import inline
from particlerb.contact.contact_model import NEW_VELOCITIES, LoadTimes
from particlerb.forces.kernels import (
    kick_others,
    kick_potential,
    less_internal,
    load_of_velocity,
    with_power,
)
from particlerb.forces.kinds import CONTACT, PISTONS
from particlerb.integrators.contact_limits import old_velocity
from particlerb.integrators.contact_stages import drift_walls, kick_walls
from particlerb.integrators.external_work import add_entry, entry_of_kick
from particlerb.integrators.method import Method
from particlerb.integrators.slopes import ACCEPTED, Pose, pose, put_pose
from particlerb.integrators.stages import MovingBodies, loads, shown_at, stage, stages
from particlerb.maths.quaternion import (
    add_scaled4,
    matrix,
    normalised,
    times_vector,
    turn,
    turn_back,
)
from particlerb.maths.vec3 import Vec3, add_scaled, component_product, cross, dot, scale
from particlerb.model.block import INV_INERTIA, INV_MASS, get, get3


@inline
def _gyroscopic(w: Vec3, inverse: Vec3, dt: float) -> Vec3:
    """One Newton step for I (ω⁺ - ω) + h ω⁺ × I ω⁺ = 0; ω and I = 1/inverse in the rotor frame.

    Moments count in units of the first. Points have inverse = 0 and no spin: any I serves them.
    """
    I1 = 1.0
    I2 = inverse[0] / inverse[1] if inverse[1] > 0.0 else 1.0
    I3 = inverse[0] / inverse[2] if inverse[2] > 0.0 else 1.0
    f = scale(dt, cross(w, (I1 * w[0], I2 * w[1], I3 * w[2])))
    h = dt
    # rows of the Jacobian I + h ([ω]× I - [I ω]×)
    r0 = (I1, h * w[2] * (I3 - I2), h * w[1] * (I3 - I2))
    r1 = (h * w[2] * (I1 - I3), I2, h * w[0] * (I1 - I3))
    r2 = (h * w[1] * (I2 - I1), h * w[0] * (I2 - I1), I3)
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    inv = 1.0 / dot(r0, c0)
    change = add_scaled(f[2], c2, add_scaled(f[1], c1, scale(f[0], c0)))
    return add_scaled(-inv, change, w)


@stage
def _advance_implicitly(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """Momenta by the forces, rates by the gyroscopic term, then the pose by both."""
    acting, sums_external = moving.acting, moving.sums_external
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            y = pose(rows, b)
            R, inverse = matrix(y.q), get3(rows, INV_INERTIA, b)
            middle = kick_potential(acting, rows, b, y.x, R, dt, y.p, y.L)
            p, L = kick_others(acting, rows, b, y.x, R, dt, middle[0], middle[1])
            zero = (0.0, 0.0, 0.0)
            against, braking = load_of_velocity(acting, rows, b, y.x, R, y.p, y.L, zero, zero)
            p, L = add_scaled(dt, against, p), add_scaled(dt, braking, L)
            entry = entry_of_kick(rows, b, y.x, R, (y.p, y.L), middle, (p, L))
            entry = less_internal(acting, rows, b, y.x, dt, entry)
            add_entry(sums_external, rows, b, 1.0, with_power(acting, rows, b, y.x, R, dt, entry))
            w = _gyroscopic(component_product(inverse, turn_back(R, L)), inverse, dt)
            q = normalised(add_scaled4(dt, times_vector(y.q, scale(0.5, w)), y.q))
            m = (
                (w[0] / inverse[0], w[1] / inverse[1], w[2] / inverse[2])
                if inverse[0] > 0.0
                else zero
            )
            x = add_scaled(dt * get(rows, INV_MASS, b), p, y.x)
            put_pose(rows, b, Pose(x, q, p, turn(matrix(q), m)))


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """One stage, with all loads taken at the beginning; springs of contacts take new velocities."""
    loads(moving, first, end, LoadTimes(dt, dt, NEW_VELOCITIES, None))
    kick_walls(moving.contact, moving.team, dt, 0.0, True)
    _advance_implicitly(moving, first, end, dt)
    drift_walls(moving.contact, moving.team, dt)


METHOD: Final = Method(
    summary="order 1, baseline; the game standard, implicit gyroscopic term; damps; any force",
    order=1,
    accepts=ACCEPTED | {CONTACT, PISTONS},
    cost=4.0,
    evaluations=1,
    keeps_angular_momentum=False,
    stability_limit=2.0,
    max_turn=0.5,
    step=step,
    show=shown_at(LoadTimes(0.0, 0.0, NEW_VELOCITIES, None)),
    contact_limit=old_velocity,
)
