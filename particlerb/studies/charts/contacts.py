"""Picture of the force chains in one frame: contacts as lines, the stronger the thicker."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from particlerb.maths.vec3 import Floats
from particlerb.record.trajectory import Contacts, Trajectory
from particlerb.studies.charts.bodies import draw_particles, side_axes
from particlerb.studies.charts.style import COLOURS, INK, bare, plain
from particlerb.words import count_of

_FIGURE_WIDTH = 11.0  # inches
_MAX_WIDTH, _KEY_WIDTH = 4.0, 0.8  # points, of the strongest force, and of weak ones in the key
_MIN_EMPTY_SHARE, _MAX_PANELS = 0.15, 4  # share of the width that is left out
_WEAK, _STRONG = "#9aa5b1", COLOURS[1]


def draw_contacts(trajectory: Trajectory, path: Path) -> None:
    """Draw all contacts of the last frame over the outlines of the particles, seen from the side.

    A contact of two bodies is a line between their centres of mass, one with a wall from the centre
    to the point; its width is the size of the force. The view is along the axis along which the
    bodies reach least, of x and y where gravity acts along z.

    Parameters
    ----------
    trajectory : Trajectory
        With positions, orientations and contacts.
    path : Path
        Where to; the suffix is the format.
    """
    k = trajectory.n_frames - 1
    x = trajectory.read("position", k)
    contacts = trajectory.contacts(k)
    shown = side_axes(trajectory, x)
    centres = trajectory.particle_positions(k)[:, shown]
    radii = trajectory.particles.radius[trajectory.constituents[1]]
    parts = _apart(centres[:, 0] - radii, centres[:, 0] + radii)
    widths = [stop - start for start, stop in parts]
    height = np.ptp(centres[:, 1]) + 2.0 * radii.max()
    tall = float(np.clip(_FIGURE_WIDTH * height / sum(widths) + 1.2, 2.4, 9.0))
    figure = Figure(figsize=(_FIGURE_WIDTH, tall), layout="constrained")
    panels = figure.subplots(1, len(parts), width_ratios=widths, sharey=True, squeeze=False)[0]
    across, up = ("xyz"[c] for c in shown)
    for axes, (start, stop) in zip(panels, parts, strict=True):
        draw_particles(axes, centres, radii)
        if contacts.wall.size:
            _draw_forces(axes, x, contacts, shown)
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.set(xlabel=f"{across} [m]", xlim=(start, stop))
        bare(axes)
    panels[0].set_ylabel(f"{up} [m]")
    title = trajectory.parameter("case_resolved")["title"] or path.stem
    time = float(trajectory.time[k])
    text = f"{title}: force chains at t = {time:.6g} s\n{summary(contacts)}"
    figure.suptitle(plain(text), color=INK, fontsize=10, x=0.01, ha="left")
    if contacts.wall.size:
        figure.legend(handles=_key(contacts), loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def _apart(low: Floats, high: Floats) -> list[tuple[float, float]]:
    """Ranges that particles cover, where much between them is empty; else one."""
    order = np.argsort(low)
    ends = np.maximum.accumulate(high[order])
    gaps = low[order][1:] - ends[:-1]
    cuts = np.flatnonzero(gaps > _MIN_EMPTY_SHARE * (ends[-1] - low.min()))
    margin = 0.01 * (ends[-1] - low.min())
    starts = low[order][np.append(0, cuts + 1)] - margin
    stops = ends[np.append(cuts, len(ends) - 1)] + margin
    if len(starts) > _MAX_PANELS:
        starts, stops = starts[:1], stops[-1:]
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def _key(contacts: Contacts) -> list[Line2D]:
    """What the lines mean: colours, and two widths."""
    force = np.linalg.norm(contacts.force, axis=1)
    mean, most = float(force.mean()), float(force.max())
    lines = [
        (_WEAK, _KEY_WIDTH, f"below the mean force, {mean:.3g} N"),
        (_STRONG, _MAX_WIDTH * mean / (most or 1.0), "above it"),
        (_STRONG, _MAX_WIDTH, f"the largest, {most:.3g} N"),
    ]
    return [Line2D([], [], color=colour, lw=width, label=text) for colour, width, text in lines]


def _draw_forces(axes: Axes, com: Floats, contacts: Contacts, shown: list[int]) -> None:
    """Lines of contacts; those above the mean force in colour, the strongest last."""
    force = np.linalg.norm(contacts.force, axis=1)
    order = np.argsort(force)
    force = force[order]
    chains = LineCollection(
        list(contacts.lines(com)[order][..., shown]),
        linewidths=np.maximum(_MAX_WIDTH * force / (force.max() or 1.0), 0.2),
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
    counts = f"{count_of(force.size, 'contact')}, {walls} with walls"
    return f"{counts}; mean {force.mean():.3g} N, largest {force.max():.3g} N"
