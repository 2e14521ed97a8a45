"""Arguments, messages, exit codes, progress; no physics.

Results go to stdout, progress and messages to stderr. Heavy libraries are imported only by the
commands that use them, so that `--help` answers at once.

Exit codes: 0 done; 1 the run failed; 2 wrong usage or case; 3 a [check] was missed;
130 interrupted, with the frames so far kept.
"""

import argparse
import contextlib
import difflib
import io
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import particlerb

if TYPE_CHECKING:
    from particlerb.case.schema import Case
    from particlerb.checks import Result
    from particlerb.simulate import Outcome, Prepared

DONE, FAILED, WRONG, MISSED, INTERRUPTED = 0, 1, 2, 3, 130
PICTURES = (".png", ".svg", ".pdf")
PLOTTED = ("position", "orientation", "linear_momentum", "angular_momentum")
EPILOG = """\
CASE is a TOML file, or the name of one in ./cases or among the examples (`cases` lists them).
`python -m particlerb CASE` is short for `run CASE`.
exit codes: 0 done, 1 the run failed, 2 wrong usage or case, 3 a [check] was missed, 130 interrupted
"""


class Ending(Exception):  # noqa: N818
    """One message with which a command ends, and its exit code; by default wrong usage."""

    def __init__(self, message: str, code: int = WRONG) -> None:
        super().__init__(message)
        self.code = code


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

    check = commands.add_parser("check", help="read a case and print its plan, without a run")
    add_case(check)
    add_plan(check)

    mass = commands.add_parser("mass", help="mass, com, inertia tensor, principal axes of bodies")
    add_case(mass)
    mass.add_argument("body", nargs="?", metavar="BODY", help="name of one body; default: all")

    info = commands.add_parser("info", help="what a trajectory file holds")
    info.add_argument("file", metavar="FILE")
    info.add_argument("--json", action="store_true", help="machine-readable")

    plot = commands.add_parser("plot", help="picture of a trajectory: ways, rates, drifts")
    plot.add_argument("file", metavar="FILE")
    plot.add_argument("-o", "--output", metavar="PICTURE", help="default: FILE with .png")
    plot.add_argument(
        "--body", metavar="NAME", help="body whose rates are drawn; default: the fastest to spin"
    )
    plot.add_argument("--overwrite", action="store_true", help="replace an existing picture")

    commands.add_parser("cases", help="list the example cases")
    commands.add_parser("methods", help="list the integrators")
    commands.add_parser("schema", help="JSON schema of a case file, for editors")
    return top


def add_case(command: argparse.ArgumentParser) -> None:
    """Options of all commands that read a case."""
    command.add_argument("case", metavar="CASE")
    command.add_argument(
        "--set",
        dest="overrides",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a key of the case, as run.dt=1e-4 or body.0.mass=2; repeatable",
    )
    command.add_argument("--json", action="store_true", help="machine-readable result")


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
    """Run the command of this process and end it."""
    code = main()
    writer = sys.modules.get("particlerb.record.writer")
    if writer is not None and writer.Recorder.broken:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)  # HDF5 does not survive a failed write: it would crash on the way out
    sys.exit(code)


def complain(message: str, code: int) -> int:
    """Print a message to stderr."""
    text = message if ": error:" in message else f"particlerb: {message}"
    print(text, file=sys.stderr)
    return code


def example_folders() -> list[Path]:
    """Where cases are looked for by name: here, then the repository's, then the installed ones."""
    package = Path(particlerb.__file__).parent
    return [Path("cases"), package.parent / "cases", package / "_cases"]


def find_case(name: str) -> Path:
    """Path of a case given by path or by name.

    Raises
    ------
    Ending
        If there is none; with the nearest names.
    """
    if Path(name).suffix or os.sep in name or Path(name).exists():
        return Path(name)
    for folder in example_folders():
        if (folder / f"{name}.toml").is_file():
            return folder / f"{name}.toml"
    known = sorted({path.stem for folder in example_folders() for path in folder.glob("*.toml")})
    near = difflib.get_close_matches(name, [*known, *COMMANDS], 3)
    hint = f"did you mean {' or '.join(near)}?" if near else "`cases` lists the examples"
    raise Ending(f"{name}: no such command, file or case; {hint}")


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
        from particlerb.simulate import prepare

        prepared = prepare(case)
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


def run_command(options: argparse.Namespace) -> int:
    """`run`: the plan, the run, the checks."""
    prepared = prepared_case(options)
    path = output_path(options, prepared.case)
    warn(options, disk_warnings(prepared.case, path))
    if not (options.quiet or options.json):
        title = prepared.case.title or path.stem
        print(f"{title}\n\nplan\n{prepared.text}\n", flush=True)
    outcome = execute(prepared, path, options)
    from particlerb.checks import results, table

    checks = results(prepared.case, prepared.scene, outcome)
    if options.json:
        print(json.dumps(summary(path, outcome, checks)))
    else:
        if checks:
            print(f"checks\n{table(checks)}\n")
        if not options.quiet:
            print(drift_text(outcome))
            print(f"written: {path}")
    return DONE if all(check.holds for check in checks) else MISSED


def output_path(options: argparse.Namespace, case: "Case") -> Path:
    """File of a run, which may not exist unless it may be replaced."""
    stem = case.path.stem if case.path else "run"
    path = Path(options.output) if options.output else Path("output") / f"{stem}.h5"
    if path.is_dir():
        raise Ending(f"{path} is a folder: name a file with -o")
    if path.exists() and not options.overwrite:
        raise Ending(f"{path} exists: give another name with -o, or --overwrite")
    wrong = [parent for parent in path.parents if parent.exists() and not parent.is_dir()]
    if wrong:
        raise Ending(f"{path} cannot be made: {wrong[0]} is no folder")
    return path


def disk_warnings(case: "Case", path: Path) -> list[str]:
    """Warning where the file would not fit on the disk."""
    import shutil

    from particlerb.record.writer import bytes_of_run, spare_bytes
    from particlerb.simulate import frame_count

    size = bytes_of_run(case, frame_count(case)) + spare_bytes(case)
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    free = shutil.disk_usage(folder).free
    if size <= free:
        return []
    return [
        f"particlerb: warning: {path} would take {size / 1e9:.3g} GB, the disk has"
        f" {free / 1e9:.3g} GB free; raise run.every, or give fewer [output] fields"
    ]


def execute(prepared: "Prepared", path: Path, options: argparse.Namespace) -> "Outcome":
    """Run with a progress bar; an interrupt or a failure says what was kept."""
    from tqdm import tqdm

    from particlerb.record.writer import FullDiskError
    from particlerb.simulate import RunError, frame_count, run_prepared

    frames = frame_count(prepared.case)
    bar = tqdm(total=frames, unit="frame", disable=True if options.quiet else None, delay=0.5)
    try:
        with bar, stoppable():
            return run_prepared(prepared, path, options.overwrite, bar.update)
    except RunError as error:
        raise Ending(f"the run failed: {error}; {kept(path)}", FAILED) from None
    except KeyboardInterrupt:
        raise Ending(f"interrupted; {kept(path)}", INTERRUPTED) from None
    except FileExistsError as error:
        raise Ending(str(error)) from None
    except FullDiskError:
        raise Ending(f"the run failed: the disk is full; {kept(path)}", FAILED) from None
    except OSError as error:
        raise Ending(f"the run failed: cannot write {error}", FAILED) from None


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end a run between two kernels; what ignored them goes on doing so."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {n: signal.getsignal(n) for n in numbers if signal.getsignal(n) != signal.SIG_IGN}
    if threading.current_thread() is not threading.main_thread():
        before = {}  # only the main thread may have a say in signals
    for number in before:
        signal.signal(number, ask_to_stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ask_to_stop(number: int, frame: object) -> None:
    """End the run after the kernel that is running; the second time, at once."""
    del frame
    from particlerb.threads import THREADS

    THREADS.is_stopping = True
    signal.signal(number, signal.default_int_handler)


def kept(path: Path) -> str:
    """What is left in a file after a run that did not end."""
    from particlerb.trajectory import TrajectoryError, open_trajectory

    try:
        with open_trajectory(path) as trajectory:
            n = trajectory.n_frames
            return f"{n} {'frame is' if n == 1 else 'frames are'} kept in {path}"
    except (OSError, TrajectoryError):
        return "no file was written"


def drift_text(outcome: "Outcome") -> str:
    """The ledger in one line."""
    energy, linear, angular = outcome.drift
    return (
        f"drift (total less booked, relative): energy {energy:.2g}, momentum {linear:.2g},"
        f" angular momentum {angular:.2g}"
    )


def summary(path: Path, outcome: "Outcome", checks: "list[Result]") -> dict[str, Any]:
    """Result of a run for machines."""
    return {
        "file": str(path),
        "drift": outcome.drift._asdict(),
        "checks": [{**check._asdict(), "holds": check.holds} for check in checks],
    }


def check_command(options: argparse.Namespace) -> int:
    """`check`: the plan without a run."""
    prepared = prepared_case(options)
    if options.json:
        print(json.dumps({"plan": prepared.text, "warnings": prepared.plan.warnings}))
    else:
        print(f"{options.case} is a case that can be run\n\nplan\n{prepared.text}")
    return DONE


def mass_command(options: argparse.Namespace) -> int:
    """`mass`: mass properties of the distinct bodies."""
    from particlerb.bodies.mass_properties import describe
    from particlerb.bodies.scene import assemble
    from particlerb.case.placement import resolve_bodies
    from particlerb.case.problems import CaseError

    case = read_case(options)
    try:
        scene = assemble(case)
    except CaseError as error:
        raise Ending(str(error)) from None
    bodies = range(len(scene.kind))
    if options.body is not None:
        try:
            bodies = resolve_bodies(case, options.body).tolist()
        except KeyError:
            known = ", ".join(body.name for body in case.body)
            raise Ending(f"{options.body}: no such body; bodies here: {known}") from None
    shown: dict[int, str] = {}
    for b in bodies:
        shown.setdefault(int(scene.kind[b]), scene.names[b])
    counts = scene.particles.offset[1:] - scene.particles.offset[:-1]
    if options.json:
        print(json.dumps([mass_record(scene, k, name) for k, name in shown.items()]))
        return DONE
    texts = [describe(scene.properties, k, n, int(counts[k])) for k, n in shown.items()]
    print("\n\n".join(texts))
    return DONE


def mass_record(scene: Any, k: int, name: str) -> dict[str, Any]:
    """Mass properties of one kind for machines."""
    from particlerb.rotors.rotor_class import NAMES

    record = {field: values[k].tolist() for field, values in scene.properties._asdict().items()}
    record["rotor_class"] = NAMES[record["rotor_class"]]
    return {"name": name, **record}


def opened(path: str) -> Any:
    """Trajectory in a file; wrong usage where it is none."""
    from particlerb.trajectory import TrajectoryError, open_trajectory

    try:
        return open_trajectory(path)
    except (TrajectoryError, FileNotFoundError, IsADirectoryError) as error:
        raise Ending(str(error)) from None


def info_command(options: argparse.Namespace) -> int:
    """`info`: what a file holds and where it comes from."""
    with opened(options.file) as trajectory:
        facts = {
            "title": trajectory.parameter("case_resolved")["title"],
            "bodies": trajectory.n_bodies,
            "frames": trajectory.n_frames,
            "time": [float(t) for t in trajectory.time[[0, -1]]] if trajectory.n_frames else [],
            "fields": trajectory.fields,
            "seed": int(trajectory.parameter("seed")),
            "versions": trajectory.parameter("versions"),
            "machine": trajectory.parameter("machine"),
            "git_revision": trajectory.parameter("git_revision"),
        }
        plan = trajectory.parameter("plan")
    if options.json:
        print(json.dumps({**facts, "plan": plan}))
        return DONE
    for name, value in facts.items():
        print(f"{name:<13} {text_of(value)}")
    print(f"plan\n{plan}")
    return DONE


def text_of(value: Any) -> str:
    """A fact in words."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {entry}" for name, entry in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def plot_command(options: argparse.Namespace) -> int:
    """`plot`: a picture of a trajectory."""
    with opened(options.file) as trajectory:
        path = Path(options.output or Path(options.file).with_suffix(".png"))
        if path.exists() and not options.overwrite:
            raise Ending(f"{path} exists: give another name with -o, or --overwrite")
        names = list(trajectory.names)
        lacking = [field for field in PLOTTED if field not in trajectory.fields]
        if lacking:
            raise Ending(f"{options.file} lacks {', '.join(lacking)}: see [output] fields")
        if not trajectory.n_frames:
            raise Ending(f"{options.file} has no frames")
        if path.suffix not in PICTURES:
            raise Ending(f"{path}: a picture ends with {', '.join(PICTURES)}")
        if options.body is not None and options.body not in names:
            near = difflib.get_close_matches(options.body, names, 3)
            hint = f"did you mean {' or '.join(near)}?" if near else f"the first is {names[0]}"
            raise Ending(f"{options.body}: no such body in {options.file}; {hint}")
        from particlerb.studies.charts.trajectory import draw_trajectory

        draw_trajectory(trajectory, path, names.index(options.body) if options.body else None)
    print(f"written: {path}")
    return DONE


def cases_command(options: argparse.Namespace) -> int:
    """`cases`: the examples, each with its title."""
    del options
    import tomllib

    shown: dict[str, str] = {}
    for folder in example_folders():
        for path in sorted(folder.glob("*.toml")):
            try:
                title = str(tomllib.loads(path.read_text(encoding="utf-8")).get("title", ""))
            except (tomllib.TOMLDecodeError, UnicodeDecodeError):
                title = "(not readable)"
            shown.setdefault(path.stem, title)
    width = max(map(len, shown), default=0)
    for name in sorted(shown):
        print(f"{name:<{width}}  {shown[name]}")
    return DONE


def methods_command(options: argparse.Namespace) -> int:
    """`methods`: the integrators."""
    del options
    from particlerb.methods import METHODS

    print("auto    closed form where a body is free, strang where a force drives it (default)")
    for name, method in METHODS.items():
        print(f"{name:<7} {method.SUMMARY}")
    return DONE


def schema_command(options: argparse.Namespace) -> int:
    """`schema`: JSON schema of a case file."""
    del options
    from particlerb.case.schema import case_json_schema

    print(json.dumps(case_json_schema(), indent=2, ensure_ascii=False))
    return DONE


COMMANDS: Final[dict[str, Callable[[argparse.Namespace], int]]] = {
    "run": run_command,
    "check": check_command,
    "mass": mass_command,
    "info": info_command,
    "plot": plot_command,
    "cases": cases_command,
    "methods": methods_command,
    "schema": schema_command,
}
