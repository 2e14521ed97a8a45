"""Bodies that move as prescribed, whatever touches them, by the motions that walls have.

A prescribed body has no inverse mass, so nothing pushes it: its velocities do not follow from its
momenta, and are written for contacts beside them.
"""

from typing import NamedTuple

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.contact.records import Records
from particlerb.contact.wall_motion import acceleration_at, motion_in, pose_at
from particlerb.maths.quaternion import Quat, multiply, to_body, to_world
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, component_product, cross


class PrescribedBodies(NamedTuple):
    """Prescribed bodies of a group."""

    body: Ints  # (m,) of the group, ascending
    motions: Records  # (m,) MOTION
    com: Floats  # (3, m) [m] centre of mass before it is displaced,
    q: Floats  # (4, m) and orientation of the rotor frame
    mass: Floats  # (m,) [kg]
    inertia: Floats  # (3, m) [kg m²] principal moments


@inline
def prescribed_in(prescribed: PrescribedBodies, first: int, end: int) -> range:
    """Those that are bodies first to end."""
    body = prescribed.body
    return range(np.searchsorted(body, first), np.searchsorted(body, end))


@inline
def prescribed_pose(
    prescribed: PrescribedBodies, k: int, t: float
) -> tuple[Vec3, Quat, Vec3, Vec3]:
    """Position, orientation, velocity and angular velocity of prescribed body k at a time."""
    x, turn, v, omega = pose_at(motion_in(prescribed.motions, k), t)
    com, q = prescribed.com, prescribed.q
    arm = to_world(turn, (com[0, k], com[1, k], com[2, k]))
    orientation = multiply(turn, (q[0, k], q[1, k], q[2, k], q[3, k]))
    return add_scaled(1.0, arm, x), orientation, add_scaled(1.0, cross(omega, arm), v), omega


@inline
def prescribed_acceleration(prescribed: PrescribedBodies, k: int, t: float) -> Vec3:
    """Acceleration of the centre of mass of prescribed body k at a time [m/s²]."""
    com = prescribed.com
    return acceleration_at(motion_in(prescribed.motions, k), (com[0, k], com[1, k], com[2, k]), t)


@inline
def prescribed_momenta(
    prescribed: PrescribedBodies, k: int, q: Quat, v: Vec3, omega: Vec3
) -> tuple[Vec3, Vec3]:
    """M v and I ω of prescribed body k."""
    inertia, mass = prescribed.inertia, prescribed.mass[k]
    spin = component_product((inertia[0, k], inertia[1, k], inertia[2, k]), to_body(q, omega))
    return (mass * v[0], mass * v[1], mass * v[2]), to_world(q, spin)


def prescribed_among(prescribed: PrescribedBodies | None, members: Ints) -> PrescribedBodies | None:
    """Those among the members of a group, by their numbers there; None where there are none."""
    if prescribed is None:
        return None
    numbers = np.flatnonzero(np.isin(members, prescribed.body))
    if not numbers.size:
        return None
    rows = np.searchsorted(prescribed.body, members[numbers])
    com, q, inertia = (
        np.ascontiguousarray(values[:, rows])
        for values in (prescribed.com, prescribed.q, prescribed.inertia)
    )
    motions = prescribed.motions[rows].view(Records)
    return PrescribedBodies(numbers, motions, com, q, prescribed.mass[rows], inertia)
