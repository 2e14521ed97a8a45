"""Picture of what accuracy costs: error against time, a curve for each method."""

import math
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from particlerb.compiled.vector_width import processor
from particlerb.maths.vec3 import Floats
from particlerb.studies.charts.style import (
    INK,
    METHOD_COLOURS,
    CurveEnd,
    finish_panel,
    write_beside,
)
from particlerb.studies.points import Point, WorkPrecision
from particlerb.studies.text import count_of
from particlerb.studies.work_precision_table import advice, cheapest, frontier

_PEER: Final = "#75808c"
_PEER_MARKS: Final = "s^vPX<>p"  # one for each engine
_LOST: Final = 2.0 * math.pi  # rad: where runs that failed are put
_HALO: Final = [withStroke(linewidth=2.5, foreground="white")]
_LETTER, _LINE = 0.0098, 0.034  # width of a letter and height of a label, as shares of a panel


def draw_chart(chart: WorkPrecision, path: Path) -> None:
    """Draw a chart; the suffix of the path is the format."""
    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    axes = figure.add_subplot()
    curves = [list(own) for _, own in groupby(chart.points, lambda p: p.label)]
    engines = list(dict.fromkeys(p.engine for p in chart.points if p.engine))
    ends = []
    for points in curves:
        mark = _PEER_MARKS[engines.index(points[0].engine)] if points[0].engine else "o"
        if end := _draw_curve(axes, points, chart.floor, mark):
            ends.append(end)
    front = frontier(chart.points)
    axes.plot(
        [p.seconds for p in front], [height(p, chart.floor) for p in front],
        color="#ffd54f", lw=7, alpha=0.55, zorder=1, solid_capstyle="round",
    )  # fmt: skip
    finish_panel(
        axes, xscale="log", yscale="log", **limits(chart, ends),
        xlabel=f"{chart.clock} in kernels for the whole run [s]   (faster to the left)",
        ylabel=f"largest {chart.measure}   (better below)",
    )  # fmt: skip
    axes.set_title(advice(chart), fontsize=11, loc="left", color=INK, fontweight="bold")
    _label_curves(axes, ends)
    _mark_levels(axes, chart)
    _mark_failures(axes, chart.points)
    _mark_cheapest(axes, chart)
    bodies = count_of(chart.n_bodies, "body", "bodies")
    figure.suptitle(
        f"{chart.title}   ({bodies} to t = {chart.t_end:.6g} s, one thread, {processor()})",
        color=INK, x=0.01, ha="left", fontsize=12,
    )  # fmt: skip
    own = METHOD_COLOURS.keys()
    absent = [f"{name}: left out, {why}" for name, why in chart.left_out if name not in own]
    if words := "\n".join((*chart.notes, *absent)):
        figure.supxlabel(words, fontsize=8, color=_PEER, x=0.01, ha="left")
    figure.savefig(path, dpi=130)


def height(point: Point, floor: float) -> float:
    """Error at which a point is drawn: not below the limit of the reference."""
    return max(point.size, 0.5 * floor)


def _draw_curve(axes: Axes, points: list[Point], floor: float, mark: str) -> CurveEnd | None:
    """Draw one curve, crosses for failed points; None where all failed."""
    first = points[0]
    colour = _PEER if first.engine else METHOD_COLOURS.get(first.method, INK)
    style, size, width = ("--", 3.2, 1.1) if first.engine else ("-", 4.5, 1.8)
    marker, size = ("D", 9) if len(points) == 1 else (mark, size)
    failed = [p.seconds for p in points if p.failure]
    good = [(p.seconds, height(p, floor)) for p in points if not p.failure]
    if failed:  # an empty line would count in the layout
        axes.plot(failed, [_LOST] * len(failed), "x", ms=6, mew=1.4, color=colour, clip_on=False)
    if not good:
        return None
    x, y = zip(*good, strict=True)
    axes.plot(x, y, style, marker=marker, ms=size, lw=width, color=colour)
    return x[-1], y[-1], first.label, colour


def limits(chart: WorkPrecision, ends: Sequence[CurveEnd]) -> dict[str, Any]:
    """Limits of the axes: all points, the limit of the reference, and names at the right."""
    times = [p.seconds for p in chart.points] or [1e-3, 1.0]
    heights = [height(p, chart.floor) for p in chart.points if not p.failure] or [1e-3]
    low = min(*heights, chart.target) / 10.0
    left = math.log10(min(times) / 2.0)
    wide = [(math.log10(x) - left) / (0.97 - _LETTER * len(name)) for x, _, name, _ in ends]
    published = max((len(names) for names, _ in together(chart.published)), default=0)
    wide.append((math.log10(max(times)) - left) / (0.98 - _LETTER * published))
    return {"ylim": (max(low, 1e-18), 20.0), "xlim": (10.0**left, 10.0 ** (left + max(wide)))}


def _label_curves(axes: Axes, ends: list[CurveEnd]) -> None:
    """Write the name of each curve at its end, where it covers the fewest curves and no name."""
    to_share = axes.transScale + axes.transLimits
    drawn = np.concatenate([_along(to_share.transform(line.get_xydata())) for line in axes.lines])
    boxes: list[tuple[float, float, float]] = []  # left, right and height of each label
    for x, y, text, colour in sorted(ends, key=lambda end: end[1]):
        at, level = to_share.transform((x, y))
        left, right = at + 0.013, at + 0.018 + _LETTER * len(text)

        def cost(shift: float, left: float = left, right: float = right, y: float = level) -> float:
            named = sum(abs(y + shift - b) < _LINE and a < right and left < c for a, c, b in boxes)
            is_under = (drawn[:, 0] > left) & (drawn[:, 0] < right)
            is_under &= abs(drawn[:, 1] - y - shift) < 0.5 * _LINE
            is_out = not 0.01 < y + shift < 0.95
            return float(1e3 * (named + is_out) + 0.1 * is_under.sum() + 30.0 * abs(shift))

        shift = min(0.25 * _LINE * np.arange(-16, 17), key=cost)
        boxes.append((left, right, level + shift))
        line = {"arrowstyle": "-", "color": colour, "lw": 0.6} if abs(shift) > 0.5 * _LINE else None
        axes.annotate(
            text, (at, level), (left, level + shift), "axes fraction", color=colour, fontsize=9,
            va="center", zorder=5, arrowprops=line, path_effects=_HALO,
        )  # fmt: skip


def _along(points: Floats) -> Floats:
    """Points on a curve, 50 on each stretch."""
    share = np.linspace(0.0, 1.0, 50, endpoint=False)[:, None, None]
    between = points[:-1] + share * (points[1:] - points[:-1])
    return np.concatenate([between.reshape(-1, 2), points[-1:]])


def together(published: tuple[tuple[str, float], ...]) -> list[tuple[str, float]]:
    """Published errors with those that are close to each other under one name."""
    lines: list[tuple[str, float]] = []
    for name, error in sorted(published, key=lambda one: one[1]):
        if lines and error < 3.0 * lines[-1][1]:
            lines[-1] = (f"{lines[-1][0]}, {name}", error)
        else:
            lines.append((name, error))
    return lines


def _mark_levels(axes: Axes, chart: WorkPrecision) -> None:
    """Mark the target error, the limit of the reference, and published errors."""
    low = axes.get_ylim()[0]
    if chart.floor > low:
        axes.axhspan(low, chart.floor, color="#eeeeee", zorder=0)
        write_beside(axes, 0.995, chart.floor, "limit of the reference", fontsize=8,
                     color="#777777", ha="right", va="top")  # fmt: skip
    axes.axhline(chart.target, color=INK, lw=0.9, ls=":")
    write_beside(axes, 0.005, chart.target, f"target: {chart.target:.3g}", fontsize=8, color=INK,
                 va="bottom")  # fmt: skip
    for names, error in together(chart.published):
        axes.axhline(error, color="#b05020", lw=0.8, ls=(0, (6, 3)), zorder=0)
        write_beside(axes, 0.995, error, names, fontsize=7.5, color="#b05020", ha="right",
                     va="bottom")  # fmt: skip


def _mark_failures(axes: Axes, points: Sequence[Point]) -> None:
    """Draw the line of failed runs, with the names of methods that always fail."""
    failed = {p.label for p in points if p.failure}
    if not failed:
        return
    throughout = sorted(failed - {p.label for p in points if not p.failure})
    words = f"; at every step: {', '.join(throughout)}" if throughout else ""
    axes.axhline(_LOST, color="#cc3333", lw=0.8)
    write_beside(axes, 0.005, _LOST * 1.15, f"× failed: error above 1, or NaN{words}", fontsize=8,
                 color="#cc3333", va="bottom")  # fmt: skip


def _mark_cheapest(axes: Axes, chart: WorkPrecision) -> None:
    """Circle the cheapest run that reaches the target error."""
    best = cheapest(chart.points, chart.target)
    if best is None:
        return
    where = best.seconds, height(best, chart.floor)
    axes.plot(*where, "o", ms=13, mfc="none", mec=INK, mew=1.6, zorder=6)
