"""Chart what a tree does to energy and momenta, over its opening angle.

    python benchmarks/tree_drift.py [--bodies 2000] [--steps 400] [--picture docs/tree_drift.png]

A ball of bodies at rest, each of two particles, falls together for a third of its time of collapse
under softened attraction, with strang: summed directly and by trees of ever larger angles. Printed
and drawn are the largest errors of energy, momentum and angular momentum, relative as in the
ledger of a run. Momenta are kept to rounding at any angle, since every pair of cells has one
potential; energy is not, since the tree is another one at each step.
"""

import argparse
import math
from pathlib import Path

import numpy as np

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare, run_prepared
from particlerb.studies.charts.style import COLOURS, GRID, INK, bare

ANGLES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.95)
NAMES = ("energy", "momentum", "angular momentum")


def ball(n: int, steps: int, angle: float | None) -> dict:
    """Case of n bodies of together 1 kg in a ball of 1 m, G = 1."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((n, 3))
    x *= (rng.random(n) ** (1 / 3) / np.linalg.norm(x, axis=1))[:, None]
    end = math.pi / math.sqrt(8.0) / 3.0  # a third of the free fall of the ball
    sums = {"sum": "direct"} if angle is None else {"sum": "tree", "opening_angle": angle}
    shape = {"type": "points", "position": [[0.003, 0, 0], [-0.003, 0, 0]], "mass": 0.5 / n}
    body = {
        "name": "grain", "shape": shape, "count": n, "position": x.tolist(),
        "orientation": "random", "velocity": {"random": 0.1},
    }  # fmt: skip
    return {
        "run": {"t_end": end, "every": end / 20, "dt": end / steps, "seed": 1},
        "attraction": {"G": 1.0, "softening": 0.02} | sums,
        "body": [body],
    }


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--bodies", type=int, default=2000)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--picture", type=Path, default=Path("docs/tree_drift.png"))
    options = parser.parse_args()
    found = {}
    for angle in (None, *ANGLES):
        case = load(ball(options.bodies, options.steps, angle))
        found[angle] = run_prepared(prepare(to_system(case)), None).drift
        label = "direct sum " if angle is None else f"angle {angle:<5.3g}"
        figures = ", ".join(f"{n} {d:.1e}" for n, d in zip(NAMES, found[angle], strict=True))
        print(f"  {label}  {figures}")
    draw(found, options)


def draw(found: dict, options: argparse.Namespace) -> None:
    """Draw the drifts over the angle."""
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        2, 1, figsize=(8.0, 5.4), sharex=True, layout="constrained", height_ratios=(1.6, 1.0)
    )
    for k, (name, colour) in enumerate(zip(NAMES, COLOURS, strict=True)):
        axes = panels[min(k, 1)]
        values = [max(found[angle][k], 1e-18) for angle in ANGLES]
        axes.semilogy(ANGLES, values, "o-", color=colour, lw=2, label=f"{name}, tree")
        direct = max(found[None][k], 1e-18)
        axes.axhline(direct, color=colour, lw=1.2, ls=":", label=f"{name}, direct sum")
    panels[0].set_title(
        f"A tree keeps momenta to rounding at any angle, and energy to its own error\n"
        f"({options.bodies} bodies of two particles, {options.steps} steps of strang)",
        loc="left", color=INK, fontsize=11,
    )  # fmt: skip
    panels[1].set(xlabel="opening angle θ [rad]", ylim=(1e-18, 1e-15))
    for axes in panels:
        axes.legend(fontsize=9, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes.set_ylabel("largest drift, relative")
        axes.grid(color=GRID, lw=0.6)
        bare(axes)
    figure.savefig(options.picture, dpi=110)


if __name__ == "__main__":
    main()
