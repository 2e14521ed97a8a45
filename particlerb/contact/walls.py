"""Walls: planes, cylinders and surfaces of triangles (boxes too), and where a sphere touches them.

A wall consists of primitives: a plane; the side, the discs and the rims of a cylinder; the faces,
edges and vertices of a surface. All but planes are thin shells, to be touched from both sides.

A wall has points that are nearer to a centre than all of it around them. A face has one if the
centre is above or below the face; an edge, if the centre is beyond that edge for each face that
meets there; a vertex, if it is beyond for each edge. So there is one on a plane of triangles, one
over a ridge, two in a valley; there and in the bottom of a bowl edges and vertices count as well
(`euler_count`). `wall_contacts` makes contacts of what counts.
Faces of one plane have the very same normal, and all primitives ask on which side of an edge a
centre is by the same formula, so that they divide space among themselves up to rounding.

References
----------
Ericson, Real-Time Collision Detection (2005), 5.1.5: nearest point of a triangle.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.records import Records
from particlerb.maths.quaternion import to_body, to_world
from particlerb.maths.rows import column3, row3, row4
from particlerb.maths.vec3 import Floats, Ints, Vec3, add_scaled, cross, dot, norm, scale, subtract

PLANE: Final = 0  # point, normal
FACE: Final = 1  # three vertices in the order of their numbers, normal from where that is left
EDGE: Final = 2  # two vertices in the order of their numbers, range in `around`: signed normals
VERTEX: Final = 3  # point, three unused, ranges in `around`: other ends of its edges, its faces
SIDE: Final = 4  # centre, axis, radius, half of the length
DISC: Final = 5  # centre, axis, radius
RIM: Final = 6  # centre of the circle, axis outwards, radius, whether a disc closes it

FAR: Final = 1e100  # [m] gap of a centre to a primitive that has no point nearest to it
NEAR: Final = 1e-100  # [m] gap of a centre that is behind a plane: it is pushed to the front
_TILT: Final = (0.5377, 0.8339, 0.1239)  # a centre just above an edge counts as moved that way


class Walls(NamedTuple):
    """Primitives of all walls, those of a wall together; positions at t = 0 if nothing moves."""

    kind: Ints  # (n_primitives,)
    parameter: Floats  # (n_primitives, 12) [m], see the kinds
    wall: Ints  # (n_primitives,) ascending
    around: Floats  # (n_around, 3) what edges and vertices have to know of their neighbours


# Nearest points


@inline
def _nearest_on_plane(p: Vec3, n: Vec3, x: Vec3) -> Vec3:
    """Point of a plane through p with unit normal n."""
    return add_scaled(-dot(subtract(x, p), n), n, x)


@inline
def _nearest_on_segment(a: Vec3, b: Vec3, x: Vec3) -> Vec3:
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
    rho = norm(across)
    if rho > 0.0:
        return z, rho, scale(1.0 / rho, across)
    k = (1.0, 0.0, 0.0) if abs(axis[0]) < 0.6 else (0.0, 1.0, 0.0)
    any_one = cross(axis, k)
    return z, rho, scale(1.0 / norm(any_one), any_one)


@inline
def _nearest_on_cylinder(c: Vec3, axis: Vec3, radius: float, half: float, x: Vec3) -> Vec3:
    """Point of the side of a cylinder, ends at ± half from its centre c."""
    z, _, away = radial(c, axis, x)
    return add_scaled(radius, away, add_scaled(min(max(z, -half), half), axis, c))


@inline
def _nearest_on_disc(c: Vec3, axis: Vec3, radius: float, x: Vec3) -> Vec3:
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


@inline
def primitive_at(kind: Ints, rows: Floats, p: int) -> Primitive:
    """Primitive p, from the kinds and parameters of `Walls`."""
    a, b = (rows[p, 0], rows[p, 1], rows[p, 2]), (rows[p, 3], rows[p, 4], rows[p, 5])
    c, n = (rows[p, 6], rows[p, 7], rows[p, 8]), (rows[p, 9], rows[p, 10], rows[p, 11])
    return Primitive(kind[p], a, b, c, n)


@inline
def nearest(primitive: Primitive, x: Vec3) -> Vec3:  # noqa: PLR0911
    """Point of a primitive nearest to x, whatever its neighbours are; wall's frame."""
    kind, a, b, c, _ = primitive
    if kind == PLANE:
        return _nearest_on_plane(a, b, x)
    if kind == FACE:
        return nearest_on_triangle(a, b, c, x)
    if kind == EDGE:
        return _nearest_on_segment(a, b, x)
    if kind == VERTEX:
        return a
    if kind == SIDE:
        return _nearest_on_cylinder(a, b, c[0], c[1], x)
    if kind == DISC:
        return _nearest_on_disc(a, b, c[0], x)
    return _nearest_on_cylinder(a, b, c[0], 0.0, x)


@inline
def squared_distance(primitive: Primitive, x: Vec3) -> float:
    """Square of the distance from a primitive [m²], behind a plane 0."""
    if primitive.kind == PLANE and dot(subtract(x, primitive.a), primitive.b) < 0.0:
        return 0.0
    d = subtract(x, nearest(primitive, x))
    return dot(d, d)


@inline
def side(a: Vec3, b: Vec3, n: Vec3, x: Vec3) -> float:
    """(b - a) × (x - a) · n: positive to the left of a to b, seen against n; never zero."""
    ab = subtract(b, a)
    value = dot(cross(ab, subtract(x, a)), n)
    return value if value != 0.0 else dot(cross(ab, _TILT), n)


@inline
def is_over_face(a: Vec3, b: Vec3, c: Vec3, n: Vec3, x: Vec3) -> bool:
    """Whether x is above or below a triangle, which is to the left of a to b seen against n."""
    return side(a, b, n, x) > 0.0 and side(b, c, n, x) > 0.0 and side(a, c, n, x) < 0.0


@inline
def _count_at_edge(a: Vec3, b: Vec3, around: Floats, lo: int, hi: int, x: Vec3) -> tuple[int, bool]:
    """`euler_count` of an edge: the faces that x is beyond, but for all but one that meet there."""
    ab = subtract(b, a)
    if dot(subtract(x, a), ab) <= 0.0 or dot(subtract(x, b), ab) >= 0.0:
        return 0, False
    beyond = 0
    for k in range(lo, hi):
        beyond += 1 if side(a, b, row3(around, k), x) < 0.0 else 0
    return beyond - (hi - lo) + 1, beyond == hi - lo


@inline
def _count_at_vertex(
    a: Vec3, around: Floats, lo: int, middle: int, hi: int, x: Vec3
) -> tuple[int, bool]:
    """`euler_count` of a vertex: 1, less edges that come nearer, and faces between two of them."""
    ax, nearer = subtract(x, a), 0
    for k in range(lo, middle):
        nearer += 1 if dot(ax, subtract(row3(around, k), a)) > 0.0 else 0
    count = 1 - nearer
    if nearer > 1:
        for k in range(middle, hi):
            one, other = lo + int(around[k, 0]), lo + int(around[k, 1])
            is_near = dot(ax, subtract(row3(around, one), a)) > 0.0
            is_near = is_near and dot(ax, subtract(row3(around, other), a)) > 0.0
            count += 1 if is_near else 0
    return count, nearer == 0


@inline
def euler_count(primitive: Primitive, around: Floats, x: Vec3) -> tuple[int, bool]:
    """How often a point of a primitive counts, and whether it is nearer to x than all around it.

    1 where a sphere around x that grows meets a new piece of the wall there, -1 where two of its
    pieces join or one closes to a ring, 1 where a ring is filled, 0 where nothing of that happens.
    """
    kind, a, b, c, n = primitive
    if kind == FACE:
        return (1, True) if is_over_face(a, b, c, n, x) else (0, False)
    if kind == EDGE:
        return _count_at_edge(a, b, around, int(c[0]), int(c[1]), x)
    if kind == VERTEX:
        return _count_at_vertex(a, around, int(c[0]), int(c[1]), int(c[2]), x)
    is_opposite = True
    if kind != PLANE:
        z, rho, _ = radial(a, b, x)
        if kind == SIDE:
            is_opposite = abs(z) <= c[1]
        elif kind == DISC:
            is_opposite = rho < c[0]
        else:
            is_opposite = z > 0.0 and (c[1] == 0.0 or rho >= c[0])
    return (1, True) if is_opposite else (0, False)


@inline
def gap_vector(primitive: Primitive, x: Vec3) -> Vec3:
    """Vector to x from the nearest point of a primitive, of a face from that of its plane."""
    if primitive.kind == PLANE:
        return scale(max(dot(subtract(x, primitive.a), primitive.b), NEAR), primitive.b)
    if primitive.kind == FACE:
        return scale(dot(subtract(x, primitive.a), primitive.n), primitive.n)
    return subtract(x, nearest(primitive, x))


@inline
def normal_rate(primitive: Primitive, x: Vec3, n: Vec3, u: Vec3) -> Vec3:
    """How the normal of a primitive turns [1/s] while a point x near it moves with u [m/s].

    Parameters
    ----------
    primitive : Primitive
        In whose frame all is.
    x, n : tuples of 3 floats
        Point [m], and the unit vector to it from the nearest point.
    u : tuple of 3 floats [m/s]

    Returns
    -------
    tuple of 3 floats [1/s]
        ṅ = K u, with the curvatures K of the surface at the distance of x.
    """
    kind, a, b, _, _ = primitive
    if kind in (PLANE, FACE, DISC):
        return 0.0, 0.0, 0.0
    across = add_scaled(-dot(u, n), n, u)
    if kind == EDGE:
        edge = subtract(b, a)
        across = add_scaled(-dot(u, edge) / dot(edge, edge), edge, across)
    elif kind != VERTEX:
        _, rho, away = radial(a, b, x)
        around = cross(b, away)
        bent = scale(dot(n, away) * dot(u, around) / max(rho, NEAR), around)
        if kind == SIDE:
            return bent
        across = add_scaled(-dot(u, around), around, across)
        return add_scaled(1.0 / max(norm(subtract(x, nearest(primitive, x))), NEAR), across, bent)
    return scale(1.0 / max(norm(subtract(x, nearest(primitive, x))), NEAR), across)


@inline
def in_frame_of(poses: Records, w: int, x: Vec3) -> Vec3:
    """Point of the world in the frame of wall w."""
    return to_body(row4(poses.orientation, w), subtract(x, row3(poses.position, w)))


@inline
def wall_velocity(poses: Records, w: int, arm: Vec3) -> Vec3:
    """Velocity [m/s] of wall w at an arm from the origin of its frame, world axes."""
    return add_scaled(1.0, cross(row3(poses.angular_velocity, w), arm), row3(poses.velocity, w))


@inline
def gap_and_velocity(walls: Walls, poses: Records, p: int, x: Vec3) -> tuple[Vec3, Vec3]:
    """Gap between a primitive and the centre of a sphere, and how fast the wall moves there.

    Parameters
    ----------
    walls : Walls
    poses : records POSE, shape (n_walls,)
        At the time that is meant.
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
    w, primitive = wall[p], primitive_at(kind, rows, p)
    y = in_frame_of(poses, w, x)
    _, is_nearest = euler_count(primitive, around, y)
    away = gap_vector(primitive, y) if is_nearest else (FAR, 0.0, 0.0)
    gap = to_world(row4(poses.orientation, w), away)
    arm = subtract(subtract(x, row3(poses.position, w)), gap)
    return gap, wall_velocity(poses, w, arm)


def gaps(walls: Walls, poses: Records, points: Floats, indices: Ints, primitive: Ints) -> Floats:
    """Vectors from primitives of walls to some of the points (3, n), (3, m) [m]; FAR: has none."""
    gap = np.empty((3, indices.size))
    _find_gaps(walls, poses, points, indices, primitive, gap)
    return gap


@kernel
def _find_gaps(
    walls: Walls, poses: Records, points: Floats, indices: Ints, primitive: Ints, gap: Floats
) -> None:
    """Write what `gaps` returns."""
    x = points[0], points[1], points[2]
    for k in range(indices.size):
        away, _ = gap_and_velocity(walls, poses, primitive[k], column3(x, indices[k]))
        gap[0, k], gap[1, k], gap[2, k] = away
