"""RATTLE, kick - constrained drift - kick: bodies that joints hold together.

Order 2, symmetric, symplectic where the forces have a potential. The drift is that of `strang`,
repeated until it ends where the joints hold (joints/solver.py). The momenta are projected in frames
alone: the impulse that this takes is a part of the one of the next drift, in the same direction.

Source: Andersen, J. Comput. Phys. 52, 24 (1983); Reich, SIAM J. Numer. Anal. 33, 475 (1996).
"""

from typing import Final

from particlerb.contact.contact_model import LEAPFROG, LoadTimes
from particlerb.forces.kinds import BODIES, CONTACT, JOINTS, PISTONS, POSE, TIME, VELOCITY
from particlerb.integrators.contact_limits import old_velocity
from particlerb.integrators.contact_stages import drift_walls, keep_momenta, kick_walls
from particlerb.integrators.method import Method
from particlerb.integrators.pair_stages import BlockShare
from particlerb.integrators.stages import (
    MovingBodies,
    constrained_drift,
    kick_jointed,
    loads,
    stages,
)
from particlerb.integrators.strang import CLOSING_KICK


@stages
def coupled_step(moving: MovingBodies, first: int, end: int, open_kick: float, dt: float) -> None:
    """Kick, constrained drift; the kick of dt/2 that belongs to the end stays open."""
    kick_dt = CLOSING_KICK * dt + open_kick
    keep_momenta(moving.contact, BlockShare(moving.blocks, moving.layout, first, end))
    loads(moving, first, end, LoadTimes(dt, kick_dt, LEAPFROG, None))
    kick_walls(moving.contact, moving.team, open_kick, CLOSING_KICK * dt, True)
    kick_jointed(moving, first, end, open_kick, CLOSING_KICK * dt)
    damps = moving.jointed is not None and moving.jointed.damps is not None
    own_kick = CLOSING_KICK * dt if damps else kick_dt
    constrained_drift(moving, own_kick, 0.0, dt)
    drift_walls(moving.contact, moving.team, dt)


METHOD: Final = Method(
    summary="order 2, symplectic; strang with joints; any force but magnus",
    order=2,
    accepts=frozenset({POSE, VELOCITY, TIME, BODIES, CONTACT, PISTONS, JOINTS}),
    cost=1500.0,
    evaluations=1,
    keeps_rods=True,
    stability_limit=2.0,
    contact_limit=old_velocity,
    max_turn=0.5,
    closing_kick=CLOSING_KICK,
    coupled_step=coupled_step,
    holds_joints=True,
)
