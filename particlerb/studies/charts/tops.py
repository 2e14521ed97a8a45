"""Tops: which bodies are such, the paths of their axes, nutation and precession."""

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D

from particlerb.model.state import rotate
from particlerb.record.trajectory import Trajectory
from particlerb.record.verify import counted
from particlerb.rotors.rotor_class import SYMMETRIC
from particlerb.studies.charts.bodies import direction, draw_lines, set_equal_scale, upright
from particlerb.studies.charts.style import COLOURS, INK, finish_over_time, line_style, plain

_SAME: Final = 2e-3  # by which paths on the unit sphere do not differ


def is_top(trajectory: Trajectory, body: int) -> bool:
    """Whether a body with two equal moments is moved by forces while its centre rests."""
    has_forces = bool(trajectory.parameter("case_resolved")["force"])
    is_free = bool(counted(trajectory).mass[body])
    is_symmetric = int(trajectory.bodies.rotor_class[body]) == SYMMETRIC
    way = trajectory.read("position", bodies=body)
    return has_forces and is_free and is_symmetric and not np.ptp(way, axis=0).any()


def tops_of(trajectory: Trajectory, body: int, is_scene: bool) -> dict[int, int]:
    """Tops whose axes are drawn, with these axes: a few, where nothing else moves, or the body."""
    free = np.flatnonzero(counted(trajectory).mass).tolist()
    are_few = is_scene and trajectory.n_bodies <= len(COLOURS)
    are_all = are_few and all(is_top(trajectory, b) for b in free)
    tops = free if are_all else [body] * is_top(trajectory, body)
    return {b: _symmetry_axis(trajectory, b) for b in tops}


def _symmetry_axis(trajectory: Trajectory, body: int) -> int:
    """Axis of the body frame nearest to that of the moment that differs from the other two."""
    moments = trajectory.bodies.inertia[:, body]
    return body_axis(trajectory, body, int(np.argmax(np.abs(moments - np.median(moments)))))


def body_axis(trajectory: Trajectory, body: int, principal: int) -> int:
    """Axis of the body frame nearest to a principal one."""
    frame = trajectory.bodies.rotor_frame[:, body : body + 1]
    return int(np.argmax(np.abs(rotate(frame, np.eye(3)[:, principal : principal + 1]))))


def draw_trace(axes: Axes3D, trajectory: Trajectory, tops: dict[int, int]) -> None:
    """Paths of the ends of an axis of each of some bodies on the unit sphere."""
    ways = [direction(trajectory, body, axis) for body, axis in tops.items()]
    for k, (body, points) in enumerate(zip(tops, ways, strict=True)):
        colour = line_style(body)["color"] if len(tops) > 1 else COLOURS[1]
        above = sum(np.allclose(points, way, rtol=0.0, atol=_SAME) for way in ways[k + 1 :])
        axes.plot(*points.T, lw=0.9 + 1.5 * above, color=colour)
        axes.plot(*points[-1:].T, "o", ms=3.5, color=colour)
    (body, axis), *others = tops.items()
    one = f"path of the {'xyz'[axis]} axis of {trajectory.names[body]}"
    of = "paths of the axes of the tops" if others else one
    axes.set_title(plain(f"{of} on the unit sphere"), fontsize=10, color=INK)
    set_equal_scale(axes, np.concatenate(ways), "")


def draw_nutation(axes: Axes, trajectory: Trajectory, tops: dict[int, int]) -> None:
    """How far the axis of each top leans, and about the vertical how far it has come."""
    up, is_one, time = upright(trajectory), len(tops) == 1, trajectory.time
    ways = np.stack([direction(trajectory, b, axis) for b, axis in tops.items()], axis=1)
    x, y, z = (ways[:, :, (up + k) % 3] for k in (1, 2, 0))
    nutation = np.degrees(np.arccos(np.clip(z, -1.0, 1.0)))
    precession = np.degrees(np.unwrap(np.arctan2(y, x), axis=0))
    names = ["nutation" if is_one else f"{trajectory.names[b]}, nutation" for b in tops]
    own = [line_style(b)["color"] for b in tops]
    left, right, dashes = (COLOURS[:1], COLOURS[1:], "-") if is_one else (own, own, "--")
    draw_lines(axes, time, nutation, names, lambda k: {"color": left[k]})
    other = axes.twinx()
    draw_lines(other, time, precession, names, lambda k: {"color": right[k], "ls": dashes})
    colour = COLOURS[1] if is_one else INK
    axes.plot([], [], dashes, color=colour, label="precession (right)")
    other.set_ylabel("precession [°]", color=colour)
    title = f"axis of {trajectory.names[next(iter(tops))]}" if is_one else "axes of the tops"
    finish_over_time(axes, title, f"angle with {'xyz'[up]} [°]")
