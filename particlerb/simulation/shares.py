"""The share of one rank in a scene: its bodies, and the groups that move them."""

import itertools
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.case.run import frame_count
from particlerb.contact.contact_model import GroupContact
from particlerb.contact.missed_pairs import bounding_radii
from particlerb.forces import Terms, terms_on
from particlerb.forces.attraction import TILE
from particlerb.forces.links import WORLD
from particlerb.maths.vec3 import Ints
from particlerb.model.bodies import taken
from particlerb.model.bricks import shares_of_bricks
from particlerb.model.load import STATE_ROWS
from particlerb.model.superblocks import Range, own_parts, parts_of, range_of, superblocks, writers
from particlerb.model.system import System
from particlerb.plan.joint_ends import Ties, joint_name, pairs_of
from particlerb.plan.links import AnyLink, components, is_link, links_of
from particlerb.plan.segments import GroupPlan, Plan, Segment, inside, jumps_on
from particlerb.ranks import NoRanksError, Ranks
from particlerb.record.file_size import estimated_size
from particlerb.rotors.rotor_class import POINT
from particlerb.simulation.whole_run import Prepared
from particlerb.stepping.contact_part import contact_like
from particlerb.stepping.motion import SegmentGroup, Shared

BYTES_SET_UP: Final = 720  # of memory for each body of the scene, pushed: benchmarks/ranks.py
BYTES_MOVED: Final = 2050  # beside these for each body that a rank moves, likewise
BYTES_JOINT: Final = 9000  # in the set-up, for each joint of the scene: see docs/scale.md
BYTES_TIED: Final = 7000  # in the run, for each body of a rank that a joint ties
BYTES_SEARCHED: Final = 115  # in the set-up, for each sphere that touches: see docs/scale.md
BYTES_UNPUSHED: Final = 250  # of those of the set-up that a body which touches does not take
BYTES_SAVED: Final = 200  # of a checkpoint for each body, likewise
BYTES_TOUCHING: Final = 2600  # in the run, for each body of a rank that touches, and each copy
BYTES_SPHERE: Final = 850  # in the run, for each of their spheres
BYTES_WRITTEN: Final = 1400  # in the run, for each body that a rank writes and another may move
SENSIBLE_BODIES: Final = 2000  # that touch, of a rank at least: see docs/scale.md
MOST_ATTRACTED: Final = 1_000_000  # particles: 1e12 pairs are some minutes of one core
_COUPLING_WORDS: Final = {
    "links": "springs between bodies that touch, or damped ones on these",
    "user_pairs": "forces between bodies that touch",
    "joints": "joints",
}


def refuse_coupled(prepared: Prepared) -> None:
    """Raise NoRanksError where bodies act on each other that ranks would not move together.

    Those that joints or springs tie together are to lie in one superblock. What ties the first that
    do not is named.
    """
    system = prepared.system
    each = [(np.array(k), *pairs_of(system, table)) for k, table in enumerate(system.joint)]
    ties: list[AnyLink | Ties] = [*itertools.starmap(Ties, each), *links_of(system)]
    label = components(system.n_bodies, ties, np.zeros(0, dtype=np.int64))
    block = superblocks(system.n_bodies)[0].stop
    torn = label[np.arange(label.size) // block != label // block]
    if torn.size:
        raise NoRanksError(_told_of(system, ties, np.flatnonzero(label == torn.min()), block))


def _told_of(system: System, ties: Sequence[AnyLink | Ties], members: Ints, block: int) -> str:
    """What is wrong with bodies that are tied together and lie in several superblocks."""
    first, last = int(members[0]), int(members[-1])
    tie = next(tie for tie in ties if np.isin(tie.body_a, members).any())
    if isinstance(tie, Ties):
        k, number = int(np.argmax(np.isin(tie.body_a, members))), int(tie.record)
        tie_name = joint_name(system, system.joint[number], tie.body_a, tie.body_b, k)
        name = f"joint[{number}] ({tie_name})"
    else:
        name = f"force[{tie.number}]"
    return (
        "--mpi lets one rank move all bodies that joints or springs tie together:"
        f" {name} and others tie {members.size}, from {system.names[first]}, body {first} of the"
        f" scene, to {system.names[last]}, body {last}, which are not among the same {block}: list"
        " the bodies of a mechanism next to each other in the case, or run it without --mpi"
    )


def attraction_of(plan: Plan) -> Terms | None:
    """Terms of the bodies that attract each other; None where none do."""
    every = (segment.terms for _, segment in plan.segments)
    return next((terms for terms in every if terms.attraction is not None), None)


def refuse_attraction(plan: Plan, ranks: Ranks) -> int:
    """Most ranks that may share a sum over attracting particles; NoRanksError where they cannot."""
    terms = attraction_of(plan)
    assert terms is not None
    assert terms.attraction is not None
    n = terms.attraction.mass.size
    most = -(-n // TILE)
    if terms.opening_angle:
        raise NoRanksError(
            "--mpi shares the direct sum of the attraction, and this case takes a tree: give"
            ' attraction.sum = "direct", or run it without --mpi'
        )
    if n > MOST_ATTRACTED:
        raise NoRanksError(
            f"--mpi shares the attraction of {MOST_ATTRACTED} particles at most, and this case has"
            f" {n}: each of the ranks moves all bodies; run it without --mpi, with a tree"
        )
    if ranks.count > most:
        raise NoRanksError(
            f"{ranks.count} ranks are too many for the attraction of {n} particles: a rank sums"
            f" over the pairs of {TILE} or more, so {most} may share it"
        )
    return most


def _with_attraction_shared(prepared: Prepared, ranks: Ranks) -> Prepared:
    """All bodies, on each rank; only the sum over their pairs is shared."""
    groups = [
        group._replace(
            segments=tuple(s._replace(terms=s.terms._replace(ranks=ranks)) for s in group.segments)
        )
        for group in prepared.plan.groups
    ]
    return prepared._replace(plan=prepared.plan._replace(groups=tuple(groups)), is_copied=True)


def can_be_apart(scene: Any) -> bool:
    """Whether each rank can set up its bodies: they and their forces need nothing of the others.

    Of a case, or of the system that was made of it.
    """
    couples = scene.contact or scene.attraction or scene.joint
    is_varied = any(body.is_varied for body in scene.body)
    is_of_several = any(is_link(force) or force.needs_particles for force in scene.force)
    return not (couples or is_varied or is_of_several or scene.run.accuracy is not None)


def is_planned_together(system: System) -> bool:
    """Whether other bodies of a scene may decide by which method these are moved.

    A method that is named moves points among other bodies, but not points alone.
    """
    is_point = np.unique(system.properties.rotor_class == POINT)
    return system.run.method not in ("auto", "exact") and is_point.size > 1


def share_of(n_bodies: int, ranks: Ranks) -> Range:
    """Bodies of a rank.

    Raises
    ------
    NoRanksError
        If there are more ranks than parts.
    """
    ranges = parts_of(n_bodies)
    if ranks.count > len(ranges):
        least = ranges[0].stop
        raise NoRanksError(
            f"{ranks.count} ranks are too many for {n_bodies} bodies: a rank takes {least} or more,"
            f" so {len(ranges)} may share them"
        )
    return range_of(n_bodies, ranks)


def part_of(prepared: Prepared, ranks: Ranks) -> Prepared:
    """The share of a rank in a prepared system; itself where it has been set up apart.

    Raises
    ------
    NoRanksError
        If bodies act on each other in a way that ranks cannot share, or ranks are too many.
    """
    if prepared.is_part or prepared.hash_of_scene:
        return prepared
    if prepared.plan.contacts:
        refuse_contact(prepared, ranks)
        return _part_of_touching(prepared, touching_in(prepared.plan), ranks)
    if attraction_of(prepared.plan) is not None:
        refuse_attraction(prepared.plan, ranks)
        return _with_attraction_shared(prepared, ranks)
    refuse_coupled(prepared)
    first, stop = of = share_of(prepared.system.n_bodies, ranks)
    plan = prepared.plan._replace(groups=tuple(inside(prepared.plan.groups, of, first)))
    return prepared._replace(system=prepared.system.part(first, stop), plan=plan, first=first)


def _part_of_touching(prepared: Prepared, group: GroupPlan, ranks: Ranks) -> Prepared:
    """Bodies that a rank shows and writes; whom it moves changes on the way."""
    system = prepared.system
    first, stop = of = range_of(system.n_bodies, ranks)
    indices = np.flatnonzero((group.members >= first) & (group.members < stop))
    bodies, members = taken(group.bodies, indices), group.members[indices] - first
    examples, kind = _kinds_of(system, group.members, ranks)
    all_bodies = SegmentGroup(group.members, taken(group.bodies, examples), Terms())
    shared = Shared(all_bodies, kind, ranks, of, system.n_bodies)
    contacts = dict[int, GroupContact | None]()  # which segments have in common
    segments = tuple(_shown(segment, indices, examples, contacts) for segment in group.segments)
    shown = GroupPlan(members, bodies, segments, group.worlds, shared)  # without rates of all
    others = inside([one for one in prepared.plan.groups if not one.touches], of, first)
    plan = prepared.plan._replace(groups=(shown, *others))
    return prepared._replace(system=system.part(first, stop), plan=plan, first=first)


def _kinds_of(system: System, members: Ints, ranks: Ranks) -> tuple[Ints, Ints]:
    """Bodies of a group like which the others are, and like which of these each is.

    Ranks keep constants and spheres of these alone. One rank moves all, and needs those of each.
    """
    sort = system.kind[members] * len(system.body) + system.block[members]
    _, examples, kind = np.unique(sort, return_index=True, return_inverse=True)
    if ranks.count == 1 or examples.size == members.size:
        return np.arange(members.size), np.arange(members.size)
    return examples, kind.astype(np.int32)


def _shown(
    segment: Segment, indices: Ints, examples: Ints, contacts: dict[int, GroupContact | None]
) -> Segment:
    """A segment of bodies that a rank shows, with what acts on all."""
    jumps, contact = jumps_on(segment.jumps, indices), segment.terms.contact
    if contact is not None and examples.size < contact.max_arm.size:
        key, prescribed = id(contact), contact.model.prescribed
        if key not in contacts:
            contacts[key], _ = contact_like(contact, examples, prescribed)
        contact = contacts[key]
    terms = segment.terms._replace(contact=None)
    shown = terms_on(terms, indices)._replace(contact=contact)
    return segment._replace(terms=shown, jumps=jumps, all_terms=terms)


def refuse_contact(prepared: Prepared, ranks: Ranks) -> None:
    """Raise NoRanksError where ranks cannot share a scene in which bodies touch; it says why."""
    unshared = list(dict.fromkeys(_unshared(prepared)))
    if unshared:
        told = "--mpi shares clumps with springs in their contacts, and this case has"
        raise NoRanksError(f"{told} {', '.join(unshared)}: run it without --mpi")
    refuse_coupled(prepared)
    n = int((touching_in(prepared.plan).bodies.inv_mass > 0.0).sum())
    if ranks.count > n:
        raise NoRanksError(f"{ranks.count} ranks are too many for {n} bodies that touch and move")


def touching_in(plan: Plan) -> GroupPlan:
    """The bodies that touch: they are one group."""
    return next(group for group in plan.groups if group.touches)


def _unshared(prepared: Prepared) -> Iterator[str]:
    """What there is that ranks cannot share where bodies touch."""
    system, group = prepared.system, touching_in(prepared.plan)
    ends = [end for table in system.joint for end in pairs_of(system, table)]
    if any(np.isin(end, group.members).any() for end in ends):
        yield _COUPLING_WORDS["joints"]
    if attraction_of(prepared.plan) is not None:
        yield "attraction"
    for segment in group.segments:
        terms, contact = segment.terms, segment.terms.contact
        yield from (w for key, w in _COUPLING_WORDS.items() if getattr(terms, key) is not None)
        if contact is not None and not terms.has_springy_contact:
            yield f'the law "{system.contact.law}"' if system.contact else "contact by impulses"
        if segment.method != "strang":
            yield f"the method {segment.method}"


class Shares(NamedTuple):
    """How ranks share a scene: the most that one of them has."""

    ranks_at_most: int
    parts: int
    """Files that bodies lie in."""
    bodies_of_part: int
    bytes_of_part: int
    """Size of each file, with two states from which the run can be continued."""
    bodies_of_rank: int
    """Bodies that a rank moves."""
    set_up_bytes: int
    """Memory of the set-up, of the bodies of a rank or of the whole scene: see docs/scale.md."""
    run_bytes: int
    """Memory of the run, beside it."""
    copies_of_rank: int = 0
    """Bodies of other ranks that may touch those of a rank, at the start."""
    bytes_of_step: int = 0
    """What a rank receives in a step."""
    sensible_ranks: int | None = None
    """Ranks beyond which the exchange costs more than it saves; None: there is no exchange."""


def _most_of_rank(bodies: Ints, n_bodies: int, n_ranks: int) -> int:
    """How many of some bodies a rank has at most, where each has whole parts of the scene."""
    ranges = parts_of(n_bodies)
    return int(np.bincount(writers(len(ranges), n_ranks)[bodies // ranges[0].stop]).max(initial=0))


def shares_of(prepared: Prepared, n_ranks: int) -> Shares:
    """How so many ranks would share a prepared system.

    Raises
    ------
    NoRanksError
        As `part_of`.
    """
    system, ranks = prepared.system, Ranks()
    ranks.count = n_ranks
    ranks.number = n_ranks - 1  # the last rank has most parts
    ranges = parts_of(system.n_bodies)
    in_part = ranges[0].stop
    n_bytes = estimated_size(system, frame_count(system.run)) * in_part // system.n_bodies
    set_up, of_part = BYTES_SET_UP * system.n_bodies, n_bytes + 2 * BYTES_SAVED * in_part
    ends = [pairs_of(system, table) for table in system.joint]
    set_up += BYTES_JOINT * sum(first.size for first, _ in ends)
    tied = np.unique(np.concatenate([np.zeros(0, np.int64), *itertools.chain(*ends)]))
    of_ties = BYTES_TIED * _most_of_rank(tied[tied != WORLD], system.n_bodies, n_ranks)
    if prepared.plan.contacts:
        refuse_contact(prepared, ranks)
        group = touching_in(prepared.plan)
        contact = group.segments[0].terms.known_contact
        model, n = contact.model, group.members.size
        is_free = model.inv_mass > 0.0
        reach = bounding_radii(model.spheres, n)
        com = taken(system.state, group.members).com[:, is_free]
        bodies, copies = shares_of_bricks(com, reach[is_free], contact.skin, ranks)
        here = min(bodies + copies, n)
        n_spheres = model.spheres.radius.size * here / n
        set_up += BYTES_SEARCHED * model.spheres.radius.size - BYTES_UNPUSHED * n
        other = np.delete(np.arange(system.n_bodies), group.members)
        others = _most_of_rank(other, system.n_bodies, n_ranks)
        run_bytes = BYTES_TOUCHING * here + int(BYTES_SPHERE * n_spheres)
        run_bytes += BYTES_MOVED * others + of_ties
        run_bytes += BYTES_WRITTEN * _most_of_rank(group.members, system.n_bodies, n_ranks)
        most, bodies = int(is_free.sum()), bodies + others
        sensible = max(1, most // SENSIBLE_BODIES)
        exchanged: tuple[int, ...] = copies, 8 * STATE_ROWS * copies, sensible
    elif (terms := attraction_of(prepared.plan)) is not None and terms.attraction is not None:
        most, bodies = refuse_attraction(prepared.plan, ranks), system.n_bodies
        run_bytes = BYTES_MOVED * bodies
        exchanged = 0, 24 * terms.attraction.mass.size, most
    else:
        refuse_coupled(prepared)
        share_of(system.n_bodies, ranks)
        bodies = min(len(own_parts(len(ranges), ranks)) * in_part, system.n_bodies)
        if can_be_apart(system) and not is_planned_together(system):
            set_up = BYTES_SET_UP * bodies
        most, run_bytes, exchanged = len(ranges), BYTES_MOVED * bodies + of_ties, ()
    return Shares(most, len(ranges), in_part, of_part, bodies, set_up, run_bytes, *exchanged)
