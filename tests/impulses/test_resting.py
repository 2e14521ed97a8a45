"""Resting, sliding and rolling: closed forms, thresholds of friction, walls of all kinds."""

import math

import numpy as np
import pytest
from impulse_scenes import DOWN, G, R, clump, errors, exact, go, impulse, plane, sphere, tilted

plain = pytest.mark.plain


def test_a_ball_that_slides_comes_to_roll_with_five_sevenths_of_its_speed():
    misses = []
    for dt in (0.02, 0.005):
        t = go(sphere(position=[0, 0, R], velocity=[1.0, 0, 0]), contact=exact(0.0, 0.2),
               wall=[plane()], gravity=DOWN, dt=dt, t_end=1.0, every=0.5)  # fmt: skip
        assert t.velocity[-1, 0, 0] == pytest.approx(5.0 / 7.0, abs=1e-13)
        assert t.angular_velocity[-1, 0, 1] == pytest.approx(5.0 / 7.0 / R, abs=1e-12)
        rolls = 2.0 / 7.0 / (0.2 * G)
        way = rolls * 6.0 / 7.0 + (1.0 - rolls) * 5.0 / 7.0
        misses.append(abs(t.position[-1, 0, 0] - way))
        assert max(errors(t)) < 1e-13
    assert misses[1] < 0.1 * misses[0] < 1e-5


@plain
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_a_box_slides_from_the_angle_of_friction_on_and_is_not_lifted(share):
    angle = math.atan(0.3 * share)
    t = go(clump("box", position=[0, 0, 2 * R]), contact=exact(0.0, 0.3), wall=[plane()],
           gravity=tilted(angle, 0.4), dt=5e-3, t_end=1.0, every=0.25)  # fmt: skip
    speed = max(0.0, G * (math.sin(angle) - 0.3 * math.cos(angle)))
    v = t.velocity[-1, 0]
    assert v == pytest.approx([speed * math.cos(0.4), speed * math.sin(0.4), 0.0], abs=1e-12)
    assert np.abs(t.position[:, 0, 2] - 2 * R).max() < 1e-12
    assert max(errors(t)) < 1e-12


@plain
def test_a_box_that_slides_obliquely_slows_down_along_its_way_and_is_not_lifted():
    way, mu = np.array([math.cos(0.7), math.sin(0.7), 0.0]), 0.3
    box = clump("box", position=[0, 0, 2 * R], velocity=way.tolist())
    t = go(box, contact=exact(0.0, mu), wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.3,
           every=0.1)  # fmt: skip
    v = t.velocity[:, 0]
    assert np.abs(v - np.outer(1.0 - mu * G * t.time, way)).max() < 1e-13
    assert np.abs(np.cross(v, way)).max() < 1e-14
    assert np.abs(t.angular_velocity).max() < 1e-12
    assert np.abs(t.position[:, 0, 2] - 2 * R).max() < 1e-13
    assert max(errors(t)) < 1e-13


@pytest.mark.parametrize("share", [0.99, 1.01])
@pytest.mark.parametrize("degrees", [10.0, 30.0, 40.0])
def test_a_ball_rolls_down_a_slope_up_to_its_critical_friction(share, degrees):
    angle = math.radians(degrees)
    mu = 2.0 / 7.0 * math.tan(angle) * share
    t = go(sphere(position=[0, 0, R]), contact=exact(0.0, mu), wall=[plane()],
           gravity=tilted(angle), dt=5e-3, t_end=0.5, every=0.5)  # fmt: skip
    pull = 5.0 / 7.0 * math.sin(angle)
    if share < 1.0:
        pull = math.sin(angle) - mu * math.cos(angle)
    slip = t.velocity[-1, 0, 0] - R * t.angular_velocity[-1, 0, 1]
    assert t.velocity[-1, 0, 0] == pytest.approx(0.5 * G * pull, abs=1e-12)
    assert (abs(slip) < 1e-12) == (share > 1.0)


def pyramid(pair, floor):
    critical, r = math.tan(0.5 * math.asin(3**-0.5)), 2 * R / 3**0.5
    balls = [
        sphere(f"b{k}", position=[r * math.cos(a), r * math.sin(a), R], material="ball")
        for k, a in enumerate(2 * math.pi / 3 * np.arange(3))
    ]
    top = R + math.sqrt(4 * R * R - r * r)
    contact = exact(0.0, pair * critical, iterations=400, tolerance=1e-9)
    contact["pair"] = [{"materials": ["ball", "floor"], "friction": floor * critical / 4}]
    contact["overlap"] = 1e-12
    balls.append(sphere("top", position=[0, 0, top], material="ball"))
    keys = {"material": [{"name": "ball"}, {"name": "floor"}], "gravity": DOWN}
    t = go(*balls, contact=contact, wall=[plane(material="floor")], dt=5e-3, t_end=1.0,
           every=0.5, **keys)  # fmt: skip
    return top - t.position[-1, 3, 2]


@pytest.mark.compiled
@pytest.mark.parametrize(("pair", "floor"), [(1.01, 2), (0.99, 2), (2, 1.01), (2, 0.99)])
def test_a_pyramid_of_balls_falls_below_its_critical_frictions(pair, floor):
    sinks = pyramid(pair, floor)
    if min(pair, floor) > 1.0:
        assert abs(sinks) < 1e-9
    else:
        assert sinks > 1e-3


@plain
def test_a_ball_rolls_over_seams_of_a_box_as_on_a_plane():
    ball = sphere(position=[0.1, 0.2, R], velocity=[1.0, 0.4, 0.0])
    keys = {"contact": exact(0.0, 0.3), "gravity": DOWN, "dt": 5e-3, "t_end": 0.5, "every": 0.5}
    box = {"type": "box", "name": "bin", "lower": [-2, -2, 0], "upper": [2, 2, 2]}
    smooth, seamed = go(ball, wall=[plane()], **keys), go(ball, wall=[box], **keys)
    assert seamed.position[-1] == pytest.approx(smooth.position[-1], abs=1e-13)
    assert seamed.velocity[-1] == pytest.approx(smooth.velocity[-1], abs=1e-13)


@plain
def test_a_ball_in_a_corner_presses_on_all_three_faces():
    box = {"type": "box", "name": "bin", "lower": [0, 0, 0], "upper": [2, 2, 2]}
    g = [-3.0, -2.0, -G]
    output = {"fields": ["position", "contacts", "wall_force"]}
    t = go(sphere(position=[R, R, R]), contact=exact(0.0, 0.0), wall=[box], dt=5e-3, t_end=0.2,
           every=0.1, gravity={"acceleration": g}, output=output)  # fmt: skip
    assert t.position[-1, 0] == pytest.approx([R, R, R], abs=1e-12)
    assert t.contacts(2).wall.size == 3
    assert t.wall_force[-1, 0] == pytest.approx(2.0 * np.array(g), rel=1e-9)


@plain
def test_a_conveyor_takes_a_box_along_and_its_work_is_counted():
    belt = plane(motion={"velocity": [0.5, 0.0, 0.0]})
    t = go(clump("box", position=[0, 0, 2 * R]), contact=exact(0.0, 0.3), wall=[belt],
           gravity=DOWN, dt=5e-3, t_end=0.4, every=0.1)  # fmt: skip
    assert t.velocity[-1, 0] == pytest.approx([0.5, 0.0, 0.0], abs=1e-12)
    assert t.energy[-1] - t.energy[0] == pytest.approx(0.5 * 0.25, abs=1e-12)
    assert max(errors(t)) < 1e-12


@plain
def test_a_wall_that_comes_fast_meets_a_body_at_rest_before_it_is_in_it():
    piston = plane(motion={"velocity": [0.0, 0.0, 2.0]}, point=[0.0, 0.0, -0.047])
    t = go(sphere(position=[0, 0, R]), contact=exact(0.0, 0.3), wall=[piston], dt=5e-3, t_end=0.1,
           every=0.05)  # fmt: skip
    assert t.observable("impulse_overlap") == pytest.approx(0.0, abs=1e-12)
    assert t.velocity[-1, 0, 2] == pytest.approx(2.0, abs=1e-12)


@plain
def test_a_table_that_swings_lifts_a_ball_with_all_that_it_gives_counted():
    swing = {"oscillation": {"amplitude": [0.0, 0.0, 0.02], "frequency": 2.0}}
    t = go(sphere(position=[0, 0, R]), contact=exact(0.0, 0.3), wall=[plane(motion=swing)],
           gravity=DOWN, dt=2e-3, t_end=0.5, every=0.05)  # fmt: skip
    gap = t.position[:, 0, 2] - R - 0.02 * np.sin(4 * math.pi * t.time)
    assert np.abs(gap).max() < 3e-4
    assert errors(t)[0] < 1e-11


@plain
def test_a_driven_body_and_a_held_one_carry_and_stop_others():
    drive = sphere("lift", position=[0, 0, 0], motion={"velocity": [0, 0, 0.3]})
    held = sphere("stop", position=[0, 0, 4.5 * R], fixed=True)
    ball = sphere("ball", position=[0, 0, 2 * R])
    t = go(drive, held, ball, contact=exact(0.0, 0.5), gravity=DOWN, dt=2e-3, t_end=0.15,
           every=0.05, output={"fields": ["position", "velocity", "linear_momentum",
                                          "angular_momentum", "orientation"]})  # fmt: skip
    assert t.velocity[1, 2, 2] == pytest.approx(0.3, abs=1e-12)
    assert t.position[-1, 1] == pytest.approx([0, 0, 4.5 * R], abs=0)
    assert errors(t)[0] < 1e-10


def test_friction_of_all_contacts_stays_within_the_cone_and_none_pulls():
    bodies = [clump(f"c{i}", position=[0.13 * i, 0.05 * (i % 2), 0.4 + 0.6 * i],
                    orientation=[1.0, 0.2 * i, 0.1, -0.3]) for i in range(3)]  # fmt: skip
    output = {"fields": ["position", "contacts"]}
    t = go(*bodies, contact=impulse(0.0, 0.4), wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.6,
           every=0.05, output=output)  # fmt: skip
    seen = 0
    for frame in range(t.time.size):
        force = t.contacts(frame).force
        point = t.contacts(frame).point
        on_floor = t.contacts(frame).wall == 0
        normal, along = force[on_floor, 2], np.hypot(*force[on_floor, :2].T)
        assert (normal >= 0.0).all()
        assert (along <= 0.4 * normal * (1.0 + 1e-12)).all()
        assert (np.abs(point[on_floor, 2]) < 0.01).all()
        seen += on_floor.sum()
    assert seen > 15


def test_a_stack_stands_and_keeps_its_energy():
    boxes = [clump(f"b{i}", position=[0, 0, 2 * R + 4 * R * i]) for i in range(4)]
    contact = impulse(0.0, 0.5, tolerance=1e-6, iterations=200)
    t = go(*boxes, contact=contact, wall=[plane()], gravity=DOWN, dt=5e-3, t_end=0.5, every=0.1)
    moved = t.position[-1] - t.position[0]
    assert np.abs(moved).max() < 1e-7
    assert errors(t)[0] < 1e-12


def pushed(restitution, dt, *more):
    """Largest error of the balance [J] of a ball that is pushed down and along, and turned."""
    ball = sphere(position=[0, 0, R], velocity=[0.5, 0.2, -1.0 if restitution else 0.0])
    force = [{"type": "push", "body": "ball", "force": [6.0, 2.0, -20.0]},
             {"type": "torque", "body": "ball", "torque": [0.1, 0.3, 0.2]}, *more]  # fmt: skip
    t = go(ball, contact=exact(restitution, 0.1), wall=[plane()], gravity=DOWN, force=force, dt=dt,
           t_end=0.4, every=0.1)  # fmt: skip
    assert errors(t)[1] < 1e-13
    return errors(t)[0]


@plain
@pytest.mark.parametrize("restitution", [0.0, 0.6])
def test_what_presses_a_ball_onto_a_floor_does_no_work_by_that(restitution):
    """It flies between bounces, and nothing is solved then."""
    assert pushed(restitution, 5e-3) < 1e-13


@plain
def test_the_balance_of_what_drags_along_a_floor_is_of_order_two():
    drag = {"type": "drag", "body": "ball", "translation": 0.5, "rotation": 0.005}
    coarse, fine = pushed(0.0, 0.02, drag), pushed(0.0, 0.01, drag)
    assert fine < 0.27 * coarse < 1e-3
