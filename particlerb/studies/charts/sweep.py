"""Picture of a sweep: each value over one axis, or over two, or beside each of more."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from particlerb.maths.vec3 import Floats
from particlerb.studies.charts.style import COLOURS, INK, cell_edges, finish_panel, plain

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
    figure.suptitle(plain(title), color=INK, fontsize=12)
    panels = figure.subplots(down, across, squeeze=False)
    if len(axes) > 2:
        for row, (name, numbers) in zip(panels, shown, strict=True):
            for panel, axis in zip(row, axes, strict=True):
                _draw_points(panel, axis, name, numbers, False)
    else:
        for panel, (name, numbers) in zip(panels.flat, shown, strict=False):
            if len(axes) == 1:
                _draw_points(panel, axes[0], name, numbers, True)
            else:
                _draw_map(figure, panel, axes, name, numbers)
        for panel in panels.flat[len(shown) :]:
            panel.set_axis_off()
    figure.savefig(path, dpi=110)


def _draw_points(
    panel: Axes, axis: tuple[str, Floats], name: str, values: Floats, is_only: bool
) -> None:
    """A value over an axis; a line through the means of replicates if it is the only one."""
    label, x = axis
    x, values = x[np.isfinite(values)], values[np.isfinite(values)]
    if is_only:
        panel.plot(*_means(x[:, None], values), color=COLOURS[0], lw=1.2)
    panel.plot(x, values, "o", color=COLOURS[0], ms=4 if is_only else 2)
    finish_panel(panel, name, xlabel=label, ylabel=_unit(name), xscale=_scale(x))


def _means(x: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Places (m, k) among x (n, k), ascending, and means of values there; NaN where none is."""
    places, place = np.unique(x, axis=0, return_inverse=True)
    is_done = np.isfinite(values)
    at = place.ravel()[is_done]
    with np.errstate(invalid="ignore"):
        means = np.bincount(at, values[is_done], len(places)) / np.bincount(at, None, len(places))
    return places, means


def _draw_map(
    figure: Figure, panel: Axes, axes: Sequence[tuple[str, Floats]], name: str, values: Floats
) -> None:
    """A value over two axes: cells where they form a grid, else points; means of replicates."""
    (across, x), (up, y) = axes
    places, means = _means(np.stack([x, y], axis=1), values)
    columns, rows, scales = np.unique(x), np.unique(y), (_scale(x), _scale(y))
    if columns.size * rows.size == len(places) and min(columns.size, rows.size) > 1:
        each = zip((columns, rows), scales, strict=True)
        edges = (cell_edges(ends, scale == "log") for ends, scale in each)
        grid = means.reshape(columns.size, rows.size).T
        drawn: Any = panel.pcolormesh(*edges, grid, cmap="viridis")
    else:
        drawn = panel.scatter(places[:, 0], places[:, 1], c=means, cmap="viridis", s=16)
    figure.colorbar(drawn, ax=panel, label=_unit(name))
    finish_panel(panel, name, xlabel=across, ylabel=up, xscale=scales[0], yscale=scales[1])
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
