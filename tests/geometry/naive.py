"""Mass properties as the definition says them: loops over particles in exact rational numbers."""

from fractions import Fraction

import numpy as np

from particlerb.geometry.particles import Particles

Vector = list[Fraction]
Matrix = list[list[Fraction]]


def exact(values) -> Vector:
    """The rational numbers that the floats are."""
    return [Fraction(float(value)) for value in values]


def mass(particles: Particles) -> Fraction:
    """M = Σ m."""
    return sum(exact(particles.mass), Fraction(0))


def com(particles: Particles) -> Vector:
    """Σ m p / M."""
    total = [Fraction(0)] * 3
    for m, p in zip(exact(particles.mass), particles.position, strict=True):
        total = [s + m * x for s, x in zip(total, exact(p), strict=True)]
    return [s / mass(particles) for s in total]


def inertia_tensor(particles: Particles) -> Matrix:
    """Σ m (|r|² 1 − r rᵀ + (2/5) radius² 1) with r = p − com."""
    centre = com(particles)
    tensor = [[Fraction(0)] * 3 for _ in range(3)]
    rows = zip(exact(particles.mass), exact(particles.radius), particles.position, strict=True)
    for m, radius, p in rows:
        r = [x - c for x, c in zip(exact(p), centre, strict=True)]
        diagonal = r[0] ** 2 + r[1] ** 2 + r[2] ** 2 + Fraction(2, 5) * radius**2
        for i in range(3):
            for j in range(3):
                tensor[i][j] += m * ((diagonal if i == j else 0) - r[i] * r[j])
    return tensor


def tetrahedron_tensor(vertices, m: float) -> Matrix:
    """Solid tetrahedron about its centroid: Σ m r rᵀ = (M/20) Σ_v v vᵀ over its vertices."""
    v = [exact(vertex) for vertex in vertices]
    centre = [sum(column, Fraction(0)) / 4 for column in zip(*v, strict=True)]
    v = [[x - c for x, c in zip(vertex, centre, strict=True)] for vertex in v]
    second = [[sum(a[i] * a[j] for a in v) * Fraction(m) / 20 for j in range(3)] for i in range(3)]
    trace = second[0][0] + second[1][1] + second[2][2]
    return [[(trace if i == j else 0) - second[i][j] for j in range(3)] for i in range(3)]


def largest_difference(exact_values, floats) -> float:
    """max |float − exact| over nested lists of the same shape, rounded once."""
    if isinstance(exact_values, list):
        pairs = zip(exact_values, floats, strict=True)
        return max(largest_difference(e, f) for e, f in pairs)
    return abs(float(Fraction(float(floats)) - exact_values))


def of_kind(particles: Particles, k: int) -> Particles:
    """Particles of kind k alone (views); IndexError if there is no such kind."""
    if not 0 <= k < len(particles.offset) - 1:
        raise IndexError(f"kind {k} of {len(particles.offset) - 1}")
    lo, hi = int(particles.offset[k]), int(particles.offset[k + 1])
    position, mass, radius, _ = particles
    offset = np.array([0, hi - lo], dtype=np.int64)
    return Particles(position[lo:hi], mass[lo:hi], radius[lo:hi], offset)
