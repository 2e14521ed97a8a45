"""How long a run will take: a trial of its first steps, by the clock."""

import time
from typing import Final

import numpy as np

from particlerb.case.run import frame_count
from particlerb.compiled.jit import compiling
from particlerb.compiled.plain import all_compiled
from particlerb.compiled.threads import THREADS
from particlerb.record.file_size import estimated_size
from particlerb.simulation.frame_times import frame_times
from particlerb.simulation.whole_run import Prepared, Run

_LAST_PIECE_SECONDS: Final = 0.3  # of a trial, at least
_FIRST_SHARE: Final = 2.0**-24  # of the run; it compiles. A step, where that is longer,
_MOST_FIRST_SHARE: Final = 2.0**-4  # up to this: a part of a step costs as much as a whole one
_WRITE_BYTES_PER_SECOND: Final = 2e8  # to a file


def estimated_seconds(prepared: Prepared) -> float:
    """Wall time of the motion of a run and of its file [s], compilation aside.

    The run is made in pieces, from a step on, each twice as long as that before, until one has
    taken 0.3 s and compiled nothing; the rest is taken to go on at the speed of that one.

    Raises
    ------
    RunError
        If one of these pieces fails, as the run would.
    """
    run, end = Run(prepared), prepared.system.run.t_end
    every, n_frames = prepared.system.run.every, frame_count(prepared.system.run)
    steps = [segment.dt for group in prepared.plan.groups for segment in group.segments]
    first_length = min(max(end * _FIRST_SHARE, *steps), end * _MOST_FIRST_SHARE)
    spent, reached, length = 0.0, 0.0, first_length
    with THREADS.using(prepared.system.run.threads), all_compiled():
        while reached < end:
            until = min(reached + length, end)
            first, stop = int(reached / every), min(int(until / every) + 2, n_frames)
            times = frame_times(prepared.system.run, min(first, n_frames - 1), stop)
            times = np.union1d(times[(times > reached) & (times <= until)], until)
            start = time.perf_counter()
            with compiling() as compiled:
                *_, error = run.frames_at(times, np.full(times.size, True))
            if error is not None:
                raise error
            piece = time.perf_counter() - start - sum(compiled)
            spent += piece if reached else 0.0
            length, last, reached = 2.0 * length, until - reached, until
            if piece >= _LAST_PIECE_SECONDS and not compiled and last > first_length:
                spent += piece * (end - reached) / last
                break
    n_bytes = estimated_size(prepared.system, n_frames)
    return spent + n_bytes / _WRITE_BYTES_PER_SECOND
