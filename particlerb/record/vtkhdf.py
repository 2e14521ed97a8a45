"""Makes a trajectory file a VTKHDF file too: ParaView opens it, and no number is stored twice.

Each body is a point of one PolyData; the arrays of its points are virtual datasets over the H5MD
values of the same file, so they take no room and grow with them. Rules found by trial with VTK
9.3 to 9.7: the topology is stored once and every step says offset 0; arrays of `Steps` may be
longer than NSteps; a hard link cannot replace a view, since VTK wants one row per point and not
per frame; `Steps/Values` is a copy of the times, since a dimension scale with a second name breaks
h5netcdf.
"""

from collections.abc import Container, Mapping
from typing import Any, Final

import h5py
import numpy as np
from h5py import h5d, h5p, h5s

from particlerb.maths.vec3 import Floats, Ints
from particlerb.record.hdf5 import WITH_GROUPS, InPieces, change, growing, note
from particlerb.record.parts import Parts, rows_over
from particlerb.record.schema import SERIES, VTKHDF, rows_per_chunk

CELL_KINDS: Final = ("Vertices", "Lines", "Polygons", "Strips")
TOPOLOGY: Final = (
    f"{VTKHDF}/NumberOfPoints",
    *(
        f"{VTKHDF}/{cells}/{name}"
        for cells in CELL_KINDS
        for name in ("NumberOfCells", "NumberOfConnectivityIds", "Offsets", "Connectivity")
    ),
)  # what is written once
_DATA_GROUP: Final = f"{VTKHDF}/PointData"
_STEPS_GROUP: Final = f"{VTKHDF}/Steps"
STEP_TIMES: Final = f"{_STEPS_GROUP}/Values"
STEP_STARTS: Final = f"{_STEPS_GROUP}/PointOffsets"
_CONSTANTS: Final = {  # of each step: value, and width
    "PartOffsets": (0,),
    "NumberOfParts": (1,),
    "CellOffsets": (0, len(CELL_KINDS)),
    "ConnectivityIdOffsets": (0, len(CELL_KINDS)),
}
_POINTS_FIELD: Final = "position"  # the field that says where the points are


def create_vtkhdf(
    file: h5py.File,
    fields: Mapping[str, h5d.DatasetID],
    static: Mapping[str, h5d.DatasetID],
    n_frames: int,
    parts: Parts | None = None,
) -> None:
    """Make /VTKHDF for a file that is still without frames; it has `topology_of` already.

    Parameters
    ----------
    file : h5py.File
        Open for writing.
    fields : mapping of str to DatasetID, shapes (T, N, C)
        What the file records of each body; without positions there is nothing to show.
    static : mapping of str to DatasetID
        Arrays that do not change, (N, ...), by the names that VTK is to show.
    n_frames : int
        Frames that the file may come to hold; `resize_vtkhdf` changes it.
    parts : Parts, optional
        Files where the numbers of bodies lie.
    """
    if _POINTS_FIELD not in fields:
        return
    root = h5py.h5g.open(file.id, VTKHDF.encode())
    note(root, Version=np.array([2, 0], dtype=np.int64), Type=np.bytes_("PolyData"))
    for name, values in static.items():
        view(file, f"{_DATA_GROUP}/{name}", values)
        _constant(file, f"{_STEPS_GROUP}/PointDataOffsets/{name}", 0, n_frames)
    for name, values in fields.items():
        _show(file, name, values, n_frames, parts)
    rows = rows_per_chunk(n_frames)
    growing(file, STEP_TIMES, "f8", rows=rows)
    growing(file, STEP_STARTS, "i8", rows=rows)
    for name, (value, *width) in _CONSTANTS.items():
        _constant(file, f"{_STEPS_GROUP}/{name}", value, n_frames, *width)
    note(h5py.h5g.open(file.id, _STEPS_GROUP.encode()), NSteps=np.int64(0))


def topology_of(fields: Container[str], n: int) -> dict[str, Any]:
    """What VTK is told once of n bodies, by paths: each is a vertex, if its place is recorded."""
    if _POINTS_FIELD not in fields:
        return {}
    counts: list[Any] = [np.array([n])]
    for name in CELL_KINDS:
        count = n if name == CELL_KINDS[0] else 0
        counts += [np.array([count])] * 2
        counts += [InPieces(count + 1, np.arange), InPieces(count, np.arange)]
    return dict(zip(TOPOLOGY, counts, strict=True))


def _constant(file: h5py.File, path: str, value: int, n_frames: int, *width: int) -> None:
    """An array of one value for any number of steps, which takes no room."""
    growing(file, path, "i8", width, rows=1024, length=n_frames, fill=value)


def _place_of(name: str) -> str:
    """Path where VTK looks for a field."""
    return f"{VTKHDF}/Points" if name == _POINTS_FIELD else f"{_DATA_GROUP}/{name}"


def resize_vtkhdf(
    file: h5py.File, fields: Mapping[str, h5d.DatasetID], n_frames: int, parts: Parts | None = None
) -> None:
    """Let /VTKHDF, where there is one, have room for so many frames; those in it stay.

    Where the bodies lie in parts, these must have the frames.
    """
    if is_finished(file, n_frames):
        return
    steps = file[_STEPS_GROUP]
    for dataset in (*(steps[name] for name in _CONSTANTS), *steps["PointDataOffsets"].values()):
        dataset.resize(n_frames, axis=0)
    for name, values in fields.items():
        del file[_place_of(name)]
        _show(file, name, values, n_frames, parts)


def _show(
    file: h5py.File, name: str, values: h5d.DatasetID, n_frames: int, parts: Parts | None
) -> None:
    """Let VTK see a field of bodies."""
    if parts is None:
        view(file, _place_of(name), values, n_frames)
        return
    source = h5py.h5i.get_name(values).decode().lstrip("/")
    shape = n_frames, *SERIES[source].width
    rows_over(file, _place_of(name), source, values.dtype, shape, parts)


def is_finished(file: h5py.File, n_frames: int) -> bool:
    """Whether /VTKHDF, where there is one, has room for these frames and no more."""
    return VTKHDF not in file or len(file[f"{_STEPS_GROUP}/PartOffsets"]) == n_frames


def view(file: h5py.File, path: str, values: h5d.DatasetID, n_frames: int | None = None) -> None:
    """Virtual dataset over the values: (n_frames * N, C) over (T, N, C), or the same shape.

    One mapping of all of it. Values that do not change need a view too: a link would carry their
    dimension scales to where netCDF does not find them.
    """
    full = shape = values.shape
    if n_frames is not None:
        full, shape = (n_frames, *full[1:]), (n_frames * full[1], *full[2:])
    mapped, source = h5s.create_simple(shape), h5s.create_simple(full)
    mapped.select_all()
    source.select_all()
    plan = h5p.create(h5p.DATASET_CREATE)
    plan.set_obj_track_times(False)
    plan.set_virtual(mapped, b".", h5py.h5i.get_name(values), source)
    kind, space = values.get_type(), h5s.create_simple(shape)
    h5d.create(file.id, path.encode(), kind, space, plan, WITH_GROUPS)


def steps_of(first: int, times: Floats, n_points: int) -> dict[str, Floats | Ints]:
    """What the arrays of steps get for frames from `first` on, by their paths."""
    return {STEP_TIMES: times, STEP_STARTS: np.arange(first, first + len(times)) * n_points}


def count_steps(file: h5py.File, n_frames: int) -> None:
    """Say how many steps there are, where VTK counts some."""
    if VTKHDF in file:
        change(h5py.h5g.open(file.id, _STEPS_GROUP.encode()), "NSteps", np.int64(n_frames))
