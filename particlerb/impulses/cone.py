"""Coulomb's cone: the exact impulse of one contact alone, and the nearest point of the cone.

With u = b + W r and the normal velocity not below a least one, a contact is open (r = 0), sticks
(u = 0), or slides, r_t = -s⁻¹ u_t with |r_t| = μ r_n. In tangents for which the Schur complement S
is diagonal, r_t(s) = -(S + s)⁻¹ c with c = b_t - W_tn b_n / W_nn: one equation for s >= 0.
"""

import math
from typing import Final

from particlerb.compiled.jit import inline
from particlerb.impulses import records as col
from particlerb.maths.vec3 import ZERO, Floats, Vec3

_MAX_ITERATIONS: Final = 40  # of Newton's method and of halving
_SCALE_TOLERANCE: Final = 1e-14  # relative change of s at which the equation is solved


@inline
def impulse_alone(frame: Floats, k: int, u: Vec3, least: float) -> Vec3:
    """Impulse [N s] along n, t₁, t₂ of contact k if nothing else acts.

    Parameters
    ----------
    frame, k
        Rows of contacts, and which.
    u : tuple of 3 floats [m/s]
        Velocity without the impulse.
    least : float [m/s]
        Normal velocity that is asked for.
    """
    w, mu = frame[k, col.INVERSE], frame[k, col.FRICTION]
    a1, a2 = frame[k, col.COUPLING], frame[k, col.COUPLING + 1]
    s1, s2 = frame[k, col.SCHUR], frame[k, col.SCHUR + 1]
    b = u[0] - least
    if b >= 0.0:
        return ZERO
    c1, c2 = u[1] - a1 * b / w, u[2] - a2 * b / w
    x1, x2 = -c1 / s1, -c2 / s2
    n = -(b + a1 * x1 + a2 * x2) / w
    if n >= 0.0 and x1 * x1 + x2 * x2 <= mu * mu * n * n:
        return n, x1, x2
    if mu == 0.0:
        return -b / w, 0.0, 0.0
    s = _slide(frame, k, b, c1, c2)
    x1, x2 = -c1 / (s1 + s), -c2 / (s2 + s)
    n = max(-(b + a1 * x1 + a2 * x2) / w, 0.0)
    shorter = mu * n / max(math.sqrt(x1 * x1 + x2 * x2), 1e-300)
    return n, shorter * x1, shorter * x2


@inline
def _slide(frame: Floats, k: int, b: float, c1: float, c2: float) -> float:
    """s [1/kg] of a contact that slides: Newton on 1/|r_t| - 1/(μ r_n), kept in a bracket."""
    w, mu = frame[k, col.INVERSE], frame[k, col.FRICTION]
    a1, a2 = frame[k, col.COUPLING], frame[k, col.COUPLING + 1]
    s1, s2 = frame[k, col.SCHUR], frame[k, col.SCHUR + 1]
    mean, c = 0.5 * (s1 + s2), math.sqrt(c1 * c1 + c2 * c2)
    s: float
    s, low, high = max(-c * w / (mu * b) - mean, 0.0), 0.0, math.inf
    for _ in range(_MAX_ITERATIONS):
        d1, d2 = 1.0 / (s1 + s), 1.0 / (s2 + s)
        x1, x2 = -c1 * d1, -c2 * d2
        n = -(b + a1 * x1 + a2 * x2) / w
        t = math.sqrt(x1 * x1 + x2 * x2)
        if n <= 0.0 or t > mu * n:
            low = s
        else:
            high = s
        nearer = -1.0
        if n > 0.0:
            slope = (x1 * x1 * d1 + x2 * x2 * d2) / (t * t * t)
            slope -= (a1 * x1 * d1 + a2 * x2 * d2) / (w * mu * n * n)
            nearer = s - (1.0 / t - 1.0 / (mu * n)) / slope
        if not low < nearer < high:
            nearer = 2.0 * s + mean if high == math.inf else 0.5 * (low + high)
        if abs(nearer - s) <= _SCALE_TOLERANCE * (s + mean):
            break
        s = nearer
    return s


@inline
def nearest_in_cone(n: float, x: float, y: float, mu: float) -> Vec3:
    """Point of the cone |r_t| <= μ r_n nearest to (n, x, y)."""
    t = math.sqrt(x * x + y * y)
    if mu * t <= -n:
        return ZERO
    if t <= mu * n:
        return n, x, y
    height = (n + mu * t) / (1.0 + mu * mu)
    shorter = mu * height / max(t, 1e-300)
    return height, shorter * x, shorter * y


@inline
def on_disc(x: float, y: float, radius: float) -> tuple[float, float]:
    """Nearest point within a disc."""
    length = math.sqrt(x * x + y * y)
    if length <= radius:
        return x, y
    return x * (radius / length), y * (radius / length)
