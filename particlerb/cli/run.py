"""Commands `run` and `check`: a case, its plan, its run, its checks."""

import argparse
import contextlib
import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from particlerb.cli.common import DONE, FAILED, INTERRUPTED, MISSED, Ending, prepared_case, warn

if TYPE_CHECKING:
    from particlerb.case.schema import Case
    from particlerb.checks import Result
    from particlerb.simulate import Outcome, Prepared


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
    text = (
        f"drift (total less booked, relative): energy {energy:.2g}, momentum {linear:.2g},"
        f" angular momentum {angular:.2g}"
    )
    if outcome.flown is None:
        return text
    share = f"{100.0 * outcome.flown:.3g} % of the body-steps"
    return f"{share} were saved: nothing was in reach, closed form\n{text}"


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
