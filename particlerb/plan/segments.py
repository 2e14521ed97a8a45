"""From a system to a plan: what acts on whom and when, by which method, at which step, and why.

Bodies with the same forces form a group. Its time is cut where a force starts or stops and where
an impulse acts; each segment is free (closed form) or driven (stepped). What a system does not use
is neither computed nor compiled, and the plan says so in words.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.coarse_lattice import coarse
from particlerb.case.problems import CaseError, Problem
from particlerb.case.source import problem_at
from particlerb.contact.contact_frequency import initial_contact_frequency
from particlerb.contact.contact_model import ContactSpheres, GroupContact
from particlerb.forces import Terms, needs_of
from particlerb.forces.attraction import Attraction, fastest_rates
from particlerb.forces.impulse import Impulse
from particlerb.forces.links import fastest_oscillation, link_rates, with_springs
from particlerb.forces.registry import term_of
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import State, lengths, omega_world
from particlerb.model.system import System
from particlerb.plan.case_forces import (
    acts,
    edges_of,
    impossible,
    jumps_at,
    loads_of,
)
from particlerb.plan.contact_setup import ContactSetup, contact_of
from particlerb.plan.groups import BodyGroup, groups_of, terms_of
from particlerb.plan.links import coincident, links_of
from particlerb.rotors.rotor_class import POINT
from particlerb.stepping.motion import Group

RADIANS_PER_STEP: Final = 0.05  # default step: this over the fastest rate
STEPS_PER_CONTACT: Final = 20  # below which a contact is not accurate
MOST_LOOKED_AT: Final = 2000  # bodies whose nearest neighbours are looked for
MOST_STEPS: Final = 2.0**53  # steps are counted in float64 where times are


class Segment(NamedTuple):
    """One stretch of time of one group."""

    start: float  # [s]
    stop: float  # [s], inf for the last
    jumps: tuple[Impulse, ...]  # impulses at the start
    terms: Terms
    method: str
    dt: float  # [s]; 0 where the method has no step, the first one where it is adaptive
    tolerance: float  # of one step of adaptive methods, relative


class Stepping(NamedTuple):
    """How the driven segments of a group are stepped."""

    method: str
    dt: float  # [s]
    tolerance: float
    reason: str  # in words, for the plan


class GroupPlan(NamedTuple):
    """Bodies on which the same forces act."""

    members: Ints  # (n,) which bodies of the system these are
    bodies: Bodies  # their constants
    segments: tuple[Segment, ...]  # from 0 to infinity

    def group(self, segment: Segment) -> Group:
        """What a method needs for one segment."""
        return Group(self.members, self.bodies, segment.terms)


class Plan(NamedTuple):
    """How a system will be run."""

    groups: tuple[GroupPlan, ...]
    step: str  # the step and why this one
    warnings: tuple[str, ...]


def make_plan(system: System) -> Plan:
    """Plan of a system.

    Parameters
    ----------
    system : System
        Bodies, and all that acts on them.

    Raises
    ------
    CaseError
        If a torque overflows or turns a body that cannot turn so, if the method does not accept a
        force, or if no step can be chosen.
    """
    loads = loads_of(system)
    links = links_of(system)
    problems = impossible(system, loads) + coincident(system)
    if problems:
        raise CaseError(problems)
    touching = contact_of(system)
    grouped = groups_of(system, loads, links, touching)
    cut = [cut_into_segments(system, group, touching) for group in grouped]
    refuse_method(system, cut)
    groups = tuple(with_steps(group, step(system, group)) for group in cut)
    return checked(system, groups, [None] * len(groups))


def with_choice(system: System, plan: Plan, choice: Sequence[Stepping | None]) -> Plan:
    """Plan whose groups are stepped as chosen, where something is.

    Raises
    ------
    CaseError
        If a step is too short or too long.
    """
    groups = tuple(
        group if chosen is None else stepped_by(group, chosen)
        for group, chosen in zip(plan.groups, choice, strict=True)
    )
    return checked(system, groups, choice)


def stepped_by(group: GroupPlan, chosen: Stepping) -> GroupPlan:
    """Group whose stepped segments are stepped so."""
    segments = tuple(
        s._replace(method=chosen.method, tolerance=chosen.tolerance) if has_step(s.method) else s
        for s in group.segments
    )
    return with_steps(group._replace(segments=segments), chosen.dt)


def checked(
    system: System, groups: tuple[GroupPlan, ...], choice: Sequence[Stepping | None]
) -> Plan:
    """Plan of groups with steps, if these can be taken."""
    refuse_endless(system, groups)
    refuse_unstable(system, groups)
    warnings = (
        *(as_warning(problem) for problem in coarse(system)),
        *step_warnings(system, groups),
    )
    return Plan(groups, step_reason(system, groups, choice), warnings)


def cut_into_segments(system: System, group: BodyGroup, touching: ContactSetup | None) -> GroupPlan:
    """Segments of a group between the edges of its forces; steps are set later."""
    edges = {0.0}
    for form in (*(force.form for force in group.forces), *(link.force for link in group.links)):
        edges.update(edges_of(form))
    starts = sorted(edges)
    members, forces = group.members, group.forces
    bodies = taken(system.bodies, members)
    if touching is not None:
        bodies = held(bodies, touching.fixed[members])
    segments = []
    for start, stop in zip(starts, [*starts[1:], np.inf], strict=True):
        acting = [force for force in forces if acts(force.form, start)]
        links = [link for link in group.links if acts(link.force, start)]
        terms = terms_of(system, group, bodies, acting, links, touching, start)
        jumps = jumps_at(forces, bodies, start)
        method = chosen_method(system.run.method, bodies, terms)
        segments.append(Segment(start, stop, jumps, terms, method, 0.0, system.run.tolerance))
    return GroupPlan(members, bodies, tuple(segments))


def held(bodies: Bodies, fixed: Bools) -> Bodies:
    """Bodies of which some do not move, whatever acts on them."""
    moves = ~fixed
    return bodies._replace(
        mass=bodies.mass * moves,
        inv_mass=bodies.inv_mass * moves,
        inv_inertia=bodies.inv_inertia * moves,
    )


def refused_terms(method: str, terms: Terms) -> list[str]:
    """Names of the terms that need more than a method takes into account."""
    able = METHODS[method].accepts
    return sorted(name for name, needs in needs_of(terms).items() if not needs <= able)


def accepts(method: str, terms: Terms) -> bool:
    """Whether a method can integrate under these terms."""
    return not refused_terms(method, terms)


def has_step(method: str) -> bool:
    """Whether a method steps; a closed form does not."""
    return METHODS[method].order > 0


def is_adaptive(method: str) -> bool:
    """Whether a method chooses its steps itself."""
    return bool(METHODS[method].is_adaptive)


def chosen_method(named: str, bodies: Bodies, terms: Terms) -> str:
    """Name of the method of a segment: a named one steps whatever rotates, `auto` does not."""
    is_free = accepts("exact", terms)
    if named == "auto":
        return "exact" if is_free else "strang"
    rotates = bool((bodies.rotor_class != POINT).any())
    return named if rotates or not is_free else "exact"


def refuse_method(system: System, groups: list[GroupPlan]) -> None:
    """Raise CaseError where a method was asked for and a force acts that it does not accept."""
    for group in groups:
        for segment in group.segments:
            refused = refused_terms(segment.method, segment.terms)
            if not refused:
                continue
            acting = ", ".join(refused)
            able = ", ".join(name for name in METHODS if accepts(name, segment.terms))
            reason = f"{segment.method} does not accept what acts here: {acting}"
            raise CaseError([problem_at(system, "run.method", reason, f"methods that do: {able}")])


def step(system: System, group: GroupPlan) -> float:
    """Step of the stepped segments of a group [s]; 0 where it has none."""
    if not any(has_step(segment.method) for segment in group.segments):
        return 0.0
    if system.run.dt is not None:
        return system.run.dt
    rate = fastest_rate(system, group)
    if not np.isfinite(rate):
        reason = "no step can be chosen: a torque over a moment of inertia overflows"
        raise CaseError([problem_at(system, "run", reason, "give run.dt")])
    return min(system.run.every, RADIANS_PER_STEP / rate) if rate > 0 else system.run.every


def step_reason(
    system: System, groups: tuple[GroupPlan, ...], choice: Sequence[Stepping | None]
) -> str:
    """The steps in words, and why these."""
    stepped = [
        (group, chosen)
        for group, chosen in zip(groups, choice, strict=True)
        if any(has_step(segment.method) for segment in group.segments)
    ]
    if not stepped:
        return "no step: nothing is stepped"
    reasons = dict.fromkeys(chosen.reason for _, chosen in stepped if chosen is not None)
    if reasons:
        return "; ".join(reasons)
    if all(is_adaptive(s.method) or not has_step(s.method) for g, _ in stepped for s in g.segments):
        packs = "packs of sixteen bodies, and those that act on each other,"
        return f"{packs} take their own, error {system.run.tolerance!r} in each"
    if system.run.dt is not None:
        return f"{system.run.dt!r} s, as the case says"
    steps = {step(system, group) for group, _ in stepped}
    rule = f"the smaller of run.every and {RADIANS_PER_STEP} / fastest rate"
    if len(steps) > 1:
        return f"{min(steps):.6g} s to {max(steps):.6g} s, for each group {rule}"
    (dt,) = steps
    rate = max(fastest_rate(system, group) for group, _ in stepped)
    why = "run.every" if dt == system.run.every else f"{RADIANS_PER_STEP} / ({rate:.6g} rad/s)"
    return f"{dt:.6g} s = {why}, {rule}"


def refuse_endless(system: System, groups: tuple[GroupPlan, ...]) -> None:
    """Raise CaseError where steps until t_end are more than can be counted."""
    for group in groups:
        for segment in group.segments:
            length = min(segment.stop, system.run.t_end) - segment.start
            if not has_step(segment.method) or length <= 0.0:
                continue
            step = segment.dt
            if is_adaptive(segment.method):  # it will find a step of about a radian
                step = 1.0 / max(fastest_rate(system, group, system.run.t_end), 1.0 / length)
            if length > MOST_STEPS * step:
                key = "run" if system.run.dt is None else "run.dt"
                reason = f"the step of {step:.3g} s would be taken {length / step:.3g}"
                hint = "give a longer run.dt, or a smaller force"
                raise CaseError([problem_at(system, key, f"{reason} times until t_end", hint)])


def refuse_unstable(system: System, groups: tuple[GroupPlan, ...]) -> None:
    """Raise CaseError where a step is above the limit of contact, unless it is allowed.

    That is the limit of a single contact of the outermost spheres, and of all contacts together
    at t = 0.
    """
    if system.contact is None or system.contact.allow_unstable:
        return
    for group in groups:
        for segment in group.segments:
            if segment.terms.contact is None:
                continue
            rate = fastest_contact(system, group, segment)
            reach = METHODS[segment.method].stability_limit * damped_share(segment.terms.contact)
            limit = reach / rate if rate > 0.0 else np.inf
            if segment is group.segments[0]:
                refuse_crowded(system, group, reach)
            if segment.dt > limit:
                reason = (
                    f"the step of {segment.dt:.3g} s is above {limit:.3g} s, where a contact of"
                    f" bodies like {system.names[int(group.members[0])]} grows without bound"
                )
                hint = (
                    f"dt = {math.pi / rate / STEPS_PER_CONTACT:.2g} s or less is accurate;"
                    " contact.allow_unstable = true takes it all the same"
                )
                key = "run" if system.run.dt is None else "run.dt"
                raise CaseError([problem_at(system, key, reason, hint)])


def stable_turn(plan: Plan) -> float:
    """Largest ω dt [rad] at which bodies stay at rest on several damped contacts."""
    limits = [
        METHODS[segment.method].stability_limit * damped_share(segment.terms.contact)
        for group in plan.groups
        for segment in group.segments
        if segment.terms.contact is not None
    ]
    return min(limits, default=math.inf)


def refuse_crowded(system: System, group: GroupPlan, reach: float) -> None:
    """Raise CaseError where a step is too long for all contacts at t = 0."""
    segment = group.segments[0]
    contact, state = segment.terms.contact, taken(system.state, group.members)
    assert contact is not None
    depth = deepest_impact(contact, group.bodies, state, falling_speed(system, segment.terms))
    rate = initial_contact_frequency(contact, state.com, state.q, depth)
    if segment.dt * rate > reach:
        reason = (
            f"the step of {segment.dt:.3g} s is above {reach / rate:.3g} s, where bodies like"
            f" {system.names[int(group.members[0])]} that touch at t = 0 grow without bound on all"
            " their contacts together"
        )
        hint = (
            f"dt = {math.pi / rate / STEPS_PER_CONTACT:.2g} s or less is accurate;"
            " contact.allow_unstable = true takes it all the same"
        )
        raise CaseError(
            [problem_at(system, "run" if system.run.dt is None else "run.dt", reason, hint)]
        )


def deepest_impact(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> float:
    """Deepest overlap [m] of an impact of the heaviest bodies of `hertz`; 0 for hooke."""
    if contact.model.law.hertz is None:
        return 0.0
    K = (4.0 / 3.0) * float(contact.model.law.stiffness.max())
    K *= math.sqrt(float(contact.model.spheres.radius.max()))
    moving = bodies.inv_mass[bodies.inv_mass > 0.0]
    speed = impact_speed(contact, bodies, state, fall)
    return float((1.25 * speed**2 / (K * 2.0 * moving.min(initial=np.inf))) ** 0.4)


def impact_speed(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> float:
    """Speed [m/s] with which two may meet, by those at t = 0 and by falling."""
    speed = np.linalg.norm(state.p * bodies.inv_mass, axis=0)
    spin = np.linalg.norm(omega_world(bodies, state), axis=0)
    return 2.0 * float((speed + spin * contact.max_arm).max()) + fall


def damped_share(contact: GroupContact) -> float:
    """Share of the limit of an undamped contact at which the most damped one stays at rest.

    A dashpot that acts on the velocity carried on to the kick: ω h < √(16 ζ² + 4) - 4 ζ.
    """
    ratio = float(contact.model.law.damping_ratio.max(initial=0.0))
    return 2.0 / (math.hypot(4.0 * ratio, 2.0) + 4.0 * ratio)


def fastest_contact(system: System, group: GroupPlan, segment: Segment) -> float:
    """Largest rate of a contact in a segment [rad/s]."""
    contact, state = segment.terms.contact, taken(system.state, group.members)
    assert contact is not None
    fall = falling_speed(system, segment.terms)
    return float(contact_rates(contact, group.bodies, state, fall).max())


@np.errstate(over="ignore", divide="ignore")
def rates(system: System, group: GroupPlan, t_end: float = 0.0) -> Floats:
    """Estimate of the fastest rate of each body of a group, (n,) [rad/s]: spin, forces, impulses.

    A torque without potential spins a body up while it lasts, by |τ| Δt / I; one without end counts
    up to `t_end`. Any torque makes a body at rest turn or swing at a rate of √(|τ| / I).
    """
    bodies, state = group.bodies, taken(system.state, group.members)
    spin = np.linalg.norm(omega_world(bodies, state), axis=0)
    inv_inertia = bodies.inv_inertia.max(axis=0)
    swing = np.zeros_like(spin)
    for segment in group.segments:
        for at, impulse, _ in segment.jumps:
            spin = spin + lengths(at) * lengths(impulse) * inv_inertia
        links, attraction = segment.terms.links, segment.terms.attraction
        lasting, swinging, squares = np.zeros((3, spin.size))
        for load in segment.terms.loads:
            spinning, turning, squared, rate = term_of(load).rates(load, bodies, state)
            lasting, swinging = lasting + spinning, swinging + turning
            squares, swing = squares + squared, np.maximum(swing, rate)
        length = (segment.stop if np.isfinite(segment.stop) else t_end) - segment.start
        spin = spin + lasting * inv_inertia * max(length, 0.0)
        swing = np.maximum(swing, np.sqrt((lasting + swinging) * inv_inertia))
        swing = np.maximum(swing, np.sqrt(squares))
        if links is not None:
            swing = np.maximum(swing, link_rates(links))
        if attraction is not None:
            swing = np.maximum(swing, attraction_rates(attraction, state.com))
        if segment.terms.contact is not None:
            fall = falling_speed(system, segment.terms)
            swing = np.maximum(swing, contact_rates(segment.terms.contact, bodies, state, fall))
    return np.asarray(np.maximum(spin, swing))


def falling_speed(system: System, terms: Terms) -> float:
    """Speed [m/s] that bodies reach by falling through all of a system."""
    if terms.gravity is None:
        return 0.0
    g = terms.gravity.acceleration
    com = system.state.com
    extent = com.max(axis=1) - com.min(axis=1)
    size = float(np.linalg.norm(g))
    lowest = np.abs(com).max(axis=1)  # the ground may lie at the origin
    return math.sqrt(2.0 * max(float(np.abs(g) @ np.maximum(extent, lowest)), 0.0)) if size else 0.0


@np.errstate(invalid="ignore", divide="ignore")
def contact_rates(contact: GroupContact, bodies: Bodies, state: State, fall: float) -> Floats:
    """Rate of the fastest contact of each body with another one or a wall, (n,) [rad/s].

    ω² = k (1/m_eff) with 1/m_eff = Σ 1/M + (r×n)·I⁻¹(r×n) of both bodies, at the sphere and for
    the normal where that is largest, and k with the tangential stiffness where there is friction;
    for hertz k is that at the deepest overlap of an impact with the speed that is there at t = 0
    or reached by falling. Of a wall 1/M is 0, or that of its piston; the other body is the softest
    one of each material.
    """
    model, law = contact.model, contact.model.law
    softness = bodies.inv_mass + softest_turning(model.spheres, bodies.inv_inertia)
    own = np.full(softness.size, -1)
    own[model.spheres.body] = model.spheres.material
    partner = softest_partners(contact, softness, own)
    pair = model.pair_of[own]  # of bodies that touch nothing any one: they have no partners
    both = np.where(own[:, None] >= 0, softness[:, None] + partner, 0.0)
    shear = np.where(law.friction > 0.0, law.tangential_stiffness, 0.0)
    if law.hertz is None:
        k = (law.stiffness + shear)[pair]
        return np.asarray(np.sqrt(np.maximum(k * both, 0.0).max(axis=1)))
    speed = impact_speed(contact, bodies, state, fall)
    K = (4.0 / 3.0) * law.stiffness[pair] * math.sqrt(float(model.spheres.radius.max()))
    share = 1.0 + 6.0 * (shear / np.maximum(law.stiffness, 1e-300))[pair]
    depth = (1.25 * speed**2 / np.maximum(K * both, 1e-300)) ** 0.4
    squared = np.where(K * both > 0.0, 1.5 * K * np.sqrt(depth) * share * both, 0.0)
    return np.asarray(np.sqrt(squared.max(axis=1)))


def softest_turning(spheres: ContactSpheres, inv_inertia: Floats) -> Floats:
    """Largest (r×n)·I⁻¹(r×n) [1/kg] over the spheres of each body and unit vectors n, (n,).

    The larger eigenvalue of a matrix with two, as n along r gives 0: from its trace and the sum of
    its principal minors.
    """
    (x, y, z), (a, b, c) = spheres.arm**2, inv_inertia[:, spheres.body]
    trace = a * (y + z) + b * (x + z) + c * (x + y)
    minors = (x + y + z) * (b * c * x + a * c * y + a * b * z)
    largest = np.zeros(inv_inertia.shape[1])
    root = np.sqrt(np.maximum(0.25 * trace**2 - minors, 0.0))
    np.maximum.at(largest, spheres.body, 0.5 * trace + root)
    return largest


def softest_partners(contact: GroupContact, softness: Floats, material: Ints) -> Floats:
    """Largest 1/m_eff [1/kg] of what each body may meet of each material; -inf: nothing, (n, k)."""
    model, walls = contact.model, contact.model.walls
    partner = np.full((softness.size, len(model.pair_of)), -np.inf)
    for code in np.unique(material[material >= 0]).tolist():
        those = np.flatnonzero(material == code)
        softest = those[np.argmax(softness[those])]
        partner[:, code] = softness[softest]
        partner[softest, code] = softness[those[those != softest]].max(initial=-np.inf)
    inverse = np.zeros(int(walls.wall.max(initial=-1)) + 1)
    if contact.pistons is not None:
        inverse[contact.pistons.wall] = 1.0 / contact.pistons.mass
    for code in np.unique(model.wall_material).tolist():
        own = walls.wall[model.wall_material == code]
        partner[:, code] = np.maximum(partner[:, code], inverse[own].max())
    return partner


def attraction_rates(attraction: Attraction, com: Floats) -> Floats:
    """Rates at which bodies would go round their nearest neighbours, (n,) [rad/s].

    Of very many bodies some are looked at, and all others get the largest of these.
    """
    n = com.shape[1]
    which = np.unique(np.linspace(0, n - 1, min(n, MOST_LOOKED_AT)).astype(np.int64))
    owner = np.repeat(np.arange(n), np.diff(attraction.offset))
    gm: Floats = np.bincount(owner, attraction.gm, n).astype(np.float64)
    found = fastest_rates(gm, com, attraction.softening, which)
    return found if which.size == n else np.full(n, found.max())


def fastest_rate(system: System, group: GroupPlan, t_end: float = 0.0) -> float:
    """Largest of the rates of a group [rad/s]."""
    return float(rates(system, group, t_end).max())


def with_steps(group: GroupPlan, dt: float) -> GroupPlan:
    """Group whose stepped segments have a step that divides them evenly."""
    segments = []
    for segment in group.segments:
        if has_step(segment.method):
            length = segment.stop - segment.start
            is_even = np.isinf(length) or is_adaptive(segment.method)
            own = dt if is_even else length / np.ceil(length / dt * (1 - 1e-12))
            segments.append(segment._replace(dt=float(own)))
        else:
            segments.append(segment)
    return group._replace(segments=tuple(segments))


def step_warnings(system: System, groups: tuple[GroupPlan, ...]) -> list[str]:
    """Warnings about steps that turn a body too far, now or by t_end, or let springs explode."""
    found: dict[str, tuple[float, str, float]] = {}
    for group in groups:
        stepped = [s for s in group.segments if has_step(s.method) and not is_adaptive(s.method)]
        if not stepped:
            continue
        rate = fastest_rate(system, group, system.run.t_end)
        name = system.names[int(group.members[0])]
        for segment in stepped:
            method, turn = METHODS[segment.method], segment.dt * rate
            limit = stable_step(system, group, segment) if turn > method.stability_limit else np.inf
            contact = 0.0
            if segment.terms.contact is not None:
                contact = fastest_contact(system, group, segment)
            if segment.dt * contact > math.pi / STEPS_PER_CONTACT:
                steps = math.pi / (segment.dt * contact)
                reason = f"the step of {segment.dt:.6g} s is taken {steps:.2g} times in a contact"
                reason += f" of bodies like {name}, and {STEPS_PER_CONTACT} make it accurate"
                found["contact"] = max(found.get("contact", (0.0, "", 0.0)), (turn, reason, rate))
            elif segment.dt > limit:
                reason = (
                    f"the step of {segment.dt:.6g} s is above the limit of {segment.method}: on the"
                    f" springs of bodies like {name} it grows without bound above {limit:.6g} s"
                )
                found["limit"] = max(found.get("limit", (0.0, "", 0.0)), (turn, reason, rate))
            elif turn > method.max_turn:
                reason = f"the step of {segment.dt:.6g} s turns bodies like {name} by up to"
                reason += f" {turn:.3g} rad"
                found["turn"] = max(found.get("turn", (0.0, "", 0.0)), (turn, reason, rate))
    key = "run" if system.run.dt is None else "run.dt"
    problems = [
        problem_at(system, key, reason, f"advised: dt = {RADIANS_PER_STEP / rate:.3g} s or less")
        for _, reason, rate in found.values()
    ]
    return [as_warning(problem) for problem in problems]


def as_warning(problem: Problem) -> str:
    """Text of what is no mistake, but hardly meant."""
    return str(problem).replace(": error: ", ": warning: ", 1)


def stable_step(system: System, group: GroupPlan, segment: Segment) -> float:
    """Longest step [s] with which the springs of a segment stay bounded at t = 0; inf: any."""
    everything = with_springs(segment.terms.links, segment.terms.loads, group.bodies)
    if not everything.first.size:
        return np.inf
    state = taken(system.state, group.members)
    rate = fastest_oscillation(everything, group.bodies, state.com, state.q)
    return float(METHODS[segment.method].stability_limit / rate) if rate > 0.0 else np.inf
