"""Measure how long a user waits: --help, and the first and the second run of each case.

    python benchmarks/startup.py [CASE ...] [--random 30] [--record]

Whole commands, wall and processor seconds, on all cores there are, with Python's bytecode in place
as an installer leaves it. The first run of a case compiles
into an empty cache, the second finds everything there. Random scenes of one to three bodies with
all kinds of forces share one cache, as those of somebody do who tries things out: what a scene
shares with those before it is not compiled again. Goals: 12 s wall for a first run, 20 s with
contact; random scenes 5 s in the median and 12 s at most, 1 s again. Without CASE all cases of
`cases/` are run; `--record` adds the figures to `results/startup.csv`, case by case.
"""

import argparse
import compileall
import os
import random
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from results import record

ROOT = Path(__file__).parents[1]
CASES = ROOT / "cases"
LONGEST = 900.0


def seconds(words: list[str], cache: str) -> tuple[float, float]:
    """Wall and processor seconds of a command; it may miss a check (3)."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "particlerb", *words],
        env={**os.environ, "NUMBA_CACHE_DIR": cache, "PYTHONDONTWRITEBYTECODE": ""},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    if done.returncode not in (0, 3):
        raise RuntimeError(done.stderr[-2000:])
    wall = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def both_runs(case: Path, folder: str, cache: str) -> dict[str, float]:
    """Seconds of the first run of a case, and of the second."""
    words = ["run", str(case), "-o", f"{folder}/run.h5", "--overwrite", "--quiet"]
    found = {}
    for which in ("first", "second"):
        wall, used = seconds(words, cache)
        found |= {f"{which} [s]": wall, f"{which} [CPU s]": used}
    return found


def random_scenes(folder: str, n: int) -> list[Path]:
    """So many random scenes that run, as files: those of tests/fuzz, without joints and contact."""
    sys.path.insert(0, str(ROOT / "tests" / "fuzz"))
    import fuzz_runs
    import tomlkit

    os.environ.pop("NUMBA_DISABLE_JIT", None)  # which that module sets for itself
    made: list[Path] = []
    number = 0
    while len(made) < n:
        dice, path = random.Random(number), Path(folder) / f"random{number}.toml"
        number += 1
        bodies = fuzz_runs.bodies_of(dice)
        forces = [fuzz_runs.force_of(dice, bodies, 1.0) for _ in range(dice.choice((1, 2, 3)))]
        case = {"run": {"t_end": 1.0, "every": 0.1}, "body": bodies, "force": forces}
        path.write_text(tomlkit.dumps(case))
        words = [sys.executable, "-m", "particlerb", "check", str(path)]
        if subprocess.run(words, capture_output=True, check=False).returncode == 0:
            made.append(path)
    return made


def main() -> None:
    """Print the figures, and keep them if that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", nargs="*", help="names of cases; default: all")
    parser.add_argument("--random", type=int, default=0, metavar="N", help="random scenes, too")
    parser.add_argument("--record", action="store_true", help="add them to results/startup.csv")
    asked = parser.parse_args()
    compileall.compile_dir(ROOT / "particlerb", quiet=1)
    keep = record if asked.record else lambda name, figures: None
    with tempfile.TemporaryDirectory() as folder:
        wall = statistics.median(seconds(["--help"], f"{folder}/help")[0] for _ in range(7))
        print(f"--help {wall:.2f} s, goal 0.15", flush=True)
        keep("startup", [("--help [s]", wall)])
        names = asked.case or ([] if asked.random else sorted(p.stem for p in CASES.glob("*.toml")))
        for name in names:
            found = both_runs(CASES / f"{name}.toml", folder, f"{folder}/{name}")
            print(f"{name:24}", *(f"{key} {value:.1f}" for key, value in found.items()), flush=True)
            keep("startup", [(f"{name}, {key}", value) for key, value in found.items()])
        scenes = random_scenes(folder, asked.random)
        runs = [both_runs(path, folder, f"{folder}/random") for path in scenes]
        for key in runs[0] if runs else ():
            values = [run[key] for run in runs]
            middle, most = statistics.median(values), max(values)
            print(f"{len(runs)} random scenes, {key}: median {middle:.2f}, at most {most:.2f}")
            keep("startup", [(f"random scenes, median, {key}", middle),
                             (f"random scenes, at most, {key}", most)])  # fmt: skip


if __name__ == "__main__":
    main()
