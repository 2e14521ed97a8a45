"""A trajectory whose bodies lie in files of their own, a range of them in each: parts and master.

`run.h5` is the master: all that a trajectory has, but that the numbers of bodies in time are
virtual datasets over `run.parts/0000.h5`, `run.parts/0001.h5`, … . The names are relative, so file
and folder are moved together. A part that is missing would be read as NaN without an error: who
opens a master looks at each part first.
"""

import logging
import os
import re
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar

import h5py
import numpy as np
from h5py import h5a, h5d, h5p, h5s, is_hdf5

from particlerb.model.superblocks import Range
from particlerb.record.hdf5 import WITH_GROUPS, header_attribute, note, open_unlocked

Found = TypeVar("Found")

_LOG: Final = logging.getLogger(__name__)
_FOLDER: Final = "parts_folder"  # root attribute of a master: name of the folder
_EDGES: Final = "parts"  # of a master: first body of each part, and how many bodies there are
_RANGE: Final = "bodies"  # of a part: first body, and the one behind the last
_RUN: Final = "run"  # of both: what decides the motion
_FOLDER_NAME: Final = re.compile(r"[^/\\\0]+\.parts")


class Parts(NamedTuple):
    """Files that have the bodies of a trajectory."""

    folder: str
    """Name, beside the master."""
    ranges: tuple[Range, ...]
    """Bodies of each, one after the other."""
    run: str
    """Hash of what decides the motion; that of each part."""

    @property
    def names(self) -> list[str]:
        """Files, from where the master is."""
        return [f"{self.folder}/{k:04d}.h5" for k in range(len(self.ranges))]

    def paths(self, master: Path) -> list[Path]:
        """The same, from anywhere."""
        return [folder_beside(master) / name for name in self.names]

    @property
    def n_bodies(self) -> int:
        """Bodies of all parts."""
        return self.ranges[-1].stop


def folder_beside(path: Path) -> Path:
    """Folder that a file lies in, behind all links: where the folder of its parts is."""
    return Path(os.path.realpath(path)).parent


def folder_of(path: Path) -> str:
    """Name of the folder for the parts of a new master: one that no master beside it uses."""
    for k in count(1):
        name = f"{path.stem}.{k}.parts" if k > 1 else f"{path.stem}.parts"
        if not masters_of(path.parent / name):
            return name
    raise AssertionError


def masters_of(folder: Path) -> list[Path]:
    """Files that have their parts in a folder: a master, and copies of it."""
    if not folder.is_dir():
        return []
    beside = (path for path in sorted(folder.parent.iterdir()) if path.is_file() and is_hdf5(path))
    candidates = ((path, _looked_up(path, parts_in)) for path in beside)
    return [path for path, parts in candidates if parts and parts.folder == folder.name]


def parts_used_by(path: Path) -> list[Path]:
    """Parts of a file, those of them that are its alone; none where it has none."""
    parts = _looked_up(path, parts_in)
    named = zip(parts.paths(path), parts.ranges, strict=True) if parts else ()
    used = [used for used, of in named if parts and _looked_up(used, range_in) == (of, parts.run)]
    copies = [other for other in masters_of(used[0].parent) if other != path] if used else []
    if copies:
        _LOG.warning("%s stays: %s has its parts there too", used[0].parent, copies[0])
    return [] if copies else used


def _looked_up(path: Path, what: Callable[[h5py.File], Found | None]) -> Found | None:
    """What a file says; None where it says nothing, or makes no sense."""
    try:
        with open_unlocked(path) as file:
            return what(file)
    except (OSError, RuntimeError, KeyError, ValueError):
        return None


def note_master(file: h5py.File, parts: Parts) -> None:
    """Let a file say which parts it has."""
    edges = np.array([0, *(of.stop for of in parts.ranges)], dtype=np.int64)
    names = {_FOLDER: np.bytes_(os.fsencode(parts.folder)), _RUN: np.bytes_(parts.run)}
    note(file.id, **names, **{_EDGES: edges})


def note_part(file: h5py.File, of: Range, run: str) -> None:
    """Let a file say which part of which run it is."""
    note(file.id, **{_RANGE: np.array(of, dtype=np.int64), _RUN: np.bytes_(run)})


def parts_in(file: Any) -> Parts | None:
    """Parts of a file that is not trusted; None where it is whole.

    Raises
    ------
    ValueError
        If what it says of them makes no sense.
    """
    if not isinstance(file, h5py.File) or not h5a.exists(file.id, _EDGES.encode()):
        return None
    edges = header_attribute(file, _EDGES, "i")
    folder = os.fsdecode(bytes(header_attribute(file, _FOLDER, "S")))
    if edges.size < 2 or edges[0] != 0 or (np.diff(edges) <= 0).any():
        raise ValueError("its parts do not follow each other")
    if not _FOLDER_NAME.fullmatch(folder):
        raise ValueError(f"its parts lie in {folder!r}, not in a folder beside it")
    ranges = [Range(*ends) for ends in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)]
    return Parts(folder, tuple(ranges), bytes(header_attribute(file, _RUN, "S")).decode())


def part_paths(file: Any) -> list[Path]:
    """Files of the parts of a file that is not trusted; none where it is whole."""
    parts = parts_in(file)
    return parts.paths(Path(file.filename)) if parts else []


def range_in(file: h5py.File) -> tuple[Range, str] | None:
    """Bodies of a part, and its run; None where it is none."""
    if not h5a.exists(file.id, _RANGE.encode()):
        return None
    first, stop = header_attribute(file, _RANGE, "i").tolist()
    return Range(first, stop), bytes(header_attribute(file, _RUN, "S")).decode()


def growing_over(
    file: h5py.File, path: str, dtype: Any, width: tuple[int, ...], parts: Parts
) -> h5d.DatasetID:
    """A dataset (T, N, ...) over the same one of all parts, as long as the longest of them.

    Its extent is not to be asked for where the parts are not there yet.
    """
    most = (h5s.UNLIMITED, *width)
    plan = _plan(dtype)
    for name, (first, stop) in zip(parts.names, parts.ranges, strict=True):
        extent = (stop - first, *width[1:])
        rest = (0,) * (len(width) - 1)
        full_space = h5s.create_simple((0, *width), most)
        part_space = h5s.create_simple((0, *extent), (most[0], *extent))
        ones, block = (1,) * len(most), (h5s.UNLIMITED, *extent)
        full_space.select_hyperslab((0, first, *rest), ones, block=block)
        part_space.select_hyperslab((0, 0, *rest), ones, block=block)
        plan.set_virtual(full_space, os.fsencode(name), f"/{path}".encode(), part_space)
    kind, space = h5py.h5t.py_create(np.dtype(dtype)), h5s.create_simple((0, *width), most)
    return h5d.create(file.id, path.encode(), kind, space, plan, WITH_GROUPS)


def rows_over(
    file: h5py.File, path: str, source: str, dtype: Any, shape: tuple[int, ...], parts: Parts
) -> None:
    """A dataset (T N, ...) over the first T frames of one (T, N, ...) of all parts; shape: T, ....

    All parts must have these frames.
    """
    n_frames, *width = shape
    plan, n, rest = _plan(dtype), parts.n_bodies, (0,) * len(width)
    space = h5s.create_simple((n_frames * n, *width))
    for name, (first, stop) in zip(parts.names if n_frames else (), parts.ranges, strict=False):
        rows, part_space = space.copy(), h5s.create_simple((n_frames, stop - first, *width))
        ones, block = (1,) * len(width), (stop - first, *width)
        rows.select_hyperslab((first, *rest), (n_frames, *ones), (n, *width), block)
        part_space.select_all()
        plan.set_virtual(rows, os.fsencode(name), f"/{source}".encode(), part_space)
    kind = h5py.h5t.py_create(np.dtype(dtype))
    h5d.create(file.id, path.encode(), kind, space, plan, WITH_GROUPS)


def _plan(dtype: Any) -> Any:
    """Properties of a virtual dataset: what is not there is NaN; of integers -1."""
    plan = h5p.create(h5p.DATASET_CREATE)
    plan.set_obj_track_times(False)
    missing = np.nan if np.dtype(dtype).kind == "f" else -1
    plan.set_fill_value(np.array(missing, dtype=dtype))
    return plan
