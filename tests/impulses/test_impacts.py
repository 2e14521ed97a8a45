"""Restitution: bounces, rows of balls, rods, clumps that meet in free space."""

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    G,
    R,
    clump,
    errors,
    events,
    exact,
    go,
    impulse,
    plane,
    sphere,
    weightless,
)

plain = pytest.mark.plain


@pytest.mark.parametrize("dt", [0.1, 0.01])
def test_an_elastic_ball_keeps_its_energy_at_any_step(dt):
    ball = sphere(radius=1.0, position=[0, 0, 5.9])
    keys = {"wall": [plane()], "gravity": DOWN, "t_end": 20.0, "every": 0.7}
    t = go(ball, contact=impulse(1.0), dt=dt, **keys)
    assert np.abs(t.energy / t.energy[0] - 1.0).max() < 1e-12
    assert max(errors(t)) < 1e-11 * t.energy[0]


@plain
def test_heights_of_bounces_follow_restitution_to_the_order_of_the_step():
    misses = []
    for dt in (4e-3, 1e-3):
        t = go(sphere(position=[0, 0, 1.0 + R]), contact=impulse(0.8), wall=[plane()],
               gravity=DOWN, dt=dt, t_end=1.2, every=dt)  # fmt: skip
        z = t.position[:, 0, 2] - R
        bounced = np.flatnonzero(np.diff(np.sign(t.linear_momentum[:, 0, 2])) > 0)[0]
        misses.append(abs(z[bounced:].max() - 0.64))
        assert misses[-1] < G * np.sqrt(2 * G) * dt * (1.0 - 0.64)
    assert misses[1] < 0.5 * misses[0]


@pytest.mark.compiled
@pytest.mark.parametrize("k", [1, 2, 3])
def test_newtons_cradle_hands_on_as_many_balls_as_come_in(k):
    balls = [
        sphere(f"b{i}", position=[2 * R * i - 0.05 * (i < k), 0, 0], velocity=[float(i < k), 0, 0])
        for i in range(5)
    ]
    t = weightless(*balls, contact=impulse(1.0, 0.0), dt=1e-3, t_end=0.2, every=0.1)
    expected = [float(i >= 5 - k) for i in range(5)]
    assert t.velocity[-1, :, 0] == pytest.approx(expected, abs=1e-14)


@plain
@pytest.mark.parametrize("e", [0.7, 0.0])
@pytest.mark.parametrize(("v", "mu"), [(3.0, 0.2), (0.5, 0.6)])
def test_an_oblique_bounce_is_that_of_a_rigid_ball_wherever_its_step_ends(v, mu, e):
    """Friction is μ m (1 + e) or ends slip, with the arm R: Δv = J/m, Δω = -J R/I."""
    ball = sphere(position=[0, 0, R + 0.05], velocity=[v, 0, -1.0], angular_velocity=[0, 2.0, 0])
    t = go(ball, contact=impulse(e, mu, tolerance=1e-13, iterations=200), wall=[plane()], dt=8e-3,
           t_end=0.08, every=0.08)  # fmt: skip
    change = max(-mu * (1.0 + e), -2.0 / 7.0 * (v - 2.0 * R))
    assert t.velocity[-1, 0] == pytest.approx([v + change, 0.0, e], abs=1e-11)
    assert t.angular_velocity[-1, 0] == pytest.approx([0.0, 2.0 - 2.5 * change / R, 0.0], abs=1e-10)


@plain
def test_a_ball_bounces_to_rest_alike_on_a_floor_that_moves_evenly():
    """A last hit that one step lets land is at rest in the next, whatever its gap is rounded to."""
    ways = []
    for speed in (0.0, 0.9):
        ball = sphere(position=[0, 0, 0.3], velocity=[0.4, 0, speed])
        floor = plane(motion={"velocity": [0, 0, speed]}) if speed else plane()
        t = go(ball, contact=impulse(0.8, 0.3, tolerance=1e-12), wall=[floor], gravity=DOWN,
               dt=4e-3, t_end=1.8, every=0.02)  # fmt: skip
        ways.append(t.position[:, 0] - np.outer(t.time, [0, 0, speed]))
    assert np.abs(ways[0] - ways[1]).max() < 1e-12


@plain
def test_a_row_of_halved_masses_speeds_up_by_its_closed_form():
    balls = [
        sphere(f"b{i}", mass=0.5**i, position=[2 * R * i - 0.05 * (i < 1), 0, 0],
               velocity=[float(i < 1), 0, 0])
        for i in range(6)
    ]  # fmt: skip
    t = go(*balls, contact=impulse(1.0, 0.0), dt=1e-3, t_end=0.1, every=0.1)
    assert t.velocity[-1, 5, 0] == pytest.approx((4.0 / 3.0) ** 5, rel=1e-13)
    assert max(errors(t)) < 1e-14


def through_equal_gaps(masses):
    """Velocities after the first ball has come with 1 m/s onto others that are as near as can be.

    The gap that closes next is the next hit: of the limit only the ratios of gaps are left.
    """
    m, gap, v = np.array(masses), np.ones(len(masses) - 1), np.zeros(len(masses))
    v[0] = 1.0
    while (approach := v[:-1] - v[1:]).max() > 1e-12:
        left = np.divide(gap, approach, np.full(gap.size, np.inf), where=approach > 1e-12)
        k = left.argmin()
        gap -= left[k] * approach
        p = 2.0 * approach[k] / (1.0 / m[k] + 1.0 / m[k + 1])
        v[k : k + 2] += -p / m[k], p / m[k + 1]
    return v


@plain
@pytest.mark.parametrize("contact", [impulse(1.0, 0.0), events(1.0, 0.0)], ids=lambda c: c["law"])
@pytest.mark.parametrize("masses", [(4.0, 1.0, 2.0, 0.5), (2.0, 1.0, 1.0, 2.0)])
def test_a_row_of_unequal_masses_goes_as_with_equal_gaps_that_vanish(masses, contact):
    balls = [
        sphere(f"b{i}", mass=m, position=[2 * R * i - 0.01 * (i < 1), 0, 0],
               velocity=[float(i < 1), 0, 0])
        for i, m in enumerate(masses)
    ]  # fmt: skip
    step = {"dt": 1e-3} if contact["law"] == "impulse" else {}
    t = weightless(*balls, contact=contact, t_end=0.1, every=0.1, **step)
    assert t.velocity[-1, :, 0] == pytest.approx(through_equal_gaps(masses), abs=1e-13)


@plain
def test_a_ball_that_hits_the_tip_of_a_rod_follows_rigid_impact():
    rod = {
        "name": "rod",
        "mass": 1.0,
        "position": [0, 0, 0],
        "shape": {
            "type": "points",
            "mass": 0.5,
            "radius": R,
            "position": [[-0.5, 0, 0], [0.5, 0, 0]],
        },
    }
    ball = sphere("ball", mass=1.0, position=[0.5, 0, 0.25], velocity=[0, 0, -1.0])
    del rod["mass"]
    t = go(rod, ball, contact=impulse(1.0, 0.0), dt=1e-3, t_end=0.1, every=0.1)
    inertia = 2 * 0.5 * (0.25 + 0.4 * R * R)
    compliance = 1.0 + 1.0 + 0.25 / inertia
    push = 2.0 / compliance
    assert t.velocity[-1, 1, 2] == pytest.approx(-1.0 + push, abs=1e-14)
    assert t.velocity[-1, 0, 2] == pytest.approx(-push, abs=1e-14)
    assert t.angular_velocity[-1, 0, 1] == pytest.approx(0.5 * push / inertia, abs=1e-13)


def converging(n=8, seed=3):
    rng = np.random.default_rng(seed)
    places = np.array([(i % 2, (i // 2) % 2, i // 4) for i in range(n)]) * 0.6 - 0.3
    turns = rng.normal(size=(n, 4))
    return [
        clump(f"c{i}", position=list(places[i]), orientation=list(turns[i]),
              velocity=list(rng.normal(size=3) - 2.0 * places[i]),
              angular_velocity=list(3.0 * rng.normal(size=3)))
        for i in range(n)
    ]  # fmt: skip


@pytest.mark.parametrize(("restitution", "friction"), [(0.0, 0.5), (0.5, 2.0), (1.0, 0.3)])
def test_clumps_that_meet_keep_their_momenta_and_gain_no_energy(restitution, friction):
    contact = impulse(restitution, friction, push_out=0.0, tolerance=1e-6)
    t = weightless(*converging(), contact=contact, dt=2e-3, t_end=0.4, every=2e-3)
    sizes = t.momentum_sizes()
    P, L = t.observable("linear_momentum"), t.observable("angular_momentum")
    assert np.abs(P - P[0]).max() < 1e-13 * sizes[0]
    assert np.abs(L - L[0]).max() < 1e-13 * sizes[1]
    assert t.energy[-1] < 0.98 * t.energy[0]
    assert np.diff(t.energy).max() < 1e-13 * t.energy[0]
    assert errors(t)[0] < 1e-13 * t.energy[0]


@plain
def test_push_out_changes_nothing_that_is_not_counted():
    t = go(*converging(), contact=impulse(0.5, 0.5), dt=5e-3, t_end=0.4, every=5e-3, gravity=DOWN,
           wall=[plane(point=[0, 0, -0.8])])  # fmt: skip
    energy, linear, angular = errors(t)
    assert energy < 1e-12 * t.energy.max()
    assert max(linear, angular) < 1e-12 * t.momentum_sizes()[0]


@plain
def test_symmetric_scenes_turned_in_space_move_alike():
    def hit(axis, across):
        side = [0.03 * c for c in across]
        one = sphere("a", position=[0.3 * c for c in axis], velocity=[-2.0 * c for c in axis])
        two = clump("b", position=side, angular_velocity=[2.0 * c for c in across])
        t = go(one, two, contact=exact(0.4, 0.3), dt=2e-3, t_end=0.2, every=0.2)
        return t.velocity[-1], t.angular_velocity[-1]

    v, w = hit((1, 0, 0), (0, 1, 0))
    v_turned, w_turned = hit((0, 1, 0), (0, 0, 1))
    assert v_turned == pytest.approx(np.roll(v, 1, axis=1), abs=1e-13)
    assert w_turned == pytest.approx(np.roll(w, 1, axis=1), abs=1e-12)
