"""Bodies as a picture shows them: paths through space, a side view, and attitudes of one."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, PolyCollection
from matplotlib.colors import to_rgb
from mpl_toolkits.mplot3d import Axes3D

from particlerb.maths.vec3 import Floats
from particlerb.model.state import rotate, rotation_matrix
from particlerb.record import schema
from particlerb.record.trajectory import Trajectory
from particlerb.studies.charts.style import COLOURS, INK, finish_panel

_ATTITUDES: Final = 7
_APART: Final = 1.25  # of attitudes, in diagonals of the body
_FACES: Final = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
_CORNERS: Final = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3, indexing="ij"), -1).reshape(8, 3)
BODY: Final = "#eceff2"


_FLAT: Final = 0.05  # height over width of what is seen from above


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
    share = (speed / (speed.max() or 1.0))[body][order, None]
    colours = 1.0 - share * (1.0 - np.array(to_rgb(COLOURS[0]))) - 0.08 * (1.0 - share)
    radii = trajectory.particles.radius[particle][order]
    reach = np.ptp(centres[:, shown], axis=0).max() or 1.0
    draw_particles(axes, centres[order][:, shown], np.maximum(radii, 0.003 * reach), colours)
    axes.set_aspect("equal")
    axes.autoscale_view()
    title = f"t = {trajectory.time[frame]:.4g} s; blue: up to {speed.max():.3g} m/s"
    finish_panel(axes, title, xlabel=f"{'xyz'[across]} [m]", ylabel=f"{'xyz'[up]} [m]")
    axes.grid(visible=False)


def draw_paths(axes: Axes3D, trajectory: Trajectory, shown: list[int], body: int) -> None:
    """Trajectories of some bodies, one of them in another colour."""
    position = trajectory.read("position", bodies=shown)
    for k, b in enumerate(shown):
        x, y, z = position[:, k].T
        colour, opacity = (COLOURS[1], 1.0) if b == body else (COLOURS[0], 0.6)
        axes.plot(x, y, z, lw=1.2, color=colour, alpha=opacity)
        axes.plot(x[-1:], y[-1:], z[-1:], "o", ms=3.5, color=colour)
    axes.set_title("trajectories" if len(shown) > 1 else "trajectory", fontsize=10, color=INK)
    set_equal_scale(axes, position.reshape(-1, 3))


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
    labels = {f"{letter}label": f"{letter}{unit}" for letter in "xyz"}
    axes.set(xlim=x, ylim=y, zlim=z, **labels)
    axes.set_box_aspect(half / half.max())
    axes.locator_params(nbins=4)


def direction(trajectory: Trajectory, body: int, axis: int) -> Floats:
    """An axis of a body in the world, (T, 3)."""
    q = trajectory.read("orientation", bodies=body).T
    return rotate(q, np.tile(np.eye(3)[:, axis, None], q.shape[1])).T


def draw_attitudes(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """A body at some instants, seen with its angular momentum upwards.

    Where it turns over, the instants lie around that, else within its first turn.
    """
    momentum = trajectory.read("angular_momentum", bodies=body)[0]
    up = momentum / np.linalg.norm(momentum)
    spun = int(np.argmax(np.abs(trajectory.omega_body(body)[0])))
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
    title = f"{trajectory.names[body]}, its angular momentum upwards, its {'xyz'[spun]} axis orange"
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
