"""Which bodies advance together.

Bodies on which the same forms of forces act share a group. Bodies that act on each other, also
through others, are a cluster and share one too, with copies of it; asymmetric bodies come first.
"""

import itertools
from collections import defaultdict
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeVar

import numpy as np

from particlerb.forces.links import WORLD
from particlerb.forces.registry import force_of
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Bools, Ints
from particlerb.model.superblocks import superblock_of
from particlerb.model.system import System
from particlerb.plan.case_forces import N_NUMBERS, Forces, ResolvedForce
from particlerb.plan.contact_setup import SystemContact
from particlerb.plan.joint_ends import Ties
from particlerb.plan.joints import SystemJoints
from particlerb.plan.known_courses import Behind
from particlerb.plan.links import AnyLink, attracted, components
from particlerb.rotors.rotor_class import ASYMMETRIC

_Part = TypeVar("_Part")
_OF_EACH: Final = {  # keys of joints that may differ among mechanisms that are alike
    "name", "body", "to", "at", "at_to", "axis", "axis_to", "spring", "damper", "limit", "motor",
    "friction",
}  # fmt: skip


class GroupForces(NamedTuple):
    """Bodies that share a group, and all that ever acts on them."""

    members: Ints  # (n,) bodies of the system
    is_held: Bools  # (n,) whether nothing can push them
    forces: list[Forces]  # on each of them
    links: list[AnyLink]  # among them, with numbers of the system
    attracts: bool  # whether they attract each other
    touches: bool  # whether they touch
    joints: SystemJoints | None = None  # of the system, if any are among them
    behind: Behind | None = None  # what was planned before, and is over


def groups_of(
    system: System,
    loads: Sequence[ResolvedForce],
    links: Sequence[AnyLink],
    touching: SystemContact | None,
    joints: SystemJoints | None,
    apart: Ints,
) -> list[GroupForces]:
    """Groups of a system, in the order of their first bodies; those of unlike `apart` in others."""
    heavy = attracted(system)
    solid = np.zeros(0, dtype=np.int64) if touching is None else touching.body
    acting = None if joints is None else joints.acting
    ties: list[AnyLink | Ties] = [*links, *([] if acting is None else [acting])]
    ends = [end[end != WORLD] for tie in ties for end in (tie.body_a, tie.body_b)]
    bound = np.unique(np.concatenate([heavy, solid, *ends]))
    absent = bound if system.merging is None else np.union1d(bound, system.merging.guests)
    is_held = system.is_held
    alone = _groups_alone(system, loads, absent, apart)
    groups = [GroupForces(one, is_held[one], forces, [], False, False) for one, forces in alone]
    together = solid if joints is None else joints.solved_with(solid)
    label = components(len(system.kind), ties, heavy, together)
    found = clusters(system, loads, links, label, bound, apart, acting)
    number = np.full(len(system.kind), -1)  # of the group of each body
    for k, members in enumerate(found):
        number[members] = k
    links_of = _by_group([(link, number[link.body_a]) for link in links])
    loads_on = _by_group([(load, number[load.members]) for load in loads])
    for k, members in enumerate(found):
        inside = [within(link, number[link.body_a] == k) for link in links_of[k]]
        attracts = bool(heavy.size) and bool(number[heavy[0]] == k)
        tied = joints if acting is not None and (number[acting.body_a] == k).any() else None
        touches = bool(together.size) and bool(number[together[0]] == k)
        forces = _aligned(loads_on[k], members)
        own = members, is_held[members], forces
        groups.append(GroupForces(*own, inside, attracts, touches, tied))
    return sorted(groups, key=lambda group: int(group.members.min()))


def _by_group(parts: Sequence[tuple[_Part, Ints]]) -> defaultdict[int, list[_Part]]:
    """What acts in each group, in order, from the groups of the bodies that each part acts on."""
    in_group: defaultdict[int, list[_Part]] = defaultdict(list)
    for part, numbers in parts:
        for k in np.unique(numbers).tolist():
            in_group[k].append(part)
    return in_group


def part_of(group: GroupForces, index: Ints) -> GroupForces:
    """Some bodies of a group that do not act on each other."""
    forces = [Forces(form, numbers[:, index]) for form, numbers in group.forces]
    members, is_held = group.members[index], group.is_held[index]
    return group._replace(members=members, is_held=is_held, forces=forces)


def _groups_alone(
    system: System, loads: Sequence[ResolvedForce], bound: Ints, apart: Ints
) -> list[tuple[Ints, list[Forces]]]:
    """Bodies that no other body acts on, with forces of the same forms, and these forces."""
    alone = np.ones(len(system.kind), dtype=bool)
    alone[bound] = False
    like = apart.copy()  # number of the sequence of forms on each body
    number = itertools.count(len(like))
    sequences: defaultdict[tuple[object, ...], int] = defaultdict(number.__next__)
    widths = np.array([load.numbers.shape[1] for load in loads], dtype=np.int64)
    starts = np.cumsum([0, *widths])
    numbers = np.zeros((starts[-1], max([N_NUMBERS, *(len(load.numbers) for load in loads)])))
    for k, load in enumerate(loads):
        numbers[starts[k] : starts[k + 1], : len(load.numbers)] = load.numbers.T
        form, before = load.form, like[load.members]
        for previous in np.unique(before).tolist():
            like[load.members[before == previous]] = sequences[previous, form]
    none = np.zeros(0, dtype=np.int64)
    bodies = np.concatenate([none, *(load.members for load in loads)])
    order = np.argsort(bodies, kind="stable")
    sizes = np.array([load.members.size for load in loads], dtype=np.int64)
    acting = np.repeat(np.arange(len(loads)), sizes)
    place = np.arange(acting.size) - (np.cumsum(sizes) - sizes)[acting]
    row = starts[acting] + place * (widths[acting] > 1)
    acting, row = acting[order], row[order]
    bodies, free = bodies[order], np.flatnonzero(alone)
    free = free[np.argsort(like[free], kind="stable")]
    groups = []
    for members in np.split(free, np.flatnonzero(np.diff(like[free])) + 1) if free.size else []:
        first = np.searchsorted(bodies, members)
        length = np.searchsorted(bodies, members[0], side="right") - first[0]
        at = first + np.arange(length)[:, None]
        forces = [Forces(loads[acting[k[0]]].force, numbers[row[k]].T) for k in at]
        groups.append((members, forces))
    return groups


def clusters(
    system: System,
    loads: Sequence[ResolvedForce],
    links: Sequence[AnyLink],
    label: Ints,
    bound: Ints,
    apart: Ints,
    joints: Ties | None = None,
) -> list[Ints]:
    """Bodies of each group of clusters that are copies of each other; asymmetric ones first.

    Where the step is given, mechanisms of tables that are alike are copies too. Those that lie in
    different superblocks are in different groups: ranks may share them.
    """
    if not bound.size:
        return []
    order = bound[np.argsort(label[bound], kind="stable")]
    starts = np.flatnonzero(np.diff(label[order], prepend=-1))
    signs: dict[int, list[object]] = {}
    moves = np.array([body.motion is not None for body in system.body])[system.block]
    kind = np.stack([system.kind, moves, system.is_held])
    for cluster in np.split(order, starts[1:]):
        first, last = int(cluster[0]), int(cluster[-1])
        block = superblock_of(first, last) if system.n_worlds == 1 else 0
        like = int(apart[first]), block, *kind[:, cluster % system.in_each].ravel().tolist()
        signs[int(label[first])] = [like]
    for link in links:
        labels, count = np.unique(label[link.body_a], return_counts=True)
        for key, springs in zip(labels.tolist(), count.tolist(), strict=True):
            signs[key].append((link.number, springs))
    if joints is not None:
        kinds = [_kind_of_joint(system, k) for k in range(len(system.joint))]
        for key, number in zip(label[joints.body_a].tolist(), joints.record.tolist(), strict=True):
            signs[key].append(("joint", kinds[number]))
    for load in loads:
        labels = np.unique(label[load.members[np.isin(load.members, bound)]])
        for key in labels.tolist():
            signs[key].append(load.form)
    alike: defaultdict[tuple[object, ...], list[Ints]] = defaultdict(list)
    for cluster in np.split(order, starts[1:]):
        alike[tuple(signs[int(label[cluster[0]])])].append(cluster)
    groups = [np.sort(np.concatenate(parts)) for parts in alike.values()]
    is_asymmetric = system.bodies.rotor_class == ASYMMETRIC
    return [members[np.argsort(~is_asymmetric[members], kind="stable")] for members in groups]


def _kind_of_joint(system: System, number: int) -> object:
    """What joints of a table have in common with those of others whose bodies may share a group.

    Numbers of what acts along them may differ, and change in a simulation; what damps, or cuts the
    time at knots, acts on the steps of all.
    """
    table, run = system.joint[number], system.run
    is_adaptive = run.method in METHODS and METHODS[run.method].is_adaptive
    if run.dt is None or run.accuracy is not None or is_adaptive or table.drive is not None:
        return number
    stop, spring, motor = (getattr(table, key) for key in ("limit", "spring", "motor"))
    damps = table.damper > 0.0, stop is not None and stop.damping > 0.0, table.friction > 0.0
    acting = stop is None or stop.stiffness is None, spring is None, type(motor)
    return table.model_dump_json(exclude=_OF_EACH), damps, stop is None, acting


def within(link: AnyLink, is_inside: Bools) -> AnyLink:
    """Those pairs of a link."""
    pairs = np.flatnonzero(is_inside)
    values = {name: getattr(link, name)[..., pairs] for name in link._fields[2:]}
    return link._replace(**values)


def _aligned(loads: Sequence[ResolvedForce], members: Ints) -> list[Forces]:
    """Forces on the bodies of a cluster; those that act on some only are zero on the others."""
    place = {b: i for i, b in enumerate(members.tolist())}
    rooms_of: dict[tuple[object, ...], list[tuple[Forces, Bools]]] = {}
    for load in loads:
        inside = np.array([b in place for b in load.members.tolist()])
        if not inside.any():
            continue
        own = load.on(inside)
        columns = np.array([place[b] for b in own.members.tolist()])
        rooms = rooms_of.setdefault(load.form, [])
        free = next((one for one in rooms if not one[1][columns].any()), None)
        if free is None:
            zeros = np.zeros((max(N_NUMBERS, len(load.numbers)), members.size))
            free = Forces(load.force, zeros), np.zeros(members.size, dtype=bool)
            free[0].numbers[:3] = force_of(load.force).nowhere
            rooms.append(free)
        numbers, taken_ = free[0].numbers, free[1]
        numbers[: len(own.numbers), columns] = own.numbers
        taken_[columns] = True
    return [forces for rooms in rooms_of.values() for forces, _ in rooms]
