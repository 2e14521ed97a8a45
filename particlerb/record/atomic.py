"""A file that goes from one commit to the next as a whole, whatever is cut off in between.

HDF5 writes through h5py's driver for Python objects: what it overwrites stays in memory until a
commit, and no write can fail on it. Only new pages, to which nothing committed refers, go into the
file at any time. A commit

1. syncs these,
2. puts all changed pages behind the end of the file, as one record with a hash, and syncs it: from
   here on it is done,
3. puts them in their places, the superblock last, and syncs.

A record that is not whole counts for nothing. One that is can be applied any number of times, until
the next pages are written over it.

Why it is so: docs/decisions/0015.
"""

import contextlib
import errno
import hashlib
import os
import struct
import time
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from particlerb.record.output_path import sync_open
from particlerb.record.writer_lock import InUseError, WriterLock

PAGE: Final = 4096  # bytes that a disk writes as one
_MAX_NEW_PAGES: Final = 2048  # new pages that wait in memory
_FOOTER: Final = struct.Struct("<16sQ32s")  # of a record: mark, number of pages, SHA-256
MARK: Final = b"particlerb pages"
_PAGE_NUMBER_BYTES: Final = 8
VERSION_0: Final = b"\x89HDF\r\n\x1a\n\0"  # how a superblock of version 0 begins, as h5py has it,
SUPERBLOCK: Final = 96  # bytes of it,
END: Final = 40  # and where in it the end of the file stands, as a plain number

_Buffer = bytes | bytearray | memoryview


class AtomicFile:
    """Open file for h5py, `h5py.File(AtomicFile(...), "r+")`; on the disk it changes at commits.

    Parameters
    ----------
    source : file or WriterLock
        What is open; locked if it is to be written: only a writer goes on after an error.
    path : Path
        Its name, for errors.
    is_durable : bool
        Whether commits wait for the disk: they are safe from a power cut then, not from kills only.

    Attributes
    ----------
    on_disk : int
        Bytes of the file behind the last access of a writer: another program may cut it.
    changed : dict of int to bytearray
        Pages that are not yet in their places; at first those of a commit that was cut off.
    failure : tuple or None
        Number, words and file of the first error; from then on nothing goes into the file.
    seconds : float
        That the disk was waited for.
    """

    def __init__(self, source: BinaryIO | WriterLock, path: Path, is_durable: bool = True) -> None:
        self.source, self.path, self.is_durable = source, path, is_durable
        self.descriptor, self.is_writer = source.fileno(), isinstance(source, WriterLock)
        self.on_disk = os.fstat(self.descriptor).st_size
        self.size = self.on_disk  # as HDF5 sees it
        self.place = 0  # of the next read or write
        self.new: dict[int, bytearray] = {}  # pages behind those that were committed
        self.changed = {k: bytearray(page) for k, page in left_over(self.descriptor).items()}
        self.failure: tuple[int | None, str | None, str] | None = None
        self.seconds = 0.0
        self.committed = _pages_in(self.end())

    def __repr__(self) -> str:
        """Return the name, which h5py makes that of the file."""
        return str(self.path)

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place, counted from the start or the end."""
        self.place = place + (self.size if whence == os.SEEK_END else 0)
        return self.place

    def tell(self) -> int:
        """Where the next read or write begins."""
        return self.place

    def truncate(self, size: int) -> int:
        """Take note of the size."""
        self.size = size
        return size

    def flush(self) -> None:
        """Do nothing: `commit` does it."""

    def read(self, size: int) -> bytes:
        """Bytes from the place on."""
        content = bytearray(size)
        self.readinto(content)
        return bytes(content)

    def readinto(self, target: Any) -> int:
        """Fill a buffer from the place on, behind the end with zeros."""
        view = memoryview(target).cast("B")
        number, offset = divmod(self.place, PAGE)
        page = self.changed.get(number) or self.new.get(number)
        if page is not None and offset + len(view) <= PAGE:  # of metadata just made most are so
            view[:] = page[offset : offset + len(view)]
            self.place += len(view)
            return len(view)
        page_pieces = [
            (self.changed.get(number) or self.new.get(number), offset, start, stop)
            for number, offset, start, stop in pieces(self.place, len(view))
        ]
        if any(page is None for page, _, _, _ in page_pieces):
            self.take(self.place, view)
        for page, offset, start, stop in page_pieces:
            if page is not None:
                view[start:stop] = page[offset : offset + stop - start]
        self.place += len(view)
        return len(view)

    def write(self, source: Any) -> int:
        """Write at the place: much that is new into the file, all else into memory."""
        view = memoryview(source).cast("B")
        start, stop = self.place, self.place + len(view)
        self.place, self.size = stop, max(self.size, stop)
        if len(view) < PAGE or start < self.committed * PAGE:
            self.remember(start, view)
        else:
            for number in range(start // PAGE, _pages_in(stop)) if self.new else ():
                if number in self.new:
                    self.put_new(number * PAGE, self.new.pop(number))
            self.put_new(start, view)
        if len(self.new) > _MAX_NEW_PAGES:
            self.put_all_new()
        return len(view)

    def begin(self, content: bytearray) -> None:
        """Let a new file have a content, in memory."""
        self.remember(0, memoryview(content))
        self.size = len(content)

    def remember(self, place: int, view: memoryview) -> None:
        """Write into pages in memory."""
        for number, offset, start, stop in pieces(place, len(view)):
            pages = self.changed if number < self.committed else self.new
            page = pages.get(number)
            if page is None:
                page = pages[number] = bytearray(PAGE)
                if stop - start < PAGE and number * PAGE < self.on_disk:
                    self.take(number * PAGE, memoryview(page))
            page[offset : offset + stop - start] = view[start:stop]

    def put_all_new(self) -> None:
        """Write all new pages into the file."""
        for place, data in runs(self.new):
            self.put_new(place, data)
        self.new = {}

    def put_new(self, place: int, data: _Buffer) -> None:
        """Write what is new into the file; HDF5 does not learn of a failure, `commit` does."""
        with contextlib.suppress(OSError), self.blaming():
            put(self.descriptor, place, data)

    def take(self, place: int, view: memoryview) -> None:
        """Read what is in the file; a writer reads zeros where that fails: HDF5 would crash."""
        try:
            with self.blaming():
                fill(self.descriptor, place, view)
        except OSError:
            if not self.is_writer:
                raise
            view[:] = bytes(len(view))

    @contextlib.contextmanager
    def blaming(self) -> Iterator[None]:
        """Name the file in an error; a writer writes no more after it, nor where the file was cut.

        Of a reader the writer may cut it, which has settled its commit.
        """
        try:
            if self.is_writer and self.failure is not None:
                raise OSError(*self.failure)
            if self.is_writer and os.fstat(self.descriptor).st_size < self.on_disk:
                raise OSError(errno.EIO, "was cut by another program meanwhile")
            yield
            self.on_disk = os.fstat(self.descriptor).st_size
        except OSError as error:
            self.failure = self.failure or (error.errno, error.strerror, str(self.path))
            raise OSError(*self.failure) from None

    def sync(self) -> None:
        """Wait until the disk has what was written."""
        if self.is_durable:
            start = time.monotonic()
            sync_open(self.descriptor)
            self.seconds += time.monotonic() - start

    def commit(self) -> None:
        """Let the file on the disk be, in one moment, what HDF5 has flushed until now.

        Raises
        ------
        OSError
            If something could not be written since the last commit. The file is then as that has
            left it, or this commit is done but for its third step.
        """
        self.put_all_new()
        end = self.end()
        if self.committed and not self.changed:
            return
        behind = max(_pages_in(end), self.committed) * PAGE
        with self.blaming():
            os.ftruncate(self.descriptor, behind)
            self.sync()
            if self.changed:
                put(self.descriptor, behind, record(behind, self.changed))
                self.sync()
        self.settle()
        self.committed = _pages_in(end)

    def settle(self) -> None:
        """Put the changed pages in their places, and cut off the record that has them."""
        with self.blaming():
            if self.changed:
                for place, data in runs(self.changed):
                    put(self.descriptor, place, data)
                self.sync()
            if os.fstat(self.descriptor).st_size > self.end():
                os.ftruncate(self.descriptor, self.end())
        self.changed = {}

    def is_in_place(self) -> bool:
        """Whether the changed pages are in their places."""
        written = bytearray(PAGE)
        for number, page in self.changed.items():
            fill(self.descriptor, number * PAGE, memoryview(written))
            if written != page:
                return False
        return True

    def end(self) -> int:
        """End of the file as HDF5 has noted it [bytes]; OSError where something has failed."""
        self.seek(0)
        start = self.read(SUPERBLOCK)
        if self.failure is not None:
            raise OSError(*self.failure)
        if not start.startswith(VERSION_0):
            return self.size
        return int(struct.unpack_from("<Q", start, END)[0])

    def __del__(self) -> None:
        """Close the file, if nobody else has."""
        self.source.close()


def to_read(path: Path) -> Path | AtomicFile:
    """What h5py opens to read a file; a commit that was cut off is brought to its end before.

    Where that cannot be written, it is done in memory. While another process writes the file, it is
    left to that one.
    """
    source = path.open("rb")
    file = AtomicFile(source, path)
    try:
        if not file.is_in_place():
            finish(path)
    except InUseError:
        pass
    except OSError:
        return file
    source.close()
    return path


def finish(path: Path) -> None:
    """Bring a commit that was cut off to its end.

    Raises
    ------
    InUseError
        If another process writes the file.
    OSError
        If it cannot be written, or others cannot be kept away.
    """
    with contextlib.closing(WriterLock(path)) as lock:
        if not lock.is_exclusive:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK), str(path))
        AtomicFile(lock, path).settle()


def _pages_in(size: int) -> int:
    """Pages that so many bytes lie in."""
    return -(-size // PAGE)


def pieces(place: int, size: int) -> list[tuple[int, int, int, int]]:
    """Of each page that bytes at a place lie in: its number, where in it, and which bytes."""
    first, offset = divmod(place, PAGE)
    if offset + size <= PAGE:  # most are so
        return [(first, offset, 0, size)] if size else []
    starts = range(PAGE - offset, size, PAGE)
    numbered = enumerate(starts, first + 1)
    later = [(number, 0, start, min(start + PAGE, size)) for number, start in numbered]
    return [(first, offset, 0, PAGE - offset), *later]


def runs(pages: Mapping[int, _Buffer]) -> Iterator[tuple[int, bytes]]:
    """Places and bytes of pages that follow each other; the superblock comes last."""
    numbers = enumerate(sorted(pages))
    groups = [[number for _, number in run] for _, run in groupby(numbers, lambda k: k[1] - k[0])]
    for run in reversed(groups):
        yield run[0] * PAGE, b"".join(pages[number] for number in run)


def fill(descriptor: int, place: int, view: memoryview) -> None:
    """Read a part of a file; behind its end are zeros."""
    while len(view):
        done = os.preadv(descriptor, [view], place)
        if not done:
            view[:] = bytes(len(view))
        place, view = place + done, view[done or len(view) :]


def put(descriptor: int, place: int, data: _Buffer) -> None:
    """Write bytes into a file."""
    view = memoryview(data)
    while view:
        done = os.pwrite(descriptor, view, place)
        place, view = place + done, view[done:]


def record(place: int, pages: Mapping[int, _Buffer]) -> bytes:
    """Record of some pages, to be put at a place, where `left_over` finds it."""
    numbers = sorted(pages)
    content = b"".join(pages[number] for number in numbers)
    content += np.array(numbers, dtype=np.uint64).tobytes()
    return content + _FOOTER.pack(MARK, len(numbers), _hash_of(place, content))


def _hash_of(place: int, content: _Buffer) -> bytes:
    """SHA-256 of a record at a place."""
    hasher = hashlib.sha256(place.to_bytes(8, "little"))
    hasher.update(content)
    return hasher.digest()


def left_over(descriptor: int) -> dict[int, _Buffer]:
    """Pages in the record at the end of a file; none where none is there, or not all of it."""
    size = os.fstat(descriptor).st_size
    footer = os.pread(descriptor, _FOOTER.size, max(size - _FOOTER.size, 0))
    if len(footer) < _FOOTER.size or not footer.startswith(MARK):
        return {}
    _, n, digest = _FOOTER.unpack(footer)
    place = size - _FOOTER.size - n * (PAGE + _PAGE_NUMBER_BYTES)
    if place < 0:
        return {}
    content = memoryview(bytearray(n * (PAGE + _PAGE_NUMBER_BYTES)))
    fill(descriptor, place, content)
    numbers = np.frombuffer(content[n * PAGE :], dtype=np.uint64).tolist()
    if _hash_of(place, content) != digest or max(numbers, default=0) * PAGE >= place:
        return {}
    return {number: content[k * PAGE :][:PAGE] for k, number in enumerate(numbers)}
