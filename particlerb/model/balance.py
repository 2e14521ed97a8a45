"""The energy balance: energy and momenta of every frame, less what forces have given since.

total - initial - external is the error of integration alone. It is judged against the largest
kinetic energy, work or gross work of contacts, Σ|p| and Σ|L|, never against a value that may be
zero or, of bodies at rest, is all rounding.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, unfused_kernel
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats
from particlerb.model.bodies import Bodies
from particlerb.model.state import lengths
from particlerb.model.superblocks import Range, summed, superblocks
from particlerb.model.totals import N_TOTALS, far_norm
from particlerb.ranks import ALONE, Ranks

_STILL_ENERGY_SHARE = 1e-20  # share of the energy of a motion that is seen; below it there is none
_BORNE_SHARE = 1e-6  # share of what weights give to momenta; below it something bears them
_KNOWN_SHARE = 1e-8  # of energies, and of weights times distances: sums round below it


class Entries(NamedTuple):
    """The energy balance of some frames; the observables of the file, in this order.

    (T, n_worlds) in place of (T,) for scenes in a batch.
    """

    kinetic_energy: Floats  # (T,) [J]
    potential_energy: Floats  # (T,) [J]
    energy: Floats  # (T,) [J] kinetic and potential
    work: Floats  # (T,) [J] of all that has no place in potential_energy
    energy_error: Floats  # (T,) [J] energy - initial energy - work
    linear_momentum: Floats  # (T, 3) [kg m/s]
    linear_momentum_error: Floats  # (T, 3) [kg m/s] total - initial - external
    angular_momentum: Floats  # (T, 3) [kg m²/s] about the origin of the world
    angular_momentum_error: Floats  # (T, 3) [kg m²/s] total - initial - external


class _Relative(NamedTuple):
    energy: float
    linear_momentum: float
    angular_momentum: float


class ConservationError(_Relative):
    """Largest errors of integration so far, each relative to its scale; of worlds, (n_worlds,)."""

    of_start = math.inf  # largest error of the energy relative to that at the start


@inline
def _larger(a: float, b: float) -> float:
    """The larger; what is no number counts as large."""
    return b if b > a or np.isnan(b) else a


@unfused_kernel
def _enter(
    sums: Floats,
    external: Floats,
    initial: Floats,
    errors: Floats,
    scales: Floats,
    single: Floats,
    vectors: Floats,
) -> None:
    """Fill the entries of some frames, of all worlds one after the other, and widen the largest.

    sums (T, 10), external (T, 7), initial (W, 7); errors and scales (3, W); of the entries the
    numbers (5, T) and the vectors (4, T, 3), in their order.
    """
    for f in range(len(sums)):
        w = f % len(initial)
        now, gained, first = sums[f], external[f], initial[w]
        energy = now[0] + now[1]
        error = energy - first[0] - gained[0]
        single[0, f], single[1, f], single[2, f] = now[0], now[1], energy
        single[3, f], single[4, f] = gained[0], error
        for c in range(3):
            vectors[0, f, c], vectors[2, f, c] = now[2 + c], now[5 + c]
            vectors[1, f, c] = now[2 + c] - first[1 + c] - gained[1 + c]
            vectors[3, f, c] = now[5 + c] - first[4 + c] - gained[4 + c]
        scales[0, w] = _larger(scales[0, w], _larger(now[0], abs(gained[0])))
        scales[1, w], scales[2, w] = _larger(scales[1, w], now[8]), _larger(scales[2, w], now[9])
        errors[0, w] = _larger(errors[0, w], abs(error))
        errors[1, w] = _larger(errors[1, w], far_norm(row3(vectors[1], f)))
        errors[2, w] = _larger(errors[2, w], far_norm(row3(vectors[3], f)))


class EnergyBalance:
    """The balance of a run from its initial totals on."""

    def __init__(self, initial: Floats) -> None:
        self.shape = initial.shape[1:-1]  # of worlds
        sums = initial[0].reshape(-1, N_TOTALS)
        self.initial = sums[:, 1:8].copy()
        self.initial[:, 0] += sums[:, 0]
        self.errors = np.zeros((3, len(sums)))
        self.scales = sums.T[[0, 8, 9]]

    def checkpoint(self) -> dict[str, Floats]:
        """Initial totals, largest errors and scales so far."""
        errors, scales = (values[:, 0].copy() for values in (self.errors, self.scales))
        return {"initial": self.initial[0].copy(), "errors": errors, "scales": scales}

    def restore(self, saved: Mapping[str, Floats]) -> None:
        """Go on from what was saved.

        Raises
        ------
        KeyError, ValueError
            If something is missing, or has another shape.
        """
        sizes = self.initial.shape[1], len(self.errors), len(self.scales)
        if tuple(len(saved[name]) for name in ("initial", "errors", "scales")) != sizes:
            raise ValueError("the energy balance has another size")
        self.initial = saved["initial"][None]
        self.errors, self.scales = saved["errors"][:, None], saved["scales"][:, None]

    def enter(self, now: Floats, external: Floats, gross: Floats | float = 0.0) -> Entries:
        """Entries of some frames.

        Parameters
        ----------
        now : ndarray, shape (T, 10) or (T, n_worlds, 10)
            See `totals`.
        external : ndarray, shape (T, 7) or (T, n_worlds, 7)
        gross : float, or ndarray of shape (n_worlds,) [J]
            Sum of the sizes of all that contacts have taken or given until the last of them: what
            goes in by one wall and out by friction cancels in `external`.
        """
        n = now.size // N_TOTALS
        single, vectors = np.empty((5, n)), np.empty((4, n, 3))
        sums, gains = now.reshape(n, N_TOTALS), external.reshape(n, 7)
        _enter(sums, gains, self.initial, self.errors, self.scales, single, vectors)
        if not isinstance(gross, float) or gross:
            np.maximum(self.scales[0], gross, out=self.scales[0])
        if self.shape:
            by_frame = -1, *self.shape
            single, vectors = single.reshape(5, *by_frame), vectors.reshape(4, *by_frame, 3)
        return Entries(*single, *vectors)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def drift(
        self, bodies: Bodies, com: Floats, duration: float, ranks: Ranks = ALONE, g: float = 0.0
    ) -> ConservationError:
        """Largest errors until now over the largest scales; arguments as of `scales_seen`."""
        given = bodies, com, duration, ranks, g
        relative = self.errors / scales_seen(self.scales, self.initial[:, 0], *given)
        drift = ConservationError(*(relative if self.shape else relative[:, 0]).tolist())
        drift.of_start = float(np.max(self.errors[0] / np.abs(self.initial[:, 0])))
        return drift


def scales_seen(
    scales: Floats,
    energy: Floats,
    bodies: Bodies,
    com: Floats,
    duration: float,
    ranks: Ranks = ALONE,
    g: float = 0.0,
) -> Floats:
    """Scales by which errors are judged, (3, n_worlds), none of them zero.

    Where nothing moves but by rounding, the scales are those of a motion that is seen; where
    momenta are nothing beside what weights give them and what bears them takes, it is that.
    No error is judged finer than the energy at the start, or weights at their distances, round.

    Parameters
    ----------
    scales : ndarray, shape (3, n_worlds)
        Largest kinetic energy or work [J], Σ|p| [kg m/s] and Σ|L| [kg m²/s].
    energy : ndarray, shape (n_worlds,) [J]
        At the start.
    bodies, com
        Constants, and centres of mass (3, n) at the start [m].
    duration : float [s]
        Of the run.
    ranks : Ranks
        Each with bodies of its own.
    g : float [m/s²]
        Size of the acceleration of gravity.
    """
    sizes = _sizes(bodies, com, len(energy))
    reaches = [reach.max(axis=0, initial=0.0) for reach, _ in ranks.gathered(sizes)]
    R = np.max(reaches, axis=0)
    mass = summed(sizes[1], ranks)
    momentum = mass * R / duration
    seen = np.stack([momentum * R / duration, momentum, momentum * R])
    seen[0] += np.abs(energy)
    is_still = scales[0] < _STILL_ENERGY_SHARE * seen[0]
    scales = np.where(is_still, np.maximum(scales, seen), scales)
    weight = mass * g * duration
    scales[1] = np.where(scales[1] < _BORNE_SHARE * weight, weight, scales[1])
    scales[0] = np.maximum(scales[0], _KNOWN_SHARE * np.maximum(np.abs(energy), mass * g * R))
    scales[2] = np.maximum(scales[2], _KNOWN_SHARE * weight * R)
    safe: Floats = np.where(scales > 0.0, scales, 1.0)
    return safe


def _sizes(bodies: Bodies, com: Floats, n_worlds: int) -> Floats:
    """Reach R and mass M of each superblock, (2, S, n_worlds); M R²/T², M R/T, M R²/T are seen.

    R: largest distance of a body from the origin and its radius of gyration; T: a time.
    """
    reach = lengths(com) + np.sqrt(bodies.inertia.max(axis=0) * bodies.inv_mass)
    n = reach.size
    ranges = [Range(0, n)] if n_worlds > 1 else superblocks(n)
    sizes = np.empty((2, len(ranges), n_worlds))
    for k, span in enumerate(ranges):
        sizes[0, k] = reach[slice(*span)].reshape(n_worlds, -1).max(axis=1)
        sizes[1, k] = bodies.mass[slice(*span)].reshape(n_worlds, -1).sum(axis=1)
    return sizes
