"""The Strang splitting: order, exact drifts, time reversal, energy, symmetries of the world."""

import numpy as np
import pytest
from formulas import unit_quaternion
from hypothesis import given, settings
from hypothesis import strategies as st

from particlerb.integrators import METHODS
from particlerb.stepping import stepped_motion

INERTIA = (1.0, 2.0, 2.5)
TENSOR = np.diag(INERTIA)
START = {
    "position": [0.1, -0.2, 0.3],
    "velocity": [0.3, 0.1, -0.2],
    "orientation": [0.8, 0.0, 0.6, 0.0],
    "angular_velocity": [1.0, 0.4, -0.7],
}
AT, FORCE, TORQUE = np.array([0.4, -0.3, 0.2]), np.array([1.0, 2.0, -1.5]), np.array([0.5, -1, 0.7])
LOADS = {
    "push": lambda t, R: (FORCE, np.cross(R @ AT, FORCE)),
    "follower": lambda t, R: (R @ FORCE, R @ np.cross(AT, FORCE)),
    "torque": lambda t, R: (np.zeros(3), TORQUE),
}


def forces(make, kind):
    """Forces of a case that are one of LOADS."""
    frame = {"frame": "body"} if kind == "follower" else {}
    return [make.torque(TORQUE) if kind == "torque" else make.push(FORCE, AT, **frame)]


def vectors(size=1.0):
    """Vectors of at most this size per component."""
    return st.lists(st.floats(-size, size), min_size=3, max_size=3).map(np.array)


def unit_quaternions():
    """Unit quaternions in any direction."""
    return st.integers(0, 2**32 - 1).map(unit_quaternion)


# Order


MEASURED = {  # what a kick does not give exactly
    "push": ("turn", "spin"),
    "follower": ("turn", "spin", "way"),
    "torque": ("turn",),
}


@pytest.mark.compiled
@pytest.mark.parametrize("kind", LOADS)
@pytest.mark.parametrize("t_end", [1.6, 1.537])
def test_order_is_two(make, kind, t_end):
    """Also at a frame between two steps, which is reached by a partial step."""
    true = make.integrate(TENSOR, 2.0, START, LOADS[kind], [t_end])
    steps = 0.1 / 2.0 ** np.arange(5)
    errors = {"turn": [], "spin": [], "way": []}
    for dt in steps:
        scene = make.case(make.body(**START), force=forces(make, kind), t_end=t_end, every=t_end)
        found = make.arrays(scene, f"run.dt={dt}")
        errors["turn"].append(make.angle(found.orientation[-1, 0], true.orientation[-1]))
        for name, quantity in (("way", "position"), ("spin", "angular_momentum")):
            difference = getattr(found, quantity)[-1, 0] - getattr(true, quantity)[-1]
            errors[name].append(np.linalg.norm(difference))
    for name in MEASURED[kind]:
        assert errors[name][0] > 1e-6  # the fit does not live on rounding
        slope = np.polyfit(np.log(steps), np.log(errors[name]), 1)[0]
        assert slope == pytest.approx(METHODS["strang"].order, abs=0.05)


# The drift


CLASSES = {
    "point": (0.0, 0.0, 0.0),
    "rod": (1.3, 1.3, 0.0),
    "sphere": (1.7, 1.7, 1.7),
    "prolate": (2.0, 2.0, 0.5),
    "oblate": (1.0, 1.0, 1.9),
    "turned": (0.5, 2.0, 2.0),  # symmetry axis x: the rotor frame is not the body frame
}


def free_orientation(make, inertia, q, w, t):
    """Orientation of a free body with a symmetry axis: a turn about L, one about the axis."""
    moments = np.array(inertia)
    if not moments.any():
        return q
    odd = int(np.argmax(np.abs(moments - np.median(moments))))
    across = moments[(odd + 1) % 3]
    R = make.rotation(q)
    m = moments * R.inv().apply(w)
    L = R.apply(m)
    axis = np.eye(3)[odd]
    own = 0.0 if moments[odd] == 0 else m[odd] * (1 / moments[odd] - 1 / across)
    turn = make.rotation([1.0, 0, 0, 0]).from_rotvec(L * t / across)
    about = turn.from_rotvec(own * t * axis)
    return (turn * R * about).as_quat(scalar_first=True)


@pytest.mark.parametrize("name", CLASSES)
@given(data=st.data())
@settings(max_examples=15)
def test_drift_is_exact_for_bodies_with_an_axis(make, name, data):
    """Up to a whole turn per step: |L| dt / I₁ <= 2π, with I₁ the moment across the axis."""
    inertia = np.array(CLASSES[name])
    q, w = data.draw(unit_quaternions()), data.draw(vectors(3.0))
    if name == "point":
        w = np.zeros(3)
    if name == "rod":
        axis = make.rotation(q).apply([0, 0, 1])
        w = w - axis * (w @ axis)
    L = inertia * make.rotation(q).inv().apply(w)
    rate = max(np.linalg.norm(L) / (np.median(inertia) or 1.0), np.linalg.norm(w), 1e-3)
    dt = data.draw(st.floats(0.01, 0.999)) * 2 * np.pi / rate
    steps = 8
    body = make.body(inertia=inertia, orientation=q.tolist(), angular_velocity=w.tolist())
    scene = make.case(body, t_end=steps * dt, every=steps * dt, dt=dt, method="strang")
    found = make.arrays(scene)
    expected = free_orientation(make, inertia, q, w, steps * dt)
    # a few roundings of every radian that was turned, here and there, and of every step
    assert make.angle(found.orientation[-1, 0], expected) < 5e-15 * steps * (1 + rate * dt)
    assert found.angular_momentum[-1, 0] == pytest.approx(found.angular_momentum[0, 0], abs=0)


def test_asymmetric_drift_turns_and_keeps_momentum(make):
    scene = make.case(make.body(**START), t_end=20.0, every=5.0, dt=0.05, method="strang")
    found = make.arrays(scene)
    assert (found.angular_momentum == found.angular_momentum[0]).all()
    assert (found.linear_momentum == found.linear_momentum[0]).all()
    assert np.abs(np.linalg.norm(found.orientation, axis=-1) - 1).max() < 4e-16
    assert make.angle(found.orientation[0, 0], found.orientation[1, 0]) > 0.1


# Symmetries


@pytest.mark.parametrize("kind", LOADS)
def test_runs_backwards(make, kind):
    """Forward, momenta turned round, and as far again: back at the start but for rounding."""
    keys = {"force": forces(make, kind), "t_end": 4.0, "every": 4.0, "dt": 0.05}
    there = make.arrays(make.case(make.body(**START), **keys))
    back = make.arrays(make.case(make.body(**make.turned_round(there)), **keys))
    assert make.angle(there.orientation[0, 0], there.orientation[-1, 0]) > 0.1
    # 160 steps of rounding 1e-16, which the motion amplifies by less than 100
    assert back.position[-1, 0] == pytest.approx(there.position[0, 0], abs=2e-12)
    assert make.angle(back.orientation[-1, 0], there.orientation[0, 0]) < 2e-12
    assert back.angular_momentum[-1, 0] == pytest.approx(-there.angular_momentum[0, 0], abs=2e-12)


@given(turn=unit_quaternions(), w=vectors(2.0), force=vectors(3.0), at=vectors())
@settings(max_examples=15)
def test_does_not_know_north(make, turn, w, force, at):
    """The scene turned as a whole moves as the turned scene."""
    R = make.rotation(turn)

    def run(R):
        start = {
            "position": R.apply(START["position"]),
            "velocity": R.apply(START["velocity"]),
            "orientation": (R * make.rotation(START["orientation"])).as_quat(scalar_first=True),
            "angular_velocity": R.apply(w),
        }
        pushes = [make.push(R.apply(force), at)]
        return make.arrays(make.case(make.body(**start), force=pushes, t_end=2.0, dt=0.02))

    one, other = run(make.rotation([1.0, 0, 0, 0])), run(R)
    for name in ("position", "linear_momentum", "angular_momentum"):
        expected = R.apply(getattr(one, name)[:, 0])
        assert getattr(other, name)[:, 0] == pytest.approx(expected, abs=1e-12)
    for k in range(len(one.time)):
        expected = (R * make.rotation(one.orientation[k, 0])).as_quat(scalar_first=True)
        assert make.angle(expected, other.orientation[k, 0]) < 1e-12


def test_does_not_know_metre_and_kilogram(make):
    """A body of 1e-27 kg and 1e-9 m moves like one of 1 kg and 1 m, in its own units."""
    length, mass, time = 1e-9, 1e-27, 1e-6

    def run(length, mass, time):
        start = {
            "position": np.array(START["position"]) * length,
            "velocity": np.array(START["velocity"]) * length / time,
            "orientation": START["orientation"],
            "angular_velocity": np.array(START["angular_velocity"]) / time,
        }
        one = make.body(inertia=np.array(INERTIA) * mass * length**2, **start) | {"mass": mass}
        pushes = [make.push(FORCE * mass * length / time**2, AT * length)]
        return make.arrays(
            make.case(one, force=pushes, t_end=2 * time, every=0.5 * time, dt=0.01 * time)
        )

    one, small = run(1.0, 1.0, 1.0), run(length, mass, time)
    assert small.position / length == pytest.approx(one.position, rel=1e-11, abs=1e-12)
    unit = mass * length**2 / time
    assert small.angular_momentum / unit == pytest.approx(one.angular_momentum, rel=1e-11)
    assert small.orientation == pytest.approx(one.orientation, abs=1e-12)


# Energy


@pytest.mark.compiled
def test_energy_of_a_pushed_body_is_bounded_without_trend(make):
    """A couple of two constant forces has a potential and leaves the body in place: a pendulum."""
    couple = [make.push([0, 0, 2.0], [0.5, 0.1, 0]), make.push([0, 0, -2.0], [-0.5, 0.2, 0])]
    start = {"angular_velocity": [0.5, 0.3, 1.0]}
    scene = make.case(make.body(**start), force=couple, t_end=5000.0, every=0.35, dt=0.05)
    found = make.arrays(scene)
    error, kinetic = found.ledger.energy_error, found.ledger.kinetic_energy
    assert np.ptp(kinetic) > 0.5  # it swings
    size = np.abs(error).max()
    assert 1e-6 < size < 1e-2 * kinetic.max()  # (ω dt)² / 12 of what swings is 1e-3
    first, last = np.array_split(error, 10)[0], np.array_split(error, 10)[-1]
    assert np.abs(last).max() < 1.5 * np.abs(first).max()
    trend = np.polyfit(found.time, error, 1)[0] * found.time[-1]
    assert abs(trend) < 0.1 * size
    assert np.abs(np.linalg.norm(found.orientation, axis=-1) - 1).max() < 1e-15


def test_progress_pauses_change_no_bit(make, monkeypatch):
    """The host takes the kernel back every so many steps; the motion does not notice."""
    scene = make.case(make.body(**START), force=forces(make, "push"), t_end=1.0, every=0.4, dt=0.03)
    straight = make.arrays(scene)
    monkeypatch.setattr(stepped_motion, "NANOSECONDS_PER_CALL", 5 * METHODS["strang"].cost)
    paused = make.arrays(scene)
    assert (straight.orientation == paused.orientation).all()
    assert (straight.angular_momentum == paused.angular_momentum).all()
    assert (straight.ledger.energy_error == paused.ledger.energy_error).all()
