"""The HDF5 file that a run writes: made whole or not at all, changed by commits, left after errors.

A new file lies beside its place, under its name with `.new` behind it, until it has all but frames.
"""

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py

from particlerb.record.atomic import AtomicFile
from particlerb.record.checked_reading import FAULTS, reason_of
from particlerb.record.output_path import output_path
from particlerb.record.writer_lock import WriterLock

_NUMBERS = itertools.count()  # of the files in memory


class DamagedError(OSError):
    """A file from before that cannot be written on: why."""


class OutputFile:
    """HDF5 file that one process writes.

    Parameters
    ----------
    path : Path or None
        Its name, for errors; None for a file in memory.
    lock : WriterLock or None
        The open file; closed with this one.
    mode : str
        `w` for a new file, `r+` for one from before.
    is_durable : bool
        Whether commits wait for the disk.

    Attributes
    ----------
    file : h5py.File
        For whoever writes, within `writing`.
    is_broken : bool
        Whether something has failed; nothing more is written then.
    """

    def __init__(
        self, path: Path | None, lock: WriterLock | None, mode: str, is_durable: bool
    ) -> None:
        self.path, self.is_from_before, self.is_broken = path, mode == "r+", False
        self.disk: AtomicFile | None = None
        if path is None or lock is None:
            name = f"memory-{next(_NUMBERS)}.h5"  # HDF5 tells files in memory apart by their names
            self.file = h5py.File(name, "w", driver="core", backing_store=False)
            return
        try:
            self.disk = AtomicFile(lock, path, is_durable)
            self.disk.settle()
            self.file = h5py.File(self.disk, mode)
        except BaseException:
            lock.close()
            raise

    @property
    def seconds_for_disk(self) -> float:
        """Seconds that the disk was waited for until now."""
        return 0.0 if self.disk is None else self.disk.seconds

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Leave the file as it was committed last where the disk fails, or HDF5 is interrupted."""
        try:
            yield
        except BaseException as error:
            self.abandon()
            if self.is_from_before and isinstance(error, FAULTS):
                raise DamagedError(f"{self.path} is damaged: {reason_of(error)}") from None
            raise
        if self.disk is not None and self.disk.failure is not None:
            self.abandon()

    def abandon(self) -> None:
        """Write no more; raise OSError where the disk has failed."""
        self.is_broken = True
        if self.disk is None:
            return
        failure, self.disk.failure = self.disk.failure, self.disk.failure or (None, None, "")
        with suppress(OSError, RuntimeError, ValueError):
            self.file.close()
        self.disk.source.close()
        if failure is not None:
            raise OSError(*failure) from None

    def commit(self) -> None:
        """Let the file on the disk be what was written until now."""
        self.file.flush()
        if self.disk is not None:
            self.disk.commit()

    def close(self) -> None:
        """Commit and close; a file in memory stays open."""
        if self.disk is None:
            self.file.flush()
            return
        self.file.close()
        self.disk.commit()
        self.disk.source.close()


@contextmanager
def new_file(path: Path | None, overwrite: bool, is_durable: bool) -> Iterator[OutputFile]:
    """A new file, which takes its name when the block has ended well, and is none otherwise.

    Raises
    ------
    FileExistsError
        If there is a file that may not be replaced.
    InUseError
        If another process writes it.
    OSError
        If it cannot be made.
    """
    if path is None:
        yield OutputFile(None, None, "w", is_durable)
        return
    place = output_path(path, overwrite)
    place.parent.mkdir(parents=True, exist_ok=True)
    if place.exists():
        WriterLock(place).close()  # nobody else writes it
    new = place.with_name(f"{place.name}.new")
    lock = WriterLock(new)
    os.ftruncate(lock.fileno(), 0)
    output = OutputFile(path, lock, "w", is_durable)
    try:
        with output.writing():
            yield output
            new.replace(place)
            if is_durable:
                _sync_folder(place.parent)
    except BaseException:
        new.unlink(missing_ok=True)
        raise


def _sync_folder(path: Path) -> None:
    """Wait until the disk has the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
