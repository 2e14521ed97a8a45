"""Volume, first and second moments of a union of balls in closed form, from its surface.

By Gauss's theorem all of them are integrals over the surface, and this consists of the exposed
parts of the spheres. On each sphere the exposed part E is what no cap of another sphere covers.
Integrals over E of spherical harmonics of degree 1 to 3 are integrals along its edge, which
consists of arcs of circles; that of degree 0, the solid angle, is a sum of triangles with one
apex and of segments, modulo 4π. No piece of space is ever cut, so that touching, identical,
concentric, collinear or cocircular spheres are no special cases. Formulas: docs/mass_properties.md.

Read in this order: `union`, `neighbours`, geometry/caps.py, `patches` with what it calls.
Everything is scaled by the caller so that no number over- or underflows.
"""

import math
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import THREADS
from particlerb.geometry.caps import SAME, Caps, caps_of, circle, exposed_arcs, open_by, point
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Bools, Floats, Ints, Vec3, cross, dot, norm, subtract

_MAX_ARC_PIECE: Final = 0.5 * math.pi  # [rad]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)  # of cubic trigonometric terms: 3e-17
_MAX_TOLERANCE: Final = 1e-9  # as far as this is raised where the edge of a patch does not close
_MAX_EDGE_GAP: Final = 1e-12  # [of the radius] that counts as none in the edge of a patch
_SOLID_ANGLE_ROUNDING: Final = 1e-6  # below which all or nothing of a sphere may be exposed
_WORK_PER_SPHERE: Final = 200  # in the units of threads.LEAST_WORK
N_SUMS: Final = 15  # volume, first (3), second (6) moments, vector area (3), area, gap


# Directions for the apex of the triangles: the one farthest from the edge's antipode is taken.
_APEXES: Final = np.array(
    [
        [math.sqrt(1.0 - z * z) * math.cos(a), math.sqrt(1.0 - z * z) * math.sin(a), z]
        for k in range(12)
        for z, a in [((2 * k + 1.0) / 12.0 - 1.0, 0.7 + 2.399963229728653 * k)]
    ]
)


class _Union(NamedTuple):
    """Moments of a union of balls of density 1."""

    volume: float
    first: Floats  # (3,) ∫ x dV
    second: Floats  # (6,) ∫ x xᵀ dV: xx yy zz xy xz yz
    area: float
    gap: float  # |∮ n dA|, and the gaps in the edges of patches: 0 but for rounding


def union(centre: Floats, radius: Floats) -> _Union:
    """Moments of the union of balls about the origin of their centres.

    Parameters
    ----------
    centre : ndarray, shape (n, 3)
        Of the order of one, as is the largest radius: their cubes must not underflow.
    radius : ndarray, shape (n,)
        Positive.
    """
    cover = neighbours(centre, radius)
    rows = np.zeros((len(radius), N_SUMS))
    c, R = np.ascontiguousarray(centre), np.ascontiguousarray(radius)

    def work(first: int, end: int) -> None:
        patches(c, R, cover, rows, first, end)

    THREADS.share(work, len(radius), _WORK_PER_SPHERE * len(radius))
    sums = np.array([math.fsum(column) for column in rows.T])
    gap = math.hypot(*sums[10:13]) + sums[14]
    return _Union(float(sums[0]), sums[1:4], sums[4:10], float(sums[13]), float(gap))


# Who covers whom


class Cover(NamedTuple):
    """Balls that overlap each ball, but for hidden ones, which have none and cover none."""

    start: Ints  # (n + 1,) those of ball i are other[start[i]:start[i + 1]]
    other: Ints  # (two for each pair,)
    hidden: Bools  # (n,) inside another ball; of identical ones all but the first


def neighbours(centre: Floats, radius: Floats) -> Cover:
    """Who covers whom of balls with centres (n, 3) and radii (n,)."""
    (i, j), distance = _overlapping_pairs(centre, radius)
    large = np.where((radius[i] > radius[j]) | ((radius[i] == radius[j]) & (i < j)), i, j)
    small = i + j - large
    hidden = np.zeros(len(radius), dtype=np.bool_)
    hidden[small[distance <= (radius[large] - radius[small]) + SAME * radius[large]]] = True
    shown = ~(hidden[i] | hidden[j])
    ball, other = np.stack([i, j, j, i])[:, shown].reshape(2, -1)
    order = np.lexsort((np.tile(np.arange(len(ball) // 2), 2), ball))
    start = np.searchsorted(ball[order], np.arange(len(radius) + 1))
    return Cover(start, other[order], hidden)


def _overlapping_pairs(centre: Floats, radius: Floats) -> tuple[Ints, Floats]:
    """Pairs of balls that overlap, (2, k), and their distances, (k,); nested ones are pairs too.

    Found by a sweep along the longest axis.
    """
    along = int(np.argmax(np.ptp(centre, axis=0)))
    low = centre[:, along] - radius
    order = np.argsort(low, kind="stable")
    c, R = np.ascontiguousarray(centre[order]), np.ascontiguousarray(radius[order])
    n_pairs = _sweep(c, R, along, np.empty((2, 0), dtype=np.int64))
    pairs = np.empty((2, n_pairs), dtype=np.int64)
    _sweep(c, R, along, pairs)
    i, j = order[pairs]
    return np.stack([i, j]), np.linalg.norm(centre[j] - centre[i], axis=1)


@kernel
def _sweep(centre: Floats, radius: Floats, along: int, pairs: Ints) -> int:
    """Write the pairs of balls in the order of their lowest points, or only count them."""
    count = 0
    for i in range(len(radius)):
        top = centre[i, along] + radius[i]
        for j in range(i + 1, len(radius)):
            if centre[j, along] - radius[j] > top:
                break
            if norm(subtract(row3(centre, j), row3(centre, i))) < radius[i] + radius[j]:
                if pairs.shape[1] > 0:
                    pairs[0, count], pairs[1, count] = i, j
                count += 1
    return count


# One sphere


@kernel
def patches(
    centre: Floats, radius: Floats, cover: Cover, rows: Floats, first: int, end: int
) -> None:
    """Write what the exposed parts of spheres first to end add to the moments: rows (n, N_SUMS)."""
    for i in range(first, end):
        if cover.hidden[i]:
            continue
        others, same = cover.other[cover.start[i] : cover.start[i + 1]], SAME
        while True:
            caps = caps_of(centre, radius, others, i, same)
            arcs = exposed_arcs(caps, same)
            gap = open_by(caps, arcs)
            if gap <= _MAX_EDGE_GAP or same >= _MAX_TOLERANCE:
                break
            same *= 10.0
        c = (centre[i, 0], centre[i, 1], centre[i, 2])
        _add_patch(caps, arcs, c, radius[i], rows[i])
        rows[i, 14] = gap * radius[i] * radius[i] if gap > _MAX_EDGE_GAP else 0.0


@kernel
def _best_apex(caps: Caps, arcs: Floats) -> int:
    """Number of the apex whose antipode is farthest from the ends of arcs."""
    best, farthest = 0, -1.0
    for a in range(len(_APEXES)):
        nearest = 2.0
        for m in range(len(arcs)):
            c = circle(caps, int(arcs[m, 0]))
            pieces = max(1, math.ceil((arcs[m, 2] - arcs[m, 1]) / _MAX_ARC_PIECE))
            for piece in range(pieces + 1):
                t = arcs[m, 1] + (arcs[m, 2] - arcs[m, 1]) * piece / pieces
                nearest = min(nearest, 1.0 + dot(row3(_APEXES, a), point(c, t)))
        if nearest > farthest:
            best, farthest = a, nearest
    return best


@inline
def _triangle(a: Vec3, p: Vec3, q: Vec3) -> float:
    """Signed solid angle of a spherical triangle, −2π to 2π.

    Source: Van Oosterom, Strackee, IEEE Trans. Biomed. Eng. 30, 125 (1983), equation 8.
    """
    return 2.0 * math.atan2(dot(a, cross(p, q)), 1.0 + dot(a, p) + dot(a, q) + dot(p, q))


@kernel
def _add_patch(caps: Caps, arcs: Floats, c: Vec3, R: float, row: Floats) -> None:
    """Moments of the exposed part of one sphere with centre c and radius R.

    With ∫ Y = −1/(l (l + 1)) ∮ ∂Y/∂ν for a harmonic Y of degree l, ν = (u − h n) / s pointing out
    of the patch: N = ∫ n, T = ∫ n nᵀ and U = ∫ n nᵀ (c · n) from A = ∫ 1.
    """
    A = _solid_angle(caps, arcs)
    N, K, W = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    cc = np.array(c)
    for m in range(len(arcs)):
        k = int(arcs[m, 0])
        edge = circle(caps, k)
        u, h = caps.axis[k], caps.height[k]
        cu = dot(c, edge[0])
        pieces = max(1, math.ceil((arcs[m, 2] - arcs[m, 1]) / _MAX_ARC_PIECE))
        half = 0.5 * (arcs[m, 2] - arcs[m, 1]) / pieces
        for piece in range(pieces):
            middle = arcs[m, 1] + (2 * piece + 1) * half
            for g in range(len(_NODES)):
                weight, n = half * _WEIGHTS[g], point(edge, middle + half * _NODES[g])
                cn = dot(c, n)
                for a in range(3):
                    N[a] += weight * (u[a] - h * n[a])
                    for b in range(a, 3):
                        un, nn = u[a] * n[b] + n[a] * u[b], n[a] * n[b]
                        K[a, b] += weight * (un - 2.0 * h * nn)
                        mixed = cc[a] * (u[b] - h * n[b]) + cc[b] * (u[a] - h * n[a])
                        if a == b:
                            mixed += cu - h * cn
                        W[a, b] += weight * (un * cn + nn * (cu - 3.0 * h * cn) - 0.2 * mixed)
    cT, cN = np.zeros(3), 0.0
    for a in range(3):
        N[a] *= -0.5
        cN += cc[a] * N[a]
        for b in range(a, 3):
            K[a, b] = (A / 3.0 if a == b else 0.0) - K[a, b] / 6.0
            K[b, a] = K[a, b]
    for a in range(3):
        cT[a] = K[a, 0] * c[0] + K[a, 1] * c[1] + K[a, 2] * c[2]
    flux = cN + R * A
    RR = R * R
    row[0] = RR * flux / 3.0
    for a in range(3):
        row[1 + a] = 0.25 * RR * (cc[a] * flux + R * (cT[a] + R * N[a]))
        row[10 + a] = RR * N[a]
    row[13] = RR * A
    for at, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        U = 0.2 * (cc[a] * N[b] + cc[b] * N[a] + (cN if a == b else 0.0)) - W[a, b] / 12.0
        outer = cc[a] * cc[b] * flux + R * (cc[a] * cT[b] + cc[b] * cT[a])
        outer += RR * (cc[a] * N[b] + cc[b] * N[a] + U) + RR * R * K[a, b]
        row[4 + at] = 0.2 * RR * outer


@kernel
def _solid_angle(caps: Caps, arcs: Floats) -> float:
    """Solid angle ∫ 1 of what the caps leave, from its edge.

    The edge, run with the caps on the left, encloses what the triangles (apex, p, q) and the
    segments between chord and arc add up to, modulo 4π. All or nothing, which both are 0 then, are
    told apart by the largest cap.
    """
    if len(arcs) == 0:
        return 4.0 * math.pi if len(caps.height) == 0 else 0.0
    a = row3(_APEXES, _best_apex(caps, arcs))
    covered = 0.0
    for m in range(len(arcs)):
        c = circle(caps, int(arcs[m, 0]))
        h, depth = c[3], c[4]
        pieces = max(1, math.ceil((arcs[m, 2] - arcs[m, 1]) / _MAX_ARC_PIECE))
        step = (arcs[m, 2] - arcs[m, 1]) / pieces
        for piece in range(pieces):
            p, q = point(c, arcs[m, 1] + piece * step), point(c, arcs[m, 1] + (piece + 1) * step)
            chord = 2.0 * math.atan2(depth * math.sin(step), 1.0 + h + depth * math.cos(step))
            covered += _triangle(a, p, q) + depth * step - chord
    full = 4.0 * math.pi
    A = -covered - full * math.floor(-covered / full)
    if _SOLID_ANGLE_ROUNDING < A < full - _SOLID_ANGLE_ROUNDING:
        return A
    rest = A - full if A > _SOLID_ANGLE_ROUNDING else A  # about 0
    is_bare = 2.0 * math.pi * caps.depth.max() <= 2.0 * _SOLID_ANGLE_ROUNDING
    return full + min(rest, 0.0) if is_bare else max(rest, 0.0)
