"""Cells of a tree: how they are grown around bodies, and what their particles amount to.

Cells are split along the longest side of the box round the centres of their bodies, into halves by
number, down to buckets of at most BUCKET particles or of one body; a body of more particles has a
tree of its own, grown once in its rotor frame, which is grafted on there.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.forces.gravity_tree.lanes import BUCKET, at
from particlerb.forces.gravity_tree.multipole import (
    MASS,
    PLACE,
    TERMS,
    add_particle_moments,
    add_shifted_moments,
)
from particlerb.maths.quaternion import matrix, turn
from particlerb.maths.rows import column3, column3_at, column4, put_column3, rows3, rows4
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross

DEEPEST: Final = 128  # levels: two trees of halves
BALL: Final = 7  # columns of `ball`


class Nodes(NamedTuple):
    """Cells before those inside them; a cell that is split has its first half right after it."""

    second: Ints  # (n_nodes,) other half, 0 where the cell is not split
    end: Ints  # (n_nodes,) first cell after all that are inside
    first: Ints  # (n_nodes,) particle
    stop: Ints  # (n_nodes,) particle, excluded
    body: Ints  # (n_nodes,) of which the cell is a part, -1 where it has several


class Cells(NamedTuple):
    """What the particles of each cell amount to.

    The columns of `ball` are the centre of mass, world frame, and the distance of the furthest
    particle [m], the number of particles, 1 if it is a bucket or a particle, and the mass [kg].
    """

    ball: Floats  # (n_nodes + n_points, BALL) see above; particles are cells after all others
    moment: Floats  # (n_nodes, TERMS) [kg m^|α|]
    energy: Floats  # (n_nodes,) [kg²/m] of what the cell itself meets


class TreePoints(NamedTuple):
    """Particles in the order of the tree."""

    place: Floats  # (3, n_points) [m], world frame
    mass: Floats  # (n_points,) [kg]
    owner: Floats  # (n_points,) number of the body
    field: Floats  # (3, n_points) [kg/m²] acceleration over G


class Kinds(NamedTuple):
    """Particles of each body in the order of its own tree, and that tree."""

    arm: Floats  # (3, n_points) [m], rotor frame
    mass: Floats  # (n_points,) [kg]
    offset: Ints  # (n_bodies + 1,) of particles
    nodes: Nodes
    node_offset: Ints  # (n_bodies + 1,)


def room_for_nodes(n: int) -> Nodes:
    """Room for so many."""
    return Nodes(*(np.zeros(n, dtype=np.int64) for _ in range(5)))


# Growing


@inline
def _swap(items: tuple[Floats, Ints, Ints], i: int, j: int) -> None:
    """Exchange two items."""
    place, order, weight = items
    for k in range(3):
        place[k, i], place[k, j] = place[k, j], place[k, i]
    order[i], order[j] = order[j], order[i]
    weight[i], weight[j] = weight[j], weight[i]


@inline
def select(items: tuple[Floats, Ints, Ints], axis: int, lo: int, hi: int, middle: int) -> None:
    """Bring those with the lesser coordinates before `middle`: Hoare's selection."""
    x = items[0][axis]
    hi -= 1
    while lo < hi:
        m = (lo + hi) // 2
        if x[m] < x[lo]:
            _swap(items, m, lo)
        if x[hi] < x[lo]:
            _swap(items, hi, lo)
        if x[hi] < x[m]:
            _swap(items, hi, m)
        pivot = x[m]
        i, j = lo, hi
        while i <= j:
            while x[i] < pivot:
                i += 1
            while x[j] > pivot:
                j -= 1
            if i <= j:
                _swap(items, i, j)
                i += 1
                j -= 1
        if middle <= j:
            hi = j
        elif middle >= i:
            lo = i
        else:
            return


@inline
def _longest_side(place: Floats, lo: int, hi: int) -> int:
    """Axis along which items lo to hi are furthest apart."""
    axis, longest = 0, -1.0
    for k in range(3):
        x = place[k]
        least, most = x[lo], x[lo]
        for i in range(lo + 1, hi):
            least, most = min(least, x[i]), max(most, x[i])
        if most - least > longest:
            axis, longest = k, most - least
    return axis


@inline
def _middle_of(lo: int, hi: int, points: int) -> int:
    """Where to split: nearly in halves, so that buckets become full if bodies are alike."""
    full = max(1, BUCKET * (hi - lo) // points)
    buckets = -(-(hi - lo) // full)
    return lo + full * ((buckets + 1) // 2)


@inline
def _graft(kinds: Nodes, lo: int, hi: int, b: int, k: int, placed: int, nodes: Nodes) -> int:
    """Copy the tree of body b to node k on; return the number of nodes after it."""
    for j in range(hi - lo):
        second = kinds.second[lo + j]
        nodes.second[k + j] = k + second if second > 0 else 0
        nodes.first[k + j] = placed + kinds.first[lo + j]
        nodes.stop[k + j] = placed + kinds.stop[lo + j]
        nodes.body[k + j] = b
    return k + hi - lo


@kernel
def grow(
    items: tuple[Floats, Ints, Ints], kinds: Nodes, node_offset: Ints, nodes: Nodes, stack: Ints
) -> int:
    """Write the tree of items of given places and numbers of particles; return its size.

    Parameters
    ----------
    items : tuple of ndarrays
        Places, (3, n) [m], numbers and weights, (n,); all are brought into the order of the tree.
    kinds, node_offset : Nodes, ndarray
        Trees of the items of more than BUCKET particles, that of item b from node_offset[b] on.
    nodes : Nodes
        Room.
    stack : ndarray, shape (4, ...)
    """
    place, order, weight = items
    second, end, first, stop, body = nodes
    count, placed, top = 0, 0, 1
    stack[0, 0], stack[1, 0], stack[2, 0] = 0, order.size, -1
    while top > 0:
        top -= 1
        lo, hi, parent = stack[0, top], stack[1, top], stack[2, top]
        k = count
        if parent >= 0:
            second[parent] = k
        points = 0
        for i in range(lo, hi):
            points += weight[i]
        second[k], first[k], stop[k] = 0, placed, placed + points
        body[k] = order[lo] if hi - lo == 1 else -1
        count += 1
        if points > BUCKET and hi - lo > 1:
            middle = _middle_of(lo, hi, points)
            select(items, _longest_side(place, lo, hi), lo, hi, middle)
            stack[0, top], stack[1, top], stack[2, top] = middle, hi, k
            stack[0, top + 1], stack[1, top + 1], stack[2, top + 1] = lo, middle, -1
            top += 2
            continue
        if points > BUCKET:
            b = order[lo]
            count = _graft(kinds, node_offset[b], node_offset[b + 1], b, k, placed, nodes)
        placed += points
    for k in range(count - 1, -1, -1):
        end[k] = end[second[k]] if second[k] > 0 else k + 1
    return count


# Filling


@kernel
def place_points(
    kinds: Kinds,
    y: Floats,
    order: Ints,
    begin: Ints,
    points: TreePoints,
    ball: Floats,
    first: int,
    end: int,
) -> None:
    """Place the particles of bodies first to end, in the order of the tree: x = com + R r.

    Parameters
    ----------
    kinds : Kinds
        Particles.
    y : ndarray, shape (13, n_bodies)
        Centre of mass [m], unit quaternion from rotor frame to world; the rest is not used.
    order, begin : ndarray, shapes (n_bodies,) and (n_bodies + 1,)
        Bodies as they follow in the tree, and their first particles there.
    points, ball : TreePoints, ndarray of shape (n_points, 7)
        What is written: particles, and the same as cells.
    first, end : int
        Positions in `order`, end excluded.
    """
    com, q = rows3(y, 0, y.shape[1]), rows4(y[3:7], 0, y.shape[1])
    arms, places = rows3(kinds.arm, 0, kinds.mass.size), rows3(points.place, 0, kinds.mass.size)
    offset, masses, mass, owner = kinds.offset, kinds.mass, points.mass, points.owner
    for k in range(first, end):
        b, at_first = order[k], begin[k]
        x, R, lo = column3(com, b), matrix(column4(q, b)), offset[b]
        for i in range(offset[b + 1] - lo):
            j = at_first + i
            place, m = add_scaled(1.0, turn(R, column3(arms, lo + i)), x), masses[lo + i]
            put_column3(places, j, place)
            ball[j, 0], ball[j, 1], ball[j, 2] = place
            ball[j, 3], ball[j, 4], ball[j, 5], ball[j, 6] = 0.0, 1.0, 1.0, m
            mass[j], owner[j] = m, b


@inline
def _centre_of(mass: Floats, place: Floats, lo: int, hi: int) -> Vec3:
    """Centre of mass of particles; that of massless ones is the first."""
    X, total = (0.0, 0.0, 0.0), 0.0
    o = column3_at(place, lo)
    for i in range(lo, hi):
        a = (place[0, i] - o[0], place[1, i] - o[1], place[2, i] - o[2])
        X, total = add_scaled(mass[i], a, X), total + mass[i]
    return add_scaled(1.0 / total if total > 0.0 else 0.0, X, o)


@inline
def reach(X: Vec3, points: TreePoints, lo: int, hi: int) -> float:
    """Distance ρ of the furthest particle, or what tells more where many are far out.

    That is (3 <r⁶>)^{1/6}, with the mean by mass: in a full ball it is the radius too, and the
    series that is cut off after order 5 errs by terms in r⁶.
    """
    place, mass, _, _ = points
    most, total, sixth = 0.0, 0.0, 0.0
    for i in range(lo, hi):
        dx, dy, dz = place[0, i] - X[0], place[1, i] - X[1], place[2, i] - X[2]
        square = dx * dx + (dy * dy + dz * dz)
        most = max(most, square)
        total, sixth = total + mass[i], sixth + mass[i] * square * square * square
    mean = 3.0 * sixth / total if total > 0.0 else 0.0
    return float(np.sqrt(max(most, mean ** (1.0 / 3.0))))


@inline
def load_lanes(rows: Floats, points: TreePoints, X: Vec3, lo: int, hi: int) -> None:
    """Put particles into lanes, from X; the lanes without one have no mass and the first place."""
    for i in range(BUCKET):
        j = lo + i if lo + i < hi else lo
        for k in range(3):
            rows[at(PLACE + k, i)] = points.place[k, j] - X[k]
        rows[at(MASS, i)] = points.mass[j] if lo + i < hi else 0.0


@inline
def _halves_centre(cells: Cells, one: int, other: int) -> Vec3:
    """Centre of mass of two cells."""
    ball, m, n = cells.ball, cells.moment[one, 0], cells.moment[other, 0]
    s = n / (m + n) if m + n > 0.0 else 0.0
    d = (
        ball[other, 0] - ball[one, 0],
        ball[other, 1] - ball[one, 1],
        ball[other, 2] - ball[one, 2],
    )
    return add_scaled(s, d, (ball[one, 0], ball[one, 1], ball[one, 2]))


@kernel
def fill_cells(
    nodes: Nodes, points: TreePoints, cells: Cells, rows: Floats, powers: Floats, count: int
) -> None:
    """Write centre, radius and moments of cells, the inner ones first."""
    second, _, first, stop, _ = nodes
    ball, moment, _ = cells
    for k in range(count - 1, -1, -1):
        lo, hi = first[k], stop[k]
        for i in range(TERMS):
            moment[k, i] = 0.0
        if second[k] > 0:
            X = _halves_centre(cells, k + 1, second[k])
            for half in (k + 1, second[k]):
                s = (ball[half, 0] - X[0], ball[half, 1] - X[1], ball[half, 2] - X[2])
                add_shifted_moments(s, moment[half], powers, moment[k])
        else:
            X = _centre_of(points.mass, points.place, lo, hi)
            load_lanes(rows, points, X, lo, hi)
            add_particle_moments(rows, moment[k])
        ball[k, 0], ball[k, 1], ball[k, 2] = X
        ball[k, 3], ball[k, 4] = reach(X, points, lo, hi), hi - lo
        ball[k, 5], ball[k, 6] = 0.0 if second[k] > 0 else 1.0, moment[k, 0]


@kernel
def add_loads(
    kinds: Kinds,
    y: Floats,
    order: Ints,
    begin: Ints,
    points: TreePoints,
    gravitation: float,
    load: Floats,
    first: int,
    end: int,
) -> None:
    """Add force Σ m g and torque Σ (x - com) × m g of bodies first to end in the tree's order."""
    com, places = rows3(y, 0, y.shape[1]), rows3(points.place, 0, points.mass.size)
    fields = rows3(points.field, 0, points.mass.size)
    for k in range(first, end):
        b = order[k]
        X, F, tau = column3(com, b), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for i in range(begin[k], begin[k + 1]):
            f = column3(fields, i)
            m = gravitation * points.mass[i]
            force = (m * f[0], m * f[1], m * f[2])
            arm = add_scaled(-1.0, X, column3(places, i))
            F, tau = add_scaled(1.0, force, F), add_scaled(1.0, cross(arm, force), tau)
        for axis in range(3):
            load[axis, b] += F[axis]
            load[3 + axis, b] += tau[axis]
