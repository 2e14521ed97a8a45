"""How fast bodies that attract each other would go round: an estimate for steps."""

import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import THREADS
from particlerb.forces.attraction import TILE, inverse_cube, squared
from particlerb.maths.rows import column3, rows3
from particlerb.maths.vec3 import Floats, Ints, subtract


@kernel
def _raise_squared_rates(
    gm_body: Floats, com: Floats, softening: float, indices: Ints, chosen: Floats, squares: Floats
) -> None:
    """Raise `squares` to max_b (G M_a + G M_b)/(d² + ε²)^{3/2} [1/s²] of the chosen bodies a.

    Parameters
    ----------
    gm_body, com, softening, indices
        As for `fastest_rates`.
    chosen : ndarray, shape (4, n) [m, m³/s²]
        Centre of mass and G times mass of the chosen bodies: they fill the lanes.
    squares : ndarray, shape (n,) [1/s²]
    """
    coms = rows3(com, 0, gm_body.size)
    for lo in range(0, indices.size, TILE):
        hi = min(lo + TILE, indices.size)
        targets, gms = rows3(chosen, lo, hi), chosen[3, lo:hi]
        bodies, best = indices[lo:hi], squares[lo:hi]
        for b in range(gm_body.size):
            x, gm = column3(coms, b), gm_body[b]
            for i in range(hi - lo):
                is_own = bodies[i] == b
                square = squared(subtract(x, column3(targets, i)), softening)
                value = inverse_cube(gm + gms[i], 1.0 if is_own else square)
                value = 0.0 if is_own else value
                best[i] = value if value > best[i] else best[i]


def fastest_rates(gm_body: Floats, com: Floats, softening: float, indices: Ints) -> Floats:
    """Fastest rate at which each chosen body would go round another one: an estimate.

    max_b √(G (M_a + M_b)/(d² + ε²)^{3/2}) with the distance d of the centres of mass; another one
    at no distance, and without softening, is left out.

    Parameters
    ----------
    gm_body : ndarray, shape (n_bodies,) [m³/s²]
        G times the mass of each body.
    com : ndarray, shape (3, n_bodies) [m]
        World frame.
    softening : float [m²]
        ε².
    indices : ndarray, shape (n,)
        The chosen bodies.

    Returns
    -------
    ndarray, shape (n,) [rad/s]
        Zero where there is no other body.
    """
    chosen = np.ascontiguousarray(np.vstack([com[:, indices], gm_body[indices]]))
    squares = np.zeros(indices.size)
    THREADS.alone(_raise_squared_rates, gm_body, com, softening, indices, chosen, squares)
    return np.sqrt(squares)
