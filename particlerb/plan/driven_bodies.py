"""Bodies that move as prescribed, whatever pushes them: how, and from where."""

import math

import numpy as np

from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.records import Records
from particlerb.contact.wall_motion import motion_records
from particlerb.maths.vec3 import Ints
from particlerb.model.system import System
from particlerb.plan.wall_setup import drive_of


def driven_bodies(system: System) -> PrescribedBodies | None:
    """Those of a system that begins at t = 0; None where there are none."""
    which = np.flatnonzero([system.body[k].motion is not None for k in system.block])
    if not which.size:
        return None
    bodies, (com, q, _, _) = system.bodies, system.state
    motions = [drive_of(system.body[system.block[b]], com[:, b]) for b in which.tolist()]
    at_start = np.array([math.sin(motion.phase) * np.array(motion.amplitude) for motion in motions])
    return PrescribedBodies(
        which,
        motion_records(motions),
        np.ascontiguousarray(com[:, which] - at_start.T),
        np.ascontiguousarray(q[:, which]),
        bodies.mass[which],
        np.ascontiguousarray(bodies.inertia[:, which]),
    )


def driven_among(driven: PrescribedBodies | None, members: Ints) -> PrescribedBodies | None:
    """Those among the members of a group, with their numbers there; None where there are none."""
    if driven is None:
        return None
    own = np.flatnonzero(np.isin(driven.which, members))
    if not own.size:
        return None
    order = np.argsort(members)
    which = order[np.searchsorted(members[order], driven.which[own])]
    com, q, inertia = (
        np.ascontiguousarray(values[:, own]) for values in (driven.com, driven.q, driven.inertia)
    )
    motions = driven.motions[own].view(Records)
    return PrescribedBodies(which, motions, com, q, driven.mass[own], inertia)
