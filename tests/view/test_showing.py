"""Trajectories shown from Python: a figure, and a page that a thread serves."""

import urllib.error
import urllib.request

import pytest

pytest.importorskip("viser")

import particlerb
from particlerb import Scene
from particlerb.tables import Box, RunTable


@pytest.fixture
def trajectory():
    """A box that turns."""
    scene = Scene(RunTable(t_end=1.0, every=0.5))
    shape = Box(size=(1, 2, 3), n=2)
    scene.add_body(name="box", shape=shape, mass=1.0, angular_velocity=(1, 0, 0))
    with particlerb.run(scene) as trajectory:
        yield trajectory


def test_a_page_answers_until_it_is_closed(trajectory):
    with trajectory.view(port=8490, browser=False) as shown:
        assert shown.address in repr(shown)
        assert shown.address in shown._repr_html_()
        with urllib.request.urlopen(shown.address) as answer:
            assert answer.status == 200
        thread = shown._thread
        assert thread.is_alive()
    assert not thread.is_alive()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(shown.address, timeout=1.0)
    assert trajectory.position.shape == (3, 1, 3)


def test_a_page_that_cannot_be_made_leaves_no_server(trajectory, monkeypatch):
    monkeypatch.setattr("particlerb.view.replay.Replay.make_controls", lambda page: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        trajectory.view(port=8491, browser=False)
    monkeypatch.undo()
    with trajectory.view(port=8491, browser=False) as shown:
        assert ":8491/" in shown.address


def test_plot_is_that_of_the_package(trajectory, tmp_path):
    figure = trajectory.plot(tmp_path / "a.png", body="box")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert len(figure.axes) == len(particlerb.plot(trajectory, body="box").axes)
