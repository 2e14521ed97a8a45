"""What the study of `stability` moves, and what becomes of it.

Bodies on which nothing acts, over shapes and starts (`FAMILIES`), or with the terms that the limits
and the drift ask for, driven by a method as a run drives it (`history`), and judged by the energy
(`outcome`). See stability.py for the maps made of it. Nothing here knows of cases and files.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb.forces import Terms, energies_of
from particlerb.integrators import METHODS
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import Bodies, made_of, quaternions, rotor_order
from particlerb.model.state import (
    Frames,
    State,
    initial_state,
    kinetic_energy,
    quaternion_product,
    room_for,
)
from particlerb.rotors.rotor_class import ASYMMETRIC, POINT, SYMMETRIC
from particlerb.stepping.make_motion import make_motion
from particlerb.stepping.motion import SegmentGroup

TURNS: Final = 1e4  # of each body of a map
_GRID_STEP: Final = 0.25  # [s] grid of the times of methods without a step of their own
SMALL: Final = 1e-3  # relative error of the energy up to which a run is called accurate
LARGE: Final = 0.1
_MIN_GROWTH_RATIO: Final = 1.5  # of the worst error from the first half of a run to the second
_MIN_ERROR: Final = 1e-10  # a worst error below is not growing: sums of rounding errors grow
MOMENTS: Final = np.array([1.0, 2.0, 3.0])  # [kg m²] of bodies where the shape does not matter
_NEEDLE_RATIO: Final = 0.05  # of sides of the thinnest plate, and thickness of the needle

_UPRIGHT: Final = (1.0, 0.0, 0.0, 0.0)
VERDICTS: Final = (
    "accurate",
    "accurate so far, growing",
    "bounded and wrong",
    "growing",
    "not solvable",
)
ACCURATE, SO_FAR, WRONG, GROWING, UNSOLVABLE = range(5)


# What is moved, and how


class StabilityScene(NamedTuple):
    """Bodies with what acts on them, and where they start; |ω| = 1 rad/s."""

    bodies: Bodies
    terms: Terms
    state: State


def bodies_of(inertia: Floats, mass: Floats | float = 1.0) -> Bodies:
    """Bodies with these principal moments, ascending, (n, 3) [kg m²]; zeros: points."""
    n = len(inertia)
    ordered, axes = rotor_order(inertia, np.tile(np.eye(3), (n, 1, 1)))
    is_equal = (inertia[:, 0] == inertia[:, 1]) | (inertia[:, 1] == inertia[:, 2])
    rotor_class = np.where(is_equal, SYMMETRIC, ASYMMETRIC)
    rotor_class[~inertia.any(axis=1)] = POINT
    frame = np.ascontiguousarray(quaternions(axes).T)
    return made_of(np.full(n, mass), np.ascontiguousarray(ordered.T), frame, rotor_class)


def unit_vectors(n: int, seed: int) -> Floats:
    """Random directions, (n, 3)."""
    axis = np.random.default_rng(seed).normal(size=(n, 3))
    unit: Floats = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    return unit


def scene(
    inertia: Floats,
    omega: Floats,
    terms: Terms | None = None,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    mass: float = 1.0,
) -> StabilityScene:
    """Bodies whose principal axes are those of the world, all at one position, with no velocity.

    Parameters
    ----------
    inertia : ndarray, shape (3,) or (n, 3) [kg m²]
        Principal moments, ascending, of all bodies or of each.
    omega : ndarray, shape (n, 3) [rad/s]
    terms : Terms, optional
    position : (3,) [m]
    mass : float [kg]
    """
    n = len(omega)
    bodies = bodies_of(np.broadcast_to(inertia, (n, 3)), mass)
    com = np.tile(np.array(position), (n, 1))
    state = initial_state(bodies, com, np.tile(_UPRIGHT, (n, 1)), np.zeros((n, 3)), omega)
    return StabilityScene(bodies, terms or Terms(), state)


def history(
    moved: StabilityScene,
    method: str,
    dt: float,
    times: Floats,
    tolerance: float = 0.0,
    chunks: int = 1,
) -> Frames:
    """States at ascending times, multiples of dt; NaN once no body is finite any more.

    Parameters
    ----------
    moved : StabilityScene
    method : str
    dt, tolerance : float [s, 1]
        For adaptive methods the first step, and the tolerance.
    times : ndarray, shape (T,) [s]
    chunks : int
        How often to look whether anything is left.
    """
    n = moved.bodies.mass.size
    group = SegmentGroup(np.arange(n), moved.bodies, moved.terms)
    motion = make_motion(METHODS[method], group, moved.state, 0.0, dt, tolerance)
    frames = room_for(times.size, n, np.tile(_UPRIGHT, (n, 1)))
    for array in frames[:4]:
        array[:] = np.nan
    for rows in np.array_split(np.arange(times.size), chunks):
        with np.errstate(all="ignore"):
            motion.record(times[rows], rows, frames)
        if not np.isfinite(frames.orientation[rows[-1]]).all(axis=1).any():
            break
    return frames


def energy_errors(moved: StabilityScene, frames: Frames) -> Floats:
    """|E/E₀ - 1| of each body at each time, (T, n); not finite where the state is not."""
    start = energy(moved, moved.state)
    with np.errstate(all="ignore"):
        errors = [np.abs(energy(moved, state) / start - 1.0) for state in states(moved, frames)]
    return np.array(errors)


def states(moved: StabilityScene, frames: Frames) -> Iterator[State]:
    """The states of frames, one after the other."""
    x, q, p, L = frames[:4]
    for f in range(len(x)):
        yield State(x[f].T, quaternion_product(q[f].T, moved.bodies.rotor_frame), p[f].T, L[f].T)


def energy(moved: StabilityScene, state: State) -> Floats:
    """Kinetic energy and that of the springs, (n,) [J]."""
    value = kinetic_energy(moved.bodies, state)
    for load in moved.terms.loads:
        elastic = energies_of(load, state.com, state.q)
        value = value if elastic is None else value + elastic
    return value


def sampling(dt: float, turns: float) -> Floats:
    """Times on the grid of steps: 200 even ones, and 60 whose distances grow from one step on."""
    steps = math.ceil(2.0 * math.pi * turns / dt)
    share = np.concatenate([np.geomspace(1.0 / steps, 1.0, 60), np.linspace(0.005, 1.0, 200)])
    return np.unique(np.rint(share * steps)) * dt


# What becomes of a body


class StabilityOutcome(NamedTuple):
    """What became of n bodies."""

    error: Floats
    """Worst relative error of the energy, shape (n,); inf where the state is not finite."""
    verdict: Ints
    """Index of VERDICTS, shape (n,)."""
    turns: Floats
    """Turns until the error first was above 10 %, shape (n,); inf where it never was."""


def outcome(times: Floats, errors: Floats) -> StabilityOutcome:
    """Judge errors (T, n) at ascending times [s], by these rules in this order.

    - not solvable: an error is not a number, or infinite;
    - growing: the worst error of the second half of the time is more than 1.5 times that of the
      first half and above 1e-10; below 1e-3 all the time: accurate so far, growing;
    - accurate: never above 1e-3; bounded and wrong: the rest.
    """
    errors = np.where(np.isfinite(errors), errors, np.inf)
    first = errors[times <= 0.5 * times[-1]].max(axis=0)
    worst = errors.max(axis=0)
    grows = (worst > _MIN_GROWTH_RATIO * first) & (worst > _MIN_ERROR)
    small = worst <= SMALL
    rules = [np.isinf(worst), grows & small, grows, small]
    verdict = np.select(rules, [UNSOLVABLE, SO_FAR, GROWING, ACCURATE], WRONG)
    lost = errors > LARGE
    turns = np.where(lost.any(axis=0), times[lost.argmax(axis=0)] / (2.0 * math.pi), np.inf)
    return StabilityOutcome(worst, verdict, turns)


# Bodies of the maps


def plates(columns: int) -> tuple[Floats, Floats, Floats]:
    """A needle, then flat plates a by b up to the square one, which turns like a disc.

    Side ratio b/a (0: the needle), moments (r², 1, 1 + r²), and a spin with equal components.
    """
    ratio = np.linspace(_NEEDLE_RATIO, 1.0, columns - 1)
    flat = np.stack([ratio**2, np.ones(columns - 1), 1.0 + ratio**2], axis=1)
    inertia = np.vstack([[_NEEDLE_RATIO**2, 1.0, 1.0], flat])
    omega = np.full((columns, 3), 1.0 / math.sqrt(3.0))
    return np.append(0.0, ratio), inertia, omega


def starts(columns: int) -> tuple[Floats, Floats, Floats]:
    """L from near the axis of the largest moment, through the separatrix, to that of the smallest.

    2HI₂/L², I = (1, 2, 3), and the spin. L lies in the plane of axes 1 and 3, at an angle to axis 3
    that comes closest to the separatrix, 30°, in the middle column.
    """
    u = np.linspace(-1.0, 1.0, columns)
    angle = np.radians(30.0 + u * np.abs(u) * np.where(u < 0.0, 29.0, 59.0))
    L = np.stack([np.sin(angle), np.zeros(columns), np.cos(angle)], axis=1)
    across = MOMENTS[1] * (L * L / MOMENTS).sum(axis=1)
    omega = L / MOMENTS
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    return across, np.tile(MOMENTS, (columns, 1)), omega


_Family = Callable[[int], tuple[Floats, Floats, Floats]]
FAMILIES: Final[dict[str, _Family]] = {"shape": plates, "start": starts}


def row_of(method: str, pace: float, columns: int, turns: float) -> StabilityOutcome:
    """Outcome of all families at one step, one after the other."""
    families = zip(*(make(columns) for make in FAMILIES.values()), strict=True)
    _, inertia, omega = map(np.concatenate, families)
    free = scene(inertia, omega)
    is_stepped = METHODS[method].order and not METHODS[method].is_adaptive
    dt = pace if is_stepped else _GRID_STEP
    times = sampling(dt, turns)
    frames = history(free, method, dt, times, pace, chunks=20)
    return outcome(times, energy_errors(free, frames))
