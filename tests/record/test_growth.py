"""Very many frames: batches of whole chunks, and memory that does not grow with their number."""

import tracemalloc

import h5py
import numpy as np

from particlerb.case.to_system import to_system
from particlerb.model.balance import Entries
from particlerb.record import schema, writer
from particlerb.record.frame_values import NewFrames
from particlerb.record.layout import tables_of
from particlerb.record.provenance import texts_of
from particlerb.simulation import frame_times
from particlerb.simulation.run import Run, prepare


def test_large_batches_end_where_chunks_do(make):
    """However the time that they take has let them grow."""
    system = to_system(make.case(make.body(), t_end=60.0, every=0.01))
    ends = np.cumsum([len(batch.times) for batch in frame_times.batches(system)])
    at_last = ends[(ends > 2048) & (ends < 6000)]
    assert at_last.size >= 3
    assert (at_last % 1024 == 0).all()


def recorder_of(make, path, frames):
    """A recorder for so many frames of one body, and a function that appends some of them."""
    system = to_system(make.case(make.body(), t_end=0.01 * frames, every=0.01))
    recorder = writer.Recorder(path, system, tables_of(system) | texts_of(system, {}))
    times = np.zeros(1000)
    states, ledger, _ = Run(prepare(system)).frames_at(times, np.ones(1000, dtype=bool))

    def append(n):
        entries = Entries(*(e[:n] for e in ledger))
        recorder.append(NewFrames(times[:n], states, np.arange(n), entries))

    return recorder, append


def test_memory_does_not_grow_with_the_number_of_frames(make, tmp_path):
    """Though no commit comes: 160 bytes of small arrays for each frame would be 16 MB."""
    recorder, append = recorder_of(make, tmp_path / "many.h5", 100_000)
    recorder.last_commit = np.inf
    append(1000)
    tracemalloc.start()
    for _ in range(99):
        append(1000)
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    recorder.finish()
    assert largest < 2 * writer.MOST_WAITING
    with h5py.File(tmp_path / "many.h5") as file:
        assert (file[schema.STEP][:] == np.arange(100_000)).all()
