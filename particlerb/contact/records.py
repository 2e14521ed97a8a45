"""Records of bodies, contacts, walls and pistons: what each number of a row is.

In kernels and in plain Python `forces.elastic[c]` is a field of row c. All fields are float64, so
that a checkpoint keeps plain arrays: see `to_floats`.
"""

from typing import Any, Final, TypeAlias

import numpy as np

from particlerb.compiled.jit import lean
from particlerb.maths.quaternion import Quat
from particlerb.maths.vec3 import Floats, Vec3

Records: TypeAlias = "np.recarray[Any, np.dtype[Any]]"
FLOAT: Final = np.float64

# A body at the instant of a kick, world axes
BODY: Final = np.dtype(
    [
        ("position", FLOAT, 3),  # [m] of the centre of mass
        ("velocity", FLOAT, 3),  # [m/s]
        ("angular_velocity", FLOAT, 3),  # [rad/s]
        ("inv_mass", FLOAT),  # [1/kg] 0 where it is held
        ("speed", FLOAT),  # [m/s] |velocity|
        ("angular_speed", FLOAT),  # [rad/s] |angular_velocity|
        ("orientation", FLOAT, 4),  # of the rotor frame
    ]
)

# What a contact remembers from instant to instant
HISTORY: Final = np.dtype(
    [
        ("spring", FLOAT, 3),  # [m] tangential
        ("overlap", FLOAT),  # [m] at the instant before
        ("normal_force", FLOAT),  # [N] at the instant before
        ("inv_effective_mass", FLOAT),  # [1/kg] where it began, 0 where the contact is not active
        ("damping", FLOAT),  # see `law.damping_coefficient`
    ]
)
ROLLING_HISTORY: Final = np.dtype([*HISTORY.descr, ("rolling_spring", FLOAT, 3)])  # [m]

# Forces of a contact on its first body, world axes
FORCES: Final = np.dtype(
    [
        ("elastic", FLOAT, 3),  # [N] of the normal spring, which has a potential
        ("other", FLOAT, 3),  # [N] all that has none: dashpots, friction
        ("point", FLOAT, 3),  # [m] where they act
        ("elastic_energy", FLOAT),  # [J] of the normal spring
        ("boundary_power", FLOAT),  # [W] of the elastic force on a wall or held body that moves
        ("correction_time", FLOAT),  # [s] of the elastic force: see `law.correction_time`
        ("gross_power", FLOAT),  # [W] |that of the other forces| + |that on moving boundaries|
    ]
)
ROLLING_FORCES: Final = np.dtype([*FORCES.descr, ("rolling_torque", FLOAT, 3)])  # [N m]

# Beside the forces of a contact with a wall
WALL_POINT: Final = (
    ("correction_impulse", FLOAT, 3),  # [N s] elastic forces of a piece times correction times
    ("count", FLOAT),  # how often the primitive's nearest point counts: see `walls.count_of`
    ("is_nearest", FLOAT),  # whether that point is nearer to the sphere than all around it
    ("piece", FLOAT),  # first contact of the piece that the point is of; HANDLED: done with
    ("gap", FLOAT, 3),  # [m] from that point to the centre of the sphere
)

# Pose and motion of a wall
POSE: Final = np.dtype(
    [
        ("position", FLOAT, 3),  # [m] a point p of the wall is at position + R p
        ("orientation", FLOAT, 4),
        ("velocity", FLOAT, 3),  # [m/s] where p = 0
        ("angular_velocity", FLOAT, 3),  # [rad/s]
        ("piston_axis", FLOAT, 3),  # [kg^-1/2] axis of a piston over the root of its mass
    ]
)

# How a wall or a body moves as prescribed: see `wall_motion.PrescribedMotion`
MOTION: Final = np.dtype(
    [
        ("centre", FLOAT, 3),
        ("velocity", FLOAT, 3),
        ("angular_velocity", FLOAT, 3),
        ("amplitude", FLOAT, 3),
        ("frequency", FLOAT),
        ("phase", FLOAT),
    ]
)

# A piston: a wall that slides along its axis
PISTON: Final = np.dtype(
    [
        ("displacement", FLOAT),  # [m]
        ("velocity", FLOAT),  # [m/s] of the drift before the last kick
        ("previous_velocity", FLOAT),  # [m/s] of the drift before that
        ("listed_displacement", FLOAT),  # [m] when the neighbour lists were made
        ("booked_work", FLOAT),  # [J] of contacts without potential, and of stops
        ("contact_velocity", FLOAT),  # [m/s] that contacts saw
        ("elastic_force", FLOAT),  # [N] of contacts along the axis
        ("other_force", FLOAT),  # [N] the rest of it
        ("max_stiffness", FLOAT),  # the largest of the next one so far
        ("stiffness", FLOAT),  # of all contacts together, over that of the law
        ("correction_power", FLOAT),  # [W] of the other force beside force times mean velocity
    ]
)


def zero_records(dtype: np.dtype[Any], *shape: int) -> Records:
    """Records of zeros."""
    return np.zeros(shape, dtype=dtype).view(np.recarray)


def to_floats(records: Records) -> Floats:
    """Records (n,) as rows of numbers (n, ..), in the same memory."""
    n_fields = records.dtype.itemsize // np.dtype(FLOAT).itemsize
    return np.asarray(records).view(FLOAT).reshape(*records.shape, n_fields)


def from_floats(rows: Floats, dtype: np.dtype[Any]) -> Records:
    """Rows of numbers (n, ..) as records (n,), in the same memory."""
    return rows.view(dtype)[:, 0].view(np.recarray)


@lean
def row3(array: Floats, i: int) -> Vec3:
    """Vector in row i of an (n, 3) array."""
    return array[i, 0], array[i, 1], array[i, 2]


@lean
def put_row3(array: Floats, i: int, v: Vec3) -> None:
    """Write the vector in row i of an (n, 3) array."""
    array[i, 0], array[i, 1], array[i, 2] = v


@lean
def row4(array: Floats, i: int) -> Quat:
    """Quaternion in row i of an (n, 4) array."""
    return array[i, 0], array[i, 1], array[i, 2], array[i, 3]


@lean
def put_row4(array: Floats, i: int, q: Quat) -> None:
    """Write the quaternion in row i of an (n, 4) array."""
    array[i, 0], array[i, 1], array[i, 2], array[i, 3] = q
