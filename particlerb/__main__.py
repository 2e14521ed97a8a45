"""`python -m particlerb`; an interrupt while it begins or ends is as any other."""

import signal
import sys

try:
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    from particlerb.cli import entry

    entry()
except KeyboardInterrupt:
    print("particlerb: interrupted", file=sys.stderr)
    sys.exit(130)
finally:
    exec("")  # one that was interrupted would make Python end by SIGINT in place of the code
