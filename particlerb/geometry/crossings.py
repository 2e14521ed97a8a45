"""Faces of a mesh that cross each other: sweep along one axis, then pairs of triangles.

Two faces cross if each has corners on both sides of the other's plane and they share a piece of
the line of both planes. Faces of one plane cross if they cover each other and look the same way:
their matter would count twice. What only touches does not cross: common corners and edges, an edge
that rests on a face, faces of one plane that look at each other. A distance up to `nearness` is
none.

Source of the interval test: Möller, J. Graphics Tools 2 (2), 25 (1997).
"""

import math

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross, divide, dot, norm, subtract

_MAX_PAIRS_TOLD = 1000

_Triangle = tuple[Vec3, Vec3, Vec3]


def crossings(vertices: Floats, faces: Ints, nearness: float) -> tuple[Ints, Floats]:
    """Pairs of faces that cross, (k, 2), and a point of each crossing, (k, 3) [m].

    Parameters
    ----------
    vertices, faces : ndarray, shapes (n, 3) [m], (m, 3)
        Equal vertices are one; no face is flat.
    nearness : float [m]
    """
    corner = vertices[faces]
    axis = int(np.argmax(np.ptp(vertices, axis=0)))
    order = np.argsort(corner[:, :, axis].min(axis=1), kind="stable")
    boxes = np.stack([corner.min(axis=1), corner.max(axis=1)])[:, order]
    pairs, points = np.empty((_MAX_PAIRS_TOLD, 2), dtype=np.int64), np.empty((_MAX_PAIRS_TOLD, 3))
    count = _sweep(vertices, faces[order], boxes, axis, nearness, pairs, points)
    pairs = np.sort(order[pairs[:count]], axis=1)
    by_face = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[by_face], points[:count][by_face]


@kernel
def _sweep(
    vertices: Floats, faces: Ints, boxes: Floats, axis: int, nearness: float, pairs: Ints,
    points: Floats,
) -> int:  # fmt: skip
    """Number of crossing pairs among faces in the order of their lowest coordinate on the axis."""
    low, high, count = boxes[0], boxes[1], 0
    polygon, clipped = np.empty((2, 9)), np.empty((2, 9))
    for i in range(len(faces)):
        for j in range(i + 1, len(faces)):
            if low[j, axis] > high[i, axis]:
                break
            apart = False
            for k in range(3):
                apart |= low[j, k] > high[i, k] or low[i, k] > high[j, k]
            if apart:
                continue
            meets, x, y, z = _cross_at(vertices, faces[i], faces[j], nearness, polygon, clipped)
            if meets:
                pairs[count] = i, j
                points[count] = x, y, z
                count += 1
                if count == len(pairs):
                    return count
    return count


@inline
def normal(t: _Triangle) -> Vec3:
    """Unit normal."""
    n = cross(subtract(t[1], t[0]), subtract(t[2], t[0]))
    return divide(n, norm(n))


@inline
def corners(vertices: Floats, face: Ints) -> _Triangle:
    """Corners of a face."""
    return row3(vertices, face[0]), row3(vertices, face[1]), row3(vertices, face[2])


@inline
def _along_line(t: _Triangle, line: Vec3, origin: Vec3) -> Vec3:
    """Coordinates of the corners of a triangle along a line."""
    a, b, c = subtract(t[0], origin), subtract(t[1], origin), subtract(t[2], origin)
    return dot(line, a), dot(line, b), dot(line, c)


@inline
def height(vertices: Floats, v: int, face: Ints, n: Vec3, foot: Vec3, nearness: float) -> float:
    """Distance of vertex v from the plane of a face, 0 where it is its corner or near."""
    if v == face[0] or v == face[1] or v == face[2]:
        return 0.0
    distance = dot(n, subtract(row3(vertices, v), foot))
    return 0.0 if abs(distance) <= nearness else distance


@inline
def _heights(
    vertices: Floats, other: Ints, face: Ints, n: Vec3, foot: Vec3, nearness: float
) -> Vec3:
    """The same of the corners of another face."""
    return (
        height(vertices, other[0], face, n, foot, nearness),
        height(vertices, other[1], face, n, foot, nearness),
        height(vertices, other[2], face, n, foot, nearness),
    )


@inline
def interval(along: Vec3, above: Vec3) -> tuple[float, float]:
    """Where a triangle meets a plane, on the line: coordinates and heights of its corners."""
    low, high = math.inf, -math.inf
    for k in range(3):
        m = (k + 1) % 3
        if above[k] == 0.0:
            low, high = min(low, along[k]), max(high, along[k])
        if above[k] * above[m] < 0.0:
            t = along[k] + (along[m] - along[k]) * (above[k] / (above[k] - above[m]))
            low, high = min(low, t), max(high, t)
    return low, high


@inline
def _straddles(above: Vec3) -> bool:
    """Whether corners lie on both sides."""
    return min(above[0], above[1], above[2]) < 0.0 < max(above[0], above[1], above[2])


@kernel
def _cross_at(
    vertices: Floats, f: Ints, g: Ints, nearness: float, polygon: Floats, clipped: Floats
) -> tuple[bool, float, float, float]:
    """Whether two faces cross, and a point where."""
    p, q = corners(vertices, f), corners(vertices, g)
    m, n = normal(p), normal(q)
    over_p = _heights(vertices, g, f, m, p[0], nearness)
    if over_p == (0.0, 0.0, 0.0) and dot(m, n) > 0.0:
        return _covers(p, q, m, nearness, polygon, clipped)
    over_q = _heights(vertices, f, g, n, q[0], nearness)
    line = cross(m, n)
    size = norm(line)
    if not _straddles(over_p) or not _straddles(over_q) or size == 0.0:
        return False, 0.0, 0.0, 0.0
    line = divide(line, size)
    along_p, along_q = _along_line(p, line, p[0]), _along_line(q, line, p[0])
    low_p, high_p = interval(along_p, over_q)
    low_q, high_q = interval(along_q, over_p)
    low, high = max(low_p, low_q), min(high_p, high_q)
    x, y, z = _edge_point(p, along_p, over_q, 0.5 * (low + high), line)
    return high - low > nearness, x, y, z


@inline
def _edge_point(p: _Triangle, along: Vec3, above: Vec3, t: float, line: Vec3) -> Vec3:
    """Point of the line at t: from where one edge of a triangle meets it, onwards."""
    for k in range(3):
        m = (k + 1) % 3
        if above[k] * above[m] < 0.0:
            s = above[k] / (above[k] - above[m])
            ahead = t - (along[k] + s * (along[m] - along[k]))
            return add_scaled(ahead, line, add_scaled(s, subtract(p[m], p[k]), p[k]))
    return p[0]


@kernel
def _covers(
    p: _Triangle, q: _Triangle, n: Vec3, nearness: float, polygon: Floats, clipped: Floats
) -> tuple[bool, float, float, float]:
    """Whether triangles of one plane with normal n have a common area, and its middle.

    The second is cut at the three sides of the first (Sutherland and Hodgman); what remains must
    be wider than `nearness`.
    """
    u = subtract(p[1], p[0])
    u = divide(u, norm(u))
    v = cross(n, u)
    count = 3
    for k in range(3):
        d = subtract(q[k], p[0])
        polygon[0, k], polygon[1, k] = dot(d, u), dot(d, v)
    for k in range(3):
        a, b = subtract(p[k], p[0]), subtract(p[(k + 1) % 3], p[0])
        ax, ay = dot(a, u), dot(a, v)
        ex, ey = dot(b, u) - ax, dot(b, v) - ay
        side = math.sqrt(ex * ex + ey * ey)
        n_clipped = 0
        for i in range(count):
            j = (i + 1) % count
            di = (ex * (polygon[1, i] - ay) - ey * (polygon[0, i] - ax)) / side - nearness
            dj = (ex * (polygon[1, j] - ay) - ey * (polygon[0, j] - ax)) / side - nearness
            if di > 0.0:
                clipped[0, n_clipped], clipped[1, n_clipped] = polygon[0, i], polygon[1, i]
                n_clipped += 1
            if di * dj < 0.0:
                s = di / (di - dj)
                clipped[0, n_clipped] = polygon[0, i] + s * (polygon[0, j] - polygon[0, i])
                clipped[1, n_clipped] = polygon[1, i] + s * (polygon[1, j] - polygon[1, i])
                n_clipped += 1
        count = n_clipped
        for i in range(count):
            polygon[0, i], polygon[1, i] = clipped[0, i], clipped[1, i]
    if count < 3:
        return False, 0.0, 0.0, 0.0
    area, x, y = 0.0, 0.0, 0.0
    for i in range(count):
        j = (i + 1) % count
        area += 0.5 * (polygon[0, i] * polygon[1, j] - polygon[0, j] * polygon[1, i])
        x, y = x + polygon[0, i] / count, y + polygon[1, i] / count
    if area <= nearness * nearness:
        return False, 0.0, 0.0, 0.0
    middle = add_scaled(y, v, add_scaled(x, u, p[0]))
    return True, middle[0], middle[1], middle[2]
