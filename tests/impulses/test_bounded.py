"""Stops, motors with a largest torque and friction in joints, by impulses: closed forms, bits."""

import re

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, case, clump, errors, exact, impulse, plane, sphere

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.simulation.run import prepare
from particlerb.simulation.whole_run import RunError

pytestmark = pytest.mark.plain

M, D = 2.0, 0.5  # kg, m: of a ball, and how far its centre is from the hinge
OWN = 0.4 * M * R * R  # kg m²
LOAD = M * G * D  # N m
FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum", "joint_coordinate"]


def hinged(d=D, omega=0.0, **joint):
    """A ball that touches nothing, on a hinge along y at the origin; level at the start."""
    ball = sphere(position=[d, 0, 0], velocity=[0, 0, -omega * d], contact=False)
    ball["angular_velocity"] = [0, omega, 0]
    hinge = {"type": "hinge", "body": "ball", "at": [0, 0, 0], "axis": [0, 1, 0]} | joint
    return case(ball, joint=[hinge], contact=impulse(tolerance=1e-12), output={"fields": FIELDS})


def go(scene, t_end, dt, **keys):
    """Trajectory with a frame for each step, and its first coordinate."""
    scene["run"] |= {"t_end": t_end, "dt": dt, "every": dt}
    t = particlerb.run(scene | keys)
    return t, t.joint_coordinate[:, 0]


def test_friction_stops_a_hinge_at_the_known_angle():
    """I ω²/(2 τ), and within the last step by τ h²/(8 I) at most; all the energy is heat."""
    omega, torque, dt = 3.0, 0.05, 0.05
    t, x = go(hinged(0.0, omega, friction=torque), 0.75, dt)
    ahead, late = OWN * omega**2 / (2.0 * torque), torque * dt * dt / (8.0 * OWN)
    assert 0.0 <= x[-1] - ahead <= late
    assert x[-1] == x[-2]
    assert t.omega_body(0)[4, 1] == pytest.approx(omega - 4 * dt * torque / OWN, abs=1e-13)
    assert errors(t)[0] < 1e-14
    assert t.energy[-1] < 1e-25
    assert errors(t)[2] < 1e-15


@pytest.mark.parametrize("share", [1.01, 0.99])
def test_friction_holds_what_it_can_carry(share):
    t, x = go(hinged(friction=share * LOAD), 0.1, 0.01, gravity=DOWN)
    sliding = max(1.0 - share, 0.0) * LOAD / (M * D * D + OWN)
    assert x == pytest.approx(0.5 * sliding * t.time**2, abs=1e-8 if share < 1.0 else 1e-14)
    assert errors(t)[0] < 1e-9


def test_a_motor_reaches_its_speed_when_its_largest_torque_lets_it():
    speed, torque, dt = 4.0, 0.08, 0.05
    t, x = go(hinged(0.0, motor={"speed": speed, "largest": torque}), 0.6, dt)
    reached = OWN * speed / torque
    assert x[-1] == pytest.approx(speed * (0.6 - 0.5 * reached), abs=torque * dt * dt / (8 * OWN))
    assert t.omega_body(0)[-1, 1] == pytest.approx(speed, rel=1e-13)
    assert errors(t)[0] < 1e-14  # what it has done is external work


@pytest.mark.parametrize(("share", "turns"), [(0.9, 1.0), (1.0, 0.0), (1.5, -1.0)])
def test_a_motor_stalls_against_a_load(share, turns):
    """To lift at 4 rad/s it lacks a tenth of the torque, or nothing, or has half of it too much."""
    motor = {"speed": -4.0, "largest": share * LOAD}
    t, x = go(hinged(motor=motor), 0.05, 0.01, gravity=DOWN)
    ahead = 0.5 * (1.0 - share) * LOAD / (M * D * D + OWN) * t.time**2
    assert x == pytest.approx(ahead, abs=2e-5 * abs(ahead[-1]) + 1e-13)
    assert np.sign(np.round(x[-1], 12)) == turns


@pytest.mark.parametrize("e", [0.0, 0.6])
def test_a_hinge_comes_to_rest_at_its_stop(e):
    """It meets the stop with ω² = 2 m g d sin x / I, and leaves it e times as fast."""
    stop, dt = 0.3, 0.01
    t, x = go(hinged(limit={"range": [-1.0, stop], "restitution": e}), 0.4, dt, gravity=DOWN)
    met = np.sqrt(2.0 * LOAD * np.sin(stop) / (M * D * D + OWN))
    assert x.max() - stop <= (met * dt if e else 1e-6)
    rates = t.omega_body(0)[:, 1]
    if e:
        rates, falls = np.diff(x) / dt, LOAD / (M * D * D + OWN) * dt
        assert rates.min() == pytest.approx(-e * met, abs=2.0 * falls)
    else:
        assert np.abs(x[-10:] - stop).max() < 1e-6
        assert np.abs(rates[-10:]).max() < 1e-6


@pytest.mark.parametrize("height", [2.1, 2.15, 2.2, 2.25])
def test_a_bob_rests_at_its_stop_alike_on_a_base_that_moves_evenly(height):
    """A last hit that one step lets land bounces in the next, whatever its gap is rounded to."""
    ways, dt, e = [], 8e-3, 0.5
    for speed in (0.0, 0.37, 0.9, -0.6):
        base = sphere("base") | (
            {"motion": {"velocity": [0, 0, speed]}} if speed else {"fixed": True}
        )
        bob = sphere("bob", position=[0, 0, 1], velocity=[0, 0, speed - 0.95 * G * dt])
        limit = {"range": [-height * G * dt * dt, 1.0], "restitution": e}
        slider = {"type": "slider", "body": "bob", "to": "base", "at": [0, 0, 0], "axis": [0, 0, 1]}
        scene = case(base, bob, joint=[slider | {"limit": limit}], contact=impulse(tolerance=1e-12))
        ways.append(go(scene, 0.1, dt, gravity=DOWN, output={"fields": FIELDS})[1])
    assert np.abs(ways - ways[0]).max() < 1e-12


def test_what_rubs_and_stops_between_two_bodies_keeps_their_momenta():
    left, right = (clump(name, position=[x, 0, 0]) for name, x in (("left", -0.3), ("right", 0.3)))
    right["angular_velocity"], right["velocity"] = [0, 0, 4.0], [0.2, 0.5, 0.1]
    hinge = {"type": "hinge", "body": "right", "to": "left", "at": [0, 0, 0], "axis": [0, 0, 1],
             "friction": 0.05, "limit": {"range": [-0.1, 0.2], "restitution": 0.5},
             "assemble": True}  # fmt: skip
    contact = impulse(tolerance=1e-12, push_out=0.0)
    t = particlerb.run(case(left, right, joint=[hinge], contact=contact, t_end=0.4, every=0.02,
                            dt=0.01, output={"fields": FIELDS}))  # fmt: skip
    x, P = t.joint_coordinate[:, 0], t.observable("linear_momentum")
    L = t.observable("angular_momentum")
    assert x.max() > 0.2
    assert x[-1] < x.max() - 0.01
    assert np.abs(P - P[0]).max() < 1e-13
    assert np.abs(L - L[0]).max() < 1e-13
    assert errors(t)[0] < 1e-4 * t.energy[0]
    assert t.energy[-1] < 0.9 * t.energy[0]


def pressed(end=0.3, speed=2.0, **keys):
    """A cart on a slider between stops; a motor drives it against a ball, and that to a wall."""
    cart = clump("cart", position=[-0.35, 0, 0])
    motor = {"speed": speed, "largest": 3.0}
    slider = {"type": "slider", "body": "cart", "axis": [1, 0, 0], "motor": motor,
              "friction": 0.5, "limit": {"range": [-0.1, 0.25], "restitution": 0.3}}  # fmt: skip
    ball, wall = sphere(position=[0.0, 0.1, 0.1]), plane((-1, 0, 0), point=[end, 0, 0])
    ball["mass"], fields = 0.2, [*FIELDS, "wall_force"]
    return case(cart, ball, joint=[slider], wall=[wall], output={"fields": fields},
                contact=exact(0.0, 0.5) | keys)  # fmt: skip


@pytest.mark.parametrize(("end", "x_end"), [(0.25, 0.2), (0.35, 0.25)])
def test_a_motor_presses_with_what_friction_leaves(end, x_end):
    """3 N go through the ball into the wall, but for 0.5 N: or none where the stop comes first."""
    t, x = go(pressed(end, push_out=1.0, slop=0.0), 0.9, 0.025)
    force = np.asarray(t.wall_force)[-1, 0, 0]
    assert x[-1] == pytest.approx(x_end, abs=1e-9)
    assert 2.5 - 1e-9 <= force <= 3.5 + 1e-9 if end < 0.3 else force == 0.0
    assert t.observable("impulse_residual")[-5:].max() <= 1e-13
    assert errors(t)[0] < 1e-12
    assert errors(t)[1] < 1e-12


def test_what_a_motor_presses_stays_where_it_is():
    """No gap is too small: neither the cart nor the ball sets out again once both are at rest."""
    scene = pressed(0.25, rolling_friction=0.1, torsional_friction=0.1, iterations=100)
    scene["body"][1]["angular_velocity"] = [3.0, 5.0, -2.0]
    t, x = go(scene, 0.9, 0.03)
    assert np.ptp(x[-8:]) < 1e-12
    assert np.ptp(t.position[-8:], axis=0).max() < 1e-12


def test_newtons_method_solves_what_acts_within_bounds(monkeypatch):
    """After one sweep, and with no more of them."""
    monkeypatch.setattr("particlerb.impulses.solver._NEWTON_ROUNDS", 1)
    keys = {"iterations": 1, "solver": "newton", "tolerance": 1e-12}
    newton, x = go(pressed(speed=0.2, **keys), 0.4, 0.025)
    _, y = go(pressed(speed=0.2), 0.4, 0.025)
    assert newton.observable("impulse_residual").max() <= 1e-12
    assert x == pytest.approx(y, abs=1e-9)


def test_a_run_goes_on_bit_for_bit_and_does_not_see_its_frames(tmp_path):
    scene = pressed(speed=0.2, iterations=1, solver="sweeps")  # one sweep needs forces of before
    path = tmp_path / "part.h5"
    whole, x = go(scene, 0.3, 0.025)
    scene["run"] |= {"t_end": 0.15}
    particlerb.run(scene, path).close()
    with particlerb.resume(path, t_end=0.3) as t:
        for name in FIELDS:
            assert (getattr(t, name) == getattr(whole, name)).all()
    scene["run"] |= {"t_end": 0.3, "every": 0.01}
    assert (particlerb.run(scene).joint_coordinate[::5, 0] == x[::2]).all()


@pytest.mark.parametrize(
    ("joint", "contact", "what"),
    [
        ({"friction": 1.0}, {"law": "hooke", "stiffness": 1e4, "restitution": 0.5}, "friction"),
        ({"motor": {"speed": 1.0, "largest": 1.0}}, None, "motor"),
        ({"limit": {"range": [0, 1]}}, None, 'contact.law = "impulse", or give a stiffness'),
        ({"friction": 1.0, "drive": {"speed": [[0, 0], [1, 1]]}}, impulse(), "given beside drive"),
        (
            {"limit": {"range": [0, 1], "damping": 1.0}},
            impulse(),
            "a stop without stiffness has none",
        ),
        ({"limit": {"range": [0.1, 1]}}, impulse(), "beyond a hard stop"),
    ],
)
def test_what_no_law_solves_is_refused(joint, contact, what):
    scene = hinged(**joint) | ({"contact": contact} if contact else {})
    if contact is None:
        del scene["contact"]
    with pytest.raises(CaseError, match=what):
        particlerb.run(scene)


def test_a_light_ball_on_a_long_arm_stops_hard():
    """Its stop asks for an impulse that would turn a free ball by radians in half a step."""
    ball = sphere(radius=0.005, position=[0.1, 0, 0], velocity=[0, 0, -2.0], contact=False)
    ball["angular_velocity"] = [0, 20.0, 0]
    limit = {"range": [-0.1, 0.5]}
    hinge = {"type": "hinge", "body": "ball", "at": [0, 0, 0], "axis": [0, 1, 0], "limit": limit}
    keys = {"contact": impulse(tolerance=1e-12), "output": {"fields": FIELDS}}
    t, x = go(case(ball, joint=[hinge], **keys), 0.1, 0.01)
    assert x[-1] == pytest.approx(0.5, abs=1e-3)
    assert errors(t)[0] < 1e-10


def test_what_is_solved_beside_contacts_is_recorded_with_them():
    """The mechanism comes first; what touches nothing else had a group, and a tally, of its own."""
    resting = sphere(name="resting", position=[3.0, 0, R])
    scene = hinged(friction=2.0 * LOAD)
    scene["body"].append(resting)
    scene["output"] = {"fields": [*FIELDS, "wall_force"]}
    t, _ = go(scene, 0.05, 0.01, wall=[plane()], gravity=DOWN)
    assert np.abs(t.wall_force[-1]).max() == pytest.approx(M * G, rel=1e-9)


def whip(dt):
    """Two bars of 1 m that turn by 8 rad/s as one about a pin, against stops of both hinges."""
    links = [[x, 0, 0] for x in (-0.4, -0.15, 0.15, 0.4)]
    shape = {"type": "points", "mass": 0.25, "radius": 0.02, "position": links}
    bars = [
        {"name": name, "shape": shape, "contact": False, "position": [x, 0, 0],
         "velocity": [0, 0, -8.0 * x], "angular_velocity": [0, 8.0, 0]}
        for name, x in (("near", 0.5), ("far", 1.5))
    ]  # fmt: skip
    hinge = {"type": "hinge", "axis": [0, 1, 0]}
    pin = hinge | {"body": "near", "at": [0, 0, 0], "limit": {"range": [-0.5, 0.5]}}
    elbow = hinge | {"body": "far", "to": "near", "at": [1, 0, 0], "limit": {"range": [-0.4, 0.4]}}
    for joint in (pin, elbow):
        joint["limit"] |= {"restitution": 0.5}
    keys = {"contact": impulse(tolerance=1e-12), "output": {"fields": FIELDS}}
    return go(case(*bars, joint=[pin, elbow], **keys), 0.24, dt)[0]


def test_a_whip_against_stops_errs_by_the_error_of_its_joints():
    """It stores 86 J, loses most of it in its stops, and the energy balance is of order 2."""
    coarse, fine = (errors(whip(dt))[0] for dt in (16e-3, 8e-3))
    assert coarse / fine > 3.0
    assert 1e-3 < fine < 0.1


def test_a_friction_that_no_chosen_accuracy_knows_is_refused():
    scene = hinged(omega=1.0, friction=0.5)
    scene["run"] |= {"accuracy": 1e-3}
    with pytest.raises(CaseError, match="contacts with a stiffness"):
        particlerb.run(scene)


def test_a_bounce_may_be_seen_beyond_half_a_turn():
    """The middle of a step lies at 3.2 rad, which is -3.08."""
    limit = {"range": [-1.0, 3.1], "restitution": 0.5}
    t, x = go(hinged(0.0, 8.0, limit=limit), 0.8, 0.04)
    assert 3.1 < x.max() < 3.1 + 0.04 * 8.0
    assert t.omega_body(0)[-1, 1] == pytest.approx(-0.5 * 8.0, rel=1e-12)


def test_a_step_that_passes_a_stop_ends_the_run():
    """It went on through the stop, whole turns, with exit code 0."""
    limit = {"range": [-2.6, 2.6], "restitution": 0.9}
    with pytest.raises(RunError, match="has turned so far beyond its stop"):
        go(hinged(0.0, 60.0, limit=limit), 0.2, 0.02)


def test_a_bound_on_what_another_joint_drives_is_refused():
    scene = hinged(friction=0.5)
    other = {key: value for key, value in scene["joint"][0].items() if key != "friction"}
    scene["joint"].append(other | {"drive": {"speed": [[0.0, 0.0], [1.0, 1.0]]}})
    with pytest.raises(CaseError, match="another joint of the same bodies has a drive"):
        particlerb.run(scene)


def test_a_plan_of_joints_alone_promises_no_overlap():
    text = prepare(to_system(load(hinged(friction=1.0)))).text
    assert "contact         nothing, impulse in joints alone, residual 1e-12 or 20 sweeps" in text
    assert "overlap" not in text
    assert "0 spheres" not in text


def test_the_summary_tells_what_a_stop_has_taken(tmp_path, capsys):
    """(1 - e²) I ω²/2."""
    scene = hinged(omega=2.0, limit={"range": [-1.0, 0.3], "restitution": 0.5})
    scene["run"] |= {"t_end": 0.3, "dt": 0.01, "every": 0.1}
    path = tmp_path / "a.toml"
    path.write_text(particlerb.Scene.from_case(scene).to_toml())
    assert main([str(path), "-o", str(tmp_path / "a.h5")]) == 0
    (taken,) = re.findall(r"work: impacts (\S+) J", capsys.readouterr().out)
    assert float(taken) == pytest.approx(-1.5 * (M * D * D + OWN), rel=5e-3)
