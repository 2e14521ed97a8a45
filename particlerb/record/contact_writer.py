"""Writes what contacts do: per body, per wall, and the contacts of each frame one after another.

The last have no fixed number; as with particles of bodies, an offset says where a frame begins.
"""

from collections.abc import Callable, Collection, Sequence
from typing import Any

import h5py
import numpy as np

from particlerb.contact.contact_output import (
    ContactOutput,
    contact_numbers,
    largest_overlaps,
    wall_loads,
)
from particlerb.maths.vec3 import Floats, Ints
from particlerb.record import schema


def contact_values(
    fields: Collection[str], touches: Sequence[ContactOutput], n_bodies: int
) -> dict[str, Floats | Ints]:
    """Those of the fields that contacts decide, for some frames: (T, n_bodies), (T, n_walls, 3)."""
    made: dict[str, Callable[[ContactOutput], Any]] = {
        "contact_number": lambda one: contact_numbers(one, n_bodies),
        "contact_overlap": lambda one: largest_overlaps(one, n_bodies),
        "wall_force": lambda one: wall_loads(one)[0],
        "wall_torque": lambda one: wall_loads(one)[1],
        "wall_position": lambda one: one.centre,
        "wall_velocity": lambda one: one.velocity,
    }
    return {name: np.stack([made[name](one) for one in touches]) for name in fields if name in made}


def contact_columns(
    touches: Sequence[ContactOutput], dtype: "np.dtype[Any]"
) -> tuple[dict[str, Floats | Ints], Ints]:
    """Contacts of some frames as a file holds them, by name, and the row behind each frame."""
    columns = {}
    for name, column in schema.COLUMNS.items():
        kind = np.dtype(np.int32) if column.is_count else dtype
        width = (column.width,) if column.width else ()
        parts = [np.empty((0, *width), kind), *(getattr(one, name) for one in touches)]
        columns[name] = np.concatenate(parts).astype(kind)
    return columns, np.cumsum([one.wall.size for one in touches], dtype=np.int64)


class ContactList:
    """Contacts of all frames in a file; the offset is for the recorder to write."""

    def __init__(self, file: h5py.File) -> None:
        self.columns = {name: file[schema.CONTACTS][name] for name in schema.COLUMNS}
        self.offset = file[schema.OFFSET]
        self.dtype = self.columns["force"].dtype

    def write(self, first: int, touches: Sequence[ContactOutput]) -> Ints:
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
