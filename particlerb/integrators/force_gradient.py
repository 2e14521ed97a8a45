"""Order 4 with the gradient of the forces: four kicks between three positive drifts.

A symmetric splitting for forces of the pose and the time whose rates of change are known, and
symplectic where they have a potential V. Two of its kicks are those of V - κh² [V,[T,V]]: with
the acceleration a = (F/M, I⁻¹τ) that the loads give a body, they are F + 2κh² Ḟ and τ + 2κh² τ̇,
the rates of change along a motion with the velocities a (`Kick.change`; docs/theory.md, section 9).
So all drifts are positive, and errors are a tenth of those of methods of this order without
gradients. Asymmetric bodies drift by the
preprocessed Moser-Veselov map of order 8, all others in closed form.

Source: Suzuki, Phys. Lett. A 201, 425 (1995), and Omelyan, Mryglod, Folk, Comput. Phys. Commun.
151, 272 (2003), for the family; A is where the errors of random tops are least.
"""

from typing import Final

from particlerb.compiled.jit import kernel
from particlerb.contact.contact_model import NOW
from particlerb.forces.kernels import Acting, kick_potential
from particlerb.forces.kinds import BODIES, POSE, TIME
from particlerb.forces.links import change_links
from particlerb.forces.registry import CHANGE
from particlerb.integrators.kick import KickAndDrift
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import Layout, PairTerms, gather_states, scatter
from particlerb.integrators.rotor_drift import kick_and_rotor_drift
from particlerb.integrators.stages import MovingBodies, loads, stages
from particlerb.maths.quaternion import matrix
from particlerb.maths.vec3 import ZERO, Floats
from particlerb.model.block import COM, Q, get3, get4
from particlerb.rotors.moser_veselov import cost_of_maps, modified_inertia

A: Final = 0.2775
DRIFTS: Final = (A, 1.0 - 2.0 * A, A)
_S: Final = 0.5 - A
CLOSING_KICK: Final = (1.0 / 12.0 - _S * _S) / (0.5 - 2.0 * _S * _S)
KICKS: Final = (CLOSING_KICK, 0.5 - CLOSING_KICK, 0.5 - CLOSING_KICK)  # and the first, left open
_KICK_TIMES: Final = (0.0, A, 1.0 - A, 1.0)
_ALL_KICKS: Final = (*KICKS, CLOSING_KICK)
_SPREAD: Final = sum(
    one * other * abs(t - s)
    for one, t in zip(_ALL_KICKS, _KICK_TIMES, strict=True)
    for other, s in zip(_ALL_KICKS, _KICK_TIMES, strict=True)
)
GRADIENT: Final = 0.25 * (1.0 / 3.0 - _SPREAD)  # 2κ of the second and the third kick
_NO_SHARE: Final = 0.0  # no drift is cut for its share of the step: maps of order 8 are good enough


@kernel
def _change_pairs(acting: Acting, pairs: PairTerms | None, blocks: Floats, layout: Layout) -> None:
    """Write into their rows how fast the loads of other bodies change, if there are any.

    Where momenta stand in a state are the loads that act on it: it moves with what they give it.
    """
    if pairs is None:
        return
    links, y, change = pairs.links, pairs.y, pairs.flows
    gather_states(blocks, layout, y)
    for k in range(layout.first.size):
        rows, lo = blocks[k], layout.first[k]
        for b in range(layout.size[k]):
            x, R = get3(rows, COM, b), matrix(get4(rows, Q, b))
            F, tau = kick_potential(acting, rows, b, x, R, 1.0, ZERO, ZERO)
            for i in range(3):
                y[7 + i, lo + b] = F[i]
                y[10 + i, lo + b] = tau[i]
    change[:] = 0.0
    change_links(links, y, change)
    scatter(change, blocks, layout, CHANGE, 0)


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """A kick, three drifts with two bent kicks between them; the last kick stays open."""
    loads(moving, first, end, NOW)
    move = KickAndDrift(CLOSING_KICK * dt + open_kick, 0.0, 0.0, DRIFTS[0] * dt, _NO_SHARE, True)
    kick_and_rotor_drift(moving, first, end, None, move)
    for k in range(1, len(DRIFTS)):
        loads(moving, first, end, NOW)
        _change_pairs(moving.acting, moving.pairs, moving.blocks, moving.layout)
        weight, drift_dt = GRADIENT * (dt * dt * dt), DRIFTS[k] * dt
        move = KickAndDrift(KICKS[k] * dt, weight, _KICK_TIMES[k] * dt, drift_dt, _NO_SHARE, False)
        kick_and_rotor_drift(moving, first, end, 1, move)


METHOD: Final = Method(
    summary="order 4, symplectic where forces have a potential; takes their gradients",
    order=4,
    accepts=frozenset({POSE, BODIES, TIME}),
    cost=20.0,
    evaluations=len(KICKS),
    takes_gradients=True,
    keeps_rods=True,
    stability_limit=3.1,  # below its first resonance
    max_turn=3.0,
    closing_kick=CLOSING_KICK,
    step=step,
    rotor_constants=modified_inertia,
    asymmetric_cost=cost_of_maps(1.35, DRIFTS),
)
