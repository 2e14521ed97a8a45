"""Free rotation over one step by the preprocessed discrete Moser-Veselov map, order 8.

The map keeps energy and angular momentum to rounding. As it stands it has order 2; with the inertia
tensor replaced by one that depends on the constants of motion and the step it follows the true
motion to order 8: 1/I_k becomes s/I_k + d, with polynomials s and d in half the squared momentum N
and the energy H, both in units of the step. Because s and d depend on N and H, the map is
symplectic up to its order only. The rotation over the step is the quaternion (1, x, y, z)
normalised, where

    x = (1 + x² + y² + z²) u₁ + f₁ y z   and cyclic,   u = ½ h m b, f₁ = (I₂ - I₃)/I₁

with the modified inertia 1/b. Newton's method solves it in two to four steps while a map turns by
less than 0.8 rad; a fixed point, as is usual, takes up to forty and stops converging soon after.
Longer turns are cut into pieces, and so are the longest drifts of a step: their error, of the
eighth power of the turn, would be that of the step (docs/decisions/0016).

Source: Moser and Veselov, Commun. Math. Phys. 139, 217 (1991); Hairer and Vilmart, J. Phys. A 39,
13225 (2006), for the modified inertia up to order 8.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.maths.vec3 import Floats, Vec3, add_scaled, component_product, cross, dot, scale

Cubic: TypeAlias = tuple[Vec3, Vec3, Vec3]  # coefficients of N, H, N², NH, H², N³, N²H, NH², H³
LONGEST_PIECE: Final = 0.8  # rad that one map may turn
LARGEST_SHARE: Final = 0.3  # of the turn of a whole step that one map may turn
MOST_PIECES: Final = 64  # a drift that turns further says nothing any more


def modified_inertia(inv_inertia: Floats) -> Floats:
    """Coefficients of the modified inertia, for bodies whose moments are all positive.

    Parameters
    ----------
    inv_inertia : ndarray, shape (3, n) [1/(kg m²)]

    Returns
    -------
    ndarray, shape (22, n)
        1/I in units of that of axis 1, that unit, and nine coefficients each of s and d.
    """
    n = inv_inertia.shape[1]
    if n == 0 or (inv_inertia != inv_inertia[:, :1]).any():
        return np.array(_coefficients(*inv_inertia))
    coefficients = _coefficients(*inv_inertia[:, 0].tolist())  # numbers are faster than arrays
    return np.array(coefficients)[:, None].repeat(n, axis=1)


def _coefficients(x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """The same from three rows of inverse moments, or numbers, to the same bits."""
    a = x / x, y / x, z / x
    I = tuple(1.0 / one for one in a)  # noqa: E741
    aa, II = tuple(one * one for one in a), tuple(one * one for one in I)
    Ia = sum(p * q for p, q in zip(I, a, strict=True))
    a1, a2, a3 = sum(a), sum(aa), sum(p * q for p, q in zip(a, aa, strict=True))
    I1, I2, I3 = sum(I), sum(II), sum(p * q for p, q in zip(I, II, strict=True))
    x11 = I1 * a1 - Ia  # sums of I_p^j a_q^k over p ≠ q
    x12 = I1 * a2 - sum(p * q for p, q in zip(I, aa, strict=True))
    x21 = I2 * a1 - sum(p * q for p, q in zip(II, a, strict=True))
    d = a[0] * a[1] * a[2]
    dd, e = d * d, 1.0 / d
    s = (
        I1 * d / 6,
        -a1 / 3,
        (I2 * d - a1) * d / 30,
        (1 - x11) * d / 30,
        (3 * I1 * d + 2 * a2) / 60,
        (4 * e + 17 * I3 - 15 * e * x11) * d * dd / 2520,
        (9 * I1 + 10 * e * a2 - 6 * x21) * dd / 420,
        ((6 * x12 - 100 * a1) * e + 53 * I2) * dd / 2520,
        (15 - e * a3 - 2 * x11) * d / 630,
    )
    added = (
        -d / 3,
        I1 * d / 6,
        -I1 * dd / 60,
        a1 * d / 10 - I2 * dd / 60,
        -(9 + x11) * d / 60,
        (34 * e * a1 - 19 * I2) * d * dd / 2520,
        (I3 + 2 * e * x11 - 85 * e) * d * dd / 1260,
        (47 * I1 + 13 * x21 - 38 * e * a2) * dd / 2520,
        (9 * e * a1 + e * x12 - 11 * I2) * dd / 1260,
    )
    return (*a, x, *s, *added)


@inline
def polynomial(c: Cubic, N: float, H: float) -> float:
    """Polynomial of degree 3 in N and H without its constant."""
    of_N = N * (c[0][0] + N * (c[0][2] + N * c[1][2]))
    of_H = c[0][1] + N * (c[1][0] + N * c[2][0]) + H * (c[1][1] + N * c[2][1] + H * c[2][2])
    return of_N + H * of_H


@inline
def pieces_of(turn: float, share: float) -> int:
    """Number of maps for a drift that turns by so many radians, and takes this share of a step."""
    return min(max(int(turn / LONGEST_PIECE), int(share / LARGEST_SHARE)) + 1, MOST_PIECES)


def cost_of_maps(
    least: float, drifts: Sequence[float], largest_share: float = math.inf
) -> Callable[[float], float]:
    """Cost of an asymmetric body over that of others, from its turn in a step [rad], about.

    It is `least` with one map for each of these drifts; no map takes more than a share of the step.
    """

    @lru_cache
    def cost(turn: float) -> float:
        largest = max(turn / LONGEST_PIECE, 1.0 / largest_share)
        return least * sum(max(1.0, abs(share) * largest) for share in drifts) / len(drifts)

    return cost


@inline
def iterations_of(turn: float) -> int:
    """Newton steps from the first guess to rounding, for a map that turns by so many radians.

    Enough for all of 20 000 random bodies, needles and discs among them.
    """
    if turn < 0.08:
        return 2
    return 3 if turn < 0.45 else 4


@inline
def first_guess(m: Vec3, a: Vec3, s: Cubic, d: Cubic) -> tuple[Vec3, Vec3, Vec3]:
    """u, f and a first guess of (x, y, z); m and a are h m/I₁ and I₁/I, without dimension."""
    N, H = 0.5 * dot(m, m), 0.5 * dot(m, component_product(a, m))
    size, added = 1.0 + polynomial(s, N, H), polynomial(d, N, H)
    b = (size * a[0] + added, size * a[1] + added, size * a[2] + added)
    inverse = 1.0 / (b[0] * b[1] * b[2])
    u = scale(0.5, component_product(m, b))
    f = (
        (b[2] - b[1]) * (b[0] * b[0]) * inverse,
        (b[0] - b[2]) * (b[1] * b[1]) * inverse,
        (b[1] - b[0]) * (b[2] * b[2]) * inverse,
    )
    x = u[0] + f[0] * u[1] * u[2]
    y = u[1] + f[1] * x * u[2]
    return u, f, (x, y, u[2] + f[2] * x * y)


@inline
def newton(u: Vec3, f: Vec3, v: Vec3) -> Vec3:
    """One Newton step towards (x, y, z)."""
    x, y, z = v
    size = 1.0 + dot(v, v)
    g = (
        x - size * u[0] - f[0] * (y * z),
        y - size * u[1] - f[1] * (x * z),
        z - size * u[2] - f[2] * (x * y),
    )
    x2, y2, z2 = x + x, y + y, z + z
    r0 = (1.0 - x2 * u[0], -y2 * u[0] - f[0] * z, -z2 * u[0] - f[0] * y)
    r1 = (-x2 * u[1] - f[1] * z, 1.0 - y2 * u[1], -z2 * u[1] - f[1] * x)
    r2 = (-x2 * u[2] - f[2] * y, -y2 * u[2] - f[2] * x, 1.0 - z2 * u[2])
    c0, c1, c2 = cross(r1, r2), cross(r2, r0), cross(r0, r1)
    change = add_scaled(g[2], c2, add_scaled(g[1], c1, scale(g[0], c0)))
    return add_scaled(-1.0 / dot(r0, c0), change, v)
