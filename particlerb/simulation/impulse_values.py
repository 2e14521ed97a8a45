"""How well contacts by impulses were solved: what frames show, and checks ask for."""

from collections.abc import Mapping
from typing import Final

import numpy as np

from particlerb.case.output import SweepValue
from particlerb.impulses import records
from particlerb.maths.vec3 import Floats

_TALLY_COLUMNS: Final = {  # since the last frame, and since t = 0
    "impulse_residual": (records.WORST, records.WORST_EVER),
    "impulse_overlap": (records.DEEPEST_NOW, records.DEEPEST),
    "push_out_work": (records.PUSH_OUT_WORK, records.PUSH_OUT_WORK),
    "impacts": (records.IMPACTS, records.IMPACTS),
    "elastic_impacts": (records.ELASTIC, records.ELASTIC),
    "smallest_gap": (records.SMALLEST_GAP, records.SMALLEST_GAP),
    "impact_work": (records.IMPACT_WORK, records.IMPACT_WORK),
    "friction_work": (records.FRICTION_WORK, records.FRICTION_WORK),
}


def impulse_fields(tallies: Mapping[int, Floats], rows: list[int]) -> dict[str, Floats]:
    """What some frames show, (T,) each; 0 where nothing can touch."""
    nothing = np.zeros(records.TALLY)
    shown = np.array([tallies.get(row, nothing) for row in rows])
    return {name: shown[:, now] for name, (now, _) in _TALLY_COLUMNS.items()}


def impulse_quantity(asked: SweepValue, tally: Floats | None) -> Floats:
    """The largest residual or overlap until a time, or the work until then, (1,)."""
    return np.zeros(1) if tally is None else tally[[_TALLY_COLUMNS[asked.quantity][1]]]
