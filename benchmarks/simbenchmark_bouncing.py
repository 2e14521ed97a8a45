"""Draw the error of the energy in SimBenchmark's bouncing test over the published curves.

    python benchmarks/simbenchmark_bouncing.py [--picture docs/bouncing.png]

Elastic balls of 10 kg fall from 5 m and bounce for 20 s (cases/bouncing.toml). SimBenchmark counts
the mean over time of the squared error of the energy of all 49 balls together, as its figures for
ODE show: 49² (m g h/2)² v²/3 with v = 9.8 m/s, what semi-implicit Euler does in free fall, is
0.0185 J² at h = 1e-5 s. All balls are alike, so one is run here and counts 49 times.

Its data are in tests/reference/simbenchmark_bouncing.csv; where an engine has several solvers, the
best is drawn. Ours is the penalty method with three stiffnesses: the energy of the spring counts.
With 50 to 100 steps in a bounce and more it lies below RaiSim's, whose impact has no duration.
"""

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import numpy as np

import particlerb
from particlerb.studies.charts.style import COLOURS, GRID, INK, bare, name_curves

PUBLISHED = Path(__file__).parents[1] / "tests" / "reference" / "simbenchmark_bouncing.csv"
STEPS = (4e-3, 2e-3, 1e-3, 4e-4, 2e-4, 1e-4, 4e-5, 2e-5, 1e-5)  # s
STIFFNESSES = (1e5, 1e6, 1e7)  # N/m
BALLS = 49  # all alike
LEAST = 10.0  # steps in a bounce


def published() -> dict[str, dict[float, float]]:
    """Smallest error [J²] of each engine at each step [s]."""
    found: dict[str, dict[float, float]] = defaultdict(dict)
    rows = csv.reader(line for line in PUBLISHED.read_text().splitlines() if line[0] != "#")
    for row in rows:
        engine, step, error = row[1], float(row[7]), float(row[8])
        found[engine][step] = min(error, found[engine].get(step, np.inf))
    return found


def ours(stiffness: float, step: float) -> float:
    """Error of all balls with a spring of this stiffness [J²]."""
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": 0.1}, "mass": 10.0}
    contact = {"stiffness": stiffness, "restitution": 1.0, "friction": 0.8}
    case = {
        "run": {"t_end": 20.0, "every": 0.01, "dt": step},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "contact": contact | {"allow_unstable": True},
        "wall": [{"name": "floor", "type": "plane", "normal": [0.0, 0.0, 1.0]}],
        "body": [ball | {"position": [0.0, 0.0, 5.0]}],
    }
    with particlerb.run(case) as run:
        return float(np.mean((BALLS * run.ledger.energy_error) ** 2))


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--picture", type=Path, default=Path("docs/bouncing.png"))
    options = parser.parse_args()
    curves = {}
    for k in STIFFNESSES:
        longest = np.pi * np.sqrt(10.0 / k) / LEAST
        curves[k] = {h: ours(k, h) for h in STEPS if h < longest}
        text = ", ".join(f"{h:g} s: {e:.2g} J²" for h, e in curves[k].items())
        orders = np.diff(np.log(list(curves[k].values()))) / np.diff(np.log(list(curves[k])))
        print(f"  k = {k:.0e} N/m  {text}; order of its root {0.5 * np.mean(orders[-3:]):.2f}")
    draw(curves, options.picture)


def draw(curves: dict[float, dict[float, float]], path: Path) -> None:
    """Draw ours over the published curves."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(9.0, 6.0), layout="constrained")
    ends = []
    for engine, points in published().items():
        steps = sorted(points)
        axes.loglog(steps, [points[h] for h in steps], "o-", color="#999999", lw=1.2, ms=3)
        ends.append((steps[-1], points[steps[-1]], engine, "#666666"))
    axes.set(xlim=(7e-6, 0.9), ylim=(1e-17, 1e11))
    name_curves(axes, ends, 1.5 * ends[0][0], gap=1.4)
    for (k, points), colour in zip(curves.items(), COLOURS, strict=True):
        steps = sorted(points)
        axes.loglog(steps, [points[h] for h in steps], "o-", color=colour, lw=2, label=f"{k:.0e}")
    axes.legend(title="particlerb, stiffness [N/m]", loc="lower right", frameon=False)
    axes.set_xlabel("step [s]")
    axes.set_ylabel("mean squared error of the energy [J²]   (better below)")
    axes.set_title(
        "SimBenchmark's 49 bouncing balls: 24 kJ for 20 s; grey as published",
        loc="left", color=INK, fontsize=12,
    )  # fmt: skip
    axes.grid(color=GRID, lw=0.6)
    bare(axes)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
