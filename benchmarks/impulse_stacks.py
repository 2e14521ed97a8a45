"""Let stacks of boxes without stiffness stand for a minute, and measure how far they move.

    python benchmarks/impulse_stacks.py [--seconds 60] [--only "10 boxes,.."] [--record]

A box is eight balls on the corners of a cube of 0.4 m, as in cases/stack.toml; the step is 5 ms,
the tolerance 1e-9. «1e4 on n» has a box of 1e4 times the mass on top of n. Rows: the largest move
of any box since the start, over its side, in frames 0.1 s apart; the largest residual; in how many
steps it was above the tolerance; sweeps and Newton's iterations a step; time of the processor, with
set-up, after a short run that compiles. Asked for is a move below 1e-3. `--record` adds the figures
to results/impulse_stacks.csv.
"""

import argparse
import time

import numpy as np
from results import record

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.impulses.records import NEWTON_STEPS, STEPS, SWEEPS, UNMET, WORST_EVER
from particlerb.simulation.run import prepare, run_prepared

SIDE, RADIUS, MASS = 0.4, 0.1, 0.125  # m, m, kg of a ball
CORNERS = (RADIUS * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)).tolist()
STACKS = {  # masses from below, in those of a box
    "10 boxes": [1.0] * 10,
    "30 boxes": [1.0] * 30,
    "1e4 on 1": [1.0, 1e4],
    "1e4 on 10": [1.0] * 10 + [1e4],
}


def scene(masses: list[float], seconds: float) -> dict:
    """A stack."""
    bodies = [
        {
            "name": f"box{i}",
            "shape": {"type": "points", "mass": MASS * m, "radius": RADIUS, "position": CORNERS},
            "position": [0.0, 0.0, (i + 0.5) * SIDE],
        }
        for i, m in enumerate(masses)
    ]
    law = {"law": "impulse", "restitution": 0.0, "friction": 0.5, "tolerance": 1e-9}
    return {
        "run": {"t_end": seconds, "every": min(0.1, seconds), "dt": 5e-3, "threads": 1},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "contact": law,
        "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
        "body": bodies,
    }


def found_in(masses: list[float], seconds: float) -> dict[str, float]:
    """Figures of a stack."""
    start = time.process_time()
    outcome = run_prepared(prepare(to_system(load(scene(masses, seconds)))), None)
    spent = time.process_time() - start
    with particlerb.Trajectory(outcome.file) as t:
        x = t.position
    tally = outcome.tally
    return {
        "largest move over the side": float(np.linalg.norm(x - x[0], axis=2).max() / SIDE),
        "largest residual": tally[WORST_EVER],
        "steps above the tolerance": tally[UNMET],
        "sweeps a step": tally[SWEEPS] / tally[STEPS],
        "iterations of Newton's method a step": tally[NEWTON_STEPS] / tally[STEPS],
        "time of the processor s": spent,
    }


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=60.0, help="simulated")
    parser.add_argument("--only", default=",".join(STACKS), help="names of stacks")
    parser.add_argument("--record", action="store_true", help="add to results/impulse_stacks.csv")
    options = parser.parse_args()
    found_in([1.0], 0.01)  # compiles
    rows = []
    for name in options.only.split(","):
        for key, value in found_in(STACKS[name], options.seconds).items():
            rows.append((f"{name}, {options.seconds:g} s: {key}", float(value)))
            print(f"{rows[-1][0]:<60} {value:10.4g}", flush=True)
    if options.record:
        record("impulse_stacks", rows)


if __name__ == "__main__":
    main()
