"""Kicks and drifts of whole blocks, one after the other: what splittings of high order share.

In a drift centres of mass fly and bodies turn: asymmetric ones by the preprocessed Moser-Veselov
map of order 8, in as many pieces and by as many iterations as the fastest of a block asks for, all
others in closed form.
"""

import math

import numpy as np

from particlerb.compiled.jit import Flag, inline
from particlerb.integrators.kick import KickAndDrift, kick_with_gradient
from particlerb.integrators.stages import MovingBodies, stage
from particlerb.maths.quaternion import matrix, multiply, normalised, turn_back
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, component_product, dot, scale
from particlerb.model.block import (
    COM,
    INV_INERTIA,
    INV_MASS,
    ROTOR,
    SCRATCH,
    L,
    P,
    Q,
    get,
    get3,
    get4,
    put,
    put3,
    put4,
)
from particlerb.rotors.moser_veselov import Cubic, first_guess, iterations_of, newton, pieces_of
from particlerb.rotors.symmetric_split import symmetric_split

_U = SCRATCH  # of the Moser-Veselov map: u, f, and the solution
_F = SCRATCH + 3
_V = SCRATCH + 6
_RATE_ROW = SCRATCH + 9


@inline
def _fly(rows: Floats, b: int, dt: float) -> None:
    """x + p dt/M of body b."""
    x, p = get3(rows, COM, b), get3(rows, P, b)
    put3(rows, COM, b, add_scaled(dt * get(rows, INV_MASS, b), p, x))


@inline
def _body_momentum(rows: Floats, b: int) -> Vec3:
    """Rᵀ L of body b."""
    return turn_back(matrix(get4(rows, Q, b)), get3(rows, L, b))


@inline
def _fastest_turn(rows: Floats, n: int) -> float:
    """Largest |ω| of a block at the beginning of a step [rad/s]; 0 where it is not finite."""
    for b in range(n):
        w = component_product(get3(rows, INV_INERTIA, b), _body_momentum(rows, b))
        put(rows, _RATE_ROW, b, dot(w, w))
    largest = 0.0
    for b in range(n):
        largest = max(largest, get(rows, _RATE_ROW, b))
    return math.sqrt(largest) if largest < np.inf else 0.0


@inline
def _cubic(rows: Floats, at: int, b: int) -> Cubic:
    """Nine coefficients of body b."""
    return get3(rows, at, b), get3(rows, at + 3, b), get3(rows, at + 6, b)


@inline
def _start_map(rows: Floats, b: int, m: Vec3, dt: float) -> None:
    """Modified inertia and a first guess for body b with the momentum m in its own axes."""
    s, d = _cubic(rows, ROTOR + 4, b), _cubic(rows, ROTOR + 13, b)
    turn = scale(dt * get(rows, ROTOR + 3, b), m)
    u, f, v = first_guess(turn, get3(rows, ROTOR, b), s, d)
    put3(rows, _U, b, u)
    put3(rows, _F, b, f)
    put3(rows, _V, b, v)


@inline
def _finish_map(rows: Floats, n: int, iterations: int) -> None:
    """Solve the map of a block, and turn its bodies."""
    for _ in range(iterations - 1):
        for b in range(n):
            put3(rows, _V, b, newton(get3(rows, _U, b), get3(rows, _F, b), get3(rows, _V, b)))
    for b in range(n):
        x, y, z = newton(get3(rows, _U, b), get3(rows, _F, b), get3(rows, _V, b))
        put4(rows, Q, b, normalised(multiply(get4(rows, Q, b), (1.0, x, y, z))))


@inline
def _finish_drift(rows: Floats, n: int, dt: float, pieces: int, iterations: int) -> None:
    """End the drift of a block of asymmetric bodies."""
    _finish_map(rows, n, iterations)
    for _ in range(pieces - 1):
        for b in range(n):
            _start_map(rows, b, _body_momentum(rows, b), dt / pieces)
        _finish_map(rows, n, iterations)


@inline
def fly_and_split(rows: Floats, b: int, dt: float) -> None:
    """Drift of body b of any other class."""
    _fly(rows, b, dt)
    q, m = get4(rows, Q, b), _body_momentum(rows, b)
    put4(rows, Q, b, symmetric_split(q, m, get3(rows, INV_INERTIA, b), dt))


@inline
def _drift_asymmetric(
    kind: Flag, gradient: Flag, moving: MovingBodies, first: int, end: int, move: KickAndDrift
) -> None:
    """Kick and drift of asymmetric bodies, as long as the fastest of a block asks for."""
    if kind is None:
        return
    acting, sums_external = moving.acting, moving.sums_external
    for block in range(first, min(end, moving.layout.asymmetric)):
        rows, n = moving.blocks[block], moving.layout.size[block]
        if move.is_first:  # and kept for the other drifts of the step
            put(rows, _RATE_ROW, 0, _fastest_turn(rows, n))
        turned = abs(move.drift) * get(rows, _RATE_ROW, 0)
        pieces = pieces_of(turned, move.share)
        iterations = iterations_of(turned / pieces)
        for b in range(n):
            spin, R = kick_with_gradient(gradient, acting, sums_external, rows, b, move)
            _fly(rows, b, move.drift)
            _start_map(rows, b, turn_back(R, spin), move.drift / pieces)
        _finish_drift(rows, n, move.drift, pieces, iterations)


@inline
def _drift_symmetric(
    kind: Flag, gradient: Flag, moving: MovingBodies, first: int, end: int, move: KickAndDrift
) -> None:
    """Kick and drift of bodies whose drift has a closed form."""
    if kind is None:
        return
    acting, sums_external = moving.acting, moving.sums_external
    for block in range(max(first, moving.layout.asymmetric), end):
        rows = moving.blocks[block]
        for b in range(moving.layout.size[block]):
            kick_with_gradient(gradient, acting, sums_external, rows, b, move)
            fly_and_split(rows, b, move.drift)


@stage
def kick_and_rotor_drift(
    moving: MovingBodies, first: int, end: int, gradient: Flag, move: KickAndDrift
) -> None:
    """A kick, bent by the gradient or not, and the drift after it."""
    _drift_asymmetric(moving.rotors.asymmetric, gradient, moving, first, end, move)
    _drift_symmetric(moving.rotors.symmetric, gradient, moving, first, end, move)
