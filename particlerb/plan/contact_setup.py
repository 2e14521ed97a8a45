"""Contact of a system, resolved: materials and pairs of them, walls, and who may touch whom.

`contact_of` makes arrays of what its records say. A body takes part with its particles of positive
radius.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.contact import ContactTable, Pair
from particlerb.case.problems import CaseError, Problem, nearest, problem_at, refuse
from particlerb.contact.piston import Pistons
from particlerb.contact.prescribed_motion import PrescribedBodies
from particlerb.contact.restitution import damping_ratio, effective_modulus, effective_shear_modulus
from particlerb.contact.wall_motion import PrescribedMotion
from particlerb.contact.wall_shapes import joined
from particlerb.contact.walls import Walls
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.system import System
from particlerb.plan.initial_overlaps import refuse_misplaced
from particlerb.plan.joint_ends import excluded_pairs
from particlerb.plan.joint_rows import bounds_of
from particlerb.plan.obstacles import pistons_of, prescribed_bodies, wall_motions, wall_of

_TANGENTIAL_RATIO: Final = 2.0 / 7.0  # default tangential over normal stiffness
NOTHING: Final = -1  # material of a body that touches nothing


class MaterialPairs(NamedTuple):
    """Numbers of every pair of k materials; symmetric, and zero where a pair cannot meet."""

    stiffness: Floats  # (k, k) [N/m] hooke, normal
    tangential_stiffness: Floats  # (k, k) [N/m] hooke
    modulus: Floats  # (k, k) [Pa] hertz, E*
    shear_modulus: Floats  # (k, k) [Pa] hertz, G*
    restitution: Floats  # (k, k)
    damping_ratio: Floats  # (k, k) ζ that gives the restitution with this law
    friction: Floats  # (k, k)
    rolling_friction: Floats  # (k, k)
    torsional_friction: Floats  # (k, k)
    can_meet: Bools  # (k, k)


class SystemContact(NamedTuple):
    """All that records say about contact."""

    record: ContactTable  # what was asked for: law, skin, what is allowed
    materials: Sequence[str]  # (k,) names; a single "" where there are none
    pairs: MaterialPairs  # (k, k), or (n_worlds k, k) where the worlds differ in them
    body: Ints  # (m,) bodies of the system that may touch, ascending
    material: Ints  # (n_bodies,) code; NOTHING for the others
    fixed: Bools  # (n_bodies,) whether a body is held: it stays, or moves as prescribed
    prescribed: PrescribedBodies | None  # bodies of the system that move as prescribed
    walls: Walls  # primitives of all walls
    motions: tuple[PrescribedMotion, ...]  # (n_walls,)
    pistons: Pistons | None  # walls that slide
    wall_material: Ints  # (n_walls,) code
    excluded: Ints  # (k,) pairs of bodies of the system that joints keep from touching


def contact_of(system: System, is_start: bool = True) -> SystemContact | None:
    """Contact of a system, which may stand at t = 0; None where nothing touches.

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
    code = [codes.get(b.material or names[0], 0) if b.contact else NOTHING for b in system.body]
    material = np.array(code)[system.block]
    fixed = system.is_held
    parts: list[Walls] = []
    for number, table in enumerate(system.wall):
        try:
            parts.append(wall_of(system, number, table))
        except CaseError as error:
            problems += error.problems
    wall_codes = [codes.get(wall.material or names[0], 0) for wall in system.wall]
    wall_material = np.array(wall_codes, dtype=np.int64)
    first_world = slice(system.in_each)
    slides = np.array([wall.piston is not None for wall in system.wall], dtype=np.bool_)
    ends = material[first_world], fixed[first_world], wall_material, slides
    can_meet = _meetings(len(names), *ends)
    if not problems and not can_meet.any() and not _is_for_joints(system):
        reason = "this takes two bodies, or a body and a wall, of which one can move"
        hint = "add a [[wall]] or a body, or leave [contact] out"
        problems.append(problem_at(system, "contact", f"nothing can touch: {reason}", hint))
    tables = system.contacts or (system.contact,)
    pairs = [pairs_of(system, table, names, can_meet) for table in tables]
    problems += [problem for _, missing in pairs for problem in missing]
    refuse(problems)
    contact = SystemContact(
        record=system.contact,
        materials=names,
        pairs=side_by_side([of_table for of_table, _ in pairs]),
        body=np.flatnonzero(material != NOTHING),
        material=material,
        fixed=fixed,
        prescribed=prescribed_bodies(system),
        walls=joined(parts),
        motions=wall_motions(system),
        pistons=pistons_of(system),
        wall_material=wall_material,
        excluded=excluded_pairs(system),
    )
    if can_meet.any() and is_start:
        refuse_misplaced(system, contact)
    return contact


def _without_radius(system: System) -> list[Problem]:
    """What is wrong with bodies of which no particle has a radius."""
    largest = np.maximum.reduceat(system.particles.radius, system.particles.offset[:-1])
    of_first = largest[system.kind[system.names.first[:-1]]]
    bare = [i for i, body in enumerate(system.body) if body.contact and of_first[i] == 0.0]
    hint = (
        "take a `ball` without `n`, give `points` a radius, add a part of `points` with a radius"
        " and mass = 0, which only touch (see [contact] in docs/case.md), or say contact = false"
    )
    reason = "no particle has a radius: nothing can touch this body"
    return [
        problem_at(system, f"body[{i}].{'part' if system.body[i].part else 'shape'}", reason, hint)
        for i in bare
    ]


def _without_material(system: System, names: Sequence[str]) -> list[Problem]:
    """What is wrong with bodies and walls that do not say which of several materials they have."""
    if len(names) == 1:
        return []
    keys = [f"body[{i}]" for i, b in enumerate(system.body) if b.contact and not b.material]
    keys += [f"wall[{i}]" for i, wall in enumerate(system.wall) if not wall.material]
    hint = nearest("", names)
    reason = "missing: there are several"
    return [problem_at(system, f"{key}.material", reason, hint) for key in keys]


def _meetings(n_materials: int, material: Ints, fixed: Bools, walls: Ints, slides: Bools) -> Bools:
    """Which pairs of materials can meet, (k, k).

    Parameters
    ----------
    n_materials : int
        k.
    material, fixed : ndarray, shape (n_bodies,)
        As in `SystemContact`.
    walls, slides : ndarray, shape (n_walls,)
        Code of each wall, and whether it has a piston: then fixed bodies meet it too.
    """
    touches = material != NOTHING
    moving = np.bincount(material[touches & ~fixed], minlength=n_materials)
    still = np.bincount(material[touches & fixed], minlength=n_materials)
    sliding = np.bincount(walls[slides], minlength=n_materials)
    by_sliding = (still[:, None] > 0) & (sliding[None, :] > 0)
    still += np.bincount(walls, minlength=n_materials)
    met = (moving[:, None] > 0) & ((moving + still)[None, :] > 0)
    with_itself = (moving > 1) | ((moving == 1) & (still > 0))
    np.fill_diagonal(met, with_itself)
    met |= by_sliding
    return np.asarray(met | met.T)


def _is_for_joints(system: System) -> bool:
    """Whether [contact] is needed, though nothing meets: its law solves what acts in joints."""
    assert system.contact is not None
    return system.contact.law == "impulse" and bool(bounds_of(system.joint).row.size)


def pairs_of(
    system: System, table: ContactTable, names: Sequence[str], can_meet: Bools
) -> tuple[MaterialPairs, list[Problem]]:
    """Numbers of all pairs that can meet, (k, k), and what is wrong where some are missing."""
    numbers = np.zeros((len(MaterialPairs._fields) - 1, *can_meet.shape))
    pairs = MaterialPairs._make([*numbers, can_meet])
    by_names = {frozenset(pair.materials): (i, pair) for i, pair in enumerate(table.pair)}
    problems: list[Problem] = []
    is_hertz = table.law == "hertz"
    if is_hertz:
        problems += _without_moduli(system, can_meet)
    for a, b in np.argwhere(np.triu(can_meet)).tolist():
        number, pair = by_names.get(frozenset((names[a], names[b])), (-1, None))
        needed = ["restitution", "friction"] + (["stiffness"] if table.law == "hooke" else [])
        missing = [key for key in needed if _number_of(table, pair, key) is None]
        if missing:
            problems += [_missing_number(system, names, a, b, number, missing)]
            continue
        for key in (*needed, "rolling_friction", "torsional_friction"):
            _both(getattr(pairs, key), a, b, _number_of(table, pair, key) or 0.0)
        if not table.has_stiffness:
            continue
        ratio = damping_ratio(float(pairs.restitution[a, b]), table.attract)
        _both(pairs.damping_ratio, a, b, ratio)
        if is_hertz:
            continue
        tangential = _number_of(table, pair, "tangential_stiffness")
        if tangential is None:
            tangential = _TANGENTIAL_RATIO * float(pairs.stiffness[a, b])
        _both(pairs.tangential_stiffness, a, b, tangential)
    if is_hertz and not problems:
        _add_moduli(system, pairs)
    return pairs, problems


def side_by_side(pairs: Sequence[MaterialPairs]) -> MaterialPairs:
    """Numbers of several worlds, the rows of one below those of the other."""
    return MaterialPairs(*map(np.concatenate, zip(*pairs, strict=True)))


def _number_of(table: ContactTable, pair: Pair | None, key: str) -> float | None:
    """Number of a pair, its own or that of all pairs."""
    own: float | None = None if pair is None else getattr(pair, key)
    return getattr(table, key) if own is None else own


def _both(array: Floats, a: int, b: int, value: float) -> None:
    """Write a number of a pair, which has no first."""
    array[a, b] = array[b, a] = value


def _missing_number(
    system: System, names: Sequence[str], a: int, b: int, number: int, missing: Sequence[str]
) -> Problem:
    """Numbers that a pair needs and that are nowhere given."""
    listed = " and ".join(f"`{key}`" for key in missing)
    if len(names) == 1:
        reason = f"missing: contact needs {listed}"
        return problem_at(system, f"contact.{missing[0]}", reason, "give it in [contact]")
    pair = f"{names[a]} with {names[b]}" if a != b else f"{names[a]} with itself"
    if number >= 0:
        key, reason = f"contact.pair[{number}].{missing[0]}", f"missing: {pair} needs {listed}"
        return problem_at(system, key, reason, "give it here, or in [contact] for all pairs")
    reason = f"missing: {pair}, which can touch, has no {listed}"
    hint = f'add [[contact.pair]] with materials = ["{names[a]}", "{names[b]}"]'
    return problem_at(system, "contact.pair", reason, f"{hint}, or give {listed} in [contact]")


def _without_moduli(system: System, can_meet: Bools) -> list[Problem]:
    """What hertz lacks: materials that can touch, with both of their constants."""
    if not system.material:
        reason = "hertz needs a [[material]] with `young` and `poisson`"
        return [problem_at(system, "contact.law", reason, 'add it, or take law = "hooke"')]
    return [
        problem_at(system, f"material[{k}].{key}", "missing: hertz needs it", "give it")
        for k in np.flatnonzero(can_meet.any(axis=0)).tolist()
        for key in ("young", "poisson")
        if getattr(system.material[k], key) is None
    ]


def _add_moduli(system: System, pairs: MaterialPairs) -> None:
    """Write E* and G* of all pairs that can meet."""
    for a, b in np.argwhere(pairs.can_meet).tolist():
        first, second = system.material[a], system.material[b]
        young = (first.young or 0.0, second.young or 0.0)
        poisson = (first.poisson or 0.0, second.poisson or 0.0)
        pairs.modulus[a, b] = effective_modulus(young, poisson)
        pairs.shear_modulus[a, b] = effective_shear_modulus(young, poisson)
