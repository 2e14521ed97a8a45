"""Measure what parts of a solve for impulses take a contact: sweeps, residual, push-out, work.

    python benchmarks/impulse_sweep.py [--bodies 1000] [--contacts 3700] [--record]

Contacts join bodies that are near each other in memory, as those of a heap do, with random frames
and velocities; times are those of the processor on one thread, medians of seven. `--record` adds
the figures to results/impulse_sweep.csv. Goals: 34 ns a sweep, 40 ns with conjugate gradients.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
from results import record

from particlerb.impulses.bookkeeping import book_impulses
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.push_out import push_out
from particlerb.impulses.records import (
    FRICTION,
    GAP,
    LEAST,
    SLOW,
    TALLY,
    ImpulseRules,
    Impulses,
    room_for_partners,
    room_for_rows,
)
from particlerb.impulses.rows import write_frame
from particlerb.impulses.solver import _mix, _sweep, residual

NEAR = 60  # bodies between two that touch, at most
REPEATED = 100


def contacts(n: int, m: int) -> Impulses:
    """So many contacts of n balls of 1 kg and a wall."""
    rng, none = np.random.default_rng(0), np.zeros(0, dtype=np.int64)
    partners, rows = room_for_partners(n + 1), room_for_rows(m)
    partners.inverse[:n, [0, 1, 4, 6]] = 1.0, 20.0, 20.0, 20.0
    rows.first[:] = np.sort(rng.integers(0, n, m))
    rows.second[:] = np.minimum(rows.first + rng.integers(1, NEAR, m), n)
    for k, normal in enumerate(rng.normal(size=(m, 3))):
        point = rng.normal(0.0, 0.2, 3)
        write_frame(partners, rows, k, tuple(normal / np.linalg.norm(normal)), tuple(point))
    rows.frame[:, FRICTION], rows.frame[:, LEAST] = 0.5, 0.0
    rows.limits[:, GAP], rows.limits[:, SLOW] = rng.normal(0.0, 1e-4, m), 0.04
    partners.velocity[:n] = rng.normal(0.0, 0.01, (n, 6))
    newton = room_for_newton(np.zeros(0, dtype=np.bool_), none, none, 0)
    rules = ImpulseRules(np.zeros(1), 1e-3, 20, 0.3, 1e-5, 0.0, False)
    return Impulses(rules, partners, rows, np.array([m, -1]), np.zeros(TALLY), newton)


def nanoseconds(part: Callable[[], object], m: int) -> float:
    """Of the processor for one contact of a part."""
    part()
    found = []
    for _ in range(7):
        start = time.process_time()
        for _ in range(REPEATED):
            part()
        found.append(time.process_time() - start)
    return float(np.median(found)) / REPEATED / m * 1e9


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--bodies", type=int, default=1000)
    parser.add_argument("--contacts", type=int, default=3700)
    parser.add_argument("--record", action="store_true", help="add to results/impulse_sweep.csv")
    options = parser.parse_args()
    m, impulses = options.contacts, contacts(options.bodies, options.contacts)
    _, partners, rows, *_ = impulses

    def with_gradients() -> None:
        rows.old[:] = rows.impulse
        _sweep(partners, rows, None, m)
        _mix(partners, rows, None, m, 0.3, False)

    parts = {
        "push-out": lambda: push_out(impulses, None, 2e-3),  # first: sweeps change the velocities
        "sweep": lambda: _sweep(partners, rows, None, m),
        "sweep with conjugate gradients": with_gradients,
        "residual": lambda: residual(partners, rows, None, m, 1e-6, 1.0),
        "work": lambda: book_impulses(impulses, None),
    }
    figures = [(f"{name} [ns]", nanoseconds(part, m)) for name, part in parts.items()]
    for name, x in figures:
        print(f"{name:<40} {x:8.1f}")
    if options.record:
        record("impulse_sweep", figures)


if __name__ == "__main__":
    main()
