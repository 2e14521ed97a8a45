"""Where the bodies of a case are at t = 0 and how they move: arrays over all bodies.

Each block of the case draws its random numbers from streams of its own, one per purpose, so that
another block, or random velocities asked for later, change none of those that were there before.
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.bodies import GridPlacement, InBody, Motion, NormalDistribution, RandomBox
from particlerb.case.schema import Case
from particlerb.case.values import Euler, FloatArray, IntArray
from particlerb.model.names import BodyNames

_DRAWN_AT_ONCE: Final = 65_536  # rows of random numbers that are drawn for others
_SEED_OF_PURPOSE = {"place": 0, "orientation": 1, "velocity": 2, "angular_velocity": 3, "shape": 4}


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
    names: BodyNames
    """One per body."""


def placement_of(case: Case, part: range | None = None) -> Placement:
    """Initial values of all bodies of a case, or of a part of them: the same ones.

    Returns
    -------
    Placement
        Arrays of its own, which may be written to.
    """
    names = BodyNames(((body.name, body.count) for body in case.body), part)
    span, n = names.part, len(names)
    edges = names.first.clip(span.start, span.stop) - span.start
    block = np.repeat(np.arange(len(case.body)), np.diff(edges))
    position, velocity, angular_velocity = (np.empty((n, 3)) for _ in range(3))
    orientation = np.empty((n, 4))
    for i, body in enumerate(case.body):
        members = slice(edges[i], edges[i + 1])
        first = max(span.start - int(names.first[i]), 0)
        own = range(first, first + int(edges[i + 1] - edges[i]))
        if not own:
            continue
        position[members] = positions(case, i, own)
        orientation[members] = q = orientations(case, i, own)
        velocity[members] = vectors(case, i, "velocity", body.velocity, q, own)
        omega = vectors(case, i, "angular_velocity", body.angular_velocity, q, own)
        angular_velocity[members] = omega
    return Placement(block, position, orientation, velocity, angular_velocity, names)


def random_stream(seed: int, block: int, purpose: str) -> np.random.Generator:
    """Random numbers of one block for one purpose.

    Parameters
    ----------
    seed : int
        Of the case.
    block : int
        Index of the [[body]] table.
    purpose : str
        A key of `_SEED_OF_PURPOSE`; "shape" is for particles drawn at random.
    """
    entropy = np.random.SeedSequence([seed, block, _SEED_OF_PURPOSE[purpose]])
    return np.random.default_rng(entropy)


def _drawn(draw: Callable[[tuple[int, int]], FloatArray], width: int, part: range) -> FloatArray:
    """Some rows of what is drawn row by row, shape (len(part), width); those before are passed."""
    for first in range(0, part.start, _DRAWN_AT_ONCE):
        draw((min(_DRAWN_AT_ONCE, part.start - first), width))
    return draw((len(part), width))


def _given(values: Sequence[float] | FloatArray, part: range) -> FloatArray:
    """Some rows of those for all bodies of a block, or the one for all of them."""
    given = np.asarray(values, dtype=np.float64)
    return given if given.ndim == 1 else given[part.start : part.stop]


def positions(case: Case, block: int, part: range) -> FloatArray:
    """Centres of mass of some bodies of a block, world frame [m], shape (n, 3) or (3,)."""
    body = case.body[block]
    if isinstance(body.place, GridPlacement):
        return grid(body.place, body.count, part)
    if isinstance(body.place, RandomBox):
        lower, upper = np.array(body.place.lower), np.array(body.place.upper)
        stream = random_stream(case.run.seed, block, "place")
        u = _drawn(stream.random, 3, part)
        return (1.0 - u) * lower + u * upper
    return _given(body.position, part)


def grid(place: GridPlacement, count: int, part: range) -> FloatArray:
    """Some of the first `count` points of a grid, x fastest, shape (n, 3) [m].

    The grid as a whole is centred at `origin`, also where the last layer is not full.
    """
    n = np.array(place.n or grid_size(count))
    i = np.arange(part.start, part.stop)
    steps = np.stack((i % n[0], i // n[0] % n[1], i // (n[0] * n[1])), axis=1)
    return (steps - 0.5 * (n - 1)) * np.array(place.spacing) + np.array(place.origin)


def grid_size(count: int) -> tuple[int, int, int]:
    """Nearly cubic numbers of points per axis with room for all: x >= y >= z."""
    nx = _ceil_root(count, 3)
    ny = _ceil_root(-(-count // nx), 2)
    return nx, ny, -(-count // (nx * ny))


def _ceil_root(value: int, degree: int) -> int:
    """Smallest integer whose power is not below the value."""
    root = max(1, int(float(value) ** (1 / degree)) - 1)
    while root**degree < value:
        root += 1
    return root


def orientations(case: Case, block: int, part: range) -> FloatArray:
    """Unit quaternions of some bodies of a block, shape (n, 4) or (4,).

    Random ones are uniform: normal components, normalised.

    References
    ----------
    Muller, Commun. ACM 2, 19 (1959): normal vectors point uniformly on the sphere, here S³.
    """
    body = case.body[block]
    if isinstance(body.orientation, Euler):
        return quaternion_of_euler(body.orientation.euler_deg)
    if isinstance(body.orientation, str):
        stream = random_stream(case.run.seed, block, "orientation")
        return unit_vectors(_drawn(stream.standard_normal, 4, part))
    return unit_vectors(_given(body.orientation, part))


def unit_vectors(q: FloatArray) -> FloatArray:
    """Vectors of length 1; scaled first, as squares of large or small numbers overflow."""
    q = q / np.abs(q).max(axis=-1, keepdims=True)
    return q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True))


def quaternion_of_euler(euler_deg: Sequence[float]) -> FloatArray:
    """Quaternion q = q_z(yaw) q_y(pitch) q_x(roll) of intrinsic z-y-x angles [°], shape (4,)."""
    roll, pitch, yaw = np.deg2rad(np.fmod(euler_deg, 720.0)) / 2
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    cy, sy = np.cos(yaw), np.sin(yaw)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.array((w, x, y, z))


def quaternion_of(value: Euler | Sequence[float]) -> FloatArray:
    """Unit quaternion (4,) of an orientation as a case gives it."""
    q = quaternion_of_euler(value.euler_deg) if isinstance(value, Euler) else np.array(value)
    return unit_vectors(q)


def vectors(
    case: Case, block: int, key: str, motion: Motion, q: FloatArray, part: range
) -> FloatArray:
    """Velocities or angular velocities of bodies of a block, world frame, shape (n, 3) or (3,)."""
    if isinstance(motion, NormalDistribution):
        stream = random_stream(case.run.seed, block, key)
        return motion.random * _drawn(stream.standard_normal, 3, part)
    if isinstance(motion, InBody):
        return in_world(q, np.array(motion.body))
    return _given(motion, part)


def in_world(q: FloatArray, v: FloatArray) -> FloatArray:
    """R v, (..., 3), of orientations q (..., 4), and v (3,) or (..., 3) in the body frames."""
    # Here, as reading a case loads no compiler.
    from particlerb.model.state import rotate

    return rotate(q.T, np.broadcast_to(v, (*q.shape[:-1], 3)).T).T
