"""All commands: the module that runs each, its help, and its options."""

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

_BODY_FILE_HELP: Final = "a case; a table x y z m [r] of points, x y z r of spheres; STL, OBJ, PLY"

_Parser = argparse.ArgumentParser
_Option = Callable[[_Parser], object]
"""Adds an option, or several, to a command."""


# Types of values


def _names(text: str) -> list[str]:
    """Words between commas."""
    return [word for word in (part.strip() for part in text.split(",")) if word]


def _positive(text: str) -> float:
    """A positive number."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text}")
    return value


def _number(text: str, most: int | None = None) -> int:
    """A whole number from 1 on."""
    value = int(text) if text.isascii() and text.strip().isdigit() else 0
    if value < 1 or (most and value > most):
        allowed = f"between 1 and {most}" if most else "a whole number, 1 or more"
        raise argparse.ArgumentTypeError(f"must be {allowed}, got {text}")
    return value


def _frame_slice(text: str) -> slice:
    """Slice from a text as Python writes it: 10, 0:100, ::10, -1."""
    wrong = argparse.ArgumentTypeError(f"must be first:stop:stride, got {text or 'nothing'}")
    parts = [part.strip() for part in text.split(":")]
    try:
        numbers = [int(part) if part else None for part in parts]
    except ValueError:
        raise wrong from None
    if len(numbers) == 1 and numbers[0] is not None:
        return slice(numbers[0], numbers[0] + 1 or None)
    if not 2 <= len(numbers) <= 3:
        raise wrong
    if len(numbers) == 3 and numbers[2] is not None and numbers[2] < 1:
        raise argparse.ArgumentTypeError(f"must go forward, got {text}")
    return slice(*numbers)


# Options


def _option(*names: str, **how: Any) -> _Option:
    """What `add_argument` takes."""
    return lambda command: command.add_argument(*names, **how)


def _flag(*names: str, help: str) -> _Option:
    """Option without a value."""
    return _option(*names, action="store_true", help=help)


def _list(name: str, help: str) -> _Option:
    """Option of names between commas."""
    return _option(name, type=_names, default=[], metavar="A,B", help=help)


def _output(metavar: str, help: str, what: str = "an existing file") -> tuple[_Option, ...]:
    """Where to write, and whether over a file that is there."""
    overwrite = _flag("--overwrite", help=f"replace {what}")
    return _option("-o", "--output", metavar=metavar, help=help), overwrite


def _json(help: str = "machine-readable result") -> _Option:
    """--json."""
    return _flag("--json", help=help)


def _budget(seconds: float) -> _Option:
    """--budget of a study."""
    text = "time to spend on measurements, compilation aside; default: %(default)s"
    return _option("--budget", type=_positive, default=seconds, metavar="SECONDS", help=text)


def _matter(command: _Parser) -> None:
    """Add what is said of a body from a file of its own."""
    file = command.add_argument_group("for a body in a table or mesh")
    amount = file.add_mutually_exclusive_group()
    amount.add_argument("--mass", type=_positive, metavar="KG", help="mass of the body")
    density = "density of the body; default: 1"
    amount.add_argument("--density", type=_positive, metavar="KG/M3", help=density)
    file.add_argument("--scale", type=_positive, metavar="M", help="unit of length; default: 1 m")


def _format(command: _Parser) -> None:
    """Add the format of an export."""
    either = command.add_mutually_exclusive_group()
    text = "a trajectory: gsd, csv, particles, contacts, lammps, npz, h5; bodies: lammps, mjcf,"
    either.add_argument("--to", metavar="FORMAT", help=f"{text} yade, gsd")
    text = "one plain file of a run over ranks: --to h5"
    either.add_argument("--merge", dest="to", action="store_const", const="h5", help=text)


_SET: Final = _option(
    "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
    help="change a key of the case, for example run.dt=1e-4 or body.0.mass=2; repeatable",
)  # fmt: skip
_THREADS: Final = _option("--threads", type=_number, metavar="N", help="default: all cores")
_CODE: Final = _flag("--allow-code", help="let the case run Python code, with your permissions")
_MPI: Final = _flag(
    "--mpi", help="share the bodies among the ranks of mpiexec or srun: see docs/scale.md"
)
_CASE: Final = (
    _option("case", metavar="CASE", help="a TOML file, or the name of an example: see `cases`"),
    _SET, _CODE, _json(),
)  # fmt: skip
_STRICT: Final = (_THREADS, _flag("--strict", help="warnings are errors"))
_PLAN: Final = _flag(
    "--plan", help="print the whole plan: all groups and segments, and why others do not act"
)
_REPORT: Final = (
    _option(
        "--log",
        metavar="FILE",
        help="write a line each second: time, steps, energy, error, contacts, speed",
    ),
    _flag("-q", "--quiet", help="print only the checks"),
)
_METHODS: Final = _list("--methods", "default: all")
_STUDY: Final = _output("NAME", "name of the CSV, PNG and SVG files", "existing files")


# The commands


class Command(NamedTuple):
    """One command."""

    module: str
    """Of this package; its function `<name>_command` runs it. Imported when it is called."""
    help: str
    options: tuple[_Option, ...] = ()


COMMANDS: Final = {
    "run": Command("run", "run a case into an HDF5 file", (
        *_CASE, *_STRICT, _PLAN, *_output("FILE", "default: output/<case>.h5"), _MPI, *_REPORT,
    )),
    "resume": Command("run", "continue a run that was stopped", (
        _option("file", metavar="FILE", help="trajectory of the run; frames are added to it"),
        _option("--t-end", type=_positive, metavar="SECONDS",
                help="time at which to end; default: t_end of the case"),
        _CODE, _json(), *_STRICT, _MPI, *_REPORT,
    )),
    "check": Command("check", "show the plan of a case, its file size and its run time", (
        *_CASE, *_STRICT, _PLAN,
        _option("--ranks", type=_number, metavar="N",
                help="also show how N ranks of --mpi would share the bodies"),
    )),
    "sweep": Command("sweep", "run variants of a case into one table", (
        *_CASE,
        _option("--axis", dest="axes", action="append", default=[], metavar="KEY=VALUES",
                help="values of a key, as in 'run.dt=[1e-3, 1e-4]'; replaces [sweep.axes];"
                " repeatable"),
        _option("--workers", type=_number, metavar="N", help="processes; default: all cores"),
        _option("--executor", choices=("local", "mpi", "dask"), default="local",
                help="processes here, ranks (mpiexec -n N python -m particlerb sweep ..), or dask"),
        _option("--address", default="", metavar="URL", help="scheduler of a dask cluster"),
        _flag("--plot", help="also draw a picture of the table"),
        *_output("FILE.csv", "the table; rows already in it are not run again", "the table"),
    )),
    "mass": Command("bodies", "print the mass properties of bodies", (
        _option("file", metavar="FILE", help=_BODY_FILE_HELP),
        _option("body", nargs="?", metavar="BODY", help="body of a case; default: all"),
        _SET, _matter,
        _option("--spin", type=_positive, metavar="RAD/S",
                help="angular speed for which a step is recommended"),
        _json(),
    )),
    "info": Command("show", "list what a trajectory file holds", (
        _option("file", metavar="FILE", nargs="?", help="a trajectory"),
        _flag("--machine",
              help="describe this machine and what is compiled for it; takes no FILE"),
        _json("machine-readable"),
        _flag("--verify", help="check that the file is undamaged; exit 1 if not"),
    )),
    "plot": Command("show", "draw a trajectory or its contacts", (
        _option("file", metavar="FILE", help="a trajectory"),
        *_output("PICTURE", "default: FILE with .png, or _contacts.png", "an existing picture"),
        _option("--body", metavar="NAME",
                help="body whose angular velocity is drawn; default: the one that spins fastest"),
        _flag("--contacts",
              help="draw the force chains of the last frame; contacts must have been recorded"),
    )),
    "export": Command("export", "write files for other programs", (
        _option("file", metavar="FILE", help=f"a trajectory; or bodies: {_BODY_FILE_HELP}"),
        _format,
        _SET, _matter, *_output("FILE", "default: the input's name"),
        _list("--bodies", "bodies or blocks; default: all"),
        _option("--frames", type=_frame_slice, default=slice(None), metavar="A:B:C",
                help="from A to before B, every C-th; a single number is one frame; default: all"),
        _list("--fields", "default: all that were recorded; in csv those of bodies"),
    )),
    "view": Command("view", "push the bodies of a case, or play a file, in a browser", (
        _option("case", nargs="?", default="cube_at_rest", metavar="CASE|FILE",
                help="a case to push, or a trajectory file to play; default: the paper's cube"),
        _SET, _THREADS,
        _option("--port", type=partial(_number, most=65535), default=8080,
                help="default: %(default)s"),
        _option("--host", default="127.0.0.1",
                help="address to listen on; default: %(default)s, this machine only"),
        _option("--allow-host", dest="hosts", action="append", default=[], metavar="NAME",
                help="another host name of the page, for example behind a tunnel or proxy;"
                " repeatable"),
        _flag("--no-token",
              help="let in everyone who reaches the port, without the token in the address"),
        _flag("--no-browser", help="do not open a browser"),
        _option("-o", "--output", metavar="FILE",
                help="where a session is saved; default: output/<case>_session.toml"),
    )),
    "chart": Command("studies", "measure what accuracy costs, for every method", (
        *_CASE, _METHODS, _list("--peers", "other engines, as scipy,mujoco; or all"),
        _option("--error", type=_positive, metavar="RAD",
                help="error to reach; default: 1e-6, with contact the energy_drift of the case"),
        _flag("--processor-time",
              help="measure processor time, not wall time: for a busy machine"),
        *_STUDY, _budget(30.0),
    )),
    "stability": Command(
        "studies", "map where each method fails", (_METHODS, *_STUDY, _budget(240.0))
    ),
    "converge": Command("studies", "measure how many particles a body needs", (
        _option("shapes", nargs="*", metavar="SHAPE", help="default: all"),
        _option("--most", type=_number, default=1_000_000, metavar="N",
                help="largest number of particles per shape; default: 1000000"),
        *_STUDY,
    )),
    "cases": Command("lists", "list the example cases"),
    "methods": Command("lists", "list the integrators"),
    "schema": Command("lists", "print the JSON schema of a case file"),
}  # fmt: skip
