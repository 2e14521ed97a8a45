"""NASA check-case 2, the tumbling brick: our error beside that of five published simulations.

Prints the table of docs/nasa_check_case.md and draws docs/nasa_check_case.png. The measure is the
same for all: the largest absolute difference from the exact solution (tests/reference/
nesc_brick.csv, 25 digits) of the three body rates [deg/s], and of yaw, pitch and roll [deg].
Exact differences of zero are drawn at 1e-16.

    python benchmarks/nasa_check_case.py
"""

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import particlerb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HERE = Path(__file__).parents[1]
REFERENCE = HERE / "tests" / "reference"
PICTURE = HERE / "docs" / "nasa_check_case.png"
FLOOR = 1e-16  # where an error of zero is drawn
OURS, THEIRS, INK = "#d55e00", "#7f8c99", "#333333"


def rows_of(name: str) -> list[dict[str, str]]:
    """Rows of a reference, without its comments."""
    lines = (REFERENCE / name).read_text().splitlines()
    return list(csv.DictReader(line for line in lines if line and not line.startswith("#")))


def euler_deg(q: np.ndarray) -> np.ndarray:
    """Yaw, pitch, roll [deg] of quaternions (T, 4), intrinsic z-y-x."""
    w, x, y, z = q.T
    yaw = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    pitch = np.arcsin(2 * (w * y - x * z))
    roll = np.arctan2(2 * (w * x + y * z), w * w - x * x - y * y + z * z)
    return np.degrees(np.stack([yaw, pitch, roll], axis=1))


def our_errors() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times [s], largest differences of the rates [deg/s] and of the angles [deg]."""
    rows = rows_of("nesc_brick.csv")
    t = np.array([float(row["t"]) for row in rows])
    rates = np.array([[float(row[f"w{k}"]) for k in "xyz"] for row in rows])
    q = np.array([[float(row[f"q{k}"]) for k in range(4)] for row in rows])
    with particlerb.run(HERE / "cases" / "tumbling_brick.toml") as brick:
        assert np.allclose(brick.time[1:], t)
        ours, our_rates = brick.orientation[1:, 0], brick.omega_body(0)[1:]
    turned = euler_deg(ours) - euler_deg(q)
    angles = np.abs((turned + 180.0) % 360.0 - 180.0)
    return t, np.degrees(np.abs(our_rates - rates)).max(axis=1), angles.max(axis=1)


def published_errors() -> dict[str, np.ndarray]:
    """Rows (t, rates [deg/s], angles [deg]) of each published simulation."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    for row in rows_of("nesc_case2_sim_errors.csv"):
        errors = (float(row["t"]), float(row["dw_deg_s"]), float(row["da_deg"]))
        found.setdefault(row["sim"], []).append(errors)
    return {sim: np.array(rows) for sim, rows in found.items()}


def print_table(ours: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Table in Markdown: errors at 10 s and 30 s, and the largest of the whole."""
    t, rates, angles = ours
    tables = {f"simulation {sim}": rows for sim, rows in published_errors().items()}
    order = sorted(tables, key=lambda name: -tables[name][-1, 2])
    tables["**particlerb**"] = np.stack([t, rates, angles], axis=1)
    print("| | rates at 10 s | rates at 30 s | attitude at 10 s | attitude at 30 s |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for name in [*order, "**particlerb**"]:
        rows = tables[name]
        at = {time: rows[np.isclose(rows[:, 0], time)][0] for time in (10.0, 30.0)}
        cells = [at[time][k] for k in (1, 2) for time in (10.0, 30.0)]
        print(f"| {name} | " + " | ".join(f"{cell:.1e}" for cell in cells) + " |")


def draw(ours: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    """Two panels, attitude and rates, on one logarithmic axis of errors."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    t, rates, angles = ours
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        "NASA check-case 2, the tumbling brick: distance from the exact solution",
        color=INK,
        fontsize=14,
    )
    panels = figure.subplots(1, 2, sharey=True)
    columns = (("attitude (yaw, pitch, roll) [deg]", 2, angles), ("body rates [deg/s]", 1, rates))
    for axes, (title, column, own) in zip(panels, columns, strict=True):
        ends = {}
        for sim, rows in published_errors().items():
            axes.plot(rows[:, 0], rows[:, column], "o-", ms=4, lw=1.5, color=THEIRS)
            ends[sim] = rows[-1, column]
        label_ends(axes, ends)
        axes.plot(t, np.maximum(own, FLOOR), "o-", ms=4, lw=2.2, color=OURS)
        axes.annotate(
            f"particlerb\n{own[-1]:.0e}",
            (30.0, max(own[-1], FLOOR)),
            (6, 0),
            textcoords="offset points",
            color=OURS,
            weight="bold",
            va="center",
        )
        axes.set_yscale("log")
        axes.set_ylim(3e-17, 30.0)
        axes.set_xlim(0.0, 38.0)
        axes.set_xticks(range(0, 31, 5))
        axes.set_xlabel("time [s]")
        axes.set_title(f"largest error of the {title}", fontsize=11, color=INK)
        axes.grid(axis="y", color="#e4e4e4", lw=0.8)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("error")
    figure.savefig(PICTURE, dpi=130)


def label_ends(axes: "Axes", ends: dict[str, float], least: float = 2.6) -> None:
    """Name each published line at its end; labels keep `least` apart, as a factor."""
    lowest = 0.0
    for sim, value in sorted(ends.items(), key=lambda entry: entry[1]):
        lowest = max(value, lowest * least)
        axes.text(30.7, lowest, f"NASA sim. {sim}", color="#55606b", va="center", fontsize=9)


if __name__ == "__main__":
    errors = our_errors()
    print_table(errors)
    draw(errors)
    print(f"largest of 30 s: rates {errors[1].max():.1e} deg/s, attitude {errors[2].max():.1e} deg")
