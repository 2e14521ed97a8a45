"""A field that turns: a dipole follows it like a pendulum, and what it gives is counted."""

import numpy as np
import pytest
from scipy.special import ellipk

from particlerb.forces.kinds import TIME
from particlerb.integrators import METHODS, UNJOINTED

MASS = 2.0
INERTIA = np.array([1.0, 2.0, 2.5])
TURN = np.array([0.6, -1.1, 1.7])  # [rad/s]
FIELD = {
    "type": "field",
    "body": "body",
    "field": [0.3, -0.8, 1.2],
    "charge": 1.5,
    "at": [0.4, -0.3, 0.2],
    "dipole": [0.2, 0.5, -0.4],
    "angular_velocity": TURN.tolist(),
}
START = {
    "position": [1.0, 0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}


def true_motion(make, times, during=(0.0, np.inf)):
    """The definition: E turned by SciPy's rotation vector Ω t."""
    moment = FIELD["charge"] * np.array(FIELD["at"]) + FIELD["dipole"]

    def load(t, R):
        E = make.rotation([1.0, 0, 0, 0]).from_rotvec(TURN * t).apply(FIELD["field"])
        E = E * (during[0] <= t < during[1])
        return FIELD["charge"] * E, np.cross(R @ moment, E)

    return make.integrate(np.diag(INERTIA), MASS, START, load, times)


@pytest.mark.parametrize("tilt", [0.01, 1.5])
def test_a_dipole_that_turns_with_the_field_swings_about_it_like_a_pendulum(make, tilt):
    """With ψ = φ - Ω t: ψ'' = -(d E/I) sin ψ, of period 4 K(sin² ψ₀/2)/√(d E/I)."""
    d, E, moment, rate = 0.3, 5.0, 1.3, 2.1
    period = 4 * ellipk(np.sin(tilt / 2) ** 2) / np.sqrt(d * E / moment)
    field = FIELD | {"field": [E, 0, 0], "charge": 0.0, "at": [0, 0, 0], "dipole": [d, 0, 0]}
    field["angular_velocity"] = [0, 0, rate]
    start = {
        "orientation": [np.cos(tilt / 2), 0, 0, np.sin(tilt / 2)],
        "angular_velocity": [0, 0, rate],
    }
    keys = {"method": "dop853", "tolerance": 1e-13, "t_end": period, "every": period / 4}
    found = make.arrays(make.case(make.body(inertia=[moment] * 3, **start), force=[field], **keys))
    axis = make.rotation(found.orientation[:, 0]).apply([1, 0, 0])
    psi = np.arctan2(axis[:, 1], axis[:, 0]) - rate * found.time
    psi = (psi + np.pi) % (2 * np.pi) - np.pi
    # along the field after a quarter, on the other side after half a period
    assert psi == pytest.approx([tilt, 0, -tilt, 0, tilt], abs=1e-10)
    spin = found.angular_velocity[:, 0, 2]
    assert spin[[0, 2, 4]] == pytest.approx(rate, abs=1e-10)
    assert found.ledger.work == pytest.approx(0.5 * moment * (spin**2 - rate**2), abs=1e-10)
    assert np.abs(found.ledger.work).max() > 1e-5


def test_charges_and_a_dipole_against_an_integration(make):
    keys = {"force": [FIELD], "t_end": 1.6, "every": 0.4, "method": "dop853", "tolerance": 1e-13}
    found = make.arrays(make.case(make.body(**START), **keys))
    assert "work from potentials and their change with time" in found.plan
    true = true_motion(make, found.time)
    assert found.position[:, 0] == pytest.approx(true.position, abs=1e-11)
    assert make.angle(found.orientation[:, 0], true.orientation).max() < 1e-11
    assert found.ledger.work == pytest.approx(true.external[:, 0], abs=1e-10)


STEPS = {"strang": (2, 0.1), "rkn6": (6, 0.4), "rk4": (4, 0.1)}
FIRST_ORDER = ["semi_implicit_euler", "explicit_euler", "momentum_euler"]
END = 1.6


@pytest.mark.plain
@pytest.mark.parametrize("tied", [False, True])
@pytest.mark.parametrize("method", [*STEPS, *FIRST_ORDER])
def test_methods_keep_their_order_and_the_ledger_closes_at_it(make, method, tied):
    """`tied` to another body, by next to nothing: then the loop for bodies together takes it."""
    order, dt = STEPS.get(method, (1, 2.0**-6))
    true = true_motion(make, [END])
    bodies, force = [make.body(**START)], [FIELD]
    if tied:
        bodies.append(make.body("other", position=[9.0, 0, 0]))
        force = [FIELD, make.tie("other", 1e-300)]
    errors, drift = [], []
    for h in (dt, dt / 2, dt / 4):
        keys = {"force": force, "t_end": END, "every": END, "method": method, "dt": h}
        found = make.arrays(make.case(*bodies, **keys))
        errors.append(make.angle(found.orientation[-1, 0], true.orientation[-1]))
        drift.append(abs(found.ledger.energy_error[-1]))
    assert np.log2(errors[0] / errors[2]) / 2 == pytest.approx(order, abs=0.3)
    assert np.log2(drift[0] / drift[2]) / 2 > order - 0.6
    work = found.ledger.work[-1]
    assert work == pytest.approx(true.external[-1, 0], abs=20 * errors[-1] + 1e-9)
    assert abs(true.external[-1, 0]) > 0.1


@pytest.mark.parametrize("method", ["strang", "rk4", "dop853"])
def test_a_field_that_acts_later_has_turned_meanwhile(make, method):
    """And frames off the grid of steps see the field of their own time."""
    during = (0.5, 1.1)
    force = [FIELD | {"during": list(during)}]
    keys = {"t_end": 1.6, "every": 0.17, "method": method, "tolerance": 1e-12}
    keys |= {} if method == "dop853" else {"dt": 2e-3}
    found = make.arrays(make.case(make.body(**START), force=force, **keys))
    parts = found.time <= during[0]
    true = true_motion(make, found.time, during)
    assert np.abs(true.velocity[~parts] - START["velocity"]).max() > 0.1
    assert found.velocity[:, 0] == pytest.approx(true.velocity, abs=3e-6)


@pytest.mark.parametrize("loop", ["alone", "tied", "contact"])
def test_each_loop_tells_kicks_the_time_at_which_they_are_made(make, loop):
    """On a charge alone: p = Σ q E(t_k) h_k, half a step at the ends; frames off the grid too."""
    dt, q = 0.1, 1.5
    ball = make.sphere("body")
    force = [{"type": "field", "body": "body", "field": FIELD["field"], "charge": q}]
    force[0]["angular_velocity"] = TURN.tolist()
    keys = {"method": "strang", "dt": dt, "t_end": 0.99, "every": 0.33}
    bodies = [ball, make.sphere("other", position=[9.0, 0, 0])]
    if loop == "tied":
        force.append(make.tie("other", 1e-300))
    if loop == "contact":
        keys["contact"] = make.hooke(100.0)
    found = make.arrays(make.case(*bodies, force=force, **keys))

    def kick(t, h):
        return q * h * make.rotation([1.0, 0, 0, 0]).from_rotvec(TURN * t).apply(FIELD["field"])

    for time, p in zip(found.time, found.linear_momentum[:, 0], strict=True):
        steps = int(time / dt)
        rest = time - steps * dt
        expected = sum(kick(k * dt, 0.5 * dt) + kick((k + 1) * dt, 0.5 * dt) for k in range(steps))
        expected = expected + kick(steps * dt, 0.5 * rest) + kick(time, 0.5 * rest)
        assert p == pytest.approx(expected, abs=1e-14)


def test_every_method_with_a_step_takes_time_into_account():
    able = [method for method in map(METHODS.get, UNJOINTED) if method.order]
    assert all(TIME in method.accepts for method in able)
