"""Springs and dampers on balls and universal joints."""

import numpy as np
import pytest
from scenes import X, Z, bar, body, case, joint, moved
from test_actions import OUTPUT

from particlerb import CaseError
from particlerb.case.to_system import to_system
from particlerb.maths.quaternion import conjugate, multiply
from particlerb.simulation.run import prepare

pytestmark = pytest.mark.plain
WEIGHTLESS = (0.0, 0.0, 0.0)
TILTED = (0.5, 0.5, -0.5, 0.5)


def rotation_vectors(q):
    """Rotation vectors of quaternions (T, 4) against the first."""
    turned = np.array([multiply(tuple(row), conjugate(tuple(q[0]))) for row in q])
    turned *= np.where(turned[:, :1] < 0.0, -1.0, 1.0)
    s = np.linalg.norm(turned[:, 1:], axis=1)
    factor = 2.0 * np.arctan2(s, turned[:, 0]) / np.where(s > 0.0, s, 1.0)
    return factor[:, None] * turned[:, 1:]


@pytest.mark.parametrize("kind", ["spring", "damper"])
def test_a_ball_joint_swings_or_slows_down_about_any_axis(kind):
    """A sphere: φ = n ω₀/w sin w t with w² = k/I, or ω = n ω₀ exp(-c t/I)."""
    spin, n = 0.9, np.array([2, -1, 2]) / 3
    ball = body("ball", 2.0, [0.1, 0.1, 0.1], [1, 2, 3], spin=(spin * n).tolist(), q=TILTED)
    keys = {"spring": {"stiffness": 5.0}} if kind == "spring" else {"damper": 0.3}
    ties = [joint("ball", "ball", None, [1, 2, 3], **keys)]
    scene = case([ball], ties, WEIGHTLESS, output=OUTPUT)
    errors, w = [], np.sqrt(50.0)
    for dt in (0.02, 0.01):
        with moved(scene, 1.0, dt, every=0.1) as trajectory:
            t, ledger = trajectory.time[:, None], trajectory.ledger
            if kind == "spring":
                found = rotation_vectors(np.array(trajectory.orientation)[:, 0])
                exact = spin * n * np.sin(w * t) / w
            else:
                found = np.array(trajectory.angular_velocity)[:, 0]
                exact = spin * n * np.exp(-3.0 * t)
            errors.append(np.abs(found - exact).max())
            assert np.abs(ledger.energy_error).max() < 5e-3 * dt / 0.02
            assert np.abs(ledger.angular_momentum_error).max() < 1e-13
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def sprung(kind):
    """Two free bars that turn against each other, with a spring where they are joined."""
    first, second = np.array([0.5, 0.2, 0.3]), np.array([1.9, 0.2, -0.9])
    v = np.cross(first, [0.5, 0, 0]) + np.cross(second, [0, 0.5, 0])
    bars = [
        bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.9, [0, 0, 0], first.tolist()),
        bar("b", [1, 0, 0], [1, 1, 0], 2.0, 0.8, v.tolist(), second.tolist()),
    ]
    keys = {"spring": {"stiffness": 3.0}}
    if kind == "ball":
        ties = [joint("ball", "b", "a", [1, 0, 0], **keys)]
    else:
        keys |= {"axis_to": Z, "along": "angle about axis"}
        ties = [joint(kind, "b", "a", [1, 0, 0], X, **keys)]
    return case(bars, ties, WEIGHTLESS, output=OUTPUT)


@pytest.mark.parametrize("kind", ["ball", "universal"])
@pytest.mark.parametrize(
    ("method", "order", "dts"), [("rattle", 2, (0.04, 0.02)), ("rattle4", 4, (0.05, 0.025))]
)
def test_springs_in_turning_joints_keep_order_energy_and_momenta(kind, method, order, dts):
    """Energy is ½ k φ² besides that of the motion: a wrong torque would not keep it."""
    errors = []
    for dt in dts:
        with moved(sprung(kind), 1.0, dt, method, every=0.2) as trajectory:
            ledger = trajectory.ledger
            errors.append(np.abs(ledger.energy_error).max())
            assert np.ptp(ledger.potential_energy) > 0.05
            assert np.abs(ledger.linear_momentum_error).max() < 1e-13
            assert np.abs(ledger.angular_momentum_error).max() < 1e-13
    assert errors[0] / errors[1] == pytest.approx(2**order, rel=0.35)


@pytest.mark.parametrize(("along", "axis"), [("angle about axis", X), ("angle about axis_to", Z)])
def test_a_universal_joint_swings_about_the_axis_that_is_named(along, axis):
    """x = v/w sin w t with w² = k/I, as `joint_coordinate` has it; a motor gives τ t²/2 I."""
    spin = (0.4 * np.array(axis)).tolist()
    block = body("block", 2.0, [0.1, 0.1, 0.1], [0, 0, 0], spin=spin, q=TILTED)
    output = {"fields": [*OUTPUT["fields"], "joint_coordinate"]}
    for keys in ({"spring": {"stiffness": 5.0}}, {"motor": 0.2}, {"drive": {"speed": 0.4}}):
        tie = joint("universal", "block", None, [0, 0, 0], X, axis_to=Z, along=along, **keys)
        scene = case([block], [tie], WEIGHTLESS, output=output)
        with moved(scene, 1.0, 2e-3, every=0.1) as trajectory:
            t, x = trajectory.time, np.array(trajectory.joint_coordinate)
            names = [name.split(", ")[1] for name in trajectory.coordinate_names]
            assert np.abs(trajectory.ledger.energy_error).max() < 1e-5
        k = names.index(along)
        w = np.sqrt(50.0)
        exact = 0.4 * np.sin(w * t) / w if "spring" in keys else 0.4 * t
        exact = exact + t * t if "motor" in keys else exact
        assert x[:, k] == pytest.approx(exact, abs=1e-5)
        assert np.abs(x[:, 1 - k]).max() < 1e-13


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"motor": 1.0}, "springs and dampers alone"),
        ({"spring": {"stiffness": 1.0, "rest": 0.1}}, "rests at the start"),
        ({"type": "universal", "axis": X, "axis_to": Z, "damper": 1.0}, "has several coordinates"),
        ({"type": "fixed", "damper": 1.0}, "nothing acts along a fixed joint"),
    ],
)
def test_what_does_not_act_along_turning_joints_is_named(keys, words):
    ball = body("ball", 2.0, [0.1, 0.1, 0.1], [1, 2, 3])
    scene = case([ball], [joint("ball", "ball") | keys])
    with pytest.raises(CaseError, match=words):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **scene}))
