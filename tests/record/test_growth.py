"""Batches of very many frames: whole chunks, which go into the file without a copy in HDF5."""

import numpy as np

from particlerb.case.to_system import to_system
from particlerb.simulation import frame_times


def test_large_batches_end_where_chunks_do(make):
    """However the time that they take has let them grow."""
    system = to_system(make.case(make.body(), t_end=60.0, every=0.01))
    ends = np.cumsum([len(batch.times) for batch in frame_times.batches(system)])
    at_last = ends[(ends > 2048) & (ends < 6000)]
    assert at_last.size >= 3
    assert (at_last % 1024 == 0).all()
