"""Order 4 with the gradient of the forces: four kicks between three positive drifts.

A symmetric, symplectic splitting for forces that have a potential V whose second derivative is
known. Two of its kicks are those of V - κh² [V,[T,V]]: with the acceleration a = (F/M, I⁻¹τ) that
the loads give a body, they are F + 2κh² Ḟ and τ + 2κh² τ̇, the rates of change along a motion with
the velocities a (`Kick.change`; docs/theory.md, section 9). So all drifts are positive, and errors
are a tenth of those of methods of this order without gradients. Asymmetric bodies drift by the
preprocessed Moser-Veselov map of order 8, all others in closed form.

Source: Suzuki, Phys. Lett. A 201, 425 (1995), and Omelyan, Mryglod, Folk, Comput. Phys. Commun.
151, 272 (2003), for the family; A is where the errors of random tops are least.
"""

from typing import Final

from particlerb.compiled.jit import Flag, inline, kernel
from particlerb.contact.contact_model import NOW
from particlerb.forces.kernels import Acting, Entry, change_of, kick_potential, less_internal
from particlerb.forces.kinds import BODIES, POSE
from particlerb.forces.links import change_links
from particlerb.forces.registry import CHANGE, PAIR
from particlerb.integrators.external_work import book, kick_entry
from particlerb.integrators.kick import kick_body
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout, PairTerms, clear, gather_states, scatter
from particlerb.integrators.rotor_drift import (
    drift_symmetric,
    fastest_turn,
    finish_drift,
    start_drift,
)
from particlerb.integrators.stages import MovingBodies, loads, stage, stages
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
from particlerb.rotors.moser_veselov import (
    LONGEST_PIECE,
    iterations_of,
    modified_inertia,
    pieces_of,
)

A: Final = 0.2775
DRIFTS: Final = (A, 1.0 - 2.0 * A, A)
_S: Final = 0.5 - A
CLOSING_KICK: Final = (1.0 / 12.0 - _S * _S) / (0.5 - 2.0 * _S * _S)
KICKS: Final = (CLOSING_KICK, 0.5 - CLOSING_KICK, 0.5 - CLOSING_KICK)  # and the first, left open
_TIMES: Final = (0.0, A, 1.0 - A, 1.0)  # of the kicks
_ALL: Final = (*KICKS, CLOSING_KICK)
_SPREAD: Final = sum(
    one * other * abs(t - s)
    for one, t in zip(_ALL, _TIMES, strict=True)
    for other, s in zip(_ALL, _TIMES, strict=True)
)
GRADIENT: Final = 0.25 * (1.0 / 3.0 - _SPREAD)  # 2κ of the second and the third kick
_ZERO: Final = (0.0, 0.0, 0.0)
_NO_SHARE: Final = 0.0  # no drift is cut for its share of the step: maps of order 8 are good enough


def _maps_of(turn: float) -> float:
    """Moser-Veselov maps per drift of a step in which a body turns so far [rad], about."""
    return sum(max(1.0, share * turn / LONGEST_PIECE) for share in DRIFTS) / len(DRIFTS)


@inline
def _less_internal(
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
def _kick(
    bent: Flag, moving: MovingBodies, rows: Floats, b: int, dt: float, weight: float
) -> tuple[Vec3, Rows]:
    """Kick body b over dt, bent by the gradient or not; L, which is stored with p, and R."""
    acting = moving.acting
    if bent is None:
        _, spin, R = kick_body(acting, moving.books, rows, b, dt)
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
    book(moving.books, rows, b, 1.0, _less_internal(acting.pair, rows, b, x, v, weight, entry))
    return spin, R


@inline
def _drift_asymmetric(
    kind: Flag, bent: Flag, moving: MovingBodies, span: tuple[int, int], k: int, kick_dt: float,
    dt: float,
) -> None:  # fmt: skip
    """Kick, and drift k, of asymmetric bodies."""
    if kind is None:
        return
    drift_dt, weight = DRIFTS[k] * dt, GRADIENT * (dt * dt * dt)
    for block in range(span[0], min(span[1], moving.layout.asymmetric)):
        rows, n = moving.blocks[block], moving.layout.size[block]
        turned = abs(drift_dt) * fastest_turn(rows, n, k == 0)
        pieces = pieces_of(turned, _NO_SHARE)
        iterations = iterations_of(turned / pieces)
        for b in range(n):
            spin, R = _kick(bent, moving, rows, b, kick_dt, weight)
            start_drift(rows, b, spin, R, drift_dt, pieces)
        finish_drift(rows, n, drift_dt, pieces, iterations)


@inline
def _drift_symmetric(
    kind: Flag, bent: Flag, moving: MovingBodies, span: tuple[int, int], k: int, kick_dt: float,
    dt: float,
) -> None:  # fmt: skip
    """Kick, and drift k, of bodies whose drift has a closed form."""
    if kind is None:
        return
    drift_dt, weight = DRIFTS[k] * dt, GRADIENT * (dt * dt * dt)
    for block in range(max(span[0], moving.layout.asymmetric), span[1]):
        rows = moving.blocks[block]
        for b in range(moving.layout.size[block]):
            _kick(bent, moving, rows, b, kick_dt, weight)
            drift_symmetric(rows, b, drift_dt)


@stage
def _kick_and_drift(
    moving: MovingBodies, first: int, last: int, k: int, bent: Flag, kick_dt: float, dt: float
) -> None:
    """A kick, and drift k of a step dt."""
    span, rotors = (first, last), moving.rotors
    _drift_asymmetric(rotors.asymmetric, bent, moving, span, k, kick_dt, dt)
    _drift_symmetric(rotors.symmetric, bent, moving, span, k, kick_dt, dt)


@kernel
def _change_pairs(acting: Acting, pairs: PairTerms | None, blocks: Floats, layout: Layout) -> None:
    """Write into their rows how fast the loads of other bodies change, if there are any.

    Where momenta stand in a state are the loads that act on it: it moves with what they give it.
    """
    if pairs is None:
        return
    links, _, _, _, y, _, change = pairs
    gather_states(blocks, layout, y)
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for b in range(layout.size[k]):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            F, tau = kick_potential(acting, rows, b, x, R, 1.0, _ZERO, _ZERO)
            for i in range(3):
                y[7 + i, lo + b] = F[i]
                y[10 + i, lo + b] = tau[i]
    clear(change)
    change_links(links, y, change)
    scatter(change, blocks, layout, CHANGE, 0)


@stages
def step(moving: MovingBodies, first: int, last: int, open_kick: float, dt: float) -> None:
    """A kick, three drifts with two bent kicks between them; the last kick stays open."""
    loads(moving, first, last, NOW)
    _kick_and_drift(moving, first, last, 0, None, CLOSING_KICK * dt + open_kick, dt)
    for k in range(1, len(DRIFTS)):
        loads(moving, first, last, NOW)
        _change_pairs(moving.acting, moving.pairs, moving.blocks, moving.layout)
        _kick_and_drift(moving, first, last, k, 1, KICKS[k] * dt, dt)


METHOD: Final = Method(
    name="force_gradient",
    summary="order 4, symplectic; gradients of forces that have a potential",
    order=4,
    free_order=8,
    accepts=frozenset({POSE, BODIES}),
    cost=20.0,
    evaluations=len(KICKS),
    takes_gradients=True,
    keeps_rods=True,
    stability_limit=3.1,  # below its first resonance
    max_turn=3.0,
    closing_kick=CLOSING_KICK,
    step=step,
    rotor_constants=modified_inertia,
    asymmetric_cost=_maps_of,
)
