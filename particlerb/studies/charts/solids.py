"""Solids in a picture: the shapes that a case gives its bodies, and walls as lines.

A view is a matrix whose rows point to the right, upwards and away from who looks.
"""

import contextlib
from collections.abc import Sequence
from itertools import product
from typing import Any, Final, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba

from particlerb.case.bodies import Body
from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.contact.wall_motion import poses_at
from particlerb.export.surfaces import SurfaceMesh, Surfaces, surface_of, surface_of_wall
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.state import rotation_matrix
from particlerb.model.system import System
from particlerb.plan.obstacles import middle, motion_of
from particlerb.record.provenance import changes_in
from particlerb.record.trajectory import Trajectory, TrajectoryError
from particlerb.studies.charts.style import INK

_Tint: TypeAlias = str | Floats | None
BODY_TINT: Final = "#eceff2"
ANGLED: Final = "[m], seen from above at an angle"
_VIEW_ANGLES: Final = np.radians((35.0, 22.0))  # about the vertical, and from above
_SOLID_SHAPES: Final = frozenset(
    ("box", "ball", "shell", "ellipsoid", "cylinder", "cone", "torus", "tetrahedron", "mesh", "rod")
)
"""Shapes with a surface; loose particles are drawn as such."""
MAX_TRIANGLES: Final = 40_000  # triangles in a picture
_SMALL: Final = 10  # copies for one that is drawn small, and may be as coarse as these
_RIM: Final = "#b5bcc4"
_MAX_EDGE_COSINE: Final = 0.85  # cosine of the angle of two faces whose edge is drawn
_LIGHT_DIRECTION: Final = np.array([-0.4, 0.6, -0.7]) / np.linalg.norm([-0.4, 0.6, -0.7])


def view_at_angle(up: int) -> Floats:
    """View with an axis of the world upwards, turned about it and tilted."""
    (cos, cos_up), (sin, sin_up) = np.cos(_VIEW_ANGLES), np.sin(_VIEW_ANGLES)
    axis = np.eye(3)
    first, second = axis[(up + 1) % 3], axis[(up + 2) % 3]
    right, level = cos * first + sin * second, cos * second - sin * first
    return np.stack([right, cos_up * axis[up] + sin_up * level, cos_up * level - sin_up * axis[up]])


def system_of(trajectory: Trajectory) -> System | None:
    """System of a trajectory at its start; None where its case cannot be made again."""
    with contextlib.suppress(CaseError, TrajectoryError, ImportError, OSError):
        system = to_system(trajectory.case)
        if system.n_bodies == trajectory.n_bodies:
            return system
    return None


def solids_of(trajectory: Trajectory) -> list[SurfaceMesh | None]:
    """Surface of each body in its frame, from the centre of mass; None where it has none.

    Where the case cannot be made again no body has one.
    """
    none: list[SurfaceMesh | None] = [None] * trajectory.n_bodies
    if (system := system_of(trajectory)) is None:
        return none
    surfaces, has_surface = Surfaces(system), [_has_surface(body) for body in system.body]
    bodies = zip(system.kind, system.block, strict=True)
    meshes = [surfaces.of_kind(kind).mesh if has_surface[k] else None for kind, k in bodies]
    total = sum(len(mesh.faces) for mesh in meshes if mesh is not None)
    return meshes if total <= MAX_TRIANGLES else none


def small_solid_of(trajectory: Trajectory, body: int, times: int) -> SurfaceMesh | None:
    """Surface of a body that is drawn small, so many times; of loose particles too, else as above.

    None where there are too many triangles, of which half face who looks.
    """
    if (system := system_of(trajectory)) is None:
        return None
    record, kind = system.body[system.block[body]], int(system.kind[body])
    mesh = surface_of(system, record, kind, _SMALL * times).mesh
    return mesh if 0.5 * times * len(mesh.faces) <= MAX_TRIANGLES else None


def view_along(across: int, up: int) -> Floats:
    """View with an axis of the world to the right and one upwards; looked at from in front."""
    axis = np.eye(3)
    return np.stack([axis[across], axis[up], np.cross(axis[up], axis[across])])


def placed(solids: Sequence[SurfaceMesh], view: Floats, q: Floats, x: Floats) -> list[SurfaceMesh]:
    """Solids at orientations (n, 4) and places (n, 3), with the vertices of a view."""
    poses = zip(solids, q, x, strict=True)
    return [mesh.moved(view @ rotation_matrix(turn), view @ com) for mesh, turn, com in poses]


def _has_surface(body: Body) -> bool:
    """Whether all of a body are shapes with a surface."""
    shapes: list[Any] = [part.shape for part in body.part] or [body.shape]
    return all(shape is not None and shape.type in _SOLID_SHAPES for shape in shapes)


def draw_solids(
    axes: Axes, solids: Sequence[SurfaceMesh], tint: _Tint, height: float, line: str = INK
) -> None:
    """Draw solids whose vertices are those of the view, those in front over those behind.

    A tint of rows (n, 3) is one of each solid. Without a tint only their edges are drawn.
    """
    shapes: list[Floats] = []
    fills: list[Floats] = []
    edges: list[Floats] = []
    depths: list[Floats] = []
    rgb: Any = to_rgb(tint) if isinstance(tint, str) else tint
    for mesh, colour in zip(solids, np.broadcast_to(rgb, (len(solids), 3)), strict=True):
        if not mesh.faces.size:
            continue
        normal = _normals(mesh)
        is_front = normal[:, 2] < 0.0
        faces = mesh.vertices[mesh.faces[is_front]]
        if tint is not None:
            bright = 0.78 + 0.22 * np.clip(normal[is_front] @ _LIGHT_DIRECTION, 0.0, 1.0)
            shades = np.append(bright[:, None] * colour, np.ones((len(faces), 1)), axis=1)
            shapes += list(faces[:, :, :2])
            fills.append(shades)
            edges.append(shades)
            depths.append(faces[:, :, 2].mean(axis=1))
        ends, beside = _sharp_edges(mesh, normal, is_front)
        lines = mesh.vertices[ends]
        shapes += list(lines[:, :, :2])
        fills.append(np.zeros((len(lines), 4)))
        edges.append(np.tile(to_rgba(line), (len(lines), 1)))
        depth = np.where(is_front, mesh.vertices[mesh.faces][:, :, 2].mean(axis=1), np.inf)
        depths.append(depth[beside].min(axis=1) - 1e-6 * np.ptp(mesh.vertices, axis=0).max())
    if not shapes:
        return
    order = np.argsort(-np.concatenate(depths))
    axes.add_collection(PolyCollection(
        [shapes[k] for k in order], facecolors=np.concatenate(fills)[order].tolist(),
        edgecolors=np.concatenate(edges)[order].tolist(), linewidths=0.7, zorder=height,
    ))  # fmt: skip


def _normals(mesh: SurfaceMesh) -> Floats:
    """Outward unit normals of the faces, (f, 3); a view may have turned the order of corners."""
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = mesh.vertices.mean(axis=0)
    is_inside_out = np.einsum("ij,ij->", corners[:, 0] - centre, normal) < 0.0
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    return np.asarray(-normal if is_inside_out else normal)


def _sharp_edges(mesh: SurfaceMesh, normal: Floats, is_front: Bools) -> tuple[Ints, Ints]:
    """Edges that are drawn, of the outline and where faces meet at an angle: ends, faces (e, 2)."""
    faces = mesh.faces
    _, vertex = np.unique(mesh.vertices.round(12), axis=0, return_inverse=True)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    face = np.tile(np.arange(len(faces)), 3)
    key = np.sort(vertex.reshape(-1)[ends], axis=1)
    order = np.lexsort(key.T)
    key, ends, face = key[order], ends[order], face[order]
    same = np.append((key[1:] == key[:-1]).all(axis=1), False)
    is_second = np.append(False, same[:-1])
    partner = np.append(face[1:], face[-1])
    seen = np.where(same, is_front[face] | is_front[partner], is_front[face])
    bent = np.einsum("ij,ij->i", normal[face], normal[partner]) < _MAX_EDGE_COSINE
    outline = is_front[face] != is_front[partner]
    shown = seen & ~is_second & (~same | bent | outline)
    return ends[shown], np.stack([face, np.where(same, partner, face)], axis=1)[shown]


def draw_walls(axes: Axes, trajectory: Trajectory, frame: int, shown: list[int]) -> str:
    """Walls where they are in a frame: planes and boxes seen edge on, others by their outlines.

    `shown` are the axes to the right and upwards. A plane at an angle is left out: the result says
    so to the title. So is a wall that slides where its place was not recorded, and so are all
    where a simulation has changed walls: they may be others.
    """
    if "wall" in changes_in(trajectory.file):
        return ""
    leaning: list[str] = []
    middle_of_scene = trajectory.read("position", frame).mean(axis=0)[shown]
    style: dict[str, Any] = {"color": INK, "lw": 1.2, "zorder": 0.4, "marker": "None"}
    for k, wall in enumerate(trajectory.case.wall):
        motion = motion_of(wall.motion, middle(wall))
        pose = poses_at([motion], trajectory.time[frame])
        turn, shift = rotation_matrix(pose.orientation[0]), pose.position[0]
        if wall.piston is not None:
            if "wall_position" not in trajectory.other_fields:
                continue
            shift = trajectory.wall_position[frame, k] - turn @ motion.centre
        if wall.type == "plane":
            normal = turn @ np.array(wall.normal) / np.linalg.norm(wall.normal)
            n, point = normal[shown], (turn @ np.array(wall.point) + shift)[shown]
            if n @ n > 1.0 - 1e-9:
                foot = middle_of_scene + ((point - middle_of_scene) @ n) * n
                axes.axline(foot, foot + 1e-3 * np.array([-n[1], n[0]]), **style)
            elif n @ n > 1e-9:
                leaning.append(wall.name)
        elif wall.type == "box" and np.allclose(turn, np.eye(3), atol=1e-9):
            ends = (np.array([wall.lower, wall.upper]) + shift)[:, shown]
            for across, side in product((0, 1), (0, 1)):
                if f"{'-+'[side]}{'xyz'[shown[across]]}" not in wall.open:
                    line = ends.copy()
                    line[:, across] = ends[side, across]
                    axes.plot(*line.T, **style)
        else:
            _draw_outline(axes, trajectory, wall, turn, shift, shown)
    return f"; not edge on: {', '.join(leaning)}" if leaning else ""


def _draw_outline(
    axes: Axes, trajectory: Trajectory, wall: Any, turn: Floats, shift: Floats, shown: list[int]
) -> None:
    """Outline and edges of a wall, front and back; nothing without its file of triangles.

    Rims of openings are pale: nothing closes them.
    """
    try:
        mesh = surface_of_wall(trajectory.case.source.files, wall, 1.0).moved(turn, shift)
    except (OSError, ValueError):
        return
    placed = mesh._replace(vertices=mesh.vertices @ view_along(*shown).T)
    normal = _normals(placed)
    is_front = normal[:, 2] < 0.0
    sides = [_sharp_edges(placed, normal, faces) for faces in (is_front, ~is_front)]
    ends, beside = (np.concatenate(parts) for parts in zip(*sides, strict=True))
    colours = np.where(beside[:, 0] == beside[:, 1], _RIM, INK).tolist()
    lines = {"colors": colours, "linewidths": 0.8, "capstyle": "round", "zorder": 0.4}
    axes.add_collection(LineCollection(list(placed.vertices[ends][:, :, :2]), **lines))
    axes.update_datalim(placed.vertices[:, :2])
