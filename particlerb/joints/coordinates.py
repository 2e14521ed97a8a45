"""Coordinates of joints: angles with their turns, and displacements; all are 0 where it starts.

A displacement is u·d, u fixed in b, d as in rows.py. An angle has the cosine p_a·p_b and the sine
q_a·q_b; its whole turns are counted at each drift, by the shorter way from one pose to the next.
Nothing is counted where nobody asks for it.
"""

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel, unfused_kernel
from particlerb.joints.records import Coordinates
from particlerb.joints.rows import attitude, put_vector, vector
from particlerb.joints.types import Ends
from particlerb.maths.quaternion import to_world
from particlerb.maths.vec3 import Floats, Vec3, dot, subtract


class Coordinate(NamedTuple):
    """One coordinate: its name, its unit, and the directions that it takes."""

    name: str
    first: tuple[str, ...] = ()  # p, q of an angle in the first body; none: a displacement
    second: tuple[str, ...] = ()  # p, q in the second; of a displacement its direction there

    @property
    def unit(self) -> str:
        """Of an angle, or of a displacement."""
        return "rad" if self.first else "m"


TURN: Final = Coordinate("angle", ("e", "e"), ("e", "f"))
SHIFT: Final = Coordinate("displacement", (), ("n",))
COORDINATES: Final[Mapping[str, tuple[Coordinate, ...]]] = {
    "hinge": (TURN,),
    "universal": (
        Coordinate("angle about axis", ("m", "l"), ("m", "m")),
        Coordinate("angle about axis_to", ("n", "n"), ("n", "l")),
    ),
    "slider": (SHIFT,),
    "cylindrical": (SHIFT, TURN),
    "screw": (SHIFT, TURN),
    "planar": (
        Coordinate("first displacement", (), ("e",)),
        Coordinate("second displacement", (), ("f",)),
        TURN,
    ),
}  # l stands across n and m


def coordinates_of(kind: str, ends: Ends) -> Coordinates:
    """Coordinates of joints of a type, joint after joint; numbers are counted from 0."""
    parts = []
    for own in COORDINATES.get(kind, ()):
        if own.first:
            vectors = [ends.first[name] for name in own.first]
            vectors += [ends.second[name] for name in own.second]
        else:
            vectors = [ends.first_at, np.zeros_like(ends.first_at)]
            vectors += [ends.second[own.second[0]], ends.second["at"]]
        parts.append(np.stack(vectors, axis=1))
    k, n = ends.a.size, len(parts)
    joint = np.repeat(np.arange(k), n)
    found = np.stack(parts, axis=1).reshape(-1, 4, 3) if parts else np.zeros((0, 4, 3))
    is_angle = np.tile([bool(own.first) for own in COORDINATES.get(kind, ())], k).astype(np.bool_)
    return Coordinates(np.arange(k * n), joint, ends.a[joint], ends.b[joint], is_angle, found)


def united(parts: Sequence[Coordinates], n_joints: Sequence[int]) -> Coordinates:
    """Coordinates of several types of joints in one, numbered through; so many joints of each."""
    first = np.cumsum([0, *n_joints])[:-1]
    moved = [one._replace(joint=one.joint + k) for one, k in zip(parts, first, strict=True)]
    found = Coordinates._make(np.concatenate(arrays) for arrays in zip(*moved, strict=True))
    return found._replace(number=np.arange(found.a.size))


@inline
def _placed(y: Floats, k: int, v: Vec3) -> Vec3:
    """Where a point v of body k is."""
    r = to_world(attitude(y, k), v)
    x = vector(y, k, 0)
    return x[0] + r[0], x[1] + r[1], x[2] + r[2]


@unfused_kernel
def count_turns(coordinates: Coordinates, y: Floats, turned: Floats) -> None:
    """Take the angles and displacements (k, 3) on to the poses of now: see `Work.turned`."""
    _, _, a, b, is_angle, vectors = coordinates
    for k in range(a.size):
        v = vectors[k]
        first, other = vector(v, 0, 0), vector(v, 1, 0)
        p, q = vector(v, 2, 0), vector(v, 3, 0)
        of_b = attitude(y, b[k])
        if not is_angle[k]:
            d = subtract(_placed(y, a[k], first), _placed(y, b[k], q))
            turned[k, 0] = dot(to_world(of_b, p), d)
            continue
        of_a = attitude(y, a[k])
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
        put_vector(stored[frame], k, 0, vector(turned, k, 0))


def values_of(coordinates: Coordinates, turned: Floats) -> Floats:
    """Angles [rad] with their turns, and displacements [m], (..., k)."""
    angle = np.arctan2(turned[..., 1], turned[..., 0]) + 2.0 * np.pi * turned[..., 2]
    return np.where(coordinates.is_angle, angle, turned[..., 0])
