"""The step of contacts without stiffness: by speed and size, as there is no frequency."""

import math
from typing import Final

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import taken
from particlerb.model.state import omega_world
from particlerb.model.system import System
from particlerb.plan.rates import falling_speed
from particlerb.plan.segments import GroupPlan, Segment

_OF_RADIUS: Final = 0.1  # that the fastest point moves in a step, at most
_OF_FALL: Final = 0.05  # of √(r/g), in which a body falls by half a radius
IMPULSE_RULE: Final = f"{_OF_RADIUS} r/v, {_OF_FALL} √(r/g)"
_OF_PATH: Final = 0.5  # of the path of a step: the mean overlap of what lands in its middle


def touches_by_impulses(segment: Segment) -> bool:
    """Whether contacts of a segment have no stiffness."""
    return segment.terms.contact is not None and segment.terms.contact.rules is not None


def _speed(system: System, group: GroupPlan, segment: Segment) -> float:
    """Speed [m/s] that points of bodies have at t = 0 and reach by falling."""
    contact, state = segment.terms.contact, taken(system.state, group.members)
    assert contact is not None
    speed = np.linalg.norm(state.p * group.bodies.inv_mass, axis=0)
    spin = np.linalg.norm(omega_world(group.bodies, state), axis=0)
    points: Floats = speed + spin * (contact.max_arm + contact.model.spheres.radius.max())
    return math.hypot(float(points.max()), falling_speed(system, segment.terms))


def impulse_step(system: System, group: GroupPlan) -> float:
    """Step [s] for contacts without stiffness; inf where a group has none.

    min(0.1 r/v, 0.05 √(r/g)) with the smallest radius r, the largest speed v, and gravity g.
    """
    step = math.inf
    for segment in group.segments:
        if not touches_by_impulses(segment):
            continue
        assert segment.terms.contact is not None
        radius = float(segment.terms.contact.model.spheres.radius.min())
        speed, g = _speed(system, group, segment), float(np.linalg.norm(system.acceleration))
        step = min(step, _OF_RADIUS * radius / speed if speed > 0.0 else math.inf)
        step = min(step, _OF_FALL * math.sqrt(radius / g) if g > 0.0 else math.inf)
    return step


def expected_overlap(system: System, group: GroupPlan, segment: Segment) -> float:
    """Overlap [m] to be expected of the fastest impact with restitution: ½ v dt."""
    return _OF_PATH * _speed(system, group, segment) * segment.dt
