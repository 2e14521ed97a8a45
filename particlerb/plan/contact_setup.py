"""Contact of a system, resolved: materials, walls, and who may touch whom.

`contact_of` makes arrays of what its records say. A body takes part with its particles of positive
radius.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.contact import ContactTable
from particlerb.case.problems import CaseError, Problem, nearest, problem_at
from particlerb.contact.piston import Pistons
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.wall_motion import PrescribedMotion
from particlerb.contact.wall_shapes import joined
from particlerb.contact.walls import Walls
from particlerb.maths.vec3 import Bools, Ints
from particlerb.model.system import System
from particlerb.plan.driven_bodies import driven_bodies
from particlerb.plan.initial_overlaps import refuse_misplaced
from particlerb.plan.joint_ends import bodies_apart
from particlerb.plan.material_pairs import MaterialPairs, pairs_of, side_by_side
from particlerb.plan.wall_setup import middle, motion_of, pistons_of, wall_of

NOTHING: Final = -1  # material of a body that touches nothing


class ContactSetup(NamedTuple):
    """All that records say about contact."""

    record: ContactTable  # what was asked for: law, skin, what is allowed
    materials: Sequence[str]  # (k,) names; a single "" where there are none
    pairs: MaterialPairs  # (k, k), or (n_worlds k, k) where the worlds differ in them
    body: Ints  # (m,) bodies of the system that may touch, ascending
    material: Ints  # (n_bodies,) code; NOTHING for the others
    fixed: Bools  # (n_bodies,) whether a body is held: it stays, or moves as prescribed
    driven: PrescribedBodies | None  # bodies of the system that move as prescribed
    walls: Walls  # primitives of all walls
    motions: tuple[PrescribedMotion, ...]  # (n_walls,)
    pistons: Pistons | None  # walls that slide
    wall_material: Ints  # (n_walls,) code
    apart: Ints  # (k,) pairs of bodies of the system that joints keep from touching


def contact_of(system: System) -> ContactSetup | None:
    """Contact of a system; None where nothing touches.

    Raises
    ------
    CaseError
        With all that is wrong: nothing that could touch, a body without radius, a material or a
        number that is missing, a file of triangles that cannot be read; and, where nothing of
        these is wrong, with what overlaps or lies beyond a wall at t = 0.
    """
    if system.contact is None:
        return None
    names = [material.name for material in system.material] or [""]
    problems = [*_without_radius(system), *_without_material(system, names)]
    codes = {name: k for k, name in enumerate(names)}
    code = np.array([codes.get(body.material or names[0], 0) for body in system.body])
    touches = np.array([body.contact for body in system.body])
    block = system.block
    material = np.where(touches[block], code[block], NOTHING)
    fixed = system.is_held
    parts: list[Walls] = []
    for number, table in enumerate(system.wall):
        try:
            parts.append(wall_of(system, number, table))
        except CaseError as error:
            problems += error.problems
    wall_material = np.array(
        [codes.get(w.material or names[0], 0) for w in system.wall], dtype=np.int64
    )
    one = slice(system.in_each)
    can_meet = _meetings(len(names), material[one], fixed[one], wall_material)
    if not problems and not can_meet.any():
        reason = "this takes two bodies, or a body and a wall, of which one can move"
        hint = "add a [[wall]] or a body, or leave [contact] out"
        problems.append(problem_at(system, "contact", f"nothing can touch: {reason}", hint))
    tables = system.contacts or (system.contact,)
    pairs = [pairs_of(system, table, names, can_meet) for table in tables]
    problems += [problem for _, missing in pairs for problem in missing]
    if problems:
        raise CaseError(problems)
    contact = ContactSetup(
        record=system.contact,
        materials=names,
        pairs=side_by_side([found for found, _ in pairs]),
        body=np.flatnonzero(material != NOTHING),
        material=material,
        fixed=fixed,
        driven=driven_bodies(system),
        walls=joined(parts),
        motions=tuple(motion_of(table.motion, middle(table)) for table in system.wall),
        pistons=pistons_of(system),
        wall_material=wall_material,
        apart=bodies_apart(system),
    )
    refuse_misplaced(system, contact)
    return contact


def _without_radius(system: System) -> list[Problem]:
    """What is wrong with bodies of which no particle has a radius."""
    largest = np.maximum.reduceat(system.particles.radius, system.particles.offset[:-1])
    bare = [
        i
        for i, first in enumerate(system.names.first[:-1])
        if system.body[i].contact and largest[system.kind[first]] == 0.0
    ]
    hint = "take a `ball` without `n`, give `points` a radius, or say contact = false"
    reason = "no particle has a radius: nothing can touch this body"
    return [
        problem_at(system, f"body[{i}].{'part' if system.body[i].part else 'shape'}", reason, hint)
        for i in bare
    ]


def _without_material(system: System, names: Sequence[str]) -> list[Problem]:
    """What is wrong with bodies and walls that do not say which of several materials they have."""
    if len(names) == 1:
        return []
    keys = [
        f"body[{i}]" for i, body in enumerate(system.body) if body.contact and not body.material
    ]
    keys += [f"wall[{i}]" for i, wall in enumerate(system.wall) if not wall.material]
    hint = nearest("", names)
    return [
        problem_at(system, f"{key}.material", "missing: there are several", hint) for key in keys
    ]


def _meetings(n_materials: int, material: Ints, fixed: Bools, walls: Ints) -> Bools:
    """Which pairs of materials can meet, (k, k).

    Parameters
    ----------
    n_materials : int
        k.
    material, fixed : ndarray, shape (n_bodies,)
        As in `ContactSetup`.
    walls : ndarray, shape (n_walls,)
        Code of each wall.
    """
    here = material != NOTHING
    moving = np.bincount(material[here & ~fixed], minlength=n_materials)
    still = np.bincount(material[here & fixed], minlength=n_materials)
    still += np.bincount(walls, minlength=n_materials)
    met = (moving[:, None] > 0) & ((moving + still)[None, :] > 0)
    own = (moving > 1) | ((moving == 1) & (still > 0))
    np.fill_diagonal(met, own)
    return np.asarray(met | met.T)
