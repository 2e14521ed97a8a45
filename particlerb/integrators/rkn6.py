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

from particlerb.contact.contact_model import NOW
from particlerb.forces.kinds import BODIES, POSE, TIME
from particlerb.integrators.kick import KickAndDrift
from particlerb.integrators.method import Method
from particlerb.integrators.rotor_drift import kick_and_rotor_drift
from particlerb.integrators.stages import MovingBodies, loads, shift_pairs, stages
from particlerb.rotors.moser_veselov import LARGEST_SHARE, cost_of_maps, modified_inertia

_TO_THE_MIDDLE: Final = (
    (0.0414649985182624, 0.123229775946271),
    (0.198128671918067, 0.290553797799558),
    (-0.0400061921041533, -0.127049212625417),
    (0.0752539843015807, -0.246331761062075),
    (-0.0115113874206879, 0.357208872795928),
    (0.2366699247869311, 0.20477705429147),
)  # kicks, and the drifts after them; from here on the same backwards
_FIRST_KICKS, _FIRST_DRIFTS = zip(*_TO_THE_MIDDLE, strict=True)
KICKS: Final = (*_FIRST_KICKS, *_FIRST_KICKS[:0:-1])  # and the first one again, left open
DRIFTS: Final = (*_FIRST_DRIFTS, *_FIRST_DRIFTS[-2::-1])
_KICK_TIMES: Final = tuple(sum(DRIFTS[:k], 0.0) for k in range(len(DRIFTS)))  # in steps
CLOSING_KICK: Final = KICKS[0]


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Eleven kicks and drifts; the last kick stays open."""
    for k in range(len(DRIFTS)):
        shift_pairs(moving, first, _KICK_TIMES[k] * dt)
        loads(moving, first, end, NOW)
        kick_dt = KICKS[k] * dt if k > 0 else CLOSING_KICK * dt + open_kick
        drift_dt, share = DRIFTS[k] * dt, abs(DRIFTS[k])
        move = KickAndDrift(kick_dt, 0.0, _KICK_TIMES[k] * dt, drift_dt, share, k == 0)
        kick_and_rotor_drift(moving, first, end, None, move)


METHOD: Final = Method(
    summary="order 6 (8 on free bodies), symmetric; for forces without velocities",
    order=6,
    accepts=frozenset({POSE, TIME, BODIES}),
    cost=66.0,
    evaluations=len(KICKS),
    keeps_rods=True,
    stability_limit=3.0,  # below its first resonance
    max_turn=3.0,
    closing_kick=CLOSING_KICK,
    step=step,
    rotor_constants=modified_inertia,
    asymmetric_cost=cost_of_maps(1.55, DRIFTS, LARGEST_SHARE),
)
