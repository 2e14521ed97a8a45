"""A viser server for one page: how it starts, and how it reads what fields say."""

import asyncio
import contextlib
import io
import logging
import socket
from collections.abc import Iterator
from typing import Any

import viser

from particlerb.view.access import Access
from particlerb.view.messages import Sieve


@contextlib.contextmanager
def listening(access: Access, port: int) -> Iterator[viser.ViserServer]:
    """A server of a page, stopped at the end; takes the next free port where one is taken.

    Raises
    ------
    OSError
        If it cannot listen there.
    AccessError
        If it lets in whom `access` does not.
    """
    refuse_foreign(access.host)
    sieve = Sieve()
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a broken message ends its sender
    with (
        contextlib.redirect_stdout(io.StringIO()),  # viser announces itself in a box
        access.guarding(sieve),
    ):
        server = viser.ViserServer(host=access.host, port=port, label="particlerb", verbose=False)
    access.port, sieve.server = server.get_port(), server
    server.get_event_loop().set_exception_handler(ignore)
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(214, 106, 14))
    server.scene.set_up_direction("+z")
    try:
        access.prove()
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def refuse_foreign(host: str) -> None:
    """Raise OSError where this machine has no such address: a thread of viser would not say so."""
    try:
        family, kind, _, _, place = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(place)
    except OSError as error:
        raise OSError(f"cannot listen on {host}: {error.strerror}") from None


def ignore(_: asyncio.AbstractEventLoop, __: dict[str, Any]) -> None:
    """Leave out what a malformed message makes of viser; the page goes on."""


def finite(text: str, what: str) -> float:
    """The number that a field of the page says.

    Raises
    ------
    ValueError
        If it is none, or not finite.
    """
    try:
        value = float(str(text)[:100])
    except ValueError:
        raise ValueError(f"{what} must be a number, got {str(text)[:40]!r}") from None
    if value - value != 0.0:
        raise ValueError(f"{what} must be finite, got {text!r}")
    return value


def vector(text: str, what: str) -> tuple[float, float, float]:
    """The three numbers that a field of the page says.

    Raises
    ------
    ValueError
        If there are not three, or one is none or not finite.
    """
    words = str(text)[:300].replace(",", " ").split()
    if len(words) != 3:
        raise ValueError(f"{what} must be three numbers x, y, z, got {len(words)}")
    x, y, z = (finite(word, what) for word in words)
    return x, y, z
