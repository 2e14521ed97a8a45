"""The fastest oscillation of bodies on springs, by power iteration on M⁻¹ K."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import cross_columns, rotate, rotate_back


class Oscillating:
    """Bodies whose fastest oscillation is looked for: all are here.

    Parameters
    ----------
    total : callable
        Sum of values of bodies, (n,).
    """

    own: Bools | None = None  # bodies all of whose springs are known here; None: each

    def __init__(self, total: Callable[[Floats], float] = np.sum) -> None:
        self.total = total

    def random(self, n: int) -> Floats:
        """Velocities and spins of n bodies and of the world to begin with, (2, 3, n + 1)."""
        return np.random.default_rng(0).standard_normal((2, 3, n + 1))

    def complete(self, motion: Floats) -> None:
        """Bring velocities and spins (2, 3, n + 1) of bodies that are not own."""

    def largest(self, size: float) -> float:
        """The largest of what is the largest of own bodies."""
        return size


_ALL_HERE = Oscillating()


def _tied(n: int, first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """Bodies, of n, at springs, and the world behind them; and which of these each one is."""
    is_tied = np.zeros(n + 1, dtype=np.bool_)
    is_tied[first] = is_tied[second] = is_tied[n] = True
    return np.flatnonzero(is_tied), np.cumsum(is_tied) - 1


def fastest_frequency(
    inverse: tuple[Floats, Floats],
    q: Floats,
    ends: Sequence[tuple[Ints, Floats]],
    springs: Sequence[Floats],
    iterations: int,
    among: Oscillating = _ALL_HERE,
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
    among : Oscillating
        Who has which of the bodies.
    """
    (inv_mass, inv_inertia), (normal, stiffness, shear) = inverse, springs
    n, (first, arm), (second, other_arm) = inv_mass.size, *ends
    tied, number = _tied(n, first, second)
    bodies, m = tied[:-1], tied.size
    signed = (number[first], arm, -1.0), (number[second], other_arm, 1.0)
    moves = np.append(inv_mass > 0.0, False)  # what is fixed, and the world, stand still
    motion = among.random(n) * moves
    inv_mass, inv_inertia, q = inv_mass[bodies], inv_inertia[:, bodies], q[:, bodies]
    own = slice(None) if among.own is None else np.flatnonzero(among.own[bodies])
    power, stored = np.zeros(n), np.zeros(n)
    for _ in range(iterations):
        v, w = motion[..., tied]
        u = sum(sign * (v[:, at] + cross_columns(w[:, at], arm)) for at, arm, sign in signed)
        along = normal * (normal * u).sum(axis=0)
        f = stiffness * along + shear * (u - along)
        F, tau = np.zeros_like(v), np.zeros_like(w)
        for at, arm, sign in signed:
            turning = cross_columns(arm, f)
            for c in range(3):
                F[c] += sign * np.bincount(at, f[c], m)
                tau[c] += sign * np.bincount(at, turning[c], m)
        moved = inv_mass * F[:, :-1]
        spun = rotate(q, inv_inertia * rotate_back(q, tau[:, :-1]))
        power[bodies] = (F[:, :-1] * moved + tau[:, :-1] * spun).sum(axis=0)
        stored[bodies] = (v * F + w * tau).sum(axis=0)[:-1]
        size = among.largest(float(np.abs([moved[:, own], spun[:, own]]).max(initial=0.0)))
        if not 0.0 < size < np.inf:
            break
        motion[0][:, bodies], motion[1][:, bodies] = moved / size, spun / size
        among.complete(motion)
    all_power, all_stored = among.total(power), among.total(stored)
    return math.sqrt(all_power / all_stored) if all_stored > 0.0 else 0.0
