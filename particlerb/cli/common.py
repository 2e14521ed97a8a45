"""What all commands share: exit codes, how a command ends, how a case is found and read."""

import argparse
import contextlib
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from particlerb.case.schema import Case
    from particlerb.simulation.run import Prepared

DONE: Final = 0
FAILED: Final = 1
WRONG: Final = 2
MISSED: Final = 3
INTERRUPTED: Final = 130
NAMES: Final = (
    "run",
    "resume",
    "check",
    "mass",
    "info",
    "plot",
    "export",
    "view",
    "chart",
    "stability",
    "converge",
    "cases",
    "methods",
    "schema",
)
PICTURES: Final = (".png", ".svg", ".pdf")
CONTROLS: Final = dict.fromkeys((*range(32), *range(127, 160)), "�")


class Ending(Exception):  # noqa: N818
    """One message with which a command ends, and its exit code; by default wrong usage."""

    def __init__(self, message: str, code: int = WRONG) -> None:
        super().__init__(message)
        self.code = code


def tamed(text: str) -> str:
    """Text of a file that no terminal takes for an order: lines and tabs stay."""
    return text.translate(CONTROLS | {ord(c): c for c in "\n\t"})


def find_case(name: str) -> Path:
    """Path of a case given by path or by name.

    Raises
    ------
    Ending
        If there is none; with the nearest names.
    """
    from particlerb.case.named import case_path, nearest_names

    path = case_path(name)
    if path is None:
        hint = nearest_names(name, NAMES)
        raise Ending(f"{name}: no such command, file or case; {hint}")
    return path


def read_case(options: argparse.Namespace) -> "Case":
    """Case of a command line; ends the program with code 2 where it is wrong."""
    from particlerb.case.problems import CaseError
    from particlerb.case.reader import load

    overrides = list(options.overrides)
    if getattr(options, "threads", None) is not None:
        overrides.append(f"run.threads={options.threads}")
    try:
        return load(find_case(options.case), overrides)
    except CaseError as error:
        raise Ending(str(error)) from None


def prepared_case(options: argparse.Namespace) -> "Prepared":
    """Case made ready to run."""
    from particlerb.case.problems import CaseError

    case = read_case(options)
    try:
        from particlerb.simulation.accuracy import prepare_accurately

        prepared = prepare_accurately(case)
    except CaseError as error:
        raise Ending(str(error)) from None
    warn(options, list(prepared.plan.warnings))
    return prepared


def warn(options: argparse.Namespace, warnings: list[str]) -> None:
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

    try:
        return open_trajectory(path)
    except (TrajectoryError, FileNotFoundError, IsADirectoryError) as error:
        raise Ending(str(error)) from None


@contextlib.contextmanager
def readable() -> Iterator[None]:
    """End the command with one message where a trajectory turns out to be damaged."""
    from particlerb.record.checked_reading import TrajectoryError

    try:
        yield
    except TrajectoryError as error:
        raise Ending(str(error), FAILED) from None


def amount(size: float) -> str:
    """Number of bytes in words."""
    power = int(min(max(math.log10(max(size, 1.0)) // 3, 1), 4))
    return f"{size / 1000.0**power:.3g} {('', 'kB', 'MB', 'GB', 'TB')[power]}"
