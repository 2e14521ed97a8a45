"""Vectors and quaternions in arrays: how compiled helpers read and write them.

The name says how the array lies: `row3` where each vector is a row, or a part of one; `column3`
where its components are in three rows, and `get3` of model/block.py in the blocks of a motion. Of
component-first arrays a block of bodies is reached through one-dimensional row views (`rows3`):
with these LLVM keeps neighbouring bodies in the lanes of a SIMD register, with two-dimensional
slices it does not, and `column3_at` is for bodies that are taken one by one.
"""

from particlerb.compiled.jit import inline, unsigned
from particlerb.maths.quaternion import Quat, Rows4
from particlerb.maths.vec3 import Floats, Rows3, Vec3


@inline
def row3(rows: Floats, k: int, at: int = 0) -> Vec3:
    """Three numbers of row k from `at` on; with unsigned indices Numba asks not about signs."""
    row = unsigned(k)
    return rows[row, unsigned(at)], rows[row, unsigned(at + 1)], rows[row, unsigned(at + 2)]


@inline
def put_row3(rows: Floats, k: int, v: Vec3, at: int = 0) -> None:
    """Write three numbers of row k from `at` on."""
    row = unsigned(k)
    rows[row, unsigned(at)], rows[row, unsigned(at + 1)] = v[0], v[1]
    rows[row, unsigned(at + 2)] = v[2]


@inline
def row4(rows: Floats, k: int, at: int = 0) -> Quat:
    """Four numbers of row k from `at` on."""
    return rows[k, at], rows[k, at + 1], rows[k, at + 2], rows[k, at + 3]


@inline
def put_row4(rows: Floats, k: int, q: Quat, at: int = 0) -> None:
    """Write four numbers of row k from `at` on."""
    rows[k, at], rows[k, at + 1], rows[k, at + 2], rows[k, at + 3] = q


@inline
def rows3(array: Floats, lo: int, hi: int) -> Rows3:
    """Rows of a (3, n) array between two bodies, as one-dimensional views."""
    return array[0, lo:hi], array[1, lo:hi], array[2, lo:hi]


@inline
def column3(rows: Rows3, b: int) -> Vec3:
    """Vector of body b."""
    return rows[0][b], rows[1][b], rows[2][b]


@inline
def put_column3(rows: Rows3, b: int, vector: Vec3) -> None:
    """Write the vector of body b."""
    rows[0][b], rows[1][b], rows[2][b] = vector


@inline
def column3_at(array: Floats, b: int, at: int = 0) -> Vec3:
    """Three numbers of column b from row `at` on."""
    return array[at, b], array[at + 1, b], array[at + 2, b]


@inline
def add_to_column3_at(array: Floats, b: int, scale: float, v: Vec3, at: int = 0) -> None:
    """Add scale v to three numbers of column b from row `at` on."""
    array[at, b] += scale * v[0]
    array[at + 1, b] += scale * v[1]
    array[at + 2, b] += scale * v[2]


@inline
def rows4(array: Floats, lo: int, hi: int) -> Rows4:
    """Rows of a (4, n) array between two bodies, as one-dimensional views."""
    return array[0, lo:hi], array[1, lo:hi], array[2, lo:hi], array[3, lo:hi]


@inline
def column4(rows: Rows4, b: int) -> Quat:
    """Quaternion of body b."""
    return rows[0][b], rows[1][b], rows[2][b], rows[3][b]


@inline
def put_column4(rows: Rows4, b: int, q: Quat) -> None:
    """Write the quaternion of body b."""
    rows[0][b], rows[1][b], rows[2][b], rows[3][b] = q
