"""A session is the run of its case: the batch run of what it recorded gives the same bits."""

import tomllib

import numpy as np
import pytest

pytest.importorskip("tomlkit")

import particlerb
from particlerb.case.reader import parse
from particlerb.case.to_system import to_system
from particlerb.simulation.group_run import GroupRun
from particlerb.view.recording import recorded
from particlerb.view.session import Session, SessionError, UserPush

CUBE = {
    "name": "cube",
    "shape": {"type": "box", "size": [1.0, 1.0, 1.0], "arrangement": "exact"},
    "mass": 2.0,
}
CORNER = (0.2, 0.2, -0.5)
UP = (0.0, 0.0, 50.0)


SPIN = [0.3, 1.0, 0.2]
SCENES = {
    "cube": lambda m: m.case(CUBE, t_end=2.0, dt=1e-3),
    "asymmetric, one of three": lambda m: m.case(
        m.body(count=3, position=[[k, 0.0, 0.0] for k in range(3)], angular_velocity=SPIN)
    ),
    "asymmetric, one of three at rest": lambda m: m.case(
        m.body(count=3, position=[[k, 0.0, 0.0] for k in range(3)])
    ),
    "stepped without end": lambda m: m.case(
        m.body(angular_velocity=SPIN), force=[m.spring([0, 0, 0], 30.0, at=[0.1, 0.0, 0.0])]
    ),
    "balls that fall on a floor": lambda m: m.case(
        m.sphere("low", position=[0.0, 0.0, 0.12]),
        m.sphere("high", position=[0.05, 0.0, 0.4], angular_velocity=SPIN),
        gravity={"acceleration": [0.0, 0.0, -9.81]},
        contact=m.hooke(1e4), wall=[m.plane()], t_end=0.5, dt=1e-3,
    ),
    "method of the case": lambda m: m.case(m.body(angular_velocity=SPIN), method="rk4", dt=0.01),
    "adaptive": lambda m: m.case(
        m.body(angular_velocity=SPIN), method="dop853", force=[m.drag(0.0, 0.1)]
    ),
}  # fmt: skip


def marks_of(name):
    """Scenes whose kernels take long to compile run in plain Python only: the logic is the same."""
    is_quick = name in ("cube", "asymmetric, one of three", "stepped without end")
    return [] if is_quick else [pytest.mark.plain]


@pytest.fixture
def session(make):
    """How to make a session of a scene."""
    return lambda name="cube": Session(to_system(SCENES[name](make)))


def pushed(session, updates):
    """Three pushes and gravity on and off, looked at as often as asked."""
    step = session.every * 0.37
    number = len(session.system.kind) - 1
    for k in range(12):
        start = k * step
        for u in range(1, updates + 1):
            session.advance(round(start + u * step / updates, 9))
        if k in (2, 6, 9):
            duration = 0.0 if k == 6 else 0.4 * step
            force = (0.5, -1.0, 2.0 if k < 9 else -7.0)
            session.apply(UserPush(number, (0.05, -0.02, 0.03), force, duration))
        if k in (4, 8):
            session.switch_gravity(not session.has_gravity)
    return session


def batch_of(session):
    """Last state of a batch run of the recorded case."""
    with particlerb.run(parse(recorded(session))) as run:
        return [
            np.array(values[-1])
            for values in (run.position, run.orientation, run.linear_momentum, run.angular_momentum)
        ]


@pytest.mark.parametrize("name", [pytest.param(n, marks=marks_of(n)) for n in SCENES])
def test_the_batch_run_of_a_recorded_session_gives_the_same_bits(session, name):
    session = pushed(session(name), 3)
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert (live[0] == batch).all()
    assert np.abs(session.frame.angular_momentum).max() > 1e-4  # something has happened


@pytest.mark.plain
def test_gravity_that_is_switched_now_changes_no_bit_on_the_screen(session):
    """The record leaves it out, as it acts from the end of the run on."""
    session = session("asymmetric, one of three")
    for k in range(1, 5):
        session.advance(0.37 * k * session.every)
        session.switch_gravity(not session.has_gravity)
        for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
            assert (live[0] == batch).all()


@pytest.mark.parametrize("name", ["cube", "stepped without end"])
def test_the_frame_rate_changes_nothing(session, name):
    few, many = (pushed(session(name), updates) for updates in (1, 17))
    assert few.time == many.time
    assert few.raw["force"] == many.raw["force"]
    for a, b in zip(few.frame[:4], many.frame[:4], strict=True):
        assert (a == b).all()


def test_a_push_leaves_the_past_of_a_stepped_body_as_it_was(session):
    """The state at the start of a push is that of the session that was never pushed."""
    session, calm = session("stepped without end"), session("stepped without end")
    session.advance(0.2345)
    start = session.apply(UserPush(0, (0.1, 0.0, 0.0), (0.0, 0.0, 1.0), 0.03)).start
    calm.advance(start)
    assert start > 0.2345
    for a, b in zip(session.frame[:4], calm.frame[:4], strict=True):
        assert (a == b).all()


def test_a_push_goes_on_from_the_last_edge_however_many_came_before(session, monkeypatch):
    """What was computed is kept: a push of some time crosses its own two edges, and no earlier."""
    crossed, real = [], GroupRun.cross
    monkeypatch.setattr(GroupRun, "cross", lambda run: (crossed.append(run.number), real(run)))
    session = session()
    for k in range(20):
        session.advance(0.05 * (k + 1))
        session.apply(UserPush(0, CORNER, UP, 0.01))
    session.advance(1.5)
    assert crossed == [0, 1] * 20
    session.apply(UserPush(0, CORNER, UP, 0.0))
    assert len(session.run.group_runs[0].plan.segments) <= 3  # what is over is not planned again
    assert len(session.lasting) <= 2
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert (live[0] == batch).all()


def test_what_is_known_of_a_body_outlasts_the_pushes_that_it_is_known_by(session):
    """Pushes about one axis have closed forms until one is about another, also when all are over.

    Of three bodies in one group one is pushed, while gravity goes on and off.
    """
    session = session("asymmetric, one of three at rest")
    step, about_one, askew = 0.5 * session.every, (0.0, 0.05, 0.0), (0.05, 0.02, 0.03)
    methods = []
    for k, at in enumerate([about_one] * 4 + [askew] + [about_one] * 4):
        session.advance(session.time + step)
        lasts = k in (1, 3, 7, 8)
        session.apply(UserPush(1, at, (0.6, 0.0, 0.0), 0.3 * step * lasts))
        (run,) = (one for one in session.run.group_runs if 1 in one.plan.members)
        methods += [run.segment.method] * lasts
        if k in (1, 3, 6):
            session.switch_gravity(not session.has_gravity)
    assert methods == ["exact", "exact", "strang", "strang"]
    session.advance(session.time + step)
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert (live[0] == batch).all()


def test_impulse_of_the_paper(session):
    session = session()
    session.apply(UserPush(0, CORNER, (0.0, 0.0, 1.0), 0.0))
    assert session.frame.angular_momentum[0, 0] == pytest.approx([0.2, -0.2, 0.0], abs=1e-15)
    assert session.frame.linear_momentum[0, 0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)


def test_push_of_the_paper_is_in_closed_form_as_what_follows(make):
    """L = ∫ r × F dt = 0.20100005 after 0.02 s: the arm turns while the push acts."""
    session = Session(to_system(make.case(CUBE, t_end=2.0, dt=1e-5)))
    session.apply(UserPush(0, CORNER, UP, 0.02))
    segments = session.run.group_runs[0].plan.segments
    assert [segment.method for segment in segments] == ["exact", "exact"]
    session.advance(1.0)
    expected = [0.20100005, -0.20100005, 0.0]
    assert session.frame.angular_momentum[0, 0] == pytest.approx(expected, abs=5e-9)


@pytest.mark.parametrize(
    "blow",
    [
        UserPush(0, CORNER, (np.nan, 0.0, 0.0), 0.0),
        UserPush(0, (np.inf, 0.0, 0.0), UP, 0.0),
        UserPush(0, CORNER, UP, -1.0),
        UserPush(0, CORNER, (0.0, 0.0, 0.0), 0.0),
        UserPush(0, CORNER, UP, 1e9),
        UserPush(0, (1e200, 0.0, 0.0), (0.0, 0.0, 1e200), 0.0),
    ],
)
def test_what_cannot_be_leaves_everything_as_it_was(session, blow):
    session = session()
    session.advance(0.3)
    session.apply(UserPush(0, CORNER, UP, 0.02))
    session.advance(0.5)
    before, text = [values.copy() for values in session.frame[:4]], recorded(session)
    with pytest.raises(SessionError):
        session.apply(blow)
    assert recorded(session) == text
    session.advance(0.6)
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert (live[0] == batch).all()
    assert (before[2] == session.frame.linear_momentum).all()


def test_a_push_that_overflows_is_taken_back(session):
    """The kinetic energy of p = 1e153 kg m/s is a float64, that of 1e155 kg m/s is none."""
    session = session()
    session.apply(UserPush(0, (0.0, 0.0, 0.0), (1e153, 0.0, 0.0), 0.0))
    with pytest.raises(SessionError, match="not finite"):
        session.apply(UserPush(0, (0.0, 0.0, 0.0), (1e155, 0.0, 0.0), 0.0))
    assert len(session.raw["force"]) == 1
    assert session.frame.linear_momentum[0, 0, 0] == 1e153


def test_a_point_cannot_be_turned(make):
    point = {"name": "p", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    session = Session(to_system(make.case(point)))
    session.advance(0.1)
    with pytest.raises(SessionError, match="nothing can turn it"):
        session.apply(UserPush(0, (0.1, 0.0, 0.0), UP, 0.1))
    assert not session.raw["force"]
    session.apply(UserPush(0, (0.0, 0.0, 0.0), UP, 0.1))


def test_gravity_on_and_off_is_a_parabola(session):
    """x = ½ g t² while it is on, straight afterwards; recorded as a push M g at the centre."""
    session = session()
    session.advance(0.5)
    session.switch_gravity(True)
    session.advance(1.5)
    assert session.frame.position[0, 0, 2] == pytest.approx(-0.5 * 9.81, rel=1e-14)
    session.switch_gravity(False)
    session.advance(2.0)
    assert session.frame.position[0, 0, 2] == pytest.approx(-9.81 * (0.5 + 0.5), rel=1e-14)
    (weight,) = session.raw["force"]
    assert weight["force"] == [0.0, 0.0, -19.62]
    assert weight["during"] == [0.5, 1.5]


def test_gravity_of_a_case_can_be_switched_off(make):
    session = Session(to_system(make.case(CUBE, gravity={"acceleration": [0.0, 0.0, -2.0]})))
    session.switch_gravity(False)
    session.advance(1.0)
    assert np.abs(session.frame.position).max() < 1e-15


def test_reset_forgets_the_pushes(session):
    session = pushed(session(), 1)
    session.reset()
    assert session.time == 0.0
    assert not session.frame.position.any()
    assert not session.raw["force"]


def test_a_recorded_session_says_what_it_is(session):
    session = session()
    with pytest.raises(ValueError, match="t = 0"):
        recorded(session)
    session.advance(0.1)
    session.apply(UserPush(0, CORNER, UP, 0.02))
    text = recorded(session)
    assert text.startswith("# Recorded by `particlerb view`")
    data = tomllib.loads(text)
    assert data["force"][0]["during"] == [0.1, 0.12000000000000001]
    assert data["run"]["t_end"] == 0.12000000000000001  # to the end of the push that begins now


@pytest.mark.plain
def test_forces_of_the_case_that_begin_later_are_left_out_of_a_record(make):
    """No run may have them; an impulse of this instant is kept."""
    knots = {"times": [0.3, 0.4], "values": [[0, 0, 1], [0, 0, 2]]}
    later = [
        make.impulse([0.5, 0, 0], [0, 0.1, 0], 0.25),
        {"type": "push", "body": "body", "force": knots},
        make.push([0, 1, 0], [0.1, 0, 0], "body", during=[0.33, 0.5]),
    ]
    body = make.body(angular_velocity=[1.0, 0.4, -0.7])
    session = Session(to_system(make.case(body, force=later, t_end=1.0, every=0.1, dt=0.01)))
    session.advance(0.1)
    assert "later forces are left out" in recorded(session)
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert live[0] == pytest.approx(batch, abs=1e-12)
    session.advance(0.25)
    assert [f["type"] for f in tomllib.loads(recorded(session))["force"]] == ["impulse"]
    assert batch_of(session)[2][0] == pytest.approx([0.5, 0.0, 0.0])
    session.advance(0.4)
    assert "bit for bit" in recorded(session)
    for live, batch in zip(session.frame[:4], batch_of(session), strict=True):
        assert (live[0] == batch).all()
