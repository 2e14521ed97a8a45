"""What all commands share: exit codes, how a command ends, how a case is found and read."""

import argparse
import contextlib
import math
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from particlerb.case.schema import Case
    from particlerb.simulation.run import Prepared

DONE: Final = 0
FAILED: Final = 1
_WRONG: Final = 2
MISSED: Final = 3
INTERRUPTED: Final = 130
PICTURES: Final = (".png", ".svg", ".pdf")
_CONTROLS: Final = dict.fromkeys((*range(32), *range(127, 160)), "�")


class Ending(Exception):  # noqa: N818
    """One message with which a command ends, and its exit code; by default wrong usage."""

    def __init__(self, message: str, code: int = _WRONG) -> None:
        super().__init__(message)
        self.code = code


def tamed(text: str) -> str:
    """Text of a file that no terminal takes for an order: lines and tabs stay."""
    return text.translate(_CONTROLS | {ord(c): c for c in "\n\t"})


@contextlib.contextmanager
def ending(*errors: type[Exception], code: int = _WRONG) -> Iterator[None]:
    """End the command with the message of an error of these kinds; by default wrong usage."""
    try:
        yield
    except errors as error:
        raise Ending(str(error), code) from None


def find_case(name: str, commands: tuple[str, ...]) -> Path:
    """Path of a case given by path or by name.

    Raises
    ------
    Ending
        If there is none; with the nearest names, those of commands among them.
    """
    from particlerb.case.named import case_path, nearest_names

    path = case_path(name)
    if path is None:
        hint = nearest_names(name, commands)
        raise Ending(f"{name}: no such command, file or case; {hint}")
    return path


def read_case(options: argparse.Namespace) -> "Case":
    """Case of a command line; ends the program with code 2 where it is wrong."""
    from particlerb.case.problems import CaseError
    from particlerb.case.reader import load

    overrides = list(options.overrides)
    if getattr(options, "threads", None) is not None:
        overrides.append(f"run.threads={options.threads}")
    with ending(CaseError):
        return load(find_case(options.case, options.commands), overrides)


def prepared_case(options: argparse.Namespace) -> "Prepared":
    """System of a case, made ready to run."""
    from particlerb.case.problems import CaseError

    case = read_case(options)
    with ending(CaseError):
        from particlerb.case.to_system import to_system
        from particlerb.simulation.accuracy import prepare_accurately

        prepared = prepare_accurately(to_system(case))
    warn(options, prepared.plan.warnings)
    return prepared


def warn(options: argparse.Namespace, warnings: Sequence[str]) -> None:
    """Print warnings; with --strict they end the program."""
    for warning in warnings:
        print(warning, file=sys.stderr)
    if warnings and options.strict:
        raise Ending("--strict: a warning is an error")


def to_write(path: Path, overwrite: bool, source: Path | None = None) -> Path:
    """Place of a file to write, behind links; wrong usage where it may not be written."""
    from particlerb.record.output_path import output_path

    if source is not None and os.path.realpath(path) == os.path.realpath(source):
        raise Ending(f"{path} is the input: give another name with -o")
    try:
        return output_path(path, overwrite)
    except (FileExistsError, NotADirectoryError) as error:
        raise Ending(str(error)) from None
    except OSError as error:
        raise Ending(f"{path} cannot be made: {error.strerror}") from None


def opened(path: str) -> Any:
    """Trajectory in a file; wrong usage where it is none."""
    from particlerb.record.trajectory import TrajectoryError, open_trajectory

    with ending(TrajectoryError, FileNotFoundError, IsADirectoryError):
        return open_trajectory(path)


def readable() -> contextlib.AbstractContextManager[None]:
    """End the command with one message where a trajectory turns out to be damaged."""
    from particlerb.record.checked_reading import TrajectoryError

    return ending(TrajectoryError, code=FAILED)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """End the command where an export is not possible, or its file cannot be written."""
    from particlerb.export import ExportError

    with ending(ExportError):
        try:
            yield
        except OSError as error:
            raise Ending(f"cannot write {path}: {error.strerror or error}", FAILED) from None


def amount(size: float) -> str:
    """Number of bytes in words."""
    power = int(min(max(math.log10(max(size, 1.0)) // 3, 1), 4))
    return f"{size / 1000.0**power:.3g} {('', 'kB', 'MB', 'GB', 'TB')[power]}"
