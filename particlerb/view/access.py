"""Who may come in: every request, for the page and for its socket, is asked what it says of itself.

A page of another site runs in the same browser and reaches every port of this machine, by its
number or by a name that was turned to it (DNS rebinding). So a request must name a host that is
ours, come from no other origin, and bring the token of the printed address, or the cookie that the
page got for it. viser has no place for such questions, but what it gives to `websockets` passes
through here. Knows no scene.

Why it is so: docs/decisions/0014.
"""

import contextlib
import hmac
import http
import http.client
import ipaddress
import re
import secrets
import socket
import threading
from collections.abc import Awaitable, Callable, Iterable, Iterator
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qsl, urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

_LOCAL_HOST: Final = "127.0.0.1"
_EVERYWHERE_HOSTS: Final = ("0.0.0.0", "::", "")
_AUTHORITY: Final = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9_.-]+)(?::([0-9]{1,5}))?")
_MAX_MESSAGE_BYTES: Final = 8 * 2**20  # a picture of a frame
_PROBE_TIMEOUT: Final = 5.0  # [s] that an answer to ourselves may take
POLICY: Final = "; ".join([
    "default-src 'none'",
    "script-src 'unsafe-inline' 'unsafe-eval'",  # viser's page unpacks itself
    "style-src 'unsafe-inline'",
    "img-src 'self' data: blob:",
    "font-src data:",
    "connect-src 'self' data: blob:",
    "worker-src blob:",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
])  # fmt: skip
HEADERS: Final = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
_FOREIGN_HOST: Final = "particlerb.invalid"  # no machine has this name: RFC 2606

_Hook = Callable[[ServerConnection, Request], Awaitable[Response | None] | Response | None]
_Handler = Callable[[ServerConnection], Awaitable[None]]
Message = str | bytes
_START_LOCK: Final = threading.Lock()  # one server at a time passes through here


class AccessError(Exception):
    """A server that lets in whom it should not: why."""


class _Authority(NamedTuple):
    """A host, and the port if one is named."""

    name: str  # lower case; an address as `ipaddress` writes it
    port: int | None

    @property
    def address(self) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
        """The address that the name is, if it is one."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.name)
        return None


def authority(text: str) -> _Authority | None:
    """What a Host header or an origin names; None where it names nothing, or oddly."""
    match = _AUTHORITY.fullmatch(text.lower())
    if match is None:
        return None
    name, port = match[1], match[2]
    if port is not None and not 1 <= int(port) <= 65535:
        return None
    try:
        if name.startswith("["):
            name = str(ipaddress.IPv6Address(name[1:-1]))
        elif name[-1].isdigit():  # as browsers do, who take 127.1 for an address
            name = str(ipaddress.IPv4Address(name))
        else:
            name = name.removesuffix(".")  # the name of the root
    except ValueError:
        return None
    return _Authority(name, None if port is None else int(port)) if name else None


def _origin_of(text: str) -> _Authority | None:
    """Host and port of an origin, the port of its scheme if none is named; None for `null`."""
    scheme, mark, rest = text.partition("://")
    ports = {"http": 80, "https": 443}
    address = authority(rest)
    if not mark or scheme.lower() not in ports or address is None:
        return None
    return address._replace(port=address.port or ports[scheme.lower()])


class Access:
    """Who may see a page and push on it.

    Parameters
    ----------
    host : str
        Address on which the page is served.
    names : iterable of str
        Further names or addresses by which it may be called, as behind a proxy.
    with_token : bool
        Whether the token of the printed address is asked for.

    Raises
    ------
    ValueError
        If a name is none.
    """

    def __init__(
        self, host: str = _LOCAL_HOST, names: Iterable[str] = (), with_token: bool = True
    ) -> None:
        self.host = host
        self.token = secrets.token_hex(24) if with_token else ""
        self.port = 0  # once it listens
        self.named = {self.read(name) for name in names}
        self.host_names = {"localhost", host.lower()}
        if not self.is_local:
            self.host_names.add(socket.gethostname().lower())

    @staticmethod
    def read(name: str) -> str:
        """A name as requests are compared with it."""
        bare = f"[{name}]" if name.count(":") > 1 and not name.startswith("[") else name
        address = authority(bare)
        if address is None or address.port is not None:
            raise ValueError(f"{name!r} is not a host: a name or an address, without a port")
        return address.name

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the page."""
        with contextlib.suppress(ValueError):
            return ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost"

    @property
    def is_everywhere(self) -> bool:
        """Whether it is served on all addresses of this machine."""
        return self.host in _EVERYWHERE_HOSTS

    @property
    def probe(self) -> str:
        """An address by which this machine reaches the page."""
        if not self.is_everywhere:
            return self.host
        return "::1" if self.host == "::" else _LOCAL_HOST

    def addresses(self) -> list[str]:
        """Where a browser finds the page: on this machine, and from others if they reach it."""
        hosts = [self.probe, *([socket.gethostname()] if self.is_everywhere else [])]
        return [self.address_at(host) for host in hosts]

    def address_at(self, host: str) -> str:
        """Address of the page by a name of its host."""
        name = f"[{host}]" if ":" in host else host
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers give those of one port to all ports of a host."""
        return f"particlerb-{self.port}"

    # The questions

    def refusal(self, request: Request) -> str:
        """Why a request is refused; empty where it is not."""
        hosts = request.headers.get_all("Host")
        origins = request.headers.get_all("Origin")
        host = authority(hosts[0]) if len(hosts) == 1 else None
        if host is None or not self.is_ours(host):
            return "this host is not known here: `view --allow-host NAME` makes it known"
        if len(origins) > 1 or (origins and not self.is_same(_origin_of(origins[0]), host)):
            return "a page of another origin may not ask"
        fields = self.fields(request)
        if fields is None or not request.path.startswith("/"):
            return "there is no such address"
        if self.token and not self.has_token(request, fields):
            return "the token is missing: open the address that `particlerb view` has printed"
        return ""

    def is_ours(self, host: _Authority) -> bool:
        """Whether a host is this one. An address is: no name server turns it to another."""
        if host.name in self.host_names or host.name in self.named:
            return True
        return host.address is not None and (host.address.is_loopback or not self.is_local)

    def is_same(self, origin: _Authority | None, host: _Authority) -> bool:
        """Whether an origin is that of our page: host and port, or a name that was allowed.

        A proxy may have put its own name for ours in the place of the host.
        """
        if origin is None:
            return False
        if origin.name in self.named and host.name not in self.named:
            return True
        ports = {80, 443} if host.port is None else {host.port}
        return origin.name == host.name and origin.port in ports

    @staticmethod
    def fields(request: Request) -> list[str] | None:
        """Tokens that the address names, at most one; None where it names anything else.

        viser's page takes orders from its address: which server to go to, what to play.
        """
        try:
            query = urlsplit(request.path).query
            pairs = parse_qsl(query, True, True, max_num_fields=1) if query else []
        except ValueError:
            return None
        return [value for _, value in pairs] if all(k == "token" for k, _ in pairs) else None

    def has_token(self, request: Request, fields: list[str]) -> bool:
        """Whether the token is in the address or in a cookie."""
        cookies = ";".join(request.headers.get_all("Cookie")).split(";")
        pairs = [cookie.strip().partition("=") for cookie in cookies]
        tokens = fields or [value for name, _, value in pairs if name == self.cookie]
        same = [hmac.compare_digest(_coded(value), _coded(self.token)) for value in tokens]
        return any(same)

    # The place at which they are asked

    def answer(self, hook: _Hook | None) -> _Hook:
        """What `websockets` asks before it opens a socket, in front of what viser gave to it."""

        async def process_request(
            connection: ServerConnection, request: Request
        ) -> Response | None:
            try:
                why = self.refusal(request)
            except Exception:  # what cannot be judged is refused
                why = "the request cannot be understood"
            if why:
                response = connection.respond(http.HTTPStatus.FORBIDDEN, f"403: {why}\n")
            else:
                result = hook(connection, request) if hook else None
                reply = await result if isinstance(result, Awaitable) else result
                if reply is None:
                    return None
                response = reply
            for name, value in HEADERS.items():
                response.headers[name] = value
            if not why and self.token and self.fields(request):
                response.headers["Set-Cookie"] = (
                    f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict"
                )
            return response

        return process_request

    @contextlib.contextmanager
    def guarding(self, sifted: Callable[[Message], bytes | None]) -> Iterator[None]:
        """Stand in front of a server of viser that is started meanwhile.

        Parameters
        ----------
        sifted : callable
            What goes on to viser of a message from a browser; None where nothing does.
        """
        serve: Any = websockets.asyncio.server.serve

        def guarded(handler: _Handler, *arguments: Any, **options: Any) -> Any:
            options["process_request"] = self.answer(options.get("process_request"))
            options["max_size"] = _MAX_MESSAGE_BYTES

            async def heard(connection: ServerConnection) -> None:
                await handler(_Sifting(connection, sifted))  # type: ignore[arg-type]

            return serve(heard, *arguments, **options)

        with _START_LOCK:
            websockets.asyncio.server.serve = guarded  # type: ignore[assignment, misc]
            try:
                yield
            finally:
                websockets.asyncio.server.serve = serve  # type: ignore[misc]

    def prove(self) -> None:
        """Ask the server as foreigners would, and as our page does.

        Raises
        ------
        AccessError
            If it answers one of them otherwise than it must.
        """
        ours = urlsplit(self.address_at(self.probe)).netloc
        query = f"?token={self.token}" if self.token else ""
        foreign = {"Origin": f"http://{_FOREIGN_HOST}"}, {"Host": f"{_FOREIGN_HOST}:{self.port}"}
        refused = [({"Host": ours, **headers}, query) for headers in foreign]
        if self.token:
            refused.append(({"Host": ours}, ""))
        wanted = [(headers, target, (403, 403)) for headers, target in refused]
        for headers, target, codes in (*wanted, ({"Host": ours}, query, (200, 101))):
            answers = self.status(headers, target), self.status({**headers, **_UPGRADE}, target)
            if answers != codes:
                raise AccessError(
                    f"viser {viser.__version__} does not let the page be guarded: a request with"
                    f" {headers} and {'the' if target else 'no'} token is answered by {answers} and"
                    f" not by {codes}; install the range of viser that particlerb asks for"
                )

    def status(self, headers: dict[str, str], target: str) -> int:
        """Code with which a request is answered."""
        line = http.client.HTTPConnection(self.probe, self.port, timeout=_PROBE_TIMEOUT)
        try:
            line.putrequest("GET", f"/{target}", skip_host=True, skip_accept_encoding=True)
            for name, value in headers.items():
                line.putheader(name, value)
            line.endheaders()
            return line.getresponse().status
        except (OSError, http.client.HTTPException):
            return 0
        finally:
            line.close()


class _Sifting:
    """A connection whose messages are looked at before viser gets them."""

    def __init__(
        self, connection: ServerConnection, sifted: Callable[[Message], bytes | None]
    ) -> None:
        self.connection, self.sifted = connection, sifted

    def __getattr__(self, name: str) -> Any:
        """All else is the connection's."""
        return getattr(self.connection, name)

    async def recv(self) -> bytes:
        """What may go on of the next message of which anything may."""
        while True:
            message = self.sifted(await self.connection.recv())
            if message is not None:
                return message


_UPGRADE: Final = {
    "Connection": "Upgrade",
    "Upgrade": "websocket",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "cGFydGljbGVyYiAgICAgIA==",
    "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
}


def _coded(text: str) -> bytes:
    """Bytes of a header."""
    return text.encode("utf-8", "surrogateescape")
