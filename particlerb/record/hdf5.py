"""Datasets, links and attributes by HDF5's own calls: h5py takes four times as long for the same.

Paths are from the root; groups on the way are made.
"""

import math
import os
from collections.abc import Callable, Iterator
from functools import cache, lru_cache
from typing import Any, Final, TypeAlias

import h5py
import numpy as np
from h5py import h5a, h5d, h5ds, h5f, h5o, h5p, h5s, h5t

WITH_GROUPS: Final = h5p.create(h5p.LINK_CREATE)
WITH_GROUPS.set_create_intermediate_group(True)
_UNLOCKED: Final = h5p.create(h5p.FILE_ACCESS)
_UNLOCKED.set_file_locking(False, True)
Form: TypeAlias = tuple["np.dtype[Any]", tuple[int, ...]]  # type of the numbers, and shape
_MIN_LARGE_BYTES: Final = 2**20
_TEXT_STEP: Final = 256  # bytes, to a multiple of which short texts are filled up
_ROWS_AT_ONCE: Final = 65_536
_MAX_ATTRIBUTE_BYTES: Final = 65536
_ANY_TEXT: Final = h5t.py_create(h5py.string_dtype(), logical=True)


class InPieces:
    """An array of which some rows are made at a time, when they are written.

    Parameters
    ----------
    n : int
        Rows.
    rows : callable
        Makes those from a first one to a last one, excluded.
    """

    def __init__(self, n: int, rows: Callable[[int, int], Any]) -> None:
        none = rows(0, 0)
        self.dtype, self.shape, self.rows = none.dtype, (n, *none.shape[1:]), rows

    def __len__(self) -> int:
        """Rows."""
        return self.shape[0]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        """All rows."""
        del copy
        return np.concatenate(list(self)).astype(dtype or self.dtype, copy=False)

    def __iter__(self) -> Iterator[Any]:
        """Rows, in pieces."""
        for first in range(0, max(len(self), 1), _ROWS_AT_ONCE):
            last = min(first + _ROWS_AT_ONCE, len(self))
            yield np.ascontiguousarray(self.rows(first, last))


def open_unlocked(path: os.PathLike[str]) -> h5py.File:
    """File open for reading, with no lock; errors as of h5py."""
    return h5py.File(h5f.open(os.fsencode(path), h5f.ACC_RDONLY, fapl=_UNLOCKED))


def put(file: h5py.File, path: str, values: Any) -> h5d.DatasetID:
    """Write an array, or a text, that does not change.

    A text is UTF-8 of fixed length: its bytes lie in one place, and a reader can tell beforehand
    how many they are.
    """
    if isinstance(values, bytes):
        kind = _text_of(max(len(values), 1))
        values = np.array(values, dtype=f"S{max(len(values), 1)}")
    else:
        kind = _type_of(np.asarray(values).dtype)
    made = h5d.create(file.id, path.encode(), kind, _space(np.shape(values)), _plan(), WITH_GROUPS)
    if np.size(values):
        made.write(h5s.ALL, h5s.ALL, np.ascontiguousarray(values), kind)
    return made


def form_of(values: Any) -> Form:
    """What `reserve` has to know of an array, or of a text: of many lengths it is the same."""
    if isinstance(values, InPieces):
        return values.dtype, values.shape
    if isinstance(values, bytes):
        return np.dtype(f"S{max(-(-len(values) // _TEXT_STEP), 1) * _TEXT_STEP}"), ()
    return np.asarray(values).dtype, np.shape(values)


def is_large(form: Form) -> bool:
    """Whether an array is given its place when it is written, and not before."""
    return form[0].itemsize * math.prod(form[1]) > _MIN_LARGE_BYTES


def reserve(file: h5py.File, path: str, form: Form) -> h5d.DatasetID:
    """An array that does not change, still without numbers, or a text."""
    is_text = form[0].kind == "S" and not form[1]
    kind = _text_of(form[0].itemsize) if is_text else _type_of(form[0])
    space, plan = _space(form[1]), _plan(is_early=not is_large(form))
    return h5d.create(file.id, path.encode(), kind, space, plan, WITH_GROUPS)


def fill(file: h5py.File, path: str, values: Any) -> None:
    """Write an array of which the form is known."""
    made, first = h5d.open(file.id, path.encode()), 0
    if not isinstance(values, InPieces):
        made.write(h5s.ALL, h5s.ALL, np.ascontiguousarray(values))
        return
    space = made.get_space()
    for piece in values:
        space.select_hyperslab((first, *[0] * (piece.ndim - 1)), piece.shape)
        made.write(h5s.create_simple(piece.shape), space, piece)
        first += len(piece)


def growing(
    file: h5py.File,
    path: str,
    dtype: Any,
    width: tuple[int, ...] = (),
    *,
    rows: int,
    length: int = 0,
    fill: float | None = None,
) -> h5d.DatasetID:
    """An array that can grow along its first axis, in chunks of so many rows."""
    plan = _plan((rows, *width), None if fill is None else (fill, np.dtype(dtype)))
    space = _space((length, *width), (h5s.UNLIMITED, *width))
    kind = _type_of(np.dtype(dtype))
    return h5d.create(file.id, path.encode(), kind, space, plan, WITH_GROUPS)


def opened(file: h5py.File, path: str) -> h5d.DatasetID:
    """Dataset of a file of our own."""
    return h5d.open(file.id, path.encode())


def link(file: h5py.File, path: str, target: h5d.DatasetID) -> None:
    """Give a dataset one more name."""
    h5o.link(target, file.id, path.encode(), WITH_GROUPS)


def group(file: h5py.File, path: str) -> h5py.h5g.GroupID:
    """Make a group."""
    return h5py.h5g.create(file.id, path.encode(), WITH_GROUPS)


def attach(dataset: h5d.DatasetID, *scales: h5d.DatasetID) -> None:
    """Let dimensions have these scales, the first ones."""
    for k, scale in enumerate(scales):
        h5ds.attach_scale(dataset, scale, k)


def note(place: Any, **values: Any) -> None:
    """Add attributes: texts, numbers, or arrays of them."""
    for name, value in values.items():
        is_text = isinstance(value, str)
        data = np.array(value, dtype=h5py.string_dtype()) if is_text else np.asarray(value)
        kind = _ANY_TEXT if is_text else _type_of(data.dtype)
        h5a.create(place, name.encode(), kind, _space(data.shape)).write(data)


def change(place: Any, name: str, value: Any) -> None:
    """Write another value into an attribute, of the same type."""
    h5a.open(place, name.encode()).write(np.asarray(value))


def header_attribute(place: Any, name: str, kinds: str) -> Any:
    """Value of an attribute, an array or bytes, if it lies within the header of its object.

    HDF5 may go round forever in a damaged heap, where strings without a fixed length lie.

    Raises
    ------
    KeyError, ValueError
        If it is not there, or of another type.
    """
    if not h5a.exists(place.id, name.encode()):
        raise KeyError(f"{name} is missing")
    held = h5a.open(place.id, name.encode())
    dtype = held.dtype
    if dtype.kind not in kinds or dtype.hasobject or len(held.shape) > 1:
        raise ValueError(f"{name} has the type {dtype}")
    if int(np.prod(held.shape)) * dtype.itemsize > _MAX_ATTRIBUTE_BYTES:
        raise ValueError(f"{name} is too large")
    values = np.empty(held.shape, dtype)
    held.read(values)
    return values[()]


def describe(dataset: h5d.DatasetID, units: str, meaning: str) -> h5d.DatasetID:
    """Say what the numbers are; `units` is CF's name, H5MD's `unit` stops MDAnalysis."""
    note(dataset, units=units, meaning=meaning)
    return dataset


@lru_cache(maxsize=256)
def _space(shape: tuple[int, ...], most: tuple[int, ...] | None = None) -> Any:
    """Extent of an array, or of a single value."""
    return h5s.create_simple(shape, most) if shape else h5s.create(h5s.SCALAR)


@cache
def _type_of(dtype: "np.dtype[Any]") -> Any:
    """HDF5's name of a type of numbers."""
    return h5t.py_create(dtype)


def _text_of(size: int) -> Any:
    """HDF5's name of UTF-8 of so many bytes."""
    return h5t.py_create(h5py.string_dtype("utf-8", size), logical=True)


@lru_cache(maxsize=256)
def _plan(
    chunk: tuple[int, ...] = (),
    fill: tuple[float, "np.dtype[Any]"] | None = None,
    is_early: bool = False,
) -> Any:
    """Properties of a new dataset: without times, so that the same content has the same bytes."""
    plan = h5p.create(h5p.DATASET_CREATE)
    plan.set_obj_track_times(False)
    if chunk:
        plan.set_chunk(chunk)
    if is_early:
        plan.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    if fill is not None:
        plan.set_fill_value(np.array(*fill))
    return plan
