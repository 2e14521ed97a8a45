"""The fastest oscillation of bodies on springs, by power iteration on M⁻¹ K."""

import math
from collections.abc import Sequence

import numpy as np

from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import rotate, rotate_back


def fastest_frequency(
    inverse: tuple[Floats, Floats],
    q: Floats,
    ends: Sequence[tuple[Ints, Floats]],
    springs: Sequence[Floats],
    iterations: int,
) -> float:
    """Fastest frequency [rad/s]; 0 without springs.

    Rayleigh's quotient u K M⁻¹ K u / u K u never exceeds the true ω².

    Parameters
    ----------
    inverse : tuple of two ndarrays, shapes (n,) [1/kg] and (3, n) [1/(kg m²)]
        Inverse masses, 0 of what is held, and inverse principal moments.
    q : ndarray, shape (4, n)
        Orientations of the rotor frames.
    ends : sequence of two tuples, of arrays (m,) and (3, m) [m]
        Bodies at the first and second end of each spring, n for the world; and where it ends,
        from their centres of mass, world axes.
    springs : sequence of three ndarrays, shapes (3, m), (m,) [N/m], (m,) [N/m]
        Direction of each spring, stiffness along it, and across it.
    iterations : int
        20 come within a few per cent, 60 within one.
    """
    (inv_mass, inv_inertia), (normal, stiffness, shear) = inverse, springs
    n, (first, second) = inv_mass.size, ends
    signed = (*first, -1.0), (*second, 1.0)
    moves = np.append(inv_mass > 0.0, False)  # what is held, and the world, stand still
    v, w = np.random.default_rng(0).standard_normal((2, 3, n + 1)) * moves
    squared = 0.0
    for _ in range(iterations):
        u = sum(
            sign * (v[:, body] + np.cross(w[:, body], arm, axis=0)) for body, arm, sign in signed
        )
        along = normal * (normal * u).sum(axis=0)
        f = stiffness * along + shear * (u - along)
        F, tau = np.zeros_like(v), np.zeros_like(w)
        for body, arm, sign in signed:
            turning = np.cross(arm, f, axis=0)
            for c in range(3):
                F[c] += sign * np.bincount(body, f[c], n + 1)
                tau[c] += sign * np.bincount(body, turning[c], n + 1)
        moved = inv_mass * F[:, :-1]
        spun = rotate(q, inv_inertia * rotate_back(q, tau[:, :-1]))
        numerator = (F[:, :-1] * moved).sum() + (tau[:, :-1] * spun).sum()
        stored = (u * f).sum()
        squared = float(numerator / stored) if stored > 0.0 else 0.0
        size = max(float(np.abs(moved).max()), float(np.abs(spun).max()))
        if not 0.0 < size < np.inf:
            break
        v[:, :-1], w[:, :-1] = moved / size, spun / size
    return math.sqrt(squared)
