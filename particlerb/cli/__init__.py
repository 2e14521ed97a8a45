"""Arguments, messages, exit codes, progress; no physics.

Results go to stdout, progress and messages to stderr. Heavy libraries are imported only by the
commands that use them, so that `--help` answers at once.

Exit codes: 0 done; 1 the run failed; 2 wrong usage or case; 3 a [check] was missed;
130 interrupted, by Ctrl-C or SIGTERM, with the frames so far kept.
"""

import argparse
import io
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from typing import Final, NoReturn, TextIO

import particlerb
from particlerb.cli.common import DONE, FAILED, INTERRUPTED, Ending, tamed
from particlerb.cli.export import export_command, frame_slice
from particlerb.cli.guard import guarded, wants_guard
from particlerb.cli.mass import mass_command
from particlerb.cli.run import check_command, resume_command, run_command
from particlerb.cli.show import (
    cases_command,
    info_command,
    methods_command,
    plot_command,
    schema_command,
)
from particlerb.cli.studies import chart_command, converge_command, stability_command
from particlerb.cli.view import add_view, view_command

EPILOG = """\
CASE is a TOML file, or the name of one in ./cases or among the examples (`cases` lists them).
`python -m particlerb CASE` is short for `run CASE`.
exit codes: 0 done, 1 the run failed, 2 wrong usage or case, 3 a [check] was missed, 130 interrupted
"""
BODY_FILE: Final = "a case; a table x y z m [r] of points, x y z r of spheres; STL, OBJ, PLY"


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = argparse.ArgumentParser(
        prog="python -m particlerb",
        description="Many rigid bodies built from mass particles.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"particlerb {particlerb.__version__}")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", required=True)

    run = commands.add_parser("run", help="run a case into an HDF5 file")
    add_case(run)
    add_plan(run)
    run.add_argument("-o", "--output", metavar="FILE", help="default: output/<case>.h5")
    run.add_argument("--overwrite", action="store_true", help="replace an existing file")
    run.add_argument("-q", "--quiet", action="store_true", help="print the checks only")

    resume = commands.add_parser(
        "resume", help="go on with a run that was stopped, or to a later end"
    )
    resume.add_argument("file", metavar="FILE", help="of the run; it grows")
    resume.add_argument(
        "--t-end", type=positive, metavar="SECONDS", help="where to end; default: as its case says"
    )
    resume.add_argument("--json", action="store_true", help="machine-readable result")
    add_plan(resume)
    resume.add_argument("-q", "--quiet", action="store_true", help="print the checks only")

    check = commands.add_parser("check", help="read a case and print its plan, without a run")
    add_case(check)
    add_plan(check)

    mass = commands.add_parser("mass", help="mass, com, inertia tensor, principal axes of bodies")
    mass.add_argument("file", metavar="FILE", help=BODY_FILE)
    mass.add_argument("body", nargs="?", metavar="BODY", help="of a case; default: all")
    add_matter(mass)
    mass.add_argument("--spin", type=positive, metavar="RAD/S", help="to advise a step for")
    mass.add_argument("--json", action="store_true", help="machine-readable result")

    info = commands.add_parser("info", help="what a trajectory file holds")
    info.add_argument("file", metavar="FILE")
    info.add_argument("--json", action="store_true", help="machine-readable")
    info.add_argument("--verify", action="store_true", help="whether it is whole; exit 1 if not")

    plot = commands.add_parser("plot", help="picture of a trajectory: ways, rates, drifts")
    plot.add_argument("file", metavar="FILE")
    plot.add_argument("-o", "--output", metavar="PICTURE", help="default: FILE with .png")
    plot.add_argument(
        "--body", metavar="NAME", help="body whose rates are drawn; default: the fastest to spin"
    )
    plot.add_argument(
        "--contacts", action="store_true", help="force chains in the last frame, if it has contacts"
    )
    plot.add_argument("--overwrite", action="store_true", help="replace an existing picture")

    add_export(commands)
    add_view(commands.add_parser("view", help="push a case, or play a file, in the browser"))

    add_studies(commands)

    commands.add_parser("cases", help="list the example cases")
    commands.add_parser("methods", help="list the integrators")
    commands.add_parser("schema", help="JSON schema of a case file, for editors")
    return top


def add_export(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """The command that writes files of other programs."""
    export = commands.add_parser("export", help="a trajectory, or bodies, for other programs")
    export.add_argument("file", metavar="FILE", help=f"a trajectory; or bodies: {BODY_FILE}")
    export.add_argument(
        "--to", required=True, metavar="FORMAT",
        help="a trajectory: gsd, csv, particles, lammps, npz; bodies: lammps, mjcf, yade, gsd",
    )  # fmt: skip
    add_matter(export)
    export.add_argument("-o", "--output", metavar="FILE", help="default: the input's name")
    export.add_argument("--overwrite", action="store_true", help="replace an existing file")
    export.add_argument(
        "--bodies", type=names, default=[], metavar="A,B", help="bodies or blocks; default: all"
    )
    export.add_argument(
        "--frames", type=frame_slice, default=slice(None), metavar="A:B:C",
        help="from A before B, every C-th; a number alone is one frame; default: all",
    )  # fmt: skip
    export.add_argument(
        "--fields",
        type=names,
        default=[],
        metavar="A,B",
        help="default: all recorded, in csv of bodies",
    )


def add_studies(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Commands of the studies."""
    chart = commands.add_parser("chart", help="what accuracy costs: every method on a case")
    add_case(chart)
    chart.add_argument("--methods", type=names, default=[], metavar="A,B", help="default: all")
    chart.add_argument("--peers", type=names, default=[], metavar="A,B", help="engines, or all")
    chart.add_argument(
        "--error",
        type=positive,
        metavar="RAD",
        help="error to advise for; default: 1e-6, "
        "for contact the energy_drift that the case allows",
    )
    add_study(chart, 30.0)

    stability = commands.add_parser("stability", help="where each method fails: maps and limits")
    stability.add_argument("--methods", type=names, default=[], metavar="A,B", help="default: all")
    add_study(stability, 240.0)

    converge = commands.add_parser("converge", help="summed inertia tensors beside analytic ones")
    converge.add_argument("shapes", nargs="*", metavar="SHAPE", help="default: all")
    converge.add_argument(
        "--most", type=int, default=1_000_000, metavar="N", help="particles of a shape at most"
    )
    add_study(converge, None)


def add_study(command: argparse.ArgumentParser, budget: float | None) -> None:
    """Options of all studies."""
    command.add_argument("-o", "--output", metavar="NAME", help="of the CSV, PNG and SVG files")
    command.add_argument("--overwrite", action="store_true", help="replace existing files")
    if budget is not None:
        command.add_argument(
            "--budget", type=positive, default=budget, metavar="SECONDS",
            help="to measure for, without compilation; default: %(default)s",
        )  # fmt: skip


def names(text: str) -> list[str]:
    """Words between commas."""
    return [word for word in (part.strip() for part in text.split(",")) if word]


def positive(text: str) -> float:
    """A positive number."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text}")
    return value


def add_case(command: argparse.ArgumentParser) -> None:
    """Options of all commands that read a case."""
    command.add_argument("case", metavar="CASE")
    add_overrides(command)
    command.add_argument("--json", action="store_true", help="machine-readable result")


def add_overrides(command: argparse.ArgumentParser) -> None:
    """Option that changes a case."""
    command.add_argument(
        "--set",
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a key of the case, as run.dt=1e-4 or body.0.mass=2; repeatable",
    )


def add_matter(command: argparse.ArgumentParser) -> None:
    """Options of the commands that read bodies: of a case, or one from a file of its own."""
    add_overrides(command)
    file = command.add_argument_group("of a body in a table or mesh, which is no case")
    amount = file.add_mutually_exclusive_group()
    amount.add_argument("--mass", type=positive, metavar="KG", help="of the body")
    amount.add_argument(
        "--density", type=positive, metavar="KG/M3", help="of its matter; default: 1"
    )
    file.add_argument("--scale", type=positive, metavar="M", help="unit of length; default: 1 m")


def add_plan(command: argparse.ArgumentParser) -> None:
    """Options of the commands that make a plan."""
    command.add_argument("--threads", type=int, metavar="N", help="default: all cores")
    command.add_argument("--strict", action="store_true", help="warnings are errors")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks Σ shows ? and goes on
            stream.reconfigure(errors="replace")
    top = parser()
    if words and words[0] not in (*COMMANDS, "-h", "--help", "--version"):
        words.insert(0, "run")
    try:
        options = top.parse_args(words)
        return COMMANDS[options.command](options)
    except Ending as error:
        return complain(str(error), error.code)
    except KeyboardInterrupt:
        return complain("interrupted", INTERRUPTED)
    except BrokenPipeError:  # the reader of stdout went away, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except MemoryError:
        return complain("out of memory: fewer bodies or particles would fit", FAILED)
    except OSError as error:
        return complain(str(error), FAILED)


def entry() -> NoReturn:
    """Run the command of this process and end it; SIGTERM ends it as Ctrl-C does."""
    warnings.showwarning = show_warning
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    if wants_guard(sys.argv[1:]):
        sys.exit(guarded(sys.argv[1:]))
    sys.exit(main())


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning as all other messages are, without its place in the sources."""
    del category, filename, lineno, file, line
    print(f"particlerb: warning: {message}", file=sys.stderr)


def complain(message: str, code: int) -> int:
    """Print a message to stderr."""
    text = message if ": error:" in message else f"particlerb: {message}"
    print(tamed(text), file=sys.stderr)
    return code


COMMANDS: Final[dict[str, Callable[[argparse.Namespace], int]]] = {
    "run": run_command,
    "resume": resume_command,
    "check": check_command,
    "mass": mass_command,
    "info": info_command,
    "plot": plot_command,
    "export": export_command,
    "view": view_command,
    "chart": chart_command,
    "stability": stability_command,
    "converge": converge_command,
    "cases": cases_command,
    "methods": methods_command,
    "schema": schema_command,
}
