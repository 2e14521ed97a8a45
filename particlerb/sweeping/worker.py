"""One variant in a worker: a run in memory, and the row that it leaves."""

import math
import signal
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.output import Asked, Check, CheckValue
from particlerb.case.problems import CaseError
from particlerb.case.reader import build
from particlerb.case.source import Source
from particlerb.case.to_system import to_system
from particlerb.compiled.threads import THREADS
from particlerb.model.system import System
from particlerb.plan.joints import joints_of
from particlerb.simulation.accuracy import prepare_accurately
from particlerb.simulation.checks import joint_quantity, quantity, results
from particlerb.simulation.impulse_values import impulse_quantity
from particlerb.simulation.run import Outcome, RunError, run_prepared

_LETTERS = {3: "xyz", 4: "wxyz"}


class Task(NamedTuple):
    """Variants that one worker runs one after the other."""

    numbers: tuple[int, ...]
    raw: tuple[dict[str, Any], ...]
    source: Source  # of the case that they are variants of, without its data
    asked: tuple[Asked, ...]
    attempt: int = 0


class Row(NamedTuple):
    """What a variant came to."""

    number: int
    status: str  # "done", or "failed: " and why
    energy_drift: float
    missed: int  # limits of drift
    values: tuple[float, ...]


def start_worker() -> None:
    """One thread, as there is a worker on every core; the driver alone hears of Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    THREADS.use(1)


def work(task: Task) -> list[Row]:
    """Rows of a task; a variant that fails fails alone."""
    rows = []
    for number, raw in zip(task.numbers, task.raw, strict=True):
        try:
            rows.append(_row(number, task.source._replace(raw=raw), task.asked))
        except (CaseError, RunError, ArithmeticError, ValueError) as error:
            lines = str(error).splitlines() or [type(error).__name__]
            rows.append(failed(number, lines[0]))
    return rows


def failed(number: int, reason: str) -> Row:
    """Row of a variant that came to nothing."""
    return Row(number, f"failed: {reason}", math.nan, 0, ())


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # found in the frames, and the row
def _row(number: int, source: Source, asked: Sequence[Asked]) -> Row:
    """Run a variant."""
    prepared = prepare_accurately(to_system(build(source, ())))
    system = prepared.system
    looked_at = tuple(
        CheckValue.model_construct(**dict(one), value=0.0, tolerance=math.inf) for one in asked
    )
    check = Check.model_construct(**dict(system.check))
    check = check.model_copy(update={"value": looked_at})
    outcome = run_prepared(prepared._replace(system=system._replace(check=check)), None)
    missed = sum(not one.holds for one in results(system, outcome))
    values = [x for one in asked for x in _found(one, system, outcome)]
    return Row(number, "done", outcome.drift.energy, missed, tuple(values))


def _found(asked: Asked, system: System, outcome: Outcome) -> list[float]:
    """Numbers of a value that is asked for."""
    time = system.run.t_end if asked.time is None else asked.time
    probe = next(probe for probe in outcome.probes if probe.time == time)
    if asked.body is not None:
        bodies = system.names.find(asked.body)
        found = [quantity(asked, system, int(b), probe.frame) for b in bodies]
    elif asked.joint is None:
        found = [impulse_quantity(asked, probe.tally)]
    else:
        setup = joints_of(system)
        assert setup is not None
        found = [joint_quantity(asked, setup, probe.joints)]
    return [x for one in found for x in np.ravel(one).tolist()]


def columns(asked: Asked, system: System) -> list[str]:
    """Names of the numbers of a value that is asked for."""
    when = "" if asked.time is None else f"@{asked.time:g}"
    if asked.body is not None:
        owners = [system.names[int(b)] for b in system.names.find(asked.body)]
        size = {"orientation": 4, "kinetic_energy": 1, "inertia": 9}.get(asked.quantity, 3)
    elif asked.joint is None:
        owners, size = ["contacts"], 1
    else:
        setup = joints_of(system)
        assert setup is not None
        owners = [str(asked.joint)]
        size = {"joint_force": 3, "joint_torque": 3}.get(asked.quantity, 1)
        if asked.quantity == "joint_coordinate":
            size = int((setup.coordinates.joint == setup.names.index(owners[0])).sum())
    parts = [f".{letter}" for letter in _LETTERS.get(size, "")] or _numbered(size)
    return [f"{owner}.{asked.quantity}{part}{when}" for owner in owners for part in parts]


def _numbered(size: int) -> list[str]:
    """Ends of the names of numbers without letters."""
    return [""] if size == 1 else [f".{k}" for k in range(size)]
