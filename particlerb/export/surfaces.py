"""The surfaces of bodies and walls: what is shown, and where a ray meets it. Knows no browser.

A body is shown as the solid that its case names; bodies of loose particles as their balls, with a
marker for a particle without radius. Rays meet balls and ellipsoids where the formula says, all
else where the triangles are that the screen shows. Lengths in metres, body frame, from the com.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.case.bodies import Body
from particlerb.case.placement import quaternion_of
from particlerb.case.to_system import turn_of
from particlerb.files import Files
from particlerb.geometry.mesh import read_mesh, triangles_of
from particlerb.geometry.particles import kind_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import taken
from particlerb.model.state import axes_across, rotate_back, rotation_matrix
from particlerb.model.system import System

_MIN_AXIS_SHARE: Final = 0.02  # of the longest axis of an ellipsoid: rods and points are to be seen
_MARKER_RADIUS: Final = 0.08  # of a particle without one, in units of the body's extent
_ROD_THICKNESS: Final = 0.02  # in units of its length
_PLANE_SIZE: Final = 2.0  # in units of the scene
_MANY_COPIES: Final = 10_000  # of which each is coarse
_FACETS: Final = 48  # around a cylinder
_PARALLEL: Final = 1e-14  # |det| of a ray beside a triangle, relative
_BOX_FACES: Final = (
    (1, 3, 0), (4, 1, 0), (0, 3, 2), (2, 4, 0), (1, 7, 3), (5, 1, 4),
    (5, 7, 1), (3, 7, 2), (6, 4, 2), (2, 7, 6), (6, 5, 4), (7, 5, 6),
)  # fmt: skip
"""Triangles of a box whose corners are numbered by their bits x y z."""


class SurfaceMesh(NamedTuple):
    """Triangles."""

    vertices: Floats  # (v, 3) [m]
    faces: Ints  # (f, 3)
    is_smooth: bool = False

    def moved(self, R: Floats, shift: Floats) -> "SurfaceMesh":
        """Turned by a rotation matrix (3, 3) and then shifted by (3,) [m]."""
        return self._replace(vertices=self.vertices @ R.T + shift)


class _Surface(NamedTuple):
    """Surface of one kind of body."""

    mesh: SurfaceMesh  # what is shown
    corners: Floats  # (t, 3, 3) triangles that a ray can meet
    centre: Floats  # (e, 3) ellipsoids that a ray can meet
    semi_axes: Floats  # (e, 3) along the axes of the body

    @property
    def reach(self) -> float:
        """Radius of a ball about the centre of mass that holds it all [m]."""
        far = np.linalg.norm(self.mesh.vertices, axis=1).max(initial=0.0)
        balls = np.linalg.norm(self.centre, axis=1) + self.semi_axes.max(axis=1, initial=0.0)
        return float(max(far, balls.max(initial=0.0)))


class _Layer(NamedTuple):
    """Copies of one mesh, one on each of some bodies: drawn together."""

    mesh: SurfaceMesh
    body: Ints  # (n,) body of each copy
    turn: Floats | None  # (4, n) unit quaternions, axes of the mesh to those of the body
    size: Floats | None  # (n, 3) by which it is scaled along its axes


class Hit(NamedTuple):
    """Where a ray meets a body."""

    body: int
    at: Floats  # (3,) [m], body frame
    normal: Floats  # (3,) unit, outward, body frame
    distance: float  # along the ray [m]


class Surfaces:
    """Surfaces of all bodies of a system."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.known: dict[int, _Surface] = {}
        self.layers: list[_Layer] = []
        self.reach: Floats = np.zeros(system.n_bodies)  # radius of a ball that holds each [m]
        for i in range(len(system.body)):
            members = np.flatnonzero(system.block == i)
            kinds, of_body = np.unique(system.kind[members], return_inverse=True)
            self.reach[members] = np.array([self.of_kind(kind).reach for kind in kinds])[of_body]
            if kinds.size == 1:
                self.layers.append(_Layer(self.of_kind(kinds[0]).mesh, members, None, None))
            else:
                bodies = taken(system.bodies, members)
                axes = equal_ellipsoid(bodies.inertia, bodies.mass).T
                frame = system.bodies.rotor_frame[:, members]
                self.layers.append(_Layer(unit_ball(members.size), members, frame, axes))

    def of_kind(self, kind: int) -> _Surface:
        """Surface of a kind of body."""
        kind = int(kind)
        if kind not in self.known:
            first = int(np.argmax(self.system.kind == kind))
            body = self.system.body[self.system.block[first]]
            if body.count > 1 and body.shape is not None and body.shape.type == "cloud":
                self.known[kind] = _ellipsoid_surface(self.system, first)
            else:
                copies = int(np.count_nonzero(self.system.kind == kind))
                self.known[kind] = surface_of(self.system, body, kind, copies)
        return self.known[kind]

    def hit(self, position: Floats, q: Floats, origin: Floats, direction: Floats) -> Hit | None:
        """Nearest point at which a ray meets a body; None where it meets none.

        Parameters
        ----------
        position, q : ndarray, shapes (N, 3) [m] and (N, 4)
            Of all bodies, as they are shown.
        origin, direction : ndarray, shape (3,)
            Of the ray, world frame.
        """
        size = np.linalg.norm(direction)
        if not (np.isfinite(origin).all() and np.isfinite(size) and size > 0.0):
            return None
        direction = direction / size
        away = position - origin
        along = away @ direction
        beside = np.linalg.norm(away - along[:, None] * direction, axis=1)
        near = np.flatnonzero((beside <= self.reach) & (along + self.reach >= 0.0))
        best: Hit | None = None
        for b in near[np.argsort((along - self.reach)[near])].tolist():
            if best is not None and along[b] - self.reach[b] > best.distance:
                break
            start, way = rotate_back(q[b], -away[b]), rotate_back(q[b], direction)
            crossing = meet(self.of_kind(self.system.kind[b]), start, way)
            if crossing is not None and (best is None or crossing[0] < best.distance):
                best = Hit(b, start + crossing[0] * way, crossing[1], crossing[0])
        return best


def meet(surface: _Surface, start: Floats, way: Floats) -> tuple[float, Floats] | None:
    """Distance [m] of a surface in front of a ray, and its outward normal (3,) there.

    The ray starts at (3,) [m] and goes along the unit vector `way` (3,), body frame.
    """
    crossings = [*_meet_triangles(surface.corners, start, way)]
    crossings += _meet_ellipsoids(surface.centre, surface.semi_axes, start, way)
    return min(crossings, key=lambda one: one[0], default=None)


def _meet_triangles(corners: Floats, start: Floats, way: Floats) -> list[tuple[float, Floats]]:
    """Nearest triangle that a ray meets from either side, its normal against the ray.

    Source: Möller and Trumbore, J. Graphics Tools 2, 21 (1997).
    """
    if not len(corners):
        return []
    edge_1, edge_2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(way, edge_2)
    det = np.einsum("ij,ij->i", edge_1, p)
    scale = np.linalg.norm(edge_1, axis=1) * np.linalg.norm(edge_2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        s = start - corners[:, 0]
        q = np.cross(s, edge_1)
        u, v = np.einsum("ij,ij->i", s, p) / det, (q @ way) / det
        t = np.einsum("ij,ij->i", edge_2, q) / det
        inside = (np.abs(det) > _PARALLEL * scale) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    if not inside.any():
        return []
    k = int(np.argmin(np.where(inside, t, np.inf)))
    normal = np.cross(edge_1[k], edge_2[k])
    normal = normal / np.linalg.norm(normal)
    return [(float(t[k]), -normal if normal @ way > 0.0 else normal)]


def _meet_ellipsoids(
    centre: Floats, semi_axes: Floats, start: Floats, way: Floats
) -> list[tuple[float, Floats]]:
    """Nearest ellipsoid that a ray meets from outside."""
    if not len(centre):
        return []
    o, d = (start - centre) / semi_axes, way / semi_axes
    a, half_b, c = (d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1.0
    root = half_b * half_b - a * c
    with np.errstate(invalid="ignore"):
        t = (-half_b - np.sqrt(root)) / a
    ahead = (root >= 0.0) & (t > 0.0)
    if not ahead.any():
        return []
    k = int(np.argmin(np.where(ahead, t, np.inf)))
    normal = (o[k] + t[k] * d[k]) / semi_axes[k]
    return [(float(t[k]), normal / np.linalg.norm(normal))]


def surface_of(system: System, body: Body, kind: int, copies: int) -> _Surface:
    """Surface of the bodies of a record."""
    com = system.properties.com[kind]
    shapes = [(body.shape, np.eye(3), np.zeros(3))] if body.shape is not None else []
    for part in body.part:
        shapes.append((part.shape, turn_of(part), np.array(part.position)))
    surfaces = [solid(system.files, shape, R, place - com, copies) for shape, R, place in shapes]
    solids = [surface for surface in surfaces if surface is not None]
    if len(solids) < len(surfaces):
        return _particles_surface(system, body, kind, copies)
    return together(solids)


def solid(files: Files, shape: Any, R: Floats, shift: Floats, copies: int) -> _Surface | None:
    """Surface of a shape turned by R (3, 3) and shifted by (3,) [m]; None for loose particles."""
    kind, record = shape.type, shape
    if kind in ("ball", "shell", "ellipsoid"):
        axes = np.array(record.semi_axes) if kind == "ellipsoid" else np.full(3, record.radius)
        mesh = unit_ball(copies)
        mesh = mesh._replace(vertices=mesh.vertices * axes).moved(R, shift)
        if np.ptp(axes) == 0.0 or np.array_equal(R, np.eye(3)):  # aligned with the body
            return _Surface(mesh, np.zeros((0, 3, 3)), shift[None], axes[None])
        return triangles(mesh)
    if kind == "mesh":
        surface = read_mesh(files.read(record.file), record.scale)
        return triangles(SurfaceMesh(surface.vertices, surface.faces).moved(R, shift))
    if kind == "points" and record.radius is not None and all(record.radius):
        return _balls_of(np.array(record.position) @ R.T + shift, np.array(record.radius), copies)
    if kind == "box":
        return triangles(box(np.array(record.size)).moved(R, shift))
    made: dict[str, Callable[[], SurfaceMesh]] = {
        "cylinder": lambda: _turned(_tube(record.radius, record.height, record.inner_radius)),
        "cone": lambda: _turned([[0, 0], [record.radius, 0], [0, record.height]]),
        "torus": lambda: _turned(record.minor_radius * _circle() + [record.major_radius, 0], True),
        "tetrahedron": lambda: _tetrahedron(np.array(record.vertices)),
        "rod": lambda: _turned(_tube(_ROD_THICKNESS * record.length, record.length), facets=12),
    }
    return triangles(made[kind]().moved(R, shift)) if kind in made else None


def box(size: Floats) -> SurfaceMesh:
    """Box about the origin with edges (3,) [m]."""
    return SurfaceMesh((np.array([*np.ndindex(2, 2, 2)]) - 0.5) * size, np.array(_BOX_FACES))


def _circle(n: int = _FACETS) -> Floats:
    """Points of the unit circle at equal angles, (n, 2)."""
    angle = 2.0 * np.pi / n * np.arange(n)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1).round(15)  # on the axes 0


def _turned(outline: Any, is_smooth: bool = False, facets: int = _FACETS) -> SurfaceMesh:
    """Surface that a closed outline sweeps about z.

    Parameters
    ----------
    outline : array_like, shape (n, 2) [m]
        Distances from z and heights, the inside at the left; edges on z sweep nothing.
    """
    radius, height = np.array(outline, dtype=np.float64).T
    spokes = _circle(facets)
    rings = np.empty((len(radius), facets, 3))
    rings[..., :2], rings[..., 2] = radius[:, None, None] * spokes, height[:, None]
    here = np.arange(rings.shape[0] * facets).reshape(rings.shape[:2])
    beside, after = np.roll(here, -1, axis=1), np.roll(here, -1, axis=0)
    lower = np.stack([here, beside, np.roll(after, -1, axis=1)], axis=-1)
    upper = np.stack([here, np.roll(after, -1, axis=1), after], axis=-1)
    faces = np.concatenate([lower[radius > 0.0], upper[np.roll(radius, -1) > 0.0]])
    return SurfaceMesh(rings.reshape(-1, 3), faces.reshape(-1, 3), is_smooth)


def _tube(radius: float, height: float, inner: float = 0.0) -> list[list[float]]:
    """Outline of a cylinder about z, with or without a bore."""
    z = 0.5 * height
    return [[inner, -z], [radius, -z], [radius, z], [inner, z]]


def _tetrahedron(vertices: Floats) -> SurfaceMesh:
    """Tetrahedron; its triangles look outward."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    is_left = np.linalg.det(vertices[1:] - vertices[0]) < 0.0
    return SurfaceMesh(vertices, faces[:, ::-1] if is_left else faces)


def triangles(mesh: SurfaceMesh) -> _Surface:
    """Form that a ray meets where its triangles are."""
    none = np.zeros((0, 3))
    return _Surface(mesh, mesh.vertices[mesh.faces], none, none)


def unit_ball(copies: int) -> SurfaceMesh:
    """Ball of radius 1, of as many triangles as the number of copies allows."""
    half = 36 if copies <= 10 else 18 if copies <= 200 else 9 if copies <= 2000 else 5
    angle = np.pi / half * np.arange(half + 1)  # from the lower pole
    outline = np.stack([np.sin(angle), -np.cos(angle)], axis=1).round(15)  # on z at both ends
    return _turned(outline, True, 2 * half)


def _particles_surface(system: System, body: Body, kind: int, copies: int) -> _Surface:
    """A body of loose particles: their balls; six particles with given moments as an octahedron."""
    particles = kind_of(system.particles, kind)
    place, radius = particles.position, particles.radius.copy()
    if radius.any():
        place, radius = place[radius > 0.0], radius[radius > 0.0]
    extent = float(np.linalg.norm(place, axis=1).max())
    radius[radius == 0.0] = _MARKER_RADIUS * extent if extent > 0.0 else 1.0
    surface = _balls_of(place, radius, copies)
    if body.shape is not None and body.shape.type == "moments":
        axes = np.abs(place).max(axis=0) * 0.999
        corners = np.concatenate([np.diag(axes), -np.diag(axes)])
        faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2],
                          [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])  # fmt: skip
        return together([triangles(SurfaceMesh(corners, faces)), surface])
    return surface


def equal_ellipsoid(moments: Floats, mass: Any) -> Floats:
    """Semi-axes (3, ...) [m] of solid ellipsoids with these masses and principal moments (3, ...).

    I1 = m (b² + c²)/5; none is so thin, or so small where it is a point, that it is not seen.
    """
    axes = np.sqrt(np.maximum(2.5 / mass * (moments.sum(axis=0) - 2.0 * moments), 0.0))
    longest = axes.max(axis=0)
    unseen = longest.max() if longest.any() else 1.0  # among bodies of their size, alone 1 m
    return np.maximum(axes, _MIN_AXIS_SHARE * np.where(longest > 0.0, longest, unseen))


def _ellipsoid_surface(system: System, b: int) -> _Surface:
    """A body that shares its shape with no other, as the ellipsoid with its mass and moments."""
    unit = unit_ball(_MANY_COPIES)
    R = rotation_matrix(system.bodies.rotor_frame[:, b])
    axes = equal_ellipsoid(system.bodies.inertia[:, b], system.bodies.mass[b])
    mesh = unit._replace(vertices=unit.vertices * axes)
    return triangles(mesh.moved(R, np.zeros(3)))


def _balls_of(place: Floats, radius: Floats, copies: int) -> _Surface:
    """Balls as one surface."""
    unit = unit_ball(copies * len(place))
    balls = zip(place, radius, strict=True)
    mesh = _joined([unit._replace(vertices=r * unit.vertices + x) for x, r in balls])
    return _Surface(mesh, np.zeros((0, 3, 3)), place, np.tile(radius[:, None], 3))


def _joined(meshes: Sequence[SurfaceMesh]) -> SurfaceMesh:
    """Several meshes as one."""
    vertices, faces, is_smooth = zip(*meshes, strict=True)
    first = np.cumsum([0, *map(len, vertices[:-1])])
    shifted = [indices + n for indices, n in zip(faces, first, strict=True)]
    return SurfaceMesh(np.concatenate(vertices), np.concatenate(shifted), all(is_smooth))


def together(surfaces: Sequence[_Surface]) -> _Surface:
    """Several surfaces as one."""
    if len(surfaces) == 1:
        return surfaces[0]
    meshes, *met_by_rays = zip(*surfaces, strict=True)
    return _Surface(_joined(meshes), *map(np.concatenate, met_by_rays))


def walls_of(system: System, size: float) -> list[SurfaceMesh]:
    """Surfaces of the walls, planes cut to a size [m]; world frame."""
    return [surface_of_wall(system.files, wall, size) for wall in system.wall]


def surface_of_wall(files: Files, wall: Any, size: float) -> SurfaceMesh:
    """Surface of one wall, a plane cut to a size [m]; world frame, at t = 0."""
    if wall.type == "plane":
        z = np.array(wall.normal) / np.linalg.norm(wall.normal)
        (x, y), half = axes_across(z), 0.5 * _PLANE_SIZE * size
        corners = [a * half * x + b * half * y for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        return SurfaceMesh(np.array(corners) + wall.point, np.array([[0, 1, 2], [0, 2, 3]]))
    if wall.type == "box":
        lower, upper = np.array(wall.lower), np.array(wall.upper)
        return box(upper - lower).moved(np.eye(3), 0.5 * (lower + upper))
    if wall.type == "cylinder":
        axis = np.array(wall.axis) / np.linalg.norm(wall.axis)
        turn = np.stack([*axes_across(axis), axis], axis=1)
        return _turned(_tube(wall.radius, wall.length)).moved(turn, np.array(wall.centre))
    vertices, faces = triangles_of(files.read(wall.file))
    turn = rotation_matrix(quaternion_of(wall.orientation))
    return SurfaceMesh(wall.scale * vertices, faces).moved(turn, np.array(wall.position))


def extent_of(position: Floats, reach: Floats) -> float:
    """Size of a scene [m]: half the diagonal of the box that holds all bodies."""
    far = position + reach[:, None], position - reach[:, None]
    size = float(np.linalg.norm(far[0].max(axis=0) - far[1].min(axis=0))) / 2.0
    return size if math.isfinite(size) and size > 0.0 else 1.0
