"""Picture of a sweep: each value over one axis, or over two, or beside each of more."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from particlerb.maths.vec3 import Floats
from particlerb.studies.charts.style import COLOURS, INK, finish_panel

_MAX_PANELS: Final = 12
_WIDTH, _HEIGHT = 4.6, 3.2  # [in] of a panel
_UNITS: Final = {
    "position": "m", "velocity": "m/s", "angular_velocity": "rad/s", "linear_momentum": "kg m/s",
    "angular_momentum": "kg m²/s", "kinetic_energy": "J", "inertia": "kg m²", "joint_force": "N",
    "joint_torque": "N m",
}  # fmt: skip
_EVEN_TOLERANCE: Final = 1e-9  # share by which differences, or ratios, of an axis may differ


def draw_sweep(
    title: str, axes: Sequence[tuple[str, Floats]], values: Sequence[tuple[str, Floats]], path: Path
) -> None:
    """Draw values of the runs; as PNG, SVG or PDF, by the suffix of the path.

    Parameters
    ----------
    title : str
    axes, values : sequence of (str, ndarray of shape (n_runs,))
        Names and numbers; NaN where a run failed. Values that are the same everywhere are left out.
    path : Path
    """
    shown = [(name, v) for name, v in values if np.unique(v[np.isfinite(v)]).size > 1]
    shown = shown[:_MAX_PANELS]
    shown = shown or list(values)[:1]
    across = len(axes) if len(axes) > 2 else min(len(shown), 3)
    down = len(shown) if len(axes) > 2 else -(-len(shown) // across)
    figure = Figure(figsize=(_WIDTH * across, _HEIGHT * down + 0.4), layout="constrained")
    figure.suptitle(title, color=INK, fontsize=12)
    panels = figure.subplots(down, across, squeeze=False)
    if len(axes) > 2:
        for row, (name, numbers) in zip(panels, shown, strict=True):
            for panel, axis in zip(row, axes, strict=True):
                _draw_points(panel, axis, name, numbers)
    else:
        for panel, (name, numbers) in zip(panels.flat, shown, strict=False):
            if len(axes) == 1:
                _draw_line(panel, axes[0], name, numbers)
            else:
                _draw_map(figure, panel, axes, name, numbers)
        for panel in panels.flat[len(shown) :]:
            panel.set_axis_off()
    figure.savefig(path, dpi=110)


def _draw_line(panel: Axes, axis: tuple[str, Floats], name: str, values: Floats) -> None:
    """A value over the only axis; with replicates, their mean as the line."""
    label, x = axis
    x, values = x[np.isfinite(values)], values[np.isfinite(values)]
    places = np.unique(x)
    means = np.array([values[x == place].mean() for place in places])
    panel.plot(places, means, color=COLOURS[0], lw=1.2)
    panel.plot(x, values, "o", color=COLOURS[0], ms=4)
    finish_panel(panel, name, xlabel=label, ylabel=_unit(name), xscale=_scale(x))


def _draw_points(panel: Axes, axis: tuple[str, Floats], name: str, values: Floats) -> None:
    """A value beside one of several axes."""
    label, x = axis
    panel.plot(x, values, ".", color=COLOURS[0], ms=4)
    finish_panel(panel, name, xlabel=label, ylabel=_unit(name), xscale=_scale(x))


def _draw_map(
    figure: Figure, panel: Axes, axes: Sequence[tuple[str, Floats]], name: str, values: Floats
) -> None:
    """A value over two axes: cells where they form a grid, else coloured points."""
    (across, x), (up, y) = axes
    columns, rows = np.unique(x), np.unique(y)
    if columns.size * rows.size == values.size and min(columns.size, rows.size) > 1:
        grid = np.full((rows.size, columns.size), np.nan)
        grid[np.searchsorted(rows, y), np.searchsorted(columns, x)] = values
        drawn: Any = panel.pcolormesh(columns, rows, grid, cmap="viridis", shading="nearest")
    else:
        drawn = panel.scatter(x, y, c=values, cmap="viridis", s=16)
    figure.colorbar(drawn, ax=panel, label=_unit(name))
    finish_panel(panel, name, xlabel=across, ylabel=up, xscale=_scale(x), yscale=_scale(y))
    panel.grid(visible=False)


def _unit(name: str) -> str:
    """Unit of a value by its name, ball.velocity.x or ball.position; nothing where it has none."""
    return next((f"[{_UNITS[part]}]" for part in name.split(".")[1:] if part in _UNITS), "")


def _scale(x: Floats) -> str:
    """Logarithmic where an axis was given in equal ratios, or spans two decades."""
    places = np.unique(x)
    if places.size < 2 or places[0] <= 0.0:
        return "linear"
    ratios = places[1:] / places[:-1]
    is_even = places.size > 2 and np.ptp(ratios) <= _EVEN_TOLERANCE * ratios.max()
    return "log" if is_even or places[-1] >= 100.0 * places[0] else "linear"
