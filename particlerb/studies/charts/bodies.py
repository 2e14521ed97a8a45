"""Bodies as a picture shows them: paths, a side view, a linkage at instants, attitudes of one."""

from itertools import product
from typing import Any, Final, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d import Axes3D

from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.state import rotate, rotation_matrix
from particlerb.record import schema
from particlerb.record.trajectory import Trajectory
from particlerb.studies.charts.style import COLOURS, INK, finish_panel, line_style

_ATTITUDES: Final = 7
_APART: Final = 1.25  # of attitudes, in diagonals of the body
_FACES: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
_CORNERS: Final = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), -1).reshape(8, 3)
BODY: Final = "#eceff2"
_FLAT: Final = 0.05  # height over width of what is seen from above
_WORLD: Final = -1  # in the place of a body
_DEEP: Final = 0.4  # depth over width of what is seen at an angle
_ANGLES: Final = np.radians((35.0, 22.0))  # of such a view: about the vertical, and from above
_STILL: Final = 1e-3  # of the width, which bodies at rest would not move in the whole time
FEW: Final = 12  # bodies at most whose paths are drawn
KEYED: Final = 6  # bodies at most that have a colour each

_End: TypeAlias = tuple[int, int, Floats]  # body, which of its points, place in the first frame


def upright(trajectory: Trajectory) -> int:
    """Axis along which gravity is largest; z without gravity."""
    gravity = trajectory.parameter("case_resolved")["gravity"]
    g = np.abs(gravity["acceleration"]) if gravity else np.zeros(3)
    return int(np.argmax(g)) if g.any() else 2


def side_axes(trajectory: Trajectory, x: Floats) -> list[int]:
    """Axes of a view of points x: that along which they reach farthest, and upwards.

    What lies in a plane is seen from above.
    """
    up = upright(trajectory)
    extent = np.ptp(x, axis=0)
    if extent[up] < _FLAT * extent.max():
        return sorted({0, 1, 2} - {up})
    return [max({0, 1, 2} - {up}, key=lambda c: float(extent[c])), up]


def draw_particles(axes: Axes, centres: Floats, radii: Floats, colours: object = BODY) -> None:
    """Outlines of particles, in the units of the axes."""
    width = 2.0 * radii
    circles = EllipseCollection(
        width, width, np.zeros_like(width), units="xy", offsets=centres,
        offset_transform=axes.transData, facecolor=colours, edgecolor="#8f99a3", linewidth=0.3,
    )  # fmt: skip
    axes.add_collection(circles)
    low, high = (centres - radii[:, None]).min(axis=0), (centres + radii[:, None]).max(axis=0)
    axes.update_datalim([low, high])


def draw_side(axes: Axes, trajectory: Trajectory, frame: int) -> None:
    """Particles in a frame, those in front last; the darker, the faster their body."""
    centres = trajectory.particle_positions(frame)
    body, particle = trajectory.constituents
    across, up = shown = side_axes(trajectory, centres)
    depth = centres[:, 3 - across - up]
    order = np.argsort(depth if (across, up) != (0, 2) else -depth)
    momenta = trajectory.read("linear_momentum", slice(frame, frame + 1))[0]
    speed = np.linalg.norm(momenta, axis=1) / trajectory.mass
    reach = np.ptp(centres[:, shown], axis=0).max() or 1.0
    is_still = speed.max() * np.ptp(trajectory.time) <= _STILL * reach
    share = (speed / (1.0 if is_still else speed.max()))[body][order, None]
    colours = 1.0 - share * (1.0 - np.array(to_rgb(COLOURS[0]))) - 0.08 * (1.0 - share)
    radii = trajectory.particles.radius[particle][order]
    draw_particles(axes, centres[order][:, shown], np.maximum(radii, 0.003 * reach), colours)
    _draw_walls(axes, trajectory, frame, shown)
    if trajectory.n_bodies <= FEW:
        _draw_outlines(axes, trajectory, frame, (across, up))
        for path in np.moveaxis(trajectory.read("position")[: frame + 1], 1, 0):
            axes.plot(*path[:, shown].T, color=COLOURS[1], lw=0.9, alpha=0.7)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    words = "at rest" if is_still else f"blue: up to {speed.max():.3g} m/s"
    title = f"t = {trajectory.time[frame]:.4g} s; {words}"
    finish_panel(axes, title, xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    axes.grid(visible=False)


def draw_paths(axes: Axes3D, trajectory: Trajectory, shown: list[int], body: int) -> None:
    """Trajectories of some bodies: of a few in the colours of their lines, else one in another."""
    position = trajectory.read("position", bodies=shown)
    is_keyed = trajectory.n_bodies <= KEYED
    for k, b in enumerate(shown):
        x, y, z = position[:, k].T
        style = line_style(b) if is_keyed else {"color": COLOURS[b == body], "ls": "-"}
        axes.plot(x, y, z, lw=1.2, alpha=1.0 if is_keyed or b == body else 0.6, **style)
        axes.plot(x[-1:], y[-1:], z[-1:], "o", ms=3.5, color=style["color"])
    axes.set_title("trajectories" if len(shown) > 1 else "trajectory", fontsize=10, color=INK)
    set_equal_scale(axes, position.reshape(-1, 3))


def draw_linkage(axes: Axes, trajectory: Trajectory) -> None:
    """All bodies at some instants, the last in colour, with their joints and the paths of centres.

    A body that is only its moments is drawn as lines from its centre to its joints, any other as a
    box around its particles. What keeps a distance all the time is a line between its ends.
    """
    x = trajectory.read("position")
    frames = np.unique(np.linspace(0, trajectory.n_frames - 1, 4).astype(int)).tolist()
    edges = trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))
    points, distances = _joint_points(trajectory)
    is_bar = _without_shape(trajectory)
    edges[is_bar & np.array([np.abs(own).max(initial=0.0) > 0.0 for own in points])] = 0.0
    boxes = _CORNERS * edges[:, None]
    attitudes = [
        [rotation_matrix(q) for q in row] for row in trajectory.read("orientation")[frames]
    ]

    def placed(local: Floats | list[Floats], k: int) -> list[Floats]:
        """Points of each body at an instant, world frame."""
        turns = zip(local, attitudes[k], x[frames[k]], strict=True)
        return [own @ R.T + com for own, R, com in turns]

    corners = np.stack([placed(boxes, k) for k in range(len(frames))])
    hinges = [placed(points, k) for k in range(len(frames))]
    fixed = [place[None] for ends in distances for b, _, place in ends if b == _WORLD]
    joined = [p for row in hinges for p in row]
    everywhere = np.concatenate([corners.reshape(-1, 3), *joined, *fixed])
    view, names = _view(trajectory, everywhere)
    for path in np.moveaxis(x @ view.T, 1, 0):
        axes.plot(*path[:, :2].T, color=COLOURS[1], lw=0.9, alpha=0.7, zorder=1.0)
    for k in range(len(frames)):
        is_last = k == len(frames) - 1
        _draw_boxes(axes, corners[k] @ view.T, is_last, 2.0 + 0.1 * k)
        line: dict[str, Any] = {
            "color": COLOURS[0] if is_last else "#9aa5b1",
            "zorder": 2.05 + 0.1 * k,
        }
        for com, own in zip(x[frames[k]] @ view.T, hinges[k], strict=True):
            for end in own @ view.T:
                axes.plot(*zip(com[:2], end[:2], strict=True), lw=2.2 if is_last else 1.2, **line)
                axes.plot(*end[:2], "o", ms=4, mfc="white", **line)
        for ends in distances:
            places = [place if b == _WORLD else hinges[k][b][n] for b, n, place in ends]
            shown = np.array(places) @ view.T
            axes.plot(*shown.T[:2], "-o", ms=4, mfc="white", lw=2.2 if is_last else 1.2, **line)
    axes.update_datalim((everywhere @ view.T)[:, :2])
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    times = ", ".join(f"{trajectory.time[frame]:.3g}" for frame in frames)
    title = f"t = {times} s (blue); orange: paths of centres"
    finish_panel(axes, title, xlabel=names[0], ylabel=names[1])
    axes.grid(visible=False)


def _draw_boxes(axes: Axes, corners: Floats, is_last: bool, height: float) -> None:
    """Faces of boxes with these corners in the view, (n, 8, 3); those in front last."""
    faces = [own[list(face)] for own in corners if np.ptp(own) > 0.0 for face in _FACES]
    faces.sort(key=lambda face: -float(face[:, 2].mean()))
    tint, opacity = ("#a9cce3", 0.75) if is_last else (BODY, 0.35)
    axes.add_collection(PolyCollection(
        [face[:, :2] for face in faces], facecolors=tint, edgecolors=INK, linewidths=0.7,
        alpha=opacity, zorder=height,
    ))  # fmt: skip


def _draw_walls(axes: Axes, trajectory: Trajectory, frame: int, shown: list[int]) -> None:
    """Planes and faces of boxes that are seen edge on; what moves, only where that was recorded."""
    middle = trajectory.read("position", slice(frame, frame + 1))[0].mean(axis=0)[shown]
    style: dict[str, Any] = {"color": INK, "lw": 1.2, "zorder": 0.4}
    for k, wall in enumerate(trajectory.parameter("case_resolved")["wall"]):
        moved = np.zeros(2)
        if wall["piston"] and "wall_position" in trajectory.other_fields:
            moved = np.diff(trajectory.wall_position[[0, frame], k], axis=0)[0, shown]
        elif wall["piston"] or wall["motion"]:
            continue
        if wall["type"] == "plane":
            normal = np.array(wall["normal"]) / np.linalg.norm(wall["normal"])
            n, point = normal[shown], np.array(wall["point"])[shown] + moved
            if n @ n > 1.0 - 1e-9:
                foot = middle + ((point - middle) @ n) * n
                axes.axline(foot, foot + 1e-3 * np.array([-n[1], n[0]]), **style)
        elif wall["type"] == "box":
            ends = np.array([wall["lower"], wall["upper"]])[:, shown] + moved
            for across, side in product((0, 1), (0, 1)):
                if f"{'-+'[side]}{'xyz'[shown[across]]}" not in wall["open"]:
                    line = ends.copy()
                    line[:, across] = ends[side, across]
                    axes.plot(*line.T, **style)


def _draw_outlines(axes: Axes, trajectory: Trajectory, frame: int, shown: tuple[int, int]) -> None:
    """Boxes around the particles of each body that has several, behind them."""
    edges = trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))
    x, q = (
        trajectory.read(name, slice(frame, frame + 1))[0] for name in ("position", "orientation")
    )
    several = np.flatnonzero(np.bincount(trajectory.constituents[0]) > 1)
    view = np.eye(3)[[*shown, 3 - sum(shown)]]
    turned = [_CORNERS * edges[b] @ rotation_matrix(q[b]).T + x[b] for b in several]
    if turned:
        _draw_boxes(axes, np.stack(turned) @ view.T, False, 0.5)


def _numbers(trajectory: Trajectory, names: list[str] | None) -> list[int]:
    """Bodies of names of bodies and of blocks, in their order."""
    return [
        b
        for name in names or []
        for b, own in enumerate(trajectory.names)
        if own == name or own.startswith(f"{name}[")
    ]


def _without_shape(trajectory: Trajectory) -> Bools:
    """Bodies of which only the moments of inertia are known."""
    found = np.zeros(trajectory.n_bodies, dtype=bool)
    for body in trajectory.parameter("case_resolved")["body"]:
        if (body["shape"] or {}).get("type") == "moments":
            found[_numbers(trajectory, [body["name"]])] = True
    return found


def _joint_points(trajectory: Trajectory) -> tuple[list[Floats], list[list[_End]]]:
    """Points of joints in each body, its frame from its centre of mass, and ends of distances."""
    x, q = (trajectory.read(name, slice(0, 1))[0] for name in ("position", "orientation"))
    turns = [rotation_matrix(own) for own in q]
    found: list[list[Floats]] = [[] for _ in range(trajectory.n_bodies)]
    distances: list[list[_End]] = []

    def placed(point: Any, b: int) -> Floats:
        """A point of a body as a case gives it, world frame; none: its centre."""
        local = point["body"] if isinstance(point, dict) else (0.0, 0.0, 0.0)
        return np.array(point if isinstance(point, list) else x[b] + turns[b] @ local)

    for joint in trajectory.parameter("case_resolved")["joint"]:
        first, second = (_numbers(trajectory, joint[key]) for key in ("body", "to"))
        if joint["chain"]:
            first, second = first[1:], first[:-1]
        at, at_to = joint["at"], joint["at_to"]
        has_own = at_to is not None or joint["type"] in ("distance", "gear")
        for k, a in enumerate(first):
            here = placed(at, a)
            ends = [(a, here)]
            if second:
                b = second[k % len(second)]
                ends.append((b, placed(at_to, b) if has_own else here))
            elif isinstance(at_to, list):
                ends.append((_WORLD, np.array(at_to)))
            for b, place in ends:
                if b != _WORLD:
                    found[b].append(turns[b].T @ (place - x[b]))
            if joint["type"] == "distance" and not (joint["breaks_at"] or joint["during"]):
                distances.append([(b, len(found[b]) - 1, place) for b, place in ends])
    return [np.array(own).reshape(-1, 3) for own in found], distances


def _view(trajectory: Trajectory, points: Floats) -> tuple[Floats, tuple[str, str]]:
    """Rows to the right, upwards and away, and names of the axes: along an axis, or at an angle."""
    across, up = side_axes(trajectory, points)
    away = 3 - across - up
    extent = np.ptp(points, axis=0)
    axis = np.eye(3)
    if extent[away] < _DEEP * extent.max():
        depth = np.cross(axis[up], axis[across])  # so that right, up and towards us turn as x, y, z
        return np.stack([axis[across], axis[up], depth]), (
            f"{'xyz'[across]} [m]",
            f"{'xyz'[up]} [m]",
        )
    (cos, cos_up), (sin, sin_up) = np.cos(_ANGLES), np.sin(_ANGLES)
    first, second = axis[(up + 1) % 3], axis[(up + 2) % 3]
    right, level = cos * first + sin * second, cos * second - sin * first
    rows = np.stack([right, cos_up * axis[up] + sin_up * level, cos_up * level - sin_up * axis[up]])
    return rows, ("[m], seen from above at an angle", f"upwards: {'xyz'[up]} [m]")


def draw_trace(axes: Axes3D, trajectory: Trajectory, body: int, axis: int) -> None:
    """Path of the end of an axis of a body on the unit sphere."""
    points = direction(trajectory, body, axis)
    axes.plot(*points.T, lw=0.9, color=COLOURS[1])
    axes.plot(*points[-1:].T, "o", ms=3.5, color=COLOURS[1])
    title = f"path of the {'xyz'[axis]} axis of {trajectory.names[body]} on the unit sphere"
    axes.set_title(title, fontsize=10, color=INK)
    set_equal_scale(axes, points, "")


def set_equal_scale(axes: Axes3D, points: Floats, unit: str = " [m]") -> None:
    """Give all three axes the same scale, and none less than a third of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, (high - low).max() / 3.0) / 2.0
    half = np.where(half > 0.0, 1.05 * half, 1.0)
    middle = (low + high) / 2.0
    x, y, z = zip(middle - half, middle + half, strict=True)
    power = 3 * int(np.log10(max(np.abs([x, y, z]).max(), 1e-300)) // 3)
    power = power if abs(power) > 3 and unit else 0
    unit = unit.replace("[", f"[1e{power} ") if power else unit
    labels = {f"{letter}label": f"{letter}{unit}" for letter in "xyz"}
    axes.set(xlim=x, ylim=y, zlim=z, **labels)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.6g}")
    axes.set_box_aspect(half / half.max())
    axes.locator_params(nbins=4)


def direction(trajectory: Trajectory, body: int, axis: int) -> Floats:
    """An axis of a body in the world, (T, 3)."""
    q = trajectory.read("orientation", bodies=body).T
    return rotate(q, np.tile(np.eye(3)[:, axis, None], q.shape[1])).T


def spun_axis(trajectory: Trajectory, body: int) -> int:
    """Axis of the body frame about which a body turns most at first, or on the whole."""
    rates = np.abs(trajectory.omega_body(body))
    return int(np.argmax(rates[0] if rates[0].any() else rates.mean(axis=0)))


def draw_attitudes(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """A body at some instants, seen with its angular momentum upwards.

    Where it turns over, the instants lie around that, else within its first turn.
    """
    momentum = trajectory.read("angular_momentum", bodies=body)[0]
    up = momentum / np.linalg.norm(momentum)
    spun = spun_axis(trajectory, body)
    height = direction(trajectory, body, spun) @ up
    frames = _instants(trajectory, body, height * np.sign(height[0]))
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    view = np.stack([side / np.linalg.norm(side), np.cross(up, side / np.linalg.norm(side)), up])
    tilt = np.radians(25.0)  # looked at from above
    view = (
        np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        @ view
    )
    edges = trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))[body]
    corners = _CORNERS * edges / np.linalg.norm(edges)
    arrow = np.outer([0.0, 0.5 * edges[spun] / np.linalg.norm(edges) + 0.2], np.eye(3)[spun])
    attitudes = trajectory.read("orientation", bodies=body)[frames]
    for k, q in enumerate(attitudes):
        to_picture = (view @ rotation_matrix(q)).T
        turned, tip = corners @ to_picture, arrow @ to_picture
        by_depth = sorted(_FACES, key=lambda face: -float(turned[list(face), 1].mean()))
        shapes = [turned[list(face)][:, [0, 2]] + [_APART * k, 0.0] for face in by_depth]
        faces = PolyCollection(shapes, facecolors=BODY, edgecolors=INK, linewidths=0.9)
        faces.set_zorder(2.0)
        axes.add_collection(faces)
        in_front = 3.0 if tip[1, 1] < 0.0 else 1.0
        x, z = tip[:, 0] + _APART * k, tip[:, 2]
        axes.plot(x, z, color=COLOURS[1], lw=2.0, zorder=in_front)
        axes.plot(x[1], z[1], "o", color=COLOURS[1], ms=6, zorder=in_front)
        axes.text(_APART * k, -0.85, f"{trajectory.time[frames[k]]:.4g} s", ha="center", color=INK)
    axes.set(xlim=(-0.7, _APART * (_ATTITUDES - 1) + 0.7), ylim=(-0.95, 0.75), aspect="equal")
    axes.set_axis_off()
    name = f"box around {trajectory.names[body]}"
    title = f"{name}; its angular momentum is upwards, its {'xyz'[spun]} axis orange"
    axes.set_title(title, fontsize=10, color=INK)


def _instants(trajectory: Trajectory, body: int, height: Floats) -> list[int]:
    """Frames at equal times: around the first instant at which a body lies down, or in a turn."""
    time = trajectory.time
    if height.min() < -0.5:
        over = int(np.argmax(height < 0.0))
        start = int(np.flatnonzero(height[:over] > 0.97)[-1]) if (height[:over] > 0.97).any() else 0
        stop = over + int(np.argmax(np.append(height[over:-1] < -0.97, True)))
    else:
        rate = float(np.linalg.norm(trajectory.omega_body(body)[0]))
        start, stop = 0, int(np.searchsorted(time, time[0] + 2.0 * np.pi / rate))
    times = np.linspace(time[start], time[min(stop, time.size - 1)], _ATTITUDES)
    return [int(np.argmin(np.abs(time - t))) for t in times]
