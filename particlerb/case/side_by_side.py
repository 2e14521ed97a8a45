"""Cases that differ in numbers alone, side by side as worlds of one system.

What no case changes is made once; what some change is made for each of them, as if alone.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from particlerb.case.bodies import Body, InBody, NormalDistribution, RandomBox
from particlerb.case.placement import (
    Placement,
    in_world,
    orientations,
    place,
    positions,
    vectors,
)
from particlerb.case.problems import Path
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.case.source import Source
from particlerb.case.to_system import centred_at_com, farthest, kinds, spins_of, to_system
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import bodies_of_kind
from particlerb.model.names import NamesInWorlds
from particlerb.model.state import initial_state
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError

_RANDOM = ("place", "orientation", "velocity", "angular_velocity")


def variants_side_by_side(
    source: Source, raw: Sequence[dict[str, Any]], paths: Sequence[Path]
) -> System:
    """System of variants that have been checked as cases before: what differs is read anew.

    Parameters
    ----------
    source : Source
        Of the case that they are variants of.
    raw : sequence of dict
        Data of each.
    paths : sequence of Path
        Keys in which they differ: of [run], of a body, or of a force.

    Raises
    ------
    CaseError, WorldsDifferError
        As `side_by_side`.
    """
    first = build(source._replace(raw=raw[0]), ())
    cases = [first]
    for own in raw[1:]:
        update: dict[str, Any] = {"run": type(first.run).model_validate(own["run"])}
        for table in ("body", "force"):
            records = list(getattr(first, table))
            for i in {int(path[1]) for path in paths if path[0] == table}:
                records[i] = type(records[i]).model_validate(own[table][i])
            update[table] = tuple(records)
        cases.append(first.model_copy(update=update))
    return side_by_side(cases)


def side_by_side(cases: Sequence[Case]) -> System:
    """System of cases that have the same records but for numbers of bodies, forces and seeds.

    Records that are the same object in a case and in the first one are taken to be unchanged.

    Raises
    ------
    CaseError
        As `to_system`.
    WorldsDifferError
        If a body spins as it cannot, as `to_system` would say of its case.
    """
    first, n_worlds = to_system(cases[0]), len(cases)
    changed = [
        (w, i)
        for w, case in enumerate(cases)
        for i, body in enumerate(case.body)
        if body is not cases[0].body[i] or _draws_anew(body, case, cases[0])
    ]
    placement = _placement(cases, changed)
    kind = np.tile(first.kind, (n_worlds, 1))
    records = (*cases[0].body, *(cases[w].body[i] for w, i in changed))
    particles, properties, of_record = kinds(cases[0].model_copy(update={"body": records}), [])
    own = {i: first.block == i for i in range(len(cases[0].body))}
    for (w, i), k in zip(changed, of_record[len(cases[0].body) :].tolist(), strict=True):
        kind[w, own[i]] = k
    bodies = bodies_of_kind(properties, kind.ravel())
    omega, size, total = spins_of(placement, bodies)
    is_drawn = [isinstance(body.angular_velocity, NormalDistribution) for body in cases[0].body]
    if (size > total)[~np.array(is_drawn)[placement.block]].any():
        raise WorldsDifferError("a body spins as it cannot")
    x, q, v = placement.position, placement.orientation, placement.velocity
    centred = centred_at_com(particles, properties)
    return first._replace(
        names=placement.names,
        block=placement.block,
        kind=kind.ravel(),
        particles=centred,
        properties=properties,
        summed=np.diff(particles.offset),
        reach=farthest(centred),
        bodies=bodies,
        state=initial_state(bodies, x, q, v, omega),
        n_worlds=n_worlds,
        others={
            j: tuple(case.force[j] for case in cases)
            for j, force in enumerate(cases[0].force)
            if any(case.force[j] is not force for case in cases)
        },
    )


def _draws_anew(body: Body, case: Case, first: Case) -> bool:
    """Whether another seed gives a body other initial values."""
    if case.run.seed == first.run.seed:
        return False
    drawn = NormalDistribution, RandomBox, str
    return any(isinstance(getattr(body, key), drawn) for key in _RANDOM)


def _placement(cases: Sequence[Case], changed: Sequence[tuple[int, int]]) -> Placement:
    """Initial values of the bodies of all cases."""
    base, n_worlds = place(cases[0]), len(cases)
    values = [np.tile(array, (n_worlds, 1, 1)) for array in base[1:5]]
    position, orientation, velocity, spin = values
    by_record: dict[int, list[int]] = {}
    for w, i in changed:
        by_record.setdefault(i, []).append(w)
    for i, which in by_record.items():
        own = slice(base.names.first[i], base.names.first[i + 1])
        for w in which:
            position[w, own] = positions(cases[w], i)
            turn = cases[w].body[i].orientation
            if isinstance(turn, str) or turn != cases[0].body[i].orientation:
                orientation[w, own] = orientations(cases[w], i)
        q = orientation[which, own]
        velocity[which, own] = _vectors(cases, which, i, "velocity", q)
        spin[which, own] = _vectors(cases, which, i, "angular_velocity", q)
    x, q, v, omega = (array.reshape(-1, array.shape[-1]) for array in values)
    names = NamesInWorlds(base.names.records, n_worlds)
    return Placement(np.tile(base.block, n_worlds), x, q, v, omega, names)


def _vectors(cases: Sequence[Case], which: Sequence[int], i: int, key: str, q: Floats) -> Floats:
    """Velocities, or angular velocities, of a record in some cases, (k, count, 3) or (k, 1, 3)."""
    given = [getattr(cases[w].body[i], key) for w in which]
    if all(isinstance(one, InBody) for one in given):
        return in_world(q, np.array([one.body for one in given])[:, None])
    found = [
        np.atleast_2d(vectors(cases[w], i, key, one, turn))
        for w, one, turn in zip(which, given, q, strict=True)
    ]
    return np.array(found)
