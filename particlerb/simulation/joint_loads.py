"""What joints carry and how well they hold, at the frames of a trajectory.

Both follow from the recorded states and from the forces that act there: no frame needs to have
them. The forces are those of the segment in which a frame lies.
"""

from typing import NamedTuple

import numpy as np

from particlerb.case.to_system import to_system
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import STATE_FIELDS, Frames
from particlerb.plan.joints import joints_of
from particlerb.record.provenance import STATE, changes_in
from particlerb.record.trajectory import Trajectory, check_trajectory
from particlerb.simulation.joint_values import LoadReader, room_for_values
from particlerb.simulation.run import prepare


class JointLoads(NamedTuple):
    """Joints j at frames T."""

    names: tuple[str, ...]  # (j,)
    force: Floats  # (T, j, 3) [N] on the first body, world axes
    torque: Floats  # (T, j, 3) [N m] on it about the point of the joint, world axes
    force_determined: Ints  # (T, j, 3) 0 where redundant rows leave the component open
    torque_determined: Ints  # (T, j, 3)
    misfit: Floats  # (T, j) largest |g|, of lengths over the size of the joint
    rate: Floats  # (T, j) largest |dg/dt| [1/s], the same way


def joint_loads(trajectory: Trajectory) -> JointLoads:
    """Forces and torques in all joints of a trajectory, and how well these hold.

    Where rows depend on others, sums alone are determined: of all loads that keep the joints these
    are the least, torques divided by the size of the joint.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and both momenta.

    Returns
    -------
    JointLoads
        Force [N] and torque [N m], (T, j, 3), world frame, on the first body at the joint's point.

    Raises
    ------
    KeyError
        If it has no joints.
    TypeError
        If it is no trajectory.
    ValueError
        If its Simulation has changed more than `run` and the state: the file has the case as it
        began.
    """
    check_trajectory(trajectory)
    changes = changes_in(trajectory.file)
    if acting := [words for table, words in changes.items() if table not in ("run", STATE)]:
        raise ValueError(
            f"{trajectory.path}: its Simulation has changed {'; '.join(acting)}, and"
            " loads would be those of the scene as it began: record output.fields ="
            ' ["joint_force", "joint_torque"] in place of joint_loads'
        )
    system = prepare(to_system(trajectory.case)).system
    setup = joints_of(system)
    if setup is None:
        raise KeyError("the trajectory has no joints")
    times = trajectory.time
    values = room_for_values(setup, times.size)
    if np.isfinite(setup.breaks).any():
        values.joint_break_time[:] = trajectory.joint_break_time
    x, q, p, L = (np.asarray(getattr(trajectory, name)) for name in STATE_FIELDS)
    LoadReader(system).read(times, Frames(x, q, p, L, q[0], times > 0.0), values)
    return JointLoads(setup.names, *values[:6])
