"""Runs the commands that read files of unknown origin in a process of their own.

HDF5 checks much of what it reads, not all: a damaged file can crash it, or send it round in circles
where Python's Ctrl-C does not reach. Then a message is left, and the right exit code.
"""

import os
import subprocess
import sys
from collections.abc import Sequence
from typing import Final

from particlerb.cli.common import FAILED, INTERRUPTED

GUARDED: Final = ("info", "plot", "export")
MARK: Final = "PARTICLERB_IS_GUARDED"
SECONDS_TO_END: Final = 2.0


def wants_guard(words: Sequence[str]) -> bool:
    """Whether a command line is to run in a process of its own."""
    return bool(words) and words[0] in GUARDED and MARK not in os.environ


def guarded(words: Sequence[str]) -> int:
    """Run a command line in a process of its own; return its exit code."""
    command = [sys.executable, "-m", "particlerb", *words]
    with subprocess.Popen(command, env=os.environ | {MARK: "1"}) as process:
        try:
            code = process.wait()
        except KeyboardInterrupt:
            try:
                process.terminate()  # Ctrl-C was sent to the other process too, SIGTERM was not
                process.wait(SECONDS_TO_END)
            except subprocess.TimeoutExpired:
                process.kill()
            return INTERRUPTED
    if code >= 0:
        return code
    reason = f"HDF5 crashed reading it (signal {-code})"
    file = next((word for word in words[1:] if not word.startswith("-")), "the file")
    print(f"particlerb: {file} is damaged: {reason}", file=sys.stderr)
    return FAILED
