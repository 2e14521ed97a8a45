"""Picture of what accuracy costs: error against time, a curve for each method."""

import math
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from particlerb.compiled.vector_width import processor
from particlerb.maths.vec3 import Floats
from particlerb.studies.charts import style
from particlerb.studies.points import Point, WorkPrecision
from particlerb.studies.work_precision_table import advice, cheapest, frontier
from particlerb.words import count_of

_PEER_COLOUR: Final = "#75808c"
_PEERS: Final = "MuJoCo", "LAMMPS", "PyBullet", "SciPy", "REBOUND", "textbook"
_PEER_MARKS: Final = dict(zip(_PEERS, "s^vPo>", strict=True))  # the same in all charts
_FAILED: Final = 2.0 * math.pi  # rad: where runs that failed are put
_HALO: Final = [withStroke(linewidth=2.5, foreground="white")]
_LETTER, _LINE = 0.0098, 0.034  # width of a letter and height of a label, as shares of a panel
_LABEL_GAP = 0.013  # share of the width between a point and a name
_MARK_REACH: Final = np.array([[-0.006, 0.0], [0.006, 0.0], [0.0, -0.012], [0.0, 0.012]])
"""To the edges of a mark, as shares of a panel."""
_SHORT_HEADING: Final = 80  # letters, beside which the key of the front has room
_SHIFTS: Final = 0.25 * _LINE * np.arange(-16, 17)  # of a name against its point


class _Curve(NamedTuple):
    """What did not fail of a curve, (n, 2) of time and error, with its name and colour."""

    points: Floats
    name: str
    colour: str


class _Place(NamedTuple):
    """Where a name may stand, in shares of the panel."""

    point: tuple[float, float]
    left: float
    right: float
    level: float


def draw_chart(chart: WorkPrecision, path: Path) -> None:
    """Draw a chart; the suffix of the path is the format."""
    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    axes = figure.add_subplot()
    curves = [list(g) for _, g in groupby(chart.points, lambda p: p.label.partition(",")[0])]
    drawn = []
    for points in curves:
        if curve := _draw_curve(axes, points, chart.floor):
            drawn.append(curve)
    front = frontier(chart.points)
    axes.plot(
        [p.seconds for p in front], [height(p, chart.floor) for p in front],
        color="#ffd54f", lw=7, alpha=0.55, zorder=1, solid_capstyle="round",
    )  # fmt: skip
    style.finish_panel(
        axes, xscale="log", yscale="log", **limits(chart, drawn),
        xlabel=f"{chart.clock} in kernels for the whole run [s]   (faster to the left)",
        ylabel=f"largest {chart.measure}   (better below)",
    )  # fmt: skip
    heading = advice(chart)
    axes.set_title(heading, fontsize=11, loc="left", color=style.INK, fontweight="bold")
    below = ["yellow: none of ours is faster and more accurate"] if len(front) > 1 else []
    if below and len(heading) <= _SHORT_HEADING:
        axes.set_title(below.pop(), fontsize=8, loc="right", color="#8a6d00")
    _label_curves(axes, drawn, _mark_levels(axes, chart))
    _mark_failures(axes, chart.points)
    _mark_cheapest(axes, chart)
    bodies = count_of(chart.n_bodies, "body", "bodies")
    how = f"{bodies} to t = {chart.t_end:.6g} s, one thread, {processor()}"
    title = style.plain(f"{chart.title}   ({how})")
    figure.suptitle(title, color=style.INK, x=0.01, ha="left", fontsize=12)
    our_names = style.METHOD_COLOURS.keys()
    absent = [f"{name}: left out, {why}" for name, why in chart.left_out if name not in our_names]
    if words := "\n".join((*below, *chart.notes, *absent)):
        figure.supxlabel(words, fontsize=8, color=_PEER_COLOUR, x=0.01, ha="left")
    figure.savefig(path, dpi=130)


def height(point: Point, floor: float) -> float:
    """Error at which a point is drawn: not below the limit of the reference."""
    return max(point.size, 0.5 * floor)


def _draw_curve(axes: Axes, points: list[Point], floor: float) -> _Curve | None:
    """Draw one curve, of one method at all its steps or springs, crosses for failed points.

    None where all failed.
    """
    first, last = points[0], points[-1]
    method = first.method.partition(",")[0]
    colour = _PEER_COLOUR if first.engine else style.METHOD_COLOURS.get(method, style.INK)
    dashes, size, width = ("--", 3.2, 1.1) if first.engine else ("-", 4.5, 1.8)
    mark = _PEER_MARKS.get(first.engine, "o")
    marker, size = (mark if first.engine else "D", 9) if len(points) == 1 else (mark, size)
    failed = [p.seconds for p in points if p.failure]
    good = [(p.seconds, height(p, floor)) for p in points if not p.failure]
    if failed:  # an empty line would count in the layout
        axes.plot(failed, [_FAILED] * len(failed), "x", ms=6, mew=1.4, color=colour, clip_on=False)
    if not good:
        return None
    x, y = zip(*good, strict=True)
    axes.plot(x, y, dashes, marker=marker, ms=size, lw=width, color=colour)
    end = "" if last.label == first.label else f" to {last.label.partition(', ')[2]}"
    return _Curve(np.array(good), first.label + end, colour)


def limits(chart: WorkPrecision, curves: Sequence[_Curve]) -> dict[str, Any]:
    """Limits of the axes: all points, the limit of the reference, and names at the right."""
    times = [p.seconds for p in chart.points] or [1e-3, 1.0]
    heights = [height(p, chart.floor) for p in chart.points if not p.failure] or [1e-3]
    low, high = min(*heights, chart.target) / 10.0, 10.0 * max(*heights, chart.target)
    is_failed = any(p.failure for p in chart.points)
    left = math.log10(min(times) / 2.0)
    wide = [(math.log10(c.points[-1, 0]) - left) / (0.97 - _LETTER * len(c.name)) for c in curves]
    published = max((len(names) for names, _ in together(chart.published)), default=0)
    wide.append((math.log10(max(times)) - left) / (0.98 - _LETTER * published))
    top = 20.0 if is_failed or not curves else min(high, 20.0)
    return {"ylim": (max(low, 1e-18), top), "xlim": (10.0**left, 10.0 ** (left + max(wide)))}


def _label_curves(axes: Axes, curves: Sequence[_Curve], taken: list[_Place]) -> None:
    """Write the name of each curve at one of its points, on no line and no other text if it can.

    The end is preferred to other points, and the height of the point to others.
    """
    to_share = axes.transScale + axes.transLimits
    shares = [to_share.transform(curve.points) for curve in curves]
    levels = [np.array([[0.0, label.point[1]], [1.0, label.point[1]]]) for label in taken]
    marks = [points + edge for points in shares for edge in _MARK_REACH]
    drawn = np.concatenate([*map(_along, (*shares, *levels)), *marks])

    def cost(place: _Place, is_end: bool) -> float:
        above = place.level + 0.5 * _LINE > drawn[:, 1]
        is_under = above & (drawn[:, 1] > place.level - 0.5 * _LINE)
        is_under &= (drawn[:, 0] > place.left) & (drawn[:, 0] < place.right)
        is_out = not 0.01 < place.level < 0.97 or place.left < 0.005 or place.right > 0.995
        overlaps = sum(_overlap(place, other) for other in taken)
        crossed = 3.0 * bool(is_under.any()) + 0.1 * float(is_under.sum())
        moved = 30.0 * abs(place.level - place.point[1])
        return 1e3 * (overlaps + is_out) + crossed + moved + 1.5 * (not is_end)

    for curve, points in sorted(
        zip(curves, shares, strict=True), key=lambda one: float(one[0].points[-1, 1])
    ):
        tried = [
            (place, k == len(points) - 1)
            for k, point in enumerate(points)
            for place in _places(point, curve.name)
        ]
        best = min(tried, key=lambda one: cost(*one))[0]
        taken.append(best)
        is_far = abs(best.level - best.point[1]) > 0.5 * _LINE
        line = {"arrowstyle": "-", "color": curve.colour, "lw": 0.6} if is_far else None
        is_left = best.right < best.point[0]
        at = (best.right if is_left else best.left, best.level)
        axes.annotate(
            curve.name, best.point, at, "axes fraction", color=curve.colour, fontsize=9,
            va="center", ha="right" if is_left else "left", zorder=5, arrowprops=line,
            path_effects=_HALO,
        )  # fmt: skip


def _places(point: Floats, name: str) -> list[_Place]:
    """Where a name may stand beside a point: right or left of it, at many heights."""
    (x, y), width = point.tolist(), 0.005 + _LETTER * len(name)
    sides = (x + _LABEL_GAP, x - _LABEL_GAP - width)
    return [_Place((x, y), left, left + width, y + d) for left in sides for d in _SHIFTS.tolist()]


def _overlap(text: _Place, other: _Place) -> bool:
    """Whether two texts cover each other."""
    is_level = abs(text.level - other.level) < _LINE
    return is_level and text.left < other.right and other.left < text.right


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


def _mark_levels(axes: Axes, chart: WorkPrecision) -> list[_Place]:
    """Mark the target error, the limit of the reference, and published errors; where words stand.

    No name of a curve stands on their lines either.
    """
    low, taken = axes.get_ylim()[0], []
    height_of = (axes.transScale + axes.transLimits).transform

    def took(level: float, text: str, is_right: bool) -> None:
        width, y = 0.9 * _LETTER * len(text), float(height_of((1.0, level))[1])
        left = 0.995 - width if is_right else 0.005
        taken.append(_Place((left, y), left, left + width, y + 0.5 * _LINE))

    if chart.floor > low:
        axes.axhspan(low, chart.floor, color="#eeeeee", zorder=0)
        words = "below the limit of the reference"
        style.write_inside(axes, 0.995, 0.008, words, fontsize=8, color="#777777", ha="right")
        took(low, words, True)
    axes.axhline(chart.target, color=style.INK, lw=0.9, ls=":")
    words = f"target: {chart.target:.3g}"
    style.write_beside(axes, 0.005, chart.target, words, fontsize=8, color=style.INK, va="bottom")
    took(chart.target, words, False)
    for names, error in together(chart.published):
        axes.axhline(error, color="#b05020", lw=0.8, ls=(0, (6, 3)), zorder=0)
        style.write_beside(axes, 0.995, error, names, fontsize=7.5, color="#b05020", ha="right",
                     va="bottom")  # fmt: skip
        took(error, names, True)
    return taken


def _mark_failures(axes: Axes, points: Sequence[Point]) -> None:
    """Draw the line of failed runs, with the names of what fails at some or at all steps."""
    failed, good = ({p.label for p in points if bool(p.failure) is bad} for bad in (True, False))
    if not failed:
        return
    axes.axhline(_FAILED, color="#cc3333", lw=0.8)
    text = "× failed: error above 1, or NaN"
    for when, names in (("some steps", failed & good), ("every step", failed - good)):
        text += f"; at {when}: {', '.join(sorted(names))}" if names else ""
    style.write_beside(axes, 0.005, _FAILED * 1.4, text, fontsize=8, color="#cc3333", va="bottom")


def _mark_cheapest(axes: Axes, chart: WorkPrecision) -> None:
    """Circle the cheapest run that reaches the target error."""
    best = cheapest(chart.points, chart.target)
    if best is None:
        return
    where = best.seconds, height(best, chart.floor)
    axes.plot(*where, "o", ms=13, mfc="none", mec=style.INK, mew=1.6, zorder=6)
