"""Size of the file of a run, known before it is written."""

from typing import Final

import numpy as np

from particlerb.model.system import System
from particlerb.record.schema import CONTACT_FIELDS, COORDINATES, FIELDS, JOINTS, WALLS

SMALLEST_FILE: Final = 260_000  # bytes of a file of few bodies and frames


def estimated_size(system: System, n_frames: int) -> int:
    """Size of the fields of a run on disk [bytes], without the small rest."""
    item = np.dtype(system.output.dtype).itemsize
    per_body = FIELDS | CONTACT_FIELDS
    fields = system.output.fields
    width = sum(max(len(per_body[name].components), 1) for name in fields if name in per_body)
    walls = 3 * sum(name in WALLS for name in fields) * len(system.wall)
    n_joints = sum(system.names.scene.find_in_order(t.body).size - t.chain for t in system.joint)
    joints = sum(max(len(JOINTS[name].components), 1) for name in fields if name in JOINTS)
    joints += 3 * any(name in COORDINATES for name in fields)
    return n_frames * (system.n_of_scene * width * item + 8 * (21 + walls + joints * n_joints))
