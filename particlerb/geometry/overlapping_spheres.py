"""Bodies made of overlapping spheres: uniform matter that no overlap counts twice.

`union_solid` is the exact union, `plain_solid` what adding up the spheres would give; `spheres`
makes the particles of a body. The spheres keep their radii, with which they touch. Where they do
not overlap they carry the matter as well; where they do, they have no mass, and six points beside
them (see geometry/solid.py) give the body the exact mass, com and tensor of the union.
"""

import math
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from particlerb.geometry.particles import Mass, Particles, one_kind, with_surface
from particlerb.geometry.solid import UniformSolid, equimomental_points, symmetric
from particlerb.geometry.union import neighbours, union
from particlerb.maths.vec3 import Floats, Ints

_Overlap: TypeAlias = Literal["exact", "sum", "error"]
_TOUCH_ROUNDING: Final = 1e-12  # overlap, of the sum of the radii, that is rounding of a touch
_EPSILON: Final = float(np.finfo(np.float64).eps)
_HUGE: Final = 1e50  # [m] the largest radius lies between this and its inverse


class _Overlaps(NamedTuple):
    """How deep spheres lie in each other."""

    pairs: int
    pair: tuple[int, int]  # the deepest, by overlap over the smaller diameter
    depth: float  # [m] of this pair, R_i + R_j − d
    hidden: Ints  # spheres that lie inside another one


def spheres(
    position: ArrayLike,
    radius: ArrayLike,
    mass: Mass | None = None,
    density: Mass | None = None,
    overlap: _Overlap = "exact",
) -> Particles:
    """Particles of a body of uniform spheres.

    Parameters
    ----------
    position : array_like, shape (n, 3) [m]
    radius : array_like, shape (n,) or () [m]
        Positive.
    mass : float, or ndarray of shape (k, 1) [kg]
        Of the body, 0 for surface without matter; or
    density : float, or ndarray of shape (k, 1) [kg/m³]
        Of its matter.
    overlap : {"exact", "sum", "error"}
        Matter in several spheres counts once; counts in each of them; is refused.

    Returns
    -------
    Particles
        The spheres in their order, then the six points where spheres overlap and count once.

    Raises
    ------
    ValueError
        If a number is not finite, there is no sphere, radii are out of range, or spheres overlap
        and must not.
    """
    centre, R = _checked(position, radius)
    amount = mass if density is None else density
    overlapping = overlaps(centre, R)
    if overlapping.pairs and overlap == "error":
        raise ValueError(refusal(centre, R, overlapping))
    if amount is None or not np.any(amount):
        return one_kind(centre, 0.0, R)
    if not overlapping.pairs or overlap == "sum":
        volumes = 4.0 / 3.0 * math.pi * R**3
        share = volumes if mass is None else volumes / math.fsum(volumes)
        return one_kind(centre, amount * share, R)
    solid = union_solid(centre, R)
    matter = equimomental_points(solid, amount * solid.volume if mass is None else amount)
    return with_surface(matter, centre, R)


def _checked(position: ArrayLike, radius: ArrayLike) -> tuple[Floats, Floats]:
    """Centres (n, 3) and radii (n,) as float64; ValueError where they are no spheres."""
    particles = one_kind(position, 1.0, radius)
    largest = float(particles.radius.max())
    if not 1.0 / _HUGE < largest < _HUGE:
        needed = f"{1.0 / _HUGE:.0e} to {_HUGE:.0e} is needed, as its fifth power must be a number"
        raise ValueError(f"the largest radius is {largest} m: {needed}")
    return particles.position, particles.radius


def union_solid(position: ArrayLike, radius: ArrayLike) -> UniformSolid:
    """Volume, com and tensor of the union of spheres, in closed form.

    Parameters
    ----------
    position : array_like, shape (n, 3) [m]
    radius : array_like, shape (n,) or () [m]

    Raises
    ------
    ValueError
        If a number is not finite, radii are out of range, or there is no sphere.

    References
    ----------
    Derived in docs/mass_properties.md.
    """
    centre, R = _checked(position, radius)
    unit = math.ldexp(1.0, math.frexp(float(R.max()))[1])
    weight = (R / unit) ** 3
    origin = weight @ centre / weight.sum()
    c = (centre - origin) / unit
    integrals = union(c, R / unit)
    com = integrals.first / integrals.volume
    second = symmetric(integrals.second) - integrals.volume * np.outer(com, com)
    inertia = np.trace(second) * np.eye(3) - second
    extent = float((np.linalg.norm(c, axis=1) + R / unit).max())
    error = (integrals.gap + _EPSILON * integrals.area) * extent / (3.0 * integrals.volume)
    return UniformSolid(integrals.volume * unit**3, origin + com * unit, inertia * unit**5, error)


def plain_solid(position: ArrayLike, radius: ArrayLike) -> UniformSolid:
    """The sum over all spheres, as if no two of them overlapped."""
    centre, R = _checked(position, radius)
    volume = 4.0 / 3.0 * math.pi * R**3
    total = math.fsum(volume)
    com = volume @ centre / total
    r = centre - com
    second = (r.T * volume) @ r + 0.2 * (volume @ R**2) * np.eye(3)
    return UniformSolid(total, com, np.trace(second) * np.eye(3) - second, len(R) * _EPSILON)


def overlaps(centre: Floats, radius: Floats) -> _Overlaps:
    """Overlapping pairs of spheres (n, 3), (n,) [m], of which touching ones are none."""
    cover = neighbours(centre, radius)
    hidden = np.flatnonzero(cover.hidden)
    pairs = np.stack([np.repeat(np.arange(len(radius)), np.diff(cover.start)), cover.other])
    reach = radius[pairs].sum(axis=0)
    depth = reach - np.linalg.norm(centre[pairs[0]] - centre[pairs[1]], axis=1)
    is_deep = (pairs[0] < pairs[1]) & (depth > _TOUCH_ROUNDING * reach)
    pairs, depth = pairs[:, is_deep], depth[is_deep]
    n_pairs = len(depth) + len(hidden)
    if len(hidden) or not n_pairs:
        return _Overlaps(n_pairs, (-1, -1), 0.0, hidden)
    k = int(np.argmax(depth / np.minimum(radius[pairs[0]], radius[pairs[1]])))
    return _Overlaps(n_pairs, (int(pairs[0, k]), int(pairs[1, k])), float(depth[k]), hidden)


def refusal(centre: Floats, radius: Floats, check: _Overlaps) -> str:
    """What overlaps, for the message."""
    if check.hidden.size:
        i = int(check.hidden[0])
        inside = np.linalg.norm(centre - centre[i], axis=1) + radius[i] - radius
        inside[i] = math.inf
        return f"sphere {i} lies inside sphere {int(np.argmin(inside))}: overlap is an error here"
    i, j = check.pair
    return (
        f"{check.pairs} pairs of spheres overlap, most of all {i} and {j}, by {check.depth:.6g} m:"
        ' overlap is an error here; "exact" counts their matter once'
    )
