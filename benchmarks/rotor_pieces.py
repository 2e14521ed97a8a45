"""Chart what cutting the drifts of rkn6 gains and costs: error against time.

    python benchmarks/rotor_pieces.py [--keep points.json] [--draw docs/rotor_pieces.png]

Drifts of asymmetric bodies are cut into maps that turn by at most LONGEST_PIECE, and take at most
LARGEST_SHARE of the step (particlerb/rotors/moser_veselov.py). For each pair of these, in a process
of its own, 64 bodies of each of seven kinds turn on a held tip for some 30 rad; steps turn the
fastest by 6 to 0.4 rad. Printed is, for each wanted error, the least time over that of the best
pair, as a geometric mean over the kinds: of the longest step from which on all errors are small
enough; and the largest growth of the error where the step shrinks by a sixth. `--points` takes what
`--keep` has written in place of measuring.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

RULES = ((0.8, 1.0), (0.45, 1.0), (0.25, 1.0), (0.8, 0.3), (0.6, 0.25), (0.45, 0.3))  # rad, share
TAKEN = (0.8, 0.3)
KINDS = {  # principal moments, and spins about the body's z axis [rad/s]
    "tops, slow": ((1.0, 1.2, 0.6), (1.0, 3.0)),
    "tops, 1 to 10": ((1.0, 1.2, 0.6), (1.0, 10.0)),
    "tops, fast": ((1.0, 1.2, 0.6), (10.0, 30.0)),
    "bricks": ((1.0, 2.0, 2.5), (2.0, 6.0)),
    "nearly symmetric": ((1.0, 1.001, 0.5), (2.0, 6.0)),
    "needles": ((1.0, 1.015, 0.02), (2.0, 6.0)),
    "plates": ((1.0, 1.2, 2.199), (2.0, 6.0)),
}
TURNS = 6.0 * 2.0 ** (-0.25 * np.arange(17))  # rad of the fastest body in a step
WANTED = 10.0 ** -np.arange(3.0, 10.0)  # rad
DRAWN = ("tops, fast", "tops, 1 to 10", "tops, slow", "plates")
REPEATS = 9
N_BODIES = 64


def bodies_on_tips(kind: str) -> dict:
    """Case of tilted bodies under a weight at a distance of 1 m from the tip."""
    inertia, (slow, fast) = KINDS[kind]
    random = np.random.default_rng(3)
    tilt, spin = random.uniform(0.1, 2.0, N_BODIES), random.uniform(slow, fast, N_BODIES)
    zero = np.zeros(N_BODIES)
    turn = np.stack([np.cos(tilt / 2), np.sin(tilt / 2), zero, zero], axis=1)
    y, z = 0.2 * spin, spin  # body axes; the world's after the tilt about x
    c, s = np.cos(tilt), np.sin(tilt)
    rates = np.stack([0.3 * spin, c * y - s * z, s * y + c * z], axis=1)
    t_end = 60.0 / (slow + fast)
    return {
        "title": kind,
        "run": {"t_end": t_end, "every": t_end},
        "body": [
            {
                "name": "top",
                "shape": {"type": "moments", "inertia": list(inertia)},
                "mass": 1.0,
                "count": N_BODIES,
                "place": {"type": "grid", "spacing": 3.0},
                "orientation": turn.tolist(),
                "angular_velocity": rates.tolist(),
            }
        ],
        "force": [
            {"type": "push", "body": "top", "at": [0.0, 0.0, 1.0], "force": [0.0, 0.0, -1.0]},
            {"type": "push", "body": "top", "force": [0.0, 0.0, 1.0]},
        ],
    }


def measured(rule: tuple[float, float]) -> dict[str, list[tuple[float, float, float]]]:
    """Turn of a step [rad], least time [s] and worst error [rad] of each kind; in this process."""
    from particlerb.rotors import moser_veselov

    moser_veselov.LONGEST_PIECE, moser_veselov.LARGEST_SHARE = rule  # before anything is compiled
    from particlerb.case.to_system import to_system
    from particlerb.compiled.threads import THREADS
    from particlerb.simulation.trials import errors, part, seconds, states_at
    from particlerb.studies.work_precision import Study

    THREADS.use(1)
    found: dict[str, list[tuple[float, float, float]]] = {}
    for kind in KINDS:
        study = Study(to_system(bodies_on_tips(kind)), 2.0)
        everyone = np.arange(N_BODIES)
        oracle = part(study.system, study.plan("dop853", 1e-14), everyone)
        true = states_at(oracle, study.times[-1:])[0]
        found[kind] = []
        for turn in TURNS:
            plan = study.plan("rkn6", turn / study.rate)
            own = part(study.system, plan, everyone)
            error = errors(own, states_at(own, study.times[-1:])[0], true)[-1].worst
            spent = min(seconds(own, study.system.run.t_end) for _ in range(REPEATS))
            found[kind].append((float(turn), spent, error))
    return found


def in_a_process(rule: tuple[float, float]) -> dict[str, list[tuple[float, float, float]]]:
    """The same with kernels compiled for this rule."""
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, __file__, "--one", *map(str, rule)],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
            check=True,
        )
    result: dict[str, list[tuple[float, float, float]]] = json.loads(done.stdout.splitlines()[-1])
    return result


def least(points: list[tuple[float, float, float]], wanted: float) -> float:
    """Least time of the steps from which on all errors are small enough [s]; NaN: none."""
    best = np.nan
    for _, spent, error in reversed(points):
        if not error <= wanted:
            break
        best = np.fmin(best, spent)
    return float(best)


def growth(points: list[tuple[float, float, float]]) -> float:
    """Largest factor of the error from a step to the next shorter one, between 1e-2 and 1e-11."""
    sizes = np.array([error for _, _, error in points])
    within = (sizes[1:] > 1e-11) & (sizes[:-1] < 1e-2)
    return float((sizes[1:] / sizes[:-1])[within].max())


def words(rule: tuple[float, float]) -> str:
    """A rule as one would say it."""
    share = f" and {rule[1]:g} of the step" if rule[1] < 1.0 else ""
    return f"{rule[0]:g} rad{share}"


def draw(found: dict[tuple[float, float], dict], path: Path) -> None:
    """Error against time, a panel for each kind and a curve for each rule."""
    from matplotlib.figure import Figure

    colours = {(0.8, 1.0): "#d55e00", (0.45, 1.0): "#0072b2", (0.25, 1.0): "#999999"}
    figure = Figure(figsize=(13.0, 4.6), layout="constrained")
    panels = figure.subplots(1, len(DRAWN), sharey=True)
    for axes, kind in zip(panels, DRAWN, strict=True):
        for rule, colour in {**colours, TAKEN: "#009e73"}.items():
            _, spent, error = np.array(found[rule][kind]).T
            width = 2.6 if rule == TAKEN else 1.3
            label = words(rule) + (" (taken)" if rule == TAKEN else "")
            axes.loglog(1e3 * spent, error, "o-", ms=3.5, lw=width, color=colour, label=label)
        axes.set_title(kind, fontsize=11)
        axes.set_xticks([0.2, 0.3, 0.5, 1.0], ["0.2", "0.3", "0.5", "1"])
        axes.set_xticks([], minor=True)
        axes.grid(color="#dddddd", lw=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("largest orientation error [rad]   (better below)")
    panels[0].legend(fontsize=9, frameon=False, loc="lower left")
    figure.supxlabel("time of the run [ms]   (faster to the left)", fontsize=10)
    title = "rkn6 on asymmetric bodies: how far one Moser-Veselov map may turn"
    figure.suptitle(title, x=0.01, ha="left")
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--one", type=float, nargs=2, help="one rule, in this process; JSON")
    parser.add_argument("--draw", type=Path, help="picture to write")
    parser.add_argument("--keep", type=Path, help="JSON file of all points to write")
    parser.add_argument("--points", type=Path, help="such a file to read")
    options = parser.parse_args()
    if options.one is not None:
        print(json.dumps(measured(tuple(options.one))))
        return
    if options.points:
        read = json.loads(options.points.read_text())
        found = {rule: read[words(rule)] for rule in RULES}
    else:
        found = {rule: in_a_process(rule) for rule in RULES}
    if options.keep:
        options.keep.write_text(json.dumps({words(rule): own for rule, own in found.items()}))
    if options.draw:
        draw(found, options.draw)
    times = np.array([[[least(f[k], w) for w in WANTED] for k in KINDS] for f in found.values()])
    ratios = times / np.nanmin(times, axis=0)
    heading = "  ".join(f"{wanted:.0e}" for wanted in WANTED)
    print(f"{'maps of at most':28}  {heading}   mean  growth")
    for rule, own in zip(RULES, ratios, strict=True):
        means = np.exp(np.nanmean(np.log(own), axis=0))
        row = "  ".join(f"{mean:5.2f}" for mean in means)
        worst = max(growth(points) for points in found[rule].values())
        print(f"{words(rule):28}  {row}  {np.exp(np.nanmean(np.log(own))):5.2f}  {worst:6.1f}")


if __name__ == "__main__":
    main()
