"""Variants of a sweep in one batch: who may share one, and the rows of those that do.

Variants share a batch where the times, the method and all keys that are no numbers of bodies,
forces or contact are the same, and where the same numbers are zero. Their bodies stand in one
system, as worlds (model/worlds.py); each world has the bits of a run alone.
"""

from collections.abc import Sequence

import numpy as np

from particlerb.case.output import SweepValue
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Floats
from particlerb.model.system import System
from particlerb.model.worlds import WorldsDifferError
from particlerb.plan.joints import assembled
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import GroupPlan, Plan, has_step, is_adaptive
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.run import run_unrecorded
from particlerb.simulation.whole_run import Prepared
from particlerb.stepping.sparse_contact import can_fly
from particlerb.sweeping.rows import Row, asking
from particlerb.sweeping.validity import courses, displaced, found, valid_until

_Asked = Sequence[SweepValue]
_Ends = Floats | None  # until when each row is valid, if that is asked for


def may_share(system: System) -> bool:
    """Whether variants of a case may share a batch."""
    contact, slides = system.contact, any(wall.piston is not None for wall in system.wall)
    if contact is not None and (not contact.has_stiffness or contact.relax or slides):
        return False
    if system.run.accuracy:
        return False
    return not any(body.is_drawn or body.motion is not None for body in system.body)


def rows_together(
    numbers: Sequence[int], system: System, asked: _Asked, valid_within: float | None = None
) -> list[Row]:
    """Rows of variants that are the worlds of a system, or its first half: others become twins.

    Raises
    ------
    WorldsDifferError
        If they cannot, which shows here.
    CaseError, RunError
        If one of them is wrong, or fails: each alone says which.
    """
    start = asking(system, asked, valid_within is not None).with_run(threads=1)
    if not may_share(start):
        raise WorldsDifferError("bodies act on each other as they cannot in worlds")
    system, plan = _planned(start)
    if valid_within is not None:
        system, plan = _planned(displaced(start, plan, len(numbers)))
    outcome = run_unrecorded(Prepared(system, plan, ""))
    until = None
    if valid_within is not None:
        both = courses(asked, system, outcome)
        until = valid_until(outcome, [np.hsplit(one, 2) for one in both], valid_within)
    return rows_of(numbers, system, asked, outcome, until)


def _planned(start: System) -> tuple[System, Plan]:
    """Worlds with their joints assembled, and their plan; WorldsDifferError where it differs."""
    system = assembled(start)
    plan = make_plan(system)
    for group in plan.groups:
        _refuse_different(system, group)
    return system, plan


def rows_of(
    numbers: Sequence[int], system: System, asked: _Asked, outcome: Outcome, until: _Ends = None
) -> list[Row]:
    """Rows of the first worlds of a system that has run; a variant alone is one."""
    n, end, probes = len(numbers), system.run.t_end, {p.time: p for p in outcome.probes}
    times = [end if one.time is None else one.time for one in asked]
    values = [found(one, system, probes[time])[:n] for one, time in zip(asked, times, strict=True)]
    values += [] if until is None else [until[:, None]]
    results = np.hstack([np.zeros((n, 0)), *values]).tolist()
    missed = np.zeros(n, dtype=np.int64)
    for name, each in outcome.drift._asdict().items():
        limit = getattr(system.check, f"{name}_drift")
        missed += 0 if limit is None else ~(np.atleast_1d(each)[:n] <= limit)
    energy = np.atleast_1d(outcome.drift.energy)[:n].tolist()
    rows = zip(numbers, energy, missed.tolist(), results, strict=True)
    return [Row(number, "done", drift, k, tuple(row)) for number, drift, k, row in rows]


def _refuse_different(system: System, group: GroupPlan) -> None:
    """Raise WorldsDifferError where a group is not the same in each, or steps by its bodies."""
    assert group.worlds is not None
    bodies = group.worlds.bodies
    rows = group.members[bodies] - system.in_each * np.arange(len(bodies))[:, None]
    if (rows != rows[0]).any() or (np.diff(group.bodies.rotor_class[bodies], axis=0) != 0).any():
        raise WorldsDifferError("other bodies advance together in each")
    for segment in group.segments:
        if is_adaptive(segment.method):
            raise WorldsDifferError("the method chooses steps by all bodies")
        if has_step(segment.method) and system.run.dt is None:
            raise WorldsDifferError("each has a step of its own")
        if segment.terms.opening_angle > 0.0:
            raise WorldsDifferError("a tree of all bodies sums the attraction")
        is_pair = segment.terms.attraction is not None and bodies.shape[1] == 2
        if is_pair and system.run.method in ("auto", "exact"):
            raise WorldsDifferError("two bodies alone may have a closed form")
        if can_fly(METHODS[segment.method], segment.terms, bodies.shape[1]):
            raise WorldsDifferError("bodies fly in closed form between their contacts")
