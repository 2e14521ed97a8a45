"""Joints and contact in one solve: momenta, closed forms, Coulomb's law, bits, what is refused."""

from pathlib import Path
from types import SimpleNamespace

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
    go,
    impulse,
    plane,
    sphere,
)

import particlerb
from particlerb.compiled.barrier import ONE_THREAD
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.records import (
    FRICTION,
    NEWTON_STEPS,
    RESIDUAL,
    TALLY,
    ImpulseRules,
    Impulses,
    room_for_partners,
    room_for_rows,
)
from particlerb.impulses.rows import write_frame
from particlerb.impulses.solver import solve
from particlerb.joints.records import HOLDS, ConstraintRows, joint_data_at
from particlerb.joints.responses import find_bounded, find_responses, mechanisms_of, pairs_through
from particlerb.joints.setup import NO_ACTIONS, joints_among
from particlerb.model.state import State

CASES = Path(__file__).parents[2] / "cases"
plain = pytest.mark.plain

AXES = {"hinge": {"axis": [0, 1.0, 0.2]}, "universal": {"axis": [0, 0, 1.0], "axis_to": [0, 1, 0]},
        "slider": {"axis": [0, 1.0, 0]}, "cylindrical": {"axis": [0, 1.0, 0]},
        "planar": {"axis": [0, 0, 1.0]}, "distance": {"at_to": [-2 * R, 0, 0]},
        "fixed": {"merge": False}}  # fmt: skip


def tied(kind, *, to="left", at=(0.0, 0.0, 0.0), body="right", **keys):
    """Joint between two bodies, or one and the world."""
    table = {"type": kind, "body": body, "at": list(at)} | ({"to": to} if to else {})
    return table | AXES.get(kind, {}) | keys


def struck(kind, **contact):
    """Two boxes that a joint ties, and a ball that flies onto them; no other body is near."""
    left, right = (clump(name, position=[x, 0, 0]) for name, x in (("left", -0.3), ("right", 0.3)))
    ball = sphere(position=[0.45, 0.9, 0.31], velocity=[-0.4, -4.0, -1.2])
    return case(left, right, ball, joint=[tied(kind)], t_end=0.4, every=0.02, dt=5e-3,
                contact=impulse(0.4, 0.5, tolerance=1e-12, iterations=500) | contact)  # fmt: skip


@plain
@pytest.mark.parametrize("kind", ["ball", *AXES])
def test_momenta_are_kept_and_joints_hold_through_a_blow(kind):
    t = particlerb.run(struck(kind, push_out=0.0))
    loads = particlerb.joint_loads(t)
    P, L = (t.observable(f"{name}_momentum") for name in ("linear", "angular"))
    assert np.abs(np.diff(np.array(t.linear_momentum)[:, 2], axis=0)).max() > 1.0
    assert np.abs(P - P[0]).max() < 1e-13 * np.abs(P[0]).max()
    assert np.abs(L - L[0]).max() < 1e-13 * np.abs(L[0]).max()
    assert loads.misfit.max() < 1e-13
    assert loads.rate.max() < 1e-12
    assert errors(t)[0] < 1e-3 * t.energy[0]
    assert (np.diff(t.energy) < 1e-3 * t.energy[0]).all()
    assert t.energy[-1] < 0.98 * t.energy[0]


def door(restitution, dt, t_end, friction=0.0):
    """A bar of five balls on a hinge at the origin, which falls onto a floor."""
    place = [[0.25 * k - 0.5, 0.0, 0.02 * k - 0.04] for k in range(5)]
    shape = {"type": "points", "mass": 0.2, "radius": 0.05, "position": place}
    hinge = {"type": "hinge", "body": "bar", "at": [0, 0, 0], "axis": [0, 1, 0]}
    bar = {"name": "bar", "shape": shape, "position": [0.5, 0.0, 0.04]}
    keys = {"joint": [hinge], "wall": [plane(point=[0, 0, -0.4])], "gravity": DOWN}
    contact = impulse(restitution, friction, tolerance=1e-9)
    return case(bar, dt=dt, t_end=t_end, every=dt, contact=contact, **keys)


@plain
def test_an_elastic_door_keeps_its_energy_to_order_two():
    found = []
    for dt in (8e-3, 4e-3):
        t = particlerb.run(door(1.0, dt, 0.6))
        found.append(np.abs(t.energy - t.energy[0]).max())
        assert t.linear_momentum[:, 0, 2].max() > 0.1
    assert found[0] / found[1] == pytest.approx(4.0, rel=0.15)


@plain
def test_a_door_that_lies_on_its_stop_lies_there():
    t = particlerb.run(door(0.0, 8e-3, 0.8, friction=0.5))
    late = np.array(t.position)[t.time > 0.6]
    assert np.abs(late - late[-1]).max() < 1e-6
    assert late[-1, 0, 2] < -0.1
    assert np.abs(particlerb.joint_loads(t).misfit).max() < 1e-13


@plain
@pytest.mark.parametrize("e", [0.6, 1.0])
def test_a_ball_that_hits_a_bar_on_a_hinge_feels_its_inertia_about_the_hinge(e):
    """J = (1 + e) v / (1/m + d²/I): the impulse at a distance d from the axis."""
    d, v = 1.0, 2.0
    scene = door(e, 5e-3, 0.2)
    bar, ball = scene["body"][0], sphere(position=[d, 0.3, 0.08], velocity=[0, -v, 0])
    scene = {k: scene[k] for k in ("run", "contact", "joint")} | {"body": [bar, ball]}
    scene["joint"][0]["axis"] = [0, 0, 1.0]
    t = particlerb.run(scene)
    place = np.array([[0.25 * k, 0.02 * k] for k in range(5)])
    inertia = 0.2 * (place[:, 0] ** 2).sum() + 5 * 0.4 * 0.2 * 0.05**2
    J = (1 + e) * v / (1 / 2.0 + d * d / inertia)
    assert t.velocity[-1, 1, 1] == pytest.approx(J / 2.0 - v, abs=1e-12)
    first = np.flatnonzero(np.abs(t.velocity[:, 0, 1]) > 0.1)[0]
    assert t.omega_body(0)[first] @ t.omega_body(0)[first] == pytest.approx((J * d / inertia) ** 2)


@plain
def test_dampers_leave_the_order_two():
    bodies = sphere("upper", position=[0.5, 0, 0]), sphere("lower", position=[1.0, 0, 0.1])
    hinges = [
        tied("hinge", to=None, body="upper", axis=[0, 1, 0], damper=2.0),
        tied("hinge", to="upper", body="lower", at=[0.7, 0, 0], axis=[0, 1, 0], damper=0.5),
    ]
    keys = {"gravity": DOWN, "wall": [plane(point=[0, 0, -9.0])], "t_end": 0.096, "every": 0.096}
    runs = [case(*bodies, joint=hinges, contact=impulse(), dt=h, **keys)
            for h in (0.016, 0.008, 0.004)]  # fmt: skip
    ends = [(t.position[-1].ravel(), errors(t)[0]) for t in map(particlerb.run, runs)]
    far, near = (np.abs(ends[k][0] - ends[k + 1][0]).max() for k in (0, 1))
    assert far / near == pytest.approx(4.0, rel=0.05)
    assert ends[0][1] / ends[2][1] == pytest.approx(16.0, rel=0.1)


@plain
def test_the_balance_of_what_is_turned_holds_where_nothing_is_near():
    """A floor is there, and no step has a contact: order 2, as without it."""
    near, far = clump("near", position=[0.3, 0, 1.0]), clump("far", position=[0.9, 0, 1.0])
    far |= {"velocity": [0, 0, 1.2], "angular_velocity": [0, -4.0, 0]}
    hinge = tied("hinge", to="near", body="far", at=[0.6, 0, 1.0], axis=[0, 1, 0], damper=0.05)
    turn = {"type": "torque", "body": "far", "torque": [0, 0.2, 0.1]}
    coarse, fine = (
        errors(go(near, far, contact=impulse(), wall=[plane()], gravity=DOWN, joint=[hinge], dt=dt,
                  force=[turn], t_end=0.3, every=0.1))[0]
        for dt in (0.02, 0.01)
    )  # fmt: skip
    assert fine < 0.27 * coarse < 1e-3


def gripper(force, t_end, **keys):
    """A brick between two plates on sliders that motors press together."""
    left, right = (clump(name, position=[x, 0, 0]) for name, x in (("left", -0.4), ("right", 0.4)))
    press = [tied("slider", to=None, body=name, at=[x, 0, 0], axis=[n, 0, 0], motor=force)
             for name, x, n in (("left", -0.4, 1.0), ("right", 0.4, -1.0))]  # fmt: skip
    return case(left, right, clump("brick"), joint=press, gravity=DOWN, dt=5e-3, t_end=t_end,
                every=0.02, contact=impulse(0.0, 0.5, tolerance=1e-9) | keys)  # fmt: skip


@plain
def test_a_gripper_holds_a_brick_if_twice_friction_times_force_carries_it():
    """Twice μ F against m g; m = 1 kg and μ = 1/2, so F = g is the limit."""
    held, lost = (particlerb.run(gripper(share * G, 0.05)) for share in (1.01, 0.99))
    assert np.abs(held.position - held.position[0]).max() < 1e-9
    assert held.observable("impulse_residual").max() <= 1e-9
    assert errors(held)[0] < 1e-9  # what presses and does not move does no work
    assert lost.velocity[-1, 2, 2] < -0.01 * G * 0.05


@plain
def test_what_is_pushed_out_goes_back_to_its_joints():
    boxes = [clump("left", position=[-0.3, 0, 0.3], orientation=[1.0, 0.2, 0.1, 0.0]),
             clump("right", position=[0.3, 0, 0.3])]  # fmt: skip
    keys = {"joint": [tied("ball", at=[0, 0, 0.3])], "gravity": DOWN, "wall": [plane()]}
    t = particlerb.run(case(*boxes, t_end=0.4, every=0.02, dt=5e-3, contact=impulse(0.3), **keys))
    assert t.observable("push_out_work")[-1] > 1e-3
    assert particlerb.joint_loads(t).misfit.max() < 1e-13
    assert errors(t)[1] < 1e-12
    assert errors(t)[2] < 1e-12


@plain
@pytest.mark.parametrize("e", [0.0, 0.6])
def test_a_cart_with_a_pendulum_hits_a_wall(e):
    """By hand, in the place of the cart and the angle; the hinge bears its part of the shock.

    It bore it where bodies are that have been pushed out, and 1e-3 of the energy came from nowhere.
    """
    cart_mass, mass, length, angle, speed, rate = 1.5, 0.7, 0.4, -0.9, 2.0, 3.0
    out, up = length * np.sin(angle), length * np.cos(angle)
    M = np.array([[cart_mass + mass, mass * up], [mass * up, mass * (length**2 + 0.4 * R**2)]])
    by = np.linalg.inv(M)[0]
    after = np.array([speed, rate]) - (1.0 + e) * speed / by[0] * by
    bob = {"velocity": [speed + rate * up, 0, rate * out], "angular_velocity": [0, -rate, 0]}
    bob |= {"mass": mass, "position": [out - R, 0, -up], "contact": False}
    cart = sphere("cart", mass=cart_mass, position=[-R, 0, 0], velocity=[speed, 0, 0])
    joints = [tied("slider", to=None, body="cart", axis=[1, 0, 0]),
              tied("hinge", to="cart", body="bob", at=[-R, 0, 0], axis=[0, 1, 0])]  # fmt: skip
    off, balance = [], []
    for h in (1e-3, 2.5e-4):
        t = go(cart, sphere("bob") | bob, joint=joints, contact=impulse(e, 0.0, tolerance=1e-12),
               wall=[plane([-1, 0, 0])], dt=h, t_end=h, every=h)  # fmt: skip
        found = t.velocity[-1, 0, 0], -t.angular_velocity[-1, 1, 1]
        off.append(np.abs(found - after).max())
        balance.append(errors(t)[0])
    assert off[0] < 0.5 * after[1] ** 2 * 1e-3  # it turns while the step goes on
    assert off[1] < 0.3 * off[0]
    assert balance[0] < 1e-7 * t.energy[0]
    assert balance[1] < balance[0] / 13.0


@plain
def test_a_mechanism_that_touches_goes_on_bit_for_bit(tmp_path):
    assert_goes_on_alike(struck("hinge"), 0.2, tmp_path / "part.h5")


@plain
def test_contacts_couple_all_that_joints_tie_to_their_bodies():
    """Bodies 0, 1 and 2, 3 are mechanisms, 4 is alone: Newton's method has room for all."""
    first, member = np.array([0, 2, 4]), np.arange(4)
    mechanisms = SimpleNamespace(number=np.array([0, 0, 1, 1, -1]), first=first, member=member)
    a, b = pairs_through(mechanisms, np.array([1, 3]), np.array([2, 4]))
    among = {(0, 1), (2, 3), (0, 2), (0, 3), (1, 2), (1, 3), (2, 4), (3, 4)}
    assert set(zip(a.tolist(), b.tolist(), strict=True)) == among


@plain
def test_a_mechanism_moves_as_dense_matrices_say_and_newton_solves_its_contacts():
    """Two unit masses on a ball joint, one contact of each with a wall."""
    bodies = SimpleNamespace(mass=np.ones(2), inv_mass=np.ones(2), inv_inertia=np.ones((3, 2)))
    ends, a, b = np.tile([0.5, 0, 0], (3, 1)), np.zeros(3, np.int64), np.ones(3, np.int64)
    none = np.full(3, HOLDS)
    rows = ConstraintRows(b, a, b, ends, -ends, np.eye(3), np.ones(3), np.ones(3), none, none,
                          np.zeros((3, 12)))  # fmt: skip
    joints = joints_among(a[:1], np.array([0, 3]), rows, bodies, NO_ACTIONS)
    places, still = np.array([[0.0, 1.0], [0, 0], [0, 0]]), np.zeros((3, 2))
    state = State(places, np.repeat(np.eye(4)[:, :1], 2, axis=1), still, still)
    data, mechanisms = joint_data_at(joints, state), mechanisms_of(joints, 3)
    partners, contacts = room_for_partners(3, mechanisms), room_for_rows(2)
    partners.inverse[:2, [0, 1, 4, 6]] = 1.0
    partners.position[1, 0], partners.velocity[:2, 2] = 1.0, -1.0
    contacts.partner_a[:], contacts.partner_b[:] = [0, 1], 2
    for k, x in enumerate((-0.2, 1.3)):
        write_frame(partners, contacts, k, (0.0, 0.0, 1.0), (x, 0.1, -0.1))
        contacts.frame[k, FRICTION] = 0.5
    rules = ImpulseRules(np.zeros(1), np.zeros(1), 1e-12, 1, 0.0, 0.0, 0.0, True)
    newton = room_for_newton(partners.inverse[:, 0] > 0, a[:1], b[:1], 2)
    impulses = Impulses(rules, partners, contacts, np.array([2, -1]), np.zeros(TALLY), newton)
    find_bounded(joints, data, impulses, 0.01)
    find_responses(joints, data, impulses)
    g = data.gradient
    G = np.hstack([g[:, :3], g[:, 3:6], -g[:, :3], g[:, 6:9]])
    dense = np.eye(12) - G.T @ np.linalg.solve(G @ G.T, G)
    assert mechanisms.response.reshape(12, 12) == pytest.approx(dense, abs=1e-13)
    solve(impulses, ONE_THREAD, 1.0, 0.0)
    assert impulses.tally[RESIDUAL] <= 1e-12
    assert impulses.tally[NEWTON_STEPS] > 1
    assert np.abs(G @ partners.velocity[:2].ravel()).max() < 1e-14
    assert np.abs(partners.velocity[:2, 2]).max() > 1e-3  # what hangs between the two swings on


@plain
def test_the_gripper_of_the_cases_begins_to_lift():
    """The whole of it takes long to compile, and its 240 steps long in Python."""
    t = particlerb.run(CASES / "gripper.toml", overrides=["run.t_end=0.01", "run.every=0.005"])
    lifted = (t.position[-1] - t.position[0])[:, 2]
    assert lifted[0] > 8e-5
    assert lifted[5] == pytest.approx(lifted[0], abs=1e-6)  # it lagged by a fifth, half a step
    assert errors(t)[0] < 1e-6
    assert particlerb.joint_loads(t).misfit.max() < 1e-13


def loads_of(body, joint, **keys):
    """Run of bodies with a joint that may break; when it did, in steps, and the trajectory."""
    fields = ["position", "orientation", "linear_momentum", "angular_momentum", "joint_break_time"]
    scene = case(*body, joint=joint, output={"fields": fields}, **keys)
    t = particlerb.run(scene)
    return scene, t, t.joint_break_time[-1] / t.case.run.dt


@plain
@pytest.mark.parametrize(("share", "breaks"), [(0.999, 0.5), (1.001, 0.0)])
def test_a_joint_breaks_under_a_weight_and_the_momenta_are_counted(share, breaks):
    """The load of the first step is m g; the free fall begins at its end."""
    hook, load = sphere("hook", contact=False), sphere("load", position=[0, 0, -0.5])
    joint = [
        tied("ball", to=None, body="hook", at=[0, 0, 0.2]),
        tied(
            "ball", to="hook", body="load", at=[0, 0, -0.25], breaks_at={"force": share * 2.0 * G}
        ),
    ]
    keys = {"wall": [plane(point=[0, 0, -9.0])], "gravity": DOWN, "t_end": 0.05, "dt": 0.01}
    _, t, found = loads_of((hook, load), joint, contact=impulse(), every=0.01, **keys)
    assert found == pytest.approx([0.0, breaks], abs=1e-12)
    fallen = 0.5 * G * np.maximum(t.time - 0.01, 0.0) ** 2 if breaks else 0.0
    assert t.position[:, 1, 2] == pytest.approx(-0.5 - fallen, abs=1e-12)
    assert max(errors(t)) < 1e-13


@plain
@pytest.mark.parametrize(
    ("e", "share", "breaks"), [(0.5, 0.999, 0.5), (0.0, 0.999, 0.5), (0.5, 1.001, 0.0)]
)
def test_a_joint_breaks_under_a_blow(tmp_path, e, share, breaks):
    """(1 + e) m v over a step of h; what goes on from a checkpoint knows what has broken."""
    h, v = 0.01, 3.0
    plate, ball = clump("plate"), sphere(position=[R, R, 0.3 + 0.3 * h * v], velocity=[0, 0, -v])
    load = {"force": share * (1.0 + e) * 2.0 * v / h}
    joint = [tied("fixed", to=None, body="plate", breaks_at=load, merge=False)]
    keys = {"contact": impulse(e), "dt": h, "every": h}
    scene, t, found = loads_of((plate, ball), joint, t_end=4 * h, **keys)
    assert found == pytest.approx([breaks], abs=1e-12)
    assert t.velocity[-1, :, 2] == pytest.approx([0.0, e * v], abs=1e-13)
    assert max(errors(t)) < 1e-13
    part = tmp_path / "part.h5"
    particlerb.run(scene | {"run": scene["run"] | {"t_end": 2 * h}}, part).close()
    with particlerb.resume(part, t_end=4 * h) as later:
        assert (later.joint_break_time[-1] == t.joint_break_time[-1]).all()
        assert (later.linear_momentum == t.linear_momentum).all()


@plain
def test_the_order_of_bodies_does_not_change_how_a_chain_bounces():
    """Its corners hit the floor in the same steps, and what one hits moves the others."""
    ends = [("a", -0.3, 0.0, 0.35), ("b", 0.3, 0.02, 0.4), ("c", 0.9, -0.03, 0.37)]
    boxes = [
        clump(name, position=at, orientation=[1.0, 0.1 * k, -0.15, 0.2 * k],
              velocity=[0.3 * k, 0.0, -2.0])
        for k, (name, *at) in enumerate(ends)
    ]  # fmt: skip
    limit = {"range": [-0.05, 0.05], "restitution": 0.5}
    pins = [{"type": "hinge", "body": b, "to": a, "at": [0.3, 0, 0], "axis": [0, 1, 0],
             "limit": limit, "assemble": True} for b, a in (("b", "a"), ("c", "b"))]  # fmt: skip
    found = []
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        t = go(*(boxes[k] for k in order), contact=impulse(0.5, 0.5, tolerance=1e-9), joint=pins,
               wall=[plane()], gravity=DOWN, dt=2e-3, t_end=0.2, every=0.1)  # fmt: skip
        found.append(t.position[-1][np.argsort(order)])
    assert np.abs(found[0][:, 2] - [0.35, 0.4, 0.37]).max() > 0.1
    assert np.abs(np.array(found[1:]) - found[0]).max() < 1e-9
