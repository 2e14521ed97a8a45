"""Measure sweeps and simulations in Python beside what is asked of them.

    python benchmarks/sweeps.py [PART ...] [--record]

Parts: tops, values, contact, million, loop, executors, workers, drivers, start; all where none is
named. Times are those of the processor, of all processes of a command, when all is compiled.
`--record` adds the figures to results/sweeps.csv.

A top is that of `heavy_top`, with `method = "strang"`, 2000 steps and 21 frames. Rows on other
executors, and after kills, are compared with those of processes of this machine, byte for byte.
"""

import argparse
import contextlib
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from results import record

import particlerb
from particlerb import Scene, Simulation
from particlerb.case.problems import path_of
from particlerb.case.reader import load
from particlerb.case.sweep import SweepTable
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.sweeping.rows import Row
from particlerb.sweeping.worker import Task, work
from particlerb.tables import Box, RunTable, TorqueTable

TOP = ("--set", "run.method=strang", "--set", "run.dt=1e-3", "--set", "run.every=0.1")
SPIN = "body.0.angular_velocity.body.1"
KILLS = 20
KILLED = """
import os, signal, sys
import particlerb
from particlerb.case.reader import load
import multiprocessing

if __name__ == "__main__":
    overrides = ("run.method=strang", "run.every=0.1")
    killed = 0

    def kill(n):
        global killed
        own = multiprocessing.active_children()
        if n and killed < int(sys.argv[2]) and own:
            killed += 1
            os.kill(own[0].pid, signal.SIGKILL)

    case = load("heavy_top", overrides)
    axes = {"run.dt": {"low": 1e-3, "high": 2e-3, "n": int(sys.argv[3])}}
    particlerb.sweep(case, sys.argv[1], axes=axes, workers=2, progress=kill)
    print(killed)
"""


class Figure(NamedTuple):
    """What was measured, and what is asked."""

    name: str
    value: float
    asked: str


def spread(low: float, high: float, n: int) -> str:
    """Axis of a command."""
    return f"{{ low = {low}, high = {high}, n = {n} }}"


def command(*words: str, before: tuple[str, ...] = ()) -> list[str]:
    """A command of the package."""
    return [*before, sys.executable, "-m", "particlerb", *words]


def sweep_of_tops(table: Path, n: int, key: str = SPIN, axis: str = "") -> list[str]:
    """Words of a sweep of n tops."""
    chosen = ("--axis", f"{key}={axis or spread(140, 160, n)}")
    return ["sweep", "heavy_top", *TOP, *chosen, "-o", str(table)]


def used(words: list[str], expected: tuple[int, ...] = (0, 3)) -> float:
    """Processor time [s] of a command with all its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode in expected, done.stderr
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def seconds(run: Callable[[], list[Row]]) -> tuple[float, list[Row]]:
    """Processor time of a run that is done for the second time, and its rows."""
    run()
    start = time.process_time()
    rows = run()
    return time.process_time() - start, rows


def merged_and_alone(case: object, task: Task, alone: int) -> tuple[float, float]:
    """Milliseconds of a variant in a batch, and alone; their rows must have the same bits."""
    batch, together = seconds(lambda: work(task))
    few = task._replace(numbers=task.numbers[:alone], values=task.values[:alone], is_batch=False)
    one_by_one, rows = seconds(lambda: work(few))
    assert repr(rows) == repr(together[:alone]), "rows differ"
    assert all(row.status == "done" for row in together)
    return 1e3 * batch / len(task.numbers), 1e3 * one_by_one / alone


def tops(folder: Path) -> Iterator[Figure]:
    """1000 heavy tops."""
    table = folder / "tops.csv"
    for _ in range(2):  # the first one compiles
        table.unlink(missing_ok=True)
        total = used(command(*sweep_of_tops(table, 1000), "--workers", "1"))
    yield Figure("1000 heavy tops, the whole command, s", total, "5")
    case = load("heavy_top", tuple(TOP[1::2]))
    values = tuple((w,) for w in np.linspace(140.0, 160.0, 1000).tolist())
    task = Task(tuple(range(1000)), values, (path_of(SPIN),), case.source, (), True)
    merged, alone = merged_and_alone(case, task, 200)
    yield Figure("a top among 1000 in a batch, ms", merged, "0.1")
    yield Figure("a top by itself, no file, ms", alone, "5")


def values(folder: Path) -> Iterator[Figure]:
    """1e5 initial values: as bodies of one run, and as rows of a sweep."""
    scene = Scene.from_case("heavy_top", tuple(TOP[1::2]))
    spins = np.zeros((100_000, 3))
    spins[:, 1] = np.linspace(140.0, 160.0, 100_000)
    scene.check = None
    apart = {"count": 100_000, "position": spins, "angular_velocity": spins}
    scene.body = [scene.body[0].model_copy(update=apart)]
    with THREADS.using(1):
        for _ in range(2):
            start = time.process_time()
            particlerb.run(scene).close()
            took = time.process_time() - start
    yield Figure("1e5 initial values, bodies of one run, s", took, "5")
    table = folder / "values.csv"
    total = used(command(*sweep_of_tops(table, 100_000), "--workers", "1"))
    yield Figure("1e5 initial values, rows of a sweep, the whole command, s", total, "5")


def contact(folder: Path) -> Iterator[Figure]:
    """1000 scenes with contact."""
    asked = SweepTable(
        axes={"contact.friction": [0.1]}, value=({"body": "solid", "quantity": "velocity"},)
    ).value
    values = tuple((mu,) for mu in np.linspace(0.1, 0.3, 1000).tolist())
    case = load("slide_to_roll")
    paths = (path_of("contact.friction"),)
    task = Task(tuple(range(1000)), values, paths, case.source, asked, True)
    merged, alone = merged_and_alone(case, task, 20)
    yield Figure("slide_to_roll among 1000 in a batch, ms", merged, "")
    yield Figure("slide_to_roll by itself, ms", alone, "")
    yield Figure("so many times as fast in a batch", alone / merged, "at least 20")


def million(folder: Path) -> Iterator[Figure]:
    """A million bodies of one record, read, checked and planned."""
    random = np.random.default_rng(1)
    n = 1_000_000
    position, spin = random.uniform(size=(n, 3)), random.normal(size=(n, 3))

    def ready(forces: int) -> float:
        start = time.process_time()
        scene = Scene(RunTable(t_end=1.0, every=1.0, dt=1e-2))
        scene.add_body(
            name="body", count=n, shape=Box(size=(1, 2, 3), n=2), mass=1.0, position=position,
            angular_velocity=spin,
        )  # fmt: skip
        for _ in range(forces):
            scene.add_force(TorqueTable(body="body", torque=(0, 0, 1.0)))
        prepare_accurately(to_system(load(scene)))
        return time.process_time() - start

    ready(1)
    yield Figure("1e6 bodies made ready, s", ready(0), "3")
    yield Figure("1e6 bodies with a torque made ready, s", ready(1), "3")


def loop(folder: Path) -> Iterator[Figure]:
    """A control loop: calls of `advance`, and changes of a parameter."""
    calls, dt = 10_000, 1e-2

    def ready() -> Simulation:
        scene = Scene(RunTable(t_end=1000.0, every=1.0, dt=1e-3, method="strang"))
        shape = Box(size=(1, 2, 3), n=4)
        spin = (0.05, -0.1, 0.08)
        scene.add_body(name="bus", shape=shape, mass=100.0, angular_velocity=spin)
        scene.add_force(TorqueTable(body="bus", torque=(0, 0, 0.1)))
        simulation = Simulation(scene)
        simulation.advance(1.0)
        return simulation

    best = []
    for _ in range(5):
        simulation = ready()
        start = time.process_time()
        for k in range(1, calls + 1):
            simulation.advance(1.0 + k * dt)
        middle = time.process_time()
        simulation.advance(simulation.time + calls * dt)
        best.append(2 * middle - start - time.process_time())
    yield Figure("a call of advance beside the motion, µs", 1e6 * np.median(best) / calls, "20")
    simulation.change("force[0].torque", (0, 0, 0.2))
    start = time.process_time()
    for k in range(500):
        simulation.change("force[0].torque", (0, 0, 0.1 + 1e-4 * k))
        simulation.advance(simulation.time + dt)
    each = (time.process_time() - start) / 500
    yield Figure("a change of a parameter with a call of advance, ms", 1e3 * each, "")


def executors(folder: Path) -> Iterator[Figure]:
    """Rows of processes, ranks and dask."""
    n, rows = 300, {}
    mpiexec = Path(sys.executable).with_name("mpiexec")
    ranks = (str(mpiexec) if mpiexec.exists() else "mpiexec", "-n", "3")
    ways = {
        "processes": (("--workers", "2"), ()),
        "ranks of MPI": (("--executor", "mpi"), ranks),
        "dask": (("--executor", "dask", "--workers", "2"), ()),
    }
    asked = SweepTable(axes={SPIN: [1.0]}).value
    case = load("heavy_top", tuple(TOP[1::2]))
    for name, (words, before) in ways.items():
        table = folder / f"{name.replace(' ', '_')}.csv"
        used(command(*sweep_of_tops(table, n), *words, before=before))
        rows[name] = table.read_text().splitlines()
    spins = np.array([140.0 + k / (n - 1) * 20.0 for k in range(n)]).tolist()
    few = range(0, n, 10)
    task = Task(tuple(few), tuple((spins[k],) for k in few), (path_of(SPIN),), case.source, asked)
    alone = {row.number: repr(row.energy_drift) for row in work(task)}
    for name, lines in rows.items():
        cells = [line.split(",") for line in lines[1:]]
        same = sum(alone[k] == cells[k][3] for k in few)
        equal = sum(a == b for a, b in zip(lines, rows["processes"], strict=True)) - 1
        yield Figure(f"rows of 300 equal to those of processes, {name}", equal, "300")
        yield Figure(f"of 30 runs alone with these bits, {name}", same, "30")


def reference_of(folder: Path, n: int) -> list[str]:
    """Rows of a sweep that nothing disturbs, of variants that run one by one."""
    table = folder / "undisturbed.csv"
    if not table.exists():
        axis = spread(1e-3, 2e-3, n)
        used(command(*sweep_of_tops(table, n, "run.dt", axis)))
    return table.read_text().splitlines()


def compared(table: Path, rows: list[str], kills: int, what: str) -> Iterator[Figure]:
    """Whether a table is complete, no row twice, after kills."""
    lines = table.read_text().splitlines()
    yield Figure(f"kills of a {what}", kills, str(KILLS))
    same = sum(a == b for a, b in zip(lines, rows, strict=False)) - 1
    yield Figure(f"rows that are equal after them, of {len(rows) - 1}", same, str(len(rows) - 1))
    yield Figure("rows too many, or twice", len(lines) - len(set(rows)), "0")


def workers(folder: Path) -> Iterator[Figure]:
    """Kill a worker each time that rows have come."""
    n, table = 640, folder / "workers.csv"
    rows = reference_of(folder, n)
    script = folder / "killed.py"
    script.write_text(KILLED)
    words = [sys.executable, str(script), str(table), str(KILLS), str(n)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    yield from compared(table, rows, int(done.stdout.split()[-1]), "worker")


def drivers(folder: Path) -> Iterator[Figure]:
    """Kill the command each time that its table has grown."""
    n, table, kills = 640, folder / "drivers.csv", 0
    rows = reference_of(folder, n)
    words = command(*sweep_of_tops(table, n, "run.dt", spread(1e-3, 2e-3, n)), "--workers", "1")
    while kills < KILLS:
        before = table.stat().st_size if table.exists() else 0
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        driver = subprocess.Popen(words, **quiet)
        while driver.poll() is None and (not table.exists() or table.stat().st_size <= before):
            time.sleep(0.002)
        if driver.poll() is not None:
            break
        driver.send_signal(signal.SIGKILL)
        driver.wait()
        kills += 1
    used(words)
    yield from compared(table, rows, kills, "driver")


def start(folder: Path) -> Iterator[Figure]:
    """What a wrong key costs, and what a plain run imports."""
    table = folder / "wrong.csv"
    words = command(*sweep_of_tops(table, 10, "body.0.spin"))
    took = used(words, (2,))
    yield Figure("a wrong key ends with code 2 after, s", took, "before anything runs")
    yield Figure("files that it leaves", sum(1 for _ in folder.glob("wrong*")), "0")
    code = (
        "import sys\nfrom particlerb.cli import main\n"
        f"main(['run', 'heavy_top', '-q', '-o', {str(folder / 'a.h5')!r}])\n"
        "print(sum(name in sys.modules for name in ('mpi4py', 'distributed', 'dask')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    yield Figure(
        "of mpi4py, dask, distributed imported by a run", int(done.stdout.split()[-1]), "0"
    )


PARTS = {
    part.__name__: part
    for part in (tops, values, contact, million, loop, executors, workers, drivers, start)
}


def main() -> None:
    """Print what was measured beside what is asked."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[])
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    THREADS.use(1)
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        for part in args.parts or PARTS:
            figures = list(PARTS[part](Path(name)))
            for figure in figures:
                print(f"| {figure.name} | {figure.asked} | {figure.value:.4g} |", flush=True)
            if args.record:
                record("sweeps", [(figure.name, figure.value) for figure in figures])


if __name__ == "__main__":
    os.environ.setdefault("CI", "true")
    main()
