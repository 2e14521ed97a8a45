"""Measure particlerb beside other engines on the same bodies, at the same error.

    python benchmarks/against_peers.py [--budget 240] [--engines mujoco,scipy] [--record]

Four scenes: one free body near its intermediate axis (t = 100), 1000 free bodies (t = 10), 1000
heavy tops of different tilt and spin (t = 10), symmetric ones and asymmetric ones. Each engine
runs its ladder of steps or tolerances (benchmarks/peers); what counts is its least time with a
worst orientation error below the wanted one, beside ours in the same run, one thread. Times are
those of the stepping loops: for ours the time in kernels, set-up of the motion included. For the
single body the closed form is also measured in a batch of 100 000 such bodies, since a call of a
kernel from Python costs more than one body does. Of tops, the time of what `run.accuracy`
does is printed too: the search and the motion, Python included, and not the plan. `--record` adds
the figures to results/peers.csv, `--scenes " symmetric"` runs those with this in their title,
`--methods exact` those methods of ours.

Goals: one body 1000 times the best peer at 1e-6 rad; 1000 free bodies 50 times SciPy DOP853 and
500 times MuJoCo RK4 at 1e-6; 1000 asymmetric tops 10 times SciPy and 50 times MuJoCo RK4 at 1e-6,
20 times every engine at 1e-3; 1000 symmetric tops 50 times SciPy at 1e-6, 20 times as asked.
"""

import argparse
import math
import time

import numpy as np
from results import record

from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.model.system import System
from particlerb.plan.make_plan import make_plan
from particlerb.plan.time_step import stepped_by
from particlerb.simulation.accuracy import search
from particlerb.simulation.trials import part, seconds, states_at
from particlerb.studies.chart import chart
from particlerb.studies.points import Point, WorkPrecision
from particlerb.studies.work_precision import Study

ENGINES = ("mujoco", "lammps", "pybullet", "scipy", "rebound")


def one_body(count: int = 1) -> dict:
    """Free bodies that spin about the intermediate axis, nearly."""
    rows = np.tile([1e-3, 1.0, 1e-3], (count, 1))
    return {
        "title": "one free body near its intermediate axis",
        "run": {"t_end": 100.0, "every": 100.0},
        "body": [
            {
                "name": "handle",
                "shape": {"type": "moments", "inertia": [1.0, 2.0, 3.0]},
                "mass": 1.0,
                "count": count,
                "position": np.zeros((count, 3)).tolist() if count > 1 else [0, 0, 0],
                "angular_velocity": rows.tolist() if count > 1 else rows[0].tolist(),
            }
        ],
    }


def free_bodies(n: int = 1000) -> dict:
    """Bodies of one asymmetric kind with random orientation and spin of about 1 rad/s."""
    random = np.random.default_rng(1)
    omega = random.normal(size=(n, 3))
    omega *= random.uniform(0.5, 1.0, (n, 1)) / np.linalg.norm(omega, axis=1, keepdims=True)
    return {
        "title": "1000 free bodies",
        "run": {"t_end": 10.0, "every": 10.0},
        "body": [
            {
                "name": "body",
                "shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]},
                "mass": 1.0,
                "count": n,
                "place": {"type": "grid", "spacing": 3.0},
                "orientation": "random",
                "angular_velocity": omega.tolist(),
            }
        ],
    }


def heavy_tops(n: int = 1000, inertia: tuple[float, ...] = (1.0, 1.2, 0.6)) -> dict:
    """Tops on a held tip, tilted by 0.1 to 2 rad, spinning with 1 to 10 rad/s."""
    random = np.random.default_rng(2)
    tilt, spin = random.uniform(0.1, 2.0, n), random.uniform(1.0, 10.0, n)
    zero = np.zeros(n)
    turn = np.stack([np.cos(tilt / 2), np.sin(tilt / 2), zero, zero], axis=1)
    axis = np.stack([zero, -np.sin(tilt), np.cos(tilt)], axis=1)  # the body's z in the world
    weight = {"type": "push", "body": "top", "at": [0.0, 0.0, 1.0], "force": [0.0, 0.0, -1.0]}
    return {
        "title": f"{n} {'symmetric' if inertia[0] == inertia[1] else 'asymmetric'} heavy tops",
        "run": {"t_end": 10.0, "every": 10.0},
        "body": [
            {
                "name": "top",
                "shape": {"type": "moments", "inertia": list(inertia)},
                "mass": 1.0,
                "count": n,
                "place": {"type": "grid", "spacing": 3.0},
                "orientation": turn.tolist(),
                "angular_velocity": (spin[:, None] * axis).tolist(),
            }
        ],
        "force": [weight, {"type": "push", "body": "top", "force": [0.0, 0.0, 1.0]}],
    }


def symmetric_tops() -> dict:
    """The same of Lagrange."""
    return heavy_tops(inertia=(1.0, 1.0, 0.6))


def best(points: list[Point], wanted: float) -> Point | None:
    """Point of least time whose error is small enough."""
    good = [p for p in points if not p.failure and p.error.worst <= wanted]
    return min(good, key=lambda p: p.seconds, default=None)


def compared(found: WorkPrecision, wanted: float) -> list[tuple[str, float]]:
    """Print our best and each engine's, and how many times faster ours is."""
    ours = best([p for p in found.points if not p.engine], wanted)
    assert ours is not None
    print(f"\n{found.title}, worst error {wanted:g} rad, one thread")
    print(f"  {'particlerb ' + ours.method:<30} {ours.seconds * 1e3:10.4f} ms")
    rows = [(f"{found.title}, {wanted:g} rad, ours [ms]", ours.seconds * 1e3)]
    for label in sorted({p.label for p in found.points if p.engine}):
        rival = best([p for p in found.points if p.label == label], wanted)
        if rival is None:
            print(f"  {label:<30} does not get there")
            continue
        ratio = rival.seconds / ours.seconds
        print(f"  {label:<30} {rival.seconds * 1e3:10.3f} ms, {ratio:8.1f} times ours")
        rows.append((f"{found.title}, {wanted:g} rad, {label} / ours", ratio))
    return rows


def as_asked(system: System, wanted: float, repeats: int = 7) -> float:
    """Time of search and motion for `run.accuracy`, one thread, without the plan [s]."""
    THREADS.use(1)
    free = system.with_run(accuracy=wanted, method="auto")
    plan, taken = make_plan(free), []
    for _ in range(repeats + 1):  # the first compiles
        started = time.perf_counter()
        found = [(group, search(free, group)) for group in plan.groups]
        chosen = tuple(g if one is None else stepped_by(g, one.stepping) for g, one in found)
        own = part(free, plan._replace(groups=chosen), np.arange(len(free.kind)))
        states_at(own, np.array([free.run.t_end]))
        taken.append(time.perf_counter() - started)
    return float(np.median(taken[1:]))


def asked_beside(system: System, found: WorkPrecision, wanted: float) -> tuple[str, float]:
    """Print how many times faster than SciPy's DOP853 a run with `run.accuracy` is."""
    ours = as_asked(system, wanted)
    rival = best([p for p in found.points if p.label == "SciPy DOP853"], wanted)
    ratio = rival.seconds / ours if rival else math.nan
    print(f"  run.accuracy, search and motion: {ours * 1e3:.3f} ms, DOP853 {ratio:.1f} times")
    return f"{found.title}, {wanted:g} rad as asked, SciPy DOP853 / ours", ratio


def in_a_batch(n: int = 100_000) -> float:
    """Time of the closed form for one body of a batch, with one output [s]."""
    study = Study(to_system(one_body(n)), 10.0)
    THREADS.use(1)
    whole = part(study.system, study.plan("auto", None), np.arange(n))
    return float(np.median([seconds(whole, 100.0) for _ in range(9)])) / n


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--budget", type=float, default=240.0, help="seconds for each scene")
    parser.add_argument("--engines", default=",".join(ENGINES), help="those to compare with")
    parser.add_argument("--scenes", default="", help="a word of the titles of those to run")
    parser.add_argument("--methods", default="", help="of ours; all if left out")
    parser.add_argument("--record", action="store_true", help="add to results/peers.csv")
    options = parser.parse_args()
    rows: list[tuple[str, float]] = []
    scenes = ((one_body, (1e-6,)), (free_bodies, (1e-6,)), (symmetric_tops, (1e-6,)),
              (heavy_tops, (1e-6, 1e-3)))  # fmt: skip
    for scene, errors in scenes:
        system = to_system(scene())
        if options.scenes not in system.title:
            continue
        ours = options.methods.split(",") if options.methods else ()
        found = chart(system, ours, options.engines.split(","), budget=options.budget)
        for name, reason in found.left_out:
            print(f"  {name}: left out, {reason}")
        for wanted in errors:
            rows += compared(found, wanted)
            if scene in (symmetric_tops, heavy_tops):
                rows.append(asked_beside(system, found, wanted))
    if options.scenes:
        return
    alone = in_a_batch()
    print(f"\nclosed form, one body of a batch of 100 000: {alone * 1e9:.0f} ns, set-up included")
    rows.append(("one free body, in a batch [ns]", alone * 1e9))
    if options.record:
        record("peers", rows)


if __name__ == "__main__":
    main()
