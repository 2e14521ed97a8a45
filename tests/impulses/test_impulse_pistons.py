"""Walls with a mass that impulses move: closed forms, energy and momentum, what is refused."""

import math

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    G,
    R,
    assert_goes_on_alike,
    case,
    errors,
    exact,
    go,
    impulse,
    plane,
    sphere,
)

import particlerb

pytestmark = pytest.mark.plain

FIELDS = ["position", "orientation", "linear_momentum", "wall_position", "wall_velocity",
          "wall_force"]  # fmt: skip


def piston(mass, load=0.0, point=(0, 0, 0), **keys):
    """Floor that slides up and down."""
    return plane(point=list(point), piston={"mass": mass, "axis": [0, 0, 2], "load": load} | keys)


@pytest.mark.parametrize("joint", [[], [{"type": "slider", "body": "ball", "axis": [0, 0, 1]}]])
@pytest.mark.parametrize("restitution", [1.0, 0.5, 0.0])
def test_a_piston_of_3_kg_is_hit_by_a_ball_as_a_free_body(restitution, joint):
    """Without gravity: v = (m - e M)/(m + M) v₀, V = m (1 + e)/(m + M) v₀."""
    t = go(sphere("ball", position=[0, 0, 0.15], velocity=[0, 0, -2.0]), joint=joint,
           contact=exact(restitution), wall=[piston(3.0)], dt=5e-3, t_end=0.1, every=0.05,
           output={"fields": FIELDS})  # fmt: skip
    v = -2.0 * (2.0 - restitution * 3.0) / 5.0
    V = -2.0 * 2.0 * (1.0 + restitution) / 5.0
    assert t.linear_momentum[-1, 0] == pytest.approx([0.0, 0.0, 2.0 * v], abs=1e-13)
    assert t.wall_velocity[-1, 0] == pytest.approx([0.0, 0.0, V], abs=1e-13)
    assert errors(t)[0] < 1e-13
    assert t.energy[-1] == pytest.approx(1.0 * v * v + 1.5 * V * V, abs=1e-13)


def test_a_ball_rests_on_a_piston_that_a_load_lifts():
    """(m + M) a = F - (m + M) g; the piston bears m (g + a)."""
    t = go(sphere(position=[0, 0, R]), contact=exact(), wall=[piston(3.0, 70.0)], gravity=DOWN,
           dt=0.01, t_end=0.4, every=0.1, output={"fields": FIELDS})  # fmt: skip
    a = 70.0 / 5.0 - G
    assert np.abs(t.position[:, 0, 2] - R - 0.5 * a * t.time**2).max() < 1e-12
    assert np.abs(t.wall_position[:, 0, 2] - 0.5 * a * t.time**2).max() < 1e-12
    assert t.wall_force[-1, 0] == pytest.approx([0.0, 0.0, -2.0 * (G + a)], abs=1e-10)
    assert max(errors(t)) < 1e-12


def test_two_balls_on_a_hinge_rest_on_a_piston_that_a_load_lifts():
    """As one does; a run with a piston and joints read behind the end of the list of joints."""
    balls = [sphere(f"ball {x}", position=[x, 0, R]) for x in (-0.15, 0.15)]
    hinge = {"type": "hinge", "body": "ball -0.15", "to": "ball 0.15", "axis": [0, 1, 0],
             "at": [0, 0, R]}  # fmt: skip
    t = go(*balls, contact=exact(), wall=[piston(3.0, 100.0)], gravity=DOWN, joint=[hinge],
           dt=0.01, t_end=0.2, every=0.1, output={"fields": FIELDS})  # fmt: skip
    a = 100.0 / 7.0 - G
    assert np.abs(t.position[:, :, 2] - R - 0.5 * a * t.time[:, None] ** 2).max() < 1e-12
    assert t.wall_force[-1, 0] == pytest.approx([0.0, 0.0, -4.0 * (G + a)], abs=1e-10)
    assert max(errors(t)) < 1e-12


def test_a_ball_bounces_on_a_piston_in_the_balance():
    """M g is borne by the load: the ball comes back after 2 v/g, the piston moves on."""
    v, dt = 1.5, 1e-3
    ball = sphere(position=[0, 0, R], velocity=[0, 0, v])
    t = go(ball, contact=exact(1.0), wall=[piston(6.0, 6.0 * G)], gravity=DOWN, dt=dt, t_end=0.5,
           every=0.125, output={"fields": FIELDS})  # fmt: skip
    touch = 2.0 * v / G
    after, V = -v * (2.0 - 6.0) / 8.0, -v * 2.0 * 2.0 / 8.0
    rest = 0.5 - touch
    assert t.position[-1, 0, 2] == pytest.approx(
        R + after * rest - 0.5 * G * rest**2, abs=3 * v * dt
    )
    assert t.wall_position[-1, 0, 2] == pytest.approx(V * rest, abs=v * dt)
    assert errors(t)[0] < 1e-12


def test_push_out_moves_a_piston_too_and_is_counted():
    """By masses: the ball goes 3/5 of the overlap up, the piston 2/5 down, against its load."""
    t = go(sphere(position=[0, 0, R - 0.01]), contact=exact(overlap=0.02), gravity=DOWN,
           wall=[piston(3.0, 70.0)], dt=5e-3, t_end=0.02, every=0.02)  # fmt: skip
    assert t.observable("push_out_work")[-1] > 0.05
    assert max(errors(t)) < 1e-12


@pytest.mark.parametrize("solver", ["sweeps", "newton"])
def test_a_lid_holds_a_ball_by_friction(solver):
    """What is pressed is held by 2 μ F = 1.05 m g or falls with 0.95; the lid is a piston."""
    side = {"normal": (1, 0, 0), "name": "side"}
    for share in (1.05, 0.95):
        load = share * 2.0 * G / (2.0 * 0.5)
        lid = plane((-1, 0, 0), "lid", point=[2 * R, 0, 0],
                    piston={"mass": 1.0, "axis": [1, 0, 0], "load": -load})  # fmt: skip
        t = go(sphere(position=[R, 0, 0]), contact=exact(0.0, 0.5, solver=solver),
               wall=[plane(**side), lid], gravity=DOWN, dt=5e-3, t_end=0.1, every=0.05)  # fmt: skip
        fallen = 0.5 * G * max(1.0 - share, 0.0) * 0.01
        assert t.position[-1, 0, 2] == pytest.approx(-fallen, abs=1e-9)


def test_a_run_with_a_piston_that_is_resumed_has_the_same_bits(tmp_path):
    balls = [sphere(f"b{i}", position=[0.01 * i, 0, R + 2 * R * i]) for i in range(2)]
    keys = {"contact": impulse(0.3), "wall": [piston(1.0, 30.0)], "gravity": DOWN, "dt": 5e-3}
    scene = case(*balls, t_end=0.3, every=0.03, **keys)
    names = "position", "energy_error"
    whole = assert_goes_on_alike(scene, 0.15, tmp_path / "part.h5", names)
    often = particlerb.run(case(*balls, t_end=0.3, every=2e-3, **keys))
    assert (often.position[::15] == whole.position).all()
    assert np.abs(whole.observable("energy_error")).max() < 1e-12
    assert math.isfinite(whole.energy[-1])


@pytest.mark.parametrize("keys", [{"fixed": True}, {"motion": {"velocity": [0.3, 0, 0.1]}}])
def test_a_lid_comes_down_on_a_ball_that_impulses_do_not_move(keys):
    """It falls by 0.1 m on one held, comes on the other, and leaves e times as fast."""
    lid = plane((0, 0, -1), point=[0, 0, 0.2], piston={"mass": 3.0, "axis": [0, 0, 1]})
    other = sphere("other", position=[5, 0, 0])
    t = go(sphere(position=[0, 0, 0]) | keys, other, contact=exact(0.5), wall=[lid], gravity=DOWN,
           dt=1e-3, t_end=0.2, every=0.01, output={"fields": FIELDS})  # fmt: skip
    rate = 0.0 if "fixed" in keys else 0.1
    hit = (math.sqrt(rate**2 + 2.0 * G * 0.1) - rate) / G
    left = rate + 0.5 * (G * hit + rate)
    after = t.time[t.time > hit + 2e-3] - hit
    speeds = t.wall_velocity[-after.size :, 0, 2]
    assert speeds == pytest.approx(left - G * after, abs=0.02)
    assert errors(t)[0] < 1e-12
