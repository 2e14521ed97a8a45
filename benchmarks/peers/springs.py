"""Numba-compiled equations of bodies on springs, for the engines that take compiled functions.

A spring pulls with k (l - l₀) + c dl/dt along the line between its ends: points of two bodies, or
of one and of the world. State, component first, (13, n): position, velocity, quaternion, angular
momentum about the centre of mass in the rotor frame.
"""

from math import sqrt

import numpy as np
from numba import njit  # noqa: TID251 (the peers stand outside the package)

from .rotation import FAST, half_product, matrix
from .scene import Scene, loads, to_rotor


@njit(forceinline=True, **FAST)
def turned(R, v):
    """R v."""
    return (
        R[0][0] * v[0] + R[0][1] * v[1] + R[0][2] * v[2],
        R[1][0] * v[0] + R[1][1] * v[1] + R[1][2] * v[2],
        R[2][0] * v[0] + R[2][1] * v[1] + R[2][2] * v[2],
    )


@njit(forceinline=True, **FAST)
def crossed(a, b):
    """a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(forceinline=True, **FAST)
def end_of(y, inverse, b, at):
    """A point of a body: its arm from the centre of mass, its place and its velocity, world."""
    if b < 0:
        return (0.0, 0.0, 0.0), (at[0], at[1], at[2]), (0.0, 0.0, 0.0)
    R = matrix(y[6, b], y[7, b], y[8, b], y[9, b])
    arm = turned(R, at)
    spin = turned(R, (inverse[0, b] * y[10, b], inverse[1, b] * y[11, b], inverse[2, b] * y[12, b]))
    w = crossed(spin, arm)
    place = (y[0, b] + arm[0], y[1, b] + arm[1], y[2, b] + arm[2])
    return arm, place, (y[3, b] + w[0], y[4, b] + w[1], y[5, b] + w[2])


@njit(forceinline=True, **FAST)
def pull_on(load, b, arm, x, y, z):
    """Add a force at the end of an arm to those on a body."""
    if b >= 0:
        torque = crossed(arm, (x, y, z))
        load[0, b] += x
        load[1, b] += y
        load[2, b] += z
        for c in range(3):
            load[3 + c, b] += torque[c]


@njit(**FAST)
def spring_rates(y, mass, inverse, steady, tensor, ends, at, numbers, rate):
    """Rates (13, n) of a state (13, n).

    Parameters
    ----------
    mass, inverse : ndarray, shapes (n,), (3, n)
        [kg], inverse principal moments [1/(kg m²)].
    steady, tensor : ndarray, shapes (3, n), (3, 3, n)
        Constant forces, world [N], and Σ p fᵀ of theirs, rotor by world [N m].
    ends, at : ndarray, shapes (2, s), (2, s, 3)
        Bodies, -1 the world, and points in their rotor frames from the centre of mass [m].
    numbers : ndarray, shape (3, s)
        Stiffness, damping, length without force.
    """
    n = mass.size
    load = np.zeros((6, n))
    for s in range(ends.shape[1]):
        a, b = ends[0, s], ends[1, s]
        arm_a, x_a, v_a = end_of(y, inverse, a, at[0, s])
        arm_b, x_b, v_b = end_of(y, inverse, b, at[1, s])
        dx, dy, dz = x_b[0] - x_a[0], x_b[1] - x_a[1], x_b[2] - x_a[2]
        length = sqrt(dx * dx + dy * dy + dz * dz)
        if length == 0.0:
            continue
        speed = (v_b[0] - v_a[0]) * dx + (v_b[1] - v_a[1]) * dy + (v_b[2] - v_a[2]) * dz
        pull = numbers[0, s] * (length - numbers[2, s]) + numbers[1, s] * speed / length
        f = pull / length
        pull_on(load, a, arm_a, f * dx, f * dy, f * dz)
        pull_on(load, b, arm_b, -f * dx, -f * dy, -f * dz)
    for b in range(n):
        R = matrix(y[6, b], y[7, b], y[8, b], y[9, b])
        l = (y[10, b], y[11, b], y[12, b])  # noqa: E741
        omega = (inverse[0, b] * l[0], inverse[1, b] * l[1], inverse[2, b] * l[2])
        gyro = crossed(l, omega)
        for c in range(3):
            rate[c, b] = y[3 + c, b]
            rate[3 + c, b] = (load[c, b] + steady[c, b]) / mass[b]
            i, j = (c + 1) % 3, (c + 2) % 3
            own = 0.0
            for k in range(3):
                own += R[k][c] * load[3 + k, b]
                own += tensor[i, k, b] * R[k][j] - tensor[j, k, b] * R[k][i]
            rate[10 + c, b] = gyro[c] + own
        dq = half_product(y[6, b], y[7, b], y[8, b], y[9, b], omega)
        for c in range(4):
            rate[6 + c, b] = dq[c]


def spring_problem(scene: Scene) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray]:
    """State at the start (13, n), the constants of its rates, and the size of each entry."""
    momenta = scene.inertia * to_rotor(scene.orientation, scene.angular_velocity)
    state = np.vstack([scene.position.T, scene.velocity.T, scene.orientation.T, momenta.T])
    force, tensor = loads(scene)
    inverse = np.divide(1.0, scene.inertia, out=np.zeros_like(momenta), where=scene.inertia > 0)
    ends, at, numbers = scene.springs
    steady = (force + scene.mass[:, None] * scene.gravity).T.copy()
    constants = (scene.mass, inverse.T.copy(), steady, np.moveaxis(tensor, 0, 2).copy(), ends, at,
                 numbers)  # fmt: skip
    length = np.maximum(np.abs(at).max(initial=0.0), numbers[2].max(initial=0.0))
    length = max(float(length), float(np.ptp(scene.position, axis=0).max()), 1e-300)
    rate = np.sqrt(numbers[0].max() / scene.mass.min())
    spin = scene.inertia.max(1) * rate
    speed = np.full((3, len(spin)), rate * length)
    size = np.vstack([np.full((3, len(spin)), length), speed, np.ones((4, len(spin))),
                      np.tile(np.where(spin > 0, spin, 1.0), (3, 1))])  # fmt: skip
    return state, constants, size
