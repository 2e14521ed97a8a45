"""Command `view`: a case that can be pushed, or a file that is played, in the browser."""

import argparse
import contextlib
import math
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli.common import opened, read_case, to_write
from particlerb.cli.exit_codes import DONE, FAILED, Ending, ending
from particlerb.cli.guard import TRAJECTORY_SUFFIXES

if TYPE_CHECKING:
    import viser

    from particlerb.view.access import Access
    from particlerb.view.live import Live

SCENES: Final = {
    "cube": "cube_at_rest", "T-handle": "dzhanibekov", "gyroscope": "heavy_top",
    "cradle": "newtons_cradle", "linkage": "four_bar", "heap": "heap",
}  # fmt: skip
"""Examples that may be chosen on the page, by what they are called there."""
_LONGEST_CALL: Final = 0.02  # [s] of a kernel in Python: what has taken longer is compiled
_VISER_HINT: Final = 'the browser scene needs viser: pip install "particlerb[view]"'


def view_command(options: argparse.Namespace) -> int:
    """`view`: serve the page until Ctrl-C."""
    try:
        import viser  # noqa: F401

        from particlerb.compiled.plain import time_in_python
        from particlerb.view.access import Access, AccessError
        from particlerb.view.server import listening
    except ImportError:
        raise Ending(_VISER_HINT, FAILED) from None
    with ending(ValueError, about="--allow-host"):
        access = Access(options.host, options.hosts, not options.no_token)
    text = ""
    if options.no_token:
        who = "every user of this machine" if access.is_local else "everyone who reaches it"
        text = f"--no-token lets {who} push the bodies and save sessions"
    elif not access.is_local:
        text = f"{options.host} is open to the network, unencrypted: who sees the traffic sees the"
        text += " token, and can push the bodies and save sessions"
    if text:
        print(f"particlerb: warning: {text}", file=sys.stderr)
    is_file = Path(options.case).suffix.lower() in TRAJECTORY_SUFFIXES
    with (
        ending(AccessError, code=FAILED),
        listening(access, options.port) as server,
        time_in_python(math.inf, _LONGEST_CALL),  # a page that compiles stands still
    ):
        return _play(options, server, access) if is_file else push(options, server, access)


def push(options: argparse.Namespace, server: "viser.ViserServer", access: "Access") -> int:
    """Serve a case, and the scenes that are chosen on its page after it."""
    live = _live(options, server)
    with open_to(access, options.no_browser):
        while True:
            live.go()
            _save(live)
            if live.chosen is None:
                break
            live.say(f"preparing {live.chosen}: the first start compiles, for a minute or more")
            live.write_status("")
            options.case, options.overrides = SCENES[live.chosen], []
            live = _live(options, server)
    if not live.is_over:  # a signal has ended it
        live.stop()
        _save(live)
    return DONE


def _live(options: argparse.Namespace, server: "viser.ViserServer") -> "Live":
    """The page of a case, made ready."""
    from particlerb.view.live import Live, rehearse

    case = read_case(options)
    stem = case.path.stem if case.path else "case"
    name = next((key for key, value in SCENES.items() if value == stem), stem)
    path = Path(options.output) if options.output else Path("output") / f"{stem}_session.toml"
    to_write(path, overwrite=True)  # where it exists, a number is added
    with ending(CaseError):
        system = to_system(case)
        print("preparing ...", file=sys.stderr)
        rehearse(system)
        server.gui.reset()  # long after its last update: a browser misses a field that is gone
        server.scene.reset()
        return Live(system, server, path, list(dict.fromkeys((name, *SCENES))))


def _save(live: "Live") -> None:
    """Keep what was pushed and not saved."""
    if not live.is_saved:
        with contextlib.suppress(ValueError):
            live.save()
            print(live.message)


def _play(options: argparse.Namespace, server: "viser.ViserServer", access: "Access") -> int:
    """Serve a file."""
    from particlerb.view.replay import Replay, ReplayError

    with opened(options.case, True) as trajectory:
        with ending(ReplayError, about=options.case):
            replay = Replay(trajectory, server, Path(options.case))
        with open_to(access, options.no_browser):
            replay.go()
    return DONE


@contextlib.contextmanager
def open_to(access: "Access", no_browser: bool) -> Iterator[None]:
    """Say where the page is, and open it where there is a display; until Ctrl-C or SIGTERM."""
    from particlerb.view.showing import in_browser

    addresses = access.addresses()
    print("open this address in a browser; Ctrl-C ends", *addresses, sep="\n", flush=True)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with contextlib.nullcontext() if no_browser else in_browser(addresses[0]):
            yield
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)
