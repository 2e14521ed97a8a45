"""Kicks at a fixed pose: what all splitting methods have in common.

A kick is the exact flow of the forces while nothing moves, drag included. Two kicks that follow
each other are one of the summed length, so a step leaves its last kick open for the next one.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag, inline
from particlerb.forces.kernels import (
    Acting,
    Entry,
    change_of,
    change_of_others,
    damp,
    flow_in,
    flow_out,
    kick_others,
    kick_potential,
    less_internal,
    load_of_users,
    prepare_kick,
    shift_time,
    with_power,
)
from particlerb.forces.kinds import Momenta
from particlerb.forces.registry import CHANGE, PAIR
from particlerb.integrators.external_work import add_entry, entry_of_kick
from particlerb.maths.quaternion import Matrix, matrix, tensor, turn, turn_back
from particlerb.maths.vec3 import (
    ZERO,
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.block import (
    COM,
    INV_INERTIA,
    INV_MASS,
    SCRATCH,
    L,
    P,
    Q,
    get,
    get3,
    get4,
    put,
    put3,
)
from particlerb.model.load import OUTSIDE, TORQUE

_BODIES_TOGETHER: Final = 64  # that iterate
_MAX_ITERATION_PAIRS: Final = 100  # beside the first four
_LEAST_CHANGE: Final = 4e-16  # share of momenta: iterations end before one that changes less
_CHANGES_ROW: Final = SCRATCH + 6  # 1 until momenta change no more; before it old momenta


@inline
def _with_flow(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, old: Momenta, new: Momenta,
    entry: Entry,
) -> Entry:  # fmt: skip
    """External work, with what a flow did from old to new momenta."""
    if acting.flow is None:
        return entry
    work, dp, dL = entry_of_kick(rows, b, x, R, old, old, new)
    return work + entry[0], add_scaled(1.0, dp, entry[1]), add_scaled(1.0, dL, entry[2])


class _Kick(NamedTuple):
    """A kick of a body but for what depends on velocities: pairs of p and L."""

    x: Vec3
    R: Matrix
    old: Momenta
    first: Momenta  # after half of the flows
    middle: Momenta  # with the forces that have a potential
    last: Momenta  # with all of the pose
    inverse: Matrix  # R I⁻¹ Rᵀ [1/(kg m²)]


@inline
def solve_kicks(acting: Acting, rows: Floats, n: int, dt: float) -> None:
    """Before n bodies of a block are kicked over dt, find what users' forces do to them.

    Those that take velocities act by the implicit midpoint rule, iterated to rounding in SIMD
    lanes; a body that has converged keeps what it has, so that none depends on its neighbours.
    Where one does not converge it is lost: NaN. As many as the first level of the cache has go
    together.
    """
    prepare_kick(acting, rows, n, dt)
    if acting.user_flow is None:
        return
    for first in range(0, n, _BODIES_TOGETHER):
        _solve_some_kicks(acting, rows, first, min(first + _BODIES_TOGETHER, n), dt)


@inline
def _solve_some_kicks(acting: Acting, rows: Floats, first: int, end: int, dt: float) -> None:
    """The same, of bodies `first` to `end`, `end` excluded."""
    many = 0
    for b in range(first, end):
        old = get3(rows, P, b), get3(rows, L, b)
        put3(rows, SCRATCH, b, old[0])
        put3(rows, SCRATCH + 3, b, old[1])
        kick = _kick_of(acting, rows, b, dt, old)
        guess = _iterated(
            acting, rows, b, kick, dt, _iterated(acting, rows, b, kick, dt, kick.last)
        )
        many += _iterate(acting, rows, b, kick, dt, guess, True)
    for _ in range(_MAX_ITERATION_PAIRS):
        if many == 0:
            return
        many = 0
        for b in range(first, end):
            old = get3(rows, SCRATCH, b), get3(rows, SCRATCH + 3, b)
            kick, guess = _kick_of(acting, rows, b, dt, old), (get3(rows, P, b), get3(rows, L, b))
            many += _iterate(acting, rows, b, kick, dt, guess, get(rows, _CHANGES_ROW, b) > 0.0)
    for b in range(first, end):
        if get(rows, _CHANGES_ROW, b) > 0.0:
            put3(rows, P, b, (np.nan, np.nan, np.nan))


@inline
def _iterate(
    acting: Acting, rows: Floats, b: int, kick: _Kick, dt: float, guess: Momenta, changes: bool
) -> int:
    """Two iterations of body b from a guess, unless it has converged; 1 if it needs more."""
    second = _iterated(acting, rows, b, kick, dt, guess)
    third = _iterated(acting, rows, b, kick, dt, second)
    p, spin = _one_of(changes, third, guess)
    put3(rows, P, b, p)
    put3(rows, L, b, spin)
    more = _differs(guess[0], second[0], third[0], kick.first[0], kick.last[0])
    more = more | _differs(guess[1], second[1], third[1], kick.first[1], kick.last[1])
    more = more & changes
    put(rows, _CHANGES_ROW, b, 1.0 if more else 0.0)
    return 1 if more else 0


@inline
def _iterated(
    acting: Acting, rows: Floats, b: int, kick: _Kick, dt: float, estimate: Momenta
) -> Momenta:
    """Momenta at the end of a kick, by the loads half way to an estimate of them."""
    (p0, L0), (p, spin) = kick.first, estimate
    v = scale(0.5 * get(rows, INV_MASS, b), add_scaled(1.0, p0, p))
    omega = turn(kick.inverse, scale(0.5, add_scaled(1.0, L0, spin)))
    F, tau = load_of_users(acting, rows, b, kick.x, kick.R, v, omega, ZERO, ZERO)
    p, spin = add_scaled(dt, F, kick.last[0]), add_scaled(dt, tau, kick.last[1])
    return damp(acting, rows, b, kick.R, p0, L0, p, spin)


@inline
def _differs(a: Vec3, b: Vec3, c: Vec3, first: Vec3, last: Vec3) -> bool:
    """Whether the iterate after c will differ by more than rounding; not if it is not finite.

    Changes shrink in proportion, here from |b - a| to |c - b|. Rounding is that of the largest of
    c and what it is a sum of: momenta before the kick, and after it by all other forces.
    """
    before = abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(b[2] - a[2])
    change = abs(c[0] - b[0]) + abs(c[1] - b[1]) + abs(c[2] - b[2])
    size = abs(c[0]) + abs(c[1]) + abs(c[2])
    size += abs(first[0]) + abs(first[1]) + abs(first[2])
    size += abs(last[0]) + abs(last[1]) + abs(last[2])
    return (change > _LEAST_CHANGE * size) & (change * change > _LEAST_CHANGE * size * before)


@inline
def _one_of(is_first: bool, a: Momenta, b: Momenta) -> Momenta:
    """A or b, without a branch."""
    (p, q), (u, v) = a, b
    return (
        (p[0] if is_first else u[0], p[1] if is_first else u[1], p[2] if is_first else u[2]),
        (q[0] if is_first else v[0], q[1] if is_first else v[1], q[2] if is_first else v[2]),
    )


@inline
def kick_body(
    acting: Acting, sums_external: Flag, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Matrix]:
    """Kick body b over dt after `solve_kicks`; its new momenta, stored, and its rotation matrix."""
    if acting.user_flow is None:
        kick = _kick_of(acting, rows, b, dt, (get3(rows, P, b), get3(rows, L, b)))
        (p, spin), (p_last, L_last) = kick.first, kick.last
        last = damp(acting, rows, b, kick.R, p, spin, p_last, L_last)
    else:
        kick = _kick_of(acting, rows, b, dt, (get3(rows, SCRATCH, b), get3(rows, SCRATCH + 3, b)))
        last = get3(rows, P, b), get3(rows, L, b)
    p, spin = flow_out(acting, rows, b, kick.R, 0.5 * dt, last[0], last[1])
    put3(rows, P, b, p)
    put3(rows, L, b, spin)
    add_entry(sums_external, rows, b, 1.0, _entry_of(acting, rows, b, dt, kick, last, (p, spin)))
    return p, spin, kick.R


@inline
def _kick_of(acting: Acting, rows: Floats, b: int, dt: float, old: Momenta) -> _Kick:
    """A kick of body b but for what depends on velocities, and the second half of the flows."""
    x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
    first = flow_in(acting, rows, b, R, 0.5 * dt, old[0], old[1])
    middle = kick_potential(acting, rows, b, x, R, dt, first[0], first[1])
    last = kick_others(acting, rows, b, x, R, dt, middle[0], middle[1])
    return _Kick(x, R, old, first, middle, last, tensor(R, get3(rows, INV_INERTIA, b)))


@inline
def _entry_of(
    acting: Acting, rows: Floats, b: int, dt: float, kick: _Kick, last: Momenta, end: Momenta
) -> Entry:
    """Entry of a kick that came to `last` before the second half of the flows, and then `end`."""
    x, R = kick.x, kick.R
    entry = entry_of_kick(rows, b, x, R, kick.first, kick.middle, last)
    entry = _with_flow(acting, rows, b, x, R, kick.old, kick.first, entry)
    entry = _with_flow(acting, rows, b, x, R, last, end, entry)
    entry = with_power(acting, rows, b, x, R, dt, entry)
    return less_internal(acting, rows, b, x, dt, entry)


@inline
def _less_change(
    acting: Acting, rows: Floats, b: int, x: Vec3, v: Vec3, weight: float, entry: Entry
) -> Entry:
    """External work, without what the gradients of other bodies' forces give.

    As a rate, that of x × F + τ has the part v × F.
    """
    if acting.pair is None:
        return entry
    work, impulse, angular = entry
    F, tau = get3(rows, CHANGE, b), get3(rows, CHANGE + TORQUE, b)
    turning = add_scaled(1.0, cross(x, F), add_scaled(1.0, cross(v, get3(rows, PAIR, b)), tau))
    F = subtract(F, get3(rows, CHANGE + OUTSIDE, b))
    turning = subtract(turning, get3(rows, CHANGE + OUTSIDE + 3, b))
    return work, add_scaled(-weight, F, impulse), add_scaled(-weight, turning, angular)


class KickAndDrift(NamedTuple):
    """A kick, and the drift after it."""

    kick: float  # [s]
    weight: float  # [s³] of the gradient, where the kick is bent by it: see `force_gradient`
    before: float  # [s] since the step began, when it is made
    drift: float  # [s]
    share: float  # of the step that the drift takes, by which maps are cut; 0: they are not
    is_first: bool  # of the step


@inline
def _velocities(rows: Floats, b: int, R: Matrix, p: Vec3, L: Vec3) -> Momenta:
    """p/M and R I⁻¹ Rᵀ L of body b; of loads, accelerations of a body at rest."""
    omega = turn(R, component_product(get3(rows, INV_INERTIA, b), turn_back(R, L)))
    return scale(get(rows, INV_MASS, b), p), omega


@inline
def _mixed_work(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, mean: Momenta,
    torques: Momenta, moved: tuple[Momenta, Momenta],
) -> float:  # fmt: skip
    """What a bent kick adds to the work of loads without potential, beside those that have one.

    With the work as one more variable that kicks change, it is the rest of the commutator of
    (9.2) once the momenta have their part; both kinds of loads have torques, and accelerations.
    """
    (v, w), (tau, sigma), (own, other) = _velocities(rows, b, R, *mean), torques, moved
    dF, dtau = change_of(acting, rows, b, x, R, (v, w), ZERO, ZERO)
    dG, dsigma = change_of_others(acting, rows, b, x, R, (v, w), ZERO, ZERO)
    work = dot(dG, own[0]) + dot(dsigma, own[1]) - dot(dF, other[0]) - dot(dtau, other[1])
    work -= 2.0 * dot(other[1], cross(own[1], mean[1]))
    return work - dot(other[1], cross(w, tau)) + dot(sigma, cross(own[1], w))


@inline
def _hastened_work(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, move: KickAndDrift, now: Momenta,
    own: Momenta,
) -> float:  # fmt: skip
    """The same of loads, now and at the end of a kick, that are linear in time."""
    if acting.clock is None:
        return 0.0
    shift_time(acting, rows, b, move.before + move.kick)
    F, tau = kick_others(acting, rows, b, x, R, 1.0, ZERO, ZERO)
    return (dot(subtract(F, now[0]), own[0]) + dot(subtract(tau, now[1]), own[1])) / move.kick


@inline
def kick_with_gradient(
    gradient: Flag, acting: Acting, sums_external: Flag, rows: Floats, b: int, move: KickAndDrift
) -> tuple[Vec3, Matrix]:
    """Kick body b, bent by the gradient or not; L, which is stored with p, and R."""
    dt, weight = move.kick, move.weight
    shift_time(acting, rows, b, move.before)
    if gradient is None:
        _, spin, R = kick_body(acting, sums_external, rows, b, dt)
        return spin, R
    x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
    old = get3(rows, P, b), get3(rows, L, b)
    F, tau = kick_potential(acting, rows, b, x, R, 1.0, ZERO, ZERO)
    own, G, sigma = _velocities(rows, b, R, F, tau), ZERO, ZERO
    v, w = own
    if acting.others is not None:
        G, sigma = kick_others(acting, rows, b, x, R, 1.0, ZERO, ZERO)
        other = _velocities(rows, b, R, G, sigma)
        v, w = add_scaled(1.0, other[0], v), add_scaled(1.0, other[1], w)
    dF, dtau = change_of(acting, rows, b, x, R, (v, w), ZERO, ZERO)
    p = add_scaled(weight, dF, add_scaled(dt, F, old[0]))
    spin = add_scaled(weight, dtau, add_scaled(dt, tau, old[1]))
    middle = p, spin
    if acting.others is not None:
        dF, dtau = change_of_others(acting, rows, b, x, R, (v, w), ZERO, ZERO)
        p = add_scaled(weight, dF, add_scaled(dt, G, p))
        spin = add_scaled(weight, dtau, add_scaled(dt, sigma, spin))
    put3(rows, P, b, p)
    put3(rows, L, b, spin)
    work, impulse, angular = entry_of_kick(rows, b, x, R, old, middle, (p, spin))
    if acting.others is not None and sums_external is not None:
        mean = scale(0.5, add_scaled(1.0, old[0], p)), scale(0.5, add_scaled(1.0, old[1], spin))
        rate = _mixed_work(acting, rows, b, x, R, mean, (tau, sigma), (own, other))
        rate += _hastened_work(acting, rows, b, x, R, move, (G, sigma), own)
        work += 0.5 * weight * rate
    entry = less_internal(acting, rows, b, x, dt, (work, impulse, angular))
    add_entry(sums_external, rows, b, 1.0, _less_change(acting, rows, b, x, v, weight, entry))
    return spin, R
