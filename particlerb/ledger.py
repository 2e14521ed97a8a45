"""The ledger: energy and momenta of every frame, and what is left when the booked is taken away.

total - initial - booked is the error of integration alone. It is judged against the largest
kinetic energy or energy turned over, Σ|p| and Σ|L|, never against a value that may be zero.
Sums run over fixed blocks of bodies in a fixed order: the same bits for any number of threads.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from particlerb._jit import kernel
from particlerb.bodies.bodies import Bodies
from particlerb.bodies.state import Frames
from particlerb.maths.quaternion import load4, rows4, to_body
from particlerb.maths.vec3 import Floats, cross, dot, load3, rows3, scale
from particlerb.threads import BLOCK, THREADS

N_TOTALS = 10


class Totals(NamedTuple):
    """Sums over all bodies, per frame."""

    kinetic_energy: Floats  # (T,) [J]
    potential_energy: Floats  # (T,) [J] of uniform gravity, zero at the origin
    linear_momentum: Floats  # (T, 3) [kg m/s]
    angular_momentum: Floats  # (T, 3) [kg m²/s], about the origin of the world
    momentum_size: Floats  # (T,) Σ|p| [kg m/s]
    spin_size: Floats  # (T,) Σ|L| of the bodies and of their centres of mass [kg m²/s]


@kernel
def sum_blocks(
    frames: Frames, bodies: Bodies, gravity: Floats, sums: Floats, first: int, last: int
) -> None:
    """Sums over some blocks of bodies, for all frames, into sums (T, blocks, 10)."""
    position, orientation, linear, angular, _, _ = frames
    mass, inv_mass, _, inv_inertia, rotor_frame, _ = bodies
    n = mass.size
    g = (gravity[0], gravity[1], gravity[2])
    inverse, frame = rows3(inv_inertia, 0, n), rows4(rotor_frame, 0, n)
    for f in range(sums.shape[0]):
        for k in range(first, last):
            kinetic = potential = size = spin = 0.0
            P = (0.0, 0.0, 0.0)
            H = (0.0, 0.0, 0.0)
            for b in range(k * BLOCK, min((k + 1) * BLOCK, n)):
                x = (position[f, b, 0], position[f, b, 1], position[f, b, 2])
                p = (linear[f, b, 0], linear[f, b, 1], linear[f, b, 2])
                L = (angular[f, b, 0], angular[f, b, 1], angular[f, b, 2])
                q = (
                    orientation[f, b, 0],
                    orientation[f, b, 1],
                    orientation[f, b, 2],
                    orientation[f, b, 3],
                )
                m = to_body(load4(frame, b), to_body(q, L))
                w = load3(inverse, b)
                omega = (w[0] * m[0], w[1] * m[1], w[2] * m[2])
                kinetic += 0.5 * (dot(p, scale(inv_mass[b], p)) + dot(m, omega))
                potential -= mass[b] * dot(g, x)
                orbit = cross(x, p)
                P = (P[0] + p[0], P[1] + p[1], P[2] + p[2])
                H = (H[0] + orbit[0] + L[0], H[1] + orbit[1] + L[1], H[2] + orbit[2] + L[2])
                size += np.sqrt(dot(p, p))
                spin += np.sqrt(dot(L, L)) + np.sqrt(dot(orbit, orbit))
            block = (kinetic, potential, P[0], P[1], P[2], H[0], H[1], H[2], size, spin)
            for c in range(N_TOTALS):
                sums[f, k, c] = block[c]


def totals(frames: Frames, bodies: Bodies, gravity: Floats) -> Totals:
    """Totals of frames; gravity is the acceleration (3,) [m/s²]."""
    n, n_frames = bodies.mass.size, len(frames.position)
    blocks = np.empty((n_frames, -(-n // BLOCK), N_TOTALS))
    THREADS.spread(partial(sum_blocks, frames, bodies, gravity, blocks), n, n * n_frames)
    sums = blocks.sum(axis=1)
    return Totals(sums[:, 0], sums[:, 1], sums[:, 2:5], sums[:, 5:8], sums[:, 8], sums[:, 9])


class Entries(NamedTuple):
    """What the ledger says of some frames; the observables of the file, in this order."""

    kinetic_energy: Floats  # (T,) [J]
    potential_energy: Floats  # (T,) [J]
    energy: Floats  # (T,) [J] kinetic and potential
    work: Floats  # (T,) [J] booked by forces and impulses other than gravity
    energy_error: Floats  # (T,) [J] energy - initial energy - work
    linear_momentum: Floats  # (T, 3) [kg m/s]
    linear_momentum_error: Floats  # (T, 3) [kg m/s] total - initial - booked
    angular_momentum: Floats  # (T, 3) [kg m²/s] about the origin of the world
    angular_momentum_error: Floats  # (T, 3) [kg m²/s] total - initial - booked


class Drift(NamedTuple):
    """Largest errors of integration so far, each relative to its scale."""

    energy: float
    linear_momentum: float
    angular_momentum: float


class Ledger:
    """Books a run from its initial totals on."""

    def __init__(self, initial: Totals) -> None:
        self.energy = float(initial.kinetic_energy[0] + initial.potential_energy[0])
        self.linear = initial.linear_momentum[0].copy()
        self.angular = initial.angular_momentum[0].copy()
        self.errors = np.zeros(3)
        self.scales = np.zeros(3)
        self.widen(initial, np.zeros(1))

    def widen(self, now: Totals, work: Floats) -> None:
        """Let the scales grow with what is turned over."""
        turned_over = np.maximum(now.kinetic_energy, np.abs(work))
        sizes = (turned_over, now.momentum_size, now.spin_size)
        self.scales = np.maximum(self.scales, [size.max(initial=0.0) for size in sizes])

    def enter(self, now: Totals, booked: Floats) -> Entries:
        """Entries of some frames, given their totals and what was booked, (T, 7)."""
        work = booked[:, 0]
        energy = now.kinetic_energy + now.potential_energy
        entries = Entries(
            now.kinetic_energy,
            now.potential_energy,
            energy,
            work,
            energy - self.energy - work,
            now.linear_momentum,
            now.linear_momentum - self.linear - booked[:, 1:4],
            now.angular_momentum,
            now.angular_momentum - self.angular - booked[:, 4:7],
        )
        self.widen(now, work)
        errors = (
            np.abs(entries.energy_error),
            np.linalg.norm(entries.linear_momentum_error, axis=1),
            np.linalg.norm(entries.angular_momentum_error, axis=1),
        )
        self.errors = np.maximum(self.errors, [error.max(initial=0.0) for error in errors])
        return entries

    def drift(self) -> Drift:
        """Largest errors until now over the largest scales."""
        safe = np.where(self.scales > 0.0, self.scales, 1.0)
        return Drift(*(self.errors / safe).tolist())
