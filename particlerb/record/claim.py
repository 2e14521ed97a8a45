"""One writer for a file, with room on the disk.

HDF5's own locks would keep readers out. The lock here ends with the process and lies on a byte far
beyond the end of the file, so no reader notices it. Room is taken before HDF5 writes into it, since
HDF5 does not survive a write that fails. Where the system or the file system has no such locks, or
no such room, there is none.
"""

import contextlib
import errno
import os
import struct
from pathlib import Path

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

VERSION_0 = b"\x89HDF\r\n\x1a\n\0"  # how a superblock of version 0 begins, which h5py writes here,
SUPERBLOCK = 96  # bytes of it,
END = 40  # and where in it the end of the file stands, as a plain number
PIECE = 2**20  # bytes that are looked at together
FAR = 2**62  # byte that is locked
BUSY = (errno.EACCES, errno.EAGAIN)
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


class InUseError(OSError):
    """Another process writes the file."""


def noted_end(start: bytes, size: int) -> int:
    """End of a file as HDF5 has noted it in its first bytes; its size where it has not."""
    if len(start) < SUPERBLOCK or not start.startswith(VERSION_0):
        return size
    return int(struct.unpack_from("<Q", start, END)[0])


def is_closed(path: Path) -> bool:
    """Whether a file ends where it has noted: no writer was killed before it gave room back."""
    with path.open("rb") as file:
        size = path.stat().st_size
        return noted_end(file.read(SUPERBLOCK), size) == size


class Claim:
    """Right to write a file, until it is released or the process ends.

    Parameters
    ----------
    path : Path
        A file; an empty one is made where there is none.

    Raises
    ------
    InUseError
        If another writer has it.
    OSError
        If the file can be neither opened nor made.
    """

    def __init__(self, path: Path) -> None:
        self.descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        self.size = os.fstat(self.descriptor).st_size  # that is taken
        try:
            self.lock()
        except OSError as error:
            os.close(self.descriptor)
            if error.errno in BUSY:
                raise InUseError(
                    error.errno, "is being written by another run", str(path)
                ) from None
            raise

    def lock(self) -> None:
        """Lock the byte, for this open file: not for the process, which may read it besides."""
        command = getattr(fcntl, "F_OFD_SETLK", None)
        if command is None:
            return
        request = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, FAR, 1, 0)
        try:
            fcntl.fcntl(self.descriptor, command, request)
        except OSError as error:
            if error.errno in BUSY:
                raise
            # a file system without locks

    def reserve(self, size: int) -> None:
        """Take room on the disk, so that the file can grow to a size [bytes].

        Raises
        ------
        OSError
            With a number of FULL, if the disk, a quota or a limit has no room.
        """
        if size <= self.size or not hasattr(os, "posix_fallocate"):
            return
        try:
            os.posix_fallocate(self.descriptor, self.size, size - self.size)
        except OSError as error:
            if error.errno in FULL:
                raise
            return  # a file system that cannot
        self.size = size

    def end(self) -> int:
        """End of the file as HDF5 has noted it [bytes]."""
        start = os.pread(self.descriptor, SUPERBLOCK, 0)
        return noted_end(start, os.fstat(self.descriptor).st_size)

    def trim(self) -> None:
        """Give back what lies beyond the noted end."""
        end = self.end()
        if end < os.fstat(self.descriptor).st_size:
            os.ftruncate(self.descriptor, end)

    def lengthen(self) -> None:
        """Let a file whose last bytes could not be written reach to its noted end, or end before.

        HDF5 opens none that is shorter than noted.
        """
        size, end = os.fstat(self.descriptor).st_size, self.end()
        if size < end:
            try:
                os.ftruncate(self.descriptor, end)
            except OSError:
                with contextlib.suppress(OSError):
                    os.pwrite(self.descriptor, struct.pack("<Q", size), END)

    def mend(self, margin: int) -> None:
        """Let the noted end of a file that a kill has left lie behind what was written after it.

        A commit writes the end last. What lies beyond may belong to something, and HDF5 would give
        it away a second time; only room that was taken ahead is zero.

        Parameters
        ----------
        margin : int
            More than what is written and may be zero [bytes].
        """
        size, end = os.fstat(self.descriptor).st_size, self.end()
        used = size
        while used > end:
            start = max(used - PIECE, end)
            piece = os.pread(self.descriptor, used - start, start).rstrip(b"\0")
            used = start + len(piece)
            if piece:
                break
        if end < size:
            noted = struct.pack("<Q", min(used + PIECE + margin, size))
            os.pwrite(self.descriptor, noted, END)

    def release(self) -> None:
        """Give it back; may be repeated."""
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self.descriptor)
            self.descriptor = -1
