"""What is recorded of frames, as a file or the memory holds it."""

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import h5py
import numpy as np

from particlerb.contact import contact_output
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.state import Frames, derived
from particlerb.model.system import System
from particlerb.record import schema


class FrameError(Exception):
    """A frame that a file cannot hold, or that is not the one that it holds: which."""


def _stored(name: str, values: Any, kind: "np.dtype[Any]") -> Any:
    """Numbers as a file holds them; FrameError where these are too large for their type."""
    numbers = values.astype(kind, copy=False)
    if numbers.dtype != values.dtype and np.isinf(numbers).any():
        raise FrameError(f'{name} is too large for {kind}: take output.dtype = "float64"')
    return numbers


def contact_values(
    fields: Collection[str], touches: Sequence[contact_output.ContactOutput], bodies: range
) -> dict[str, Floats | Ints]:
    """Those of the fields that contacts decide, for some frames: (T, n), (T, n_walls, 3).

    The n bodies are those of a range of the scene.
    """
    made: dict[str, Callable[[contact_output.ContactOutput], Any]] = {
        "contact_number": lambda one: contact_output.contact_numbers(one, bodies),
        "contact_overlap": lambda one: contact_output.largest_overlaps(one, bodies),
        "wall_force": lambda one: contact_output.wall_loads(one)[0],
        "wall_torque": lambda one: contact_output.wall_loads(one)[1],
        "wall_position": lambda one: one.centre,
        "wall_velocity": lambda one: one.velocity,
    }
    return {name: np.stack([made[name](one) for one in touches]) for name in fields if name in made}


def contact_columns(
    touches: Sequence[contact_output.ContactOutput], dtype: "np.dtype[Any]"
) -> tuple[dict[str, Floats | Ints], Ints]:
    """Contacts of some frames as a file holds them, by name, and the row behind each frame."""
    columns = {}
    for name, column in schema.COLUMNS.items():
        parts = [np.empty((0, *column.width)), *(getattr(one, name) for one in touches)]
        values = np.concatenate(parts)
        columns[name] = _stored(f"{name} of a contact", values, schema.dtype_of(column, dtype))
    return columns, np.cumsum([one.wall.size for one in touches], dtype=np.int64)


class ContactDatasets:
    """Contacts of all frames in a file; the offset is for the recorder to write."""

    def __init__(self, file: h5py.File) -> None:
        self.columns = {name: file[schema.CONTACTS][name] for name in schema.COLUMNS}
        self.offset = file[schema.OFFSET]
        self.dtype = self.columns["force"].dtype

    def write(self, first: int, touches: Sequence[contact_output.ContactOutput]) -> Ints:
        """Write contacts of some frames from row `first` on; return where each frame ends."""
        columns, ends = contact_columns(touches, self.dtype)
        for name, values in columns.items():
            dataset = self.columns[name]
            dataset.resize(first + len(values), axis=0)
            if len(values):
                dataset[first:] = values
        return first + ends

    def cut(self, n_frames: int) -> None:
        """Cut off what belongs to no frame."""
        for dataset in self.columns.values():
            dataset.resize(int(self.offset[n_frames]), axis=0)


class NewFrames(NamedTuple):
    """What a recorder is given of some rows of the frames."""

    times: Floats  # (T,) [s] of these rows
    frames: Frames
    rows: Ints  # (T,)
    balance: Any  # of all rows: `Entries`
    contacts: Sequence[contact_output.ContactOutput] = ()  # of these rows, where wanted
    others: Mapping[str, Floats | Ints] = MappingProxyType({})  # fields of joints and impulses


def values_of(system: System, new: NewFrames) -> dict[str, Any]:
    """Arrays of new frames, by their paths, in the order of the checksums."""
    times, frames, rows, balance, contacts, others = new
    fields, first = system.output.fields, system.names.part.start
    bodies = range(first, first + system.n_bodies)
    table: dict[str, Any] = contact_values(fields, contacts, bodies)
    table |= _fields_of(frames, rows, system, fields)
    table |= others
    dtype, values = np.dtype(system.output.dtype), {}
    for path, element in schema.series_of(fields).items():
        name = path.split("/")[-2]
        if path == schema.TIME:
            value = times
        else:
            value = table[name] if element.per or element.is_asked else getattr(balance, name)[rows]
        values[path] = _stored(name, value, schema.dtype_of(element, dtype))
    return values


def _fields_of(
    frames: Frames, rows: Ints, system: System, names: Collection[str]
) -> dict[str, Floats]:
    """Arrays of the fields of some names, for some rows of the frames."""
    contiguous = len(rows) == rows[-1] - rows[0] + 1
    pick = slice(rows[0], rows[-1] + 1) if contiguous else rows
    arrays = {name: getattr(frames, name)[pick] for name in Frames._fields if name in names}
    if {"velocity", "angular_velocity"} & set(names):
        motion = frames.orientation, frames.linear_momentum, frames.angular_momentum
        rates = derived(system.bodies, *(values[pick] for values in motion))
        arrays["velocity"], arrays["angular_velocity"] = rates
    return arrays
