"""A uniform solid in a few numbers, and the few particles that move like it.

What is known exactly of a body as a whole (a union of spheres, a mesh) is a `UniformSolid`: volume,
centre of mass and tensor for density 1. `equimomental_points` turns it into six point masses, so
that the sums over the particles of any body, these among them, are its mass properties.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.geometry.particles import Mass, Particles, one_kind
from particlerb.maths.vec3 import Floats

MOMENT_ROUNDING: Final = 64 * float(np.finfo(np.float64).eps)


class UniformSolid(NamedTuple):
    """Uniform matter of density 1 kg/m³."""

    volume: float
    """[m³]."""
    com: Floats
    """[m], shape (3,)."""
    inertia: Floats
    """[m⁵], shape (3, 3); ∫ (|r|² 1 − r rᵀ) dV about com."""
    error: float
    """Estimated relative error of the volume, and of the inertia relative to its trace."""


def symmetric(second: Floats) -> Floats:
    """Matrix (3, 3) of xx yy zz xy xz yz."""
    xx, yy, zz, xy, xz, yz = second
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def equimomental_points(solid: UniformSolid, mass: Mass) -> Particles:
    """Six equal point masses with the com of a solid and, for this mass, its tensor.

    At com ± p_k along principal axis k, with p_1² = 3 (λ_2 + λ_3 − λ_1) / (2 V) and cyclic: six
    masses M/6 then have the moments M λ / V.

    Parameters
    ----------
    solid : UniformSolid
    mass : float, or ndarray of shape (k, 1) [kg]

    Raises
    ------
    ValueError
        If a principal moment exceeds the sum of the two others by more than rounding.
    """
    moments, axes = np.linalg.eigh(solid.inertia)
    excess = moments.sum() - 2.0 * moments
    if not (excess >= -max(MOMENT_ROUNDING, solid.error) * moments[-1]).all():
        raise ValueError(impossible(moments))
    reach = np.sqrt(1.5 * np.maximum(excess, 0.0) / solid.volume)
    arms = (axes * reach).T
    return one_kind(np.concatenate([solid.com + arms, solid.com - arms]), mass / 6.0)


def impossible(moments: Floats) -> str:
    """Why no body has these principal moments (3,), ascending, in full precision."""
    low, middle, high = (float(moment) for moment in moments)
    if low < 0.0:
        return f"principal moments {low!r}, {middle!r}, {high!r} kg m²: one is negative"
    return (
        f"principal moments {low!r}, {middle!r}, {high!r} kg m²: I1 + I2 − I3 ="
        f" {math.fsum((low, middle, -high))!r} is negative, no matter has these"
    )
