"""Picture of a trajectory: paths, angular velocity, an axis in the world, conservation errors."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from particlerb.geometry.particles import kind_of
from particlerb.maths.vec3 import Floats
from particlerb.model.state import derived
from particlerb.record.trajectory import Trajectory
from particlerb.studies.charts.style import COLOURS, INK, finish_panel, write_beside
from particlerb.studies.text import count_of

_PATHS = 12  # bodies whose trajectories are drawn


def draw_trajectory(trajectory: Trajectory, path: Path, body: int | None = None) -> None:
    """Draw where bodies go, the angular velocity of one, and the drifts; as PNG, SVG or PDF.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and momenta.
    path : Path
        Where to; the suffix is the format.
    body : int, optional
        Index of the body whose angular velocity and axis are drawn; default: the fastest to spin.
    """
    if body is None:
        body = _fastest(trajectory)
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    title = trajectory.parameter("case_resolved")["title"] or Path(trajectory.file.filename).name
    counts = f"{count_of(trajectory.n_bodies, 'body', 'bodies')}, {trajectory.n_frames} frames"
    figure.suptitle(f"{title}   ({counts})", color=INK)
    _draw_paths(figure.add_subplot(grid[0, 0], projection="3d"), trajectory, body)
    _draw_angular_velocity(figure.add_subplot(grid[0, 1]), trajectory, body)
    _draw_axis(figure.add_subplot(grid[1, 0]), trajectory, body)
    _draw_conservation_errors(figure.add_subplot(grid[1, 1]), trajectory)
    figure.savefig(path, dpi=130)


def _fastest(trajectory: Trajectory) -> int:
    """Body with the largest angular velocity in the last frame."""
    last = slice(trajectory.n_frames - 1, trajectory.n_frames)
    momenta = trajectory.read("angular_momentum", last)
    omega = derived(trajectory.bodies, trajectory.read("orientation", last), momenta, momenta)[1]
    return int(np.argmax(np.linalg.norm(omega[0], axis=1)))


def _draw_paths(axes: Axes3D, trajectory: Trajectory, body: int) -> None:
    """Trajectories of some bodies; where none moves, that of a point of one body."""
    n, name = trajectory.n_bodies, trajectory.names[body]
    shown = np.unique(np.append(np.linspace(0, n - 1, min(n, _PATHS)).astype(int), body))
    position = trajectory.read("position")[:, shown]
    if np.ptp(position, axis=0).max() > 0.0:
        for k, b in enumerate(shown):
            x, y, z = position[:, k].T
            colour = COLOURS[1] if b == body else COLOURS[0]
            axes.plot(x, y, z, lw=1.2, color=colour, alpha=1.0 if b == body else 0.6)
            axes.plot(x[-1:], y[-1:], z[-1:], "o", ms=3.5, color=colour)
        counts = f"{len(shown)} of {n}" if n > len(shown) else f"all {n}"
        title = f"trajectories ({counts})" if n > 1 else "trajectory"
        points = position.reshape(-1, 3)
    else:
        centre = position[0, int(np.flatnonzero(shown == body)[0])]
        points = centre + _reach_of(trajectory, body) * _axis_of(trajectory, body)
        axes.plot(*points.T, lw=0.9, color=COLOURS[1])
        title = f"path of the end of the x axis of {name}, whose centre of mass is at rest"
    axes.set_title(title, fontsize=10)
    _set_equal_scale(axes, points)


def _set_equal_scale(axes: Axes3D, points: Floats) -> None:
    """Give all three axes the same scale, and none less than a third of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, (high - low).max() / 3.0) / 2.0
    half = np.where(half > 0.0, 1.05 * half, 1.0)
    middle = (low + high) / 2.0
    x, y, z = zip(middle - half, middle + half, strict=True)
    axes.set(xlim=x, ylim=y, zlim=z, xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect(half / half.max())
    axes.locator_params(nbins=4)


def _reach_of(trajectory: Trajectory, body: int) -> float:
    """Distance of the farthest particle of a body from its centre [m]; 1 for a point."""
    own = kind_of(trajectory.particles, trajectory.kind[body]).position
    return float(np.linalg.norm(own, axis=1).max(initial=0.0)) or 1.0


def _axis_of(trajectory: Trajectory, body: int) -> Floats:
    """The body's x axis in the world, (T, 3)."""
    w, x, y, z = trajectory.read("orientation", bodies=body).T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)


def _draw_angular_velocity(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """Angular velocity of one body in its own axes."""
    omega, time = trajectory.omega_body(body), trajectory.time
    for k, letter in enumerate("xyz"):
        axes.plot(time, omega[:, k], color=COLOURS[k], lw=1.3, label=f"ω{letter}")
    axes.plot(time, np.linalg.norm(omega, axis=1), color=INK, lw=1.0, ls="--", label="|ω|")
    finish(axes, f"angular velocity of {trajectory.names[body]}, body frame", "ω [rad/s]")


def _draw_axis(axes: Axes, trajectory: Trajectory, body: int) -> None:
    """Where the body's x axis points."""
    axis = _axis_of(trajectory, body)
    for k, letter in enumerate("xyz"):
        axes.plot(trajectory.time, axis[:, k], color=COLOURS[k], lw=1.3, label=letter)
    axes.set_ylim(-1.08, 1.08)
    finish(axes, f"x axis of {trajectory.names[body]} in the world", "direction cosine")


def _draw_conservation_errors(axes: Axes, trajectory: Trajectory) -> None:
    """Largest errors of integration so far, relative to what is turned over."""
    ledger = trajectory.ledger
    linear, angular = trajectory.momentum_sizes()
    turned_over = max(ledger.kinetic_energy.max(), np.abs(ledger.work).max())
    errors = (
        ("energy", np.abs(ledger.energy_error), turned_over),
        ("momentum", np.linalg.norm(ledger.linear_momentum_error, axis=1), linear),
        ("angular momentum", np.linalg.norm(ledger.angular_momentum_error, axis=1), angular),
    )
    time, epsilon = trajectory.time, np.finfo(float).eps
    for (name, error, scale), colour in zip(errors, COLOURS, strict=True):
        drift = np.maximum.accumulate(error) / (scale or 1.0)
        label = name if drift[-1] > 0.0 else f"{name} (0)"
        axes.semilogy(time, np.where(drift > 0.0, drift, np.nan), color=colour, lw=1.3, label=label)
    axes.axhline(epsilon, color=INK, lw=0.8, ls=":")
    text = "machine epsilon"
    write_beside(axes, 0.99, 0.9 * epsilon, text, fontsize=8, color=INK, ha="right", va="top")
    axes.set_ylim(min(axes.get_ylim()[0], 1e-17), max(axes.get_ylim()[1], 1e-14))
    finish(axes, "conservation errors", "relative, external work removed")


def finish(axes: Axes, title: str, label: str) -> None:
    """What all panels over time have in common."""
    finish_panel(axes, title, xlabel="t [s]", ylabel=label)
    axes.legend(
        fontsize=8, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False,
        handlelength=1.4, columnspacing=1.0, borderaxespad=0.2,
    )  # fmt: skip
