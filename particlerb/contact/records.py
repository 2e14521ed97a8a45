"""Records of bodies, contacts, walls and pistons: what each number of a row is.

In kernels and in plain Python `forces.elastic[c]` is a field of row c. All fields are float64, so
that a checkpoint keeps plain arrays: see `to_floats`.
"""

from typing import Any, Final

import numpy as np

from particlerb.maths.vec3 import Floats

_FLOAT: Final = np.float64


class Records(np.ndarray[Any, np.dtype[Any]]):
    """Array of records, whose fields are attributes as in compiled code."""

    def __getattr__(self, name: str) -> Any:
        """A field, as an array."""
        if name not in (self.dtype.names or ()):
            raise AttributeError(name)
        field = self.view(np.ndarray)[name]
        self.__dict__[name] = field  # a view: the next time it is found without this
        return field


def record(base: np.dtype[Any] | None = None, **sizes: int) -> np.dtype[Any]:
    """Type of a record: the fields of another one, and numbers (size 1) and vectors by name."""
    fields = [(name, _FLOAT) if n == 1 else (name, _FLOAT, n) for name, n in sizes.items()]
    return np.dtype([*(base.descr if base is not None else ()), *fields])


# A body at the instant of a kick, world axes
BODY: Final = record(
    position=3,  # [m] of the centre of mass
    velocity=3,  # [m/s]
    angular_velocity=3,  # [rad/s]
    inv_mass=1,  # [1/kg] 0 where it is held
    speed=1,  # [m/s] |velocity|
    angular_speed=1,  # [rad/s] |angular_velocity|
    orientation=4,  # of the rotor frame
)

# What a contact remembers from instant to instant
_HISTORY: Final = record(
    spring=3,  # [m] tangential
    overlap=1,  # [m] at the instant before
    normal_force=1,  # [N] at the instant before
    inv_effective_mass=1,  # [1/kg] where it began, 0 where the contact is not active
    damping=1,  # see `law.damping_coefficient`
)
_IMPULSE_HISTORY: Final = record(
    force=3,  # [N] mean of the last step on the first body
    inv_effective_mass=1,  # [1/kg] 0 where the contact is not active
)

# Forces of a contact on its first body, world axes
CONTACT_FORCES: Final = record(
    elastic=3,  # [N] of the normal spring, which has a potential
    other=3,  # [N] all that has none: dashpots, friction
    point=3,  # [m] where they act
    elastic_energy=1,  # [J] of the normal spring
    boundary_power=1,  # [W] of the elastic force on a wall or held body that moves
    correction_time=1,  # [s] of the elastic force: see `law.correction_time`
    gross_power=1,  # [W] |that of the other forces| + |that on moving boundaries|
)
ROLLING_FORCES: Final = record(CONTACT_FORCES, rolling_torque=3)  # [N m]

# Beside the forces of a contact with a wall
_WALL_POINT: Final = {
    "correction_impulse": 3,  # [N s] elastic forces of a piece times correction times
    "count": 1,  # how often the primitive's nearest point counts: see `walls.euler_count`
    "is_nearest": 1,  # whether that point is nearer to the sphere than all around it
    "piece": 1,  # first contact of the piece that the point is of; -1: it is dealt with
    "gap": 3,  # [m] from that point to the centre of the sphere
}

# Pose and motion of a wall
POSE: Final = record(
    position=3,  # [m] a point p of the wall is at position + R p
    orientation=4,
    velocity=3,  # [m/s] where p = 0
    angular_velocity=3,  # [rad/s]
    piston_axis=3,  # [kg^-1/2] axis of a piston over the root of its mass
)

# How a wall or a body moves as prescribed: see `wall_motion.PrescribedMotion`
MOTION: Final = record(
    centre=3, velocity=3, angular_velocity=3, amplitude=3, frequency=1, phase=1, shift=3, turn=4
)

# A piston: a wall that slides along its axis
PISTON: Final = record(
    displacement=1,  # [m]
    velocity=1,  # [m/s] of the drift before the last kick
    previous_velocity=1,  # [m/s] of the drift before that
    listed_displacement=1,  # [m] when the neighbour lists were made
    external_work=1,  # [J] of contacts without potential, and of stops
    contact_velocity=1,  # [m/s] that contacts saw
    elastic_force=1,  # [N] of contacts along the axis
    other_force=1,  # [N] the rest of it
    max_stiffness=1,  # the largest of the next one so far
    stiffness=1,  # of all contacts together, over that of the law
    correction_power=1,  # [W] of the other force beside force times mean velocity
)

# The largest of all bodies, for contacts that cannot come into reach
EXTREMES: Final = record(
    displacement=1,  # [m] that spheres have come since the lists were made
    speed=1,  # [m/s] at the last evaluation
    angular_speed=1,  # [rad/s]
    ahead=1,  # [m] that points have come in a step since then, by impulses
)


# When bodies were placed at the beginning of a step
STEP_START: Final = record(
    time=1,  # [s] since the segment began
    before=1,  # [s] length of the step before, 0 where there is none
)

# Tangential springs of a contact within a step, for methods that take several slopes
STAGES: Final = record(start=3, total=3, rolling_start=3, rolling_total=3)  # [m]


def history_record(with_rolling: bool, with_impulses: bool = False) -> np.dtype[Any]:
    """Record of what a contact remembers; against rolling a torque [N m], or a spring [m]."""
    if with_impulses:
        return record(_IMPULSE_HISTORY, torque=3) if with_rolling else _IMPULSE_HISTORY
    return record(_HISTORY, rolling_spring=3) if with_rolling else _HISTORY


def forces_record(
    with_rolling: bool, with_wall: bool, with_impulses: bool = False
) -> np.dtype[Any]:
    """Record of the forces of a contact between spheres, or with a wall."""
    forces = ROLLING_FORCES if with_rolling else CONTACT_FORCES
    if with_impulses:
        forces = record(forces, overlap=1)  # [m] springs act in its middle, impulses do not
    return record(forces, **_WALL_POINT) if with_wall else forces


def columns_of(dtype: np.dtype[Any]) -> int:
    """How many numbers a record has."""
    return dtype.itemsize // np.dtype(_FLOAT).itemsize


def zero_records(dtype: np.dtype[Any], *shape: int) -> Records:
    """Records of zeros."""
    return np.zeros(shape, dtype=dtype).view(Records)


def to_floats(records: Records) -> Floats:
    """Records (n,) as rows of numbers (n, ..), in the same memory."""
    return np.asarray(records).view(_FLOAT).reshape(*records.shape, columns_of(records.dtype))


def from_floats(rows: Floats, dtype: np.dtype[Any]) -> Records:
    """Rows of numbers (n, ..) as records (n,), in the same memory."""
    return rows.view(dtype)[:, 0].view(Records)
