"""How well `check` tells the time and the size of a run: every example, warm.

    python benchmarks/estimates.py [CASE ...]

Prints a row per case: seconds told and taken by the whole command on one thread, and their ratio
(3 are allowed); its processor seconds, which other work delays less; bytes told and written (2).
Its table is `benchmarks/results/estimates.csv`, each row with the load of the machine.
"""

import csv
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from results import load, processor

CASES = Path(__file__).parent.parent / "cases"
TABLE = Path(__file__).parent / "results" / "estimates.csv"
HEAD = ["case", "seconds told", "taken", "ratio", "processor seconds", "ratio", "bytes told",
        "written", "ratio", "load"]  # fmt: skip
LONGEST = 600.0


def particlerb(*words):
    """Run a command of the program."""
    command = [sys.executable, "-m", "particlerb", *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=LONGEST)


def processor_seconds():
    """Of all commands so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def row(case, folder):
    """What `check` says of a case, and what its second run takes."""
    path = folder / "run.h5"
    words = ("run", case, "-o", path, "--overwrite", "--quiet", "--threads", 1)
    particlerb(*words)
    told = json.loads(particlerb("check", case, "--json").stdout)
    start, before = time.perf_counter(), processor_seconds()
    particlerb(*words)
    taken, used = time.perf_counter() - start, processor_seconds() - before
    written, seconds = path.stat().st_size, told["seconds"]
    values = seconds, taken, seconds / taken, used, seconds / used
    return [
        case.stem,
        *(f"{value:.3g}" for value in values),
        told["bytes"],
        written,
        f"{told['bytes'] / written:.3g}",
        load(),
    ]


def main():
    """Print the table, and write it where all cases were asked for."""
    asked = [CASES / f"{name}.toml" for name in sys.argv[1:]]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for case in asked or sorted(CASES.glob("*.toml")):
            try:
                rows.append(row(case, Path(folder)))
            except subprocess.TimeoutExpired:
                rows.append([case.stem, *["-"] * 9])
            print(*(f"{value!s:>18}" for value in rows[-1]), flush=True)
    if not asked:
        with TABLE.open("w", newline="") as file:
            csv.writer(file).writerows([[*HEAD, processor()], *rows])


if __name__ == "__main__":
    main()
