"""Measure clumps that touch on ranks: figures in docs/scale.md.

    python benchmarks/ranks_touching.py gas [--ranks 4] [--bodies 1000] [--steps 100000] [--record]
    python benchmarks/ranks_touching.py weak [--ranks 2] [--bodies 20000] [--steps 300] [--rounds 3]
        [--record]
    python benchmarks/ranks_touching.py memory [--ranks 4] [--bodies 100000] [--record]

`gas`: clumps that collide far from everything: how far their momentum drifts, how many are left,
what is sent for each copy in a step, and how often ranks wait for all others. `weak`: so many
clumps a rank, in a box that is the longer the more there are; on no rank, one, two, four and so on
up to `--ranks` in turn, one thread each; and, as a control, as many processes on no rank side by
side, which share nothing but the machine. `memory`: what a rank takes of so many clumps in all, in
the set-up and two steps, as the command sets them up.
Goals: 1e-13 of the sum of all momenta, 110 bytes, one reduction; two ranks take 1.12 times as
long as one, which takes 3 % more than none. Times are those of the wall, which need as many idle
cores as there are ranks, and those of the processor without what ranks wait for each other.
`--record` adds the figures to results/ranks.csv.
"""

import argparse
import ctypes
import gc
import statistics
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from mpi_runs import figures_of, print_figures
from ranks import memory
from results import record

import particlerb
from particlerb.case.to_system import to_system
from particlerb.cli import main as main_command
from particlerb.compiled.threads import THREADS
from particlerb.ranks import ALONE, Ranks, ranks_of_mpi
from particlerb.simulation import run as simulate

DT: Final = 5e-4
POINTS: Final = [
    [0.05, 0.05, 0.05], [0.05, -0.05, -0.05], [-0.05, 0.05, -0.05], [-0.06, -0.05, 0.05],
]  # fmt: skip
advance = simulate.advance


def case(n: int, steps: int, is_gas: bool) -> dict[str, Any]:
    """Clumps on a grid: a cube that is slow and far from everything, or a long box that is full."""
    side = round(n ** (1 / 3)) + 1 if is_gas else 10
    shape = {"type": "points", "mass": 0.1, "radius": 0.1, "position": POINTS}
    grid = [-(-n // side**2), side, side]
    place = {"type": "grid", "spacing": 0.4, "n": grid}
    body = {"name": "c", "shape": shape, "count": n, "place": place, "orientation": "random"}
    body |= {"velocity": {"random": min(2.5 / (steps * DT), 2.0) if is_gas else 1.0}}
    contact = {"law": "hooke", "stiffness": 1e4, "restitution": 0.9, "friction": 0.5}
    t_end = steps * DT
    run = {"t_end": t_end, "every": t_end / 10 if is_gas else t_end, "dt": DT, "method": "strang"}
    found = {"run": run | {"threads": 1}, "body": [body], "contact": contact}
    if not is_gas:
        half = [0.2 * k + 0.1 for k in grid]
        found["wall"] = [{"name": "b", "type": "box", "lower": [-x for x in half], "upper": half}]
    return found | {"output": {"durable": False}}


class Watch:
    """What a rank sends, how often it waits for all others, and for how long."""

    def __init__(self, ranks: Ranks | None) -> None:
        self.calls: Counter[str] = Counter()
        self.waited, self.n_bytes, self.n_moved, self.copies = 0.0, 0, 0, 0
        self.begun = 0.0, 0.0
        for name in ("gathered", "largest", "added", "sent", "swapped") if ranks else ():
            setattr(ranks, name, self.watched(name, getattr(ranks, name)))

    def watched(self, name: str, work: Any) -> Any:
        """The same, counted."""

        def does(*given: Any) -> Any:
            start = time.process_time()
            self.calls[name] += 1
            if name == "swapped":
                self.n_bytes += sum(rows.nbytes for rows in given[1].values())
                self.copies += sum(rows.shape[-1] for rows in given[1].values())
            found = work(*given)
            if name == "swapped":  # what is returned waits for it
                found = self.watched("waited", found)
            if name == "sent":
                self.n_moved += sum(rows.nbytes for rows in found)
            self.waited += time.process_time() - start
            return found

        return does

    def advanced(self, *given: Any) -> Any:
        """Run, and begin to count behind the set-up."""
        self.calls.clear()
        self.waited, self.n_bytes, self.n_moved, self.copies = 0.0, 0, 0, 0
        self.begun = time.perf_counter(), time.process_time()
        return advance(*given)


def set_up(args: argparse.Namespace) -> None:
    """Measure what the command takes of memory on this rank [bytes a body of the scene]."""
    ranks, words = ranks_of_mpi(), ["--mpi", "--quiet", "--overwrite", "--threads", "1"]
    own: dict[str, float] = {}

    def begins(*given: Any) -> Any:
        ctypes.CDLL(None).malloc_trim(0)
        own["most"], own["kept"] = memory("VmHWM") - before, memory("VmRSS") - before
        found = advance(*given)
        own["run"] = memory("VmHWM") - before
        return found

    for n in (64 * ranks.count, args.bodies):  # the first compiles
        path = args.folder / f"{n}.toml"
        if ranks.number == 0:
            path.write_text(particlerb.Scene.from_case(case(n, 2, False)).to_toml())
        ranks.gathered(None)
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)
        before = memory("VmRSS")
        simulate.advance = begins  # type: ignore[assignment]
        if main_command([str(path), "-o", str(path.with_suffix(".h5")), *words]):
            raise SystemExit("the run has failed")
    print_figures(ranks, {name: value / args.bodies for name, value in own.items()})


def worker(args: argparse.Namespace) -> None:
    """Measure on this rank; the first one prints the figures of all."""
    ranks = ranks_of_mpi() if args.ranks else None
    THREADS.use(1)
    watch = Watch(ranks)
    simulate.advance = watch.advanced  # type: ignore[assignment]
    own, is_gas = {}, args.what == "gas"
    for n, steps in ((8 * max(args.ranks, 1), 20), (args.bodies, args.steps)):  # the first compiles
        prepared = simulate.prepare(to_system(case(n, steps, is_gas)))
        path = args.folder / f"{args.ranks}.h5"
        simulate.run_prepared(prepared, path, True, ranks=ranks or ALONE)
        wall, cpu = time.perf_counter() - watch.begun[0], time.process_time() - watch.begun[1]
        own = {"wall": wall, "cpu": cpu - watch.waited, "bytes": watch.n_bytes}
        own |= {"copies": watch.copies, "moved": watch.n_moved, **watch.calls}
    print_figures(ranks, own)


def measured(args: argparse.Namespace, ranks: int, n: int, folder: Path) -> list[dict[str, float]]:
    """Figures of each rank of a run of its own."""
    words = args.what, "--ranks", ranks, "--bodies", n, "--steps", args.steps, "--folder", folder
    return figures_of(__file__, ranks, *words, "--worker")


def gas(args: argparse.Namespace, folder: Path) -> list[tuple[str, float]]:
    """Momentum, bodies, and what is sent."""
    each, name = measured(args, args.ranks, args.bodies, folder), f"gas of {args.bodies} clumps"
    name += f", {args.ranks} ranks, {args.steps} steps"
    with particlerb.open(folder / f"{args.ranks}.h5") as trajectory:
        p = trajectory.linear_momentum
    total, most = p.sum(axis=1), np.abs(p[0]).sum()
    reductions = max(own["largest"] for own in each)
    others = max(sum(own.get(kind, 0) for kind in ("gathered", "added", "sent")) for own in each)
    copies = sum(own["copies"] for own in each)
    return [
        (f"{name}: momentum that changed hands, of all", np.abs(p[-1] - p[0]).sum() / most),
        (f"{name}: drift of momentum, of all", np.abs(total - total[0]).max() / most),
        (f"{name}: bodies that are not finite", float((~np.isfinite(p[-1]).all(axis=1)).sum())),
        (f"{name}: bytes a copy and step", sum(own["bytes"] for own in each) / max(copies, 1)),
        (
            f"{name}: beside these, for lists and frames, own bodies included",
            sum(own["moved"] for own in each) / max(copies, 1),
        ),
        (f"{name}: copies a rank", copies / args.steps / args.ranks),
        (f"{name}: reductions a step", reductions / args.steps),
        (f"{name}: other exchanges of all ranks, a step", others / args.steps),
    ]


def beside(args: argparse.Namespace, folder: Path, number: int) -> list[dict[str, float]]:
    """Figures of one of several processes that know nothing of each other."""
    own = folder / f"beside.{number}"
    own.mkdir(exist_ok=True)
    return measured(args, 0, args.bodies, own)


def weak(args: argparse.Namespace, folder: Path) -> list[tuple[str, float]]:
    """Times of more ranks over one, and of one over none; medians over rounds."""
    counts = [0, *(2**k for k in range(args.ranks.bit_length()))]
    rounds: list[list[list[dict[str, float]]]] = []
    for _ in range(args.rounds):
        rounds.append([measured(args, n, max(n, 1) * args.bodies, folder) for n in counts])
        with ThreadPoolExecutor() as pool:  # which share nothing but the machine
            alone = pool.map(partial(beside, args, folder), range(args.ranks))
            rounds[-1].append([own for each in alone for own in each])
        print([[round(own["wall"], 3) for own in each] for each in rounds[-1]], flush=True)
    found = []
    for kind in ("wall", "cpu"):
        most = [[max(own[kind] for own in each) for each in row] for row in rounds]
        name = f"{args.bodies} clumps a rank, {kind}"
        one = statistics.median(row[1] for row in most)
        over_none = statistics.median(row[1] / row[0] for row in most)
        found += [
            (f"{name}: ms a step on one rank", 1e3 * one / args.steps),
            (f"{name}: one rank over none, %", 100 * over_none - 100),
        ]
        floor = statistics.median(row[-1] / row[0] for row in most)
        found.append((f"{name}: {args.ranks} processes on no rank over one", floor))
        for k, n in enumerate(counts[2:], 2):
            ratio = statistics.median(row[k] / row[1] for row in most)
            found.append((f"{name}: {'two' if n == 2 else n} ranks over one", ratio))
    return found


def memories(args: argparse.Namespace, folder: Path) -> list[tuple[str, float]]:
    """Memory of the rank that has most of it, for one rank, two, and so on."""
    found = []
    for n in (2**k for k in range(args.ranks.bit_length())):
        each = measured(args, n, args.bodies, folder)
        for kind in ("most", "kept", "run"):
            values = [own[kind] for own in each]
            print(n, kind, [round(value) for value in values], flush=True)
            name = f"{args.bodies} clumps, {n} rank{'s' * (n > 1)}, bytes a clump of the scene"
            where = {"most": "most in the set-up", "kept": "kept of it", "run": "most in the run"}
            found.append((f"{name}, {where[kind]}", max(values)))
    return found


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("what", choices=("gas", "weak", "memory"))
    parser.add_argument("--ranks", type=int)
    parser.add_argument("--bodies", type=int)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    is_gas = args.what == "gas"
    if args.ranks is None:
        args.ranks = 2 if args.what == "weak" else 4
    args.bodies = args.bodies or {"gas": 1000, "weak": 20_000, "memory": 100_000}[args.what]
    args.steps = args.steps or (100_000 if is_gas else 300)
    if args.worker:
        (set_up if args.what == "memory" else worker)(args)
        return
    with tempfile.TemporaryDirectory(dir=args.folder) as folder:
        figures = {"gas": gas, "weak": weak, "memory": memories}[args.what]
        found = figures(args, Path(folder))
    for name, value in found:
        print(f"{name}: {value:.4g}")
    if args.record:
        record("ranks", found)


if __name__ == "__main__":
    main()
