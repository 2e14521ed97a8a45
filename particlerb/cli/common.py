"""What several commands do: find and read a case, open a trajectory, name a file to write."""

import argparse
import contextlib
import math
import os
import shutil
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from particlerb.case.case_names import case_path, nearest_names
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.schema import Case
from particlerb.cli.exit_codes import FAILED, Ending, code_of, ending
from particlerb.cli.guard import probe
from particlerb.record.output_path import output_path
from particlerb.record.trajectory import Trajectory, TrajectoryError, open_trajectory
from particlerb.record.verify import verify
from particlerb.record.writer_lock import WriterLock

PICTURES: Final = (".png", ".svg", ".pdf")
_FAULTS_OF_VALUES: Final = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


def fitted(plan: str) -> str:
    """A plan whose lines go on below their second column where a terminal is narrower."""
    if not (plan and sys.stdout.isatty()):
        return plan
    width = shutil.get_terminal_size().columns
    column = min(len(plan) - len(plan.split(maxsplit=1)[-1]), width // 2)
    lines = textwrap.TextWrapper(
        width, subsequent_indent=" " * column, break_long_words=False, break_on_hyphens=False
    )
    return "\n".join(map(lines.fill, plan.split("\n")))


def find_case(name: str, commands: tuple[str, ...] = ()) -> Path:
    """Path of a case given by path or by name.

    Raises
    ------
    Ending
        If there is none; with the nearest names, those of commands among them.
    """
    path = case_path(name)
    if path is None:
        if name == "-":
            raise Ending("a case is read from a file, not from standard input: give its path")
        what = "command, file or case" if commands else "file or case"
        raise Ending(f"{name}: no such {what}; {nearest_names(name, commands)}")
    return path


def read_case(options: argparse.Namespace) -> Case:
    """Case of a command line; ends the program with code 2 where it is wrong."""
    overrides = list(options.overrides)
    if getattr(options, "threads", None) is not None:
        overrides.append(f"run.threads={options.threads}")
    with ending(CaseError):
        allow_code = getattr(options, "allow_code", False)
        return load(find_case(options.case), overrides, allow_code)


def to_write(path: Path, overwrite: bool, source: Path | None = None) -> Path:
    """Place of a file to write, behind links; wrong usage where it may not be written."""
    if source is not None and os.path.realpath(path) == os.path.realpath(source):
        raise Ending(f"{path} is the input: give another name with -o")
    try:
        return output_path(path, overwrite)
    except (FileExistsError, NotADirectoryError) as error:
        raise Ending(str(error)) from None
    except OSError as error:
        raise Ending(f"{path} cannot be made: {error.strerror}", code_of(error)) from None


def named_output(options: argparse.Namespace, default: Path) -> Path:
    """File that -o names, else the default; a new name without a suffix gets its own."""
    path = Path(options.output or default)
    is_new = bool(path.name) and not os.path.lexists(path)
    return path.with_suffix(default.suffix) if is_new and not path.suffix else path


def output_of(options: argparse.Namespace, default: Path, source: Path | None = None) -> Path:
    """The same, where it may be written."""
    path = named_output(options, default)
    to_write(path, options.overwrite, source)
    return path


@contextlib.contextmanager
def opened(path: str, visits_parts: bool = False) -> Iterator[Trajectory]:
    """Trajectory in a file, open: wrong usage where it is none, one message where it is damaged.

    What its values lead to is their fault only where the file is not whole.
    """
    if (case := case_path(path)) is not None and case.suffix == ".toml":
        result = Path("output") / f"{case.stem}.h5"
        missing = "" if result.is_file() else "run it, and "
        raise Ending(f"{path} is a case, not a trajectory: {missing}give {result}")
    probe(Path(path), visits_parts)
    with ending(TrajectoryError, FileNotFoundError, IsADirectoryError):
        trajectory = open_trajectory(path)
    with trajectory, ending(TrajectoryError, code=FAILED):
        try:
            yield trajectory
        except _FAULTS_OF_VALUES:
            flaws = [one for one in verify(trajectory) if not one.is_whole]
            if not flaws:
                raise
            told = f"{path} is damaged: {flaws[0].what} {flaws[0].words}"
            raise Ending(told, FAILED) from None


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """End the command where the file of a path cannot be written, or a run writes it now."""
    try:
        if path.is_file() and os.access(path, os.W_OK):
            WriterLock(path).close()
        yield
    except OSError as error:
        raise Ending(f"cannot write {path}: {error.strerror or error}", FAILED) from None


def amount(size: float) -> str:
    """Number of bytes in words."""
    power = int(min(max(math.log10(max(size, 1.0)) // 3, 1), 4))
    return f"{size / 1000.0**power:.3g} {('', 'kB', 'MB', 'GB', 'TB')[power]}"


def wall_time(seconds: float) -> str:
    """A wall time in words."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"
