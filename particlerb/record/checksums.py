"""Checksums: one number per frame, and one digest of all that does not change.

They find what a disk, a copy or an editor has changed. They protect from chance, not from malice.
"""

import hashlib
import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any, Final

import h5py
import numpy as np
from numpy.typing import NDArray

from particlerb.record import schema
from particlerb.record.checked_reading import object_at, require_own_storage
from particlerb.record.hdf5 import InPieces
from particlerb.record.vtkhdf import TOPOLOGY

Words = NDArray[np.uint64]

_MULTIPLIER: Final = 0x9E3779B97F4A7C15  # 2^64 over the golden ratio


@lru_cache(maxsize=16)
def factors(n: int) -> Words:
    """(2 k + 1) ODD mod 2^64 for k < n: all odd, so that no changed bit cancels."""
    return (2 * np.arange(n, dtype=np.uint64) + np.uint64(1)) * np.uint64(_MULTIPLIER)


def frame_checksums(
    n_frames: int, elements: Iterable[NDArray[np.generic]], first: int = 0
) -> Words:
    """Checksum of each of some frames.

    c ← ODD c + Σ_k (2 k + 1) ODD w_k mod 2^64 for one element after the other, with w_k the words
    of its row, of as many bits as its numbers have. Any change within one number is found for
    certain, others but for one case in 2^60 or so.

    Parameters
    ----------
    n_frames : int
        T.
    elements : iterable of ndarray, shapes (T, ...)
        Numbers of 32 or 64 bits, as the file holds them.
    first : int
        Number of the first body, where elements have those of a part of the bodies and nothing
        else: the sum over all parts is the checksum of the whole.
    """
    total = np.zeros(n_frames, dtype=np.uint64)
    for values in elements:
        word = np.uint32 if values.itemsize == 4 else np.uint64
        words: Any = np.ascontiguousarray(values).reshape(n_frames, -1).view(word)
        total = total * np.uint64(_MULTIPLIER) + words @ factors(words.shape[1])
        if first and values.size:
            shift = 2 * first * math.prod(values.shape[2:]) * _MULTIPLIER % 2**64
            total += np.uint64(shift) * words.sum(axis=1, dtype=np.uint64)
    return total


def list_checksums(columns: Iterable[NDArray[np.generic]], ends: NDArray[np.int64]) -> Words:
    """Checksum of each frame's part of a list: of all numbers in its rows, and of how many.

    Parameters
    ----------
    columns : iterable of ndarray, shapes (m, ...)
        Rows of all frames, one frame after the other; 32 or 64 bits, as the file holds them.
    ends : ndarray, shape (T,)
        The row behind each frame; the first begins at 0.
    """
    counts = np.diff(ends, prepend=0)
    row = (np.arange(counts.sum()) - np.repeat(ends - counts, counts)).astype(np.uint64)
    total = counts.astype(np.uint64)
    for values in columns:
        word = np.uint32 if values.itemsize == 4 else np.uint64
        width = math.prod(values.shape[1:])
        words: Any = np.ascontiguousarray(values).reshape(len(row), width).view(word)
        k = row[:, None] * np.uint64(width) + np.arange(width, dtype=np.uint64)
        weight = (np.uint64(2) * k + np.uint64(1)) * np.uint64(_MULTIPLIER)
        sums = np.concatenate([np.zeros(1, np.uint64), np.cumsum((words * weight).sum(axis=1))])
        total = total * np.uint64(_MULTIPLIER) + sums[ends] - sums[ends - counts]
    return total


_SCALES: Final = (*schema.AXES, schema.BODY, *schema.PART_TABLES)
_TABLES: Final = [*schema.STATIC, *_SCALES, *TOPOLOGY]  # in this order


def _unchanging(file: h5py.File) -> list[str]:
    """Paths of all datasets of a file that do not change in time."""
    paths = [*schema.STATIC, *schema.AXES, schema.BODY]
    paths += [path for path in schema.PART_TABLES if path in file]
    paths += TOPOLOGY if schema.VTKHDF in file else ()
    texts = (f"{schema.PARAMETERS}/{name}" for name in file[schema.PARAMETERS])
    paths += [path for path in texts if path != schema.FILES]
    return [*paths, *(f"{schema.FILES}/{name}" for name in file.get(schema.FILES, ()))]


def _order(path: str) -> tuple[int, str]:
    """What puts paths into the order of the digest: tables, then texts, then kept files."""
    is_file = path.startswith(f"{schema.FILES}/")
    return _TABLES.index(path) if path in _TABLES else len(_TABLES) + is_file, path


def digest_of(content: Mapping[str, Any]) -> str:
    """SHA-256 of arrays and texts by their paths."""
    hasher = hashlib.sha256()
    for path in sorted(content, key=_order):
        value = content[path]
        if isinstance(value, InPieces):
            hasher.update(f"{path} {math.prod(value.shape) * value.dtype.itemsize} ".encode())
            for piece in value:
                hasher.update(piece.tobytes())
            continue
        data = value if isinstance(value, bytes) else np.ascontiguousarray(value).tobytes()
        hasher.update(f"{path} {len(data)} ".encode())
        hasher.update(data)
    return hasher.hexdigest()


def digest(file: h5py.File) -> str:
    """SHA-256 of all that does not change in time: tables and texts."""
    return digest_of(tables_in(file))


def tables_in(file: h5py.File) -> dict[str, Any]:
    """All that does not change in time, by paths: tables and texts."""
    content = {}
    for path in _unchanging(file):
        dataset = object_at(file, path)
        require_own_storage(file, dataset, path)
        content[path] = dataset[()]
    return content


def seal(file: h5py.File) -> None:
    """Write the digest; to be repeated whenever /parameters has changed."""
    file[schema.INTEGRITY].attrs["digest"] = np.bytes_(digest(file))
