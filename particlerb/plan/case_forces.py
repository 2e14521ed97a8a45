"""The forces of a case, resolved on bodies: which act on whom, summed to terms, and which cannot.

Bodies with forces of the same forms share a group, however different the sizes, directions and
points of these forces are. What a type of force is, its file in `particlerb.forces` says.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.forces import AnyForce, LoadTable, read_load
from particlerb.case.problems import Problem, refuse
from particlerb.forces import Terms, summed
from particlerb.forces.gravity import UniformGravity
from particlerb.forces.impulse import Impulse
from particlerb.forces.kinds import ForceError, refuse_length
from particlerb.forces.python import with_code
from particlerb.forces.ramp import vectors_of
from particlerb.forces.registry import force_of
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.merging import Merging
from particlerb.model.names import BodyNames
from particlerb.model.state import lengths, rotate_back
from particlerb.model.system import System
from particlerb.plan.links import AXIAL_ROUNDING, force_problem, is_link, turned_problem
from particlerb.rotors.rotor_class import POINT, ROD

N_NUMBERS: Final = 12


class ResolvedForce(NamedTuple):
    """One force or impulse of the case, resolved."""

    number: int  # index of [[force]]
    force: AnyForce
    members: Ints  # bodies on which it acts, ascending
    numbers: Floats  # (k, 1), or for each of them (k, n); `forces.kinds.Force.resolve` made them

    @property
    def form(self) -> tuple[object, ...]:
        """What it has in common with others of a group: all but its size, direction and point."""
        force, knots = self.force, self.force.timed
        when: tuple[object, ...] = force.edges
        if knots is not None:  # as bytes, whose hash is found once
            when = np.array(knots.times).tobytes(), np.asarray(knots.values).tobytes()
        has_arm = force_of(force).has_arm and bool(self.numbers[:3].any())
        return force.type, getattr(force, "frame", None), when, has_arm, *force.likeness

    def on(self, index: Ints | Bools) -> "ResolvedForce":
        """The same on some of the members."""
        own = self.numbers if self.numbers.shape[1] == 1 else self.numbers[:, index]
        return self._replace(members=self.members[index], numbers=own)


class Forces(NamedTuple):
    """One force of the same form on each of n bodies."""

    form: AnyForce  # one of them
    numbers: Floats  # (N_NUMBERS, n)


def loads_of(system: System) -> list[ResolvedForce]:
    """All forces and impulses that act on one body each; `links` has the others.

    Raises
    ------
    CaseError
        If numbers do not fit the bodies: not as many charges as a body has particles.
    """
    loads: list[ResolvedForce] = []
    problems: list[Problem] = []
    unmerged = system if system.merging is None else system.merging.unmerged
    for number, table, members in _acting_forces(system):
        try:
            force = _of_members(with_code(with_knots(table, system), system), members, system)
            acting = force_of(force).resolve(force, members, unmerged)
        except ForceError as error:
            problems.append(force_problem(system, number, error, members))
            continue
        resolved = [part for one in acting for part in _by_arm(ResolvedForce(number, force, *one))]
        if system.merging is not None:
            resolved = [one for load in resolved for one in _on_hosts(load, system.merging)]
        loads += resolved
    refuse(problems)
    return loads


def _of_members(force: AnyForce, members: Ints, system: System) -> AnyForce:
    """A force with the entries of these bodies, if it has one for each that it names.

    Raises
    ------
    ForceError
        If it has more, or fewer.
    """
    if not force.entries:
        return force
    named = BodyNames(system.names.records).find_in_order(force.body)
    named = np.array([*dict.fromkeys(named.tolist())])
    for key, values in force.entries.items():
        refuse_length(key, values, named.size)
    order, own = np.argsort(named), members % system.in_each + system.names.part.start
    return force.of_bodies(order[np.searchsorted(named, own, sorter=order)])


def _by_arm(load: ResolvedForce) -> list[ResolvedForce]:
    """A force on those bodies that it turns about an arm, and on those that it does not."""
    has_arm: Bools = np.asarray(load.numbers[:3].any(axis=0))
    if not force_of(load.force).has_arm or has_arm.all() or not has_arm.any():
        return [load]
    return [load.on(has_arm), load.on(~has_arm)]


def _on_hosts(load: ResolvedForce, merging: Merging) -> list[ResolvedForce]:
    """The same force on the bodies that carry those on which it acts; none on what is held."""
    load = load.on(~merging.is_held[load.members])
    is_merged = merging.is_merged[load.members]
    carried = [load.on(~is_merged)] if not is_merged.all() else []
    in_body = getattr(load.force, "frame", "world") == "body"
    for k in np.flatnonzero(is_merged)[:, None]:
        body, values = load.on(k).members, load.on(k).numbers
        arm = merging.placed(body, values[:3]) if force_of(load.force).has_arm else values[:3]
        vectors = merging.turned(body, values[3:6]) if in_body else values[3:]
        numbers = np.concatenate([arm, vectors])
        carried.append(load._replace(members=merging.host[body], numbers=numbers))
    return carried


def _acting_forces(system: System) -> Iterator[tuple[int, AnyForce, Ints]]:
    """Forces on one body each, and on whom they act; what differs in each world by itself."""
    for number, table in enumerate(system.force):
        if is_link(table):
            continue
        members = system.names.find(table.body)
        if not members.size:  # all of them are on other ranks
            continue
        if number not in system.others and not table.entries:
            yield number, table, members
            continue
        by_world = members.reshape(system.n_worlds, -1)
        forces = system.others.get(number, [table] * system.n_worlds)
        for force, bodies in zip(forces, by_world, strict=True):
            yield number, force, bodies


def with_knots(force: AnyForce, system: System) -> AnyForce:
    """A force whose knots, if it has any, are read from their file.

    Raises
    ------
    ForceError
        If the file has none, or all come after the end.
    """
    if not isinstance(force, LoadTable) or force.timed is None:
        return force
    key, load = force.load_key, force.timed
    if load.table is not None:
        try:
            force = force.model_copy(update={key: read_load(system.files.read(load.table))})
        except ValueError as error:
            raise ForceError(f"{key}.table", str(error)) from None
    if force.edges[0] >= system.run.t_end:
        where = f"{key}.times" if load.table is None else f"{key}.table"
        reason = f"the first knot, {force.edges[0]!r} s, must be before run.t_end"
        raise ForceError(where, f"{reason} = {system.run.t_end!r}")
    return force


def impossible(system: System, loads: list[ResolvedForce]) -> list[Problem]:
    """What is wrong with forces where the bodies are, and with torques that they cannot follow."""
    checks = refused, _impossible_torques
    return [p for check in checks for load in loads for p in check(system, load)]


def refused(system: System, load: ResolvedForce) -> list[Problem]:
    """What is wrong with a force by its own check."""
    check = force_of(load.force).check
    if check is None:
        return []
    try:
        check(load.force, load.numbers, system.state.com[:, load.members])
    except ForceError as error:
        return [force_problem(system, load.number, error, load.members)]
    return []


def acting_terms(system: System, bodies: Bodies, forces: list[Forces], start: float) -> Terms:
    """Sum of the forces of a segment: one term of each kind, but springs and centres one by one."""
    loads = []
    for form, numbers in forces:
        term = force_of(form).term
        assert term is not None
        loads.append(term(form, numbers, bodies, start))
    gravity = system.acceleration
    return Terms(UniformGravity(bodies.mass, gravity) if gravity.any() else None, summed(loads))


def jumps_of(forces: list[Forces], bodies: Bodies) -> tuple[Impulse, ...]:
    """Impulses among forces of one instant."""
    loads = ((force_of(form).jump, form, numbers) for form, numbers in forces)
    return tuple(jump(form, numbers, bodies) for jump, form, numbers in loads if jump is not None)


def _impossible_torques(system: System, load: ResolvedForce) -> list[Problem]:
    """What is wrong with a force that turns a point, or a rod about its own axis."""
    kind, rotor_class = force_of(load.force), system.bodies.rotor_class[load.members]
    load = load.on((rotor_class == POINT) | (rotor_class == ROD))
    index = load.members
    if not index.size or not (kind.has_arm or kind.is_torque):
        return []
    bodies, state = taken(system.bodies, index), taken(system.state, index)
    size, axial = _turning_part(load, bodies, state.q)
    wrong = np.flatnonzero(axial > AXIAL_ROUNDING * np.maximum(size, 1e-300))
    if not wrong.size:
        return []
    b = int(index[wrong[0]])
    key, hint = kind.turning(load.force, bool(system.bodies.rotor_class[b] == POINT))
    where = f"force[{load.number}].{key}"
    return [turned_problem(system, load.force.type, where, b, hint)]


def _turning_part(load: ResolvedForce, bodies: Bodies, q: Floats) -> tuple[Floats, Floats]:
    """Size of what turns these points and rods, and its part that they cannot follow, (n,) each.

    For a force at a point it is the lever arm and not the torque: an arm along a rod never turns
    it about its axis, any other arm does so but by chance. Points can follow nothing.
    """
    is_torque, n = force_of(load.force).is_torque, bodies.mass.size
    vectors = vectors_of(load.force, load.numbers) if is_torque else load.numbers[:3]
    in_world = is_torque and getattr(load.force, "frame", "body") == "world"
    if load.numbers.shape[1] == 1:
        vectors = np.tile(vectors, n)
    k = vectors.shape[1] // n
    axes = np.repeat(q if in_world else bodies.rotor_frame, k, axis=1)
    turn = rotate_back(axes, vectors).reshape(3, n, k)
    axial = np.abs(turn[2]) if is_torque else np.hypot(turn[0], turn[1])
    size, axial = lengths(turn).max(axis=1), axial.max(axis=1)
    return size, np.where(bodies.rotor_class == POINT, size, axial)
