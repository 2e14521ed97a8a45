"""Strang splitting, kick - drift - kick, with the symmetric-top rotor: the default under force.

Order 2, symmetric, symplectic where the forces have a potential. The drift is exact for points,
rods, spheres and symmetric tops; kicks are the exact flow of the forces at a fixed pose, drag
included.

Source: Strang, SIAM J. Numer. Anal. 5, 506 (1968); the rotor: rotors/symmetric_split.py.
"""

from typing import Final

from particlerb.contact.contact_model import LEAPFROG, LoadTimes
from particlerb.forces.kinds import BODIES, CONTACT, PISTONS, POSE, TIME, VELOCITY
from particlerb.integrators.contact_limits import old_velocity
from particlerb.integrators.contact_stages import drift_walls, keep_momenta, kick_walls
from particlerb.integrators.kick import kick_body, solve_kicks
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare
from particlerb.integrators.rotor_drift import fly_and_split
from particlerb.integrators.stages import MovingBodies, flow_dashpots, kick, loads, stage, stages
from particlerb.maths.quaternion import turn_back
from particlerb.maths.vec3 import add_scaled
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, Q, get, get3, get4, put3, put4
from particlerb.rotors.symmetric_split import symmetric_split

CLOSING_KICK: Final = 0.5


@stage
def drift(moving: MovingBodies, first: int, end: int, dt: float) -> None:
    """Motion without forces."""
    for k in range(first, end):
        rows = moving.blocks[k]
        for b in range(moving.layout.size[k]):
            fly_and_split(rows, b, dt)


@stage
def kick_and_drift(
    moving: MovingBodies, first: int, end: int, kick_dt: float, drift_dt: float
) -> None:
    """`kick` and `drift` in one go, without a way to memory in between."""
    for k in range(first, end):
        rows, n = moving.blocks[k], moving.layout.size[k]
        solve_kicks(moving.acting, rows, n, kick_dt)
        for b in range(n):
            p, spin, R = kick_body(moving.acting, moving.sums_external, rows, b, kick_dt)
            x, q = get3(rows, COM, b), get4(rows, Q, b)
            m = turn_back(R, spin)
            put3(rows, COM, b, add_scaled(drift_dt * get(rows, INV_MASS, b), p, x))
            put4(rows, Q, b, symmetric_split(q, m, get3(rows, INV_INERTIA, b), drift_dt))


@stages
def step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Kick, drift; the kick of dt/2 that belongs to the end stays open."""
    kick_and_drift(moving, first, end, CLOSING_KICK * dt + open_kick, dt)


@stages
def coupled_step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """The same with flows of dashpots around the drift, in one order and in the reverse order.

    Loads of contacts are means over the kick, and need to know the drifts that it stands between.
    """
    kick_dt = CLOSING_KICK * dt + open_kick
    contact, team = moving.contact, moving.team
    keep_momenta(contact, BlockShare(moving.blocks, moving.layout, first, end))
    flow_dashpots(moving, open_kick, True)
    loads(moving, first, end, LoadTimes(dt, kick_dt, LEAPFROG, None))
    kick_walls(contact, team, open_kick, CLOSING_KICK * dt, True)
    kick(moving, first, end, kick_dt)
    flow_dashpots(moving, CLOSING_KICK * dt, False)
    drift(moving, first, end, dt)
    drift_walls(contact, team, dt)


METHOD: Final = Method(
    summary="order 2, symplectic; kick-drift-kick with a symmetric-top rotor; any force",
    order=2,
    accepts=frozenset({POSE, VELOCITY, TIME, BODIES, CONTACT, PISTONS}),
    cost=6.0,
    evaluations=1,
    keeps_rods=True,
    stability_limit=2.0,
    contact_limit=old_velocity,
    max_turn=0.5,
    closing_kick=CLOSING_KICK,
    step=step,
    coupled_step=coupled_step,
    has_dashpot_flows=True,
)
