"""Measure contact by impulses beside the penalty law: a thousand clumps that fall into a box.

    python benchmarks/impulses.py [--seeds 5] [--seconds 2] [--longer 4] [--settings 2e-3:5,5e-3:5]
                                  [--record]

The scene is that of cases/clump_drop.toml, with other attitudes for each seed. The penalty law
takes the step and stiffness of that case; impulses take steps [s] with so many sweeps at most. All
advance in turn, a slice of simulated time each, on one thread; times are those of the processor,
without set-up. Overlaps, in radii, are rms over the contacts between clumps at the end, and the
largest: of any slice's end for the penalty law, of any step for impulses. The height is that of the
centre of mass. Each figure is the median over the seeds. `--longer` goes on with impulses to that
time, for the energy that is left. `--record` adds the figures to results/impulses.csv.

Goals at 2 ms with 5 sweeps: half of the time of the penalty law at most, rms overlap 3e-4 R and
0.15 R at most, height 1.45 +- 0.03 m, less than 0.5 J after 4 s.
"""

import argparse

import numpy as np
from clump_drop import RADIUS, SLICE, Ours, drop
from results import record

from particlerb.contact.sphere_search import neighbours
from particlerb.impulses.records import DEEPEST, STEPS, SWEEPS, UNMET

CLUMPS = 1000


def by_impulses(case: dict, dt: float, sweeps: int) -> dict:
    """The same case with contacts that have no stiffness."""
    keys = {name: case["contact"][name] for name in ("restitution", "friction")}
    run = case["run"] | {"dt": dt, "method": "moreau"}
    return case | {"run": run, "contact": {"law": "impulse", "iterations": sweeps} | keys}


def overlaps(points: np.ndarray) -> np.ndarray:
    """Overlaps of spheres (3, 8 n) of different clumps, in radii."""
    n = points.shape[1]
    first, second, _ = neighbours(points, np.full(n, RADIUS), np.arange(n) // 8, 0.0)
    away = np.linalg.norm(points[:, second] - points[:, first], axis=0)
    return (2.0 * RADIUS - away) / RADIUS


class Measured:
    """A run with what it has cost and how deep its contacts were."""

    def __init__(self, case: dict) -> None:
        self.ours, self.seconds, self.peak = Ours(case), 0.0, 0.0

    def advance(self) -> None:
        """Go on for a slice."""
        self.seconds += self.ours.advance(SLICE).processor
        self.depth = overlaps(self.ours.points())
        self.peak = max(self.peak, self.depth.max(initial=0.0))

    def figures(self) -> dict[str, float]:
        """What is compared, now."""
        tally = self.ours.run.group_runs[0].motion.impulse_tally()
        found = {
            "cost [s/s]": self.seconds / self.ours.time,
            "rms overlap [R]": float(np.sqrt((self.depth**2).mean())),
            "largest overlap [R]": self.peak,
            "height [m]": float(self.ours.x[:, 2].mean()),
            "kinetic energy [J]": self.kinetic(),
        }
        if tally.size:
            found["largest overlap [R]"] = tally[DEEPEST] / RADIUS
            found["sweeps a step"] = tally[SWEEPS] / tally[STEPS]
            found["steps above the tolerance"] = tally[UNMET] / tally[STEPS]
        return found

    def kinetic(self) -> float:
        """Of all clumps [J]."""
        run = self.ours.run
        p, L = self.frames[2][0], self.frames[3][0]
        inertia = run.system.bodies.inertia[0, 0]  # a cube of spheres has one moment
        return float(0.5 * ((p * p).sum() + (L * L).sum() / inertia))

    @property
    def frames(self) -> tuple:
        """Arrays of the last frame."""
        return self.ours.run.room


def one_seed(seed: int, settings: list[tuple[float, int]], seconds: float) -> dict:
    """All laws in turn, from one start."""
    case = drop(CLUMPS, seconds)
    case["run"]["seed"] = seed
    runs = {"penalty 1e5, 0.2 ms": Measured(case)}
    for dt, sweeps in settings:
        runs[f"impulse {1e3 * dt:g} ms, {sweeps}"] = Measured(by_impulses(case, dt, sweeps))
    for _ in range(round(seconds / SLICE)):
        for run in runs.values():
            run.advance()
    return runs


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5, help="starts")
    parser.add_argument("--seconds", type=float, default=2.0, help="simulated")
    parser.add_argument("--longer", type=float, default=4.0, help="impulses alone, until then")
    parser.add_argument("--settings", default="2e-3:5", help="steps [s] and sweeps")
    parser.add_argument("--record", action="store_true", help="add to results/impulses.csv")
    options = parser.parse_args()
    pairs = [one.split(":") for one in options.settings.split(",")]
    settings = [(float(dt), int(sweeps)) for dt, sweeps in pairs]
    for case in (drop(CLUMPS, SLICE), by_impulses(drop(CLUMPS, SLICE), 2e-3, 5)):
        Ours(case).advance(SLICE)  # compile what is measured
    found: dict[str, list[dict[str, float]]] = {}
    for seed in range(options.seeds):
        for name, run in one_seed(seed, settings, options.seconds).items():
            figures = run.figures()
            if name.startswith("impulse") and options.longer > options.seconds:
                while run.ours.time < options.longer - 0.5 * SLICE:
                    run.advance()
                figures[f"kinetic energy at {options.longer:g} s [J]"] = run.kinetic()
            found.setdefault(name, []).append(figures)
            print(seed, name, {key: float(f"{x:.3g}") for key, x in figures.items()}, flush=True)
    rows = []
    penalty, *_ = found
    for name, each in found.items():
        for key in each[0]:
            rows.append((f"{name}: {key}", float(np.median([one[key] for one in each]))))
        ratios = [
            a["cost [s/s]"] / b["cost [s/s]"] for a, b in zip(each, found[penalty], strict=True)
        ]
        rows.append((f"{name}: cost over that of the penalty law", float(np.median(ratios))))
    for key, x in rows:
        print(f"{key:<60} {x:10.4g}")
    if options.record:
        record("impulses", rows)


if __name__ == "__main__":
    main()
