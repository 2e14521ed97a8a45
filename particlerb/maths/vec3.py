"""Vectors as tuples of three scalars: values in, values out.

Nothing here writes into an argument; maths/rows.py brings vectors out of arrays, and back.
"""

import math
from typing import Any, Final, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from particlerb.compiled.jit import inline

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
Indices: TypeAlias = NDArray[np.int32]  # where there are many
Bools: TypeAlias = NDArray[np.bool_]
Vec3: TypeAlias = tuple[float, float, float]
Rows3: TypeAlias = tuple[Floats, Floats, Floats]
Array = TypeVar("Array", Floats, Ints)

ZERO: Final = (0.0, 0.0, 0.0)


def differences(values: Array, before: Any) -> Array:
    """Each of the values less the one before it; `numpy.diff` takes ten times as long for a few."""
    changes = values.copy()
    changes[1:] -= values[:-1]
    changes[:1] -= before
    return changes


def rows_of(array: Floats) -> Any:
    """Rows of a (3, n) or (4, n) array, or view, each contiguous: copies perhaps, to read alone."""
    array = np.asarray(array, np.float64)
    return tuple(array if array.strides[1] == array.itemsize else np.ascontiguousarray(array))


@inline
def add_scaled(a: float, x: Vec3, y: Vec3) -> Vec3:
    """y + a x."""
    return y[0] + a * x[0], y[1] + a * x[1], y[2] + a * x[2]


@inline
def scale(a: float, x: Vec3) -> Vec3:
    """a x."""
    return a * x[0], a * x[1], a * x[2]


@inline
def component_product(x: Vec3, y: Vec3) -> Vec3:
    """Component by component; a diagonal tensor times a vector."""
    return x[0] * y[0], x[1] * y[1], x[2] * y[2]


@inline
def add(x: Vec3, y: Vec3) -> Vec3:
    """x + y."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2]


@inline
def subtract(x: Vec3, y: Vec3) -> Vec3:
    """x - y."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2]


@inline
def dot(x: Vec3, y: Vec3) -> float:
    """x . y."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@inline
def norm(x: Vec3) -> float:
    """|x|."""
    return math.sqrt(dot(x, x))


@inline
def divide(x: Vec3, a: float) -> Vec3:
    """x / a."""
    return x[0] / a, x[1] / a, x[2] / a


@inline
def cross(x: Vec3, y: Vec3) -> Vec3:
    """x × y."""
    return (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])


@inline
def corner3(corner: Floats, f: int, k: int) -> Vec3:
    """Corner k of face f, of an (n, 3, 3) array."""
    return corner[f, k, 0], corner[f, k, 1], corner[f, k, 2]
