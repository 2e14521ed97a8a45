"""How a command ends: exit codes, and the one message of what went wrong. Imports nothing heavy."""

import contextlib
import errno
import os
from collections.abc import Iterator
from typing import Final

DONE: Final = 0
FAILED: Final = 1
_WRONG_INPUT: Final = 2
MISSED: Final = 3
INTERRUPTED: Final = 130
_DISK_FULL_ERRORS: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_CONTROL_CHARACTERS: Final = dict.fromkeys((*range(32), *range(127, 160)), "�")


class Ending(Exception):  # noqa: N818
    """One message with which a command ends, and its exit code; by default wrong usage."""

    def __init__(self, message: str, code: int = _WRONG_INPUT) -> None:
        super().__init__(message)
        self.code = code


def code_of(error: OSError) -> int:
    """Exit code of what cannot be written: a disk that fails is not wrong usage."""
    return FAILED if error.errno in _DISK_FULL_ERRORS else _WRONG_INPUT


@contextlib.contextmanager
def ending(*errors: type[Exception], code: int = _WRONG_INPUT, about: str = "") -> Iterator[None]:
    """End the command with the message of an error, after what it is about."""
    try:
        yield
    except errors as error:
        raise Ending(f"{about}: {error}" if about else str(error), code) from None


def tamed(text: str) -> str:
    """Text of a file that no terminal takes for an order: lines and tabs stay."""
    return text.translate(_CONTROL_CHARACTERS | {ord(c): c for c in "\n\t"})


def code_of_fault(error: OSError) -> int:
    """Exit code of what the system refused: a name too long for it is wrong usage."""
    return _WRONG_INPUT if error.errno == errno.ENAMETOOLONG else FAILED


def fault_text(error: OSError) -> str:
    """What the system refused, and where: it names neither stdout nor the current folder."""
    reason = error.strerror or str(error)
    if error.filename is not None:
        return f"{error.filename}: {reason}"
    try:
        os.getcwd()
    except OSError:
        return "the current folder is gone: change to one that is there"
    if error.errno in _DISK_FULL_ERRORS:
        try:
            print(flush=True)
        except OSError:
            return f"stdout cannot be written: {reason}"
    return f"a file cannot be read or written: {reason}"
