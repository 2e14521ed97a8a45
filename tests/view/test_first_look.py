"""What a scene shows before anyone has done something: where it stands, what a push would be."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser")

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.view.access import Access
from particlerb.view.arrows import Arrows
from particlerb.view.live import Live
from particlerb.view.server import listening
from particlerb.view.stage import SpringLines

pytestmark = pytest.mark.plain


@pytest.fixture
def live(tmp_path):
    """The page of the paper's cube, that nobody looks at."""
    with listening(Access(), 8600) as server:
        yield Live(to_system(load("cube_at_rest")), server, tmp_path / "session.toml")


def test_a_push_is_proposed_that_fits_the_body(live):
    """25 N/kg; the paper's point lies where the ray along (0.4, 0.4, -1) leaves the cube."""
    assert live.controls.force.value == "50"
    assert live.controls.point.value == "0.2, 0.2, -0.5"


def test_a_screen_beside_two_panels_is_no_phone(live):
    """1400 px leave 640 x 900 for the scene, a phone has 390 x 844."""
    for aspect, is_phone in ((640 / 900, False), (390 / 844, True)):
        first = live.server.initial_camera
        camera = SimpleNamespace(aspect=aspect, position=first.position, look_at=first.look_at)
        live.stage.step_back(camera)
        assert np.any(camera.look_at) == is_phone


def test_balls_of_a_cradle_stay_in_the_picture(tmp_path):
    """At 1400 px, where the last one comes as far as the first one is held: 0.2 m."""
    system = to_system(load("newtons_cradle"))
    with listening(Access(), 8601) as server:
        stage = Live(system, server, tmp_path / "session.toml").stage
        camera = np.array(server.initial_camera.position)
    first, *_, last = system.state.com.T
    highest = np.array([last[0] + 0.2, 0.0, first[2]])
    ahead = -camera / np.linalg.norm(camera)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    for place in (first, highest):
        seen = stage.on_page(place) - camera
        across = seen @ right / np.linalg.norm(right) / (seen @ ahead)
        assert abs(across) < np.tan(np.radians(75.0 / 2.0)) * 640 / 900


def test_charts_of_zeros_have_no_scale(live):
    """UPlot shows zeros from 0 to 100."""
    chart = live.controls.energy
    assert np.isnan(chart.data[1:]).all()
    live.controls.direction.value = "+z"
    for push, is_seen in ((None, False), (live.push_at_point, True)):
        if push is not None:
            push(None)
        for _ in range(2):
            live.session.advance(live.session.time + 0.1)
            live.show(10.0 * live.session.time)
        assert np.isfinite(chart.data).all() == is_seen


@pytest.mark.parametrize(("point", "is_outside"), [("0.2, 0.2, -0.5", False), ("5, 0, 0", True)])
def test_a_push_outside_its_body_is_told(live, point, is_outside):
    live.controls.direction.value, live.controls.point.value = "+z", point
    live.push_at_point(None)
    assert ("at a point outside the body" in live.controls.outcome.content) == is_outside


def test_an_impulse_is_told_without_rounding(live):
    """57.5 N × 0.02 s were 1.1500000000000001 N s."""
    live.controls.force.value = "57.5"
    live.explain()
    assert "0.02 s = 1.15 N s at once" in live.controls.outcome.content


def test_the_point_that_is_proposed_lies_on_the_body(make, tmp_path):
    """Its corner at √7 m, rounded up to 2.65 m, was told to lie outside."""
    handle = make.body(shape={"type": "moments", "inertia": [1.0, 2.0, 3.0]}, mass=1.0)
    with listening(Access(), 8602) as server:
        live = Live(to_system(load(make.case(handle))), server, tmp_path / "session.toml")
        live.controls.direction.value = "+z"
        live.push_at_point(None)
    assert live.controls.point.value == "2.65, 0, 0"
    assert "outside" not in live.controls.outcome.content


def test_energies_of_what_hangs_have_one_scale(tmp_path):
    """A cradle hangs 1 m below the zero of heights: beside -4.9 J none of its 0.05 J were seen."""
    with listening(Access(), 8603) as server:
        live = Live(to_system(load("newtons_cradle")), server, tmp_path / "session.toml")
        live.show(0.0)
        *_, kinetic, total = live.history[-1]
    assert total == kinetic
    assert abs(live.session.entries.energy[0]) > 4.0


def test_after_a_reset_no_push_is_told(live):
    live.controls.direction.value = "+z"
    live.push_at_point(None)
    assert "pushed at t = 0 s" in live.controls.outcome.content
    live.press("reset")
    assert "pushed" not in live.controls.outcome.content


def test_a_scene_whose_updates_cost_the_same_however_short_goes_on(live, monkeypatch):
    """Time per simulated second grew as updates became shorter, until nothing moved."""
    clock = [0.0]

    def slow(time):
        clock[0] += 1.0  # s
        live.session.time = time

    monkeypatch.setattr("particlerb.view.live.time.perf_counter", lambda: clock[0])
    monkeypatch.setattr(live.session, "advance", slow)
    for _ in range(50):
        live.advance(0.05)
    assert live.session.time >= 49 * live.session.every / 32


def test_springs_are_drawn_from_point_to_point():
    system = to_system(load("newtons_cradle"))
    lines = SpringLines(system)
    ends = lines.at(system.state.com.T, system.state.q.T)
    assert ends.shape == (5, 2, 3)
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == pytest.approx(1.0, abs=1e-6)
    assert (ends[:, 1, 2] == 0.0).all()  # where they hang


def test_a_trail_whose_chords_say_nothing_begins_anew():
    arrows = Arrows(SimpleNamespace(size=1.0, unit=1.0), {})
    for angle in (0.0, 0.1, 0.2):
        arrows.extend_trail(np.array([np.cos(angle), np.sin(angle), 0.0]), 0.5)
    assert len(arrows.trail) == 3
    arrows.extend_trail(np.array([-1.0, 0.0, 0.0]), 0.5)
    assert len(arrows.trail) == 1


def test_arrows_have_names_unless_they_turn_fast(live):
    stage, start = live.stage, np.zeros(3)
    for angle in (0.0, 0.05, 0.1):
        stage.name_arrow("L", start, np.array([[np.cos(angle), np.sin(angle), 0.0]]))
    assert stage.arrow_names["L"].visible
    stage.name_arrow("L", start, np.array([[-1.0, 0.0, 0.0]]))
    assert not stage.arrow_names["L"].visible


def test_what_rounding_leaves_of_a_turn_is_no_arrow_no_chart_and_no_number(live):
    """Balls of a cradle turn at 4e-14 rad/s: the page drew that as its largest ω."""
    session, spin = live.session, np.array([0.0, 4e-14, 0.0])
    frame = session.frame
    mass, inertia = session.system.bodies.mass[0], session.system.bodies.inertia[:, 0]
    for rate, is_seen in ((spin, False), (1e6 * spin, True)):
        live.reset()
        momenta = np.array([[[mass, 0.0, 0.0]]]), (inertia * rate)[None, None]
        session.frame = frame._replace(linear_momentum=momenta[0], angular_momentum=momenta[1])
        session.time += 1.0
        live.show(0.0)
        drawn = [arrow in live.stage.arrows for arrow in ("omega", "L")]
        assert drawn == [is_seen, is_seen]
        assert any(live.history[-1][1:4]) == is_seen
        assert (">0<i>…</i>" in str(live.numbers.content)) != is_seen


def test_errors_of_a_top_are_those_of_the_solver(tmp_path):
    """The weight turns L by some percent: that was shown as an error of |L|."""
    with listening(Access(), 8602) as server:
        live = Live(to_system(load("heavy_top")), server, tmp_path / "session.toml")
        live.controls.direction.value = "+z"
        live.push_at_point(None)
        last = live.session.last[0]
        assert live.drift(last) == (0.0, 0.0)
        before = np.linalg.norm(live.session.frame.angular_momentum)
        live.session.advance(last.stop + 0.1)
        energy, L = live.drift(last)
        after = np.linalg.norm(live.session.frame.angular_momentum)
        assert abs(after / before - 1.0) > 1e-3
        assert max(abs(energy), L) < 1e-12  # a closed form
