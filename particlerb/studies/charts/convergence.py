"""Picture of `converge`: how many particles an error needs, and how smooth the way there is.

Left: error against the total number of particles, every curve named at its end; below it, in a
strip of their own, the sets where only rounding is left. Right: the error of every lattice against
particles per edge, one panel per shape, with the band of neighbouring lattices and the numbers of
particles that some errors need. Nothing is computed here.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import NullFormatter

from particlerb.studies.charts.style import (
    COLOURS,
    INK,
    CurveEnd,
    finish_panel,
    name_curves,
    write_inside,
)
from particlerb.studies.convergence import (
    WANTED,
    Convergence,
    Curve,
    is_confirmed,
    is_exact,
    needed,
    order,
    settled,
    spread,
)

_SMOOTH_COLOUR, _EXACT_COLOUR = COLOURS[0], COLOURS[2]
_CURVED_COLOURS = (COLOURS[1], "#df65b0", "#8c564b", "#b8860b", "#7b3294", "#555555", "#b2182b")
_WIDEST = 60.0  # in units of the largest number of particles: room for names
_NAMES_AT = 1.6  # where names begin, in the same units
_SHORT_CURVE = 0.01  # a curve that ends before this has its name where it ends
_BOTTOM, _LOWEST = 5e-5, 5e-7  # lowest errors shown, left and right
FLOOR = 1e-17  # where an error of 0 is drawn
_FINE_TICK_LABELS = ["0", "$10^{-16}$", "$10^{-14}$", "$10^{-12}$"]


def draw_convergence(convergence: Convergence, path: Path) -> None:
    """Draw a study; as PNG, SVG or PDF, by the suffix of the path."""
    exact = [curve for curve in convergence.curves if is_exact(curve)]
    rough = [curve for curve in convergence.curves if not is_exact(curve)]
    figure = Figure(figsize=(14.5, 8.4), layout="constrained")
    figure.suptitle("How many particles a body needs", color=INK, fontsize=14)
    most = convergence.most
    if not rough:
        _draw_exact(figure.subplots(), exact, most)
    else:
        colours = colours_of(rough)
        left, right = figure.subfigures(1, 2, squeeze=False, wspace=0.02)[0]
        if exact:
            above, below = left.subplots(2, 1, sharex=True, height_ratios=(4.6, 1.4))
            _draw_settled(above, rough, colours, most)
            above.set_xlabel("")
            _draw_exact(below, exact, most)
        else:
            _draw_settled(left.subplots(), rough, colours, most)
        needs = {curve.shape: int(curve.particles[0]) for curve in exact}
        _draw_lattices(right, rough, colours, needs)
    figure.savefig(path, dpi=110)


def colours_of(curves: Sequence[Curve]) -> dict[str, str]:
    """One colour for all that has an order, a tint each for what has none."""
    curved = [curve.shape for curve in curves if math.isnan(order(curve))]
    tints = {name: _CURVED_COLOURS[k % len(_CURVED_COLOURS)] for k, name in enumerate(curved)}
    return {curve.shape: tints.get(curve.shape, _SMOOTH_COLOUR) for curve in curves}


def title(curve: Curve) -> str:
    """Name of a shape, and the order where there is one."""
    name, p = curve.shape.replace("_", " "), order(curve)
    return name if math.isnan(p) else f"{name}, 1/n^{p:.2f}"


def finish(axes: Axes, heading: str = "", **settings: Any) -> None:
    """What all panels have in common."""
    finish_panel(axes, heading, xscale="log", yscale="log", **settings)
    axes.xaxis.set_minor_formatter(NullFormatter())


# Left: error against the total number of particles


def _draw_settled(axes: Axes, curves: Sequence[Curve], colours: dict[str, str], most: int) -> None:
    """The error that neither this set nor any larger one that was tried exceeds."""
    ends = []
    for curve in curves:
        shown = is_confirmed(curve) & (settled(curve) >= _BOTTOM)
        if not shown.any():
            continue
        number, error = curve.particles[shown], settled(curve)[shown]
        style = "steps-post" if math.isnan(order(curve)) else "default"
        axes.plot(number, error, color=colours[curve.shape], lw=1.8, drawstyle=style)
        ends.append((float(number[-1]), float(error[-1]), title(curve), colours[curve.shape]))
    finish(
        axes, "error that no larger lattice exceeds", xlabel="particles in total",
        ylabel="relative error of tensor or com", xlim=(0.7, _WIDEST * most), ylim=(_BOTTOM, 1.0),
    )  # fmt: skip
    _name_ends(axes, ends, most, gap=0.16)
    axes.hlines(WANTED, 1.0, most, color=INK, lw=0.8, ls=":")


def _name_ends(axes: Axes, ends: Sequence[CurveEnd], most: int, gap: float) -> None:
    """Names at the right; those of curves that end early where these end."""
    far = [end for end in ends if end[0] > _SHORT_CURVE * most]
    name_curves(axes, far, _NAMES_AT * most, gap)
    for x, y, name, colour in (end for end in ends if end[0] <= _SHORT_CURVE * most):
        axes.annotate(name, (x, y), (6, 6), textcoords="offset points", color=colour)


def _draw_exact(axes: Axes, curves: Sequence[Curve], most: int) -> None:
    """Sets with the tensor of the solid: a mark with a name, or a line where every n is one."""
    marks = sorted((c for c in curves if len(c.n) == 1), key=lambda curve: curve.particles[0])
    for curve in marks:
        error = max(float(curve.error[0]), FLOOR)
        axes.plot(int(curve.particles[0]), error, "o", color=_EXACT_COLOUR, ms=5)
    if marks:
        names = ", ".join(f"{title(curve)} {int(curve.particles[0])}" for curve in marks)
        write_inside(axes, 0.02, 0.86, f"dots: {names} particles", color=_EXACT_COLOUR)
    cells = [c for c in curves if c.arrangement == "cells"]
    lines = [([c], title(c)) for c in curves if len(c.n) > 1 and c not in cells]
    if cells:
        names = title(cells[0]) if len(cells) == 1 else "curved shapes"
        lines.append((cells, f"cells of {names}"))
    ends = []
    for together, name in lines:
        worst = max(FLOOR, *(float(curve.error.max()) for curve in together))
        first = min(int(curve.particles[0]) for curve in together)
        last = max(int(curve.particles[-1]) for curve in together)
        axes.plot([first, last], [worst, worst], color=_EXACT_COLOUR, lw=1.8)
        ends.append((float(last), worst, name, _EXACT_COLOUR))
    finish(
        axes, "exact sets, lines for any n: only rounding is left", xlabel="particles in total",
        xlim=(0.7, _WIDEST * most), ylim=(FLOOR / 2, 1e-12),
    )  # fmt: skip
    _name_ends(axes, ends, most, gap=0.8)
    axes.set_yticks([FLOOR, 1e-16, 1e-14, 1e-12], _FINE_TICK_LABELS)
    axes.tick_params(axis="y", which="minor", left=False)


# Right: every lattice that was tried, against particles per edge


def _draw_lattices(
    figure: SubFigure, curves: Sequence[Curve], colours: dict[str, str], exact: dict[str, int]
) -> None:
    """One panel per shape, the numbers of particles in it, that of an exact set too."""
    columns = min(3, math.ceil(math.sqrt(len(curves))))
    rows = math.ceil(len(curves) / columns)
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, curve in zip(panels.flat, curves, strict=False):
        _draw_lattice(axes, curve, colours[curve.shape])
        write_inside(axes, 0.03, 0.03, _needs_text(curve, exact.get(curve.shape)), fontsize=7,
                     family="monospace", color=INK, va="bottom", linespacing=1.25)  # fmt: skip
    for axes in panels.flat[len(curves) :]:
        axes.remove()
    title = "each lattice (dots), median and range of neighbouring n (line, band), 1/n² (dotted)"
    figure.suptitle(title, fontsize=10)
    figure.supxlabel("particles per edge, n", fontsize=10)


def _draw_lattice(axes: Axes, curve: Curve, colour: str) -> None:
    """Every error, the band and the median of neighbouring n, and 1/n² to compare with."""
    lowest, median, highest = spread(curve)
    axes.plot(curve.n, curve.n**-2.0, color=INK, lw=0.9, ls=":", zorder=3)
    axes.plot(curve.n, curve.error, ".", color=colour, ms=4, alpha=0.7, mew=0)
    if math.isnan(order(curve)):
        axes.fill_between(curve.n, lowest, highest, color=colour, alpha=0.2, lw=0)
        axes.plot(curve.n, median, color=colour, lw=1.6)
    finish(axes, ylim=(_LOWEST, 1.0))
    write_inside(axes, 0.98, 0.97, title(curve), ha="right", va="top", color=colour)


def _needs_text(curve: Curve, exact: int | None) -> str:
    """Particles for each wanted error, and those of an exact set."""
    rows = [("error", "particles")]
    for wanted in WANTED:
        need = needed(curve, wanted)
        rows.append((f"{wanted:g}", f"{'' if need.is_reached else '> '}{need.particles:,}"))
    if exact is not None:
        rows.append(("exact", f"{exact}"))
    return "\n".join(f"{error:<6}{number:>10}" for error, number in rows).replace(",", " ")
