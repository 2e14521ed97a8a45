"""Forces of contacts at one instant: what those between spheres and with walls have in common.

An evaluation has three passes, each over ranges that threads can share: bodies move their spheres,
contacts find their forces, bodies collect them in the order of the contacts (`body_loads`). So the
sums do not depend on the threads. Between two passes the threads have to meet. The elastic part of
the normal force has a potential and is kept apart from the rest, which counts as work.
"""

from typing import Final, NamedTuple

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.contact_model import ContactModel, Evaluation, Workspace
from particlerb.contact.friction import friction_force, rolling_torque
from particlerb.contact.law import (
    ContactState,
    NormalForce,
    corrected_rate,
    correction_time,
    damping_coefficient,
    normal_force,
    with_motion,
)
from particlerb.contact.records import Records
from particlerb.contact.spring_growth import Sliding, spring_after, spring_at
from particlerb.maths.quaternion import matrix, turn, turn_back
from particlerb.maths.rows import column3_at, put_row3, put_row4, row3, row4
from particlerb.maths.vec3 import (
    ZERO,
    Bools,
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    norm,
    scale,
    subtract,
)
from particlerb.model.block import COM, L, P, Q, get3, get4

_POINT_FAR_AWAY: Final = 1e100  # [m] where contacts act that have ended


class Collision(NamedTuple):
    """Where and how two that are near to each other move."""

    overlap: float  # [m]
    normal: Vec3  # from the first to the second
    point: Vec3  # [m] world frame
    velocity: Vec3  # [m/s] of the first relative to the second, at the point
    angular_velocity: Vec3  # [rad/s] of the first relative to the second
    boundary_velocity: Vec3  # [m/s] there, of a wall or a held body
    r_eff: float  # [m] R*
    turning: Vec3  # [1/s] how the normal turns, where a method asks for it; else zero


# Bodies at the instant of a kick


@kernel
def body_kinematics(
    model: ContactModel,
    workspace: Workspace,
    rows: Floats,
    last: Floats,
    ahead: float,
    lo: int,
    n: int,
    which: Bools | None,
) -> None:
    """Find where the spheres of a block of bodies are, and velocities at the instant of the kick.

    Parameters
    ----------
    model, workspace : ContactModel, Workspace
    rows : ndarray
        The block, the momenta those of the drift before.
    last : ndarray, shape (6, n_bodies)
        Momenta of the drift before that one.
    ahead : float
        By how much of their change the momenta are to be carried on.
    lo, n : int
        First body of the block, and how many there are.
    which : ndarray, shape (n_bodies,), optional
        Whether to look at a body; None: at each.
    """
    spheres, inv_mass, inertia = model.spheres, model.inv_mass, model.inv_inertia
    arm, radius, offset = spheres.arm, spheres.radius, spheres.offset
    xyzr, bodies = workspace.xyzr, workspace.bodies
    for k in range(n):
        b = lo + k
        if which is not None and not which[b]:
            continue
        x, q = get3(rows, COM, k), get4(rows, Q, k)
        R = matrix(q)
        if inv_mass[b] > 0.0:  # others rest, or move as prescribed: see `prescribed_motion`
            p, spin = get3(rows, P, k), get3(rows, L, k)
            p = add_scaled(ahead, subtract(p, column3_at(last, b)), p)
            spin = add_scaled(ahead, subtract(spin, column3_at(last, b, 3)), spin)
            turning = component_product(column3_at(inertia, b), turn_back(R, spin))
            put_velocity(bodies, b, scale(inv_mass[b], p), turn(R, turning))
        put_row3(bodies.position, b, x)
        put_row4(bodies.orientation, b, q)
        bodies.inv_mass[b] = inv_mass[b]
        for i in range(offset[b], offset[b + 1]):
            r = turn(R, column3_at(arm, i))
            xyzr[i, 0], xyzr[i, 1], xyzr[i, 2] = x[0] + r[0], x[1] + r[1], x[2] + r[2]
            xyzr[i, 3] = radius[i]


@inline
def put_velocity(bodies: Records, b: int, v: Vec3, omega: Vec3) -> None:
    """Write how fast body b moves [m/s] and turns [rad/s]."""
    put_row3(bodies.velocity, b, v)
    put_row3(bodies.angular_velocity, b, omega)
    bodies.speed[b], bodies.angular_speed[b] = norm(v), norm(omega)


@inline
def max_speeds(bodies: Records, first: int, end: int, which: Bools | None) -> tuple[float, float]:
    """Largest speed [m/s] and angular speed [rad/s] of bodies first to end, or some of them."""
    v, w = 0.0, 0.0
    for b in range(first, end):
        if which is not None and not which[b]:
            continue
        v, w = max(v, bodies.speed[b]), max(w, bodies.angular_speed[b])
    return v, w


@inline
def max_point_speed(bodies: Records, arm: float, first: int, end: int) -> float:
    """Largest speed [m/s] of points of bodies first to end, within an arm [m] of their centres.

    Twice the speed by turning counts: an asymmetric body may turn faster soon.
    """
    v = 0.0
    for b in range(first, end):
        v = max(v, bodies.speed[b] + 2.0 * arm * bodies.angular_speed[b])
    return v


@inline
def velocity_at(bodies: Records, b: int, point: Vec3) -> Vec3:
    """Velocity of a point of body b [m/s]."""
    arm = subtract(point, row3(bodies.position, b))
    omega = row3(bodies.angular_velocity, b)
    return add_scaled(1.0, cross(omega, arm), row3(bodies.velocity, b))


@inline
def inv_effective_mass(
    model: ContactModel, bodies: Records, b: int, point: Vec3, normal: Vec3
) -> float:
    """What a push along the normal at a point gives the point: 1/M + (r×n)·I⁻¹(r×n) [1/kg]."""
    inertia = model.inv_inertia
    R = matrix(row4(bodies.orientation, b))
    lever = turn_back(R, cross(subtract(point, row3(bodies.position, b)), normal))
    inverse = (inertia[0, b], inertia[1, b], inertia[2, b])
    return bodies.inv_mass[b] + dot(lever, component_product(inverse, lever))


# One contact


@inline
def note_overlap(on: Evaluation, overlap: float, radius: float, b: int, partner: int) -> None:
    """Note that a body lies too deep in another or in a wall, for the host to say."""
    deepest, k = on.workspace.deepest, on.thread
    comes_first = b < deepest[k, 2] or (b == deepest[k, 2] and partner < deepest[k, 3])
    if overlap > deepest[k, 0] or (overlap == deepest[k, 0] and comes_first):
        deepest[k, 0], deepest[k, 1], deepest[k, 2], deepest[k, 3] = overlap, radius, b, partner


@inline
def start_contact(on: Evaluation, pair: int, c: int, inv_mass: float, r_eff: float) -> None:
    """Keep what contact c has as long as it lasts; `inv_mass` is 1/m_eff [1/kg]."""
    history = on.contacts.history
    history.inv_effective_mass[c] = inv_mass
    history.damping[c] = damping_coefficient(on.model.law, pair, inv_mass, r_eff)
    stages = on.contacts.stages
    if stages is not None:  # one that begins within a step has had no spring so far
        put_row3(stages.start, c, ZERO)
        put_row3(stages.total, c, ZERO)
        put_row3(stages.rolling_start, c, ZERO)
        put_row3(stages.rolling_total, c, ZERO)


@inline
def end_contact(on: Evaluation, c: int) -> None:
    """Contact c has no force and no history; it stays so for who looks at a frame."""
    history, forces = on.contacts.history, on.contacts.forces
    put_row3(history.spring, c, ZERO)
    history.overlap[c], history.normal_force[c] = 0.0, 0.0
    history.inv_effective_mass[c], history.damping[c] = 0.0, 0.0
    if on.model.law.rolling is not None:
        put_row3(history.rolling_spring, c, ZERO)
    put_row3(forces.elastic, c, ZERO)
    put_row3(forces.point, c, (_POINT_FAR_AWAY, 0.0, 0.0))
    on.contacts.active[c] = False


@inline
def contact_force(on: Evaluation, pair: int, c: int, now: Collision) -> None:
    """Find the forces of contact c, and keep what the next instant needs.

    The spring grows as the method says: of `strang` by half of the drift before times the sliding
    velocity of the instant before, kept with it, and by the other half with that of now.
    """
    law, before, after, growth = on.model.law, on.before, on.after, on.growth
    history, forces = on.contacts.history, on.contacts.forces
    normal = now.normal
    rate = dot(now.velocity, normal)
    sliding = add_scaled(-rate, normal, now.velocity)
    slid = spring_at(growth, growth.before, row3(history.spring, c), sliding, normal)
    inv_mass, damping = history.inv_effective_mass[c], history.damping[c]
    previous = history.overlap[c] if on.growth.slope is None else now.overlap
    state = ContactState(now.overlap, previous, rate, sliding, inv_mass, damping, now.r_eff)
    rate = corrected_rate(law, pair, state, history.normal_force[c], before)
    state = with_motion(state, rate, sliding)
    pressed = normal_force(law, pair, state, before, after)
    dt = growth.since if growth.since > 0.0 else after  # a kick at rest: half of the same step
    tangential, cut = friction_force(law, pair, state, pressed, slid, dt)
    elastic, force = pressed.elastic, pressed.force
    slides = Sliding(sliding, 1.0, normal, now.turning, False)
    put_row3(history.spring, c, spring_after(on, c, slides, state, (slid, cut)))
    history.overlap[c], history.normal_force[c] = max(now.overlap, 0.0), force
    other = add_scaled(elastic - force, normal, tangential)
    put_row3(forces.elastic, c, scale(-elastic, normal))
    put_row3(forces.other, c, other)
    put_row3(forces.point, c, now.point)
    _resist_rolling(on, pair, c, state, now, pressed)
    forces.elastic_energy[c] = pressed.energy
    forces.correction_time[c] = correction_time(pressed, state, before, after)
    power = -elastic * dot(normal, now.boundary_velocity)
    forces.boundary_power[c] = power
    on_boundary = power + dot(other, now.boundary_velocity)
    forces.gross_power[c] = abs(dot(other, now.velocity)) + abs(on_boundary)


@inline
def _resist_rolling(
    on: Evaluation, pair: int, c: int, state: ContactState, now: Collision, pressed: NormalForce
) -> None:
    """Torque of contact c against rolling, if anything resists."""
    if on.model.law.rolling is None:
        return
    history, law, normal, R = on.contacts.history, on.model.law, now.normal, state.r_eff
    growth = on.growth
    omega = add_scaled(-dot(now.angular_velocity, normal), normal, now.angular_velocity)
    kept = row3(history.rolling_spring, c)
    slid = spring_at(growth, growth.before * R, kept, omega, normal)
    torque, cut = rolling_torque(law, pair, state, omega, pressed, slid, growth.since)
    rolls = Sliding(omega, R, normal, now.turning, True)
    put_row3(history.rolling_spring, c, spring_after(on, c, rolls, state, (slid, cut)))
    put_row3(on.contacts.forces.rolling_torque, c, torque)
