"""The HDF5 file that a run writes: made whole or not at all, changed by commits, left after errors.

A new file lies beside its place, under its name with `.new` behind it, until its first commit; one
that has parts, in their folder.
"""

import errno
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import h5py

from particlerb.record.atomic import AtomicFile
from particlerb.record.checked_reading import FAULTS, reason_of
from particlerb.record.output_path import is_at, output_path, short_name, sync
from particlerb.record.parts import parts_used_by
from particlerb.record.writer_lock import InUseError, WriterLock


class DamagedError(OSError):
    """A file from before that cannot be written on: why."""


class OutputFile:
    """HDF5 file that one process writes.

    Parameters
    ----------
    path : Path
        Its name, for errors.
    lock : WriterLock
        The open file; closed with this one.
    is_durable : bool
        Whether commits wait for the disk.
    place, waiting : Path, optional
        Where a new file comes to lie with its first commit, and where it lies until then.
    empty : bytes
        Content of a new file, without frames.
    replaced : sequence of Path
        Parts of the file that is in its place until then: removed with it.

    Attributes
    ----------
    file : h5py.File
        For whoever writes, within `writing`.
    is_broken : bool
        Whether something has failed; nothing more is written then.
    """

    def __init__(
        self, path: Path, lock: WriterLock, is_durable: bool, place: Path | None = None,
        empty: bytearray | None = None, waiting: Path | None = None, replaced: Sequence[Path] = (),
    ) -> None:  # fmt: skip
        self.path, self.is_from_before, self.is_broken = path, place is None, False
        self.place, self.waiting = place, waiting  # None: it is there
        self.name = path.absolute()  # also where the process goes to another folder
        self.replaced = replaced
        try:
            if waiting is not None:
                _empty(lock, waiting)
            self.disk = AtomicFile(lock, path, is_durable)
            self.disk.settle()
            if empty is not None:
                self.disk.begin(empty)
            self.file = h5py.File(self.disk, "r+")
        except BaseException:
            lock.close()
            raise

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Leave the file as it was committed last where the disk fails, or HDF5 is interrupted."""
        try:
            yield
        except BaseException as error:
            self.abandon()
            is_there = not isinstance(error, FileNotFoundError)
            if self.is_from_before and is_there and isinstance(error, FAULTS):
                raise DamagedError(f"{self.path} is damaged: {reason_of(error)}") from None
            raise
        if self.disk.failure is not None:
            self.abandon()

    def abandon(self) -> None:
        """Write no more; raise OSError where the disk has failed."""
        self.is_broken = True
        failure, self.disk.failure = self.disk.failure, self.disk.failure or (None, None, "")
        with suppress(OSError, RuntimeError, ValueError):
            self.file.close()
        if self.waiting is not None:
            with suppress(OSError):
                self.waiting.unlink(missing_ok=True)
        self.disk.source.close()
        if failure is not None:
            raise OSError(*failure) from None

    def commit(self) -> None:
        """Let the file on the disk be what was written until now; a new one takes its name."""
        self.file.flush()
        self.disk.commit()
        self.take_place()

    def take_place(self) -> None:
        """Give a new file its name; raise FileNotFoundError where one from before has none now."""
        if self.place is None or self.waiting is None:
            descriptor = self.disk.descriptor
            if not os.fstat(descriptor).st_nlink and not is_at(self.name, descriptor):
                raise OSError(errno.ENOENT, "was removed or replaced meanwhile", str(self.path))
            return
        self.waiting.replace(self.place)
        folders = dict.fromkeys((self.place.parent, self.waiting.parent))
        self.place = self.waiting = None
        for folder in folders if self.disk.is_durable else ():
            sync(folder)
        with suppress(OSError):
            for part in self.replaced:
                part.unlink(missing_ok=True)
            for folder in {part.parent for part in self.replaced}:
                folder.rmdir()  # if it is empty

    def close(self) -> None:
        """Commit and close; where it was moved, raise FileNotFoundError with its new name."""
        self.file.close()
        self.disk.commit()
        self.take_place()
        if not is_at(self.name, self.disk.descriptor):
            names = str(self.path), None, _name_of(self.disk.descriptor)
            raise OSError(errno.ENOENT, "was moved meanwhile", *names)
        self.disk.source.close()


def waiting_in(folder: Path, place: Path) -> Path:
    """Where a new file lies until its first commit."""
    return folder / f"{short_name(place)}.new"


def _empty(lock: WriterLock, waiting: Path) -> None:
    """Empty it; raise InUseError where another run has just ended, and renamed what was locked."""
    if not is_at(waiting, lock.fileno()):
        raise InUseError(errno.EBUSY, "was written by another run just now", str(waiting))
    with _blaming(waiting):
        os.truncate(lock.fileno(), 0)


def new_file(
    path: Path, overwrite: bool, is_durable: bool, empty: bytearray, folder: str = "."
) -> OutputFile:
    """A new file, which takes its name with its first commit, and is none without.

    Until then it lies in a folder: this one, from where it comes to lie.

    Raises
    ------
    FileExistsError
        If there is a file that may not be replaced.
    InUseError
        If another process writes it.
    OSError
        If it cannot be made.
    """
    place = output_path(path, overwrite)
    waiting = waiting_in(place.parent / folder, place)
    waiting.parent.mkdir(parents=True, exist_ok=True)
    if place.exists():
        WriterLock(place).close()  # nobody else writes it
    if waiting.is_symlink():  # no run has made it: what it leads to stays
        waiting.unlink()
    lock = WriterLock(waiting)
    replaced = parts_used_by(place) if place.exists() else ()
    return OutputFile(path, lock, is_durable, place, empty, waiting, replaced)


def _name_of(descriptor: int) -> str:
    """Name of an open file; empty where the system does not say it."""
    with suppress(OSError):
        name = os.readlink(f"/proc/self/fd/{descriptor}")
        return os.path.relpath(name) if is_at(Path(name), descriptor) else ""
    return ""


@contextmanager
def _blaming(path: Path) -> Iterator[None]:
    """Name what an operation by a number of a file was for, where it fails."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
