"""What joints carry, how well they hold and where they are, in states of the bodies.

All but the turns of angles follows from a state and from the forces that act there: a run that
records it and `joint_loads` find it by the same code.
"""

import math
from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.problems import nearest, problem_at, refuse
from particlerb.contact.contact_output import ContactOutput
from particlerb.integrators import METHODS
from particlerb.integrators.joint_slopes import add_actions
from particlerb.integrators.joint_stages import set_prescribed
from particlerb.integrators.stages import gather_loads
from particlerb.joints.coordinates import values_of
from particlerb.joints.reactions import (
    factorise_all,
    find_multipliers,
    forces_of_joints,
    make_least,
)
from particlerb.joints.records import JointData, joint_data_at
from particlerb.joints.rows import add_impulses, rates, residuals
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.block import COM
from particlerb.model.state import Frames, State, state_in
from particlerb.model.superblocks import Range
from particlerb.model.system import System
from particlerb.plan.joints import SystemJoints, asked_of_joints, joints_of
from particlerb.plan.make_plan import make_plan
from particlerb.plan.merging import unmerged
from particlerb.plan.segments import GroupPlan, Segment, inside
from particlerb.ranks import Ranks
from particlerb.stepping.stepped_bodies import SteppedBodies
from particlerb.words import count_of


class JointValues(NamedTuple):
    """Joints j with coordinates c at T instants, named as the fields of a file."""

    joint_force: Floats  # (T, j, 3) [N] on the first body, world axes
    joint_torque: Floats  # (T, j, 3) [N m] on it about the point of the joint, world axes
    joint_force_determined: Ints  # (T, j, 3) 0 where redundant rows leave the component open
    joint_torque_determined: Ints  # (T, j, 3)
    joint_misfit: Floats  # (T, j) largest |g|, of lengths over the size of the joint
    joint_rate: Floats  # (T, j) largest |dg/dt| [1/s], the same way
    joint_coordinate: Floats  # (T, c) [rad or m]
    joint_break_time: Floats  # (T, j) [s]; 0 while it holds


def room_for_values(setup: SystemJoints, n: int) -> JointValues:
    """Values of n instants, to be written; joints that do not act carry nothing."""
    j = len(setup.names)
    force, torque = np.zeros((2, n, j, 3))
    misfit, rate, break_time = np.zeros((3, n, j))
    known = np.ones((2, n, j, 3), dtype=np.int64)
    coordinates = np.zeros((n, setup.coordinates.a.size))
    return JointValues(force, torque, known[0], known[1], misfit, rate, coordinates, break_time)


def refuse_checks(system: System, parent: str = "check") -> None:
    """Raise CaseError where a check names no joint, or numbers that a joint has not."""
    is_asked = any(check.joint is not None for check in system.check.value)
    setup = joints_of(system) if is_asked else None
    problems = []
    for k, check in enumerate(system.check.value):
        if check.joint is None or setup is None:
            continue
        if check.joint not in setup.names:
            reason = f'there is no joint "{check.joint}"'
            hint = nearest(check.joint, setup.names)
            problems.append(problem_at(system, f"{parent}.value[{k}].joint", reason, hint))
        elif check.quantity == "joint_coordinate" and check.tolerance < math.inf:
            n = int(np.sum(setup.coordinates.joint == setup.names.index(check.joint)))
            if np.size(check.value) != n:
                reason = f"{check.joint} has {count_of(n, 'coordinate')}"
                problems.append(problem_at(system, f"check.value[{k}].value", reason, ""))
    refuse(problems)


def of_all_ranks(values: JointValues, setup: SystemJoints, ranks: Ranks) -> JointValues:
    """Values of the joints of all ranks, each of which moves some of them.

    What each differs by from those of joints that do not act is added, as integers of 64 bits.
    """
    if ranks.count == 1:
        return values
    idle = room_for_values(setup, len(values.joint_misfit))

    def added(array: Any, none: Any) -> Any:
        start = none.view(np.int64)
        return (ranks.added(array.view(np.int64) - start) + start).view(array.dtype)

    return JointValues._make(map(added, values, idle))


def labels_of(system: System) -> dict[str, list[tuple[str, str]]]:
    """Names and units of joints and coordinates, where they are to be recorded."""
    setup = joints_of(system) if asked_of_joints(system) else None
    if setup is None:
        return {}
    joints = [(name, "") for name in setup.names]
    return {"joint": joints, "coordinate": setup.coordinate_labels}


def broken_joints(
    setup: SystemJoints | None, values: JointValues | None
) -> tuple[tuple[str, float], ...]:
    """Names of joints that have broken by the last of some instants, and when [s]."""
    if setup is None or values is None:
        return ()
    times = values.joint_break_time[-1].tolist()
    broken = [(name, t) for name, t in zip(setup.names, times, strict=True) if t > 0.0]
    return tuple(sorted(broken, key=lambda one: one[1]))


def at_row(values: JointValues, row: int) -> JointValues:
    """Copy of the values of one instant."""
    return JointValues._make(array[row : row + 1].copy() for array in values)


def recorded_values(
    values: JointValues | None, fields: Collection[str], rows: Ints
) -> dict[str, Floats | Ints]:
    """Those of the fields, for some rows."""
    asked = () if values is None else [name for name in JointValues._fields if name in fields]
    return {name: getattr(values, name)[rows] for name in asked}


class LoadReader:
    """Finds what joints carry from frames alone, those inside of merged bodies included.

    It is found as if no bodies were merged: the constraints of all joints, in the same states.
    """

    def __init__(self, system: System) -> None:
        first = system.names.part.start
        plan = make_plan(unmerged(system.whole or system).with_run(method="auto", accuracy=None))
        self.groups = inside(plan.groups, Range(first, first + system.n_bodies), first)
        self.readers: dict[tuple[int, int], JointReader] = {}

    def read(self, times: Floats, frames: Frames, values: JointValues) -> None:
        """Write all rows but coordinates and times of breaking, which are there."""
        for k, time in enumerate(times.tolist()):
            self._read_row(time, frames, values, k)

    def _read_row(self, time: float, frames: Frames, values: JointValues, k: int) -> None:
        """Write one row."""
        broken = np.append(values.joint_break_time[k], 0.0)
        broken = np.where(broken > 0.0, broken, np.inf)
        for g, group in enumerate(self.groups):
            s = next(s for s, span in enumerate(group.segments) if span.start <= time < span.stop)
            if group.segments[s].terms.joints is None:
                continue
            state = state_in(frames, k, group.members, group.bodies)
            if (g, s) not in self.readers:
                self.readers[g, s] = JointReader(group, group.segments[s], state)
            reader = self.readers[g, s]
            reader.read(time, state, None, None, broken[reader.joints.number], values, k)


class JointReader:
    """Finds the values of the joints of a group while a segment lasts."""

    def __init__(self, group: GroupPlan, segment: Segment, first: State) -> None:
        assert segment.terms.joints is not None
        self.segment, self.joints = segment, segment.terms.joints
        rows = np.argsort(self.joints.order)
        self.row_of = dict(zip(group.members.tolist(), rows.tolist(), strict=True))
        moving = group.group(segment)
        method = METHODS[segment.method]
        self.bodies = SteppedBodies(method, moving, first, segment.start, segment.dt, None)

    def read(
        self,
        time: float,
        state: State,
        contacts: ContactOutput | None,
        turned: Floats | None,
        broken: Floats,
        values: JointValues,
        row: int,
    ) -> None:
        """Write a row of the values.

        Parameters
        ----------
        time : float [s]
        state : State
            Of the group.
        contacts : ContactOutput, optional
            Of the frame; None: not known, and joints of a group with contact carry NaN.
        turned : ndarray, shape (c, 3), or None
            Coordinates as the motion tracks them.
        broken : ndarray, shape (j,) [s]
            When joints of the group have broken; inf: they hold.
        values, row : JointValues, int
            What to write.
        """
        joints, is_broken = self.joints, broken <= time
        data, m = self.loaded(time, state, contacts, broken), joints.rows.kind.size
        is_open = make_least(joints, data)
        carried, is_joint = forces_of_joints(joints, data, data.z), joints.number >= 0
        if contacts is None and self.segment.terms.contact is not None:
            carried[:], is_open[:] = np.nan, True
        numbers, is_known = joints.number[is_joint], ~is_open[is_joint]
        force, torque = np.hsplit(carried[is_joint], 2)
        values.joint_force[row, numbers], values.joint_torque[row, numbers] = force, torque
        values.joint_force_determined[row, numbers] = is_known[:, :3]
        values.joint_torque_determined[row, numbers] = is_known[:, 3:]
        values.joint_break_time[row, numbers] = np.where(is_broken, broken, 0.0)[is_joint]
        residuals(joints, data, 0, m, data.clock[0])
        rates(joints, data, 0, m)
        start, size = joints.program.start[:-1], joints.rows.size
        for of, found in ((values.joint_misfit, data.g), (values.joint_rate, data.z)):
            of[row, numbers] = np.maximum.reduceat(np.abs(found) / size, start)[is_joint]
        if turned is not None:
            coordinates = values_of(joints.coordinates, turned)
            values.joint_coordinate[row, joints.coordinates.number] = coordinates

    def loaded(
        self, time: float, state: State, contacts: ContactOutput | None, broken: Floats
    ) -> JointData:
        """Data of the joints with multipliers z, by what is given as to `read`."""
        joints, bodies = self.joints, self.bodies
        loads = np.zeros((6, state.com.shape[1]))
        bodies.put(COM, np.vstack(state))
        gather_loads(bodies.moving, time - self.segment.start, loads)
        data = joint_data_at(joints, state)
        data.change[:-1] = loads.T[joints.order]
        data.clock[0] = time - self.segment.start
        data.broken[:] = np.where(broken <= time, -np.inf, np.inf)
        assert bodies.jointed is not None
        jointed = bodies.jointed._replace(data=data)
        set_prescribed(jointed.prescribed, data, time, 0.0, 0, len(data.y))
        factorise_all(joints, data, data.clock[0])
        add_actions(None, jointed, data.change, 0)
        self._add_contacts(data, contacts)
        find_multipliers(joints, data, data.change)
        return data

    def _add_contacts(self, data: JointData, contacts: ContactOutput | None) -> None:
        """Add to the loads on bodies what contacts do, and what acts within bounds in joints."""
        if contacts is None:
            return
        for k, force in enumerate(contacts.force):
            for body, sign in zip(contacts.body[k].tolist(), (1.0, -1.0), strict=True):
                row = self.row_of.get(body)
                if row is not None:
                    turning = np.cross(contacts.point[k] - data.y[row, :3], force)
                    load = np.append(force, turning + contacts.rolling_torque[k])
                    data.change[row] += sign * load
        if self.joints.bounds is not None:
            data.z[:] = 0.0
            np.add.at(data.z, self.joints.bounds.row, contacts.within)
            rows, n = self.joints.rows, data.z.size
            add_impulses(rows, self.joints.inv_mass, data.gradient, data.z, 0, n, data.change, 0)
