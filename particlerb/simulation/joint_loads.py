"""What joints carry and how well they hold, at the frames of a trajectory.

Both follow from the recorded states and from the forces that act there: no frame needs to have
them. The forces are those of the segment in which a frame lies.
"""

from typing import NamedTuple

import numpy as np

from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS
from particlerb.integrators.stages import gather_loads
from particlerb.joints.reactions import find_multipliers, forces_of_joints, make_least
from particlerb.joints.rows import rates, residuals
from particlerb.maths.vec3 import Floats
from particlerb.model.state import State, quaternion_product
from particlerb.plan.joint_words import work_at
from particlerb.plan.joints import joints_of
from particlerb.plan.segments import GroupPlan, Segment
from particlerb.record.trajectory import Trajectory
from particlerb.simulation.run import prepare
from particlerb.stepping.stepped_motion import SteppedMotion


class JointLoads(NamedTuple):
    """Joints j at frames T."""

    names: tuple[str, ...]  # (j,)
    force: Floats  # (T, j, 3) [N] on the first body, world axes
    torque: Floats  # (T, j, 3) [N m] on it about the point of the joint, world axes
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

    Raises
    ------
    KeyError
        If it has no joints.
    """
    system = prepare(to_system(trajectory.case))
    setup = joints_of(system.system)
    if setup is None:
        raise KeyError("the trajectory has no joints")
    times = trajectory.time
    n, j = times.size, len(setup.names)
    found = JointLoads(setup.names, *np.zeros((2, n, j, 3)), *np.zeros((2, n, j)))
    fields = "position", "orientation", "linear_momentum", "angular_momentum"
    states = [np.asarray(getattr(trajectory, name)) for name in fields]
    for group in system.plan.groups:
        for segment in group.segments:
            if segment.terms.joints is None:
                continue
            for k in np.flatnonzero((segment.start <= times) & (times < segment.stop)):
                x, q, p, L = (np.ascontiguousarray(v[k, group.members].T) for v in states)
                state = State(x, quaternion_product(q, group.bodies.rotor_frame), p, L)
                _fill_in(found, int(k), group, segment, state, float(times[k]))
    return found


def _fill_in(
    found: JointLoads, k: int, group: GroupPlan, segment: Segment, state: State, time: float
) -> None:
    """Frame k of the joints of a group in a state at a time [s]."""
    joints = segment.terms.joints
    assert joints is not None
    motion = SteppedMotion(
        METHODS[segment.method], group.group(segment), state, segment.start, segment.dt
    )
    loads = np.zeros((6, state.com.shape[1]))
    gather_loads(motion.moving, time - segment.start, loads)
    work, m = work_at(joints, state), joints.rows.kind.size
    padded = np.zeros((joints.inv_mass.size, 6))
    padded[:-1] = loads.T[joints.order]
    find_multipliers(joints, work, padded)
    make_least(joints, work)
    carried = forces_of_joints(joints, work)
    found.force[k, joints.number], found.torque[k, joints.number] = carried[:, :3], carried[:, 3:]
    residuals(joints, work, 0, m)
    rates(joints, work, 0, m)
    start, size = joints.program.start[:-1], joints.rows.size
    found.misfit[k, joints.number] = np.maximum.reduceat(np.abs(work.g) / size, start)
    found.rate[k, joints.number] = np.maximum.reduceat(np.abs(work.z) / size, start)
