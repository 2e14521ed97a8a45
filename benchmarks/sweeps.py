"""Measure variants of a sweep that share a batch against those that run one by one.

    python benchmarks/sweeps.py [--variants 1000] [--alone 20] [--record]

`slide_to_roll` with another friction in each variant; times are those of the processor, on one
thread, when all is compiled. `--record` adds the figures to results/sweeps.csv. Goal: a batch of
1000 scenes with contact is 20 times as fast as the same scenes one by one.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
from results import record

from particlerb.case.problems import path_of
from particlerb.case.reader import load
from particlerb.case.sweep import SweepTable
from particlerb.compiled.threads import THREADS
from particlerb.sweeping.rows import Row
from particlerb.sweeping.worker import Task, work

CASE, KEY = "slide_to_roll", "contact.friction"
ASKED = ({"body": "solid", "quantity": "velocity"},)


def seconds(run: Callable[[], list[Row]]) -> tuple[float, list[Row]]:
    """Processor time of a run that is done for the second time, and its rows."""
    run()
    start = time.process_time()
    rows = run()
    return time.process_time() - start, rows


def main() -> None:
    """Print what a variant takes in a batch and alone, and whether the rows are equal."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--variants", type=int, default=1000)
    parser.add_argument("--alone", type=int, default=20)
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    THREADS.use(1)
    n, k = args.variants, args.alone
    values = tuple((mu,) for mu in np.linspace(0.1, 0.3, n).tolist())
    asked = SweepTable(axes={KEY: [0.1]}, value=ASKED).value
    task = Task(tuple(range(n)), values, (path_of(KEY),), load(CASE).source, asked, True)
    batch, together = seconds(lambda: work(task))
    few = task._replace(numbers=task.numbers[:k], values=values[:k], is_batch=False)
    alone, rows = seconds(lambda: work(few))
    ratio = alone / k / (batch / n)
    same = repr(rows) == repr(together[:k])
    print(f"batch of {n}: {1e3 * batch / n:.2f} ms a variant; alone {1e3 * alone / k:.1f} ms")
    print(f"{ratio:.1f} times as fast; rows {'have the same bits' if same else 'DIFFER'}")
    if args.record:
        figures = [
            (f"ms a variant, {n} together", 1e3 * batch / n),
            ("ms a variant, alone", 1e3 * alone / k),
            ("times as fast", ratio),
        ]
        record("sweeps", figures)


if __name__ == "__main__":
    main()
