"""Joints of a system, resolved: which bodies, where, which rows; and whether they fit.

`joints_of` makes the rows of every [[joint]] from the poses at the start, `assembled` the system
with its bodies where all joints fit.
"""

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.joints import ACTIONS, JointTable
from particlerb.case.output import FIELDS_OF_JOINTS
from particlerb.case.problems import CaseError, Problem, problem_at, refuse
from particlerb.contact.prescribed_motion import PrescribedBodies, prescribed_among
from particlerb.forces.links import WORLD, Links
from particlerb.integrators.joint_stages import set_prescribed
from particlerb.joints import records as col
from particlerb.joints.coordinates import names_of, united
from particlerb.joints.drives import set_moving
from particlerb.joints.records import (
    Actions,
    Bounds,
    Breaks,
    ConstraintRows,
    Coordinates,
    JointData,
    Joints,
    joint_data_at,
)
from particlerb.joints.rows import linearise, rates, residuals
from particlerb.joints.setup import joints_among
from particlerb.joints.solver import constrained_drift, project_momenta
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, held
from particlerb.model.state import lengths, rotate_back, state_of
from particlerb.model.system import System
from particlerb.plan import joint_rows
from particlerb.plan.joint_drives import DriveCourse, courses_of, drives_from
from particlerb.plan.joint_ends import Ties, ends_of, pairs_of, unique, wrong_place
from particlerb.plan.obstacles import prescribed_bodies
from particlerb.rotors.rotor_class import NAMES, POINT, ROD

_MAX_START_MISFIT: Final = 1e-6  # of its size that a joint may not fit at the start
_MAX_ASSEMBLED_MISFIT: Final = 1e-9  # of its size, once assembled
_AXIAL_ROUNDING: Final = 1e-12


class SystemJoints(NamedTuple):
    """All joints of a system."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    record: Ints  # (j,) index of [[joint]]
    body_a: Ints  # (j,) bodies of the system
    body_b: Ints  # (j,) bodies, or WORLD
    start: Ints  # (j + 1,) first row of each
    rows: ConstraintRows  # with bodies of the system
    places: Floats  # (j, 4, 3) points of both, n in the first, m (or n) in the second; rotor frames
    coordinates: Coordinates  # with bodies of the system
    counts_turns: bool  # whether somebody asks for coordinates
    actions: Actions
    until: Floats  # (j,) [s] when each is released; -inf: its bodies are merged
    courses: tuple[DriveCourse, ...]  # what is prescribed
    breaks: Breaks  # (j,)
    prescribed: PrescribedBodies | None  # bodies of the system that move as prescribed
    bounds: Bounds  # what acts within bounds, of actions

    def within(
        self, members: Ints, bodies: Bodies, links: Links | None = None, time: float = 0.0
    ) -> Joints | None:
        """Joints that act at a time in a group, and its dashpots; None where there are none."""
        n = int(max(members.max(), self.body_a.max())) + 1
        place = np.full(n + 1, WORLD)
        place[members] = np.arange(members.size)
        acting = np.flatnonzero((place[self.body_a] != WORLD) & (self.until > time))
        if not acting.size:
            return None
        place[WORLD] = members.size
        count = np.diff(self.start)[acting]
        start = np.r_[0, np.cumsum(count)]
        index = np.repeat(self.start[acting] - start[:-1], count) + np.arange(start[-1])
        rows = ConstraintRows(*(values[index] for values in self.rows))
        rows = rows._replace(a=place[rows.a], b=place[rows.b])
        taken = np.isin(self.coordinates.joint, acting) & self.counts_turns
        coordinates = Coordinates._make(values[taken] for values in self.coordinates)
        coordinates = coordinates._replace(a=place[coordinates.a], b=place[coordinates.b])
        actions = self.actions
        if links is not None and links.damping is not None:
            rows, actions = joint_rows.with_dashpots(rows, actions, links, members.size)
            start = np.r_[start, start[-1] + 1 + np.arange(links.body_a.size)]
            acting = np.r_[acting, np.full(links.body_a.size, -1)]
        drives = drives_from(self.courses, time)
        prescribed = np.isin(members, [] if self.prescribed is None else self.prescribed.body)
        joints = joints_among(acting, start, rows, bodies, actions, coordinates, drives, prescribed)
        limits = Breaks(*(np.append(limit, np.inf)[joints.number] for limit in self.breaks))
        breaks = limits if np.isfinite(limits).any() else None
        bounds = joint_rows.bounds_among(self.bounds, joints.rows)
        return joints._replace(breaks=breaks, bounds=bounds)

    @property
    def acting(self) -> Ties:
        """Joints that ever act."""
        lasting = np.flatnonzero(self.until > 0.0)
        return Ties(self.record[lasting], self.body_a[lasting], self.body_b[lasting])

    def solved_with(self, solid: Ints) -> Ints:
        """Bodies that touch, and those with something within bounds, which are solved with them."""
        is_bounded = np.isin(self.rows.action, self.bounds.row)
        ends = np.r_[self.rows.a[is_bounded], self.rows.b[is_bounded]]
        return np.union1d(solid, ends[ends != WORLD]) if ends.size else solid

    def drives_among(self, members: Ints) -> list[DriveCourse]:
        """What is prescribed among the members of a group."""
        drives = np.unique(self.rows.drive[np.isin(self.rows.a, members)])
        return [self.courses[k] for k in drives[drives != col.AT_REST].tolist()]

    @property
    def coordinate_labels(self) -> list[tuple[str, str]]:
        """Name and unit of each coordinate."""
        pairs = zip(self.names, self.types, strict=True)
        return [(f"{name}, {word}", unit) for name, kind in pairs for word, unit in names_of(kind)]


def asked_of_joints(system: System) -> set[str]:
    """Names of what is to be recorded, or checked, of joints."""
    asked = {*system.output.fields, *(value.quantity for value in system.check.value)}
    return asked.intersection(FIELDS_OF_JOINTS)


def joints_of(system: System) -> SystemJoints | None:
    """All joints of a system, or of that of which it is a part; None where there are none.

    Raises
    ------
    CaseError
        With all that is wrong: a body tied to itself, a body without extent or a rod that would
        have to carry a torque that it cannot.
    """
    if not system.joint:
        return None
    system = system.whole or system
    merging = system.merging
    system = system if merging is None else merging.unmerged
    system = system._replace(state=system.placed or system.state)
    problems, parts, acting = list[Problem](), list[joint_rows.TableJoints](), list[JointTable]()
    driven = [k for k, table in enumerate(system.joint) if table.drive is not None]
    for number, table in enumerate(system.joint):
        first, second = pairs_of(system, table)
        if problem := _wrong_ends(system, number, first, second):
            problems.append(problem)
            continue
        ends = ends_of(system, table, first, second)
        if problem := wrong_place(system, number, ends):
            problems.append(problem)
            continue
        drive, action = driven.index(number) if number in driven else col.AT_REST, col.HOLDS
        if table.motor is not None or any(getattr(table, key) for key in ACTIONS):
            action = len(acting)
            acting.append(table)
        parts.append(joint_rows.joints_of_table(system, number, ends, merging, (action, drive)))
    refuse(problems)
    columns = list(zip(*parts, strict=True))
    record, first, second, places, n_rows, until = map(np.concatenate, columns[3:])
    setup = SystemJoints(
        unique(
            [name for part in parts for name in part.names],
            [system.joint[k].name is not None for k in record.tolist()],
        ),
        tuple(system.joint[k].type for k in record.tolist()),
        record,
        first,
        second,
        np.cumsum([0, *n_rows]),
        ConstraintRows(*map(np.concatenate, zip(*(part.rows for part in parts), strict=True))),
        places,
        united(columns[1], [len(part.names) for part in parts]),
        "joint_coordinate" in asked_of_joints(system),
        joint_rows.actions_of(acting),
        until,
        courses_of(system),
        joint_rows.breaks_of(system, record),
        prescribed_bodies(system),
        joint_rows.bounds_of(acting),
    )
    problems = _held_impulses(system, setup)
    if merging is None and system.continued is None:
        problems = _impossible(system, setup) + problems
    refuse(problems)
    return setup


def _held_impulses(system: System, setup: SystemJoints) -> list[Problem]:
    """What is wrong with impulses on bodies that joints hold."""
    tied, problems = np.concatenate([setup.body_a, setup.body_b]), []
    for k, force in enumerate(system.force):
        if force.type == "impulse" and np.isin(system.names.find(force.body), tied).any():
            reason = "an impulse on a body that a joint holds is not computed yet"
            hint = "use a push for a short time"
            problems.append(problem_at(system, f"force[{k}].body", reason, hint))
    return problems


def _wrong_ends(system: System, number: int, first: Ints, second: Ints) -> Problem | None:
    """What is wrong with a joint of a body and itself, or of bodies that do not move freely."""
    is_held, table = system.is_held, system.joint[number]
    moves = np.array([body.motion is not None for body in system.body])[system.block]
    for a, b in zip(first.tolist(), second.tolist(), strict=True):
        if a == b:
            reason = f"ties {system.names[a]} to itself"
            return problem_at(system, f"joint[{number}].to", reason, "name another body")
        if is_held[a] and (b == WORLD or is_held[b]):
            reason = f"{system.names[a]} is fixed or driven, and so is the other side"
            return problem_at(system, f"joint[{number}].body", reason, "name a body that is free")
        carrier = next((end for end in (a, b) if end != WORLD and moves[end]), None)
        if carrier is not None and system.contact is None and table.until < math.inf:
            reason = f"{system.names[carrier]} is driven, and would stand still once it is released"
            key = f"joint[{number}].during"
            return problem_at(system, key, reason, "add [contact], or keep it")
    return None


# Whether they fit


class _AtStart(NamedTuple):
    """All joints of a system, with the bodies where they are at the start."""

    joints: Joints
    data: JointData
    rows: list[slice]  # of each cluster


def _at_start(system: System, setup: SystemJoints) -> _AtStart:
    """Joints of all bodies of a system."""
    n = system.n_bodies
    joints = setup.within(np.arange(n), held(system.bodies, system.is_held))
    assert joints is not None
    data = joint_data_at(joints, system.state)
    prescribed = prescribed_among(setup.prescribed, joints.order)
    set_prescribed(prescribed, data, 0.0, 0.0, 0, n)
    edges = joints.program.start[joints.clusters.joint].tolist()
    return _AtStart(joints, data, [slice(*ends) for ends in pairwise(edges)])


def has_loops(system: System, setup: SystemJoints) -> bool:
    """Whether joints close a loop, so that rows may depend on others."""
    return bool((_at_start(system, setup).joints.clusters.smallest_pivot > 0.0).any())


def joint_of_row(joints: Joints, row: int) -> int:
    """Which joint of the system has a row of a group."""
    return int(joints.number[np.searchsorted(joints.program.start, row, side="right") - 1])


def _impossible(system: System, setup: SystemJoints) -> list[Problem]:
    """What is wrong with joints that would turn a point, or a rod about its axis."""
    n, (joints, data, _) = system.n_bodies, _at_start(system, setup)
    linearise(joints, data, 0, joints.rows.kind.size)
    rotor_class = np.append(system.bodies.rotor_class[joints.order], NAMES.index("sphere"))
    problems: dict[int, Problem] = {}
    for end, at in ((joints.rows.a, 3), (joints.rows.b, 6)):
        turning = data.gradient[:, at : at + 3].T
        arm = np.abs(rotate_back(np.ascontiguousarray(data.y[end, 3:7].T), turning))
        is_point, is_rod = rotor_class[end] == POINT, rotor_class[end] == ROD
        allowed = _AXIAL_ROUNDING * joints.rows.size
        wrong = (is_point & (arm.max(axis=0) > allowed)) | (is_rod & (arm[2] > allowed))
        for row in np.flatnonzero(wrong & (end < n)).tolist():
            joint = joint_of_row(joints, row)
            body = int(joints.order[end[row]])
            what = "has no extent" if is_point[row] else "has no inertia about its axis"
            kind = NAMES[int(rotor_class[end[row]])]
            reason = f"{setup.names[joint]} would turn {system.names[body]}, a {kind} that {what}"
            hint = "give it a width, as a box has, or use a ball joint or a distance on its axis"
            key = f"joint[{int(setup.record[joint])}]"
            problems.setdefault(joint, problem_at(system, key, reason, hint))
    return list(problems.values())


def assembled(system: System) -> System:
    """The system with its bodies, and their momenta, where all joints fit.

    Each cluster is moved the least way in the metric of its masses.

    Raises
    ------
    CaseError
        As `joints_of`; if a joint does not fit, and is not to be assembled; if no pose near the
        start meets all joints.
    """
    setup = joints_of(system)
    if setup is None:
        return system
    joints, data, rows = _at_start(system, setup)
    n, m = system.n_bodies, joints.rows.kind.size
    if m:
        residuals(joints, data, 0, m, 0.0)
        off = np.abs(data.g) / joints.rows.size
        _refuse_misfits(system, setup, joints, off, "{name} does not fit where its bodies start:")
    before, motion = data.y.copy(), data.motion.copy()
    data.motion[:] = 0.0  # else teeth would be passed meanwhile
    for c, cluster_rows in enumerate(rows):
        bodies = slice(joints.clusters.body[c], joints.clusters.body[c + 1])
        if cluster_rows.start < cluster_rows.stop and off[cluster_rows].any():
            data.y[bodies, 7:] = 0.0
            constrained_drift(joints, data, c, 0.0, -1.0, 1.0)
            data.y[bodies, 7:] = before[bodies, 7:]
            _refuse_apart(system, setup, joints, data, cluster_rows)
    data.motion[:] = motion
    _refuse_fast(system, setup, joints, data)
    for c in range(len(rows)):
        project_momenta(joints, data, c, 0.0, 0.0, 0.0)
    moved = float(lengths((data.y - before)[:n, :3].T).max())
    state = np.empty((13, n))
    state[:, joints.order] = data.y[:n].T
    _refuse_loose(system, setup, joints, data)
    fitted = system._replace(state=state_of(state), placed=system.state)
    if moved <= _MAX_START_MISFIT * float(joints.rows.size.max()):
        return fitted
    line = f"bodies moved by up to {moved:.3g} m at the start, until all joints fit"
    return fitted._replace(notes=(*system.notes, ("joints", line)))


def _refuse_misfits(
    system: System, setup: SystemJoints, joints: Joints, off: Floats, what: str
) -> None:
    """Raise CaseError for joints that are off by more than is allowed, unless they may be moved."""
    problems: dict[int, Problem] = {}
    for row in np.argsort(-off).tolist():
        joint = joint_of_row(joints, row)
        number = int(setup.record[joint])
        if off[row] <= _MAX_START_MISFIT or system.joint[number].assemble or number in problems:
            continue
        reason = f"{what.format(name=setup.names[joint])} off by {off[row]:.3g} of its size"
        hint = "correct it, or give assemble = true, which moves bodies until it fits"
        if system.joint[number].drive is not None:
            hint += "; bodies begin with the speed of a drive"
        problems[number] = problem_at(system, f"joint[{number}]", reason, hint)
    refuse(problems.values())


def _refuse_loose(system: System, setup: SystemJoints, joints: Joints, data: JointData) -> None:
    """Raise CaseError where the axes of what rolls are not held."""
    hint = "hold both bodies by hinges, parallel and at their distance"
    for row, words in joint_rows.loose_wheels(joints, data).items():
        joint = joint_of_row(joints, row)
        reason = f"{setup.names[joint]} does not roll: its axes {words}"
        raise CaseError([problem_at(system, f"joint[{setup.record[joint]}]", reason, hint)])


def _refuse_apart(
    system: System, setup: SystemJoints, joints: Joints, data: JointData, rows: slice
) -> None:
    """Raise CaseError where the joints of a cluster have not come together."""
    residuals(joints, data, rows.start, rows.stop, 0.0)
    off = np.abs(data.g[rows]) / joints.rows.size[rows]
    if (off <= _MAX_ASSEMBLED_MISFIT).all():  # of NaN it is not
        return
    joint = joint_of_row(joints, rows.start + int(np.argmax(np.nan_to_num(off, nan=np.inf))))
    reason = f"no pose near the start meets {setup.names[joint]} and the joints about it"
    hint = "place the bodies nearer to where they belong, or remove a contradicting joint"
    raise CaseError([problem_at(system, f"joint[{int(setup.record[joint])}]", reason, hint)])


def _refuse_fast(system: System, setup: SystemJoints, joints: Joints, data: JointData) -> None:
    """Raise CaseError where velocities at the start break a joint that may not be assembled."""
    m = joints.rows.kind.size
    linearise(joints, data, 0, m)
    set_moving(joints, data, 0, m, 0.0)
    rates(joints, data, 0, m)
    speed = np.zeros(m)
    for end in (joints.rows.a, joints.rows.b):
        y, q = data.y[end].T, np.ascontiguousarray(data.y[end, 3:7].T)
        spin = joints.inv_inertia[end].T * rotate_back(q, y[10:])
        speed += lengths(y[7:10]) * joints.inv_mass[end] + lengths(spin) * joints.rows.size
    off = np.abs(data.z) / np.where(speed > 0.0, speed, 1.0)
    _refuse_misfits(system, setup, joints, off, "{name} is broken by the velocities at the start:")
