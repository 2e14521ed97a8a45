"""Who may come in: host, origin and token of every request; the attack, and the proof."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("viser")

import h5py
import msgspec
import viser
import websockets.asyncio.server
import zstandard
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect

import particlerb
from particlerb.cli import main
from particlerb.record.trajectory import open_trajectory
from particlerb.view.access import Access, AccessError, authority
from particlerb.view.replay import Replay
from particlerb.view.server import listening

ROOT = Path(__file__).parents[2]
PROTOCOL = [f"viser-v{viser.__version__}"]
CAMERA = {"type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (5.0, 0.0, 0.0),
          "fov": 1.0, "near": 0.1, "far": 100.0, "image_height": 100, "image_width": 100,
          "look_at": (0.0, 0.0, 0.0), "up_direction": (0.0, 0.0, 1.0)}  # fmt: skip
CLICK = {"type": "SceneNodeClickMessage", "name": "/bodies/0", "instance_index": 0,
         "ray_origin": (5.0, 0.1, 0.1), "ray_direction": (-1.0, 0.0, 0.0),
         "screen_pos": (0.5, 0.5), "modifier": None, "owner": ""}  # fmt: skip


def heard(client):
    """Messages of the server in the next window."""
    raw = client.recv(timeout=10.0)
    size, packed = (int.from_bytes(raw[k : k + 8], "little") for k in (0, 8))
    plain = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
    return msgspec.msgpack.decode(plain)["messages"]


def push_and_save(url, **how):
    """What a hostile page does: find the button, push, save."""
    with connect(url, subprotocols=PROTOCOL, max_size=None, **how) as client:
        client.send(msgspec.msgpack.encode(CAMERA))
        save = None
        while save is None:
            for message in heard(client):
                if str(message.get("props", {}).get("label", "")).startswith("save the session"):
                    save = message["uuid"]
        client.send(msgspec.msgpack.encode(CLICK))
        update = {"type": "GuiUpdateMessage", "uuid": save, "updates": {"value": True}}
        for _ in range(20):
            time.sleep(0.25)
            client.send(msgspec.msgpack.encode(update))


@pytest.mark.slow
def test_no_page_of_another_site_pushes(tmp_path):
    """Over the command as it is started: a foreign origin, a foreign host, no token; then ours."""
    process = subprocess.Popen(
        [sys.executable, "-u", "-m", "particlerb", "view", "--port", "8520"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    try:
        printed = ""
        while "http" not in printed:
            printed = process.stdout.readline()
            assert printed, "it ended"
        url = printed.strip().replace("http", "ws", 1)
        port = re.search(r":(\d+)", url.removeprefix("ws:"))[1]
        assert url.startswith("ws://127.0.0.1:")
        bare = url.partition("?")[0]
        hostile = [
            (url, {"origin": "http://evil.example"}),
            (url, {"origin": f"http://localhost:{port}"}),  # a site of its own
            (url, {"additional_headers": {"Host": f"evil.example:{port}"}}),
            (bare, {"origin": f"http://127.0.0.1:{port}"}),
        ]
        for where, how in hostile:
            with pytest.raises(InvalidStatus, match="403"):
                push_and_save(where, **how)
            assert not list(tmp_path.iterdir()), how
        push_and_save(url, origin=f"http://127.0.0.1:{port}")
        assert list(tmp_path.glob("output/*_session.toml"))
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
        process.stdout.close()


@pytest.fixture(scope="module")
def door():
    """A page of which only the door is looked at."""
    access = Access(names=["tunnel.example.org"])
    with listening(access, 8530):
        yield access


def status(access, *lines, path=None):
    """Answer to a request of these header lines, as they stand."""
    path = f"/?token={access.token}" if path is None else path
    with socket.create_connection(("127.0.0.1", access.port), 10.0) as line:
        line.sendall("\r\n".join([f"GET {path} HTTP/1.1", *lines, "", ""]).encode("latin-1"))
        line.settimeout(10.0)
        data = b""
        while b"\r\n\r\n" not in data and (more := line.recv(65536)):
            data += more
    return int(data.split()[1]) if data else 0, data.decode("latin-1")


HOSTS = {
    "127.0.0.1:{port}": 200, "localhost:{port}": 200, "LocalHost:{port}": 200, "localhost": 200,
    "localhost.:{port}": 200, "[::1]:{port}": 200, "[0:0:0:0:0:0:0:1]:{port}": 200,
    "127.0.0.1:9": 200, "127.9.9.9:{port}": 200, "tunnel.example.org": 200,
    "TUNNEL.example.org.:443": 200,
    "evil.example:{port}": 403, "127.0.0.1.evil.example": 403, "localhost.evil.example": 403,
    "evil.tunnel.example.org": 403, "xlocalhost:{port}": 403, "0.0.0.0:{port}": 403,
    "192.168.1.1:{port}": 403, "127.1:{port}": 403, "2130706433": 403, "0x7f000001": 403,
    "0177.0.0.1": 403, "[::]:{port}": 403, "[::1": 403, "::1": 403, "[fe80::1%25lo]:{port}": 403,
    "[::ffff:127.0.0.1]:{port}": 403, "localhost..": 403, "localhost:": 403, "localhost:x": 403,
    "localhost:0": 403, "localhost:70000": 403, "localhost:{port}:1": 403, "": 403, ".": 403,
    "user@localhost:{port}": 403, "localhost/": 403, "localhost, evil.example": 403,
    "localhost\tevil": 403, "http://localhost": 403, "l\u00f6calhost": 403, "*": 403, "null": 403,
}  # fmt: skip


@pytest.mark.parametrize(("host", "code"), HOSTS.items())
def test_hosts(door, host, code):
    assert status(door, f"Host: {host.format(port=door.port)}")[0] == code


def test_a_host_is_named_once(door):
    good = f"Host: 127.0.0.1:{door.port}"
    assert status(door, good)[0] == 200
    assert status(door)[0] == 403
    assert status(door, good, good)[0] == 403
    assert status(door, good, "Host: evil.example")[0] == 403
    assert status(door, "Host: evil.example", good)[0] == 403
    assert status(door, "X-Forwarded-Host: localhost", "Host: evil.example")[0] == 403


ORIGINS = {
    "http://127.0.0.1:{port}": 200, "HTTP://127.0.0.1:{port}": 200, "https://127.0.0.1:{port}": 200,
    "http://tunnel.example.org": 200, "https://tunnel.example.org:8443": 200,
    "http://localhost:{port}": 403, "http://127.0.0.1": 403, "http://127.0.0.1:9": 403,
    "http://evil.example": 403, "http://evil.example:{port}": 403, "null": 403, "": 403,
    "file://": 403, "127.0.0.1:{port}": 403, "ws://127.0.0.1:{port}": 403,
    "chrome-extension://127.0.0.1:{port}": 403, "http://127.0.0.1:{port}/": 403,
    "http://127.0.0.1:{port}.evil.example": 403, "http://127.0.0.1:{port}@evil.example": 403,
    "http://[::1]:{port}": 403, "http://evil.tunnel.example.org": 403, "http://": 403,
    "http://127.0.0.1:{port} http://evil.example": 403,
}  # fmt: skip


@pytest.mark.parametrize(("origin", "code"), ORIGINS.items())
def test_origins(door, origin, code):
    lines = f"Host: 127.0.0.1:{door.port}", f"Origin: {origin.format(port=door.port)}"
    assert status(door, *lines)[0] == code
    upgrade = (
        "Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: cGFydGljbGVyYiAgICAgIA==", f"Sec-WebSocket-Protocol: {PROTOCOL[0]}",
    )  # fmt: skip
    assert status(door, *lines, *upgrade)[0] == (101 if code == 200 else 403)
    assert status(door, *lines, lines[1])[0] == 403  # twice


def test_another_name_is_another_origin(door):
    """Behind a proxy that keeps the host; without a port it is that of the scheme."""
    for host, origin, code in (
        ("tunnel.example.org", "https://tunnel.example.org", 200),
        ("tunnel.example.org", "https://tunnel.example.org:8443", 403),
        ("tunnel.example.org:8443", "https://tunnel.example.org:8443", 200),
        ("tunnel.example.org", "http://127.0.0.1", 403),
    ):
        assert status(door, f"Host: {host}", f"Origin: {origin}")[0] == code, (host, origin)


def test_the_token_and_then_the_cookie(door):
    host, name = f"Host: 127.0.0.1:{door.port}", f"particlerb-{door.port}"
    _, answer = status(door, host)
    (cookie,) = re.findall(r"(?im)^set-cookie: (.*)\r$", answer)
    assert cookie == f"{name}={door.token}; Path=/; HttpOnly; SameSite=Strict"
    assert len(door.token) == 48
    for path, jar, wanted in (
        ("/", f"{name}={door.token}", 200),
        ("/", f"_xsrf=1; a b=c; {name}=wrong; {name}={door.token}", 200),
        ("/", f"{name}={door.token[:-1]}", 403),
        ("/", f"particlerb-1={door.token}", 403),
        ("/", "", 403),
        ("/index.html", f"{name}={door.token}", 200),
        ("/nothing", f"{name}={door.token}", 404),
        ("/%2e%2e/%2e%2e/__init__.py", f"{name}={door.token}", 404),
        (f"/?token={door.token[:-1]}", "", 403),
        (f"/?token={door.token[:-1]}", f"{name}={door.token}", 403),
        (f"/?token={door.token.upper()}", "", 403),
        (f"/?token={door.token}&token={door.token}", "", 403),
        (f"/?token={door.token}&websocket=ws://evil.example", "", 403),
        ("/?websocket=ws://evil.example", f"{name}={door.token}", 403),
        ("/?playbackPath=https://evil.example/x", f"{name}={door.token}", 403),
        ("/?token=", "", 403),
        ("/?token", "", 403),
        ("/?token=%ff%00", "", 403),
        (f"http://evil.example/?token={door.token}", "", 403),
        (f"*?token={door.token}", "", 403),
    ):
        assert status(door, host, f"Cookie: {jar}", path=path)[0] == wanted, (path, jar)


def test_headers_of_every_answer(door):
    for lines, code in (((f"Host: 127.0.0.1:{door.port}",), 200), (("Host: evil.example",), 403)):
        found, answer = status(door, *lines)
        assert found == code
        head = answer.partition("\r\n\r\n")[0].lower()
        assert "frame-ancestors 'none'" in head
        for line in (
            "x-content-type-options: nosniff", "referrer-policy: no-referrer",
            "cache-control: no-store", "x-frame-options: deny",
            "cross-origin-resource-policy: same-origin",
        ):  # fmt: skip
            assert line in head
        assert ("set-cookie" in head) == (code == 200)


def asked(access, host):
    """Why a request of a host is refused."""
    return access.refusal(Request("/", Headers([("Host", host)])))


def test_open_to_the_network_addresses_are_hosts_and_names_are_not():
    access = Access("0.0.0.0", with_token=False)
    for host in ("192.168.1.7:8080", "[fe80::1]:8080", "localhost", socket.gethostname()):
        assert not asked(access, host), host
    assert "--allow-host" in asked(access, "evil.example")
    assert asked(Access("192.168.1.7", with_token=False), "192.168.1.7:8080") == ""
    assert "token" in asked(Access("192.168.1.7"), "192.168.1.7:8080")


def test_addresses_are_whole():
    access = Access("::1")
    access.port = 8080
    assert access.addresses() == [f"http://[::1]:8080/?token={access.token}"]
    access = Access("0.0.0.0", with_token=False)
    access.port = 1
    assert access.addresses() == ["http://127.0.0.1:1/", f"http://{socket.gethostname()}:1/"]
    assert Access().token != Access().token


@pytest.mark.parametrize("name", ["", "a b", "http://a", "a:80", "a/b", "*", "[::1]:80"])
def test_allowed_names_are_names(name, capsys):
    with pytest.raises(ValueError, match="is not a host"):
        Access(names=[name])
    assert main(["view", "--allow-host", name]) == 2
    assert "--allow-host" in capsys.readouterr().err


def test_ipv6_names_are_allowed():
    assert Access(names=["2001:DB8::1", "[2001:db8::2]", "Hub.Example."]).named == {
        "2001:db8::1", "2001:db8::2", "hub.example",
    }  # fmt: skip
    assert authority("[2001:db8:0:0::1]:80") == ("2001:db8::1", 80)


def unguarded(serve):
    """A later viser that gives `websockets` its own hook at another place."""

    def other(handler, *arguments, process_request=None, **options):
        return serve(handler, *arguments, **options)

    return other


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch, tmp_path, capsys):
    serve = websockets.asyncio.server.serve
    monkeypatch.setattr(websockets.asyncio.server, "serve", unguarded(serve))
    with (
        pytest.raises(AccessError, match="does not let the page be guarded"),
        listening(Access(), 8540),
    ):
        pass
    monkeypatch.chdir(tmp_path)
    assert main(["view", "--port", "8550"]) == 1
    said = capsys.readouterr()
    assert "does not let the page be guarded" in said.err.splitlines()[-1]
    assert "http" not in said.out
    with pytest.raises(AccessError), listening(Access(with_token=False), 8540):
        pass


def test_without_a_token_origins_are_still_asked(capsys):
    access = Access(with_token=False)
    with listening(access, 8560):
        host = f"Host: 127.0.0.1:{access.port}"
        assert status(access, host, path="/")[0] == 200
        assert status(access, host, "Origin: http://evil.example", path="/")[0] == 403
        assert status(access, "Host: evil.example", path="/")[0] == 403
        assert "set-cookie" not in status(access, host, path="/")[1].lower()


def test_names_that_no_case_could_have_do_not_reach_the_page(tmp_path):
    """Twice the same name, and a list of them is an error of the whole page in the browser."""
    body = {"shape": {"type": "moments", "inertia": [1, 2, 2]}, "mass": 1.0}
    bodies = [{"name": "a", **body}, {"name": "b", "position": [3, 0, 0], **body}]
    path = tmp_path / "run.h5"
    particlerb.run({"run": {"t_end": 1.0, "every": 0.5}, "body": bodies}, path).close()
    with h5py.File(path, "r+") as file:
        file["bodies/names"][:] = [b"x", b"x"]
    access = Access()
    with open_trajectory(path) as trajectory, listening(access, 8570) as server:
        replay = Replay(trajectory, server, path)
        assert replay.names == ["a", "b"] == list(replay.body_field.options)
