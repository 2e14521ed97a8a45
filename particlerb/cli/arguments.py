"""Options of all commands: each `add_…` adds what one command takes, or several."""

import argparse
from typing import Final

_BODY_FILE: Final = "a case; a table x y z m [r] of points, x y z r of spheres; STL, OBJ, PLY"

_Parser = argparse.ArgumentParser


# Types of values


def names(text: str) -> list[str]:
    """Words between commas."""
    return [word for word in (part.strip() for part in text.split(",")) if word]


def positive(text: str) -> float:
    """A positive number."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text}")
    return value


def _number(text: str) -> int:
    """A whole number from 1 on."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, got {text}")
    return value


def port(text: str) -> int:
    """A port."""
    value = int(text)
    if not 1 <= value <= 65535:
        raise argparse.ArgumentTypeError(f"must be between 1 and 65535, got {text}")
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


# What several commands take


def _add_flag(command: _Parser, *names: str, help: str) -> None:
    """Add an option without a value."""
    command.add_argument(*names, action="store_true", help=help)


def _add_list(command: _Parser, name: str, help: str) -> None:
    """Add an option of names between commas."""
    command.add_argument(name, type=names, default=[], metavar="A,B", help=help)


def _add_json(command: _Parser, help: str = "machine-readable result") -> None:
    """Add --json."""
    _add_flag(command, "--json", help=help)


def _add_output(command: _Parser, metavar: str, help: str, what: str = "an existing file") -> None:
    """Add where to write, and whether over a file that is there."""
    command.add_argument("-o", "--output", metavar=metavar, help=help)
    _add_flag(command, "--overwrite", help=f"replace {what}")


def _add_report(command: _Parser) -> None:
    """Add what is said of a run on its way."""
    command.add_argument(
        "--log", metavar="FILE", help="write a line each second: time, energy, error"
    )
    _add_flag(command, "-q", "--quiet", help="print only the checks")


def _add_overrides(command: _Parser) -> None:
    """Add the option that changes a case."""
    command.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE",
        help="change a key of the case, for example run.dt=1e-4 or body.0.mass=2; repeatable",
    )  # fmt: skip


def _add_threads(command: _Parser) -> None:
    """Add --threads."""
    command.add_argument("--threads", type=int, metavar="N", help="default: all cores")


def _add_code(command: _Parser) -> None:
    """Add --allow-code."""
    _add_flag(
        command, "--allow-code", help="allow the case to run Python code, with your permissions"
    )


def _add_mpi(command: _Parser) -> None:
    """Add --mpi."""
    words = "share the bodies among the ranks of mpiexec or srun: see docs/scale.md"
    _add_flag(command, "--mpi", help=words)


def _add_case(command: _Parser) -> None:
    """Add options of all commands that read a case."""
    command.add_argument("case", metavar="CASE")
    _add_overrides(command)
    _add_code(command)
    _add_json(command)


def _add_plan(command: _Parser) -> None:
    """Add options of the commands that make a plan."""
    _add_threads(command)
    _add_flag(command, "--strict", help="warnings are errors")


def _add_matter(command: _Parser) -> None:
    """Add options of the commands that read bodies: of a case, or one from a file of its own."""
    _add_overrides(command)
    file = command.add_argument_group("for a body in a table or mesh")
    amount = file.add_mutually_exclusive_group()
    amount.add_argument("--mass", type=positive, metavar="KG", help="mass of the body")
    amount.add_argument(
        "--density", type=positive, metavar="KG/M3", help="density of the body; default: 1"
    )
    file.add_argument("--scale", type=positive, metavar="M", help="unit of length; default: 1 m")


def _add_study(command: _Parser, budget: float | None = None) -> None:
    """Add options of all studies."""
    _add_output(command, "NAME", "name of the CSV, PNG and SVG files", "existing files")
    if budget is not None:
        command.add_argument(
            "--budget", type=positive, default=budget, metavar="SECONDS",
            help="time to spend on measurements, compilation aside; default: %(default)s",
        )  # fmt: skip


# The commands


def add_none(command: _Parser) -> None:
    """Add nothing."""


def add_run(run: _Parser) -> None:
    """Add options of `run`."""
    _add_case(run)
    _add_plan(run)
    _add_output(run, "FILE", "default: output/<case>.h5")
    _add_mpi(run)
    _add_report(run)


def add_resume(resume: _Parser) -> None:
    """Add options of `resume`."""
    resume.add_argument(
        "file", metavar="FILE", help="trajectory of the run; frames are added to it"
    )
    resume.add_argument(
        "--t-end",
        type=positive,
        metavar="SECONDS",
        help="time at which to end; default: t_end of the case",
    )
    _add_code(resume)
    _add_json(resume)
    _add_plan(resume)
    _add_mpi(resume)
    _add_report(resume)


def add_check(check: _Parser) -> None:
    """Add options of `check`."""
    _add_case(check)
    _add_plan(check)
    check.add_argument(
        "--ranks",
        type=_number,
        metavar="N",
        help="also show how N ranks of --mpi would share the bodies",
    )


def add_mass(mass: _Parser) -> None:
    """Add options of `mass`."""
    mass.add_argument("file", metavar="FILE", help=_BODY_FILE)
    mass.add_argument("body", nargs="?", metavar="BODY", help="body of a case; default: all")
    _add_matter(mass)
    mass.add_argument(
        "--spin",
        type=positive,
        metavar="RAD/S",
        help="angular speed for which a step is recommended",
    )
    _add_json(mass)


def add_info(info: _Parser) -> None:
    """Add options of `info`."""
    info.add_argument("file", metavar="FILE", nargs="?")
    _add_flag(
        info, "--machine", help="describe this machine and what is compiled for it; takes no FILE"
    )
    _add_json(info, "machine-readable")
    _add_flag(info, "--verify", help="check that the file is undamaged; exit 1 if not")


def add_plot(plot: _Parser) -> None:
    """Add options of `plot`."""
    plot.add_argument("file", metavar="FILE")
    _add_output(plot, "PICTURE", "default: FILE with .png", "an existing picture")
    plot.add_argument(
        "--body",
        metavar="NAME",
        help="body whose angular velocity is drawn; default: the one that spins fastest",
    )
    _add_flag(
        plot,
        "--contacts",
        help="draw the force chains of the last frame; contacts must have been recorded",
    )


def add_export(export: _Parser) -> None:
    """Add options of `export`."""
    export.add_argument("file", metavar="FILE", help=f"a trajectory; or bodies: {_BODY_FILE}")
    export.add_argument(
        "--to", required=True, metavar="FORMAT",
        help="a trajectory: gsd, csv, particles, contacts, lammps, npz, h5; bodies: lammps, mjcf,"
        " yade, gsd",
    )  # fmt: skip
    _add_matter(export)
    _add_output(export, "FILE", "default: the input's name")
    _add_list(export, "--bodies", "bodies or blocks; default: all")
    export.add_argument(
        "--frames", type=_frame_slice, default=slice(None), metavar="A:B:C",
        help="from A to before B, every C-th; a single number is one frame; default: all",
    )  # fmt: skip
    _add_list(export, "--fields", "default: all that were recorded; in csv those of bodies")


def add_view(view: _Parser) -> None:
    """Add options of `view`."""
    view.add_argument(
        "case", nargs="?", default="cube_at_rest", metavar="CASE|FILE",
        help="a case to push, or a trajectory file to play; default: the paper's cube",
    )  # fmt: skip
    _add_overrides(view)
    _add_threads(view)
    view.add_argument("--port", type=port, default=8080, help="default: %(default)s")
    view.add_argument(
        "--host", default="127.0.0.1",
        help="address to listen on; default: %(default)s, this machine only",
    )  # fmt: skip
    view.add_argument(
        "--allow-host", dest="hosts", action="append", default=[], metavar="NAME",
        help="another host name of the page, for example behind a tunnel or proxy; repeatable",
    )  # fmt: skip
    no_token = "let in everyone who reaches the port, without the token in the address"
    _add_flag(view, "--no-token", help=no_token)
    _add_flag(view, "--no-browser", help="do not open a browser")
    saved = "where a session is saved; default: output/<case>_session.toml"
    view.add_argument("-o", "--output", metavar="FILE", help=saved)


def add_chart(chart: _Parser) -> None:
    """Add options of `chart`."""
    _add_case(chart)
    _add_list(chart, "--methods", "default: all")
    _add_list(chart, "--peers", "engines, or all")
    chart.add_argument(
        "--error", type=positive, metavar="RAD",
        help="error to reach; default: 1e-6, with contact the energy_drift of the case",
    )  # fmt: skip
    _add_flag(
        chart, "--processor-time", help="measure processor time, not wall time: for a busy machine"
    )
    _add_study(chart, 30.0)


def add_sweep(sweep: _Parser) -> None:
    """Add options of `sweep`."""
    _add_case(sweep)
    sweep.add_argument(
        "--axis", dest="axes", action="append", default=[], metavar="KEY=VALUES",
        help="values of a key, as in 'run.dt=[1e-3, 1e-4]'; replaces [sweep.axes]; repeatable",
    )  # fmt: skip
    sweep.add_argument("--workers", type=int, metavar="N", help="processes; default: all cores")
    sweep.add_argument(
        "--executor", choices=("local", "mpi", "dask"), default="local",
        help="processes here, ranks (mpiexec -n N python -m particlerb sweep ..), or dask",
    )  # fmt: skip
    sweep.add_argument("--address", default="", metavar="URL", help="scheduler of a dask cluster")
    _add_flag(sweep, "--plot", help="also draw a picture of the table")
    _add_output(sweep, "FILE.csv", "the table; rows already in it are not run again", "the table")


def add_stability(stability: _Parser) -> None:
    """Add options of `stability`."""
    _add_list(stability, "--methods", "default: all")
    _add_study(stability, 240.0)


def add_converge(converge: _Parser) -> None:
    """Add options of `converge`."""
    converge.add_argument("shapes", nargs="*", metavar="SHAPE", help="default: all")
    converge.add_argument(
        "--most",
        type=int,
        default=1_000_000,
        metavar="N",
        help="largest number of particles per shape",
    )
    _add_study(converge)
