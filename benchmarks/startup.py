"""Measure how long a user waits: --help, the first run of a case, the second.

    python benchmarks/startup.py

The first run compiles into an empty cache, and one with another set of forces into that of the
first. Wall and processor seconds of whole commands, best of
some rounds (of one, for the first run). Goals: 0.15 s, 15 s, 1.5 s.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CASES = Path(__file__).parents[1] / "cases"

DRAG = '[[force]]\ntype = "drag"\nbody = "top"\ntranslation = 0.1\n'


def seconds(words: list[str], cache: str, rounds: int = 1) -> tuple[float, float]:
    """Best wall and processor seconds of a command."""
    best = (float("inf"), float("inf"))
    for _ in range(rounds):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "particlerb", *words],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            stdout=subprocess.DEVNULL,
            check=True,
        )
        wall = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        best = min(best, (wall, used))
    return best


def main() -> None:
    """Print the figures."""
    print("start-up, wall s (processor s)")
    with tempfile.TemporaryDirectory() as folder:
        wall, used = seconds(["--help"], folder, 7)
        print(f"  --help                     {wall:6.2f} ({used:.2f}), goal 0.15")
        for name in ("tumbling_brick", "paper_cube"):
            words = ["run", str(CASES / f"{name}.toml"), "-o", f"{folder}/x.h5", "--overwrite"]
            cache = str(Path(folder) / name)
            wall, used = seconds(words, cache)
            print(f"  {name}, empty cache {wall:6.2f} ({used:.2f}), goal 15")
            wall, used = seconds(words, cache, 5)
            print(f"  {name}, again       {wall:6.2f} ({used:.2f}), goal 1.5")
        top, slowed = CASES / "heavy_top.toml", Path(folder) / "slowed.toml"
        plain = top.read_text().partition("[check]")[0].partition("[[check.value]]")[0]
        slowed.write_text(plain + DRAG)
        both = [["run", str(case), "-o", f"{folder}/x.h5", "--overwrite"] for case in (top, slowed)]
        wall, used = seconds(both[1], f"{folder}/alone")
        print(f"  heavy_top with drag, empty cache {wall:6.2f} ({used:.2f})")
        seconds(both[0], f"{folder}/behind")
        wall, used = seconds(both[1], f"{folder}/behind")
        print(f"  heavy_top with drag, behind heavy_top {wall:6.2f} ({used:.2f}), goal 5")


if __name__ == "__main__":
    main()
