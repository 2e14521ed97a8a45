"""What joints carry: closed forms, balance of momentum, redundant rows."""

import numpy as np
import pytest
from scenes import SCENES, bar, body, case, joint, moved

import particlerb
from particlerb import CaseError, Simulation, joint_loads, run
from particlerb.record.verify import verify

G = 9.81
RUN = {"t_end": 0.1, "every": 0.1}


def test_a_string_carries_weight_and_centripetal_force():
    """T = m (v²/l + g cos θ), towards the pivot."""
    shape = {"type": "points", "position": [[0.0, 0.0, 0.0]], "mass": [2.0]}
    bob = {"name": "bob", "shape": shape, "position": [0.6, 0.0, -0.8], "velocity": [0.0, 1.5, 0.0]}
    scene = case([bob], [{"type": "distance", "body": "bob", "at_to": [0.0, 0.0, 0.0]}])
    with moved(scene, 0.5, 0.02, every=0.07) as trajectory:
        loads = joint_loads(trajectory)
        x, p = np.array(trajectory.position)[:, 0], np.array(trajectory.linear_momentum)[:, 0]
    tension = (p * p).sum(axis=1) / 2.0 - 2.0 * G * x[:, 2]
    assert loads.names == ("bob-world",)
    assert loads.force[:, 0] == pytest.approx(-tension[:, None] * x, abs=1e-11)
    assert np.abs(loads.torque).max() < 1e-12
    assert loads.misfit.max() < 1e-14
    assert loads.rate.max() < 1e-13


def test_a_bar_let_go_leaves_a_quarter_of_its_weight_on_the_pivot():
    """F = M g (1 - M a²/(I + M a²)), a the distance to the pivot."""
    rod = bar("rod", [0, 0, 0], [1, 0, 0], 3.0)
    with moved(case([rod], [joint("hinge", "rod", None, [0, 0, 0], [0, 1, 0])]), 0.02, 0.01) as t:
        loads = joint_loads(t)
    inertia = 3.0 / 12 * (1 + 0.01)
    up = 3.0 * G * (1.0 - 0.75 / (inertia + 0.75))
    assert loads.force[0, 0] == pytest.approx([0.0, 0.0, up], abs=1e-12)
    assert np.abs(loads.torque[0, 0]).max() < 1e-12


@pytest.mark.plain
def test_a_push_and_a_spring_are_carried_too():
    block = body("block", 2.0, [0.1, 0.2, 0.3], [0, 0, 0])
    push = {"type": "push", "body": "block", "at": [0, 0.3, 0], "force": [5.0, 0.0, 0.0]}
    spring = {"type": "spring", "body": "block", "at": [0, 0, 0.2], "anchor": [0.0, 1.0, 0.2],
              "stiffness": 7.0}  # fmt: skip
    scene = case([block], [joint("fixed", "block", None, [0, 0, 0.5])], force=[push, spring])
    with moved(scene, 0.02, 0.01) as trajectory:
        loads = joint_loads(trajectory)
    force = np.array([-5.0, -7.0, 2.0 * G])
    arms = np.array([[0, 0.3, -0.5], [0, 0, -0.3], [0, 0, -0.5]])
    given = np.array([[5.0, 0, 0], [0, 7.0, 0], [0, 0, -2.0 * G]])
    for k in range(2):
        assert loads.force[k, 0] == pytest.approx(force, abs=1e-12)
        assert loads.torque[k, 0] == pytest.approx(-np.cross(arms, given).sum(axis=0), abs=1e-12)


CARRIED = {"fields": ["position", "orientation", "linear_momentum", "angular_momentum",
                      "joint_force", "joint_torque"]}  # fmt: skip
IMPULSES = {"law": "impulse", "restitution": 0.0, "friction": 0.0, "tolerance": 1e-12}


@pytest.mark.plain
@pytest.mark.parametrize(
    ("law", "tolerance"),
    [(IMPULSES, 1e-10), ({"law": "hooke", "stiffness": 1e4, "restitution": 0.2}, 1e-6)],
)
def test_a_lever_on_the_floor_leaves_a_third_of_its_weight_on_the_hinge(law, tolerance):
    """1 kg at the hinge, 2 kg on the floor: the hinge carries 1 kg, and before a step no one knows.

    With springs the ball has come to rest after 0.3 s.
    """
    shape = {"type": "points", "position": [[0, 0, 0], [1, 0, 0]], "mass": [1.0, 2.0],
             "radius": [0.0, 0.1]}  # fmt: skip
    lever = {"name": "lever", "shape": shape, "position": [2 / 3, 0, 0.1]}
    floor = {"name": "floor", "type": "plane", "normal": [0, 0, 1]}
    scene = case([lever], [joint("hinge", "lever", None, [0, 0, 0.1], [0, 1, 0])], wall=[floor])
    scene |= {"contact": {"friction": 0.0} | law, "output": CARRIED}
    with moved(scene, 0.3, 5e-4, method="auto", every=0.1) as t:
        force, torque = np.array(t.joint_force)[:, 0], np.array(t.joint_torque)
    assert force[-1] == pytest.approx([0.0, 0.0, G], abs=tolerance)
    assert np.abs(torque[-1]).max() < 1e-12
    assert np.isnan(force[0]).all() == (law is IMPULSES)


@pytest.mark.plain
@pytest.mark.parametrize(
    "held",
    [
        {"limit": {"range": [-1.0, 0.0]}},
        {"friction": 20.0},
        {"motor": {"speed": 0.0, "largest": 20.0}},
        {"limit": {"range": [-1.0, 0.0]}, "friction": 0.5},
    ],
)
def test_what_a_joint_holds_by_impulses_it_carries_too(held):
    """A level rod that a stop, friction, a motor or two of them hold: all of its weight."""
    rod = bar("rod", [0, 0, 0], [1, 0, 0], 3.0) | {"contact": False}
    pivot = joint("hinge", "rod", None, [0, 0, 0], [0, 1, 0], **held)
    scene = case([rod], [pivot], contact=IMPULSES, output=CARRIED)
    with moved(scene, 0.05, 0.01, method="auto", every=0.025) as t:
        assert np.array(t.joint_force)[1:, 0] == pytest.approx(
            np.array([[0.0, 0.0, 3.0 * G]] * 2), abs=1e-9
        )


@pytest.mark.plain
def test_a_motor_with_a_largest_torque_is_carried_while_the_rod_falls():
    """F_z = M (g - a α) while the rod is level, α = (M g a + τ)/(I + M a²), within a step."""
    rod = bar("rod", [0, 0, 0], [1, 0, 0], 3.0) | {"contact": False}
    keys = {"motor": {"speed": 9.0, "largest": 2.0}}
    pivot = joint("hinge", "rod", None, [0, 0, 0], [0, 1, 0], **keys)
    scene = case([rod], [pivot], contact=IMPULSES, output=CARRIED)
    with moved(scene, 2e-4, 1e-4, method="auto") as t:
        force = np.array(t.joint_force)[1, 0]
    turning = (3.0 * G * 0.5 + 2.0) / (3.0 / 12 * 1.01 + 0.75)
    assert force == pytest.approx([0.0, 0.0, 3.0 * (G - 0.5 * turning)], abs=1e-2)


@pytest.mark.plain
def test_what_is_determined_is_so_where_nothing_else_is_asked():
    """Beside contact, too."""
    shape = {"type": "points", "position": [[0, 0, 0], [1, 0, 0]], "mass": [1.0, 2.0],
             "radius": [0.0, 0.1]}  # fmt: skip
    lever = {"name": "lever", "shape": shape, "position": [2 / 3, 0, 0.1]}
    floor = {"name": "floor", "type": "plane", "normal": [0, 0, 1]}
    scene = case([lever], [joint("ball", "lever", None, [0, 0, 0.1])], wall=[floor])
    for fields in (CARRIED["fields"], CARRIED["fields"][:4]):
        scene |= {"contact": IMPULSES, "output": {"fields": [*fields, "joint_force_determined"]}}
        with moved(scene, 0.02, 0.01, method="auto") as t:
            assert np.array(t.joint_force_determined)[1:].all()


def test_a_door_at_rest_hangs_on_both_hinges():
    """Only sums are determined: the weight, and the moment of the weight about the hinges."""
    door = bar("door", [0, 0, 0], [1, 0, 0], 25.0)
    hinges = [joint("hinge", "door", None, [0, 0, z], [0, 0, 1]) for z in (-0.4, 0.4)]
    with moved(case([door], hinges), 0.02, 0.01) as trajectory:
        assert np.abs(np.array(trajectory.position)[-1] - [0.5, 0, 0]).max() < 1e-14
        loads = joint_loads(trajectory)
    force, torque = loads.force[0], loads.torque[0]
    assert force.sum(axis=0) == pytest.approx([0, 0, 25.0 * G], abs=1e-11)
    assert force[:, 2] == pytest.approx([12.5 * G] * 2, abs=1e-11)
    moment = (torque + np.cross([[0, 0, -0.4], [0, 0, 0.4]], force)).sum(axis=0)
    assert moment == pytest.approx(-np.cross([0.5, 0, 0], [0, 0, -25.0 * G]), abs=1e-11)
    assert torque[:, 2] == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.plain
@pytest.mark.parametrize("name", ["bricard", "slider_crank", "mixed_chain"])
def test_what_joints_carry_is_the_change_of_the_momenta(name):
    """Ṗ - M g of each body by differences of order six, beside the sum over its joints.

    Steps of 1 ms: momenta are good to 1e-15/h, so that shorter ones show rounding over h².
    """
    scene, h = SCENES[name](), 1e-3
    times = {"t_end": 6 * h, "every": h, "dt": h, "method": "rattle8"}
    with run({"run": times, **scene}) as trajectory:
        loads, names = joint_loads(trajectory), list(trajectory.names)
        p = np.array(trajectory.linear_momentum)
    rate = np.tensordot([-1, 9, -45, 0, 45, -9, 1], p, 1) / (60 * h)
    masses = np.array([table["mass"] for table in scene["body"]])
    carried = np.zeros_like(rate)
    for table, force in zip(scene["joint"], loads.force[3], strict=True):
        carried[names.index(table["body"])] += force
        if "to" in table:
            carried[names.index(table["to"])] -= force
    outside = rate - masses[:, None] * np.array(scene["gravity"]["acceleration"])
    assert carried == pytest.approx(outside, abs=1e-9)


def test_trajectories_without_joints_have_no_loads():
    with (
        run(
            {"run": {"t_end": 0.1, "every": 0.1}, "body": [body("b", 1.0, [1, 1, 1], [0, 0, 0])]}
        ) as t,
        pytest.raises(KeyError, match="has no joints"),
    ):
        joint_loads(t)


@pytest.mark.plain
@pytest.mark.parametrize("method", ["rattle", "dop853"])
def test_a_loop_is_one_beside_a_body_that_a_dashpot_alone_ties(method):
    """A door on two hinges with a ball that pushes against it through air, if hardly."""
    door = bar("door", [0, 0, 0], [1, 0.2, 0.1], 2.0)
    hinges = [joint("hinge", "door", None, [0, 0, z], [0, 0, 1]) for z in (-0.4, 0.4)]
    ball = body("ball", 0.3, [0.01, 0.01, 0.01], [1.5, 0.3, 0.5])
    link = {"type": "spring", "body": "ball", "to": "door", "stiffness": 1e-12, "damping": 1e-12}
    times = {"t_end": 0.4, "every": 0.4, "method": method}
    times |= {"dt": 0.01} if method == "rattle" else {"tolerance": 1e-9}
    found = []
    for bodies, force in (([door], []), ([door, ball], [link | {"rest_length": "initial"}])):
        scene = case(bodies, hinges, (0.3, 0.5, -G), force=force)
        with run({"run": times, **scene}) as trajectory:
            loads = joint_loads(trajectory)
            found.append((np.array(trajectory.position)[:, 0], loads.force, loads.torque))
    for alone, beside in zip(*found, strict=True):
        assert beside == pytest.approx(alone, abs=1e-6)


@pytest.mark.plain
def test_loads_that_redundant_rows_leave_open_do_not_depend_on_units():
    """All lengths and gravity in thousandths: forces are those, torques too with their arms."""
    small, scene, found = 1e-3, SCENES["bricard"](), []
    for scale in (1.0, small):
        moments = (scale**2 * np.array([b["shape"]["inertia"] for b in scene["body"]])).tolist()
        bodies = [b | {"position": (scale * np.array(b["position"])).tolist()}
                  | {"shape": b["shape"] | {"inertia": own}}
                  for b, own in zip(scene["body"], moments, strict=True)]  # fmt: skip
        joints = [j | {"at": (scale * np.array(j["at"])).tolist()} for j in scene["joint"]]
        with moved(case(bodies, joints, (0, -G * scale, 0)), 0.02, 0.01) as trajectory:
            found.append(joint_loads(trajectory))
    large, small_loads = found
    assert small_loads.force / small == pytest.approx(large.force, abs=1e-7)
    assert small_loads.torque / small**2 == pytest.approx(large.torque, abs=1e-7)


@pytest.mark.plain
def test_loads_of_a_scene_that_has_changed_are_refused(tmp_path):
    """The file has the case as it began: a motor of 0, and then one that turns the bar.

    Another step, and a value that was refused, change nothing in what joints carry.
    """
    scene = case([bar("a", [0, 0, 0], [1, 0, 0], 1.0)],
                 [joint("hinge", "a", None, [0, 0, 0], [0, 0, 1], motor=0)])  # fmt: skip
    times = {"t_end": 0.2, "every": 0.1, "dt": 0.01, "method": "rattle"}
    for name, change in (("a", ("run.dt", 0.02)), ("b", ("joint[0].motor", 5.0))):
        with Simulation({"run": times, **scene}, tmp_path / name) as simulation:
            simulation.advance(0.1)
            with pytest.raises(CaseError):
                simulation.change("joint[0].motor", "much")
            simulation.change(*change)
            simulation.advance(0.2)
    with particlerb.open(tmp_path / "a") as trajectory:
        assert joint_loads(trajectory).force.shape == (3, 1, 3)
    with particlerb.open(tmp_path / "b") as trajectory:
        assert all(found.is_whole for found in verify(trajectory))
        with pytest.raises(ValueError, match=r"has changed joint\[0\].motor, at t = 0.1 s"):
            joint_loads(trajectory)
