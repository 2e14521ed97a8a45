"""What is recorded of frames, as a file or the memory holds it."""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from particlerb.contact.contact_output import ContactOutput
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, derived
from particlerb.model.system import System
from particlerb.record import schema
from particlerb.record.contact_writer import contact_values


class NewFrames(NamedTuple):
    """What a recorder is given of some rows of the frames."""

    times: Floats  # (T,) [s] of these rows
    frames: Frames
    rows: Ints  # (T,)
    balance: Any  # of all rows: `Entries`
    contacts: Sequence[ContactOutput] = ()  # of these rows, where wanted
    others: Mapping[str, Floats | Ints] = MappingProxyType({})  # fields of joints and impulses


def values_of(system: System, given: NewFrames) -> dict[str, Any]:
    """Arrays of new frames, by their paths, in the order of the checksums."""
    times, frames, rows, balance, contacts, others = given
    fields = system.output.fields
    found: dict[str, Any] = contact_values(fields, contacts, system.n_bodies)
    found |= _fields_of(frames, rows, system, fields)
    found |= others
    dtype, values = np.dtype(system.output.dtype), {}
    for path, element in schema.series_of(fields).items():
        name = path.split("/")[-2]
        if path == schema.TIME:
            value = times
        else:
            value = found[name] if element.per or element.is_asked else getattr(balance, name)[rows]
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
