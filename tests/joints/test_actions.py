"""What acts on jointed bodies: drag, dampers, dashpots, springs, stops, motors."""

import numpy as np
import pytest
from scenes import X, Y, bar, body, case, hinge_chain, joint, moved

import particlerb
from particlerb import CaseError, joint_loads
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare
from particlerb.simulation.whole_run import RunError

FIELDS = ["position", "orientation", "linear_momentum", "angular_momentum"]
FIELDS += ["velocity", "angular_velocity"]
OUTPUT = {"fields": FIELDS}


LIGHT = (0.0, 0.0, -1e-300)  # too small to change a bit, as are
GHOSTS = {"damper": 1e-300, "motor": 1e-300}  # these: with them all share one compiled loop
plain = pytest.mark.plain


def flap(speed=0.0, g=(0.0, 0.0, 0.0), **keys):
    """A bar on a hinge at the origin about y; its moment about it is 1/3 + 1/300 + 1/1200."""
    bar_ = bar("flap", [0, 0, 0], [1, 0, 0], 1.0, 0.1, [0, 0, -0.5 * speed], [0, speed, 0])
    return case([bar_], [joint("hinge", "flap", None, [0, 0, 0], Y) | keys], g, output=OUTPUT)


def hinged(speed=0.0, g=LIGHT, **keys):
    """A flap on which ghosts act too."""
    return flap(speed, g, **(GHOSTS | keys))


MOMENT = (1 + 0.01) / 12 + 0.25


def angle(trajectory, b=0):
    """Turn about y from the start, between -π and π."""
    q = np.array(trajectory.orientation)[:, b]
    first = q[0]
    w = (q * first).sum(axis=1)
    y = first[0] * q[:, 2] - first[2] * q[:, 0]
    return 2 * np.arctan2(y, w)


@pytest.mark.plain
@pytest.mark.parametrize("c", [0.05, 3.0])
def test_a_damper_slows_a_hinge_down(c):
    """ω = ω₀ exp(-c t / I)."""
    ends = []
    for dt in (0.01, 0.005):
        with moved(hinged(2.0, damper=c), 0.2, dt, every=0.05) as trajectory:
            w = np.array(trajectory.angular_velocity)[:, 0, 1]
            ends.append(np.abs(w - 2.0 * np.exp(-c * trajectory.time / MOMENT)).max())
            assert np.abs(trajectory.ledger.energy_error).max() < 1e-13
            assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-13
    assert ends[0] / ends[1] == pytest.approx(4.0, rel=0.05)


def test_an_overdamped_hinge_creeps():
    """c φ' = τ - k φ after its start: c h/I = 4e3."""
    scene = hinged(damper=140.0, spring={"stiffness": 70.0}, motor=35.0)
    with moved(scene, 4.0, 0.01, every=1.0) as trajectory:
        t = trajectory.time
        assert angle(trajectory) == pytest.approx(0.5 * (1 - np.exp(-0.5 * t)), abs=2e-3)


def swings(method, dts, **keys):
    """Errors of a spring that swings about its rest, x = x₀ cos(√(k/m) t), with two steps."""
    scene = flap(spring={"stiffness": 8.0, "rest": 0.3}, **keys)
    errors = []
    for dt in dts:
        with moved(scene, 1.0, dt, method, every=0.1) as trajectory:
            exact = 0.3 * (1 - np.cos(np.sqrt(8.0 / MOMENT) * trajectory.time))
            errors.append(np.abs(angle(trajectory) - exact).max())
    return errors


def test_a_spring_swings_a_hinge_and_a_slider():
    """At order two."""
    errors = swings("rattle", (0.02, 0.01), g=LIGHT, **GHOSTS)
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)
    block = body("block", 2.0, [0.1, 0.2, 0.3], [1.0, 0, 0], [0.7, 0, 0])
    slider = joint("slider", "block", None, [0, 0, 0], X, spring={"stiffness": 50.0}) | GHOSTS
    with moved(case([block], [slider], LIGHT), 1.0, 4e-3, every=0.1) as trajectory:
        x = np.array(trajectory.position)[:, 0, 0] - 1.0
        phase = (5.0 * 4e-3) ** 2 / 24 * 5.0  # of order two
        assert x == pytest.approx(0.14 * np.sin(5.0 * trajectory.time), abs=0.14 * phase)
        assert np.abs(trajectory.ledger.energy_error).max() < 16e-5
        assert np.abs(trajectory.ledger.work).max() < 1e-290


@plain
def test_a_spring_without_damping_swings_at_order_six():
    errors = swings("rattle6", (0.1, 0.05))
    assert errors[0] / errors[1] == pytest.approx(64.0, rel=0.25)


@plain
def test_motors_on_the_same_body_each_book_their_own_work():
    """Two bars that motors press apart, on sliders of a third body below them: W = F x."""
    base = bar("base", [0, 0, -1], [1, 0, -1], 2.0, 0.1, [0, 0, 0], [0, 0, 0])
    bars = [bar(name, [x, 0, 0], [x + 0.2, 0, 0], 0.2, 0.1, [0, 0, 0], [0, 0, 0])
            for name, x in (("left", -0.5), ("right", 0.5))]  # fmt: skip
    joints = [joint("slider", "base", None, [0, 0, 0], Y)]
    joints += [joint("slider", name, "base", [0, 0, 0], X) | {"motor": force}
               for name, force in (("left", -15.0), ("right", 15.0))]  # fmt: skip
    t = particlerb.run(
        case([base, *bars], joints) | {"run": {"t_end": 0.1, "every": 0.05, "dt": 0.01}}
    )
    assert np.abs(t.observable("energy_error")).max() < 1e-12
    assert t.energy[-1] - t.energy[0] == pytest.approx(2 * 15.0**2 * 0.1**2 / (2 * 0.2), rel=1e-12)


def test_a_motor_gives_what_it_takes():
    """ω = τ t / I; its work is τ φ, at a slider F x."""
    with moved(hinged(motor=0.7), 1.0, 0.01, every=0.1) as trajectory:
        t = trajectory.time
        assert angle(trajectory) == pytest.approx(0.35 * t * t / MOMENT, rel=5e-5)
        assert trajectory.ledger.work == pytest.approx(0.7 * angle(trajectory), rel=5e-5)
        assert np.abs(trajectory.ledger.energy_error).max() < 5e-5


@plain
def test_the_balance_beside_a_motor_has_the_order_of_the_method():
    """A motor bends two links in the middle: its work is its torque times the angle."""
    scene, errors = hinge_chain(2), []
    scene["joint"][1]["motor"] = 0.3
    for dt in (0.02, 0.01):
        with moved(scene | {"output": OUTPUT}, 0.2, dt, "rattle4", every=0.1) as trajectory:
            errors.append(np.abs(trajectory.ledger.energy_error).max())
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@pytest.mark.slow
def test_stops_turn_a_flap_back():
    limit = {"range": [-0.5, 0.2], "stiffness": 2e3}
    with moved(hinged(1.0, limit=limit), 1.1, 5e-4, every=0.01) as trajectory:
        phi, w = angle(trajectory), np.array(trajectory.angular_velocity)[:, 0, 1]
        energy = trajectory.ledger.energy_error
    deepest = np.sqrt(MOMENT / 2e3)
    assert phi.max() == pytest.approx(0.2 + deepest, abs=2e-3)
    assert phi.min() == pytest.approx(-0.5 - deepest, abs=2e-3)
    assert w[np.flatnonzero(np.abs(phi + 0.1) < 0.2)] ** 2 == pytest.approx(1.0, abs=1e-3)
    assert np.abs(energy).max() < 1e-4


@pytest.mark.slow
def test_a_stop_that_damps_ends_a_fall():
    limit = {"range": [-1.0, 0.4], "stiffness": 500.0, "damping": 20.0}
    with moved(hinged(0.0, (0, 0, -9.81), limit=limit), 3.0, 2e-3, every=0.02) as trajectory:
        phi, ledger = angle(trajectory), trajectory.ledger
        assert np.abs(ledger.energy_error).max() < 1e-3 * np.abs(ledger.work).max()
    depth = 0.5 * 9.81 * np.cos(phi[-1]) / 500.0
    assert phi[-1] == pytest.approx(0.4 + depth, abs=1e-6)


@plain
@pytest.mark.parametrize(
    ("method", "step", "within"), [("rattle", 4e-3, 3e-4), ("dop853", None, 1e-8)]
)
def test_a_stop_is_met_beyond_half_a_turn_too(method, step, within):
    """It pushed from the other end of its limit there, with 1466 J in place of 0.67."""
    scene = hinged(2.0, limit={"range": [-0.5, 3.0], "stiffness": 20.0})
    scene["run"] = {"t_end": 2.5, "every": 0.02, "method": method} | ({"dt": step} if step else {})
    with particlerb.run(scene) as t:
        assert np.abs(t.ledger.energy_error).max() < within
        phi = angle(t)
    deepest = 2.0 * np.sqrt(MOMENT / 20.0)
    assert phi.max() == pytest.approx(3.0 + deepest, abs=2e-3)
    assert phi[-1] == pytest.approx(
        3.0 - 2.0 * (2.5 - 1.5 - np.pi * 0.5 * deepest), abs=10 * within
    )


@plain
@pytest.mark.parametrize("method", ["rattle", "dop853"])
def test_a_stop_that_is_passed_ends_the_run(method):
    scene = hinged(4.0, limit={"range": [-0.5, 1.0], "stiffness": 1.0})
    scene["run"] = {"t_end": 4.0, "every": 0.05, "method": method}
    with pytest.raises(RunError, match="has turned so far beyond its stop"):
        particlerb.run(scene)


def dragged(dt):
    """Two rods with unequal drag, and a dashpot from the second to the world."""
    bodies = [
        bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.1),
        bar("b", [1, 0, 0], [1, 1, 0], 2.0, 0.1),
    ]
    joints = [joint("hinge", "a", None, [0, 0, 0], Y), joint("ball", "b", "a", [1, 0, 0])]
    force = [
        {"type": "drag", "body": "a", "translation": 0.4, "rotation": 0.1},
        {"type": "drag", "body": "b", "translation": 1.5, "rotation": 0.02},
        {"type": "spring", "body": "b", "at": [0.5, 0, 0], "anchor": [1.0, 1.5, 0.5],
         "stiffness": 5.0, "damping": 3.0},
    ]  # fmt: skip
    return moved(case(bodies, joints, force=force, output=OUTPUT), 0.6, dt, every=0.06)


@plain
def test_drag_and_dashpots_on_jointed_bodies_are_of_order_two():
    ends, errors = [], []
    for dt in (0.02, 0.01, 0.005):
        with dragged(dt) as trajectory:
            ends.append(np.array(trajectory.position)[-1])
            errors.append(np.abs(trajectory.ledger.energy_error).max())
            assert trajectory.ledger.work[-1] < -0.5
            assert np.abs(trajectory.ledger.linear_momentum_error).max() < 1e-12
            assert np.abs(trajectory.ledger.angular_momentum_error).max() < 1e-12
            assert joint_loads(trajectory).misfit.max() < 1e-13
            assert joint_loads(trajectory).rate.max() < 1e-12
    coarse, fine = (np.abs(ends[k] - ends[k + 1]).max() for k in (0, 1))
    assert coarse / fine == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.2)


def test_what_joints_carry_beside_drag_and_springs_is_the_change_of_the_momenta():
    """Ṗ of each body by central differences beside the sum over its loads."""
    h = 1e-3
    bodies = [bar("a", [0, 0, 0], [1, 0, 0], 1.0, 0.1, [0, 0, -1.0], [0, 2.0, 0])]
    hinge = joint("hinge", "a", None, [0, 0, 0], Y, damper=0.5, spring={"stiffness": 4.0})
    force = [{"type": "drag", "body": "a", "translation": 0.4, "rotation": 0.1}]
    scene = case(bodies, [hinge], force=force, output=OUTPUT)
    with moved(scene, 4 * h, h / 20, every=h) as trajectory:
        p = np.array(trajectory.linear_momentum)[:, 0]
        v = np.array(trajectory.velocity)[:, 0]
        loads = joint_loads(trajectory)
    rate = (p[0] - 8 * p[1] + 8 * p[3] - p[4]) / (12 * h)
    assert loads.force[2, 0] == pytest.approx(rate - [0, 0, -9.81] + 0.4 * v[2], abs=1e-4)


def test_a_damped_mechanism_goes_on_bit_for_bit(tmp_path):
    scene = hinged(1.0, (0, 0, -9.81), damper=0.3, spring={"stiffness": 4.0})
    path, times = tmp_path / "run.h5", {"every": 0.03, "dt": 0.01}
    particlerb.run({"run": {"t_end": 0.09, **times}, **scene}, path).close()
    particlerb.resume(path, 0.21).close()
    whole = particlerb.run({"run": {"t_end": 0.21, **times}, **scene})
    with particlerb.open(path) as resumed, whole:
        assert (np.array(resumed.orientation) == np.array(whole.orientation)).all()
        assert (resumed.ledger.work == whole.ledger.work).all()


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"type": "ball", "motor": 1.0}, "springs and dampers alone"),
        ({"limit": {"range": [0.2, 0.1], "stiffness": 1.0}}, "must ascend"),
        ({"limit": {"range": [0.0, 4.0], "stiffness": 1.0}}, "beyond half a turn"),
        ({"spring": {"stiffness": 1.0, "rest": 4.0}}, "beyond half a turn"),
    ],
)
def test_what_cannot_act_along_a_joint_is_named(keys, words):
    scene = hinged(**keys) if "type" not in keys else flap(**keys)
    if keys.get("type") == "ball":
        scene["joint"][0].pop("axis")
    with pytest.raises(CaseError, match=words):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **scene}))


def test_orders_above_two_and_magnus_are_refused():
    times = {"t_end": 1.0, "every": 0.1, "dt": 0.01}
    with pytest.raises(CaseError, match="does not accept what acts here: damping among joints"):
        prepare(to_system({"run": times | {"method": "rattle4"}, **flap(damper=1.0)}))
    magnus = {"type": "magnus", "body": "flap", "coefficient": 0.1}
    with pytest.raises(CaseError, match="does not accept what acts here: magnus"):
        prepare(to_system({"run": times, **flap(), "force": [magnus]}))


@pytest.mark.parametrize("method", ["auto", "rattle4"])
def test_a_wire_that_is_cut_lets_its_bob_fly(method):
    """A parabola, and a constant spin, from the state at the release on."""
    release = 0.35
    weight = body("bob", 1.0, [0.1, 0.2, 0.25], [1.0, 0, 0], [0, 1.0, 0])
    wire = {"type": "distance", "body": "bob", "at_to": [0.0, 0, 0], "during": [0.0, release]}
    times = {"t_end": 0.7, "every": 0.05, "dt": 0.005, "method": method}
    with particlerb.run({"run": times, **case([weight], [wire], output=OUTPUT)}) as trajectory:
        t, x = trajectory.time, np.array(trajectory.position)[:, 0]
        v = np.array(trajectory.velocity)[:, 0]
        loads = joint_loads(trajectory)
        assert np.abs(trajectory.ledger.linear_momentum_error).max() < 1e-12
    length = np.linalg.norm(x, axis=1)
    assert np.abs(length[t <= release] - 1.0).max() < 1e-13
    k = np.flatnonzero(t >= release)[0]
    s = (t[k:] - t[k])[:, None]
    assert x[k:] == pytest.approx(x[k] + v[k] * s - 0.5 * 9.81 * s * s * [0, 0, 1], abs=1e-12)
    assert np.abs(length[k + 1 :] - 1.0).max() > 0.1
    assert (np.linalg.norm(loads.force[:k, 0], axis=1) > 0.1).all()
    assert (loads.force[k:] == 0.0).all()


def test_a_spring_that_is_released_takes_its_energy_with_it():
    scene = hinged(spring={"stiffness": 8.0, "rest": 1.0}, during=[0.0, 0.2])
    with moved(scene, 0.4, 0.002, every=0.1) as trajectory:
        ledger, phi = trajectory.ledger, angle(trajectory)
    assert np.abs(ledger.energy_error).max() < 2e-4
    assert ledger.work[-1] == pytest.approx(-4.0 * (1.0 - phi[2]) ** 2, rel=1e-9)


def test_a_joint_does_not_catch_bodies():
    with pytest.raises(CaseError, match="a joint acts from the start on"):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.1}, **flap(during=[0.1, 0.2])}))


@plain
@pytest.mark.parametrize(
    ("kind", "along", "inertia"),
    [("cylindrical", "displacement", 2.0), ("cylindrical", "angle", 0.1),
     ("planar", "first displacement", 2.0), ("planar", "second displacement", 2.0),
     ("planar", "angle", 0.1)],
)  # fmt: skip
def test_a_spring_acts_along_the_coordinate_that_is_named(kind, along, inertia):
    """x = v/ω sin ωt with ω² = k/m; the other coordinates go on as they began."""
    block = body("block", 2.0, [0.1, 0.1, 0.1], [0, 0, 0], [0.3, 0.3, 0.3], [0, 0, 0.4])
    if kind == "cylindrical":
        block["velocity"] = [0, 0, 0.3]
    tie = joint(kind, "block", None, [0, 0, 0], [0, 0, 1], spring={"stiffness": 5.0}, along=along)
    if kind == "planar":
        block["velocity"] = [0.3, 0.3, 0]
    output = {"fields": [*FIELDS, "joint_coordinate", "joint_rate"]}
    scene = case([block], [tie], (0, 0, 0), output=output)
    with moved(scene, 1.0, 2e-3, every=0.1) as trajectory:
        t, x = trajectory.time, np.array(trajectory.joint_coordinate)
        names = [name.split(", ")[1] for name in trajectory.coordinate_names]
        assert np.abs(trajectory.ledger.energy_error).max() < 1e-5
    w = np.sqrt(5.0 / inertia)
    for name, values in zip(names, x.T, strict=True):
        free = np.abs(values - values[1] / 0.1 * t).max()
        if name == along:
            v = 0.4 if name == "angle" else 0.3
            assert np.abs(values) == pytest.approx(np.abs(v / w * np.sin(w * t)), abs=1e-5)
        else:
            assert free < 1e-12


def test_a_coordinate_is_named_where_there_are_several():
    times = {"t_end": 1.0, "every": 0.1}
    rod = bar("rod", [0, 0, 0], [1, 0, 0])
    for keys, words in (({}, "has several coordinates"), ({"along": "twist"}, "has no twist")):
        tie = joint("cylindrical", "rod", None, [0, 0, 0], X, damper=1.0, **keys)
        with pytest.raises(CaseError, match=words):
            prepare(to_system({"run": times, **case([rod], [tie])}))
