"""The plan in words: what is computed, what is left out, and why, one line each."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, islice

import numpy as np

from particlerb.case.coarse_lattice import lattice_errors
from particlerb.case.contact import ContactTable
from particlerb.case.run import AttractionTable
from particlerb.forces import Terms, has_potential, is_constant, needs_of, words_of
from particlerb.forces.gravity_tree.opening_angle import SAMPLE
from particlerb.forces.kinds import TIME
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import Bodies
from particlerb.model.names import BodyNames
from particlerb.model.system import System
from particlerb.plan.contact_rules import MOST_BODIES
from particlerb.plan.joint_words import joint_line
from particlerb.plan.merging import merged
from particlerb.plan.segments import GroupPlan, Plan, Segment, has_step, is_adaptive
from particlerb.plan.time_step import cheaper_law, expected_overlap
from particlerb.ranks import ALONE, Ranks
from particlerb.stepping.closed_forms import words_of_forms
from particlerb.stepping.sparse_contact import can_fly
from particlerb.words import count_of

_MAX_GROUPS_SHOWN = 20
_MAX_SEGMENTS_SHOWN = 12
_MAX_RUNS_SHOWN = 4
_PLAIN = 1e-9  # an offset, or an error of moments, that nobody asks about
_BALANCE = (  # the hardest first
    "work and impulses summed step by step: a force without potential acts",
    "work from potentials and their change with time; impulses summed step by step",
    "work from potentials; impulses summed step by step: a force is not constant",
    "work and impulses in closed form",
    "work and impulses in closed form: every force has a potential",
)
_CLASS_WORDS = ("point", "rod", "spherical top", "symmetric top", "asymmetric top")


def describe(
    system: System, plan: Plan, accuracy: str = "", ranks: Ranks = ALONE, is_whole: bool = False
) -> str:
    """Text of a plan, with what is known of its accuracy; of several, each with own bodies.

    The whole of it has all groups and segments, and a line for each thing that does not act.
    """
    out = _left_out(system, plan)
    lines = [
        ("bodies", _bodies_line(system, ranks)),
        ("particles", _particles_line(system)),
        *system.notes,
        *_acting_lines(system, plan, ranks),
        *((name, f"off: {why}") for name, why in out.items() if is_whole),
        *([] if is_whole else [("left out", _left_out_line(out))]),
        ("step", plan.step),
        *([("accuracy", accuracy)] if accuracy else []),
        ("energy balance", _BALANCE[min(ranks.gathered(_hardest_balance(plan)))]),
        *_group_lines(system, plan, ranks, is_whole),
    ]
    width = min(44, max(len(name) for name, _ in lines))
    return "\n".join(f"  {name:<{width}}  {text}" for name, text in lines)


def _group_lines(
    system: System, plan: Plan, ranks: Ranks, is_whole: bool
) -> Iterator[tuple[str, str]]:
    """Groups of bodies, with lines of their segments.

    Over ranks, those of which the same is to be said are one.
    """
    names, first, n = system.names, system.names.part.start, len(plan.groups)
    most, shown = (n, np.inf) if is_whole else (_MAX_GROUPS_SHOWN, _MAX_SEGMENTS_SHOWN)
    told = [
        (_runs(group.members + first), group.members.size, _segment_lines(group, shown))
        for group in plan.groups[: most if ranks is ALONE else None]
    ]
    if ranks is not ALONE:
        alike: dict[tuple[str, ...], tuple[list[tuple[int, int]], int]] = {}
        for runs, size, lines in chain(*ranks.gathered(told)):
            before, n_before = alike.get(tuple(lines), ([], 0))
            follows = bool(before) and before[-1][1] + 1 == runs[0][0]
            joined = [(before.pop()[0], runs[0][1])] if follows else []
            alike[tuple(lines)] = before + joined + runs[follows:], n_before + size
        told = [(*bodies, list(lines)) for lines, bodies in alike.items()]
        names, n = BodyNames(names.records), len(told)
        most = n if is_whole else most
    for runs, size, lines in told[:most]:
        yield from ((_name_of(names, runs, size), text) for text in lines)
    if n > most:
        yield "...", f"and {n - most} more groups of bodies"


def _bodies_line(system: System, ranks: Ranks) -> str:
    """How many bodies of which rotor class."""
    own = np.bincount(system.bodies.rotor_class, minlength=len(_CLASS_WORDS))
    counts = ranks.added(own)
    counted = zip(counts.tolist(), _CLASS_WORDS, strict=True)
    return ", ".join(count_of(n, name) for n, name in counted if n)


def _particles_line(system: System) -> str:
    """How many particles were summed, how many are kept, and why."""
    kinds = len(system.particles.offset) - 1
    sets = "one set" if kinds == 1 else f"{kinds} sets"
    how = "summed once to mass, centre of mass and inertia tensor"
    line = f"{system.summed.sum()} in {sets}, {how}"
    some = islice(lattice_errors(system), _MAX_GROUPS_SHOWN)
    if (worst := max((np.abs(off).max() for *_, off in some), default=0.0)) > _PLAIN:
        line += f"; moments up to {100 * worst:.3g} % from those of solids: see `mass`"
    kept = np.diff(system.particles.offset)
    is_reduced = kept < system.summed
    if not is_reduced.any():
        return line
    touching = np.add.reduceat(system.particles.radius > 0.0, system.particles.offset[:-1])
    surface = touching[is_reduced].sum()
    rest = f"{surface} that touch, and " if surface else ""
    why = "nothing attracts them" if surface else "nothing touches or attracts them"
    return f"{line}; kept of {system.summed[is_reduced].sum()}: {rest}6 points per set, as {why}"


def _acting_lines(system: System, plan: Plan, ranks: Ranks) -> Iterator[tuple[str, str]]:
    """What acts, one line each."""
    if system.acceleration.any():
        yield "gravity", f"{vector(system.acceleration.tolist())} m/s²"
    if system.attraction is not None:
        yield "attraction", _attraction_line(system.attraction, plan)
    for kind, count in Counter(force.type for force in system.force).items():
        origins = ranks.gathered(_origin_of_points(system, kind))
        yield kind, f"{count} in the case{next(filter(None, origins), '')}"
    if system.joint:
        yield "joints", joint_line(merged(system), plan)
    if plan.contacts:
        yield "contact", _contact_line(system, plan)
        if words := _overlap_words(system, plan):
            yield "overlap", words


def _origin_of_points(system: System, kind: str) -> str:
    """Where the centre of mass of a body is, from which `at` counts, if not at the origin."""
    for force in system.force:
        if force.type == kind and np.any(getattr(force, "at", ())):
            b = system.names.find_in_order(force.body)
            com, reach = system.properties.com[system.kind[b]], system.reach[system.kind[b]]
            for k in np.flatnonzero(np.linalg.norm(com, axis=1) > _PLAIN * reach).tolist():
                centre = f"{system.names[b[k]]} is at {vector(com[k].tolist())} m of its axes"
                return f"; `at` counts from the centre of mass, which of {centre}"
    return ""


def _left_out(system: System, plan: Plan) -> dict[str, str]:
    """What does not act, and why."""
    still = "no [gravity]" if system.gravity is None else "its acceleration is 0"
    touches = "no [contact]" if system.particles.radius.any() else "no particle has a radius"
    out = {
        "gravity": (still, not system.acceleration.any()),
        "attraction": ("no [attraction]", system.attraction is None),
        "joints": ("no [[joint]]", not system.joint),
        "forces": ("no [[force]]", not system.force),
        "contact": (touches, not plan.contacts),
    }
    return {name: why for name, (why, is_out) in out.items() if is_out}


def _left_out_line(out: dict[str, str]) -> str:
    """The same in a line, with why nothing touches."""
    words = (f"contact ({why})" if name == "contact" else name for name, why in out.items())
    return ", ".join(words) or "nothing"


def _attraction_line(table: AttractionTable, plan: Plan) -> str:
    """How attraction is summed."""
    terms = [s.terms for _, s in plan.segments if s.terms.attraction is not None]
    assert terms[0].attraction is not None
    n, softening = terms[0].attraction.mass.size, table.softening
    angle, accuracy = terms[0].opening_angle, terms[0].tree_accuracy
    how = "each particle with all those of other bodies"
    if angle:
        how = f"a tree, opening angle {angle:.3g}"
    if accuracy:
        how += f", where no scene errs by more than {accuracy:.3g}, or wider: as wide as"
        how += f" {min(n, SAMPLE)} particles, summed directly at the start, allow"
    soft = f"softened by {softening:.6g} m" if softening else "not softened"
    return f"{n} particles, {how}; G = {table.G:.9g} m³/(kg s²), {soft}"


def vector(values: Sequence[float]) -> str:
    """Three numbers."""
    return "(" + ", ".join(f"{value:.9g}" for value in values) + ")"


def _contact_line(system: System, plan: Plan) -> str:
    """What may touch, by which law."""
    assert system.contact is not None
    contact = plan.contacts[0]
    spheres, walls = contact.model.spheres.radius.size, len(contact.motions)
    and_walls = f" and {count_of(walls, 'wall')}" if walls else ""
    line = f"{count_of(spheres, 'sphere')}{and_walls}, {system.contact.law}"
    if contact.n_interior:
        line += f", {contact.n_interior} inner spheres left out, which nothing can reach"
    if contact.rules is not None:
        line = line if spheres else "nothing, impulse in joints alone"
        line += f", {_solved(plan, system.contact)}"
        if not spheres:
            return line
    if contact.events is not None:
        again = f"what hits again within {contact.events.contact_time:.3g} s bounces elastically"
        return f"{line}, at the instants of impacts, one after the other; {again}"
    return f"{line}, pairs kept within {contact.skin:.3g} m{_flying(plan)}"


def _overlap_words(system: System, plan: Plan) -> str:
    """What overlap is to be expected, and what the other law would take for it."""
    contact = plan.contacts[0]
    if contact.events is not None or not contact.model.spheres.radius.size:
        return ""
    touching = [each for each in plan.segments if each[1].terms.contact is not None]
    overlap, k = max((expected_overlap(system, *each), -k) for k, each in enumerate(touching))
    if not 0.0 < overlap < np.inf or touching[-k][1].dt == 0.0:
        return ""
    words = cheaper_law(system, *touching[-k], overlap)
    return f"about {overlap:.3g} m in the fastest impact, {words}"


def _solved(plan: Plan, table: ContactTable) -> str:
    """How impulses are found."""
    by_impulses = [each for each in plan.segments if each[1].terms.touches_by_impulses]
    after = _after_sweeps(table.solver, max(group.members.size for group, _ in by_impulses))
    return f"residual {table.tolerance:.3g} or {table.iterations} sweeps, {after}"


def _after_sweeps(solver: str, n: int) -> str:
    """Whether Newton's method goes on where sweeps of n bodies do not end, and why."""
    if solver != "auto":
        return f"{'then' if solver == 'newton' else 'not'} Newton's method, as the case says"
    if n <= MOST_BODIES:
        return f"then Newton's method (for up to {MOST_BODIES} bodies)"
    return f"not Newton's method, as {n} bodies are more than {MOST_BODIES}"


def _flying(plan: Plan) -> str:
    """Whether bodies with nothing in reach fly in closed form."""
    touching = ((group, s) for group, s in plan.segments if s.terms.contact is not None)
    flies = any(can_fly(METHODS[s.method], s.terms, g.members.size) for g, s in touching)
    return ", closed form where none is in reach" if flies else ""


def _hardest_balance(plan: Plan) -> int:
    """How the work of forces is found, for the energy balance: which of the words says it."""
    stepped = [segment for group in plan.groups for segment in group.stepped]
    if not all(has_potential(segment.terms) for segment in stepped):
        return 0
    if any(TIME in needs for s in stepped for needs in needs_of(s.terms).values()):
        return 1
    if not all(is_constant(segment.terms) for segment in stepped):
        return 2
    return 4 if all(has_potential(segment.terms) for _, segment in plan.segments) else 3


def group_name(system: System, index: Ints) -> str:
    """Which bodies these are: names of a few, ranges of many."""
    return _name_of(system.names, _runs(index), index.size)


def _runs(index: Ints) -> list[tuple[int, int]]:
    """First and last of bodies that follow each other, not of more than can be shown."""
    index = np.sort(index)
    breaks = np.flatnonzero(np.diff(index) > 1)[: _MAX_RUNS_SHOWN + 1]
    first, last = index[[0, *(breaks + 1).tolist()]], index[[*breaks.tolist(), -1]]
    return list(zip(first.tolist(), last.tolist(), strict=True))


def _name_of(names: BodyNames, runs: Sequence[tuple[int, int]], size: int) -> str:
    """Words for so many bodies, which are in these runs first."""
    if size <= 2:
        return ", ".join(names[b] for first, last in runs for b in range(first, last + 1))
    words = [f"{a}-{b}" if a < b else f"{a}" for a, b in runs]
    more = f", ... ({size})" if len(words) > _MAX_RUNS_SHOWN else ""
    return "bodies " + ", ".join(words[:_MAX_RUNS_SHOWN]) + more


def _segment_lines(group: GroupPlan, most: float) -> list[str]:
    """One line per segment, of so many first ones and the last."""
    n, bodies = len(group.segments), group.bodies
    left = n - int(min(most, n))
    lines = [_segment_line(bodies, segment) for segment in group.segments[: n - left]]
    if left > 1:
        lines.append(f"and {left - 1} more segments")
    if left > 0:
        lines.append(_segment_line(bodies, group.segments[-1]))
    return lines


def _segment_line(bodies: Bodies, segment: Segment) -> str:
    """When, how, why."""
    begin = f"{segment.start:.9g} s"
    when = f"from {begin}" if np.isinf(segment.stop) else f"{begin} to {segment.stop:.9g} s"
    start = f"after {count_of(len(segment.jumps), 'impulse')}, " if segment.jumps else ""
    if not has_step(segment.method):
        return f"{when}: {start}{_closed_reason(bodies, segment.terms)}"
    driver = f"{_driving(segment.terms)}, {segment.method}"
    if is_adaptive(segment.method):
        return f"{when}: {start}{driver}, tolerance {segment.tolerance:.3g}"
    steps = (segment.stop - segment.start) / segment.dt
    count = f"{round(steps)} steps of " if np.isfinite(steps) else "steps of "
    return f"{when}: {start}{driver}, {count}{segment.dt:.6g} s"


def _closed_reason(bodies: Bodies, terms: Terms) -> str:
    """Why a segment has a closed form."""
    acting = " and ".join(words_of(terms))
    if terms.collides_by_events:
        return f"{_driving(terms)}, closed form between impacts, no step"
    if terms.attraction is not None:
        return f"{_driving(terms)}, closed form, no step (two points: Kepler's orbits)"
    if why := words_of_forms(bodies, terms):
        return f"{_driving(terms)}, closed form, no step ({'; '.join(why)})"
    reason = f"{acting} through the centre of mass: a parabola" if acting else "nothing acts"
    return f"free, closed form, no step ({reason})"


def _driving(terms: Terms) -> str:
    """How the terms that act make bodies move, and their names."""
    acting = words_of(terms)
    outside = f"driven by {' and '.join(acting)}" if acting else ""
    if not terms.is_coupled:
        return outside or "driven by nothing, but the case names the method"
    between = []
    if terms.links is not None:
        kinds = "spring", "springs"
        if terms.links.damping is not None:
            kinds = "spring and dashpot", "springs and dashpots"
        between.append(count_of(terms.links.body_a.size, *kinds))
    if terms.user_pairs is not None:
        between.append(terms.user_pairs.words)
    if terms.attraction is not None:
        between.append("attraction")
    if terms.contact is not None:
        between.append("contact")
    if terms.joints is not None:
        between.append(count_of(int((terms.joints.number >= 0).sum()), "joint"))
    return f"coupled by {' and '.join(between)}{outside and f', {outside}'}"
