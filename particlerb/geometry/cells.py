"""Solids cut into cells: what each cell holds, exactly, and one particle for it.

The bounding box is cut into equal cells. A cell on the boundary counts by the share of it that is
inside; its particle sits at the centroid of that share. Read in this order: `Lattice`; `cut_mesh`,
shares of a mesh by clipping its faces; `cell_particles`, which makes the particles and moves them
outward by the little that one particle in place of a cell lacks in the tensor. Formulas are in
docs/mass_properties.md; solids with round sections are in `geometry.sections`.

A *cell sum* has ten numbers over the matter of one cell, in coordinates u, v, w of the cell from 0
to 1 and in units of its volume: 1, u, v, w, uu, vv, ww, uv, uw, vw.

Why it is so: docs/decisions/0011.
"""

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.geometry.particles import Mass, Particles, one_kind
from particlerb.geometry.solid import symmetric
from particlerb.maths.vec3 import Floats, Ints

_EMPTY_CELL_SHARE: Final = 1e-10  # below which it holds nothing but rounding
_COLUMN_OF: Final = (0, 1, 2, 0, 3, 4, 0, 5, 1, 2)  # 1, u, v, uu, vv, uv of a column of full height
_COLUMN_SHARE: Final = np.array([1, 1, 1, 1 / 2, 1, 1, 1 / 3, 1, 1 / 2, 1 / 2])  # and ∫ of w in it
MAX_CORNERS: Final = 12  # of a triangle cut by six planes: nine at most
_MIN_THICKNESS_SHARE: Final = 1e-9
"""Variance of particles over that of the matter, below which they lie in a plane."""

Layer = tuple[int, Floats]


class Lattice(NamedTuple):
    """Equal cells of a box."""

    lower: Floats
    """Corner [m], shape (3,)."""
    spacing: Floats
    """Edges of a cell [m], shape (3,)."""
    counts: tuple[int, int, int]
    """Cells along x, y, z."""


def grid_over(lower: Floats, upper: Floats, n: int) -> Lattice:
    """Cells of a box with corners (3,) [m]: n along its largest extent, as near to cubes as can be.

    ValueError unless n >= 2, the fewest along any extent: particles in one plane have no second
    moment across it.
    """
    if n < 2:
        raise ValueError(f"n is {n}: 2 or more are needed")
    extent = upper - lower
    counts = np.maximum(2, np.rint(n * extent / extent.max())).astype(np.int64)
    return Lattice(lower, extent / counts, (int(counts[0]), int(counts[1]), int(counts[2])))


# Meshes


def cut_mesh(vertices: Floats, faces: Ints, grid: Lattice) -> Iterator[Layer]:
    """Cell sums of the matter inside a closed mesh, layer by layer along x: (i, (n_y, n_z, 10)).

    Every face is cut at the planes between cells. A piece adds, with the sign of its side, the
    matter between itself and the floor of its cell, and all of the cells below: prisms, whose
    integrals are polynomials. What lies below the matter cancels.

    Parameters
    ----------
    vertices, faces : ndarray, shapes (n, 3) [m], (m, 3)
    grid : Lattice
        Holds the whole mesh.
    """
    corner = (vertices - grid.lower)[faces] / grid.spacing
    corner = np.clip(corner, 0.0, grid.counts)  # a face that rounding lifts over the top is lost
    nx, ny, nz = grid.counts
    first = np.clip(np.floor(corner[:, :, 0].min(axis=1)), 0, nx - 1).astype(np.int64)
    last = np.clip(np.ceil(corner[:, :, 0].max(axis=1)) - 1, first, nx - 1).astype(np.int64)
    layer_of = np.repeat(first, last - first + 1)
    face = np.repeat(np.arange(len(faces)), last - first + 1)
    starts = np.concatenate([[0], np.cumsum(last - first + 1)[:-1]])
    layer_of += np.arange(len(face)) - starts[face]
    order = np.argsort(layer_of, kind="stable")
    bounds = np.searchsorted(layer_of[order], np.arange(nx + 1))
    work = np.empty((4, 3, MAX_CORNERS))
    for i in range(nx):
        sums, above = np.zeros((ny, nz, 10)), np.zeros((ny, nz, 6))
        _add_faces(corner, face[order[bounds[i] : bounds[i + 1]]], i, sums, above, work)
        _add_below(sums, above)
        yield i, sums


@kernel
def _add_faces(
    corner: Floats, chosen: Ints, i: int, sums: Floats, above: Floats, work: Floats
) -> None:
    """Cut faces, in units of cells, at the planes of layer i and add their pieces."""
    ny, nz = sums.shape[0], sums.shape[1]
    slab, row, piece, rest = work[0], work[1], work[2], work[3]
    for f in chosen:
        for k in range(3):
            for m in range(3):
                slab[k, m] = corner[f, m, k]
            slab[0, k] -= i
        n_slab = cut(slab, cut(slab, 3, 0, 0.0, 1.0, rest), 0, 1.0, -1.0, rest)
        if n_slab < 3:
            continue
        j_low, j_high = reach(slab, n_slab, 1, ny)
        for j in range(j_low, j_high + 1):
            copy(slab, n_slab, row)
            shift(row, n_slab, 1, j)
            n_row = cut(row, cut(row, n_slab, 1, 0.0, 1.0, rest), 1, 1.0, -1.0, rest)
            if n_row < 3:
                continue
            k_low, k_high = reach(row, n_row, 2, nz)
            for k in range(k_low, k_high + 1):
                copy(row, n_row, piece)
                shift(piece, n_row, 2, k)
                n_piece = cut(piece, cut(piece, n_row, 2, 0.0, 1.0, rest), 2, 1.0, -1.0, rest)
                if n_piece >= 3:
                    _add_piece(piece, n_piece, sums[j, k], above[j, k])


@inline
def copy(polygon: Floats, n: int, other: Floats) -> None:
    """Copy a polygon, (3, n)."""
    for k in range(3):
        for m in range(n):
            other[k, m] = polygon[k, m]


@inline
def shift(polygon: Floats, n: int, axis: int, by: int) -> None:
    """Count one coordinate from the floor of a cell."""
    for m in range(n):
        polygon[axis, m] -= by


@inline
def reach(polygon: Floats, n: int, axis: int, cells: int) -> tuple[int, int]:
    """First and last cell that a polygon reaches along an axis."""
    low, high = polygon[axis, 0], polygon[axis, 0]
    for m in range(1, n):
        low, high = min(low, polygon[axis, m]), max(high, polygon[axis, m])
    first = min(max(int(np.floor(low)), 0), cells - 1)
    return first, min(max(int(np.ceil(high)) - 1, first), cells - 1)


@inline
def cut(polygon: Floats, n: int, axis: int, at: float, side: float, rest: Floats) -> int:
    """Keep of a polygon what has side (x − at) >= 0; corners that remain.

    Source: Sutherland, Hodgman, Comm. ACM 17, 32 (1974), for one plane.
    """
    inside = True
    for m in range(n):
        inside = inside and side * (polygon[axis, m] - at) >= 0.0
    if inside:
        return n
    count = 0
    for m in range(n):
        o = m + 1 if m + 1 < n else 0
        here, there = side * (polygon[axis, m] - at), side * (polygon[axis, o] - at)
        if here >= 0.0:
            for k in range(3):
                rest[k, count] = polygon[k, m]
            count += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for k in range(3):
                rest[k, count] = polygon[k, m] + share * (polygon[k, o] - polygon[k, m])
            rest[axis, count] = at
            count += 1
    copy(rest, count, polygon)
    return count


@inline
def _add_at(sums: Floats, above: Floats, weight: float, u: float, v: float, w: float) -> None:
    """Add one node of a piece: the column below it in its cell, and its area for those below."""
    wu, wv = weight * u, weight * v
    sums[0] += weight * w
    sums[1] += wu * w
    sums[2] += wv * w
    sums[3] += weight * w * w * 0.5
    sums[4] += wu * u * w
    sums[5] += wv * v * w
    sums[6] += weight * w * w * w * (1 / 3)
    sums[7] += wu * v * w
    sums[8] += wu * w * w * 0.5
    sums[9] += wv * w * w * 0.5
    above[0] += weight
    above[1] += wu
    above[2] += wv
    above[3] += wu * u
    above[4] += wv * v
    above[5] += wu * v


@inline
def _add_piece(polygon: Floats, n: int, sums: Floats, above: Floats) -> None:
    """Integrate the columns below a polygon; exact, as nothing is above the third degree.

    Rule of seven nodes in each triangle: corners 1/20, middles of sides 2/15, centroid 9/20.
    """
    u0, v0, w0 = polygon[0, 0], polygon[1, 0], polygon[2, 0]
    for m in range(1, n - 1):
        u1, v1, w1 = polygon[0, m], polygon[1, m], polygon[2, m]
        u2, v2, w2 = polygon[0, m + 1], polygon[1, m + 1], polygon[2, m + 1]
        area = 0.5 * ((u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0))
        if area == 0.0:
            continue
        tip, side, middle = area * (1 / 20), area * (2 / 15), area * (9 / 20)
        _add_at(sums, above, tip, u0, v0, w0)
        _add_at(sums, above, tip, u1, v1, w1)
        _add_at(sums, above, tip, u2, v2, w2)
        _add_at(sums, above, side, 0.5 * (u0 + u1), 0.5 * (v0 + v1), 0.5 * (w0 + w1))
        _add_at(sums, above, side, 0.5 * (u1 + u2), 0.5 * (v1 + v2), 0.5 * (w1 + w2))
        _add_at(sums, above, side, 0.5 * (u2 + u0), 0.5 * (v2 + v0), 0.5 * (w2 + w0))
        u, v, w = (u0 + u1 + u2) * (1 / 3), (v0 + v1 + v2) * (1 / 3), (w0 + w1 + w2) * (1 / 3)
        _add_at(sums, above, middle, u, v, w)


def _add_below(sums: Floats, above: Floats) -> None:
    """Add to every cell the columns of full height below pieces that lie above it."""
    higher = np.zeros_like(above)
    higher[:, :-1] = np.cumsum(above[:, :0:-1], axis=1)[:, ::-1]
    sums += higher[:, :, _COLUMN_OF] * _COLUMN_SHARE


# Particles


class Pieces(NamedTuple):
    """Matter of the cells that hold any."""

    cell: Ints
    """Numbers along x, y, z, shape (k, 3)."""
    share: Floats
    """Of the cell, shape (k,)."""
    centroid: Floats
    """[m], shape (k, 3)."""
    spread: Floats
    """Second moments of all pieces about their own centroids, per mass [m²], shape (3, 3)."""


def pieces(layers: Iterable[Layer], grid: Lattice) -> Pieces:
    """Shares and centroids of the cells that are not empty."""
    cells, shares, centroids, spread = [], [], [], np.zeros(6)
    for i, sums in layers:
        chosen = np.argwhere(sums[:, :, 0] > _EMPTY_CELL_SHARE)
        held = sums[chosen[:, 0], chosen[:, 1]]
        share = held[:, 0]
        mean = np.clip(held[:, 1:4] / share[:, None], 0.0, 1.0)
        x, y, z = mean.T
        squares = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
        spread += (held[:, 4:] - share[:, None] * squares).sum(axis=0)
        shares.append(share)
        cells.append(np.column_stack([np.full(len(chosen), i), chosen]))
        centroids.append(grid.lower + (cells[-1] + mean) * grid.spacing)
    share = np.concatenate(shares)
    inner = symmetric(spread / share.sum()) * np.outer(grid.spacing, grid.spacing)
    return Pieces(np.concatenate(cells), share, np.concatenate(centroids), inner)


def cell_particles(layers: Iterable[Layer], grid: Lattice, mass: Mass) -> Particles:
    """One particle for each cell that holds matter, with the com and tensor of all of it.

    A particle in place of a piece lacks the piece's moments about its own centroid. All particles
    are therefore moved by r → A r about the com, A symmetric with A C Aᵀ = C + D, C the second
    moments of the particles and D what they lack: of all linear maps the one that moves matter
    least (optimal transport of Gaussians). A − 1 falls as 1/n².

    Parameters
    ----------
    layers : iterable of (i, ndarray of shape (n_y, n_z, 10))
        Cell sums.
    grid : Lattice
    mass : float, or ndarray of shape (k, 1) [kg]

    Raises
    ------
    ValueError
        If the particles lie in a plane: n is too small.

    References
    ----------
    Dowson, Landau, J. Multivariate Analysis 12, 450 (1982), for A.
    """
    _, share, centroid, lacking = pieces(layers, grid)
    weight = share / share.sum()
    com = weight @ centroid
    r = centroid - com
    com += weight @ r  # what rounding has left
    r -= weight @ r
    second = (weight[:, None] * r).T @ r
    if np.linalg.eigvalsh(second)[0] <= _MIN_THICKNESS_SHARE * np.trace(second + lacking):
        raise ValueError("the cells lie in a plane: raise n")
    return one_kind(com + r @ _least_move(second, second + lacking), weight * mass)


def _least_move(second: Floats, wanted: Floats) -> Floats:
    """Symmetric A with A C A = W, of `second` C: C^(-1/2) (C^(1/2) W C^(1/2))^(1/2) C^(-1/2)."""
    values, vectors = np.linalg.eigh(second)
    root = (vectors * np.sqrt(values)) @ vectors.T
    inverse = (vectors / np.sqrt(values)) @ vectors.T
    squares, axes = np.linalg.eigh(root @ wanted @ root)
    return inverse @ (axes * np.sqrt(squares)) @ axes.T @ inverse
