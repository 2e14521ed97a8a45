"""Walls: planes, cylinders and surfaces of triangles (boxes too), at rest or moving as prescribed.

A wall consists of primitives: a plane; the side, the discs and the rims of a cylinder; the faces,
edges and vertices of a surface. All but planes are thin shells, to be touched from both sides.

A sphere touches a wall at each point of it that is nearest to the centre among all points around
that point. A face has such a point if the centre is above or below the face; an edge, if the centre
is beyond that edge for each face that meets there; a vertex, if it is beyond for each edge. So
neighbours share no contact: there is one on a plane of triangles, one over a ridge, two in a valley
(in a smooth bowl of radius R these meet a ball of radius r over about r/R of its way).
Faces of one plane have the very same normal, and all primitives ask on which side of an edge a
centre is by the same formula, so that they divide space among themselves up to rounding.

A wall moves as x = c + d(t) + R(t) (p - c), with d = v t + A sin(2π f t + φ), R = exp(ω t).

References
----------
Ericson, Real-Time Collision Detection (2005), 5.1.5: nearest point of a triangle.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from particlerb._jit import inline, kernel, lean
from particlerb.contact.search import Pairs, sort_by_second, spread
from particlerb.maths.quaternion import Quat, to_body, to_world
from particlerb.maths.vec3 import (
    Bools,
    Floats,
    Ints,
    Vec3,
    add_scaled,
    cross,
    dot,
    load3,
    rows3,
    scale,
    subtract,
)

PLANE: Final = 0  # point, normal
FACE: Final = 1  # three vertices in the order of their numbers, normal
EDGE: Final = 2  # two vertices in the order of their numbers, range in `around`: signed normals
VERTEX: Final = 3  # point, three unused, range in `around`: the other ends of its edges
SIDE: Final = 4  # centre, axis, radius, half of the length
DISC: Final = 5  # centre, axis, radius
RIM: Final = 6  # centre of the circle, axis outwards, radius, whether a disc closes it

FAR: Final = 1e100  # [m] gap of a centre to a primitive that has no point nearest to it
NEAR: Final = 1e-100  # [m] gap of a centre that is behind a plane: it is pushed to the front
COPLANAR: Final = 1e-6  # sine of the angle between faces of one plane: STL has single precision
TILT: Final = (0.5377, 0.8339, 0.1239)  # a centre just above an edge counts as moved that way
UNIT: Final = 1024  # as in `search`
WORK: Final = 4  # body-steps that finding what is near a sphere takes
CELLS: Final = 8  # per primitive, at most
FEWEST_CELLS: Final = 512


class Walls(NamedTuple):
    """Primitives of all walls, those of a wall together; places at t = 0 if nothing moves."""

    kind: Ints  # (n_primitives,)
    parameter: Floats  # (n_primitives, 12) [m], see the kinds
    wall: Ints  # (n_primitives,) ascending
    around: Floats  # (n_around, 3) what edges and vertices have to know of their neighbours


class Motion(NamedTuple):
    """How a wall moves; all zero for one at rest."""

    centre: Vec3 = (0.0, 0.0, 0.0)  # [m] at t = 0
    velocity: Vec3 = (0.0, 0.0, 0.0)  # [m/s] of the centre
    angular_velocity: Vec3 = (0.0, 0.0, 0.0)  # [rad/s]
    amplitude: Vec3 = (0.0, 0.0, 0.0)  # [m]
    frequency: float = 0.0  # [1/s]
    phase: float = 0.0  # [rad]


# Nearest points


@inline
def nearest_on_plane(p: Vec3, n: Vec3, x: Vec3) -> Vec3:
    """Point of a plane through p with unit normal n."""
    return add_scaled(-dot(subtract(x, p), n), n, x)


@inline
def nearest_on_segment(a: Vec3, b: Vec3, x: Vec3) -> Vec3:
    """Point between a and b."""
    ab = subtract(b, a)
    t = dot(subtract(x, a), ab) / dot(ab, ab)
    return add_scaled(min(max(t, 0.0), 1.0), ab, a)


@inline
def nearest_on_triangle(a: Vec3, b: Vec3, c: Vec3, x: Vec3) -> Vec3:  # noqa: PLR0911
    """Point of a triangle: by the region of the plane that x is above (Ericson, 5.1.5)."""
    ab, ac, ax = subtract(b, a), subtract(c, a), subtract(x, a)
    d1, d2 = dot(ab, ax), dot(ac, ax)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    bx = subtract(x, b)
    d3, d4 = dot(ab, bx), dot(ac, bx)
    if d3 >= 0.0 and d4 <= d3:
        return b
    w_c = d1 * d4 - d3 * d2
    if w_c <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return add_scaled(d1 / (d1 - d3), ab, a)
    cx = subtract(x, c)
    d5, d6 = dot(ab, cx), dot(ac, cx)
    if d6 >= 0.0 and d5 <= d6:
        return c
    w_b = d5 * d2 - d1 * d6
    if w_b <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return add_scaled(d2 / (d2 - d6), ac, a)
    w_a = d3 * d6 - d5 * d4
    if w_a <= 0.0 and d4 >= d3 and d5 >= d6:
        return add_scaled((d4 - d3) / ((d4 - d3) + (d5 - d6)), subtract(c, b), b)
    f = 1.0 / (w_a + w_b + w_c)
    return add_scaled(w_b * f, ab, add_scaled(w_c * f, ac, a))


@inline
def radial(c: Vec3, axis: Vec3, x: Vec3) -> tuple[float, float, Vec3]:
    """Height along the axis through c, distance from it, and the unit vector away from it.

    On the axis itself, where all points of a circle are equally near, it is any across.
    """
    d = subtract(x, c)
    z = dot(d, axis)
    across = add_scaled(-z, axis, d)
    rho = math.sqrt(dot(across, across))
    if rho > 0.0:
        return z, rho, scale(1.0 / rho, across)
    k = (1.0, 0.0, 0.0) if abs(axis[0]) < 0.6 else (0.0, 1.0, 0.0)
    any_one = cross(axis, k)
    return z, rho, scale(1.0 / math.sqrt(dot(any_one, any_one)), any_one)


@inline
def nearest_on_cylinder(c: Vec3, axis: Vec3, radius: float, half: float, x: Vec3) -> Vec3:
    """Point of the side of a cylinder, ends at ± half from its centre c."""
    z, _, away = radial(c, axis, x)
    return add_scaled(radius, away, add_scaled(min(max(z, -half), half), axis, c))


@inline
def nearest_on_disc(c: Vec3, axis: Vec3, radius: float, x: Vec3) -> Vec3:
    """Point of a disc."""
    _, rho, away = radial(c, axis, x)
    return add_scaled(min(rho, radius), away, c)


# A primitive and a centre


class Primitive(NamedTuple):
    """Numbers of one primitive: arrays that enter a function in a loop are counted there."""

    kind: int
    a: Vec3
    b: Vec3
    c: Vec3
    n: Vec3


@lean
def row3(rows: Floats, p: int, k: int) -> Vec3:
    """Three numbers of a row, from k on."""
    return rows[p, k], rows[p, k + 1], rows[p, k + 2]


@inline
def nearest(one: Primitive, x: Vec3) -> Vec3:  # noqa: PLR0911
    """Point of a primitive nearest to x, whatever its neighbours are; wall's frame."""
    kind, a, b, c, _ = one
    if kind == PLANE:
        return nearest_on_plane(a, b, x)
    if kind == FACE:
        return nearest_on_triangle(a, b, c, x)
    if kind == EDGE:
        return nearest_on_segment(a, b, x)
    if kind == VERTEX:
        return a
    if kind == SIDE:
        return nearest_on_cylinder(a, b, c[0], c[1], x)
    if kind == DISC:
        return nearest_on_disc(a, b, c[0], x)
    return nearest_on_cylinder(a, b, c[0], 0.0, x)


@inline
def side(a: Vec3, b: Vec3, n: Vec3, x: Vec3) -> float:
    """(b - a) × (x - a) · n: positive to the left of a to b, seen against n; never zero."""
    ab = subtract(b, a)
    value = dot(cross(ab, subtract(x, a)), n)
    return value if value != 0.0 else dot(cross(ab, TILT), n)


@inline
def is_over_face(a: Vec3, b: Vec3, c: Vec3, n: Vec3, x: Vec3) -> bool:
    """Whether x is above or below a triangle."""
    turn = 1.0 if side(a, b, n, c) > 0.0 else -1.0
    return (
        turn * side(a, b, n, x) > 0.0
        and turn * side(b, c, n, x) > 0.0
        and turn * side(a, c, n, x) < 0.0
    )


@lean
def is_over_edge(a: Vec3, b: Vec3, around: Floats, lo: int, hi: int, x: Vec3) -> bool:
    """Whether x is between the ends of an edge and beyond it for each face that meets there."""
    ab = subtract(b, a)
    found = dot(subtract(x, a), ab) > 0.0 and dot(subtract(x, b), ab) < 0.0
    for k in range(lo, hi):
        found = found and side(a, b, row3(around, k, 0), x) < 0.0
    return found


@lean
def is_over_vertex(a: Vec3, around: Floats, lo: int, hi: int, x: Vec3) -> bool:
    """Whether x is beyond a vertex for each edge that ends there."""
    ax, found = subtract(x, a), True
    for k in range(lo, hi):
        found = found and dot(ax, subtract(row3(around, k, 0), a)) <= 0.0
    return found


@lean
def has_nearest(one: Primitive, around: Floats, x: Vec3) -> bool:
    """Whether a point of a primitive is nearer to x than all points of the wall around it."""
    kind, a, b, c, n = one
    found = True
    if kind == FACE:
        found = is_over_face(a, b, c, n, x)
    elif kind == EDGE:
        found = is_over_edge(a, b, around, int(c[0]), int(c[1]), x)
    elif kind == VERTEX:
        found = is_over_vertex(a, around, int(c[0]), int(c[1]), x)
    elif kind != PLANE:
        z, rho, _ = radial(a, b, x)
        if kind == SIDE:
            found = abs(z) <= c[1]
        elif kind == DISC:
            found = rho < c[0]
        else:
            found = z > 0.0 and (c[1] == 0.0 or rho >= c[0])
    return found


@lean
def gap_of(one: Primitive, around: Floats, x: Vec3) -> Vec3:
    """Vector to x from the point of a primitive that it touches; wall's frame."""
    if not has_nearest(one, around, x):
        return FAR, 0.0, 0.0
    if one.kind == PLANE:
        return scale(max(dot(subtract(x, one.a), one.b), NEAR), one.b)
    if one.kind == FACE:
        return scale(dot(subtract(x, one.a), one.n), one.n)
    return subtract(x, nearest(one, x))


@lean
def touch(walls: Walls, poses: Floats, p: int, x: Vec3) -> tuple[Vec3, Vec3]:
    """Gap between a primitive and the centre of a sphere, and how fast the wall moves there.

    Parameters
    ----------
    walls : Walls
    poses : ndarray, shape (n_walls, 13)
        As `write_poses` gives them for the time that is meant.
    p : int
        Primitive.
    x : tuple of 3 floats [m]
        Centre, world frame.

    Returns
    -------
    gap : tuple of 3 floats [m]
        From the point of the wall to x, world axes. It is as long as FAR where this primitive has
        no point to be touched, and as short as NEAR, along the normal, behind a plane.
    velocity : tuple of 3 floats [m/s]
        Of the wall's point, world axes.
    """
    kind, rows, wall, around = walls
    w = wall[p]
    a, b, c, n = row3(rows, p, 0), row3(rows, p, 3), row3(rows, p, 6), row3(rows, p, 9)
    X, q = row3(poses, w, 0), (poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6])
    d = subtract(x, X)
    gap = to_world(q, gap_of(Primitive(kind[p], a, b, c, n), around, to_body(q, d)))
    velocity = add_scaled(1.0, cross(row3(poses, w, 10), subtract(d, gap)), row3(poses, w, 7))
    return gap, velocity


# Motion


@inline
def motion_in(rows: Floats, k: int) -> Motion:
    """Motion from the numbers of a row."""
    return Motion(
        (rows[k, 0], rows[k, 1], rows[k, 2]),
        (rows[k, 3], rows[k, 4], rows[k, 5]),
        (rows[k, 6], rows[k, 7], rows[k, 8]),
        (rows[k, 9], rows[k, 10], rows[k, 11]),
        rows[k, 12],
        rows[k, 13],
    )


def numbers_of(motions: Sequence[Motion]) -> Floats:
    """Numbers of motions, (n, 14), for `motion_in`."""
    rows = [[*m.centre, *m.velocity, *m.angular_velocity, *m.amplitude, *m[4:]] for m in motions]
    return np.array(rows, dtype=np.float64).reshape(len(rows), 14)


@inline
def pose_at(motion: Motion, t: float) -> tuple[Vec3, Quat, Vec3, Vec3]:
    """Pose of a wall's frame at a time, in closed form.

    Returns
    -------
    x, q : tuples of 3 and 4 floats [m, -]
        A point p of the wall is at x + R p.
    v, omega : tuples of 3 floats [m/s, rad/s]
        Velocity of the frame's origin, where p = 0, and angular velocity.
    """
    centre, velocity, omega, amplitude, frequency, phase = motion
    rate = 2.0 * math.pi * frequency
    turned = rate * t + phase
    way = add_scaled(math.sin(turned), amplitude, scale(t, velocity))
    v = add_scaled(rate * math.cos(turned), amplitude, velocity)
    speed = math.sqrt(dot(omega, omega))
    half = 0.5 * speed * t
    f = math.sin(half) / speed if speed > 0.0 else 0.0
    q = (math.cos(half), f * omega[0], f * omega[1], f * omega[2])
    arm = to_world(q, centre)
    x = subtract(add_scaled(1.0, centre, way), arm)
    return x, q, subtract(v, cross(omega, arm)), omega


def write_poses(motions: Sequence[Motion], t: float, poses: Floats) -> None:
    """Write position, orientation, velocity and angular velocity of each wall, (n_walls, 13)."""
    for wall, motion in enumerate(motions):
        poses[wall] = [number for part in pose_at(motion, t) for number in part]


def poses_at(motions: Sequence[Motion], t: float) -> Floats:
    """Poses of all walls, (n_walls, 13): see `write_poses`."""
    poses = np.empty((len(motions), 13))
    write_poses(motions, t, poses)
    return poses


def farthest_way(motions: Sequence[Motion], duration: float, reach: float) -> float:
    """How far a point of a wall may move in a time [m], within `reach` of the walls' centres."""
    ways = [0.0]
    for _, velocity, omega, amplitude, frequency, _ in motions:
        swing = min(2.0, 2.0 * math.pi * frequency * duration) * math.hypot(*amplitude)
        ways.append(duration * (math.hypot(*velocity) + reach * math.hypot(*omega)) + swing)
    return max(ways)


# Making walls


def joined(walls: Sequence[Walls]) -> Walls:
    """Several walls as one set, numbered in this order."""
    kinds, parameters, owners, around, before = [], [], [], [np.zeros((0, 3))], 0
    for number, part in enumerate(walls):
        parameter = part.parameter.copy()
        has_neighbours = (part.kind == EDGE) | (part.kind == VERTEX)
        parameter[has_neighbours, 6:8] += before
        before += len(part.around)
        kinds.append(part.kind)
        parameters.append(parameter)
        owners.append(np.full(part.kind.size, number))
        around.append(part.around)
    if not kinds:
        none = np.zeros(0, dtype=np.int64)
        return Walls(none, np.zeros((0, 12)), none, around[0])
    return Walls(
        np.concatenate(kinds),
        np.concatenate(parameters),
        np.concatenate(owners),
        np.concatenate(around),
    )


def wall_of(kinds: Sequence[int], parameters: Sequence[Sequence[float]]) -> Walls:
    """Wall of primitives that need no neighbours."""
    parameter = np.zeros((len(kinds), 12))
    for row, values in zip(parameter, parameters, strict=True):
        row[: len(values)] = values
    kind = np.array(kinds, dtype=np.int64)
    return Walls(kind, parameter, np.zeros_like(kind), np.zeros((0, 3)))


def plane(point: Sequence[float], normal: Sequence[float]) -> Walls:
    """Infinite plane; bodies are on the side of its normal."""
    return wall_of([PLANE], [[*point, *unit(normal)]])


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
    return wall_of(kinds, parameters)


FACES_OF_BOX: Final = {
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
    vertices = np.array([[corners[i, 0], corners[j, 1], corners[k, 2]] for i, j, k in BITS])
    faces = [face for name, face in FACES_OF_BOX.items() if name not in open_faces]
    triangles = [three for a, b, c, d in faces for three in ((a, b, c), (a, c, d))]
    return surface(vertices, np.array(triangles))


BITS: Final = tuple(np.ndindex(2, 2, 2))


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
    is_smooth = smoothed(normal, area, edge, ends, faces, places)
    edges = edge_primitives(places, faces, normal, edge, ends, is_smooth)
    corners = vertex_primitives(places, ends, is_smooth)
    parameter = np.concatenate([places[faces].reshape(-1, 9), normal], axis=1)
    kind = np.full(len(faces), FACE)
    return joined_in_one([Walls(kind, parameter, kind * 0, np.zeros((0, 3))), edges, corners])


def joined_in_one(parts: Sequence[Walls]) -> Walls:
    """Parts of the same wall."""
    walls = joined(parts)
    return walls._replace(wall=np.zeros_like(walls.wall))


def smoothed(
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
    is_flat = np.linalg.norm(np.cross(normal[left], normal[right]), axis=1) < COPLANAR
    third = [faces[f].sum(axis=1) - ends[pairs].sum(axis=1) for f in (left, right)]
    along = places[ends[pairs, 1]] - places[ends[pairs, 0]]
    turn = [
        np.einsum("ij,ij->i", np.cross(along, places[v] - places[ends[pairs, 0]]), normal[left])
        for v in third
    ]
    is_flat &= turn[0] * turn[1] < 0.0  # not folded back on itself
    left, right = left[is_flat], right[is_flat]
    patch = np.arange(len(faces))
    while (patch[left] != patch[right]).any():
        lower = np.minimum(patch[left], patch[right])
        np.minimum.at(patch, left, lower)
        np.minimum.at(patch, right, lower)
        patch = patch[patch]
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


def edge_primitives(
    places: Floats, faces: Ints, normal: Floats, edge: Ints, ends: Ints, is_smooth: Bools
) -> Walls:
    """Edges that do not lie within a plane, each with the normals of the faces that meet there.

    The sign of a normal is the one for which the face is on the positive `side` of the edge.
    """
    flat = edge.reshape(-1)
    order = np.argsort(flat, kind="stable")
    order = order[~is_smooth[flat[order]]]
    own, face = flat[order], order // 3
    a, b = places[ends[own, 0]], places[ends[own, 1]]
    third = places[faces[face].sum(axis=1) - ends[own].sum(axis=1)]
    turn = np.einsum("ij,ij->i", np.cross(b - a, third - a), normal[face])
    which = np.flatnonzero(~is_smooth)
    parameter = np.zeros((which.size, 12))
    parameter[:, :6] = places[ends[which]].reshape(-1, 6)
    parameter[:, 6] = np.searchsorted(own, which, side="left")
    parameter[:, 7] = np.searchsorted(own, which, side="right")
    kind = np.full(which.size, EDGE)
    return Walls(kind, parameter, kind * 0, np.sign(turn)[:, None] * normal[face])


def vertex_primitives(places: Floats, ends: Ints, is_smooth: Bools) -> Walls:
    """Vertices that do not lie within a plane, each with the other ends of its edges."""
    which = np.unique(ends[~is_smooth])
    here = np.concatenate([ends[:, 0], ends[:, 1]])
    there = np.concatenate([ends[:, 1], ends[:, 0]])
    order = np.argsort(here, kind="stable")
    order = order[np.isin(here[order], which)]
    parameter = np.zeros((which.size, 12))
    parameter[:, :3] = places[which]
    parameter[:, 6] = np.searchsorted(here[order], which, side="left")
    parameter[:, 7] = np.searchsorted(here[order], which, side="right")
    kind = np.full(which.size, VERTEX)
    return Walls(kind, parameter, kind * 0, places[there[order]])


# Candidates


class Lists(NamedTuple):
    """Primitives of each wall that a sphere may touch, by the cell of its centre.

    The first list of a wall is for all centres, the others are those of its cells.
    """

    origin: Floats  # (n_walls, 3) [m], wall's frame
    per_metre: Floats  # (n_walls,) [1/m] one over the width of a cell
    shape: Ints  # (n_walls, 3)
    first: Ints  # (n_walls + 1,) lists of wall w are first[w] to first[w + 1]
    begin: Ints  # (n_lists + 1,) entries of list k are begin[k] to begin[k + 1]
    entry: Ints  # (n_entries,) primitive


@lean
def primitive(kind: Ints, rows: Floats, p: int) -> Primitive:
    """Primitive p."""
    a, b, c, n = row3(rows, p, 0), row3(rows, p, 3), row3(rows, p, 6), row3(rows, p, 9)
    return Primitive(kind[p], a, b, c, n)


@inline
def squared_distance(one: Primitive, x: Vec3) -> float:
    """Square of the distance from a primitive [m²], behind a plane 0."""
    if one.kind == PLANE and dot(subtract(x, one.a), one.b) < 0.0:
        return 0.0
    d = subtract(x, nearest(one, x))
    return dot(d, d)


@kernel
def list_primitives(
    walls: Walls, lists: Lists, corners: Ints, reach: float, is_counting: bool
) -> None:
    """Count, or write, the primitives within reach of each cell.

    Parameters
    ----------
    walls, lists : Walls, Lists
        Counting, `begin` gets the number for list k at k + 2; writing, it is a sum of these, and
        is left as it is meant.
    corners : ndarray, shape (n_primitives, 6)
        First and last cell in each direction that a primitive is near to.
    reach : float
        [m]
    is_counting : bool
    """
    kind, rows, wall, _ = walls
    origin, per_metre, shape, first, begin, entry = lists
    for p in range(kind.size):
        w, one = wall[p], primitive(kind, rows, p)
        zero, step = row3(origin, w, 0), 1.0 / per_metre[w]
        far = reach + 0.5 * math.sqrt(3.0) * step * (1.0 + 1e-9)
        for i in range(corners[p, 0], corners[p, 3] + 1):
            for j in range(corners[p, 1], corners[p, 4] + 1):
                for k in range(corners[p, 2], corners[p, 5] + 1):
                    middle = add_scaled(step, (i + 0.5, j + 0.5, k + 0.5), zero)
                    cell = first[w] + 1 + (i * shape[w, 1] + j) * shape[w, 2] + k
                    cell = first[w] if kind[p] == PLANE else cell
                    if kind[p] != PLANE and squared_distance(one, middle) > far * far:
                        continue
                    if not is_counting:
                        entry[begin[cell + 1]] = p
                    begin[cell + (2 if is_counting else 1)] += 1


@inline
def list_of(x: Vec3, zero: Vec3, per_metre: float, shape: tuple[int, int, int], first: int) -> int:
    """List of the cell of a centre; -1 outside of all cells."""
    i, j, k = subtract(x, zero)
    i, j, k = math.floor(i * per_metre), math.floor(j * per_metre), math.floor(k * per_metre)
    if min(i, j, k) < 0 or i >= shape[0] or j >= shape[1] or k >= shape[2]:
        return -1
    return first + 1 + int((i * shape[1] + j) * shape[2] + k)


@kernel
def find_candidates(
    walls: Walls,
    lists: Lists,
    poses: Floats,
    points: Floats,
    reach: Floats,
    which: Ints,
    pairs: Pairs,
    is_counting: bool,
    first_unit: int,
    last_unit: int,
) -> None:
    """Count, or write, the primitives within reach of the spheres of units first to last.

    Counting, the number of sphere i is written to start[i + 1].
    """
    kind, rows, _, _ = walls
    origin, per_metre, shape, first, begin, entry = lists
    _, second, start = pairs
    place = rows3(points, 0, points.shape[1])
    for at in range(first_unit * UNIT, min(last_unit * UNIT, which.size)):
        i = which[at]
        count, square = 0, reach[i] * reach[i]
        for w in range(per_metre.size):
            q = (poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6])
            x = to_body(q, subtract(load3(place, i), row3(poses, w, 0)))
            shape_w = (shape[w, 0], shape[w, 1], shape[w, 2])
            cell = list_of(x, row3(origin, w, 0), per_metre[w], shape_w, first[w])
            for own in (first[w], cell):
                for k in range(begin[max(own, 0)], begin[own + 1]):
                    p = entry[k]
                    if squared_distance(primitive(kind, rows, p), x) < square:
                        if not is_counting:
                            second[start[i] + count] = p
                        count += 1
        if is_counting:
            start[i + 1] = count


class WallSearch:
    """Finds the primitives of walls near spheres, again and again.

    Parameters
    ----------
    walls : Walls
    radius : ndarray, shape (n,) [m]
        Of the spheres.
    """

    def __init__(self, walls: Walls, radius: Floats) -> None:
        self.walls, self.radius = walls, radius
        self.everyone = np.arange(radius.size)
        self.reach = -1.0

    def pairs(self, points: Floats, poses: Floats, skin: float, which: Ints | None = None) -> Pairs:
        """Pairs of a sphere and a primitive that is nearer to its centre than r + skin.

        Parameters
        ----------
        points : ndarray, shape (3, n) [m]
            Centres.
        poses : ndarray, shape (n_walls, 13)
            Of the walls at the same time.
        skin : float
            Not negative [m].
        which : ndarray, shape (k,), optional
            Spheres that take part, ascending; left out: all.

        Returns
        -------
        Pairs
            The sphere is the first, the primitive the second; sorted by both.
        """
        which = self.everyone if which is None else which
        n, walls = self.everyone.size, self.walls
        start = np.zeros(n + 1, dtype=np.int64)
        reach = self.radius + skin
        if not which.size or not walls.kind.size:
            return Pairs(self.everyone[:0], self.everyone[:0], start)
        if reach.max() > self.reach:
            self.reach = float(reach.max())
            self.lists = lists_of(walls, self.reach)
        pairs = Pairs(self.everyone[:0], self.everyone[:0], start)
        self.visit(points, poses, reach, which, pairs, True)
        np.cumsum(start, out=start)
        first, second = np.empty((2, int(start[-1])), dtype=np.int64)
        pairs = Pairs(first, second, start)
        self.visit(points, poses, reach, which, pairs, False)
        spread(lambda lo, hi: sort_by_second(pairs, lo, hi), n)
        return pairs

    def visit(
        self,
        points: Floats,
        poses: Floats,
        reach: Floats,
        which: Ints,
        pairs: Pairs,
        is_counting: bool,
    ) -> None:
        """Count, or write, what is near the spheres."""
        walls, lists = self.walls, self.lists
        spread(
            lambda lo, hi: find_candidates(
                walls, lists, poses, points, reach, which, pairs, is_counting, lo, hi
            ),
            which.size,
            WORK,
        )


def lists_of(walls: Walls, reach: float) -> Lists:
    """Lists for centres that may touch what is within reach [m]."""
    lower, upper = bounds_of(walls)
    n_walls = int(walls.wall.max(initial=-1)) + 1
    shape, origin = np.zeros((n_walls, 3), dtype=np.int64), np.zeros((n_walls, 3))
    width = np.ones(n_walls)
    corners = np.zeros((walls.kind.size, 6), dtype=np.int64)
    for w in range(n_walls):
        own = np.flatnonzero((walls.wall == w) & (walls.kind != PLANE))
        if not own.size:
            continue
        low, high = lower[own] - reach, upper[own] + reach
        origin[w] = low.min(axis=0)
        extent = high.max(axis=0) - origin[w]
        width[w] = max(np.cbrt(extent.prod() / (CELLS * own.size + FEWEST_CELLS)), 2.0 * reach)
        shape[w] = np.floor(extent / width[w]) + 1
        corners[own, :3] = (low - origin[w]) / width[w]
        corners[own, 3:] = (high - origin[w]) / width[w]
        corners[own, 3:] = np.minimum(corners[own, 3:], shape[w] - 1)
    first = np.concatenate([[0], np.cumsum(shape.prod(axis=1) + 1)])
    begin = np.zeros(first[-1] + 2, dtype=np.int64)
    lists = Lists(origin, 1.0 / width, shape, first, begin, np.zeros(0, dtype=np.int64))
    list_primitives(walls, lists, corners, reach, True)
    np.cumsum(begin, out=begin)
    lists = lists._replace(entry=np.empty(begin[-1], dtype=np.int64))
    list_primitives(walls, lists, corners, reach, False)
    return lists


def bounds_of(walls: Walls) -> tuple[Floats, Floats]:
    """Opposite corners of the box around each primitive, (n_primitives, 3) [m]; not of planes."""
    kind, parameter, _, _ = walls
    a, b, c = parameter[:, :3], parameter[:, 3:6], parameter[:, 6:9]
    lower, upper = a.copy(), a.copy()
    for kinds, others in (((FACE, EDGE), b), ((FACE,), c)):
        own = np.isin(kind, kinds)
        lower[own] = np.minimum(lower[own], others[own])
        upper[own] = np.maximum(upper[own], others[own])
    own = np.isin(kind, (SIDE, DISC, RIM))
    half = np.where(kind == SIDE, c[:, 1], 0.0)[:, None] * np.abs(b)
    half += c[:, :1] * np.sqrt(np.maximum(1.0 - b * b, 0.0))
    lower[own] -= half[own]
    upper[own] += half[own]
    return lower, upper
