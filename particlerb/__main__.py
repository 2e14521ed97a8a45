"""`python -m particlerb`; an interrupt while it begins or ends is as any other."""

import contextlib
import importlib
import os
import signal
import sys


def _end(code: object) -> None:
    """End this process; where it is one of several, and not yet with them in MPI, all of them.

    Launchers let them wait there for one that has ended.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # Python takes a while to end
    is_together = getattr(sys.modules.get("particlerb.ranks"), "TOGETHER", False)
    if code and "--mpi" in sys.argv and not is_together:
        with contextlib.suppress(Exception):
            mpi = importlib.import_module("mpi4py.MPI")
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPI adds words of its own
            mpi.COMM_WORLD.Abort(code)
    sys.exit(code)  # type: ignore[arg-type]


try:
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    from particlerb.cli import entry

    entry()
except KeyboardInterrupt:
    print("particlerb: interrupted", file=sys.stderr)
    _end(130)
except SystemExit as end:
    _end(end.code)
finally:
    exec("")  # one that was interrupted would make Python end by SIGINT in place of the code
