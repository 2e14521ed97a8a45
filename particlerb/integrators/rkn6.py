"""Order 6 for forces that know no velocities: eleven kicks and drifts of Blanes and Moan.

A symmetric splitting of Runge-Kutta-Nyström type. Where the forces have a potential it is
symplectic for all bodies but asymmetric ones, whose rotor is so to order 8: in chaotic motion their
energy creeps, by 3e-9 in a million turns at h |ω| = 0.5 (docs/stability.md). It asks that the
forces know nothing of the velocities, so there is no drag. Asymmetric bodies drift by the
preprocessed Moser-Veselov map of order 8, all others in closed form; on free bodies the order is
therefore 8, or the drift exact. Drifts that turn a body too far for that map, and the longest ones
of a step, are cut into pieces (rotors/moser_veselov.py).

Source: Blanes and Moan, J. Comput. Appl. Math. 142, 313 (2002), coefficients SRKN₁₁ᵇ.
"""

import math
from typing import Final

import numpy as np

from particlerb.compiled.jit import inline, kernel_from
from particlerb.forces.kernels import Acting, shift_time
from particlerb.forces.kinds import BODIES, POSE, TIME
from particlerb.maths.quaternion import matrix, multiply, normalised, turn_back
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, dot, multiplied3, scale
from particlerb.model.block import (
    COM,
    INV_INERTIA,
    INV_MASS,
    OWN,
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
from particlerb.model.bodies import taken
from particlerb.model.state import State
from particlerb.rotors.moser_veselov import (
    LARGEST_SHARE,
    LONGEST_PIECE,
    Cubic,
    first_guess,
    iterations_of,
    modified_inertia,
    newton,
    pieces_of,
)
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.rotors.symmetric_split import symmetric_split
from particlerb.stepping.coupled import CoupledMotion, stages_of
from particlerb.stepping.kicks import kick
from particlerb.stepping.loop import SteppedMotion, advance_blocks
from particlerb.stepping.motion import CompositeMotion, Group, Motion, part_of

ORDER: Final = 6
FREE_ORDER: Final = 8
IS_ADAPTIVE: Final = False
KEEPS_RODS: Final = True
ACCEPTS: Final = frozenset({POSE, TIME, BODIES})
SUMMARY: Final = "order 6 (8 on free bodies), symmetric; for forces without velocities"
COST: Final = 66.0  # ns per body-step, roughly; of bodies with a closed drift
EVALUATIONS: Final = 11  # of the forces in a step
REACH: Final = 3.0  # largest hω of an oscillator that stays bounded (below its first resonance)
LONGEST: Final = 3.0  # rad in one step above which it is worth a warning
KICKS: Final = (
    0.0414649985182624,
    0.198128671918067,
    -0.0400061921041533,
    0.0752539843015807,
    -0.0115113874206879,
    0.2366699247869311,
    0.2366699247869311,
    -0.0115113874206879,
    0.0752539843015807,
    -0.0400061921041533,
    0.198128671918067,
)  # and the first one again, left open
DRIFTS: Final = (
    0.123229775946271,
    0.290553797799558,
    -0.127049212625417,
    -0.246331761062075,
    0.357208872795928,
    0.20477705429147,
    0.357208872795928,
    -0.246331761062075,
    -0.127049212625417,
    0.290553797799558,
    0.123229775946271,
)
BEFORE: Final = tuple(sum(DRIFTS[:k], 0.0) for k in range(len(DRIFTS)))  # where each kick is made
EDGE: Final = KICKS[0]
U: Final = SCRATCH  # of the Moser-Veselov map: u, f, and the solution
F: Final = SCRATCH + 3
V: Final = SCRATCH + 6
RATE: Final = SCRATCH + 9
OWN_ROWS: Final = SCRATCH - OWN


def maps(turn: float) -> float:
    """Moser-Veselov maps per drift of a step in which a body turns so far [rad], about."""
    largest = max(turn / LONGEST_PIECE, 1.0 / LARGEST_SHARE)
    return sum(max(1.0, abs(share) * largest) for share in DRIFTS) / len(DRIFTS)


@inline
def fly(rows: Floats, b: int, dt: float) -> None:
    """x + p dt/M of body b."""
    x, p = get3(rows, COM, b), get3(rows, P, b)
    put3(rows, COM, b, add_scaled(dt * get(rows, INV_MASS, b), p, x))


@inline
def body_momentum(rows: Floats, b: int) -> Vec3:
    """Rᵀ L of body b."""
    return turn_back(matrix(get4(rows, Q, b)), get3(rows, L, b))


@inline
def fastest_turn(rows: Floats, n: int) -> float:
    """Largest |ω| of a block at the beginning of a step [rad/s]; 0 where it is not finite."""
    for b in range(n):
        w = multiplied3(get3(rows, INV_INERTIA, b), body_momentum(rows, b))
        put(rows, RATE, b, dot(w, w))
    largest = 0.0
    for b in range(n):
        largest = max(largest, get(rows, RATE, b))
    return math.sqrt(largest) if largest < np.inf else 0.0


@inline
def cubic(rows: Floats, at: int, b: int) -> Cubic:
    """Nine coefficients of body b."""
    return get3(rows, at, b), get3(rows, at + 3, b), get3(rows, at + 6, b)


@inline
def start_map(rows: Floats, b: int, m: Vec3, dt: float) -> None:
    """Modified inertia and a first guess for body b with the momentum m in its own axes."""
    s, d = cubic(rows, OWN + 4, b), cubic(rows, OWN + 13, b)
    turn = scale(dt * get(rows, OWN + 3, b), m)
    u, f, v = first_guess(turn, get3(rows, OWN, b), s, d)
    put3(rows, U, b, u)
    put3(rows, F, b, f)
    put3(rows, V, b, v)


@inline
def finish_map(rows: Floats, n: int, iterations: int) -> None:
    """Solve the map of a block, and turn its bodies."""
    for _ in range(iterations - 1):
        for b in range(n):
            put3(rows, V, b, newton(get3(rows, U, b), get3(rows, F, b), get3(rows, V, b)))
    for b in range(n):
        x, y, z = newton(get3(rows, U, b), get3(rows, F, b), get3(rows, V, b))
        put4(rows, Q, b, normalised(multiply(get4(rows, Q, b), (1.0, x, y, z))))


@inline
def asymmetric_stage(
    k: int,
    rate: float,
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    opening: float,
    dt: float,
) -> None:
    """Kick and drift k; `rate` is the fastest turn of the block at the beginning of the step."""
    kick_dt = KICKS[k] * dt if k > 0 else opening
    drift_dt = DRIFTS[k] * dt
    turn = abs(drift_dt) * rate
    pieces = pieces_of(turn, abs(DRIFTS[k]))
    iterations = iterations_of(turn / pieces)
    for b in range(n):
        shift_time(acting, rows, b, BEFORE[k] * dt)
        _, L_b, R = kick(acting, books, rows, b, kick_dt)
        fly(rows, b, drift_dt)
        start_map(rows, b, turn_back(R, L_b), drift_dt / pieces)
    finish_map(rows, n, iterations)
    for _ in range(pieces - 1):
        for b in range(n):
            start_map(rows, b, body_momentum(rows, b), drift_dt / pieces)
        finish_map(rows, n, iterations)


@inline
def asymmetric_step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Eleven kicks and drifts; the last kick stays open."""
    rate = fastest_turn(rows, n)
    for k in range(len(DRIFTS)):
        asymmetric_stage(k, rate, acting, books, rows, n, opening, dt)


@inline
def symmetric_stage(
    k: int, acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Kick and drift k of bodies whose drift has a closed form."""
    h = KICKS[k] * dt if k > 0 else opening
    for b in range(n):
        shift_time(acting, rows, b, BEFORE[k] * dt)
        kick(acting, books, rows, b, h)
        fly(rows, b, DRIFTS[k] * dt)
        q = get4(rows, Q, b)
        m = body_momentum(rows, b)
        put4(rows, Q, b, symmetric_split(q, m, get3(rows, INV_INERTIA, b), DRIFTS[k] * dt))


@inline
def symmetric_step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """Eleven kicks and drifts of these."""
    for k in range(len(DRIFTS)):
        symmetric_stage(k, acting, books, rows, n, opening, dt)


@inline
def stage(
    k: int,
    is_asymmetric: bool,
    acting: Acting,
    books: int | None,
    rows: Floats,
    n: int,
    opening: float,
    dt: float,
) -> None:
    """Kick and drift k where bodies act on each other."""
    if is_asymmetric:
        if k == 0:
            put(rows, RATE, 0, fastest_turn(rows, n))
        asymmetric_stage(k, get(rows, RATE, 0), acting, books, rows, n, opening, dt)
    else:
        symmetric_stage(k, acting, books, rows, n, opening, dt)


advance_asymmetric = kernel_from(advance_blocks, "rkn6_asymmetric", step=asymmetric_step, EDGE=EDGE)
advance_symmetric = kernel_from(advance_blocks, "rkn6_symmetric", step=symmetric_step, EDGE=EDGE)
together = stages_of("rkn6", stage, len(DRIFTS), EDGE, flows=False)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> Motion:
    """Set off from a state at a time [s]."""
    del tolerance
    is_asymmetric = group.bodies.rotor_class == ASYMMETRIC
    if group.terms.is_coupled:
        own = np.zeros((OWN_ROWS, is_asymmetric.size))
        own[:, is_asymmetric] = modified_inertia(group.bodies.inv_inertia[:, is_asymmetric])
        return CoupledMotion(together, COST, group, state, start, dt, own=own)
    parts: list[tuple[Ints, Motion]] = []
    for chosen, advance in (
        (is_asymmetric, advance_asymmetric),
        (~is_asymmetric, advance_symmetric),
    ):
        which = np.flatnonzero(chosen)
        if which.size:
            part = part_of(group, which)
            rotor = modified_inertia(part.bodies.inv_inertia) if chosen is is_asymmetric else None
            motion = SteppedMotion(advance, COST, part, taken(state, which), start, dt, own=rotor)
            parts.append((which, motion))
    return parts[0][1] if len(parts) == 1 else CompositeMotion(tuple(parts))
