"""Room that a run takes on the disk."""

from typing import Final

import numpy as np

from particlerb.case.schema import Case
from particlerb.record.contact_writer import walls_wanted
from particlerb.record.schema import CONTACT_FIELDS, FIELDS

SMALLEST_FILE: Final = 600_000  # bytes of a file of few bodies and frames


def most_frames(case: Case) -> int:
    """Frames of a run, or a few more."""
    return int(case.run.t_end / case.run.every) + 2


def bytes_of_run(case: Case, n_frames: int) -> int:
    """Size of the fields of a run on disk [bytes], without the small rest."""
    item = np.dtype(case.output.dtype).itemsize
    per_body = FIELDS | CONTACT_FIELDS
    own = [per_body[name] for name in case.output.fields if name in per_body]
    width = sum(max(len(element.components), 1) for element in own)
    walls = 3 * len(walls_wanted(case)) * len(case.wall)
    return n_frames * (case.n_bodies * width * item + 8 * (21 + walls))
