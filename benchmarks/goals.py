"""Goals of speed beside what was last measured: one table, from results/*.csv; measures nothing.

    python benchmarks/goals.py > benchmarks/results/goals.md

Each line says which benchmark measures it; `--record` of that one renews it. Where nothing was
recorded the table says so. «now» is the newest figure, whatever the machine; which it was, with its
vectors, and the commit stand beside it.
"""

import csv
from typing import Final, NamedTuple

from results import FOLDER


class Goal(NamedTuple):
    """A figure that is asked for."""

    work: str
    limit: float  # that is asked for
    is_least: bool  # whether the figure should be as large at least; else as small
    script: str  # that measures it
    table: str  # of results/
    figure: str  # as the table calls it


def least(work: str, limit: float, script: str, table: str, figure: str) -> Goal:
    """A figure that should be as large at least: so many times as fast as another program."""
    return Goal(work, limit, True, script, table, figure)


def most(work: str, limit: float, script: str, table: str, figure: str) -> Goal:
    """A figure that should be as small."""
    return Goal(work, limit, False, script, table, figure)


_CALLS: Final = "free_bodies.py --calls", "calls"
_PEERS: Final = "against_peers.py", "peers"
_FORCED: Final = "forced_bodies.py", "forced"
_DROP: Final = "clump_drop.py", "clump_drop"
_TREE: Final = "attraction.py", "attraction"
_TOPS: Final = "1000 {} heavy tops, {} rad"

GOALS: Final = (
    most("one free body, t = 100, motion of a prepared scene [ms]", 0.06, *_CALLS,
         "one free body, motion [ms]"),
    most("the whole call `run(dict)` in memory [ms]", 5, *_CALLS, "run(dict) in memory [ms]"),
    most("the whole call `run(dict)` with a file [ms]", 12, *_CALLS, "run(dict) with a file [ms]"),
    least("1000 free bodies, 1e-6, motion, times SciPy's loop", 40, *_CALLS,
          "1000 free bodies, SciPy DOP853 / ours"),
    most("1e5 free bodies, one frame [ms]", 25, *_CALLS, "100 000 free bodies, one frame [ms]"),
    most("a recorded body-frame before the file [ns]", 15, *_CALLS,
         "a body-frame before the file [ns]"),
    least("1000 symmetric tops, 1e-6, kernels, times SciPy's DOP853", 50, *_PEERS,
          _TOPS.format("symmetric", "1e-06") + ", SciPy DOP853 / ours"),
    least("1000 asymmetric tops, 1e-6, kernels, times SciPy's DOP853", 7, *_PEERS,
          _TOPS.format("asymmetric", "1e-06") + ", SciPy DOP853 / ours"),
    least("1000 asymmetric tops, 1e-3, kernels, times SciPy's DOP853", 6, *_PEERS,
          _TOPS.format("asymmetric", "0.001") + ", SciPy DOP853 / ours"),
    least("symmetric tops as asked, 1e-6, search included, times SciPy's DOP853", 20, *_PEERS,
          _TOPS.format("symmetric", "1e-06") + " as asked, SciPy DOP853 / ours"),
    least("asymmetric tops as asked, 1e-6, search included, times SciPy's DOP853", 4, *_PEERS,
          _TOPS.format("asymmetric", "1e-06") + " as asked, SciPy DOP853 / ours"),
    most("strang [ns per body-step]", 6.5, *_FORCED, "strang, push [ns]"),
    most("rk4 [ns per body-step]", 7.5, *_FORCED, "rk4, push [ns]"),
    most("rkn6 [ns per body-step]", 80, *_FORCED, "rkn6, push [ns]"),
    most("clump drop, 1 s, of LAMMPS' time", 0.35, *_DROP, "1000 clumps, ours / LAMMPS"),
    most("tree, 1e5 points, error asked 1e-4 [s]", 0.35, *_TREE, "1e5 points, 1e-4, loads [s]"),
)  # fmt: skip


def newest(table: str) -> dict[str, list[str]]:
    """Last row of each figure of a table."""
    path = FOLDER / f"{table}.csv"
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {row[3]: row for row in list(csv.reader(file))[1:]}


def line(goal: Goal) -> str:
    """A goal as a line of the table."""
    sign = "≥" if goal.is_least else "≤"
    row = newest(goal.table).get(goal.figure)
    if row is None:
        return f"| {goal.work} | {sign} {goal.limit:g} | - | not measured | `{goal.script}` |"
    date, commit, processor, _, value = row
    now = float(value)
    is_met = now >= goal.limit if goal.is_least else now <= goal.limit
    verdict = "met" if is_met else "**missed**"
    made = f"`{goal.script}`, {date}, {commit}, {processor}"
    return f"| {goal.work} | {sign} {goal.limit:g} | {now:.3g} | {verdict} | {made} |"


def main() -> None:
    """Print the table."""
    print("| work | goal | now | | measured by |\n| --- | ---: | ---: | --- | --- |")
    print("\n".join(map(line, GOALS)))


if __name__ == "__main__":
    main()
