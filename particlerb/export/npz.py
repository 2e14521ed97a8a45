"""NumPy arrays in one archive, written piece by piece: `numpy.load` gives them by name."""

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy

from particlerb.export import Selection
from particlerb.record.schema import COLUMNS, CONTACT_FIELDS, CONTACTS, FIELDS, OBSERVED

NEEDS: Final = ()
HOLDS: Final = (*FIELDS, *CONTACT_FIELDS, *OBSERVED, CONTACTS)


def write(selection: Selection, path: Path) -> None:
    """Write time, the bodies' constants, each field as (T, n, C), and contacts as in a trajectory.

    Contacts of frame f are the rows contacts_offset[f] to contacts_offset[f + 1] of their arrays.
    """
    trajectory, bodies = selection.trajectory, selection.bodies
    constants = {
        "frame": np.array(selection.frames),
        "time": trajectory.time[selection.frames],
        "body": bodies,
        "name": np.array(trajectory.names)[bodies],
        "mass": trajectory.mass[bodies],
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:
        for name, array in constants.items():
            add(archive, name, array.shape, array.dtype, [array])
        for name in selection.fields:
            first = selection.values(name, slice(0, 1))
            shape = (len(selection.frames), *first.shape[1:])
            pieces = (selection.values(name, frames) for frames in selection.portions())
            add(archive, name, shape, first.dtype, pieces)
        for per in {OBSERVED[name].per: 0 for name in selection.observed if OBSERVED[name].per}:
            names = np.array(trajectory.names_of(per))
            add(archive, f"{per}_name", names.shape, names.dtype, [names])
        for name in selection.observed:
            values = trajectory.observed(name)[selection.frames]
            add(archive, name, values.shape, values.dtype, [values])
        if selection.has_contacts:
            _add_contacts(archive, selection)


def _add_contacts(archive: zipfile.ZipFile, selection: Selection) -> None:
    """Add the contacts of all frames, column by column."""
    counts = [len(selection.contacts(frame).wall) for frame in selection.frames]
    offset = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])
    add(archive, "contacts_offset", offset.shape, offset.dtype, [offset])
    for name in COLUMNS:
        first = getattr(selection.contacts(selection.frames[0]), name)
        pieces = (getattr(selection.contacts(frame), name) for frame in selection.frames)
        shape = (int(offset[-1]), *first.shape[1:])
        add(archive, f"contacts_{name}", shape, first.dtype, pieces)


def add(
    archive: zipfile.ZipFile,
    name: str,
    shape: tuple[int, ...],
    dtype: "np.dtype[Any]",
    pieces: Iterable[Any],
) -> None:
    """Add an array that comes in pieces along its first axis."""
    header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        npy.write_array_header_2_0(file, header)
        for piece in pieces:
            file.write(np.ascontiguousarray(piece).data.cast("B") if piece.size else b"")
