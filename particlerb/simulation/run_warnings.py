"""What a run has seen that makes its results doubtful, in words: where it ends these are told."""

import math
from collections.abc import Sequence
from typing import Final

from particlerb.case.run import RunTable
from particlerb.forces.gravity_tree.opening_angle import other_angle
from particlerb.impulses import records
from particlerb.plan.segments import GroupPlan, is_adaptive
from particlerb.plan.time_step import stable_turn
from particlerb.simulation.outcome import Outcome
from particlerb.simulation.whole_run import Prepared

_UNSOLVED_RESIDUAL: Final = 1.0  # of impulses that are no better than none
_LARGE_DRIFT: Final = 0.01  # of the energy: bodies are not where they would be


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
    told += lost_energy(prepared.system.run, prepared.plan.groups, outcome.drift.energy)
    return [f"particlerb: warning: {text}" for text in told]


def lost_energy(run: RunTable, groups: Sequence[GroupPlan], drift: float) -> list[str]:
    """What to say where the energy errs by much, relative to the largest one or work."""
    if not drift > _LARGE_DRIFT:
        return []
    stepped = [s for group in groups for s in group.stepped if not is_adaptive(s.method)]
    steps = [run.dt or segment.dt for segment in stepped]
    remedy = f"take run.dt below {min(steps):.3g} s" if steps else "lower run.tolerance"
    if any(segment.terms.attraction is not None for segment in stepped):
        remedy += ', or run.method = "dop853", whose steps follow the motion'
    return [
        f"the energy errs by {drift:.2g} of the largest kinetic energy or work, so positions and"
        " orientations are wrong too: steps are too long for what bodies have met, or a force does"
        f" not fit its potential; {remedy}"
    ]
