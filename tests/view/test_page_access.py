"""Who reaches the page in a real browser, and what hostile clients and files leave of it."""

import functools
import http.server
import threading
from pathlib import Path

import pytest

pytest.importorskip("viser")

import test_server
import viser
from test_server import CAMERA, fields_of, hostile_updates, send, settled, uploads

import particlerb
import particlerb.view.access as access_module

pytestmark = pytest.mark.slow
TRIES = """async ([address, token, protocol]) => {
  const socket = query => new Promise(done => {
    const one = new WebSocket(address.replace("http", "ws") + query, protocol);
    one.onopen = () => done("open");
    one.onerror = () => done("refused");
  });
  const get = query => fetch(address + query, {credentials: "include"}).then(
    answer => answer.status, () => "refused");
  const frame = () => new Promise(done => {
    const one = document.createElement("iframe");
    one.onload = () => { try { done(one.contentDocument ? "readable" : "blocked") }
                         catch { done("blocked") } };
    one.src = address + "?token=" + token;
    document.body.append(one);
  });
  return [await socket(""), await socket("?token=" + token), await get(""),
          await get("?token=" + token), await frame()];
}"""
HOSTILE = "<img src=x onerror='window.hacked=1'><script>window.hacked=1</script>${{1}}"


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """Port of another site on this machine."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "index.html").write_text("<!doctype html><title>elsewhere</title><body>")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


def test_the_browser_finds_nothing_against_the_policy(cube):
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.n_pushes, "pushed")
    assert cube.page.evaluate("window.violations") == []
    assert not [text for kind, text in cube.seen if "Content Security Policy" in text]
    assert not [text for kind, text in cube.seen if kind == "error"]


def test_a_policy_that_is_too_strict_is_reported(browser, monkeypatch):
    """So the test above can fail."""
    from particlerb.view.access import Access
    from particlerb.view.server import listening

    strict = access_module.POLICY.replace(" 'unsafe-inline'", "")
    monkeypatch.setitem(access_module.HEADERS, "Content-Security-Policy", strict)
    access, page, seen = Access(), browser.new_page(), []
    page.on("console", lambda message: seen.append(message.text))
    with listening(access, 8220):
        page.goto(access.addresses()[0])
        page.wait_for_timeout(500)
    assert any("Content Security Policy" in text for text in seen)
    page.close()


def test_without_the_token_nothing_is_served(cube, browser):
    """With it a cookie is left, by which the bare address works until the page ends."""
    jar = [one for one in browser.cookies() if one["name"] == cube.access.cookie]
    assert [(one["httpOnly"], one["sameSite"]) for one in jar] == [(True, "Strict")]
    bare = cube.access.addresses()[0].partition("?")[0]
    page = browser.new_page()
    try:
        assert page.goto(bare).status == 200
        browser.clear_cookies()
        assert page.goto(bare).status == 403
        assert "open the address" in page.locator("body").inner_text()
        assert page.goto(f"{bare}?token={'0' * 48}").status == 403
        assert page.goto(bare.replace("127.0.0.1", "localhost")).status == 403
        assert page.goto(cube.access.addresses()[0]).status == 200
    finally:
        page.close()


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_a_page_of_another_port_or_name_reaches_nothing(cube, browser, elsewhere, name):
    """Of the same site too, to which the browser gives the cookie: ports are one site."""
    page = browser.new_page()
    before = settled(cube.serving)
    try:
        page.goto(f"http://{name}:{elsewhere}/")
        address = cube.access.addresses()[0].partition("?")[0]
        tries = [address, cube.access.token, f"viser-v{viser.__version__}"]
        found = page.evaluate(TRIES, tries)
        assert found == ["refused", "refused", "refused", "refused", "blocked"]
    finally:
        page.close()
    assert settled(cube.serving) == before


def test_after_hostile_clients_the_page_is_as_it_was(cube, monkeypatch):
    """Every field takes what is typed, and every other browser sees it."""
    monkeypatch.setattr(test_server, "PAUSE", 0.0)
    cube.serving.token = cube.access.token
    for handle in fields_of(cube.serving):
        send(cube.serving, *hostile_updates(handle), *uploads(handle))
    send(cube.serving, b"", b"\xc1" * 100, CAMERA[:-1], "text", b"\x00" * 2_000_000)
    cube.fill("force [N]", "7")
    cube.until(lambda: cube.serving.controls.force.value == "7", "typed")
    cube.fill("duration [s]", "0.5")
    cube.field("at once").check()
    cube.choose("direction", "-y")
    cube.fill("digits", "9")
    cube.fill("point [m]", "0.1, 0, 0")
    cube.fill("speed", "2")
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.n_pushes, "pushed")
    blow = cube.serving.session.last[0].push
    assert (blow.at, blow.vector, blow.duration) == ((0.1, 0.0, 0.0), (0.0, -3.5, 0.0), 0.0)
    assert cube.serving.digits.value == 9
    cube.fill("speed", "1")
    cube.choose("direction", "along the view")


def test_names_in_a_file_are_shown_as_they_are(serve, tmp_path):
    """Names, title and file name are text, never a part of the page."""
    from particlerb.record.trajectory import open_trajectory
    from particlerb.view.replay import Replay

    body = {"shape": {"type": "box", "size": [1, 1, 1], "n": 2}, "mass": 1.0}
    bodies = [{"name": HOSTILE, **body}, {"name": "b", "position": [3, 0, 0], **body}]
    path = tmp_path / "<b>x'\"&.h5"
    case = {"title": HOSTILE, "run": {"t_end": 1.0, "every": 0.5}, "body": bodies}
    particlerb.run(case, path).close()
    with open_trajectory(path) as trajectory:
        assert trajectory.names[0] == HOSTILE
        with serve(lambda server: Replay(trajectory, server, path)) as served:
            served.page.wait_for_timeout(500)
            assert served.page.evaluate("window.hacked") is None
            assert served.page.locator(".pb b").first.inner_text() == HOSTILE
            assert served.page.locator("img[src='x']").count() == 0
            with served.page.expect_download() as download:
                served.press("PNG of this frame")
            assert Path(download.value.path()).read_bytes()[:4] == b"\x89PNG"
            assert "/" not in download.value.suggested_filename
            assert served.page.evaluate("window.hacked") is None
