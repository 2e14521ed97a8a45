"""Measure what parts of a solve for impulses take a contact: sweeps, residual, push-out, work.

    python benchmarks/impulse_sweep.py [--bodies 1000] [--contacts 3700] [--repeated 25] [--record]

Contacts join bodies that are near each other in memory, as those of a heap do, with random frames
and velocities. They are solved in the order of a list, and by colours on one thread and on two:
the least of many, by the processor for one thread, by the clock on the wall for two, which says
something only where nothing else runs. `--record` adds the figures to results/impulse_sweep.csv.
Goals: 34 ns a sweep, 40 ns with conjugate gradients; two threads 1.8 times as fast from 1e4
contacts on.
"""

import argparse
import time
from collections.abc import Callable
from functools import partial

import numpy as np
from results import record

from particlerb.compiled.barrier import Team, together
from particlerb.compiled.jit import kernel
from particlerb.compiled.threads import THREADS
from particlerb.impulses.colours import put_in_colours
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.push_out import push_out
from particlerb.impulses.records import (
    FRICTION,
    GAP,
    LEAST_VELOCITY,
    SLOW,
    TALLY,
    ImpulseRows,
    ImpulseRules,
    Impulses,
    Partners,
    room_for_partners,
    room_for_rows,
)
from particlerb.impulses.rows import write_frame
from particlerb.impulses.solver import Scales, _mix, _sweep, residual

NEAR = 60  # bodies between two that touch, at most
REPEATED = 20


def contacts(n: int, m: int, least: int) -> Impulses:
    """So many contacts of n balls of 1 kg and a wall, with colours if they are at least so many."""
    rng, none = np.random.default_rng(0), np.zeros(0, dtype=np.int64)
    partners, rows = room_for_partners(n + 1), room_for_rows(m)
    partners.inverse[:n, [0, 1, 4, 6]] = 1.0, 20.0, 20.0, 20.0
    rows.partner_a[:] = np.sort(rng.integers(0, n, m))
    rows.partner_b[:] = np.minimum(rows.partner_a + rng.integers(1, NEAR, m), n)
    rows.colours.counts[1] = least
    newton = room_for_newton(np.zeros(0, dtype=np.bool_), none, none, 0)
    rules = ImpulseRules(np.zeros(1), np.zeros(1), 1e-3, 20, 0.3, 1e-5, 0.0, False)
    count, tally = np.array([m, -1]), np.zeros(TALLY)
    impulses = Impulses(rules, partners, rows, count, tally, newton)
    put_in_colours(impulses)
    for k, normal in enumerate(rng.normal(size=(m, 3))):
        point = rng.normal(0.0, 0.2, 3)
        write_frame(partners, rows, k, tuple(normal / np.linalg.norm(normal)), tuple(point))
    rows.frame[:, FRICTION], rows.frame[:, LEAST_VELOCITY] = 0.5, 0.0
    rows.limits[:, GAP], rows.limits[:, SLOW] = rng.normal(0.0, 1e-4, m), 0.04
    partners.velocity[:n] = rng.normal(0.0, 0.01, (n, 6))
    return impulses


def nanoseconds(part: Callable[[Team], object], m: int, threads: int, repeated: int) -> float:
    """The least that a part takes for one contact."""
    clock = time.process_time if threads == 1 else time.perf_counter
    THREADS.use(threads)
    found = []
    for _ in range(repeated):
        start = clock()
        together(part, threads)
        found.append(clock() - start)
    return min(found[1:]) / REPEATED / m * 1e9


@kernel
def sweeps(partners: Partners, rows: ImpulseRows, team: Team, with_gradients: bool) -> None:
    """So many, from impulses and velocities as they are."""
    for _ in range(REPEATED):
        _sweep(partners, rows, team)
        if with_gradients:
            _mix(partners, rows, team, 0.3, False)


@kernel
def residuals(partners: Partners, rows: ImpulseRows, team: Team) -> float:
    """The sum of so many."""
    found = 0.0
    for _ in range(REPEATED):
        found += residual(partners, rows, team, Scales(1e-6, 1.0, 1.0, 0.0, 0.0))[0]
    return found


@kernel
def pushes(impulses: Impulses, team: Team) -> None:
    """So many."""
    for _ in range(REPEATED):
        push_out(impulses, team, 2e-3)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--bodies", type=int, default=1000)
    parser.add_argument("--contacts", type=int, default=3700)
    parser.add_argument("--repeated", type=int, default=25, help="of which the least counts")
    parser.add_argument("--record", action="store_true", help="add to results/impulse_sweep.csv")
    options = parser.parse_args()
    m, figures = options.contacts, []
    for order, least, threads in (("list", m + 1, 1), ("colours", 1, 1), ("colours", 1, 2)):
        impulses = contacts(options.bodies, m, least)
        _, partners, rows, *_ = impulses
        parts = {
            "push-out": partial(pushes, impulses),  # first: sweeps change the velocities
            "sweep": lambda team, p=partners, r=rows: sweeps(p, r, team, False),
            "sweep with conjugate gradients": lambda team, p=partners, r=rows: sweeps(
                p, r, team, True
            ),
            "residual": partial(residuals, partners, rows),
        }
        for name, part in parts.items():
            figure = f"{name}, {order}, {threads} threads [ns]"
            figures.append((figure, nanoseconds(part, m, threads, options.repeated)))
    for name, x in figures:
        print(f"{name:<60} {x:8.1f}")
    if options.record:
        record("impulse_sweep", figures)


if __name__ == "__main__":
    main()
