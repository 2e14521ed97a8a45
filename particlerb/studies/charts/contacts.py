"""Picture of the force chains in one frame: contacts as lines, the stronger the thicker."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from particlerb.maths.vec3 import Floats
from particlerb.record.trajectory import Contacts, Trajectory
from particlerb.studies.charts.style import COLOURS, INK, bare

WIDTH = 11.0  # inches, of the picture
WIDEST = 4.0  # points, of the strongest force
WEAK, STRONG = "#9aa5b1", COLOURS[1]
BODY = "#eceff2"


def draw_contacts(trajectory: Trajectory, path: Path, frame: int = -1) -> None:
    """Draw all contacts of a frame over the outlines of the particles, seen from the side.

    A contact of two bodies is a line between their centres of mass, one with a wall from the centre
    to the point; its width is the size of the force. The view is along the axis along which the
    bodies reach least, of x and y where gravity acts along z.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and contacts.
    path : Path
        Where to; the suffix is the format.
    frame : int
        Number of the frame; negative counts from the end.
    """
    k = range(trajectory.n_frames)[frame]
    x = trajectory.read("position", slice(k, k + 1))[0]
    contacts = trajectory.contacts(k)
    across, up = axes_of(trajectory, x)
    places = trajectory.particle_positions(k)
    radii = trajectory.particles.radius[trajectory.constituents[1]]
    span = np.ptp(places, axis=0) + 2.0 * radii.max()
    height = float(np.clip(WIDTH * span[up] / span[across] + 1.4, 2.6, 9.0))
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.add_subplot()
    draw_particles(axes, places[:, [across, up]], radii)
    draw_forces(axes, x, contacts, [across, up])
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel(f"{'xyz'[across]} [m]")
    axes.set_ylabel(f"{'xyz'[up]} [m]")
    title = trajectory.parameter("case_resolved")["title"] or path.stem
    time = float(trajectory.time[k])
    figure.suptitle(f"{title}: force chains at t = {time:.6g} s", color=INK, x=0.01, ha="left")
    axes.set_title(summary(contacts), fontsize=10, loc="left", color=INK)
    bare(axes)
    figure.savefig(path, dpi=130)


def axes_of(trajectory: Trajectory, x: Floats) -> tuple[int, int]:
    """Axes of the picture, across and up: up is that along which gravity is largest, else z."""
    gravity = trajectory.parameter("case_resolved")["gravity"]
    g = np.abs(gravity["acceleration"]) if gravity else np.zeros(3)
    up = int(np.argmax(g)) if g.any() else 2
    level = [c for c in range(3) if c != up]
    extent = np.ptp(x, axis=0)
    return max(level, key=lambda c: float(extent[c])), up


def draw_particles(axes: Axes, places: Floats, radii: Floats) -> None:
    """Outlines of particles, in the units of the axes."""
    width = 2.0 * radii
    circles = EllipseCollection(
        width, width, np.zeros_like(width), units="xy", offsets=places,
        offset_transform=axes.transData, facecolor=BODY, edgecolor="#c9d0d6", linewidth=0.3,
    )  # fmt: skip
    axes.add_collection(circles)
    low, high = (places - radii[:, None]).min(axis=0), (places + radii[:, None]).max(axis=0)
    axes.update_datalim([low, high])


def draw_forces(axes: Axes, x: Floats, contacts: Contacts, shown: list[int]) -> None:
    """Lines of contacts; those above the mean force in colour, the strongest last."""
    if not contacts.wall.size:
        return
    force = np.linalg.norm(contacts.force, axis=1)
    order = np.argsort(force)
    is_body = contacts.wall < 0
    ends = np.where(is_body[:, None], x[np.where(is_body, contacts.body[:, 1], 0)], contacts.point)
    lines = np.stack([x[contacts.body[:, 0]], ends], axis=1)[order][:, :, shown]
    force = force[order]
    width = WIDEST * force / (force.max() or 1.0)
    colours = np.where(force > force.mean(), STRONG, WEAK)
    width = np.maximum(width, 0.2)
    chains = LineCollection(
        list(lines), linewidths=width, colors=colours.tolist(), capstyle="round"
    )
    axes.add_collection(chains)


def summary(contacts: Contacts) -> str:
    """How many contacts, and how strong."""
    if not contacts.wall.size:
        return "nothing touches"
    force = np.linalg.norm(contacts.force, axis=1)
    walls = int((contacts.wall >= 0).sum())
    return (
        f"{force.size} contacts, {walls} of them with walls; mean {force.mean():.3g} N,"
        f" largest {force.max():.3g} N (the widest); in colour above the mean"
    )
