"""Closed meshes of triangles: read from a file, checked, and integrated exactly.

Read in this order: `TriangleMesh`; `read_mesh`, the way in from STL, OBJ and PLY files; `checked`,
which merges equal vertices, orients the faces and refuses what bounds no matter, saying where;
`mesh_solid`, volume, com and second moments from signed tetrahedra. Formulas are in
docs/mass_properties.md. Nothing here knows of particles.

Faces and edges are numbered as in the file, from 0.
"""

import math
from collections.abc import Sequence
from importlib import import_module
from io import BytesIO
from pathlib import Path, PurePath
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from particlerb.files import File, content
from particlerb.geometry.cells import cut_mesh, grid_over
from particlerb.geometry.crossings import crossings
from particlerb.geometry.solid import UniformSolid
from particlerb.geometry.winding import oriented, windings
from particlerb.maths.vec3 import Floats, Ints
from particlerb.words import count_of

MESH_SUFFIXES: Final = (".stl", ".obj", ".ply")
_MIN_FACE_HEIGHT: Final = 1e-12  # over the longest side: below it the corners lie on one line
_TOUCH_SHARE: Final = 1e-12  # of the size: as near as this, faces touch and do not cross
_VOLUME_ROUNDING: Final = 64 * float(np.finfo(np.float64).eps)
_COARSE_CELLS: Final = 8  # along the largest extent, to find matter that counts twice
_MAX_CELL_ERROR: Final = 1e-6  # of matter, in cells
_MAX_PLACES_NAMED: Final = 3  # in a message
_MAX_COMPARED: Final = 500  # vertices of open edges, to find two that were meant to be one
_MAX_RIM_GAP: Final = 1e-3  # of the size
_INSTALL_COMMAND: Final = 'pip install "particlerb[mesh]"'


class TriangleMesh(NamedTuple):
    """A surface of triangles."""

    vertices: Floats
    """[m], shape (n, 3)."""
    faces: Ints
    """Shape (m, 3); indices of vertices, counterclockwise seen from outside."""
    notes: tuple[str, ...] = ()
    """What was changed to make it so, in words."""


# Reading


def read_mesh(file: str | Path | File, scale: float = 1.0) -> TriangleMesh:
    """Checked mesh of a file, which trimesh reads.

    Parameters
    ----------
    file : path of an STL (ascii or binary), OBJ or PLY file, or its content
    scale : float [m]
        Length of one unit of the file.

    Raises
    ------
    OSError
        If the file is not there, or cannot be read.
    ValueError
        As `triangles_of`, `checked`.
    """
    name = file.name if isinstance(file, File) else str(file)
    if PurePath(name).suffix.lower() not in MESH_SUFFIXES:
        raise ValueError(f"{name} is not a mesh: its name must end with {', '.join(MESH_SUFFIXES)}")
    try:
        vertices, faces = triangles_of(content(file))
        return checked(scale * vertices, faces)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None


def triangles_of(file: File) -> tuple[Floats, Ints]:
    """Vertices (n, 3) and faces (m, 3) of a file, as they are in it.

    Textures and materials that it names are not looked for.

    Raises
    ------
    ValueError
        If trimesh is not there, or cannot read the file.
    """
    try:
        trimesh: Any = import_module("trimesh")
    except ImportError:
        raise ValueError(f"reading it needs trimesh: {_INSTALL_COMMAND}") from None
    kind = PurePath(file.name).suffix.lower().removeprefix(".")
    try:
        loaded = trimesh.load_mesh(
            BytesIO(file.data), file_type=kind, process=False, skip_materials=True
        )
        return np.array(loaded.vertices, dtype=np.float64), np.array(loaded.faces, dtype=np.int64)
    except Exception as error:  # whatever a broken file makes of trimesh
        raise ValueError(f"trimesh cannot read it: {error}") from None


# Checking


def checked(vertices: ArrayLike, faces: ArrayLike) -> TriangleMesh:
    """Mesh that bounds matter: closed, oriented, without crossings.

    Equal vertices become one, faces with two equal corners go, unused vertices go. Faces whose
    neighbours are oriented otherwise, and meshes that are inside out, are turned round; notes say
    so. Several parts may lie beside or touch each other, or inside as cavities.

    Parameters
    ----------
    vertices : array_like, shape (n, 3) [m]
    faces : array_like, shape (m, 3)
        Indices of vertices.

    Raises
    ------
    ValueError
        With numbers of faces and coordinates: no faces, a vertex not finite, a face whose corners
        lie on one line, an open edge, faces that cross or cover each other, a surface that cannot
        be oriented, a part inside another that is oriented like it, zero volume.
    """
    corner = np.array(vertices, dtype=np.float64, order="C")
    triangle = np.array(faces, dtype=np.int64, order="C")
    if triangle.ndim != 2 or triangle.shape[1:] != (3,) or len(triangle) == 0:
        raise ValueError("it has no triangles")
    if corner.ndim != 2 or corner.shape[1:] != (3,) or triangle.min() < 0:
        raise ValueError("it has no vertices in three dimensions")
    if triangle.max() >= len(corner):
        raise ValueError(f"a face names vertex {triangle.max()} of {len(corner)}")
    if not np.isfinite(corner[triangle]).all():
        face = int(np.argmin(np.isfinite(corner[triangle]).all(axis=(1, 2))))
        raise ValueError(f"face {face} has a vertex that is not finite")
    corner, index = np.unique(corner[triangle.ravel()] + 0.0, axis=0, return_inverse=True)
    triangle = index.reshape(-1, 3)
    number, notes = np.arange(len(triangle)), []
    collapsed = (triangle == np.roll(triangle, 1, axis=1)).any(axis=1)
    if collapsed.any():
        notes.append(f"left out {_faces_text(number[collapsed])} with two equal corners")
        triangle, number = triangle[~collapsed], number[~collapsed]
    if len(triangle) == 0:
        raise ValueError("it has zero volume: every face has two equal corners")
    _refuse_flat(corner, triangle, number)
    _refuse_open(corner, triangle, number)
    _refuse_crossings(corner, triangle, number)
    triangle, turned = _outward(corner, triangle, number)
    refuse_miscounted(corner, triangle)
    return TriangleMesh(corner, triangle, (*notes, *turned))


def _faces_text(numbers: Ints) -> str:
    """`face 3`, `faces 3, 4`, `faces 3, 4, 5, ... (12 in all)`."""
    listed = ", ".join(str(number) for number in numbers[:_MAX_PLACES_NAMED].tolist())
    rest = f", ... ({len(numbers)} in all)" if len(numbers) > _MAX_PLACES_NAMED else ""
    return f"face{'s' if len(numbers) > 1 else ''} {listed}{rest}"


def _point_text(point: Floats) -> str:
    """Coordinates in a message."""
    return "(" + ", ".join(f"{x:.9g}" for x in point.tolist()) + ") m"


def _refuse_flat(vertices: Floats, faces: Ints, number: Ints) -> None:
    """Refuse faces without area."""
    corner = vertices[faces]
    sides = corner - np.roll(corner, 1, axis=1)
    longest = (sides**2).sum(axis=2).max(axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = np.flatnonzero(area <= _MIN_FACE_HEIGHT * longest)
    if len(flat):
        raise ValueError(
            f"{_faces_text(number[flat])}: the corners lie on one line, the first at "
            + ", ".join(_point_text(point) for point in corner[flat[0]])
        )


def _refuse_open(vertices: Floats, faces: Ints, number: Ints) -> None:
    """Refuse edges of an odd number of faces."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    unique, first, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    odd = np.flatnonzero(count % 2)
    if not len(odd):
        return
    places = [
        f"edge {_point_text(vertices[unique[e, 0]])} to {_point_text(vertices[unique[e, 1]])}"
        f" of face {number[first[e] // 3]} has {count_of(count[e], 'face')}"
        for e in odd[:_MAX_PLACES_NAMED]
    ]
    rest = f"; ... {len(odd)} edges in all" if len(odd) > _MAX_PLACES_NAMED else ""
    raise ValueError(
        f"it is open: {'; '.join(places)}{rest}; two faces are needed at each: "
        + _remedy(vertices, np.unique(unique[odd]))
    )


def _remedy(vertices: Floats, rim: Ints) -> str:
    """What closes a mesh whose open edges end at these vertices: joining them, or more faces."""
    some = vertices[rim[:_MAX_COMPARED]]
    apart = np.linalg.norm(some[:, None] - some, axis=2)
    np.fill_diagonal(apart, np.inf)
    i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
    if apart[i, j] > _MAX_RIM_GAP * np.ptp(vertices, axis=0).max():
        return "close the hole where the mesh was made, or try trimesh.repair.fill_holes"
    return (
        f"vertices {_point_text(some[i])} and {_point_text(some[j])} are {apart[i, j]:.3g} m apart,"
        " and only equal ones are one: join such vertices where the mesh was made, or with"
        " merge_vertices of trimesh"
    )


def _refuse_crossings(vertices: Floats, faces: Ints, number: Ints) -> None:
    """Refuse faces that cross each other, or that cover each other and face the same way."""
    size = np.ptp(vertices, axis=0).max()
    nearness = max(_TOUCH_SHARE * size, 16 * np.finfo(np.float64).eps * np.abs(vertices).max())
    pairs, points = crossings(vertices, faces, nearness)
    if len(pairs):
        places = [
            f"face {number[i]} and face {number[j]} at {_point_text(point)}"
            for (i, j), point in zip(pairs[:_MAX_PLACES_NAMED], points, strict=False)
        ]
        rest = f"; ... {len(pairs)} pairs in all" if len(pairs) > _MAX_PLACES_NAMED else ""
        raise ValueError(f"it intersects itself: {'; '.join(places)}{rest}")


def _outward(vertices: Floats, faces: Ints, number: Ints) -> tuple[Ints, Sequence[str]]:
    """Faces oriented so that matter is inside, and what was turned round for it."""
    part, flipped, torn = oriented(faces)
    if torn >= 0:
        raise ValueError(
            f"it cannot be oriented: its faces have no two sides, near face {number[torn]} at "
            + _point_text(vertices[faces[torn]].mean(axis=0))
        )
    faces = np.where(flipped[:, None], faces[:, ::-1], faces)
    signs = np.array([sign(vertices, faces[part == p]) for p in range(part.max() + 1)])
    if not signs.all():
        first = np.flatnonzero(part == np.argmin(np.abs(signs)))[0]
        place = f"face {number[first]} at {_point_text(vertices[faces[first]].mean(axis=0))}"
        raise ValueError(f"it has zero volume, in the part of {place}")
    wanted = 1 - 2 * (windings(vertices, faces, part, signs) % 2)
    wrong = signs != wanted
    was_mixed = np.bincount(part, weights=flipped) > 0
    turns = wrong & (was_mixed | (wanted > 0) | wrong.all())
    if (wrong & ~turns).any():
        first = np.flatnonzero(part == np.argmax(wrong & ~turns))[0]
        raise ValueError(
            f"the part of face {number[first]} at"
            f" {_point_text(vertices[faces[first]].mean(axis=0))} lies inside another and is"
            " oriented like it: its matter would count twice; a cavity is oriented the other way"
        )
    turned = flipped ^ turns[part]
    if not turned.any():
        return np.ascontiguousarray(faces), ()
    faces = np.where(turns[part][:, None], faces[:, ::-1], faces)
    all_of_them = "all faces: the mesh was inside out"
    note = f"turned round {all_of_them if turned.all() else _faces_text(number[turned])}"
    return np.ascontiguousarray(faces), (note,)


def refuse_miscounted(vertices: Floats, faces: Ints) -> None:
    """Refuse surfaces (n, 3), (m, 3) that wind round matter more than once, or the wrong way.

    Parts that touch along edges are one here, so that `_outward` cannot tell them apart: a few
    cells must be empty, full, or between.
    """
    grid = grid_over(vertices.min(axis=0), vertices.max(axis=0), _COARSE_CELLS)
    for i, sums in cut_mesh(vertices, faces, grid):
        share = sums[:, :, 0]
        off = np.maximum(share - 1.0, -share)
        j, k = np.unravel_index(int(np.argmax(off)), off.shape)
        if off[j, k] > _MAX_CELL_ERROR:
            centre = grid.lower + (np.array([i, j, k]) + 0.5) * grid.spacing
            raise ValueError(
                f"matter near {_point_text(centre)} counts {share[j, k]:.3g} times: parts that"
                " touch are oriented against each other, or lie in each other"
            )


def sign(vertices: Floats, faces: Ints) -> int:
    """+1 for faces (m, 3) that look outward, -1 inward, 0 for no volume but rounding."""
    volume = _tetrahedra(vertices[faces] - vertices[faces[0, 0]])
    total = math.fsum(volume)
    is_zero = abs(total) <= _VOLUME_ROUNDING * math.fsum(np.abs(volume))
    return 0 if is_zero else int(math.copysign(1.0, total))


# Integrals


def _tetrahedra(corner: Floats) -> Floats:
    """Signed volumes, (m,), of the tetrahedra of the origin and faces with corners (m, 3, 3)."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0


def mesh_solid(mesh: TriangleMesh) -> UniformSolid:
    """Volume, com and second moments of the matter inside a mesh, to rounding.

    Each face makes a tetrahedron with a point amid the mesh; of volume V and corners 0, a, b, c it
    has ∫ r dV = V s/4 and ∫ r rᵀ dV = (V/20)(a aᵀ + b bᵀ + c cᵀ + s sᵀ), s = a + b + c.

    References
    ----------
    Tonon, J. Math. Stat. 1, 8 (2004), whose formulas for a tetrahedron these are.
    """
    origin = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    unit = 2.0 ** np.ceil(np.log2(np.abs(mesh.vertices - origin).max()))
    corner = (mesh.vertices[mesh.faces] - origin) / unit
    weight = _tetrahedra(corner)
    total = corner.sum(axis=1)
    volume = math.fsum(weight)
    com = np.array([math.fsum(weight * total[:, k]) for k in range(3)]) / (4.0 * volume)
    second = np.empty((3, 3))
    for i in range(3):
        for j in range(i + 1):
            products = (corner[:, :, i] * corner[:, :, j]).sum(axis=1) + total[:, i] * total[:, j]
            mean = math.fsum(weight * products) / (20.0 * volume)
            second[i, j] = second[j, i] = mean - com[i] * com[j]
    inertia = (np.trace(second) * np.eye(3) - second) * volume
    lost = _VOLUME_ROUNDING * math.fsum(np.abs(weight)) / volume
    return UniformSolid(volume * unit**3, origin + com * unit, inertia * unit**5, lost)
