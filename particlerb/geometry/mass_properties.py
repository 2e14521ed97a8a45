"""Mass, centre of mass, inertia tensor, principal frame and rotor class of particle sets.

Read in this order: `MassProperties`; `mass_properties`, which calls geometry/sums.py;
`_principal_frames`, which decides the rotor class and builds the axes with NumPy over all kinds at
once. Formulas are numbered in docs/bodies.md.

Nothing here has an absolute threshold. A kind is scaled by powers of two, exactly, to extent and
mass of about one before anything is squared, and scaled back at the end.
"""

import math
from typing import NamedTuple

import numpy as np

from particlerb.geometry.particles import Particles, refuse
from particlerb.geometry.sums import sums_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.rotors.rotor_class import ASYMMETRIC, POINT, ROD, SPHERE, SYMMETRIC

_SUM_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)  # 1.8e-15: sums, coordinates, eigenvalues
_FEW_PARTICLES = 4096  # of which the properties are kept: variants of a scene have the same bodies
_MOST_KNOWN = 64  # scenes whose bodies are kept
_KNOWN: dict[tuple[bytes, ...], "MassProperties"] = {}  # by the content of their arrays
_TIE = 0.999  # components this close to the largest count as equal when an axis takes its sign


class MassProperties(NamedTuple):
    """What motion needs to know of particle sets; arrays over kinds."""

    mass: Floats
    """[kg], shape (n,)."""
    com: Floats
    """[m], shape (n, 3); in the frame of the particles."""
    inertia_tensor: Floats
    """[kg m²], shape (n, 3, 3); about com, axes of the particles, as summed."""
    moments: Floats
    """[kg m²], shape (n, 3); principal, ascending; equal or 0 to the bit as the class says."""
    axes: Floats
    """Shape (n, 3, 3); columns are the principal axes in those axes, det = +1."""
    rotor_class: Ints
    """Shape (n,); codes of particlerb.rotors.rotor_class."""


class Ratios(NamedTuple):
    """Dimensionless numbers that decide the rotor class; arrays over kinds."""

    offset: Floats
    """|com| / g, shape (n,), with the radius of gyration g = √(½ tr I / M); inf where I = 0."""
    smallest: Floats
    """λ_1 / λ_3, shape (n,)."""
    lower_gap: Floats
    """(λ_2 − λ_1) / λ_3, shape (n,)."""
    upper_gap: Floats
    """(λ_3 − λ_2) / λ_3, shape (n,)."""
    zero_below: Floats
    """ε + (ε |com|/g)², shape (n,): a smaller λ_1 / λ_3 is zero."""
    equal_below: Floats
    """ε (1 + |com|/g), shape (n,): moments with a smaller gap are equal."""


def of_kind(properties: MassProperties, k: int) -> MassProperties:
    """Mass properties of one kind, as arrays of length one."""
    return MassProperties._make(array[k : k + 1] for array in properties)


def mass_properties(particles: Particles) -> MassProperties:
    """Sum the mass properties of every kind and decide its rotor class.

    Parameters
    ----------
    particles : Particles
        Kinds with finite positions, masses and radii of 0 or more.

    Returns
    -------
    MassProperties

    Raises
    ------
    ValueError
        If a kind has no particles, a negative mass or radius, a number that is not finite, no
        mass, or a tensor beyond the range of float64; the message names the kind.

    References
    ----------
    Goldstein, Poole, Safko, Classical Mechanics, 3rd ed., section 5.3.
    """
    if particles.mass.size > _FEW_PARTICLES:
        return _summed(particles)
    content = tuple(array.tobytes() for array in particles)
    if (known := _KNOWN.get(content)) is None:
        if len(_KNOWN) >= _MOST_KNOWN:
            _KNOWN.clear()
        known = _KNOWN[content] = _summed(particles)
    return MassProperties._make(array.copy() for array in known)


def _summed(particles: Particles) -> MassProperties:
    """The same, without those that are known."""
    with np.errstate(all="ignore"):  # underflow, and the ratios of points: 0 / 0
        sums, exponent = sums_of(particles)
        mass, com, second = sums[:, 0], sums[:, 1:4], sums[:, 4:10]
        tensor = _inertia_tensors(second, sums[:, 10])
        moments, axes, rotor_class = _principal_frames(mass, com, tensor)
        length, inertia = exponent[:, 0], exponent[:, 1] + 2 * exponent[:, 0]
        properties = MassProperties(
            np.ldexp(mass, exponent[:, 1]),
            np.ldexp(com, length[:, None]),
            np.ldexp(tensor, inertia[:, None, None]),
            np.ldexp(moments, inertia[:, None]),
            axes,
            rotor_class,
        )
    overflown = np.isinf(properties.inertia_tensor).any(axis=(1, 2))
    refuse(np.asarray(overflown), "the inertia tensor exceeds the range of float64")
    return properties


def _inertia_tensors(second: Floats, balls: Floats) -> Floats:
    """I = (tr C + B) 1 − C from C = Σ m r rᵀ, shape (n, 6), and B = Σ (2/5) m radius², (n,)."""
    xx, yy, zz, xy, xz, yz = second.T
    rows = [(yy + zz + balls, -xy, -xz), (-xy, xx + zz + balls, -yz), (-xz, -yz, xx + yy + balls)]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1)) + 0.0  # -0 becomes 0


def tensor_off_com(mass: float, tensor: Floats, d: Floats) -> Floats:
    """Tensor (3, 3) about a point at d (3,) from the com, of that about the com."""
    return np.asarray(tensor + mass * (d @ d * np.eye(3) - np.outer(d, d)))


# Rotor classes


def ratios(mass: Floats, com: Floats, tensor: Floats, moments: Floats) -> Ratios:
    """Ratios that decide the class, from eigenvalues (n, 3) as computed; see docs/bodies.md.

    A coordinate p is known to ε |p|. This moves Σ m r² by 2 ε Σ m |r| |p| at most, a share of
    2 ε √(1 + (|com|/g)²) by Cauchy and Schwarz; a rod's zero moment only by its square.
    """
    largest = moments[:, 2]
    gyration = np.sqrt(0.5 * np.trace(tensor, axis1=1, axis2=2) / mass)
    offset = np.where(gyration > 0.0, np.linalg.norm(com, axis=1) / gyration, math.inf)
    return Ratios(
        offset,
        moments[:, 0] / largest,
        (moments[:, 1] - moments[:, 0]) / largest,
        (largest - moments[:, 1]) / largest,
        _SUM_ROUNDING + (_SUM_ROUNDING * offset) ** 2,
        _SUM_ROUNDING * (1.0 + offset),
    )


def _rotor_classes(ratio: Ratios) -> Ints:
    """Class of every kind, shape (n,): the first that holds of point, rod, sphere, symmetric."""
    gap = np.minimum(ratio.lower_gap, ratio.upper_gap)
    return np.select(
        [
            _SUM_ROUNDING * ratio.offset >= 1.0,  # g <= ε |com|: the particles coincide
            ratio.smallest <= ratio.zero_below,
            ratio.lower_gap + ratio.upper_gap <= ratio.equal_below,
            gap <= ratio.equal_below,
        ],
        [POINT, ROD, SPHERE, SYMMETRIC],
        default=ASYMMETRIC,
    ).astype(np.int64)


def _unique_axis(ratio: Ratios, rotor_class: Ints) -> Ints:
    """Column of the axis whose moment differs from two equal ones, shape (n,); -1 for none."""
    last = (rotor_class == SYMMETRIC) & (ratio.lower_gap <= ratio.upper_gap)
    first = (rotor_class == ROD) | (rotor_class == SYMMETRIC)
    return np.select([last, first], [2, 0], default=-1).astype(np.int64)


def _equalised(moments: Floats, rotor_class: Ints, unique: Ints) -> Floats:
    """Ascending moments (n, 3), equal or zero to the bit where the class says so."""
    result = np.maximum(moments, 0.0)
    mean = 0.5 * (result[:, :2] + result[:, 1:])
    result[unique == 2, :2] = mean[unique == 2, :1]
    result[unique == 0, 1:] = mean[unique == 0, 1:]
    result[rotor_class == ROD, 0] = 0.0
    result[rotor_class == SPHERE] = result[rotor_class == SPHERE, 1:2]
    result[rotor_class == POINT] = 0.0
    return result


# Principal frames


def _principal_frames(mass: Floats, com: Floats, tensor: Floats) -> tuple[Floats, Floats, Ints]:
    """Moments (n, 3), right-handed axes in columns (n, 3, 3) and classes (n,) of tensors (n, 3, 3).

    Diagonal to rounding: the given axes, permuted, and the diagonal itself. Sphere and point: the
    given axes. Rod and symmetric: the unique axis, and the given axes projected on its plane.
    Asymmetric: eigenvectors, each positive along its largest component, the last one turned round
    where the frame would be left-handed.
    """
    moments, axes = eigen_systems(tensor)
    ratio = ratios(mass, com, tensor, moments)
    rotor_class = _rotor_classes(ratio)
    unique = _unique_axis(ratio, rotor_class)
    first, last, general = unique == 0, unique == 2, rotor_class == ASYMMETRIC

    axes[(rotor_class == POINT) | (rotor_class == SPHERE)] = np.eye(3)
    if first.any():
        axes[first] = _frames_about(axes[first, :, 0])
    axes[last] = np.roll(_frames_about(axes[last, :, 2]), -1, axis=2)
    if general.any():
        axes[general] = _right_handed(axes[general])
    return _equalised(moments, rotor_class, unique), axes, rotor_class


def eigen_systems(tensor: Floats) -> tuple[Floats, Floats]:
    """Ascending eigenvalues (n, 3) and orthonormal eigenvectors in columns (n, 3, 3).

    Off-diagonal elements within the rounding of the sum count as zero: then the values are the
    diagonal to the bit and the vectors are unit vectors, in their given order where values tie.
    """
    diagonal = np.diagonal(tensor, axis1=1, axis2=2)
    off_diagonal = np.abs(tensor[:, [0, 0, 1], [1, 2, 2]]).max(axis=1)
    oblique = off_diagonal > _SUM_ROUNDING * diagonal.max(axis=1)
    order = np.argsort(diagonal, axis=1, kind="stable")
    values = np.take_along_axis(diagonal, order, axis=1)
    vectors = np.swapaxes(np.eye(3)[order], 1, 2).copy()
    if oblique.any():
        values[oblique], vectors[oblique] = _polished(tensor[oblique])
    return values, vectors


def _polished(tensor: Floats) -> tuple[Floats, Floats]:
    """Eigen system of LAPACK with orthonormal vectors and values from Rayleigh quotients.

    Source: one Newton-Schulz step V (3 − VᵀV)/2, Higham, Functions of Matrices, 2008, ch. 8.
    """
    _, vectors = np.linalg.eigh(tensor)
    transposed = np.swapaxes(vectors, 1, 2)
    vectors = vectors @ (1.5 * np.eye(3) - 0.5 * (transposed @ vectors))
    values = np.sum(vectors * (tensor @ vectors), axis=1)
    order = np.argsort(values, axis=1, kind="stable")
    vectors = np.take_along_axis(vectors, order[:, None, :], axis=2)
    return np.take_along_axis(values, order, axis=1), vectors


def _positive_direction(vector: Floats) -> tuple[Floats, Ints]:
    """±vector (n, 3) whose largest component is positive, and the index (n,) of that component.

    The first component within `_TIE` of the largest decides, so that (1, −1, 0)/√2 does not turn
    round with the rounding.
    """
    size = np.abs(vector)
    largest = np.argmax(size >= _TIE * size.max(axis=1, keepdims=True), axis=1)
    sign = np.sign(np.take_along_axis(vector, largest[:, None], axis=1))
    return vector * sign + 0.0, largest


def _frames_about(axis: Floats) -> Floats:
    """Frames (u, a, b) in columns, shape (n, 3, 3), about unit vectors (n, 3), reproducible.

    u = ±axis, its largest component k positive; a is the given axis k + 1 projected on the plane
    of the equal moments; b = u × a. For an axis along e_k these are the given axes themselves.
    """
    u, k = _positive_direction(axis)
    e = np.eye(3)[(k + 1) % 3]
    a = e - u * np.sum(u * e, axis=1, keepdims=True)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return np.stack([u, a, np.cross(u, a)], axis=2) + 0.0


def _right_handed(axes: Floats) -> Floats:
    """Frames (n, 3, 3): columns positive along their largest component, the last by det = +1."""
    first, second = _positive_direction(axes[:, :, 0])[0], _positive_direction(axes[:, :, 1])[0]
    last = axes[:, :, 2]
    hand = np.sign(np.sum(np.cross(first, second) * last, axis=1, keepdims=True))
    return np.stack([first, second, last * hand + 0.0], axis=2)
