"""Magnus lift F = c ω × v: a circle, a cycloid, no work, and the order of every method with it."""

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.forces.kinds import VELOCITY
from particlerb.integrators import METHODS, UNJOINTED

MASS, SPIN, C = 2.0, 3.0, 0.7
RATE = C * SPIN / MASS  # at which the way turns [rad/s]
BALL = {"inertia": [1.3] * 3, "velocity": [0.4, 0.0, 0.1], "angular_velocity": [0, 0, SPIN]}
ABLE = [name for name in UNJOINTED if VELOCITY in METHODS[name].accepts]
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}
INERTIA = np.array([1.0, 2.0, 2.5])


def magnus(c=C, **keys):
    return {"type": "magnus", "body": "body", "coefficient": c} | keys


def circle(t):
    """v turns about the spin at the rate c ω/M."""
    cos, sin, v = np.cos(RATE * t), np.sin(RATE * t), BALL["velocity"]
    return np.stack([v[0] * cos, v[0] * sin, np.full_like(t, v[2])], axis=1)


def test_the_way_of_a_ball_that_spins_steadily_is_a_circle(make):
    """Its velocity is exact with `strang` whatever the step: a kick is the flow of the lift."""
    keys = {"t_end": 5.0, "every": 0.5, "method": "strang", "dt": 0.25}
    found = make.arrays(make.case(make.body(**BALL), force=[magnus()], **keys))
    assert found.velocity[:, 0] == pytest.approx(circle(found.time), abs=1e-14)
    assert not np.allclose(found.velocity[:, 0], found.velocity[0, 0], atol=0.1)
    assert np.abs(found.ledger.work).max() < 1e-15
    assert np.abs(found.ledger.energy_error).max() < 1e-15
    assert np.abs(found.ledger.linear_momentum_error).max() < 1e-15


def test_under_gravity_it_drifts_across_it_on_a_cycloid(make):
    """M v' = M g + c ω × v with g along -y and ω along z: the drift is g/RATE along x."""
    g = 9.81
    gravity = {"acceleration": [0, -g, 0]}
    start = BALL | {"velocity": [0.0, 0, 0]}
    keys = {"t_end": 4.0, "every": 0.5, "method": "dop853", "tolerance": 1e-13}
    scene = make.case(make.body(**start), force=[magnus()], gravity=gravity, **keys)
    found = make.arrays(scene)
    t, d = found.time, g / RATE
    v = np.stack([d * (1 - np.cos(RATE * t)), -d * np.sin(RATE * t), 0 * t], axis=1)
    assert found.velocity[:, 0] == pytest.approx(v, abs=1e-10)
    x = np.stack([d * (t - np.sin(RATE * t) / RATE), -d * (1 - np.cos(RATE * t)) / RATE, 0 * t])
    assert found.position[:, 0] == pytest.approx(x.T, abs=1e-10)


def test_with_a_push_and_drag_against_an_integration(make):
    forces = [magnus(), make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2]), make.drag(0.3, 0.2)]
    keys = {"force": forces, "t_end": 1.6, "every": 0.4, "method": "dop853", "tolerance": 1e-13}
    found = make.arrays(make.case(make.body(**START), **keys))
    true = make.integrate(np.diag(INERTIA), MASS, START, forces, found.time)
    assert found.position[:, 0] == pytest.approx(true.position, abs=1e-11)
    assert make.angle(found.orientation[:, 0], true.orientation).max() < 1e-11
    assert found.ledger.work == pytest.approx(true.external[:, 0], abs=1e-10)


STEPS = {"strang": (2, 0.1), "rk4": (4, 0.1)}
FIRST_ORDER = ["semi_implicit_euler", "explicit_euler", "momentum_euler"]


@pytest.mark.plain
@pytest.mark.parametrize("method", [*STEPS, *FIRST_ORDER])
def test_methods_keep_their_order_with_it(make, method):
    """Beside drag, a push and gravity, on an asymmetric body; the work is then that of drag."""
    order, dt = STEPS.get(method, (1, 2.0**-7))
    forces = [magnus(), make.push([1.0, 2.0, -1.5], [0.4, -0.3, 0.2]), make.drag(0.3, 0.2)]
    true = make.integrate(np.diag(INERTIA), MASS, START, forces, [0.8])
    errors = []
    for h in (dt, dt / 2, dt / 4):
        keys = {"force": forces, "t_end": 0.8, "every": 0.8, "method": method, "dt": h}
        found = make.arrays(make.case(make.body(**START), **keys))
        errors.append(np.linalg.norm(found.position[-1, 0] - true.position[-1]))
    assert errors[-1] > 1e-12
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(order, abs=0.2)


def test_rkn6_refuses_it_as_any_force_that_depends_on_velocities(make):
    scene = make.case(make.body(**BALL), force=[magnus()], method="rkn6", dt=0.1)
    with pytest.raises(CaseError, match="does not accept what acts here: magnus"):
        particlerb.run(scene)
    assert set(ABLE) == {"strang", "dop853", *STEPS, *FIRST_ORDER}


def test_the_default_step_follows_the_turn_of_the_way(make):
    keys = {"t_end": 1.0, "every": 1.0}
    slow = make.arrays(make.case(make.body(**BALL), force=[magnus()], **keys)).plan
    fast = make.arrays(make.case(make.body(**BALL), force=[magnus(50 * C)], **keys)).plan
    assert f"{SPIN:.6g} rad/s" in slow
    assert f"{50 * RATE:.6g} rad/s" in fast
    assert "driven by Magnus lift, strang" in slow
