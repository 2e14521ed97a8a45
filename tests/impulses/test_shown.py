"""How well contacts were solved is in every frame, and checks may ask for it."""

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    G,
    R,
    assert_goes_on_alike,
    case,
    clump,
    exact,
    impulse,
    plane,
    sphere,
)

import particlerb
from particlerb import Simulation
from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli.run import impulse_text
from particlerb.impulses.records import STEPS, TALLY, UNMET
from particlerb.simulation.checks import results
from particlerb.simulation.run import prepare, run_prepared
from particlerb.simulation.run_warnings import run_warnings

NAMES = ("impulse_residual", "impulse_overlap", "push_out_work")


def stack(**keys):
    """Boxes that one sweep does not hold, and that are let fall a little."""
    boxes = [clump(f"b{i}", position=[0, 0, 2.1 * R + 4.1 * R * i]) for i in range(3)]
    contact = impulse(0.0, 0.5, iterations=1, tolerance=1e-6, solver="sweeps")
    return case(*boxes, contact=contact, wall=[plane()], gravity=DOWN,
                **({"dt": 5e-3, "t_end": 0.4, "every": 0.1} | keys))  # fmt: skip


def test_frames_show_the_overlap_of_a_bounce_where_it_was():
    dt, height = 5e-3, 0.5
    ball = sphere(position=[0, 0, height + R])
    t = particlerb.run(
        case(ball, contact=impulse(1.0), wall=[plane()], gravity=DOWN, dt=dt, t_end=0.6, every=0.1)
    )
    overlap, speed = t.observable("impulse_overlap"), np.sqrt(2 * G * height)
    hit = int(np.ceil(np.sqrt(2 * height / G) / 0.1))
    assert 0.0 < overlap[hit] < speed * dt
    assert overlap[:hit] == pytest.approx(0.0, abs=0.0)
    assert overlap[hit + 1 :] == pytest.approx(0.0, abs=0.0)
    assert t.observable("push_out_work") == pytest.approx(0.0, abs=0.0)


def test_frames_show_residuals_and_what_was_pushed_out_and_a_resumed_run_the_same(tmp_path):
    whole = assert_goes_on_alike(stack(), 0.2, tmp_path / "part.h5", NAMES)
    residual, work = whole.observable("impulse_residual"), whole.observable("push_out_work")
    assert residual[0] == 0.0
    assert (residual[1:] > 1e-6).any()
    assert work[-1] > 0.0
    gained = np.diff(whole.energy)  # a step may gain what it pushes out, and m (g h)²/2 a contact
    assert (gained <= np.diff(work) + 20 * 12 * 0.5 * (G * 5e-3) ** 2).all()


def test_what_is_looked_at_between_frames_is_in_the_next_frame_too(tmp_path):
    checks = {"quantity": "impulse_overlap", "value": 0.0, "tolerance": 1.0}
    looked = stack() | {"check": {"value": [checks | {"time": t} for t in (0.13, 0.19, 0.37)]}}
    plain, probed = particlerb.run(stack()), particlerb.run(looked)
    with Simulation(stack(), tmp_path / "by_hand.h5") as simulation:
        for until in (0.09, 0.13, 0.4):
            simulation.advance(until)
    with particlerb.open(tmp_path / "by_hand.h5") as by_hand:
        for name in NAMES:
            right = plain.observable(name)
            assert probed.observable(name).tolist() == right.tolist()
            assert by_hand.observable(name).tolist() == right.tolist()


def test_a_check_asks_for_the_largest_residual_and_overlap_until_then():
    asked = [{"quantity": name, "value": 0.0, "tolerance": 1e-6} for name in NAMES]
    asked.append({"quantity": "impulse_overlap", "value": 0.0, "tolerance": 1.0, "time": 0.05})
    system = to_system(stack() | {"check": {"value": asked}})
    outcome = run_prepared(prepare(system), None)
    residual, overlap, work, early = results(system, outcome)
    t = particlerb.run(stack())
    assert residual.error == t.observable("impulse_residual").max()
    assert overlap.error == t.observable("impulse_overlap").max()
    assert work.error == t.observable("push_out_work")[-1]
    assert not residual.holds
    assert early.holds
    assert residual.name == "impulse_residual of all contacts at 0.4 s"


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"contact": {"stiffness": 1e5, "restitution": 0.5, "friction": 0.5}},
         "there is no impulse_residual without impulses"),
        ({"contact": impulse(), "body": "ball"}, "impulse_residual is of all contacts"),
    ],
)  # fmt: skip
def test_a_check_of_impulses_is_refused_where_it_asks_for_nothing(keys, words):
    asked = {"quantity": "impulse_residual", "value": 0.0, "tolerance": 1e-6}
    asked |= {"body": keys["body"]} if "body" in keys else {}
    scene = case(sphere(position=[0, 0, R]), contact=keys["contact"], wall=[plane()])
    with pytest.raises(CaseError) as error:
        to_system(scene | {"check": {"value": [asked]}})
    assert words in str(error.value)


@pytest.mark.plain
@pytest.mark.parametrize("solver", ["sweeps", "newton"])
def test_a_run_whose_impulses_were_not_found_says_so_with_the_time(solver):
    """A light ball under a heavy one, which comes after another segment has begun."""
    light, heavy = sphere("light", position=[0, 0, R]), sphere("heavy", position=[0, 0, 3.2 * R])
    heavy["mass"] = 2e4
    push = {"type": "push", "body": "light", "force": [0, 0, -1e-9], "during": [0.02, 0.04]}
    scene = case(light, heavy, contact=impulse(solver=solver), wall=[plane()], gravity=DOWN,
                 force=[push], dt=5e-3, t_end=0.1, every=5e-3)  # fmt: skip
    prepared = prepare(to_system(scene))
    told = run_warnings(prepared, run_prepared(prepared, None))
    t = particlerb.run(scene)
    residual = t.observable("impulse_residual")
    if solver == "newton":
        assert told == []
        assert residual.max() <= 1e-3
    else:
        time = t.time[residual.argmax()] - 2.5e-3
        assert len(told) == 1
        assert f"the residual reached {residual.max():.2g} at t = {time:.6g} s" in told[0]
        assert 'contact.iterations or contact.solver = "newton"' in told[0]


@pytest.mark.plain
@pytest.mark.parametrize("unmet", [0.0, 3.0])
def test_the_summary_says_what_lowers_a_residual_that_is_too_large(unmet):
    tally = np.zeros(TALLY)
    tally[[STEPS, UNMET]] = 8.0, unmet
    advice = 'tolerance in 3 of 8 steps (contact.iterations or solver = "newton" lower it)'
    assert (advice in impulse_text(tally)) == (unmet > 0.0)


@pytest.mark.plain
@pytest.mark.parametrize(("masses", "held"), [((1.0, 10.0), False), ((10.0, 1.0), False),
                                              ((1.0, 1.0), True), ((1.0,), False)])  # fmt: skip
def test_contacts_show_how_deep_two_overlap_wherever_the_impulse_acts(masses, held):
    """On a floor, at the lighter of two, on what lies on a held one: the overlap is 2 mm."""
    deep, names = 2e-3, ("a", "b")
    balls = [
        sphere(names[i], mass=m, position=[0, 0, (2 * i + 1) * R - (i + 1) * deep])
        for i, m in enumerate(masses)
    ]
    if held:
        balls[0] |= {"fixed": True}
    contact = exact(0.0, 0.0, overlap=0.01, push_out=0.0)
    output = {"fields": ["contacts", "contact_overlap"]}
    t = particlerb.run(case(*balls, contact=contact, wall=[plane()], gravity=DOWN, output=output,
                            dt=1e-3, t_end=2e-3, every=1e-3))  # fmt: skip
    assert t.contact_overlap[-1] == pytest.approx(deep, rel=1e-9)
    n = len(masses) - held
    assert t.contacts(2).overlap == pytest.approx(np.full(n, deep), rel=1e-9)
