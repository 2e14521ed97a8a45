"""A pendulum with stops, with friction and with a weak motor, beside SciPy with event location.

J θ'' = -K sin θ + τ about a hinge along y, θ from hanging: DOP853 from event to event, and a mode
of its own for what sticks. It shares no line with the solver. Impacts and changes of mode fall
within steps, so errors are of order 1 in the step at least.
"""

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, case, impulse, sphere
from scipy.integrate import solve_ivp

import particlerb

pytestmark = pytest.mark.plain

M, D = 2.0, 0.5  # kg, m
J = M * D * D + 0.4 * M * R * R  # kg m²
K = M * G * D  # N m
STEPS = np.array([0.02, 0.005])  # s


def angles(joint, theta, omega, t_end, dt):
    """Times, and the angle at each step: downwards at 0, right-handed about y."""
    at = [-D * np.sin(theta), 0.0, -D * np.cos(theta)]
    v = np.cross([0.0, omega, 0.0], at).tolist()
    ball = sphere(position=at, velocity=v, contact=False, angular_velocity=[0, omega, 0])
    hinge = {"type": "hinge", "body": "ball", "at": [0, 0, 0], "axis": [0, 1, 0]} | joint
    scene = case(ball, joint=[hinge], contact=impulse(tolerance=1e-12), gravity=DOWN)
    scene["output"] = {"fields": ["position", "joint_coordinate"]}
    scene["run"] |= {"t_end": t_end, "dt": dt, "every": dt}
    with particlerb.run(scene) as t:
        return np.array(t.time), theta + np.array(t.joint_coordinate[:, 0])


def until(events, torque, start, y, times, found):
    """Swing on until an event happens, and fill the angles: when, the state, and which."""
    for event in events:
        event.terminal = True
    span, precise = [start, times[-1] + 1e-9], {"rtol": 1e-12, "atol": 1e-13}
    swing = solve_ivp(
        lambda _, y: [y[1], (torque - K * np.sin(y[0])) / J], span, y, "DOP853",
        events=events, dense_output=True, **precise,
    )  # fmt: skip
    inside = (times >= start) & (times <= swing.t[-1])
    found[inside] = swing.sol(times[inside])[0]
    which = [k for k, at in enumerate(swing.t_events) if at.size]
    return swing.t[-1], swing.y[:, -1], which[0] if which else None


def outwards(event, direction):
    """An event that counts in one direction."""
    event.direction = direction
    return event


def with_stops(times, theta, omega, lower, upper, e):
    """It meets a stop, and leaves it e times as fast."""
    found, t, y = np.full(times.size, np.nan), 0.0, [theta, omega]
    stops = [outwards(lambda _, y: y[0] - lower, -1.0), outwards(lambda _, y: y[0] - upper, 1.0)]
    while t < times[-1]:
        t, y, which = until(stops, 0.0, t, y, times, found)
        y = [(lower, upper)[which], -e * y[1]] if which is not None else y
    return found


def with_friction(times, theta, omega, torque):
    """Coulomb's friction; where it stands still, and the weight is less, it sticks."""
    found, t, y, way = np.full(times.size, np.nan), 0.0, [theta, omega], np.sign(omega)
    rests = lambda _, y: y[1]  # noqa: E731
    while t < times[-1]:
        t, y, _ = until([outwards(rests, -way)], -way * torque, t, y, times, found)
        way = -way
        if K * abs(np.sin(y[0])) <= torque:
            found[times >= t] = y[0]
            break
        y = [y[0], way * 1e-12]
    return found, t


def with_motor(times, theta, omega, speed, largest):
    """It pulls with all that it has below its speed, keeps it where it can, and lags elsewhere."""
    found, t, y = np.full(times.size, np.nan), 0.0, [theta, omega]
    meets = outwards(lambda _, y: y[1] - speed, 1.0)
    changes = 0
    while t < times[-1]:
        t, y, which = until([meets], largest, t, y, times, found)
        if which is None:
            break
        ahead = y[0] + np.linspace(0.0, 2.0 * np.pi, 200_001)
        lost = ahead[K * np.sin(ahead) > largest]
        until_lost = t + (lost[0] - y[0]) / speed
        inside = (times >= t) & (times <= until_lost)
        found[inside] = y[0] + speed * (times[inside] - t)
        t, y, changes = until_lost, [lost[0], speed * (1.0 - 1e-13)], changes + 2
    return found, changes


def is_of_order_one(pairs, most):
    """Errors are `most` [rad/s] times each of the steps at most, and fall with them."""
    errors = np.array([np.abs(x - expected).max() for x, expected in pairs])
    assert (errors < most * STEPS).all(), errors / STEPS
    assert errors[-1] < 0.5 * errors[0], errors


def test_a_pendulum_bounces_between_its_stops():
    lower, upper, e, theta = -0.3, 0.5, 0.7, 0.45
    limit = {"range": [lower - theta, upper - theta], "restitution": e}
    runs = [angles({"limit": limit}, theta, 2.0, 0.6, dt) for dt in STEPS]
    pairs = [(x, with_stops(t, theta, 2.0, lower, upper, e)) for t, x in runs]
    is_of_order_one(pairs, 6.0)


def test_friction_in_a_hinge_stops_a_pendulum_where_it_sticks():
    torque = 0.5 * K
    runs = [angles({"friction": torque}, 1.0, 2.0, 1.0, dt) for dt in STEPS]
    found = [with_friction(t, 1.0, 2.0, torque) for t, _ in runs]
    assert found[0][1] < 0.9  # s: it sticks
    is_of_order_one([(x, own[0]) for (_, x), own in zip(runs, found, strict=True)], 1.5)
    assert all(x[-1] == x[-2] for _, x in runs)


def test_a_weak_motor_loses_its_speed_under_load_and_finds_it_again():
    motor = {"speed": 3.0, "largest": 0.8 * K}
    runs = [angles({"motor": motor}, 0.0, 0.0, 1.4, dt) for dt in STEPS]
    found = [with_motor(t, 0.0, 0.0, 3.0, 0.8 * K) for t, _ in runs]
    assert found[0][1] == 4  # it has lost its speed once, and would once more
    is_of_order_one([(x, own[0]) for (_, x), own in zip(runs, found, strict=True)], 0.05)
