"""Measure the attraction between particles: pairs a second, share of the machine, threads.

    python benchmarks/attraction.py [--only SECTION ...] [--record]

A pair is a target and a source of another body; it counts as 20 operations, as is usual for such
sums (3 differences, 3 + 3 for the square, 5 for the root and the cube, 6 to add). The peak is what
chains of fused multiply-adds reach on the same core in the same rounds, 2 operations each. Minima
over rounds in which all variants follow each other; all loads of a scene, as in a run. `--record`
adds the figures of this commit to results/attraction.csv, those of a section when it is done.
Goals: 25 % of the peak on one thread, 1.8 times as fast on two, two points in less than 100 ns.

The tree: its time by the clock of its thread from 1e3 to 1e6 points, against n log n and against
the direct sum, and its errors and lost momenta against the opening angle. Goals: 1e6 points in a
few seconds at an error of 1e-4, momenta lost by rounding alone.
"""

import argparse
import re
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np
from pytreegrav import Accel
from results import record

from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import THREADS
from particlerb.forces.attraction import (
    Attraction,
    Fields,
    attraction_loads,
    fields_of,
    spread_loads,
)
from particlerb.forces.gravity_tree.opening_angle import fitting_angle, safe_angle, sampled_error
from particlerb.forces.gravity_tree.tree import Tree
from particlerb.maths.vec3 import Floats

Figures: TypeAlias = list[tuple[str, float]]
Ten: TypeAlias = tuple[float, float, float, float, float, float, float, float, float, float]

ROUNDS = 30
FLOPS_PER_PAIR = 20
SCENES = {
    "1 000 points": [1] * 1_000,
    "10 000 points": [1] * 10_000,
    "30 000 points": [1] * 30_000,
    "2 bodies of 5 000": [5_000] * 2,
    "100 bodies of 100": [100] * 100,
}


# Peak of a core


@inline
def longer(chains: Ten, m: float, c: float) -> Ten:
    """Ten chains, each longer by one fused multiply-add."""
    p, q, r, s, t, u, v, w, x, y = chains
    p, q, r, s, t = p * m + c, q * m + c, r * m + c, s * m + c, t * m + c
    return p, q, r, s, t, u * m + c, v * m + c, w * m + c, x * m + c, y * m + c


@inline
def longer_by_eight(chains: Ten, m: float, c: float) -> Ten:
    """Ten chains, each longer by eight."""
    chains = longer(longer(longer(longer(chains, m, c), m, c), m, c), m, c)
    return longer(longer(longer(longer(chains, m, c), m, c), m, c), m, c)


@kernel
def multiply_add(rows: Floats, m: float, c: float, times: int) -> None:
    """16 fused multiply-adds on every number of ten rows, again and again."""
    p, q, r, s, t = rows[0], rows[1], rows[2], rows[3], rows[4]
    u, v, w, x, y = rows[5], rows[6], rows[7], rows[8], rows[9]
    for _ in range(times):
        for i in range(p.size):  # ten registers, more than the latency of two units can use
            chains = (p[i], q[i], r[i], s[i], t[i], u[i], v[i], w[i], x[i], y[i])
            chains = longer_by_eight(longer_by_eight(chains, m, c), m, c)
            p[i], q[i], r[i], s[i], t[i], u[i], v[i], w[i], x[i], y[i] = chains


class Peak:
    """Double precision operations a second of one core."""

    TIMES = 5_000

    def __init__(self) -> None:
        self.rows = np.ones((10, 64))
        self.best = 0.0
        multiply_add(self.rows, 0.999, 0.001, 1)

    def run(self) -> None:
        """Measure once more."""
        start = time.perf_counter()
        multiply_add(self.rows, 0.999, 0.001, self.TIMES)
        seconds = time.perf_counter() - start
        self.best = max(self.best, 2 * 16 * self.rows.size * self.TIMES / seconds)

    @property
    def register(self) -> str:
        """Widest register that the chains are in: zmm holds 8 numbers, ymm 4, xmm 2."""
        code = next(iter(multiply_add.inspect_asm().values()))  # type: ignore[attr-defined]
        found = re.findall(r"vfn?m\w+pd\s.*%([xyz]mm)", code)
        return max(found, default="none")


# Direct sum


def scene(counts: Sequence[int], seed: int = 1) -> tuple[Attraction, Floats]:
    """Bodies of so many particles, some 1 m in size and 10 m apart, and their state."""
    rng = np.random.default_rng(seed)
    n, n_bodies = sum(counts), len(counts)
    mass = rng.uniform(0.5, 2.0, n)
    offset = np.concatenate([[0], np.cumsum(counts)])
    y = np.zeros((13, n_bodies))
    y[:3] = 10.0 * n_bodies ** (1 / 3) * rng.uniform(-0.5, 0.5, (3, n_bodies))
    y[3:7] = rng.normal(size=(4, n_bodies))
    y[3:7] /= np.linalg.norm(y[3:7], axis=0)
    arm = rng.normal(size=(3, n)) if n > n_bodies else np.zeros((3, n))
    return Attraction(arm, mass, 6.7e-11 * mass, offset, 1e-4), y


class Evaluation:
    """All loads of a scene, again and again."""

    def __init__(self, counts: Sequence[int]) -> None:
        self.attraction, self.y = scene(counts)
        self.fields, self.load = fields_of(self.attraction), np.zeros((6, len(counts)))
        self.pairs = sum(counts) ** 2 - sum(count * count for count in counts)
        self.best: dict[int, float] = {}

    def run(self, threads: int) -> None:
        """Evaluate once; note the time."""
        start = time.perf_counter()
        spread_loads(self.attraction, self.fields, self.y, self.load)
        seconds = time.perf_counter() - start
        self.best[threads] = min(self.best.get(threads, np.inf), seconds)


@kernel
def loads_again(
    attraction: Attraction, fields: Fields, y: Floats, load: Floats, times: int
) -> None:
    """Loads inside a compiled loop, as a stepping kernel has them."""
    for _ in range(times):
        attraction_loads(attraction, fields, y, load)


def nanoseconds_of_few(n: int, times: int = 20_000) -> float:
    """Time of all loads of n points, in a compiled loop."""
    attraction, y = scene([1] * n)
    fields, load = fields_of(attraction), np.zeros((6, n))
    taken = []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        loads_again(attraction, fields, y, load, times)
        taken.append((time.perf_counter() - start) / times)
    return 1e9 * min(taken)


def direct_sum() -> Figures:
    """Print and return the figures of the sum over all pairs."""
    peak, evaluations = Peak(), {name: Evaluation(counts) for name, counts in SCENES.items()}
    for _ in range(ROUNDS):
        peak.run()
        for threads in (1, 2):
            THREADS.use(threads)
            next(iter(evaluations.values())).run(0)  # makes the threads
            for evaluation in evaluations.values():
                evaluation.run(threads)
    print(f"direct sum; peak {peak.best / 1e9:.1f} Gflop/s of one core, in {peak.register}")
    rows = [("peak [Gflop/s]", peak.best / 1e9)]
    for name, evaluation in evaluations.items():
        rate = evaluation.pairs / evaluation.best[1]
        share = 100.0 * FLOPS_PER_PAIR * rate / peak.best
        gain = evaluation.best[1] / evaluation.best[2]
        print(
            f"  {name:<20} {rate / 1e9:6.2f} e9 pairs/s {1e9 / rate:7.3f} ns a pair"
            f" {share:6.1f} % of the peak; {gain:5.2f} times with two threads"
        )
        rows += [
            (f"{name}, pair [ns]", 1e9 / rate),
            (f"{name}, of the peak [%]", share),
            (f"{name}, gain by two threads", gain),
        ]
    for n in (2, 3, 10):
        value = nanoseconds_of_few(n)
        print(f"  {n} points in a compiled loop {value:8.1f} ns")
        rows.append((f"{n} points [ns]", value))
    return rows


# Tree


def sphere(n: int, seed: int = 1) -> tuple[Attraction, Floats]:
    """Plummer's sphere of n points, the outermost hundredth left out, and their state."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(3, n))
    direction /= np.linalg.norm(direction, axis=0)
    y = np.zeros((13, n))
    y[:3] = direction / np.sqrt(rng.uniform(0.0, 0.985, n) ** (-2 / 3) - 1.0)
    y[3] = 1.0
    mass = rng.uniform(0.5, 2.0, n)
    return Attraction(np.zeros((3, n)), mass, mass / mass.sum(), np.arange(n + 1), 0.0), y


def ball(n: int, seed: int = 1) -> tuple[Attraction, Floats]:
    """Even ball of n points, and their state."""
    rng = np.random.default_rng(seed)
    attraction, y = sphere(n, seed)
    y[:3] *= rng.random(n) ** (1 / 3) / np.linalg.norm(y[:3], axis=0)
    return attraction, y


def compact(n: int, seed: int = 1) -> tuple[Attraction, Floats]:
    """Even ball of bodies of 20 particles, small against their distance: what a tree errs most on.

    Nothing is summed directly there but neighbours, and cells have few bodies.
    """
    _, y = ball(n // 20, seed)
    rng = np.random.default_rng(seed)
    size, counts = 20 * y.shape[1], np.arange(y.shape[1] + 1) * 20
    arm, mass = 1e-4 * rng.normal(size=(3, size)), np.ones(size)
    arm = arm.reshape(3, -1, 20)
    arm = (arm - arm.mean(axis=2, keepdims=True)).reshape(3, -1)
    return Attraction(arm, mass, mass / size, counts, 0.0), y


def seconds_of(
    evaluate: Callable[[], object], rounds: int, clock: Callable[[], float] = time.thread_time
) -> float:
    """Least time of some evaluations, by this thread's own clock; the first is not counted."""
    taken = []
    evaluate()
    for _ in range(rounds):
        start = clock()
        evaluate()
        taken.append(clock() - start)
    return min(taken)


def tree_times(angle: float) -> Figures:
    """Time of all loads against the number of points, and the fit c n log n."""
    rows = []
    for name, make in (("ball", ball), ("sphere", sphere)):
        sizes, taken = np.array([1_000, 10_000, 100_000, 1_000_000]), []
        for n in sizes:
            attraction, y = make(int(n))
            tree, load = Tree(attraction, angle), np.zeros((6, y.shape[1]))
            taken.append(seconds_of(partial(tree.loads, y, load), 3 if n < 1e6 else 1))
            rows.append((f"tree, {name} of {n}, angle {angle:.2f} [s]", taken[-1]))
        unit = np.array(taken) / (sizes * np.log2(sizes))
        power = np.polyfit(np.log(sizes[1:]), np.log(taken[1:]), 1)[0]
        print(
            f"  {name:<8} {', '.join(f'{t:.2g}' for t in taken)} s for 1e3 to 1e6 points; over"
            f" n log n {', '.join(f'{1e9 * t:.0f}' for t in unit)} ns; from 1e4 like n^{power:.2f}"
        )
    return rows


def break_even(angle: float) -> Figures:
    """Number of points at which the tree takes as long as the direct sum, on one thread."""
    sizes, ratio = [2_000, 4_000, 8_000, 16_000, 32_000], []
    for n in sizes:
        attraction, y = ball(n)
        tree, fields, load = Tree(attraction, angle), fields_of(attraction), np.zeros((6, n))
        direct = seconds_of(partial(spread_loads, attraction, fields, y, load), 5)
        ratio.append(seconds_of(partial(tree.loads, y, load), 5) / direct)
    even = float(np.exp(np.interp(0.0, -np.log(ratio), np.log(sizes))))
    print(
        f"  time of the tree over that of the direct sum for {sizes} points:"
        f" {', '.join(f'{r:.2f}' for r in ratio)}; even at {even:.0f}"
    )
    return [(f"tree as fast as direct sum, angle {angle:.2f} [points]", even)]


def tree_errors(n: int = 20_000) -> Figures:
    """Errors of accelerations and lost momenta against the opening angle."""
    rows = []
    for name, make in (("ball", ball), ("sphere", sphere), ("compact", compact)):
        attraction, y = make(n)
        exact = np.zeros((6, y.shape[1]))
        mass = np.add.reduceat(attraction.mass, attraction.offset[:-1])
        spread_loads(attraction, fields_of(attraction), y, exact)
        sizes = np.linalg.norm(exact[:3] / mass, axis=0)
        for angle in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0):
            load = np.zeros((6, y.shape[1]))
            Tree(attraction, angle).loads(y, load)
            off = np.linalg.norm((load - exact)[:3] / mass, axis=0)
            rms = float(np.linalg.norm(off) / np.linalg.norm(sizes))
            torque = np.cross(y[:3].T, load[:3].T).T + load[3:]
            lost = [
                np.linalg.norm(v.sum(axis=1)) / np.linalg.norm(v, axis=0).sum()
                for v in (load[:3], torque)
            ]
            print(
                f"  {name:<8} angle {angle:.1f}: error {rms:.1e} ({rms / angle**6:.3f} angle^6),"
                f" each body's rms {np.sqrt(((off / sizes) ** 2).mean()):.1e},"
                f" max {(off / sizes).max():.1e}; lost momenta {lost[0]:.0e}, {lost[1]:.0e}"
            )
            rows.append((f"tree, {name}, angle {angle:.1f}, rms error", rms))
    return rows


def tree_growth(angle: float) -> Figures:
    """Print and return time against the number of points, and where it is that of the sum."""
    THREADS.use(1)
    print(f"tree; one thread; angle {angle:.2f}")
    rows = [*tree_times(angle), *break_even(angle)]
    THREADS.use(None)
    return rows


def tree_threads() -> Figures:
    """Print and return how much faster two threads are."""
    attraction, y = ball(100_000)
    one, load, taken = Tree(attraction, 0.5), np.zeros((6, 100_000)), []
    for threads in (1, 2):
        THREADS.use(threads)
        taken.append(seconds_of(partial(one.loads, y, load), 5, time.perf_counter))
    THREADS.use(None)
    print(f"  100 000 points: {taken[0] / taken[1]:.2f} times as fast with two threads")
    return [("tree, gain by two threads", taken[0] / taken[1])]


# The tree as users ask for it, beside pytreegrav


def accelerations(attraction: Attraction, y: Floats) -> Floats:
    """Those of points, (3, n), by the direct sum."""
    exact = np.zeros((6, y.shape[1]))
    spread_loads(attraction, fields_of(attraction), y, exact)
    return exact[:3] / attraction.mass


def error_of(found: Floats, exact: Floats) -> float:
    """Relative rms error of accelerations, (3, n)."""
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))


def peer(
    attraction: Attraction, y: Floats, exact: Floats, wanted: float
) -> tuple[float, float, float]:
    """Opening angle, error and least time [s] of pytreegrav with quadrupoles, for an error."""
    place = np.ascontiguousarray(y[:3].T)
    constant = float(attraction.gm[0] / attraction.mass[0])
    for angle in (0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2):
        find = partial(Accel, place, attraction.mass, G=constant, theta=angle)
        find = partial(find, quadrupole=True, method="tree", parallel=False)
        error = error_of(find().T, exact)
        if error <= wanted:
            break
    return angle, error, seconds_of(find, 3)


def as_asked(n: int, accuracy: float = 1e-4) -> Figures:
    """Print and return time and error of the fitted angle, and of a peer."""
    rows = []
    print(f"tree with the angle that is fitted for an error of {accuracy}; one thread")
    for name, make in (("ball", ball), ("sphere", sphere)):
        attraction, y = make(n)
        THREADS.use(None)
        exact = accelerations(attraction, y)
        THREADS.use(1)
        angle = fitting_angle(attraction, y, accuracy)
        load, one = np.zeros((6, n)), Tree(attraction, angle)
        one.loads(y, load)
        error = error_of(load[:3] / attraction.mass, exact)
        least = seconds_of(partial(one.loads, y, load), 5)
        look = seconds_of(partial(sampled_error, one), 3)
        other, other_error, other_least = peer(attraction, y, exact, max(error, 0.3 * accuracy))
        print(
            f"  {name} of {n}: angle {angle:.2f}, error {error:.1e}, {least:.3f} s, the look at"
            f" the sample {look:.3f} s; pytreegrav, angle {other:.1f}, error {other_error:.1e},"
            f" {other_least:.3f} s: {other_least / least:.1f} times as long"
        )
        rows += [
            (f"tree, {name} of {n}, error {accuracy} asked, error", error),
            (f"tree, {name} of {n}, error {accuracy} asked [s]", least),
            (f"tree, {name} of {n}, pytreegrav, error", other_error),
            (f"tree, {name} of {n}, pytreegrav [s]", other_least),
        ]
    THREADS.use(None)
    return rows


SECTIONS: dict[str, Callable[[], Figures]] = {
    "direct_sum": direct_sum,
    "tree_as_asked_1e5": partial(as_asked, 100_000),
    "tree_as_asked_1e4": partial(as_asked, 10_000),
    "tree_growth": partial(tree_growth, 0.5),
    "tree_growth_exact": partial(tree_growth, safe_angle(1e-4)),
    "tree_threads": tree_threads,
    "tree_errors": tree_errors,
}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--record", action="store_true", help="add to results/attraction.csv")
    parser.add_argument("--only", choices=SECTIONS, nargs="+", help="these sections")
    options = parser.parse_args()
    for name in options.only or SECTIONS:
        rows = SECTIONS[name]()
        if options.record:
            record("attraction", rows)


if __name__ == "__main__":
    main()
