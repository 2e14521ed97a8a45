"""Where the bodies of a case are at t = 0 and how they move: arrays over all bodies.

Each block of the case draws its random numbers from streams of its own, one per purpose, so that
another block, or random velocities asked for later, change none of those that were there before.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, overload

import numpy as np

from particlerb.case.schema import (
    Case,
    Euler,
    GridPlacement,
    InBody,
    Motion,
    NormalDistribution,
    RandomBox,
)
from particlerb.case.values import REFERENCE, FloatArray, IntArray

PURPOSES = {"place": 0, "orientation": 1, "velocity": 2, "angular_velocity": 3, "shape": 4}


class Names(Sequence[str]):
    """Names of all bodies, made when asked for: `cube` alone, `clump[0]`, `clump[1]`, ... ."""

    def __init__(self, case: Case) -> None:
        self.blocks = [(body.name, body.count) for body in case.body]
        self.first = first_bodies(case)

    def __len__(self) -> int:
        """Number of bodies."""
        return int(self.first[-1])

    @overload
    def __getitem__(self, b: int) -> str: ...
    @overload
    def __getitem__(self, b: slice) -> list[str]: ...
    def __getitem__(self, b: int | slice) -> str | list[str]:
        """Name of body b, or of several."""
        if isinstance(b, slice):
            return [self[i] for i in range(*b.indices(len(self)))]
        b = range(len(self))[b]
        block = int(np.searchsorted(self.first, b, side="right")) - 1
        name, count = self.blocks[block]
        return name if count == 1 else f"{name}[{b - self.first[block]}]"

    def __iter__(self) -> Iterator[str]:
        """All names, a million in a third of a second."""
        for name, count in self.blocks:
            if count == 1:
                yield name
            else:
                yield from (f"{name}[{k}]" for k in range(count))


class Placement(NamedTuple):
    """Initial values of all bodies, in the order of the blocks."""

    block: IntArray
    """Index of the [[body]] table, shape (n_bodies,)."""
    position: FloatArray
    """Centre of mass, world frame [m], shape (n_bodies, 3)."""
    orientation: FloatArray
    """Unit quaternion, scalar first, body to world, shape (n_bodies, 4)."""
    velocity: FloatArray
    """World frame [m/s], shape (n_bodies, 3)."""
    angular_velocity: FloatArray
    """World frame [rad/s], shape (n_bodies, 3)."""
    names: Sequence[str]
    """One per body."""


def place(case: Case) -> Placement:
    """Initial values of all bodies of a case.

    Returns
    -------
    Placement
        Arrays of its own, which may be written to.
    """
    first = first_bodies(case)
    n = int(first[-1])
    block = np.repeat(np.arange(len(case.body)), np.diff(first))
    position, velocity, angular_velocity = (np.empty((n, 3)) for _ in range(3))
    orientation = np.empty((n, 4))
    for i, body in enumerate(case.body):
        own = slice(first[i], first[i + 1])
        position[own] = positions(case, i)
        orientation[own] = q = orientations(case, i)
        velocity[own] = vectors(case, i, "velocity", body.velocity, q)
        angular_velocity[own] = vectors(case, i, "angular_velocity", body.angular_velocity, q)
    return Placement(block, position, orientation, velocity, angular_velocity, Names(case))


def first_bodies(case: Case) -> IntArray:
    """Index of the first body of each block, and the number of bodies; shape (n_blocks + 1,)."""
    counts = np.array([0, *(body.count for body in case.body)], dtype=np.int64)
    first: IntArray = np.cumsum(counts)
    return first


def random_stream(case: Case, block: int, purpose: str) -> np.random.Generator:
    """Random numbers of one block for one purpose.

    Parameters
    ----------
    case : Case
        Gives the seed.
    block : int
        Index of the [[body]] table.
    purpose : str
        A key of `PURPOSES`; "shape" is for particles drawn at random.
    """
    entropy = np.random.SeedSequence([case.run.seed, block, PURPOSES[purpose]])
    return np.random.default_rng(entropy)


def positions(case: Case, block: int) -> FloatArray:
    """Centres of mass of a block, world frame [m], shape (count, 3) or (3,)."""
    body = case.body[block]
    if isinstance(body.place, GridPlacement):
        return grid(body.place, body.count)
    if isinstance(body.place, RandomBox):
        lower, upper = np.array(body.place.lower), np.array(body.place.upper)
        u = random_stream(case, block, "place").random((body.count, 3))
        points: FloatArray = (1.0 - u) * lower + u * upper
        return points
    return np.asarray(body.position, dtype=np.float64)


def grid(place: GridPlacement, count: int) -> FloatArray:
    """The first `count` points of a grid, x fastest, shape (count, 3) [m].

    The grid as a whole is centred at `origin`, also where the last layer is not full.
    """
    n = np.array(place.n or grid_size(count))
    i = np.arange(count)
    steps = np.stack((i % n[0], i // n[0] % n[1], i // (n[0] * n[1])), axis=1)
    points: FloatArray = (steps - 0.5 * (n - 1)) * np.array(place.spacing) + np.array(place.origin)
    return points


def grid_size(count: int) -> tuple[int, int, int]:
    """Nearly cubic numbers of points per axis with room for all: x >= y >= z."""
    nx = ceil_root(count, 3)
    ny = ceil_root(-(-count // nx), 2)
    return nx, ny, -(-count // (nx * ny))


def ceil_root(value: int, degree: int) -> int:
    """Smallest integer whose power is not below the value."""
    root = max(1, int(float(value) ** (1 / degree)) - 1)
    while root**degree < value:
        root += 1
    return root


def orientations(case: Case, block: int) -> FloatArray:
    """Unit quaternions of a block, shape (count, 4) or (4,)."""
    body = case.body[block]
    if isinstance(body.orientation, Euler):
        return quaternion_of_euler(body.orientation.euler_deg)
    if isinstance(body.orientation, str):
        return random_quaternions(random_stream(case, block, "orientation"), body.count)
    return normalised(np.asarray(body.orientation, dtype=np.float64))


def normalised(q: FloatArray) -> FloatArray:
    """Quaternions of length 1; scaled first, as squares of large or small numbers overflow."""
    q = q / np.abs(q).max(axis=-1, keepdims=True)
    unit: FloatArray = q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    return unit


def quaternion_of_euler(euler_deg: Sequence[float]) -> FloatArray:
    """Quaternion q = q_z(yaw) q_y(pitch) q_x(roll) of intrinsic z-y-x angles [°], shape (4,)."""
    roll, pitch, yaw = np.deg2rad(np.fmod(euler_deg, 720.0)) / 2
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    return np.array(
        (
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
    )


def random_quaternions(stream: np.random.Generator, count: int) -> FloatArray:
    """Uniform rotations: normal components, normalised; shape (count, 4).

    References
    ----------
    Muller, Commun. ACM 2, 19 (1959): normal vectors point uniformly on the sphere, here S³.
    """
    return normalised(stream.standard_normal((count, 4)))


def vectors(case: Case, block: int, key: str, motion: Motion, q: FloatArray) -> FloatArray:
    """Velocities or angular velocities of a block, world frame, shape (count, 3) or (3,)."""
    if isinstance(motion, NormalDistribution):
        drawn = random_stream(case, block, key).standard_normal((case.body[block].count, 3))
        return motion.random * drawn
    if isinstance(motion, InBody):
        return to_world(q, np.array(motion.body))
    return np.asarray(motion, dtype=np.float64)


def to_world(q: FloatArray, v: FloatArray) -> FloatArray:
    """R v = v + w t + u × t with u = (x, y, z), t = 2 u × v; q of shape (..., 4)."""
    w, u = q[..., :1], q[..., 1:]
    t = 2.0 * np.cross(u, v)
    turned: FloatArray = v + w * t + np.cross(u, t)
    return turned


def resolve_bodies(case: Case, names: str | Sequence[str]) -> IntArray:
    """Indices of the bodies that a force or a check names.

    Parameters
    ----------
    case : Case
        The case.
    names : str or sequence of str
        `clump` is all bodies of the block, `clump[3]` the fourth of them.

    Returns
    -------
    ndarray, shape (n,)
        Ascending, each body once.

    Raises
    ------
    KeyError
        If there is no such body; `load` has refused a case that names one.
    """
    return np.unique(bodies_in_order(case, names))


def bodies_in_order(case: Case, names: str | Sequence[str]) -> IntArray:
    """Indices of the bodies as they are named: in this order, and as often; else as above."""
    first = first_bodies(case)
    blocks = {body.name: i for i, body in enumerate(case.body)}
    wanted = [names] if isinstance(names, str) else names
    return np.concatenate([bodies_named(name, blocks, first) for name in wanted])


def bodies_named(name: str, blocks: dict[str, int], first: IntArray) -> IntArray:
    """Indices of the bodies of one name."""
    match = REFERENCE.fullmatch(name)
    if match is None or match[1] not in blocks:
        raise KeyError(name)
    lo, hi = first[blocks[match[1]]], first[blocks[match[1]] + 1]
    if match[2] is None:
        return np.arange(lo, hi)
    if int(match[2]) >= hi - lo:
        raise KeyError(name)
    return np.array([lo + int(match[2])])
