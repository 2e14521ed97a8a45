"""Pictures: the only module that imports matplotlib."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D

from particlerb.maths.vec3 import Floats
from particlerb.trajectory import Trajectory

mpl.use("Agg")

WAYS = 12  # bodies whose ways are drawn
COLOURS = ("#0072b2", "#d55e00", "#009e73")  # x, y, z: told apart also by the colour-blind
INK = "#333333"
FLOOR = 1e-18  # where an error of zero is drawn


def draw_trajectory(trajectory: Trajectory, path: Path, body: int = 0) -> None:
    """Draw where bodies go, the angular velocity of one, and the drifts; as PNG, SVG or PDF.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and momenta.
    path : Path
        Where to; the suffix is the format.
    body : int
        Index of the body whose angular velocity and axis are drawn.
    """
    time, name = trajectory.time, trajectory.names[body]
    figure = Figure(figsize=(11, 7.2), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    title = trajectory.parameter("case_resolved")["title"] or Path(trajectory.file.filename).name
    counts = f"{trajectory.n_bodies} bodies" if trajectory.n_bodies > 1 else "1 body"
    figure.suptitle(f"{title}   ({counts}, {trajectory.n_frames} frames)", color=INK)
    draw_ways(figure.add_subplot(grid[0, 0], projection="3d"), trajectory, body)
    draw_rates(figure.add_subplot(grid[0, 1]), trajectory, time, body, name)
    draw_axis(figure.add_subplot(grid[1, 0]), trajectory, time, body, name)
    draw_drifts(figure.add_subplot(grid[1, 1]), trajectory, time)
    figure.savefig(path, dpi=130)


def draw_ways(axes: Axes3D, trajectory: Trajectory, body: int) -> None:
    """Ways of some bodies; where none moves away, the way of a point of one body."""
    n = trajectory.n_bodies
    shown = np.unique(np.append(np.linspace(0, n - 1, min(n, WAYS)).astype(int), body))
    position = trajectory.read("position")[:, shown]
    extent = np.ptp(position, axis=0).max()
    reach = reach_of(trajectory, body)
    if extent > 0.0 or n > 1:
        for k, b in enumerate(shown):
            x, y, z = position[:, k].T
            colour = COLOURS[1] if b == body else COLOURS[0]
            axes.plot(x, y, z, lw=1.2, color=colour, alpha=1.0 if b == body else 0.6)
            axes.plot(x[-1:], y[-1:], z[-1:], "o", ms=3.5, color=colour)
        axes.set_title(f"ways of {len(shown)} of {n} bodies" if n > 1 else "way", fontsize=10)
    else:
        x, y, z = (reach * axis_of(trajectory, body) + position[:, 0]).T
        axes.plot(x, y, z, lw=1.0, color=COLOURS[1])
        axes.set_title("way of the end of the body's x axis (the com rests)", fontsize=10)
    for set_label, letter in zip(
        (axes.set_xlabel, axes.set_ylabel, axes.set_zlabel), "xyz", strict=True
    ):
        set_label(f"{letter} [m]")
    axes.set_aspect("equal")


def reach_of(trajectory: Trajectory, body: int) -> float:
    """Distance of the farthest particle of a body from its centre [m]; 1 for a point."""
    table = trajectory.file["bodies/particles"]
    kind = int(trajectory.file["bodies/kind"][body])
    lo, hi = table["offset"][kind : kind + 2]
    farthest = float(np.linalg.norm(table["position"][lo:hi], axis=1).max(initial=0.0))
    return farthest or 1.0


def axis_of(trajectory: Trajectory, body: int) -> Floats:
    """The body's x axis in the world, (T, 3)."""
    w, x, y, z = trajectory.read("orientation")[:, body].T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)


def draw_rates(axes: Axes, trajectory: Trajectory, time: Floats, body: int, name: str) -> None:
    """Angular velocity of one body in its own axes."""
    omega = trajectory.omega_body(body)
    for k, letter in enumerate("xyz"):
        axes.plot(time, omega[:, k], color=COLOURS[k], lw=1.3, label=f"ω{letter}")
    size = np.linalg.norm(omega, axis=1)
    axes.plot(time, size, color=INK, lw=1.0, ls="--", label="|ω|")
    axes.set_title(f"angular velocity of {name}, body frame", fontsize=10)
    axes.set_ylabel("ω [rad/s]")
    finish(axes)


def draw_axis(axes: Axes, trajectory: Trajectory, time: Floats, body: int, name: str) -> None:
    """Where the body's x axis points."""
    axis = axis_of(trajectory, body)
    for k, letter in enumerate("xyz"):
        axes.plot(time, axis[:, k], color=COLOURS[k], lw=1.3, label=letter)
    axes.set_title(f"x axis of {name} in the world", fontsize=10)
    axes.set_ylabel("direction cosine")
    axes.set_ylim(-1.08, 1.08)
    finish(axes)


def draw_drifts(axes: Axes, trajectory: Trajectory, time: Floats) -> None:
    """Errors of integration: total less initial less booked, relative to what is turned over."""
    ledger = trajectory.ledger
    linear, angular = trajectory.momentum_sizes()
    turned_over = max(ledger.kinetic_energy.max(), np.abs(ledger.work).max())
    errors = (
        ("energy", np.abs(ledger.energy_error), turned_over),
        ("momentum", np.linalg.norm(ledger.linear_momentum_error, axis=1), linear),
        ("angular momentum", np.linalg.norm(ledger.angular_momentum_error, axis=1), angular),
    )
    for (name, error, scale), colour in zip(errors, COLOURS, strict=True):
        drift = np.maximum(error / (scale or 1.0), FLOOR)
        axes.semilogy(time, drift, color=colour, lw=1.2, label=name)
    axes.axhline(np.finfo(float).eps, color=INK, lw=0.8, ls=":")
    axes.annotate("one rounding", (time[0], 1.3 * np.finfo(float).eps), fontsize=8, color=INK)
    axes.set_title("drift: total less initial less booked, relative", fontsize=10)
    bottom, top = axes.get_ylim()
    axes.set_ylim(min(bottom, FLOOR / 2), max(top, 1e-14))
    finish(axes)


def finish(axes: Axes) -> None:
    """What all panels over time have in common."""
    axes.set_xlabel("t [s]")
    axes.grid(color="#dddddd", lw=0.6)
    axes.legend(fontsize=8, ncols=4, loc="best", frameon=True, framealpha=0.85)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
