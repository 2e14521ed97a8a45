"""Tops: which bodies are such, the paths of their axes, nutation and precession."""

import numpy as np
from matplotlib.axes import Axes
from mpl_toolkits.mplot3d import Axes3D

from particlerb.model.state import rotate
from particlerb.record.trajectory import Trajectory
from particlerb.record.verify import counted
from particlerb.rotors.rotor_class import SYMMETRIC
from particlerb.studies.charts.bodies import direction, set_equal_scale, upright
from particlerb.studies.charts.style import COLOURS, INK, finish_over_time, line_style, plain


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
    for body, points in zip(tops, ways, strict=True):
        colour = line_style(body)["color"] if len(tops) > 1 else COLOURS[1]
        axes.plot(*points.T, lw=0.9, color=colour)
        axes.plot(*points[-1:].T, "o", ms=3.5, color=colour)
    of = " and ".join(
        f"the {'xyz'[axis]} axis of {trajectory.names[b]}" for b, axis in tops.items()
    )
    axes.set_title(plain(f"path of {of} on the unit sphere"), fontsize=10, color=INK)
    set_equal_scale(axes, np.concatenate(ways), "")


def draw_nutation(axes: Axes, trajectory: Trajectory, tops: dict[int, int]) -> None:
    """How far the axis of each top leans, and about the vertical how far it has come."""
    up, is_one = upright(trajectory), len(tops) == 1
    across = [(up + 1) % 3, (up + 2) % 3]
    other = axes.twinx()
    for b, principal in tops.items():
        axis = direction(trajectory, b, principal)
        nutation = np.degrees(np.arccos(np.clip(axis[:, up], -1.0, 1.0)))
        precession = np.degrees(np.unwrap(np.arctan2(axis[:, across[1]], axis[:, across[0]])))
        own = line_style(b)["color"]
        colours, dashes = (COLOURS[:2], "-") if is_one else ((own, own), "--")
        name = "" if is_one else f"{trajectory.names[b]}, "
        label = plain(f"{name}nutation")
        axes.plot(trajectory.time, nutation, color=colours[0], lw=1.3, label=label)
        line = other.plot(trajectory.time, precession, dashes, color=colours[1], lw=1.3)
    right = COLOURS[1] if is_one else INK
    axes.plot([], [], line[0].get_linestyle(), color=right, label="precession (right)")
    other.set_ylabel("precession [°]", color=right)
    title = f"axis of {trajectory.names[next(iter(tops))]}" if is_one else "axes of the tops"
    finish_over_time(axes, title, f"angle with {'xyz'[up]} [°]")
