"""What a resumed run needs beside the last frame: two slots in the file, written in turn.

A slot is an archive of NumPy arrays (`numpy.load` reads its bytes) with the hash of these bytes
and the number of frames that lay behind. The attribute `current` says which slot counts; it is
changed when the other one is wholly on disk, so a kill at any moment leaves one that is whole.
"""

import hashlib
import io
import zipfile
from collections.abc import Mapping
from typing import Any, NamedTuple

import h5py
import numpy as np

from particlerb.record.schema import CHECKPOINT, CURRENT, SLOT_DIGEST, SLOT_FRAMES, SLOTS

LARGEST_CHUNK = 2**20  # bytes of a slot that lie together
SMALLEST_CHUNK = 2**9


class CheckpointError(Exception):
    """A file without a checkpoint that is whole: why."""


class Checkpoint(NamedTuple):
    """State of a run."""

    n_frames: int  # frames that lie behind
    arrays: Mapping[str, Any]
    digest: str  # SHA-256 of the bytes in the slot


def packed(arrays: Mapping[str, Any]) -> bytes:
    """Bytes of an archive of arrays: the same for the same arrays."""
    archive = io.BytesIO()
    np.savez(archive, **arrays)
    return archive.getvalue()


def unpacked(content: bytes) -> dict[str, Any]:
    """Arrays of an archive."""
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def make_slots(file: h5py.File, n_frames: int, arrays: Mapping[str, Any]) -> None:
    """Make both slots, and write the first; it counts at once."""
    content = packed(arrays)
    if CHECKPOINT in file:  # not wholly made
        del file[CHECKPOINT]
    group = file.create_group(CHECKPOINT)
    size = 2 ** (len(content) - 1).bit_length()
    chunks = (min(max(size, SMALLEST_CHUNK), LARGEST_CHUNK),)
    for name in SLOTS:
        slot = group.create_dataset(name, (0,), "u1", maxshape=(None,), chunks=chunks)
        slot.attrs[SLOT_FRAMES] = np.int64(0)
        slot.attrs[SLOT_DIGEST] = np.bytes_(digest_of(b""))
    group.attrs[CURRENT] = np.int64(0)
    put(group[SLOTS[0]], n_frames, content)


def put(slot: h5py.Dataset, n_frames: int, content: bytes) -> None:
    """Write a slot."""
    slot.resize((len(content),))
    slot[:] = np.frombuffer(content, dtype=np.uint8)
    slot.attrs.modify(SLOT_FRAMES, np.int64(n_frames))
    slot.attrs.modify(SLOT_DIGEST, np.bytes_(digest_of(content)))


def digest_of(content: bytes) -> str:
    """Hash of the bytes of a slot."""
    return hashlib.sha256(content).hexdigest()


def write_checkpoint(file: h5py.File, n_frames: int, arrays: Mapping[str, Any]) -> int:
    """Write the slot that does not count; return its number, for `CURRENT` once it is on disk."""
    group = file[CHECKPOINT]
    other = 1 - int(group.attrs[CURRENT])
    put(group[SLOTS[other]], n_frames, packed(arrays))
    return other


def slot_in(file: h5py.File, number: int) -> tuple[int, bytes, str]:
    """Frames, bytes and hash of a slot.

    Raises
    ------
    CheckpointError
        If it is not there, or its bytes do not have its hash.
    """
    try:
        slot = file[CHECKPOINT][SLOTS[number]]
        n_frames, digest = int(slot.attrs[SLOT_FRAMES]), bytes(slot.attrs[SLOT_DIGEST]).decode()
        content = slot[:].tobytes()
    except (KeyError, IndexError, OSError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise CheckpointError(f"{file.filename} has no checkpoint: {reason}") from None
    if digest_of(content) != digest:
        raise CheckpointError(f"{file.filename}: the checkpoint is damaged: its hash is another")
    return n_frames, content, digest


def read_checkpoint(file: h5py.File) -> Checkpoint:
    """Checkpoint that counts, or the one before where that is damaged.

    Raises
    ------
    CheckpointError
        If there is none that is whole.
    """
    group = file.get(CHECKPOINT)
    if not isinstance(group, h5py.Group) or CURRENT not in group.attrs:
        raise CheckpointError(f"{file.filename} has no checkpoint")
    current = int(group.attrs[CURRENT])
    try:
        n_frames, content, digest = slot_in(file, current)
    except CheckpointError as error:
        try:
            n_frames, content, digest = slot_in(file, 1 - current)
        except CheckpointError:
            raise error from None
    try:
        return Checkpoint(n_frames, unpacked(content), digest)
    except (ValueError, OSError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise CheckpointError(f"{file.filename}: the checkpoint cannot be read: {error}") from None
