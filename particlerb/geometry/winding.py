"""Which way the faces of a mesh look: one side for each connected part, and what lies inside what.

Kernels and their NumPy callers; faces in, signs out. Messages are the business of `geometry.mesh`.
"""

import math

import numpy as np

from particlerb.compiled.jit import kernel
from particlerb.maths.vec3 import Bools, Floats, Ints, corner3, cross, dot, norm, subtract

_MIN_FACE_DISTANCE = 1e-9  # height of a point over a face, relative: it has no winding number there


def oriented(faces: Ints) -> tuple[Ints, Bools, int]:
    """Connected parts, which faces must be turned round in each, and where that is impossible.

    Faces are neighbours at a common edge; where more than two meet, as where parts touch, those
    that look the opposite way along it. In each part the larger number of faces stays as it is.

    Parameters
    ----------
    faces : ndarray, shape (m, 3)

    Returns
    -------
    part : ndarray, shape (m,)
        Number of the part of each face, by first face.
    flipped : ndarray, shape (m,)
    torn : int
        A face next to which the surface has only one side; -1 for none.
    """
    m = len(faces)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    low, high, forward = low[order], high[order], (start < end)[order]
    face = order // 3
    is_first = np.ones(3 * m, dtype=np.bool_)
    is_first[1:] = (low[1:] != low[:-1]) | (high[1:] != high[:-1])
    begin = np.flatnonzero(is_first)
    count = np.diff(np.append(begin, 3 * m))
    pair = np.stack([begin, begin + 1])[:, count == 2]
    many = [_meetings(np.arange(b, b + n), forward[b : b + n])
            for b, n in zip(begin[count > 2], count[count > 2], strict=True)]  # fmt: skip
    pair = np.concatenate([pair, *many], axis=1)
    one, other, same = face[pair[0]], face[pair[1]], forward[pair[0]] == forward[pair[1]]
    source = np.concatenate([one, other])
    by_source = np.argsort(source, kind="stable")
    offset = np.searchsorted(source[by_source], np.arange(m + 1))
    neighbour = np.concatenate([other, one])[by_source]
    part, flipped = np.full(m, -1), np.zeros(m, dtype=np.bool_)
    torn = int(_spread_sides(offset, neighbour, np.tile(same, 2)[by_source], part, flipped))
    if torn >= 0:
        return part, flipped, torn
    more = 2 * np.bincount(part, weights=flipped) > np.bincount(part)
    return part, flipped ^ more[part], torn


def _meetings(index: Ints, forward: Bools) -> Ints:
    """Pairs, (2, k), of the faces at an edge: of opposite directions as far as there are such."""
    ahead, back = index[forward], index[~forward]
    n = min(len(ahead), len(back))
    rest = np.concatenate([ahead[n:], back[n:]])
    return np.stack(
        [np.concatenate([ahead[:n], rest[0::2]]), np.concatenate([back[:n], rest[1::2]])]
    )


@kernel
def _spread_sides(offset: Ints, neighbour: Ints, differs: Bools, part: Ints, flipped: Bools) -> int:
    """Fill `part` (-1 at first) and `flipped` from neighbour to neighbour; a torn face or -1."""
    waiting = np.empty(len(part), dtype=np.int64)
    n_parts = 0
    for first in range(len(part)):
        if part[first] >= 0:
            continue
        part[first] = n_parts
        waiting[0], n_waiting = first, 1
        while n_waiting > 0:
            n_waiting -= 1
            face = waiting[n_waiting]
            for k in range(offset[face], offset[face + 1]):
                other, side = neighbour[k], flipped[face] ^ differs[k]
                if part[other] < 0:
                    part[other], flipped[other] = n_parts, side
                    waiting[n_waiting] = other
                    n_waiting += 1
                elif flipped[other] != side:
                    return int(other)
        n_parts += 1
    return -1


def windings(vertices: Floats, faces: Ints, part: Ints, signs: Ints) -> Ints:
    """How many other parts each part lies inside of, (n_parts,).

    Parameters
    ----------
    vertices, faces : ndarray, shapes (n, 3) [m], (m, 3)
    part : ndarray, shape (m,)
    signs : ndarray, shape (n_parts,)
        +1 where a part's faces look away from what it bounds, -1 where towards it.
    """
    corners = [vertices[faces[part == p]] for p in range(len(signs))]
    boxes = np.array([(c.min(axis=(0, 1)), c.max(axis=(0, 1))) for c in corners])
    depth = np.zeros(len(signs), dtype=np.int64)
    for p, corner in enumerate(corners):
        for q in range(len(signs)):
            if q == p or (boxes[p, 1] < boxes[q, 0]).any() or (boxes[p, 0] > boxes[q, 1]).any():
                continue
            for point in corner.mean(axis=1):
                angle = solid_angle(corners[q], point)
                if math.isfinite(angle):  # else on the surface, where the parts touch
                    depth[p] += round(signs[q] * angle / (4.0 * math.pi))
                    break
    return depth


@kernel
def solid_angle(corner: Floats, point: Floats) -> float:
    """Solid angle of oriented faces (m, 3, 3) seen from a point (3,); NaN on a face.

    Source: Van Oosterom, Strackee, IEEE Trans. Biomed. Eng. 30, 125 (1983), eq. (8).
    """
    total, p = 0.0, (point[0], point[1], point[2])
    for f in range(len(corner)):
        r0, r1 = subtract(corner3(corner, f, 0), p), subtract(corner3(corner, f, 1), p)
        r2 = subtract(corner3(corner, f, 2), p)
        a, b, c = norm(r0), norm(r1), norm(r2)
        triple = dot(r0, cross(r1, r2))
        below = a * b * c + dot(r0, r1) * c + dot(r1, r2) * a + dot(r2, r0) * b
        if below <= 0.0 and abs(triple) <= _MIN_FACE_DISTANCE * a * b * c:
            return math.nan
        total += 2.0 * math.atan2(triple, below)
    return total
