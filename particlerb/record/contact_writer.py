"""Writes what contacts do: per body, per wall, and the contacts of each frame one after another.

The last have no fixed number; as with particles of bodies, an offset says where a frame begins.
"""

from collections.abc import Callable, Mapping, Sequence

import h5py
import numpy as np

from particlerb.case.schema import Case
from particlerb.contact.contact_output import (
    ContactOutput,
    contact_numbers,
    largest_overlaps,
    wall_loads,
)
from particlerb.maths.vec3 import Floats, Ints
from particlerb.record.schema import (
    COLUMNS,
    CONTACTS,
    MOST_IN_CHUNK,
    OFFSET,
    WALL_NAMES,
    WALL_NUMBERS,
    WALLS,
    Element,
)

CONTACTS_PER_CHUNK = 64, 8192  # at least, at most
Make = Callable[[str, Element], h5py.Dataset]


def body_values(name: str, touches: Sequence[ContactOutput], n_bodies: int) -> Floats | Ints:
    """A field of contact per body for some frames, (T, n_bodies)."""
    of_frame = {"contact_number": contact_numbers, "contact_overlap": largest_overlaps}[name]
    return np.stack([of_frame(one, n_bodies) for one in touches])


def wall_values(
    wanted: Mapping[str, object], touches: Sequence[ContactOutput]
) -> dict[str, Floats]:
    """Fields of walls for some frames, (T, n_walls, 3)."""
    loads = [wall_loads(one) for one in touches]
    values = {
        "wall_force": [force for force, _ in loads],
        "wall_torque": [torque for _, torque in loads],
        "wall_position": [one.centre for one in touches],
        "wall_velocity": [one.velocity for one in touches],
    }
    return {name: np.stack(values[name]) for name in wanted}


def make_walls(file: h5py.File, case: Case) -> None:
    """Names of the walls, and their dimension scale."""
    names = [wall.name.encode() for wall in case.wall]
    file[WALL_NAMES] = np.array(names)
    file[WALL_NAMES].attrs["meaning"] = "of each wall"
    file[WALL_NUMBERS] = np.arange(len(names))
    file[WALL_NUMBERS].make_scale("wall")
    file[WALL_NAMES].dims[0].attach_scale(file[WALL_NUMBERS])


def walls_wanted(case: Case) -> list[str]:
    """Fields of walls that a case asks for."""
    return [name for name in WALLS if name in case.output.fields]


def make_contacts(
    file: h5py.File,
    step: h5py.Dataset,
    time: h5py.Dataset,
    dtype: np.dtype[np.floating],
    n_expected: int,
) -> None:
    """Make room for the contacts of all frames, of which about so many are expected.

    What is no integer has the given type.
    """
    rows = int(np.clip(n_expected, *CONTACTS_PER_CHUNK))
    group = file.create_group(CONTACTS)
    group["step"], group["time"] = step, time
    for name, column in COLUMNS.items():
        shape = (column.width,) if column.width else ()
        made = group.create_dataset(
            name, (0, *shape), np.dtype("i4") if column.is_count else dtype,
            maxshape=(None, *shape), chunks=(rows, *shape),
        )  # fmt: skip
        made.attrs["units"], made.attrs["meaning"] = column.units, column.meaning
    offset = file.create_dataset(OFFSET, (1,), "i8", maxshape=(None,), chunks=(MOST_IN_CHUNK,))
    offset.attrs["units"] = "1"
    offset.attrs["meaning"] = "contacts of frame f are offset[f] to offset[f + 1]"


class ContactList:
    """Contacts of all frames in a file; the offset is for the recorder to write."""

    def __init__(self, file: h5py.File) -> None:
        self.columns = {name: file[CONTACTS][name] for name in COLUMNS}
        self.offset = file[OFFSET]

    def rows(self, touches: Sequence[ContactOutput]) -> tuple[list[Floats | Ints], Ints]:
        """Contacts of some frames as the file holds them, and the row behind each frame."""
        ends = np.cumsum([one.wall.size for one in touches], dtype=np.int64)
        columns = [
            np.concatenate([getattr(one, name) for one in touches]).astype(dataset.dtype)
            for name, dataset in self.columns.items()
        ]
        return columns, ends

    def write(self, first: int, touches: Sequence[ContactOutput]) -> Ints:
        """Write contacts of some frames from row `first` on; return where each frame ends."""
        columns, ends = self.rows(touches)
        for dataset, values in zip(self.columns.values(), columns, strict=True):
            dataset.resize(first + len(values), axis=0)
            if len(values):
                dataset[first:] = values
        return first + ends

    def cut(self, n_frames: int) -> None:
        """Cut off what belongs to no frame."""
        self.offset.resize(n_frames + 1, axis=0)
        for dataset in self.columns.values():
            dataset.resize(int(self.offset[-1]), axis=0)
