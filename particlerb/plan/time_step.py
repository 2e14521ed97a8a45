"""The step of each group, and why; steps above which a motion grows: refused or told.

Why it is so: docs/decisions/0004.
"""

import math
from collections.abc import Collection, Sequence
from operator import itemgetter
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.case.problems import CaseError, Problem, problem_at
from particlerb.contact.contact_frequency import initial_contact_frequency
from particlerb.contact.contact_model import GroupContact
from particlerb.forces.links import fastest_oscillation, with_springs
from particlerb.integrators import METHODS
from particlerb.joints.tension import fastest_tension
from particlerb.model.bodies import taken
from particlerb.model.state import lengths, omega_world
from particlerb.model.system import System
from particlerb.plan.rates import deepest_impact, falling_speed, fastest_contact, point_speed, rates
from particlerb.plan.segments import GroupPlan, Plan, Segment, has_step, is_adaptive
from particlerb.ranks import ALONE, Ranks
from particlerb.stepping.motion import force_of

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
                what = f"{like} that touch at t = {segment.start:.6g} grow without bound"
                rate = _crowded_rate(system, group)
                _refuse_above(system, segment, rate, f"where {what} on all their contacts together")
            rate = fastest_contact(system, group, segment)
            what = f"a contact of {like} grows without bound"
            _refuse_above(system, segment, rate, f"where {what}")


def _crowded_rate(system: System, group: GroupPlan) -> float:
    """Rate of the fastest oscillation of bodies on all contacts with which they begin [rad/s]."""
    terms, state = group.segments[0].terms, taken(system.state, group.members)
    contact, fall = terms.known_contact, falling_speed(terms, state.com)
    depth = deepest_impact(contact, group.bodies, state, fall)
    start = group.segments[0].start
    return initial_contact_frequency(contact, state.com, state.q, depth, start)


def _refuse_above(system: System, segment: Segment, rate: float, where: str) -> None:
    """Raise CaseError where the step of a segment is too long for contacts of a rate [rad/s]."""
    reach = contact_limit(segment.method, segment.terms.known_contact)
    if METHODS[segment.method].stability_limit == 0.0:
        reach = LONGEST_UNSTABLE
    dt = _longest_taken(system, segment)
    if not dt * rate > reach:
        return
    reason = f"the step of {dt:.3g} s is above {reach / rate:.3g} s, {where}"
    accurate = f"dt = {math.pi / rate / STEPS_PER_CONTACT:.2g} s or less is accurate"
    hint = f"{accurate}; contact.allow_unstable = true takes it anyway"
    raise CaseError([problem_at(system, step_key(system), reason, hint)])


def _longest_taken(system: System, segment: Segment) -> float:
    """Longest step [s] that is taken in a segment: none goes beyond its end, nor t_end."""
    return min(segment.dt, min(segment.stop, system.run.t_end) - segment.start)


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
            if _longest_taken(system, segment) * rate > limit:
                reason = f"with {segment.method} bodies that rest on contacts oscillate ever more"
                reason += f" above {limit / rate:.3g} s" if limit > 0.0 else " at any step"
                return [problem_at(system, "run.method", reason, 'take "strang"')]
    return []


def step_key(system: System) -> str:
    """Path of what a step is to be blamed on: that which was asked for, or the run."""
    return "run" if system.run.dt is None else "run.dt"


def contact_limit(method: str, contact: GroupContact) -> float:
    """Largest ω dt [rad] at which bodies stay at rest on contacts, however these are damped."""
    limit_at, undamped = METHODS[method].contact_limit, METHODS[method].stability_limit
    assert limit_at is not None
    limits = map(limit_at, contact.model.law.damping_ratio.tolist())
    return min((min(limit, undamped or math.inf) for limit in limits), default=undamped)


def stable_turn(plan: Plan) -> float:
    """Largest ω dt [rad] at which bodies stay at rest on several damped contacts.

    Of a method without a stable step the plan has warned.
    """
    springy = (s for _, s in plan.segments if s.terms.has_springy_contact)
    stable = (s for s in springy if METHODS[s.method].stability_limit > 0.0)
    limits = (contact_limit(s.method, s.terms.known_contact) for s in stable)
    return min(limits, default=math.inf)


def stable_step(system: System, group: GroupPlan, segment: Segment) -> float:
    """Longest step [s] that keeps springs, and what joints carry, bounded at t = 0; inf: any."""
    everything = with_springs(segment.terms.links, segment.terms.loads, group.bodies)
    state = taken(system.state, group.members)
    rate = fastest_oscillation(everything, group.bodies, state.com, state.q)
    if segment.terms.joints is not None and segment is group.segments[0]:
        rate = max(
            rate, fastest_tension(segment.terms.joints, state, force_of(group.group(segment))[1])
        )
    return float(METHODS[segment.method].stability_limit / rate) if rate > 0.0 else np.inf


_MAX_PATH_RADII: Final = 0.1  # of the fastest point in a step
_MAX_FALL_SHARE: Final = 0.05  # of √(r/g), in which a body falls by half a radius
IMPULSE_RULE: Final = f"{_MAX_PATH_RADII} r/v, {_MAX_FALL_SHARE} √(r/g)"
_OVERLAP_SHARE: Final = 0.5  # of the path of a step: the mean overlap of what lands in its middle


def impulse_step(system: System, group: GroupPlan) -> float:
    """Step [s] for contacts without stiffness; inf where a group has none.

    min(0.1 r/v, 0.05 √(r/g)) with the smallest radius r, the largest speed v, and gravity g.
    """
    impulsive = [s for s in group.segments if s.terms.touches_by_impulses]
    steps = (_longest_step(system, s, point_speed(system, group, s)) for s in impulsive)
    return min(steps, default=math.inf)


def _longest_step(system: System, segment: Segment, speed: float) -> float:
    """Step [s] of impulses for bodies of a speed [m/s]."""
    assert segment.terms.contact is not None
    radius = float(segment.terms.contact.model.spheres.radius.min(initial=math.inf))
    g = math.hypot(*system.acceleration)  # squares of large ones overflow
    step = _MAX_PATH_RADII * radius / speed if speed > 0.0 else math.inf
    return min(step, _MAX_FALL_SHARE * math.sqrt(radius / g) if g > 0.0 else math.inf)


def expected_overlap(system: System, group: GroupPlan, segment: Segment) -> float:
    """Overlap [m] to be expected of the fastest impact.

    By impulses with restitution ½ v dt; by springs v √(m/k) of the heaviest body and the softest
    spring, without damping, or that of `hertz`.
    """
    contact, speed = segment.terms.contact, point_speed(system, group, segment)
    if segment.terms.touches_by_impulses:
        return _OVERLAP_SHARE * speed * segment.dt
    assert contact is not None
    if contact.model.law.hertz is not None:
        state = taken(system.state, group.members)
        fall = falling_speed(segment.terms, state.com)
        return deepest_impact(contact, group.bodies, state, fall)
    inverse = group.bodies.inv_mass
    lightest, k = inverse[inverse > 0.0].min(initial=math.inf), contact.model.law.stiffness
    return speed / math.sqrt(float(lightest * k[k > 0.0].min(initial=math.inf)))


# Impulses over springs: a step of five sweeps costs 6.6 of springs (benchmarks/impulses.py)
_IMPULSE_COST: Final = 5.5  # steps of springs that a step of impulses costs without its sweeps
_SWEEP_COST: Final = 0.2  # for each sweep, as of trial code
_ALIKE_RATIO: Final = 1.5  # times the work, below which neither law is cheaper


def cheaper_law(system: System, group: GroupPlan, segment: Segment, overlap: float) -> str:
    """Which of both laws takes less work where this overlap [m] is to be expected, in words."""
    assert system.contact is not None
    speed, laws = point_speed(system, group, segment), ("springs", "impulses")
    impulse = _IMPULSE_COST + _SWEEP_COST * system.contact.iterations
    if segment.terms.touches_by_impulses:
        laws = laws[::-1]
        ratio = segment.dt * speed * STEPS_PER_CONTACT / (math.pi * overlap * impulse)
    else:
        longest = _longest_step(system, segment, speed)
        ratio = segment.dt * impulse / min(overlap / (_OVERLAP_SHARE * speed), longest)
    if max(ratio, 1.0 / ratio) < _ALIKE_RATIO:
        return "for which springs and impulses cost about the same"
    cheap, dear = laws if ratio > 1.0 else laws[::-1]
    times = max(ratio, 1.0 / ratio)
    return f"for which {cheap} are cheaper: {dear} would take about {times:.1g} times the work"


RADIANS_PER_STEP: Final = 0.05  # default step: this over the fastest rate
_Worst: TypeAlias = dict[str, tuple[float, str, float]]  # turn or share, why, better step [s]
_MAX_STEPS: Final = 2.0**53  # steps are counted in float64 where times are
_ROUNDING: Final = 2.0**-53  # of a time, relative
_LARGEST_LOSS: Final = 0.01  # [rad] that a body may turn in the rounding of t_end


class Stepping(NamedTuple):
    """How the driven segments of a group are stepped."""

    method: str
    dt: float  # [s]
    tolerance: float
    reason: str  # in words, for the plan


def step(system: System, group: GroupPlan) -> float:
    """Step of the stepped segments of a group [s]; 0 where it has none."""
    if not group.stepped:
        return 0.0
    if system.run.dt is not None:
        return system.run.dt
    rate = float(rates(system, group).max())
    if not np.isfinite(rate):
        reason = "no step can be chosen: a torque over a moment of inertia overflows"
        raise CaseError([problem_at(system, "run", reason, "give run.dt")])
    step = min(system.run.every, impulse_step(system, group))
    return min(step, RADIANS_PER_STEP / rate) if rate > 0 else step


def with_steps(group: GroupPlan, dt: float) -> GroupPlan:
    """Group whose stepped segments have a step that divides them evenly."""

    def step_in(segment: Segment) -> float:
        length = segment.stop - segment.start
        if not has_step(segment.method):
            return segment.dt
        is_even = np.isinf(length) or is_adaptive(segment.method)
        return float(dt if is_even else length / np.ceil(length / dt * (1 - 1e-12)))

    return group._replace(segments=tuple(s._replace(dt=step_in(s)) for s in group.segments))


def stepped_by(group: GroupPlan, chosen: Stepping) -> GroupPlan:
    """Group whose stepped segments are stepped so."""
    segments = tuple(
        s._replace(method=chosen.method, tolerance=chosen.tolerance) if has_step(s.method) else s
        for s in group.segments
    )
    return with_steps(group._replace(segments=segments), chosen.dt)


def step_reason(
    system: System,
    groups: tuple[GroupPlan, ...],
    distinct: Collection[float],
    choice: Sequence[Stepping | None] = (),
) -> str:
    """The steps in words, and why these; `distinct` are those that `step` found, of all groups."""
    stepped = [group for group in groups if group.stepped]
    if not stepped:
        unused = "" if system.run.dt is None else ", and run.dt is not used"
        return f"none: every motion has a closed form{unused}"
    chosen = (one for group, one in zip(groups, choice, strict=False) if group.stepped)
    if reasons := dict.fromkeys(one.reason for one in chosen if one is not None):
        return "; ".join(reasons)
    if all(is_adaptive(segment.method) for group in stepped for segment in group.stepped):
        packs = "packs of sixteen bodies, and those that act on each other,"
        return f"{packs} take their own, error {system.run.tolerance!r} in each"
    if system.run.dt is not None:
        about = "" if float(f"{system.run.dt:.9g}") == system.run.dt else "about "
        return f"{about}{system.run.dt:.9g} s, as the case says"
    rule = f"the smaller of run.every and {RADIANS_PER_STEP} / fastest rate"
    if len(distinct) > 1:
        return f"{min(distinct):.6g} s to {max(distinct):.6g} s, for each group {rule}"
    (dt,) = distinct
    by_rate = f"{RADIANS_PER_STEP} / ({RADIANS_PER_STEP / dt:.6g} rad/s)"
    why = "run.every" if dt == system.run.every else by_rate
    if (by_impulses := min(impulse_step(system, group) for group in stepped)) < math.inf:
        rule = f"the smallest of run.every, {IMPULSE_RULE}, and {RADIANS_PER_STEP} / fastest rate"
        if dt == by_impulses:
            why = "the rule of impulses"
    return f"{dt:.6g} s = {why}, {rule}"


def refuse_endless(system: System, groups: tuple[GroupPlan, ...]) -> None:
    """Raise CaseError where steps until t_end are more than can be counted."""
    for group in groups:
        for segment in group.stepped:
            length = min(segment.stop, system.run.t_end) - segment.start
            if length <= 0.0:
                continue
            rate = 1.0 / segment.dt if segment.dt > 0.0 else math.inf
            if is_adaptive(segment.method):  # it will find a step of about a radian
                rate = max(float(rates(system, group, system.run.t_end).max()), 1.0 / length)
            steps = length * rate
            if steps > _MAX_STEPS:
                key = step_key(system)
                reason = f"the step of {1.0 / rate:.3g} s would be taken {steps:.3g}"
                hint = "give a longer run.dt, or a smaller force"
                raise CaseError([problem_at(system, key, f"{reason} times until t_end", hint)])


def step_warnings(system: System, groups: tuple[GroupPlan, ...], ranks: Ranks = ALONE) -> list[str]:
    """Warnings about steps that turn a body too far, now or by t_end, or let springs explode.

    And about a run so long that the rounding of its time is an angle. Of ranks that have groups of
    their own, those about the worst of all.
    """
    worst: _Worst = {}
    for own in ranks.gathered(_worst_steps(system, groups)):
        for kind, found in own.items():
            worst[kind] = max(worst.get(kind, found), found, key=itemgetter(0))
    advice = ((reason, f"advised: dt = {dt:.3g} s or less") for _, reason, dt in worst.values())
    told = [problem_at(system, step_key(system), *words) for words in advice]
    spin, t_end = max(ranks.gathered(_spin_that_is_lost(system))), system.run.t_end
    if spin > 0.0:
        known, rounding = _LARGEST_LOSS / (spin * _ROUNDING), t_end * _ROUNDING
        reason = f"{t_end:.3g} s round by {rounding:.2g} s, in which a body turns by"
        reason += f" {spin * rounding:.2g} rad: its angle at t_end is not known"
        hint = f"until {known:.2g} s it is known to {_LARGEST_LOSS} rad"
        told.append(problem_at(system, "run.t_end", reason, hint))
    return list(map(as_warning, told))


@np.errstate(over="ignore")
def _spin_that_is_lost(system: System) -> float:
    """Fastest rate at t = 0 [rad/s], if its angle at t_end is lost in the rounding of t_end."""
    bodies, state, least = system.bodies, system.state, _LARGEST_LOSS / _ROUNDING / system.run.t_end
    spin = 2.0 * np.abs(state.L).max(initial=0.0) * bodies.inv_inertia.max(initial=0.0)  # at most
    if spin > least:
        spin = float(lengths(omega_world(bodies, state)).max())
    return float(spin) if spin > least else 0.0


def _worst_steps(system: System, groups: tuple[GroupPlan, ...]) -> _Worst:
    """Turn in a step that is too long, in each way that it may be: the largest, why, better.

    No step is longer than its segment, and one that was chosen for an accuracy has been tried.
    """
    worst: _Worst = {}
    for group in groups:
        stepped = [segment for segment in group.stepped if not is_adaptive(segment.method)]
        if not stepped:
            continue
        turning = rates(system, group, system.run.t_end)
        rate, fastest = float(turning.max()), system.names[int(group.members[turning.argmax()])]
        name = system.names[int(group.members[0])]
        for segment in stepped:
            dt = _longest_taken(system, segment)
            method, turn = METHODS[segment.method], dt * rate
            limit = stable_step(system, group, segment) if turn > method.stability_limit else np.inf
            touches = segment.terms.contact is not None
            contact = fastest_contact(system, group, segment) if touches else 0.0
            advised = RADIANS_PER_STEP / rate if rate else math.inf
            reason = f"the step of {dt:.6g} s"
            if dt * contact > math.pi / STEPS_PER_CONTACT:
                kind, advised = "contact", math.pi / (contact * STEPS_PER_CONTACT)
                reason += f" is taken {math.pi / (dt * contact):.2g} times in a contact of"
                reason += f" bodies like {name}, and {STEPS_PER_CONTACT} make it accurate"
            elif dt > limit:
                kind = "limit"
                what = "springs" if segment.terms.joints is None else "springs and joints"
                reason += f" is above the limit of {segment.method}: on the {what} of bodies like"
                reason += f" {name} it grows without bound above {limit:.6g} s"
            elif turn > method.max_turn and system.run.accuracy is None:
                kind = "turn"
                reason += f" turns bodies like {fastest} by up to {turn:.3g} rad"
            else:
                continue
            if turn > worst.get(kind, (0.0,))[0]:
                worst[kind] = turn, reason, advised
    return worst


def as_warning(problem: Problem) -> str:
    """Text of what is no mistake, but hardly meant."""
    return str(problem).replace(": error: ", ": warning: ", 1)
