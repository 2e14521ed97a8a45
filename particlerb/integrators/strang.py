"""Strang splitting, kick - drift - kick, with the symmetric-top rotor: the default under force.

Order 2, symmetric, symplectic where the forces have a potential. The drift is exact for points,
rods, spheres and symmetric tops; kicks are the exact flow of the forces at a fixed pose, drag
included.

Source: Strang, SIAM J. Numer. Anal. 5, 506 (1968); the rotor: rotors/symmetric_split.py.
"""

from typing import Final

from particlerb.compiled.jit import inline, kernel_from
from particlerb.forces.kernels import Acting, prepare_kick
from particlerb.forces.kinds import BODIES, CONTACT, POSE, TIME, VELOCITY
from particlerb.maths.quaternion import turn_back
from particlerb.maths.vec3 import Floats, add_scaled
from particlerb.model.block import COM, INV_INERTIA, INV_MASS, Q, get, get3, get4, put3, put4
from particlerb.model.state import State
from particlerb.rotors.symmetric_split import symmetric_split
from particlerb.stepping.contact_run import TouchingMotion, kernels_of
from particlerb.stepping.coupled import CoupledMotion, one_stage
from particlerb.stepping.kicks import kick
from particlerb.stepping.loop import SteppedMotion, advance_blocks
from particlerb.stepping.motion import Group, Motion
from particlerb.stepping.sparse_contact import DiluteMotion, can_fly

ORDER: Final = 2
FREE_ORDER: Final = 2
IS_ADAPTIVE: Final = False
KEEPS_RODS: Final = True
ACCEPTS: Final = frozenset({POSE, VELOCITY, TIME, BODIES, CONTACT})
SUMMARY: Final = "order 2, symplectic; kick-drift-kick with a symmetric-top rotor; any force"
COST: Final = 6.0  # ns per body-step, roughly
EVALUATIONS: Final = 1  # of the forces in a step
REACH: Final = 2.0  # largest hω of an oscillator that stays bounded
LONGEST: Final = 0.5  # rad in one step above which it is worth a warning
EDGE: Final = 0.5


@inline
def step(
    acting: Acting, books: int | None, rows: Floats, n: int, opening: float, dt: float
) -> None:
    """K(opening) D(dt); the kick of dt/2 that belongs to the end stays open."""
    prepare_kick(acting, rows, n, opening)
    for b in range(n):
        p, L, R = kick(acting, books, rows, b, opening)
        x, q = get3(rows, COM, b), get4(rows, Q, b)
        put3(rows, COM, b, add_scaled(dt * get(rows, INV_MASS, b), p, x))
        put4(rows, Q, b, symmetric_split(q, turn_back(R, L), get3(rows, INV_INERTIA, b), dt))


advance = kernel_from(advance_blocks, "strang", step=step, EDGE=EDGE)
together = one_stage("strang", step, EDGE, flows=True)
touching = kernels_of("strang", together)


def begin(group: Group, state: State, start: float, dt: float, tolerance: float) -> Motion:
    """Set off from a state at a time [s]."""
    del tolerance
    if group.terms.contact is not None:
        kind = DiluteMotion if can_fly(group.terms, group.members.size) else TouchingMotion
        return kind(touching, together, COST, group, state, start, dt)
    if group.terms.is_coupled:
        return CoupledMotion(together, COST, group, state, start, dt)
    return SteppedMotion(advance, COST, group, state, start, dt)
