"""Command `view`: a case that can be pushed, or a file that is played, in the browser."""

import argparse
import contextlib
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli.common import opened, read_case, to_write
from particlerb.cli.exit_codes import DONE, FAILED, Ending, ending
from particlerb.cli.guard import FILES, probe

if TYPE_CHECKING:
    from particlerb.view.access import Access
    from particlerb.view.page import Page

_MISSING: Final = 'the browser scene needs viser: pip install "particlerb[view]"'


def view_command(options: argparse.Namespace) -> int:
    """`view`: serve the page until Ctrl-C."""
    try:
        import viser  # noqa: F401

        from particlerb.view.access import Access, AccessError
        from particlerb.view.server import listening
    except ImportError:
        raise Ending(_MISSING, FAILED) from None
    try:
        access = Access(options.host, options.hosts, not options.no_token)
    except ValueError as error:
        raise Ending(f"--allow-host: {error}") from None
    if options.no_token:
        who = "every user of this machine" if access.is_local else "everyone who reaches it"
        print(
            f"particlerb: warning: --no-token lets {who} push the bodies and save sessions",
            file=sys.stderr,
        )
    elif not access.is_local:
        print(
            f"particlerb: warning: {options.host} is open to the network, unencrypted: who sees the"
            " traffic sees the token, and can push the bodies and save sessions",
            file=sys.stderr,
        )
    is_file = Path(options.case).suffix.lower() in FILES
    try:
        with listening(access, options.port) as server:
            return _play(options, server, access) if is_file else push(options, server, access)
    except AccessError as error:
        raise Ending(str(error), FAILED) from None


def push(options: argparse.Namespace, server: object, access: "Access") -> int:
    """Serve a case."""
    from particlerb.view.live import Live, rehearse

    case = read_case(options)
    stem = case.path.stem if case.path else "case"
    path = Path(options.output) if options.output else Path("output") / f"{stem}_session.toml"
    to_write(path, overwrite=True)  # where it exists, a number is added
    with ending(CaseError):
        print("making ready (the first time compiles, some 15 s or longer) ...", file=sys.stderr)
        system = to_system(case)
        rehearse(system)
        live = Live(system, server, path)  # type: ignore[arg-type]
    serve(live, access)
    if not live.is_saved:
        with contextlib.suppress(ValueError):
            live.save()
            print(live.message)
    return DONE


def _play(options: argparse.Namespace, server: object, access: "Access") -> int:
    """Serve a file."""
    from particlerb.view.replay import Replay, ReplayError

    probe(Path(options.case))
    with opened(options.case) as trajectory:
        try:
            replay = Replay(trajectory, server, Path(options.case))  # type: ignore[arg-type]
        except ReplayError as error:
            raise Ending(f"{options.case}: {error}") from None
        serve(replay, access)
    return DONE


def serve(page: "Page", access: "Access") -> None:
    """Say where the page is, and keep it up to date until Ctrl-C or SIGTERM."""
    print("open this address in a browser; Ctrl-C ends", *access.addresses(), sep="\n", flush=True)
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        page.go()
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGTERM, before)
    page.stop()
