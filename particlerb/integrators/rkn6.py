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

from typing import Final

from particlerb.compiled.jit import Flag, inline
from particlerb.contact.contact_model import NOW
from particlerb.forces.kernels import shift_time
from particlerb.forces.kinds import BODIES, POSE, TIME
from particlerb.integrators.kick import kick_body
from particlerb.integrators.method import Method
from particlerb.integrators.rotor_drift import (
    drift_symmetric,
    fastest_turn,
    finish_drift,
    start_drift,
)
from particlerb.integrators.stages import MovingBodies, loads, stage, stages
from particlerb.rotors.moser_veselov import (
    LARGEST_SHARE,
    LONGEST_PIECE,
    iterations_of,
    modified_inertia,
    pieces_of,
)

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
_BEFORE: Final = tuple(sum(DRIFTS[:k], 0.0) for k in range(len(DRIFTS)))  # where each kick is made
CLOSING_KICK: Final = KICKS[0]


def _maps_of(turn: float) -> float:
    """Moser-Veselov maps per drift of a step in which a body turns so far [rad], about."""
    largest = max(turn / LONGEST_PIECE, 1.0 / LARGEST_SHARE)
    return sum(max(1.0, abs(share) * largest) for share in DRIFTS) / len(DRIFTS)


@inline
def _drift_asymmetric(
    kind: Flag, moving: MovingBodies, first: int, last: int, k: int, kick_dt: float, dt: float
) -> None:
    """Kick, and drift k, of asymmetric bodies, as long as the fastest of a block asks for."""
    if kind is None:
        return
    drift_dt = DRIFTS[k] * dt
    for block in range(first, min(last, moving.layout.asymmetric)):
        rows, n = moving.blocks[block], moving.layout.size[block]
        turn = abs(drift_dt) * fastest_turn(rows, n, k == 0)
        pieces = pieces_of(turn, abs(DRIFTS[k]))
        iterations = iterations_of(turn / pieces)
        for b in range(n):
            shift_time(moving.acting, rows, b, _BEFORE[k] * dt)
            _, spin, R = kick_body(moving.acting, moving.books, rows, b, kick_dt)
            start_drift(rows, b, spin, R, drift_dt, pieces)
        finish_drift(rows, n, drift_dt, pieces, iterations)


@inline
def _drift_symmetric(
    kind: Flag, moving: MovingBodies, first: int, last: int, k: int, kick_dt: float, dt: float
) -> None:
    """Kick, and drift k, of bodies whose drift has a closed form."""
    if kind is None:
        return
    for block in range(max(first, moving.layout.asymmetric), last):
        rows = moving.blocks[block]
        for b in range(moving.layout.size[block]):
            shift_time(moving.acting, rows, b, _BEFORE[k] * dt)
            kick_body(moving.acting, moving.books, rows, b, kick_dt)
            drift_symmetric(rows, b, DRIFTS[k] * dt)


@stage
def _kick_and_drift(
    moving: MovingBodies, first: int, last: int, k: int, kick_dt: float, dt: float
) -> None:
    """A kick, and drift k of a step dt."""
    _drift_asymmetric(moving.rotors.asymmetric, moving, first, last, k, kick_dt, dt)
    _drift_symmetric(moving.rotors.symmetric, moving, first, last, k, kick_dt, dt)


@stages
def step(moving: MovingBodies, first: int, last: int, open_kick: float, dt: float) -> None:
    """Eleven kicks and drifts; the last kick stays open."""
    for k in range(len(DRIFTS)):
        loads(moving, first, last, NOW)
        kick_dt = KICKS[k] * dt if k > 0 else CLOSING_KICK * dt + open_kick
        _kick_and_drift(moving, first, last, k, kick_dt, dt)


METHOD: Final = Method(
    name="rkn6",
    summary="order 6 (8 on free bodies), symmetric; for forces without velocities",
    order=6,
    free_order=8,
    accepts=frozenset({POSE, TIME, BODIES}),
    cost=66.0,
    evaluations=len(KICKS),
    keeps_rods=True,
    stability_limit=3.0,  # below its first resonance
    max_turn=3.0,
    closing_kick=CLOSING_KICK,
    step=step,
    rotor_constants=modified_inertia,
    asymmetric_cost=_maps_of,
)
