"""How far states lie apart, as users judge it: angles between orientations, sizes of bodies.

The angle is that of the rotation from one orientation to the other, which is accurate for tiny
angles. Rods compare their axes, points nothing.
"""

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
from particlerb.model.state import rotate
from particlerb.rotors.rotor_class import POINT, ROD


def _lengths(v: Floats) -> Floats:
    """|v| of the vectors (T, n, k), (T, n)."""
    return np.asarray(np.sqrt(np.einsum("tnk,tnk->tn", v, v)))


def _chords(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Lengths of |b| a - |a| b and |b| a + |a| b, as sin and cos of half the angle between them.

    Source: Kahan, How futile are mindless assessments of roundoff, 2006, section 12.
    """
    a, b = a * _lengths(b)[..., None], b * _lengths(a)[..., None]
    return _lengths(a - b), _lengths(a + b)


def _axes(bodies: Bodies, q: Floats) -> Floats:
    """Symmetry axes in the world, (..., T, n, 3), of orientations (..., T, n, 4)."""
    axis = rotate(bodies.rotor_frame, np.array([[0.0], [0.0], [1.0]]))
    return np.moveaxis(rotate(np.moveaxis(q, -1, 0), axis[:, None, None]), 0, -1)


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
    near, far = _chords(q, r)
    angle = 4.0 * np.arctan2(np.minimum(near, far), np.maximum(near, far))
    is_rod = bodies.rotor_class == ROD
    if is_rod.any():
        turned = 2.0 * np.arctan2(*_chords(*_axes(bodies, np.stack([q, r]))))
        angle[:, is_rod] = turned[:, is_rod]
    angle[:, bodies.rotor_class == POINT] = 0.0
    return angle, _lengths(y - x)


def angles(bodies: Bodies, expected: Floats, actual: Floats) -> Floats:
    """Angles between orientations (n, 4) of n bodies, (n,) [rad]; as `misfits`."""
    at_rest = np.zeros((1, len(expected), 3))
    (angle,), _ = misfits(bodies, at_rest, expected[None], at_rest, actual[None])
    return np.asarray(angle)
