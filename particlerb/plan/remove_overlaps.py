"""Bodies pushed apart where they overlap at t = 0, if `contact.relax` asks for it.

Each round, every overlap pushes its two bodies apart by half of its depth each, or the one that can
move by all of it; a body takes the mean of its pushes, a little lengthened. Attitudes stay.
"""

from typing import Final

import numpy as np

from particlerb.case.problems import CaseError, problem_at
from particlerb.contact.sphere_search import SphereSearch
from particlerb.contact.wall_motion import poses_at
from particlerb.contact.wall_search import WallSearch
from particlerb.contact.walls import gaps
from particlerb.maths.vec3 import Floats
from particlerb.model.state import lengths
from particlerb.model.system import System
from particlerb.plan.contact_setup import SystemContact, contact_of
from particlerb.plan.initial_overlaps import spheres_of

ROUNDS: Final = 2000  # at most
_OVERRELAXATION: Final = 1.5  # times the mean of all pushes on a body
_MAX_OVERLAP_LEFT: Final = 1e-3  # in units of the smallest radius


def remove_overlaps(system: System) -> System:
    """The system with its bodies pushed apart, if `contact.relax` asks for it.

    Raises
    ------
    CaseError
        As `contact_of`; if joints hold bodies, or these have too little room to be pushed apart.
    """
    if system.contact is None or not system.contact.relax:
        return system
    if system.joint:
        reason = "bodies that joints hold are not pushed apart"
        raise CaseError([problem_at(system, "contact.relax", reason, "place them apart")])
    contact = contact_of(system)
    assert contact is not None
    return system._replace(state=system.state._replace(com=_pushed_apart(system, contact)))


def _pushed_apart(system: System, contact: SystemContact) -> Floats:
    """Centres of mass (3, n_bodies) [m] with which hardly anything overlaps.

    Raises
    ------
    CaseError
        If overlaps remain.
    """
    spheres = spheres_of(system, contact)
    place, radius, body = spheres
    com, moves = system.state.com.copy(), ~contact.fixed
    search, walls = SphereSearch(radius, body), WallSearch(contact.walls, radius)
    poses = poses_at(contact.motions, 0.0)
    enough = max(_MAX_OVERLAP_LEFT * float(radius.min()), contact.record.overlap)
    deepest = np.inf
    for _ in range(ROUNDS):
        points = np.ascontiguousarray(place + (com - system.state.com)[:, body])
        first, second, _ = search.pairs(points, 0.0)
        d = points[:, second] - points[:, first]
        d[0, ~d.any(axis=0)] = 1e-300  # one centre: along x
        distance = np.maximum(lengths(d), 1e-300)
        depth = radius[first] + radius[second] - distance
        a, b = body[first], body[second]
        share = moves[a].astype(float) + moves[b]
        depth *= share > 0.0
        push = d / distance * depth / np.maximum(share, 1.0)
        i, p, _ = walls.pairs(points, poses, 0.0)
        gap = gaps(contact.walls, poses, points, i, p)
        size = np.maximum(lengths(gap), 1e-300)
        into = np.maximum(radius[i] - size, 0.0) * moves[body[i]]
        deepest = max(float(depth.max(initial=0.0)), float(into.max(initial=0.0)))
        if deepest <= enough:
            return com
        bodies = np.concatenate([a, b, body[i]])
        pushes = np.concatenate([-push, push, gap / size * into], axis=1)
        counts = np.maximum(np.bincount(bodies, minlength=moves.size), 1)
        for c in range(3):
            total = np.bincount(bodies, pushes[c], moves.size)
            com[c] += _OVERRELAXATION * total / counts * moves
    reason = f"bodies still overlap by {deepest:.3g} m after {ROUNDS} rounds of pushing them apart"
    raise CaseError([problem_at(system, "contact.relax", reason, "give them more space")])
