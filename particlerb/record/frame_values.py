"""What is recorded of frames, as a file or the memory holds it."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from particlerb.contact.contact_output import ContactOutput
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, derived
from particlerb.model.system import System
from particlerb.record import schema
from particlerb.record.contact_writer import contact_values


def values_of(
    system: System,
    times: Floats,
    frames: Frames,
    rows: Ints,
    ledger: Any,
    touches: Sequence[ContactOutput],
    others: Mapping[str, Floats | Ints],
) -> dict[str, Any]:
    """Arrays of some rows of the frames, by their paths, in the order of the checksums."""
    fields = system.output.fields
    found: dict[str, Any] = contact_values(fields, touches, system.n_bodies)
    found |= _fields_of(frames, rows, system, fields)
    found |= others
    dtype, values = np.dtype(system.output.dtype), {}
    for path, element in schema.series_of(fields).items():
        name = path.split("/")[-2]
        if path == schema.TIME:
            value = times
        else:
            value = found[name] if element.per or element.is_asked else getattr(ledger, name)[rows]
        values[path] = value.astype(schema.dtype_of(element, dtype), copy=False)
    return values


def _fields_of(
    frames: Frames, rows: Ints, system: System, names: Collection[str]
) -> dict[str, Floats]:
    """Arrays of the fields of some names, for some rows of the frames."""
    contiguous = len(rows) == rows[-1] - rows[0] + 1
    pick = slice(rows[0], rows[-1] + 1) if contiguous else rows
    arrays = {name: getattr(frames, name)[pick] for name in Frames._fields if name in names}
    if {"velocity", "angular_velocity"} & set(names):
        arrays["velocity"], arrays["angular_velocity"] = derived(
            system.bodies,
            frames.orientation[pick],
            frames.linear_momentum[pick],
            frames.angular_momentum[pick],
        )
    return arrays
