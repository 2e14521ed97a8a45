"""Steps above which a motion grows without bound: on contacts they are refused, on springs told."""

import math
from typing import Final

import numpy as np

from particlerb.case.problems import CaseError, Problem, problem_at
from particlerb.contact.contact_frequency import initial_contact_frequency
from particlerb.contact.contact_model import GroupContact
from particlerb.forces.links import fastest_oscillation, with_springs
from particlerb.integrators import METHODS
from particlerb.model.bodies import taken
from particlerb.model.system import System
from particlerb.plan.rates import deepest_impact, falling_speed, fastest_contact
from particlerb.plan.segments import GroupPlan, Plan, Segment

STEPS_PER_CONTACT: Final = 20  # below which a contact is not accurate
LONGEST_UNSTABLE: Final = 2.0  # ω dt [rad] of a contact with a method that has no stable step


def refuse_unstable(system: System, groups: tuple[GroupPlan, ...]) -> None:
    """Raise CaseError where a step is above the limit of contact, unless it is allowed.

    That is the limit of a single contact of the outermost spheres, and of all contacts together
    at t = 0.
    """
    if system.contact is None or system.contact.allow_unstable or not system.contact.has_stiffness:
        return
    for group in groups:
        for segment in group.segments:
            if segment.terms.contact is None:
                continue
            like = f"bodies like {system.names[int(group.members[0])]}"
            if segment is group.segments[0]:
                what = f"{like} that touch at t = 0 grow without bound on all their contacts"
                rate = _crowded_rate(system, group)
                _refuse_above(system, segment, rate, f"where {what} together")
            rate = fastest_contact(system, group, segment)
            what = f"a contact of {like} grows without bound"
            _refuse_above(system, segment, rate, f"where {what}")


def _crowded_rate(system: System, group: GroupPlan) -> float:
    """Rate of the fastest swing of bodies on all contacts with which they begin [rad/s]."""
    terms, state = group.segments[0].terms, taken(system.state, group.members)
    assert terms.contact is not None
    fall = falling_speed(system, terms)
    depth = deepest_impact(terms.contact, group.bodies, state, fall)
    return initial_contact_frequency(terms.contact, state.com, state.q, depth)


def _refuse_above(system: System, segment: Segment, rate: float, where: str) -> None:
    """Raise CaseError where the step of a segment is too long for contacts of a rate [rad/s]."""
    assert segment.terms.contact is not None
    reach = contact_limit(segment.method, segment.terms.contact)
    if METHODS[segment.method].stability_limit == 0.0:
        reach = LONGEST_UNSTABLE
    if not segment.dt * rate > reach:
        return
    reason = f"the step of {segment.dt:.3g} s is above {reach / rate:.3g} s, {where}"
    hint = (
        f"dt = {math.pi / rate / STEPS_PER_CONTACT:.2g} s or less is accurate;"
        " contact.allow_unstable = true takes it anyway"
    )
    raise CaseError([problem_at(system, step_key(system), reason, hint)])


def growing_contacts(system: System, groups: tuple[GroupPlan, ...]) -> list[Problem]:
    """Contacts on which a method without a stable step lets a body that rests oscillate ever more.

    Impacts, which are short, may be taken by such a method all the same.
    """
    for group in groups:
        for segment in group.segments:
            contact = segment.terms.contact
            if contact is None or METHODS[segment.method].stability_limit > 0.0:
                continue
            rate = fastest_contact(system, group, segment)
            limit = contact_limit(segment.method, contact)
            if segment.dt * rate > limit:
                reason = f"with {segment.method} bodies that rest on contacts oscillate ever more"
                reason += f" above {limit / rate:.3g} s" if limit > 0.0 else " at any step"
                return [problem_at(system, "run.method", reason, 'take "strang"')]
    return []


def step_key(system: System) -> str:
    """Path of what a step is to be blamed on: that which was asked for, or the run."""
    return "run" if system.run.dt is None else "run.dt"


def contact_limit(method: str, contact: GroupContact) -> float:
    """Largest ω dt [rad] at which bodies stay at rest on contacts, however these are damped."""
    given, undamped = METHODS[method].contact_limit, METHODS[method].stability_limit
    assert given is not None
    limits = map(given, contact.model.law.damping_ratio.tolist())
    return min((min(limit, undamped or math.inf) for limit in limits), default=undamped)


def stable_turn(plan: Plan) -> float:
    """Largest ω dt [rad] at which bodies stay at rest on several damped contacts.

    Of a method without a stable step the plan has warned.
    """
    limits = [
        contact_limit(s.method, s.terms.contact)
        for _, s in plan.segments
        if s.terms.contact is not None
        and s.terms.has_springy_contact
        and METHODS[s.method].stability_limit > 0.0
    ]
    return min(limits, default=math.inf)


def stable_step(system: System, group: GroupPlan, segment: Segment) -> float:
    """Longest step [s] with which the springs of a segment stay bounded at t = 0; inf: any."""
    everything = with_springs(segment.terms.links, segment.terms.loads, group.bodies)
    if not everything.first.size:
        return np.inf
    state = taken(system.state, group.members)
    rate = fastest_oscillation(everything, group.bodies, state.com, state.q)
    return float(METHODS[segment.method].stability_limit / rate) if rate > 0.0 else np.inf
