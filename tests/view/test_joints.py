"""Joints on the page: where they are drawn, and pushes on links that joints hold."""

import os
from pathlib import Path

import numpy as np
import pytest

import particlerb
from particlerb.case.to_system import to_system
from particlerb.view.stage import JointLines

PICTURES = os.environ.get("PARTICLERB_PICTURES")
BAR = {"type": "box", "size": [0.8, 0.1, 0.1], "arrangement": "exact"}
HANGING = {
    "run": {"t_end": 4.0, "every": 0.1, "dt": 0.01},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "body": [
        {"name": "upper", "shape": BAR, "mass": 1.0, "position": [0.4, 0.0, 0.0]},
        {"name": "lower", "shape": BAR, "mass": 1.0, "position": [1.2, 0.0, 0.0]},
    ],
    "joint": [
        {"type": "hinge", "body": "upper", "at": [0.0, 0.0, 0.0], "axis": [0.0, 1.0, 0.0]},
        {"type": "ball", "body": "lower", "to": "upper", "at": [0.8, 0.0, 0.0]},
        {"type": "distance", "body": "lower", "at": [1.6, 0.0, 0.0], "at_to": [1.6, 0.0, 0.5],
         "name": "wire"},
    ],
}  # fmt: skip


def test_lines_are_where_the_joints_are_while_they_move():
    lines = JointLines(to_system(HANGING), 2.0)
    with particlerb.run(HANGING) as t:
        x, q = np.array(t.position), np.array(t.orientation)
    start, end = (lines.at(x[k], q[k]) for k in (0, -1))
    assert start[0] == pytest.approx(np.array([[0, -0.18, 0], [0, 0.18, 0]]), abs=1e-12)
    assert start[-1] == pytest.approx(np.array([[1.6, 0, 0], [1.6, 0, 0.5]]), abs=1e-12)
    assert end[0] == pytest.approx(start[0], abs=1e-12)  # its axis is fixed in the world
    assert np.linalg.norm(end[-1, 0] - end[-1, 1]) == pytest.approx(0.5, abs=1e-12)
    assert end[-1, 1] == pytest.approx([1.6, 0, 0.5], abs=1e-15)
    middle = 0.5 * (end[1, 0] + end[1, 1])  # of the ball, at the end of the upper bar
    assert np.linalg.norm(middle) == pytest.approx(0.8, abs=1e-12)
    assert len(start) == 1 + 3 + 3 + 3 + 1


def test_a_pinion_shows_its_axis_and_the_line_of_its_rack():
    rack = {"type": "rack", "body": "upper", "at_to": [0.4, -0.5, 0.0], "axis": [0.0, 0.0, 1.0],
            "axis_to": [1.0, 0.0, 0.0]}  # fmt: skip
    x, q = np.array([[0.4, 0, 0], [1.2, 0, 0]]), np.array([[1.0, 0, 0, 0]] * 2)
    lines = JointLines(to_system({**HANGING, "joint": [rack]}), 2.0).at(x, q)
    assert lines[0] == pytest.approx(np.array([[0.4, 0, -0.18], [0.4, 0, 0.18]]), abs=1e-12)
    assert lines[1] == pytest.approx(np.array([[0.22, -0.5, 0], [0.58, -0.5, 0]]), abs=1e-12)


@pytest.mark.slow
def test_a_link_is_pushed_by_a_click_and_the_session_is_that_of_its_case(serve, tmp_path):
    from particlerb.view.live import Live

    path = tmp_path / "session.toml"
    with serve(lambda server: Live(to_system(HANGING), server, path)) as page:
        page.press("run / pause")
        page.until(lambda: not page.serving.is_running, "paused")
        stage = page.serving.stage
        joint_lines = stage.lines[0][1]
        assert joint_lines.visible
        session = page.serving.session
        x, q = session.frame.position[0], session.frame.orientation[0]
        shown = np.array(joint_lines.points)
        assert shown == pytest.approx(stage.on_page(stage.joints.at(x, q)), abs=1e-6)
        page.fill("force [N]", "8")
        page.choose("direction", "+y")
        page.choose("body", "lower")
        page.press("push at this point")
        page.until(lambda: session.last, "pushed")
        page.press("run / pause")
        page.until(lambda: session.time > session.last[1].stop + 0.3, "running")
        page.press("run / pause")
        page.until(lambda: not page.serving.is_running, "paused again")
        page.page.wait_for_timeout(800)
        assert not page.page.locator("[data-key=hand_L]").count()  # joints push too
        if PICTURES:
            page.page.screenshot(path=Path(PICTURES) / "view_joints.png")
        page.press("save the session as a case")
        page.until(path.exists, "saved")
        found = [values[0].copy() for values in session.frame[:2]]
        assert not [text for kind, text in page.seen if kind == "error"]
    with particlerb.run(path) as batch:
        assert (batch.position[-1] == found[0]).all()
        assert (batch.orientation[-1] == found[1]).all()
        across = np.abs(batch.position[:, 1, 1]).max()
        assert across > 1e-4  # out of the plane of its fall, where it would stay
