"""Measure writing and reading of trajectory files beside h5py alone.

    python benchmarks/files.py [--frames 200]

Writing: the recorder, given frames from memory, beside h5py that appends the same arrays in chunks
of the same shape. One body: a million frames. Reading: one body over all frames, and one frame, of
a file of 10 000 bodies. Checksums: ours beside HDF5's fletcher32. Rounds take turns, the best
counts. Commits: the share of the processor's time for records and for pages in their places, once a
second, with checkpoints where they are due; what the disk takes for its syncs comes on top.
Goals: 0.7 of h5py; 1e5 frames a second; 0.2 s and 10 ms with 1000 frames; 5 % for commits.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from results import record

import particlerb
from particlerb.case.reader import load
from particlerb.case.schema import Case
from particlerb.case.to_system import to_system
from particlerb.model.balance import Entries
from particlerb.model.state import Frames, as_frame
from particlerb.model.system import System
from particlerb.record.atomic import AtomicFile
from particlerb.record.checksums import frame_checksums
from particlerb.record.frame_values import NewFrames
from particlerb.record.layout import tables_of
from particlerb.record.provenance import texts_of
from particlerb.record.schema import frames_per_chunk, rows_per_chunk
from particlerb.record.writer import Recorder

FIELDS = ("position", "orientation", "linear_momentum", "angular_momentum")
NUMBERS = 22  # of a frame: step, time (twice), offset, checksum, ledger
BATCH = 7  # frames of many bodies
ROUNDS = 5


def case_of(n: int, frames: int) -> Case:
    """Case of n bodies."""
    shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
    place = {"type": "grid", "spacing": 1.0}
    body = {"name": "b", "shape": shape, "mass": 1.0, "count": n, "place": place}
    return load({"run": {"t_end": float(frames - 1), "every": 1.0}, "body": [body]})


def batch_of(system: System, size: int) -> tuple[Frames, Entries]:
    """Frames and ledger entries that any batch of the run may have."""
    one = as_frame(system.bodies, system.state)
    arrays = [np.repeat(a, size, axis=0) for a in one[:4]]
    arrays = [a + np.random.default_rng(1).standard_normal(a.shape) for a in arrays]
    wide = ("linear_momentum", "angular_momentum")
    entries = Entries(
        *(np.ones((size, 3) if name.startswith(wide) else size) for name in Entries._fields)
    )
    return Frames(*arrays, one.last, np.ones(size, dtype=np.bool_)), entries


def with_recorder(
    path: Path,
    system: System,
    frames: int,
    batch: int,
    checkpoint: Callable[[], dict[str, Any]] | None = None,
) -> float:
    """Seconds for the recorder."""
    given, entries = batch_of(system, batch)
    start = time.perf_counter()
    content = tables_of(system) | texts_of(system, {})
    recorder = Recorder(path, system, content, overwrite=True)
    for lo in range(0, frames, batch):
        rows = np.arange(min(batch, frames - lo))
        recorder.append(NewFrames(lo + rows.astype(float), given, rows, entries))
        recorder.commit_if_due(checkpoint)
    recorder.finish()
    return time.perf_counter() - start


def with_h5py(
    path: Path, system: System, frames: int, batch: int, numbers: bool = False, **keys: Any
) -> float:
    """Seconds for h5py alone; with the numbers of a frame too, which are written in the end."""
    given, _ = batch_of(system, batch)
    start = time.perf_counter()
    with h5py.File(path, "w", locking=False) as file:
        sets = {}
        for name in FIELDS:
            n, c = getattr(given, name).shape[1:]
            chunks = (frames_per_chunk(n, c, 8, frames), n, c)
            sets[name] = file.create_dataset(
                name, (0, n, c), "f8", maxshape=(None, n, c), chunks=chunks, **keys
            )
        for lo in range(0, frames, batch):
            hi = min(lo + batch, frames)
            for name, dataset in sets.items():
                dataset.resize(hi, axis=0)
                dataset[lo:hi] = getattr(given, name)[: hi - lo]
        for k in range(NUMBERS if numbers else 0):
            file.create_dataset(f"{k}", data=np.ones(frames), chunks=(rows_per_chunk(frames),))
        file.flush()
    return time.perf_counter() - start


def best(works: dict[str, Callable[[], float]]) -> dict[str, float]:
    """Least seconds of each of some works, which take turns."""
    for work in works.values():
        work()
    rounds = [{name: work() for name, work in works.items()} for _ in range(ROUNDS)]
    return {name: min(one[name] for one in rounds) for name in works}


def timed(work: Callable[[], object]) -> float:
    """Seconds of one call."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def writing(folder: Path, n: int, frames: int, batch: int) -> tuple[float, float, float]:
    """Share of the speed of h5py alone, of h5py with as many numbers, and frames a second."""
    system = to_system(case_of(n, frames))
    found = best(
        {
            "recorder": lambda: with_recorder(folder / "a.h5", system, frames, batch),
            "h5py": lambda: with_h5py(folder / "b.h5", system, frames, batch),
            "all": lambda: with_h5py(folder / "b.h5", system, frames, batch, numbers=True),
            "fletcher32": lambda: with_h5py(
                folder / "b.h5", system, frames, batch, fletcher32=True
            ),
        }
    )
    share, speed = found["h5py"] / found["recorder"], frames / found["recorder"]
    print(
        f"{n} bodies, {frames} frames: {speed:.3g} frames a second, {share:.2f} of the speed of"
        f" h5py alone, {found['all'] / found['recorder']:.2f} where it writes as many numbers;"
        f" h5py with fletcher32 {found['h5py'] / found['fletcher32']:.2f}"
    )
    return share, found["all"] / found["recorder"], speed


def reading(folder: Path, frames: int) -> tuple[float, float]:
    """Seconds for one body over all frames, and for one frame; all four fields."""
    with_recorder(folder / "a.h5", to_system(case_of(10_000, frames)), frames, BATCH)

    def body() -> object:
        with particlerb.open(folder / "a.h5") as t:
            return [t.read(name, bodies=1234) for name in FIELDS]

    def frame() -> object:
        with particlerb.open(folder / "a.h5") as t:
            return [t.read(name, slice(frames // 2, frames // 2 + 1)) for name in FIELDS]

    found = best({"body": lambda: timed(body), "frame": lambda: timed(frame)})
    print(
        f"10000 bodies, {frames} frames, {len(FIELDS)} fields, the file opened anew: one body"
        f" {found['body']:.3f} s, one frame {1e3 * found['frame']:.1f} ms"
    )
    return found["body"], found["frame"]


def commits(folder: Path, n: int, frames: int, batch: int) -> float:
    """Share of the processor's time for commits, without that for syncs."""
    system = to_system(case_of(n, frames))
    spent = {"commit": 0.0, "fsync": 0.0}

    def counted(name: str, work: Callable[[Any], None]) -> Callable[[Any], None]:
        def timed(argument: Any) -> None:
            start = time.process_time()
            work(argument)
            spent[name] += time.process_time() - start

        return timed

    state = np.random.default_rng(1).standard_normal((13, n))
    before = AtomicFile.commit, os.fsync
    AtomicFile.commit, os.fsync = (  # type: ignore[method-assign]
        counted("commit", before[0]),
        counted("fsync", before[1]),
    )
    start = time.process_time()
    try:
        with_recorder(folder / "a.h5", system, frames, batch, lambda: {"state": state})
    finally:
        AtomicFile.commit, os.fsync = before  # type: ignore[method-assign]
    whole = time.process_time() - start - spent["fsync"]
    share = (spent["commit"] - spent["fsync"]) / whole
    print(
        f"{n} bodies, {frames} frames: {100 * share:.1f} % of {whole:.2f} s in commits, and"
        f" {spent['fsync']:.2f} s in syncs"
    )
    return share


def checksums() -> float:
    """Speed of the checksum [GB/s]."""
    values = np.random.default_rng(1).standard_normal((BATCH, 10_000, 13))
    seconds = min(timed(lambda: frame_checksums(BATCH, [values])) for _ in range(50))
    print(f"checksums: {values.nbytes / seconds / 1e9:.0f} GB/s")
    return values.nbytes / seconds / 1e9


def main() -> None:
    """Print everything."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1000, help="of 10 000 bodies")
    parser.add_argument("--record", action="store_true", help="add to results/files.csv")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=".") as name:
        share, *_ = writing(Path(name), 10_000, options.frames // 5, BATCH)
        lone, alike, speed = writing(Path(name), 1, 1_000_000, 1024)
        body, frame = reading(Path(name), options.frames)
        few = commits(Path(name), 1, 3_000_000, 1024)
        many = commits(Path(name), 20_000, options.frames // 10, 2)
    figures = [
        ("writing, 10000 bodies, of h5py alone", share),
        ("writing, one body, of h5py alone", lone),
        ("writing, one body, of h5py with as many numbers", alike),
        ("writing, one body [frames/s]", speed),
        ("one body, all frames [s]", body),
        ("one frame [s]", frame),
        ("commits, one body [share of the time]", few),
        ("commits, 20000 bodies [share of the time]", many),
        ("checksums [GB/s]", checksums()),
    ]
    if options.record:
        record("files", figures)


if __name__ == "__main__":
    main()
