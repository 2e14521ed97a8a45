"""The walk down a tree of cells that finds the field in each of them: see tree.py.

A cell carries a list of the others that it still has to meet. Each is met as a whole, or particle
by particle, or one of the two is split, as `_encounter` says; it says the same of A and B as of B
and A, so that A meets B where B meets A. A bucket can be split too, into its particles, which are
cells with the numbers `second.size` on. Where a bucket lies far out among few and looks upon very
many, as in a halo, its own size would otherwise make it meet all of them one by one.
"""

from typing import Final, NamedTuple, TypeAlias

from particlerb.compiled.jit import inline, kernel
from particlerb.forces.attraction import inverse_cube, squared
from particlerb.forces.gravity_tree.cells import Cells, Nodes, TreePoints, load_lanes
from particlerb.forces.gravity_tree.lanes import BUCKET, at, clear, lane_sum
from particlerb.forces.gravity_tree.multipole import (
    FIELD,
    LOCAL,
    MASS,
    MOMENT,
    OWNER,
    PLACE,
    SIGNS,
    TERMS,
    add_far,
    add_far_to_point,
    add_particle_fields,
    add_shifted_field,
)
from particlerb.maths.rows import column3_at
from particlerb.maths.vec3 import Floats, Ints, Vec3, subtract

RANGES: Final = 128  # of particles that are waited for
_MIN_SPLIT_PARTICLES: Final = 256  # from which on a larger bucket that sees them is split
_Ball: TypeAlias = tuple[float, float, float, float, float, float]
_TAKE_WHOLE: Final = 0
_TAKE_EACH: Final = 1
_SPLIT_A: Final = 2
_SPLIT_B: Final = 3


class Scratch(NamedTuple):
    """Room of one thread."""

    rows: Floats  # (ROWS * BUCKET,) buffer of multipole.py
    near: Floats  # (MOMENT * BUCKET,) particles of a bucket, and what attracts them
    powers: Floats  # (TERMS,)
    scaled: Floats  # (TERMS,) [m^|α|] moments over mass
    local: Floats  # (DEEPEST, TERMS) field in the cells on the way from the root
    far: Ints  # (BUCKET,) cells to be met as a whole
    ranges: Ints  # (2 * RANGES,) particles to be met one by one
    stack: Ints  # (5, 4 * DEEPEST)
    meets: Ints  # (levels * n,) cells that those of a level have to meet


# Meeting


@inline
def _encounter(a: _Ball, b: _Ball, is_later: bool, square: float) -> int:
    """How cells A and B, A later than B or not, meet at θ²: the same if they are exchanged."""
    dx, dy, dz = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    if 2.0 * (a[3] * a[3] + b[3] * b[3]) < square * (dx * dx + (dy * dy + dz * dz)):
        return _TAKE_WHOLE
    is_end, is_other_end = a[5] > 0.0, b[5] > 0.0
    if is_end and is_other_end:
        return _TAKE_EACH
    if is_end:
        return _SPLIT_A if a[3] > b[3] and b[4] > _MIN_SPLIT_PARTICLES else _SPLIT_B
    if is_other_end:
        return _SPLIT_B if b[3] > a[3] and a[4] > _MIN_SPLIT_PARTICLES else _SPLIT_A
    return _SPLIT_B if b[3] > a[3] or (b[3] == a[3] and is_later) else _SPLIT_A


@inline
def _ball_of(cells: Cells, A: int) -> _Ball:
    """Ball of a cell."""
    ball = cells.ball
    return ball[A, 0], ball[A, 1], ball[A, 2], ball[A, 3], ball[A, 4], ball[A, 5]


@inline
def _load_far(cells: Cells, X: Vec3, far: Ints, count: int, rows: Floats) -> None:
    """Put cells into lanes, seen from X; lanes without one have no mass."""
    ball, moment, _ = cells
    for i in range(BUCKET):
        B = far[i if i < count else 0]
        for k in range(3):
            rows[at(PLACE + k, i)] = X[k] - ball[B, k]
        is_cell = moment.shape[0] > B
        if i < count and is_cell:
            for k in range(TERMS):
                rows[at(MOMENT + k, i)] = SIGNS[k] * moment[B, k]
        else:
            for k in range(TERMS):
                rows[at(MOMENT + k, i)] = 0.0
            if i < count:
                rows[at(MOMENT, i)] = ball[B, 6]


@kernel
def _meet_far(
    cells: Cells, X: Vec3, far: Ints, count: int, eps2: float, rows: Floats, scaled: Floats
) -> None:
    """Add the fields of some cells to that of a cell at X, given its moments over its mass."""
    _load_far(cells, X, far, count, rows)
    add_far(rows, scaled, eps2)


@kernel
def _meet_far_point(
    cells: Cells, X: Vec3, far: Ints, count: int, eps2: float, rows: Floats, scaled: Floats
) -> None:
    """Add the fields of some cells to that at a point."""
    _load_far(cells, X, far, count, rows)
    add_far_to_point(rows, scaled, eps2)


@inline
def _pull(near: Floats, lane: int, x: Vec3, m: float, eps2: float, is_own: bool) -> None:
    """Add the field of a particle at x to that in a lane, and its potential's depth.

    One of the same body has none.
    """
    X = near[at(PLACE, lane)], near[at(PLACE + 1, lane)], near[at(PLACE + 2, lane)]
    d = subtract(x, X)
    square = 1.0 if is_own else squared(d, eps2)
    w = inverse_cube(0.0 if is_own else m, square)
    near[at(FIELD, lane)] += w * d[0]
    near[at(FIELD + 1, lane)] += w * d[1]
    near[at(FIELD + 2, lane)] += w * d[2]
    near[at(MASS, lane)] += w * square


@kernel
def _pull_by(
    place: Floats, mass: Floats, ranges: Ints, count: int, eps2: float, near: Floats
) -> None:
    """Add the field of ranges of particles to that of a bucket, and their potential's depth.

    A loop over BUCKET, which the compiler knows, would be written out before it could be put into
    vectors: it asks the array.
    """
    for k in range(count):
        for j in range(ranges[2 * k], ranges[2 * k + 1]):
            x, m = column3_at(place, j), mass[j]
            for i in range(near.size // MOMENT):
                _pull(near, i, x, m, eps2, False)


@kernel
def _pull_each_other(points: TreePoints, lo: int, hi: int, eps2: float, near: Floats) -> None:
    """Add the field of a bucket's own particles, those of the same body left out."""
    for j in range(lo, hi):
        x = column3_at(points.place, j)
        owner, m = points.owner[j], points.mass[j]
        for i in range(BUCKET):
            _pull(near, i, x, m, eps2, near[at(OWNER, i)] == owner)


@inline
def _meet_itself(
    nodes: Nodes, points: TreePoints, A: int, tail: int, eps2: float, scratch: Scratch
) -> int:
    """Let the parts of a cell meet each other, unless all are of one body."""
    if nodes.body[A] >= 0:
        return tail
    if nodes.second[A] == 0:
        _pull_each_other(points, nodes.first[A], nodes.stop[A], eps2, scratch.near)
        return tail
    scratch.meets[tail], scratch.meets[tail + 1] = A + 1, nodes.second[A]
    return tail + 2


@inline
def meet(
    tree: tuple[Nodes, TreePoints, Cells],
    scratch: Scratch,
    A: int,
    lists: tuple[int, int],
    square: float,
    eps2: float,
) -> int:
    """Let cell A meet those in a list; return the end of the list for its parts.

    Parameters
    ----------
    A : int
        The cell whose field grows.
    lists : tuple of two ints
        First of its list, and its end, excluded; that for its parts is written behind it.
    square, eps2 : float
        θ² and ε².
    """
    nodes, points, cells = tree
    second, _, first, stop, _ = nodes
    place, mass = points.place, points.mass
    rows, scaled, near, ranges = scratch.rows, scratch.scaled, scratch.near, scratch.ranges
    meets, stack, far = scratch.meets, scratch.stack, scratch.far
    a = _ball_of(cells, A)
    X = a[:3]
    tail, n_far, n_near = lists[1], 0, 0
    for listed in range(lists[0], lists[1]):
        stack[2, 0], top = meets[listed], 1
        while top > 0:
            top -= 1
            B = stack[2, top]
            if A == B:
                tail = _meet_itself(nodes, points, A, tail, eps2, scratch)
                continue
            how = _encounter(a, _ball_of(cells, B), A > B, square)
            if how == _TAKE_WHOLE:
                far[n_far] = B
                n_far += 1
                if n_far == BUCKET:
                    _meet_far(cells, X, far, n_far, eps2, rows, scaled)
                    n_far = 0
            elif how == _TAKE_EACH:
                j = B - second.size
                ranges[2 * n_near] = j if j >= 0 else first[B]
                ranges[2 * n_near + 1] = j + 1 if j >= 0 else stop[B]
                n_near += 1
                if n_near == RANGES:
                    _pull_by(place, mass, ranges, n_near, eps2, near)
                    n_near = 0
            elif how == _SPLIT_A:
                meets[tail] = B
                tail += 1
            elif second[B] > 0:
                stack[2, top], stack[2, top + 1] = second[B], B + 1
                top += 2
            else:
                for j in range(first[B], stop[B]):
                    stack[2, top] = second.size + j
                    top += 1
    _pull_by(place, mass, ranges, n_near, eps2, near)
    if n_far > 0:
        _meet_far(cells, X, far, n_far, eps2, rows, scaled)
    return tail


@kernel
def _pull_lane(
    place: Floats, mass: Floats, lo: int, hi: int, eps2: float, near: Floats, lane: int
) -> None:
    """Add the field of particles to that of one of a bucket."""
    for j in range(lo, hi):
        _pull(near, lane, column3_at(place, j), mass[j], eps2, False)


@kernel
def _meet_point(
    tree: tuple[Nodes, TreePoints, Cells],
    scratch: Scratch,
    i: int,
    lane: int,
    lists: tuple[int, int],
    square: float,
    eps2: float,
) -> None:
    """Let particle i, in a lane of a bucket, meet the cells in a list."""
    nodes, points, cells = tree
    second, _, first, stop, _ = nodes
    place, mass = points.place, points.mass
    rows, scaled, near = scratch.rows, scratch.scaled, scratch.near
    meets, stack, far = scratch.meets, scratch.stack, scratch.far
    A, n_far = second.size + i, 0
    a = _ball_of(cells, A)
    X = a[:3]
    clear(rows, LOCAL, LOCAL + 4)
    for listed in range(lists[0], lists[1]):
        stack[2, 0], top = meets[listed], 1
        while top > 0:
            top -= 1
            B = stack[2, top]
            how = _encounter(a, _ball_of(cells, B), A > B, square)
            if how == _TAKE_WHOLE:
                far[n_far] = B
                n_far += 1
                if n_far == BUCKET:
                    _meet_far_point(cells, X, far, n_far, eps2, rows, scaled)
                    n_far = 0
            elif how == _TAKE_EACH:
                _pull_lane(place, mass, first[B], stop[B], eps2, near, lane)
            else:
                stack[2, top], stack[2, top + 1] = second[B], B + 1
                top += 2
    if n_far > 0:
        _meet_far_point(cells, X, far, n_far, eps2, rows, scaled)
    near[at(MASS, lane)] += lane_sum(rows, LOCAL)
    for k in range(3):
        near[at(FIELD + k, lane)] += lane_sum(rows, LOCAL + 1 + k)


# Walking


@inline
def _load_bucket(points: TreePoints, lo: int, hi: int, near: Floats) -> None:
    """Put the particles of a bucket into lanes, without a field."""
    load_lanes(near, points, (0.0, 0.0, 0.0), lo, hi)
    for i in range(BUCKET):
        near[at(OWNER, i)] = points.owner[lo + i] if lo + i < hi else points.owner[lo]
    clear(near, MASS, FIELD + 3)


@inline
def _store_fields(
    points: TreePoints, X: Vec3, lo: int, hi: int, local: Floats, scratch: Scratch
) -> float:
    """Write the fields at the particles of a bucket; return the depth of what it meets nearby."""
    rows, near = scratch.rows, scratch.near
    load_lanes(rows, points, X, lo, hi)
    clear(rows, FIELD, FIELD + 3)
    add_particle_fields(rows, local)
    depth = 0.0
    for i in range(hi - lo):
        for k in range(3):
            points.field[k, lo + i] = near[at(FIELD + k, i)] + rows[at(FIELD + k, i)]
        depth += points.mass[lo + i] * near[at(MASS, i)]
    return depth


@inline
def _sum_local(
    cells: Cells, A: int, scratch: Scratch, inherited: Floats, local: Floats, parent: int
) -> float:
    """Write the field in A, from what it has met and from its parent's; return the depth of A."""
    depth = 0.0
    for k in range(TERMS):
        local[k] = lane_sum(scratch.rows, LOCAL + k)
        depth += local[k] * cells.moment[A, k]
    if parent >= 0:
        s = subtract(_ball_of(cells, A)[:3], _ball_of(cells, parent)[:3])
        add_shifted_field(s, inherited, scratch.powers, local)
    return depth


@kernel
def walk(
    tree: tuple[Nodes, TreePoints, Cells],
    scratch: Scratch,
    square: float,
    eps2: float,
    start: int,
    until: int,
) -> None:
    """Write the fields at the particles of cells start to until, and the energy of these cells.

    Cells above are gone through on the way, by every thread that needs them, with the same bits.

    Parameters
    ----------
    tree : tuple
        Cells that are filled; fields and energies are written.
    scratch : Scratch
        Own room of the thread.
    square, eps2 : float
        θ² and ε² [m²].
    start, until : int
        Cells, until excluded: whole branches.
    """
    nodes, points, cells = tree
    second, end, first, stop, _ = nodes
    local, stack, near = scratch.local, scratch.stack, scratch.near
    scratch.meets[0], bounds, path = 0, stack[3], stack[4]
    stack[0, 0], stack[1, 0], bounds[0], bounds[1], top = 0, 0, 0, 1, 1
    while top > 0:
        top -= 1
        A, level = stack[0, top], stack[1, top]
        if until <= A or end[A] <= start:
            continue
        clear(scratch.rows, LOCAL, LOCAL + TERMS)
        m = cells.moment[A]
        for k in range(TERMS):
            scratch.scaled[k] = m[k] / m[0] if m[0] > 0.0 else 0.0
        if second[A] == 0:
            _load_bucket(points, first[A], stop[A], near)
        lists = (bounds[level], bounds[level + 1])
        tail = meet(tree, scratch, A, lists, square, eps2)
        parent = path[level - 1] if level > 0 else -1
        depth = _sum_local(cells, A, scratch, local[level], local[level + 1], parent)
        if second[A] > 0:
            path[level], bounds[level + 2] = A, tail
            stack[0, top], stack[0, top + 1] = second[A], A + 1
            stack[1, top], stack[1, top + 1] = level + 1, level + 1
            top += 2
        else:
            if tail > lists[1]:
                for i in range(first[A], stop[A]):
                    _meet_point(tree, scratch, i, i - first[A], (lists[1], tail), square, eps2)
            X = _ball_of(cells, A)[:3]
            depth += _store_fields(points, X, first[A], stop[A], local[level + 1], scratch)
        cells.energy[A] = -0.5 * depth
