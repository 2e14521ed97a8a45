"""When a run looks at its bodies: frames, times of checks, and batches of both."""

import time
from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from particlerb.case.run import RunTable, frame_count
from particlerb.maths.vec3 import Bools, Floats
from particlerb.model.system import System
from particlerb.ranks import ALONE, Ranks

_BATCH_BYTES = 32_000_000  # of frames that are held before they are written
BATCH_FRAMES = 1024
BATCH_SECONDS = 0.5  # that a batch should take
FIRST_BATCH = 1  # frames, before it is known how long one takes
_MIN_ALIGNED_FRAMES = 64  # frames of a batch from which on it ends at a multiple of its size
_MAX_EXACT_INTEGER = 2**53  # integers up to this are doubles: their ratio is rounded once


def frame_times(run: RunTable, first: int = 0, stop: int | None = None) -> Floats:
    """Times [s] of all frames, or of those from `first` on and before `stop`."""
    n = frame_count(run)
    stop = n if stop is None else stop
    times = multiples(run.every, first, stop)
    if stop == n:
        times[-1] = run.t_end
    return times


def multiples(every: float, first: int, stop: int) -> Floats:
    """Multiples first .. stop - 1 of a number, as one would write them: 3 times 0.7 is 2.1.

    The float 0.7 is a little less than 7/10; three times that may fall before an edge at 2.1 s.
    """
    k = np.arange(first, stop, dtype=np.float64)
    decimal = Fraction(repr(every))
    above, below = decimal.numerator, decimal.denominator
    if max(above, below) > _MAX_EXACT_INTEGER:
        return np.float64(every) * k
    return np.where(k * above <= _MAX_EXACT_INTEGER, k * above / below, every * k)


def whole_frames(run: RunTable) -> int:
    """Number of frames that a run to any later end has as well."""
    n = frame_count(run)
    return n if multiples(run.every, n - 1, n)[0] == run.t_end else n - 1


class Batch(NamedTuple):
    """Times that are computed together."""

    times: Floats  # [s]
    is_frame: Bools  # which are frames,
    is_probe: Bools  # and which a check asks for
    is_whole_end: bool  # whether it ends with the last frame that a longer run has as well
    is_odd: bool  # whether it is the frame at t_end, which a longer run has not


def frames_at_once(system: System) -> int:
    """Frames that are held before they are written."""
    return int(min(max(_BATCH_BYTES // (max(system.n_bodies, 1) * 13 * 8), 1), BATCH_FRAMES))


def batches(
    system: System, done: int = 0, ranks: Ranks = ALONE, first: int = 0, reached: float = 0.0
) -> Iterator[Batch]:
    """Times of a run, or of its rest behind some frames.

    As many as fit into the cache and take about half a second, so that a long run is written,
    shows progress and can be interrupted. Large ones end where chunks of the file do, as far as
    their sizes allow: whole chunks are written without a copy. All ranks take the same. `first` is
    how many frames the first has, if it is given; none has times until `reached` [s].
    """
    most, n = frames_at_once(system), frame_count(system.run)
    n_whole = whole_frames(system.run)
    asked = [system.run.t_end if v.time is None else v.time for v in system.check.value]
    probes = np.unique(np.array(asked, dtype=np.float64))
    if done:
        probes = probes[probes > max(float(frame_times(system.run, done - 1, done)[0]), reached)]
    size = min(first or FIRST_BATCH, most)
    while done < n:
        stop = n_whole if done < n_whole else n
        over = (done + size) % size if size >= _MIN_ALIGNED_FRAMES else 0
        frames = frame_times(system.run, done, min(done + size - over, stop))
        due, probes = probes[probes <= frames[-1]], probes[probes > frames[-1]]
        times = np.union1d(frames, due) if due.size else frames
        start = time.monotonic()
        done += len(frames)
        none = (times >= 0.0, times < 0.0)
        masks = (np.isin(times, frames), np.isin(times, due)) if due.size else none
        yield Batch(times, *masks, done == n_whole, done > n_whole)
        share = BATCH_SECONDS / max(time.monotonic() - start, 1e-9)
        size = min(ranks.gathered(int(min(max(size * min(share, 4.0), 1), most))))
