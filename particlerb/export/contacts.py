"""Contacts of each frame as lines, in VTKHDF: ParaView shows the force chains beside the particles.

A contact of two bodies is a line between their centres of mass, one with a wall from the centre of
the body to the point where the force acts. Each frame is a part of its own, as it has another
number of lines. Source: the VTKHDF format, version 2.0 (docs.vtk.org), temporal PolyData.
"""

from pathlib import Path
from typing import Final

import h5py
import numpy as np

from particlerb.export import ExportError, Selection
from particlerb.maths.vec3 import Floats, Ints
from particlerb.record.schema import CONTACTS, VTKHDF
from particlerb.record.vtkhdf import CELL_KINDS

NEEDS: Final = ("position",)
HOLDS: Final = (CONTACTS,)
_LINES: Final = "Lines"


def write(selection: Selection, path: Path) -> None:
    """Write a line for each contact of each frame, with force [N], its size, overlap and wall."""
    if not selection.has_contacts:
        raise ExportError(f"contacts needs {CONTACTS}, not recorded: see [output] fields")
    trajectory, frames = selection.trajectory, list(selection.frames)
    points, of_frames = [], []
    for k in frames:
        contacts = selection.contacts(k)
        of_frames.append(contacts)
        points.append(contacts.lines(trajectory.read("position", k)).reshape(-1, 3))
    counts = np.array([len(ends) // 2 for ends in points])
    each = zip(*((one.force, one.overlap, one.wall) for one in of_frames), strict=True)
    force, overlap, wall = map(np.concatenate, each)
    data = {"force": force, "size": np.linalg.norm(force, axis=1), "overlap": overlap, "wall": wall}
    with h5py.File(path, "w") as file:
        root = file.create_group(VTKHDF)
        root.attrs["Version"] = np.array([2, 0], dtype=np.int64)
        root.attrs.create("Type", np.bytes_("PolyData"))
        root["Points"], root["NumberOfPoints"] = np.concatenate(points), 2 * counts
        for kind in CELL_KINDS:
            _put_cells(root, kind, counts if kind == _LINES else np.zeros_like(counts))
        for name, values in data.items():
            root[f"CellData/{name}"] = values
        _put_steps(root, trajectory.time[frames], counts, list(data))


def _put_cells(root: h5py.Group, kind: str, counts: Ints) -> None:
    """Cells of each frame with two points each, numbered from 0 in their frame."""
    cells = root.create_group(kind)
    cells["NumberOfCells"], cells["NumberOfConnectivityIds"] = counts, 2 * counts
    cells["Offsets"] = np.concatenate([2 * np.arange(n + 1) for n in counts.tolist()])
    cells["Connectivity"] = np.concatenate([np.arange(2 * n) for n in counts.tolist()])


def _put_steps(root: h5py.Group, times: Floats, counts: Ints, names: list[str]) -> None:
    """Where the points and lines of each frame begin."""
    n, first = len(counts), np.cumsum(counts) - counts
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = np.int64(n)
    offsets = np.zeros((n, len(CELL_KINDS)), dtype=np.int64)
    offsets[:, CELL_KINDS.index(_LINES)] = first
    steps["Values"], steps["PartOffsets"] = times, np.arange(n)
    steps["NumberOfParts"], steps["PointOffsets"] = np.ones(n, dtype=np.int64), 2 * first
    steps["CellOffsets"], steps["ConnectivityIdOffsets"] = offsets, 2 * offsets
    for name in names:
        steps[f"CellDataOffsets/{name}"] = first
