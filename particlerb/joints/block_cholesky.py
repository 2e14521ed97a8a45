"""Sparse block factors L D Lᵀ of A = G M⁻¹ Gᵀ, one block of rows for each joint.

Two joints couple where they share a body that moves. The order of the joints (minimum degree) and
the list of block operations are made once, as integers; the kernels run that list, so that any
topology has the same code and the same bits always. Chains and trees have two blocks a joint. A
pivot below a share of its diagonal means that the row depends on those before it: its column is
left out of this factor.
"""

import heapq
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.lanes import choose
from particlerb.joints.fives import down_fives, up_fives, update_fives
from particlerb.joints.records import Clusters, ConstraintRows, JointData, Program
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Bools, Floats, Ints, dot


class _Elimination(NamedTuple):
    """Joints in the order in which they are eliminated, and those that each leaves coupled."""

    order: list[int]
    coupled: list[list[int]]


def _eliminated(near: list[set[int]]) -> _Elimination:
    """Elimination of joints of which these are near each other, fewest neighbours first."""
    heap = [(len(neighbours), k) for k, neighbours in enumerate(near)]
    heapq.heapify(heap)
    remaining, elimination = set(range(len(near))), _Elimination([], [])
    while heap:
        degree, k = heapq.heappop(heap)
        if k not in remaining or degree != len(near[k]):
            continue
        remaining.remove(k)
        elimination.order.append(k)
        elimination.coupled.append(sorted(near[k]))
        for i in near[k]:
            near[i] |= near[k]
            near[i] -= {i, k}
            heapq.heappush(heap, (len(near[i]), i))
    return elimination


def _neighbours(a: Ints, b: Ints, moves: Bools) -> list[set[int]]:
    """Joints that share a body that moves with each joint."""
    at: defaultdict[int, list[int]] = defaultdict(list)
    for j, ends in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        for body in ends:
            if moves[body]:
                at[body].append(j)
    near: list[set[int]] = [set() for _ in range(a.size)]
    for joints in at.values():
        for j in joints:
            near[j].update(joints)
    for j, neighbours in enumerate(near):
        neighbours.discard(j)
    return near


def program_of(a: Ints, b: Ints, start: Ints, inv_mass: Floats) -> Program:
    """Program for joints of one cluster.

    Parameters
    ----------
    a, b : ndarray, shape (j,)
        Bodies of each joint.
    start : ndarray, shape (j + 1,)
        First row of each joint.
    inv_mass : ndarray, shape (n + 1,) [1/kg]
    """
    moves = inv_mass > 0.0
    elimination = _eliminated(_neighbours(a, b, moves))
    place = np.empty(a.size, dtype=np.int64)
    place[elimination.order] = np.arange(a.size)
    pairs = [(j, j) for j in range(a.size)]
    numbers = {pair: k for k, pair in enumerate(pairs)}

    def block(i: int, j: int) -> int:
        """Number of the block of two joints, the later one first."""
        pair = (i, j) if place[i] >= place[j] else (j, i)
        if pair not in numbers:
            numbers[pair] = len(pairs)
            pairs.append(pair)
        return numbers[pair]

    column, update = [0], [0]
    below: list[int] = []
    below_joint: list[int] = []
    updates: list[tuple[int, ...]] = []
    rows = np.diff(start).tolist()
    for k, coupled in zip(elimination.order, elimination.coupled, strict=True):
        coupled.sort(key=lambda j: int(place[j]))
        below += [block(i, k) for i in coupled]
        below_joint += coupled
        for n, i in enumerate(coupled):
            updates += [
                (block(i, k), block(j, k), block(i, j), rows[i], rows[j]) for j in coupled[: n + 1]
            ]
        column.append(len(below))
        update.append(len(updates))
    pair = _ints(pairs).reshape(-1, 2)
    return Program(
        start,
        pair,
        _shared(a, b, pair, inv_mass),
        _ints(elimination.order),
        _ints(column),
        _ints(below),
        _ints(below_joint),
        _ints(update),
        _ints(updates).reshape(-1, 5),
    )


def _ints(values: Sequence[Any]) -> Ints:
    """Numbers as an array."""
    return np.array(values, dtype=np.int64)


def _shared(a: Ints, b: Ints, pair: Ints, inv_mass: Floats) -> Bools:
    """Which bodies that move the joints of each block share: aa, ab, ba, bb."""
    i, j = pair.T
    ends = (a, a), (a, b), (b, a), (b, b)
    return np.stack([(p[i] == q[j]) & (inv_mass[p[i]] > 0.0) for p, q in ends], axis=1)


@inline
def _on_diagonal(data: JointData, k: int, at: int, n: int, m: float) -> None:
    """Lower half of the diagonal block k of n rows from `at` on, and its diagonal."""
    gradient, factor = data.gradient, data.factor
    for r in range(n):
        by_x, by_a = row3(gradient, at + r), row3(gradient, at + r, 3)
        by_b = row3(gradient, at + r, 6)
        for s in range(r + 1):
            v = m * dot(by_x, row3(gradient, at + s))
            v += dot(by_a, row3(gradient, at + s, 9))
            factor[k, r, s] = v + dot(by_b, row3(gradient, at + s, 12))
        data.scale[at + r] = factor[k, r, r]
        factor[k, r, r] += data.compliance[at + r]


@inline
def _add_shared(
    data: JointData, k: int, i: int, j: int, rows: int, columns: int, of: tuple[float, int, int]
) -> None:
    """Add to block k, of rows from i on with those from j on, what a body that both share gives.

    1/M with its sign, and where ∂g/∂θ, and J⁻¹ times it, of the body stand in a gradient.
    """
    gradient, factor, (m, by_i, by_j) = data.gradient, data.factor, of
    for r in range(rows):
        by_x, turning = row3(gradient, i + r), row3(gradient, i + r, by_i)
        for s in range(columns):
            v = m * dot(by_x, row3(gradient, j + s))
            factor[k, r, s] += v + dot(turning, row3(gradient, j + s, by_j))


@inline
def _off_diagonal(
    data: JointData, shares: Bools, k: int, i: int, j: int, rows: int, columns: int,
    inv_mass: tuple[float, float],
) -> None:  # fmt: skip
    """Block k, of rows from i on with those from j on; 1/M are those of the bodies of the rows."""
    first, second = inv_mass
    for r in range(rows):
        for s in range(columns):
            data.factor[k, r, s] = 0.0
    if shares[k, 0]:
        _add_shared(data, k, i, j, rows, columns, (first, 3, 9))
    if shares[k, 1]:
        _add_shared(data, k, i, j, rows, columns, (-first, 3, 12))
    if shares[k, 2]:
        _add_shared(data, k, i, j, rows, columns, (-second, 6, 9))
    if shares[k, 3]:
        _add_shared(data, k, i, j, rows, columns, (second, 6, 12))


@kernel
def assemble(
    program: Program, ends: ConstraintRows, inv_mass: Floats, data: JointData, lo: int, hi: int
) -> None:
    """A = G M⁻¹ Gᵀ in blocks lo to hi, and its diagonal."""
    start, pair, shares = program.start, program.pair, program.shares
    for k in range(lo, hi):
        i, j = pair[k, 0], pair[k, 1]
        at, to = start[i], start[j]
        rows, columns = start[i + 1] - at, start[j + 1] - to
        first, second = inv_mass[ends.a[at]], inv_mass[ends.b[at]]
        if i == j:
            if rows == 5:
                _on_diagonal(data, k, at, 5, first + second)
            else:
                _on_diagonal(data, k, at, rows, first + second)
            continue
        if rows == 5 and columns == 5:
            _off_diagonal(data, shares, k, at, to, 5, 5, (first, second))
        else:
            _off_diagonal(data, shares, k, at, to, rows, columns, (first, second))


@inline
def _factorise_diagonal(
    factor: Floats, k: int, n: int, smallest: float, scale: Floats, at: int
) -> None:
    """L D Lᵀ of a block: L below the diagonal, 1/D on it, 0 where a pivot is too small."""
    for c in range(n):
        v = factor[k, c, c]
        is_large = v > smallest * scale[at + c]
        f = choose(is_large, 1.0 / choose(is_large, v, 1.0), 0.0)
        factor[k, c, c] = f
        for r in range(n - 1, c, -1):
            share = factor[k, r, c] * f
            for i in range(c + 1, r + 1):
                factor[k, r, i] -= share * factor[k, i, c]
            factor[k, r, c] = share


@inline
def _factorise_below(factor: Floats, k: int, n: int, at: int, rows: int) -> None:
    """B L⁻ᵀ of a block B below the diagonal block k, L D of the whole factor."""
    for r in range(rows):
        for c in range(1, n):
            v = factor[at, r, c]
            for i in range(c):
                v -= factor[at, r, i] * factor[k, c, i]
            factor[at, r, c] = v


@inline
def _update(
    factor: Floats, k: int, left: int, right: int, target: int, rows: int, columns: int, n: int
) -> None:
    """Target -= left D⁻¹ rightᵀ, with D of the diagonal block k; of a diagonal block its half."""
    for r in range(rows):
        for c in range(r + 1 if left == right else columns):
            v = factor[target, r, c]
            for i in range(n):
                v -= factor[left, r, i] * factor[k, i, i] * factor[right, c, i]
            factor[target, r, c] = v


@inline
def _eliminate(
    program: Program, factor: Floats, scale: Floats, e: int, k: int, d: int, n: int,
    smallest_pivot: float,
) -> None:  # fmt: skip
    """Eliminate joint k, the one at place e, of n rows and with the diagonal block d.

    Blocks with as many rows have constant loops.
    """
    start = program.start
    _factorise_diagonal(factor, d, n, smallest_pivot, scale, start[k])
    for q in range(program.column[e], program.column[e + 1]):
        i, at = program.below_joint[q], program.below[q]
        rows = start[i + 1] - start[i]
        if rows == n:
            _factorise_below(factor, d, n, at, n)
        else:
            _factorise_below(factor, d, n, at, rows)
    for q in range(program.update[e], program.update[e + 1]):
        left, right, target = program.updates[q, 0], program.updates[q, 1], program.updates[q, 2]
        rows, columns = program.updates[q, 3], program.updates[q, 4]
        if n == 5 and rows == 5 and columns == 5:
            update_fives(factor, d, left, right, target)
        elif rows == n and columns == n:
            _update(factor, d, left, right, target, n, n, n)
        else:
            _update(factor, d, left, right, target, rows, columns, n)


@kernel
def factorise(program: Program, clusters: Clusters, factor: Floats, scale: Floats, c: int) -> None:
    """Factors in place, of cluster c.

    Numbers of rows that are often met are constants for the compiler.
    """
    start = program.start
    lo, hi, smallest_pivot = clusters.joint[c], clusters.joint[c + 1], clusters.smallest_pivot[c]
    for e in range(lo, hi):
        k = program.order[e]
        n, d = start[k + 1] - start[k], clusters.block[c] + k - lo
        if n == 5:
            _eliminate(program, factor, scale, e, k, d, 5, smallest_pivot)
        elif n == 3:
            _eliminate(program, factor, scale, e, k, d, 3, smallest_pivot)
        else:
            _eliminate(program, factor, scale, e, k, d, n, smallest_pivot)


@inline
def _take_below(factor: Floats, block: int, at: int, to: int, n: int, z: Floats, rows: int) -> None:
    """z of the rows of a block below, from `to` on, without what z of joint k gives them."""
    for r in range(rows):
        v = z[to + r]
        for c in range(n):
            v -= factor[block, r, c] * z[at + c]
        z[to + r] = v


@inline
def _down(program: Program, factor: Floats, z: Floats, e: int, k: int, d: int, n: int) -> None:
    """Forward substitution with all blocks of joint k: see `_eliminate`."""
    start = program.start
    at = start[k]
    for r in range(1, n):
        v = z[at + r]
        for c in range(r):
            v -= factor[d, r, c] * z[at + c]
        z[at + r] = v
    for r in range(n):
        z[at + r] *= factor[d, r, r]
    for q in range(program.column[e], program.column[e + 1]):
        i, block = program.below_joint[q], program.below[q]
        rows = start[i + 1] - start[i]
        if rows == n:
            _take_below(factor, block, at, start[i], n, z, n)
        else:
            _take_below(factor, block, at, start[i], n, z, rows)


@inline
def _give_below(
    factor: Floats, k: int, block: int, at: int, to: int, n: int, z: Floats, rows: int
) -> None:
    """z of joint k without what z of the rows of a block below gives it."""
    for c in range(n):
        v = 0.0
        for r in range(rows):
            v += factor[block, r, c] * z[to + r]
        z[at + c] -= factor[k, c, c] * v


@inline
def _up(program: Program, factor: Floats, z: Floats, e: int, k: int, d: int, n: int) -> None:
    """Back substitution with them."""
    start = program.start
    at = start[k]
    for q in range(program.column[e], program.column[e + 1]):
        i, block = program.below_joint[q], program.below[q]
        rows = start[i + 1] - start[i]
        if rows == n:
            _give_below(factor, d, block, at, start[i], n, z, n)
        else:
            _give_below(factor, d, block, at, start[i], n, z, rows)
    for r in range(n - 1, -1, -1):
        v = z[at + r]
        for c in range(r + 1, n):
            v -= factor[d, c, r] * z[at + c]
        z[at + r] = v


@kernel
def solve(program: Program, clusters: Clusters, factor: Floats, z: Floats, c: int) -> None:
    """z <- A⁻¹ z of cluster c."""
    order, start = program.order, program.start
    lo, hi = clusters.joint[c], clusters.joint[c + 1]
    for e in range(lo, hi):
        k = order[e]
        n, d = start[k + 1] - start[k], clusters.block[c] + k - lo
        if n == 5:
            down_fives(program, factor, z, e, k, d)
        elif n == 3:
            _down(program, factor, z, e, k, d, 3)
        else:
            _down(program, factor, z, e, k, d, n)
    for e in range(hi - 1, lo - 1, -1):
        k = order[e]
        n, d = start[k + 1] - start[k], clusters.block[c] + k - lo
        if n == 5:
            up_fives(program, factor, z, e, k, d)
        elif n == 3:
            _up(program, factor, z, e, k, d, 3)
        else:
            _up(program, factor, z, e, k, d, n)
