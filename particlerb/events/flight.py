"""Bodies between collisions: where they are, how fast, and how they turn, in closed form."""

import math

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.events import records as col
from particlerb.events.records import EventScene, EventState
from particlerb.maths.quaternion import Matrix, Quat, matrix, normalised, to_body, turn, turn_back
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import (
    ZERO,
    Floats,
    Ints,
    Vec3,
    add_scaled,
    component_product,
    dot,
    norm,
    scale,
)
from particlerb.model.state import State
from particlerb.rotors.single_turn import set_steady_turn, set_turn, steadily_turned, turned


@inline
def pull(scene: EventScene, b: int) -> Vec3:
    """Acceleration of a body [m/s²]."""
    if b >= scene.n_moving:
        return ZERO
    return scene.gravity


@inline
def flight_at(scene: EventScene, state: EventState, b: int, t: float) -> tuple[Vec3, Vec3]:
    """Centre of mass [m] and velocity [m/s] of a body at a time."""
    x, v, g = row3(state.flight, b), row3(state.flight, b, col.FLIGHT_V), pull(scene, b)
    h = t - state.flight[b, col.SINCE]
    mean = add_scaled(0.5 * h, g, v)
    return add_scaled(h, mean, x), add_scaled(h, g, v)


@inline
def in_box(box: tuple[Vec3, Vec3] | None, d: Vec3) -> Vec3:
    """Shortest of the vectors from a point to the images of another, of that to one of them [m]."""
    if box is None:
        return d
    side, inverse = box
    return (
        d[0] - side[0] * np.rint(d[0] * inverse[0]),
        d[1] - side[1] * np.rint(d[1] * inverse[1]),
        d[2] - side[2] * np.rint(d[2] * inverse[2]),
    )


@inline
def orientation_at(scene: EventScene, state: EventState, b: int, t: float) -> Quat:
    """Orientation of a body at a time, rotor frame to world."""
    if scene.turns is None:
        return steadily_turned(state.turn, b, t - state.spin[b, col.TURNED])
    return turned(state.turn, b, t - state.spin[b, col.TURNED])


@inline
def angular_velocity(scene: EventScene, state: EventState, b: int, R: Matrix) -> Vec3:
    """Angular velocity [rad/s] of a body that is turned by R, world axes."""
    m = turn_back(R, row3(state.spin, b))
    return turn(R, component_product(row3(scene.body, b, col.BODY_INV_INERTIA), m))


@inline
def set_spin(scene: EventScene, state: EventState, b: int, t: float, q: Quat, spin: Vec3) -> None:
    """Let a body turn from a time on, from q with the angular momentum `spin` [kg m²/s].

    |ω| is at most √(2 T/I), and |L|/I, with the smallest moment I. In the rotor frame
    ω̇_i = (I_j - I_k) ω_j ω_k / I_i, so that |ω̇| <= max |I_j - I_k|/I_i |ω|²/√3; points at r
    are accelerated by (|ω̇| + |ω|²) r at most.
    """
    q, inverse = normalised(q), row3(scene.body, b, col.BODY_INV_INERTIA)
    put_row3(state.spin, b, spin, col.SPIN_L)
    state.spin[b, col.TURNED] = t
    if scene.turns is None:
        set_steady_turn(state.turn, b, inverse, q, spin)
    else:
        inertia = row3(scene.body, b, col.BODY_INERTIA)
        is_asymmetric = scene.kind[b, col.IS_ASYMMETRIC] == 1
        set_turn(state.turn, b, inertia, inverse, is_asymmetric, q, spin)
    m = to_body(q, spin)
    largest = max(inverse[0], inverse[1], inverse[2])
    fastest = math.sqrt(largest * dot(m, component_product(inverse, m)))
    fastest = min(fastest, largest * norm(spin))
    state.spin[b, col.FASTEST] = fastest
    state.spin[b, col.BEND] = scene.body[b, col.BODY_CURVED] * fastest * fastest


@inline
def bring(scene: EventScene, state: EventState, b: int, t: float) -> None:
    """End a flight at a time, and begin the next one there."""
    if b >= scene.n_moving:
        return
    x, v = flight_at(scene, state, b, t)
    add_moment(scene, state, b, t, state.sums, col.MOMENT)
    put_row3(state.flight, b, x, col.FLIGHT_X)
    put_row3(state.flight, b, v, col.FLIGHT_V)
    state.flight[b, col.SINCE] = t


@inline
def add_moment(scene: EventScene, state: EventState, b: int, t: float, to: Floats, at: int) -> None:
    """Add m ∫ x dt of a flight until a time [kg m s] to three numbers from `at` on."""
    h = t - state.flight[b, col.SINCE]
    x, v, g = row3(state.flight, b), row3(state.flight, b, col.FLIGHT_V), pull(scene, b)
    mass = scene.body[b, col.BODY_MASS]
    path = scale(mass * h, x)
    path = add_scaled(0.5 * mass * h * h, v, path)
    path = add_scaled(mass * h * h * h / 6.0, g, path)
    for k in range(3):
        to[at + k] += path[k]


@kernel
def states_at(
    scene: EventScene, state: EventState, t: float, to: Ints, out: State, moment: Floats
) -> None:
    """Write the states of all bodies at a time; m ∫ x dt of all flights until then.

    Parameters
    ----------
    to : ndarray, shape (n,)
        Column of `out` of each body.
    """
    for k in range(3):
        moment[k] = state.sums[col.MOMENT + k]
    for b in range(state.event.shape[0]):
        i = to[b]
        x, v = flight_at(scene, state, b, t)
        q, spin = orientation_at(scene, state, b, t), row3(state.spin, b)
        if b < scene.n_moving:
            add_moment(scene, state, b, t, moment, 0)
        p = scale(scene.body[b, col.BODY_MASS], v)
        for k in range(3):
            out.com[k, i], out.p[k, i], out.L[k, i] = x[k], p[k], spin[k]
        for k in range(4):
            out.q[k, i] = q[k]


@inline
def set_flight(scene: EventScene, state: EventState, b: int, initial: State, i: int) -> None:
    """Flight of a body from time 0 on, from column i of initial states."""
    x = (initial.com[0, i], initial.com[1, i], initial.com[2, i])
    p = (initial.p[0, i], initial.p[1, i], initial.p[2, i])
    spin = (initial.L[0, i], initial.L[1, i], initial.L[2, i])
    put_row3(state.flight, b, x, col.FLIGHT_X)
    put_row3(state.flight, b, scale(scene.body[b, col.BODY_INV_MASS], p), col.FLIGHT_V)
    q = (initial.q[0, i], initial.q[1, i], initial.q[2, i], initial.q[3, i])
    set_spin(scene, state, b, 0.0, q, spin)


@inline
def posed(scene: EventScene, state: EventState, b: int, t: float) -> tuple[Matrix, Vec3]:
    """Rotation matrix of a body at a time, and its angular velocity; of a ball at rest in it."""
    R = matrix(orientation_at(scene, state, b, t))
    return R, angular_velocity(scene, state, b, R)
