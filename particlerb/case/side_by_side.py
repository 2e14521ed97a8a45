"""Cases that differ in numbers alone, side by side as worlds of one system.

What no case changes is made once; what some change is made for each of them, as if alone.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from particlerb.case.bodies import InBody, NormalDistribution, RandomBox
from particlerb.case.changes import changed
from particlerb.case.overrides import with_values
from particlerb.case.placement import (
    Placement,
    in_world,
    orientations,
    placement_of,
    positions,
    unit_vectors,
    vectors,
)
from particlerb.case.problems import Path, Source
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.case.to_system import centred_at_com, farthest, kinds, spins_of, to_system
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import bodies_of_kind
from particlerb.model.names import BodyNames
from particlerb.model.state import initial_state
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError

_MATTER_KEYS = ("shape", "mass", "density")
_RANDOM_TYPES = (NormalDistribution, RandomBox, str)
_Changes = Mapping[Path, Sequence[Any]]


def side_by_side(source: Source, paths: Sequence[Path], rows: Sequence[Sequence[Any]]) -> System:
    """System of variants of a case: what differs is read anew.

    Parameters
    ----------
    source : Source
        Of the case that they are variants of.
    paths : sequence of Path
        Keys in which they differ: numbers of a body, a force or of contact, or run.seed.
    rows : sequence
        Values of these keys, for each variant, of the same `likeness`.

    Raises
    ------
    CaseError
        As `to_system`, of the first.
    WorldsDifferError
        If another is wrong: each alone says in what.
    """
    raw = with_values(source.raw, paths, rows[0])
    case, n_worlds = build(source._replace(raw=raw), ()), len(rows)
    changes, wrong = changed(case, paths, rows)
    if wrong:
        raise WorldsDifferError("some are no cases")
    first = to_system(case)
    placement = _placement(case, changes, n_worlds)
    made = _kinds(case, changes, first, n_worlds)
    bodies = bodies_of_kind(made["properties"], made["kind"])
    omega, size, total = spins_of(placement, bodies)
    is_drawn = [isinstance(body.angular_velocity, NormalDistribution) for body in case.body]
    if (size > total)[~np.array(is_drawn)[placement.block]].any():
        raise WorldsDifferError("a body spins as it cannot")
    x, q, v = placement.position, placement.orientation, placement.velocity
    return first._replace(
        names=placement.names,
        block=placement.block,
        **made,
        bodies=bodies,
        state=initial_state(bodies, x, q, v, omega),
        n_worlds=n_worlds,
        contacts=tuple(changes.get(("contact",), ())),
        others={int(at[1]): tuple(each) for at, each in changes.items() if at[0] == "force"},
    )


def _kinds(case: Case, changes: _Changes, first: System, n_worlds: int) -> dict[str, Any]:
    """Kinds of the bodies of all worlds, and what a system says of them."""
    kind, n, records = np.tile(first.kind, (n_worlds, 1)), len(case.body), list(case.body)
    owners = []
    for i, body in enumerate(case.body):
        new = {key: changes["body", i, key] for key in _MATTER_KEYS if ("body", i, key) in changes}
        if new:
            owners.append(i)
            each = zip(*new.values(), strict=True)
            records += [body.model_copy(update=dict(zip(new, row, strict=True))) for row in each]
    if not owners:
        return {"kind": kind.ravel(), "properties": first.properties}
    all_records = case.model_copy(update={"body": tuple(records)})
    particles, properties, of_record = kinds(all_records, [])
    for i in range(n):
        own = range(i, i + 1)
        if i in owners:
            own = range(n + n_worlds * owners.index(i), n + n_worlds * (owners.index(i) + 1))
        kind[:, first.block == i] = [of_record[k] + records[k].kinds for k in own]
    centred = centred_at_com(particles, properties)
    return {
        "kind": kind.ravel(),
        "particles": centred,
        "properties": properties,
        "summed": np.diff(particles.offset),
        "reach": farthest(centred),
    }


def _placement(case: Case, changes: _Changes, n_worlds: int) -> Placement:
    """Initial values of the bodies of all worlds."""
    base = placement_of(case)
    values = [np.tile(array, (n_worlds, 1, 1)) for array in base[1:5]]
    position, orientation, velocity, spin = values
    for i, body in enumerate(case.body):

        def differs(key: str, i: int = i, body: Any = body) -> bool:
            is_drawn = ("run",) in changes and isinstance(getattr(body, key), _RANDOM_TYPES)
            return is_drawn or ("body", i, key) in changes

        members = slice(base.names.first[i], base.names.first[i + 1])
        if differs("position") or differs("place"):
            key = "position" if body.place is None else "place"
            position[:, members] = _of_worlds(case, changes, n_worlds, i, key)
        turns = differs("orientation")
        if turns:
            orientation[:, members] = _of_worlds(case, changes, n_worlds, i, "orientation")
        for key, array in (("velocity", velocity), ("angular_velocity", spin)):
            if differs(key) or (turns and isinstance(getattr(body, key), InBody)):
                q = orientation[:, members]
                array[:, members] = _of_worlds(case, changes, n_worlds, i, key, q)
    x, q, v, omega = (array.reshape(-1, array.shape[-1]) for array in values)
    names = BodyNames(base.names.records, n_worlds=n_worlds)
    return Placement(np.tile(base.block, n_worlds), x, q, v, omega, names)


def _of_worlds(
    case: Case, changes: _Changes, n_worlds: int, i: int, key: str, q: Floats | None = None
) -> Floats:
    """Initial values of a record in all worlds, (n_worlds, count or 1, k)."""
    body = case.body[i]
    entries = changes.get(("body", i, key), [getattr(body, key)] * n_worlds)
    if all(type(entry) is tuple for entry in entries):
        values = np.array(entries)[:, None]
        return unit_vectors(values) if key == "orientation" else values
    if q is not None and all(isinstance(entry, InBody) for entry in entries):
        return in_world(q, np.array([entry.body for entry in entries])[:, None])
    rows, records, bodies = [], list(case.body), range(body.count)
    runs = changes.get(("run",), [case.run] * n_worlds)
    for w, (entry, run) in enumerate(zip(entries, runs, strict=True)):
        records[i] = body.model_copy(update={key: entry})
        variant = case.model_copy(update={"run": run, "body": tuple(records)})
        if q is not None:
            rows.append(vectors(variant, i, key, entry, q[w], bodies))
        else:
            placed = orientations if key == "orientation" else positions
            rows.append(placed(variant, i, bodies))
    return np.array([np.atleast_2d(row) for row in rows])
