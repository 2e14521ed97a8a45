"""Does `run.accuracy` choose well? Its choice beside the full chart, over scenes and accuracies.

    python benchmarks/accuracy.py [--scenes kepler,drag] [--accuracies 1e-3,1e-6]
                                  [--no-peers] [--record NAME]

For each scene the errors of all methods are found over the whole ladder of steps that `chart` has.
Then for each accuracy the choice is run on all bodies: its error at t_end against dop853 at 1e-14
is set beside what was asked and what was estimated; its time beside that of the cheapest point of
the ladder, the least of many runs on one thread, taken in turn; and the time of the search, without
making the plan and without compiling. SciPy's joint DOP853 is shown for the tops. `--record` puts
each line into results/NAME.csv as it is found, in place of the last one of its scene and accuracy.

Goals: the choice takes at most 1.5 times the cheapest point; the error lies between a fiftieth of
what was asked and what was asked, where the ladder has such a point; the search takes at most as
long as the run, or 1 ms, the larger of the two.
"""

import argparse
import csv
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from against_peers import heavy_tops
from results import FOLDER, commit, processor

from particlerb.case.reader import load
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.maths.vec3 import Ints
from particlerb.model.system import System
from particlerb.plan.segments import is_adaptive
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.trials import BodySubset, errors, part, seconds, states_at
from particlerb.simulation.whole_run import Prepared
from particlerb.studies.peers import engines, peer_errors, peer_scene
from particlerb.studies.work_precision import Study

CASES = Path(__file__).parents[1] / "cases"
METHODS = ("strang", "force_gradient", "rkn6", "dop853", "rk4")
ACCURACIES = "1e-3,1e-6,1e-9"
FILLED = 0.1  # s of repeated runs
REFERENCE = "dop853", 1e-14  # what errors are against
LONGEST = 5.0  # s that the ladder of a method may take
HEADER = (
    "scene", "wanted", "choice", "estimate", "error", "of wanted", "motion [ms]", "search [ms]",
    "cheapest", "its error", "its time [ms]", "ratio", "SciPy DOP853 [ms]", "holds",
)  # fmt: skip


class Rung(NamedTuple):
    """One run of the ladder."""

    method: str
    step: float  # or the tolerance
    error: float


def tops(inertia: list[float], n: int = 1000) -> dict:
    """Heavy tops of these moments."""
    scene = heavy_tops(n)
    scene["body"][0]["shape"]["inertia"] = inertia
    return scene


def dragged(n: int = 100) -> dict:
    """Asymmetric bodies that fall, tumble and are slowed down by a drag."""
    random = np.random.default_rng(3)
    body = {
        "name": "stone",
        "shape": {"type": "moments", "inertia": [1.0, 1.4, 0.6]},
        "mass": 1.0,
        "count": n,
        "place": {"type": "grid", "spacing": 3.0},
        "orientation": "random",
        "angular_velocity": random.normal(0.0, 2.0, (n, 3)).tolist(),
    }
    drag = {"type": "drag", "body": "stone", "translation": 0.2, "rotation": 0.1}
    push = {"type": "push", "body": "stone", "at": [0.3, 0.1, 0.2], "force": [0.0, 0.5, 0.0]}
    return {
        "run": {"t_end": 10.0, "every": 10.0},
        "gravity": {"acceleration": [0.0, 0.0, -9.81]},
        "body": [body],
        "force": [drag, push],
    }


def mixed(n: int = 20) -> dict:
    """Rods, spheres, symmetric and asymmetric bodies on springs."""
    random = np.random.default_rng(4)
    shapes = {
        "rod": [1.0, 1.0, 0.0],
        "ball": [1.0, 1.0, 1.0],
        "disc": [1.0, 1.0, 2.0],
        "stone": [0.8, 1.0, 1.3],
    }
    bodies, forces = [], []
    for k, (name, inertia) in enumerate(shapes.items()):
        omega = random.normal(0.0, 2.0, (n, 3))
        omega[:, 2] *= inertia[2] > 0.0
        place = [[3.0 * i, 3.0 * k, 0.0] for i in range(n)]
        shape = {"type": "moments", "inertia": inertia}
        body = {"name": name, "shape": shape, "mass": 1.0, "count": n, "position": place}
        bodies.append(body | {"angular_velocity": omega.tolist()})
        at = [0.2, 0.1, 0.3] if inertia[2] > 0.0 else [0.0, 0.0, 0.3]
        spring = {"type": "spring", "body": name, "at": at, "stiffness": 4.0}
        forces.append(spring | {"anchor": [30.0, 0.0, 5.0]})
    return {"run": {"t_end": 20.0, "every": 20.0}, "body": bodies, "force": forces}


def late(n: int = 200) -> dict:
    """Points on orbits; one of them passes its centre closely, late and alone."""
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    place = np.stack([np.cos(angle), np.sin(angle), np.zeros(n)], axis=1)
    speed = np.ones(n)
    speed[n // 3] = 0.5
    velocity = speed[:, None] * np.stack([-np.sin(angle), np.cos(angle), np.zeros(n)], axis=1)
    points = {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}
    body = {"name": "point", "shape": points, "count": n, "position": place.tolist()}
    return {
        "run": {"t_end": 12.0, "every": 12.0},
        "body": [body | {"velocity": velocity.tolist()}],
        "force": [{"type": "central", "body": "point", "mu": 1.0}],
    }


SCENES = {
    "symmetric tops": lambda: tops([1.0, 1.0, 0.6]),
    "asymmetric tops": heavy_tops,
    "one top": lambda: tops([1.0, 1.2, 0.6], 1),
    "30 tops": lambda: tops([1.0, 1.2, 0.6], 30),
    "10000 tops": lambda: tops([1.0, 1.2, 0.6], 10_000),
    "heavy_top": "heavy_top",
    "spinning_tops": "spinning_tops",
    "paper_cube": "paper_cube",
    "spring_pendulum": "spring_pendulum",
    "libration": "libration",
    "kepler": "kepler",
    "dumbbell_pair": "dumbbell_pair",
    "gravity_gradient": "gravity_gradient",
    "drag": dragged,
    "mixed classes": mixed,
    "late": late,
}


def case_of(scene: str, *overrides: str) -> Case:
    """The case of a scene; a file, or made here."""
    made = SCENES[scene]
    return load(CASES / f"{made}.toml" if isinstance(made, str) else made(), list(overrides))


def whole(prepared: Prepared) -> BodySubset:
    """All bodies of a prepared case."""
    system = prepared.system
    return part(system, prepared.plan, np.arange(system.n_bodies))


def every(study: Study) -> Ints:
    """All bodies of a scene."""
    return np.arange(study.system.n_bodies)


def truth(study: Study, found: BodySubset) -> float:
    """Error at t_end of a run of all bodies against dop853 at 1e-14."""
    reference = part(study.system, study.plan(*REFERENCE), every(study))
    times = study.times
    last = errors(found, times, states_at(found, times)[0], states_at(reference, times)[0])[-1]
    return max(last.worst, last.position)


def least_times(parts: list[BodySubset], t_end: float) -> list[float]:
    """Least times of the motions, taken in turn [s].

    Of long runs it is that of the processor, which other programs disturb less.
    """
    least = np.full(len(parts), np.inf)
    spent = np.zeros(len(parts))
    for one in parts:
        seconds(one, t_end)  # so that all is compiled, and loaded
    while (spent < FILLED).any():
        for k, one in enumerate(parts):
            if spent[k] > 0.0 and least[k] > 3.0 * least.min():  # no rival
                spent[k] = FILLED
                continue
            start = time.process_time()
            in_kernels = seconds(one, t_end)
            spent[k] += max(time.process_time() - start, 1e-6)
            least[k] = min(least[k], in_kernels, time.process_time() - start)
    return least.tolist()


def search_time(system: System) -> float:
    """Processor time of the choice beyond that of a plan, all compiled before [s]."""
    plain = system.with_run(accuracy=None)
    least, spent = [np.inf, np.inf], 0.0
    prepare_accurately(system)
    while spent < FILLED:
        for k, one in enumerate((plain, system)):
            start = time.process_time()
            prepare_accurately(one)
            taken = time.process_time() - start
            least[k], spent = min(least[k], taken), spent + taken
    return max(least[1] - least[0], 0.0)


def ladder(study: Study, wanted: float) -> list[Rung]:
    """Errors of all methods over their ladders, until they are below what is wanted."""
    rungs: list[Rung] = []
    for method in METHODS:
        if study.refusal(method):
            continue
        best, stays, start = np.inf, 0, time.monotonic()
        for step in study.ladder(method):
            states = study.states(method, step)
            own = part(study.system, study.plan(method, step), study.sampled)
            last = errors(own, study.times, states, study.reference.frames)[-1]
            error = max(last.worst, last.position)
            rungs.append(Rung(method, step, error))
            stays = stays + 1 if error > 0.7 * best and error < 1e-6 else 0
            best = min(best, error)
            if error < wanted or stays > 1 or time.monotonic() - start > LONGEST:
                break
    return rungs


def scipy_times(
    study: Study, wanted: list[float], clock: Callable[[], float] = time.process_time
) -> dict[float, float]:
    """Least times of SciPy's joint DOP853 with an error that is small enough [s]."""
    (engine,) = engines(("scipy",))
    scene = peer_scene(study.system)
    last = part(study.system, study.plan("auto", None), study.sampled)
    found = dict.fromkeys(wanted, np.nan)
    with THREADS.using(1, clock):
        for tolerance in engine.VARIANTS["DOP853"]:
            result = engine.run(scene, "DOP853", tolerance)
            error = peer_errors(
                result, study.system, study.sampled, last, study.times, study.reference.frames
            )[0]
            spent = min(engine.run(scene, "DOP853", tolerance).seconds for _ in range(5))
            for one in wanted:
                if error.worst <= one:
                    found[one] = np.nanmin([found[one], spent])
    return found


def rows(scene: str, wanted: list[float], peers: bool) -> Iterator[tuple]:
    """The table of one scene."""
    base = case_of(scene)
    study = Study(to_system(base), LONGEST)
    rungs = ladder(study, min(wanted))
    theirs = {}
    if peers and scene in ("symmetric tops", "asymmetric tops"):
        theirs = scipy_times(study, wanted)
    for one in wanted:
        yield row(scene, one, study, rungs, theirs.get(one, np.nan))


def row(scene: str, wanted: float, study: Study, rungs: list[Rung], peer: float) -> tuple:
    """One line of the table."""
    system = to_system(case_of(scene, f"run.accuracy={wanted}"))
    prepared = prepare_accurately(system)
    said = json.loads(prepared.parameters["accuracy"])
    own = whole(prepared)
    error = truth(study, own)
    good = [r for r in rungs if r.error <= wanted and r[:2] != REFERENCE]
    best = list({r.method: r for r in reversed(good)}.values())  # the longest step of each
    rivals = [part(study.system, study.plan(*r[:2]), every(study)) for r in best]
    spent, *theirs = least_times([own, *rivals], system.run.t_end)
    search = search_time(system)
    k = int(np.argmin(theirs)) if theirs else -1
    ratio = spent / theirs[k] if theirs else np.nan
    faults = [] if said["is_met"] else ["not met"]
    faults += ["wrong"] if said["is_met"] and error > wanted else []
    faults += ["too good"] if said["groups"] and error < wanted / 50 and wanted > 1e-11 else []
    faults += ["slow"] if ratio > 1.5 else []
    faults += ["long search"] if search > max(spent, 1e-3) else []
    choices = {
        (g["method"], f"{g['tolerance' if is_adaptive(g['method']) else 'dt']:.3g}")
        for g in said["groups"]
    }
    choice = "; ".join(" ".join(one) for one in sorted(choices)) or "closed form"
    cheapest = (f"{best[k].method} {best[k].step:.3g}", best[k].error) if best else ("none", np.nan)
    return (
        scene, wanted, choice, said["error"], error, error / wanted, 1e3 * spent, 1e3 * search,
        *cheapest, 1e3 * theirs[k] if theirs else np.nan, ratio, 1e3 * peer,
        ", ".join(faults) or "yes",
    )  # fmt: skip


def shown(value: object) -> str:
    """A figure as text."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def write(path: Path, line: tuple) -> None:
    """Put a line into a table, in place of the one of the same scene and accuracy."""
    known: dict[tuple[str, ...], list[str]] = {}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            known = {tuple(row[2:4]): row for row in list(csv.reader(file))[1:]}
    values = [shown(value) for value in line]
    known[values[0], values[1]] = [commit(), processor(), *values]
    order = list(SCENES)
    ordered = sorted(known.values(), key=lambda row: (order.index(row[2]), -float(row[3])))
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("commit", "processor", *HEADER), *ordered])


def as_page() -> None:
    """Print the table of results/accuracy.csv for docs/accuracy.md: rows with a commit."""
    names = "scene", "asked", "choice", "error, of what was asked", "kernels [ms]", "search [ms]"
    print("| " + " | ".join((*names, "cheapest")) + " |")
    print("| --- | ---: | --- | ---: | ---: | ---: | --- |")
    with (FOLDER / "accuracy.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if row["commit"] == "-":
                continue
            share, ratio = float(row["of wanted"]), float(row["ratio"])
            is_closed = row["choice"] == "closed form"
            found = "rounding" if is_closed else f"{share:.2g}"
            other = f"{row['cheapest']}, {1.0 / ratio:.2g} of the time"
            other = other if ratio == ratio else row["cheapest"]
            if ratio > 1.5:
                other = f"**{other}**"
            spent = row["search [ms]"]
            if float(spent) > max(1.0, float(row["motion [ms]"])):
                spent = f"**{spent}**"
            if not is_closed and not 0.02 <= share <= 1.0:
                found = f"**{found}**"
            print(
                f"| {row['scene']} | {row['wanted']} | {row['choice']} | {found}"
                f" | {row['motion [ms]']} | {spent} | {other} |"
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--scenes", default=",".join(SCENES))
    parser.add_argument("--accuracies", default=ACCURACIES)
    parser.add_argument("--no-peers", action="store_true", help="leave SciPy out")
    parser.add_argument("--record", metavar="NAME", help="write results/NAME.csv")
    parser.add_argument("--page", action="store_true", help="print the recorded table alone")
    options = parser.parse_args()
    if options.page:
        as_page()
        return
    THREADS.use(1)
    wanted = [float(one) for one in options.accuracies.split(",")]
    print("\t".join(HEADER))
    for scene in options.scenes.split(","):
        for line in rows(scene, wanted, not options.no_peers):
            print("\t".join(shown(value) for value in line), flush=True)
            if options.record:
                write(FOLDER / f"{options.record}.csv", line)


if __name__ == "__main__":
    main()
