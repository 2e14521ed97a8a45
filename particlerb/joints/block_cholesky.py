"""Sparse block factors L D Lᵀ of A = G M⁻¹ Gᵀ, one block of rows for each joint.

The list of block operations is made once, as integers (elimination.py); the kernels run that list,
so that any topology has the same code and the same bits always. A pivot below a share of its
diagonal means that the row depends on those before it: its column is left out of this factor. Of a
joint that closes a loop the rows that count are those with the largest pivots, whichever these are
in a pose: what is next to nothing at one end of a drift is not so at the other.
"""

from math import inf

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.lanes import any_of, choose, opposite
from particlerb.joints.fives import down_fives, up_fives, update_fives
from particlerb.joints.records import Clusters, ConstraintRows, JointData, Program
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Bools, Floats, dot


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
def _choose_rows(data: JointData, k: int, n: int, smallest: float, at: int) -> None:
    """Make the scale of rows 0 if they count, and inf if they depend on others of their block.

    One by one the row with the largest pivot over its diagonal counts. Half of the block and
    what iterations keep of the last one are used meanwhile.
    """
    factor, pivot, column, scale = data.factor, data.last_gain, data.last_g, data.scale
    for r in range(n):
        pivot[at + r] = factor[k, r, r]
        scale[at + r] = 1.0 / choose(scale[at + r] > 0.0, scale[at + r], 1.0)
        for s in range(r):
            factor[k, s, r] = factor[k, r, s]
    for _ in range(n):
        largest, inverse, is_found = smallest, 0.0, False
        for r in range(n):
            column[at + r] = 0.0
            share = pivot[at + r] * scale[at + r]
            largest = choose(share > largest, share, largest)
        for r in range(n):
            is_next = (pivot[at + r] * scale[at + r] == largest) & (largest > smallest)
            is_next = is_next & opposite(is_found)
            is_found = is_found | is_next
            inverse = choose(is_next, 1.0 / choose(is_next, pivot[at + r], 1.0), inverse)
            for i in range(n):
                if i != r:
                    shared = factor[k, min(i, r), max(i, r)]
                    column[at + i] = choose(is_next, shared, column[at + i])
            pivot[at + r] = choose(is_next, -inf, pivot[at + r])
        if not any_of(is_found):
            break
        for r in range(n):
            share = column[at + r] * inverse
            pivot[at + r] -= share * column[at + r]
            for s in range(r):
                factor[k, s, r] -= share * column[at + s]
    for r in range(n):
        scale[at + r] = choose(pivot[at + r] == -inf, 0.0, inf)
        pivot[at + r] = 0.0


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
    program: Program, data: JointData, e: int, k: int, d: int, n: int, smallest_pivot: float,
    chooses: bool,
) -> None:  # fmt: skip
    """Eliminate joint k, the one at place e, of n rows and with the diagonal block d.

    Blocks with as many rows have constant loops.
    """
    start, factor, scale = program.start, data.factor, data.scale
    if chooses and program.closes[k]:
        _choose_rows(data, d, n, smallest_pivot, start[k])
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
def factorise(program: Program, clusters: Clusters, data: JointData, c: int, chooses: bool) -> None:
    """Factors in place, of cluster c.

    Numbers of rows that are often met are constants for the compiler. `chooses`: it finds which
    rows count; else `scale` says so.
    """
    start = program.start
    lo, hi, smallest_pivot = clusters.joint[c], clusters.joint[c + 1], clusters.smallest_pivot[c]
    for e in range(lo, hi):
        k = program.order[e]
        n, d = start[k + 1] - start[k], clusters.block[c] + k - lo
        if n == 5:
            _eliminate(program, data, e, k, d, 5, smallest_pivot, chooses)
        elif n == 3:
            _eliminate(program, data, e, k, d, 3, smallest_pivot, chooses)
        else:
            _eliminate(program, data, e, k, d, n, smallest_pivot, chooses)


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
