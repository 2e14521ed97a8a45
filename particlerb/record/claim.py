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

FAR = 2**62  # byte that is locked
BUSY = (errno.EACCES, errno.EAGAIN)
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


class InUseError(OSError):
    """Another process writes the file."""


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

    def trim(self, size: int) -> None:
        """Give back what lies beyond a size [bytes]."""
        if size < os.fstat(self.descriptor).st_size:
            os.ftruncate(self.descriptor, size)

    def release(self) -> None:
        """Give it back; may be repeated."""
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self.descriptor)
            self.descriptor = -1
