"""How well contacts by impulses were solved: what frames show, and checks ask for."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from particlerb.case.output import Asked
from particlerb.impulses.records import (
    DEEPEST,
    DEEPEST_NOW,
    ELASTIC,
    FRICTION_WORK,
    IMPACT_WORK,
    IMPACTS,
    PUSH_OUT_WORK,
    SMALLEST_GAP,
    TALLY,
    WORST,
    WORST_EVER,
)
from particlerb.maths.vec3 import Floats

_COLUMNS: Final = {  # of a tally: since the last frame, and since t = 0
    "impulse_residual": (WORST, WORST_EVER),
    "impulse_overlap": (DEEPEST_NOW, DEEPEST),
    "push_out_work": (PUSH_OUT_WORK, PUSH_OUT_WORK),
    "impacts": (IMPACTS, IMPACTS),
    "elastic_impacts": (ELASTIC, ELASTIC),
    "smallest_gap": (SMALLEST_GAP, SMALLEST_GAP),
    "impact_work": (IMPACT_WORK, IMPACT_WORK),
    "friction_work": (FRICTION_WORK, FRICTION_WORK),
}


def impulse_fields(tallies: Mapping[int, Floats], rows: list[int]) -> dict[str, Floats]:
    """What some frames show, (T,) each; 0 where nothing can touch."""
    nothing = np.zeros(TALLY)
    found = np.array([tallies.get(row, nothing) for row in rows])
    return {name: found[:, now] for name, (now, _) in _COLUMNS.items()}


def impulse_quantity(asked: Asked, tally: Floats | None) -> Floats:
    """The largest residual or overlap until a time, or the work until then, (1,)."""
    return np.zeros(1) if tally is None else tally[[_COLUMNS[asked.quantity][1]]]
