"""Measure what ranks cost and gain, and what a rank needs: figures of the model in docs/scale.md.

    python benchmarks/ranks.py [--bodies 524288] [--rounds 3] [--runs 3] [--only free]
        [--folder /dev/shm] [--record]

Free bodies with six frames of all fields, and the same pushed with 100 steps, on no rank, on one
and on two, in turn, by `mpiexec`; one thread each. Times are those of the processor in the run
itself, the least of `--runs`; compilation and set-up aside. A rank that waits for others in MPI
turns in a circle: that is taken off. Times of the wall need two idle cores. Goals: one rank costs 3
% at most, two are 1.8 times as fast. `--record` adds the figures to results/ranks.csv.
"""

import argparse
import ctypes
import gc
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import h5py
from mpi_runs import figures_of, print_figures
from results import record

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.model.superblocks import SUPERBLOCK
from particlerb.ranks import ALONE, Ranks, ranks_of_mpi
from particlerb.record.checkpoint import slots_in
from particlerb.simulation import run as simulate
from particlerb.simulation.set_up_apart import prepared_apart

FRAMES, STEPS = 6, 100
advance = simulate.advance


def case(n: int, is_pushed: bool) -> dict[str, Any]:
    """Bodies on a grid, each with a spin of its own; pushed ones are stepped."""
    body = {"name": "b", "shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0}
    body |= {"count": n, "place": {"type": "grid", "spacing": 2.0}}
    body["angular_velocity"] = {"random": 2.0}
    every = 1.0 if is_pushed else 0.2
    run = {"t_end": 1.0, "every": every, "threads": 1}
    if not is_pushed:
        return {"run": run, "body": [body], "output": {"durable": False}}
    push = {"type": "push", "body": "b", "force": [0, 1, 0], "at": [0.3, 0, 0]}
    run |= {"dt": 1.0 / STEPS, "method": "strang"}
    return {"run": run, "body": [body], "force": [push], "output": {"durable": False}}


def memory(name: str) -> int:
    """Memory of this process [bytes]: VmRSS, or VmHWM, the most since it was last asked for."""
    words = Path("/proc/self/status").read_text().split(f"{name}:")[1].split()
    Path("/proc/self/clear_refs").write_text("5")
    return 1024 * int(words[0])


class Clock:
    """Processor time of this rank, without that in which it waits for others."""

    def __init__(self, ranks: Ranks | None) -> None:
        self.waited, self.begun = 0.0, (0.0, 0.0, 0.0)
        if ranks is not None:
            self.ask = ranks.gathered
            ranks.gathered = self.gathered  # type: ignore[method-assign]

    def gathered(self, value: Any) -> list[Any]:
        """Values of all ranks."""
        start = time.process_time()
        try:
            return self.ask(value)
        finally:
            self.waited += time.process_time() - start

    def now(self) -> float:
        """Seconds."""
        return time.process_time() - self.waited

    def advanced(self, *arguments: Any) -> Any:
        """Take note of when the set-up is done."""
        self.begun = self.now(), self.waited, time.perf_counter()
        return advance(*arguments)


def measure(
    n: int, runs: int, is_pushed: bool, path: Path, ranks: Ranks | None
) -> dict[str, float]:
    """What a set-up and a run take; the least times of some, and the memory of the first."""
    found: dict[str, float] = {}
    clock = Clock(ranks)
    simulate.advance = clock.advanced
    for size in (
        SUPERBLOCK * (ranks.count if ranks else 1),
        *(n,) * runs,
    ):  # the first one compiles
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        start, before = clock.now(), memory("VmRSS")
        scene = load(case(size, is_pushed))
        apart = prepared_apart(scene, ranks or ALONE)
        prepared = apart or simulate.prepare(to_system(scene))
        most, kept = memory("VmHWM") - before, memory("VmRSS") - before
        simulate.run_prepared(prepared, path, True, ranks=ranks or ALONE)
        own = {"set_up": clock.begun[0] - start, "run": clock.now() - clock.begun[0]}
        own["waited"] = clock.waited - clock.begun[1]
        own["wall"] = time.perf_counter() - clock.begun[2]
        bytes_of = {"set_up_bytes": most, "kept_bytes": kept}
        bytes_of["run_bytes"] = memory("VmHWM") - before - kept
        del prepared, apart
        if size < n:
            continue
        found = {k: min(found.get(k, v), v) for k, v in own.items()} | {
            k: found.get(k, v) for k, v in bytes_of.items()
        }
    return found


def worker(n: int, runs: int, is_pushed: bool, path: Path, has_ranks: bool) -> None:
    """Measure on this rank; the first one prints the figures of all."""
    ranks = ranks_of_mpi() if has_ranks else None
    THREADS.use(1)
    print_figures(ranks, measure(n, runs, is_pushed, path, ranks))


def measured(
    args: argparse.Namespace, is_pushed: bool, ranks: int, folder: Path
) -> list[dict[str, float]]:
    """Figures of each rank of a run of its own."""
    kind = ("pushed" if is_pushed else "free") + ("" if ranks else " alone")
    words = "--bodies", args.bodies, "--runs", args.runs, "--folder", folder, "--worker", kind
    return figures_of(__file__, ranks, *words)


def saved_bytes(folder: Path) -> int:
    """Bytes of the last state in the first part."""
    with h5py.File(next(folder.glob("*.parts/0000.h5")), "r") as file:
        states = slots_in(file)
    return sum(values.nbytes for values in states[max(states)].values())


def figures(args: argparse.Namespace, folder: Path, names: list[str]) -> list[tuple[str, float]]:
    """All figures, medians over rounds."""
    found: list[tuple[str, float]] = []
    n = args.bodies
    for name in names:
        is_pushed = name == "pushed"
        alone, one, two = [], [], []
        for _ in range(args.rounds):
            for ranks, into in ((0, alone), (1, one), (2, two)):
                into.append(measured(args, is_pushed, ranks, folder))
                print(name, ranks, [round(own["run"], 3) for own in into[-1]], flush=True)
        pairs = list(zip(alone, one, two, strict=True))
        cost = statistics.median((b[0]["run"] + b[0]["waited"]) / a[0]["run"] for a, b, _ in pairs)
        gain = statistics.median(b[0]["run"] / max(own["run"] for own in c) for _, b, c in pairs)
        walls = [b[0]["wall"] / max(own["wall"] for own in c) for _, b, c in pairs]
        outputs = n * (STEPS if is_pushed else FRAMES)
        run = statistics.median(a[0]["run"] for a in alone)
        found += [
            (f"{name}: one rank over none, %", 100.0 * (cost - 1.0)),
            (f"{name}: times as fast on two ranks as on one", gain),
            (f"{name}: the same by the wall", statistics.median(walls)),
            (
                f"{name}: ns a {'body and step' if is_pushed else 'body and frame'}",
                1e9 * run / outputs,
            ),
            (
                f"{name}: ns a body to set up",
                1e9 * statistics.median(a[0]["set_up"] for a in alone) / n,
            ),
            (
                f"{name}: bytes a body, most in the set-up",
                max(a[0]["set_up_bytes"] for a in alone) / n,
            ),
            (
                f"{name}: bytes a body, kept of the set-up",
                max(a[0]["kept_bytes"] for a in alone) / n,
            ),
            (
                f"{name}: bytes a body of the scene, most in the set-up of one of two ranks",
                max(own["set_up_bytes"] for c in two for own in c) / n,
            ),
            (
                f"{name}: bytes a body, most in the run beside it",
                max(a[0]["run_bytes"] for a in alone) / n,
            ),
            (f"{name}: bytes a body in a saved state", saved_bytes(folder) / min(n, 65536)),
        ]
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--bodies", type=int, default=524_288)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--only", choices=("free", "pushed"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--worker", default="", help=argparse.SUPPRESS)
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    if args.worker:
        alone = args.worker.endswith("alone")
        path = args.folder / ("alone.h5" if alone else "run.h5")
        worker(args.bodies, args.runs, args.worker.startswith("pushed"), path, not alone)
        return
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        names = [args.only] if args.only else ["free", "pushed"]
        found = figures(args, Path(folder), names)
    for name, value in found:
        print(f"{name}: {value:.4g}")
    if args.record:
        record("ranks", found)


if __name__ == "__main__":
    main()
