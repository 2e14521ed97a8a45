"""A block of bodies in the cache: state, constants and loads as rows of one flat buffer.

Row r of body b is rows[r * STRIDE + b]. All distances between rows are known while compiling, so
LLVM needs no checks for overlap, and a loop over the bodies of a block fills SIMD lanes however
long its body is; with separate arrays it gives up silently beyond some sixteen rows.

Why it is so: docs/decisions/0005.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from particlerb.compiled.jit import inline, unsigned
from particlerb.compiled.threads import BLOCK
from particlerb.maths.quaternion import Quat
from particlerb.maths.vec3 import Floats, Vec3
from particlerb.model.bodies import Bodies
from particlerb.model.state import State

STRIDE: Final = BLOCK + 8  # from row to row: a power of two would meet the same lines of the cache
CACHE_LINE: Final = 8  # numbers of a line of the cache, and of the widest SIMD register
COM: Final = 0
Q: Final = 3
P: Final = 7
L: Final = 10
EXTERNAL: Final = 13  # work, impulse, angular impulse: see integrators/external_work.py
CHANGING: Final = 20  # rows before this one change with time
INV_MASS: Final = 20
INV_INERTIA: Final = 21
ROTOR: Final = 24  # constants of asymmetric bodies that a method asks for
SCRATCH: Final = 46
LOADS: Final = 56  # from here on the parameters of the terms


@inline
def cell(at: int, b: int) -> int:
    """Index of body b in row `at`: unsigned, so that Numba asks not whether it is negative."""
    return unsigned(at * STRIDE + b)


@inline
def get(rows: Floats, at: int, b: int) -> float:
    """Number of body b in row `at`."""
    return rows[cell(at, b)]


@inline
def put(rows: Floats, at: int, b: int, value: float) -> None:
    """Write the number of body b."""
    rows[cell(at, b)] = value


@inline
def get3(rows: Floats, at: int, b: int) -> Vec3:
    """Vector of body b from row `at` on."""
    return rows[cell(at, b)], rows[cell(at + 1, b)], rows[cell(at + 2, b)]


@inline
def put3(rows: Floats, at: int, b: int, v: Vec3) -> None:
    """Write the vector of body b."""
    rows[cell(at, b)], rows[cell(at + 1, b)], rows[cell(at + 2, b)] = v


@inline
def get4(rows: Floats, at: int, b: int) -> Quat:
    """Quaternion of body b from row `at` on."""
    return rows[cell(at, b)], rows[cell(at + 1, b)], rows[cell(at + 2, b)], rows[cell(at + 3, b)]


@inline
def put4(rows: Floats, at: int, b: int, q: Quat) -> None:
    """Write the quaternion of body b."""
    rows[cell(at, b)], rows[cell(at + 1, b)], rows[cell(at + 2, b)], rows[cell(at + 3, b)] = q


@inline
def assign(target: Floats, source: Floats) -> None:
    """Copy an array into one of its shape, both without gaps.

    What Numba compiles for slices makes words for errors of shapes, which takes 2 s.
    """
    values, out = source.reshape(source.size), target.reshape(target.size)
    for i in range(out.size):
        out[i] = values[i]


@inline
def copy_changing(source: Floats, target: Floats, n: int) -> None:
    """Copy what changes with time."""
    for r in range(min(CHANGING, source.size // STRIDE)):  # LLVM would copy a constant loop out
        for b in range(n):
            put(target, r, b, get(source, r, b))


@inline
def gather_block(rows: Floats, y: Floats, lo: int, n: int) -> None:
    """States of a block whose first body is lo, into y (13, n_bodies)."""
    for c in range(y.shape[0]):
        out = y[c, lo : lo + n]
        for b in range(out.size):
            out[b] = get(rows, c, b)


@inline
def scatter_block(values: Floats, rows: Floats, at: int, first: int, lo: int, n: int) -> None:
    """Rows of values (rows, n_bodies) from `first` on, into the rows of a block from `at` on."""
    for c in range(first, values.shape[0]):
        row = values[c, lo : lo + n]
        for b in range(row.size):
            put(rows, at + c - first, b, row[b])


def in_blocks(
    n: int, n_rows: int, parts: Sequence[tuple[int, Floats]], before: Floats | None = None
) -> Floats:
    """Blocks (n_blocks, n_rows * STRIDE) of n bodies.

    Parameters
    ----------
    n, n_rows : int
        Bodies, and rows of a block.
    parts : sequence of (int, ndarray of shape (rows, n))
        What goes into the rows, and the first of these rows; all others are zero.
    before : ndarray, optional
        Blocks of so many rows, whose memory is used again where there are as many or more.
    """
    n_blocks = -(-n // BLOCK)
    if before is None or len(before) < n_blocks:
        blocks = aligned_zeros(n_blocks * n_rows * STRIDE).reshape(n_blocks, n_rows * STRIDE)
    else:
        blocks = before[:n_blocks]
        blocks[:] = 0.0
    for at, values in parts:
        into_blocks(blocks, at, values)
    return blocks


def into_blocks(blocks: Floats, at: int, values: Floats) -> None:
    """Write rows (count, n) into the rows of all blocks from `at` on; the reverse of the below."""
    count, n = values.shape
    rows = blocks.reshape(len(blocks), -1, STRIDE)
    if len(blocks) == 1:
        rows[0, at : at + count, :n], rows[0, at : at + count, n:BLOCK] = values, 0.0
        return
    room = np.zeros((count, len(blocks) * BLOCK))
    room[:, :n] = values
    rows[:, at : at + count, :BLOCK] = room.reshape(count, -1, BLOCK).swapaxes(0, 1)


def changing(blocks: Floats) -> Floats:
    """The rows of all blocks that change with time, as a view."""
    return blocks[:, : CHANGING * STRIDE]


def aligned_zeros(size: int) -> Floats:
    """Zeros from the beginning of a line of the cache on: registers never straddle two lines."""
    room = np.zeros(size + CACHE_LINE)
    first = -(room.ctypes.data // room.itemsize) % CACHE_LINE
    return room[first : first + size]


def out_of_blocks(blocks: Floats, at: int, count: int, n: int) -> Floats:
    """Some rows of all blocks as one array (count, n)."""
    parts = blocks.reshape(len(blocks), -1, STRIDE)[:, at : at + count, :BLOCK]
    return np.ascontiguousarray(parts.swapaxes(0, 1).reshape(count, -1)[:, :n])


def state_rows(state: State, bodies: Bodies) -> list[tuple[int, Floats]]:
    """Where state and constants of bodies go."""
    return [
        (COM, state.com),
        (Q, state.q),
        (P, state.p),
        (L, state.L),
        (INV_MASS, bodies.inv_mass[None]),
        (INV_INERTIA, bodies.inv_inertia),
    ]
