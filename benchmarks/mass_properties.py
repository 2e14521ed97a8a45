"""The cost of summing a particle, against reading it once.

Prints one CSV row per number of particles in a kind (a million particles altogether): nanoseconds
per particle of `mass_properties` and of its summing kernel alone, and of the memory-bandwidth
bound, one NumPy sum over the same 40 bytes per particle. Each figure is the best of five.

    python benchmarks/mass_properties.py
"""

import time
from collections.abc import Callable

import numpy as np

from particlerb.bodies.mass_properties import mass_properties, sum_kinds
from particlerb.bodies.particles import Particles

TOTAL = 1_000_000
PER_KIND = (20, 1_000, TOTAL)


def best(run: Callable[[], object], repeats: int = 5) -> float:
    """Shortest of some runs [s], after one that compiles."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def random_kinds(per_kind: int) -> Particles:
    """Kinds of random particles, a million altogether."""
    rng = np.random.default_rng(1)
    offset = np.arange(0, TOTAL + 1, per_kind, dtype=np.int64)
    return Particles(rng.random((TOTAL, 3)), rng.random(TOTAL), np.zeros(TOTAL), offset)


def main() -> None:
    """Print the table."""
    print("particles_per_kind,mass_properties_ns,kernel_ns,numpy_read_ns")
    for per_kind in PER_KIND:
        particles = random_kinds(per_kind)
        n = len(particles.offset) - 1
        sums, exponent = np.empty((n, 11)), np.empty((n, 2), dtype=np.int64)
        figures = (
            best(lambda p=particles: mass_properties(p)),
            best(lambda p=particles, s=sums, e=exponent: sum_kinds(*p, s, e)),
            best(lambda p=particles: (p.position.sum(), p.mass.sum(), p.radius.sum())),
        )
        print(per_kind, *(f"{1e9 * t / TOTAL:.2f}" for t in figures), sep=",")


if __name__ == "__main__":
    main()
