"""What a resumed run needs beside the last frame: two slots in the file, written in turn.

A slot is an archive of NumPy arrays (`numpy.load` reads its bytes) with the hash of these bytes
and the number of frames that lay behind. The attribute `current` says which slot counts; it changes
with the counter of frames, in one commit. Where the slot that counts is damaged, the other serves.

Why it is so: docs/decisions/0012.
"""

import hashlib
import io
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from h5py import h5d, h5s

from particlerb.record import schema
from particlerb.record.checked_reading import (
    TrajectoryError,
    attribute,
    dataset_at,
    integer_attribute,
    object_at,
    open_file,
    require_self_contained,
    trajectory_errors,
)
from particlerb.record.hdf5 import change, group, growing, note, opened

_MIN_CHUNK_BYTES, _MAX_CHUNK_BYTES = 2**9, 2**20  # of a slot that lie together


class CheckpointError(Exception):
    """A file without a checkpoint that is whole: why."""


class Checkpoint(NamedTuple):
    """State of a run."""

    n_frames: int  # frames that lie behind
    arrays: dict[str, Any]


class _Slot(NamedTuple):
    """Content of a slot as it was written."""

    n_frames: int  # frames that lie behind
    content: bytes
    digest: str  # SHA-256 of the content


def _make_slots(file: h5py.File, size: int) -> None:
    """Make both slots, empty, for contents of about so many bytes."""
    note(group(file, schema.CHECKPOINT), **{schema.CURRENT: np.int64(1)})
    size = 2 ** (size - 1).bit_length()
    rows = min(max(size, _MIN_CHUNK_BYTES), _MAX_CHUNK_BYTES)
    empty = {schema.SLOT_FRAMES: np.int64(0), schema.SLOT_DIGEST: np.bytes_(_digest_of(b""))}
    for name in schema.SLOTS:
        note(growing(file, f"{schema.CHECKPOINT}/{name}", "u1", rows=rows), **empty)


def put(slot: h5d.DatasetID, n_frames: int, content: bytes) -> None:
    """Write a slot."""
    slot.set_extent((len(content),))
    slot.write(h5s.ALL, h5s.ALL, np.frombuffer(content, dtype=np.uint8))
    change(slot, schema.SLOT_FRAMES, np.int64(n_frames))
    change(slot, schema.SLOT_DIGEST, np.bytes_(_digest_of(content)))


def _digest_of(content: bytes) -> str:
    """Hash of the bytes of a slot."""
    return hashlib.sha256(content).hexdigest()


def write_checkpoint(file: h5py.File, n_frames: int, arrays: Mapping[str, Any]) -> None:
    """Write the slot that does not count, and let it count, both with the next commit."""
    archive = io.BytesIO()
    np.savez(archive, **arrays)  # the same bytes for the same arrays
    content = archive.getvalue()
    if schema.CHECKPOINT not in file:
        _make_slots(file, len(content))
    place = file[schema.CHECKPOINT]
    other = 1 - int(place.attrs[schema.CURRENT])
    put(opened(file, f"{schema.CHECKPOINT}/{schema.SLOTS[other]}"), n_frames, content)
    change(place.id, schema.CURRENT, np.int64(other))


def count_from(file: h5py.File, n_frames: int) -> None:
    """Let the slot count that lies behind so many frames; the other is to be written next.

    A part that a kill has left ahead of others goes on from the slot that all of them have.
    """
    if schema.CHECKPOINT not in file:
        return
    place = file[schema.CHECKPOINT]
    slots = [place.get(name) for name in schema.SLOTS]  # one may be missing in a damaged file
    frames = [-1 if slot is None else int(slot.attrs[schema.SLOT_FRAMES]) for slot in slots]
    if n_frames in frames and frames[int(place.attrs[schema.CURRENT])] != n_frames:
        change(place.id, schema.CURRENT, np.int64(frames.index(n_frames)))


def slots_in(file: h5py.File) -> dict[int, dict[str, Any]]:
    """Both states of a file that is not trusted, by the frames behind which they lie; whole ones.

    A kill while parts are committed leaves some of them one state ahead.
    """
    states: dict[int, dict[str, Any]] = {}
    for is_before in (True, False) if schema.CHECKPOINT in file else ():
        with suppress(TrajectoryError, CheckpointError):
            state = _state_in(file, is_before)
            states[state.n_frames] = state.arrays
    return states


def states_of(path: Path) -> dict[int, dict[str, Any]]:
    """Both states in the file of a part.

    Raises
    ------
    TrajectoryError
        If it is none, or takes data from other files.
    """
    with open_file(path) as file:
        require_self_contained(file)
        return slots_in(file)


def slot_in(file: h5py.File, is_before: bool) -> _Slot:
    """The slot that counts, or the one before, of a file that is not trusted.

    Raises
    ------
    TrajectoryError
        If it is not there, or of another form.
    CheckpointError
        If it does not have the hash that was written.
    """
    with trajectory_errors(file):
        current = integer_attribute(object_at(file, schema.CHECKPOINT), schema.CURRENT)
        name = schema.SLOTS[1 - current if is_before else current]
        slot = dataset_at(file, f"{schema.CHECKPOINT}/{name}", "u", (None,))
        content = slot[:].tobytes()
        stored = bytes(attribute(slot, schema.SLOT_DIGEST, "S")).decode(errors="replace")
        n_frames, digest = integer_attribute(slot, schema.SLOT_FRAMES), _digest_of(content)
    if digest != stored:
        written = f"written was {stored[:12]}…"
        raise CheckpointError(f"in slot {name} has the hash {digest[:12]}…, {written}")
    return _Slot(n_frames, content, digest)


def read_checkpoint(file: h5py.File) -> Checkpoint:
    """The state that counts, or the one before where that is damaged.

    Raises
    ------
    CheckpointError
        If there is none that is whole: what is wrong with the one that counts.
    """
    if schema.CHECKPOINT not in file:
        raise CheckpointError(f"{file.filename}: the checkpoint is missing")
    try:
        return _state_in(file, False)
    except (TrajectoryError, CheckpointError) as error:
        with suppress(TrajectoryError, CheckpointError):
            return _state_in(file, True)
        raise CheckpointError(f"{file.filename} is damaged: the checkpoint {error}") from None


def _state_in(file: h5py.File, is_before: bool) -> Checkpoint:
    """State in the slot that counts, or in the one before; errors as of `slot_in`.

    What zipfile, zlib, tokenize and NumPy raise of an archive that they cannot read has no end.
    """
    slot = slot_in(file, is_before)
    try:
        with np.load(io.BytesIO(slot.content), allow_pickle=False) as archive:
            return Checkpoint(slot.n_frames, {name: archive[name] for name in archive.files})
    except Exception as error:
        raise CheckpointError(f"cannot be read: {error}") from None
