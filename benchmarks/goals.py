"""Goals of speed beside what was last measured: one table, from results/*.csv; measures nothing.

    python benchmarks/goals.py > benchmarks/results/goals.md

Each line says which benchmark measures it; `--record` of that one renews it. Where nothing was
recorded the table says so. «now» is the newest figure, whatever the machine; which it was, with its
vectors and its load, and the commit stand beside it.
"""

import csv
import math
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
    over: str = ""  # figure of the same table that it is divided by, if any
    times: float = 1.0  # and by which it is multiplied


def least(work: str, limit: float, script: str, table: str, figure: str) -> Goal:
    """A figure that should be as large at least: so many times as fast as another program."""
    return Goal(work, limit, True, script, table, figure)


def most(work: str, limit: float, script: str, table: str, figure: str) -> Goal:
    """A figure that should be as small."""
    return Goal(work, limit, False, script, table, figure)


_CALLS: Final = "free_bodies.py --calls", "calls"
_PEERS: Final = "against_peers.py", "peers"
_CHOICE: Final = "accuracy.py", "accuracy"
_FORCED: Final = "forced_bodies.py", "forced"
_DROP: Final = "clump_drop.py", "clump_drop"
_TREE: Final = "attraction.py", "attraction"
_START: Final = "startup.py", "startup"
_EVENTS: Final = "events.py", "events"

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
    least("1000 symmetric tops, 1e-6, kernels, times SciPy's DOP853", 50, *_CHOICE,
          "symmetric tops; 1e-06; kernels"),
    least("1000 asymmetric tops, 1e-6, kernels, times SciPy's DOP853", 7, *_CHOICE,
          "asymmetric tops; 1e-06; kernels"),
    least("1000 asymmetric tops, 1e-3, kernels, times SciPy's DOP853", 6, *_CHOICE,
          "asymmetric tops; 0.001; kernels"),
    least("symmetric tops as asked, 1e-6, search included, times SciPy's DOP853", 20, *_PEERS,
          "1000 symmetric heavy tops, 1e-06 rad as asked, SciPy DOP853 / ours"),
    least("asymmetric tops as asked, 1e-6, search included, times SciPy's DOP853", 4, *_PEERS,
          "1000 asymmetric heavy tops, 1e-06 rad as asked, SciPy DOP853 / ours"),
    most("strang [ns per body-step]", 6.5, *_FORCED, "strang, push [ns]"),
    most("rk4 [ns per body-step]", 7.5, *_FORCED, "rk4, push [ns]"),
    most("rkn6 [ns per body-step]", 80, *_FORCED, "rkn6, push [ns]"),
    most("clump drop, 1 s, of LAMMPS' time", 0.35, *_DROP, "1000 clumps, 1 s, ours / LAMMPS"),
    most("clump drop, 2 s, of LAMMPS' time", 0.4, *_DROP, "1000 clumps, 2 s, ours / LAMMPS"),
    most("clump drop, resting heap, of LAMMPS' time", 0.45, *_DROP,
         "1000 clumps, resting heap, ours / LAMMPS"),
    least("clump drop of 1000, two threads", 1.85, *_DROP, "1000 clumps, two threads"),
    least("clump drop of 8000, two threads", 1.85, *_DROP, "8000 clumps, two threads"),
    most("tree, 1e5 points of a ball, error asked 1e-4 [s]", 0.35, *_TREE,
         "tree, ball of 100000, error 0.0001 asked [s]"),
    Goal("tree, 1e5 points of a ball, error asked 1e-4, times pytreegrav", 8, True, *_TREE,
         "tree, ball of 100000, pytreegrav [s]", "tree, ball of 100000, error 0.0001 asked [s]"),
    *(Goal(f"tree, cost of a point of a {scene}, 1e5 of 1e4", 1.35, False, *_TREE,
           f"tree, {scene} of 100000, error 0.0001 asked [s]",
           f"tree, {scene} of 10000, error 0.0001 asked [s]", 0.1) for scene in ("ball", "sphere")),
    *(most(f"collision by events among {n} balls [µs]", 5, *_EVENTS,
           f"{n} balls: µs a collision") for n in (1000, 100000)),
    Goal("collision by events, 1e5 balls of 1e3", 1.5, False, *_EVENTS,
         "100000 balls: µs a collision", "1000 balls: µs a collision"),
    *(most(f"first run of {name}, wall [s]", 20 if name == "clump_drop" else 12, *_START,
           f"{name}, first [s]")
      for name in ("tumbling_brick", "heavy_top", "spring_net", "clump_drop", "binary_asteroid")),
    most("first run of a random scene, median of 20 to 30 [s]", 5, *_START,
         "random scenes, median, first [s]"),
    most("first run of a random scene, the longest of 20 to 30 [s]", 12, *_START,
         "random scenes, at most, first [s]"),
    most("second run of a random scene, the longest of 20 to 30 [s]", 1, *_START,
         "random scenes, at most, second [s]"),
)  # fmt: skip


def beside_scipy() -> dict[str, list[str]]:
    """Times of SciPy's loop over ours, of the table of choices that run.accuracy makes."""
    found = {}
    with (FOLDER / "accuracy.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            peer, motion = float(row["SciPy DOP853 [ms]"]), float(row["motion [ms]"])
            if row["commit"] != "-" and math.isfinite(peer):
                figure = f"{row['scene']}; {row['wanted']}; kernels"
                found[figure] = ["", row["commit"], row["processor"], figure, str(peer / motion)]
    return found


def newest(table: str) -> dict[str, list[str]]:
    """Last row of each figure of a table."""
    path = FOLDER / f"{table}.csv"
    if table == "accuracy":
        return beside_scipy()
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        return {row[3]: row for row in list(csv.reader(file))[1:]}


def line(goal: Goal) -> str:
    """A goal as a line of the table."""
    sign = "≥" if goal.is_least else "≤"
    known = newest(goal.table)
    row, lowest = known.get(goal.figure), known.get(f"{goal.figure}, least")
    under = known.get(goal.over) if goal.over else [*"----", "1"]
    if row is None or under is None:
        return f"| {goal.work} | {sign} {goal.limit:g} | - | not measured | `{goal.script}` |"
    date, commit, processor, _, value = row
    now = float(value) * goal.times / float(under[4])
    is_met = now >= goal.limit if goal.is_least else now <= goal.limit
    verdict = "met" if is_met else "**missed**"
    made = ", ".join(filter(None, (f"`{goal.script}`", date, commit, processor)))
    shown = f"{now:.3g}" if lowest is None else f"{now:.3g} (least {float(lowest[4]):.3g})"
    return f"| {goal.work} | {sign} {goal.limit:g} | {shown} | {verdict} | {made} |"


def main() -> None:
    """Print the table."""
    print("| work | goal | now | | measured by |\n| --- | ---: | ---: | --- | --- |")
    print("\n".join(map(line, GOALS)))


if __name__ == "__main__":
    main()
