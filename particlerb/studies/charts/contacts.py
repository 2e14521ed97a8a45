"""Picture of the force chains in one frame: contacts as lines, the stronger the thicker."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from particlerb.maths.vec3 import Floats
from particlerb.record.trajectory import Contacts, Trajectory
from particlerb.studies.charts.bodies import draw_particles, side_axes
from particlerb.studies.charts.style import COLOURS, INK, bare
from particlerb.studies.text import count_of

_WIDTH = 11.0  # inches, of the picture
_WIDEST = 4.0  # points, of the strongest force
_WEAK, _STRONG = "#9aa5b1", COLOURS[1]


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
    shown = side_axes(trajectory, x)
    centres = trajectory.particle_positions(k)[:, shown]
    radii = trajectory.particles.radius[trajectory.constituents[1]]
    width, height = np.ptp(centres, axis=0) + 2.0 * radii.max()
    size = _WIDTH, float(np.clip(_WIDTH * height / width + 1.4, 2.6, 9.0))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.add_subplot()
    draw_particles(axes, centres, radii)
    if contacts.wall.size:
        _draw_forces(axes, x[:, shown], contacts, shown)
    axes.set_aspect("equal")
    axes.autoscale_view()
    across, up = ("xyz"[c] for c in shown)
    axes.set(xlabel=f"{across} [m]", ylabel=f"{up} [m]")
    title = trajectory.parameter("case_resolved")["title"] or path.stem
    time = float(trajectory.time[k])
    figure.suptitle(f"{title}: force chains at t = {time:.6g} s", color=INK, x=0.01, ha="left")
    axes.set_title(summary(contacts), fontsize=10, loc="left", color=INK)
    bare(axes)
    figure.savefig(path, dpi=130)


def _draw_forces(axes: Axes, com: Floats, contacts: Contacts, shown: list[int]) -> None:
    """Lines of contacts; those above the mean force in colour, the strongest last."""
    force = np.linalg.norm(contacts.force, axis=1)
    order = np.argsort(force)
    first, second = contacts.body.T
    is_wall = contacts.wall[:, None] >= 0
    ends = np.where(is_wall, contacts.point[:, shown], com[np.maximum(second, 0)])
    force = force[order]
    chains = LineCollection(
        list(np.stack([com[first], ends], axis=1)[order]),
        linewidths=np.maximum(_WIDEST * force / (force.max() or 1.0), 0.2),
        colors=np.where(force > force.mean(), _STRONG, _WEAK).tolist(),
        capstyle="round",
    )
    axes.add_collection(chains)


def summary(contacts: Contacts) -> str:
    """How many contacts, and how strong."""
    if not contacts.wall.size:
        return "no contacts"
    force = np.linalg.norm(contacts.force, axis=1)
    walls = int((contacts.wall >= 0).sum())
    return (
        f"{count_of(force.size, 'contact')}, {walls} with walls; mean {force.mean():.3g} N,"
        f" largest {force.max():.3g} N (the widest); in colour above the mean"
    )
