"""Compare a run of ten_thousand_clumps to disk with h5py alone writing the same arrays.

    python benchmarks/trajectory_output.py [frames]

Both write the same fields in chunks of the same shape, float64, uncompressed, then flush. The
arrays of the reference come from memory, made before the clock starts. Rounds alternate; medians.
Goal: at most 1.5 times, with 1000 frames.
"""

import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.record.schema import frames_per_chunk
from particlerb.simulation.run import prepare, run_prepared

CASE = Path(__file__).parents[1] / "cases" / "ten_thousand_clumps.toml"
FIELDS = {"position": 3, "orientation": 4, "linear_momentum": 3, "angular_momentum": 3}
ROUNDS = 5


def with_h5py(path: Path, arrays: dict[str, np.ndarray], batch: int) -> float:
    """Seconds for h5py alone to append the arrays, some frames at a time."""
    start = time.perf_counter()
    with h5py.File(path, "w", locking=False) as file:
        sets = {}
        for name, values in arrays.items():
            n, c = values.shape[1:]
            shape = (frames_per_chunk(n, c, 8, len(values)), n, c)
            sets[name] = file.create_dataset(
                name, (0, n, c), "f8", maxshape=(None, n, c), chunks=shape
            )
        total = len(arrays["position"])
        for lo in range(0, total, batch):
            hi = min(lo + batch, total)
            for name, dataset in sets.items():
                dataset.resize(hi, axis=0)
                dataset[lo:hi] = arrays[name][lo:hi]
        file.flush()
    return time.perf_counter() - start


def compare(frames: int) -> tuple[float, float]:
    """Median seconds of a whole run and of h5py alone."""
    every = 10.0 / (frames - 1)
    prepared = prepare(to_system(load(CASE, [f"run.every={every!r}", "run.t_end=10.0"])))
    ours, theirs = [], []
    with tempfile.TemporaryDirectory(dir=".") as folder:
        run, reference = Path(folder) / "run.h5", Path(folder) / "reference.h5"
        run_prepared(prepared, run)
        with h5py.File(run) as file:
            arrays = {name: file[f"particles/trajectory/{name}/value"][:] for name in FIELDS}
        for _ in range(ROUNDS):
            run.unlink()
            start = time.perf_counter()
            run_prepared(prepared, run)
            ours.append(time.perf_counter() - start)
            theirs.append(with_h5py(reference, arrays, 7))
            reference.unlink()
    return float(np.median(ours)), float(np.median(theirs))


def main(frames: int = 1000) -> None:
    """Print the figures."""
    ours, theirs = compare(frames)
    print(f"ten_thousand_clumps, {frames} frames to disk, {frames * 10_000 * 13 * 8 / 1e9:.2f} GB")
    print(f"  run {ours:.2f} s, h5py alone {theirs:.2f} s, ratio {ours / theirs:.2f} (goal 1.5)")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1000)
