"""Centre of mass, tensor per unit of mass, and volume of the analytic solids.

Written independently of all sums: `converge` and the stop rule measure particles against these.
Numbers of docs/bodies.md in brackets.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from particlerb.maths.vec3 import Floats


class Analytic(NamedTuple):
    """What integration says of a solid of uniform density, per unit of mass."""

    com: Floats
    """[m], shape (3,); in the shape's own axes."""
    tensor: Floats
    """[m²], shape (3, 3); about com, in the same axes."""


def _centred(x: float, y: float, z: float) -> Analytic:
    """Moments per mass [m²] about the axes of a shape with its com at the origin."""
    return Analytic(np.zeros(3), np.diag([x, y, z]))


def _analytic_box(size: Sequence[float]) -> Analytic:
    """I_x = M (b² + c²)/12, and cyclic (5)."""
    a, b, c = size
    return _centred((b * b + c * c) / 12.0, (a * a + c * c) / 12.0, (a * a + b * b) / 12.0)


def _analytic_ellipsoid(semi_axes: Sequence[float]) -> Analytic:
    """I_x = M (b² + c²)/5, and cyclic (7)."""
    a, b, c = semi_axes
    return _centred((b * b + c * c) / 5.0, (a * a + c * c) / 5.0, (a * a + b * b) / 5.0)


def _analytic_ball(radius: float) -> Analytic:
    """I = (2/5) M R² (6)."""
    return _analytic_shell(radius, 0.0)


def _analytic_shell(radius: float, inner_radius: float | None = None) -> Analytic:
    """Thick: (2/5) M (R⁵ − r⁵)/(R³ − r³) (9); thin: (2/3) M R² (8)."""
    if inner_radius is None:
        moment = 2.0 / 3.0 * radius**2
    else:
        q = inner_radius / radius  # R⁵ alone may overflow
        moment = 0.4 * radius**2 * (1.0 - q**5) / (1.0 - q**3)
    return _centred(moment, moment, moment)


def _analytic_cylinder(radius: float, height: float, inner_radius: float = 0.0) -> Analytic:
    """I_z = M (R² + r²)/2, I_x = M (3 (R² + r²) + h²)/12 (10)."""
    squares = radius**2 + inner_radius**2
    across = (3.0 * squares + height**2) / 12.0
    return _centred(across, across, 0.5 * squares)


def _analytic_cone(radius: float, height: float) -> Analytic:
    """Com at h/4 above the base, I_z = (3/10) M R², I_x = (3/80) M (4R² + h²) (11)."""
    across = 3.0 / 80.0 * (4.0 * radius**2 + height**2)
    tensor = np.diag([across, across, 0.3 * radius**2])
    return Analytic(np.array([0.0, 0.0, 0.25 * height]), tensor)


def _analytic_torus(major_radius: float, minor_radius: float) -> Analytic:
    """I_z = M (c² + 3a²/4), I_x = M (c²/2 + 5a²/8) (12)."""
    c, a = major_radius, minor_radius
    across = 0.5 * c**2 + 0.625 * a**2
    return _centred(across, across, c**2 + 0.75 * a**2)


def _analytic_rod(length: float) -> Analytic:
    """I_x = M L²/12, I_z = 0 (13)."""
    return _centred(length**2 / 12.0, length**2 / 12.0, 0.0)


def _analytic_tetrahedron(vertices: ArrayLike) -> Analytic:
    """Com at the mean of the vertices; Σ m r rᵀ = (M/20) Σ_v r_v r_vᵀ about it (14)."""
    corner = np.asarray(vertices, dtype=np.float64)
    com = corner.mean(axis=0)
    second = (corner - com).T @ (corner - com) / 20.0
    return Analytic(com, np.trace(second) * np.eye(3) - second)


ANALYTIC: Final[dict[str, Callable[..., Analytic]]] = {
    "box": _analytic_box,
    "ball": _analytic_ball,
    "ellipsoid": _analytic_ellipsoid,
    "shell": _analytic_shell,
    "cylinder": _analytic_cylinder,
    "cone": _analytic_cone,
    "torus": _analytic_torus,
    "rod": _analytic_rod,
    "tetrahedron": _analytic_tetrahedron,
}


def _shell_volume(p: Mapping[str, Any]) -> float:
    """(4π/3)(R³ − r³); ValueError for the thin shell."""
    if p.get("inner_radius") is None:
        raise ValueError("a thin shell has no volume: give mass")
    return 4.0 / 3.0 * math.pi * float(p["radius"] ** 3 - p["inner_radius"] ** 3)


def _tetrahedron_volume(p: Mapping[str, Any]) -> float:
    """|(b − a) · (c − a) × (d − a)| / 6."""
    corner = np.asarray(p["vertices"], dtype=np.float64)
    return float(abs(np.linalg.det(corner[1:] - corner[0]))) / 6.0


_VOLUME: dict[str, Callable[[Mapping[str, Any]], float]] = {
    "box": lambda p: math.prod(p["size"]),
    "ball": lambda p: 4.0 / 3.0 * math.pi * p["radius"] ** 3,
    "shell": _shell_volume,
    "cylinder": lambda p: (
        math.pi * (p["radius"] ** 2 - (p.get("inner_radius") or 0.0) ** 2) * p["height"]
    ),
    "cone": lambda p: math.pi * p["radius"] ** 2 * p["height"] / 3.0,
    "torus": lambda p: 2.0 * math.pi**2 * p["major_radius"] * p["minor_radius"] ** 2,
    "ellipsoid": lambda p: 4.0 / 3.0 * math.pi * math.prod(p["semi_axes"]),
    "tetrahedron": _tetrahedron_volume,
}


def volume(shape_name: str, parameters: Mapping[str, Any]) -> float:
    """Volume [m³] of the analytic solid, so that mass = density · volume.

    Parameters
    ----------
    shape_name : str
        Key of `_VOLUME`.
    parameters : mapping
        Its arguments by name; others are ignored.

    Raises
    ------
    ValueError
        For a shape without volume (points, moments, cloud, rod, thin shell): give mass.
    """
    if shape_name not in _VOLUME:
        raise ValueError(f"shape {shape_name!r} has no volume: give mass")
    return float(_VOLUME[shape_name](parameters))
