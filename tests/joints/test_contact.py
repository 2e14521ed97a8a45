"""Jointed bodies that touch: stops, floors, energy, order, resuming, threads."""

import numpy as np
import pytest
from holds import misfits
from scenes import Y, case, joint, moved

import particlerb
from particlerb import CaseError
from particlerb.case.to_system import to_system
from particlerb.record.verify import verify
from particlerb.simulation.run import prepare

G = 9.81
FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum"]
FIELDS += ["velocity", "angular_velocity"]
ELASTIC = {"stiffness": 2e4, "restitution": 1.0, "friction": 0.0}


plain = pytest.mark.plain


def string_of(n, length, radius=0.05, **keys):
    """A body of n spheres along x."""
    place = [[length * (k / (n - 1) - 0.5), 0.0, 0.0] for k in range(n)]
    shape = {"type": "points", "position": place, "mass": [1.0 / n] * n, "radius": [radius] * n}
    return {"shape": shape, **keys}


def door(contact=None, floor=-0.4):
    """A bent bar on a hinge at the origin that falls onto a floor."""
    bar = string_of(5, 1.0, name="door", position=[0.5, 0.0, 0.04])
    for k, place in enumerate(bar["shape"]["position"]):
        place[2] = 0.02 * k
    hinge = joint("hinge", "door", None, [0, 0, 0], Y)
    scene = case([bar], [hinge], output={"fields": FIELDS})
    if contact is None:
        return scene
    wall = {"name": "floor", "type": "plane", "point": [0, 0, floor], "normal": [0, 0, 1.0]}
    return {**scene, "contact": contact, "wall": [wall]}


def chain(contact, n=4, **keys):
    """Links on balls that overlap at the joints, above a floor."""
    link = string_of(3, 0.2, name="link", count=n)
    link["position"] = [[0.2 * k, 0.01 * k, 0.3 + 0.02 * k] for k in range(n)]
    ends = {"at": {"body": [-0.1, 0, 0]}, "at_to": {"body": [0.1, 0, 0]}}
    tie = {"type": "ball", "body": "link", "chain": True, **ends, "assemble": True}
    wall = {"name": "floor", "type": "plane", "point": [0, 0, 0], "normal": [0, 0, 1.0]}
    scene = case([link], [tie | keys], output={"fields": FIELDS})
    return {**scene, "contact": contact, "wall": [wall]}


def test_a_door_bounces_off_a_stop_with_the_speed_with_which_it_came():
    with moved(door(ELASTIC), 0.6, 2e-4, every=1e-3) as trajectory:
        x, w = np.array(trajectory.position)[:, 0], np.array(trajectory.angular_velocity)[:, 0, 1]
        ledger = trajectory.ledger
        assert np.abs(ledger.energy_error).max() < 1e-4
        assert np.abs(ledger.angular_momentum_error).max() < 1e-12
        g, rate = misfits(trajectory, [joint("hinge", "door", None, [0, 0, 0], Y)])
    turn = 1 + np.flatnonzero(np.diff(np.sign(w[1:])))[0]
    assert x[turn, 2] < -0.1
    down = np.flatnonzero((x[:, 2] > -0.1) & (np.arange(x.shape[0]) < turn))[-1]
    up = turn + np.flatnonzero(x[turn:, 2] > -0.1)[0]
    came, went = (np.interp(-0.1, *order(x[k : k + 2, 2], w[k : k + 2])) for k in (down, up - 1))
    assert went == pytest.approx(-came, rel=2e-5)
    assert came == pytest.approx(np.sqrt(2 * (x[0, 2] + 0.1) * G / moment()), rel=1e-4)
    assert g < 1e-13
    assert rate < 1e-11


def moment():
    """Σ m r² of the door about its hinge, of 1 kg in five solid spheres."""
    place = np.array([[k / 4, 0.02 * k] for k in range(5)])
    return (place**2).sum() / 5 + 0.4 * 0.05**2


def order(x, y):
    """Both, so that x ascends."""
    return (x, y) if x[0] < x[1] else (x[::-1], y[::-1])


@plain
def test_contact_that_does_not_act_changes_nothing():
    with moved(door(), 0.3, 5e-3) as free, moved(door(ELASTIC, -9.0), 0.3, 5e-3) as other:
        assert np.abs(np.array(free.position) - np.array(other.position)).max() < 1e-14


@plain
def test_reactions_that_are_not_known_are_gaps_of_a_whole_file(tmp_path):
    """By impulses no one knows before the first step."""
    scene = door({"law": "impulse", "restitution": 0.0, "friction": 0.0}, -9.0)
    fields = [*scene["output"]["fields"], "joint_force", "joint_force_determined"]
    run = {"t_end": 0.02, "every": 0.01, "dt": 5e-3}
    path = tmp_path / "door.h5"
    particlerb.run({**scene, "run": run, "output": {"fields": fields}}, path).close()
    with particlerb.open(path) as t:
        assert np.isnan(t.joint_force).all(axis=(1, 2)).tolist() == [True, False, False]
        assert not t.joint_force_determined[0].any()
        assert all(finding.is_whole for finding in verify(t))


@plain
def test_a_door_above_a_floor_falls_at_order_two():
    ends = []
    for dt in (8e-3, 4e-3, 2e-3):
        with moved(door(ELASTIC), 0.24, dt) as trajectory:
            ends.append(np.array(trajectory.position)[-1, 0])
    coarse, fine = (np.linalg.norm(ends[k] - ends[k + 1]) for k in (0, 1))
    assert coarse / fine == pytest.approx(4.0, rel=0.02)


@plain
def test_the_energy_of_a_bounce_with_friction_and_damping_is_of_order_two():
    contact = {"stiffness": 3000.0, "restitution": 0.4, "friction": 0.3}
    errors = []
    for dt in (2e-3, 5e-4):
        with moved(door(contact, -0.1), 0.3, dt, every=0.02) as trajectory:
            errors.append(np.abs(trajectory.ledger.energy_error).max())
            assert trajectory.ledger.work[-1] < -0.5
    assert errors[0] / errors[1] > 10.0


@plain
def test_a_chain_falls_on_the_floor_and_its_joints_hold():
    contact = {"stiffness": 2e4, "restitution": 0.3, "friction": 0.3}
    with moved(chain(contact), 0.5, 5e-4, every=0.02) as trajectory:
        x, ledger = np.array(trajectory.position), trajectory.ledger
        turnover = np.abs(ledger.work).max()
        assert np.abs(ledger.energy_error).max() < 2e-3 * turnover
        assert np.abs(ledger.linear_momentum_error).max() < 1e-12
        assert np.abs(ledger.angular_momentum_error).max() < 1e-12
        p0, p1 = (np.array(trajectory.position)[-1, k] for k in (0, 1))
        loads = particlerb.joint_loads(trajectory)
    assert x[:, :, 2].min() > 0.04
    assert x[-1, :, 2].max() < 0.2
    assert loads.misfit.max() < 1e-13
    assert np.linalg.norm(p0 - p1) < 0.2 + 1e-12


@plain
def test_jointed_bodies_touch_each_other_only_if_they_are_told_to():
    contact = {"stiffness": 2e4, "restitution": 0.3, "friction": 0.3}
    times = {"t_end": 0.1, "every": 0.1}
    prepare(to_system({"run": times, **chain(contact)}))
    with pytest.raises(CaseError, match="bodies overlap at t = 0"):
        prepare(to_system({"run": times, **chain(contact, collide=True)}))


def test_a_chain_that_touches_goes_on_bit_for_bit(tmp_path):
    contact = {"stiffness": 2e4, "restitution": 0.3, "friction": 0.3}
    scene, path = chain(contact), tmp_path / "run.h5"
    times = {"every": 0.05, "dt": 1e-3}
    particlerb.run({"run": {"t_end": 0.25, **times}, **scene}, path).close()
    particlerb.resume(path, 0.4).close()
    whole = particlerb.run({"run": {"t_end": 0.4, **times}, **scene})
    with particlerb.open(path) as resumed, whole:
        assert (np.array(resumed.position) == np.array(whole.position)).all()
        assert (np.array(resumed.angular_momentum) == np.array(whole.angular_momentum)).all()


@plain
def test_a_body_hangs_on_one_that_is_held():
    ball = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    bodies = [ball | {"name": "hook", "position": [0, 0, 1.0], "fixed": True},
              ball | {"name": "bob", "position": [0.6, 0, 0.2]}]  # fmt: skip
    scene = case(bodies, [{"type": "distance", "body": "bob", "to": "hook"}], contact=ELASTIC)
    with moved(scene, 0.5, 2e-3, every=0.1) as trajectory:
        x = np.array(trajectory.position)
        assert (x[:, 0] == [0, 0, 1.0]).all()
        assert np.abs(x[-1, 1] - x[0, 1]).max() > 0.1
        assert np.linalg.norm(x[:, 1] - x[:, 0], axis=1) == pytest.approx([1.0] * 6, abs=1e-13)
        assert np.abs(trajectory.ledger.linear_momentum_error).max() < 1e-13
