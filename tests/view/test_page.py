"""The page in a real browser: pushes, numbers, replay, and what no page would send."""

import argparse
import contextlib
import os
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.cli import view
from particlerb.view import live
from particlerb.view.session import Session

OF_THE_RENDERER = ("THREE.Clock", "WebGL")  # which has no card here, nor is it ours
PICTURES = os.environ.get("PARTICLERB_PICTURES")  # folder for the screenshots of docs/
PATIENCE = 120.0  # [s]
pytestmark = pytest.mark.slow
BRICKS = {
    "run": {"t_end": 4.0, "every": 0.1},
    "body": [
        {
            "name": "brick",
            "shape": {"type": "box", "size": [0.2, 0.3, 0.5], "arrangement": "exact"},
            "mass": 1.0,
            "count": 343,
            "place": {"type": "grid", "spacing": 0.8},
            "orientation": "random",
            "velocity": {"random": 0.2},
            "angular_velocity": {"random": 2.0},
        }
    ],
}


def picture(served, name: str) -> None:
    """Keep a screenshot where one is asked for."""
    if PICTURES:
        served.page.mouse.move(700, 5)  # away from what explains itself below the mouse
        served.page.evaluate("document.activeElement.blur()")
        served.page.wait_for_timeout(1500)
        served.page.screenshot(path=Path(PICTURES) / f"{name}.png")


def state(served) -> list[np.ndarray]:
    """Position, orientation and momenta of all bodies."""
    return [values[0] for values in served.serving.session.frame[:4]]


def test_the_impulse_of_the_paper_gives_its_numbers_on_the_page(cube):
    """50 N for 0.02 s at (0.2, 0.2, -0.5) at once: L = r × J = (0.2, -0.2, 0), ω = 3 L."""
    cube.field("at once").check()
    cube.choose("direction", "+z")
    cube.press("push at this point")
    cube.until(lambda: cube.numbers("angular_momentum").any(), "pushed")
    assert cube.numbers("angular_momentum") == pytest.approx([0.2, -0.2, 0.0], abs=1e-12)
    assert cube.numbers("angular_velocity") == pytest.approx([0.6, -0.6, 0.0], abs=1e-12)
    assert cube.numbers("velocity") == pytest.approx([0.0, 0.0, 0.5], abs=1e-12)
    assert cube.numbers("hand_I") == pytest.approx([1 / 3] * 3, abs=1e-15)
    assert np.abs(cube.numbers("difference_omega")).max() < 1e-15
    p, L = state(cube)[2:]
    assert (cube.numbers("linear_momentum") == p[0]).all()  # every bit
    assert (cube.numbers("angular_momentum") == L[0]).all()


def test_a_push_gives_on_the_page_what_the_batch_run_of_the_session_gives(cube):
    cube.choose("direction", "+z")
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.time > 1.0, "running")
    cube.press("run / pause")
    cube.until(lambda: not cube.serving.is_running, "paused")
    cube.page.wait_for_timeout(500)
    shown = cube.numbers("position"), cube.numbers("angular_momentum"), cube.numbers("orientation")
    assert shown[1] == pytest.approx([0.20100005, -0.20100005, 0.0], abs=5e-9)
    cube.fill("digits", "6")
    picture(cube, "view_cube")
    cube.press("save the session as a case")
    path = cube.serving.path
    cube.until(path.exists, "saved")
    with particlerb.run(path) as batch:
        assert (batch.position[-1, 0] == shown[0]).all()
        assert (batch.angular_momentum[-1, 0] == shown[1]).all()
        assert (batch.orientation[-1, 0] == shown[2]).all()


def test_a_click_at_the_centre_does_not_turn_and_off_it_does(cube):
    """Along the ray through the centre r × F = 0; off it, ΔL = r × F Δt of the point clicked."""
    cube.field("at once").check()
    cube.fill("force [N]", "5")
    cube.choose("direction", "along the view")
    x, y = cube.canvas()
    cube.click(x, y)
    cube.until(lambda: cube.serving.session.n_pushes, "clicked")
    first = cube.serving.session.last[0]
    arm = np.linalg.norm(np.cross(first.lever, first.push.vector)) / 0.1  # [m] past the centre
    assert arm < 0.005  # a pixel or two
    assert np.linalg.norm(state(cube)[2][0]) == pytest.approx(0.1, rel=1e-12)  # N s
    before = state(cube)[3][0].copy()
    cube.press("reset")
    cube.click(x + 90, y)
    cube.until(lambda: cube.serving.session.n_pushes, "clicked again")
    second = cube.serving.session.last[0]
    gained = state(cube)[3][0]
    expected = np.cross(second.lever, second.push.vector)
    assert np.linalg.norm(gained) > 5 * np.linalg.norm(before)
    assert gained == pytest.approx(expected, abs=1e-15)
    view = np.array(second.push.vector) / 0.1
    right = np.cross(view, [0.0, 0.0, 1.0])  # of the screen: the click was to this side
    assert second.lever @ right > 0.05
    assert gained[2] > 0.0  # pushed away from us at the right: anticlockwise from above
    assert np.abs(np.abs(second.push.at).max() - 0.5) < 1e-12  # on the surface


def test_dragging_the_camera_does_not_push(cube):
    x, y = cube.canvas()
    mouse = cube.page.mouse
    mouse.move(x, y)
    cube.page.wait_for_timeout(1000)
    mouse.down()
    mouse.move(x + 120, y + 30, steps=12)
    mouse.up()
    cube.page.wait_for_timeout(1000)
    assert not cube.serving.session.n_pushes
    assert not state(cube)[2].any()


def test_reset_brings_back_the_start(cube):
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.n_pushes, "pushed")
    cube.until(lambda: cube.serving.session.time > 0.2, "running, as it was pushed")
    cube.press("reset")
    cube.until(lambda: cube.serving.session.time == 0.0, "reset")
    assert not cube.serving.is_running
    cube.page.wait_for_timeout(400)
    assert not cube.numbers("position").any()
    assert "force" not in cube.serving.session.raw or not cube.serving.session.raw["force"]


def test_a_push_of_some_time_says_why_it_differs_from_the_hand_calculation(cube):
    """θ = ½ α Δt², α = |r × F|/I = √200 · 3 rad/s²: 0.49°; compared when the push ended."""
    cube.choose("direction", "+z")
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.ends, "over")
    cube.page.wait_for_timeout(500)
    told = cube.page.locator(".pb").inner_text()
    assert "At t = 0.02 s, when the push ended." in told
    assert "The body turned by 0.49° during the push" in told
    before = cube.numbers("solver_v")
    cube.field("gravity").check()
    cube.until(lambda: cube.serving.session.has_gravity, "gravity")
    cube.page.wait_for_timeout(500)
    assert (cube.numbers("solver_v") == before).all()  # as it was then
    cube.field("gravity").uncheck()


def test_the_page_on_a_phone(cube):
    """Bodies above, the push below them; all without scrolling."""
    page, size = cube.page, cube.page.viewport_size
    try:
        page.set_viewport_size({"width": 390, "height": 844})
        page.reload()
        cube.wait_for_the_scene()
        button = page.get_by_role("button", name="push at this point")
        box = button.bounding_box()
        assert 422 < box["y"] < 844 - box["height"]
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
        before = cube.serving.session.n_pushes
        button.click()
        cube.until(lambda: cube.serving.session.n_pushes > before, "pushed from the phone")
        clients = cube.serving.server.get_clients
        cube.until(
            lambda: any(
                one.camera.aspect < 0.6 and one.camera.look_at[2] < 0.0
                for one in clients().values()
            ),
            "the scene above the fields",
        )
        picture(cube, "view_phone")
    finally:
        page.set_viewport_size(size)


def test_no_number_in_a_field_breaks_the_scene(cube):
    for wrong in ("nan", "inf", "1e999", "fifty", "", "1e308", "-1e200"):
        cube.fill("force [N]", wrong)
        before = state(cube)
        cube.serving.message = ""
        cube.press("push at this point")
        cube.until(lambda: cube.serving.session.n_pushes or cube.serving.message, wrong)
        if not cube.serving.session.n_pushes:
            assert all((was == now).all() for was, now in zip(before, state(cube), strict=True))
        cube.press("reset")
        cube.until(lambda: not cube.serving.session.n_pushes, "reset")
    cube.fill("force [N]", "50")
    cube.press("push at this point")
    cube.until(lambda: cube.serving.session.n_pushes == 1, "pushed after all that")


def test_a_file_is_replayed(serve, tmp_path):
    from particlerb.record.trajectory import open_trajectory
    from particlerb.view.replay import Replay

    path = tmp_path / "run.h5"
    particlerb.run(BRICKS, path).close()
    trajectory = open_trajectory(path)
    with trajectory, serve(lambda server: Replay(trajectory, server, path)) as served:
        served.fill("digits", "17")
        served.fill("frame", "30")
        served.until(lambda: served.serving.frame == 30, "the frame")
        served.fill("body", "brick[171]")
        served.choose("colour by", "speed")
        served.page.wait_for_timeout(800)
        assert (served.numbers("position") == trajectory.position[30, 171]).all()
        assert (served.numbers("orientation") == trajectory.orientation[30, 171]).all()
        assert "frame 30 of 40" in served.page.locator("#clock").inner_text()
        served.fill("digits", "6")
        picture(served, "view_replay")
        with served.page.expect_download() as download:
            served.press("PNG of this frame")
        assert Path(download.value.path()).read_bytes()[:4] == b"\x89PNG"
        served.press("play / pause")
        served.until(lambda: served.serving.frame > 32, "playing")


class Scenes:
    """What `view` serves: a scene, and those that are chosen after it."""

    def __init__(self, server, monkeypatch) -> None:
        self.server, self.pages, prepared = server, [], view._live

        def kept(*given):
            self.pages.append(prepared(*given))
            return self.pages[-1]

        monkeypatch.setattr(view, "_live", kept)
        monkeypatch.setattr(view, "open_to", lambda *_: contextlib.nullcontext())

    def go(self) -> None:
        """Serve them until `stop`."""
        options = {"case": "cube_at_rest", "overrides": [], "commands": (), "output": None}
        cube = to_system(load("cube_at_rest"))
        view.push(argparse.Namespace(**options, no_browser=True), self.server, None, cube)

    def stop(self) -> None:
        """End the one that is served."""
        self.pages[-1].stop()

    @property
    def message(self) -> str:
        """What it says."""
        return self.pages[-1].message


def test_bodies_of_a_scene_are_seen_while_its_kernels_are_compiled(serve, tmp_path, monkeypatch):
    """For a minute the scene before stood there, with fields that did nothing."""
    monkeypatch.chdir(tmp_path)
    are_there = threading.Event()
    monkeypatch.setattr(live, "rehearse", lambda system: are_there.wait(PATIENCE))
    with serve(lambda server: Scenes(server, monkeypatch)) as served:
        served.pages = served.serving.pages
        served.choose("scene", "linkage")
        served.page.get_by_text("The first linkage on this machine compiles").wait_for()
        served.page.get_by_text("push at this point").wait_for(state="detached")
        assert len(served.pages) == 1
        picture(served, "view_preparing")
        are_there.set()
        served.page.get_by_text("push at this point").wait_for()
        assert served.field("scene").input_value() == "linkage"


def test_no_scene_of_the_page_says_anything_on_the_console(serve, tmp_path, monkeypatch):
    """Each is chosen while the one before moves, until the first is back."""
    monkeypatch.chdir(tmp_path)
    still = lambda session, time: setattr(session, "time", time)  # noqa: E731 - compiles nothing
    monkeypatch.setattr(Session, "advance", still)
    monkeypatch.setattr(live, "NUMBERS_EVERY", 0.0)  # fields change until the end
    monkeypatch.setattr(live, "rehearse", lambda system: time.sleep(0.3))
    with serve(lambda server: Scenes(server, monkeypatch)) as served:
        for n, name in enumerate([*list(view.SCENES)[1:], "cube"], start=2):
            served.pages = served.serving.pages
            served.pages[-1].is_running = True
            served.page.wait_for_timeout(300)
            served.choose("scene", name)
            served.until(lambda n=n: len(served.pages) == n, name)
            served.page.wait_for_timeout(1500)
            assert served.field("scene").input_value() == name
            wrong = [text for kind, text in served.seen if kind in ("warning", "error")]
            assert not [text for text in wrong if not any(own in text for own in OF_THE_RENDERER)]
