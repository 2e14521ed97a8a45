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
from particlerb.case.schema import Case, Impulse, Push, Torque
from particlerb.maths.vec3 import Floats, Ints
from particlerb.rotors.rotor_class import NAMES, POINT, ROD
from particlerb.terms import Terms
from particlerb.terms.follower import Follower
from particlerb.terms.gravity import UniformGravity
from particlerb.terms.impulse import Impulse as Jump
from particlerb.terms.push import Push as WorldPush
from particlerb.terms.torque import Torque as WorldTorque

LARGEST_TORQUE: Final = float(np.finfo(np.float64).max)
AXIAL_ROUNDING: Final = 1e-12  # share of a torque about a rod's axis that is its rounding


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


def loads_of(case: Case) -> list[Load]:
    """All forces and impulses of a case."""
    return [Load(i, f, resolve_bodies(case, f.body)) for i, f in enumerate(case.force)]


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


def sizes(vectors: Floats) -> Floats:
    """|v| of each column."""
    return np.asarray(np.linalg.norm(vectors, axis=0))


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
