"""Numbers of the contacts between materials: given for a pair, or for all, or derived.

Only pairs of materials that can meet need numbers: those of two bodies of which one can move, and
of such a body and a wall.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.contact import ContactTable, Pair
from particlerb.case.problems import Problem, problem_at
from particlerb.contact.restitution import damping_ratio, effective_modulus, effective_shear_modulus
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.system import System

_TANGENTIAL: Final = 2.0 / 7.0  # default tangential over normal stiffness


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
    can_meet: Bools  # (k, k)


def pairs_of(
    system: System, table: ContactTable, names: Sequence[str], can_meet: Bools
) -> tuple[MaterialPairs, list[Problem]]:
    """Numbers of all pairs that can meet, and what is wrong where some are missing."""
    pairs = MaterialPairs._make(
        [*np.zeros((len(MaterialPairs._fields) - 1, *can_meet.shape)), can_meet]
    )
    own = {frozenset(pair.materials): (i, pair) for i, pair in enumerate(table.pair)}
    problems: list[Problem] = []
    is_hertz = table.law == "hertz"
    if is_hertz:
        problems += _without_moduli(system, can_meet)
    for a, b in np.argwhere(np.triu(can_meet)).tolist():
        number, pair = own.get(frozenset((names[a], names[b])), (-1, None))
        needed = ["restitution", "friction"] + (["stiffness"] if table.law == "hooke" else [])
        missing = [key for key in needed if _number_of(table, pair, key) is None]
        if missing:
            problems += [_missing_number(system, names, a, b, number, missing)]
            continue
        for key in (*needed, "rolling_friction"):
            _both(getattr(pairs, key), a, b, _number_of(table, pair, key) or 0.0)
        if not table.has_stiffness:
            continue
        ratio = damping_ratio(float(pairs.restitution[a, b]), table.attract)
        _both(pairs.damping_ratio, a, b, ratio)
        if is_hertz:
            continue
        tangential = _number_of(table, pair, "tangential_stiffness")
        if tangential is None:
            tangential = _TANGENTIAL * float(pairs.stiffness[a, b])
        _both(pairs.tangential_stiffness, a, b, tangential)
    if is_hertz and not problems:
        _add_moduli(system, pairs)
    return pairs, problems


def side_by_side(pairs: Sequence[MaterialPairs]) -> MaterialPairs:
    """Numbers of several worlds, the rows of one below those of the other."""
    return MaterialPairs(*map(np.concatenate, zip(*pairs, strict=True)))


def _number_of(table: ContactTable, pair: Pair | None, key: str) -> float | None:
    """Number of a pair, its own or that of all pairs."""
    value: float | None = None if pair is None else getattr(pair, key)
    if value is None:
        value = getattr(table, key)
    return value


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
    which = f"{names[a]} with {names[b]}" if a != b else f"{names[a]} with itself"
    if number >= 0:
        key, reason = f"contact.pair[{number}].{missing[0]}", f"missing: {which} needs {listed}"
        return problem_at(system, key, reason, "give it here, or in [contact] for all pairs")
    reason = f"missing: {which}, which can touch, has no {listed}"
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
        one, other = system.material[a], system.material[b]
        young = (one.young or 0.0, other.young or 0.0)
        poisson = (one.poisson or 0.0, other.poisson or 0.0)
        pairs.modulus[a, b] = effective_modulus(young, poisson)
        pairs.shear_modulus[a, b] = effective_shear_modulus(young, poisson)
