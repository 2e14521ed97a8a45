"""Charts of work against precision: what they say is what a run by hand gives."""

import csv
import math
import re
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.simulation.trials import Error
from particlerb.studies.chart import chart, curve_count
from particlerb.studies.charts.style import METHOD_COLOURS
from particlerb.studies.contact_laws import LawStudy
from particlerb.studies.peers import engines, peer_scene, refusal_by
from particlerb.studies.points import Point, WorkPrecision, failure
from particlerb.studies.text import nice_steps
from particlerb.studies.work_precision import Study
from particlerb.studies.work_precision_table import (
    advice,
    cheapest,
    csv_rows,
    duration,
    frontier,
    table,
)


def engine_of(name):
    """Module of another engine."""
    return engines([name])[0]


def point(seconds, worst, method="strang", engine="", step=0.1, position=0.0, failed=""):
    error = Error(worst, worst, position)
    return Point(method, engine, step, False, seconds, error, 0.0, 0.0, failed)


def made(*points, target=1e-6):
    return WorkPrecision("scene", 1, 1, 1.0, points, "the closed form", 1e-15, (), (), target)


def test_steps_are_those_that_one_would_write_down():
    steps = nice_steps(0.3)
    assert [next(steps) for _ in range(5)] == [0.2, 0.1, 0.05, 0.02, 0.01]
    assert next(nice_steps(5.0)) == 5.0
    assert next(nice_steps(4.99)) == 2.0


def test_frontier_has_what_nothing_of_ours_beats_in_time_and_error():
    slow, quick, beaten = point(2.0, 1e-9), point(1.0, 1e-3), point(1.5, 1e-2)
    rival, lost = point(0.1, 1e-12, engine="peer"), point(0.2, 2.0, failed="lost")
    assert frontier([slow, rival, beaten, lost, quick]) == [quick, slow]


def test_advice_names_the_cheapest_run_that_is_good_enough():
    points = [
        point(1e-3, 1e-4),
        point(2e-3, 1e-7, "rkn6", step=0.02),
        point(9e-3, 1e-8),
        point(1e-3, 1e-9, position=1e-2),  # the position is what it misses
        point(1e-5, 1e-9, engine="peer"),
    ]
    assert cheapest(points, 1e-6) == points[1]
    assert advice(made(*points)) == "for an error of 1e-06 take rkn6 with dt = 0.02 s: 2 ms"


def test_advice_says_what_came_nearest_where_nothing_is_good_enough():
    text = advice(made(point(1e-3, 1e-4), point(1.0, 1e-5)))
    assert text == (
        "no run reached an error of 1e-06 within the budget; the best was strang with dt = 0.1 s:"
        " 1e-05 in 1 s"
    )
    assert "shorten run.t_end" in advice(made(point(1.0, 3.0, failed="lost")))


def test_nothing_is_advised_below_the_floor_of_the_reference():
    chart = made(point(1.0, 0.0), target=1e-12)._replace(floor=6e-9)
    assert advice(chart) == (
        "an error of 1e-12 cannot be judged: the reference is accurate to 6e-09 only"
    )


@pytest.mark.parametrize(
    ("seconds", "words"), [(2.5, "2.5 s"), (1.3e-3, "1.3 ms"), (4e-6, "4 µs"), (7e-9, "7 ns")]
)
def test_durations_read_as_one_would_say_them(seconds, words):
    assert duration(seconds) == words


def test_failures_are_told_apart():
    assert failure(Error(0.9, 0.1, 0.0)) == ""
    assert failure(Error(1.5, 1.0, 0.0)) == "orientation off by 1.5 rad"
    assert failure(Error(0.1, 0.1, 3.0)) == "position off by 3 times the size or path of the body"
    assert failure(Error(math.nan, 0.0, 0.0)) == "NaN or infinite"
    assert failure(Error(0.0, 0.0, math.inf)) == "NaN or infinite"


@pytest.fixture(scope="module")
def tumbling(make):
    """Chart of a free body; short, for its numbers and not for its times."""
    body = make.body(angular_velocity=[0.5, 2.0, 0.3])
    return make.case(body, t_end=5.0, every=5.0), chart(
        to_system(make.case(body, t_end=5.0, every=5.0)),
        ("exact", "strang", "rkn6", "rk4", "explicit_euler"),
        budget=8.0,
        by_processor=True,
    )


@pytest.mark.compiled
def test_a_point_and_the_same_case_run_by_hand_give_the_same_error(make, tumbling):
    case, found = tumbling
    exact = make.arrays(case)
    for p in [p for p in found.points if p.step][::5]:
        by_hand = make.arrays(case, f"run.method={p.method}", f"run.dt={p.step!r}")
        error = make.angle(exact.orientation[-1, 0], by_hand.orientation[-1, 0])
        assert p.error.worst == pytest.approx(float(error), rel=1e-6, abs=2e-15)


@pytest.mark.compiled
def test_curves_fall_with_the_order_of_their_method(tumbling):
    _, found = tumbling
    for method, order in (("strang", 2), ("rk4", 4), ("explicit_euler", 1)):
        good = [p for p in found.points if p.method == method and 1e-10 < p.error.worst < 1e-2]
        steps, errors = zip(*[(p.step, p.error.worst) for p in good[-4:]], strict=True)
        slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
        assert slope == pytest.approx(order, abs=0.15)


@pytest.mark.compiled
def test_failed_points_are_marked_and_kept(tumbling):
    _, found = tumbling
    failed = [p for p in found.points if p.failure]
    assert {p.method for p in failed} >= {"explicit_euler"}
    assert table(found).count("FAILED") == len(failed)
    assert all(p not in failed for p in frontier(found.points))


@pytest.mark.plain
def test_a_run_that_ends_in_an_error_is_a_failed_point(make):
    """Explicit Euler lets the ball on its spring swing more widely, until a step is too long."""
    ball = make.sphere(position=[0.3, 0.0, 0.0], velocity=[1.0, 0.0, 0.0])
    spring = make.spring([0.0, 0.0, 0.0], 2e3, rest_length=0.1, body="ball")
    wall = [make.plane([-1.0, 0.0, 0.0]) | {"point": [9.0, 0.0, 0.0]}]
    keys = {"contact": make.hooke(1e4, 1.0, 0.0), "wall": wall, "t_end": 2.0}
    system = to_system(load(make.case(ball, force=[spring], **keys)))
    found = chart(system, ["explicit_euler", "strang"], budget=0.5, by_processor=True)
    why = "more than its smallest radius"  # shorter steps, that a fast machine has time for, do not
    ended = [p for p in found.points if p.method == "explicit_euler" and why in p.failure]
    assert ended
    assert all(math.isnan(p.size) for p in ended)
    assert not any(p.failure for p in found.points if p.method == "strang")


@pytest.mark.compiled
def test_free_scene_is_best_served_by_the_closed_form(tumbling):
    _, found = tumbling
    assert found.reference == "the closed form"
    assert frontier(found.points)[-1].method == "exact"


@pytest.mark.compiled
def test_csv_has_all_points(tumbling, tmp_path):
    _, found = tumbling
    with (tmp_path / "chart.csv").open("w", newline="") as file:
        csv.writer(file).writerows(csv_rows(found))
    with (tmp_path / "chart.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.points)
    assert [float(row["worst [rad]"]) for row in rows] == [p.error.worst for p in found.points]


@pytest.mark.compiled
def test_forced_scene_has_a_reference_of_two_methods_that_agree(make):
    drag = {"type": "drag", "body": "body", "rotation": 0.3}
    push = make.push([0, 0, 1.0], [0.3, 0, 0])
    case = make.case(
        make.body(angular_velocity=[1, 2, 0.5]), force=[push, drag], t_end=2.0, every=2.0
    )
    found = chart(to_system(case), ("exact", "strang", "rkn6"), budget=2.0, by_processor=True)
    assert "dop853 with tolerance 1e-14, checked by rk4" in found.reference
    assert found.floor < 1e-10
    reason = "rkn6 does not accept what acts here: drag (it depends on velocities)"
    assert dict(found.left_out)["rkn6"] == reason
    assert {p.method for p in found.points} == {"strang"}


@pytest.mark.compiled
def test_a_large_scene_is_judged_by_a_sample_and_timed_as_a_whole(make):
    bodies = make.body(
        count=300, place={"type": "grid", "spacing": 2.0}, angular_velocity={"random": 1.0}
    )
    found = chart(to_system(make.case(bodies)), ("strang",), budget=1.0, by_processor=True)
    assert found.n_bodies == 300
    assert 64 <= found.n_sampled <= 128
    assert f"errors of {found.n_sampled} sampled bodies" in table(found)


@pytest.mark.compiled
def test_points_are_judged_by_where_they_are(make):
    """A Kepler orbit of a point: it has no orientation, and Euler's error is one of position."""
    shape = {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}
    body = {"name": "point", "shape": shape, "position": [1, 0, 0], "velocity": [0, 1, 0]}
    centre = {"type": "central", "body": "point", "mu": 1.0}
    case = make.case(body, force=[centre], t_end=6.0, every=6.0)
    found = chart(
        to_system(case), ("strang", "explicit_euler"), target=1e-4, budget=2.0, by_processor=True
    )
    euler = [p for p in found.points if p.method == "explicit_euler"]
    assert any(p.failure.startswith("position off by") for p in euler)
    assert frontier(found.points)[-1].method == "strang"
    assert all(p.error.position < 1.0 for p in frontier(found.points))
    assert cheapest(found.points, 1e-4).method == "strang"


def test_names_that_are_none_are_refused(make):
    case = load(make.case(make.body()))
    with pytest.raises(ValueError, match="verlet: no such method; there are exact, strang"):
        chart(to_system(case), ("verlet",))
    with pytest.raises(ValueError, match="unity: no such peer; there are all, mujoco"):
        chart(to_system(case), (), ("unity",))


@pytest.mark.compiled
def test_picture_is_drawn(tumbling, tmp_path):
    from particlerb.studies.charts.work_precision import draw_chart, together

    _, found = tumbling
    lines = (("A", 1e-9), ("B", 2e-9), ("C", 1e-4))
    for suffix in ("png", "svg"):
        draw_chart(found._replace(published=lines), tmp_path / f"chart.{suffix}")
        assert (tmp_path / f"chart.{suffix}").stat().st_size > 10_000
    assert together(lines) == [("A, B", 2e-9), ("C", 1e-4)]


@pytest.mark.compiled
def test_peer_on_the_chart_has_the_errors_of_its_own_order(make):
    """SciPy's DOP853 beside ours, on bodies with pushes and gravity: the same bodies."""
    pytest.importorskip("scipy")
    push = make.push([0.4, 0.5, -0.3], [0.3, 0.2, -0.1])
    case = make.case(
        make.body(angular_velocity=[0.5, 0.7, 0.6], orientation=[0.8, 0, 0.6, 0]),
        force=[push],
        gravity={"acceleration": [0, 0, -9.81]},
        t_end=3.0,
        every=3.0,
    )
    found = chart(to_system(case), ("dop853",), ("scipy",), budget=40.0)
    theirs = [p for p in found.points if p.label == "SciPy DOP853"]
    assert min(p.error.worst for p in theirs) < 1e-10
    assert min(p.error.position for p in theirs) < 1e-12
    turning = make.case(make.body(), force=[make.torque([0, 0, 1])])
    refused = chart(to_system(turning), ("dop853",), ("scipy",), budget=1.0)
    (reason,) = [why for name, why in refused.left_out if name == "SciPy"]
    words = "other engines take gravity, springs and constant pushes in the world frame only"
    assert reason == words


@pytest.mark.plain
def test_impulses_and_springs_come_to_the_same_end_on_one_chart(make):
    """A ball that slides comes to roll; with another friction engines would be seen to err."""
    ball = make.sphere(position=[0.0, 0.0, 0.1], velocity=[1.0, 0.0, 0.0])
    law = {"law": "impulse", "restitution": 0.0, "friction": 0.8}
    keys = {"contact": law, "wall": [make.plane([0.0, 0.0, 1.0])], "t_end": 0.15, "every": 0.05}
    system = to_system(load(make.case(ball, gravity={"acceleration": [0.0, 0.0, -9.81]}, **keys)))
    study = LawStudy(system, 0.0)
    assert study.reference.floor < 0.05  # there is one, however little time was given
    exact, springs = study.states("moreau", 1e-3), list(islice(study.ladder("strang"), 2))
    off = [study.difference(study.states("strang", stiffness), exact) for stiffness in springs]
    assert study.difference(study.states("moreau", 0.01), exact) < 4e-3
    assert off[1] < 0.3 * off[0] < 0.03
    point = study.measured("strang", springs[0], repeats=1)
    assert point.method == f"strang, {springs[0]:g} N/m"
    assert point.step < 1e-3
    assert curve_count(system, (), ()) == 2
    rivals = (("mujoco", "implicitfast", 0.03), ("pybullet", "btMultiBody", 0.011))
    for name, variant, bound in rivals:
        assert peer_error(study, name, variant, 1e-3) < bound
    smoother = system.contact.model_copy(update={"friction": 0.5})
    given = peer_scene(system._replace(contact=smoother))
    study.__dict__["peer_scene"] = given._replace(times=study.times)
    for name, variant, _ in rivals:
        assert peer_error(study, name, variant, 1e-3) > 0.06
    scene = peer_scene(system)
    assert not refusal_by(engine_of("mujoco"), scene)
    assert refusal_by(engine_of("scipy"), scene) == "it has no contact"
    assert "LAMMPS has hooke" in refusal_by(engine_of("lammps"), scene)


@pytest.fixture
def bounce(make):
    """A ball falls on a floor, bounces, and touches at no time that is looked at."""

    def made(**keys):
        law = make.hooke(1e4, keys.pop("restitution", 1.0), 0.0)
        ball = make.sphere(position=[0.0, 0.0, 0.3], **keys.pop("ball", {}))
        down = {"acceleration": [0.0, 0.0, -10.0]}
        keys = {"contact": law, "gravity": down, "t_end": 0.64, "every": 0.04} | keys
        return to_system(load(make.case(ball, wall=[make.plane()], **keys)))

    return made


def peer_error(study, name, variant, step):
    """Error of an engine on a chart of contact."""
    engine = engine_of(name)
    if (why := engine.missing()) and "NUMBA" not in why:
        pytest.skip(why)
    steps = iter(study.peer_course(engine, variant, [step], 0.0))
    return next(steps).error.worst


@pytest.mark.plain
def test_engines_on_a_chart_of_contact_lose_what_a_bounce_should_take(bounce):
    """LAMMPS has the same spring; e = 0.5 leaves a quarter of the energy."""
    study = Study(bounce(restitution=0.5), 0.0, True)
    assert study.reference.floor < 0.2
    study.expected, study.scale = study.energies_by("strang", 1e-4)
    assert study.expected[-1] - study.expected[0] < -0.7 * study.scale
    coarse, fine = (peer_error(study, "lammps", "granular", h) for h in (1e-3, 2.5e-4))
    assert fine < 0.25 * coarse < 0.01
    elastic = Study(bounce(), 0.0, True)
    assert peer_error(elastic, "mujoco", "RK4", 2e-4) < 0.03  # its spring is 1 % softer
    assert peer_error(elastic, "pybullet", "btMultiBody", 2e-4) < 0.2  # gains at each bounce
    softer = elastic.system._replace(
        contact=elastic.system.contact.model_copy(update={"stiffness": 1e3})
    )
    elastic.__dict__["peer_scene"] = peer_scene(softer)._replace(times=elastic.times)
    assert peer_error(elastic, "lammps", "granular", 2.5e-4) > 0.05


def test_what_engines_are_not_given_where_bodies_touch_is_said(bounce, make):
    push = make.push([1.0, 0, 0], body="ball")
    study = Study(bounce(force=[push]), 0.0, True)
    words = "other engines are given no force[0], push where bodies touch"
    with pytest.raises(ValueError, match=re.escape(words)):
        _ = study.peer_scene
    spring = make.spring([0, 0, 2.0], 10.0, at=[0, 0, 0.05], body="ball")
    study = Study(bounce(force=[spring]), 0.0, True)
    names = ("mujoco", "lammps", "pybullet")
    reasons = [refusal_by(engine_of(name), study.peer_scene) for name in names]
    assert reasons == ["", "it is given no force[0], spring",
                       "it is given balls, clumps and planes alone"]  # fmt: skip


CRADLE = {
    ("", "strang"): ((0.027, 0.0245), (0.05, 8.8e-4), (0.096, 1.4e-4)),
    ("", "semi_implicit_euler"): ((0.025, 0.13), (0.048, 1.9e-3), (0.09, 2.8e-3)),
    ("", "rk4"): ((0.07, 0.052), (0.127, 5.9e-3), (0.23, 1.7e-4)),
    ("LAMMPS", "granular"): ((0.0135, 0.027), (0.033, 6.3e-3), (0.059, 2e-3), (0.11, 1e-4)),
    ("MuJoCo", "implicitfast"): ((0.24, 4.1e-3), (0.5, 1.3e-4)),
    ("MuJoCo", "RK4"): ((0.28, 4.1e-3), (0.68, 1.4e-3)),
    ("PyBullet", "btMultiBody"): ((0.33, 2.2e-3),),
}
CLUMPS = {
    ("", "strang"): ((0.041, 0.0175), (0.078, 0.0195), (0.137, 8.2e-3)),
    ("", "rk4"): ((0.132, 0.034), (0.277, 0.031)),
    ("MuJoCo", "implicitfast"): ((0.99, 0.058),),
    ("MuJoCo", "RK4"): ((1.5, 0.071),),
    ("PyBullet", "btMultiBody"): ((5.1, 0.068),),
}


SLOWER = {
    ("", "strang"): ((0.0784, 0.0178), (0.153, 0.0192), (0.25, 7.88e-3)),
    ("", "rk4"): ((0.244, 0.0339), (0.53, 0.0303), (0.906, 0.0317)),
    ("LAMMPS", "granular"): ((0.119, 0.119),),
    ("MuJoCo", "implicitfast"): ((2.02, 0.057),),
    ("MuJoCo", "RK4"): ((2.89, 0.0689),),
    ("PyBullet", "btMultiBody"): ((10.1, 0.0641),),
}


@pytest.mark.plain
@pytest.mark.parametrize("curves", [CRADLE, CLUMPS, SLOWER], ids=["cradle", "clumps", "slower"])
def test_names_of_curves_stand_on_no_line_mark_or_other_text(monkeypatch, tmp_path, curves):
    """Curves as dense as those of a cradle with three engines, in the picture as it is drawn."""
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    points = [
        point(seconds, error, method, engine)
        for (engine, method), own in curves.items()
        for seconds, error in own
    ]
    axes = drawn_axes(monkeypatch, made(*points, target=1e-3)._replace(floor=9e-4))
    lines = [line.get_path().transformed(line.get_transform()) for line in axes.lines[:-1]]
    reach = [line.get_markersize() * axes.figure.dpi / 144.0 for line in axes.lines[: len(curves)]]
    marks = [
        Bbox.from_extents(*(place - half), *(place + half))
        for path, half in zip(lines, reach, strict=False)
        for place in path.vertices
    ]
    texts = {text.get_text(): Text.get_window_extent(text) for text in axes.texts}
    for name in (f"{engine} {method}".strip() for engine, method in curves):
        box = texts.pop(name).padded(-1.5)
        assert not any(path.intersects_bbox(box, filled=False) for path in lines), name
        assert not any(box.overlaps(other) for other in (*marks, *texts.values())), name


@pytest.mark.plain
def test_the_chart_names_what_failed(monkeypatch):
    """At some steps or at all of them."""
    lost = [point(0.2, 2.0, name, failed="lost") for name in ("rk4", "explicit_euler")]
    axes = drawn_axes(monkeypatch, made(point(0.1, 1e-3, "rk4"), point(0.3, 1e-4), *lost))
    (text,) = (text.get_text() for text in axes.texts if "failed" in text.get_text())
    assert text.endswith("; at some steps: rk4; at every step: explicit_euler")


@pytest.mark.plain
@pytest.mark.parametrize("target", [1e-3, 1e-9])
def test_the_yellow_band_has_its_key_beside_a_heading_of_any_length(monkeypatch, target):
    """Of 48 letters, and of 100, beside which it has no room: then it stands below."""
    found = made(point(0.1, 1e-3), point(0.3, 1e-4), target=target)._replace(floor=1e-12)
    axes = drawn_axes(monkeypatch, found)
    is_long = len(axes.get_title("left")) > 80
    assert is_long == (target == 1e-9)
    shown = axes.figure.get_supxlabel() if is_long else axes.get_title("right")
    assert shown.startswith("yellow: none of ours is faster")


@pytest.mark.plain
def test_an_engine_has_one_mark_in_all_charts(monkeypatch):
    """MuJoCo's were squares in one chart and triangles in the next."""
    for others in ((), ("LAMMPS",), ("LAMMPS", "PyBullet")):
        rivals = [point(0.2, 1e-3, "a", name) for name in (*others, "MuJoCo")]
        axes = drawn_axes(monkeypatch, made(point(0.1, 1e-3), *rivals))
        marks = [line.get_marker() for line in axes.lines[1 : 1 + len(rivals)]]
        assert marks[-1] == "s"
        assert len(set(marks)) == len(marks)


@pytest.mark.plain
def test_springs_of_one_method_are_one_curve_of_its_colour(monkeypatch):
    """Each stiffness was a curve of one point, without colour."""
    springs = [point(k, 1.0 / k, f"strang, {k:g} N/m") for k in (1.0, 10.0, 100.0)]
    axes = drawn_axes(monkeypatch, made(*springs, point(2.0, 1e-3, "moreau"), target=1e-3))
    curve, other = axes.lines[:2]
    assert curve.get_xdata().tolist() == [1.0, 10.0, 100.0]
    assert curve.get_color() == METHOD_COLOURS["strang"] != other.get_color()
    names = [text.get_text() for text in axes.texts]
    assert "strang, 1 N/m to 100 N/m" in names


def drawn_axes(monkeypatch, found):
    """The panel of a chart, laid out as in its file."""
    from matplotlib.figure import Figure

    from particlerb.studies.charts.work_precision import draw_chart

    shown = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: shown.append(figure))
    draw_chart(found, Path("chart.png"))
    shown[0].draw_without_rendering()
    return shown[0].axes[0]
