"""Measure free bodies: NASA's tumbling brick, speed and error of the closed form, a run to disk.

    python benchmarks/free_bodies.py

For 100 000 random asymmetric bodies on one core: time per output, vectorised and one body at a
time, set-up time, memory, the share of each kind of turn; the worst errors over the 8 000 bodies of
tests/reference/free_rotation.npz; a run of ten_thousand_clumps against h5py alone; start-up times.
Goals: brick 1e-12; 5 ns, 7 times, 200 ns, 400 bytes; 3e-13 rad and 6 half-ulp effects; 1.5 times.

`--calls` prints whole calls alone: motions of prepared scenes, `run(dict)` in memory and with a
file, a body-frame before the file, free or stepped, the search of run.accuracy, each beside its
goal, with SciPy's whole loop where it is installed: its least time without set-up over our least
one with set-up, the frame and the energy balance of both ends. Times by the clock, the median and
the least of rounds.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import startup
import trajectory_output
from accuracy import scipy_times
from against_peers import free_bodies, one_body
from results import record

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.compiled.jit import compile_with, kernel
from particlerb.compiled.plain import all_compiled
from particlerb.compiled.threads import THREADS
from particlerb.maths.rows import rows4
from particlerb.rotors.exact import (
    SteadyTurn,
    Turn,
    by_kind,
    orientation,
    turn_all,
    turn_block,
    turns_of,
)
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.run import prepare as prepare_system
from particlerb.simulation.trials import part, states_at
from particlerb.simulation.whole_run import Run
from particlerb.studies.peers import engines
from particlerb.studies.work_precision import Study

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "free_rotation.npz"
BRICK = REFERENCE.with_name("nesc_brick.csv")
CASES = Path(__file__).parents[1] / "cases"
WELL_CONDITIONED = 3e-13


@compile_with(inline="never")
def turn_one(steady: Any, theta: Any, hyperbolic: Any, t: float, b: int, q: Any) -> None:
    """The formulas of a single body."""
    turn_block(steady, theta, hyperbolic, t, b, b + 1, rows4(q, b, b + 1))


@kernel
def one_by_one(steady: Any, theta: Any, hyperbolic: Any, t: float, q: Any) -> None:
    """The same result without SIMD."""
    for b in range(q.shape[1]):
        turn_one(steady, theta, hyperbolic, t, b, q)


def random_bodies(n: int) -> tuple[Any, ...]:
    """Asymmetric bodies, turned and spinning at random."""
    rng = np.random.default_rng(7)
    squares = rng.uniform(0.02, 1, (3, n))
    q = rng.normal(size=(4, n))
    q /= np.linalg.norm(q, axis=0)
    return squares.sum(axis=0) - squares, np.full(n, 4), q, rng.normal(size=(3, n))


def at_times(turn: Turn, t: Any) -> Turn:
    """The same bodies with each its own unit of time, so that 1 is t."""
    clock = turn.clock * t
    if not isinstance(turn, SteadyTurn):
        clock[0] = turn.clock[0]
    return turn._replace(clock=clock)


def errors(groups: list[tuple[Any, Turn]], stored: Any) -> Any:
    """Angle [rad] of each body from the reference."""
    error = np.empty(stored["t"].size)
    for which, turn in groups:
        q = orientation(at_times(turn, stored["t"][which]), 1.0)
        high, low = stored["q"][:, which], stored["low"][:, which] * 2.0**-69
        sign = np.sign((q * high).sum(axis=0))
        error[which] = 2 * np.sqrt((((sign * q - high) - low) ** 2).sum(axis=0))
    return error


def timed(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def speed(n: int) -> list[tuple[str, float]]:
    """Print times, memory and shares; return the times."""
    bodies = random_bodies(n)
    groups = turns_of(*bodies)
    set_up = median(timed(lambda: turns_of(*bodies)) for _ in range(7))
    print(f"{n} bodies: set-up {set_up / n * 1e9:.0f} ns per body")
    figures = [(f"set-up, {n} bodies [ns]", set_up / n * 1e9)]
    for which, turn in groups:
        q = np.empty((4, which.size))
        kinds = by_kind(turn)
        turn_all(*kinds, 1.0, q)
        one_by_one(*kinds, 1.0, q)
        pairs = [
            (timed(lambda: turn_all(*kinds, 2.0, q)), timed(lambda: one_by_one(*kinds, 2.0, q)))  # noqa: B023
            for _ in range(15)
        ]
        fast, slow = (median(p[i] for p in pairs) / which.size * 1e9 for i in (0, 1))
        ratio = median(p[1] / p[0] for p in pairs)
        size = sum(field.nbytes for field in turn) / which.size
        print(f"{type(turn).__name__:15} {which.size / n:8.2%} of bodies, {size:.0f} bytes each")
        print(f"    vectorised            {fast:8.2f} ns per body and output")
        print(f"    one body at a time    {slow:8.2f} ns; {ratio:.1f} times as long")
        figures.append((f"{type(turn).__name__}, {n} bodies [ns]", fast))
        figures.append((f"{type(turn).__name__}, {n} bodies, gain by lanes", ratio))
    return figures


def call_times(work: Callable[[], object], rounds: int) -> tuple[float, float]:
    """Median and least time of a call, by the clock, behind one that does not count [s]."""
    work()
    taken = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return median(taken), min(taken)


def one_state(case: dict) -> Callable[[], object]:
    """The motion of a prepared scene: set-up, one frame at t_end, its energy balance."""
    prepared = prepare_system(to_system(case))
    times = np.array([prepared.system.run.t_end])
    return lambda: Run(prepared).frames_at(times, np.ones(1, dtype=bool))


def body_frame(n: int = 1000, frames: int = 300) -> Callable[[], object]:
    """Frames of n bodies with their energy balance, before a file."""
    going = Run(prepare_system(to_system(free_bodies(n))))
    times, is_frame = np.linspace(0.0, 10.0, frames), np.ones(frames, dtype=bool)
    return lambda: going.frames_at(times, is_frame)


def stepped_frame(n: int = 1000, frames: int = 300, dt: float = 0.01) -> Callable[[], object]:
    """The same under a push, a frame at each step; every call goes on."""
    push = {"type": "push", "body": "body", "at": [0.0, 0.0, 1.0], "force": [0.0, 0.0, -1.0]}
    run = {"t_end": 10.0, "every": dt, "dt": dt, "method": "strang"}
    going = Run(prepare_system(to_system(free_bodies(n) | {"run": run, "force": [push]})))
    times, is_frame = dt * np.arange(frames), np.ones(frames, dtype=bool)
    calls = count()
    return lambda: going.frames_at(times + dt * frames * next(calls), is_frame)


def search(rounds: int) -> tuple[float, float]:
    """Time that a search takes beyond a plan, and that of the run it is for [s]."""
    system = to_system(load(CASES / "spring_pendulum.toml", ["run.accuracy=1e-6"]))
    plain = system.with_run(accuracy=None)
    both = [call_times(lambda: prepare_accurately(one), rounds)[1] for one in (system, plain)]  # noqa: B023
    going = prepare_accurately(system)
    whole = part(system, going.plan, np.arange(system.n_bodies))
    times = np.array([system.run.t_end])
    return both[0] - both[1], call_times(lambda: states_at(whole, times), rounds)[1]


def scipy_loop(case: dict, wanted: float) -> float:
    """Least time of SciPy's joint DOP853 with an error that is small enough; NaN without it [s]."""
    (engine,) = engines(("scipy",))
    if engine.missing():
        return float("nan")
    study = Study(to_system(case), 5.0)
    return scipy_times(study, [wanted], time.perf_counter)[wanted]


def calls() -> list[tuple[str, float]]:
    """Print whole calls beside their goals; return the medians."""
    THREADS.use(1)
    one, thousand = one_body(), free_bodies(1000)
    figures = []

    def row(name: str, unit: float, goal: str, found: tuple[float, float]) -> None:
        now, least = (value * unit for value in found)
        print(f"  {name:50} {now:10.4g} {least:10.4g}   {goal}", flush=True)
        figures.extend([(name, now), (f"{name}, least", least)])

    print(f"  {'time by the clock':50} {'now':>10} {'least':>10}   goal")
    row("one free body, motion [ms]", 1e3, "0.06", call_times(one_state(one), 1000))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.h5"
        row("run(dict) in memory [ms]", 1e3, "5", call_times(lambda: run_of(one), 40))
        row("run(dict) with a file [ms]", 1e3, "12", call_times(lambda: run_of(one, path), 40))
    found = call_times(one_state(thousand), 300)
    row("1000 free bodies, motion [ms]", 1e3, "-", found)
    ratio = scipy_loop(thousand, 1e-6) / found[1]
    row("1000 free bodies, SciPy DOP853 / ours", 1.0, "40", (ratio, ratio))
    many = call_times(one_state(free_bodies(100_000)), 9)
    row("100 000 free bodies, one frame [ms]", 1e3, "25", many)
    row("a body-frame before the file [ns]", 1e9 / 3e5, "15", call_times(body_frame(), 15))
    found = call_times(stepped_frame(), 15)
    row("a stepped body-frame, a frame a step [ns]", 1e9 / 3e5, "60", found)
    taken, allowed = search(30)
    row(
        "search of run.accuracy, spring_pendulum [ms]",
        1e3,
        f"{max(allowed, 1e-3) * 1e3:.3g}",
        (taken, taken),
    )
    return figures


def run_of(case: dict, path: Path | None = None) -> None:
    """A whole call."""
    particlerb.run(case, path, overwrite=True).close()


def accuracy() -> list[tuple[str, float]]:
    """Print the worst errors over the reference file; return them."""
    stored = np.load(REFERENCE)
    n = stored["t"].size
    groups = turns_of(stored["inertia"], np.full(n, 4), stored["q0"], stored["L"])
    error, effect = errors(groups, stored), stored["effect"]
    well = effect < WELL_CONDITIONED
    ratio = error[~well] / effect[~well]
    print(
        f"{well.sum()} well-conditioned: median {np.median(error[well]):.1e}, "
        f"worst {error[well].max():.2e} rad"
    )
    print(
        f"{(~well).sum()} ill-conditioned: error over the effect of half an ulp: "
        f"median {np.median(ratio):.3f}, worst {ratio.max():.2f}; "
        f"worst error {error[~well].max():.1e} rad"
    )
    return [("worst error, well-conditioned [rad]", error[well].max())]


def brick() -> None:
    """Print the error of NASA's check-case 2 at 30 s against its exact solution."""
    rows = np.loadtxt(BRICK, delimiter=",", skiprows=4)
    with particlerb.run(CASES / "tumbling_brick.toml") as trajectory:
        last = np.searchsorted(trajectory.time, rows[-1, 0])
        rates = trajectory.omega_body(0)[last]
        q = trajectory.orientation[last, 0]
    exact = rows[-1, 4:8]
    angle = 2 * np.linalg.norm(np.sign(q @ exact) * q - exact)
    error = np.abs(rates - rows[-1, 1:4]).max()
    print(f"tumbling brick at {rows[-1, 0]:g} s: rates {error:.1e} rad/s, attitude {angle:.1e} rad")


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", type=int, nargs="+", default=[100_000, 10_000])
    parser.add_argument("--record", action="store_true", help="add to results/free.csv")
    parser.add_argument("--calls", action="store_true", help="whole calls alone")
    options = parser.parse_args()
    if options.calls:
        with all_compiled():
            figures = calls()
        if options.record:
            record("calls", figures)
        return
    brick()
    with all_compiled():
        figures = [figure for n in options.bodies for figure in speed(n)]
    figures += accuracy()
    if options.record:
        record("free", figures)
    trajectory_output.main()
    startup.main()


if __name__ == "__main__":
    main()
