"""What acts on each group of bodies and when: segments of time between the edges of forces.

Each segment is free (closed form) or driven (stepped). Forces that do not act in it are neither
computed nor compiled.
"""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.case.problems import CaseError, problem_at
from particlerb.contact.contact_model import GroupContact
from particlerb.forces import Terms, kinds, needs_of, terms_on, without_gradient
from particlerb.forces.drag import Drag
from particlerb.forces.impulse import Impulse
from particlerb.integrators import METHODS
from particlerb.joints.setup import with_drag
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, held, taken
from particlerb.model.state import State
from particlerb.model.superblocks import Range, superblock_of, superblocks
from particlerb.model.system import System
from particlerb.model.worlds import Worlds, worlds_among
from particlerb.plan.case_forces import Forces, acting_terms, jumps_of
from particlerb.plan.contact_setup import SystemContact
from particlerb.plan.group_terms import terms_between
from particlerb.plan.groups import GroupForces, part_of
from particlerb.plan.joint_drives import drives_from
from particlerb.plan.known_courses import Behind, Courses, Stretch, with_known_courses
from particlerb.rotors.rotor_class import POINT
from particlerb.stepping.closed_forms import has_closed_form
from particlerb.stepping.motion import SegmentGroup, Shared

_ALL_TIME: Final = (-np.inf, np.inf)
Needs: TypeAlias = dict[str, frozenset[str]]
_NEEDS: Final = {
    kinds.POSE: "it depends on the pose",
    kinds.VELOCITY: "it depends on velocities",
    kinds.TIME: "it depends on time",
    kinds.BODIES: "bodies act on each other",
    kinds.CONTACT: "bodies touch",
    kinds.PISTONS: "walls slide",
    kinds.IMPULSES: "contacts have no stiffness",
    kinds.EVENTS: "bodies collide at the instants of their impacts",
    kinds.JOINTS: "joints hold bodies",
    kinds.FLOWS: "it depends on velocities, and joints hold bodies",
}


class RegroupedError(Exception):
    """Groups of which something was left behind are no longer these."""


class Segment(NamedTuple):
    """One stretch of time of one group."""

    start: float  # [s]
    stop: float  # [s], inf for the last
    jumps: tuple[Impulse, ...]  # impulses at the start
    terms: Terms
    method: str
    dt: float  # [s]; 0 where the method has no step, the first one where it is adaptive
    tolerance: float  # of one step of adaptive methods, relative
    all_terms: Terms | None = None  # what acts on all bodies, where ranks share them


class GroupPlan(NamedTuple):
    """Bodies on which the same forces act."""

    members: Ints  # (n,) which bodies of the system these are
    bodies: Bodies  # their constants
    segments: tuple[Segment, ...]  # to infinity
    worlds: Worlds | None = None  # scenes that share the group, if they are several
    shared: Shared | None = None  # where ranks share bodies that touch
    rates: Floats | None = None  # (3, n) of stepped bodies, see `rates_of`

    def group(self, segment: Segment) -> SegmentGroup:
        """What a method needs for one segment."""
        shared = self.shared
        if shared is not None and segment.all_terms is not None:
            shared = shared._replace(group=shared.group._replace(terms=segment.all_terms))
        return SegmentGroup(self.members, self.bodies, segment.terms, self.worlds, shared)

    @property
    def stepped(self) -> list[Segment]:
        """Segments that are stepped."""
        return [segment for segment in self.segments if has_step(segment.method)]

    @property
    def touches(self) -> bool:
        """Whether its bodies touch."""
        return any(segment.terms.contact is not None for segment in self.segments)

    @property
    def is_closed(self) -> bool:
        """Whether its bodies move in closed form throughout, and touch nothing."""
        return not (self.touches or any(has_step(one.method) for one in self.segments))


class Plan(NamedTuple):
    """How a system will be run."""

    groups: tuple[GroupPlan, ...]
    step: str  # the step and why this one
    warnings: tuple[str, ...]

    @property
    def segments(self) -> list[tuple[GroupPlan, Segment]]:
        """All segments, each with its group."""
        return [(group, segment) for group in self.groups for segment in group.segments]

    @property
    def contacts(self) -> list[GroupContact]:
        """Contact of the segments that have it."""
        return [s.terms.contact for _, s in self.segments if s.terms.contact is not None]


def cut_into_segments(
    system: System, group: GroupForces, touching: SystemContact | None, begin: float, is_first: bool
) -> list[GroupPlan]:
    """Segments of a group from a time on, between the edges of its forces; steps are set later.

    Impulses of that time act where it is the first of the run. Bodies with a closed form part from
    others where they are not stepped.
    """
    members = group.members
    if group.behind is not None:
        begin, is_first = group.behind.begin, True
    spans = [force.form.edges or _ALL_TIME for force in group.forces]  # of an impulse: its instant
    spans_of_links = [link.force.edges or _ALL_TIME for link in group.links]
    edges = {begin}.union(*spans, *spans_of_links)
    if group.joints is not None:
        edges.update(group.joints.until[np.isin(group.joints.body_a, group.members)].tolist())
        driven = group.joints.drives_among(group.members)
        edges.update(*(course.knots.tolist() for course in driven))
    starts = sorted(edge for edge in edges if begin <= edge < np.inf)
    bodies = held(taken(system.bodies, members), group.is_held)
    between: dict[tuple[int, ...], Terms] = {}  # by released joints and the numbers of the links
    stretches: list[Stretch] = []
    idle = acting_terms(system, bodies, [], begin)
    for start, acting, now in zip(starts, *_acting(group.forces, spans, starts), strict=True):
        spanned = zip(group.links, spans_of_links, strict=True)
        links = [link for link, s in spanned if s[0] <= start < s[-1]]
        released = 0 if group.joints is None else int((group.joints.until <= start).sum())
        key = released, *(link.number for link in links)
        if key not in between:
            between_bodies = terms_between(system, group, bodies, links, touching, start)
            between[key] = between_bodies._replace(gravity=idle.gravity, loads=idle.loads)
        terms = between[key]
        if acting:
            terms = terms._replace(loads=acting_terms(system, bodies, acting, start).loads)
        if terms.joints is not None and group.joints is not None:
            drives = drives_from(group.joints.courses, start)
            terms = terms._replace(joints=terms.joints._replace(drives=drives))
            terms = _with_drag_among_joints(terms, bodies)
        jumps = jumps_of(now, bodies) if start > begin or is_first else ()
        stretches.append(Stretch(terms, jumps))
    closed, segments = [], []
    scene = system.world[members] if group.joints is not None or group.links else None
    named, stops = system.run.method, [*starts[1:], np.inf]
    at_begin = bodies, taken(system.state, members)
    known_terms = _with_closed_forms(named, *at_begin, stretches, scene, group.behind)
    each = zip(starts, stops, stretches, known_terms, strict=True)
    for start, stop, (_, jumps), (terms, is_closed) in each:
        method = _chosen_method(named, bodies, terms, is_closed)
        segments.append(Segment(start, stop, jumps, terms, method, 0.0, system.run.tolerance))
        closed.append(is_closed)
    if not np.diff(closed, axis=1).any():
        n = system.n_worlds
        worlds = worlds_among(system.world[members], n) if n > 1 else None
        return [GroupPlan(members, bodies, tuple(segments), worlds)]
    distinct, kind = np.unique(np.array(closed), axis=1, return_inverse=True)
    parts = [np.flatnonzero(kind == k) for k in range(distinct.shape[1])]
    return _cut_apart(system, group, parts, touching, (begin, is_first))


def _cut_apart(
    system: System,
    group: GroupForces,
    parts: list[Ints],
    touching: SystemContact | None,
    start: tuple[float, bool],
) -> list[GroupPlan]:
    """Parts of a group by themselves, as `cut_into_segments`."""
    if group.behind is not None:
        raise RegroupedError
    groups = [part_of(group, index) for index in parts]
    return [part for setup in groups for part in cut_into_segments(system, setup, touching, *start)]


def _acting(
    forces: Sequence[Forces], spans: Sequence[tuple[float, ...]], starts: list[float]
) -> tuple[list[list[Forces]], list[list[Forces]]]:
    """Forces that act from each of some ascending times on, and impulses of that time; in order."""
    acting: list[list[Forces]] = [[] for _ in starts]
    now: list[list[Forces]] = [[] for _ in starts]
    for force, s in zip(forces, spans, strict=True):
        first, stop = bisect_left(starts, s[0]), bisect_left(starts, s[-1])
        for k in range(first, stop):
            acting[k].append(force)
        if len(s) == 1 and first < len(starts) and starts[first] == s[0]:
            now[first].append(force)
    return acting, now


def _with_drag_among_joints(terms: Terms, bodies: Bodies) -> Terms:
    """The same with drag that acts within the constraints of the joints."""
    assert terms.joints is not None
    joints, others = terms.joints, []
    for load in terms.loads:
        if isinstance(load, Drag):
            joints = with_drag(joints, load.rate * bodies.mass, load.rotation)
        else:
            others.append(load)
    return terms._replace(joints=joints, loads=tuple(others))


def _refused_terms(method: str, terms: Terms, known_needs: Needs | None = None) -> list[str]:
    """Terms that need more than a method takes into account; what that is, where it steps."""
    chosen, refused = METHODS[method], {}
    for name, needs in (needs_of(terms) if known_needs is None else known_needs).items():
        lacking = sorted(_NEEDS.get(need, _NEEDS[kinds.JOINTS]) for need in needs - chosen.accepts)
        if lacking:
            refused[name] = f" ({lacking[0]})" if has_step(method) else ""
    if chosen.takes_gradients:
        refused = dict.fromkeys(without_gradient(terms), " (its gradient is not known)") | refused
    return sorted(name + why for name, why in refused.items())


def accepting(methods: Iterable[str], terms: Terms) -> list[str]:
    """Those of some methods that can integrate under these terms, and are meant for them."""
    needs = needs_of(terms)
    return [name for name in methods if accepts(name, terms, needs)]


def accepts(method: str, terms: Terms, needs: Needs | None = None) -> bool:
    """Whether a method can integrate under these terms, with these needs, and is meant for them."""
    chosen = METHODS[method]
    is_idle = chosen.holds_joints and terms.joints is None
    is_idle = is_idle or (chosen.takes_impulses and not terms.touches_by_impulses)
    return not is_idle and not _refused_terms(method, terms, needs)


def has_step(method: str) -> bool:
    """Whether a method steps; a closed form does not."""
    return METHODS[method].order > 0


def is_adaptive(method: str) -> bool:
    """Whether a method chooses its steps itself."""
    return bool(METHODS[method].is_adaptive)


def _may_be_closed(named: str, terms: Terms) -> bool:
    """Whether a segment is not stepped where it has a closed form: a named method steps."""
    method = METHODS.get(named)
    if method is None or named == "exact":
        return True
    lacks_joints = method.holds_joints and terms.joints is None
    return lacks_joints or (method.takes_impulses and terms.contact is None)


def _with_closed_forms(
    named: str,
    bodies: Bodies,
    state: State,
    stretches: list[Stretch],
    scene: Ints | None,
    behind: Behind | None,
) -> list[tuple[Terms, Bools]]:
    """Terms of all segments, and which bodies have a closed form that counts."""
    courses = None if behind is None else behind.courses
    might = behind is None or courses is not None
    if might and all(_may_be_closed(named, one.terms) for one in stretches):
        return with_known_courses(bodies, state, stretches, scene, courses)
    none = np.zeros(bodies.mass.size, dtype=bool)
    return [(one.terms, none) for one in stretches]


def left_behind(system: System, group: GroupPlan, number: int, before: Behind | None) -> Behind:
    """What a group has left behind in its segment `number`, beside what it had at the first."""
    passed, method = group.segments[:number], system.run.method
    start = group.bodies, taken(system.state, group.members)
    courses = Courses(*start) if before is None else before.courses
    if courses is None or not all(_may_be_closed(method, segment.terms) for segment in passed):
        return Behind(group.segments[number].start, None)
    courses = courses.copied()
    for segment in passed:
        courses.under(Stretch(segment.terms, segment.jumps))
        courses.leave(np.full(group.members.size, not has_step(segment.method)))
    return Behind(group.segments[number].start, courses)


def _chosen_method(named: str, bodies: Bodies, terms: Terms, is_closed: Bools) -> str:
    """Method of a segment: a named one steps whatever rotates, `auto` does not."""
    if _may_be_closed(named, terms):
        if is_closed.all() or named == "exact":
            return "exact"
        if terms.contact is not None and not terms.has_springy_contact:
            return "moreau"
        return "strang" if terms.joints is None else "rattle"
    rotates = bool((bodies.rotor_class != POINT).any())
    return named if rotates or not accepts("exact", terms) else "exact"


def refuse_method(system: System, groups: list[GroupPlan]) -> None:
    """Raise CaseError where a method was asked for and a force acts that it does not accept."""
    named, reason = system.run.method, ""
    by_impulses = system.contact is not None and system.contact.law == "impulse"
    if named != "auto" and METHODS[named].holds_joints and not system.joint:
        reason = "bodies that joints hold, and the case has no [[joint]]"
    elif named != "auto" and METHODS[named].takes_impulses and not by_impulses:
        reason = "contact by impulses, and the case has none"
    if reason:
        reason = f"{named} is for {reason}"
        raise CaseError([problem_at(system, "run.method", reason, 'use "strang"')])
    for group in groups:
        alike = {(segment.method, id(segment.terms)): segment for segment in group.segments}
        for segment in alike.values():
            refused = _refused_terms(segment.method, segment.terms)
            is_closed = not has_step(segment.method)
            if not refused or (is_closed and has_closed_form(group.bodies, segment.terms).all()):
                continue
            acting = ", ".join(refused)
            able = _methods_for(segment.terms)
            apart = "" if able else _methods_for(segment.terms._replace(contact=None))
            reason = f"{segment.method} does not accept what acts here: {acting}"
            hint = f"methods that do: {able or 'none'}"
            hint += f"; without contact: {apart}" if apart else ""
            raise CaseError([problem_at(system, "run.method", reason, hint)])


def _methods_for(terms: Terms) -> str:
    """Names of the methods that accept what acts."""
    return ", ".join(name for name in METHODS if accepts(name, terms))


def inside(groups: Sequence[GroupPlan], of: Range, begin: int = 0) -> list[GroupPlan]:
    """What there is of groups in a range of bodies, which are numbered from another one on."""
    parts = []
    for group in groups:
        index = np.flatnonzero((group.members >= of.first) & (group.members < of.stop))
        members = group.members[index] - begin
        if index.size == group.members.size:
            parts.append(group._replace(members=members))
        elif index.size:
            parts.append(chosen(group, index, members))
    return parts


def chosen(group: GroupPlan, index: Ints, members: Ints) -> GroupPlan:
    """Some bodies of a group under new numbers."""
    segments = tuple(
        s._replace(terms=terms_on(s.terms, index), jumps=jumps_on(s.jumps, index))
        for s in group.segments
    )
    return GroupPlan(members, taken(group.bodies, index, group.is_closed), segments)


def jumps_on(jumps: tuple[Impulse, ...], k: Ints) -> tuple[Impulse, ...]:
    """Impulses on some of the bodies."""
    dense = np.ascontiguousarray
    return tuple(j._replace(at=dense(j.at[:, k]), impulse=dense(j.impulse[:, k])) for j in jumps)


def is_coupled(group: GroupPlan) -> bool:
    """Whether bodies of a group act on each other, or touch walls."""
    tied = any(s.terms.is_coupled or s.terms.joints is not None for s in group.segments)
    return tied or group.touches


def is_one(group: GroupPlan, is_cut: bool) -> bool:
    """Whether a group is not to be cut into superblocks: its bodies act on others elsewhere."""
    if group.touches or group.worlds is not None:
        return True
    at = group.members
    return is_cut and is_coupled(group) and superblock_of(int(at.min()), int(at.max())) < 0


def in_superblocks(groups: Sequence[GroupPlan], n_bodies: int) -> list[tuple[int, list[GroupPlan]]]:
    """Groups that are one, with -1; those of each superblock by themselves, with its first body."""
    together, apart = list[GroupPlan](), list[GroupPlan]()
    ranges = superblocks(n_bodies)
    for group in groups:
        (together if is_one(group, len(ranges) > 1) else apart).append(group)
    each = [(-1, together)]
    for of in ranges:
        some = inside(apart, of) if len(ranges) > 1 else apart
        some = sorted(some, key=lambda one: int(one.members.min())) if len(some) > 1 else some
        each.append((of.first, some))
    return [one for one in each if one[1]]
