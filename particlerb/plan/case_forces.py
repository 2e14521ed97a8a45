"""The forces of a case, resolved on bodies: which act on whom, summed to terms, and which cannot.

Bodies with forces of the same forms share a group, however different the sizes, directions and
points of these forces are.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.case.placement import resolve_bodies
from particlerb.case.problems import CaseError, Problem
from particlerb.case.reader import problem_at
from particlerb.case.schema import (
    AnyForce,
    Case,
    CentralTable,
    DragTable,
    ImpulseTable,
    PushTable,
    SpringTable,
    TorqueTable,
    UniformField,
)
from particlerb.case.to_system import System
from particlerb.forces import Terms
from particlerb.forces.central import Central
from particlerb.forces.drag import Drag
from particlerb.forces.follower import Follower
from particlerb.forces.gravity import UniformGravity
from particlerb.forces.impulse import Impulse
from particlerb.forces.push import Push
from particlerb.forces.spring import Spring
from particlerb.forces.torque import Torque
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, taken
from particlerb.model.state import turned_back
from particlerb.plan.links import AXIAL_ROUNDING, is_link, places
from particlerb.rotors.rotor_class import NAMES, POINT, ROD

N_NUMBERS: Final = 8
LARGEST_TORQUE: Final = float(np.finfo(np.float64).max)
MOMENT_ROUNDING: Final = 1e-14  # share of a moment of charges that is its rounding


class ResolvedForce(NamedTuple):
    """One force or impulse of the case, resolved."""

    number: int  # index of [[force]]
    force: AnyForce
    members: Ints  # bodies on which it acts, ascending
    own: tuple[float, ...] = ()  # what the bodies add: a spring's length, the charge and its moment

    @property
    def at(self) -> tuple[float, float, float]:
        """Point where it acts [m], or moment of charges [C m], body frame."""
        force = self.force
        if isinstance(force, UniformField):
            return self.own[0], self.own[1], self.own[2]
        return (
            force.at
            if isinstance(force, (PushTable, ImpulseTable, SpringTable))
            else (0.0, 0.0, 0.0)
        )

    @property
    def vector(self) -> tuple[float, float, float]:
        """The force [N], torque [N m], impulse [N s] or field of those that are constant."""
        force = self.force
        if isinstance(force, UniformField):
            return force.field
        if isinstance(force, PushTable):
            return force.force
        if isinstance(force, TorqueTable):
            return force.torque
        return force.impulse if isinstance(force, ImpulseTable) else (0.0, 0.0, 0.0)

    @property
    def numbers(self) -> tuple[float, ...]:
        """What a kernel needs of it, N_NUMBERS at most; `acting_terms` knows the order."""
        force = self.force
        if isinstance(force, DragTable):
            return (force.translation, force.rotation)
        if isinstance(force, SpringTable):
            return (*force.at, *(force.anchor or ()), force.stiffness, *self.own)
        if isinstance(force, CentralTable):
            return (*force.centre, force.mu)
        return (*self.at, *self.vector, *self.own[3:])

    @property
    def form(self) -> tuple[object, ...]:
        """What it has in common with others of a group: all but its size, direction and point."""
        force = self.force
        when = force.time if isinstance(force, ImpulseTable) else force.during
        return force.type, getattr(force, "frame", None), when, any(self.at)


class Forces(NamedTuple):
    """One force of the same form on each of n bodies."""

    form: AnyForce  # one of them
    numbers: Floats  # (N_NUMBERS, n)

    @property
    def at(self) -> Floats:
        """Points of those that act at one [m], or moments of charges [C m], (3, n), body frame."""
        return self.numbers[:3]

    @property
    def vector(self) -> Floats:
        """Forces, torques, impulses or fields that are constant, (3, n) [N, N m, N s or V/m]."""
        return self.numbers[3:6]


def loads_of(case: Case, scene: System) -> list[ResolvedForce]:
    """All forces and impulses of a case that act on one body each; `pairs` has the others.

    Raises
    ------
    CaseError
        If a field has not as many charges as a body has particles.
    """
    loads: list[ResolvedForce] = []
    problems: list[Problem] = []
    for number, force in enumerate(case.force):
        if is_link(force):
            continue
        load = ResolvedForce(number, force, resolve_bodies(case, force.body))
        if isinstance(force, SpringTable):
            loads += with_lengths(scene, load, force)
        elif isinstance(force, UniformField):
            wrong = wrong_charges(case, scene, load, force)
            problems += wrong
            loads += [] if wrong else with_charges(scene, load, force)
        else:
            loads.append(load)
    if problems:
        raise CaseError(problems)
    return loads


def with_lengths(scene: System, load: ResolvedForce, force: SpringTable) -> list[ResolvedForce]:
    """A spring with its rest length; one for each body where it is that of t = 0."""
    if force.rest_length != "initial":
        return [load._replace(own=(force.rest_length,))]
    ways = places(scene, load.members, force.at) - np.array(force.anchor)[:, None]
    return [
        load._replace(members=load.members[k : k + 1], own=(length,))
        for k, length in enumerate(sizes(ways).tolist())
    ]


def wrong_charges(
    case: Case, scene: System, load: ResolvedForce, force: UniformField
) -> list[Problem]:
    """What is wrong with a list of charges that is no list of one per particle."""
    count = np.diff(scene.particles.offset)[scene.kind[load.members]]
    if not isinstance(force.charge, tuple) or (count == len(force.charge)).all():
        return []
    b = int(np.argmax(count != len(force.charge)))
    name = scene.names[int(load.members[b])]
    reason = f"{name} has {count[b]} particles, the list {len(force.charge)} charges"
    hint = "give one for each in its order (`particlerb mass` counts them), or one number"
    return [problem_at(case, f"force[{load.number}].charge", reason, hint)]


@np.errstate(over="ignore")  # `too_large` finds what is
def with_charges(scene: System, load: ResolvedForce, force: UniformField) -> list[ResolvedForce]:
    """A field with the total charge of its bodies and the moment of charges; one for each kind.

    The charges q_i at r_i and a dipole d turn the body like Σ q_i r_i + d, by whatever it is more
    than the rounding of this sum: charges in proportion to the masses have none.
    """
    if not isinstance(force.charge, tuple):
        moment = force.charge * np.array(force.at) + force.dipole
        return [load._replace(own=(*moment.tolist(), force.charge))]
    loads = []
    kinds = scene.kind[load.members]
    q = np.array(force.charge)
    for kind in np.unique(kinds).tolist():
        own = slice(scene.particles.offset[kind], scene.particles.offset[kind + 1])
        r = scene.particles.position[own]  # with the rounding of places in the axes of the shape
        size = np.abs(q) @ (sizes(r.T) + sizes(scene.properties.com[kind]))
        moment = q @ r
        if sizes(moment) <= MOMENT_ROUNDING * size:
            moment = np.zeros(3)
        moment = moment + force.dipole
        members = load.members[kinds == kind]
        loads.append(load._replace(members=members, own=(*moment.tolist(), float(q.sum()))))
    return loads


def acts(form: AnyForce, start: float) -> bool:
    """Whether a lasting force acts in the segment that begins at `start`."""
    if isinstance(form, ImpulseTable):
        return False
    return form.during is None or form.during[0] <= start < form.during[1]


def acting_terms(case: Case, bodies: Bodies, forces: list[Forces]) -> Terms:
    """Sum of the forces of a segment: one term of each kind, but springs and centres one by one."""
    n = bodies.mass.size
    force, lever = np.zeros((3, n)), np.zeros((3, 3, n))
    body_force, body_torque, torque = np.zeros((3, 3, n))
    drag = np.zeros((2, n))
    springs: list[Spring] = []
    centres: list[Central] = []
    for one in forces:
        form, numbers = one.form, one.numbers
        if isinstance(form, DragTable):
            drag += numbers[:2]
        elif isinstance(form, SpringTable):
            arm = turned_back(bodies.rotor_frame, one.at)
            springs.append(Spring(arm, numbers[3:6], numbers[6], numbers[7]))
        elif isinstance(form, CentralTable):
            centres.append(Central(numbers[:3], numbers[3], bodies.mass, bodies.inertia))
        elif isinstance(form, UniformField):
            moment = turned_back(bodies.rotor_frame, one.at)
            force += numbers[6] * one.vector
            lever += one.vector[:, None] * moment  # a moment m turns by m × E, as an arm r by r × F
        elif isinstance(form, PushTable) and form.frame == "world":
            arm = turned_back(bodies.rotor_frame, one.at)
            force += one.vector
            lever += one.vector[:, None] * arm  # [j, l] = F_j r_l
        elif isinstance(form, PushTable):
            own = turned_back(bodies.rotor_frame, one.vector)
            body_force += own
            body_torque += np.cross(turned_back(bodies.rotor_frame, one.at), own, axis=0)
        elif isinstance(form, TorqueTable) and form.frame == "world":
            torque += one.vector
        else:
            body_torque += turned_back(bodies.rotor_frame, one.vector)
    gravity = np.array(case.gravity.acceleration) if case.gravity else np.zeros(3)
    return Terms(
        UniformGravity(bodies.mass, gravity) if gravity.any() else None,
        Push(force, lever.reshape(9, n)) if force.any() or lever.any() else None,
        Follower(body_force, body_torque) if body_force.any() or body_torque.any() else None,
        Torque(torque) if torque.any() else None,
        Drag(drag[0] * bodies.inv_mass, drag[1]) if drag.any() else None,
        tuple(springs) or None,
        tuple(centres) or None,
    )


def jump(force: Forces, bodies: Bodies) -> Impulse:
    """An impulse as the term takes it."""
    follows = isinstance(force.form, ImpulseTable) and force.form.frame == "body"
    J = turned_back(bodies.rotor_frame, force.vector) if follows else force.vector
    return Impulse(turned_back(bodies.rotor_frame, force.at), np.ascontiguousarray(J), follows)


def sizes(vectors: Floats) -> Floats:
    """|v| of each column."""
    return np.asarray(np.linalg.norm(vectors, axis=0))


def too_large(case: Case, load: ResolvedForce) -> list[Problem]:
    """What is wrong with a force whose torque exceeds the range of float64."""
    force = load.force
    if not isinstance(force, (PushTable, ImpulseTable, UniformField)):
        return []
    arm, size = max(map(abs, load.at)), max(map(abs, load.vector))
    is_field = isinstance(force, UniformField)
    charge = abs(load.own[3]) if is_field else 0.0
    if 2.0 * max(arm, charge) * size < LARGEST_TORQUE:
        return []
    what = f"charge {charge!r} with moment {arm!r}" if is_field else f"arm {arm!r} m"
    load_shown = "load" if is_field else "torque"
    reason = f"{what} and {force.type} {size!r} give a {load_shown} beyond the range of float64"
    return [problem_at(case, f"force[{load.number}].{'field' if is_field else 'at'}", reason)]


def impossible_torques(case: Case, scene: System, load: ResolvedForce) -> list[Problem]:
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
    reason = (
        f"{name} is a {NAMES[code]} with moments {sorted(bodies.inertia[:, b].tolist())} kg m²"
        f" and {what}, but this {load.force.type} would"
    )
    key, hint = what_turns(load.force, code)
    return [problem_at(case, f"force[{load.number}].{key}", reason, hint)]


def what_turns(force: AnyForce, code: int) -> tuple[str, str]:
    """Key of a force by which it turns a point or a rod, and what it should say instead."""
    if isinstance(force, TorqueTable):
        return "torque", "leave it out" if code == POINT else "give a torque across the rod"
    if isinstance(force, UniformField) and any(force.dipole):
        return "dipole", "leave it out" if code == POINT else "give a dipole along the rod's axis"
    if isinstance(force, UniformField) and isinstance(force.charge, tuple):
        return "charge", "give one number, the charge of the body"
    where = "the centre of mass" if code == POINT else "a point of the rod's axis"
    return "at", f"act at {where}"


def bodies_at_centres(case: Case, scene: System, load: ResolvedForce) -> list[Problem]:
    """What is wrong with a centre in which a body starts."""
    force = load.force
    if not isinstance(force, CentralTable):
        return []
    away = scene.state.com[:, load.members] - np.array(force.centre)[:, None]
    there = np.flatnonzero(~away.any(axis=0))
    if not there.size:
        return []
    name = scene.names[int(load.members[there[0]])]
    reason = f"{name} starts exactly at this centre, where the force has no direction"
    return [problem_at(case, f"force[{load.number}].centre", reason, "move one of the two")]


def turning_part(load: ResolvedForce, bodies: Bodies, q: Floats) -> tuple[Floats, Floats]:
    """Size of what turns these points and rods, and its part that they cannot follow, (n,) each.

    For a force at a point it is the lever arm and not the torque: an arm along a rod never turns
    it about its axis, any other arm does so but by chance. Points can follow nothing.
    """
    force = load.force
    is_torque = isinstance(force, TorqueTable)
    given = np.array(load.vector if is_torque else load.at)[:, None]
    in_world = isinstance(force, TorqueTable) and force.frame == "world"
    turn = turned_back(q if in_world else bodies.rotor_frame, np.tile(given, bodies.mass.size))
    axial = np.abs(turn[2]) if is_torque else np.hypot(turn[0], turn[1])
    size = sizes(turn)
    return size, np.where(bodies.rotor_class == POINT, size, axial)
