"""A scene that ranks set up apart: each makes its own bodies, and has nothing of the others.

That is for bodies that do not act on each other, where nothing is decided by all of them. The plan
of a rank has the same steps for its bodies as that of the whole scene.
"""

from particlerb.case.coarse_lattice import coarse
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.model.names import BodyNames
from particlerb.plan.describe import describe
from particlerb.plan.make_plan import make_plan
from particlerb.plan.segments import Plan
from particlerb.plan.time_step import as_warning, step_warnings
from particlerb.ranks import ALONE, Ranks
from particlerb.simulation.run import made_ready
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
    own = range(*share_of(len(names), ranks))
    system = ranks.together(lambda: made_ready(to_system(case, part=own)))
    plan = ranks.together(lambda: make_plan(system))
    if any(ranks.gathered(is_planned_together(system, plan))):
        return None
    is_stepped = any(group.stepped for group in plan.groups)
    told = ranks.gathered((is_stepped, plan.step))
    step = next((step for is_stepped, step in told if is_stepped), plan.step)
    warnings = *map(as_warning, coarse(system)), *step_warnings(system, plan.groups, ranks)
    plan = Plan(plan.groups, step, warnings)
    return Prepared(system, plan, describe(system, plan, ranks=ranks), first=own.start)
