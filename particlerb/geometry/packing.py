"""Spheres that fill a mesh from inside: the contact shape of a body that is no sphere.

Each sphere is inscribed: it lies in the matter and touches the surface. Of all that are centred in
the cells of a grid, the one that holds most matter which no sphere holds yet comes next, so that
the first k of a packing are the packing of k. This greedy cover holds at least 1 − 1/e of what the
best k spheres of the grid would (Nemhauser, Wolsey, Fisher, Math. Programming 14, 265, 1978).

Read in this order: `packing`; `_near_faces` and `_sweep_distance`, the distance of every cell from
the surface; `cover`, which takes sphere after sphere.
"""

import heapq
import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.geometry.cells import cut_mesh, grid_over, pieces
from particlerb.geometry.mesh import TriangleMesh, mesh_solid
from particlerb.geometry.winding import solid_angle
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, corner3, dot, subtract

_MATTER_CELLS: Final = 40_000  # about: how finely centres are tried
_MAX_CELLS: Final = 4_000_000  # of the whole grid: a thin body that lies askew has many empty
_MIN_RADIUS_CELLS: Final = 0.25  # below which spheres are of no use
_SWEEPS_PER_DIRECTION: Final = 2  # of eight
_MAX_HALVINGS: Final = 5  # of the step by which a sphere is moved to grow
_MIN_GROWTH: Final = 0.55  # of a radius, in steps; towards the ridge of a corner, 1/√3


class _Cells(NamedTuple):
    """Matter of all cells, and how far it is from the surface; of the shape of the grid."""

    share: Floats
    """Of a cell that is matter."""
    centroid: Floats
    """[m], and components."""
    nearest: Ints
    """Face; -1 where none is known yet."""
    squared: Floats
    """Distance from it [m²]; infinite where none is known."""


class _Packing(NamedTuple):
    """Inscribed spheres, the most useful first."""

    centre: Floats
    """[m], shape (k, 3)."""
    radius: Floats
    """[m], shape (k,)."""


def packing(mesh: TriangleMesh, most: int) -> _Packing:
    """Spheres in a mesh, `most` of them, or fewer where no more find room in the grid.

    Parameters
    ----------
    mesh : TriangleMesh
        As `geometry.mesh.checked` leaves it.
    most : int

    Raises
    ------
    ValueError
        If not one sphere finds room.
    """
    lower, upper = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    extent = upper - lower
    finest = max(mesh_solid(mesh).volume / _MATTER_CELLS, math.prod(extent) / _MAX_CELLS)
    grid = grid_over(lower, upper, math.ceil(extent.max() / math.cbrt(finest)))
    held = pieces(cut_mesh(mesh.vertices, mesh.faces, grid), grid)
    cell = tuple(held.cell.T)
    share, centroid = np.zeros(grid.counts), np.zeros((*grid.counts, 3))
    share[cell], centroid[cell] = held.share, held.centroid
    nearest = np.full(grid.counts, -1, dtype=np.int64)
    cells = _Cells(share, centroid, nearest, np.full(grid.counts, np.inf))
    corner = np.ascontiguousarray(mesh.vertices[mesh.faces])
    _near_faces(corner, cells, grid.lower, grid.spacing)
    for turn in range(8 * _SWEEPS_PER_DIRECTION):
        signs = 1 - 2 * (turn & 1), 1 - (turn & 2), 1 - (turn & 4) // 2
        _sweep_distance(corner, cells, signs)
    centre, radius = np.empty((most, 3)), np.empty(most)
    point = np.ascontiguousarray(np.concatenate([held.centroid.T, held.share[None]]))
    step = float(grid.spacing.min())
    count = cover(corner, point, cells.squared[cell], step, centre, radius)
    if count == 0:
        raise ValueError("no sphere fits into the mesh: it is thinner than a cell of the grid")
    return _Packing(centre[:count].copy(), radius[:count].copy())


# Distance from the surface


@inline
def _off_segment(p: Vec3, a: Vec3, b: Vec3) -> float:
    """Square of the distance of a point from a segment."""
    d, r = subtract(b, a), subtract(p, a)
    t = min(max(dot(r, d) / dot(d, d), 0.0), 1.0)
    e = add_scaled(-t, d, r)
    return dot(e, e)


@kernel
def _off_triangle(p: Vec3, corner: Floats, f: int) -> float:
    """Square of the distance of a point from a face."""
    a, b, c = corner3(corner, f, 0), corner3(corner, f, 1), corner3(corner, f, 2)
    ab, ac, ap = subtract(b, a), subtract(c, a), subtract(p, a)
    aa, cc, ac_ab = dot(ab, ab), dot(ac, ac), dot(ab, ac)
    x, y = dot(ap, ab), dot(ap, ac)
    below = aa * cc - ac_ab * ac_ab
    s, t = (cc * x - ac_ab * y) / below, (aa * y - ac_ab * x) / below
    if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
        e = add_scaled(-t, ac, add_scaled(-s, ab, ap))
        return dot(e, e)
    return min(_off_segment(p, a, b), _off_segment(p, b, c), _off_segment(p, c, a))


@inline
def _try_face(corner: Floats, cells: _Cells, f: int, i: int, j: int, k: int) -> None:
    """Take a face for the nearest one of the matter in a cell, if it is nearer than what is."""
    d = _off_triangle(row3(cells.centroid[i, j], k), corner, f)
    if d < cells.squared[i, j, k]:
        cells.squared[i, j, k], cells.nearest[i, j, k] = d, f


@kernel
def _near_faces(corner: Floats, cells: _Cells, lower: Floats, spacing: Floats) -> None:
    """Nearest face, and squared distance, of the matter in cells that the box of a face reaches."""
    counts = cells.share.shape
    low, high = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    for f in range(len(corner)):
        for a in range(3):
            least = min(corner[f, 0, a], corner[f, 1, a], corner[f, 2, a])
            most = max(corner[f, 0, a], corner[f, 1, a], corner[f, 2, a])
            low[a] = max(int((least - lower[a]) / spacing[a]) - 1, 0)
            high[a] = min(int((most - lower[a]) / spacing[a]) + 1, counts[a] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    if cells.share[i, j, k] > 0.0:
                        _try_face(corner, cells, f, i, j, k)


@inline
def _ascending(n: int, sign: int) -> range:
    """0 to n − 1, or the other way round where sign is -1."""
    return range(0 if sign > 0 else n - 1, n if sign > 0 else -1, sign)


@kernel
def _sweep_distance(corner: Floats, cells: _Cells, signs: tuple[int, int, int]) -> None:
    """Hand the nearest face on to neighbours in one direction: the way to it leads through matter.

    A face may be missed that no neighbour is nearest to, so that the result is an upper bound,
    which `cover` does not trust.

    Source: Zhao, Math. Comp. 74, 603 (2005), with faces in place of values.
    """
    si, sj, sk = signs
    ni, nj, nk = cells.share.shape
    for i in _ascending(ni, si):
        for j in _ascending(nj, sj):
            for k in _ascending(nk, sk):
                if cells.share[i, j, k] == 0.0:
                    continue
                for a, b, c in ((i - si, j, k), (i, j - sj, k), (i, j, k - sk)):
                    if 0 <= a < ni and 0 <= b < nj and 0 <= c < nk:
                        f = cells.nearest[a, b, c]
                        if f >= 0 and f != cells.nearest[i, j, k]:
                            _try_face(corner, cells, f, i, j, k)


# Sphere after sphere


@inline
def _matter_within(p: Vec3, r: float, free: Floats, n_free: int) -> float:
    """Matter within r of a point, of the first n_free cells that are free: x, y, z, share."""
    held, square = 0.0, r * r
    for m in range(n_free):
        x, y, z = free[0, m] - p[0], free[1, m] - p[1], free[2, m] - p[2]
        held += free[3, m] if x * x + y * y + z * z <= square else 0.0
    return held


@inline
def without(p: Vec3, r: float, free: Floats, n_free: int) -> int:
    """Take the cells within r of a point from the list; how many are left."""
    left = 0
    for m in range(n_free):
        x, y, z = free[0, m] - p[0], free[1, m] - p[1], free[2, m] - p[2]
        if x * x + y * y + z * z > r * r:
            for k in range(4):
                free[k, left] = free[k, m]
            left += 1
    return left


@inline
def _clearance(p: Vec3, corner: Floats, near: Ints, n_near: int) -> float:
    """Distance of a point from the first n_near of some faces."""
    squared = math.inf
    for m in range(n_near):
        squared = min(squared, _off_triangle(p, corner, near[m]))
    return math.sqrt(squared)


@kernel
def _grown(p: Vec3, r: float, step: float, corner: Floats, near: Ints) -> tuple[Vec3, float]:
    """Move a sphere within its cell, of size `step`, to the ridge of the distance: it grows.

    A ridge that the grid misses would otherwise cost every sphere there a part of its radius.
    """
    n_near, size, start = 0, 0.5 * step, p
    reach = r + 2.0 * step
    for f in range(len(corner)):
        if _off_triangle(p, corner, f) <= reach * reach:
            near[n_near] = f
            n_near += 1
    for _ in range(_MAX_HALVINGS):
        for a in range(-1, 2):
            for b in range(-1, 2):
                for c in range(-1, 2):
                    length = math.sqrt(a * a + b * b + c * c)
                    if length == 0.0:
                        continue
                    by = size / length
                    q = p[0] + by * a, p[1] + by * b, p[2] + by * c
                    d = subtract(q, start)
                    if dot(d, d) > 0.75 * step * step:
                        continue
                    wider = _clearance(q, corner, near, n_near)
                    if wider >= r + _MIN_GROWTH * size:
                        p, r = q, wider
        size *= 0.5
    return p, r


@kernel
def cover(
    corner: Floats, point: Floats, squared: Floats, step: float, centre: Floats, radius: Floats
) -> int:
    """Fill `centre` and `radius`; the number of spheres found.

    What a sphere adds can only shrink while others are taken: a sphere whose last known gain is
    the largest is looked at again, and taken if it still is (lazy evaluation, Minoux 1978). That
    it is inside, and its radius, are then made sure of against all faces.

    Parameters
    ----------
    corner : ndarray, shape (m, 3, 3) [m]
        Of the faces.
    point : ndarray, shape (4, n)
        Centroid [m] and share of every cell that holds matter.
    squared : ndarray, shape (n,) [m²]
        Distance of the centroid from the surface.
    step : float [m]
        Size of a cell.
    """
    free, n_free = point.copy(), point.shape[1]
    near = np.empty(len(corner), dtype=np.int64)
    queue = [(0.0, -1, 0)]
    for index in range(len(squared)):
        d = squared[index]
        if math.isfinite(d) and d > (_MIN_RADIUS_CELLS * step) ** 2:
            queue.append((-5.0 * d * math.sqrt(d) / step**3 - 1.0, index, -1))
    heapq.heapify(queue)
    count = 0
    while count < len(radius) and len(queue) > 1:
        gain, index, counted = heapq.heappop(queue)
        if index < 0:
            break
        p = point[0, index], point[1, index], point[2, index]
        r = math.sqrt(squared[index])
        if counted != count:
            held = _matter_within(p, r, free, n_free)
            if held > 0.0:
                heapq.heappush(queue, (-held, index, count))
            continue
        exact = squared[index]
        for f in range(len(corner)):
            exact = min(exact, _off_triangle(p, corner, f))
        if exact < squared[index]:
            squared[index] = exact
            if exact > (_MIN_RADIUS_CELLS * step) ** 2:
                heapq.heappush(queue, (gain, index, -1))
            continue
        if not solid_angle(corner, point[:3, index].copy()) > 2.0 * math.pi:
            continue
        p, r = _grown(p, r, step, corner, near)
        n_free = without(p, r, free, n_free)
        centre[count, 0], centre[count, 1], centre[count, 2] = p
        radius[count] = r
        count += 1
    return count
