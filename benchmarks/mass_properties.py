"""The cost of summing a particle, against reading it once.

Prints one CSV row per number of particles in a kind: nanoseconds per particle and core of
`mass_properties`, of its sums alone, and of the memory-bandwidth bound, one NumPy sum over the same
40 bytes per particle; best of interleaved repeats on one thread. The last column is how many
particles a second the sums take. Then one row per number of random overlapping spheres, at
the same density: pairs that overlap, and milliseconds of their exact union.

    python benchmarks/mass_properties.py
"""

import time

import numpy as np

from particlerb.compiled.threads import THREADS
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.overlapping_spheres import overlaps, union_solid
from particlerb.geometry.particles import Particles
from particlerb.geometry.sums import sums_of

TOTAL = (1_000_000, 1_000_000, 1_000_000, 10_000_000)
PER_KIND = (20, 1_000, 1_000_000, 10_000_000)
REPEATS = 7
SPHERES = (10, 100, 1_000, 10_000)


def random_kinds(total: int, per_kind: int) -> Particles:
    """Kinds of random particles."""
    rng = np.random.default_rng(1)
    offset = np.arange(0, total + 1, per_kind, dtype=np.int64)
    return Particles(rng.random((total, 3)), rng.random(total), np.zeros(total), offset)


def print_unions() -> None:
    """Print the table of unions."""
    print("spheres,overlapping_pairs,union_ms")
    for n in SPHERES:
        rng = np.random.default_rng(0)
        side = (n / 1000) ** (1 / 3)
        centre, radius = side * rng.random((n, 3)), rng.uniform(0.03, 0.12, n)
        times = []
        for _ in range(REPEATS):
            start = time.perf_counter()
            union_solid(centre, radius)
            times.append(time.perf_counter() - start)
        print(n, overlaps(centre, radius).pairs, f"{1e3 * min(times[1:]):.3g}", sep=",")


def main() -> None:
    """Print the tables."""
    THREADS.use(1)
    print("particles_per_kind,mass_properties_ns,sums_ns,numpy_read_ns,sums_per_second")
    for total, per_kind in zip(TOTAL, PER_KIND, strict=True):
        particles = random_kinds(total, per_kind)
        runs = (
            lambda p=particles: mass_properties(p),
            lambda p=particles: sums_of(p),
            lambda p=particles: (p.position.sum(), p.mass.sum(), p.radius.sum()),
        )
        times = np.empty((REPEATS, len(runs)))
        for repeat in range(REPEATS):
            for k, run in enumerate(runs):
                start = time.perf_counter()
                run()
                times[repeat, k] = time.perf_counter() - start
        best = times[1:].min(axis=0) / total
        print(per_kind, *(f"{1e9 * t:.2f}" for t in best), f"{1 / best[1]:.2g}", sep=",")
    print_unions()


if __name__ == "__main__":
    main()
