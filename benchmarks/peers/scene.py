"""The scene that every engine is given, what it hands back, and the arithmetic they share.

Frames: the *rotor frame* has its origin at the centre of mass and its axes along the principal
axes; the *world frame* is inertial. Quaternions have the scalar first and turn rotor vectors into
world vectors. Every array is float64, one row per body.

Constant world forces at fixed points of a body reduce to the net force F = Σ f and to the tensor
G = Σ p fᵀ of the points p in the rotor frame, whatever their number; with the rotation matrix R
the torque about the centre of mass is then τ_a = ε_abc (R G)_bc. Every adapter starts from these.
"""

import importlib
import math
import os
from typing import NamedTuple

import numpy as np


class Push(NamedTuple):
    """Constant world force at a point of a body."""

    body: int  # index of the body
    at: np.ndarray  # (3,) rotor frame, from the centre of mass [m]
    force: np.ndarray  # (3,) world [N]


class Scene(NamedTuple):
    """Bodies, what acts on them and until when."""

    mass: np.ndarray  # (n,) [kg]
    inertia: np.ndarray  # (n, 3) principal moments [kg m²]
    position: np.ndarray  # (n, 3) centre of mass, world [m]
    orientation: np.ndarray  # (n, 4) unit quaternion, rotor to world
    velocity: np.ndarray  # (n, 3) world [m/s]
    angular_velocity: np.ndarray  # (n, 3) world [rad/s]
    gravity: np.ndarray  # (3,) world [m/s²]
    pushes: tuple[Push, ...]
    t_end: float  # [s]
    joints: tuple[np.ndarray, ...] | None = None  # rows of with_textbook.py: kind, a, b (-1: the
    # world), r_a or n, r_b, u, l; vectors (m, 3) in rotor frames
    has_loops: bool = False  # whether rows of joints depend on others
    model: str = ""  # the same as MJCF, of which the bodies are named
    names: tuple[str, ...] = ()
    rotor_frame: np.ndarray | None = None  # (n, 4) rotor frame to the body frame of the model
    files: dict[str, str] | None = None  # the same for LAMMPS, by suffix
    refused: dict[str, str] | None = None  # why such a model is not there, by engine
    contact: tuple[float, float] | None = None  # restitution and friction; None: nothing touches
    springs: tuple[np.ndarray, ...] | None = None  # ends, places, numbers, see springs.py
    attraction: tuple[float, float] | None = None  # of points: G, and softening [m]
    times: np.ndarray | None = None  # (T,) instants at equal distances, the last one t_end [s]


class Result(NamedTuple):
    """State at `t_end`, and what it cost."""

    seconds: float  # wall time of the integration alone [s]
    position: np.ndarray  # (n, 3) centre of mass, world [m]
    orientation: np.ndarray  # (n, 4) unit quaternion, rotor to world
    angular_momentum: np.ndarray  # (n, 3) about the centre of mass, world [kg m²/s]
    kinetic_energy: np.ndarray  # (n,) [J]


class Course(NamedTuple):
    """States at the instants of a scene in which bodies touch, and what they cost."""

    seconds: float  # wall time of the whole loop, with its stops [s]
    position: np.ndarray  # (T, n, 3) centres of mass, world [m]
    orientation: np.ndarray  # (T, n, 4) rotor to world
    velocity: np.ndarray  # (T, n, 3) world [m/s]
    angular_momentum: np.ndarray  # (T, n, 3) about the centre of mass, world [kg m²/s]


def stops(scene: Scene, step: float) -> tuple[int, float]:
    """Number of steps from one instant to the next, and the step [s], at most `step`."""
    length = scene.t_end / len(scene.times)
    number = max(1, math.ceil(length / step * (1 - 1e-12)))
    return number, length / number


def absent(*packages: str) -> str | None:
    """Say which package is not there, or that Numba is switched off where it is asked for."""
    for name in packages:
        try:
            importlib.import_module(name)
        except ModuleNotFoundError:
            return f"{name} is not installed: pip install particlerb[peers]"
        except ImportError as error:
            return f"{name} cannot be imported: {error}"
    if "numba" in packages and os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return "NUMBA_DISABLE_JIT is set, and compiled functions are needed"
    return None


def rotation_matrices(q: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of unit quaternions (n, 4): rotor to world."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def to_world(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn rotor vectors (n, 3) into world vectors."""
    return np.einsum("nij,nj->ni", rotation_matrices(q), v)


def to_rotor(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Turn world vectors (n, 3) into rotor vectors."""
    return np.einsum("nji,nj->ni", rotation_matrices(q), v)


def loads(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Net push on each body (n, 3), world [N], and Σ p fᵀ (n, 3, 3), rotor by world [N m]."""
    force = np.zeros((len(scene.mass), 3))
    tensor = np.zeros((len(scene.mass), 3, 3))
    for push in scene.pushes:
        force[push.body] += push.force
        tensor[push.body] += np.outer(push.at, push.force)
    return force, tensor


def equal_steps(scene: Scene, step: float) -> tuple[int, float]:
    """Number of steps and the step [s], at most `step`, that end exactly at `t_end`."""
    number = max(1, math.ceil(scene.t_end / step * (1 - 1e-12)))
    return number, scene.t_end / number


def needs_solid_bodies(scene: Scene, engine: str) -> str | None:
    """Why an engine that wants three positive moments cannot hold the scene."""
    for body, moments in enumerate(scene.inertia):
        if not (moments > 0).all():
            kind = "rod" if moments.any() else "point"
            return f"{engine} needs three positive moments of inertia; body {body} is a {kind}"
    return None


def result(
    scene: Scene,
    seconds: float,
    position: np.ndarray,
    orientation: np.ndarray,
    velocity: np.ndarray,
    angular_momentum: np.ndarray,
) -> Result:
    """Gather a result; kinetic energy of translation and rotation from the momenta.

    Parameters
    ----------
    position, velocity, angular_momentum : ndarray, shape (n, 3)
        World frame [m], [m/s], [kg m²/s].
    orientation : ndarray, shape (n, 4)
        Quaternions of any length.
    """
    with np.errstate(all="ignore"):  # a run that became unstable ends in large numbers or NaN
        q = orientation / np.linalg.norm(orientation, axis=1, keepdims=True)
        L = to_rotor(q, angular_momentum)
        # A vanishing moment carries no momentum: 0/0 counts as 0.
        spin = np.divide(L, scene.inertia, out=np.zeros_like(L), where=scene.inertia > 0)
        energy = 0.5 * scene.mass * (velocity**2).sum(1) + 0.5 * (L * spin).sum(1)
    return Result(seconds, position, q, angular_momentum, energy)
