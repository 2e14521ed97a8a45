"""Pages that a program opens: a trajectory played from Python, a browser on a screen."""

import contextlib
import os
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Iterator
from html import escape
from pathlib import Path

from particlerb.files import Closing
from particlerb.record.trajectory import Trajectory
from particlerb.view.access import Access
from particlerb.view.replay import Replay
from particlerb.view.server import listening


class Shown(Closing):
    """A trajectory on a page of this machine, until it is closed or the program ends.

    Attributes
    ----------
    address : str
        Of the page, with the token that lets a browser in.
    """

    def __init__(self, trajectory: Trajectory, port: int, browser: bool) -> None:
        access = Access()
        with contextlib.ExitStack() as stack:
            server = stack.enter_context(listening(access, port))
            self._replay = Replay(trajectory, server, Path(trajectory.path or "trajectory.h5"))
            self.address = access.addresses()[0]
            if browser:
                stack.enter_context(in_browser(self.address))
            self._thread = threading.Thread(target=self._replay.go, daemon=True)
            self._thread.start()
            self._open = stack.pop_all()

    def __repr__(self) -> str:
        """Where the page is."""
        return f"<a trajectory on {self.address}>"

    def _repr_html_(self) -> str:
        """A link, for notebooks."""
        return f'<a href="{escape(self.address)}" target="_blank">the trajectory on a page</a>'

    def wait(self) -> None:
        """Serve the page until Ctrl-C, then close it: for scripts, which would end."""
        with contextlib.suppress(KeyboardInterrupt):
            self._thread.join()
        self.close()

    def close(self) -> None:
        """Stop the page; the trajectory stays open."""
        self._replay.stop()
        self._thread.join()
        self._open.close()


@contextlib.contextmanager
def in_browser(address: str) -> Iterator[None]:
    """Open an address where there is a screen, by a file that only this user can read."""
    with tempfile.TemporaryDirectory() as folder:
        if _has_display():
            door = Path(folder) / "particlerb.html"
            door.write_text(f'<meta http-equiv="refresh" content="0;url={address}">')
            webbrowser.open(door.as_uri())
        yield


def _has_display() -> bool:
    """Whether there is a screen for a browser."""
    names = "DISPLAY", "WAYLAND_DISPLAY"
    return sys.platform in ("darwin", "win32") or any(map(os.environ.get, names))
