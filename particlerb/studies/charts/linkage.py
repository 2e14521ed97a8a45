"""A linkage at some instants: its bodies, its joints, the rings of gimbals and wheels."""

from collections.abc import Iterator
from typing import Any, Final, TypeAlias

import numpy as np
from matplotlib.axes import Axes

from particlerb.export.surfaces import SurfaceMesh
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.state import axes_across, rotation_matrix
from particlerb.record.trajectory import Trajectory
from particlerb.rotors.rotor_class import ASYMMETRIC
from particlerb.studies.charts.bodies import shapes_of, side_axes
from particlerb.studies.charts.solids import ANGLED, draw_solids, placed, view_along, view_at_angle
from particlerb.studies.charts.style import COLOURS, INK, finish_view

_NO_POINTS: Final = np.zeros((0, 3))
_MAX_ALIGNED_SINE: Final = 0.05  # of the angle of axes that make no plane
_WORLD: Final = -1  # in the place of a body
_MIN_DEPTH_RATIO: Final = 0.4  # depth over width of what is seen at an angle

_End: TypeAlias = tuple[int, int, Floats]  # body, which of its points, place in the first frame


def mechanism_of(trajectory: Trajectory, body: int, most: int) -> list[int]:
    """Bodies that joints connect with a body, itself among them; where there are more, some."""
    pairs = [{a, b} for *_, a, b in _joined(trajectory)]
    members, found = {body}, {body}
    while found and len(members) <= most:
        found = {b for pair in pairs if pair & members for b in pair if b != _WORLD} - members
        members |= found
    return sorted(members)


def draw_linkage(axes: Axes, trajectory: Trajectory, bodies: list[int]) -> None:
    """Bodies at some instants, the last in colour, with their joints and the paths of centres.

    A body that is only its moments is drawn as lines from its centre to its joints, or as the ring
    that its hinges make of it, any other as its solid, else as a box around its particles. What
    keeps a distance all the time is a line between its ends.
    """
    x = trajectory.read("position")[:, bodies]
    frames = np.unique(np.linspace(0, trajectory.n_frames - 1, 4).astype(int)).tolist()
    points, distances, hinged = _joint_points(trajectory, bodies)
    rings, shapes = _drawn_as(trajectory, bodies, points, hinged)
    q = trajectory.read("orientation")[frames][:, bodies]
    orientations = [[rotation_matrix(each) for each in row] for row in q]

    def points_at(local: Floats | list[Floats], k: int) -> list[Floats]:
        """Points of each body at an instant, world frame."""
        turns = zip(local, orientations[k], x[frames[k]], strict=True)
        return [body_points @ R.T + com for body_points, R, com in turns]

    corners = [
        points_at([m.vertices[np.unique(m.faces)] for m in shapes], k) for k in range(len(frames))
    ]
    circles = [points_at(rings, k) for k in range(len(frames))]
    hinges = [points_at(points, k) for k in range(len(frames))]
    fixed = [place[None] for ends in distances for b, _, place in ends if b == _WORLD]
    joined = [p for rows in (corners, circles, hinges) for row in rows for p in row]
    everywhere = np.concatenate([*joined, *fixed])
    view, names = _view(trajectory, everywhere)
    for path in np.moveaxis(x @ view.T, 1, 0):
        axes.plot(*path[:, :2].T, color=COLOURS[1], lw=0.9, alpha=0.7, zorder=1.0)
    for k in range(len(frames)):
        is_last = k == len(frames) - 1
        fill, edge = ("#a9cce3", INK) if is_last else (None, "#b8c0c8")
        solids = placed(shapes, view, q[k], x[frames[k]])
        draw_solids(axes, solids, fill, 2.0 + 0.1 * k, edge)
        line: dict[str, Any] = {
            "color": COLOURS[0] if is_last else "#9aa5b1",
            "zorder": 2.05 + 0.1 * k,
        }
        for circle in circles[k]:
            axes.plot(*(circle @ view.T).T[:2], lw=2.2 if is_last else 0.8, **line)
        for com, joints in zip(x[frames[k]] @ view.T, hinges[k], strict=True):
            for end in joints @ view.T:
                axes.plot(*zip(com[:2], end[:2], strict=True), lw=2.2 if is_last else 1.2, **line)
                axes.plot(*end[:2], "o", ms=4, mfc="white", **line)
        for ends in distances:
            places = [place if b == _WORLD else hinges[k][b][n] for b, n, place in ends]
            shown = np.array(places) @ view.T
            axes.plot(*shown.T[:2], "-o", ms=4, mfc="white", lw=2.2 if is_last else 1.2, **line)
    axes.update_datalim((everywhere @ view.T)[:, :2])
    times = ", ".join(f"{trajectory.time[frame]:.3g}" for frame in frames)
    title = f"t = {times} s (blue); orange: paths of centres"
    if len(bodies) < trajectory.n_bodies:
        title = f"one of the mechanisms, that of {trajectory.names[bodies[0]]}\n{title}"
    finish_view(axes, title, *names)


def _joined(trajectory: Trajectory) -> Iterator[tuple[dict[str, Any], int, int]]:
    """Joints as the case has them, each with its body and the other one, or _WORLD."""
    for joint in trajectory.parameter("case_resolved")["joint"]:
        first, second = (_numbers(trajectory, joint[key]) for key in ("body", "to"))
        if joint["chain"]:
            first, second = first[1:], first[:-1]
        for k, a in enumerate(first):
            yield joint, a, second[k % len(second)] if second else _WORLD


def _numbers(trajectory: Trajectory, names: list[str] | None) -> list[int]:
    """Bodies of names of bodies and of blocks, in their order."""
    return [
        b
        for name in names or []
        for b, body_name in enumerate(trajectory.names)
        if body_name == name or body_name.startswith(f"{name}[")
    ]


def _drawn_as(
    trajectory: Trajectory, bodies: list[int], points: list[Floats], hinged: list[list[Floats]]
) -> tuple[list[Floats], list[SurfaceMesh]]:
    """Ring of each body, without points for most, and solid, without faces where it is lines."""
    is_bar, solids = _without_shape(trajectory)[bodies], shapes_of(trajectory)
    rings = [
        _ring(trajectory, b, hinged[k], points[k]) if is_bar[k] else _NO_POINTS
        for k, b in enumerate(bodies)
    ]
    shapes = [
        solids[b]._replace(faces=solids[b].faces[:0])
        if is_bar[k] and (len(rings[k]) or np.abs(points[k]).max(initial=0.0) > 0.0)
        else solids[b]
        for k, b in enumerate(bodies)
    ]
    return rings, shapes


def _without_shape(trajectory: Trajectory) -> Bools:
    """Bodies of which only the moments of inertia are known."""
    is_shapeless = np.zeros(trajectory.n_bodies, dtype=bool)
    for body in trajectory.parameter("case_resolved")["body"]:
        if (body["shape"] or {}).get("type") == "moments":
            is_shapeless[_numbers(trajectory, [body["name"]])] = True
    return is_shapeless


def _joint_points(
    trajectory: Trajectory, bodies: list[int]
) -> tuple[list[Floats], list[list[_End]], list[list[Floats]]]:
    """Points of joints in each of some bodies, ends of distances, axes of hinges in each body.

    In the frame of the body, from its centre of mass.
    """
    row = {b: k for k, b in enumerate(bodies)} | {_WORLD: _WORLD}
    x, q = (trajectory.read(name, slice(0, 1))[0] for name in ("position", "orientation"))
    turns = [rotation_matrix(orientation) for orientation in q]
    points: list[list[Floats]] = [[] for _ in range(trajectory.n_bodies)]
    hinged: list[list[Floats]] = [[] for _ in points]
    distances: list[list[_End]] = []

    def placed(point: Any, b: int) -> Floats:
        """A point of a body as a case gives it, world frame; none: its centre."""
        local = point["body"] if isinstance(point, dict) else (0.0, 0.0, 0.0)
        return np.array(point if isinstance(point, list) else x[b] + turns[b] @ local)

    for joint, a, other in _joined(trajectory):
        if a not in row:
            continue
        at, at_to = joint["at"], joint["at_to"]
        has_own = at_to is not None or joint["type"] in ("distance", "gear")
        here = placed(at, a)
        ends = [(a, here)]
        if other != _WORLD:
            ends.append((other, placed(at_to, other) if has_own else here))
        elif isinstance(at_to, list):
            ends.append((_WORLD, np.array(at_to)))
        for b, place in ends:
            if b != _WORLD:
                points[b].append(turns[b].T @ (place - x[b]))
                if joint["type"] == "hinge":
                    hinged[b].append(turns[b].T @ _axis_of(joint, turns[a]))
        if joint["type"] == "distance" and not (joint["breaks_at"] or joint["during"]):
            distances.append([(row[b], len(points[b]) - 1, place) for b, place in ends])
    found = [np.array(points[b]).reshape(-1, 3) for b in bodies]
    return found, distances, [hinged[b] for b in bodies]


def _axis_of(joint: dict[str, Any], turn: Floats) -> Floats:
    """Unit axis of a joint in the world, given there or in the frame of its body."""
    axis = joint["axis"]
    axis = turn @ axis["body"] if isinstance(axis, dict) else np.array(axis)
    return np.asarray(axis / np.linalg.norm(axis))


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


def _view(trajectory: Trajectory, points: Floats) -> tuple[Floats, tuple[str, str]]:
    """Rows to the right, upwards and away, and names of the axes: along an axis, or at an angle."""
    across, up = side_axes(trajectory, points)
    away = 3 - across - up
    extent = np.ptp(points, axis=0)
    if extent[away] < _MIN_DEPTH_RATIO * extent.max():
        return view_along(across, up), (f"{'xyz'[across]} [m]", f"{'xyz'[up]} [m]")
    return view_at_angle(up), (ANGLED, f"upwards: {'xyz'[up]} [m]")
