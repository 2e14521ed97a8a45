"""Walls from what a case says: planes, cylinders, boxes, surfaces of triangles."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from particlerb.contact.walls import DISC, EDGE, FACE, PLANE, RIM, SIDE, VERTEX, Walls
from particlerb.maths.components import labels
from particlerb.maths.vec3 import Bools, Floats, Ints

_COPLANAR_SINE: Final = 1e-6  # of the angle between faces of one plane: STL has single precision


def joined(walls: Sequence[Walls]) -> Walls:
    """Several walls as one set, numbered in this order."""
    parts, before = [_wall_of([], [])], 0
    for number, wall in enumerate(walls):
        parameter = wall.parameter.copy()
        parameter[(wall.kind == EDGE) | (wall.kind == VERTEX), 6:8] += before
        parameter[wall.kind == VERTEX, 8] += before
        before += len(wall.around)
        parts.append(Walls(wall.kind, parameter, np.full(wall.kind.size, number), wall.around))
    return Walls(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _wall_of(kinds: Sequence[int], parameters: Sequence[Sequence[float]]) -> Walls:
    """Wall of primitives that need no neighbours."""
    parameter = np.zeros((len(kinds), 12))
    for row, values in zip(parameter, parameters, strict=True):
        row[: len(values)] = values
    kind = np.array(kinds, dtype=np.int64)
    return Walls(kind, parameter, np.zeros_like(kind), np.zeros((0, 3)))


def plane(point: Sequence[float], normal: Sequence[float]) -> Walls:
    """Infinite plane; bodies are on the side of its normal."""
    return _wall_of([PLANE], [[*point, *unit(normal)]])


def unit(vector: Sequence[float]) -> Floats:
    """v/|v|."""
    v = np.array(vector, dtype=np.float64)
    v = v / np.abs(v).max()
    return np.asarray(v / np.linalg.norm(v))


def cylinder(
    centre: Sequence[float],
    axis: Sequence[float],
    radius: float,
    length: float,
    caps: tuple[bool, bool] = (True, True),
) -> Walls:
    """Cylinder, touched from inside and outside.

    Parameters
    ----------
    centre : sequence of 3 floats [m]
    axis : sequence of 3 floats
    radius, length : float [m]
    caps : tuple of 2 bools
        Whether a disc closes the end towards -axis, towards +axis.
    """
    c, n, half = np.array(centre, dtype=np.float64), unit(axis), 0.5 * length
    kinds, parameters = [SIDE], [[*c, *n, radius, half]]
    for sign, is_closed in zip((-1.0, 1.0), caps, strict=True):
        end = c + sign * half * n
        if is_closed:
            kinds.append(DISC)
            parameters.append([*end, *n, radius])
        kinds.append(RIM)
        parameters.append([*end, *(sign * n), radius, float(is_closed)])
    return _wall_of(kinds, parameters)


_FACES_OF_BOX: Final = {
    "-x": (0, 1, 3, 2),
    "+x": (4, 5, 7, 6),
    "-y": (0, 1, 5, 4),
    "+y": (2, 3, 7, 6),
    "-z": (0, 2, 6, 4),
    "+z": (1, 3, 7, 5),
}


def has_edges(walls: Walls) -> bool:
    """Whether a wall has edges, rims or vertices: these reach where no ball does."""
    return bool(np.isin(walls.kind, (EDGE, VERTEX, RIM)).any())


def box(lower: Sequence[float], upper: Sequence[float], open_faces: Sequence[str] = ()) -> Walls:
    """Box, touched from inside and outside: two triangles for each face that is not open.

    Parameters
    ----------
    lower, upper : sequence of 3 floats [m]
        Opposite corners.
    open_faces : sequence of str
        Of "-x", "+x", "-y", "+y", "-z", "+z".
    """
    corners = np.array([lower, upper], dtype=np.float64)
    vertices = np.array([[corners[i, 0], corners[j, 1], corners[k, 2]] for i, j, k in _CORNERS])
    faces = [face for name, face in _FACES_OF_BOX.items() if name not in open_faces]
    triangles = [three for a, b, c, d in faces for three in ((a, b, c), (a, c, d))]
    return surface(vertices, np.array(triangles))


_CORNERS: Final = tuple(np.ndindex(2, 2, 2))


def surface(vertices: Floats, triangles: Ints) -> Walls:
    """Surface of triangles, touched from both sides; it may be open and have any orientation.

    Parameters
    ----------
    vertices : ndarray, shape (n_vertices, 3) [m]
        Those at the very same place are one.
    triangles : ndarray, shape (n_triangles, 3)
        Vertices of each; triangles without area are left out.
    """
    places, same = np.unique(vertices, axis=0, return_inverse=True)
    faces = np.unique(np.sort(same.reshape(-1)[triangles], axis=1), axis=0)
    a, b, c = (places[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    sides = np.maximum(((b - a) ** 2).sum(axis=1), ((c - a) ** 2).sum(axis=1))
    has_area = area > 1e-12 * sides
    faces, normal, area = faces[has_area], across[has_area], area[has_area]
    normal = normal / area[:, None]
    ends, edge = np.unique(
        faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=0, return_inverse=True
    )
    edge = edge.reshape(-1, 3)
    is_smooth = _smoothed(normal, area, edge, ends, faces, places)
    edges = _edge_primitives(places, faces, normal, edge, ends, is_smooth)
    corners = _vertex_primitives(places, faces, ends, is_smooth)
    a, b, c = (places[faces[:, k]] for k in range(3))
    normal *= np.sign(np.einsum("ij,ij->i", np.cross(b - a, c - a), normal))[:, None]
    parameter = np.concatenate([places[faces].reshape(-1, 9), normal], axis=1)
    kind = np.full(len(faces), FACE)
    walls = joined([Walls(kind, parameter, kind * 0, np.zeros((0, 3))), edges, corners])
    return walls._replace(wall=np.zeros_like(walls.wall))


def _smoothed(
    normal: Floats, area: Floats, edge: Ints, ends: Ints, faces: Ints, places: Floats
) -> Bools:
    """Whether an edge lies within a plane, (n_edges,); faces of a plane get the same normal.

    `normal` (n_faces, 3), of which the sign is free, is changed in place.
    """
    order = np.argsort(edge.reshape(-1), kind="stable")
    count = np.bincount(edge.reshape(-1), minlength=len(ends))
    at = np.cumsum(count) - count
    pairs = np.flatnonzero(count == 2)
    one, other = order[at[pairs]], order[at[pairs] + 1]
    left, right = one // 3, other // 3
    is_flat = np.linalg.norm(np.cross(normal[left], normal[right]), axis=1) < _COPLANAR_SINE
    third = [faces[f].sum(axis=1) - ends[pairs].sum(axis=1) for f in (left, right)]
    along = places[ends[pairs, 1]] - places[ends[pairs, 0]]
    turn = [
        np.einsum("ij,ij->i", np.cross(along, places[v] - places[ends[pairs, 0]]), normal[left])
        for v in third
    ]
    is_flat &= turn[0] * turn[1] < 0.0  # not folded back on itself
    patch = labels(len(faces), left[is_flat], right[is_flat])
    sign = np.sign(np.einsum("ij,ij->i", normal, normal[patch]))
    total = np.zeros_like(normal)
    np.add.at(total, patch, (area * sign)[:, None] * normal)
    total = total[patch]
    is_alone = np.bincount(patch, minlength=len(faces))[patch] == 1
    total[is_alone] = normal[is_alone]
    normal[:] = total / np.linalg.norm(total, axis=1)[:, None]
    is_smooth = np.zeros(len(ends), dtype=np.bool_)
    is_smooth[pairs[is_flat]] = True
    return is_smooth


def _edge_primitives(
    places: Floats, faces: Ints, normal: Floats, edge: Ints, ends: Ints, is_smooth: Bools
) -> Walls:
    """Edges that do not lie within a plane, each with the normals of the faces that meet there.

    The sign of a normal is the one for which the face is on the positive `side` of the edge.
    """
    flat = edge.reshape(-1)
    order = np.argsort(flat, kind="stable")
    order = order[~is_smooth[flat[order]]]
    edge_number, face = flat[order], order // 3
    a, b = places[ends[edge_number, 0]], places[ends[edge_number, 1]]
    third = places[faces[face].sum(axis=1) - ends[edge_number].sum(axis=1)]
    turn = np.einsum("ij,ij->i", np.cross(b - a, third - a), normal[face])
    sharp = np.flatnonzero(~is_smooth)
    parameter = np.zeros((sharp.size, 12))
    parameter[:, :6] = places[ends[sharp]].reshape(-1, 6)
    parameter[:, 6] = np.searchsorted(edge_number, sharp, side="left")
    parameter[:, 7] = np.searchsorted(edge_number, sharp, side="right")
    kind = np.full(sharp.size, EDGE)
    return Walls(kind, parameter, kind * 0, np.sign(turn)[:, None] * normal[face])


def _vertex_primitives(places: Floats, faces: Ints, ends: Ints, is_smooth: Bools) -> Walls:
    """Vertices that do not lie within a plane, each with the other ends of its edges, and faces.

    A face is a row of two numbers: which of these ends are its other two vertices.
    """
    sharp = np.unique(ends[~is_smooth])
    here, there = np.concatenate([ends, ends[:, ::-1]]).T
    corner, others = faces.reshape(-1), faces[:, [[1, 2], [0, 2], [0, 1]]].reshape(-1, 2)
    edges, corners = np.lexsort((there, here)), np.argsort(corner, kind="stable")
    begins = np.searchsorted(here[edges], np.arange(len(places) + 1))
    turns = np.searchsorted(corner[corners], np.arange(len(places) + 1))
    parameter, rows, before = np.zeros((sharp.size, 12)), [np.zeros((0, 3))], 0
    for row, v in zip(parameter, sharp.tolist(), strict=True):
        neighbours = there[edges[begins[v] : begins[v + 1]]]
        two = np.searchsorted(neighbours, others[corners[turns[v] : turns[v + 1]]])
        rows += [places[neighbours], np.column_stack([two, np.zeros(len(two))])]
        row[:3], row[6:9] = places[v], np.cumsum([before, len(neighbours), len(two)])
        before += len(neighbours) + len(two)
    kind = np.full(sharp.size, VERTEX)
    return Walls(kind, parameter, kind * 0, np.concatenate(rows))
