"""How well `check` tells the time and the size of a run: every example, warm.

    python benchmarks/estimates.py [CASE ...]

Prints a row per case: seconds told and taken by the whole command on one thread, and their ratio
(3 are allowed); its processor seconds, which other work delays less; bytes told and written (2).
Its table is `benchmarks/results/estimates.csv`, each row with the load and the processor.
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
        "written", "ratio", "load", "processor"]  # fmt: skip
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
        processor().rsplit(", load ", 1)[0],
    ]


def main():
    """Print the rows of the cases that are asked for, or of all, and renew them in the table."""
    asked = [CASES / f"{name}.toml" for name in sys.argv[1:]]
    rows = csv.reader(TABLE.read_text().splitlines()) if TABLE.exists() else ()
    table = {old[0]: old for old in rows if (CASES / f"{old[0]}.toml").exists()}
    with tempfile.TemporaryDirectory() as folder:
        for case in asked or sorted(CASES.glob("*.toml")):
            try:
                table[case.stem] = row(case, Path(folder))
            except subprocess.TimeoutExpired:
                table[case.stem] = [case.stem, *["-"] * 10]
            print(*(f"{value!s:>18}" for value in table[case.stem]), flush=True)
            with TABLE.open("w", newline="") as file:
                rows = [HEAD, *sorted(table.values())]
                csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
