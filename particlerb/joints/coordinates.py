"""Coordinates of joints: angles with their turns, and displacements; all are 0 where it starts.

A displacement is u·d, u fixed in b, d as in rows.py. An angle has the cosine p_a·p_b and the sine
q_a·q_b; its whole turns are counted at each drift, by the shorter way from one pose to the next.
Nothing is counted where nobody asks for it.
"""

from collections.abc import Sequence

import numpy as np

from particlerb.compiled.jit import inline, kernel, unfused_kernel
from particlerb.joints import kinds
from particlerb.joints.records import Coordinates
from particlerb.joints.rows import orientation
from particlerb.joints.types import COORDINATES, Ends, coordinate_rows
from particlerb.maths.quaternion import to_world
from particlerb.maths.rows import put_row3, row3
from particlerb.maths.vec3 import Floats, Vec3, dot, subtract


def names_of(kind: str) -> list[tuple[str, str]]:
    """Names and units of the coordinates of joints of a type; those of balls are not counted."""
    rows = [(name, along[0].kind) for name, along in COORDINATES.get(kind, {}).items()]
    return [
        (name, "m" if of == kinds.ALONG else "rad") for name, of in rows if of != kinds.ROTATION
    ]


def coordinates_of(kind: str, ends: Ends) -> Coordinates:
    """Coordinates of joints of a type, joint after joint; numbers are counted from 0."""
    parts, is_angle = [], list[bool]()
    for name, unit in names_of(kind):
        (row,) = coordinate_rows(kind, ends, name)
        first, second, axis = row.vector_a, row.vector_b, row.axis
        if unit == "m":
            vectors = first, np.zeros_like(first), axis, second
        elif row.kind[0] == kinds.TURN:
            vectors = first, first, second, np.cross(axis, second)
        else:
            vectors = first, np.cross(first, axis), second, second
        parts.append(np.stack(vectors, axis=1))
        is_angle.append(unit == "rad")
    k, n = ends.a.size, len(parts)
    joint = np.repeat(np.arange(k), n)
    stacked = np.stack(parts, axis=1).reshape(-1, 4, 3) if parts else np.zeros((0, 4, 3))
    angles = np.tile(is_angle, k).astype(np.bool_)
    return Coordinates(np.arange(k * n), joint, ends.a[joint], ends.b[joint], angles, stacked)


def united(parts: Sequence[Coordinates], n_joints: Sequence[int]) -> Coordinates:
    """Coordinates of several types of joints in one, numbered through; so many joints of each."""
    first = np.cumsum([0, *n_joints])[:-1]
    moved = [part._replace(joint=part.joint + k) for part, k in zip(parts, first, strict=True)]
    joined = Coordinates._make(np.concatenate(arrays) for arrays in zip(*moved, strict=True))
    return joined._replace(number=np.arange(joined.a.size))


@inline
def _placed(y: Floats, k: int, v: Vec3) -> Vec3:
    """Where a point v of body k is."""
    r = to_world(orientation(y, k), v)
    x = row3(y, k)
    return x[0] + r[0], x[1] + r[1], x[2] + r[2]


@unfused_kernel
def count_turns(coordinates: Coordinates, y: Floats, turned: Floats) -> None:
    """Take the angles and displacements (k, 3) on to the poses of now: see `JointData.turned`."""
    _, _, a, b, is_angle, vectors = coordinates
    for k in range(a.size):
        v = vectors[k]
        first, other = row3(v, 0), row3(v, 1)
        p, q = row3(v, 2), row3(v, 3)
        of_b = orientation(y, b[k])
        if not is_angle[k]:
            d = subtract(_placed(y, a[k], first), _placed(y, b[k], q))
            turned[k, 0] = dot(to_world(of_b, p), d)
            continue
        of_a = orientation(y, a[k])
        c = dot(to_world(of_a, first), to_world(of_b, p))
        s = dot(to_world(of_a, other), to_world(of_b, q))
        ahead = turned[k, 0] * s - turned[k, 1] * c
        if turned[k, 1] >= 0.0 and s < 0.0 and ahead > 0.0:
            turned[k, 2] += 1.0
        elif turned[k, 1] < 0.0 and s >= 0.0 and ahead < 0.0:
            turned[k, 2] -= 1.0
        turned[k, 0], turned[k, 1] = c, s


@kernel
def store_turns(turned: Floats, stored: Floats, frame: int) -> None:
    """Keep them for a frame."""
    for k in range(len(turned)):
        put_row3(stored[frame], k, row3(turned, k))


def values_of(coordinates: Coordinates, turned: Floats) -> Floats:
    """Angles [rad] with their turns, and displacements [m], (..., k)."""
    angle = np.arctan2(turned[..., 1], turned[..., 0]) + 2.0 * np.pi * turned[..., 2]
    return np.where(coordinates.is_angle, angle, turned[..., 0])
