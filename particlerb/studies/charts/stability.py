"""Pictures of `stability`: where each method fails.

Maps: two per method, over the step and over what the bodies are; a colour for each verdict, named
in the map and in the legend, and lines of equal energy error. Limits: each by its distance from
theory. Drifts: the energy error over long times. Nothing is computed here.
"""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

from particlerb.maths.vec3 import Bools
from particlerb.studies import stability
from particlerb.studies.charts import style
from particlerb.studies.resting_contacts import RATIOS, THEORY
from particlerb.studies.stability_limits import Limit
from particlerb.studies.stability_runs import SMALL, UNSOLVABLE, VERDICTS
from particlerb.studies.stability_table import number

_TINTS: Final = ("#e8f4fb", "#e3c04f", "#7098c4", "#b0540f", "#333333")  # ever darker, of VERDICTS
_PAGE_WIDTH: Final = 10.0  # [in]
_METHODS_PER_ROW: Final = 3
_DPI: Final = 110
MEANING: Final = {
    "accurate": "accurate: energy within 0.1 %, no growth",
    "accurate\nso far,\ngrowing": "accurate so far, but the error grows",
    "bounded\nand wrong": "bounded and wrong: off by more than 0.1 %",
    "growing": "growing: wrong, and more so with time",
    "NaN or\ninfinite": "not solvable: NaN or infinite",
}
"""Of the verdicts: words in a map, and in the legend."""
_ERROR_LEVELS: Final = (-9.0, -6.0, -3.0, -1.0)  # decades of the lines of equal error
_STEPS: Final = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
_START_LABELS: Final = {2.0 / 3.0: "axis\nof I₃", 1.0: "separa-\ntrix", 2.0: "axis\nof I₁"}
FLOOR: Final = 1e-17  # lowest error drawn
_MIN_DRIFT, _MAX_DRIFT = 1e-15, 30.0


def pictures(study: stability.Stability) -> dict[str, Callable[[stability.Stability, Path], None]]:
    """What draws a study, by the end of the name of the file: what is not in it is left out."""
    drawings = {"maps": draw_maps, "limits": draw_limits, "drifts": draw_drifts}
    return {name: draw for name, draw in drawings.items() if getattr(study, name)}


# Maps


def draw_maps(study: stability.Stability, path: Path) -> None:
    """Two maps per method; as PNG, SVG or PDF, by the suffix of the path."""
    methods = list(dict.fromkeys(one.method for one in study.maps))
    down = -(-len(methods) // _METHODS_PER_ROW)
    figure = Figure(figsize=(_PAGE_WIDTH, 3.1 * down + 1.2), layout="constrained")
    turns = f"{study.turns:,.0f}".replace(",", " ")
    figure.suptitle(f"Where each method fails: energy of free bodies over {turns} turns")
    families = list(dict.fromkeys(one.family for one in study.maps))
    cells = figure.subfigures(down, _METHODS_PER_ROW, squeeze=False)
    for k, method in enumerate(methods):
        cell = cells.flat[k]
        heading = f"{method}\n{_headline(study, method)}"
        cell.suptitle(heading, color=style.METHOD_COLOURS[method], fontsize=9.5)
        panels = cell.subplots(1, len(families), sharey=True, squeeze=False)[0]
        maps = [one for one in study.maps if one.method == method]
        for axes, one in zip(panels, maps, strict=True):
            _draw_map(axes, one)
        if stability.is_tolerance(maps[0]):
            panels[0].set_ylabel("tolerance", fontsize=9)
        elif k % _METHODS_PER_ROW == 0:
            panels[0].set_ylabel("h |ω|  [rad per step]", fontsize=9)
        elif k % _METHODS_PER_ROW == _METHODS_PER_ROW - 1:
            _mark_steps_per_turn(panels[-1])
    named = zip(_TINTS, MEANING.values(), strict=True)
    patches = [
        Patch(facecolor=tint, edgecolor=style.INK, lw=0.5, label=text) for tint, text in named
    ]
    figure.legend(handles=patches, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    figure.savefig(path, dpi=_DPI)


def _headline(study: stability.Stability, method: str) -> str:
    """How far a method is accurate, over all its maps."""
    maps = [one for one in study.maps if one.method == method]
    if not maps[0].pace.any():
        return "no step, no limit"
    pace = min(stability.largest_pace(one, SMALL) for one in maps)
    if pace == 0.0:
        return "wrong at every step tried"
    if pace == maps[0].pace[-1]:
        return "within 0.1 % at every step tried"
    what = "tolerance" if stability.is_tolerance(maps[0]) else "h|ω|"
    return f"within 0.1 % up to {what} = {pace:.2g}"


def _draw_map(axes: Axes, map_: stability.Map) -> None:
    """Colours of the verdicts, lines of equal error, names of the regions."""
    columns = np.arange(map_.across.size + 1) - 0.5
    norm = BoundaryNorm(np.arange(len(VERDICTS) + 1) - 0.5, len(VERDICTS))
    is_one = map_.pace.size == 1
    edges = np.array([_STEPS[0], _STEPS[-1]]) if is_one else style.cell_edges(map_.pace, True)
    axes.pcolormesh(columns, edges, map_.verdict, cmap=ListedColormap(_TINTS), norm=norm)
    axes.set_yscale("log")
    if map_.pace.any():
        _draw_levels(axes, map_)
        _name_regions(axes, map_)
    else:
        text = f"closed form:\nno step\n\nworst error\n{map_.error.max():.0e}"
        style.write_inside(axes, 0.5, 0.5, text, ha="center", va="center", fontsize=9)
    _mark_across(axes, map_)
    _mark_pace(axes, map_)


def _draw_levels(axes: Axes, map_: stability.Map) -> None:
    """Lines of equal worst energy error, where it is finite."""
    height = np.log10(np.clip(map_.error, FLOOR, 1e3))
    levels = [level for level in _ERROR_LEVELS if height.min() < level < height.max()]
    if not levels or (map_.verdict == UNSOLVABLE).all():
        return
    lines = axes.contour(
        np.arange(map_.across.size), map_.pace, height, levels=levels, colors=style.INK,
        linewidths=0.7, linestyles="solid",
    )  # fmt: skip
    axes.clabel(lines, fmt=lambda level: f"1e{level:.0f}", fontsize=6.5)


def _name_regions(axes: Axes, map_: stability.Map) -> None:
    """The word of each verdict in the widest place of its region, and how soon all is lost."""
    for k, word in enumerate(MEANING):
        place = widest(map_.verdict == k)
        if place is None:
            continue
        axes.text(
            place[1], map_.pace[place[0]], word, ha="center", va="center", fontsize=8,
            weight="bold", color=_ink_on(k), zorder=5,
            bbox={"facecolor": _TINTS[k], "edgecolor": "none", "alpha": 0.9, "pad": 1.5},
        )  # fmt: skip
    if stability.largest_pace(map_, SMALL) > 0.0 or stability.is_tolerance(map_):
        return
    for row in (map_.pace.size // 10, 5 * map_.pace.size // 6):
        turns, verdict = map_.turns[row], int(map_.verdict[row].max())
        text = f"10 % off after\n{turns.min():.2g} turns\nor more"
        axes.text((map_.across.size - 1) / 2, map_.pace[row], text, ha="center", va="center",
                  fontsize=7.5, color=_ink_on(verdict))  # fmt: skip


def _ink_on(verdict: int) -> str:
    """Colour of words on a tint."""
    return "white" if verdict == UNSOLVABLE else "black"


def widest(region: Bools) -> tuple[int, int] | None:
    """Cell of a region that is furthest from its edge, by peeling off layer after layer.

    Words are wide: a layer takes two cells at the left and right, one above and below. None where
    the first one leaves nothing.
    """
    left = region
    while True:
        room = np.pad(left, ((1, 1), (2, 2)))
        inner = left.copy()
        for row, column in ((0, 2), (2, 2), (1, 0), (1, 1), (1, 3), (1, 4)):
            inner &= room[row : row + left.shape[0], column : column + left.shape[1]]
        if not inner.any():
            break
        left = inner
    if left is region:
        return None
    cells = np.argwhere(left)
    r, c = cells[np.abs(cells - np.median(cells, axis=0)).sum(axis=1).argmin()]
    return int(r), int(c)


def _mark_across(axes: Axes, map_: stability.Map) -> None:
    """What the columns are."""
    axes.xaxis.set_minor_locator(NullLocator())
    x = np.arange(map_.across.size, dtype=float)
    if map_.family == "shape":
        at = [0.0, *np.interp([0.25, 0.5], map_.across[1:], x[1:]), x[-1]]
        axes.set_xticks(at[::3], ["needle", "disc"], fontsize=8)
        axes.set_xlabel("shape: plate\nof sides 1 : b", fontsize=8)
        axes.set_xticks(at[1:3], minor=True)
        return
    at = np.interp(list(_START_LABELS), map_.across, x).tolist()
    axes.set_xticks(at, list(_START_LABELS.values()), fontsize=8)
    axes.axvline(at[1], color=style.INK, lw=0.8, ls=":")
    axes.set_xlabel("start, I = (1, 2, 3)", fontsize=8)


def _mark_pace(axes: Axes, map_: stability.Map) -> None:
    """Ticks of the steps, and of the steps per turn; or of the tolerances."""
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.tick_params(axis="y", labelsize=8)
    if stability.is_tolerance(map_):
        return
    axes.set_ylim(_STEPS[0], _STEPS[-1])
    axes.yaxis.set_major_locator(FixedLocator(_STEPS))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    missing = map_.pace[0] / _STEPS[0] if map_.pace.any() else 1.0
    if missing > 2.0:
        height = 0.5 * math.log(missing) / math.log(_STEPS[-1] / _STEPS[0])
        text = "not run:\nsmall steps\ncost too much"
        style.write_inside(
            axes, 0.5, height, text, ha="center", va="center", fontsize=7, color=style.INK
        )


def _mark_steps_per_turn(axes: Axes) -> None:
    """Steps per turn, at the right."""
    right = axes.secondary_yaxis("right")
    right.set_yticks(_STEPS, [f"{round(2.0 * math.pi / step, 1):.3g}" for step in _STEPS])
    right.yaxis.set_minor_locator(NullLocator())
    right.tick_params(labelsize=8)
    right.set_ylabel("steps per turn", fontsize=9)


# Limits


def draw_limits(study: stability.Stability, path: Path) -> None:
    """Each limit beside theory, and those of resting contact over its damping."""
    on_contacts = [one for one in study.limits if math.isfinite(one.zeta)]
    others = [one for one in study.limits if not math.isfinite(one.zeta)]
    tall = 0.19 * len(others) + 1.0
    below = 2.8 if on_contacts else 0.0
    figure = Figure(figsize=(_PAGE_WIDTH, tall + below), layout="constrained")
    heights = (tall, below) if below else (tall,)
    parts = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    _draw_distances(parts[0].subplots(), others)
    if on_contacts:
        _draw_resting(parts[1].subplots(), on_contacts)
    figure.savefig(path, dpi=_DPI)


def _draw_distances(axes: Axes, limits: Sequence[Limit]) -> None:
    """Each limit: its distance from theory in per cent, and both figures in words."""
    figures: dict[str, Any] = {"va": "center", "family": "monospace", "fontsize": 8.5}
    axes.axvspan(-1.0, 1.0, color="#eef2f6", lw=0)
    axes.axvline(0.0, color=style.INK, lw=0.8)
    for y, limit in zip(range(len(limits), 0, -1), limits, strict=True):
        colour = style.METHOD_COLOURS[limit.method]
        if math.isfinite(limit.theory):
            axes.plot(100.0 * (limit.measured / limit.theory - 1.0), y, "o", color=colour, ms=5)
        name = f"{limit.method}: {limit.name.replace(': largest', ',')}"
        style.write_beside(
            axes, -0.02, y, name, ha="right", va="center", fontsize=8.5, color=colour
        )
        text = f"{number(limit.theory):>12} {number(limit.measured):>12}"
        style.write_beside(axes, 1.02, y, text, **figures)
    heading = f"{'theory':>12} {'measured':>12}"
    style.write_beside(axes, 1.02, len(limits) + 1.0, heading, weight="bold", **figures)
    axes.set(xlim=(-1.3, 1.3), ylim=(0.3, len(limits) + 1.5), yticks=[])
    axes.set_xlabel("measured less theory [%]; shaded: 1 %")
    axes.set_title("limits of the step, and factors per step", loc="left", fontsize=11)
    axes.spines["left"].set_visible(False)
    style.bare(axes)


def _draw_resting(axes: Axes, limits: Sequence[Limit]) -> None:
    """Limits of a body that rests on a contact over its damping: theory as lines, measured dots."""
    style.finish_panel(
        axes, "a ball that rests on the floor: hω above which it oscillates more and more"
        " (line: theory, dots: measured)",
        xlim=(-0.02, 1.35), ylim=(0.0, 3.2), xticks=RATIOS, ylabel="hω",
    )  # fmt: skip
    axes.set_xlabel("damping ratio ζ of the contact")
    ends = []
    for method in dict.fromkeys(one.method for one in limits):
        dots = [one for one in limits if one.method == method]
        colour, zeta = style.METHOD_COLOURS[method], np.linspace(0.0, RATIOS[-1], 101)
        theory = [THEORY[method](ratio) for ratio in zeta.tolist()]
        axes.plot(zeta, theory, color=colour, lw=1.5)
        axes.plot([p.zeta for p in dots], [p.measured for p in dots], "o", color=colour, ms=6)
        ends.append((zeta[-1], theory[-1], method, colour))
    for x, y, text, colour in ends:
        axes.text(x + 0.03, y, text, color=colour, va="top" if "strang" in text else "bottom")


# Drift


def draw_drifts(study: stability.Stability, path: Path) -> None:
    """Energy error against time: one panel per motion."""
    drifts, figure = study.drifts, Figure(figsize=(_PAGE_WIDTH, 10.0), layout="constrained")
    panels = figure.subplots(len(stability.MOTIONS), 1, sharex=True, sharey=True)
    for axes, motion in zip(panels, stability.MOTIONS, strict=True):
        of_motion = [one for one in drifts if one.motion == motion]
        longest = max(one.turns[-1] for one in of_motion)
        style.finish_panel(
            axes, f"{motion}, eight starts: every sample (dots), largest until then (line)",
            xscale="log", yscale="log", xlim=(0.1, 2e4 * longest), ylim=(_MIN_DRIFT, _MAX_DRIFT),
            xticks=[10.0**k for k in range(-1, round(math.log10(longest)) + 1)],
            ylabel="|E/E₀ − 1|",
        )  # fmt: skip
        axes.xaxis.set_minor_locator(NullLocator())
        for drift in of_motion:
            _draw_drift(axes, drift)
        _name_drifts(axes, of_motion)
    panels[-1].set_xlabel("turns; at the ends h|ω|, and p of an error ∝ tᵖ over the last decade")
    figure.savefig(path, dpi=_DPI)


def _draw_drift(axes: Axes, drift: stability.EnergyDrift) -> None:
    """Samples of the worst body, and the running maximum; a cross where it ends early."""
    colour = style.METHOD_COLOURS[drift.method]
    is_finite = np.isfinite(drift.largest)
    turns, worst = drift.turns[is_finite], drift.error.max(axis=1)[is_finite]
    axes.plot(turns, np.maximum(worst, FLOOR), ".", color=colour, ms=2.5, alpha=0.5)
    axes.plot(turns, np.maximum(drift.largest[is_finite], FLOOR), color=colour, lw=1.8)
    if not is_finite.all():
        axes.plot(turns[-1], min(drift.largest[is_finite][-1], _MAX_DRIFT), "X", color=colour, ms=7)


def _name_drifts(axes: Axes, drifts: Sequence[stability.EnergyDrift]) -> None:
    """Names at the ends: how fast the error grows there, or when a curve breaks off (cross)."""
    ends = []
    for drift in drifts:
        colour, is_finite = style.METHOD_COLOURS[drift.method], np.isfinite(drift.largest)
        name = f"{drift.method}, {drift.pace:g}:"
        if is_finite.all():
            level = min(max(float(drift.largest[-1]), _MIN_DRIFT), _MAX_DRIFT)
            text = f"{name} p = {abs(stability.growth_exponent(drift)[0]):.2f}"
            ends.append((float(drift.turns[-1]), level, text, colour))
        else:
            text = f"{name} NaN after {float(f'{drift.turns[is_finite][-1]:.1g}'):g} turns"
            ends.append((math.nan, _MIN_DRIFT, text, colour))
    style.name_curves(axes, ends, 1.6 * max(drift.turns[-1] for drift in drifts), gap=1.2)
