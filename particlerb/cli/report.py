"""What a run says on its way: a bar on a terminal, else lines; lines in a log where one is wanted.

Lines are for long runs: the first comes ten seconds after the first frames, compilation aside.
"""

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final, TextIO

from tqdm import tqdm

from particlerb.cli.exit_codes import Ending, code_of
from particlerb.files import Closing
from particlerb.plan.segments import Plan, is_adaptive
from particlerb.simulation.outcome import Reached

_LOG_HEAD: Final = (
    f"{'time [s]':>10} {'frames':>9} {'steps':>9} {'energy [J]':>12} {'error [J]':>9}"
    f" {'contacts':>8} {'steps/s':>8} {'left [s]':>8}"
)
_UNTIMED_REPORTS: Final = 2  # of the start, and of a first frame, before which kernels compile
_SECONDS_BETWEEN: Final = {"lines": 10.0, "log": 1.0}  # lines


def steps_until(plan: Plan, time: float) -> int:
    """Most steps that a group takes until a time [s], of those that are known in advance."""
    steps = [0]
    for group in plan.groups:
        known = (s for s in group.stepped if s.start < time and not is_adaptive(s.method))
        steps.append(sum(round((min(s.stop, time) - s.start) / s.dt) for s in known))
    return max(steps)


def _new_log(path: Path) -> TextIO:
    """File for lines, with its head; what is there may only be another log."""
    try:
        data, head = path.read_bytes() if path.is_file() else b"", _LOG_HEAD.encode()
        if not (data.startswith(head) or head.startswith(data)):
            raise Ending(f"log: {path} exists and is not a log, give another name")
        file = path.open("w", encoding="utf-8")
        try:
            print(_LOG_HEAD, file=file, flush=True)
        except OSError:
            file.close()
            raise
    except OSError as error:
        told = f"log: {path} cannot be written: {error.strerror}"
        raise Ending(told, code_of(error)) from None
    return file


class Report(Closing):
    """Reports on a run.

    Parameters
    ----------
    total, done : int
        Frames in all, and those that were there before.
    is_quiet : bool
        Whether the terminal gets nothing.
    log : str, optional
        File for lines; it is written anew.
    steps_until : callable
        Number of steps until a time [s]; 0 where it is not known.

    Raises
    ------
    Ending
        If the log cannot be written, or is another kind of file.
    """

    def __init__(
        self, total: int, done: int, is_quiet: bool, log: str | None,
        steps_until: Callable[[float], int] = lambda time: 0,
    ) -> None:  # fmt: skip
        self.total, self.first, self.done = total, done, done
        self.steps_until, self.first_time = steps_until, 0.0  # [s] as `start`
        has_terminal = sys.stderr.isatty() and not is_quiet
        is_hidden = not has_terminal
        self.bar = tqdm(total=total, initial=done, unit="frame", disable=is_hidden, delay=0.5)
        self.outputs: dict[str, TextIO] = {}
        if not has_terminal and not is_quiet:
            self.outputs["lines"] = sys.stderr
        if log is not None:
            self.outputs["log"] = _new_log(Path(log))
        self.start = 0.0  # when the first frames were there, and all was compiled
        self.taken = 0  # reports so far
        self.said = dict.fromkeys(self.outputs, -math.inf)  # when a line was last written
        self.lines = 0  # on stderr
        self.last: Reached | None = None

    def add(self, reached: Reached) -> None:
        """Take note of what was reached."""
        self.done += reached.frames
        told = f"t = {reached.time:.6g} s, energy {reached.energy:.6g} J"
        self.bar.set_postfix_str(f"{told}, error {reached.energy_error:.1e} J", refresh=False)
        self.bar.update(reached.frames)
        now = time.monotonic()
        if self.taken < _UNTIMED_REPORTS:
            self.start, self.first, self.first_time = now, self.done, reached.time
            if "lines" in self.said:
                self.said["lines"] = now
        self.taken += 1
        self.last = reached
        for name, output in self.outputs.items():
            if now - self.said[name] >= _SECONDS_BETWEEN[name]:
                self.said[name] = now
                self._write(name, output)

    def _write(self, name: str, output: TextIO) -> None:
        """Write a line."""
        assert self.last is not None
        head = f"{_LOG_HEAD}\n" if name == "lines" and not self.lines else ""
        self.lines += name == "lines"
        elapsed, done = time.monotonic() - self.start, self.done - self.first
        steps = self.steps_until(self.last.time)
        taken = steps - self.steps_until(self.first_time)
        speed = f"{taken / elapsed:.3g}" if taken and elapsed else "-"
        left = f"{elapsed * (self.total - self.done) / done:.0f}" if done else "-"
        contacts = "-" if self.last.contacts is None else self.last.contacts
        line = (
            f"{self.last.time:10.6g} {f'{self.done}/{self.total}':>9} {steps or '-':>9}"
            f" {self.last.energy:12.7g} {self.last.energy_error:9.1e} {contacts:>8} {speed:>8}"
            f" {left:>8}"
        )
        try:
            print(f"{head}{line}", file=output, flush=True)
        except OSError as error:
            raise OSError(error.errno, error.strerror, getattr(output, "name", "stderr")) from None

    def close(self) -> None:
        """End the bar, and the log with what was reached last."""
        self.bar.close()
        log = self.outputs.pop("log", None)
        if log is not None:
            if self.last is not None:
                self._write("log", log)
            log.close()
