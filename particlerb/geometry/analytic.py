"""Centre of mass, tensor per unit of mass, and volume of the analytic solids.

Written independently of all sums: `converge` and the stop rule measure particles against these.
Numbers of docs/bodies.md in brackets.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from particlerb.maths.vec3 import Floats


class Analytic(NamedTuple):
    """What integration says of a solid of uniform density, per unit of mass."""

    com: Floats
    """[m], shape (3,); in the shape's own axes."""
    tensor: Floats
    """[m²], shape (3, 3); about com, in the same axes."""
    volume: float
    """[m³]; NaN where there is none."""


def _centred(volume: float, x: float, y: float, z: float) -> Analytic:
    """Volume [m³] and moments per mass [m²] about the axes of a shape with its com at 0."""
    return Analytic(np.zeros(3), np.diag([x, y, z]), volume)


def _with_axes(volume: float, lengths: Sequence[float], n: float) -> Analytic:
    """Moments (b² + c²)/n, and cyclic, of a box or an ellipsoid."""
    a, b, c = (length * length for length in lengths)
    return _centred(volume, (b + c) / n, (a + c) / n, (a + b) / n)


def box(size: Sequence[float]) -> Analytic:
    """I_x = M (b² + c²)/12, and cyclic (5)."""
    return _with_axes(math.prod(size), size, 12.0)


def ellipsoid(semi_axes: Sequence[float]) -> Analytic:
    """I_x = M (b² + c²)/5, and cyclic (7)."""
    return _with_axes(4.0 / 3.0 * math.pi * math.prod(semi_axes), semi_axes, 5.0)


def ball(radius: float) -> Analytic:
    """I = (2/5) M R² (6)."""
    return shell(radius, 0.0)


def shell(radius: float, inner_radius: float | None = None) -> Analytic:
    """Thick: (2/5) M (R⁵ − r⁵)/(R³ − r³) (9); thin: (2/3) M R² (8)."""
    if inner_radius is None:
        moment, volume = 2.0 / 3.0 * radius**2, math.nan
    else:
        q = inner_radius / radius  # R⁵ alone may overflow
        moment = 0.4 * radius**2 * (1.0 - q**5) / (1.0 - q**3)
        volume = 4.0 / 3.0 * math.pi * (radius**3 - inner_radius**3)
    return _centred(volume, moment, moment, moment)


def cylinder(radius: float, height: float, inner_radius: float = 0.0) -> Analytic:
    """I_z = M (R² + r²)/2, I_x = M (3 (R² + r²) + h²)/12 (10)."""
    squares = radius**2 + inner_radius**2
    across = (3.0 * squares + height**2) / 12.0
    volume = math.pi * (radius**2 - inner_radius**2) * height
    return _centred(volume, across, across, 0.5 * squares)


def cone(radius: float, height: float) -> Analytic:
    """Com at h/4 above the base, I_z = (3/10) M R², I_x = (3/80) M (4R² + h²) (11)."""
    across = 3.0 / 80.0 * (4.0 * radius**2 + height**2)
    tensor = np.diag([across, across, 0.3 * radius**2])
    volume = math.pi * radius**2 * height / 3.0
    return Analytic(np.array([0.0, 0.0, 0.25 * height]), tensor, volume)


def torus(major_radius: float, minor_radius: float) -> Analytic:
    """I_z = M (c² + 3a²/4), I_x = M (c²/2 + 5a²/8) (12)."""
    c, a = major_radius, minor_radius
    across = 0.5 * c**2 + 0.625 * a**2
    return _centred(2.0 * math.pi**2 * c * a**2, across, across, c**2 + 0.75 * a**2)


def rod(length: float) -> Analytic:
    """I_x = M L²/12, I_z = 0 (13)."""
    return _centred(math.nan, length**2 / 12.0, length**2 / 12.0, 0.0)


def tetrahedron(vertices: ArrayLike) -> Analytic:
    """Com at the mean of the vertices; Σ m r rᵀ = (M/20) Σ_v r_v r_vᵀ about it (14)."""
    corner = np.asarray(vertices, dtype=np.float64)
    com = corner.mean(axis=0)
    second = (corner - com).T @ (corner - com) / 20.0
    volume = float(abs(np.linalg.det(corner[1:] - corner[0]))) / 6.0
    return Analytic(com, np.trace(second) * np.eye(3) - second, volume)


ANALYTIC: Final[dict[str, Callable[..., Analytic]]] = {
    solid.__name__: solid
    for solid in (box, ball, ellipsoid, shell, cylinder, cone, torus, rod, tetrahedron)
}
"""By the `type` of a shape in a case."""
