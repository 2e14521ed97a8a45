"""Picture of what accuracy costs: error against time, a curve for each method."""

import math
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from particlerb.studies.charts.style import COLOURS, GRID, INK, bare
from particlerb.studies.work_precision import (
    Point,
    WorkPrecision,
    advice,
    cheapest,
    duration,
    frontier,
)

OWN: Final = {
    "exact": "#000000",
    "strang": COLOURS[0],
    "rkn6": COLOURS[1],
    "dop853": COLOURS[2],
    "rk4": "#cc79a7",
    "semi_implicit_euler": "#8c6d31",
    "explicit_euler": "#7f7f7f",
    "momentum_euler": "#b2182b",
}
PEER: Final = "#9aa5b1"
LOST: Final = 2.0 * math.pi  # rad: where runs that failed are put


def draw_chart(chart: WorkPrecision, path: Path) -> None:
    """Draw a chart; the suffix of the path is the format."""
    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    axes = figure.add_subplot()
    axes.set_xscale("log")
    axes.set_yscale("log")
    curves = [(label, list(own)) for label, own in groupby(chart.points, lambda p: p.label)]
    ends = [draw_curve(axes, label, points, chart.floor) for label, points in curves]
    front = frontier(chart.points)
    axes.plot(
        [p.seconds for p in front], [height(p, chart.floor) for p in front],
        color="#ffd54f", lw=7, alpha=0.55, zorder=1, solid_capstyle="round",
    )  # fmt: skip
    limits(axes, chart)
    label_curves(axes, [end for end in ends if end is not None])
    draw_marks(axes, chart)
    bodies = f"{chart.n_bodies} bodies" if chart.n_bodies > 1 else "1 body"
    figure.suptitle(
        f"{chart.title}   ({bodies} to t = {chart.t_end:.6g} s, one thread)",
        color=INK, x=0.01, ha="left", fontsize=12,
    )  # fmt: skip
    axes.set_title(advice(chart), fontsize=11, loc="left", color=INK, fontweight="bold")
    axes.set_xlabel("time in kernels for the whole run [s]   (faster to the left)")
    axes.set_ylabel(f"largest {chart.measure}   (better below)")
    axes.grid(color=GRID, lw=0.6)
    bare(axes)
    figure.savefig(path, dpi=130)


def colour_of(point: Point) -> str:
    """Colour of a curve."""
    return PEER if point.engine else OWN.get(point.method, INK)


def height(point: Point, floor: float) -> float:
    """Where a point stands; those that failed stand at the top, none below the reference."""
    return LOST if point.failure else max(point.size, 0.5 * floor)


def draw_curve(
    axes: Axes, label: str, points: list[Point], floor: float
) -> tuple[float, float, str, str] | None:
    """Draw one curve with its failed points; where its label goes: x, y, text, colour."""
    colour = colour_of(points[0])
    good = [p for p in points if not p.failure]
    failed = [p for p in points if p.failure]
    style = "--" if points[0].engine else "-"
    x, y = [p.seconds for p in good], [height(p, floor) for p in good]
    marker = "D" if len(points) == 1 else "o"
    size = 9 if len(points) == 1 else (3.2 if points[0].engine else 4.5)
    axes.plot(
        x, y, style, marker=marker, ms=size, lw=1.1 if points[0].engine else 1.8, color=colour
    )
    axes.plot(
        [p.seconds for p in failed], [LOST] * len(failed), "x", ms=6, mew=1.4, color=colour,
        clip_on=False,
    )  # fmt: skip
    return (x[-1], y[-1], label, colour) if good else None


def limits(axes: Axes, chart: WorkPrecision) -> None:
    """Room for all points, the floor, and labels at the right."""
    times = [p.seconds for p in chart.points] or [1e-3, 1.0]
    heights = [height(p, chart.floor) for p in chart.points if not p.failure] or [1e-3]
    low = min(*heights, chart.floor, chart.wanted) / 5.0
    axes.set_ylim(max(low, 1e-18), 20.0)
    axes.set_xlim(min(times) / 2.0, max(times) * (30.0 if chart.published else 8.0))


def label_curves(axes: Axes, ends: list[tuple[float, float, str, str]]) -> None:
    """Write the name of each curve at its end; names that would overlap are moved apart."""
    low, high = np.log10(axes.get_ylim())
    left, right = np.log10(axes.get_xlim())
    gap = 0.034 * (high - low)
    placed: list[tuple[float, float]] = []
    for x, y, text, colour in sorted(ends, key=lambda end: end[1]):
        at, level = math.log10(x) + 0.012 * (right - left), math.log10(y)
        width = 0.0115 * (right - left) * len(text)
        while any(abs(level - b) < gap and a < at + width and at < c for a, c, b in boxes(placed)):
            level += 0.25 * gap
        placed += [(at, level), (at + width, level)]
        axes.text(10.0**at, 10.0**level, text, color=colour, fontsize=9, va="center", zorder=5)


def boxes(placed: list[tuple[float, float]]) -> list[tuple[float, float, float]]:
    """Left, right and height of the labels that stand already."""
    return [(a[0], c[0], a[1]) for a, c in zip(placed[::2], placed[1::2], strict=True)]


def together(published: tuple[tuple[str, float], ...]) -> list[tuple[str, float]]:
    """Published errors with those that are close to each other under one name."""
    lines: list[tuple[str, float]] = []
    for name, error in sorted(published, key=lambda one: one[1]):
        if lines and error < 3.0 * lines[-1][1]:
            lines[-1] = (f"{lines[-1][0]}, {name}", error)
        else:
            lines.append((name, error))
    return lines


def draw_marks(axes: Axes, chart: WorkPrecision) -> None:
    """The wanted error, the floor of the reference, published errors, failed runs."""
    along = axes.get_yaxis_transform()
    axes.axhspan(axes.get_ylim()[0], chart.floor, color="#eeeeee", zorder=0)
    axes.text(
        0.995, chart.floor, "the reference is not known better", fontsize=8, color="#777777",
        ha="right", va="top", transform=along,
    )  # fmt: skip
    axes.axhline(chart.wanted, color=INK, lw=0.9, ls=":")
    axes.text(
        0.005, chart.wanted, f"wanted: {chart.wanted:.3g}", fontsize=8, color=INK,
        va="bottom", transform=along,
    )  # fmt: skip
    for names, error in together(chart.published):
        axes.axhline(error, color="#b05020", lw=0.8, ls=(0, (6, 3)), zorder=0)
        axes.text(
            0.995, error, names, fontsize=7.5, color="#b05020", ha="right", va="bottom",
            transform=along,
        )  # fmt: skip
    failed = {p.label for p in chart.points if p.failure}
    throughout = sorted(failed - {p.label for p in chart.points if not p.failure})
    if failed:
        words = f"; at every step: {', '.join(throughout)}" if throughout else ""
        axes.axhline(LOST, color="#cc3333", lw=0.8)
        axes.text(
            0.005, LOST * 1.15, f"× failed: lost, or not finite{words}", fontsize=8,
            color="#cc3333", va="bottom", transform=along,
        )  # fmt: skip
    best = cheapest(chart.points, chart.wanted)
    if best is not None:
        where = best.seconds, height(best, chart.floor)
        axes.plot(*where, "o", ms=13, mfc="none", mec=INK, mew=1.6, zorder=6)
        axes.annotate(
            duration(best.seconds), where, (-9, 8),
            textcoords="offset points", fontsize=9, color=INK, ha="right",
        )  # fmt: skip
