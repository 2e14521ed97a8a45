"""A fixed centre that attracts with an inverse-square field, and turns bodies by its gradient.

With r from the centre to the body, d = |r|, n = r/d and the inertia tensor I in the world, to
second order in the size of the body over d (MacCullagh's formula)

    U = -μ M/d - μ (tr I - 3 n·I n)/(2 d³),
    F = -μ M n/d² + 3 μ ((5 n·I n - tr I) n - 2 I n)/(2 d⁴),   τ = 3 μ n × I n/d³.

F and τ are the exact derivatives of U, hence energy, and angular momentum about the centre, are
constants of the motion. Source: Hughes, Spacecraft Attitude Dynamics (1986), section 8.1.
"""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Force, ForceError, Kick, Momenta, Rates, Term, numbers_of
from particlerb.maths.quaternion import Matrix, turn, turn_back
from particlerb.maths.vec3 import (
    Floats,
    Vec3,
    add_scaled,
    component_product,
    cross,
    dot,
    scale,
    subtract,
)
from particlerb.model.block import get, get3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State, lengths, rotate_back

if TYPE_CHECKING:
    from particlerb.case.forces import CentralTable


class Central(NamedTuple):
    """Parameters of one centre for each of n bodies."""

    centre: Floats  # (3, n) [m], world frame
    mu: Floats  # (n,) [m³/s²], G times the mass of the centre
    mass: Floats  # (n,) [kg], of the body
    inertia: Floats  # (3, n) [kg m²], principal moments, rotor frame


@inline
def _kick_central(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """p + F dt,  L + τ dt."""
    r = subtract(x, get3(rows, at, b))
    mu, mass = get(rows, at + 3, b), get(rows, at + 4, b)
    inertia = get3(rows, at + 5, b)
    inverse = 1.0 / np.sqrt(dot(r, r))
    n = scale(inverse, r)
    m = turn_back(R, n)
    moved = turn(R, (inertia[0] * m[0], inertia[1] * m[1], inertia[2] * m[2]))
    size = mu * inverse * inverse
    trace = inertia[0] + inertia[1] + inertia[2]
    near = 1.5 * size * inverse * inverse
    along = near * (5.0 * dot(n, moved) - trace) - size * mass
    force = add_scaled(-2.0 * near, moved, scale(along, n))
    torque = scale(3.0 * size * inverse, cross(n, moved))
    return add_scaled(dt, force, p), add_scaled(dt, torque, L)


@inline
def _change_central(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """F + Ḟ,  τ + τ̇, with d(I n)/dt = ω × I n + I (ṅ - ω × n)."""
    v, w = motion
    r, inertia = subtract(x, get3(rows, at, b)), get3(rows, at + 5, b)
    inverse = 1.0 / np.sqrt(dot(r, r))
    n = scale(inverse, r)
    away = dot(n, v)
    dn = scale(inverse, add_scaled(-away, n, v))
    moved = turn(R, component_product(inertia, turn_back(R, n)))
    dn_body = turn_back(R, subtract(dn, cross(w, n)))
    dmoved = add_scaled(1.0, cross(w, moved), turn(R, component_product(inertia, dn_body)))
    size, fall = get(rows, at + 3, b) * inverse * inverse, -inverse * away
    pull, near = size * get(rows, at + 4, b), 1.5 * size * inverse * inverse
    shape = 5.0 * dot(n, moved) - (inertia[0] + inertia[1] + inertia[2])
    dshape = 5.0 * (dot(dn, moved) + dot(n, dmoved))
    along = near * shape - pull
    dalong = near * (4.0 * fall * shape + dshape) - 2.0 * fall * pull
    F = add_scaled(along, dn, add_scaled(dalong, n, F))
    F = add_scaled(-2.0 * near, add_scaled(4.0 * fall, moved, dmoved), F)
    across = add_scaled(1.0, cross(dn, moved), cross(n, dmoved))
    across = add_scaled(3.0 * fall, cross(n, moved), across)
    return F, add_scaled(3.0 * size * inverse, across, tau)


KICK: Final = Kick(
    "central", 8, _kick_central, has_potential=True, is_many=True, change=_change_central
)
_CENTRE_FAR_AWAY: Final = 1e30  # [m] where a centre is for bodies on which it does not act


def central_work(central: Central, com: Floats, q: Floats, *_: object) -> Floats:
    """-U, (n,) [J]: what the field has done, up to a constant."""
    r = com - central.centre
    d = np.linalg.norm(r, axis=0)
    m = rotate_back(q, r / d)
    near = central.inertia.sum(axis=0) - 3.0 * (m * m * central.inertia).sum(axis=0)
    return central.mu * (central.mass / d + 0.5 * near / (d * d * d))


def _central_rates(central: Central, bodies: Bodies, state: State) -> Rates:
    """√3 of the rate of a circular orbit: the fastest libration of a rod."""
    distance = lengths(state.com - central.centre)
    return Rates(rate=np.sqrt(3.0 * central.mu / distance) / distance)


def _refuse_centre(table: "CentralTable", numbers: Floats, com: Floats) -> None:
    """Raise ForceError where a body starts in the centre."""
    there = np.flatnonzero(~(com - numbers[:3]).any(axis=0))
    if there.size:
        reason = "{name} starts exactly at this centre, where the force has no direction"
        raise ForceError("centre", reason, "move one of the two", int(there[0]))


FORCE: Final = Force(
    numbers_of(lambda table: (table.centre, table.mu)),
    lambda _, numbers, bodies, start: Central(numbers[:3], numbers[3], bodies.mass, bodies.inertia),
    nowhere=_CENTRE_FAR_AWAY, check=_refuse_centre,
)  # fmt: skip
TERMS: Final = (Term(Central, "central field", KICK, _central_rates, central_work),)
