"""Commands `run` and `resume`: a case, its plan, its run, its checks."""

import argparse
import contextlib
import json
import math
import shlex
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from particlerb.case.problems import CaseError
from particlerb.case.run import frame_count
from particlerb.case.to_system import to_system
from particlerb.cli.common import amount, fitted, output_of, read_case
from particlerb.cli.exit_codes import DONE, FAILED, INTERRUPTED, MISSED, Ending, ending, tamed
from particlerb.cli.guard import probe
from particlerb.cli.ranks import ranks_of
from particlerb.cli.report import Report, steps_until
from particlerb.compiled.threads import THREADS
from particlerb.impulses import records
from particlerb.maths.vec3 import Floats
from particlerb.model.system import System
from particlerb.plan.describe import describe
from particlerb.plan.segments import Plan
from particlerb.plan.time_step import STEPS_PER_CONTACT
from particlerb.ranks import ALONE, Ranks
from particlerb.record import schema
from particlerb.record.checked_reading import can_be_continued
from particlerb.record.file_size import SMALLEST_FILE, estimated_size
from particlerb.record.output_file import DamagedError
from particlerb.record.trajectory import TrajectoryError, open_trajectory
from particlerb.record.writer_lock import InUseError
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.checks import Result, results, table
from particlerb.simulation.outcome import Outcome, Progress
from particlerb.simulation.resume import ResumeError, look_at, resume_pending
from particlerb.simulation.run import run_prepared, share_of_rank
from particlerb.simulation.run_warnings import run_warnings
from particlerb.simulation.set_up_apart import prepared_apart
from particlerb.simulation.whole_run import Prepared, RunError
from particlerb.words import count_of

_MAX_ENDING_LINES: Final = 10  # that a run ends with
_OTHER_SUFFIXES: Final = (
    ".png", ".svg", ".pdf", ".csv", ".txt", ".toml", ".json", ".gsd", ".npz", ".xml", ".stl",
    ".log",
)  # fmt: skip
_BROKEN_NAMED: Final = 3  # joints at most


def prepared_case(options: argparse.Namespace, ranks: Ranks = ALONE) -> Prepared:
    """System of a case, made ready to run; on ranks that can, the part of this one."""
    case = ranks.together(partial(read_case, options))
    with ending(CaseError):
        prepared = prepared_apart(case, ranks)
        if prepared is None:
            prepared = ranks.together(lambda: prepare_accurately(to_system(case)))
    ranks.together(partial(_warn, options, prepared.plan.warnings))
    return prepared


def plan_text(options: argparse.Namespace, prepared: Prepared, ranks: Ranks = ALONE) -> str:
    """The plan as it is printed; the whole of it with --plan."""
    own = ranks if prepared.is_part else ALONE
    told = prepared.system, prepared.plan, prepared.accuracy, own
    return describe(*told, is_whole=True) if options.plan else prepared.text


def _warn(options: argparse.Namespace, warnings: Sequence[str]) -> None:
    """Print warnings; with --strict they end the program."""
    for warning in warnings:
        print(warning, file=sys.stderr)
    if warnings and options.strict:
        raise Ending("--strict: a warning is an error")


def run_command(options: argparse.Namespace) -> int:
    """`run`: the plan, the run, the checks."""
    with ranks_of(options) as ranks:
        prepared = prepared_case(options, ranks)
        plan = plan_text(options, prepared, ranks)
        if ranks is not ALONE:
            prepared = ranks.together(partial(share_of_rank, prepared, ranks))
        system = prepared.system
        path = ranks.together(partial(_output_path, options, system))
        options.log = options.log or system.output.log
        if options.log and Path(options.log).resolve() == path.resolve():
            raise Ending(f"{path} would be both the file and the log: give one another name")
        ranks.together(lambda: _warn(options, _disk_warnings(system, path)))
        if not (options.quiet or options.json):
            title = system.title or path.stem
            print(tamed(f"{title}\n\nplan\n{fitted(plan)}"), flush=True)
            free = amount(_free_bytes(path))
            print(fitted(f"  file: {path}, {size_text(system)}; {free} are free\n"), flush=True)

        run = partial(run_prepared, prepared, path, options.overwrite, ranks=ranks)
        before, total = _number_of(path), frame_count(system.run)
        outcome = _execute(run, path, prepared.plan, options, total, before=before, ranks=ranks)
        return _conclude(prepared, outcome, path, options, ranks)


def resume_command(options: argparse.Namespace) -> int:
    """`resume`: go on with the run of a file."""
    with ranks_of(options) as ranks:
        path = Path(options.file)
        ranks.together(lambda: None if ranks.number else probe(path))
        with ending(CaseError, ResumeError, TrajectoryError, FileNotFoundError):
            pending = look_at(path, options.t_end, options.threads, options.allow_code, ranks)
        ranks.together(partial(_warn, options, list(pending.warnings)))
        system, start = pending.prepared.system, pending.start
        total = frame_count(system.run)
        ranks.together(lambda: _warn(options, _disk_warnings(system, path, pending.n_before)))
        if not (options.quiet or options.json):
            again = f", the last {pending.n_before - start} of them to be computed again"
            counts = f"{pending.n_before} of {total} frames"
            rest = again if start < pending.n_before else ""
            print(f"{system.title or path.stem}\n\n{path} has {counts}{rest}\n", flush=True)

        run = partial(resume_pending, pending, ranks=ranks)
        with ending(ResumeError):
            outcome = _execute(run, path, pending.prepared.plan, options, total, start, ranks=ranks)
        return _conclude(pending.prepared, outcome, path, options, ranks)


def _conclude(
    prepared: Prepared, outcome: Outcome, path: Path, options: argparse.Namespace, ranks: Ranks
) -> int:
    """Print what came out; the exit code."""
    checks = results(prepared.system, outcome, ALONE if prepared.is_copied else ranks)
    if options.json:
        print(json.dumps(summary(path, outcome, checks)))
    else:
        lines = [] if options.quiet else [*_notes(outcome), f"written: {path}"]
        if checks:
            lines.insert(0, f"checks\n{table(checks, _MAX_ENDING_LINES - len(lines) - 1)}")
        if lines:
            print("\n".join(lines))
    ranks.together(partial(_warn, options, run_warnings(prepared, outcome)))
    return DONE if all(check.holds for check in checks) else MISSED


def _output_path(options: argparse.Namespace, system: System) -> Path:
    """File of a run, which may be written."""
    source = system.source.path
    stem = source.stem if source else "run"
    named = Path(options.output or stem)
    if named != source and named.suffix.lower() in _OTHER_SUFFIXES:
        raise Ending(f"{named}: a trajectory is an HDF5 file, as {named.with_suffix('.h5')}")
    return output_of(options, Path("output") / f"{stem}.h5", source)


def _disk_warnings(system: System, path: Path, done: int = 0) -> list[str]:
    """Warning where what is left to write, behind some frames, would not fit on the disk."""
    size = estimated_size(system, frame_count(system.run) - done) + SMALLEST_FILE
    free = _free_bytes(path)
    if size <= free:
        return []
    told = f"{path} would take {amount(size)}, the disk has {amount(free)} free"
    hint = "raise run.every, or give fewer [output] fields"
    return [f"particlerb: warning: {told}; {hint}"]


def _free_bytes(path: Path) -> int:
    """Room on the disk of a file that need not be there yet."""
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    return shutil.disk_usage(folder).free


def expected_size(system: System) -> int:
    """Bytes of a whole file, contacts aside."""
    n_bytes = estimated_size(system, frame_count(system.run))
    return n_bytes + SMALLEST_FILE + sum(map(len, system.files.contents.values()))


def size_text(system: System) -> str:
    """Frames and size of a run."""
    text = f"{frame_count(system.run)} frames, about {amount(expected_size(system))}"
    if schema.CONTACTS in system.output.fields:
        columns, dtype = schema.COLUMNS.values(), np.dtype(system.output.dtype)
        each = sum(math.prod(c.width) * schema.dtype_of(c, dtype).itemsize for c in columns)
        text += f" and {each} bytes for each contact in a frame"
        text += ", whose number is not known in advance"
    return text


def _execute(
    run: Callable[[Progress], Outcome],
    path: Path,
    plan: Plan,
    options: argparse.Namespace,
    total: int,
    done: int = 0,
    before: int | None = None,
    ranks: Ranks = ALONE,
) -> Outcome:
    """Run, and report on it; an interrupt or a failure says what was kept, and how to go on.

    `before` is the number of a file that is there and is to be replaced.
    """
    log, steps = None if ranks.number else options.log, partial(steps_until, plan)
    report = ranks.together(lambda: Report(total, done, options.quiet, log, steps))
    try:
        with report, stoppable():
            return run(report.add)
    except (RunError, DamagedError) as error:
        raise Ending(f"the run failed: {error}; {kept(path, before, None)}", FAILED) from None
    except KeyboardInterrupt:
        raise Ending(f"interrupted; {kept(path, before, ranks)}", INTERRUPTED) from None
    except InUseError:
        raise Ending(f"{path} is being written by another run: give another name with -o") from None
    except FileExistsError as error:
        raise Ending(str(error)) from None
    except OSError as error:
        why = f"cannot write {error.filename}: {error.strerror}" if error.strerror else str(error)
        told = kept(Path(error.filename2 or path), before, ranks)
        if error.filename2 == "":  # moved, the system does not say where
            told = "all frames are kept under another name"
        raise Ending(f"the run failed: {why}; {told}", FAILED) from None


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end a run; what ignored them goes on doing so."""
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
        THREADS.is_ending = THREADS.is_stopping = False


def ask_to_stop(number: int, _: object) -> None:
    """End the run behind the frame that is computed; the second time, behind the kernel."""
    if not THREADS.is_ending:
        THREADS.is_ending = True
        with contextlib.suppress(OSError, RuntimeError):  # stderr is gone, or is just being written
            told = "\nfinishing this frame; interrupt again to stop now"
            print(told, file=sys.stderr, flush=True)
        return
    THREADS.is_stopping = True
    signal.signal(number, signal.default_int_handler)


def _number_of(path: Path) -> int | None:
    """Number of a file on its disk; None where there is none."""
    return path.stat().st_ino if path.exists() else None


def kept(path: Path, before: int | None, ranks: Ranks | None) -> str:
    """What is left in a file after a run that did not end, and how ranks, if any can, go on."""
    if _number_of(path) in (None, before):
        return "no file was written"
    try:
        with open_trajectory(path) as trajectory:
            n = trajectory.n_frames
            text = f"{count_of(n, 'frame is', 'frames are')} kept in {path}"
            if ranks is not None and (can_be_continued(trajectory.file) or not n):
                how = f"python -m particlerb resume {shlex.quote(str(path))}"
                how = how if ranks is ALONE else f"mpiexec -n {ranks.count} {how} --mpi"
                text += f"\ncontinue with: {how}"
            return text
    except (OSError, TrajectoryError) as error:
        return f"what is in {path} cannot be read now: {error}"


def _notes(outcome: Outcome) -> list[str]:
    """What contacts, trees and joints did, a line each, and the conservation errors."""
    energy, linear, angular = outcome.drift
    lines = []
    if outcome.flown:
        share = f"{100.0 * outcome.flown:.3g} % of the body-steps"
        lines.append(f"{share} were taken in closed form: no contact in reach")
    if outcome.broken:
        broken = [f"{name} at t = {time:.6g} s" for name, time in outcome.broken[:_BROKEN_NAMED]]
        n = len(outcome.broken) - len(broken)
        others = f", and {n} more: the field joint_break_time has all" if n else ""
        lines.append(f"joints broke: {', '.join(broken)}{others}")
    if (tree := outcome.tree) is not None:
        errs = f"accelerations erred by {tree.seen:.2g} at most, rms, of {tree.asked:.2g} asked for"
        lines.append(f"tree of the attraction: opening angle {tree.angle:.3g}, {errs}")
    if outcome.tally is not None:
        is_stepped = outcome.tally[records.STEPS] > 0.0 or not outcome.tally.any()
        text = impulse_text if is_stepped else event_text
        lines += text(outcome.tally).splitlines()
    if outcome.contact_turn > 0.0:
        lines.append(contact_text(outcome.contact_turn))
    told = f"energy {energy:.2g}, momentum {linear:.2g}, angular momentum {angular:.2g}"
    return [*lines, f"conservation error (external work removed): {told}"]


def impulse_text(tally: Floats) -> str:
    """How well impulses were solved, and what they have done."""
    steps, unmet, unended = tally[[records.STEPS, records.UNMET, records.UNENDED]]
    each = tally[[records.CONTACTS, records.SWEEPS, records.NEWTON_STEPS]] / max(steps, 1.0)
    works = {"impacts": records.IMPACT_WORK, "pressing": records.PRESSING_WORK}
    works |= {"friction": records.FRICTION_WORK, "moving walls": records.BOUNDARY_WORK}
    works |= {"motors": records.MOTOR_WORK} if tally[records.MOTOR_WORK] else {}
    works |= {"push-out": records.PUSH_OUT_WORK}
    done = ", ".join(f"{name} {tally[k]:.3g} J" for name, k in works.items())
    advice = ' (contact.iterations or solver = "newton" lower it)' if unmet > 0.0 else ""
    text = (
        f"impulses: residual {tally[records.RESIDUAL]:.2g} in the last step,"
        f" {tally[records.WORST_EVER]:.2g} at worst, above the tolerance in {unmet:.0f} of"
        f" {steps:.0f} steps{advice}\n"
        f"per step: {each[0]:.3g} contacts, {each[1]:.3g} sweeps and {each[2]:.3g} Newton"
        f" iterations; largest overlap {tally[records.DEEPEST]:.3g} m\n"
        f"work: {done}"
    )
    if unended > 0.0:
        text += f"; in {unended:.0f} steps impacts had not come to an end"
    return text


def event_text(tally: Floats) -> str:
    """How many impacts there were, and what they have done."""
    impacts, walls = tally[records.IMPACTS], tally[records.WALL_IMPACTS]
    least, largest = tally[records.SMALLEST_GAP], tally[records.LARGEST_GAP]
    return (
        f"{impacts:.0f} impacts, {impacts - walls:.0f} between bodies and {walls:.0f} with walls\n"
        f"{tally[records.GRAZING]:.0f} grazed, {tally[records.ELASTIC]:.0f} hit again within the"
        f" contact time and bounced elastically; gaps at impacts {least:.2g} to {largest:.2g} of a"
        f" radius\nwork: impacts {tally[records.IMPACT_WORK]:.3g} J, friction"
        f" {tally[records.FRICTION_WORK]:.3g} J"
    )


def contact_text(frequency: float) -> str:
    """ω dt of bodies on all their contacts, and how many steps a contact takes."""
    steps = math.pi / frequency
    text = f"stiffest contact: ω dt = {frequency:.2g}, {steps:.3g} steps in a contact"
    return text if steps >= STEPS_PER_CONTACT else f"{text}; {STEPS_PER_CONTACT} are accurate"


def summary(path: Path, outcome: Outcome, checks: list[Result]) -> dict[str, Any]:
    """Result of a run for machines."""
    return {
        "file": str(path),
        "drift": outcome.drift._asdict(),
        "contact_turn": outcome.contact_turn,
        **({"broken": dict(outcome.broken)} if outcome.broken else {}),
        **({"tree": outcome.tree._asdict()} if outcome.tree is not None else {}),
        "checks": [{**check._asdict(), "holds": check.holds} for check in checks],
    }
