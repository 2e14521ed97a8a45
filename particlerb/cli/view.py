"""Command `view`: a case that can be pushed, or a file that is played, in the browser."""

import argparse
import contextlib
import math
import signal
import sys
import time
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

    from particlerb.model.system import System
    from particlerb.view.access import Access
    from particlerb.view.live import Live

SCENES: Final = {
    "cube": "cube_at_rest", "T-handle": "t_handle", "gyroscope": "heavy_top",
    "cradle": "newtons_cradle", "linkage": "four_bar", "heap": "heap",
}  # fmt: skip
"""Examples that may be chosen on the page, by what they are called there."""
_LONGEST_CALL: Final = 0.02  # [s] of a kernel in Python: what has taken longer is compiled
_UPDATES_ON_THE_WAY: Final = 0.2  # [s]: a browser misses a field that is gone
_VISER_HINT: Final = 'the browser scene needs viser: pip install "particlerb[view]"'


def view_command(options: argparse.Namespace) -> int:
    """`view`: serve the page until Ctrl-C."""
    try:
        import viser  # noqa: F401

        from particlerb.compiled.plain import time_in_python
        from particlerb.view.access import Access, AccessError
        from particlerb.view.server import listening, refuse_foreign
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
    refuse_foreign(access.host)
    with time_in_python(math.inf, _LONGEST_CALL):  # a page that compiles stands still
        # before there are threads of a server, beside which no copy of a process compiles
        system = None if is_file else _rehearsed(_read(options))
        with ending(AccessError, code=FAILED), listening(access, options.port) as server:
            if system is None:
                return _play(options, server, access)
            return push(options, server, access, system)


def push(
    options: argparse.Namespace, server: "viser.ViserServer", access: "Access", system: "System"
) -> int:
    """Serve a case, and the scenes that are chosen on its page after it."""
    live = _live(options, server, system)
    with open_to(access, options.no_browser):
        while True:
            live.go()
            _save(live)
            if live.chosen is None:
                break
            live.say(f"preparing {live.chosen}")
            live.write_status("")
            options.case, options.overrides = SCENES[live.chosen], []
            system = _rehearsed(_read(options), server, live.chosen)
            _clear(server)
            live = _live(options, server, system)
    if not live.is_over:  # a signal has ended it
        live.stop()
        _save(live)
    return DONE


def _read(options: argparse.Namespace) -> "System":
    """The system of a case."""
    with ending(CaseError):
        system = to_system(read_case(options))
    to_write(_path(options, system), overwrite=True)  # where it exists, a number is added
    return system


def _rehearsed(
    system: "System", server: "viser.ViserServer | None" = None, name: str = ""
) -> "System":
    """A system whose kernels are there; meanwhile its bodies stand on the page of a server."""
    from particlerb.view.live import rehearse
    from particlerb.view.page import Preparing

    print("preparing ...", file=sys.stderr)
    if server is not None:
        _clear(server)
        Preparing(server, system, name)
    with ending(CaseError):
        rehearse(system)
    return system


def _clear(server: "viser.ViserServer") -> None:
    """Take everything off a page."""
    time.sleep(_UPDATES_ON_THE_WAY)
    server.gui.reset()
    server.scene.reset()


def _live(options: argparse.Namespace, server: "viser.ViserServer", system: "System") -> "Live":
    """The page of a case, which is ready."""
    from particlerb.view.live import Live

    stem = _stem(system)
    name = next((key for key, value in SCENES.items() if value == stem), stem)
    names = list(dict.fromkeys((name, *SCENES)))
    with ending(CaseError):
        return Live(system, server, _path(options, system), names)


def _stem(system: "System") -> str:
    """Name of the file of a case."""
    path = system.source.path
    return path.stem if path else "case"


def _path(options: argparse.Namespace, system: "System") -> Path:
    """Where a session is saved."""
    return Path(options.output or Path("output") / f"{_stem(system)}_session.toml")


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
