"""Bodies of a case, pushed apart where they overlap at t = 0 and the case asks for it.

Each round, every overlap pushes its two bodies apart by half of its depth each, or the one that can
move by all of it; a body takes the mean of its pushes, a little lengthened. Attitudes stay.
"""

from typing import Final

import numpy as np

from particlerb.case.placement import first_bodies
from particlerb.case.problems import CaseError
from particlerb.case.reader import problem_at
from particlerb.case.schema import Case
from particlerb.case.to_system import System, assemble
from particlerb.contact.sphere_search import SphereSearch
from particlerb.contact.wall_motion import poses_at
from particlerb.contact.wall_search import WallSearch
from particlerb.contact.walls import gaps
from particlerb.maths.vec3 import Floats
from particlerb.model.state import lengths
from particlerb.plan.contact_setup import ContactSetup, contact_of, shift_of, spheres_of

ROUNDS: Final = 2000  # at most
LENGTHENED: Final = 1.5  # times the mean of all pushes on a body
LEFT: Final = 1e-3  # overlap that may be left, in units of the smallest radius


def assembled(case: Case) -> System:
    """Scene of a case, pushed apart where `contact.relax` asks for it.

    Raises
    ------
    CaseError
        As `assemble` and `contact_of`; and if bodies have too little room to be pushed apart.
    """
    scene = displaced(case, assemble(case))
    if case.contact is None or not case.contact.relax:
        return scene
    contact = contact_of(case, scene)
    assert contact is not None
    com = pushed_apart(case, scene, contact)
    return scene._replace(state=scene.state._replace(com=com))


def displaced(case: Case, scene: System) -> System:
    """Scene with driven bodies where their motion has them at t = 0."""
    if all(body.motion is None for body in case.body):
        return scene
    com, first = scene.state.com.copy(), first_bodies(case)
    for i, body in enumerate(case.body):
        com[:, first[i] : first[i + 1]] += shift_of(body)[:, None]
    return scene._replace(state=scene.state._replace(com=com))


def pushed_apart(case: Case, scene: System, contact: ContactSetup) -> Floats:
    """Centres of mass (3, n_bodies) [m] with which hardly anything overlaps.

    Raises
    ------
    CaseError
        If overlaps remain.
    """
    spheres = spheres_of(scene, contact)
    place, radius, body = spheres
    com, moves = scene.state.com.copy(), ~contact.fixed
    search, walls = SphereSearch(radius, body), WallSearch(contact.walls, radius)
    poses = poses_at(contact.motions, 0.0)
    enough = max(LEFT * float(radius.min()), case.contact.overlap if case.contact else 0.0)
    deepest = np.inf
    for _ in range(ROUNDS):
        points = np.ascontiguousarray(place + (com - scene.state.com)[:, body])
        first, second, _ = search.pairs(points, 0.0)
        d = points[:, second] - points[:, first]
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
            com[c] += LENGTHENED * total / counts * moves
    reason = f"bodies still overlap by {deepest:.3g} m after {ROUNDS} rounds of pushing them apart"
    raise CaseError([problem_at(case, "contact.relax", reason, "give them more room")])
