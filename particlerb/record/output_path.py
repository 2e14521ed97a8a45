"""Where a file is written: behind all links, and never in the place of what is no regular file."""

import contextlib
import errno
import glob
import hashlib
import os
import platform
import stat
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

OVERWRITE_HINT: Final = "exists: give another name with -o, or --overwrite (overwrite=True)"
_MOST_BYTES: Final = 128  # of a name to which others are added; disks take 143 to 255


def nearest_result(path: Path) -> str:
    """Hint with the file that a run of this name wrote, if there is one."""
    folder = Path("output")
    places = (Path(f"{path}.h5"), folder / path.name, folder / f"{path.name}.h5")
    found = next(filter(os.path.isfile, places), None)  # no error where a name is too long
    return f"; did you mean {found}?" if found else ""


def output_path(path: Path, overwrite: bool) -> Path:
    """Where a file is to be written; what is made on the way to it lies in the same folder.

    Parameters
    ----------
    path : Path
        As it was named: a file, or a link that leads to one.
    overwrite : bool
        Whether it may be there, or a link to it.

    Raises
    ------
    FileExistsError
        If there is a file that may not be replaced, a folder, a device, a pipe, a socket, or a link
        that leads nowhere.
    NotADirectoryError
        If it would lie in something that is no folder.
    PermissionError
        If its folder, or the nearest one that is there, may not be written.
    OSError
        If it cannot be found out.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        if path.is_symlink() and not overwrite:
            raise FileExistsError(
                f"{path} is a link to {path.readlink()}, which is not there: give another name"
                " with -o, or --overwrite to make it"
            ) from None
    except NotADirectoryError:
        wrong = next(parent for parent in path.parents if parent.exists())
        raise NotADirectoryError(f"{path} cannot be made: {wrong} is not a folder") from None
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise FileExistsError(f"{path} is a link that leads in a circle") from None
    else:
        if stat.S_ISDIR(mode):
            raise FileExistsError(f"{path} is a folder: name a file with -o")
        if not stat.S_ISREG(mode):
            raise FileExistsError(f"{path} is not a regular file, and stays: name a file with -o")
        if not overwrite:
            raise FileExistsError(f"{path} {OVERWRITE_HINT}")
    place = Path(os.path.realpath(path))
    folder = next(parent for parent in place.parents if parent.exists())
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, "its folder may not be written", str(folder))
    return place


@contextlib.contextmanager
def appearing(*paths: Path, is_new: bool = False) -> Iterator[list[Path]]:
    """Give files to write, which become those at the paths when all are whole, on the disk.

    Until they are what was there stays. They lie beside it, behind links, and have the endings of
    the paths; what a killed process had begun is taken away. Errors as of `output_path`, and
    FileExistsError where the first is there although it `is_new`. Of several the first takes its
    name last, and what had it goes first: where it is, the others are those that belong to it.
    """
    places = [output_path(path, overwrite=True) for path in paths]
    names = [f".{_processes()}.{short_name(path)}" for path in paths]
    folders = [place.parent for place in places]
    unfinished = [at / f".{os.getpid()}{name}" for at, name in zip(folders, names, strict=True)]
    removed = list(unfinished)  # where something fails
    try:
        for folder, name in zip(folders, names, strict=True):
            folder.mkdir(parents=True, exist_ok=True)
            _remove_left(folder, name)
        yield unfinished
        for new in unfinished:
            sync(new)
        (new, first), *others = zip(unfinished, places, strict=True)
        if others:
            remove(first)
        for other, place in others:
            other.replace(place)
            removed.append(place)
            sync(place.parent)
        if is_new:
            first.touch(exist_ok=False)  # whoever else would do so now
            removed.append(first)
        new.replace(first)
    except BaseException:
        for path in removed:
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)
        raise


@cache
def _processes() -> str:
    """Digest of the machine, and of the container: elsewhere the same number is another process."""
    space = Path("/proc/self/ns/pid")
    told = f"{platform.node()} {os.readlink(space) if space.is_symlink() else ''}"
    return hashlib.sha256(told.encode()).hexdigest()[:4]


def _remove_left(folder: Path, name: str) -> None:
    """Take away what processes of here have begun under a name, and are no more."""
    for left in folder.glob(f".*{glob.escape(name)}"):
        number = left.name.removesuffix(name)[1:]
        with contextlib.suppress(PermissionError, OverflowError):
            try:
                if os.name == "posix" and number.isdecimal():
                    os.kill(int(number), 0)  # asks whether it is there
            except ProcessLookupError:
                left.unlink(missing_ok=True)


def remove(path: Path) -> None:
    """Take away a file, if there is one, behind links, for good; errors as of `output_path`."""
    place = output_path(path, overwrite=True)
    if place.exists():
        place.unlink()
        sync(place.parent)


def short_name(path: Path) -> str:
    """Name of a file, to which more can be added: of a long one a digest, with a short ending."""
    name = os.fsencode(path.name)
    if len(name) <= _MOST_BYTES:
        return path.name
    ending = path.suffix if len(os.fsencode(path.suffix)) <= _MOST_BYTES // 4 else ""
    return hashlib.sha256(name).hexdigest() + ending


def is_at(path: Path, descriptor: int) -> bool:
    """Whether a path leads to an open file."""
    return path.exists() and os.path.samestat(os.fstat(descriptor), path.stat())


def sync(path: Path) -> None:
    """Wait until the disk has a file, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        sync_open(descriptor)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        os.close(descriptor)


def sync_open(descriptor: int) -> None:
    """The same of what is open; nothing where the file system has no such call."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
