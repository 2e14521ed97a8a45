"""Shapes filled with mass particles: one function per shape, numbers in, one kind out.

Common to all: positions in the shape's own axes, centred unless the function says otherwise; SI
units; `mass` [kg] is the total, shared equally unless said otherwise; a column (k, 1) of masses
gives a kind of each. Sizes, numbers of particles
and arrangements are those that the tables of `particlerb.case.shapes` allow; ValueError for a mass
that is not positive and finite, as one from a density may be, and for what shows here alone.

Lattice: the bounding box is cut into cells, n along its largest extent and as near to cubes as
whole numbers along the other extents allow; a particle sits in the centre of every cell whose
centre lies inside the shape. Curved surfaces make staircases, so that the tensor approaches the
solid's without a clean order (docs/bodies.md).

Arrangements: "lattice"; "cells", the same cells, each weighted by the share of it that is inside
(docs/mass_properties.md); "exact", the few particles that have exactly the mass, com and inertia
tensor of the solid.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from particlerb.geometry.particles import Mass, Particles, checked_mass, one_kind
from particlerb.geometry.sections import BALL, CONE, Profile, hollow, ring, section_particles, tube
from particlerb.maths.vec3 import Floats

SIX_DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])  # six unit vectors: +x +y +z -x -y -z
CUBE_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_TRIANGLE_ROUNDING = 8 * np.finfo(np.float64).eps  # of I_max: moments that come out of a sum


# Lattices


def _cell_centres(n: int) -> Floats:
    """Centres of n equal cells of [-1, 1]: (2i + 1 − n) / n, antisymmetric to the bit."""
    return (2.0 * np.arange(n) + (1.0 - n)) / n


def equal(position: Floats, mass: Mass) -> Particles:
    """Point particles at positions (n, 3) or (k, n, 3) [m] of equal mass M / n."""
    return one_kind(position, checked_mass(mass) / position.shape[-2])


def filled(half_size: Floats, mass: Mass, n: int, arrangement: str, profile: Profile) -> Particles:
    """Particles of cells, or equal ones in the cell centres inside a shape.

    Parameters
    ----------
    half_size : ndarray, shape (3,) [m]
        Of the bounding box about the origin.
    mass : float [kg]
    n : int
        Cells along the largest extent.
    arrangement : {"lattice", "cells"}
    profile : Profile
        The shape in its bounding box.

    Raises
    ------
    ValueError
        If no cell centre lies inside.
    """
    if arrangement == "cells":
        return section_particles(profile, half_size, checked_mass(mass), n)
    counts = np.maximum(1, np.rint(n * (half_size / half_size.max()))).astype(np.int64)
    centres = [_cell_centres(int(count)) for count in counts]
    chosen = np.argwhere(profile.inside(*np.ix_(*centres)))
    if len(chosen) == 0:
        raise ValueError(f"none of the cell centres for n = {n} lies inside; raise n")
    position = np.stack([centres[k][chosen[:, k]] * half_size[k] for k in range(3)], axis=1)
    return equal(position, mass)


# Solids


def box(
    size: ArrayLike, mass: Mass, n: int | Sequence[int] = 10, arrangement: str = "lattice"
) -> Particles:
    """Box of edges `size` (3,) [m]: n cells per edge (or three numbers), exact: 8 particles.

    Lattice: I_x = (M/12) (b² (1 − 1/n_y²) + c² (1 − 1/n_z²)). Exact: at (±a, ±b, ±c) / (2√3),
    where Σ m x² = M a²/12 and products cancel.
    """
    half_size = 0.5 * np.asarray(size, dtype=np.float64)
    if arrangement == "exact":
        return equal(CUBE_CORNERS * half_size / math.sqrt(3.0), mass)
    counts = np.broadcast_to(n, (3,)).tolist()
    grid = np.meshgrid(*(_cell_centres(count) for count in counts), indexing="ij")
    return equal(np.stack(grid, axis=-1).reshape(-1, 3) * half_size, mass)


def ball(radius: float, mass: Mass, n: int = 10, arrangement: str = "lattice") -> Particles:
    """Ball: n cells per diameter; exact: one solid particle of this radius, I = 2/5 M R².

    The one particle may have mass 0: then it is surface without matter.
    """
    if arrangement == "exact":
        return one_kind(np.zeros((1, 3)), checked_mass(mass) if np.any(mass) else 0.0, radius)
    return ellipsoid(np.full(3, radius), mass, n, arrangement)


def ellipsoid(
    semi_axes: ArrayLike, mass: Mass, n: int = 10, arrangement: str = "lattice"
) -> Particles:
    """Ellipsoid of half axes (3,) [m]; exact: 6 particles at a √(3/5), Σ m x² = M a²/5."""
    half_size = np.asarray(semi_axes, dtype=np.float64)
    if arrangement == "exact":
        return equal(SIX_DIRECTIONS * half_size * math.sqrt(0.6), mass)
    return filled(half_size, mass, n, arrangement, BALL)


def shell(
    radius: float,
    mass: Mass,
    inner_radius: float | None = None,
    n: int = 10,
    arrangement: str = "lattice",
) -> Particles:
    """Spherical shell: thin without `inner_radius`, else the matter between two radii.

    Thin: 6 n² particles on the sphere, the centres of n × n cells of equal angle on the six faces
    of a cube, n per quarter of a great circle. This set has the symmetry of the cube and all its
    points the distance R: its tensor is (2/3) M R² to rounding for every n. Thick: the lattice
    with n cells per diameter; the solid has I = (2/5) M (R⁵ − r⁵)/(R³ − r³).
    """
    if inner_radius is not None:
        return filled(np.full(3, radius), mass, n, arrangement, hollow(inner_radius / radius))
    slope = np.tan(0.25 * math.pi * _cell_centres(n))
    u, v = (axis.ravel() for axis in np.meshgrid(slope, slope, indexing="ij"))
    distance = np.sqrt(1.0 + (u * u + v * v))
    face = np.stack([np.ones_like(u) / distance, u / distance, v / distance], axis=1) * radius
    faces = [sign * np.roll(face, k, axis=1) for k in range(3) for sign in (1.0, -1.0)]
    return equal(np.concatenate(faces), mass)


def cylinder(
    radius: float,
    height: float,
    mass: Mass,
    inner_radius: float = 0.0,
    n: int = 10,
    arrangement: str = "lattice",
) -> Particles:
    """Cylinder or tube along z.

    The solid has I_z = M (R² + r²)/2 and I_x = M (3 (R² + r²) + h²)/12.
    """
    half_size, profile = np.array([radius, radius, 0.5 * height]), tube(inner_radius / radius)
    return filled(half_size, mass, n, arrangement, profile)


def cone(
    radius: float, height: float, mass: Mass, n: int = 10, arrangement: str = "lattice"
) -> Particles:
    """Cone along z, base at z = 0, apex at z = h.

    The solid has its com at h/4, I_z = (3/10) M R² and I_x = (3/80) M (4R² + h²).
    """
    half_size = np.array([radius, radius, 0.5 * height])
    particles = filled(half_size, mass, n, arrangement, CONE)
    return particles._replace(position=particles.position + np.array([0.0, 0.0, 0.5 * height]))


def torus(
    major_radius: float, minor_radius: float, mass: Mass, n: int = 10, arrangement: str = "lattice"
) -> Particles:
    """Ring about z: circle of the minor radius a led round the circle of the major radius c.

    The solid has I_z = M (c² + 3a²/4) and I_x = M (c²/2 + 5a²/8).
    """
    c, a = major_radius, minor_radius
    return filled(np.array([c + a, c + a, a]), mass, n, arrangement, ring(a / c))


def rod(length: float, mass: Mass, n: int = 10, arrangement: str = "lattice") -> Particles:
    """Thin rod along z: n equal particles, I = (M L²/12)(1 − 1/n²).

    Exact: masses M/6, 2M/3, M/6 at −L/2, 0, L/2 (Simpson's rule), I = M L²/12.
    """
    exact = arrangement == "exact"
    z = np.array([-1.0, 0.0, 1.0]) if exact else _cell_centres(n)
    position = np.outer(z * (0.5 * length), [0.0, 0.0, 1.0])
    if exact:
        return one_kind(position, checked_mass(mass) * np.array([1 / 6, 4 / 6, 1 / 6]))
    return equal(position, mass)


def tetrahedron(
    vertices: ArrayLike, mass: Mass, n: int = 10, arrangement: str = "lattice"
) -> Particles:
    """Solid tetrahedron with vertices (4, 3) [m], in their frame (not centred).

    A set with the symmetry of the barycentric coordinates λ has a multiple of the solid's second
    moments about the com, and the solid has Var λ = 3/80. Lattice: λ = (i + δ)/(s + 4δ) for all
    whole i ≥ 0 with Σ i = s = n − 1, n particles per edge, has Var λ = 3 s (s + 4)/(80 (s + 4δ)²);
    δ = (√(s (s + 4)) − s)/4 makes it the solid's for every n ≥ 2. Exact: M/20 in each vertex and
    4M/5 in the centroid, Var λ = (3/4)(1/20).
    """
    corner = np.asarray(vertices, dtype=np.float64)
    if arrangement == "exact":
        share = np.array([1 / 20, 1 / 20, 1 / 20, 1 / 20, 4 / 5])
        centroid = corner.mean(axis=0, keepdims=True)
        return one_kind(np.concatenate([corner, centroid]), checked_mass(mass) * share)
    if n < 2:
        raise ValueError(f"n is {n}: 2 or more are needed")
    s = n - 1
    i, j, k = (axis.ravel() for axis in np.indices((s + 1, s + 1, s + 1)))
    index = np.stack([i, j, k, s - i - j - k], axis=1)[i + j + k <= s]
    spread = math.sqrt(s * (s + 4.0))
    weight = (index + 0.25 * (spread - s)) / spread
    return equal(weight @ corner, mass)


# Sets without a solid


def moments(inertia: ArrayLike, mass: Mass) -> Particles:
    """Six equal particles with exactly these moments (3,) [kg m²] about the axes x, y, z.

    At ±p_k on axis k with p_1² = (I_2 + I_3 − I_1)/(4m), m = M/6, and cyclic.

    Raises
    ------
    ValueError
        If one moment exceeds the sum of the others by more than rounding: no matter has these.
    """
    array, m = np.asarray(inertia, dtype=np.float64), checked_mass(mass) / 6.0
    others = np.roll(array, -1) + np.roll(array, -2)
    excess = others - array
    if (excess < -_TRIANGLE_ROUNDING * array.max()).any():
        k = int(np.argmin(excess))
        raise ValueError(
            f"inertia {array.tolist()}: moment {k + 1} = {float(array[k])!r} exceeds the sum of the"
            f" other two, {float(others[k])!r}, by {-float(excess[k])!r} kg m²: no body has these"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        arms = SIX_DIRECTIONS * (0.5 * np.sqrt(np.maximum(excess, 0.0) / m))[..., None, :]
    if not np.isfinite(arms).all():
        least = float(np.min(mass))
        raise ValueError(f"inertia {array.tolist()} is too large for a mass of {least!r} kg")
    return equal(arms, mass)


def cloud(n: int, radius: float, mass: Mass, rng: np.random.Generator) -> Particles:
    """n equal particles, independent and uniform in a ball: r = R u^(1/3), direction at random."""
    direction = rng.standard_normal((n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return equal(direction * (radius * np.cbrt(rng.random((n, 1)))), mass)
