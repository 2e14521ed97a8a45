"""Forces between bodies, resolved: which pairs, where, how long at rest; and who belongs together.

`links_of` finds the pairs of every [[force]] that ties two bodies, `attracted` the bodies of
[attraction], and `components` labels the bodies that have to advance together.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np

from particlerb.case.forces import AnyForce, PythonTable, SpringTable
from particlerb.case.problems import CaseError, Problem, problem_at, refuse
from particlerb.forces.kinds import ForceError, by_its_arm
from particlerb.forces.links import WORLD
from particlerb.forces.python import with_code
from particlerb.forces.python_pairs import numbers_of_pairs, try_pairs
from particlerb.forces.spring import places
from particlerb.geometry.particles import rows_of_kinds
from particlerb.maths.components import labels
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import lengths, rotate_back
from particlerb.model.system import System
from particlerb.plan.near_pairs import near, nearest_distance
from particlerb.rotors.rotor_class import NAMES, POINT, ROD

_REACH_ROUNDING: Final = 1e-9  # share by which a pair may be further apart than reach
AXIAL_ROUNDING: Final = 1e-12  # share of an arm across a rod that is its rounding
MOST_SPRINGS: Final = 10_000_000  # of one [[force]]
_SHARE_OF_RUN: Final = 0.1  # of run.accuracy that a tree may take
_TREE_ACCURACY: Final = 1e-4  # where the case asks for none
_NO_BODIES: Final = np.zeros(0, dtype=np.int64)


class Link(NamedTuple):
    """Springs of one [[force]] between points of two bodies, or damped ones to the world."""

    number: int  # index of [[force]]
    force: SpringTable
    body_a: Ints  # (s,) bodies of the system
    body_b: Ints  # (s,) bodies of the system; WORLD: an anchor
    at_a: Floats  # (3, s) [m], body frame of a, from its centre of mass
    at_b: Floats  # (3, s) [m], body frame of b, or the anchor in the world frame
    rest_length: Floats  # (s,) [m]


class UserLink(NamedTuple):
    """Pairs of bodies between which a function of a user acts, by one [[force]]."""

    number: int  # index of [[force]]
    force: PythonTable  # with its function
    body_a: Ints  # (s,) bodies of the system
    body_b: Ints  # (s,)
    numbers: Floats  # (r, s) parameters


AnyLink: TypeAlias = Link | UserLink
_PairTable: TypeAlias = SpringTable | PythonTable
_Link = TypeVar("_Link", Link, UserLink)


# Springs and forces between bodies


def is_link(force: AnyForce) -> bool:
    """Whether a spring ties two bodies or is damped, or a force of a user acts between two."""
    if isinstance(force, PythonTable):
        return force.is_pairwise
    return isinstance(force, SpringTable) and (force.anchor is None or force.damping > 0.0)


def links_of(system: System) -> list[AnyLink]:
    """All links of a system.

    Raises
    ------
    CaseError
        With all that is wrong: a body tied to itself, a pair that is named twice, a reach in which
        there is none or too many, a point off the centre of mass of a body without extent or off
        the axis of a rod, a function that fails.
    """
    links, problems = list[AnyLink](), list[Problem]()
    unmerged = system if system.merging is None else system.merging.unmerged
    for number, force in enumerate(system.force):
        if not is_link(force):
            continue
        try:
            if isinstance(force, PythonTable):
                user_links = _in_worlds(unmerged, number, force, _user_link_of)
                _try_user_links(unmerged, number, user_links)
                links += user_links
            else:
                springs = _in_worlds(unmerged, number, force, link_of)
                problems += [one for link in springs for one in _misplaced_ends(unmerged, link)]
                links += springs
        except CaseError as error:
            problems += error.problems
    refuse(problems)
    return links


def _in_worlds(
    system: System, number: int, force: Any, of_scene: Callable[..., _Link]
) -> list[_Link]:
    """Pairs of one [[force]]; where it differs from world to world, those of each by themselves.

    Parameters
    ----------
    system : System
    number : int
        Index of the [[force]].
    force : SpringTable or PythonTable
        In the first world.
    of_scene : callable
        (system, number, force): its pairs in one scene.
    """
    if system.n_worlds == 1:
        return [of_scene(system, number, force)]
    links: list[Any] = []
    for world in range(system.n_worlds):
        world_force = system.others[number][world] if number in system.others else force
        link = of_scene(system.scene(world), number, world_force)
        second = np.where(link.body_b == WORLD, WORLD, link.body_b + world * system.in_each)
        first = link.body_a + world * system.in_each
        links.append(link._replace(body_a=first, body_b=second))
    if number in system.others:
        return links
    arrays = (np.concatenate(one, axis=-1) for one in zip(*(a[2:] for a in links), strict=True))
    return [type(links[0])(number, links[0].force, *arrays)]


def link_of(system: System, number: int, force: SpringTable) -> Link:
    """Springs of one [[force]].

    Raises
    ------
    CaseError
        If its bodies make no pairs.
    """
    if force.anchor is not None:
        first = system.names.find(force.body)
        second = np.full_like(first, WORLD)
    elif force.reach is not None:
        first, second = _pairs_in_reach(system, number, force)
    else:
        first, second = _pairs_as_named(system, number, force)
    first_at = np.tile(np.array(force.at)[:, None], first.size)
    end = force.to_at if force.anchor is None else force.anchor
    second_at = np.tile(np.array(end)[:, None], second.size)
    if force.rest_length == "initial":
        here = places(system, first, force.at)
        there = second_at if force.anchor is not None else places(system, second, force.to_at)
        rest_length = lengths(there - here)
    else:
        rest_length = np.full(first.size, force.rest_length)
    return Link(number, force, first, second, first_at, second_at, rest_length)


def _user_link_of(system: System, number: int, force: PythonTable) -> UserLink:
    """Pairs of one [[force]] that a user wrote.

    Raises
    ------
    CaseError
        If its bodies make no pairs, or its function cannot act on them.
    """
    try:
        force = with_code(force, system)
        find_pairs = _pairs_in_reach if force.reach is not None else _pairs_as_named
        ends = find_pairs(system, number, force)
        return UserLink(number, force, *ends, numbers_of_pairs(force, *ends, system))
    except ForceError as error:
        raise CaseError([force_problem(system, number, error)]) from None


def _try_user_links(system: System, number: int, links: Sequence[UserLink]) -> None:
    """Let a function of a user act on all its pairs, with the parameters of each world.

    Raises
    ------
    CaseError
        If it cannot act on them.
    """
    columns = zip(*(link[2:] for link in links), strict=True)
    first, second, numbers = (np.concatenate(one, axis=-1) for one in columns)
    try:
        try_pairs(links[0].force, first, second, numbers, system)
    except ForceError as error:
        raise CaseError([force_problem(system, number, error, first, second)]) from None


def force_problem(system: System, number: int, error: ForceError, *bodies: Ints) -> Problem:
    """What is wrong with a [[force]]; where it has a name to say, it is of these bodies."""
    names = (system.names[int(those[error.body])] for those in bodies)
    reason = error.reason.replace("{name}", " and ".join(names))
    return problem_at(system, f"force[{number}].{error.key}", reason, error.hint)


def turned_problem(system: System, force: str, key: str, b: int, hint: str) -> Problem:
    """What is wrong with a force that turns a point, or a rod about its own axis."""
    code = int(system.bodies.rotor_class[b])
    what = "has no extent: nothing can turn it" if code == POINT else "cannot turn about its axis"
    reason = (
        f"{system.names[b]} is a {NAMES[code]} with moments"
        f" {sorted(system.bodies.inertia[:, b].tolist())} kg m² and {what}, but this {force} would"
    )
    return problem_at(system, key, reason, hint)


def _pairs_as_named(system: System, number: int, force: _PairTable) -> tuple[Ints, Ints]:
    """Body after body of `body` and `to`, or one with each of the others.

    Raises
    ------
    CaseError
        If a body is its own other end, or a pair is there twice.
    """
    key = f"force[{number}].to"
    named = (system.names.find_in_order(names) for names in (force.body, force.to or ()))
    first, second = np.broadcast_arrays(*named)
    itself = np.flatnonzero(first == second)
    if itself.size:
        reason = f"ties {system.names[int(first[itself[0]])]} to itself{and_more(itself.size - 1)}"
        hint = "name another body in its place, or give `reach`"
        raise CaseError([problem_at(system, key, reason, hint)])
    a, b = first, second
    if force.at == force.to_at:  # then neither end is the first
        a, b = np.minimum(first, second), np.maximum(first, second)
    order = np.lexsort((b, a))
    is_repeated = (np.diff(a[order]) == 0) & (np.diff(b[order]) == 0)
    again = order[1:][is_repeated]
    if again.size:
        name_a, name_b = system.names[int(first[again[0]])], system.names[int(second[again[0]])]
        reason = f"ties {name_a} to {name_b} twice{and_more(again.size - 1)}"
        raise CaseError([problem_at(system, key, reason, "name every pair once")])
    return first.copy(), second.copy()


def and_more(count: int) -> str:
    """How many others there are of a kind of which one has been named."""
    return f", and {count} more" if count else ""


def _pairs_in_reach(system: System, number: int, force: _PairTable) -> tuple[Ints, Ints]:
    """Every pair of different bodies whose points are near each other at t = 0, sorted.

    Where both points are the same one of the body frame, a pair is taken once.

    Raises
    ------
    CaseError
        If there is none, or there are more than MOST_SPRINGS.
    """
    reach = force.reach or 0.0
    first = system.names.find(force.body)
    second = system.names.find(force.to or force.body)
    key = f"force[{number}].reach"
    if first.size == second.size == 1 and first[0] == second[0]:
        reason = f"there is no other body than {system.names[int(first[0])]} to tie it to"
        raise CaseError([problem_at(system, key, reason, "name more in `body`, or in `to`")])
    here, there = places(system, first, force.at), places(system, second, force.to_at)
    is_first, is_second = is_among(first, system), is_among(second, system)
    pairs, count = [], 0
    for i, j, _ in near(here, there, reach * (1.0 + _REACH_ROUNDING)):
        a, b = first[i], second[j]
        is_wanted = a != b
        if force.at == force.to_at:
            is_wanted &= (a < b) | ~(is_second[a] & is_first[b])
        pairs.append(np.stack([a[is_wanted], b[is_wanted]]))
        count += int(is_wanted.sum())
        if count > MOST_SPRINGS:
            reason = f"ties more than {MOST_SPRINGS:.0e} pairs"
            raise CaseError([problem_at(system, key, reason, "give a shorter reach")])
    if not count:
        closest = nearest_distance(first, second, here, there, reach)
        reason = f"no two points are that near: the nearest are {closest:.6g} m apart"
        raise CaseError([problem_at(system, key, reason, "give a longer reach")])
    a, b = np.concatenate(pairs, axis=1)
    order = np.lexsort((b, a))
    return a[order], b[order]


def is_among(bodies: Ints, system: System) -> Bools:
    """Whether each body of the system is one of these, (n_bodies,)."""
    mask = np.zeros(len(system.kind), dtype=np.bool_)
    mask[bodies] = True
    return mask


def _misplaced_ends(system: System, link: Link) -> list[Problem]:
    """What is wrong with ends that would turn a point, or a rod about its own axis."""
    problems = []
    both = ("at", link.body_a, link.force.at), ("to_at", link.body_b, link.force.to_at)
    for key, ends, at in both:
        if not any(at):  # as at an anchor
            continue
        index = np.unique(ends)
        index = index[np.isin(system.bodies.rotor_class[index], (POINT, ROD))]
        arm = rotate_back(system.bodies.rotor_frame[:, index], np.array(at)[:, None])
        is_point = system.bodies.rotor_class[index] == POINT
        across = np.where(is_point, lengths(arm), np.hypot(arm[0], arm[1]))
        wrong = index[across > AXIAL_ROUNDING * lengths(arm)]
        if not wrong.size:
            continue
        b = int(wrong[0])
        _, hint = by_its_arm(link.force, bool(system.bodies.rotor_class[b] == POINT))
        problems.append(turned_problem(system, "spring", f"force[{link.number}].{key}", b, hint))
    return problems


# Attraction


def attracted(system: System) -> Ints:
    """Bodies of [attraction], ascending; none without it."""
    if system.attraction is None:
        return np.zeros(0, dtype=np.int64)
    if system.attraction.body is None:
        bodies = np.arange(len(system.kind))
        return bodies if system.merging is None else np.setdiff1d(bodies, system.merging.guests)
    return system.names.find(system.attraction.body)


def tree_accuracy(system: System) -> float:
    """Error of accelerations that a tree may make, rms, relative."""
    if system.attraction is not None and system.attraction.accuracy is not None:
        return system.attraction.accuracy
    return _TREE_ACCURACY if system.run.accuracy is None else _SHARE_OF_RUN * system.run.accuracy


def coincident(system: System) -> list[Problem]:
    """What is wrong with particles of two bodies at one place, where attraction has no bound."""
    bodies = attracted(system)
    if system.attraction is None or system.attraction.softening > 0.0 or not bodies.size:
        return []
    index, of_body = particles_of(system, bodies)
    heavy = system.particles.mass[index] > 0.0
    index, owner = index[heavy], bodies[of_body[heavy]]
    place = places(system, owner, system.particles.position[index].T)
    place = np.vstack([system.world[owner], place])
    order = np.lexsort((owner, *place))
    place, owner = place[:, order], owner[order]
    is_same = (place[:, 1:] == place[:, :-1]).all(axis=0) & (owner[1:] != owner[:-1])
    repeated = np.flatnonzero(is_same)
    if not repeated.size:
        return []
    k = int(repeated[0])
    name, other = system.names[int(owner[k])], system.names[int(owner[k + 1])]
    where = ", ".join(f"{x:.6g}" for x in place[1:, k])
    reason = (
        f"{name} and {other} each have a particle at [{where}] m at t = 0, where their attraction"
        f" has no bound{and_more(repeated.size - 1)}"
    )
    return [problem_at(system, "attraction", reason, "give `softening`, or move one of the two")]


def particles_of(system: System, bodies: Ints) -> tuple[Ints, Ints]:
    """Particles of these bodies, body after body.

    Returns
    -------
    index, owner : ndarray, shape (n_particles,)
        Which of `system.particles` it is, and to which of these bodies it belongs.
    """
    return rows_of_kinds(system.particles.offset, system.kind[bodies])


# Who belongs together


def components(
    n_bodies: int, links: Sequence[Any], attracted: Ints, touching: Ints = _NO_BODIES
) -> Ints:
    """Label of each body, (n_bodies,): the first body of all those that forces between tie to it.

    Parameters
    ----------
    n_bodies : int
        Of the system.
    links : sequence of records with `body_a` and `body_b`
        Ends in the world tie nothing.
    attracted : ndarray, shape (k,)
        Bodies that attract each other.
    """
    first = np.concatenate([*(link.body_a for link in links), attracted[1:], touching[1:]])
    second = np.concatenate([*(link.body_b for link in links), attracted[:-1], touching[:-1]])
    inside = second != WORLD
    return labels(n_bodies, first[inside], second[inside])
