"""Run every kind of scene for very many steps: balance, momenta, memory, lists and file.

    python benchmarks/long_runs.py [--minutes 45] [--only NAME,..] [--unfinished] [--wall 3600]

Small scenes get 1e7 steps, the cases of cases/ a hundred times their t_end, and four scenes the
numbers that were stated for them: a heap of 1000 clumps for 60 s, 60 dumbbells that collide without
loss and eight attracting boxes on springs for 1e6 steps, and 1e6 frames of five bodies. Each runs
in a process of its own, on one thread, with limits of time: a pilot of a thousandth of the steps
measures what a step takes, and a scene that would not fit into its share of the minutes of the
processor is cut, which its row tells; `--wall` is a limit by the clock [s]. Rows are written as
scenes end: drift of energy and momenta as in the ledger of a run, how much the process has grown
since a tenth of the run, the skin and the longest lists, and whether `info --verify` accepts the
file. A scene that was not reached has the row «not run». Rows that are there stay until their scene
is run again, and each says by which commit it was made; `--unfinished` takes only scenes that were
cut, failed or not run, the cheapest first.
"""

import argparse
import csv
import json
import math
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from results import FOLDER, commit

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare, run_prepared
from particlerb.simulation.whole_run import RunError
from particlerb.stepping.contact_motion import ContactMotion

HERE = Path(__file__).resolve()
CASES = HERE.parents[1] / "cases"
PILOT = 1e-3  # share of the steps
LONGER_PILOT = 1e-2  # where a scene seems too long
MARGIN = 3.0  # of the share of time, after which a scene is ended,
COMPILING = 200.0  # s of the processor beside it
FRAMES = 200
LONGER = {  # what a hundred times t_end takes, where bodies, or a whip, get faster and faster
    "chain": ["run.dt=1e-4"],
    "impulse_slope": ["run.dt=2.5e-4"],
    "squeezer": ["run.dt=2.5e-5"],
    # or where tubes would come down again, and crush what lies there
    "heap": [f"wall.{k}.motion.oscillation.frequency=5e-4" for k in (1, 2)],
}
COLUMNS = (
    "scene", "method", "steps", "of_wanted", "t_end", "cpu_s", "us_per_step", "energy", "linear",
    "angular", "growth_MB", "new_lists", "skin_first", "skin_most", "pairs_most", "file_MB",
    "outcome", "commit",
)  # fmt: skip
WEIGHT = {"acceleration": [0.0, 0.0, -9.81]}
CORNERS = (0.1 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)).tolist()


def case(bodies: list, dt: float, steps: float, frames: int = FRAMES, **keys: Any) -> dict:
    """A case of so many steps, with gravity unless it is None."""
    t_end = dt * round(steps)
    every = dt * max(1, round(steps / frames))
    run = {"t_end": t_end, "every": every, "dt": dt, "seed": 1, "threads": 1}
    tables = {"gravity": {"acceleration": [0.0, 0.0, 0.0]}} | keys
    run |= tables.pop("run", {})
    return {"run": run, "body": bodies} | tables


def ball(name: str = "ball", **keys: Any) -> dict:
    """A ball of 1 kg."""
    return {"name": name, "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0} | keys


def box(name: str = "box", **keys: Any) -> dict:
    """A box of 1 kg that does not touch."""
    shape = {"type": "box", "size": [0.1, 0.2, 0.3]}
    return {"name": name, "shape": shape, "mass": 1.0} | keys


def clump(count: int, spacing: float, **keys: Any) -> dict:
    """Clumps of eight balls."""
    shape = {"type": "points", "mass": 0.125, "radius": 0.1, "position": CORNERS}
    place = {"type": "grid", "spacing": spacing}
    body = {"name": "clump", "shape": shape, "count": count, "place": place}
    return body | {"orientation": "random"} | keys


def hooke(restitution: float = 0.5, friction: float = 0.5, stiffness: float = 1e5) -> dict:
    """Numbers of [contact]."""
    numbers = {"stiffness": stiffness, "restitution": restitution, "friction": friction}
    return numbers | {"overlap": 1e-3}


def floor(**keys: Any) -> dict:
    """A plane at z = 0."""
    return {"name": "floor", "type": "plane", "normal": [0, 0, 1]} | keys


def bin_of(half: float, height: float, **keys: Any) -> dict:
    """An open box above z = 0."""
    corners = {"lower": [-half, -half, 0], "upper": [half, half, height], "open": ["+z"]}
    return {"name": "bin", "type": "box"} | corners | keys


# Scenes: from a number of steps to a case


def free(steps: float) -> dict:
    """A brick that tumbles, in closed form."""
    return case([box(angular_velocity=[1.0, 2.0, 3.0])], 1e-3, steps)


def forced(method: str, dt: float) -> Callable[[float], dict]:
    """A heavy top with a spring, a push and a field, by a method."""

    def made(steps: float) -> dict:
        body = box("top", angular_velocity=[1.0, 0.5, 20.0], position=[0, 0, 1.0])
        force = [
            {"type": "spring", "body": "top", "at": [0, 0, 0.15], "anchor": [0, 0, 1.3],
             "stiffness": 50.0, "rest_length": 0.1},
            {"type": "field", "body": "top", "field": [0, 0, 1.0], "dipole": [0, 0, 0.3]},
        ]  # fmt: skip
        run: dict = {"method": method}
        if method == "dop853":
            made = case([body], dt, steps, gravity=WEIGHT, force=force, run=run)
            made["run"].pop("dt")
            return made | {"run": made["run"] | {"tolerance": 1e-10}}
        return case([body], dt, steps, gravity=WEIGHT, force=force, run=run)

    return made


def driven(steps: float) -> dict:
    """A brick with forces of its own body frame and drag, that has no potential."""
    force = [
        {"type": "push", "body": "box", "force": [0.1, 0, 0], "at": [0, 0.01, 0], "frame": "body"},
        {"type": "torque", "body": "box", "torque": [0, 0, 0.01]},
        {"type": "drag", "body": "box", "translation": 0.1, "rotation": 0.01},
    ]
    return case([box()], 1e-3, steps, force=force, run={"method": "strang"})


def springs(steps: float) -> dict:
    """Three boxes in a chain of springs."""
    boxes = [box(f"b{k}", position=[float(k), 0, 0], velocity=[0, 0.3 * k, 0]) for k in range(3)]
    force = [
        {"type": "spring", "body": f"b{k}", "to": f"b{k + 1}", "stiffness": 40.0,
         "rest_length": 0.8, "at": [0, 0.1, 0]}
        for k in range(2)
    ]  # fmt: skip
    return case(boxes, 2e-3, steps, force=force, run={"method": "strang"})


def attraction(steps: float) -> dict:
    """Two dumbbells that go round each other."""
    shape = {"type": "points", "mass": 0.5, "position": [[-0.1, 0, 0], [0.1, 0, 0]]}
    bodies = [
        {"name": n, "shape": shape, "position": [x, 0, 0], "velocity": [0, v, 0]}
        for n, x, v in (("a", -1.0, -0.7), ("b", 1.0, 0.7))
    ]
    return case(bodies, 1e-2, steps, attraction={"G": 2.0}, run={"method": "strang"})


def eight_boxes(steps: float) -> dict:
    """Eight attracting boxes at the corners of a cube, with springs along its edges."""
    places = np.array(list(np.ndindex(2, 2, 2)), dtype=float)
    rng = np.random.default_rng(2)
    corners = [[0.05 * i, 0.1 * j, 0.15 * k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    shape = {"type": "points", "mass": 0.125, "position": corners}
    boxes = [
        {"name": f"b{k}", "shape": shape, "position": x.tolist()}
        | {"angular_velocity": rng.normal(size=3).tolist()}
        for k, x in enumerate(places)
    ]
    force = [
        {"type": "spring", "body": f"b{i}", "to": f"b{j}", "stiffness": 20.0, "rest_length": 0.9,
         "at": [0.02, 0.0, 0.05]}
        for i in range(8) for j in range(i) if np.abs(places[i] - places[j]).sum() == 1.0
    ]  # fmt: skip
    law = {"G": 0.02, "softening": 0.05}
    return case(boxes, 2e-3, steps, attraction=law, force=force, run={"method": "strang"})


def on_a_wall(**motion: Any) -> Callable[[float], dict]:
    """A ball at rest on a wall, which may move."""

    def made(steps: float) -> dict:
        wall = floor(**({"motion": motion} if motion else {}))
        body = ball(position=[0, 0, 0.0999])
        return case(
            [body], 1e-4, steps, gravity=WEIGHT, contact=hooke(), wall=[wall],
            run={"method": "strang"},
        )  # fmt: skip

    return made


def bounces(law: dict, **keys: Any) -> Callable[[float], dict]:
    """Three balls that bounce without loss in a box, or a case like it."""

    def made(steps: float) -> dict:
        balls = [
            ball(f"b{k}", position=[0.3 * k - 0.3, 0.1 * k, 0.6 + 0.2 * k], velocity=[1.0, -0.7, 0])
            for k in range(3)
        ]
        wall = {"name": "box", "type": "box", "lower": [-0.6, -0.6, 0], "upper": [0.6, 0.6, 2.0]}
        tables = {"gravity": WEIGHT, "contact": law, "wall": [wall], "run": {"method": "strang"}}
        return case(balls, 2e-4, steps, **(tables | keys))

    return made


def turning_drum(steps: float) -> dict:
    """Five balls in a drum that turns."""
    drum = {"name": "drum", "type": "cylinder", "centre": [0, 0, 0], "axis": [0, 1, 0],
            "radius": 0.6, "length": 0.6, "motion": {"angular_velocity": [0, 2.0, 0]}}  # fmt: skip
    balls = [ball(f"b{k}", position=[0.22 * (k % 3) - 0.22, 0, -0.2 * (k // 3)]) for k in range(5)]
    return case(
        balls, 2e-4, steps, gravity=WEIGHT, contact=hooke(), wall=[drum], run={"method": "strang"}
    )


def far_centre(steps: float) -> dict:
    """A ball on a turntable whose centre is far away."""
    table = floor(motion={"angular_velocity": [0, 0, 0.01], "centre": [0, 100.0, 0]})
    body = ball(position=[0, 0, 0.0999], velocity=[1.0, 0, 0], angular_velocity=[0, 10.0, 0])
    return case(
        [body], 1e-4, steps, gravity=WEIGHT, contact=hooke(), wall=[table],
        run={"method": "strang"},
    )  # fmt: skip


def piston(steps: float) -> dict:
    """A lid that rests on an elastic column of three balls."""
    lid = {"name": "lid", "type": "plane", "point": [0, 0, 0.6], "normal": [0, 0, -1],
           "piston": {"mass": 5.0, "axis": [0, 0, -1], "load": 20.0}}  # fmt: skip
    balls = [ball(f"b{k}", position=[0, 0, 0.1 + 0.2 * k]) for k in range(3)]
    return case(
        balls, 1e-4, steps, gravity=WEIGHT, contact=hooke(1.0, 0.0), wall=[floor(), lid],
        run={"method": "strang"},
    )  # fmt: skip


def driven_body(steps: float) -> dict:
    """A stirrer that goes round among four balls in a bin."""
    centre = {"angular_velocity": [0, 0, 2.0], "centre": [0, 0, 0.12]}
    stirrer = ball("stirrer", position=[0.25, 0, 0.12], motion=centre)
    balls = [ball(f"b{k}", position=[0.35 * c, 0.35 * s, 0.1 + 0.01 * k])
             for k, (c, s) in enumerate(((-1, 0), (0, 1), (0, -1), (-1, 1)))]  # fmt: skip
    return case(
        [stirrer, *balls], 2e-4, steps, gravity=WEIGHT, contact=hooke(), wall=[bin_of(0.6, 2.0)],
        run={"method": "strang"},
    )  # fmt: skip


def mesh_walls(steps: float) -> dict:
    """Three balls in an open box of triangles, from a file."""
    trimesh = __import__("trimesh")
    path = Path(tempfile.gettempdir()) / "long_runs_box.stl"
    made = trimesh.creation.box(extents=[1.2, 1.2, 4.0]).subdivide().subdivide()
    made.export(path)
    wall = {"name": "mesh", "type": "mesh", "file": str(path), "position": [0, 0, 2.0]}
    return bounces(hooke(), wall=[wall])(steps)


def dumbbells(steps: float) -> dict:
    """Sixty dumbbells that collide without loss in a box."""
    shape = {"type": "points", "position": [[-0.08, 0, 0], [0.08, 0, 0]], "mass": 0.5,
             "radius": 0.1}  # fmt: skip
    body = {"name": "d", "shape": shape, "count": 60, "place": {"type": "grid", "spacing": 0.5},
            "orientation": "random", "velocity": {"random": 1.0}}  # fmt: skip
    wall = {"name": "box", "type": "box", "lower": [-1.2] * 3, "upper": [1.2] * 3}
    return case([body], 2e-4, steps, contact=hooke(1.0, 0.0), wall=[wall], run={"method": "strang"})


def gas(steps: float) -> dict:
    """Four hundred balls that seldom meet: most fly in closed form."""
    body = ball("b", count=400, place={"type": "grid", "spacing": 1.0}, velocity={"random": 1.0})
    wall = {"name": "box", "type": "box", "lower": [-4.5] * 3, "upper": [4.5] * 3}
    return case([body], 2e-4, steps, contact=hooke(1.0, 0.0), wall=[wall], run={"method": "strang"})


def heap(steps: float) -> dict:
    """A thousand clumps that fall into a bin and come to rest."""
    bodies = [clump(1000, 0.6, place={"type": "grid", "spacing": 0.6, "origin": [0, 0, 3.6]})]
    wall = [bin_of(3.1, 20.0)]
    law = {"stiffness": 1e5, "restitution": 0.3, "friction": 0.5, "rolling_friction": 0.02}
    return case(
        bodies, 2e-4, steps, gravity=WEIGHT, contact=law, wall=wall, run={"method": "strang"}
    )


def million_frames(steps: float) -> dict:
    """Five bodies in closed form, a frame with each step."""
    bodies = [box(f"b{k}", position=[float(k), 0, 0], angular_velocity=[1, 2, k]) for k in range(5)]
    return case(bodies, 1e-2, steps, frames=round(steps))


def of_case(name: str) -> Callable[[float], tuple[Path, float]]:
    """A case of cases/, for so many times its t_end."""
    return lambda times: (CASES / f"{name}.toml", times)


SCENES: dict[str, tuple[Callable[[float], Any], float, float]] = {  # case, steps, share of time
    "free body, closed form": (free, 1e7, 0.2),
    "heavy top and spring, strang": (forced("strang", 1e-3), 1e7, 1.0),
    "heavy top and spring, rkn6": (forced("rkn6", 5e-3), 1e7, 1.0),
    "heavy top and spring, rk4": (forced("rk4", 1e-3), 1e7, 1.0),
    "heavy top and spring, dop853": (forced("dop853", 5e-3), 1e6, 1.0),
    "push, torque and drag": (driven, 1e7, 1.0),
    "springs between bodies": (springs, 1e7, 1.5),
    "attraction of two": (attraction, 1e7, 1.5),
    "ball on a wall": (on_a_wall(), 1.5e7, 2.0),
    "ball on a wall that turns": (on_a_wall(angular_velocity=[0, 0, 1.0]), 1e7, 2.0),
    "ball on a turntable with its centre far away": (far_centre, 1e7, 1.5),
    "ball on a wall that shakes": (
        on_a_wall(oscillation={"amplitude": [0, 0, 1e-4], "frequency": 10.0}), 1e7, 1.5
    ),
    "lossless balls in a box": (bounces(hooke(1.0, 0.0)), 1e7, 1.5),
    "lossless balls with friction": (bounces(hooke(1.0, 0.5)), 1e7, 1.5),
    "turning drum": (turning_drum, 1e7, 2.0),
    "lid on a column": (piston, 1e7, 1.5),
    "stirrer": (driven_body, 1e7, 2.0),
    "walls of triangles": (mesh_walls, 1e7, 2.0),
    "lossless balls in a box, rk4": (
        bounces(hooke(1.0, 0.0), run={"method": "rk4"}), 1e7, 2.5
    ),
    "balls in a box by impulses": (
        bounces({"law": "impulse", "restitution": 0.5, "friction": 0.5}, run={}), 1e7, 2.5
    ),
    "gas of 400 balls": (gas, 1e6, 2.0),
    "60 lossless dumbbells": (dumbbells, 1e6, 2.0),
    "8 attracting boxes on springs": (eight_boxes, 1e6, 1.0),
    "1e6 frames of 5 bodies": (million_frames, 1e6, 0.5),
    "heap of 1000 clumps": (heap, 3e5, 14.0),
} | {
    f"case {path.stem}": (of_case(path.stem), 100.0, 0.7) for path in sorted(CASES.glob("*.toml"))
}  # fmt: skip


# One scene, in a process of its own


def loaded(scene: str, amount: float) -> Any:
    """The case of a scene with so many steps, or so many times its t_end."""
    made = SCENES[scene][0](amount)
    if isinstance(made, dict):
        return load(made)
    path, times = made
    asked = load(path, LONGER.get(path.stem, ()))
    t_end = asked.run.t_end * times
    run = asked.run.model_copy(update={"t_end": t_end, "every": t_end / FRAMES, "threads": 1})
    return asked.model_copy(update={"run": run, "check": type(asked.check)()})


class Memory:
    """Resident memory of this process while it runs [MB]."""

    def __init__(self) -> None:
        self.seen: list[tuple[float, float]] = []
        threading.Thread(target=self.look, daemon=True).start()

    def look(self) -> None:
        """Note it now and then."""
        while True:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
            self.seen.append((time.monotonic(), pages * 4096 / 1e6))
            time.sleep(0.05)

    def growth(self, first: float, last: float) -> float:
        """Largest after half of a time less the largest until a tenth of it."""
        early = [m for t, m in self.seen if first <= t <= first + 0.1 * (last - first)]
        late = [m for t, m in self.seen if t >= first + 0.5 * (last - first)]
        return max(late) - max(early) if early and late else math.nan


def child(scene: str, seconds: float, folder: Path) -> dict[str, Any]:
    """Run one scene, and return its row."""
    lists: list[tuple[float, int]] = []
    make_lists = ContactMotion.make_lists

    def noted(motion: ContactMotion) -> None:
        make_lists(motion)
        found = motion.contact.lists
        pairs = found.spheres.sphere.size + found.walls.sphere.size
        lists.append((motion.lists.skin, pairs))

    ContactMotion.make_lists = noted  # type: ignore[method-assign]
    wanted = SCENES[scene][1]
    pilots = []
    for share in (PILOT, 0.1 * PILOT, PILOT):  # the first compiles
        prepared, began = prepare(to_system(loaded(scene, wanted * share))), time.process_time()
        run_prepared(prepared, None)
        pilots.append(time.process_time() - began)
    whole = max(pilots[2] - pilots[1], 1e-9) / (0.9 * PILOT)  # s for all steps
    if whole > seconds:  # so many seconds are worth a longer pilot
        prepared, began = (
            prepare(to_system(loaded(scene, wanted * LONGER_PILOT))),
            time.process_time(),
        )
        run_prepared(prepared, None)
        longer = time.process_time() - began - pilots[1]
        whole = max(longer, 1e-9) / (LONGER_PILOT - 0.1 * PILOT)
    amount = wanted * min(1.0, seconds / whole)
    lists.clear()
    case = loaded(scene, amount)
    prepared = prepare(to_system(case))
    steps = [segment.dt for group in prepared.plan.groups for segment in group.segments]
    dt = min([step for step in steps if step and step < math.inf], default=math.nan)
    methods = {segment.method for group in prepared.plan.groups for segment in group.segments}
    path, memory = folder / "long.h5", Memory()
    first, began = time.monotonic(), time.process_time()
    row: dict[str, Any] = {"scene": scene, "method": " ".join(sorted(methods))}
    outcome = "ok"
    try:
        ended = run_prepared(prepared, path, True)
        row |= dict(zip(("energy", "linear", "angular"), ended.drift, strict=True))
    except RunError as error:
        outcome = f"failed: {error}"
    cpu = time.process_time() - began
    row |= {"growth_MB": memory.growth(first, time.monotonic()), "cpu_s": cpu}
    n_steps = case.run.t_end / dt
    row |= {"steps": n_steps, "us_per_step": 1e6 * cpu / n_steps, "of_wanted": amount / wanted}
    row |= {"t_end": case.run.t_end, "new_lists": len(lists)}
    if lists:
        skins = [skin for skin, _ in lists]
        row |= {"skin_first": skins[0], "skin_most": max(skins)}
        row |= {"pairs_most": max(pairs for _, pairs in lists)}
    if path.exists():
        command = [sys.executable, "-m", "particlerb", "info", "--verify", str(path)]
        verified = subprocess.run(command, capture_output=True, text=True, check=False)
        row["file_MB"] = path.stat().st_size / 1e6
        if verified.returncode:
            said = [line.strip() for line in verified.stdout.splitlines() if "NOT OK" in line]
            outcome += f"; info --verify: {'; '.join(said) or verified.stderr.strip()[-200:]}"
    return row | {"outcome": outcome}


def shown(value: Any) -> str:
    """A figure in four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def row_of(scene: str, seconds: float, wall: float) -> dict[str, Any]:
    """Row of a scene, run in a child."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(HERE), "--child", scene, str(seconds), folder]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=wall
            )
        except subprocess.TimeoutExpired:
            return {"scene": scene, "outcome": f"not run: no end within {wall:.0f} s by the clock"}
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:] or ["no message"]
        return {"scene": scene, "outcome": f"exit code {done.returncode}: {last[0][:200]}"}
    return json.loads(done.stdout.splitlines()[-1])


def rows_of(path: Path) -> dict[str, dict[str, Any]]:
    """Rows that are there, and «not run» for the scenes that have none."""
    rows: dict[str, dict[str, Any]] = {n: {"scene": n, "outcome": "not run"} for n in SCENES}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            rows |= {row["scene"]: row for row in csv.DictReader(file) if row["scene"] in rows}
    return rows


def is_whole(row: dict[str, Any]) -> bool:
    """Whether a scene was run to the end that is wanted, without a fault."""
    return row["outcome"] == "ok" and row["of_wanted"] == "1"


def price(rows: dict[str, dict[str, Any]]) -> Callable[[str], float]:
    """Seconds of the processor that the whole of a scene would take; 0 where nothing is known."""

    def of(scene: str) -> float:
        row = rows[scene]
        return float(row.get("cpu_s") or 0.0) / float(row.get("of_wanted") or 1.0)

    return of


def main() -> None:
    """Run all scenes, or some, one after another."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=45.0)
    parser.add_argument("--only", default="")
    parser.add_argument("--unfinished", action="store_true")
    parser.add_argument("--wall", type=float, default=3600.0)
    parser.add_argument("--output", type=Path, default=FOLDER / "long_runs.csv")
    parser.add_argument("--child", nargs=3)
    options = parser.parse_args()
    if options.child:
        scene, seconds, folder = options.child
        limit = math.ceil(COMPILING + MARGIN * float(seconds))
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
        print(json.dumps(child(scene, float(seconds), Path(folder))))
        return
    rows = rows_of(options.output)
    chosen = [name for name in SCENES if any(part in name for part in options.only.split(","))]
    if options.unfinished:
        chosen = sorted((name for name in chosen if not is_whole(rows[name])), key=price(rows))
    unit = 60.0 * options.minutes / sum(SCENES[name][2] for name in SCENES)
    for name in chosen:
        row = row_of(name, unit * SCENES[name][2], options.wall) | {"commit": commit()}
        print({key: shown(value) for key, value in row.items()}, flush=True)
        rows = rows_of(options.output) | {name: row}  # others may have added theirs
        with options.output.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            for each in rows.values():
                writer.writerow({key: shown(value) for key, value in each.items()})


if __name__ == "__main__":
    main()
