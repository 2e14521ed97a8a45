"""Keeps the answers of benchmarks by commit, in results/*.csv: date, commit, machine, figures."""

import csv
import datetime as dt
import os
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

import llvmlite.binding

from particlerb.compiled.vector_width import is_wide
from particlerb.compiled.vector_width import processor as known_as

FOLDER = Path(__file__).parent / "results"


def processor() -> str:
    """Name of the processor where the system tells, LLVM's name for it, its vectors, its load."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    except (OSError, IndexError):
        name = platform.processor() or platform.machine()
    return f"{name}, {known_as()}, vectors of {vector_bits()} bits, {load()}"


def load() -> str:
    """Programs that want a core, over the last minute, and the cores there are."""
    if not hasattr(os, "getloadavg"):
        return "load unknown"
    return f"load {os.getloadavg()[0]:.0f} on {os.cpu_count()} cores"


def vector_bits() -> int:
    """Bits of the vectors that kernels use: LLVM takes 512 by itself on AMD's processors alone."""
    has = llvmlite.binding.get_host_cpu_features()
    if has.get("avx512f") and (is_wide() or known_as().startswith("znver")):
        return 512
    return 256 if has.get("avx2") else 128


def commit() -> str:
    """The commit that was measured; with + where the sources differ from it."""
    git = ["git", "-C", str(FOLDER.parents[1])]
    told = [*git, "describe", "--always", "--abbrev=10"]
    name = subprocess.run(told, capture_output=True, text=True, check=False).stdout.strip()
    differs = [*git, "diff", "--quiet", "HEAD", "--", "particlerb", "cases", "benchmarks/*.py"]
    is_clean = subprocess.run(differs, capture_output=True, check=False).returncode == 0
    return (name + "+" * (not is_clean)) if name else "unknown"


def record(name: str, figures: Sequence[tuple[str, float]]) -> None:
    """Add figures to the table of a benchmark."""
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"{name}.csv"
    is_new = not path.exists()
    today = dt.datetime.now(tz=dt.UTC).date().isoformat()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(("date", "commit", "processor", "figure", "value"))
        for figure, value in figures:
            writer.writerow((today, commit(), processor(), figure, f"{value:.4g}"))
    print(f"written: {path}")
