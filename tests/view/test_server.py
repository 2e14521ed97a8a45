"""Where the page is served, and what happens to messages that no page would send."""

import contextlib
import math
import random
import resource
import sys
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
from particlerb.case.to_system import to_system
from particlerb.view.access import Access
from particlerb.view.live import MOST_SAVED, Live
from particlerb.view.messages import Sieve
from particlerb.view.server import finite, listening, vector

pytestmark = pytest.mark.once

CASES = Path(__file__).parents[2] / "cases"
NAN = float("nan")
PAUSE = 0.1  # [s] between messages


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The paper's cube on a served page, without a browser."""
    case = load(CASES / "cube_at_rest.toml")
    access = Access()
    with listening(access, 8300) as server:
        live = Live(to_system(case), server, tmp_path_factory.mktemp("s") / "session.toml")
        live.is_running, live.waits, live.token = False, False, access.token
        thread = threading.Thread(target=live.go, daemon=True)
        thread.start()
        yield live
        live.stop()
        thread.join(10.0)
        assert not thread.is_alive()


def send(live, *messages):
    """What a client sends before it goes away."""
    url = f"ws://127.0.0.1:{live.server.get_port()}/?token={live.token}"
    with connect(url, subprotocols=[f"viser-v{viser.__version__}"], max_size=None) as client:
        for message in (CAMERA, *messages):  # it is heard after it has shown a camera
            with contextlib.suppress(ConnectionClosed):
                client.send(message)
                time.sleep(PAUSE)


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
        field(page.digits, NAN), field(page.digits, "x"), field(page.digits, 2**63),
        field(page.speed_field, "nan"), field(page.speed_field, "-1"), field(c.gravity, [1, 2]),
        field(c.force, {"a": 1}), field(c.direction, "sideways"),
        field(page.body_field, "no such body"),
        packed(type="GuiUpdateMessage", uuid="no such field", updates={"value": 1}),
        field(c.force, "x", "no such property"),
    ]  # fmt: skip
    for message in (*garbage, *wrong):
        send(page, message)
    assert page.session.n_pushes == 0
    assert all((a == b).all() for a, b in zip(before, page.session.frame[:4], strict=True))
    c.direction.value, c.force.value, c.gravity.value = "+z", "50", False
    send(page, click((5.0, 0.1, 0.1), (-1.0, 0.0, 0.0)))  # and a right one is taken
    end = time.monotonic() + 60.0  # it may compile
    while not page.session.n_pushes and time.monotonic() < end:
        time.sleep(0.05)
    assert page.session.last[0].push.at == pytest.approx((0.5, 0.1, 0.1))


def settled(page):
    """Everything on the page that a message can change."""
    gui = page.server.gui
    fields = dict(gui._gui_input_handle_from_uuid)
    own = ("value", "removed", "update_cb", "sync_cb", "is_button", "parent_container_id", "uuid")
    found = {(uuid, name): getattr(h._impl, name) for uuid, h in fields.items() for name in own}
    found |= {(uuid, "type"): type(h._impl.value) for uuid, h in fields.items()}
    found |= {(uuid, "props"): repr(vars(h._impl.props)) for uuid, h in fields.items()}
    return found | {"nodes": sorted(page.server.scene._handle_from_node_name)}


def at_rest(page):
    """The same, once a push of the test before is shown: on a busy machine that takes time."""
    found, before = settled(page), None
    while found != before:
        time.sleep(0.5)
        found, before = settled(page), found
    return found


def hostile_updates(handle):
    """Updates of a field that no page sends."""
    own = {"removed": True, "update_cb": [], "sync_cb": None, "props": 1, "gui_api": None,
           "uuid": "x", "is_button": True, "parent_container_id": "x", "update_timestamp": NAN,
           "__class__": 1, "__dict__": {}, "options": [], "visible": False}  # fmt: skip
    for name, value in own.items():
        yield field(handle, value, name)
    yield packed(type="GuiUpdateMessage", uuid=handle._impl.uuid, updates={"value": "1", **own})
    yield packed(type="GuiUpdateMessage", uuid=handle._impl.uuid, updates={})
    values = [None, [], {}, b"", b"1", [1], {"a": 1}, NAN, math.inf, -1e308, 2**63, -1, "x" * 10**6]
    if not isinstance(handle, viser.GuiTextHandle):
        values.append("1")
    for value in values:
        yield field(handle, value)


def uploads(handle):
    """An upload of an empty file into a field, which then held a file for ever."""
    start = {"source_component_uuid": handle._impl.uuid, "transfer_uuid": "t",
             "filename": "../../x", "mime_type": "text/plain",
             "part_count": 0, "size_bytes": 0}  # fmt: skip
    yield packed(type="FileTransferStartUpload", **start)
    yield packed(type="FileTransferStartUpload", **(start | {"part_count": 1, "size_bytes": 2}))
    yield packed(
        type="FileTransferPart", source_component_uuid=handle._impl.uuid, transfer_uuid="t",
        part_index=0, content=b"xx",
    )  # fmt: skip


def fields_of(page):
    """The fields of the page, without the buttons, which save and step."""
    handles = page.server.gui._gui_input_handle_from_uuid.values()
    kinds = (viser.GuiButtonHandle, viser.GuiButtonGroupHandle)
    return [handle for handle in handles if not isinstance(handle, kinds)]


def test_no_message_breaks_a_field(page, monkeypatch):
    """Any attribute of a field could be set, and an upload turned it into a file, for everyone."""
    monkeypatch.setitem(globals(), "PAUSE", 0.0)
    before = at_rest(page)
    for handle in fields_of(page):
        send(page, *hostile_updates(handle), *uploads(handle))
    buttons = [page.controls.save, page.controls.apply, page.controls.run]
    for handle in buttons:
        send(page, *hostile_updates(handle), *uploads(handle))
    time.sleep(0.5)
    assert settled(page) == before
    send(page, field(page.controls.force, "51"))
    end = time.monotonic() + 10.0
    while page.controls.force.value != "51" and time.monotonic() < end:
        time.sleep(0.05)
    assert page.controls.force.value == "51"
    page.controls.force.value = "50"


def test_no_client_opens_a_tunnel_to_the_net(page, monkeypatch):
    asked = []
    for name in ("request_share_url", "disconnect_share_url"):
        monkeypatch.setattr(viser.ViserServer, name, lambda *a, name=name, **k: asked.append(name))
    send(page, packed(type="ShareUrlRequest"), packed(type="ShareUrlDisconnect"))
    time.sleep(0.3)
    assert not asked


def test_what_follows_a_second_type_is_not_read(page):
    """A key twice: one reader takes the first, another the last. What goes on is written anew."""
    second = b"".join(map(msgspec.msgpack.encode, ("type", "ResetGuiMessage")))
    smuggled = CAMERA[:1].replace(b"\x8a", b"\x8b") + CAMERA[1:] + second
    assert msgspec.msgpack.decode(smuggled)["type"] == "ResetGuiMessage"
    sieve = Sieve()
    sieve.server = page.server
    passed = sieve(smuggled)
    assert passed is None or msgspec.msgpack.decode(passed)["type"] == "ViewerCameraMessage"


def anything(dice, depth=0):
    """A value of any kind."""
    plain = (None, True, 0, -1, 2**63, NAN, math.inf, 1e308, "", "x", "\0", "/bodies/0",
             b"\xff\xd8", "value", "+z", "50", 1.5)  # fmt: skip
    match dice.randrange(6) if depth < 4 else 0:
        case 1:
            return [anything(dice, depth + 1) for _ in range(dice.randrange(5))]
        case 2:
            return {str(anything(dice, 9)): anything(dice, depth + 1) for _ in range(3)}
        case 3:
            return dice.choice(("a", b"a")) * dice.choice((1, 100, 20_000))
    return dice.choice(plain)


def test_a_hostile_client_changes_nothing(page, monkeypatch, tmp_path):
    """2000 messages of all types that viser knows, with fields of the right names."""
    monkeypatch.setitem(globals(), "PAUSE", 0.0)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *a, **k: None)
    dice = random.Random(0)
    known = viser._messages.Message._subclass_from_type_string()
    uuids = [handle._impl.uuid for handle in fields_of(page)]
    before, state = at_rest(page), [values.copy() for values in page.session.frame[:4]]
    for _ in range(40):
        messages = []
        for _ in range(50):
            name = dice.choice(sorted(known))
            own = vars(known[name]).get("__dataclass_fields__", {})
            fields = {one: anything(dice) for one in own if dice.random() < 0.9}
            if "uuid" in fields:
                fields["uuid"] = dice.choice(uuids)
            if "source_component_uuid" in fields:
                fields["source_component_uuid"] = dice.choice(uuids)
            if "updates" in fields:
                fields["updates"] = {dice.choice(("value", "removed", "props")): anything(dice)}
            if not isinstance(fields.get("updates", {}).get("value"), str | bool):  # a page may
                messages.append(packed(**(fields | {"type": name})))
            data = bytearray(dice.choice((CAMERA, click((5.0, 0.1, 0.1), (-1.0, 0.0, 0.0)))))
            data[dice.randrange(len(data))] = dice.randrange(256)
            if b"SceneNodeClickMessage" not in data:
                messages.append(bytes(data))
        send(page, *messages)
    time.sleep(0.5)
    assert settled(page) == before
    assert all((a == b).all() for a, b in zip(state, page.session.frame[:4], strict=True))
    assert not list(tmp_path.iterdir())
    assert not page.server.gui._current_file_upload_states
    end, n = time.monotonic() + 60.0, page.session.n_pushes
    send(page, click((5.0, 0.1, 0.1), (-1.0, 0.0, 0.0)))  # an honest one is heard
    while page.session.n_pushes == n and time.monotonic() < end:
        time.sleep(0.05)
    assert page.session.n_pushes == n + 1


def test_sessions_are_saved_a_hundred_times_and_never_written_over(page, monkeypatch, tmp_path):
    monkeypatch.setattr(page, "path", tmp_path / "s.toml")
    monkeypatch.setattr(page, "written", 0)
    monkeypatch.setattr("particlerb.view.live.recorded", lambda session: "new")
    page.path.write_text("old")
    (tmp_path / "s_2.toml").symlink_to(tmp_path / "elsewhere.toml")
    for _ in range(MOST_SAVED):
        page.save()
    with pytest.raises(ValueError, match="100 sessions were saved"):
        page.save()
    assert page.path.read_text() == "old"
    assert not (tmp_path / "elsewhere.toml").exists()
    assert len(list(tmp_path.iterdir())) == 2 + MOST_SAVED


def test_two_pages_that_save_at_once_keep_both_sessions(page, monkeypatch, tmp_path):
    """The other one writes after this one has looked which names are free."""
    monkeypatch.setattr(page, "path", tmp_path / "s.toml")
    monkeypatch.setattr("particlerb.view.live.recorded", lambda session: "ours")

    def write_other(path):
        if not page.path.exists():
            page.path.write_text("theirs")

    monkeypatch.setattr("particlerb.record.output_path.sync", write_other)
    assert page.save() == tmp_path / "s_2.toml"
    texts = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert texts == {"s.toml": "theirs", "s_2.toml": "ours"}


def test_a_session_that_cannot_be_written_whole_leaves_no_file(page, monkeypatch, tmp_path):
    monkeypatch.setattr(page, "path", tmp_path / "s.toml")
    monkeypatch.setattr(page, "written", 0)
    monkeypatch.setattr("particlerb.view.live.recorded", lambda session: "new" * 1000)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            page.save()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
    page.save()
    assert page.path.read_text() == "new" * 1000


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
