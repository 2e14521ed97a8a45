"""One writer for a file: a lock that ends with the process, and that no reader notices.

HDF5's own locks would keep readers out. This one lies on a byte far beyond the end of the file, so
it is nobody else's; where the system or the file system knows no such locks, there is none.
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

    def release(self) -> None:
        """Give it back; may be repeated."""
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self.descriptor)
            self.descriptor = -1
