"""Where the page is served, and what happens to messages that no page would send."""

import contextlib
import threading
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser")

import msgspec
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from particlerb.case.reader import load
from particlerb.view.live import Live
from particlerb.view.server import finite, listening, vector

CASES = Path(__file__).parents[2] / "cases"
NAN = float("nan")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The paper's cube on a served page, without a browser."""
    case = load(CASES / "cube_at_rest.toml")
    with listening("127.0.0.1", 8300) as server:
        live = Live(case, server, tmp_path_factory.mktemp("s") / "session.toml")
        live.is_running = False
        thread = threading.Thread(target=live.go, daemon=True)
        thread.start()
        yield live
        live.stop()
        thread.join(10.0)
        assert not thread.is_alive()


def send(live, *messages):
    """What a client sends before it goes away."""
    url = f"ws://127.0.0.1:{live.server.get_port()}"
    with connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as client:
        for message in (CAMERA, *messages):  # it is heard after it has shown a camera
            with contextlib.suppress(ConnectionClosed):
                client.send(message)
                time.sleep(0.1)


def packed(**fields):
    return msgspec.msgpack.encode(fields)


CAMERA = packed(
    type="ViewerCameraMessage", wxyz=(1.0, 0.0, 0.0, 0.0), position=(5.0, 0.0, 0.0), fov=1.0,
    near=0.1, far=100.0, image_height=100, image_width=100, look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)  # fmt: skip


def click(origin, direction, **more):
    """A click on the first body."""
    fields = {"type": "SceneNodeClickMessage", "name": "/bodies/0", "instance_index": 0,
              "ray_origin": origin, "ray_direction": direction, "screen_pos": (0.5, 0.5),
              "modifier": None, "owner": ""}  # fmt: skip
    return packed(**(fields | more))


def field(handle, value, name="value"):
    return packed(type="GuiUpdateMessage", uuid=handle._impl.uuid, updates={name: value})


def test_garbage_neither_ends_nor_changes_the_scene(page):
    before = [values.copy() for values in page.session.frame[:4]]
    c = page.controls
    rng = np.random.default_rng(0)
    garbage = [rng.bytes(n) for n in (0, 1, 7, 1000, 100_000)]
    wrong = [
        "text", packed(), packed(type="NoSuchMessage"), packed(type="SceneNodeClickMessage"),
        msgspec.msgpack.encode([1, 2, 3]), packed(type=7),
        click((NAN, NAN, NAN), (NAN, 0.0, 0.0)), click((1e308, 0.0, 0.0), (-1e308, 0.0, 0.0)),
        click((5.0, 0.0, 0.0), (0.0, 0.0, 0.0)), click("abc", {"x": 1}),
        click((5.0, 0.0, 0.0), (-1.0, 0.0, 0.0), name="/nothing"),
        field(c.digits, NAN), field(c.digits, "x"), field(c.digits, 2**63),
        field(c.speed, "nan"), field(c.speed, "-1"), field(c.gravity, [1, 2]),
        field(c.force, {"a": 1}), field(c.direction, "sideways"), field(c.body, "no such body"),
        packed(type="GuiUpdateMessage", uuid="no such field", updates={"value": 1}),
        field(c.force, "x", "no such property"),
    ]  # fmt: skip
    for message in (*garbage, *wrong):
        send(page, message)
    assert not page.session.applied
    assert all((a == b).all() for a, b in zip(before, page.session.frame[:4], strict=True))
    c.direction.value, c.force.value, c.gravity.value = "+z", "50", False
    send(page, click((5.0, 0.1, 0.1), (-1.0, 0.0, 0.0)))  # and a right one is taken
    end = time.monotonic() + 10.0
    while not page.session.applied and time.monotonic() < end:
        time.sleep(0.05)
    assert page.session.applied[0].blow.at == pytest.approx((0.5, 0.1, 0.1))


def test_only_this_machine_is_listened_to(page):
    assert page.server.get_host() == "127.0.0.1"


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999", "", "x", "1 2", "0x10", None])
def test_fields_take_finite_numbers(text):
    with pytest.raises(ValueError, match="force must be"):
        finite(text, "force")


def test_fields_keep_every_digit():
    assert finite("0.1234567890123456789", "force") == 0.1234567890123456789
    assert vector("0.2, 0.2 -0.5", "point") == (0.2, 0.2, -0.5)
    for text in ("1, 2", "1 2 3 4", "1, nan, 2"):
        with pytest.raises(ValueError, match="point must be"):
            vector(text, "point")
