"""Files that a case names, by content: each is read once, and goes along with what is made of it.

A case from a trajectory has the contents that lie in it. Its names are then names and no paths:
nothing is looked up on disk.

Why it is so: docs/decisions/0017.
"""

from collections.abc import Mapping
from numbers import Real
from os import PathLike
from pathlib import Path as FilePath
from typing import NamedTuple, Self


class Closing:
    """What is closed at the end of a `with` statement."""

    def close(self) -> None:
        """Let go of files."""

    def __enter__(self) -> Self:
        """Open already."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close."""
        self.close()


class File(NamedTuple):
    """Content of a file."""

    name: str
    """As messages say it; its ending tells the format."""
    data: bytes


class Files:
    """Files of one case.

    Parameters
    ----------
    folder : Path, optional
        That names are relative to; None where nothing may be looked up on disk.
    contents : mapping of str to bytes, optional
        What is known already, by the names in the case.
    allows_code : bool
        Whether code in them may be run.
    """

    def __init__(
        self,
        folder: FilePath | None = None,
        contents: Mapping[str, bytes] | None = None,
        allows_code: bool = False,
    ) -> None:
        self.folder, self.allows_code = folder, allows_code
        self.contents = dict(contents or {})

    def copied(self, allows_code: bool) -> "Files":
        """The same files; what is read from disk here later is not known there."""
        return Files(self.folder, self.contents, allows_code)

    def read(self, name: str) -> File:
        """A file by its name in the case; from disk the first time only.

        Raises
        ------
        ValueError
            If it is not there, or cannot be read.
        """
        if self.folder is None:
            if name not in self.contents:
                raise ValueError(f'there is no file "{name}" with the case')
            return File(name, self.contents[name])
        path = self.folder / name
        if name not in self.contents:
            if not is_file(path):
                raise ValueError(f'there is no file "{name}" in {self.folder.as_posix()}')
            try:
                self.contents[name] = path.read_bytes()
            except OSError as error:
                raise ValueError(f'"{name}" cannot be read: {error.strerror or error}') from None
        return File(str(path), self.contents[name])


def content(file: str | FilePath | File) -> File:
    """A file that is named by its path, read; one that is read already as it is.

    Raises
    ------
    OSError
        If it is not there, or cannot be read.
    """
    return file if isinstance(file, File) else File(str(file), FilePath(file).read_bytes())


def number_of(value: object, what: str) -> float:
    """A number that a function was given, a NumPy scalar too.

    Raises
    ------
    TypeError, ValueError
        If it is none, or too large.
    """
    if type(value) is float:  # nearly always, in a control loop: ABCs are slow to ask
        return value
    number = value.item() if hasattr(value, "item") and not getattr(value, "ndim", 0) else value
    if isinstance(number, bool) or not isinstance(number, Real):
        raise TypeError(f"{what} must be a number, got {type(value).__name__}")
    try:
        return float(number)
    except OverflowError:
        raise ValueError(f"{what} must be a number of float64, got a larger one") from None


def path_of(value: object, what: str) -> FilePath:
    """Path that a user gives.

    Raises
    ------
    TypeError
        If it is none; says what it should have been.
    """
    if not isinstance(value, (str, PathLike)):
        raise TypeError(f"{what} must be a path, got {type(value).__name__}")
    return FilePath(value)


def is_file(path: FilePath) -> bool:
    """Whether a path is a regular file that can be looked at."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def table_beside(module: str, name: str) -> list[list[str]]:
    """Cells of a table of the package in the folder of a module, below the names of its columns."""
    lines = FilePath(module).with_name(name).read_text(encoding="utf-8").splitlines()[1:]
    return [[cell.strip() for cell in line.split("|")] for line in lines]
