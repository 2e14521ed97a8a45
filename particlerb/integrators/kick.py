"""Kicks at a fixed pose: what all splitting methods have in common.

A kick is the exact flow of the forces while nothing moves, drag included. Two kicks that follow
each other are one of the summed length, so a step leaves its last kick open for the next one.
"""

from typing import Final

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
    with_power,
)
from particlerb.forces.registry import CHANGE, PAIR
from particlerb.integrators.external_work import book, kick_entry
from particlerb.maths.quaternion import Rows, matrix, turn, turn_back
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
    scale,
    subtract,
)
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, L, P, Q, get, get3, get4, put3
from particlerb.model.load import OUTSIDE, TORQUE

_ZERO: Final = (0.0, 0.0, 0.0)


@inline
def _with_flow(
    flow: Flag, rows: Floats, b: int, x: Vec3, R: Rows, old: tuple[Vec3, Vec3],
    new: tuple[Vec3, Vec3], entry: Entry,
) -> Entry:  # fmt: skip
    """What is booked, with what a flow did from old to new momenta."""
    if flow is None:
        return entry
    work, dp, dL = kick_entry(rows, b, x, R, old, old, new)
    return work + entry[0], add_scaled(1.0, dp, entry[1]), add_scaled(1.0, dL, entry[2])


@inline
def kick_body(
    acting: Acting, books: Flag, rows: Floats, b: int, dt: float
) -> tuple[Vec3, Vec3, Rows]:
    """Kick body b over dt; its new momenta, which are stored, and its rotation matrix."""
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
) -> tuple[Vec3, Rows]:
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
