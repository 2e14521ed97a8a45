"""How tangential springs grow between the evaluations of a method.

ξ̇ = v - (ξ·ṅ) n - max(k̇/k, 0) ξ

v slides, the second term turns ξ with the normal n, the third keeps the force of a spring that
becomes stiffer (`hertz`: k ∝ √δ). Methods with one evaluation a step take v for a time before and
after it, turn ξ by `rotated_spring`, and let `friction` keep the force. Those with several slopes
take all three terms at each: turned by `rotated_spring` alone, they would be of order one. All cut
ξ to the limit of friction once a step.
"""

from typing import NamedTuple

from particlerb.compiled.jit import inline
from particlerb.contact.contact_model import Evaluation, Growth
from particlerb.contact.friction import rotated_spring
from particlerb.contact.law import ContactState, Law
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, dot, scale, subtract


class Sliding(NamedTuple):
    """How what touches slides, or rolls."""

    velocity: Vec3  # [m/s] or [rad/s], in the tangent plane
    lever: float  # 1, or the radius [m] by which angles count
    normal: Vec3
    turning: Vec3  # [1/s] ṅ, where a method asks for it
    is_rolling: bool


@inline
def spring_at(growth: Growth, before: float, kept: Vec3, sliding: Vec3, normal: Vec3) -> Vec3:
    """Spring [m] at an evaluation, from what was kept, in the tangent plane."""
    if growth.slope is None:
        return add_scaled(before, sliding, rotated_spring(kept, normal))
    if growth.slope.is_first:
        return rotated_spring(kept, normal)
    return add_scaled(-dot(kept, normal), normal, kept)


@inline
def _lost_share(law: Law, state: ContactState, step: float) -> float:
    """Share of a spring that the force kept of a stiffer one takes in a step, at most all of it."""
    if law.hertz is None:
        return 0.0
    lost = 0.5 * step * state.overlap_rate
    if lost <= 0.0:
        return 0.0
    return lost / state.overlap if lost < state.overlap else 1.0


@inline
def spring_after(
    on: Evaluation, c: int, now: Sliding, state: ContactState, springs: tuple[Vec3, Vec3]
) -> Vec3:
    """Spring [m] to be kept until the next evaluation.

    Parameters
    ----------
    on, c : Evaluation, int
    now : Sliding
    state : ContactState
    springs : tuple of two vectors [m]
        As it was at this evaluation, and cut to the limit of friction.
    """
    spring, cut = springs
    slope, stages = on.growth.slope, on.contacts.stages
    if slope is None:
        return add_scaled(on.growth.after * now.lever, now.velocity, cut)
    if stages is None:
        return cut
    start: Floats = stages.rolling_start if now.is_rolling else stages.start
    total: Floats = stages.rolling_total if now.is_rolling else stages.total
    if slope.is_first:
        spring = cut
        put_row3(start, c, cut)
        put_row3(total, c, cut)
    turned = add_scaled(-dot(spring, now.turning), now.normal, scale(now.lever, now.velocity))
    lost = _lost_share(on.model.law, state, slope.step)
    change = subtract(scale(slope.step, turned), scale(lost, spring))
    put_row3(total, c, add_scaled(slope.share, change, row3(total, c)))
    if slope.ahead > 0.0:
        return add_scaled(slope.ahead, change, row3(start, c))
    return row3(total, c)
