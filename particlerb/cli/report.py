"""What a run says on its way: a bar on a terminal, else lines; lines in a log where one is wanted.

Lines are for long runs: the first comes ten seconds after the first frames, compilation aside.
"""

import math
import sys
import time
from pathlib import Path
from typing import Final, TextIO

from tqdm import tqdm

from particlerb.cli.exit_codes import Ending, code_of
from particlerb.files import Closing
from particlerb.simulation.outcome import Reached

_LOG_HEAD: Final = (
    f"{'time [s]':>14} {'frames':>14} {'energy [J]':>18} {'error [J]':>11}"
    f" {'elapsed [s]':>12} {'left [s]':>10}"
)
_UNTIMED_REPORTS: Final = 2  # of the start, and of a first frame, before which kernels compile
_SECONDS_BETWEEN: Final = {"lines": 10.0, "log": 1.0}  # lines


def _new_log(path: Path) -> TextIO:
    """File for lines, with its head; what is there may only be another log."""
    try:
        data, head = path.read_bytes() if path.is_file() else b"", _LOG_HEAD.encode()
        if not (data.startswith(head) or head.startswith(data)):
            raise Ending(f"--log {path} exists and is not a log: give another name")
        file = path.open("w", encoding="utf-8")
        try:
            print(_LOG_HEAD, file=file, flush=True)
        except OSError:
            file.close()
            raise
    except OSError as error:
        told = f"--log {path} cannot be written: {error.strerror}"
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

    Raises
    ------
    Ending
        If the log cannot be written, or is another kind of file.
    """

    def __init__(self, total: int, done: int, is_quiet: bool, log: str | None) -> None:
        self.total, self.first, self.done = total, done, done
        has_terminal = sys.stderr.isatty() and not is_quiet
        self.bar = tqdm(
            total=total, initial=done, unit="frame", disable=not has_terminal, delay=0.5
        )
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
        self.bar.set_postfix_str(f"t = {reached.time:.6g} s", refresh=False)
        self.bar.update(reached.frames)
        now = time.monotonic()
        if self.taken < _UNTIMED_REPORTS:
            self.start, self.first = now, self.done
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
        left = f"{elapsed * (self.total - self.done) / done:10.0f}" if done else f"{'':>10}"
        line = (
            f"{self.last.time:14.6g} {self.done:>7}/{self.total:<6} {self.last.energy:18.10g}"
            f" {self.last.energy_error:11.2e} {elapsed:12.1f} {left}"
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
