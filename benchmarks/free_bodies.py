"""Measure free bodies: NASA's tumbling brick, speed and error of the closed form, a run to disk.

    python benchmarks/free_bodies.py

For 100 000 random asymmetric bodies on one core: time per output, vectorised and one body at a
time, set-up time, memory, the share of each kind of turn; the worst errors over the 8 000 bodies of
tests/reference/free_rotation.npz; a run of ten_thousand_clumps against h5py alone; start-up times.
Goals: brick 1e-12; 5 ns, 7 times, 200 ns, 400 bytes; 3e-13 rad and 6 half-ulp effects; 1.5 times.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import startup
import trajectory_output
from results import record

import particlerb
from particlerb.compiled.jit import compile_with, kernel
from particlerb.maths.quaternion import rows4
from particlerb.rotors.exact import (
    SteadyTurn,
    Turn,
    by_kind,
    orientation,
    prepare,
    turn_all,
    turn_block,
)

REFERENCE = Path(__file__).parents[1] / "tests" / "reference" / "free_rotation.npz"
BRICK = REFERENCE.with_name("nesc_brick.csv")
CASES = Path(__file__).parents[1] / "cases"
WELL_CONDITIONED = 3e-13


@compile_with(cache=True, inline="never")
def one_body(steady: Any, theta: Any, hyperbolic: Any, t: float, b: int, q: Any) -> None:
    """The formulas of a single body."""
    turn_block(steady, theta, hyperbolic, t, b, b + 1, rows4(q, b, b + 1))


@kernel
def one_by_one(steady: Any, theta: Any, hyperbolic: Any, t: float, q: Any) -> None:
    """The same result without SIMD."""
    for b in range(q.shape[1]):
        one_body(steady, theta, hyperbolic, t, b, q)


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
    groups = prepare(*bodies)
    set_up = median(timed(lambda: prepare(*bodies)) for _ in range(7))
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


def accuracy() -> list[tuple[str, float]]:
    """Print the worst errors over the reference file; return them."""
    stored = np.load(REFERENCE)
    n = stored["t"].size
    groups = prepare(stored["inertia"], np.full(n, 4), stored["q0"], stored["L"])
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
    options = parser.parse_args()
    brick()
    figures = [figure for n in options.bodies for figure in speed(n)]
    figures += accuracy()
    if options.record:
        record("free", figures)
    trajectory_output.main()
    startup.main()


if __name__ == "__main__":
    main()
