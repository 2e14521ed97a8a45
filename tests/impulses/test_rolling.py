"""Resistance to rolling with impulses: closed forms with the torque μ_r R* F_n, momenta, energy."""

import math

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    G,
    R,
    assert_goes_on_alike,
    case,
    clump,
    errors,
    exact,
    go,
    impulse,
    plane,
    sphere,
    tilted,
)
from scipy.integrate import solve_ivp
from test_newton import wedged

import particlerb
from particlerb.impulses.records import room_for_partners, room_for_rows
from particlerb.impulses.rolling import ABOUT, ACROSS, bounce_rolling, write_rolling
from particlerb.impulses.rows import write_frame

I = 0.4 * 2.0 * R * R  # noqa: E741 - of a ball of 2 kg

FIELDS = ["orientation", "linear_momentum", "angular_momentum", "wall_force", "wall_torque"]

pytestmark = pytest.mark.plain


def test_a_rolling_ball_slows_down_by_five_sevenths_of_the_coefficient():
    """(m + I/R²) v̇ = -μ_r m g: friction of the floor speeds up what the torque turns too slowly."""
    ball = sphere(position=[0, 0, R], velocity=[0.6, 0.8, 0], angular_velocity=[-8.0, 6.0, 0])
    t = go(ball, contact=exact(0.0, 0.5, rolling_friction=0.1), wall=[plane()], gravity=DOWN,
           dt=5e-3, t_end=2.0, every=0.25)  # fmt: skip
    speed = np.maximum(1.0 - 5.0 / 7.0 * 0.1 * G * t.time, 0.0)
    v, omega = t.velocity[:, 0], t.angular_velocity[:, 0]
    assert np.abs(v - np.outer(speed, [0.6, 0.8, 0.0])).max() < 1e-12
    assert np.abs(omega - np.outer(speed / R, [-0.8, 0.6, 0.0])).max() < 1e-11
    assert speed[-2] == 0.0 < speed[4]
    assert max(errors(t)) < 1e-12
    assert (np.diff(t.energy) <= 1e-12).all()


@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_ball_rolls_from_the_angle_of_rolling_friction_on(share):
    angle = math.atan(0.1 * share)
    t = go(sphere(position=[0, 0, R]), contact=exact(0.0, 0.5, rolling_friction=0.1),
           wall=[plane()], gravity=tilted(angle), dt=5e-3, t_end=1.0, every=0.25)  # fmt: skip
    speed = 5.0 / 7.0 * G * max(0.0, math.sin(angle) - 0.1 * math.cos(angle))
    assert t.velocity[-1, 0] == pytest.approx([speed, 0.0, 0.0], abs=1e-11)
    assert max(errors(t)) < 1e-12


def test_a_ball_thrown_across_a_slope_is_resisted_along_its_path_to_second_order():
    """(m + I/R²) v̇ = m g sin α - μ_r m g cos α v/|v|: opposite to the last ω it was of order 1."""
    angle, resistance, t_end, off = 0.2, 0.1, 0.48, []

    def rates(_, v):
        along = resistance * math.cos(angle) * v / np.hypot(*v)
        return 5.0 / 7.0 * G * (np.array([math.sin(angle), 0.0]) - along)

    v = solve_ivp(rates, (0.0, t_end), [0.0, 1.0], rtol=1e-11, atol=1e-12).y[:, -1]
    ball = sphere(position=[0, 0, R], velocity=[0, 1.0, 0], angular_velocity=[-1.0 / R, 0, 0])
    for h in (8e-3, 4e-3):
        t = go(ball, contact=exact(0.0, 1.0, rolling_friction=resistance), wall=[plane()],
               gravity=tilted(angle), dt=h, t_end=t_end, every=t_end)  # fmt: skip
        off.append(np.abs(t.velocity[-1, 0, :2] - v).max())
        assert errors(t)[0] < 1e-13
    assert off[0] < 4e-5
    assert off[1] < off[0] / 3.5


def test_a_ball_that_spins_in_place_stops_at_the_known_time():
    ball = sphere(position=[0, 0, R], angular_velocity=[3.0, -4.0, 2.0])
    t = go(ball, contact=exact(0.0, 0.0, rolling_friction=0.2), wall=[plane()], gravity=DOWN,
           dt=5e-3, t_end=0.2, every=0.01, output={"fields": FIELDS})  # fmt: skip
    slower = 0.2 * R * 2.0 * G / I
    spin = np.maximum(5.0 - slower * t.time, 0.0)
    assert np.abs(t.angular_velocity[:, 0, :2] - np.outer(spin, [0.6, -0.8])).max() < 1e-12
    assert np.abs(t.angular_velocity[:, 0, 2] - 2.0).max() < 1e-14  # about the normal it spins on
    assert spin[5] > 0.0 == spin[-1]
    torque = 0.2 * R * 2.0 * G
    assert t.wall_torque[5, 0] == pytest.approx([0.6 * torque, -0.8 * torque, 0.0], abs=1e-12)
    assert max(errors(t)) < 1e-13


def test_two_balls_resist_by_their_common_radius():
    """Pressed in free space: the torque μ_r R* F on both, R* = R₁R₂/(R₁ + R₂)."""
    one = sphere("one", position=[0, 0, 0], angular_velocity=[0, 5.0, 0])
    two = sphere("two", radius=0.3, position=[0.4, 0, 0], angular_velocity=[0, -1.0, 0])
    force = [{"type": "push", "body": name, "force": [f, 0, 0]}
             for name, f in (("one", 20.0), ("two", -20.0))]  # fmt: skip
    t = go(one, two, contact=exact(0.0, 0.0, rolling_friction=0.2), force=force, dt=5e-3,
           t_end=0.1, every=0.1)  # fmt: skip
    torque, inertia = 0.2 * 0.075 * 20.0, np.array([I, 9.0 * I])
    omega = np.array([5.0, -1.0]) + np.array([-1.0, 1.0]) * torque * 0.1 / inertia
    assert t.angular_velocity[-1, :, 1] == pytest.approx(omega, abs=1e-12)
    assert max(errors(t)[1:]) < 1e-13


def test_an_impact_resists_by_its_own_impulse():
    ball = sphere(position=[0, 0, R], velocity=[0, 0, -2.0], angular_velocity=[0, 30.0, 0])
    t = go(ball, contact=impulse(0.5, 0.0, rolling_friction=0.1), wall=[plane()], dt=5e-3,
           t_end=0.1, every=0.05)  # fmt: skip
    left = 30.0 - 0.1 * R * 2.0 * 1.5 * 2.0 / I
    assert t.angular_velocity[-1, 0] == pytest.approx([0.0, left, 0.0], abs=1e-12)
    assert t.velocity[-1, 0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-14)
    assert max(errors(t)) < 1e-13


@pytest.mark.parametrize(
    ("limit", "torsion"), [(0.02, 0.0), (10.0, 0.0), (0.02, 0.05), (10.0, 10.0)]
)
def test_an_impact_of_unequal_moments_resists_as_the_law_asks(limit, torsion):
    """Where m is at its bound the turning that is left is opposite to it; else nothing is left."""
    W = np.array([[20.0, 2.0, 1.5], [2.0, 3.0, 0.5], [1.5, 0.5, 10.0]])
    partners, rows = room_for_partners(2), room_for_rows(1, with_rolling=True)
    partners.inverse[0] = [1.0, *W[np.triu_indices(3)]]
    partners.velocity[0, 3:] = 3.0, -4.0, 1.0
    rows.partner_b[0] = 1
    write_frame(partners, rows, 0, (0.0, 0.0, 1.0), (0.0, 0.0, -R))
    rows.rolling.limit[0, [ACROSS, ABOUT]] = limit, torsion
    write_rolling(partners, rows, 1, 0.0)
    before = partners.velocity[0, 3:].copy()
    bounce_rolling(partners, rows, 0, 1.5)
    assert partners.velocity[0, 3:] == pytest.approx(
        before + W @ partners.impulse[0, 3:], abs=1e-12
    )
    m, left = partners.impulse[0, 3:5], partners.velocity[0, 3:5]
    about, spin = partners.impulse[0, 5], partners.velocity[0, 5]
    assert abs(about) <= 1.5 * torsion * (1.0 + 1e-14)
    assert spin == pytest.approx(0.0, abs=1e-12) or about == -math.copysign(1.5 * torsion, spin)
    if limit == 10.0:
        assert np.abs(left).max() < (1e-10 if torsion else 1e-12)  # each step leaves 0.89
    else:
        assert math.hypot(*m) == pytest.approx(1.5 * limit, rel=1e-14)
        assert m @ left == pytest.approx(-math.hypot(*m) * math.hypot(*left), rel=1e-13)


@pytest.mark.parametrize("restitution", [0.0, 0.8])
def test_clumps_that_meet_keep_their_momenta_and_gain_no_energy(restitution):
    rng = np.random.default_rng(5)
    bodies = [
        clump(f"c{i}", position=x.tolist(), velocity=(-1.5 * x).tolist(),
              angular_velocity=rng.uniform(-3.0, 3.0, 3).tolist(), orientation=q.tolist())
        for i, (x, q) in enumerate(zip(
            0.75 * np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]),
            rng.normal(size=(8, 4)), strict=True))
    ]  # fmt: skip
    contact = impulse(restitution, 0.5, rolling_friction=0.5, torsional_friction=0.4,
                      tolerance=1e-8, iterations=300, push_out=0.0)  # fmt: skip
    t = go(*bodies, contact=contact, dt=4e-3, t_end=0.8, every=4e-3)
    P, L = t.observable("linear_momentum"), t.observable("angular_momentum")
    assert np.abs(P - P[0]).max() < 1e-13
    assert np.abs(L - L[0]).max() < 1e-13
    assert (np.diff(t.energy) <= 1e-13 * t.energy[0]).all()
    assert t.energy[-1] < 0.9 * t.energy[0]
    assert errors(t)[0] < 1e-12


def test_a_wheel_on_an_arm_is_resisted_by_what_it_carries():
    """The arm of 1 kg rests on a hinge at one end, and on the wheel at the other."""
    arm = clump("arm", position=[-0.25, 0, R], contact=False)
    wheel = sphere("wheel", position=[0, 0, R], angular_velocity=[0, 40.0, 0])
    hinge = {"type": "hinge", "axis": [0, 1, 0]}
    joints = [hinge | {"body": "arm", "at": [-0.5, 0, R]},
              hinge | {"body": "wheel", "to": "arm", "at": [0, 0, R]}]  # fmt: skip
    t = go(arm, wheel, contact=exact(0.0, 0.0, rolling_friction=0.2), joint=joints,
           wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.2, every=0.05)  # fmt: skip
    slower = 0.2 * R * (2.0 + 0.5) * G / I
    assert np.abs(t.angular_velocity[:, 1, 1] - 40.0 + slower * t.time).max() < 1e-9
    assert errors(t)[0] < 1e-11


def test_what_a_driven_body_does_by_turning_is_counted():
    wheel = sphere("wheel", radius=0.3, position=[0, 0, 0])
    wheel["motion"] = {"angular_velocity": [0, 2.0, 0]}
    ball = sphere(position=[0, 0, 0.4])
    t = go(wheel, ball, contact=exact(0.0, 0.3, rolling_friction=0.3), gravity=DOWN, dt=5e-3,
           t_end=0.1, every=0.05)  # fmt: skip
    assert t.angular_velocity[-1, 1, 1] != 0.0
    assert max(errors(t)) < 1e-12


def test_a_run_that_is_resumed_has_the_same_bits_and_does_not_see_its_frames(tmp_path):
    """One sweep a step needs the torques of before."""
    boxes = [clump(f"b{i}", position=[0, 0, 2 * R + 4 * R * i]) for i in range(3)]
    contact = impulse(0.2, 0.5, rolling_friction=0.3, torsional_friction=0.3, iterations=1,
                      solver="sweeps")  # fmt: skip
    keys = {"contact": contact, "wall": [plane()], "gravity": tilted(0.2), "dt": 5e-3}
    scene, names = case(*boxes, t_end=0.2, every=0.02, **keys), ("angular_momentum", "energy_error")
    whole = assert_goes_on_alike(scene, 0.1, tmp_path / "part.h5", names)
    often = particlerb.run(case(*boxes, t_end=0.2, every=4e-3, **keys))
    assert (often.angular_momentum[::5] == whole.angular_momentum).all()


def test_newtons_method_solves_balls_that_rolling_friction_holds_in_a_tower():
    """On a slope: each carries a moment of those above it. After one sweep, and with no more."""
    balls = [sphere(f"b{i}", position=[0, 0, R + 2 * R * i]) for i in range(4)]
    contact = impulse(0.0, 0.8, rolling_friction=0.9, tolerance=1e-11, iterations=1)
    t = go(*balls, contact=contact, wall=[plane()], gravity=tilted(0.02), dt=5e-3, t_end=0.2,
           every=0.05)  # fmt: skip
    assert t.observable("impulse_residual").max() <= 1e-11
    assert np.abs(t.position[-1] - t.position[0]).max() < 1e-11


def test_newtons_method_follows_discs_that_grow_with_the_pressing_impulse(monkeypatch):
    """Wedged bodies that roll on each other; one sweep, Newton's method once."""
    monkeypatch.setattr("particlerb.impulses.solver._NEWTON_ROUNDS", 1)
    keys = {"rolling_friction": 0.1, "iterations": 1, "solver": "newton"}
    t = wedged(0, ["pair"] * 3, 1.0, 0.35, 0.2, **keys)
    assert 0.0 < t.observable("impulse_residual").max() <= 1e-10


# Spinning about the normal


def test_a_ball_that_spins_about_the_normal_stops_at_the_known_time():
    """At ω₀ I / (μ_t R m g) = 0.163 s, between frames; it rolls on, as nothing resists that."""
    ball = sphere(position=[0, 0, R], angular_velocity=[0, 0, 4.0])
    t = go(ball, contact=exact(0.0, 0.0, torsional_friction=0.1), wall=[plane()], gravity=DOWN,
           dt=5e-3, t_end=0.2, every=0.01, output={"fields": FIELDS})  # fmt: skip
    torque = 0.1 * R * 2.0 * G
    spin = np.maximum(4.0 - torque / I * t.time, 0.0)
    assert np.abs(t.angular_velocity[:, 0] - np.outer(spin, [0, 0, 1.0])).max() < 1e-12
    assert spin[-5] > 0.0 == spin[-3]
    assert t.wall_torque[5, 0] == pytest.approx([0.0, 0.0, torque], abs=1e-12)
    assert max(errors(t)) < 1e-13


def test_a_disc_of_four_balls_spins_down_by_torsion_and_friction_together():
    """(I about z) ω̇ = -(μ d + μ_t R) m g, for balls at a distance d of the axis."""
    d = 0.3
    corners = [[d, 0, 0], [-d, 0, 0], [0, d, 0], [0, -d, 0]]
    shape = {"type": "points", "mass": 0.25, "radius": R, "position": corners}
    disc = {"name": "disc", "shape": shape, "position": [0, 0, R], "angular_velocity": [0, 0, 6.0]}
    t = go(disc, contact=exact(0.0, 0.2, torsional_friction=0.5), wall=[plane()], gravity=DOWN,
           dt=0.01, t_end=0.6, every=0.1)  # fmt: skip
    slower = (0.2 * d + 0.5 * R) * G / (d * d + 0.4 * R * R)
    spin = np.maximum(6.0 - slower * t.time, 0.0)
    assert np.abs(t.angular_velocity[:, 0, 2] - spin).max() < 1e-12
    assert spin[4] > 0.0 == spin[-1]
    assert max(errors(t)) < 1e-12


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("solver", ["sweeps", "newton"])
def test_a_ball_turns_from_the_limit_of_torque_on(share, solver):
    limit = 0.2 * R * 2.0 * G
    twist = {"type": "torque", "body": "ball", "torque": [0, 0, share * limit], "frame": "world"}
    contact = exact(0.0, 0.5, torsional_friction=0.2, rolling_friction=0.1, solver=solver)
    t = go(sphere(position=[0, 0, R]), contact=contact, wall=[plane()], gravity=DOWN,
           force=[twist], dt=5e-3, t_end=0.2, every=0.1)  # fmt: skip
    spin = max(share - 1.0, 0.0) * limit / I * t.time
    assert np.abs(t.angular_velocity[:, 0, 2] - spin).max() < 1e-12
    assert max(errors(t)) < 1e-12
