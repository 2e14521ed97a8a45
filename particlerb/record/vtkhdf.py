"""Makes a trajectory file a VTKHDF file too: ParaView opens it, and no number is stored twice.

Each body is a point of one PolyData; the arrays of its points are virtual datasets over the H5MD
values of the same file, so they take no room and grow with them. Rules found by trial with VTK
9.3 to 9.7: the topology is stored once and every step says offset 0; arrays of `Steps` may be
longer than NSteps; a hard link cannot replace a view, since VTK wants one row per point and not
per frame; `Steps/Values` is a copy of the times, since a dimension scale with a second name breaks
h5netcdf.
"""

from collections.abc import Mapping
from typing import Final

import h5py
import numpy as np
from h5py import h5d, h5p, h5s

from particlerb.maths.vec3 import Floats
from particlerb.record.schema import VTKHDF, rows_per_chunk

_CELLS: Final = ("Vertices", "Lines", "Polygons", "Strips")
TOPOLOGY: Final = (
    f"{VTKHDF}/NumberOfPoints",
    *(
        f"{VTKHDF}/{cells}/{name}"
        for cells in _CELLS
        for name in ("NumberOfCells", "NumberOfConnectivityIds", "Offsets", "Connectivity")
    ),
)  # what is written once
_POINTS: Final = "position"  # the field that says where the points are


def create_vtkhdf(
    file: h5py.File, fields: Mapping[str, h5py.Dataset], static: Mapping[str, str], n_frames: int
) -> None:
    """Make /VTKHDF for a file that is still without frames.

    Parameters
    ----------
    file : h5py.File
        Open for writing.
    fields : mapping of str to Dataset, shapes (T, N, C)
        What the file records of each body; without positions there is nothing to show.
    static : mapping of str to str
        Names and paths of arrays that do not change, (N, ...).
    n_frames : int
        Frames that the file may come to hold; `resize_vtkhdf` changes it.
    """
    if _POINTS not in fields:
        return
    n = fields[_POINTS].shape[1]
    root = file.create_group(VTKHDF)
    root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
    root.attrs.create("Type", b"PolyData", dtype=h5py.string_dtype("ascii", 8))
    root["NumberOfPoints"] = np.array([n])
    for name in _CELLS:
        count = n if name == _CELLS[0] else 0
        cells = root.create_group(name)
        cells["NumberOfCells"] = cells["NumberOfConnectivityIds"] = np.array([count])
        cells["Offsets"] = np.arange(count + 1)
        cells["Connectivity"] = np.arange(count)
    data = root.create_group("PointData")
    for name, path in static.items():
        view(data, name, file[path])
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(0)
    growing = {"maxshape": (None,), "chunks": (rows_per_chunk(n_frames),)}
    steps.create_dataset("Values", (0,), "f8", **growing)
    steps.create_dataset("PointOffsets", (0,), "i8", **growing)
    constant(steps, "PartOffsets", 0)
    constant(steps, "NumberOfParts", 1)
    constant(steps, "CellOffsets", 0, len(_CELLS))
    constant(steps, "ConnectivityIdOffsets", 0, len(_CELLS))
    offsets = steps.create_group("PointDataOffsets")
    for name in static:
        constant(offsets, name, 0)
    resize_vtkhdf(file, fields, n_frames)


def constant(group: h5py.Group, name: str, value: int, *width: int) -> None:
    """An array of one value for any number of steps, which takes no room."""
    group.create_dataset(
        name, (0, *width), "i8", maxshape=(None, *width), fillvalue=value, chunks=(1024, *width)
    )


def resize_vtkhdf(file: h5py.File, fields: Mapping[str, h5py.Dataset], n_frames: int) -> None:
    """Let /VTKHDF, where there is one, have room for so many frames; those in it stay."""
    if VTKHDF not in file:
        return
    root = file[VTKHDF]
    steps = root["Steps"]
    offsets = steps["PointDataOffsets"].values()
    names = ("PartOffsets", "NumberOfParts", "CellOffsets", "ConnectivityIdOffsets")
    for dataset in (*(steps[name] for name in names), *offsets):
        dataset.resize(n_frames, axis=0)
    for name, values in fields.items():
        group, own = (root, "Points") if name == _POINTS else (root["PointData"], name)
        if own in group:
            if len(group[own]) == n_frames * values.shape[1]:
                continue
            del group[own]
        view(group, own, values, n_frames)


def is_finished(file: h5py.File, n_frames: int) -> bool:
    """Whether /VTKHDF, where there is one, has room for these frames and no more."""
    return VTKHDF not in file or len(file[VTKHDF]["Steps"]["PartOffsets"]) == n_frames


def view(group: h5py.Group, name: str, values: h5py.Dataset, n_frames: int | None = None) -> None:
    """Virtual dataset over the values: (n_frames * N, C) over (T, N, C), or the same shape.

    One mapping of all of it. Values that do not change need a view too: a link would carry their
    dimension scales to where netCDF does not find them.
    """
    full, shape = values.shape, values.shape
    if n_frames is not None:
        full, shape = (n_frames, *full[1:]), (n_frames * full[1], *full[2:])
    mapped, source = h5s.create_simple(shape), h5s.create_simple(full)
    mapped.select_all()
    source.select_all()
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_virtual(mapped, b".", values.name.encode(), source)
    h5d.create(group.id, name.encode(), values.id.get_type(), h5s.create_simple(shape), properties)


def append_steps(file: h5py.File, first: int, times: Floats) -> None:
    """Write the steps from `first` on; there are none behind them."""
    if VTKHDF not in file:
        return
    steps, last = file[VTKHDF]["Steps"], first + len(times)
    starts = np.arange(first, last) * int(file[VTKHDF]["NumberOfPoints"][0])
    for name, values in (("Values", times), ("PointOffsets", starts)):
        steps[name].resize(last, axis=0)
        steps[name][first:] = values
    count_steps(file, last)


def count_steps(file: h5py.File, n_frames: int) -> None:
    """Say how many steps there are."""
    if VTKHDF in file:
        file[VTKHDF]["Steps"].attrs.modify("NSteps", np.int64(n_frames))
