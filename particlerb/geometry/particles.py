"""Mass particles in flat arrays: the only description of a body's matter.

A *kind* is one distinct set of particles. Many equal bodies share one kind, so that its mass
properties are summed once; bodies refer to kinds by index. `Particles` first, then what joins and
checks and moves sets. Nothing here knows of shapes, tensors or motion.

Why it is so: docs/decisions/0001.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from particlerb.maths.vec3 import Bools, Floats, Ints

Mass: TypeAlias = float | Floats
"""Of a body, or a column (k, 1) of those of k kinds [kg]."""


class Particles(NamedTuple):
    """Mass particles of distinct bodies in flat arrays; kind k owns offset[k]:offset[k + 1]."""

    position: Floats
    """[m], shape (n_particles, 3); any frame common to the kind."""
    mass: Floats
    """[kg], shape (n_particles,); not negative. 0 with a radius is contact shape without mass."""
    radius: Floats
    """[m], shape (n_particles,); not negative. 0 is a point mass, above 0 a solid ball."""
    offset: Ints
    """Shape (n_kinds + 1,); from 0 to n_particles, ascending."""


def one_kind(position: ArrayLike, mass: ArrayLike, radius: ArrayLike | None = None) -> Particles:
    """Particles of a single kind; of k kinds of as many particles where a row is given for each.

    Parameters
    ----------
    position : array_like, shape (n, 3) or (k, n, 3) [m]
    mass : array_like, shape (n,) or (k, n) [kg]
        One number stands for equal masses, a column (k, 1) for those of each kind.
    radius : array_like, shape (n,) [m], optional
        Left out: point masses. One number stands for equal radii.

    Returns
    -------
    Particles
        Arrays of its own, C-contiguous float64.

    Raises
    ------
    ValueError
        If shapes disagree, nothing is given, or a value is negative or not finite; the message
        names the first such particle.
    """
    p, masses = np.asarray(position, dtype=np.float64), np.asarray(mass, dtype=np.float64)
    if p.ndim not in {2, 3} or p.shape[-1] != 3 or p.size == 0:
        raise ValueError(f"position has shape {p.shape}, not (n, 3) with n of 1 or more")
    k, n = max(len(masses) if masses.ndim == 2 else 1, len(p) if p.ndim == 3 else 1), p.shape[-2]
    m = _per_particle("mass", masses, k, n)
    r = _per_particle("radius", 0.0 if radius is None else radius, k, n)
    if not (is_finite := np.isfinite(p).all(axis=-1)).all():
        raise ValueError(f"position of particle {np.argmin(is_finite) % n} not finite")
    p = np.array(np.broadcast_to(p, (k, n, 3)), order="C").reshape(-1, 3)
    return Particles(p, m, r, n * np.arange(k + 1))


def _per_particle(name: str, value: ArrayLike, k: int, n: int) -> Floats:
    """Array of k n finite values of 0 or more, from n or one; ValueError names the first."""
    values = np.asarray(value, dtype=np.float64)
    if values.shape not in {(), (n,), (k, 1), (k, n)}:
        raise ValueError(f"{name} has shape {values.shape}, position has {n} particles")
    array = np.array(np.broadcast_to(values, (k, n)), order="C").reshape(-1)
    valid = np.isfinite(array) & (array >= 0.0)
    if not valid.all():
        i = int(np.argmin(valid))
        raise ValueError(f"{name} of particle {i % n} is {array[i]}: must be finite, 0 or more")
    return array


def checked_mass(mass: Mass) -> Mass:
    """The mass, or those of kinds; ValueError unless each is positive and finite."""
    masses = np.ravel(mass)
    if not (is_right := (masses > 0.0) & (masses < math.inf)).all():
        raise ValueError(f"mass is {masses[np.argmin(is_right)]}: positive and finite is needed")
    return mass


def check(particles: Particles) -> None:
    """ValueError that names the first kind which has no mass properties, and says why."""
    position, mass, radius, offset = particles
    count = np.diff(offset)
    refuse(count < 1, "no particles")
    for valid, reason in (
        (np.isfinite(position), "a position that is not finite"),
        (np.isfinite(mass) & (mass >= 0.0), "a mass that is negative or not finite"),
        (np.isfinite(radius) & (radius >= 0.0), "a radius that is negative or not finite"),
    ):
        if not valid.all():
            invalid = ~valid.reshape(len(mass), -1).all(axis=1)
            kind = np.repeat(np.arange(len(count)), count)[invalid]
            refuse(np.bincount(kind, minlength=len(count)) > 0, reason)
    heaviest: Floats = np.maximum.reduceat(mass, offset[:-1])
    refuse(np.asarray(heaviest <= 0.0), "no mass: its sum is not positive")


def refuse(failed: Bools, reason: str) -> None:
    """ValueError with the index of the first kind that failed, if any did."""
    if failed.any():
        raise ValueError(f"kind {int(np.argmax(failed))}: {reason}")


def concatenate(sets: Sequence[Particles]) -> Particles:
    """All kinds of several sets, in order; the sum of their kinds is kept.

    Raises
    ------
    ValueError
        If the list is empty.
    """
    if not sets:
        raise ValueError("no particles to concatenate")
    if len(sets) == 1:
        return sets[0]
    counts = np.concatenate([np.diff(s.offset) for s in sets])
    return Particles(
        np.concatenate([s.position for s in sets]),
        np.concatenate([s.mass for s in sets]),
        np.concatenate([s.radius for s in sets]),
        np.concatenate([np.zeros(1, np.int64), np.cumsum(counts, dtype=np.int64)]),
    )


def kind_of(particles: Particles, k: int) -> Particles:
    """Particles of one kind."""
    rows = slice(particles.offset[k], particles.offset[k + 1])
    position, mass, radius = (array[rows] for array in particles[:3])
    return united(Particles(position, mass, radius, particles.offset))


def rows_of_kinds(offset: Ints, kinds: Ints) -> tuple[Ints, Ints]:
    """Rows of these kinds, one after the other, and which of `kinds` each is of.

    Those of kind k are offset[k] to offset[k + 1].
    """
    count = offset[kinds + 1] - offset[kinds]
    owner = np.repeat(np.arange(kinds.size), count)
    before = np.cumsum(count) - count
    return np.arange(owner.size) + (offset[kinds] - before)[owner], owner


def united(particles: Particles) -> Particles:
    """All particles as one kind: what a body of several parts is."""
    return particles._replace(offset=np.array([0, len(particles.mass)], dtype=np.int64))


def with_surface(matter: Particles, position: Floats, radius: Floats) -> Particles:
    """Spheres (n, 3), (n,) [m] without mass, which only touch, and the particles with the mass.

    Kinds of matter have equally many particles, and each kind has all the spheres.
    """
    k, n = len(matter.offset) - 1, len(radius)
    places = [np.broadcast_to(position, (k, n, 3)), matter.position.reshape(k, -1, 3)]
    masses = [np.zeros((k, n)), matter.mass.reshape(k, -1)]
    radii = np.concatenate([radius, matter.radius[: matter.offset[1]]])
    return one_kind(np.concatenate(places, axis=1), np.concatenate(masses, axis=1), radii)


def transformed(particles: Particles, rotation: Floats, translation: ArrayLike) -> Particles:
    """Every particle turned, then moved: x = R p + t.

    Parameters
    ----------
    particles : Particles
    rotation : ndarray, shape (3, 3)
        Proper or improper orthogonal matrix; columns are the old axes in the new frame.
    translation : array_like, shape (3,) [m]
        In the new frame.
    """
    return particles._replace(position=particles.position @ rotation.T + np.asarray(translation))


def scaled_to_mass(particles: Particles, mass: Mass) -> Particles:
    """Particles of one kind, their masses times one factor, so that it has a mass [kg].

    A column of masses (k, 1) gives as many kinds.

    Raises
    ------
    ValueError
        If it has no mass to scale.
    """
    total = math.fsum(particles.mass)
    if total == 0.0:
        raise ValueError("it has no mass to scale")
    return one_kind(particles.position, particles.mass / total * mass, particles.radius)
