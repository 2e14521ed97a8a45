"""Bodies with nothing in reach fly in closed form, and nothing else changes."""

import numpy as np
import pytest

import particlerb
from particlerb.case.to_system import to_system
from particlerb.integrators import METHODS
from particlerb.model.state import as_frame
from particlerb.simulation.group_run import GroupRun
from particlerb.simulation.run import prepare, run_prepared
from particlerb.stepping import sparse_contact as dilute
from particlerb.stepping.contact_motion import ContactMotion

DUMBBELL = {"type": "points", "position": [[-0.08, 0, 0], [0.08, 0, 0]], "mass": 0.5, "radius": 0.1}


def gas(n: int, t_end: float = 0.3, **keys) -> dict:
    """Dumbbells of balls with random velocities in a box, without loss."""
    side = 0.5 * n
    body = {
        "name": "d", "shape": DUMBBELL, "count": n**3, "place": {"type": "grid", "spacing": 1.0},
        "orientation": "random", "velocity": {"random": 1.5},
    }  # fmt: skip
    corner = [side] * 3
    wall = {"name": "box", "type": "box", "lower": [-side] * 3, "upper": corner}
    run = {"t_end": t_end, "every": t_end / 2, "dt": 2e-4, "seed": 3} | keys
    contact = {"stiffness": 1e5, "restitution": 1.0, "friction": 0.0}
    return {"run": run, "contact": contact, "wall": [wall], "body": [body]}


@pytest.mark.compiled
def test_bodies_fly_as_they_are_stepped(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    flown = particlerb.run(gas(4))
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10**9)
    stepped = particlerb.run(gas(4))
    assert (np.abs(np.diff(stepped.linear_momentum, axis=0)) > 0.1).any()  # some have met
    # an interval that begins within a step of a touch knows the velocity there a little better
    np.testing.assert_allclose(flown.position, stepped.position, atol=2e-5)
    np.testing.assert_allclose(flown.orientation, stepped.orientation, atol=1e-4)
    assert np.abs(flown.ledger.energy_error).max() < 1e-4 * flown.ledger.kinetic_energy[0]


@pytest.mark.compiled
def test_frames_do_not_change_the_motion(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    few, many = particlerb.run(gas(3)), particlerb.run(gas(3, every=0.011))
    assert (few.position[-1] == many.position[-1]).all()
    assert (few.angular_momentum[-1] == many.angular_momentum[-1]).all()


@pytest.mark.compiled
def test_long_run_goes_on_where_a_short_one_ends(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    long, short = particlerb.run(gas(3, t_end=0.3)), particlerb.run(gas(3, t_end=0.15, every=0.15))
    assert long.time[1] == short.time[1]
    assert (long.position[1] == short.position[1]).all()


@pytest.mark.compiled
def test_share_of_steps_that_is_saved_is_told(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    prepared = prepare(to_system(gas(4)))
    assert "closed form where none is in reach" in prepared.text
    outcome = run_prepared(prepared, None)
    assert 0.1 < outcome.flown < 1.0


@pytest.mark.compiled
def test_dense_bodies_are_all_stepped(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    dense = gas(3, t_end=0.02)
    dense["body"][0]["place"]["spacing"] = 0.38
    dense["body"][0]["velocity"] = {"random": 0.1}
    assert run_prepared(prepare(to_system(dense)), None).flown == 0.0


@pytest.mark.plain
@pytest.mark.parametrize("spacing", [0.38, 1.0])
def test_dense_bodies_are_set_up_once(monkeypatch, spacing):
    """The first interval has all of them; where some fly, one more tells what all have stored."""
    made = []

    def noted(*given, **named):
        made.append(given[1].members.size)
        return ContactMotion(*given, **named)

    monkeypatch.setattr(dilute, "ContactMotion", noted)
    case = gas(3, t_end=0.02)
    case["body"][0]["place"]["spacing"] = spacing
    (group,) = prepare(to_system(case)).plan.groups
    segment, state = group.segments[0], prepare(to_system(case)).system.state
    motion = dilute.DiluteMotion(METHODS["strang"], group.group(segment), state, 0.0, segment.dt)
    assert sum(made) == made[-1] == 27
    assert motion.initial_energies.potential == [0.0]


def test_only_bodies_under_nothing_but_gravity_fly():
    case = gas(7)
    group = prepare(to_system(case)).plan.groups[0]
    assert dilute.can_fly(METHODS["strang"], group.segments[0].terms, group.members.size)
    assert not dilute.can_fly(METHODS["rk4"], group.segments[0].terms, group.members.size)
    assert not dilute.can_fly(METHODS["strang"], group.segments[0].terms, dilute.LEAST_BODIES - 1)
    case["force"] = [{"type": "drag", "body": "d", "translation": 0.1}]
    group = prepare(to_system(case)).plan.groups[0]
    assert not dilute.can_fly(METHODS["strang"], group.segments[0].terms, group.members.size)


def among_flying_ones(**ball) -> dict:
    """A ball of 1 kg above a floor, beside twelve dumbbells that meet nothing."""
    case = gas(1, every=0.3, dt=1e-3) | {"gravity": {"acceleration": [0, 0, -9.81]}}
    case["body"][0] |= {"count": 12, "place": {"type": "grid", "spacing": 2.0}}
    case["body"][0]["velocity"] = {"random": 0.1}
    shape = {"type": "ball", "radius": 0.1, "arrangement": "exact"}
    case["body"].append({"name": "ball", "shape": shape, "mass": 1.0} | ball)
    case["contact"] = {"stiffness": 1e4, "restitution": 0.3, "friction": 0.3, "overlap": 1e-3}
    case["wall"] = [{"name": "floor", "type": "plane", "normal": [0, 0, 1], "point": [0, 0, -30]}]
    return case


def dilute_motion(case: dict) -> dilute.DiluteMotion:
    """Motion of the first group of a case."""
    motion = GroupRun(prepare(to_system(case)).plan.groups[0], to_system(case).state).motion
    assert isinstance(motion, dilute.DiluteMotion)
    return motion


@pytest.mark.plain
def test_what_contacts_have_lost_is_counted_where_no_frame_was_looked_at(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    case = among_flying_ones(position=[0, 0, -29.65], velocity=[0, 0, -3.0])
    looked_at, unseen = dilute_motion(case), dilute_motion(case)
    frames = as_frame(to_system(case).bodies, to_system(case).state)
    for time in (0.1, 0.2):
        looked_at.record(np.array([time]), np.zeros(1, dtype=int), frames)
        looked_at.finish(time)
        unseen.finish(time)
        assert looked_at.active.sum() == 1  # the others fly
        assert looked_at.gross_work() == unseen.gross_work() > 3.0  # J, of 0.5·3²


@pytest.mark.plain
def test_swings_of_the_few_that_touch_are_seen_also_after_a_checkpoint(monkeypatch):
    monkeypatch.setattr(dilute, "LEAST_BODIES", 10)
    case = among_flying_ones(position=[0, 0, -29.9 - 9.81e-4])
    motion, resumed = dilute_motion(case), dilute_motion(case)
    motion.finish(0.05)
    assert motion.active.sum() == 1
    resumed.restore(motion.checkpoint())
    for one in (motion, resumed):
        one.finish(0.2)
    assert motion.count > 2
    assert motion.contact_frequency == pytest.approx(100.0, rel=0.01)  # √(k/m), from below
    assert resumed.contact_frequency == motion.contact_frequency
