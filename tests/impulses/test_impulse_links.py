"""Forces between bodies that impulses keep apart: springs, dashpots, attraction; closed forms."""

import math

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, assert_goes_on_alike, case, errors, exact, go, plane, sphere

import particlerb
from particlerb import Scene
from particlerb.maths.vec3 import dot, scale, subtract
from particlerb.tables import PythonTable

pytestmark = pytest.mark.plain

K, M, REST = 400.0, 2.0, 0.4  # [N/m], [kg], [m]
FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum", "wall_force"]
SAG = M * G / K  # [m] of a spring under one ball


def pair(height, stretch, damping=0.0):
    """Two balls over each other, the lower at a height [m], on a spring stretched so much [m]."""
    lower = sphere("lower", position=[0, 0, height])
    upper = sphere("upper", position=[0, 0, height + REST + stretch])
    spring = {"type": "spring", "body": "lower", "to": "upper", "stiffness": K,
              "rest_length": REST, "damping": damping}  # fmt: skip
    return (lower, upper), [spring]


def energy_of_tie(x1, x2, k, l0):
    d = subtract(x2, x1)
    return 0.5 * k * (np.sqrt(dot(d, d)) - l0) ** 2


@particlerb.force(potential=energy_of_tie)
def tie(x1, x2, k, l0):
    d = subtract(x2, x1)
    return scale(k * (1.0 - l0 / np.sqrt(dot(d, d))), d), (0.0, 0.0, 0.0)


def test_a_spring_that_a_user_writes_acts_as_the_built_in_one():
    """On two balls that fall onto a floor and each other, with friction."""
    low = sphere("low", position=[0, 0, 0.12], velocity=[0.4, 0, -0.6], angular_velocity=[1, 2, 3])
    side = sphere("side", position=[0.3, 0.05, 0.15], velocity=[-0.9, 0, 0])
    spring = {"type": "spring", "body": "low", "to": "side", "stiffness": K, "rest_length": REST}
    own = PythonTable(function=tie, body="low", to="side", parameters={"k": K, "l0": REST})
    found = []
    for built_in, written in (([spring], []), ([], [own])):
        scene = Scene.from_case(
            case(low, side, contact=exact(0.4, 0.3), wall=[plane()], gravity=DOWN, force=built_in,
                 dt=4e-3, t_end=0.2, every=0.05)
        )  # fmt: skip
        for force in written:
            scene.add_force(force)
        found.append(particlerb.run(scene))
    one, other = found
    assert np.ptp(one.energy) > 0.1
    for name in ("position", "linear_momentum", "angular_momentum"):
        assert np.abs(getattr(one, name) - getattr(other, name)).max() < 1e-13
    assert np.abs(one.energy - other.energy).max() < 1e-12


@pytest.mark.parametrize(("damping", "order"), [(0.0, 2), (8.0, 1)])
def test_a_ball_on_a_spring_oscillates_over_the_one_that_the_floor_bears(damping, order):
    """m z̈ = -k z - c ż about the sag; the floor bears the lower ball and what the spring gives."""
    start, gamma = -0.8 * SAG, 0.5 * damping / M
    omega, off, error = math.sqrt(K / M - gamma * gamma), [], []
    for dt in (0.01, 0.005):
        bodies, force = pair(R, -SAG + start, damping)
        t = go(*bodies, contact=exact(), wall=[plane()], gravity=DOWN, force=force, dt=dt,
               t_end=0.4, every=0.1, output={"fields": FIELDS})  # fmt: skip
        s = t.time
        z = np.exp(-gamma * s) * (np.cos(omega * s) + gamma / omega * np.sin(omega * s)) * start
        off.append(np.abs(t.position[:, 1, 2] - (R + REST - SAG + z)).max())
        assert np.abs(t.position[:, 0, 2] - R).max() < 1e-13
        error.append(errors(t))
    assert math.log2(off[0] / off[1]) == pytest.approx(order, abs=0.1)
    assert off[1] < 2e-3
    assert math.log2(error[0][0] / error[1][0]) == pytest.approx(2.0, abs=0.2)
    assert max(error[1][1:]) < 1e-12
    if not damping:
        middle = start * math.cos(omega * (0.4 - 0.5 * dt))  # of the last step
        assert -t.wall_force[-1, 0, 2] == pytest.approx(2.0 * M * G - K * middle, abs=0.05)


def test_two_balls_on_a_spring_fall_and_the_lower_one_stays():
    """e = 0: the upper one swings from its speed at the touch, until the spring lifts the other."""
    height, errs = 0.3, []
    touch = math.sqrt(2.0 * (height - R) / G)
    omega, end = math.sqrt(K / M), 0.4
    for dt in (2e-3, 1e-3):
        bodies, force = pair(height, 0.0)
        t = go(*bodies, contact=exact(), wall=[plane()], gravity=DOWN, force=force, dt=dt,
               t_end=end, every=end / 4)  # fmt: skip
        turn = omega * (end - touch)
        z = R + REST - SAG + SAG * math.cos(turn) - G * touch / omega * math.sin(turn)
        assert t.position[-1, 0, 2] == pytest.approx(R, abs=1e-12)
        errs.append(abs(t.position[-1, 1, 2] - z))
        assert np.abs(t.observable("linear_momentum_error")).max() < 1e-12
    assert max(errs) < 2e-3  # within a step of the touch
    assert t.velocity[-1, 1, 2] > 0.0


def test_balls_that_attract_each_other_meet_and_stay_together():
    """Of unequal masses, with friction and restitution, on a dashpot: momenta hold, no gain."""
    one = sphere("one", position=[-0.2, 0.05, 0], angular_velocity=[0, 0, 8.0])
    two = sphere("two", position=[0.2, 0, 0], velocity=[0, 0.5, 0]) | {"mass": 5.0}
    damper = {"type": "spring", "body": "one", "to": "two", "stiffness": 1e-3, "rest_length": 0.3,
              "damping": 0.5, "at": [0, 0.02, 0]}  # fmt: skip
    t = go(one, two, contact=exact(0.3, 0.5, push_out=0.0), attraction={"G": 0.1},
           force=[damper], dt=4e-3, t_end=0.8, every=4e-3)  # fmt: skip
    P, L = t.observable("linear_momentum"), t.observable("angular_momentum")
    assert np.abs(P - P[0]).max() < 1e-13
    assert np.abs(L - L[0]).max() < 1e-13
    gaps = np.linalg.norm(t.position[:, 0] - t.position[:, 1], axis=1) - 2.0 * R
    assert gaps[0] > 0.1
    assert np.abs(gaps[-10:]).max() < 0.02
    assert t.energy[-1] < t.energy[0]


def test_a_run_with_links_that_is_resumed_has_the_same_bits(tmp_path):
    bodies, force = pair(0.15, 0.1, 3.0)
    keys = {"contact": exact(0.4), "wall": [plane()], "gravity": DOWN, "force": force, "dt": 5e-3}
    scene = case(*bodies, t_end=0.3, every=0.03, **keys)
    names = "position", "energy_error"
    whole = assert_goes_on_alike(scene, 0.15, tmp_path / "part.h5", names)
    often = particlerb.run(case(*bodies, t_end=0.3, every=2e-3, **keys))
    assert (often.position[::15] == whole.position).all()
