"""NumPy arrays in one archive, written piece by piece: `numpy.load` gives them by name."""

import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy

from particlerb.export import Selection
from particlerb.record.schema import FIELDS

NEEDS: Final = ()


def write(selection: Selection, path: Path) -> None:
    """Write time, the bodies' constants, and each field as (T, n, C)."""
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
            shape = (len(selection.frames), len(bodies), len(FIELDS[name].components))
            pieces = (selection.values(name, part) for part in selection.portions())
            dtype = selection.values(name, slice(0, 1)).dtype
            add(archive, name, shape, dtype, pieces)


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
