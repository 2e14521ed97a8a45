"""How far states lie apart, as users judge it: angles between orientations, sizes of bodies.

The angle is that of the rotation from one orientation to the other, 2 atan2(|v|, |w|), which is
accurate for tiny angles. Rods compare their axes, points nothing.
"""

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
from particlerb.model.state import multiplied, turned
from particlerb.rotors.rotor_class import POINT, ROD

CONJUGATE = np.array([[1.0], [-1.0], [-1.0], [-1.0]])


def angles(bodies: Bodies, expected: Floats, found: Floats) -> Floats:
    """Angles between orientations, (n,) [rad].

    Parameters
    ----------
    bodies : Bodies
        Constants of the n bodies.
    expected, found : ndarray, shape (n, 4)
        Unit quaternions, body frame to world; their signs do not matter.
    """
    a, b = np.ascontiguousarray(expected.T), np.ascontiguousarray(found.T)
    w, *v = multiplied(a * CONJUGATE, b)
    angle = 2 * np.arctan2(np.linalg.norm(v, axis=0), np.abs(w))
    rods = bodies.rotor_class == ROD
    if rods.any():
        frame = bodies.rotor_frame[:, rods]
        axis = turned(frame, np.array([[0.0], [0.0], [1.0]]) * np.ones(frame.shape[1]))
        p, q = turned(a[:, rods], axis), turned(b[:, rods], axis)
        across = np.linalg.norm(np.cross(p, q, axis=0), axis=0)
        angle[rods] = np.arctan2(across, (p * q).sum(axis=0))
    angle[bodies.rotor_class == POINT] = 0.0
    return np.asarray(angle)
