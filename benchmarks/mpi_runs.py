"""Measure in a run of its own, on ranks of MPI or on none; the figures of all ranks come back."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from particlerb.ranks import Ranks


def figures_of(script: str, ranks: int, *words: object) -> list[dict[str, float]]:
    """Figures that a script prints with `print_figures`, on so many ranks; 0: without MPI."""
    beside = Path(sys.executable).with_name("mpiexec")
    mpiexec = str(beside) if beside.exists() else str(shutil.which("mpiexec"))
    start = [mpiexec, "-n", str(ranks)] if ranks else []
    called = [*start, sys.executable, script, *map(str, words)]
    done = subprocess.run(called, check=True, stdout=subprocess.PIPE, text=True)
    found: list[dict[str, float]] = json.loads(done.stdout)
    return found


def print_figures(ranks: Ranks | None, own: dict[str, Any]) -> None:
    """Print the figures of all ranks, on the first one."""
    each = type(ranks).gathered(ranks, own) if ranks is not None else [own]
    print(json.dumps(each), flush=True)
