"""How far states lie apart, as users judge it: angles between orientations, sizes of bodies.

The angle is that of the rotation from one orientation to the other, 2 atan2(|v|, |w|), which is
accurate for tiny angles. Rods compare their axes, points nothing.
"""

import math

import numpy as np

from particlerb.compiled.jit import inline, unfused_kernel
from particlerb.maths.quaternion import Quat, conjugate, multiply, to_world
from particlerb.maths.vec3 import Floats, Ints, cross, dot
from particlerb.model.bodies import Bodies
from particlerb.rotors.rotor_class import POINT, ROD


@inline
def _angle_between(code: int, frame: Quat, a: Quat, b: Quat) -> float:
    """Angle between two orientations of a body of a rotor class [rad]."""
    if code == POINT:
        return 0.0
    if code == ROD:
        axis = to_world(frame, (0.0, 0.0, 1.0))
        p, q = to_world(a, axis), to_world(b, axis)
        across = cross(p, q)
        return math.atan2(math.sqrt(dot(across, across)), dot(p, q))
    w, x, y, z = multiply(conjugate(a), b)
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


@unfused_kernel
def compare(
    rotor_class: Ints, rotor_frame: Floats, x: Floats, q: Floats, y: Floats, r: Floats,
    angle: Floats, distance: Floats,
) -> None:  # fmt: skip
    """Angles and distances of all rows and bodies between states (x, q) and (y, r)."""
    for k in range(angle.shape[0]):
        for b in range(rotor_class.size):
            f, e, g = rotor_frame[:, b], q[k, b], r[k, b]
            frame = (float(f[0]), float(f[1]), float(f[2]), float(f[3]))
            expected = (float(e[0]), float(e[1]), float(e[2]), float(e[3]))
            actual = (float(g[0]), float(g[1]), float(g[2]), float(g[3]))
            here, there = x[k, b], y[k, b]
            off = (
                float(there[0]) - float(here[0]),
                float(there[1]) - float(here[1]),
                float(there[2]) - float(here[2]),
            )
            angle[k, b] = _angle_between(rotor_class[b], frame, expected, actual)
            distance[k, b] = math.sqrt(dot(off, off))


@np.errstate(over="ignore", invalid="ignore")
def misfits(bodies: Bodies, x: Floats, q: Floats, y: Floats, r: Floats) -> tuple[Floats, Floats]:
    """Angles [rad] and distances [m] between poses, each (T, n).

    Parameters
    ----------
    bodies : Bodies
        Constants of the n bodies.
    x, y : ndarray, shape (T, n, 3) [m]
        Positions expected and found.
    q, r : ndarray, shape (T, n, 4)
        Unit quaternions, body frame to world, expected and found; their signs do not matter.
    """
    angle, distance = np.empty(x.shape[:2]), np.empty(x.shape[:2])
    compare(bodies.rotor_class, bodies.rotor_frame, x, q, y, r, angle, distance)
    return angle, distance


def angles(bodies: Bodies, expected: Floats, actual: Floats) -> Floats:
    """Angles between orientations (n, 4) of n bodies, (n,) [rad]; as `misfits`."""
    at_rest = np.zeros((1, len(expected), 3))
    (angle,), _ = misfits(bodies, at_rest, expected[None], at_rest, actual[None])
    return np.asarray(angle)
