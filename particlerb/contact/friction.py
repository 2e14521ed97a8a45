"""Friction and rolling resistance of one contact: a spring, a dashpot and a slider.

The tangential spring, its damping and its limit are described in `law`.
"""

import math

from particlerb.compiled.jit import inline
from particlerb.contact.law import ContactState, Law, NormalForce, with_motion
from particlerb.maths.vec3 import ZERO, Vec3, add_scaled, dot, scale


@inline
def mean_root(before: float, now: float) -> float:
    """Mean of √x between two values."""
    if now <= 0.0:
        return 0.0
    a, b = math.sqrt(max(before, 0.0)), math.sqrt(now)
    return (2.0 / 3.0) * (b + a * a / (a + b))


@inline
def time_in_contact(state: ContactState, dt: float) -> float:
    """Part of the last dt [s] that the two have touched."""
    if state.previous_overlap > 0.0:
        return dt
    if state.overlap <= 0.0 or state.overlap_rate <= 0.0:
        return 0.0
    return min(dt, state.overlap / state.overlap_rate)


@inline
def tangential_stiffness(law: Law, pair: int, state: ContactState) -> tuple[float, float, float]:
    """k_t [N/m] at the instant before, its mean since then, and now."""
    k = law.tangential_stiffness[pair]
    if law.hertz is None:
        return k, k, k
    k *= 8.0 * math.sqrt(state.r_eff)
    before = math.sqrt(max(state.previous_overlap, 0.0))
    now = math.sqrt(max(state.overlap, 0.0))
    return k * before, k * mean_root(state.previous_overlap, state.overlap), k * now


@inline
def rotated_spring(spring: Vec3, normal: Vec3) -> Vec3:
    """Spring in the tangent plane of a normal that has turned since, with its old length."""
    in_plane = add_scaled(-dot(spring, normal), normal, spring)
    square = dot(in_plane, in_plane)
    if square == 0.0:
        return 0.0, 0.0, 0.0
    return scale(math.sqrt(dot(spring, spring) / square), in_plane)


@inline
def _limited(force: Vec3, limit: float) -> Vec3:
    """Force of at most this size."""
    square = dot(force, force)
    return scale(limit / math.sqrt(square), force) if square > limit * limit else force


@inline
def _spring_and_slider(
    state: ContactState,
    stiffness: tuple[float, float, float],
    c: float,
    limit: float,
    spring: Vec3,
    dt: float,
) -> tuple[Vec3, Vec3]:
    """Force [N] of spring and dashpot, both cut at a limit, and the new spring [m]."""
    k_before, k_mean, k = stiffness
    v, elapsed = state.sliding_velocity, time_in_contact(state, dt)
    if state.previous_overlap <= 0.0:
        spring = scale(elapsed, v)
    f = scale(k, spring)
    if k_before < k:
        f = add_scaled(k_mean * elapsed, v, scale(k_before, add_scaled(-elapsed, v, spring)))
    f = _limited(f, limit)
    cut_spring = scale(1.0 / k, f) if k > 0.0 else (0.0, 0.0, 0.0)
    return _limited(add_scaled(c, v, f), limit), cut_spring


@inline
def friction_force(
    law: Law, pair: int, state: ContactState, normal: NormalForce, spring: Vec3, dt: float
) -> tuple[Vec3, Vec3]:
    """Tangential force [N] on the first, for a kick, and the spring [m] to be kept.

    Parameters
    ----------
    law, pair, state
        As for `normal_force`.
    normal : NormalForce
        Its limit is μ times this.
    spring : tuple of 3 floats [m]
        The spring of the instant before, turned with the normal (`rotated_spring`), plus what the
        two have slid since, the drift before times the sliding velocity half-way. Of no account
        where `state.previous_overlap` is 0.
    dt : float [s]
        Length of the drift before.
    """
    limit = law.friction[pair] * max(normal.force, 0.0)
    c = law.tangential_damping[pair] * normal.damping
    stiffness = tangential_stiffness(law, pair, state)
    force, spring = _spring_and_slider(state, stiffness, c, limit, spring, dt)
    return scale(-1.0, force), spring


@inline
def rolling_torque(
    law: Law, pair: int, state: ContactState, angular_velocity: Vec3, normal: NormalForce,
    spring: Vec3, dt: float,
) -> tuple[Vec3, Vec3]:  # fmt: skip
    """Torque [N m] on the first against rolling, and the spring [m] to be kept.

    The law of sliding with R* times angles, cut at μ_r R* F_n, with k_t R*² for the stiffness,
    after Iwashita and Oda, and χ c R*² for the dashpot.

    Parameters
    ----------
    law, pair, state, normal
        As for `friction_force`; the sliding velocity is not used.
    angular_velocity : tuple of 3 floats [rad/s]
        Of the first relative to the second, without its part along the normal.
    spring : tuple of 3 floats [m]
        R* times the angle of the instant before, turned, plus R* times the drift before times the
        angular velocity half-way.
    dt : float [s]
        Length of the drift before.
    """
    R = state.r_eff
    if law.rolling is None:
        return ZERO, spring
    rolling_state = with_motion(state, state.overlap_rate, scale(R, angular_velocity))
    stiffness = tangential_stiffness(law, pair, state)
    c = law.tangential_damping[pair] * normal.damping
    limit = law.rolling[pair] * max(normal.force, 0.0)
    force, spring = _spring_and_slider(rolling_state, stiffness, c, limit, spring, dt)
    return scale(-R, force), spring
