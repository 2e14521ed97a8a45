"""What files hold of joints: loads, angles with their turns, displacements, how well they hold."""

import csv

import numpy as np
import pytest
from holds import misfits
from scenes import SCENES, X, Z, bar, body, case, hinge_chain, joint, moved

import particlerb
from particlerb import CaseError, joint_loads
from particlerb.case.output import FIELDS_OF_JOINTS
from particlerb.case.to_system import to_system
from particlerb.compiled.barrier import Team
from particlerb.export import export
from particlerb.integrators import METHODS, joint_stages
from particlerb.plan.joints import joints_of
from particlerb.simulation.checks import results
from particlerb.simulation.run import prepare, run_prepared
from particlerb.stepping.make_motion import make_motion

STATE = ["position", "orientation", "linear_momentum", "angular_momentum"]


def asking(scene, *names):
    return {**scene, "output": {"fields": [*STATE, *(names or FIELDS_OF_JOINTS)]}}


def spinning(kind, velocity, spin, axis=Z, **keys):
    """A body with next to no weight on a joint with the world at its centre of mass."""
    one = body("one", 2.0, [0.3, 0.3, 0.3], [0.1, 0.2, 0.3], velocity, spin)
    tie = joint(kind, "one", None, [0.1, 0.2, 0.3], axis, **keys)
    return asking(case([one], [tie], (0, 0, -1e-300)))  # the loop with weight is compiled already


@pytest.mark.parametrize(
    ("kind", "velocity", "spin", "keys", "names", "rates"),
    [
        ("hinge", [0, 0, 0], [0, 0, 5.0], {}, ["angle"], [5.0]),
        ("hinge", [0, 0, 0], [0, 0, -7.0], {}, ["angle"], [-7.0]),
        ("slider", [0, 0, -0.3], [0, 0, 0], {}, ["displacement"], [-0.3]),
        ("cylindrical", [0, 0, 0.4], [0, 0, 3.0], {}, ["displacement", "angle"], [0.4, 3.0]),
        ("universal", [0, 0, 0], [0, 0, 4.0], {"axis_to": X},
         ["angle about axis", "angle about axis_to"], [4.0, 0.0]),
        ("universal", [0, 0, 0], [-4.0, 0, 0], {"axis_to": X},
         ["angle about axis", "angle about axis_to"], [0.0, -4.0]),
        ("planar", [0.3, 0.4, 0], [0, 0, -2.0], {},
         ["first displacement", "second displacement", "angle"], [0.4, -0.3, -2.0]),
    ],
)  # fmt: skip
def test_coordinates_grow_with_time_over_many_turns(kind, velocity, spin, keys, names, rates):
    """Uniform motion; up to five turns lie between two frames."""
    scene = spinning(kind, velocity, spin, **keys)
    with moved(scene, 9.1, 0.13, every=4.5) as t:
        found, time = t.joint_coordinate, t.time
        assert t.joint_names == ["one-world"]
        assert t.coordinate_names == [f"one-world, {name}" for name in names]
        assert t.coordinate_units == ["rad" if "angle" in name else "m" for name in names]
    assert found == pytest.approx(time[:, None] * np.array(rates), abs=1e-11)


def test_turns_are_counted_on_where_a_force_starts_and_stops():
    scene = spinning("hinge", [0, 0, 0], [0, 0, 5.0])
    push = {"type": "push", "body": "one", "force": [9.0, 0, 0], "during": [1.0, 2.3]}
    with moved(scene | {"force": [push]}, 6.0, 0.1, every=3.0) as t:
        assert t.joint_coordinate[:, 0] == pytest.approx([0.0, 15.0, 30.0], abs=1e-11)
        pushed = joint_loads(t)
        assert (pushed.force == t.joint_force).all()


@pytest.mark.parametrize("name", ["bricard", "mixed_chain"])
def test_fields_are_what_joint_loads_finds_and_change_nothing(name):
    scene = SCENES[name]()
    with (
        moved(scene, 0.1, 0.01, every=0.025) as plain,
        moved(asking(scene), 0.1, 0.01, every=0.025) as t,
    ):
        for field in STATE:
            assert (getattr(plain, field) == getattr(t, field)).all()
        loads = joint_loads(plain)
        assert t.joint_names == list(loads.names)
        assert (t.joint_force == loads.force).all()
        assert (t.joint_torque == loads.torque).all()
        assert (t.joint_misfit == loads.misfit).all()
        assert (t.joint_rate == loads.rate).all()
        worst = misfits(t, scene["joint"])
    assert loads.misfit.max() < 1e-13
    assert max(worst) < 1e-12


def door(kind):
    plank = bar("door", [0, 0, 0], [1, 0, 0], 25.0)
    axis = Z if kind == "hinge" else None
    hinges = [joint(kind, "door", None, [0, 0, z], axis) for z in (-0.4, 0.4)]
    return asking(case([plank], hinges), *FIELDS_OF_JOINTS[:4])


def test_loads_that_redundant_rows_leave_open_are_flagged():
    """On two balls the horizontal forces follow from the moment of the weight, M g a / h each.

    How the two share the weight is open; two hinges share everything but their torque about the
    axis, which is 0.
    """
    with moved(door("ball"), 0.02, 0.01) as t:
        assert t.joint_force_determined[0].tolist() == [[True, True, False]] * 2
        assert t.joint_torque_determined.all()
        across = 25.0 * 9.81 * 0.5 / 0.8
        assert t.joint_force[0, :, 0] == pytest.approx([across, -across], abs=1e-10)
    with moved(door("hinge"), 0.02, 0.01) as t:
        assert not t.joint_force_determined.any()
        assert t.joint_torque_determined[0].tolist() == [[False, False, True]] * 2
    with moved(asking(SCENES["chain6"]()), 0.02, 0.01) as t:
        assert t.joint_force_determined.all()
        assert t.joint_torque_determined.all()


def test_flags_agree_with_null_vectors_of_the_laws_of_balance():
    """Bricard: loads λ with Gᵀ λ = 0, from force and torque balance of each body at the start."""
    scene = SCENES["bricard"]()
    with moved(asking(scene), 0.02, 0.01) as t:
        flags = np.concatenate([t.joint_force_determined[0], t.joint_torque_determined[0]], axis=1)
        x = np.array(t.position)[0]
    n, m = len(scene["body"]), len(scene["joint"])
    names = [table["name"] for table in scene["body"]]
    balance = np.zeros((6 * n + m, 6 * m))
    for j, table in enumerate(scene["joint"]):
        own, axis = slice(6 * j, 6 * j + 6), np.array(table["axis"])
        for name, sign in ((table["body"], 1.0), (table.get("to"), -1.0)):
            if name is not None:
                b = names.index(name)
                arm = np.array(table["at"]) - x[b]
                cross = np.cross(np.eye(3), arm).T @ np.eye(3)
                block = np.block([[np.eye(3), np.zeros((3, 3))], [-cross.T, np.eye(3)]])
                balance[6 * b : 6 * b + 6, own] += sign * block
        balance[6 * n + j, 6 * j + 3 : 6 * j + 6] = axis  # a hinge has no torque about its axis
    _, sizes, V = np.linalg.svd(balance)
    null = V[np.sum(sizes > 1e-10 * sizes[0]) :]
    assert len(null) == 1
    is_open = np.abs(null).max(axis=0).reshape(m, 6) > 1e-8
    assert (flags == ~is_open).all()
    assert is_open.any()


@pytest.mark.slow
def test_a_run_with_fields_of_joints_goes_on_bit_for_bit(tmp_path):
    scene, path = asking(SCENES["bricard"]()), tmp_path / "run.h5"
    scene["body"].append(body("wheel", 1.0, [1, 1, 1], [9, 0, 0], spin=[0, 0, -6.0]))
    scene["joint"].append(joint("hinge", "wheel", None, [9, 0, 0], Z))
    times = {"every": 0.5, "dt": 0.02}
    whole = particlerb.run({"run": {"t_end": 3.0, **times}, **scene})
    particlerb.run({"run": {"t_end": 1.5, **times}, **scene}, path).close()
    particlerb.resume(path, 3.0).close()
    with particlerb.open(path) as resumed, whole:
        for name in FIELDS_OF_JOINTS:
            assert (getattr(resumed, name) == getattr(whole, name)).all(), name
        assert whole.joint_coordinate[-1, -1] == pytest.approx(-18.0, abs=1e-11)


def test_fields_without_joints_or_coordinates_are_refused():
    single = case([bar("a", [0, 0, 0], [1, 0, 0])], [joint("ball", "a", None, [0, 0, 0])])
    with pytest.raises(CaseError, match="no joint here has a coordinate"):
        moved(asking(single, "joint_coordinate"), 0.1, 0.1)
    del single["joint"]
    with pytest.raises(CaseError, match="there is no joint_force without a"):
        moved(asking(single, "joint_force"), 0.1, 0.1, method="strang")
    with moved(single, 0.1, 0.1, method="strang") as t, pytest.raises(KeyError, match="joints"):
        _ = t.joint_names


def test_exports_hold_fields_of_joints(tmp_path):
    with moved(asking(SCENES["chain6"]()), 0.04, 0.01, every=0.02) as t:
        fields = ["joint_force", "joint_misfit"]
        export(t, tmp_path / "a.csv", "csv", fields=fields)
        rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
        assert [row["name"] for row in rows] == list(t.joint_names) * 3
        found = [[float(row[f"joint_force_{c}"]) for c in "xyz"] for row in rows]
        assert found == t.joint_force.reshape(-1, 3).tolist()
        assert [float(row["joint_misfit"]) for row in rows] == t.joint_misfit.ravel().tolist()
        export(t, tmp_path / "b.csv", "csv", fields=["joint_coordinate"])
        rows = list(csv.DictReader((tmp_path / "b.csv").read_text().splitlines()))
        assert [row["name"] for row in rows] == list(t.coordinate_names) * 3
        values = [float(row["joint_coordinate"]) for row in rows]
        assert values == t.joint_coordinate.ravel().tolist()
        export(t, tmp_path / "a.npz", "npz")
        arrays = np.load(tmp_path / "a.npz")
        assert arrays["joint_name"].tolist() == list(t.joint_names)
        assert (arrays["joint_torque"] == t.joint_torque).all()
        assert (arrays["joint_coordinate"] == t.joint_coordinate).all()


def test_a_scene_that_is_moved_by_hand_counts_turns_and_records_them(tmp_path):
    scene = spinning("hinge", [0, 0, 0], [0, 0, 5.0])
    scene["gravity"] = {"acceleration": [0.0, 0.0, -1.0]}
    times = {"t_end": 4.0, "every": 2.0, "dt": 0.1}
    with particlerb.Simulation({"run": times, **scene}, tmp_path / "a.h5") as hand:
        hand.advance(1.7)
        hand.change("gravity.acceleration", [0.0, 0.0, -2.0])
        hand.advance(4.0)
    with particlerb.open(tmp_path / "a.h5") as t:
        assert t.joint_coordinate[:, 0] == pytest.approx([0.0, 10.0, 20.0], abs=1e-11)
        assert t.joint_force[:, 0, 2] == pytest.approx([2.0, 4.0, 4.0], abs=1e-12)


def weighed(*checks):
    """A weight that hangs at rest on a hinge and a slider."""
    one = body("one", 2.0, [0.3, 0.3, 0.3], [0, 0, -1.0])
    other = body("other", 3.0, [0.3, 0.3, 0.3], [5, 0, 0])
    joints = [
        joint("hinge", "one", None, [0, 0, 0], X, name="pin"),
        joint("slider", "other", None, [5, 0, 0], Z, name="rail"),
    ]
    return case([one, other], joints, check={"value": [{"tolerance": 1e-9} | c for c in checks]})


@pytest.mark.plain
def test_what_merged_bodies_carry_follows_a_force_that_is_changed(tmp_path):
    """A cart of 2 kg pulls one of 1 kg: their joint carries a third of the force of then."""
    carts = [body("a", 2.0, [0.2] * 3, [0, 0, 0]), body("b", 1.0, [0.2] * 3, [-1, 0, 0])]
    push = {"type": "push", "body": "a", "force": [3.0, 0, 0]}
    scene = case(carts, [joint("fixed", "b", "a")], (0, 0, 0), force=[push])
    scene["run"] = {"t_end": 0.2, "every": 0.05, "dt": 0.01}
    path = tmp_path / "a.h5"
    with particlerb.Simulation(asking(scene, "joint_force"), path) as simulation:
        simulation.advance(0.1)
        simulation.change("force[0].force", [6.0, 0, 0])
        simulation.advance(0.2)
    with particlerb.open(path) as trajectory:
        along = trajectory.joint_force[:, 0, 0]
    np.testing.assert_allclose(along, [1.0, 1.0, 1.0, 2.0, 2.0], rtol=1e-12)


def test_checks_take_what_joints_carry_and_where_they_are(tmp_path):
    good = weighed(
        {"joint": "pin", "quantity": "joint_force", "value": [0, 0, 2 * 9.81]},
        {"joint": "pin", "quantity": "joint_torque", "value": [0, 0, 0]},
        {"joint": "pin", "quantity": "joint_coordinate", "value": 0.0},
        {"joint": "rail", "quantity": "joint_coordinate", "value": -9.81 / 2, "time": 1.0},
        {"joint": "rail", "quantity": "joint_coordinate", "value": [-9.81 / 8], "time": 0.5},
        {"joint": "rail", "quantity": "joint_misfit", "value": 0.0},
    )
    path = tmp_path / "run.h5"
    times = {"every": 0.25, "dt": 0.05}
    prepared = prepare(to_system({"run": {"t_end": 1.0, **times}, **good}))
    found = results(prepared.system, run_prepared(prepared, path))
    assert all(result.holds for result in found)
    assert found[3].name == "joint_coordinate of rail at 1 s"
    good["check"]["value"][0]["value"] = [0, 0, 2 * 9.82]
    prepared = prepare(to_system({"run": {"t_end": 1.0, **times}, **good}))
    found = results(prepared.system, run_prepared(prepared, None))
    assert [result.holds for result in found] == [False] + [True] * 5
    assert found[0].error == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("check", "words"),
    [
        ({"joint": "pn", "quantity": "joint_force", "value": [0, 0, 0]}, 'did you mean "pin"'),
        ({"joint": "pin", "quantity": "joint_coordinate", "value": [0, 0]}, "has 1 coordinate"),
        ({"body": "one", "quantity": "joint_force", "value": [0, 0, 0]}, "is of a joint"),
        ({"joint": "pin", "quantity": "position", "value": [0, 0, 0]}, "is of a body"),
        ({"joint": "pin", "quantity": "joint_rate", "value": [0, 0, 0]}, "needs one number"),
    ],
)
def test_checks_of_joints_that_cannot_be_are_named(check, words):
    with pytest.raises(CaseError, match=words):
        prepare(to_system({"run": {"t_end": 1.0, "every": 0.5, "dt": 0.1}, **weighed(check)}))


@pytest.mark.plain
@pytest.mark.parametrize("size", [1, 2, 3, 5])
def test_one_thread_counts_turns_however_many_share_a_mechanism(size, monkeypatch):
    """Two at once would count a turn twice."""
    counts = []
    monkeypatch.setattr(joint_stages, "meet_all", lambda team: None)
    monkeypatch.setattr(joint_stages, "count_turns", lambda *_: counts.append(1))
    run = {"t_end": 1.0, "every": 1.0, "dt": 0.1}
    prepared = prepare(to_system({"run": run, **asking(hinge_chain(3), "joint_coordinate")}))
    (group,) = prepared.plan.groups
    segment = group.segments[0]
    motion = make_motion(
        METHODS["rattle"], group.group(segment), prepared.system.state, 0.0, segment.dt, 0.0
    )
    meetings, values = np.zeros(32, dtype=np.int64), np.zeros((size, 16))
    for thread in range(size):
        team = Team(size, thread, meetings, values)
        joint_stages.drift_clusters(
            motion.jointed, team, None, motion.bodies.blocks, 0.05, 0.0, 0.1
        )
    assert counts == [1]


@pytest.mark.plain
def test_no_two_joints_have_one_name():
    """Checks and files go by names."""
    hinge = {"type": "hinge", "body": "one", "axis": Z}
    bodies = [body("one", 1.0, [0.1, 0.1, 0.1], [0, 0, 0])]
    named, run = hinge | {"name": "one-world (2)"}, {"t_end": 1.0, "every": 1.0}
    for joints, names in (
        ([named, hinge, hinge], ("one-world (2)", "one-world", "one-world (3)")),
        ([hinge, hinge, named], ("one-world", "one-world (3)", "one-world (2)")),
    ):
        assert joints_of(to_system({"run": run, **case(bodies, joints)})).names == names
