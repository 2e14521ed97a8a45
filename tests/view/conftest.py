"""A real browser, and pages on which a case or a file is served to it."""

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = next((path for name in NAMES if (path := shutil.which(name))), None)
MUST = os.environ.get("PARTICLERB_REQUIRE_BROWSER", "0") not in ("", "0")
if MUST:  # nothing here may be skipped
    import playwright  # noqa: F401
    import tomlkit  # noqa: F401
    import trimesh  # noqa: F401
    import viser  # noqa: F401
QUIET = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
SIZE = {"width": 1600, "height": 1000}
PATIENCE = 120.0  # [s] on a machine that has other work
VIOLATIONS = """window.violations = [];
document.addEventListener("securitypolicyviolation",
  e => violations.push([e.effectiveDirective, e.blockedURI, e.sample]));"""

FEW_PICTURES = """window.requestAnimationFrame = draw => setTimeout(
  () => draw(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;"""  # as there is no card that draws them


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """Chromium without a window."""
    pytest.importorskip("playwright")
    pytest.importorskip("viser")
    if CHROMIUM is None:
        if MUST:
            pytest.fail("PARTICLERB_REQUIRE_BROWSER is set and there is no chromium")
        pytest.skip("no chromium on this machine: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        context = play.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            headless=True,
            args=list(QUIET),
            viewport=SIZE,
            accept_downloads=True,
        )
        context.set_default_timeout(1000.0 * PATIENCE)
        yield context
        context.close()


class Served:
    """A page in the browser, and the thread that serves it."""

    def __init__(self, page, serving, access, seen) -> None:
        self.page, self.serving, self.access = page, serving, access
        self.seen = seen  # console messages, of which an empty page has none

    def wait_for_the_scene(self) -> None:
        """After a page was loaded: until it is drawn, without what SwiftShader says on it."""
        self.page.locator(".pb").first.wait_for(state="attached")
        self.page.add_style_tag(content=".mantine-Notification-root{display:none}")
        self.page.wait_for_timeout(1500)

    def until(self, holds: Callable[[], bool], what: str) -> None:
        """Wait until something holds."""
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, f"never: {what}; {self.serving.message}"
            self.page.wait_for_timeout(50)

    def field(self, label: str):
        """The input beside a label."""
        return self.page.locator(
            f"xpath=//label[.='{label}']/ancestor::div[2]//input[not(@type='hidden')]"
        ).first

    def fill(self, label: str, value: str) -> None:
        """Type into a field."""
        self.field(label).fill(value)
        self.field(label).press("Enter")
        self.page.wait_for_timeout(200)

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        self.field(label).click()
        self.page.get_by_role("option", name=option, exact=True).click()
        self.page.wait_for_timeout(200)

    def press(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name).click()
        self.page.wait_for_timeout(200)

    def numbers(self, key: str) -> np.ndarray:
        """Numbers of the table as people read them; only differences may have more digits."""
        texts = self.page.eval_on_selector_all(  # at one instant, as the table is replaced often
            f"[data-key={key}]",
            r"cells => cells.map(cell => cell.innerHTML.replace(/<[^>]*>/g, ' '))",
        )
        if key.startswith("difference"):
            texts = [text.replace("…", "") for text in texts]
        return np.array([float(word) for text in texts for word in text.split()])

    def canvas(self):
        """Middle of the picture, in pixels of the page."""
        box = self.page.locator("canvas").first.bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def click(self, x: float, y: float) -> None:
        """Rest over a point of the picture, then click on it."""
        self.page.mouse.move(x - 1, y - 1)
        self.page.wait_for_timeout(300)
        self.page.mouse.move(x, y)
        self.page.wait_for_timeout(1200)
        self.page.mouse.down()
        self.page.wait_for_timeout(60)
        self.page.mouse.up()


@pytest.fixture(scope="module")
def serve(browser):
    """How to serve what `make(server)` returns."""
    return lambda make: served(browser, make)


@contextlib.contextmanager
def served(browser, make) -> Iterator[Served]:
    """Serve what `make(server)` returns, until the end of the test."""
    from particlerb.view.access import Access
    from particlerb.view.server import listening

    access = Access()
    with listening(access, 8200) as server:
        serving = make(server)
        thread = threading.Thread(target=serving.go, daemon=True)
        thread.start()
        page, seen = browser.new_page(), []
        page.on("console", lambda message: seen.append((message.type, message.text)))
        page.on("pageerror", lambda error: seen.append(("error", str(error))))
        page.add_init_script(VIOLATIONS)
        page.add_init_script(FEW_PICTURES)
        try:
            page.goto(access.addresses()[0])
            one = Served(page, serving, access, seen)
            one.wait_for_the_scene()
            yield one
        finally:
            serving.stop()
            thread.join(PATIENCE)
            page.close()


@pytest.fixture(scope="module")
def open_cube(serve, tmp_path_factory) -> Iterator[Served]:
    """The page of the paper's cube."""
    from particlerb.case.to_system import to_system
    from particlerb.view.live import Live

    system = to_system(Path(__file__).parents[2] / "cases" / "cube_at_rest.toml")
    path = tmp_path_factory.mktemp("sessions") / "session.toml"
    with serve(lambda server: Live(system, server, path)) as served:
        yield served


@pytest.fixture
def cube(open_cube) -> Served:
    """The paper's cube, paused at t = 0, with the fields as they are at first."""
    open_cube.press("step")
    open_cube.press("reset")
    open_cube.until(lambda: open_cube.serving.session.time == 0.0, "reset")
    for label, value in (("force [N]", "50"), ("duration [s]", "0.02"), ("digits", "17")):
        open_cube.fill(label, value)
    open_cube.field("at once").set_checked(False)
    return open_cube
