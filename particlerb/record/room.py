"""Room that a run takes on the disk, told before it starts and kept ahead while it writes."""

from typing import Final

import numpy as np

from particlerb.case.schema import Case
from particlerb.record.contacts import walls_wanted
from particlerb.record.schema import CONTACT_FIELDS, FIELDS

LARGEST_SPARE: Final = 8_000_000  # bytes that HDF5 may hold back in its caches, 1 MiB a dataset
SMALLEST_FILE: Final = 600_000  # bytes of a file of few bodies and frames


class FullDiskError(OSError):
    """The disk has no room for what comes next; what was written is whole."""


def most_frames(case: Case) -> int:
    """Frames of a run, or a few more."""
    return int(case.run.t_end / case.run.every) + 2


def spare_bytes(case: Case) -> int:
    """Room on the disk for what HDF5 has still to write when a run must end."""
    whole = bytes_of_run(case, most_frames(case))
    return min(LARGEST_SPARE, SMALLEST_FILE + 2 * whole)


def bytes_of_run(case: Case, n_frames: int) -> int:
    """Size of the fields of a run on disk [bytes], without the small rest."""
    item = np.dtype(case.output.dtype).itemsize
    per_body = FIELDS | CONTACT_FIELDS
    own = [per_body[name] for name in case.output.fields if name in per_body]
    width = sum(max(len(element.components), 1) for element in own)
    walls = 3 * len(walls_wanted(case)) * len(case.wall)
    return n_frames * (case.n_bodies * width * item + 8 * (21 + walls))
