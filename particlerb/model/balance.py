"""The energy balance: energy and momenta of every frame, less what forces have given since.

total - initial - booked is the error of integration alone. It is judged against the largest
kinetic energy, work or gross work of contacts, Σ|p| and Σ|L|, never against a value that may be
zero or, of bodies at rest, is all rounding.
Sums run over fixed blocks of bodies in a fixed order, and over superblocks of these: the same bits
for any number of threads and ranks.
"""

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.maths.quaternion import Rows4, load4, rows4, to_body
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Rows3,
    Vec3,
    add_scaled,
    cross,
    dot,
    load3,
    rows3,
    scale,
    store3,
)
from particlerb.model.bodies import Bodies
from particlerb.model.state import Frames, lengths
from particlerb.model.superblocks import Range, summed, superblocks
from particlerb.ranks import ALONE, Ranks

_N_TOTALS = 10
_STILL = 1e-20  # share of the energy of a motion that is seen; below it there is none
_NEAR = 1e-6  # share of |x| |p| that an angular momentum is never judged below: x × p rounds


class Totals(NamedTuple):
    """Sums over all bodies, per frame; (T, n_worlds) in place of (T,) for scenes in a batch."""

    kinetic_energy: Floats  # (T,) [J]
    potential_energy: Floats  # (T,) [J] of gravity, attraction, springs, contacts, piston loads
    linear_momentum: Floats  # (T, 3) [kg m/s]
    angular_momentum: Floats  # (T, 3) [kg m²/s], about the origin of the world
    momentum_size: Floats  # (T,) Σ|p| [kg m/s]
    spin_size: Floats  # (T,) Σ|L| of the bodies and of their centres of mass [kg m²/s]


@inline
def _load_rows(frames: Frames, f: int, lo: int, mass: Floats, local: Floats, n: int) -> None:
    """Copy x, p, L, q of n bodies of a frame into rows, so that what follows fills SIMD lanes.

    Momenta of bodies without mass, which are held, do not count.
    """
    position, orientation, linear, angular, _, _ = frames
    for b in range(n):
        is_free = mass[lo + b] > 0.0
        for c in range(3):
            local[c, b] = position[f, lo + b, c]
            local[3 + c, b] = linear[f, lo + b, c] if is_free else 0.0
            local[6 + c, b] = angular[f, lo + b, c] if is_free else 0.0
        for c in range(4):
            local[9 + c, b] = orientation[f, lo + b, c]


@inline
def _momenta_rows(
    x: Rows3, p: Rows3, L: Rows3, mass: Floats, inv_mass: Floats, g: Vec3, out: Floats
) -> None:
    """½ p²/M, -M g·x, x × p + L, |p|, |x × p| + |L| of each body, into rows 0, 1, 5..9."""
    n = mass.size
    kinetic, potential, H = out[0, :n], out[1, :n], rows3(out[5:8], 0, n)
    size, spin = out[8, :n], out[9, :n]
    for b in range(n):
        x_b, p_b, L_b = load3(x, b), load3(p, b), load3(L, b)
        orbit = cross(x_b, p_b)
        kinetic[b] = 0.5 * dot(p_b, scale(inv_mass[b], p_b))
        potential[b] = -mass[b] * dot(g, x_b)
        store3(H, b, add_scaled(1.0, orbit, L_b))
        size[b] = np.sqrt(dot(p_b, p_b))
        reach = _NEAR * np.sqrt(dot(x_b, x_b) * dot(p_b, p_b))  # straight through the origin
        spin[b] = np.sqrt(dot(L_b, L_b)) + np.sqrt(dot(orbit, orbit)) + reach


@inline
def _add_turning(q: Rows4, L: Rows3, frame: Rows4, inverse: Rows3, kinetic: Floats) -> None:
    """Add ½ Σ m_k² / I_k of each body, with m = L in the rotor frame."""
    for b in range(kinetic.size):
        m = to_body(load4(frame, b), to_body(load4(q, b), load3(L, b)))
        w = load3(inverse, b)
        kinetic[b] += 0.5 * (m[0] * (w[0] * m[0]) + m[1] * (w[1] * m[1]) + m[2] * (w[2] * m[2]))


@kernel
def _sum_blocks(
    frames: Frames,
    bodies: Bodies,
    gravity: Floats,
    bins: Ints | None,
    sums: Floats,
    first: int,
    last: int,
) -> None:
    """Add some blocks of bodies, for all frames, to sums (T, bins, 10): those of the bodies' bins.

    Without bins each block is one.
    """
    mass, inv_mass, _, inv_inertia, rotor_frame, _ = bodies
    g = (gravity[0], gravity[1], gravity[2])
    local, out = np.empty((13, BLOCK)), np.empty((_N_TOTALS, BLOCK))
    for k in range(first, last):
        lo, hi = k * BLOCK, min(k * BLOCK + BLOCK, mass.size)
        n = hi - lo
        x, p, L = rows3(local[0:3], 0, n), rows3(local[3:6], 0, n), rows3(local[6:9], 0, n)
        q, frame = rows4(local[9:13], 0, n), rows4(rotor_frame, lo, hi)
        for f in range(sums.shape[0]):
            _load_rows(frames, f, lo, mass, local, n)
            _momenta_rows(x, p, L, mass[lo:hi], inv_mass[lo:hi], g, out)
            _add_turning(q, L, frame, rows3(inv_inertia, lo, hi), out[0, :n])
            for c in range(3):
                for b in range(n):
                    out[2 + c, b] = local[3 + c, b]
            for b in range(n):
                bin_of_body = k if bins is None else bins[lo + b]
                for c in range(_N_TOTALS):
                    sums[f, bin_of_body, c] += out[c, b]


def totals(
    frames: Frames,
    bodies: Bodies,
    gravity: Floats,
    potential: Floats | float = 0.0,
    kinetic: Floats | float = 0.0,
    n_worlds: int = 1,
    ranks: Ranks = ALONE,
) -> Totals:
    """Totals of frames.

    Parameters
    ----------
    frames, bodies : Frames, Bodies
        States and constants.
    gravity : ndarray, shape (3,)
        Its acceleration [m/s²].
    potential : ndarray, shape (T,)
        Potential energy of springs, of forces between bodies, and of loads on pistons [J].
    kinetic : ndarray, shape (T,)
        Kinetic energy of pistons [J].
    n_worlds : int
        Scenes that the bodies are of, one after the other, with as many each; on one thread.
    ranks : Ranks
        Each with bodies of its own.
    """
    n, n_frames = bodies.mass.size, len(frames.position)
    n_blocks, in_each = -(-n // BLOCK), -(-(n // n_worlds) // BLOCK)
    if n_worlds == 1:
        blocks = np.zeros((n_frames, n_blocks, _N_TOTALS))
        add_up = partial(_sum_blocks, frames, bodies, gravity, None, blocks)
        THREADS.share(add_up, n_blocks, n * n_frames)
        each = [slice(of.first // BLOCK, -(-of.stop // BLOCK)) for of in superblocks(n)]
        sums = np.stack([np.add.reduce(blocks[:, own], axis=1) for own in each])
    else:
        blocks = np.zeros((n_frames, n_worlds * in_each, _N_TOTALS))
        world, b = np.divmod(np.arange(n), n // n_worlds)
        _sum_blocks(frames, bodies, gravity, in_each * world + b // BLOCK, blocks, 0, n_blocks)
        sums = blocks.reshape(n_frames, n_worlds, in_each, _N_TOTALS)
        sums = (sums[:, :, 0] if in_each == 1 else sums.sum(axis=2))[None]
    sums = summed(sums, ranks)
    return Totals(
        sums[..., 0] + kinetic,
        sums[..., 1] + potential,
        sums[..., 2:5],
        sums[..., 5:8],
        sums[..., 8],
        sums[..., 9],
    )


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
    linear_momentum_error: Floats  # (T, 3) [kg m/s] total - initial - booked
    angular_momentum: Floats  # (T, 3) [kg m²/s] about the origin of the world
    angular_momentum_error: Floats  # (T, 3) [kg m²/s] total - initial - booked


class ConservationError(NamedTuple):
    """Largest errors of integration so far, each relative to its scale; of worlds, (n_worlds,)."""

    energy: float
    linear_momentum: float
    angular_momentum: float


def _largest(values: Floats) -> Any:
    """Largest over the frames, (T, ...), and at least 0."""
    return np.maximum.reduce(values, axis=0, initial=0.0)


def _grown(largest: Floats, *values: Any) -> Floats:
    """The larger of each row and a value; NumPy is slow with a tuple of them."""
    now = np.empty_like(largest)
    for k, value in enumerate(values):
        now[k] = value
    return np.maximum(largest, now, out=now)


def _squared(values: Floats) -> Floats:
    """Squares of vectors (..., 3); a sum over so short an axis is slow."""
    squares = values * values
    return np.asarray(squares[..., 0] + squares[..., 1] + squares[..., 2])


class EnergyBalance:
    """Books a run from its initial totals on."""

    def __init__(self, initial: Totals) -> None:
        self.energy = np.asarray(initial.kinetic_energy[0] + initial.potential_energy[0])
        self.linear = initial.linear_momentum[0].copy()
        self.angular = initial.angular_momentum[0].copy()
        self.errors = np.zeros((3, *self.energy.shape))  # a column for each world
        self.scales = np.zeros((3, *self.energy.shape))
        self.widen(initial, np.zeros(1), 0.0)

    def checkpoint(self) -> dict[str, Floats]:
        """Initial totals, largest errors and scales so far."""
        initial = np.array([float(self.energy), *self.linear, *self.angular])
        return {"initial": initial, "errors": self.errors.copy(), "scales": self.scales.copy()}

    def restore(self, saved: Mapping[str, Floats]) -> None:
        """Go on from what was saved."""
        initial = saved["initial"]
        self.energy, (self.linear, self.angular) = initial[0], np.split(initial[1:7], 2)
        self.errors, self.scales = saved["errors"], saved["scales"]

    def widen(self, now: Totals, work: Floats, gross: Floats | float) -> None:
        """Let the scales grow with what is turned over."""
        energies = _largest(np.maximum(now.kinetic_energy, np.abs(work)))
        energies = np.maximum(energies, gross)
        sizes = _largest(now.momentum_size), _largest(now.spin_size)
        self.scales = _grown(self.scales, energies, *sizes)

    def enter(self, now: Totals, booked: Floats, gross: Floats | float = 0.0) -> Entries:
        """Entries of some frames.

        Parameters
        ----------
        now : Totals
        booked : ndarray, shape (T, 7) or (T, n_worlds, 7)
        gross : float, or ndarray of shape (n_worlds,) [J]
            Sum of the sizes of all that contacts have taken or given until the last of them: what
            goes in by one wall and out by friction cancels in `booked`.
        """
        work = booked[..., 0]
        energy = now.kinetic_energy + now.potential_energy
        entries = Entries(
            now.kinetic_energy,
            now.potential_energy,
            energy,
            work,
            energy - self.energy - work,
            now.linear_momentum,
            now.linear_momentum - self.linear - booked[..., 1:4],
            now.angular_momentum,
            now.angular_momentum - self.angular - booked[..., 4:7],
        )
        self.widen(now, work, gross)
        linear, angular = entries.linear_momentum_error, entries.angular_momentum_error
        self.errors = _grown(
            self.errors,
            _largest(np.abs(entries.energy_error)),
            np.sqrt(_largest(_squared(linear))),
            np.sqrt(_largest(_squared(angular))),
        )
        return entries

    def drift(
        self, bodies: Bodies, com: Floats, duration: float, ranks: Ranks = ALONE
    ) -> ConservationError:
        """Largest errors until now over the largest scales.

        Where nothing moves but by rounding, the scales are those of a motion that is seen.

        Parameters
        ----------
        bodies, com
            Constants, and centres of mass (3, n) at the start [m].
        duration : float [s]
            Of the run.
        ranks : Ranks
            Each with bodies of its own.
        """
        sizes = _sizes(bodies, com, self.energy.size)
        R = np.max([of_rank[0].max(axis=0) for of_rank in ranks.gathered(sizes)], axis=0)
        momentum = summed(sizes[1], ranks) * R / duration
        seen = np.stack([momentum * R / duration, momentum, momentum * R])
        seen = seen.reshape(self.scales.shape)
        seen[0] += np.abs(self.energy)
        is_still = self.scales[0] < _STILL * seen[0]
        scales = np.where(is_still, np.maximum(self.scales, seen), self.scales)
        safe: Floats = np.where(scales > 0.0, scales, 1.0)
        return ConservationError(*(self.errors / safe).tolist())


def _sizes(bodies: Bodies, com: Floats, n_worlds: int) -> Floats:
    """Reach R and mass M of each superblock, (2, S, n_worlds); M R²/T², M R/T, M R²/T are seen.

    R: largest distance of a body from the origin and its radius of gyration; T: a time.
    """
    reach = lengths(com) + np.sqrt(bodies.inertia.max(axis=0) * bodies.inv_mass)
    n = reach.size
    ranges = [Range(0, n)] if n_worlds > 1 else list(superblocks(n))
    each = [[v[slice(*own)].reshape(n_worlds, -1) for own in ranges] for v in (reach, bodies.mass)]
    return np.stack([[of.max(axis=1) for of in each[0]], [of.sum(axis=1) for of in each[1]]])
