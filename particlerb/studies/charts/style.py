"""Colours, lines and panels that all pictures share."""

import io
import math
from collections.abc import Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from particlerb.maths.vec3 import Floats
from particlerb.words import encodable

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73")  # told apart also by the colour-blind
METHOD_COLOURS: Final = {
    "exact": "#333333",
    "strang": "#0072b2",
    "force_gradient": "#56b4e9",
    "rkn6": "#009e73",
    "dop853": "#7b3294",
    "rk4": "#b8860b",
    "semi_implicit_euler": "#d55e00",
    "explicit_euler": "#b2182b",
    "momentum_euler": "#cc79a7",
    "moreau": "#009e73",
    "rattle": "#0072b2",
    "rattle4": "#56b4e9",
    "rattle6": "#009e73",
    "rattle8": "#d55e00",
}
INK: Final = "#333333"
GRID: Final = "#dddddd"
_TIMES: Final = 6  # steps between times at most: values of short runs are long
_HANDLE, _ROW = 6, 238  # letters beside a name, and of a legend as wide as the figure


class Picture(Figure):
    """A figure that a notebook shows, whether or not pyplot was imported there."""

    def _repr_png_(self) -> bytes:
        """PNG, for notebooks."""
        data = io.BytesIO()
        self.savefig(data, format="png")
        return data.getvalue()


def line_style(k: int) -> dict[str, Any]:
    """Colour and dashes of the k-th of a few bodies, the same in all panels."""
    return {"color": COLOURS[k % len(COLOURS)], "ls": ("-", "--", ":")[k // len(COLOURS) % 3]}


def tints(colours: Sequence[str]) -> Floats:
    """Pale colours (n, 3) of solids, one for each colour of a line."""
    return np.array([0.66 + 0.34 * np.array(mpl.colors.to_rgb(colour)) for colour in colours])


CurveEnd = tuple[float, float, str, str]
"""x and y of the last point of a curve, its name, its colour."""


def viridis(share: Floats) -> Any:
    """Colours, (n, 3) of 0 to 255, of shares from 0 to 1; the scale ends at both."""
    return mpl.colormaps["viridis"](share, bytes=True)[:, :3]


def plain(text: str) -> str:
    """A name or title as it stands: no `$` begins a formula, no `_` keeps it out of a legend."""
    return " " * text.startswith("_") + encodable(text).replace("$", r"\$")


def bare(axes: Axes) -> None:
    """Leave out what carries nothing: the frame at the top and at the right."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def finish_panel(axes: Axes, title: str = "", pad: float | None = None, **settings: Any) -> None:
    """Set the title, the grid and what matplotlib sets: labels, scales, limits, ticks."""
    axes.set(**{k: plain(v) if k in ("xlabel", "ylabel") else v for k, v in settings.items()})
    axes.set_title(plain(title), fontsize=10, loc="left", color=INK, pad=pad)
    axes.grid(color=GRID, lw=0.6)
    bare(axes)


def finish_over_time(axes: Axes, title: str, label: str) -> None:
    """What all panels over time have in common: a legend below the title, values that differ."""
    names = axes.get_legend_handles_labels()[1]
    letters = sum(map(len, names)) + _HANDLE * len(names)
    rows = max(1, math.ceil(letters / (_ROW * axes.get_position().width)))
    low, high = axes.get_ylim()
    if axes.get_yscale() == "linear":
        if high - low < 1e-6 * max(abs(low), abs(high)):
            axes.set_ylim(*sorted((0.0, 2.0 * low)))
        axes.ticklabel_format(axis="y", useOffset=False)  # it would stand over the legend
        label = in_powers(axes.yaxis, axes.get_ylim(), label)
    finish_panel(axes, title, 7 + 11 * rows, xlabel="t [s]", ylabel=label)
    axes.legend(
        fontsize=7.5, ncols=math.ceil(len(names) / rows), loc="lower left",
        bbox_to_anchor=(0.0, 1.0), frameon=False, handlelength=1.4, columnspacing=1.0,
        labelspacing=0.3, borderaxespad=0.2, borderpad=0.0,
    )  # fmt: skip
    axes.locator_params(axis="x", nbins=_TIMES)


def in_powers(axis: Axis, values: Sequence[float], label: str) -> str:
    """Label of an axis: values far from 1 are shown in powers of ten, which its unit has then."""
    power = 3 * int(np.log10(max(np.abs(values).max(), 1e-300)) // 3)
    if abs(power) <= 3 or "[" not in label:
        return label
    axis.set_major_formatter(lambda value, _: f"{value / 10.0**power:.9g}")
    return label.replace("[", f"[1e{power} ")


def finish_view(axes: Axes, title: str, across: str, up: str) -> None:
    """The same of a view of the scene: one scale for both axes, and no grid."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    finish_panel(axes, title, xlabel=across, ylabel=up)
    axes.grid(visible=False)


def cell_edges(places: Floats, is_log: bool) -> Floats:
    """Edges (n + 1,) of cells about n ascending places, two at least, halfway between them."""
    at = np.log(places) if is_log else places
    between = 0.5 * (at[1:] + at[:-1])
    ends = 2.0 * at[[0, -1]] - between[[0, -1]]
    edges = np.concatenate([ends[:1], between, ends[1:]])
    return np.exp(edges) if is_log else edges


def write_beside(axes: Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write at a share x of the width of the panel, and at a value y of its axis."""
    axes.text(x, y, plain(text), transform=axes.get_yaxis_transform(), **style)


def write_inside(axes: Axes, x: float, y: float, text: str, **style: Any) -> None:
    """Write at shares of the width and the height of the panel."""
    axes.text(x, y, text, transform=axes.transAxes, **style)


def name_curves(axes: Axes, ends: Sequence[CurveEnd], x: float, gap: float) -> None:
    """Write names at x beside the ends of curves on a logarithmic axis, `gap` decades apart.

    No line leads to an end whose x is NaN.
    """
    ordered = sorted(ends, key=lambda end: end[1])
    low, high = np.log10(axes.get_ylim())
    lowest, highest = float(low) + 0.3 * gap, float(high) - 0.3 * gap
    levels = _spread_apart(np.log10([end[1] for end in ordered]), gap, lowest, highest)
    for (last, y, name, colour), level in zip(ordered, levels, strict=True):
        line = None if np.isnan(last) else {"arrowstyle": "-", "color": colour, "lw": 0.6}
        at = (x if np.isnan(last) else last, y)
        axes.annotate(name, at, (x, 10.0**level), color=colour, va="center", arrowprops=line)


def _spread_apart(level: Floats, gap: float, lowest: float, highest: float) -> Floats:
    """Ascending levels moved apart to this gap, as far up as down, and between two if they can."""
    if level.size == 0:
        return level
    steps = gap * np.arange(len(level))
    rising = np.maximum.accumulate(level - steps)
    falling = np.minimum.accumulate((level - steps)[::-1])[::-1]
    moved: Floats = np.clip(0.5 * (rising + falling), lowest, max(lowest, highest - steps[-1]))
    return moved + steps
