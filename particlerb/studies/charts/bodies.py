"""Bodies as a picture shows them: paths, a side view, a linkage at instants, one as it turns."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import Axes3D

from particlerb.export.surfaces import SurfaceMesh, box
from particlerb.maths.vec3 import Floats
from particlerb.model.state import axes_across, rotate, rotation_matrix
from particlerb.record import schema
from particlerb.record.provenance import changes_in
from particlerb.record.trajectory import Trajectory
from particlerb.studies.charts import solids
from particlerb.studies.charts.style import COLOURS, INK, finish_view, in_powers, line_style, plain

_ATTITUDES: Final = 7
_INSTANTS, _LONG_PATH = 5, 30.0  # of one body on its way at most; lengths of it that are seen
_APART: Final = 1.25  # of orientations, in diagonals of the body
_FLAT_RATIO: Final = 0.05  # height over width of what is seen from above
_LINE_RATIO: Final = 3.0  # motion along an axis over that along the other
_FRAMES: Final = 16  # that are looked at
_STILL_SHARE: Final = 1e-3  # of the width, which bodies at rest would not move in the whole time
_AROUND: Final = 0.25  # of the width of many bodies: how far around them walls are shown
_TALL, _FLAT = 1.5, 0.3  # height over width of a view that takes a column, or a strip
_STRIP: Final = 3.0  # height of a strip beside the panels below, over height beside width of a view
FEW: Final = 12  # bodies at most whose paths are drawn
KEYED: Final = 6  # bodies at most that have a colour each
_LINES, _LETTERS = 9, 40  # that one row of names has at most
_LINE_WIDTH: Final = 1.3
_GAP_SHARE: Final = 1e-3  # of its radius that a ball on a plane is above it at most
_SAME_SHARE: Final = 2e-3  # of the range of all values, by which lines of these do not differ


def upright(trajectory: Trajectory) -> int:
    """Axis along which gravity is largest; z without gravity."""
    gravity = trajectory.parameter("case_resolved")["gravity"]
    g = np.abs(gravity["acceleration"]) if gravity else np.zeros(3)
    return int(np.argmax(g)) if g.any() else 2


def side_axes(trajectory: Trajectory, x: Floats) -> list[int]:
    """Axes of a view of points x (..., 3): to the right and upwards.

    To the right is the axis along which bodies move, where that is one of the two, else that along
    which the points reach farthest. What lies in a plane, and moves within it, is seen from above;
    under gravity only if it moves along both of its axes. A drum that lies is seen along its axis.
    """
    up = upright(trajectory)
    level = [c for c in range(3) if c != up]
    moved = motion_of_bodies(trajectory)
    extent = np.ptp(x, axis=0)
    walls = trajectory.parameter("case_resolved")["wall"]
    drums = [wall["axis"] for wall in walls if wall["type"] == "cylinder" and wall["inside"]]
    if drums and (along := int(np.argmax(np.abs(drums[0])))) != up:
        return [3 - along - up, up]
    first, second = sorted(level, key=lambda c: -float(moved[c]))
    is_line = moved[first] > _LINE_RATIO * max(moved[second], _FLAT_RATIO * extent.max())
    wide = np.maximum(extent, moved)
    is_heavy = bool(trajectory.parameter("case_resolved")["gravity"])
    if wide[up] < _FLAT_RATIO * wide.max() and not (is_line and is_heavy):
        return level
    return [first if is_line else max(level, key=lambda c: float(extent[c])), up]


def motion_of_bodies(trajectory: Trajectory) -> Floats:
    """How far bodies come from where they begin, (3,) [m], in a few frames."""
    frames = np.unique(np.linspace(0, trajectory.n_frames - 1, _FRAMES).astype(int)).tolist()
    x = [trajectory.read("position", k) for k in frames]
    return np.asarray(np.abs(np.stack(x) - x[0]).max(axis=(0, 1)))


def make_room(figure: Figure) -> list[SubplotSpec]:
    """Give the only panel a place of its shape: a column, a strip or a quarter; three are left."""
    view = figure.axes[0]
    shape = 1.0 if view.name == "3d" else view.dataLim.height / (view.dataLim.width or 1.0)
    if shape > _TALL:
        grid = figure.add_gridspec(2, 3, width_ratios=(0.5, 1.0, 1.0))
        view.set_title(view.get_title(loc="left").replace("; ", "\n"), fontsize=10, loc="left")
        place, *left = grid[:, 0], grid[0, 1], grid[0, 2], grid[1, 1:]
    elif shape < _FLAT:
        height = min(max(_STRIP * shape, 0.3), 0.7)
        grid = figure.add_gridspec(2, 3, height_ratios=(height, 1.0))
        place, *left = grid[0, :], grid[1, 0], grid[1, 1], grid[1, 2]
    else:
        grid = figure.add_gridspec(2, 2)
        place, *left = grid[0, 0], grid[0, 1], grid[1, 0], grid[1, 1]
    view.set_subplotspec(place)
    return left


def draw_particles(
    axes: Axes, centres: Floats, radii: Floats, colours: object = solids.BODY_TINT
) -> None:
    """Outlines of particles with centres (n, 2) and radii (n,), in the units of the axes."""
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
    speed = np.linalg.norm(trajectory.read("linear_momentum", frame), axis=1) / trajectory.mass
    reach = np.ptp(centres[:, shown], axis=0).max() or 1.0
    passed = speed.max() * np.ptp(trajectory.time)
    is_still = not speed.any() or 0.0 < passed <= _STILL_SHARE * reach  # one frame has no time
    share = speed[:, None] / (speed.max() or 1.0) * (not is_still)
    tints = 1.0 - share * (1.0 - np.array(to_rgb(COLOURS[0]))) - 0.08 * (1.0 - share)
    radii = trajectory.particles.radius[particle][order]
    sizes = np.maximum(radii, 0.003 * reach)
    draw_particles(axes, centres[order][:, shown], sizes, tints[body][order])
    near = axes.dataLim.padded(_AROUND * max(axes.dataLim.width, axes.dataLim.height))
    left_out = solids.draw_walls(axes, trajectory, frame, shown)
    if trajectory.n_bodies > FEW:
        axes.dataLim.set(Bbox.intersection(axes.dataLim, near) or near)
    are_few_boxes = 12 * trajectory.n_bodies <= solids.MAX_TRIANGLES
    if trajectory.n_bodies <= FEW or (are_few_boxes and not radii.any()):
        _draw_outlines(axes, trajectory, frame, (across, up), tints)
    if trajectory.n_bodies <= FEW:
        paths = np.moveaxis(trajectory.read("position")[: frame + 1, :, shown], 1, 0)
        for path in paths:
            axes.plot(*path.T, color=COLOURS[1], lw=1.2)
    rest = "at rest" if frame else "all begin at rest"
    words = rest if is_still else f"blue: up to {speed.max():.3g} m/s"
    has_paths = trajectory.n_bodies <= FEW and np.ptp(paths, axis=1).max() > _STILL_SHARE * reach
    words += ("; orange: paths" if has_paths else "") + left_out
    title = f"t = {trajectory.time[frame]:.4g} s; {words}"
    finish_view(axes, title, f"{'xyz'[across]} [m]", f"{'xyz'[up]} [m]")


def draw_lines(
    axes: Axes,
    time: Floats,
    values: Floats,
    names: Sequence[str],
    style: Callable[[int], dict[str, Any]] = line_style,
) -> None:
    """A line for each of a few values (T, n), else the median and the range of 80 % of them.

    What lies below others looks out on both sides.
    """
    n = values.shape[1]
    if n <= KEYED or (n <= _LINES and sum(map(len, names)) <= _LETTERS):
        for k, name in enumerate(names):
            apart = np.abs(values[:, k + 1 :] - values[:, [k]]).max(axis=0)
            width = _LINE_WIDTH * (1 + np.count_nonzero(apart <= _SAME_SHARE * np.ptp(values)))
            axes.plot(time, values[:, k], lw=width, label=plain(name), **style(k))
        return
    low, middle, high = np.percentile(values, (10.0, 50.0, 90.0), axis=1)
    axes.fill_between(time, low, high, color=COLOURS[0], alpha=0.2, lw=0, label="10 to 90 %")
    axes.plot(time, middle, color=COLOURS[0], lw=_LINE_WIDTH, label=f"median of {n}")


def draw_slips(axes: Axes, trajectory: Trajectory) -> bool:
    """Speeds of the lowest points of a few balls on a plane, dashed; False where it is no such.

    The plane is at rest, and in all frames each ball is on it.
    """
    walls = trajectory.parameter("case_resolved")["wall"]
    edges = trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))
    body, particle = trajectory.constituents
    radius = np.zeros(trajectory.n_bodies)
    np.maximum.at(radius, body, trajectory.particles.radius[particle])
    are_round = np.allclose(edges, 2.0 * radius[:, None], rtol=1e-6) and radius.all()
    kinds = [(wall["type"], wall["motion"], wall["piston"]) for wall in walls]
    is_plane = kinds == [("plane", None, None)] and "wall" not in changes_in(trajectory.file)
    if not (is_plane and are_round) or trajectory.n_bodies > len(COLOURS):
        return False
    down = -np.array(walls[0]["normal"]) / np.linalg.norm(walls[0]["normal"])
    heights = (walls[0]["point"] - trajectory.position) @ down
    if (heights > (1.0 + _GAP_SHARE) * radius).any():
        return False
    rim = np.cross(trajectory.angular_velocity, radius[:, None] * down)
    slip = np.linalg.norm(np.cross(trajectory.velocity + rim, down), axis=2)
    for k in range(trajectory.n_bodies):
        label = f"slip of {trajectory.names[k]}"
        axes.plot(trajectory.time, slip[:, k], "--", color=COLOURS[k], lw=_LINE_WIDTH, label=label)
    return True


def draw_at_rest(axes: Axes, trajectory: Trajectory, shown: list[int]) -> None:
    """Bodies whose centres rest, in the last frame, seen from above at an angle."""
    x, q = (trajectory.read(name, -1, bodies=shown) for name in ("position", "orientation"))
    view = solids.view_at_angle(upright(trajectory))
    shapes = shapes_of(trajectory)
    placed = solids.placed([shapes[b] for b in shown], view, q, x)
    solids.draw_solids(axes, placed, "#a9cce3", 2.0)
    title = f"t = {trajectory.time[-1]:.4g} s; the centres are at rest"
    up = "xyz"[upright(trajectory)]
    finish_view(axes, title, solids.ANGLED, f"upwards: {up} [m]")


def draw_instants(figure: Figure, place: SubplotSpec, trajectory: Trajectory) -> bool:
    """The only body at instants along its path, seen at an angle; False where that is too long."""
    x = trajectory.read("position", bodies=0)
    mesh = solids.small_solid_of(trajectory, 0, _INSTANTS)
    size = 0.0 if mesh is None else float(np.ptp(mesh.vertices, axis=0).max())
    length = float(np.ptp(x, axis=0).max())
    if mesh is None or length > _LONG_PATH * size:
        return False
    count = int(min(_INSTANTS, 1.0 + length / size))
    frames = np.linspace(len(x) - 1, 0, count).astype(int)[::-1].tolist()
    up = upright(trajectory)
    view, q = solids.view_at_angle(up), trajectory.read("orientation", bodies=0)
    *before, last = solids.placed([mesh] * count, view, q[frames], x[frames])
    axes = figure.add_subplot(place)
    solids.draw_solids(axes, before, None, 1.0, "#8f99a3")
    solids.draw_solids(axes, [last], "#a9cce3", 2.0)
    axes.plot(*(x @ view.T)[:, :2].T, color=COLOURS[1], lw=1.2, zorder=3.0)
    times = ", ".join(f"{t:.4g}" for t in trajectory.time[frames])
    title = f"t = {times} s (blue)" + "; orange: path of the centre" * (length > 0.0)
    finish_view(axes, title, solids.ANGLED, f"upwards: {'xyz'[up]} [m]")
    return True


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


def _draw_outlines(
    axes: Axes, trajectory: Trajectory, frame: int, shown: tuple[int, int], tints: Floats
) -> None:
    """Solids of bodies, and boxes around those of several particles, behind the particles."""
    x, q = (trajectory.read(name, frame) for name in ("position", "orientation"))
    view = solids.view_along(*shown)
    several = np.flatnonzero(np.bincount(trajectory.constituents[0]) > 1)
    shapes = shapes_of(trajectory)
    placed = solids.placed([shapes[b] for b in several], view, q[several], x[several])
    solids.draw_solids(axes, placed, tints[several], 0.5)


def shapes_of(trajectory: Trajectory) -> list[SurfaceMesh]:
    """Surface of each body, in its frame from its centre of mass: a box where it has none.

    Around several particles it has their bounds, not those about the centre of mass.
    """
    high = 0.5 * trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))
    body, particle = trajectory.constituents
    x, radius = trajectory.particles.position[particle], trajectory.particles.radius[particle]
    of_several = np.bincount(body, minlength=trajectory.n_bodies) > 1
    low, high = (np.where(of_several[:, None], np.inf, sign * high) for sign in (-1.0, 1.0))
    high[of_several] *= -1.0
    chosen = of_several[body]
    np.minimum.at(low, body[chosen], (x - radius[:, None])[chosen])
    np.maximum.at(high, body[chosen], (x + radius[:, None])[chosen])
    made = zip(solids.solids_of(trajectory), low, high, strict=True)
    return [box(b - a).moved(np.eye(3), 0.5 * (a + b)) if mesh is None else mesh
            for mesh, a, b in made]  # fmt: skip


def set_equal_scale(axes: Axes3D, points: Floats, unit: str = " [m]") -> None:
    """Give all axes of points (n, 3) the same scale, none less than a third of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, (high - low).max() / 3.0) / 2.0
    half = np.where(half > 0.0, 1.05 * half, 1.0)
    middle = (low + high) / 2.0
    x, y, z = zip(middle - half, middle + half, strict=True)
    axes.set(xlim=x, ylim=y, zlim=z)
    shares, largest = half / half.max(), [float(np.abs([x, y, z]).max())]
    by_axis = (axes.xaxis, axes.yaxis, axes.zaxis)
    for letter, axis, share in zip("xyz", by_axis, shares.tolist(), strict=True):
        axis.get_major_locator().set_params(nbins=max(1, round(4.0 * share)), min_n_ticks=1)
        axis.set_major_formatter(lambda value, _: f"{value:.6g}")
        axis.set_label_text(in_powers(axis, largest, f"{letter}{unit}"))
        axis.labelpad = 6.0 + 6.0 * (letter == "z")  # beside the values, not over them
    is_tall = shares[2] == 1.0 > shares[:2].max()
    axes.set_box_aspect(shares, zoom=0.8 if is_tall else 1.0)  # labels stay above the next panel


def direction(trajectory: Trajectory, body: int, axis: int) -> Floats:
    """An axis of a body in the world, (T, 3)."""
    q = trajectory.read("orientation", bodies=body).T
    return rotate(q, np.eye(3)[:, [axis]]).T


def spun_axis(trajectory: Trajectory, body: int) -> int:
    """Axis of the body frame about which a body turns most at first, or on the whole."""
    rates = np.abs(trajectory.omega_body(body))
    return int(np.argmax(rates[0] if rates[0].any() else rates.mean(axis=0)))


def draw_orientations(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """A body at some instants, seen with its angular momentum upwards.

    Where it turns over, the instants lie around that, else within its first turn.
    """
    momentum = trajectory.read("angular_momentum", bodies=body)[0]
    up = momentum / np.linalg.norm(momentum)
    spun = spun_axis(trajectory, body)
    height = direction(trajectory, body, spun) @ up
    frames = _instants(trajectory, body, height * np.sign(height[0]))
    view = np.stack([*axes_across(up), up])
    cos, sin = np.cos(np.radians(25.0)), np.sin(np.radians(25.0))  # looked at from above
    view = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ view
    edges = trajectory.table(f"{schema.TRAJECTORY}/extent", "f", (trajectory.n_bodies, 3))[body]
    solid = solids.small_solid_of(trajectory, body, _ATTITUDES)
    mesh = box(edges) if solid is None else solid
    edges = np.ptp(mesh.vertices, axis=0)  # particles may lie far below a surface
    mesh = mesh._replace(vertices=mesh.vertices / np.linalg.norm(edges))
    arrow = np.outer([0.0, 0.5 * edges[spun] / np.linalg.norm(edges) + 0.2], np.eye(3)[spun])
    orientations = trajectory.read("orientation", bodies=body)[frames]
    for k, q in enumerate(orientations):
        to_picture = view @ rotation_matrix(q)
        tip = arrow @ to_picture.T
        shift = np.array([_APART * k, 0.0, 0.0])
        seen = to_picture[[0, 2, 1]]  # to the right, upwards, away
        solids.draw_solids(axes, [mesh.moved(seen, shift)], solids.BODY_TINT, 2.0)
        in_front = 3.0 if tip[1, 1] < 0.0 else 1.0
        x, z = tip[:, 0] + _APART * k, tip[:, 2]
        axes.plot(x, z, color=COLOURS[1], lw=2.0, zorder=in_front)
        axes.plot(x[1], z[1], "o", color=COLOURS[1], ms=6, zorder=in_front)
        axes.text(_APART * k, -0.85, f"{trajectory.time[frames[k]]:.4g} s", ha="center", color=INK)
    axes.set(xlim=(-0.7, _APART * (_ATTITUDES - 1) + 0.7), ylim=(-0.95, 0.75), aspect="equal")
    axes.set_axis_off()
    name = trajectory.names[body] if solid is not None else f"box around {trajectory.names[body]}"
    title = f"{name}; its angular momentum is upwards, its {'xyz'[spun]} axis orange"
    axes.set_title(plain(title), fontsize=10, color=INK)


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
