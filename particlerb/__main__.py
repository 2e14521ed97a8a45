"""`python -m particlerb`; an interrupt while it begins or ends is as any other."""

import contextlib
import importlib
import os
import signal
import sys

try:
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    from particlerb.cli import entry

    entry()
except KeyboardInterrupt:
    print("particlerb: interrupted", file=sys.stderr)
    if "--mpi" in sys.argv:  # launchers let the others wait for a rank that has ended before MPI
        with contextlib.suppress(Exception):
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # MPI adds words of its own
            importlib.import_module("mpi4py.MPI").COMM_WORLD.Abort(130)
    sys.exit(130)
finally:
    exec("")  # one that was interrupted would make Python end by SIGINT in place of the code
