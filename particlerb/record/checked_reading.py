"""Reads files that may come from anyone, be damaged, or still grow: a value, or one clear error.

A dataset is used only if hard links lead to it, its type and shape are those of the schema, and its
numbers lie in this file: no external storage, no views of other files, no filters that HDF5 would
have to load. So a foreign file can neither run code nor have another one read or written.

Why it is so: docs/decisions/0009.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

import h5py
import numpy as np
from h5py import h5d, h5g, h5l, h5o, h5z

from particlerb.record.atomic import to_read
from particlerb.record.hdf5 import header_attribute, open_unlocked
from particlerb.record.memory import Memory
from particlerb.record.parts import part_paths, parts_in, range_in
from particlerb.record.schema import CHECKPOINT, COMMITTED, TIME
from particlerb.words import count_of

_FILTERS: Final = (h5z.FILTER_DEFLATE, h5z.FILTER_SHUFFLE, h5z.FILTER_FLETCHER32)
_LAYOUTS: Final = (h5d.COMPACT, h5d.CONTIGUOUS, h5d.CHUNKED)
_MAX_DEFLATE_RATIO: Final = 1032  # bytes that one byte can become at most
SECONDS_OF_PATIENCE: Final = 2.0
_SECONDS_AT_REST: Final = 0.5  # without a write: what fails now fails for good
PAUSE: Final = 0.01
FAULTS: Final = (
    OSError,
    RuntimeError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
    IndexError,
    SystemError,  # of an error within a visit
)  # what h5py raises on files that it cannot make sense of

Result = TypeVar("Result")


class TrajectoryError(Exception):
    """A file that is no trajectory of particlerb, or that cannot be read."""


@contextmanager
def trajectory_errors(file: h5py.File | Memory | str | Path) -> Iterator[None]:
    """Turn what h5py raises on damaged and foreign files into TrajectoryError."""
    name = file.filename if isinstance(file, h5py.File | Memory) and file else file
    require_open(file)
    try:
        yield
    except FAULTS as error:
        told = f"{name} is not a trajectory of particlerb: {reason_of(error)}"
        raise TrajectoryError(told) from None


def require_open(file: h5py.File | Memory | str | Path) -> None:
    """Raise TrajectoryError for a file that is closed."""
    if not file:
        raise TrajectoryError("the trajectory is closed: open it again, or read before it closes")


def open_file(path: str | Path) -> h5py.File:
    """File open for reading; also while another process writes it, or behind a kill.

    Raises
    ------
    TrajectoryError
        If HDF5 cannot read it.
    """
    try:
        source = to_read(Path(path))
        return open_unlocked(source) if isinstance(source, Path) else h5py.File(source, "r")
    except FAULTS as error:
        reason = reason_of(error)
        if "signature not found" in reason:
            reason = "it is of another kind, or empty"
        raise TrajectoryError(f"{path} is not a readable HDF5 file: {reason}") from None


def reason_of(error: BaseException) -> str:
    """What an error says, in one line."""
    words = str(error.args[0] if isinstance(error, KeyError) and error.args else error)
    return " ".join(words.split()) or type(error).__name__


def patiently(path: str | Path | None, read: Callable[[], Result]) -> Result:
    """What a function reads; where it fails and another attempt may succeed, at the next one.

    A file that is being written may be refused for a moment. One at rest is tried once; None is a
    file in memory.
    """
    start = time.monotonic()
    while True:
        is_last = time.monotonic() - start > SECONDS_OF_PATIENCE or not _has_just_changed(path)
        try:
            return read()
        except TrajectoryError:
            if is_last:
                raise
        time.sleep(PAUSE)


def _has_just_changed(path: str | Path | None) -> bool:
    """Whether a file was written a moment ago."""
    try:
        return path is not None and abs(time.time() - os.stat(path).st_mtime) < _SECONDS_AT_REST
    except OSError:
        return False


def dataset_at(
    file: h5py.File | Memory, path: str, kinds: str, shape: tuple[int | None, ...]
) -> h5py.Dataset:
    """Dataset of a file whose content is not trusted; a copy of an array in memory, which is.

    Parameters
    ----------
    file : h5py.File
        Open.
    path : str
        From the root, as `particles/trajectory/mass`.
    kinds : str
        NumPy's letters of the types that it may have: `f`, `i`, `u`, `S`.
    shape : tuple
        None where any length will do.

    Raises
    ------
    TrajectoryError
        If it is not there, or not what the schema says.
    """
    with trajectory_errors(file):
        if isinstance(file, Memory):
            return file[path]
        dataset = object_at(file, path)
        if not isinstance(dataset, h5py.Dataset):
            raise ValueError(f"{path} is not a dataset")
        if dataset.is_virtual:
            _require_sources(file, dataset)
        dtype, extent = dataset.dtype, dataset.shape
        is_short = dtype.kind == "f" and dtype.itemsize < 4
        if dtype.kind not in kinds or dtype.hasobject or is_short:
            raise ValueError(f"{path} has the type {dtype}")
        fits = extent is not None and len(extent) == len(shape)
        if not fits or any(n not in (None, m) for m, n in zip(extent, shape, strict=True)):
            raise ValueError(f"{path} has the shape {extent}")
        require_own_storage(file, dataset, path)
    return dataset


def object_at(file: h5py.File, path: str) -> Any:
    """What hard links lead to."""
    place = file.id
    for name in (part.encode() for part in path.split("/")):
        if not isinstance(place, h5g.GroupID) or not place.links.exists(name):
            raise KeyError(f"{path} is missing")
        if place.links.get_info(name).type != h5l.TYPE_HARD:
            raise ValueError(f"{path} is a link to elsewhere")
        place = h5o.open(place, name)
    kinds = {h5g.GroupID: h5py.Group, h5d.DatasetID: h5py.Dataset}
    return kinds.get(type(place), h5py.Datatype)(place)


def has(file: h5py.File | Memory, path: str) -> bool:
    """Whether something is there, and hard links lead to it; TrajectoryError where others do."""
    if isinstance(file, Memory):
        return path in file
    with trajectory_errors(file):
        try:
            object_at(file, path)
        except KeyError:
            return False
    return True


def require_own_storage(file: h5py.File, dataset: h5py.Dataset, path: str) -> None:
    """Raise ValueError unless the numbers lie in this file, and there can be as many."""
    if dataset.is_virtual and _lies_in_parts(file, dataset):
        return
    properties = dataset.id.get_create_plist()
    if properties.get_layout() not in _LAYOUTS or properties.get_external_count():
        raise ValueError(f"{path} lies in another file")
    filters = [properties.get_filter(k)[0] for k in range(properties.get_nfilters())]
    if any(code not in _FILTERS for code in filters):
        raise ValueError(f"{path} is packed by a filter that is not known here")
    room = file.id.get_filesize() * (_MAX_DEFLATE_RATIO if filters else 1)
    if dataset.size * dataset.dtype.itemsize > room:
        raise ValueError(f"{path} is larger than the file")


def _require_sources(file: h5py.File, dataset: h5py.Dataset) -> None:
    """Raise ValueError unless parts have what a dataset shows of them: HDF5 crashes on groups."""
    for path, source in zip(part_paths(file), dataset.virtual_sources(), strict=False):
        if path.is_file():
            with open_file(path) as part, trajectory_errors(part):
                if not isinstance(object_at(part, source.dset_name.strip("/")), h5py.Dataset):
                    raise ValueError(f"{source.dset_name} is not a dataset")


def require_self_contained(file: h5py.File) -> None:
    """Require that all of a file lies in it, before it is written to.

    Raises
    ------
    TrajectoryError
        If a link, a view or a dataset leads to another file.
    """
    wrong: list[str] = []  # h5py wants no error in a visit

    def look_at_link(name: str, link: Any) -> None:
        if not isinstance(link, h5py.HardLink):
            wrong.append(f"{name} is a link to elsewhere")

    def look_at_object(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not _lies_inside(item):
            wrong.append(f"{name} lies in another file")

    with trajectory_errors(file):
        file.visititems_links(look_at_link)
        file.visititems(look_at_object)
        if wrong:
            raise ValueError(wrong[0])


def _lies_inside(dataset: h5py.Dataset) -> bool:
    """Whether the numbers of a dataset, or those that it is a view of, lie in its file."""
    if dataset.is_virtual:
        is_own = all(source.file_name == "." for source in dataset.virtual_sources())
        return is_own or _lies_in_parts(dataset.file, dataset)
    return not dataset.id.get_create_plist().get_external_count()


def _lies_in_parts(file: h5py.File, dataset: h5py.Dataset) -> bool:
    """Whether the numbers of a virtual dataset lie in the parts of its file, each once."""
    parts, sources = parts_in(file), dataset.virtual_sources()
    return parts is not None and [s.file_name for s in sources] == parts.names[: len(sources)]


def require_parts(file: h5py.File, n_frames: int) -> None:
    """Require that each part of a file is there, of the same run, and has so many frames.

    Raises
    ------
    TrajectoryError
        If one is missing, short, or of something else; it names it.
    """
    with trajectory_errors(file):
        parts, paths = parts_in(file), part_paths(file)
    for path, of in zip(paths, parts.ranges if parts else (), strict=True):
        if not path.is_file():
            raise TrajectoryError(f"{file.filename}: its part {path} is missing")
        with open_file(path) as part, trajectory_errors(part):
            if parts is None or range_in(part) != (of, parts.run):
                raise TrajectoryError(f"{file.filename}: {path} belongs to another run, or place")
            n = min(integer_attribute(part, COMMITTED), len(part[TIME]))
        if n < n_frames:
            told = f"its part {path} has {count_of(n, 'frame')}, and {n_frames} were committed"
            raise TrajectoryError(f"{file.filename}: {told}")


def can_be_continued(file: h5py.File) -> bool:
    """Whether a file keeps a state from which its run can be continued, or its first part does."""
    paths = part_paths(file)
    if not paths:
        return CHECKPOINT in file
    with open_file(paths[0]) as part:
        return CHECKPOINT in part


def text_at(file: h5py.File | Memory, path: str) -> str:
    """A text of the file.

    Raises
    ------
    TrajectoryError
        If it is not there, or no text.
    """
    held = dataset_at(file, path, "S", ())
    with trajectory_errors(file):
        words: bytes = held if isinstance(held, bytes) else held[()]
        return words.decode(errors="replace")


def attribute(place: Any, name: str, kinds: str) -> Any:
    """Value of an attribute, an array or bytes, of a file or of what is in memory.

    Raises
    ------
    KeyError, ValueError
        If it is not there, or of another type.
    """
    if isinstance(place, Memory):
        return place.attributes[name]
    return header_attribute(place, name, kinds)


def integer_attribute(place: Any, name: str) -> int:
    """A whole number among the attributes of a file or group."""
    value = attribute(place, name, "iu")
    if np.shape(value) != ():
        raise ValueError(f"{name} is not a single number")
    return int(value)
