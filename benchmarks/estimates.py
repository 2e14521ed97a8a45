"""How well `check` tells the time and the size of a run: every example, warm.

    python benchmarks/estimates.py [CASE ...]

Prints a row per case: seconds told and taken by the whole command, and their ratio (3 are allowed);
bytes told and written (2). Its table is `benchmarks/results/estimates.csv`.
"""

import csv
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CASES = Path(__file__).parent.parent / "cases"
TABLE = Path(__file__).parent / "results" / "estimates.csv"
HEAD = ["case", "seconds told", "seconds taken", "ratio", "bytes told", "bytes written", "ratio"]
LONGEST = 600.0


def particlerb(*words):
    """Run a command of the program."""
    command = [sys.executable, "-m", "particlerb", *map(str, words)]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=LONGEST)


def row(case, folder):
    """What `check` says of a case, and what its second run takes."""
    path = folder / "run.h5"
    words = ("run", case, "-o", path, "--overwrite", "--quiet")
    particlerb(*words)
    told = json.loads(particlerb("check", case, "--json").stdout)
    start = time.perf_counter()
    particlerb(*words)
    taken = time.perf_counter() - start
    written = path.stat().st_size
    values = told["seconds"], taken, told["seconds"] / taken
    return [
        case.stem,
        *(f"{value:.3g}" for value in values),
        told["bytes"],
        written,
        f"{told['bytes'] / written:.3g}",
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
                rows.append([case.stem, *["-"] * 6])
            print(*(f"{value!s:>18}" for value in rows[-1]), flush=True)
    if not asked:
        with TABLE.open("w", newline="") as file:
            csv.writer(file).writerows([HEAD, *rows])


if __name__ == "__main__":
    main()
