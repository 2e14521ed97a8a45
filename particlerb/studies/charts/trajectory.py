"""Picture of a trajectory: ways, rates, an axis in the world, drifts."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from particlerb.maths.vec3 import Floats
from particlerb.model.state import derived
from particlerb.record.trajectory import Trajectory
from particlerb.studies.charts.style import COLOURS, GRID, INK, bare

WAYS = 12  # bodies whose ways are drawn


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
        body = fastest(trajectory)
    time, name = trajectory.time, trajectory.names[body]
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    title = trajectory.parameter("case_resolved")["title"] or Path(trajectory.file.filename).name
    counts = f"{trajectory.n_bodies} bodies" if trajectory.n_bodies > 1 else "1 body"
    figure.suptitle(f"{title}   ({counts}, {trajectory.n_frames} frames)", color=INK)
    draw_ways(figure.add_subplot(grid[0, 0], projection="3d"), trajectory, body, name)
    draw_rates(figure.add_subplot(grid[0, 1]), trajectory, time, body, name)
    draw_axis(figure.add_subplot(grid[1, 0]), trajectory, time, body, name)
    draw_drifts(figure.add_subplot(grid[1, 1]), trajectory, time)
    figure.savefig(path, dpi=130)


def fastest(trajectory: Trajectory) -> int:
    """Body with the largest angular velocity in the last frame."""
    last = slice(trajectory.n_frames - 1, trajectory.n_frames)
    momenta = trajectory.read("angular_momentum", last)
    omega = derived(trajectory.bodies, trajectory.read("orientation", last), momenta, momenta)[1]
    return int(np.argmax(np.linalg.norm(omega[0], axis=1)))


def draw_ways(axes: Axes3D, trajectory: Trajectory, body: int, name: str) -> None:
    """Ways of some bodies; where none moves, the way of a point of one body."""
    n = trajectory.n_bodies
    shown = np.unique(np.append(np.linspace(0, n - 1, min(n, WAYS)).astype(int), body))
    position = trajectory.read("position")[:, shown]
    if np.ptp(position, axis=0).max() > 0.0:
        for k, b in enumerate(shown):
            x, y, z = position[:, k].T
            colour = COLOURS[1] if b == body else COLOURS[0]
            axes.plot(x, y, z, lw=1.2, color=colour, alpha=1.0 if b == body else 0.6)
            axes.plot(x[-1:], y[-1:], z[-1:], "o", ms=3.5, color=colour)
        of = f"of {len(shown)} of {n} bodies" if n > len(shown) else "of all bodies"
        axes.set_title(f"ways {of}" if n > 1 else "way", fontsize=10)
        points = position.reshape(-1, 3)
    else:
        centre = position[0, int(np.flatnonzero(shown == body)[0])]
        points = centre + reach_of(trajectory, body) * axis_of(trajectory, body)
        axes.plot(*points.T, lw=0.9, color=COLOURS[1])
        axes.set_title(f"way of the end of the x axis of {name}, which stays in place", fontsize=10)
    set_equal_scale(axes, points)


def set_equal_scale(axes: Axes3D, points: Floats) -> None:
    """Give all three axes the same scale, and none less than a third of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = np.maximum(high - low, (high - low).max() / 3.0) / 2.0
    half = np.where(half > 0.0, 1.05 * half, 1.0)
    middle = (low + high) / 2.0
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_zlim(middle[2] - half[2], middle[2] + half[2])
    axes.set_box_aspect(half / half.max())
    axes.locator_params(nbins=4)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")


def reach_of(trajectory: Trajectory, body: int) -> float:
    """Distance of the farthest particle of a body from its centre [m]; 1 for a point."""
    particles, kind = trajectory.particles, trajectory.kind[body]
    own = particles.position[particles.offset[kind] : particles.offset[kind + 1]]
    farthest = float(np.linalg.norm(own, axis=1).max(initial=0.0))
    return farthest or 1.0


def axis_of(trajectory: Trajectory, body: int) -> Floats:
    """The body's x axis in the world, (T, 3)."""
    w, x, y, z = trajectory.read("orientation", bodies=body).T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)


def draw_rates(axes: Axes, trajectory: Trajectory, time: Floats, body: int, name: str) -> None:
    """Angular velocity of one body in its own axes."""
    omega = trajectory.omega_body(body)
    for k, letter in enumerate("xyz"):
        axes.plot(time, omega[:, k], color=COLOURS[k], lw=1.3, label=f"ω{letter}")
    axes.plot(time, np.linalg.norm(omega, axis=1), color=INK, lw=1.0, ls="--", label="|ω|")
    finish(axes, f"rates of {name}, body frame", "ω [rad/s]")


def draw_axis(axes: Axes, trajectory: Trajectory, time: Floats, body: int, name: str) -> None:
    """Where the body's x axis points."""
    axis = axis_of(trajectory, body)
    for k, letter in enumerate("xyz"):
        axes.plot(time, axis[:, k], color=COLOURS[k], lw=1.3, label=letter)
    axes.set_ylim(-1.08, 1.08)
    finish(axes, f"x axis of {name} in the world", "direction cosine")


def draw_drifts(axes: Axes, trajectory: Trajectory, time: Floats) -> None:
    """Largest errors of integration so far, relative to what is turned over."""
    ledger = trajectory.ledger
    linear, angular = trajectory.momentum_sizes()
    turned_over = max(ledger.kinetic_energy.max(), np.abs(ledger.work).max())
    errors = (
        ("energy", np.abs(ledger.energy_error), turned_over),
        ("momentum", np.linalg.norm(ledger.linear_momentum_error, axis=1), linear),
        ("angular momentum", np.linalg.norm(ledger.angular_momentum_error, axis=1), angular),
    )
    for (name, error, scale), colour in zip(errors, COLOURS, strict=True):
        drift = np.maximum.accumulate(error) / (scale or 1.0)
        label = name if drift[-1] > 0.0 else f"{name} (0)"
        axes.semilogy(time, np.where(drift > 0.0, drift, np.nan), color=colour, lw=1.3, label=label)
    axes.axhline(np.finfo(float).eps, color=INK, lw=0.8, ls=":")
    axes.text(
        0.99,
        0.9 * np.finfo(float).eps,
        "one rounding",
        fontsize=8,
        color=INK,
        transform=axes.get_yaxis_transform(),
        ha="right",
        va="top",
    )
    axes.set_ylim(min(axes.get_ylim()[0], 1e-17), max(axes.get_ylim()[1], 1e-14))
    finish(axes, "drift", "largest error so far, relative")


def finish(axes: Axes, title: str, label: str) -> None:
    """What all panels over time have in common."""
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_ylabel(label)
    axes.set_xlabel("t [s]")
    axes.grid(color=GRID, lw=0.6)
    axes.legend(
        fontsize=8, ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False,
        handlelength=1.4, columnspacing=1.0, borderaxespad=0.2,
    )  # fmt: skip
    bare(axes)
