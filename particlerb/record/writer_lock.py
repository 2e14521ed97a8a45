"""One writer for a file.

HDF5's own locks would keep readers out. The lock here ends with the process and lies on a byte far
beyond the end of the file, so no reader notices it. Where the system or the file system has no such
locks, there is none.
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

_LOCKED_BYTE = 2**62
_BUSY_ERRORS = (errno.EACCES, errno.EAGAIN)


class InUseError(OSError):
    """Another process writes the file."""


class WriterLock:
    """The right to write a file, until the lock is closed or the process ends.

    Parameters
    ----------
    path : Path
        A file; an empty one is made where there is none.

    Attributes
    ----------
    is_exclusive : bool
        Whether no other can have it; False where there are no locks.

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
            self.is_exclusive = self.lock()
        except OSError as error:
            os.close(self.descriptor)
            raise InUseError(error.errno, "is being written by another run", str(path)) from None

    def lock(self) -> bool:
        """Lock the byte, for this open file: not for the process, which may read it besides."""
        command = getattr(fcntl, "F_OFD_SETLK", None)
        if command is None:
            return False
        request = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
        try:
            fcntl.fcntl(self.descriptor, command, request)
        except OSError as error:
            if error.errno in _BUSY_ERRORS:
                raise
            return False  # a file system without locks
        return True

    def fileno(self) -> int:
        """Descriptor of the open file."""
        return self.descriptor

    def close(self) -> None:
        """Give up the right; may be repeated."""
        if self.descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(self.descriptor)
            self.descriptor = -1
