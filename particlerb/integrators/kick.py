"""Kicks at a fixed pose: what all splitting methods have in common.

A kick is the exact flow of the forces while nothing moves, drag included. Two kicks that follow
each other are one of the summed length, so a step leaves its last kick open for the next one.
"""

from typing import Final

import numpy as np

from particlerb.compiled.jit import Flag, inline
from particlerb.forces.kernels import (
    Acting,
    Entry,
    change_of,
    damp,
    flow_in,
    flow_out,
    kick_others,
    kick_potential,
    less_internal,
    load_of_users,
    prepare_kick,
    with_power,
)
from particlerb.forces.registry import CHANGE, PAIR
from particlerb.integrators.external_work import book, kick_entry
from particlerb.maths.quaternion import Matrix, matrix, turn, turn_back
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
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

_ZERO: Final = (0.0, 0.0, 0.0)
_MOST: Final = 70  # passes of three iterations of a flow of users' forces,
_ROUNDING: Final = 4e-16  # until another one would change momenta by such a share
_CHANGES: Final = SCRATCH + 6  # row: 1 until then; before it momenta when the flow began


@inline
def _with_flow(
    flow: Flag, rows: Floats, b: int, x: Vec3, R: Matrix, old: tuple[Vec3, Vec3],
    new: tuple[Vec3, Vec3], entry: Entry,
) -> Entry:  # fmt: skip
    """What is booked, with what a flow did from old to new momenta."""
    if flow is None:
        return entry
    work, dp, dL = kick_entry(rows, b, x, R, old, old, new)
    return work + entry[0], add_scaled(1.0, dp, entry[1]), add_scaled(1.0, dL, entry[2])


@inline
def begin_kick(acting: Acting, books: Flag, rows: Floats, n: int, dt: float) -> None:
    """Before n bodies of a block are kicked; all of it, where a flow takes them at once."""
    _kick_at_once(acting.own_flow, acting, books, rows, n, dt)


@inline
def _kick_at_once(
    own_flow: Flag, acting: Acting, books: Flag, rows: Floats, n: int, dt: float
) -> None:
    """Half a kick, the flow of users' forces that depend on velocities, half a kick."""
    if own_flow is None:
        prepare_kick(acting, rows, n, dt)
        return
    prepare_kick(acting, rows, n, 0.5 * dt)
    for b in range(n):
        _kick_one(acting, books, rows, b, 0.5 * dt)
    flow_block(acting, rows, n, dt)
    for b in range(n):
        x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
        old = get3(rows, SCRATCH, b), get3(rows, SCRATCH + 3, b)
        new = get3(rows, P, b), get3(rows, L, b)
        book(books, rows, b, 1.0, kick_entry(rows, b, x, R, old, old, new))
        _kick_one(acting, books, rows, b, 0.5 * dt)


@inline
def flow_block(acting: Acting, rows: Floats, n: int, dt: float) -> None:
    """Flow of users' forces at a fixed pose by the implicit midpoint rule, iterated to rounding.

    A block iterates in SIMD lanes; a body that has converged keeps what it has, so that no body
    depends on its neighbours. Where one does not converge it is lost: NaN.
    """
    for b in range(n):
        put3(rows, SCRATCH, b, get3(rows, P, b))
        put3(rows, SCRATCH + 3, b, get3(rows, L, b))
        put(rows, _CHANGES, b, 1.0)
    for _ in range(_MOST):
        many = 0
        for b in range(n):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            start = get3(rows, SCRATCH, b), get3(rows, SCRATCH + 3, b)
            first = get3(rows, P, b), get3(rows, L, b)
            second = _iterated(acting, rows, b, x, R, dt, start, first)
            third = _iterated(acting, rows, b, x, R, dt, start, second)
            fourth = _iterated(acting, rows, b, x, R, dt, start, third)
            changes = get(rows, _CHANGES, b) > 0.0
            put3(rows, P, b, _one_of(changes, fourth[0], first[0]))
            put3(rows, L, b, _one_of(changes, fourth[1], first[1]))
            changes = changes & (
                _differs(second[0], third[0], fourth[0]) | _differs(second[1], third[1], fourth[1])
            )
            put(rows, _CHANGES, b, 1.0 if changes else 0.0)
            many += 1 if changes else 0
        if many == 0:
            return
    for b in range(n):
        if get(rows, _CHANGES, b) > 0.0:
            put3(rows, P, b, (np.nan, np.nan, np.nan))


@inline
def _iterated(
    acting: Acting, rows: Floats, b: int, x: Vec3, R: Matrix, dt: float,
    start: tuple[Vec3, Vec3], end: tuple[Vec3, Vec3],
) -> tuple[Vec3, Vec3]:  # fmt: skip
    """Momenta at the end of a flow, by the loads half way to where it seemed to end."""
    p, spin = (
        scale(0.5, add_scaled(1.0, start[0], end[0])),
        scale(0.5, add_scaled(1.0, start[1], end[1])),
    )
    F, tau = load_of_users(acting, rows, b, x, R, p, spin, _ZERO, _ZERO)
    return add_scaled(dt, F, start[0]), add_scaled(dt, tau, start[1])


@inline
def _differs(a: Vec3, b: Vec3, c: Vec3) -> bool:
    """Whether the iterate after c will differ by more than rounding; not if it is not finite.

    Changes shrink in proportion, here from |b - a| to |c - b|.
    """
    before = abs(b[0] - a[0]) + abs(b[1] - a[1]) + abs(b[2] - a[2])
    change = abs(c[0] - b[0]) + abs(c[1] - b[1]) + abs(c[2] - b[2])
    size = abs(c[0]) + abs(c[1]) + abs(c[2])
    return (change > _ROUNDING * size) & (change * change > _ROUNDING * size * before)


@inline
def _one_of(is_first: bool, a: Vec3, b: Vec3) -> Vec3:
    """A or b, without a branch."""
    return a[0] if is_first else b[0], a[1] if is_first else b[1], a[2] if is_first else b[2]


@inline
def kick_body(
    acting: Acting, books: Flag, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Matrix]:
    """Kick body b over dt after `begin_kick`; its new momenta, stored, and its rotation matrix."""
    return _unless_kicked(acting.own_flow, acting, books, rows, b, dt)


@inline
def _unless_kicked(
    own_flow: Flag, acting: Acting, books: Flag, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Matrix]:
    """The same, where `begin_kick` has not done all of it."""
    if own_flow is None:
        return _kick_one(acting, books, rows, b, dt)
    return get3(rows, P, b), get3(rows, L, b), matrix(get4(rows, Q, b))


@inline
def _kick_one(
    acting: Acting, books: Flag, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Matrix]:
    """Do the work of `kick_body`."""
    x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
    old = get3(rows, P, b), get3(rows, L, b)
    first = flow_in(acting, rows, b, R, 0.5 * dt, old[0], old[1])
    middle = kick_potential(acting, rows, b, x, R, dt, first[0], first[1])
    p, L_new = kick_others(acting, rows, b, x, R, dt, middle[0], middle[1])
    last = damp(acting, rows, b, R, first[0], first[1], p, L_new)
    p, L_new = flow_out(acting, rows, b, R, 0.5 * dt, last[0], last[1])
    put3(rows, P, b, p)
    put3(rows, L, b, L_new)
    entry = kick_entry(rows, b, x, R, first, middle, last)
    entry = _with_flow(acting.flow, rows, b, x, R, old, first, entry)
    entry = _with_flow(acting.flow, rows, b, x, R, last, (p, L_new), entry)
    entry = with_power(acting.clock, acting, rows, b, x, R, dt, entry)
    book(books, rows, b, 1.0, less_internal(acting.pair, acting.contact, rows, b, x, dt, entry))
    return p, L_new, R


@inline
def _less_change(
    pair: int | None, rows: Floats, b: int, x: Vec3, v: Vec3, weight: float, entry: Entry
) -> Entry:
    """What is booked, without what the gradients of other bodies' forces give.

    As a rate, that of x × F + τ has the part v × F.
    """
    if pair is None:
        return entry
    work, impulse, angular = entry
    F, tau = get3(rows, CHANGE, b), get3(rows, CHANGE + TORQUE, b)
    turning = add_scaled(1.0, cross(x, F), add_scaled(1.0, cross(v, get3(rows, PAIR, b)), tau))
    F = subtract(F, get3(rows, CHANGE + OUTSIDE, b))
    turning = subtract(turning, get3(rows, CHANGE + OUTSIDE + 3, b))
    return work, add_scaled(-weight, F, impulse), add_scaled(-weight, turning, angular)


@inline
def kick_bent(
    bent: Flag, acting: Acting, books: Flag, rows: Floats, b: int, dt: float, weight: float
) -> tuple[Vec3, Matrix]:
    """Kick body b over dt, bent by the gradient or not; L, which is stored with p, and R.

    `weight` [s³] is that of the rates at which force and torque change: see `force_gradient`.
    """
    if bent is None:
        _, spin, R = kick_body(acting, books, rows, b, dt)
        return spin, R
    x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
    old = get3(rows, P, b), get3(rows, L, b)
    F, tau = kick_potential(acting, rows, b, x, R, 1.0, _ZERO, _ZERO)
    v = scale(get(rows, INV_MASS, b), F)
    w = turn(R, component_product(get3(rows, INV_INERTIA, b), turn_back(R, tau)))
    dF, dtau = change_of(acting, rows, b, x, R, (v, w), _ZERO, _ZERO)
    p = add_scaled(weight, dF, add_scaled(dt, F, old[0]))
    spin = add_scaled(weight, dtau, add_scaled(dt, tau, old[1]))
    put3(rows, P, b, p)
    put3(rows, L, b, spin)
    entry = kick_entry(rows, b, x, R, old, (p, spin), (p, spin))
    entry = less_internal(acting.pair, None, rows, b, x, dt, entry)
    book(books, rows, b, 1.0, _less_change(acting.pair, rows, b, x, v, weight, entry))
    return spin, R
