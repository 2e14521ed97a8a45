"""Torques: free couples in the world, or in the body, where they follow it.

No potential in general; kicks add the work.
"""

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.forces.kinds import Force, Kick, Momenta, Rates, Term, numbers_of
from particlerb.forces.push import Follower
from particlerb.forces.ramp import FollowerRamp, Ramp, course_of, load_values
from particlerb.maths.quaternion import Matrix
from particlerb.maths.vec3 import Floats, Vec3, add_scaled
from particlerb.model.block import get3
from particlerb.model.bodies import Bodies
from particlerb.model.state import lengths, rotate_back

if TYPE_CHECKING:
    from particlerb.case.forces import TorqueTable


class Torque(NamedTuple):
    """Parameters of the term for n bodies."""

    torque: Floats  # (3, n) [N m], world frame, the sum for each body


@inline
def _kick_torque(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, dt: float, p: Vec3, L: Vec3
) -> Momenta:
    """L + τ dt."""
    return p, add_scaled(dt, get3(rows, at, b), L)


@inline
def _change_torque(
    rows: Floats, at: int, b: int, x: Vec3, R: Matrix, motion: Momenta, F: Vec3, tau: Vec3
) -> Momenta:
    """Nothing: it is the same for all poses."""
    return F, tau


KICK: Final = Kick("torque", 3, _kick_torque, change=_change_torque)


def _term_of(
    table: "TorqueTable", numbers: Floats, bodies: Bodies, start: float
) -> Torque | Follower | Ramp | FollowerRamp:
    """A torque in the world, or one that follows the body; constant, or not."""
    course = course_of(table, numbers, start)
    none = np.broadcast_to(0.0, course.midway.shape)
    if table.frame == "world":
        if course.is_constant:
            return Torque(course.midway)
        return Ramp(none, course.midway, none, course.change, course.clock, none)
    local = course.turned(lambda vector: rotate_back(bodies.rotor_frame, vector))
    if local.is_constant:
        return Follower(none, local.midway)
    return FollowerRamp(none, local.midway, none, local.change, local.clock)


def turning(table: "TorqueTable", is_point: bool) -> tuple[str, str]:
    """Key and hint where it turns a point, or a rod about its axis."""
    return "torque", "leave it out" if is_point else "give a torque across the rod"


FORCE: Final = Force(
    numbers_of(load_values), _term_of, is_torque=True,
    turning=turning,
)  # fmt: skip
TERMS: Final = (
    Term(Torque, "torque", KICK, lambda torque, *_: Rates(spinning=lengths(torque.torque))),
)
