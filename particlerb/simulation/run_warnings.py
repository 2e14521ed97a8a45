"""What a run has seen that makes its results doubtful, in words: where it ends these are told."""

import math
from collections.abc import Sequence
from typing import Final

from particlerb.case.run import RunTable
from particlerb.forces.gravity_tree.opening_angle import other_angle
from particlerb.impulses import records
from particlerb.model.balance import ConservationError
from particlerb.plan.segments import GroupPlan, accepts, is_adaptive
from particlerb.plan.time_step import stable_turn
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.whole_run import Prepared

_UNSOLVED_RESIDUAL: Final = 1.0  # of impulses that are no better than none
_LARGE_DRIFT: Final = 0.01  # of the energy: bodies are not where they would be
_LARGE_OF_START: Final = 1e-4  # and of that at the start


def run_warnings(prepared: Prepared, outcome: Outcome) -> list[str]:
    """Warnings about what a run has seen: lost energy, stiff contacts, a tree that errs, ..."""
    told, limit, tree, tally = [], stable_turn(prepared.plan), outcome.tree, outcome.tally
    times = [check.time for check in prepared.system.check.value if check.time is not None]
    if outcome.passed > 0.0 and min(times, default=math.inf) <= outcome.passed:
        why = "a Simulation has moved the bodies until then, and makes none"
        told.append(f"checks until t = {outcome.passed:.6g} s were not made: {why}")
    if (turn := outcome.contact_turn) > limit:
        told.append(
            f"all contacts of a body together reached ω dt = {turn:.3g}: above {limit:.3g} contacts"
            f" with this damping do not come to rest; divide run.dt by {turn / limit:.2g}"
        )
    if outcome.tension:
        told.append(outcome.tension)
    if tree is not None and tree.seen > tree.asked:
        told.append(
            f"the error of the tree of the attraction reached {tree.seen:.2g}, above the requested"
            f" {tree.asked:.2g}: the scene has changed since its opening angle was chosen; set"
            f" attraction.opening_angle = {other_angle(*tree):.2g}"
        )
    if tally is not None and tally[records.WORST_EVER] >= _UNSOLVED_RESIDUAL:
        told.append(
            "impulses of contacts were not found: the residual reached"
            f" {tally[records.WORST_EVER]:.2g} at t = {tally[records.WORST_TIME]:.6g} s, and where"
            " it is 1 they are no better than none; take more contact.iterations or"
            ' contact.solver = "newton"'
        )
    remedy = prepared.remedy or remedy_of(prepared.system.run, prepared.plan.groups)[1]
    told += lost_energy(remedy, outcome.drift)
    return told_of(told)


def told_of(warnings: Sequence[str]) -> list[str]:
    """Warnings with the name of the program before them."""
    return [f"particlerb: warning: {text}" for text in warnings]


def lost_energy(remedy: str, drift: ConservationError) -> list[str]:
    """What to say where the energy errs by much, relative to the largest one or work in frames.

    Where frames meet bodies at rest these are nearly nothing: then that at the start counts.
    """
    if not (drift.energy > _LARGE_DRIFT and drift.of_start > _LARGE_OF_START):
        return []
    cause = "steps are too long for what bodies have met, or a force does not fit its potential"
    return [
        f"the energy errs by {drift.energy:.2g} of the largest kinetic energy or work in frames, so"
        f" positions and orientations are wrong too{f': {cause}; {remedy}' if remedy else ''}"
    ]


def remedy_of(run: RunTable, groups: Sequence[GroupPlan]) -> tuple[float, str]:
    """The shortest step [s], infinite where none is given, and what helps where energy is lost."""
    stepped = [segment for group in groups for segment in group.stepped]
    dt = min((run.dt or s.dt for s in stepped if not is_adaptive(s.method)), default=math.inf)
    if not stepped or run.accuracy is not None:
        return dt, "take a smaller run.accuracy" if stepped else ""
    if dt == math.inf:
        return dt, "lower run.tolerance"
    is_attracted = any(s.terms.attraction is not None for s in stepped)
    may_follow = is_attracted and all(accepts("dop853", s.terms) for s in stepped)
    other = ', or run.method = "dop853", whose steps follow the motion' if may_follow else ""
    return dt, f"take run.dt below {dt:.3g} s{other}"
