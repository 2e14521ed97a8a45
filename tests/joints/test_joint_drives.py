"""Prescribed motion in joints: closed forms, orders, what the drive does, what is refused."""

import numpy as np
import pytest
from scenes import X, Y, Z, bar, body, case, joint, moved
from test_actions import MOMENT, OUTPUT, angle, flap

from particlerb import CaseError, joint_loads
from particlerb.case.to_system import to_system
from particlerb.contact.prescribed_motion import prescribed_among, prescribed_in
from particlerb.plan.joint_drives import course_of
from particlerb.plan.obstacles import prescribed_bodies
from particlerb.simulation.run import prepare

pytestmark = pytest.mark.plain  # test_compiled_drives.py has one loop with all of it
SWING = {"amplitude": 0.1, "frequency": 1.5, "phase": 0.25 * np.pi}
RATE = 2 * np.pi * 1.5


def swung(t):
    """Coordinate, speed and acceleration of SWING."""
    phase = RATE * t + 0.25 * np.pi
    x = 0.1 * (np.sin(phase) - np.sin(0.25 * np.pi))
    return x, 0.1 * RATE * np.cos(phase), -0.1 * RATE**2 * np.sin(phase)


def cart(drive=SWING, speed=None, pins=1, other=None, **keys):
    """A block that is driven along x with a pendulum on a hinge about y, which starts at 60°."""
    speed = swung(0.0)[1] if speed is None else speed
    v = [speed, 0, 0]
    block = body("cart", 2.0, [0.1, 0.2, 0.3], [0, 0, 0], v)
    tip = np.array([np.sin(np.pi / 3), 0, -np.cos(np.pi / 3)])
    rod = bar("rod", [0, 0, 0], tip, 0.5, 0.1, v)
    joints = [joint("slider", "cart", None, [0, 0, 0], X, drive=drive, **keys)]
    joints.append(joint("hinge", "rod", "cart", [0, 0, 0], Y))
    return case([block, rod], joints, output=OUTPUT)


def exact_pendulum(t):
    """θ of the rod from the vertical, by SciPy's DOP853: I θ'' = -m l (g sin θ + ẍ cos θ)."""
    from scipy.integrate import solve_ivp

    inertia = 0.5 * ((1 + 0.01) / 12 + 0.25)

    def slope(time, y):
        pull = 9.81 * np.sin(y[0]) + swung(time)[2] * np.cos(y[0])
        return [y[1], -0.25 * pull / inertia]

    found = solve_ivp(slope, (0, t), [np.pi / 3, 0], "DOP853", rtol=1e-13, atol=1e-14)
    return found.y[0, -1]


@pytest.mark.parametrize(
    ("method", "steps"),
    [("rattle", (0.02, 0.01, 0.005)),
     ("rattle4", (0.04, 0.02, 0.01)),
     ("rattle6", (0.05, 0.04, 0.02)),
     ("rattle8", (0.0625, 0.05, 0.04))],
)  # fmt: skip
def test_a_driven_cart_swings_its_pendulum_at_the_order_of_the_method(method, steps):
    errors, theta = [], exact_pendulum(1.0)
    for dt in steps:
        with moved(cart(), 1.0, dt, method, every=0.25) as trajectory:
            x, t = np.array(trajectory.position), trajectory.time
            assert x[:, 0, 0] == pytest.approx(swung(t)[0], abs=1e-14)
            p = np.array(trajectory.linear_momentum)[:, 0, 0]
            assert p == pytest.approx(2.0 * swung(t)[1], abs=1e-12)
            errors.append(abs(x[-1, 1, 0] - x[-1, 0, 0] - 0.5 * np.sin(theta)))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx({"rattle": 2, "rattle4": 4, "rattle6": 6, "rattle8": 8}[method],
                                  abs=0.2)  # fmt: skip


@pytest.mark.parametrize(
    ("method", "ratio"),
    [
        ("rattle", 4),
        ("rattle4", 16),
        ("rattle6", 64),
    ],
)
def test_the_work_of_a_drive_closes_the_balance_of_energy(method, ratio):
    errors = []
    for dt in (0.04, 0.02):
        with moved(cart(), 1.0, dt, method, every=0.2) as trajectory:
            ledger = trajectory.ledger
            errors.append(np.abs(ledger.energy_error).max())
            assert np.abs(ledger.linear_momentum_error).max() < 1e-12
            assert np.abs(ledger.angular_momentum_error).max() < 1e-12
    assert np.abs(ledger.work).max() > 0.1
    assert errors[0] / errors[1] == pytest.approx(ratio, rel=0.3)


def test_what_a_drive_does_and_what_it_carries_follow_from_the_motion_alone():
    """A block on a driven slider: F = m ẍ along it, and the work is what it has gained."""
    block = body("cart", 2.0, [0.1, 0.2, 0.3], [0, 0, 0], [swung(0.0)[1], 0, 0])
    slider = joint("slider", "cart", None, [0, 0, 0], X, drive=SWING)
    with moved(case([block], [slider], output=OUTPUT), 1.0, 0.01, every=0.1) as trajectory:
        t, loads = trajectory.time, joint_loads(trajectory)
        assert loads.force[:, 0, 0] == pytest.approx(2.0 * swung(t)[2], abs=1e-12)
        assert loads.force[:, 0, 2] == pytest.approx(2.0 * 9.81, abs=1e-12)
        gained = swung(t)[1] ** 2 - swung(0.0)[1] ** 2
        assert trajectory.ledger.work == pytest.approx(gained, abs=2e-3)
        assert loads.misfit.max() < 1e-14
        assert loads.rate.max() < 1e-13


def test_a_hinge_turns_on_at_a_speed_through_whole_turns():
    """A motor with a given speed: angle ω t; its torque is that of the weight."""
    scene = flap(3.0, (0, 0, -9.81), drive={"speed": 3.0})
    scene["output"] = {"fields": [*OUTPUT["fields"], "joint_coordinate", "joint_torque"]}
    with moved(scene, 5.0, 0.02, every=0.5) as trajectory:
        t = trajectory.time
        turned = np.array(trajectory.joint_coordinate)[:, 0]
        torque = np.array(trajectory.joint_torque)[:, 0]
        assert turned == pytest.approx(3.0 * t, abs=1e-12)
        assert torque[:, 1] == pytest.approx(-0.5 * 9.81 * np.cos(3.0 * t), abs=1e-9)
        lifted = -0.5 * 9.81 * np.sin(3.0 * t)
        assert trajectory.ledger.work == pytest.approx(lifted, abs=5e-3)


@pytest.mark.parametrize("kind", ["hinge", "slider"])
def test_a_drive_works_against_a_spring_and_a_damper(kind):
    """x = v t: the drive gives m g sin φ + k x + c v, in a joint of five rows and two more."""
    keys = {"drive": {"speed": 3.0}, "spring": {"stiffness": 2.0}, "damper": 0.4}
    if kind == "hinge":
        scene = flap(3.0, (0, 0, -9.81), **keys)
    else:
        block = body("block", 2.0, [0.1, 0.2, 0.3], [0, 0, 0], [0, 0, 3.0])
        scene = case([block], [joint("slider", "block", None, [0, 0, 0], Z, **keys)], output=OUTPUT)
    with moved(scene, 1.0, 0.02, every=0.1) as trajectory:
        t, loads, ledger = trajectory.time, joint_loads(trajectory), trajectory.ledger
    weight = -0.5 * 9.81 * np.cos(3.0 * t) if kind == "hinge" else 2.0 * 9.81
    found = loads.torque[:, 0, 1] if kind == "hinge" else loads.force[:, 0, 2]
    assert found == pytest.approx(weight + 6.0 * t + 1.2, abs=1e-9)
    assert loads.misfit.max() < 1e-13
    height = -0.5 * np.sin(3.0 * t) if kind == "hinge" else 6.0 * t
    stored = 9.81 * height + 9.0 * t * t
    assert ledger.work == pytest.approx(stored, abs=5e-3)
    assert np.abs(ledger.energy_error).max() < 5e-3


def test_a_speed_that_rises_between_knots():
    """ω from 0 to 2 rad/s within 0.5 s, then constant: the torque falls from I α to 0."""
    scene = flap(0.0, drive={"speed": [[0.0, 0.0], [0.5, 2.0]]})
    with moved(scene, 1.0, 0.03, every=0.25) as trajectory:
        t, loads = trajectory.time, joint_loads(trajectory)
        exact = np.where(t < 0.5, 2.0 * t * t, 0.5 + 2.0 * (t - 0.5))
        assert angle(trajectory) == pytest.approx(exact, abs=1e-13)
        assert loads.torque[:, 0, 1] == pytest.approx(
            np.where(t < 0.5, 4.0 * MOMENT, 0.0), abs=1e-9
        )
        assert trajectory.ledger.work[-1] == pytest.approx(2.0 * MOMENT, rel=1e-3)


KNOTS = [[0.0, 0.0], [0.3, 0.2], [0.5, -0.1], [1.0, 0.4]]


def test_a_position_through_points_is_the_clamped_cubic_spline():
    """As SciPy's; the method has its order across knots, as its steps end there."""
    from scipy.interpolate import CubicSpline

    t, x = np.array(KNOTS).T
    spline = CubicSpline(t, x, bc_type=((1, 0.3), (1, -0.2)))
    scene = flap(0.3, drive={"position": KNOTS, "end_speeds": [0.3, -0.2]})
    with moved(scene, 1.2, 0.07, "rattle4", every=0.1) as trajectory:
        time, phi = trajectory.time, angle(trajectory)
    inside = time <= 1.0
    assert phi[inside] == pytest.approx(spline(time[inside]), abs=1e-12)
    assert phi[~inside] == pytest.approx(0.4 - 0.2 * (time[~inside] - 1.0), abs=1e-12)


def test_a_course_goes_on_from_any_time():
    table = to_system({"run": {"t_end": 1.0, "every": 0.1}, **flap(drive=SWING)}).joint[0].drive
    for start in (0.0, 0.123, 0.9):
        polynomial, (amplitude, rate, phase) = course_of(table).since(start)
        t = np.linspace(0.0, 1.0, 5)
        found = np.polyval(polynomial[::-1], t) + amplitude * np.sin(rate * t + phase)
        assert found == pytest.approx(swung(start + t)[0], abs=1e-15)


def test_a_driven_mechanism_goes_on_bit_for_bit(tmp_path):
    import particlerb

    path, times = tmp_path / "run.h5", {"every": 0.05, "dt": 0.01}
    scene = cart({"position": KNOTS}, 0.0)
    particlerb.run({"run": {"t_end": 0.4, **times}, **scene}, path).close()
    particlerb.resume(path, 0.8).close()
    whole = particlerb.run({"run": {"t_end": 0.8, **times}, **scene})
    with particlerb.open(path) as resumed, whole:
        assert (np.array(resumed.position) == np.array(whole.position)).all()
        assert (resumed.ledger.work == whole.ledger.work).all()


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ({"speed": 2.0}, "is broken by the velocities at the start"),
        ({"speed": [[0.0, 0.0], [0.5, 1.0], [0.5, 2.0]]}, "a jump of speed"),
        ({"position": [[0.0, 0.1], [1.0, 1.0]]}, r"must begin at \[0, 0\]"),
        ({"position": [[0.0, 0.0]]}, "two knots"),
        (
            {"position": [[0.0, 0.0], [1.0, 1.0], [0.5, 2.0]]},
            r"times must ascend, knot 2 is at 0\.5 s after 1\.0 s",
        ),
        ({"position": [[0.0, 0.0], [1.0, 1.0]], "speed": 0.0}, "one of position, speed"),
        ({"amplitude": 1.0}, "goes with amplitude"),
        ({}, "one of position, speed"),
    ],
)
def test_what_no_drive_can_do_is_named(drive, words):
    with pytest.raises(CaseError, match=words):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **flap(drive=drive)}))


def test_a_drive_needs_a_coordinate_and_takes_it():
    scene = case([bar("a", [0, 0, 0], [1, 0, 0])], [joint("ball", "a", drive=SWING)])
    with pytest.raises(CaseError, match="along a ball joint act springs and dampers alone"):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **scene}))
    text = prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **cart()})).text
    assert "11 rows; 1 degree of freedom" in text


def test_knots_of_a_drive_leave_other_mechanisms_alone():
    """Bit for bit: their steps do not end at knots of others."""
    other = [bar("c", [0, 3, 0], [1, 3, 0]), joint("hinge", "c", None, [0, 3, 0], Z)]
    alone = case([other[0]], [other[1]], (0.0, -9.81, 0.0), output=OUTPUT)
    both = cart({"position": KNOTS}, 0.0)
    both["gravity"] = alone["gravity"]
    both["body"].append(other[0])
    both["joint"].append(other[1])
    with moved(alone, 0.5, 0.03, every=0.1) as one, moved(both, 0.5, 0.03, every=0.1) as two:
        assert (np.array(one.position)[:, 0] == np.array(two.position)[:, 2]).all()


# Bodies that move as prescribed

WAVE = {"amplitude": [0.05, 0.0, 0.02], "frequency": 1.5, "phase": 0.3}
SHAKEN = {"velocity": [0.1, 0, 0], "angular_velocity": [0, 2.0, 0], "oscillation": WAVE}


def shaken(t):
    """Velocity of the centre of SHAKEN, and its acceleration."""
    phase, A = RATE * t + 0.3, np.array([0.05, 0.0, 0.02])
    v = np.array([0.1, 0.0, 0.0]) + RATE * np.outer(np.cos(phase), A)
    return v, -(RATE**2) * np.outer(np.sin(phase), A)


def platform(kind="fixed", **keys):
    """A block on a body that shakes and turns about y: held to it, or on a hinge about y."""
    base = body("base", 3.0, [1, 1, 1], [0, 0, 0]) | {"motion": SHAKEN}
    base.pop("velocity")
    base.pop("angular_velocity")
    shift = np.sin(0.3) * np.array([0.05, 0.0, 0.02])
    spin = np.array([0.0, 2.0, 0.0])
    v = shaken(np.zeros(1))[0][0]
    arm = np.array([0.4, 0.0, 0.2])
    block = body("block", 0.5, [0.01, 0.02, 0.025], shift + arm, v + np.cross(spin, arm), spin)
    axis = None if kind == "fixed" else Y
    tie = joint(kind, "block", "base", shift + np.array([0.1, 0, 0]), axis, **keys)
    return case([base, block], [tie], output=OUTPUT)


def test_a_body_fixed_to_a_driven_one_goes_with_it():
    """x = x_base + R r; the force of the joint is m (a - g), the power that of what drives."""
    with moved(platform(), 0.6, 0.01, every=0.06) as trajectory:
        t, x, loads = trajectory.time, np.array(trajectory.position), joint_loads(trajectory)
        assert trajectory.velocity[:, 0] == pytest.approx(shaken(t)[0], abs=1e-13)
        c, s = np.cos(2 * t), np.sin(2 * t)
        arm = np.stack([0.4 * c + 0.2 * s, 0 * t, 0.2 * c - 0.4 * s], axis=1)
        assert x[:, 1] == pytest.approx(x[:, 0] + arm, abs=1e-13)
        a = shaken(t)[1] - 4.0 * arm
        assert loads.force[:, 0] == pytest.approx(0.5 * (a + np.array([0, 0, 9.81])), abs=1e-11)
        assert loads.misfit.max() < 1e-13
        assert loads.rate.max() < 1e-12
        assert np.abs(trajectory.ledger.energy_error).max() < 2e-3
        assert np.abs(trajectory.ledger.linear_momentum_error).max() < 1e-12
        assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-12


@pytest.mark.parametrize(("method", "ratio"), [("rattle", 4), ("rattle4", 16)])
def test_a_pendulum_on_a_driven_body_is_of_the_order_of_the_method(method, ratio):
    """In motion and energy, with a spring between them."""
    ends, errors = [], []
    for dt in (0.04, 0.02, 0.01):
        scene = platform("hinge", spring={"stiffness": 0.5})
        with moved(scene, 0.8, dt, method, every=0.08) as trajectory:
            ends.append(np.array(trajectory.position)[-1, 1])
            errors.append(np.abs(trajectory.ledger.energy_error).max())
    coarse, fine = (np.abs(ends[k] - ends[k + 1]).max() for k in (0, 1))
    assert coarse / fine == pytest.approx(ratio, rel=0.15)
    assert errors[1] / errors[2] == pytest.approx(ratio, rel=0.15)


def test_each_mechanism_finds_its_own_driven_bodies():
    """They stand as the members of a group do, whatever their order."""
    bases = [platform()["body"][0] | {"name": f"b{k}", "mass": 1.0 + k} for k in range(4)]
    ties = [joint("ball", "block", base["name"]) for base in bases]
    scene = case([*bases, platform()["body"][1]], ties, run={"t_end": 1.0, "every": 1.0})
    system = to_system(scene)
    found = prescribed_among(prescribed_bodies(system), np.array([3, 1, 7, 0]))
    assert found.body.tolist() == [0, 1, 3]
    assert found.mass.tolist() == [4.0, 2.0, 1.0]
    assert prescribed_in(found, 1, 3) == range(1, 2)


def test_contact_beside_it_changes_nothing():
    """A driven body that others may touch is moved by contact too: the same motion."""
    contact = {"stiffness": 1e4, "restitution": 0.5, "friction": 0.0}
    scene = platform("hinge")
    ball = {"name": "ball", "shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    lone = ball | {"position": [0, 9, 9]}
    scene["body"] = [table | {"contact": False} for table in scene["body"]]
    scene["body"] += [lone, ball | {"name": "other", "position": [0, -9, 9]}]
    both = moved({**scene, "contact": contact}, 0.3, 0.005, every=0.1)
    with moved(scene, 0.3, 0.005, every=0.1) as alone, both as beside:
        x, y = np.array(alone.position), np.array(beside.position)
        assert x == pytest.approx(y, abs=1e-14)
        assert alone.velocity == pytest.approx(np.array(beside.velocity), abs=1e-13)


def test_a_driven_body_is_not_left_behind():
    scene = platform(during=[0.0, 0.5])
    with pytest.raises(CaseError, match="would stand still once it is released"):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **scene}))
