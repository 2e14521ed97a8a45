"""A scene that ranks set up apart: each makes its own bodies, and has nothing of the others.

That is for bodies that do not act on each other. The plan of a rank has the same steps for its
bodies as that of the whole scene: where they are chosen, ranks tell each other what they need.
"""

from particlerb.case.coarse_lattice import coarse
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.model.names import BodyNames
from particlerb.model.system import System
from particlerb.plan.case_forces import loads_of
from particlerb.plan.describe import describe
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import GroupPlan, Plan
from particlerb.plan.time_step import (
    as_warning,
    refuse_endless,
    step,
    step_reason,
    step_warnings,
    with_steps,
)
from particlerb.ranks import ALONE, Ranks
from particlerb.simulation.run import made_ready
from particlerb.simulation.run_warnings import remedy_of
from particlerb.simulation.shares import can_be_apart, is_planned_together, share_of
from particlerb.simulation.whole_run import Prepared


def prepared_apart(case: Case, ranks: Ranks) -> Prepared | None:
    """The bodies of this rank and their plan, with words on all; None: it takes the whole scene.

    Raises
    ------
    CaseError
        With all problems that show here; on all ranks.
    NoRanksError
        If there are more ranks than parts.
    """
    if ranks is ALONE or not can_be_apart(case):
        return None
    names = BodyNames((body.name, body.count) for body in case.body)
    own = range(*ranks.together(lambda: share_of(len(names), ranks)))
    system = ranks.together(lambda: made_ready(to_system(case, part=own)))
    plan = ranks.together(lambda: make_plan(system))
    if is_planned_together(system):
        return None
    if system.run.dt is None:
        plan = _with_steps_of_all(system, plan, ranks)
        ranks.together(lambda: refuse_endless(system, plan.groups))
    is_stepped = any(group.stepped for group in plan.groups)
    told = ranks.gathered((is_stepped, plan.step, remedy_of(system.run, plan.groups)))
    words = next((words for is_stepped, words, _ in told if is_stepped), plan.step)
    _, remedy = min((found for is_stepped, _, found in told if is_stepped), default=(0.0, ""))
    warnings = *map(as_warning, coarse(system)), *step_warnings(system, plan.groups, ranks)
    plan = Plan(plan.groups, words, warnings)
    text = describe(system, plan, ranks=ranks)
    return Prepared(system, plan, text, first=own.start, remedy=remedy)


def _with_steps_of_all(system: System, plan: Plan, ranks: Ranks) -> Plan:
    """The plan of a rank with the steps of the scene: the shortest that bodies of a group need."""
    loads = loads_of(system)

    def kind(group: GroupPlan) -> tuple[object, ...]:
        forms = (load.form for load in loads if group.members[0] in load.members)
        return *forms, *((s.start, s.stop, s.method) for s in group.segments)

    kinds = [kind(group) for group in plan.groups]
    own = dict(zip(kinds, (step(system, group) for group in plan.groups), strict=True))
    shortest = dict[object, float]()
    for steps in ranks.gathered(own):
        shortest |= {of: min(dt, shortest.get(of, dt)) for of, dt in steps.items()}
    groups = tuple(map(with_steps, plan.groups, (shortest[of] for of in kinds)))
    distinct = {dt for dt in shortest.values() if dt > 0.0}  # 0 of what is not stepped
    return plan._replace(groups=groups, step=step_reason(system, groups, distinct))
