"""From a scene to a plan: what acts on whom and when, by which method, at which step, and why.

Bodies with the same forces form a group. Its time is cut where a force starts or stops and where
an impulse acts; each segment is free (closed form) or driven (stepped). What a scene does not use
is neither computed nor compiled, and the plan says so in words.
"""

from collections import defaultdict
from typing import Final, NamedTuple

import numpy as np

from particlerb.bodies.bodies import Bodies, taken
from particlerb.bodies.scene import Scene
from particlerb.bodies.state import omega_world, turned_back
from particlerb.case.placement import resolve_bodies
from particlerb.case.problems import CaseError, Problem
from particlerb.case.reader import problem_at
from particlerb.case.schema import Case, Impulse, Push, Torque
from particlerb.maths.vec3 import Floats, Ints
from particlerb.methods import METHODS
from particlerb.methods.motion import Group
from particlerb.rotors.rotor_class import NAMES, POINT, ROD
from particlerb.terms import Terms
from particlerb.terms.follower import Follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.impulse import Impulse as Jump
from particlerb.terms.push import Push as WorldPush
from particlerb.terms.torque import Torque as WorldTorque

RADIANS_PER_STEP: Final = 0.05  # default step: this over the fastest rate
LARGEST_TURN: Final = 0.5  # rad in one step above which it is worth a warning
LARGEST_TORQUE: Final = float(np.finfo(np.float64).max)
MOST_STEPS: Final = 2.0**53  # steps are counted in float64 where times are
AXIAL_ROUNDING: Final = 1e-12  # share of a torque about a rod's axis that is its rounding


class Segment(NamedTuple):
    """One stretch of time of one group."""

    start: float  # [s]
    stop: float  # [s], inf for the last
    jumps: tuple[Jump, ...]  # impulses at the start
    terms: Terms
    method: str
    dt: float  # [s]; 0 where the method has no step


class GroupPlan(NamedTuple):
    """Bodies on which the same forces act."""

    members: Ints  # (n,) which bodies of the scene these are
    bodies: Bodies  # their constants
    segments: tuple[Segment, ...]  # from 0 to infinity

    def group(self, segment: Segment) -> Group:
        """What a method needs for one segment."""
        return Group(self.members, self.bodies, segment.terms)


class Plan(NamedTuple):
    """How a case will be run."""

    groups: tuple[GroupPlan, ...]
    step: str  # the step and why this one
    warnings: tuple[str, ...]


class Load(NamedTuple):
    """One force or impulse of the case, resolved."""

    number: int  # index of [[force]]
    force: Push | Torque | Impulse
    members: Ints  # bodies on which it acts, ascending

    @property
    def at(self) -> tuple[float, float, float]:
        """Point where it acts [m], body frame."""
        return (0.0, 0.0, 0.0) if isinstance(self.force, Torque) else self.force.at

    @property
    def vector(self) -> tuple[float, float, float]:
        """The force [N], torque [N m] or impulse [N s]."""
        force = self.force
        if isinstance(force, Push):
            return force.force
        return force.torque if isinstance(force, Torque) else force.impulse

    @property
    def form(self) -> tuple[object, ...]:
        """What it has in common with others of a group: all but its size, direction and point."""
        force = self.force
        when = force.time if isinstance(force, Impulse) else force.during
        return force.type, force.frame, when, any(self.at)


class Forces(NamedTuple):
    """One force of the same form on each of n bodies."""

    form: Push | Torque | Impulse  # one of them
    at: Floats  # (3, n) [m], body frame
    vector: Floats  # (3, n) [N, N m or N s]


def make_plan(case: Case, scene: Scene) -> Plan:
    """Plan of a case.

    Raises
    ------
    CaseError
        If a torque overflows or turns a body that cannot turn so, if the method does not accept a
        force, or if no step can be chosen.
    """
    loads = [Load(i, f, resolve_bodies(case, f.body)) for i, f in enumerate(case.force)]
    problems = [p for load in loads for p in too_large(case, load)]
    problems += [p for load in loads for p in impossible_torques(case, scene, load)]
    if problems:
        raise CaseError(problems)
    cut = [
        cut_into_segments(case, scene, members, forces)
        for members, forces in groups_of_bodies(scene, loads)
    ]
    refuse_method(case, cut)
    steps = [step(case, scene, group) for group in cut]
    groups = tuple(with_steps(group, dt) for group, dt in zip(cut, steps, strict=True))
    refuse_endless(case, groups)
    warnings = tuple(step_warnings(case, scene, groups))
    return Plan(groups, step_reason(case, scene, groups), warnings)


def groups_of_bodies(scene: Scene, loads: list[Load]) -> list[tuple[Ints, list[Forces]]]:
    """Bodies with forces of the same forms, and these forces; in the order of bodies."""
    numbers: defaultdict[int, list[int]] = defaultdict(list)
    for k, load in enumerate(loads):
        for b in load.members.tolist():
            numbers[b].append(k)
    forms = [load.form for load in loads]
    members: defaultdict[tuple[object, ...], list[int]] = defaultdict(list)
    for b in sorted(numbers):
        members[tuple(forms[k] for k in numbers[b])].append(b)
    at = np.array([load.at for load in loads]).reshape(-1, 3)
    vector = np.array([load.vector for load in loads]).reshape(-1, 3)
    groups = []
    for bodies in members.values():
        own = np.array([numbers[b] for b in bodies])
        forces = [Forces(loads[k[0]].force, at[k].T, vector[k].T) for k in own.T]
        groups.append((np.array(bodies), forces))
    alone = np.ones(len(scene.kind), dtype=bool)
    alone[list(numbers)] = False
    if alone.any():
        groups.append((np.flatnonzero(alone), []))
    return sorted(groups, key=lambda group: int(group[0][0]))


def cut_into_segments(case: Case, scene: Scene, members: Ints, forces: list[Forces]) -> GroupPlan:
    """Segments of a group between the edges of its forces; steps are set later."""
    edges = {0.0}
    for force in forces:
        if isinstance(force.form, Impulse):
            edges.add(force.form.time)
        elif force.form.during is not None:
            edges.update(force.form.during)
    starts = sorted(edges)
    bodies = taken(scene.bodies, members)
    segments = []
    for start, stop in zip(starts, [*starts[1:], np.inf], strict=True):
        terms = acting_terms(case, bodies, [force for force in forces if acts(force, start)])
        jumps = tuple(
            jump(force, bodies)
            for force in forces
            if isinstance(force.form, Impulse) and force.form.time == start
        )
        method = chosen_method(case, bodies, terms)
        segments.append(Segment(start, stop, jumps, terms, method, 0.0))
    return GroupPlan(members, bodies, tuple(segments))


def acts(force: Forces, start: float) -> bool:
    """Whether a lasting force acts in the segment that begins at `start`."""
    form = force.form
    if isinstance(form, Impulse):
        return False
    return form.during is None or form.during[0] <= start < form.during[1]


def acting_terms(case: Case, bodies: Bodies, forces: list[Forces]) -> Terms:
    """Sum of the forces of a segment, one term of each kind at most."""
    n = bodies.mass.size
    force, lever = np.zeros((3, n)), np.zeros((3, 3, n))
    body_force, body_torque, torque = np.zeros((3, 3, n))
    for form, at, vector in forces:
        arm = turned_back(bodies.rotor_frame, at)
        if isinstance(form, Push) and form.frame == "world":
            force += vector
            lever += vector[:, None] * arm  # [j, l] = F_j r_l
        elif isinstance(form, Push):
            own = turned_back(bodies.rotor_frame, vector)
            body_force += own
            body_torque += np.cross(arm, own, axis=0)
        elif form.frame == "world":
            torque += vector
        else:
            body_torque += turned_back(bodies.rotor_frame, vector)
    gravity = np.array(case.gravity.acceleration) if case.gravity else np.zeros(3)
    return Terms(
        UniformGravity(bodies.mass, gravity) if gravity.any() else None,
        WorldPush(force, lever.reshape(9, n)) if force.any() or lever.any() else None,
        Follower(body_force, body_torque) if body_force.any() or body_torque.any() else None,
        WorldTorque(torque) if torque.any() else None,
    )


def jump(force: Forces, bodies: Bodies) -> Jump:
    """An impulse as the term takes it."""
    follows = force.form.frame == "body"
    J = turned_back(bodies.rotor_frame, force.vector) if follows else force.vector
    return Jump(turned_back(bodies.rotor_frame, force.at), np.ascontiguousarray(J), follows)


def is_free(terms: Terms) -> bool:
    """Whether nothing acts but forces through the centre of mass that are constant in the world."""
    turns = terms.push is not None and terms.push.lever.any()
    return terms.follower is None and terms.torque is None and not turns


def chosen_method(case: Case, bodies: Bodies, terms: Terms) -> str:
    """Name of the method of a segment: a named one steps whatever rotates."""
    if case.run.method == "auto":
        return "exact" if is_free(terms) else "strang"
    rotates = bool((bodies.rotor_class != POINT).any())
    return case.run.method if rotates or not is_free(terms) else "exact"


def refuse_method(case: Case, groups: list[GroupPlan]) -> None:
    """Raise CaseError where `exact` was asked for and a force acts that it does not accept."""
    if case.run.method != "exact":
        return
    if all(is_free(segment.terms) for group in groups for segment in group.segments):
        return
    reason = "exact is for free bodies: a force acts that turns a body or turns with it"
    others = ", ".join(name for name in METHODS if name != "exact")
    raise CaseError([problem_at(case, "run.method", reason, f"methods that accept it: {others}")])


def step(case: Case, scene: Scene, group: GroupPlan) -> float:
    """Step of the stepped segments of a group [s]; 0 where it has none."""
    if all(segment.method == "exact" for segment in group.segments):
        return 0.0
    if case.run.dt is not None:
        return case.run.dt
    rate = fastest_rate(scene, group)
    if not np.isfinite(rate):
        reason = "no step can be chosen: a torque over a moment of inertia overflows"
        raise CaseError([problem_at(case, "run", reason, "give run.dt")])
    return min(case.run.every, RADIANS_PER_STEP / rate) if rate > 0 else case.run.every


def step_reason(case: Case, scene: Scene, groups: tuple[GroupPlan, ...]) -> str:
    """The steps in words, and why these."""
    stepped = [g for g in groups if any(s.method != "exact" for s in g.segments)]
    if not stepped:
        return "no step: nothing is stepped"
    if case.run.dt is not None:
        return f"{case.run.dt!r} s, as the case says"
    steps = {step(case, scene, group) for group in stepped}
    rule = f"the smaller of run.every and {RADIANS_PER_STEP} / fastest rate"
    if len(steps) > 1:
        return f"{min(steps):.6g} s to {max(steps):.6g} s, for each group {rule}"
    (dt,) = steps
    rate = max(fastest_rate(scene, group) for group in stepped)
    why = "run.every" if dt == case.run.every else f"{RADIANS_PER_STEP} / ({rate:.6g} rad/s)"
    return f"{dt:.6g} s = {why}, {rule}"


def refuse_endless(case: Case, groups: tuple[GroupPlan, ...]) -> None:
    """Raise CaseError where steps until t_end are more than can be counted."""
    for group in groups:
        for segment in group.segments:
            length = min(segment.stop, case.run.t_end) - segment.start
            if segment.method != "exact" and length > MOST_STEPS * segment.dt:
                key = "run" if case.run.dt is None else "run.dt"
                reason = f"the step of {segment.dt:.3g} s would be taken {length / segment.dt:.3g}"
                hint = "give a longer run.dt, or a smaller force"
                raise CaseError([problem_at(case, key, f"{reason} times until t_end", hint)])


@np.errstate(over="ignore")
def fastest_rate(scene: Scene, group: GroupPlan, t_end: float = 0.0) -> float:
    """Estimate of the fastest rate [rad/s] of a group: spin, impulses, torques.

    A torque without potential spins a body up while it lasts, by |τ| Δt / I; one without end counts
    up to `t_end`. Any torque makes a body at rest turn or swing at a rate of √(|τ| / I).
    """
    bodies, state = group.bodies, taken(scene.state, group.members)
    spin = np.linalg.norm(omega_world(bodies, state), axis=0)
    inv_inertia = bodies.inv_inertia.max(axis=0)
    swing = np.zeros_like(spin)
    for segment in group.segments:
        for at, impulse, _ in segment.jumps:
            spin = spin + sizes(at) * sizes(impulse) * inv_inertia
        _, push, follower, torque = segment.terms
        lasting = np.zeros_like(spin)
        if follower is not None:
            lasting = lasting + sizes(follower.torque)
        if torque is not None:
            lasting = lasting + sizes(torque.torque)
        length = (segment.stop if np.isfinite(segment.stop) else t_end) - segment.start
        spin = spin + lasting * inv_inertia * max(length, 0.0)
        swinging = lasting if push is None else lasting + sizes(push.lever)
        swing = np.maximum(swing, np.sqrt(swinging * inv_inertia))
    return float(np.maximum(spin, swing).max())


def sizes(vectors: Floats) -> Floats:
    """|v| of each column."""
    return np.asarray(np.linalg.norm(vectors, axis=0))


def with_steps(group: GroupPlan, dt: float) -> GroupPlan:
    """Group whose stepped segments have a step that divides them evenly."""
    segments = []
    for segment in group.segments:
        if segment.method != "exact":
            length = segment.stop - segment.start
            own = dt if np.isinf(length) else length / np.ceil(length / dt * (1 - 1e-12))
            segments.append(segment._replace(dt=float(own)))
        else:
            segments.append(segment)
    return group._replace(segments=tuple(segments))


def step_warnings(case: Case, scene: Scene, groups: tuple[GroupPlan, ...]) -> list[str]:
    """Warnings about a step that turns a body too far, now or by t_end."""
    worst, rate, dt, name = 0.0, 0.0, 0.0, ""
    for group in groups:
        longest = max(segment.dt for segment in group.segments)
        fastest = fastest_rate(scene, group, case.run.t_end) if longest else 0.0
        if longest * fastest > worst:
            worst, rate, dt = longest * fastest, fastest, longest
            name = scene.names[int(group.members[0])]
    if worst <= LARGEST_TURN:
        return []
    problem = problem_at(
        case,
        "run" if case.run.dt is None else "run.dt",
        f"the step of {dt:.6g} s turns bodies like {name} by up to {worst:.3g} rad",
        f"advised: dt = {RADIANS_PER_STEP / rate:.3g} s or less",
    )
    return [str(problem).replace(": error: ", ": warning: ", 1)]


def too_large(case: Case, load: Load) -> list[Problem]:
    """What is wrong with a force whose torque exceeds the range of float64."""
    force = load.force
    if isinstance(force, Torque):
        return []
    arm, size = max(map(abs, load.at)), max(map(abs, load.vector))
    if 2.0 * arm * size < LARGEST_TORQUE:
        return []
    reason = f"arm {arm!r} m and {force.type} {size!r} give a torque beyond the range of float64"
    return [problem_at(case, f"force[{load.number}].at", reason)]


def impossible_torques(case: Case, scene: Scene, load: Load) -> list[Problem]:
    """What is wrong with a force that turns a point, or a rod about its own axis."""
    cannot = np.isin(scene.bodies.rotor_class[load.members], (POINT, ROD))
    index = load.members[cannot]
    if not index.size:
        return []
    bodies, state = taken(scene.bodies, index), taken(scene.state, index)
    size, axial = turning_part(load, bodies, state.q)
    wrong = np.flatnonzero(axial > AXIAL_ROUNDING * np.maximum(size, 1e-300))
    if not wrong.size:
        return []
    b = int(wrong[0])
    name, code = scene.names[int(index[b])], int(bodies.rotor_class[b])
    what = "has no extent: nothing can turn it" if code == POINT else "cannot turn about its axis"
    key = "torque" if isinstance(load.force, Torque) else "at"
    reason = (
        f"{name} is a {NAMES[code]} with moments {sorted(bodies.inertia[:, b].tolist())} kg m²"
        f" and {what}, but this {load.force.type} would"
    )
    hint = "act at the centre of mass" if code == POINT else "act at a point of the rod's axis"
    return [problem_at(case, f"force[{load.number}].{key}", reason, hint)]


def turning_part(load: Load, bodies: Bodies, q: Floats) -> tuple[Floats, Floats]:
    """Size of what turns these points and rods, and its part that they cannot follow, (n,) each.

    For a force at a point it is the lever arm and not the torque: an arm along a rod never turns
    it about its axis, any other arm does so but by chance. Points can follow nothing.
    """
    is_torque = isinstance(load.force, Torque)
    given = np.array(load.vector if is_torque else load.at)[:, None]
    in_world = is_torque and load.force.frame == "world"
    turn = turned_back(q if in_world else bodies.rotor_frame, np.tile(given, bodies.mass.size))
    axial = np.abs(turn[2]) if is_torque else np.hypot(turn[0], turn[1])
    size = sizes(turn)
    return size, np.where(bodies.rotor_class == POINT, size, axial)
