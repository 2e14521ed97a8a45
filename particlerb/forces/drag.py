"""Linear drag: a force against the velocity and a torque against the angular velocity.

F = -c v and τ = -c_r ω. At a fixed pose, and with any other force F₀ and torque held, the momenta
decay by exact exponentials, with γ = c/M, and in the rotor frame γ_k = c_r/I_k:

    p ← e^{-γ h} p + (1 - e^{-γ h})/γ F₀.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Force, Kick, Momenta, Rates, Term, numbers_of
from particlerb.maths.quaternion import Matrix, turn, turn_back
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, component_product, subtract
from particlerb.model.block import INV_INERTIA, get, get3, put
from particlerb.model.bodies import Bodies
from particlerb.model.state import State

_DRAG_ROWS: Final = 2
_DECAY_ROWS: Final = 9  # of the exact flow: four factors for p and L, four for what is added; h


class Drag(NamedTuple):
    """Parameters of the term for n bodies."""

    rate: Floats  # (n,) [1/s], c/M
    rotation: Floats  # (n,) [N m s/rad], c_r


@inline
def angular_velocity(rows: Floats, b: int, R: Matrix, L: Vec3) -> Vec3:
    """ω of body b, world frame [rad/s]."""
    return turn(R, component_product(get3(rows, INV_INERTIA, b), turn_back(R, L)))


@inline
def _drag_load(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, p: Vec3, L: Vec3, F: Vec3, tau: Vec3
) -> Momenta:
    """F - γ p,  τ - c_r ω."""
    w, rotation = angular_velocity(rows, b, R, L), get(rows, at + 1, b)
    return add_scaled(-get(rows, at, b), p, F), add_scaled(-rotation, w, tau)


@inline
def _prepare_decay(rows: Floats, at: int, n: int, dt: float) -> None:
    """Factors of the exact flow over dt, in the rows after those of the drag."""
    if get(rows, at + _DRAG_ROWS + 8, 0) == dt:
        return
    put(rows, at + _DRAG_ROWS + 8, 0, dt)
    for b in range(n):
        rate, rotation = get(rows, at, b), get(rows, at + 1, b)
        inverse = get3(rows, INV_INERTIA, b)
        for k in range(4):
            x = rate * dt if k == 0 else rotation * inverse[max(k - 1, 0)] * dt
            first = at + _DRAG_ROWS + k
            put(rows, first, b, np.exp(-x))
            put(rows, first + 4, b, -np.expm1(-x) / x if x > 0.0 else 1.0)


@inline
def damp(
    rows: Floats, at: int, b: int, R: Matrix, p_old: Vec3, L_old: Vec3, p: Vec3, L: Vec3
) -> Momenta:
    """Exact flow: p and L are p_old and L_old with the kicks of all other forces."""
    first = at + _DRAG_ROWS
    decay, share = get(rows, first, b), get(rows, first + 4, b)
    kicked = subtract(p, p_old)
    p = add_scaled(decay, p_old, (share * kicked[0], share * kicked[1], share * kicked[2]))
    m = component_product(get3(rows, first + 1, b), turn_back(R, L_old))
    dm = component_product(get3(rows, first + 5, b), turn_back(R, subtract(L, L_old)))
    return p, turn(R, add_scaled(1.0, m, dm))


KICK: Final = Kick(
    "drag", _DRAG_ROWS + _DECAY_ROWS, load=_drag_load, damp=damp, prepare=_prepare_decay
)


def _drag_rates(drag: Drag, bodies: Bodies, state: State) -> Rates:
    """The faster of the decays of p and L."""
    return Rates(rate=np.maximum(drag.rate, drag.rotation * bodies.inv_inertia.max(axis=0)))


FORCE: Final = Force(
    numbers_of(lambda table: (table.translation, table.rotation)),
    lambda _, numbers, bodies, start: Drag(numbers[0] * bodies.inv_mass, numbers[1]),
)
TERMS: Final = (Term(Drag, "drag", KICK, _drag_rates),)
