"""Runs the commands that read files of unknown origin in a process of their own.

HDF5 checks much of what it reads, not all: a damaged file can crash it, or send it round in circles
where Python's Ctrl-C does not reach. Then a message is left, and the right exit code.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from particlerb.cli.exit_codes import DONE, FAILED, INTERRUPTED, Ending

GUARDED: Final = ("info", "plot", "export", "resume")
TRAJECTORY_SUFFIXES: Final = (".h5", ".hdf5", ".vtkhdf")  # that `view` plays
GUARD_MARK: Final = "PARTICLERB_IS_GUARDED"
_SECONDS_TO_END: Final = 2.0
SECONDS_TO_LOOK: Final = 10  # of the processor at each file: it has some hundred objects


def wants_guard(words: Sequence[str]) -> bool:
    """Whether a command line is to run in a process of its own."""
    if not words or GUARD_MARK in os.environ or "--mpi" in words:  # what is launched has a rank
        return False
    is_played = any(Path(word).suffix.lower() in TRAJECTORY_SUFFIXES for word in words[1:])
    return words[0] in GUARDED or (words[0] == "view" and is_played)


def guarded(words: Sequence[str]) -> int:
    """Run a command line in a process of its own; return its exit code.

    An interrupt goes on to that process. `resume` has its time to keep its frames, and ends at once
    at the second one; it is how one ends `view`.
    """
    is_page = words[0] == "view"
    command = [sys.executable, "-m", "particlerb", *words]
    with subprocess.Popen(command, env=os.environ | {GUARD_MARK: "1"}) as process:
        try:
            code = process.wait()
        except KeyboardInterrupt:
            try:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    if is_page:  # Ctrl-C was sent to the other process too, SIGTERM was not
                        return process.wait(_SECONDS_TO_END)
                process.terminate()
                process.wait(None if words[0] == "resume" else _SECONDS_TO_END)
            except (KeyboardInterrupt, subprocess.TimeoutExpired):
                process.kill()
            return DONE if is_page else INTERRUPTED
    if code >= 0:
        return code
    reason = f"HDF5 crashed on it (signal {-code})"
    file = next((word for word in words[1:] if not word.startswith("-")), "the file")
    print(f"particlerb: {file} is damaged: {reason}", file=sys.stderr)
    return FAILED


def probe(path: Path, visits_parts: bool = True) -> None:
    """Visit all objects of a file in a fork: a command that goes on for long would die of them.

    Those of its parts too, if these are asked for.

    Raises
    ------
    Ending
        If HDF5 crashes on the file, or goes round in circles.
    """
    from particlerb.record.checked_reading import TrajectoryError, open_file
    from particlerb.record.parts import part_paths
    from particlerb.record.trajectory import open_trajectory

    if not hasattr(os, "fork"):
        return
    child = os.fork()
    if not child:
        try:
            import resource

            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            most = resource.getrlimit(resource.RLIMIT_CPU)[1]
            resource.setrlimit(resource.RLIMIT_CPU, (SECONDS_TO_LOOK, most))
            with (
                contextlib.suppress(FileNotFoundError, TrajectoryError),
                open_trajectory(path) as t,
            ):
                _visit(t.file, set())
                for part_path in part_paths(t.file) if visits_parts else ():
                    until = int(time.process_time()) + SECONDS_TO_LOOK
                    resource.setrlimit(resource.RLIMIT_CPU, (until, most))
                    with open_file(part_path) as part:
                        _visit(part, set())
        finally:
            os._exit(0)
    try:
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    except KeyboardInterrupt:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise
    if code < 0:
        name = signal.Signals(-code).name
        raise Ending(f"{path} is damaged: HDF5 crashed reading it, or did not end ({name})", FAILED)


def _visit(group: Any, met: set[tuple[int, int]]) -> None:
    """Open all that is in a group, one by one, as a visit by HDF5 ends at the first fault.

    Each object is opened once, and links to elsewhere are not followed.
    """
    from h5py import h5l, h5o

    for name in list(group):
        with contextlib.suppress(Exception):  # what cannot be opened is found by who reads it
            if group.id.links.get_info(name.encode()).type != h5l.TYPE_HARD:
                continue
            item = group[name]
            about = h5o.get_info(item.id)
            if hasattr(item, "keys") and (about.fileno, about.addr) not in met:
                met.add((about.fileno, about.addr))
                _visit(item, met)
