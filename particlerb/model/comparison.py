"""How far states lie apart, as users judge it: angles between orientations, sizes of bodies.

The angle is that of the rotation from one orientation to the other, which is accurate for tiny
angles. Rods compare their axes, points nothing.
"""

from typing import Any

import numpy as np

from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
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


def _pairs(q: Floats) -> tuple[Any, Any]:
    """w + i z and x + i y of quaternions (..., 4): a product of two is made of four of complex."""
    pairs = np.take(q, [0, 3, 1, 2], axis=-1).view(np.complex128)
    return pairs[..., 0], pairs[..., 1]


def _between_axes(bodies: Bodies, q: Floats, r: Floats) -> Floats:
    """Angles between axes, (T, n) [rad]: w + i z of a* b keeps an axis, x + i y turns it."""
    (f, g), (c, d) = _pairs(bodies.rotor_frame.T), _pairs(np.stack([q, r]))
    (a, b), (u, v) = c * f - d * g.conj(), c * g + d * f.conj()
    kept, left = a.conj() * b + u * v.conj(), a.conj() * v - u * b.conj()
    return np.asarray(2.0 * np.arctan2(abs(left), abs(kept)))


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
        angle[:, is_rod] = _between_axes(bodies, q, r)[:, is_rod]
    angle[:, bodies.rotor_class == POINT] = 0.0
    return angle, _lengths(y - x)


def angles(bodies: Bodies, expected: Floats, actual: Floats) -> Floats:
    """Angles between orientations (n, 4) of n bodies, (n,) [rad]; as `misfits`."""
    at_rest = np.zeros((1, len(expected), 3))
    (angle,), _ = misfits(bodies, at_rest, expected[None], at_rest, actual[None])
    return np.asarray(angle)
