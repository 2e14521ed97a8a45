"""Variants of a sweep in one batch: who may share one, and the rows of those that do.

Variants share a batch where nothing couples their bodies, where the times, the method and all keys
that are no numbers of bodies or forces are the same, and where the same numbers are zero. Their
bodies stand in one system, as worlds (model/worlds.py); each world has the bits of a run alone.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from particlerb.case.bodies import Body
from particlerb.case.forces import PythonTable, SpringTable
from particlerb.case.output import Asked
from particlerb.case.problems import Path
from particlerb.case.shapes import Cloud
from particlerb.maths.vec3 import Floats
from particlerb.model.balance import ConservationError
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import GroupPlan, has_step, is_adaptive
from particlerb.simulation.checks import limits, quantities
from particlerb.simulation.run import Outcome, Prepared
from particlerb.simulation.unrecorded import run_unrecorded
from particlerb.sweeping.rows import Row, asked_as_checks

_OF_BODIES: Final = frozenset(
    ("shape", "mass", "density", "position", "orientation", "velocity", "angular_velocity")
)
_OF_TIME: Final = frozenset(("during", "time", "times", "table", "file", "body", "to", "type"))

_SEED: Final = ("run", "seed")


def may_share(system: System) -> bool:
    """Whether variants of a case may share a batch: nothing couples bodies but springs."""
    if system.contact or system.attraction or system.joint or system.run.accuracy:
        return False
    forces = not any(
        isinstance(force, PythonTable) or (isinstance(force, SpringTable) and force.reach)
        for force in system.force
    )
    return forces and not any(_is_its_own(body) for body in system.body)


def _is_its_own(body: Body) -> bool:
    """Whether a record has particles drawn at random, or moves as prescribed."""
    shapes = [body.shape, *(part.shape for part in body.part)]
    return body.motion is not None or any(isinstance(shape, Cloud) for shape in shapes)


def likeness(paths: Sequence[Path], values: Sequence[Any]) -> tuple[object, ...]:
    """What variants of a sweep that share a batch have in common: of their axes."""
    return tuple(
        "" if path == _SEED else _pattern(value) if _is_number(path) else repr(value)
        for path, value in zip(paths, values, strict=True)
    )


def _is_number(path: Path) -> bool:
    """Whether a key may differ from world to world."""
    if len(path) < 3 or path[0] not in ("body", "force"):
        return False
    return path[2] in _OF_BODIES if path[0] == "body" else _OF_TIME.isdisjoint(path)


def _pattern(value: Any) -> object:
    """A value without its numbers, but for which of them are zero."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value != 0
    if isinstance(value, (list, tuple)):
        return tuple(map(_pattern, value))
    if isinstance(value, dict):
        return tuple((key, _pattern(one)) for key, one in sorted(value.items()))
    return repr(value)


def rows_together(numbers: Sequence[int], system: System, asked: Sequence[Asked]) -> list[Row]:
    """Rows of variants that are the worlds of a system.

    Raises
    ------
    WorldsDifferError
        If they cannot, which shows here.
    CaseError, RunError
        If one of them is wrong, or fails: each alone says which.
    """
    check = system.check.model_copy(update={"value": asked_as_checks(asked)})
    system = system._replace(check=check).with_run(threads=1)
    plan = make_plan(system)
    for group in plan.groups:
        _refuse_different(system, group)
    outcome = run_unrecorded(Prepared(system, plan, ""))
    values = [_found(one, system, outcome) for one in asked]
    found = np.hstack([np.zeros((len(numbers), 0)), *values]).tolist()
    drifts = np.transpose(outcome.drift).tolist()
    rows = []
    for number, drift, own in zip(numbers, drifts, found, strict=True):
        missed = sum(not one.holds for one in limits(check, ConservationError(*drift)))
        rows.append(Row(number, "done", drift[0], missed, tuple(own)))
    return rows


def _refuse_different(system: System, group: GroupPlan) -> None:
    """Raise WorldsDifferError where a group is not the same in each, or steps by its bodies."""
    assert group.worlds is not None
    bodies = group.worlds.bodies
    own = group.members[bodies] - system.in_each * np.arange(len(bodies))[:, None]
    if (own != own[0]).any() or (np.diff(group.bodies.rotor_class[bodies], axis=0) != 0).any():
        raise WorldsDifferError("other bodies advance together in each")
    for segment in group.segments:
        if is_adaptive(segment.method):
            raise WorldsDifferError("the method chooses steps by all bodies")
        if has_step(segment.method) and system.run.dt is None:
            raise WorldsDifferError("each has a step of its own")


def _found(asked: Asked, system: System, outcome: Outcome) -> Floats:
    """Numbers of a value that is asked for, a row for each world."""
    assert asked.body is not None
    time = system.run.t_end if asked.time is None else asked.time
    probe = next(probe for probe in outcome.probes if probe.time == time)
    found = quantities(asked, system, system.names.find(asked.body), probe.frame)
    return found.reshape(system.n_worlds, -1)
