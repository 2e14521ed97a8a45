"""From a system to a plan: what acts on whom and when, by which method, at which step, and why.

Bodies with the same forces form a group. Its time is cut where a force starts or stops and where
an impulse acts. What a system does not use is neither computed nor compiled, and the plan says so
in words.
"""

from collections.abc import Callable, Mapping
from itertools import chain
from types import MappingProxyType

import numpy as np

from particlerb.case.coarse_lattice import coarse
from particlerb.case.problems import refuse
from particlerb.maths.vec3 import Ints
from particlerb.model.state import State
from particlerb.model.system import System
from particlerb.plan import segments, time_step
from particlerb.plan.case_forces import impossible, loads_of
from particlerb.plan.contact_setup import contact_of
from particlerb.plan.groups import GroupForces, groups_of
from particlerb.plan.initial_overlaps import Elsewhere, refuse_misplaced
from particlerb.plan.joints import joints_of
from particlerb.plan.known_courses import Behind
from particlerb.plan.links import AnyLink, Link, coincident, links_of
from particlerb.plan.merging import merged, on_hosts
from particlerb.plan.rates import rates_of


def make_plan(
    system: System,
    choose: Callable[[segments.GroupPlan], time_step.Stepping | None] = lambda group: None,
    now: tuple[float, State] | None = None,
    behind: Mapping[bytes, Behind] = MappingProxyType({}),
    moved: Elsewhere | None = None,
) -> segments.Plan:
    """Plan of a system.

    Parameters
    ----------
    system : System
        Bodies, and all that acts on them.
    choose : callable, optional
        How a group is stepped, in place of what `run` says; None where that stays.
    now : tuple of float and State, optional
        Time from which on to plan [s], and the state then, where that is not t = 0. Springs, joints
        and driven bodies are tied as they were at t = 0.
    behind : mapping of bytes to Behind, optional
        By the members of each group: what is over for it, and need not be among the forces.
    moved : Elsewhere, optional
        Bodies and walls that were put elsewhere now, and may lie in others.

    Raises
    ------
    CaseError
        If a torque is impossible, a method does not accept a force, or no step can be chosen.
    RegroupedError
        If bodies no longer belong to the groups of `behind`.
    """
    system = merged(system)
    loads, links = loads_of(system), _links_on_hosts(system)
    refuse(impossible(system, loads) + coincident(system))
    touching, joints = contact_of(system, now is None), joints_of(system)
    start, state = now or (0.0, system.state)
    if now is not None and system.merging is not None:
        state = system.merging.together(state)
    system = system._replace(state=state)
    if moved is not None and touching is not None:
        refuse_misplaced(system, touching, start or None, moved)
    grouped = groups_of(system, loads, links, touching, joints, _apart(behind, system.n_bodies))
    grouped = _after(behind, grouped) if behind else grouped
    each = (segments.cut_into_segments(system, g, touching, start, now is None) for g in grouped)
    cut = sorted(chain(*each), key=lambda group: int(group.members.min()))
    segments.refuse_method(system, cut)
    cut = [_with_rates(system, group) for group in cut]
    steps = [time_step.step(system, group) for group in cut]
    groups = tuple(map(time_step.with_steps, cut, steps))
    time_step.refuse_endless(system, groups)
    choice = [choose(group) for group in groups]
    if any(choice):
        groups = tuple(map(_stepped, groups, choice))
        time_step.refuse_endless(system, groups)
    time_step.refuse_unstable(system, groups)
    if system.n_worlds > 1:
        return segments.Plan(groups, "", ())  # nobody reads what else is said of them
    told = [*(coarse(system) if now is None else ()), *time_step.growing_contacts(system, groups)]
    warnings = (*map(time_step.as_warning, told), *time_step.step_warnings(system, groups))
    distinct = {dt for group, dt in zip(groups, steps, strict=True) if group.stepped}
    return segments.Plan(groups, time_step.step_reason(system, groups, distinct, choice), warnings)


def _with_rates(system: System, group: segments.GroupPlan) -> segments.GroupPlan:
    """A group with its rates, where something reads them."""
    is_read = group.stepped and (system.n_worlds == 1 or system.run.dt is None)
    return group._replace(rates=rates_of(system, group)) if is_read else group


def _stepped(group: segments.GroupPlan, chosen: time_step.Stepping | None) -> segments.GroupPlan:
    """A group that is stepped as was chosen for it, if something was."""
    return group if chosen is None else time_step.stepped_by(group, chosen)


def _links_on_hosts(system: System) -> list[AnyLink]:
    """Links of a system, between the bodies that move."""
    links, merging = links_of(system), system.merging
    if merging is None:
        return links
    return [on_hosts(link, merging) if isinstance(link, Link) else link for link in links]


def _apart(behind: Mapping[bytes, Behind], n_bodies: int) -> Ints:
    """(n_bodies,) number of the group that each body has been in."""
    number = np.zeros(n_bodies, dtype=np.int64)
    for k, members in enumerate(behind):
        number[np.frombuffer(members, dtype=np.int64)] = k
    return number


def _after(behind: Mapping[bytes, Behind], groups: list[GroupForces]) -> list[GroupForces]:
    """The same groups with what they have left behind."""
    pasts = [behind.get(group.members.tobytes()) for group in groups]
    if None in pasts:
        raise segments.RegroupedError
    return [group._replace(behind=past) for group, past in zip(groups, pasts, strict=True)]
