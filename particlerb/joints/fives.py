"""Blocks of five rows, those of hinges and sliders: numbers are read once, and kept meanwhile.

The same as the loops of block_cholesky.py over any number of rows, in which the compiler has to
read numbers again after each that is written.
"""

from typing import TypeAlias

from particlerb.compiled.jit import inline, unsigned
from particlerb.joints.records import Program
from particlerb.maths.vec3 import Floats

Five: TypeAlias = tuple[float, float, float, float, float]


@inline
def _row(factor: Floats, block: int, row: int) -> Five:
    """Row of a block of five columns."""
    k, r = unsigned(block), unsigned(row)
    return factor[k, r, 0], factor[k, r, 1], factor[k, r, 2], factor[k, r, 3], factor[k, r, 4]


@inline
def _diagonal(factor: Floats, k: int) -> Five:
    """Diagonal of block k."""
    return factor[k, 0, 0], factor[k, 1, 1], factor[k, 2, 2], factor[k, 3, 3], factor[k, 4, 4]


@inline
def _product(u: Five, v: Five) -> float:
    """Sum of products."""
    return (u[0] * v[0] + u[1] * v[1]) + (u[2] * v[2] + u[3] * v[3]) + u[4] * v[4]


@inline
def update_fives(factor: Floats, k: int, left: int, right: int, target: int) -> None:
    """Target -= left D⁻¹ rightᵀ, with D of the diagonal block k; of a diagonal block its half."""
    d = _diagonal(factor, k)
    for r in range(5):
        u = _row(factor, left, r)
        u = u[0] * d[0], u[1] * d[1], u[2] * d[2], u[3] * d[3], u[4] * d[4]
        for c in range(r + 1 if left == right else 5):
            factor[target, r, c] -= _product(u, _row(factor, right, c))


@inline
def down_fives(program: Program, factor: Floats, z: Floats, e: int, k: int, d: int) -> None:
    """Forward substitution with all blocks of joint k, the one at place e, whose own block is d."""
    at = program.start[k]
    u, v, w, x = _row(factor, d, 1), _row(factor, d, 2), _row(factor, d, 3), _row(factor, d, 4)
    a = z[at]
    b = z[at + 1] - u[0] * a
    c = z[at + 2] - v[0] * a - v[1] * b
    f = z[at + 3] - w[0] * a - w[1] * b - w[2] * c
    g = z[at + 4] - x[0] * a - x[1] * b - x[2] * c - x[3] * f
    solved = a * factor[d, 0, 0], b * u[1], c * v[2], f * w[3], g * x[4]
    z[at], z[at + 1], z[at + 2], z[at + 3], z[at + 4] = solved
    for q in range(program.column[e], program.column[e + 1]):
        i, block = program.below_joint[q], program.below[q]
        first = program.start[i]
        for r in range(program.start[i + 1] - first):
            z[first + r] -= _product(_row(factor, block, r), solved)


@inline
def up_fives(program: Program, factor: Floats, z: Floats, e: int, k: int, d: int) -> None:
    """Back substitution with them."""
    at = program.start[k]
    a, b, c, f, g = 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(program.column[e], program.column[e + 1]):
        i, block = program.below_joint[q], program.below[q]
        first = program.start[i]
        for r in range(program.start[i + 1] - first):
            row, below = _row(factor, block, r), z[first + r]
            a, b, c = a + row[0] * below, b + row[1] * below, c + row[2] * below
            f, g = f + row[3] * below, g + row[4] * below
    u, v, w, x = _row(factor, d, 1), _row(factor, d, 2), _row(factor, d, 3), _row(factor, d, 4)
    g = z[at + 4] - x[4] * g
    f = z[at + 3] - w[3] * f - x[3] * g
    c = z[at + 2] - v[2] * c - w[2] * f - x[2] * g
    b = z[at + 1] - u[1] * b - v[1] * c - w[1] * f - x[1] * g
    a = z[at] - factor[d, 0, 0] * a - u[0] * b - v[0] * c - w[0] * f - x[0] * g
    z[at], z[at + 1], z[at + 2], z[at + 3], z[at + 4] = a, b, c, f, g
