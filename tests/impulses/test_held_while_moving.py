"""Brakes, motors and stops hold what a mechanism turns, or drives, and nothing creeps."""

import numpy as np
import pytest
from impulse_scenes import DOWN, case, errors, impulse, sphere

import particlerb

pytestmark = pytest.mark.plain

TURNING, OUT = 10.0, 0.5  # rad/s; m from the axis to a block of 1 kg: 50 N pull it outwards
AMPLITUDE, RATE = 0.05, 4.0 * np.pi  # m, rad/s
SHAKES = {"amplitude": AMPLITUDE, "frequency": 0.5 * RATE / np.pi}
FIELDS = {"fields": ["position", "velocity", "angular_velocity", "joint_coordinate"]}


def run(*bodies, joint, h, contact, **keys):
    """Trajectory of 0.2 s."""
    return particlerb.run(
        case(*bodies, joint=joint, contact=contact, output=FIELDS, dt=h, t_end=0.2, every=0.02,
             **keys)
    )  # fmt: skip


def on_an_arm(h, is_driven, **acting):
    """Displacement of a block along an arm that turns, and the trajectory."""
    spin = {"angular_velocity": [0.0, 0.0, TURNING], "contact": False}
    arm = {"name": "arm", "shape": {"type": "box", "size": [1.0, 0.1, 0.1]}, "mass": 1.0} | spin
    block = sphere("block", mass=1.0, position=[OUT, 0.0, 0.0], velocity=[0.0, OUT * TURNING, 0.0])
    hinge = {"type": "hinge", "body": "arm", "axis": [0, 0, 1]}
    hinge |= {"drive": {"speed": TURNING}} if is_driven else {}
    slider = {"type": "slider", "body": "block", "to": "arm", "axis": [1, 0, 0]} | acting
    t = run(arm, block | spin, joint=[hinge, slider], h=h, contact=impulse(tolerance=1e-12))
    return t.joint_coordinate[:, 1], t


@pytest.mark.parametrize(
    "acting", [{"friction": 100.0}, {"motor": {"speed": 0.0, "largest": 100.0}}]
)
def test_a_brake_holds_on_an_arm_that_turns(acting):
    """It could bear twice the pull, and crept outwards by 0.25 m/s at 10 ms."""
    x, t = on_an_arm(1e-2, True, **acting)
    assert np.abs(x).max() < 1e-14
    assert errors(t)[0] < 1e-12
    coarse, fine = (np.abs(on_an_arm(h, False, **acting)[0]).max() for h in (1e-2, 5e-3))
    assert coarse < 1e-4
    assert fine < coarse / 3.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stop_holds_on_an_arm_that_turns(sign):
    """The block was 6.5 mm beyond it at 10 ms, and 7 mJ were lost."""
    limit = {"range": [-0.2, 0.0] if sign > 0.0 else [0.0, 0.2], "restitution": 0.0}
    x, t = on_an_arm(1e-2, True, axis=[sign, 0, 0], limit=limit)
    assert np.abs(x).max() < 2.0 * TURNING**2 * OUT * 1e-4 / 8.0
    assert abs(x[-1]) < 1e-6
    assert errors(t)[0] < 2e-5


@pytest.mark.parametrize("is_driven", [True, False])
def test_a_brake_holds_a_pendulum_on_a_cart_that_shakes(is_driven):
    """A drive moves the cart, or a motion of its own; it swung by 11 mrad at 10 ms, to order 1."""
    begin, most = {"velocity": [AMPLITUDE * RATE, 0.0, 0.0], "contact": False}, []
    cart = sphere("cart", mass=1.0, contact=False)
    bob = sphere("bob", mass=1.0, position=[0.0, 0.0, -0.5]) | begin
    joint = [{"type": "hinge", "body": "bob", "to": "cart", "at": [0, 0, 0], "axis": [0, 1, 0],
              "friction": 50.0}]  # fmt: skip
    if is_driven:
        cart |= begin
        joint.append({"type": "slider", "body": "cart", "axis": [1, 0, 0], "drive": SHAKES})
    else:
        cart["motion"] = {"oscillation": SHAKES | {"amplitude": [AMPLITUDE, 0.0, 0.0]}}
    for h in (1e-2, 5e-3):
        t = run(cart, bob, joint=joint, h=h, contact=impulse(tolerance=1e-12), gravity=DOWN)
        most.append(np.abs(t.joint_coordinate[:, 0]).max())
    assert most[0] < 2e-4
    assert most[1] < most[0] / 3.5


def of_order_two(errors, most):
    """Say that errors at h and h/2 are of order two, and small."""
    assert errors[0] < most
    assert errors[1] < errors[0] / 3.5


def test_a_block_goes_with_the_table_that_a_drive_shakes():
    """Up and aside, three balls on three; at 10 ms it lagged by 3.3 mm."""
    corners, axis = (
        [[0.1, 0.0, 0.0], [-0.05, 0.1, 0.0], [-0.05, -0.1, 0.0]],
        np.array([0.6, 0, 0.8]),
    )
    body = {"shape": {"type": "points", "mass": 0.3, "radius": 0.05, "position": corners}}
    body |= {"velocity": (AMPLITUDE * RATE * axis).tolist()}
    table, block = {"name": "table"} | body, {"name": "block", "position": [0, 0, 0.1]} | body
    joint = [{"type": "slider", "body": "table", "axis": axis.tolist(), "drive": SHAKES}]
    off = []
    for h in (1e-2, 5e-3):
        t = run(table, block, joint=joint, h=h, contact=impulse(0.0, 2.0, tolerance=1e-10),
                gravity=DOWN)  # fmt: skip
        path = AMPLITUDE * np.sin(RATE * t.time)[:, None] * axis
        off.append(np.abs(t.position[:, 1] - t.position[0, 1] - path).max())
        assert t.observable("impulse_residual").max() <= 1e-9
    of_order_two(off, 5e-5)


def test_a_block_goes_with_the_table_that_a_drive_turns():
    """Beside the axis; contacts disagreed about turning: residuals of 1e-5, errors of order 1."""
    axis, begin = np.array([0.3, 0.0, 0.0]), {"angular_velocity": [0.0, 0.0, 0.1 * RATE]}
    corners = [[0.1, 0.0, 0.0], [-0.05, 0.1, 0.0], [-0.05, -0.1, 0.0]]
    body = {"shape": {"type": "points", "mass": 0.3, "radius": 0.05, "position": corners}}
    body |= {"velocity": [0.0, 0.03 * RATE, 0.0]} | begin
    table = {"name": "table", "position": axis.tolist()} | body
    block = {"name": "block", "position": [0.3, 0.0, 0.1]} | body
    drive = SHAKES | {"amplitude": 0.1}
    joint = [{"type": "hinge", "body": "table", "at": [0, 0, 0], "axis": [0, 0, 1], "drive": drive}]
    off = []
    for h in (1e-2, 5e-3):
        t = run(table, block, joint=joint, h=h, contact=impulse(0.0, 2.0, tolerance=1e-10),
                gravity=DOWN)  # fmt: skip
        angle = 0.1 * np.sin(RATE * t.time)
        path = 0.3 * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
        off.append(np.abs(t.position[:, 1] - path - [0.0, 0.0, 0.1]).max())
        assert t.observable("impulse_residual").max() <= 1e-9
    of_order_two(off, 5e-5)


@pytest.mark.parametrize("solver", ["sweeps", "newton"])
def test_a_ball_spins_with_what_a_drive_turns_under_it(solver):
    """Friction about the normal holds it in the place where it stands, and it lagged by ½ h ω̇."""
    begin = {"angular_velocity": [0.0, 0.0, AMPLITUDE * RATE]}
    below, ball = sphere("below") | begin, sphere(position=[0.0, 0.0, 0.2]) | begin
    joint = [{"type": "hinge", "body": "below", "axis": [0, 0, 1], "drive": SHAKES}]
    keys, off = {"tolerance": 1e-10, "torsional_friction": 0.5, "solver": solver}, []
    for h in (1e-2, 5e-3):
        t = run(below, ball, joint=joint, h=h, contact=impulse(0.0, 0.5, **keys), gravity=DOWN)
        rate = AMPLITUDE * RATE * np.cos(RATE * t.time)
        off.append(np.abs(t.angular_velocity[:, 1, 2] - rate).max())
    of_order_two(off, 2e-3)
