"""A linkage at some instants: its bodies, its joints, the rings of gimbals and wheels."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes

from particlerb.export.surfaces import SurfaceMesh
from particlerb.forces.links import WORLD
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.state import axes_across, rotation_matrix
from particlerb.model.system import System
from particlerb.plan.joints import SystemJoints, joints_of
from particlerb.record.trajectory import Trajectory
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.studies.charts import solids
from particlerb.studies.charts.bodies import FEW, shapes_of, side_axes
from particlerb.studies.charts.solids import ANGLED, view_along, view_at_angle
from particlerb.studies.charts.style import COLOURS, INK, finish_view, tints

_NO_POINTS: Final = np.zeros((0, 3))
_MAX_ALIGNED_SINE: Final = 0.05  # of the angle of axes that make no plane
_MIN_DEPTH_RATIO: Final = 0.4  # depth over width of what is seen at an angle

_End: TypeAlias = tuple[int, int, Floats]  # body, which of its points, place in the first frame


class Linkage(NamedTuple):
    """Bodies of a trajectory and their joints, as the case has them."""

    system: System
    setup: SystemJoints


def jointed(trajectory: Trajectory) -> Linkage | None:
    """Joints of a trajectory; None where it has none, or its bodies cannot be made again."""
    system = solids.system_of(trajectory)
    setup = None if system is None else joints_of(system)
    return None if system is None or setup is None else Linkage(system, setup)


def mechanism_of(scene: Linkage, body: int) -> list[int]:
    """Bodies that joints connect with a body, itself among them; where there are more, some."""
    pairs = np.stack([scene.setup.body_a, scene.setup.body_b], axis=1)
    members, n_before = np.array([body]), 0
    while n_before < members.size <= FEW:
        n_before = members.size
        joined = pairs[np.isin(pairs, members).any(axis=1)]
        members = np.union1d(members, joined[joined != WORLD])
    return [int(b) for b in members]


def draw_linkage(
    axes: Axes,
    trajectory: Trajectory,
    scene: Linkage,
    bodies: list[int],
    colours: Sequence[str] = (),
) -> None:
    """Bodies at some instants, the last in colour, with their joints and the paths of centres.

    Each body, and its path, has its own colour where these are given.

    A body that is only its moments is drawn as lines from its centre to its joints, or as the ring
    that its hinges make of it, any other as its solid, else as a box around its particles, with
    its joints; what slides along a solid is no point of it. What keeps a distance all the time is
    a line between its ends.
    """
    x = trajectory.read("position")[:, bodies]
    frames = np.unique(np.linspace(0, trajectory.n_frames - 1, 4).astype(int)).tolist()
    points, distances, hinged = _joint_points(scene, bodies)
    rings, shapes = _drawn_as(trajectory, scene, bodies, points, hinged)
    q = trajectory.read("orientation")[frames][:, bodies]
    orientations = [[rotation_matrix(each) for each in row] for row in q]

    def points_at(local: Floats | list[Floats], k: int) -> list[Floats]:
        """Points of each body at an instant, world frame."""
        turns = zip(local, orientations[k], x[frames[k]], strict=True)
        return [body_points @ R.T + com for body_points, R, com in turns]

    vertices = [mesh.vertices[np.unique(mesh.faces)] for mesh in shapes]
    corners = [points_at(vertices, k) for k in range(len(frames))]
    circles = [points_at(rings, k) for k in range(len(frames))]
    hinges = [points_at(points, k) for k in range(len(frames))]
    fixed = [place[None] for ends in distances for b, _, place in ends if b == WORLD]
    joined = [p for rows in (corners, circles, hinges) for row in rows for p in row]
    everywhere = np.concatenate([*joined, *fixed])
    view, names, shown = _view(trajectory, everywhere)
    if shown:
        solids.draw_walls(axes, trajectory, frames[-1], shown)
    own, along = (colours or [colour] * len(bodies) for colour in COLOURS[:2])
    for path, colour in zip(np.moveaxis(x @ view.T, 1, 0), along, strict=True):
        axes.plot(*path[:, :2].T, color=colour, lw=0.9, alpha=0.7, zorder=1.0)
    for k in range(len(frames)):
        is_last = k == len(frames) - 1
        fill, edge = (tints(own), INK) if is_last else (None, "#b8c0c8")
        placed = solids.placed(shapes, view, q[k], x[frames[k]])
        solids.draw_solids(axes, placed, fill, 2.0 + 0.1 * k, edge)
        zorder = 2.05 + 0.1 * k
        for b, (com, mesh) in enumerate(zip(x[frames[k]] @ view.T, shapes, strict=True)):
            line: dict[str, Any] = {"color": own[b] if is_last else "#9aa5b1", "zorder": zorder}
            axes.plot(*(circles[k][b] @ view.T).T[:2], lw=2.2 if is_last else 0.8, **line)
            for end in hinges[k][b] @ view.T:
                bar = np.array([end if len(mesh.faces) else com, end])[:, :2]
                axes.plot(*bar.T, lw=2.2 if is_last else 1.2, **line)
                axes.plot(*end[:2], "o", ms=4, mfc="white", **line)
        line["color"] = (INK if colours else COLOURS[0]) if is_last else line["color"]
        _draw_distances(axes, distances, hinges[k], view, {"lw": 2.2 if is_last else 1.2, **line})
    axes.update_datalim((everywhere @ view.T)[:, :2])
    words = "in colour); thin" if colours else "blue); orange"
    finish_view(axes, _title(trajectory, bodies, frames, words), *names)


def _draw_distances(
    axes: Axes,
    distances: list[list[_End]],
    hinges: list[Floats],
    view: Floats,
    line: dict[str, Any],
) -> None:
    """Lines between the ends of what keeps a distance."""
    for ends in distances:
        places = [place if b == WORLD else hinges[b][n] for b, n, place in ends]
        axes.plot(*(np.array(places) @ view.T).T[:2], "-o", ms=4, mfc="white", **line)


def _title(trajectory: Trajectory, bodies: list[int], frames: list[int], words: str) -> str:
    """Which instants are drawn, and what is thin."""
    times = ", ".join(f"{trajectory.time[frame]:.3g}" for frame in frames)
    title = f"t = {times} s ({words}: paths of centres"
    if len(bodies) < trajectory.n_bodies:
        title = f"one of the mechanisms, that of {trajectory.names[bodies[0]]}\n{title}"
    return title


def _drawn_as(
    trajectory: Trajectory,
    scene: Linkage,
    bodies: list[int],
    points: list[Floats],
    hinged: list[list[Floats]],
) -> tuple[list[Floats], list[SurfaceMesh]]:
    """Ring of each body, without points for most, and solid, without faces where it is lines."""
    is_bar, shapes = _without_shape(scene.system)[bodies], shapes_of(trajectory)
    rings = [
        _ring(trajectory, b, hinged[k], points[k]) if is_bar[k] else _NO_POINTS
        for k, b in enumerate(bodies)
    ]
    drawn = [
        shapes[b]._replace(faces=shapes[b].faces[:0])
        if is_bar[k] and (len(rings[k]) or np.abs(points[k]).max(initial=0.0) > 0.0)
        else shapes[b]
        for k, b in enumerate(bodies)
    ]
    return rings, drawn


def _without_shape(system: System) -> Bools:
    """Bodies of which only the moments of inertia are known."""
    shapes = [body.shape for body in system.body]
    is_moments = [shape is not None and shape.type == "moments" for shape in shapes]
    return np.array(is_moments)[system.block]


def _joint_points(
    scene: Linkage, bodies: list[int]
) -> tuple[list[Floats], list[list[_End]], list[list[Floats]]]:
    """Points of joints in each of some bodies, ends of distances, axes of hinges in each body.

    In the frame of the body, from its centre of mass; without those of what slides along solids.
    """
    system, setup = scene
    is_bar = _without_shape(system)
    row = {b: k for k, b in enumerate(bodies)} | {WORLD: WORLD}
    points: dict[int, list[Floats]] = {b: [] for b in row}
    hinged: dict[int, list[Floats]] = {b: [] for b in row}
    distances: list[list[_End]] = []
    for j, number in enumerate(setup.record.tolist()):
        joint, tied, ends = system.joint[number], (int(setup.body_a[j]), int(setup.body_b[j])), []
        if not row.keys() >= {*tied}:
            continue
        for k, b in enumerate(tied):
            if joint.type == "slider" and b == tied[1] != WORLD and not is_bar[b]:
                continue
            frame = np.eye(3) if b == WORLD else rotation_matrix(system.bodies.rotor_frame[:, b])
            place, axis = setup.places[j, [k, k + 2]] @ frame.T
            points[b].append(place)
            if joint.type == "hinge":
                hinged[b].append(axis)
            ends.append((row[b], len(points[b]) - 1, place))
        if joint.type == "distance" and not (joint.breaks_at or joint.during):
            distances.append(ends)
    found = [np.array(points[b]).reshape(-1, 3) for b in bodies]
    return found, distances, [hinged[b] for b in bodies]


def _ring(trajectory: Trajectory, body: int, axes: list[Floats], points: Floats) -> Floats:
    """Circle that stands for a body of which only moments are known, (n, 3) in its frame.

    Through its hinges where two of them meet in its centre, as a gimbal; about its hinge where it
    has one, with two equal moments, as a wheel. Its radius is that of a ring of the largest moment.
    """
    if not 1 <= len(axes) <= 2 or len(points) != len(axes):
        return _NO_POINTS
    normal, size = axes[0], np.abs(points).max(initial=0.0)
    if len(axes) == 2:
        normal = np.cross(axes[0], axes[1])
        if size > 0.0 or np.linalg.norm(normal) < _MAX_ALIGNED_SINE:
            return _NO_POINTS
    elif int(trajectory.bodies.rotor_class[body]) == ASYMMETRIC:
        return _NO_POINTS
    radius = np.sqrt(trajectory.bodies.inertia[:, body].max() / trajectory.mass[body])
    first, second = axes_across(normal / np.linalg.norm(normal))
    angle = np.linspace(0.0, 2.0 * np.pi, 49)[:, None]
    return np.asarray(radius * (np.cos(angle) * first + np.sin(angle) * second))


def _view(trajectory: Trajectory, points: Floats) -> tuple[Floats, tuple[str, str], list[int]]:
    """Rows to the right, upwards and away, names of the axes, and these: none at an angle."""
    across, up = shown = side_axes(trajectory, points)
    away = 3 - across - up
    extent = np.ptp(points, axis=0)
    if extent[away] < _MIN_DEPTH_RATIO * extent.max():
        return view_along(across, up), (f"{'xyz'[across]} [m]", f"{'xyz'[up]} [m]"), shown
    return view_at_angle(up), (ANGLED, f"upwards: {'xyz'[up]} [m]"), []
