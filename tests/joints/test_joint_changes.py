"""Motors, springs, dampers and friction in joints that change while a simulation goes on."""

import numpy as np
import pytest
from numba import typeof
from scenes import X, Y, bar, body, case, joint

import particlerb
from particlerb import CaseError, Simulation

pytestmark = pytest.mark.plain

MOMENT = 0.5  # kg m² of a wheel about its axle
LEAST = 1e-300  # what acts, and changes no bit


def wheel(spin=0.0, **keys):
    """A wheel on an axle along y through its centre; half of it is another body, welded on."""
    halves = [
        body(name, 1.0, [0.2, 0.5 * MOMENT, 0.2], [0, 0, 0], spin=[0, spin, 0]) for name in "ab"
    ]
    joints = [
        joint("hinge", "a", None, [0, 0, 0], Y, name="axle", **keys),
        joint("fixed", "b", "a"),
    ]
    return case(halves, joints, (0, 0, 0), output={"fields": ["position", "joint_coordinate"]})


def simulated(scene, t_end, dt, path=None, **keys):
    """A simulation with a frame for each step."""
    return Simulation({"run": {"t_end": t_end, "every": dt, "dt": dt} | keys, **scene}, path)


def without_stiffness(scene):
    """The scene with contact by impulses, where nothing touches."""
    bodies = [one | {"contact": False} for one in scene["body"]]
    return scene | {"body": bodies, "contact": {"law": "impulse"}}


def rate(simulation):
    """Angular velocity of the first body about y [rad/s]."""
    return simulation.state.angular_velocity[0, 1]


def test_a_motor_that_is_changed_turns_a_wheel_by_the_closed_form(tmp_path):
    """Constant accelerations, one after the other, over many turns; no type is another one."""
    edges, torques = [0.0, 0.5, 1.123, 1.123, 1.6, 2.0], [0.0, 40.0, 3.0, -7.0, 0.0]
    with simulated(wheel(motor=0), 2.0, 0.02, tmp_path / "a.h5", method="rattle") as simulation:
        (first,) = (typeof(group.motion.bodies.moving) for group in simulation._run.group_runs)
        for time, torque in zip(edges, torques, strict=False):
            simulation.advance(time)
            simulation.change("joint[0].motor", torque)
            assert abs(simulation.energy_error) < 1e-11
            (now,) = (typeof(group.motion.bodies.moving) for group in simulation._run.group_runs)
            assert now == first
        simulation.advance(2.0)
        assert abs(simulation.energy_error) < 1e-11
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        angle, t = trajectory.joint_coordinate[:, 0], trajectory.time
        work = trajectory.ledger.work[-1]
    spans = np.clip(t[:, None] - edges[:-1], 0.0, np.diff(edges))
    omega, exact = np.zeros(t.size), np.zeros(t.size)
    for span, torque in zip(spans.T, torques, strict=True):
        exact += omega * span + 0.5 * torque / MOMENT * span**2
        omega += torque / MOMENT * span
    assert exact[-1] > 8.0 * np.pi
    assert angle == pytest.approx(exact, abs=1e-10)
    assert work == pytest.approx(0.5 * MOMENT * omega[-1] ** 2, rel=1e-12)


def test_a_motor_with_a_largest_torque_changes_both_and_leaves_its_stop():
    """It speeds up, faster, keeps its speed, presses against a hard stop, less, and goes back."""
    scene = wheel(motor={"speed": 1.0, "largest": 1.0}, limit={"range": [-1.0, 1.0]})
    simulation = simulated(without_stiffness(scene), 3.0, 0.05)
    simulation.advance(0.2)
    assert rate(simulation) == pytest.approx(0.4, abs=1e-13)
    simulation.change("joint[0].motor.largest", 2.0)
    simulation.advance(0.35)
    assert rate(simulation) == pytest.approx(1.0, abs=1e-13)
    simulation.change("joint[0].motor", {"speed": 2.0, "largest": 1.0})
    simulation.advance(0.6)
    assert rate(simulation) == pytest.approx(1.5, abs=1e-13)
    simulation.advance(1.5)
    assert abs(turned(simulation) - 1.0) < 1e-9
    simulation.change("joint[0].motor.largest", 0.1)
    simulation.advance(2.0)
    assert abs(turned(simulation) - 1.0) < 1e-9
    simulation.change("joint[0].motor.speed", -5.0)
    simulation.advance(2.5)
    assert turned(simulation) == pytest.approx(1.0 - 0.5 * 0.1 / MOMENT * 0.25, abs=1e-9)
    assert abs(simulation.energy_error) < 1e-12


def turned(simulation):
    """Angle of the first body about y, from its start on [rad]."""
    q = simulation.state.orientation[0]
    return 2.0 * np.arctan2(q[2], q[0])


def test_friction_that_is_changed_brakes_by_what_it_is_now():
    simulation = simulated(without_stiffness(wheel(3.0, friction=0.5)), 2.0, 0.05)
    simulation.advance(0.5)
    simulation.change("joint[0].friction", 2.0)
    simulation.advance(0.8)
    assert rate(simulation) == pytest.approx(3.0 - (0.5 * 0.5 + 2.0 * 0.3) / MOMENT, abs=1e-12)
    assert abs(simulation.energy_error) < 1e-12


def test_a_spring_and_a_damper_that_are_changed_are_counted():
    """Of order two: a swing about another rest with another stiffness, then e^(-c t/I)."""
    simulation = simulated(wheel(2.0, spring={"stiffness": 8.0}, damper=LEAST), 2.0, 0.002)
    simulation.advance(0.25)
    assert turned(simulation) == pytest.approx(0.5 * np.sin(4.0 * 0.25), abs=1e-5)
    x, v = turned(simulation), rate(simulation)
    simulation.change("joint[0].spring", {"stiffness": 32.0, "rest": 0.3})
    assert simulation.energy == pytest.approx(0.25 * v * v + 16.0 * (x - 0.3) ** 2, rel=1e-12)
    simulation.advance(0.65)
    exact = 0.3 + (x - 0.3) * np.cos(8.0 * 0.4) + v / 8.0 * np.sin(8.0 * 0.4)
    assert turned(simulation) == pytest.approx(exact, abs=3e-5)
    simulation.change("joint[0].spring.stiffness", LEAST)
    v = rate(simulation)
    simulation.change("joint[0].damper", 2.0)
    simulation.advance(1.0)
    assert rate(simulation) == pytest.approx(v * np.exp(-2.0 * 0.35 / MOMENT), rel=1e-4)
    assert abs(simulation.energy_error) < 1e-3


def test_a_hard_stop_moves_away_and_lets_a_motor_on():
    """A wheel that presses against it begins anew from rest, to where the stop is now."""
    simulation = simulated(without_stiffness(wheel(motor=1.0, limit={"range": [-1, 1]})), 4.0, 0.05)
    simulation.advance(2.0)
    assert abs(turned(simulation) - 1.0) < 1e-9
    simulation.change("joint[0].limit.range", [-1.0, 1.5])
    simulation.advance(2.5)
    assert turned(simulation) == pytest.approx(1.0 + 0.5 / MOMENT * 0.5**2, abs=1e-9)
    simulation.advance(4.0)
    assert abs(turned(simulation) - 1.5) < 1e-9
    assert abs(simulation.energy_error) < 1e-12


def test_a_stop_with_a_stiffness_moves_to_where_a_wheel_is():
    """What that stores is counted, and it swings back about the stop's new place."""
    limit = {"range": [-1.0, 1.0], "stiffness": 32.0}
    simulation = simulated(wheel(2.0, limit=limit), 2.0, 0.002)
    simulation.advance(0.4)
    assert turned(simulation) == pytest.approx(0.8, abs=1e-12)
    simulation.change("joint[0].limit.range", [-1.0, 0.5])
    assert simulation.energy == pytest.approx(0.25 * 4.0 + 16.0 * 0.3**2, rel=1e-12)
    simulation.advance(0.55)
    x = 0.5 + 0.3 * np.cos(8.0 * 0.15) + 0.25 * np.sin(8.0 * 0.15)
    assert turned(simulation) == pytest.approx(x, abs=3e-5)
    simulation.change("joint[0].limit.stiffness", 8.0)
    y, v = x - 0.5, rate(simulation)
    simulation.advance(0.65)
    assert turned(simulation) - 0.5 == pytest.approx(
        y * np.cos(4.0 * 0.1) + v / 4.0 * np.sin(4.0 * 0.1), abs=6e-5
    )
    assert abs(simulation.energy_error) < 1e-3


def test_a_loop_holds_a_pendulum_at_an_angle():
    """Feedback on angle and rate, and the torque of the weight: it comes to rest at 0.4 rad."""
    arm, wanted = bar("arm", [0, 0, 0], [1, 0, 0]), -0.4
    hinge = joint("hinge", "arm", None, [0, 0, 0], Y, motor=0)
    simulation = simulated(case([arm], [hinge]), 3.0, 0.015, method="rattle")
    for state in simulation.frames(every=0.03):
        q, start = state.orientation[0], arm["orientation"]
        angle = 2.0 * np.arctan2(start[0] * q[2] - start[2] * q[0], q @ start)
        weight = 9.81 * 0.5 * np.cos(angle)
        torque = 40.0 * (wanted - angle) - 7.0 * state.angular_velocity[0, 1] - weight
        simulation.change("joint[0].motor", torque)
    assert angle == pytest.approx(wanted, abs=1e-6)
    assert torque == pytest.approx(-9.81 * 0.5 * np.cos(wanted), rel=1e-5)
    assert abs(simulation.energy_error) < 1e-4


HELD = {"limit": {"range": [-1.0, 1.0]}}  # by impulses


@pytest.mark.parametrize(
    ("keys", "key", "value", "words"),
    [
        ({}, "joint[0].motor", 1.0, r"joint\[0\]\.motor: .*\n.*from the start: motor = 0"),
        ({"motor": 1.0}, "joint[0].motor", None, "comes, goes or is of another kind"),
        ({"motor": 1.0}, "joint[0].motor", {"speed": 1.0, "largest": 1.0}, "of another kind"),
        ({"motor": 1.0}, "joint[0].motor.speed", 1.0, "there is no 'speed'"),
        ({"damper": 1.0}, "joint[0].damper", 0.0, r"joint\[0\]\.damper: cannot change in a sim"),
        ({}, "joint[0].friction", 2.0, r"joint\[0\]\.friction: cannot change in a simulation"),
        ({}, "joint[0].spring", {"stiffness": 2.0}, r"joint\[0\]\.spring: cannot change in a sim"),
        ({}, "joint[0].axis", X, r"joint\[0\]\.axis: cannot change in a simulation"),
        ({}, "joint[0].limit.range", [-0.9, 2], r"limit\.range: a hard stop moves outwards alone"),
        ({}, "joint[0].limit.stiffness", 2.0, r"joint\[0\]\.limit: cannot change"),
        ({}, "joint[0].limit", None, r"joint\[0\]\.limit: cannot change"),
        ({}, "joint[1].merge", False, r"joint\[1\]\.merge: cannot change in a simulation"),
        (
            {},
            "joint",
            [joint("hinge", "a", axis=Y)],
            "joint: their number cannot change in a simulation",
        ),
    ],
)
def test_what_acts_and_joints_themselves_stay(keys, key, value, words):
    simulation = simulated(without_stiffness(wheel(**HELD | keys)), 1.0, 0.1)
    before = simulation.system
    with pytest.raises(CaseError, match=words):
        simulation.change(key, value)
    assert simulation.system is before


def steered(simulation, looks=()):
    """A wheel whose speed rises, which then goes through points, and rests; also looked at."""
    changes = [
        (0.5, {"speed": [[0.5, 1.0], [1.0, 2.0]]}),
        (1.2, {"position": [[1.2, 1.65], [1.6, 2.0]], "end_speeds": [2.0, 0.0]}),
        (1.6, {"amplitude": 0.0, "frequency": 1.0}),
    ]
    for time, drive in changes:
        for look in looks:
            simulation.advance(max(simulation.time, min(look, time)))
            assert np.isfinite(simulation.energy)
        simulation.advance(time)
        simulation.change("joint[0].drive", drive)
    return simulation.advance(2.0)


def test_set_points_of_a_drive_follow_each_other():
    """Angles of the closed forms; the work is what the wheel has gained; no type is another one."""
    simulation = simulated(wheel(1.0, drive={"speed": 1.0}), 2.0, 0.02)
    (first,) = (typeof(group.motion.bodies.moving) for group in simulation._run.group_runs)
    simulation.advance(0.5)
    simulation.change("joint[0].drive.speed", [[0.5, 1.0], [1.0, 2.0]])
    assert turned(simulation) == pytest.approx(0.5, abs=1e-12)
    simulation.advance(1.0)
    assert turned(simulation) == pytest.approx(1.25, abs=1e-12)
    assert rate(simulation) == pytest.approx(2.0, abs=1e-12)
    assert simulation.energy == pytest.approx(0.5 * MOMENT * 4.0, rel=1e-12)
    assert abs(simulation.energy_error) < 1e-3
    simulation.change("joint[0].drive", {"position": [[1, 1.25], [1.5, 2]], "end_speeds": [2, 0]})
    simulation.advance(1.25)
    middle = 0.5 * (1.25 + 2.0) + 0.5 * (2.0 - 0.0) / 8.0  # of a cubic: (x + y)/2 + h (v - w)/8
    assert turned(simulation) == pytest.approx(middle, abs=1e-12)
    simulation.advance(1.5)
    simulation.change("joint[0].drive", {"amplitude": 0.1, "frequency": 1.0, "phase": np.pi / 2})
    simulation.advance(1.75)
    assert turned(simulation) == pytest.approx(2.0 + 0.1, abs=1e-12)
    assert abs(simulation.energy_error) < 2e-3
    (now,) = (typeof(group.motion.bodies.moving) for group in simulation._run.group_runs)
    assert now == first


def test_looks_between_changes_of_a_drive_change_no_bit():
    one, two = (simulated(wheel(1.0, drive={"speed": 1.0}), 2.0, 0.02) for _ in range(2))
    for got, other in zip(steered(one)[1:5], steered(two, (0.3, 0.77, 1.31))[1:5], strict=True):
        assert got.tobytes() == other.tobytes()
    assert one.energy_error == two.energy_error


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ({"speed": 2.0}, r"drive: its speed would jump from 1\.0 to 2\.0 at t = 0\.5 s"),
        ({"speed": [[0.6, 1.0], [0.7, 1.0]]}, "must begin at t = 0.5 s, which is now, or before"),
        ({"position": [[0, 0], [1, 2.0]]}, r"drive\.position: the coordinate would jump from 0\.5"),
        ({"position": [[0.5, 0.5], [1, 2.0]]}, r"jump from 1\.0 to 0\.0 .*\n.*end_speeds = \[1\.0"),
        ({"amplitude": 1.0, "frequency": 1.0}, "its speed would jump"),
        (None, r"comes, goes or is of another kind\n.*from the start: drive = \{ speed = 0 \}"),
    ],
)
def test_a_drive_that_would_jump_is_refused(drive, words):
    simulation = simulated(wheel(1.0, drive={"speed": 1.0}), 1.0, 0.1)
    simulation.advance(0.5)
    before = simulation.system
    with pytest.raises(CaseError, match=words):
        simulation.change("joint[0].drive", drive)
    assert simulation.system is before


def test_what_joints_hold_on_a_driven_body_takes_no_jump_of_its_speed():
    base = body("base", 3.0, [1, 1, 1], [0, 0, 0]) | {"motion": {"velocity": [0.5, 0, 0]}}
    del base["velocity"], base["angular_velocity"]
    bob = body("bob", 1.0, [0.1, 0.1, 0.1], [0, 0, -1], [0.5, 0, 0])
    simulation = simulated(case([base, bob], [joint("ball", "bob", "base", [0, 0, 0])]), 1.0, 0.01)
    simulation.advance(0.25)
    with pytest.raises(CaseError, match=r"the speed of base would jump at t = 0\.25 s, and joints"):
        simulation.change("body[0].motion.velocity", [0.6, 0, 0])
    wave = {"amplitude": [0.1, 0, 0], "frequency": 1.0, "phase": -np.pi / 2}  # cos(π/2 - π/2) = 1
    gone = 0.5 - 0.1 * 2.0 * np.pi
    simulation.change("body[0].motion", {"velocity": [gone, 0, 0], "oscillation": wave})
    state = simulation.advance(0.5)
    assert state.position[0, 0] == pytest.approx(0.125 + 0.25 * gone + 0.1, abs=1e-13)
    assert np.linalg.norm(state.position[0] - state.position[1]) == pytest.approx(1.0, abs=1e-12)
    assert abs(simulation.energy_error) < 1e-4


def test_a_motor_of_zero_is_one():
    """Nowhere but along a coordinate that is free, and beside nothing that breaks."""
    scene = case([bar("a", [0, 0, 0], [1, 0, 0])], [joint("ball", "a", motor=0)])
    with pytest.raises(CaseError, match="along a ball joint act springs and dampers alone"):
        simulated(scene, 1.0, 0.1)
