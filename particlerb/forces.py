"""The forces of a case, resolved on bodies: which act on whom, summed to terms, and which cannot.

Bodies with forces of the same forms share a group, however different the sizes, directions and
points of these forces are.
"""

from collections import defaultdict
from typing import Final, NamedTuple

import numpy as np

from particlerb.bodies.bodies import Bodies, taken
from particlerb.bodies.scene import Scene
from particlerb.bodies.state import turned_back
from particlerb.case.placement import resolve_bodies
from particlerb.case.problems import Problem
from particlerb.case.reader import problem_at
from particlerb.case.schema import AnyForce, Case, Central, Drag, Impulse, Push, Spring, Torque
from particlerb.maths.vec3 import Floats, Ints
from particlerb.rotors.rotor_class import NAMES, POINT, ROD
from particlerb.terms import Terms
from particlerb.terms.central import Central as Centre
from particlerb.terms.drag import Drag as WorldDrag
from particlerb.terms.follower import Follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.impulse import Impulse as Jump
from particlerb.terms.push import Push as WorldPush
from particlerb.terms.spring import Spring as WorldSpring
from particlerb.terms.torque import Torque as WorldTorque

N_NUMBERS: Final = 8
LARGEST_TORQUE: Final = float(np.finfo(np.float64).max)
AXIAL_ROUNDING: Final = 1e-12  # share of a torque about a rod's axis that is its rounding


class Load(NamedTuple):
    """One force or impulse of the case, resolved."""

    number: int  # index of [[force]]
    force: AnyForce
    members: Ints  # bodies on which it acts, ascending

    @property
    def at(self) -> tuple[float, float, float]:
        """Point where it acts [m], body frame."""
        force = self.force
        return force.at if isinstance(force, (Push, Impulse, Spring)) else (0.0, 0.0, 0.0)

    @property
    def vector(self) -> tuple[float, float, float]:
        """The force [N], torque [N m] or impulse [N s] of those that are constant."""
        force = self.force
        if isinstance(force, Push):
            return force.force
        if isinstance(force, Torque):
            return force.torque
        return force.impulse if isinstance(force, Impulse) else (0.0, 0.0, 0.0)

    @property
    def numbers(self) -> tuple[float, ...]:
        """What a kernel needs of it, N_NUMBERS at most; `acting_terms` knows the order."""
        force = self.force
        if isinstance(force, Drag):
            return (force.translation, force.rotation)
        if isinstance(force, Spring):
            return (*force.at, *force.anchor, force.stiffness, force.rest_length)
        if isinstance(force, Central):
            return (*force.centre, force.mu)
        return (*self.at, *self.vector)

    @property
    def form(self) -> tuple[object, ...]:
        """What it has in common with others of a group: all but its size, direction and point."""
        force = self.force
        when = force.time if isinstance(force, Impulse) else force.during
        return force.type, getattr(force, "frame", None), when, any(self.at)


class Forces(NamedTuple):
    """One force of the same form on each of n bodies."""

    form: AnyForce  # one of them
    numbers: Floats  # (N_NUMBERS, n)

    @property
    def at(self) -> Floats:
        """Points of those that act at one, (3, n) [m], body frame."""
        return self.numbers[:3]

    @property
    def vector(self) -> Floats:
        """Forces, torques or impulses that are constant, (3, n) [N, N m or N s]."""
        return self.numbers[3:6]


def loads_of(case: Case) -> list[Load]:
    """All forces and impulses of a case."""
    return [Load(i, f, resolve_bodies(case, f.body)) for i, f in enumerate(case.force)]


def groups_of_bodies(scene: Scene, loads: list[Load]) -> list[tuple[Ints, list[Forces]]]:
    """Bodies with forces of the same forms, and these forces; in the order of bodies."""
    acting: defaultdict[int, list[int]] = defaultdict(list)
    for k, load in enumerate(loads):
        for b in load.members.tolist():
            acting[b].append(k)
    forms = [load.form for load in loads]
    members: defaultdict[tuple[object, ...], list[int]] = defaultdict(list)
    for b in sorted(acting):
        members[tuple(forms[k] for k in acting[b])].append(b)
    numbers = np.zeros((len(loads), N_NUMBERS))
    for k, load in enumerate(loads):
        numbers[k, : len(load.numbers)] = load.numbers
    groups = []
    for bodies in members.values():
        own = np.array([acting[b] for b in bodies])
        forces = [Forces(loads[k[0]].force, numbers[k].T) for k in own.T]
        groups.append((np.array(bodies), forces))
    alone = np.ones(len(scene.kind), dtype=bool)
    alone[list(acting)] = False
    if alone.any():
        groups.append((np.flatnonzero(alone), []))
    return sorted(groups, key=lambda group: int(group[0][0]))


def acts(force: Forces, start: float) -> bool:
    """Whether a lasting force acts in the segment that begins at `start`."""
    form = force.form
    if isinstance(form, Impulse):
        return False
    return form.during is None or form.during[0] <= start < form.during[1]


def acting_terms(case: Case, bodies: Bodies, forces: list[Forces]) -> Terms:
    """Sum of the forces of a segment: one term of each kind, but springs and centres one by one."""
    n = bodies.mass.size
    force, lever = np.zeros((3, n)), np.zeros((3, 3, n))
    body_force, body_torque, torque = np.zeros((3, 3, n))
    drag = np.zeros((2, n))
    springs: list[WorldSpring] = []
    centres: list[Centre] = []
    for one in forces:
        form, numbers = one.form, one.numbers
        if isinstance(form, Drag):
            drag += numbers[:2]
        elif isinstance(form, Spring):
            arm = turned_back(bodies.rotor_frame, one.at)
            springs.append(WorldSpring(arm, numbers[3:6], numbers[6], numbers[7]))
        elif isinstance(form, Central):
            centres.append(Centre(numbers[:3], numbers[3], bodies.mass, bodies.inertia))
        elif isinstance(form, Push) and form.frame == "world":
            arm = turned_back(bodies.rotor_frame, one.at)
            force += one.vector
            lever += one.vector[:, None] * arm  # [j, l] = F_j r_l
        elif isinstance(form, Push):
            own = turned_back(bodies.rotor_frame, one.vector)
            body_force += own
            body_torque += np.cross(turned_back(bodies.rotor_frame, one.at), own, axis=0)
        elif isinstance(form, Torque) and form.frame == "world":
            torque += one.vector
        else:
            body_torque += turned_back(bodies.rotor_frame, one.vector)
    gravity = np.array(case.gravity.acceleration) if case.gravity else np.zeros(3)
    return Terms(
        UniformGravity(bodies.mass, gravity) if gravity.any() else None,
        WorldPush(force, lever.reshape(9, n)) if force.any() or lever.any() else None,
        Follower(body_force, body_torque) if body_force.any() or body_torque.any() else None,
        WorldTorque(torque) if torque.any() else None,
        WorldDrag(drag[0] * bodies.inv_mass, drag[1]) if drag.any() else None,
        tuple(springs) or None,
        tuple(centres) or None,
    )


def jump(force: Forces, bodies: Bodies) -> Jump:
    """An impulse as the term takes it."""
    follows = isinstance(force.form, Impulse) and force.form.frame == "body"
    J = turned_back(bodies.rotor_frame, force.vector) if follows else force.vector
    return Jump(turned_back(bodies.rotor_frame, force.at), np.ascontiguousarray(J), follows)


def sizes(vectors: Floats) -> Floats:
    """|v| of each column."""
    return np.asarray(np.linalg.norm(vectors, axis=0))


def too_large(case: Case, load: Load) -> list[Problem]:
    """What is wrong with a force whose torque exceeds the range of float64."""
    force = load.force
    if not isinstance(force, (Push, Impulse)):
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
    is_torque = isinstance(load.force, Torque)
    reason = (
        f"{name} is a {NAMES[code]} with moments {sorted(bodies.inertia[:, b].tolist())} kg m²"
        f" and {what}, but this {load.force.type} would"
    )
    if is_torque:
        hint = "leave it out" if code == POINT else "give a torque across the rod"
    else:
        hint = "act at the centre of mass" if code == POINT else "act at a point of the rod's axis"
    key = f"force[{load.number}].{'torque' if is_torque else 'at'}"
    return [problem_at(case, key, reason, hint)]


def bodies_at_centres(case: Case, scene: Scene, load: Load) -> list[Problem]:
    """What is wrong with a centre in which a body starts."""
    force = load.force
    if not isinstance(force, Central):
        return []
    away = scene.state.com[:, load.members] - np.array(force.centre)[:, None]
    there = np.flatnonzero(~away.any(axis=0))
    if not there.size:
        return []
    name = scene.names[int(load.members[there[0]])]
    reason = f"{name} starts exactly at this centre, where the force has no direction"
    return [problem_at(case, f"force[{load.number}].centre", reason, "move one of the two")]


def turning_part(load: Load, bodies: Bodies, q: Floats) -> tuple[Floats, Floats]:
    """Size of what turns these points and rods, and its part that they cannot follow, (n,) each.

    For a force at a point it is the lever arm and not the torque: an arm along a rod never turns
    it about its axis, any other arm does so but by chance. Points can follow nothing.
    """
    force = load.force
    is_torque = isinstance(force, Torque)
    given = np.array(load.vector if is_torque else load.at)[:, None]
    in_world = isinstance(force, Torque) and force.frame == "world"
    turn = turned_back(q if in_world else bodies.rotor_frame, np.tile(given, bodies.mass.size))
    axial = np.abs(turn[2]) if is_torque else np.hypot(turn[0], turn[1])
    size = sizes(turn)
    return size, np.where(bodies.rotor_class == POINT, size, axial)
