"""What cases say of joints: messages, the plan, assembly, chains, resuming, threads."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from holds import misfits
from numba import typeof
from scenes import SCENES, Y, bar, body, case, joint, moved

import particlerb
from particlerb import CaseError, RunError
from particlerb.case.to_system import to_system
from particlerb.forces.links import WORLD
from particlerb.plan.joint_ends import ends_of
from particlerb.simulation.run import prepare

RUN = {"t_end": 1.0, "every": 0.1}
CASES = Path(__file__).parents[2] / "cases"


def prepared(scene, **keys):
    return prepare(to_system({"run": {"t_end": 1.0, "every": 0.1} | keys, **scene}))


def joint_line(scene):
    lines = prepared(scene).text.splitlines()
    return next(line for line in lines if line.startswith("  joints"))


def rods(*joints, n=2):
    bodies = [bar(f"b{k}", [k, 0, 0], [k + 1, 0, 0]) for k in range(n)]
    return case(bodies, list(joints))


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ({"type": "ball", "body": "b0", "to": "b0"}, "joint[0].to", "ties b0 to itself"),
        ({"type": "ball", "body": "b7"}, "joint[0].body", "there is no body"),
        ({"type": "hinge", "body": "b0"}, "joint[0].axis", "a hinge joint needs one"),
        ({"type": "ball", "body": "b0", "axis": [0, 0, 1]}, "joint[0].axis", "has none"),
        ({"type": "distance", "body": "b0"}, "joint[0].at_to", "missing"),
        ({"type": "belt", "body": "b0"}, "joint[0].type", "belt"),
        ({"type": "hinge", "body": "b0", "axis": [0, 0, 0]}, "joint[0].axis", "not a direction"),
        ({"type": "ball", "body": ["b0", "b1"], "to": ["b0", "b1", "b0"]}, "joint[0].to", "pairs"),
        ({"type": "ball", "body": ["b0", "b1"], "chain": True, "to": "b1"}, "joint[0].to", "chain"),
        ({"type": "distance", "body": "b0", "at": [0, 0, 0], "at_to": [0, 0, 0]}, "joint[0]",
         "has no length"),
        ({"type": "ball", "body": "b0", "at": [0, 0, 0], "at_to": [0, 0, 0.1]}, "joint[0]",
         "b0-world does not fit where its bodies start"),
    ],
)  # fmt: skip
def test_a_joint_that_cannot_be_is_named(table, key, words):
    with pytest.raises(CaseError) as caught:
        prepared(rods(table))
    assert key in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize("is_framed", [False, True])
@pytest.mark.parametrize("size", [2.0**-1030, 2.0**-700, 2.0**700, 2.0**1023])
def test_an_axis_may_have_any_length(size, is_framed):
    """Also one whose square is no number, and a power of two changes no bit."""
    found = []
    for a in (1.0, size):
        axis = {"body": [-a, a, 0.5 * a]} if is_framed else [-a, a, 0.5 * a]
        scene = rods({"type": "hinge", "body": "b0", "axis": axis})
        scene["body"][0]["orientation"] = [0.5, 0.5, 0.5, -0.5]
        system = to_system(scene | {"run": RUN})
        ends = ends_of(system, system.joint[0], np.array([0]), np.array([WORLD]))
        found.append(ends.directions_a["n"])
    assert np.array_equal(*found)
    assert np.linalg.norm(found[0]) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.plain
def test_light_bodies_in_a_closed_loop_are_as_good_as_none():
    """Rows whose pivots are 1e-9 of their diagonal, or less, are no redundant ones for that."""
    places = []
    for mass in (1e-7, 1e-9, 1e-11):
        source = tomllib.loads((CASES / "ladder.toml").read_text())
        for table in source["body"]:
            table["mass"] = mass if table["mass"] < 1 else table["mass"]
        del source["check"]
        source["run"] |= {"t_end": 0.02, "every": 0.01}
        source["output"] = {"fields": ["position", "joint_force"]}
        with particlerb.run(source) as trajectory:
            places.append(np.array(trajectory.position))
    assert np.abs(places[1] - places[0]).max() < 1e-9
    assert np.abs(places[2] - places[1]).max() < 1e-11


@pytest.mark.plain
def test_a_poor_guess_of_the_impulses_does_not_end_in_another_branch():
    """Overdamped dashpots let impulses ring: residuals begin near 1, where nothing is mixed."""
    source = tomllib.loads((CASES / "governor.toml").read_text())
    del source["check"]
    source["run"] |= {"t_end": 0.02, "every": 4e-3}
    with particlerb.run(source) as trajectory:
        moved_by = np.diff(np.array(trajectory.position)[:, 1, 2])
    assert np.abs(moved_by).max() < 5e-4


def test_joints_of_one_name_are_refused():
    tables = [joint("ball", f"b{k}", None, [k, 0, 0], name="pin") for k in range(2)]
    with pytest.raises(CaseError, match="is the name of joint"):
        prepared(rods(*tables))


def test_a_rod_is_not_asked_for_a_torque_about_its_axis():
    shape = {"type": "rod", "length": 1.0, "n": 5}
    rod = {"name": "rod", "shape": shape, "mass": 1.0, "position": [0.0, 0.0, 0.5]}
    prepared(case([rod], [joint("ball", "rod")]))
    message = "rod-world would turn rod, a rod that has no inertia(.|\n)*hint: give it a width"
    with pytest.raises(CaseError, match=message):
        prepared(case([rod], [joint("hinge", "rod", None, [0, 0, 0], [0, 1, 0])]))


def test_jointed_bodies_are_not_pushed_apart_and_have_ends_that_move():
    contact = {"stiffness": 1e4, "restitution": 0.5, "friction": 0.0}
    ball = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
    bodies = [ball | {"name": f"b{k}", "position": [k, 0, 0]} for k in range(2)]
    scene = case(bodies, [joint("ball", "b0", "b1")], contact=contact | {"relax": True})
    with pytest.raises(CaseError, match="bodies that joints hold are not pushed apart"):
        prepared(scene)
    bodies = [table | {"fixed": True} for table in bodies]
    bodies.append(ball | {"name": "free", "position": [0, 3.0, 0]})
    with pytest.raises(CaseError, match="b0 is fixed or driven, and so is the other side"):
        prepared(case(bodies, [joint("ball", "b0", "b1")], contact=contact))
    motion = {"velocity": [0.1, 0, 0]}
    bodies[1] = ball | {"name": "b1", "position": [1.0, 0, 0], "motion": motion}
    with pytest.raises(CaseError, match="b1 is fixed or driven, and so is the other side"):
        prepared(case(bodies, [joint("ball", "b1", "b0")], contact=contact))


def test_impulses_on_jointed_bodies_are_refused():
    scene = rods(joint("ball", "b0"))
    impulse = {"type": "impulse", "impulse": [0, 0, 1.0], "time": 0.1}
    prepared({**scene, "force": [impulse | {"body": "b1"}]})
    with pytest.raises(CaseError, match=r"force\[0\].body: an impulse on a body that a joint"):
        prepared({**scene, "force": [impulse | {"body": "b0"}]})


@pytest.mark.parametrize(("method", "force"), [("strang", None), ("rattle6", "torque"),
                                               ("rattle4", "drag")])  # fmt: skip
def test_methods_that_cannot_keep_joints_say_so(method, force):
    scene = rods(joint("ball", "b0"), n=1)
    if force == "drag":
        scene["force"] = [{"type": "drag", "body": "b0", "translation": 0.1}]
    if force == "torque":
        field = {"type": "field", "body": "b0", "field": [1.0, 0, 0], "charge": 1.0}
        scene["force"] = [field | {"angular_velocity": [0, 0, 1.0]}]
    with pytest.raises(CaseError, match="does not accept what acts here"):
        prepared(scene, method=method)


def test_the_plan_counts_rows_and_names_those_that_depend_on_others():
    line = joint_line(SCENES["bricard"]())
    assert "5 bodies in 1 cluster, 30 rows, 1 of them redundant" in line
    assert "b0-world, b1-b0" in line
    assert line.endswith("1 degree of freedom")
    assert joint_line(SCENES["chain6"]()).endswith("30 rows; 6 degrees of freedom")
    assert "22 rows; 8 degrees" in joint_line(SCENES["mixed_chain"]())


def test_the_plan_of_a_door_on_two_hinges_names_both():
    door = bar("door", [0, 0, 0], [1, 0, 0])
    hinges = [joint("hinge", "door", None, [0, 0, z], [0, 0, 1], name=name)
              for z, name in ((-0.4, "lower"), (0.4, "upper"))]  # fmt: skip
    line = joint_line(case([door], hinges))
    assert "10 rows, 5 of them redundant among those of lower, upper" in line
    assert line.endswith("; 1 degree of freedom")


def test_bodies_are_assembled_where_that_is_allowed():
    tables = [
        joint("ball", "b0", None, [0, 0, 0]),
        joint("hinge", "b1", "b0", [1, 0, 0], Y, at_to=[1.0, 0.01, 0.02], assemble=True),
    ]
    scene = rods(*tables)
    assert "until all joints fit" in prepared(scene).text
    with moved(scene, 0.02, 0.01, every=0.01) as trajectory:
        x, q = np.array(trajectory.position), np.array(trajectory.orientation)
    for k in range(3):
        ends = [
            end_of(x[k, b], q[k, b], at) for b, at in ((1, [-0.5, 0, 0]), (0, [0.5, 0.01, 0.02]))
        ]
        assert ends[0] == pytest.approx(ends[1], abs=1e-14)
        assert end_of(x[k, 0], q[k, 0], [-0.5, 0, 0]) == pytest.approx(np.zeros(3), abs=1e-14)


def end_of(x, q, at):
    at = np.array(at)
    return x + at + 2 * q[0] * np.cross(q[1:], at) + 2 * np.cross(q[1:], np.cross(q[1:], at))


def test_velocities_that_break_a_joint_are_refused_or_projected():
    scene = rods(joint("ball", "b0"), n=1)
    scene["body"][0]["angular_velocity"] = [0.0, 0.0, 1.0]
    with pytest.raises(CaseError, match="b0-world is broken by the velocities"):
        prepared(scene)
    scene["joint"][0]["assemble"] = True
    system = prepared(scene).system
    v, w = system.state.p[:, 0], system.state.L[:, 0] / (1.01 / 12)
    assert v == pytest.approx(np.cross(w, [0.5, 0, 0]), abs=1e-14)
    # L about the pivot stays: I w = (I + m a²) w'
    assert w[2] == pytest.approx(1.01 / 12 / (1.01 / 12 + 0.25), rel=1e-12)


def test_no_pose_meets_two_distances_that_are_too_short():
    tables = [
        {"type": "ball", "body": "b0", "at": {"body": [-0.5, 0.0, 0.0]}, "at_to": [0.0, 0.0, 0.0]},
        {"type": "ball", "body": "b0", "at": {"body": [0.5, 0.0, 0.0]}, "at_to": [2.0, 0.0, 0.0]},
    ]
    with pytest.raises(CaseError, match="no pose near the start meets b0-world"):
        prepared(rods(*(table | {"assemble": True} for table in tables), n=1))


def chain(n):
    link = {"name": "link", "shape": {"type": "moments", "inertia": [1e-3, 2e-3, 2.5e-3]},
            "mass": 0.1, "count": n}  # fmt: skip
    link["position"] = [[0.1 * k + 0.05, 0.0, 0.0] for k in range(n)]
    here, there = {"body": [-0.05, 0.0, 0.0]}, {"body": [0.05, 0.0, 0.0]}
    return case([link], [
        {"type": "ball", "body": "link[0]", "at": here},
        {"type": "ball", "body": "link", "chain": True, "at": here, "at_to": there},
    ])  # fmt: skip


def test_a_chain_ties_each_link_to_the_one_before():
    scene = chain(5)
    assert "5 ball; 5 bodies in 1 cluster, 15 rows; 15 degrees of freedom" in joint_line(scene)
    single = [joint("ball", "link[0]", None, [0, 0, 0])]
    single += [joint("ball", f"link[{k}]", f"link[{k - 1}]", [0.1 * k, 0, 0]) for k in range(1, 5)]
    with moved(scene, 0.05, 0.01) as one, moved({**scene, "joint": single}, 0.05, 0.01) as other:
        assert np.array(one.position) == pytest.approx(np.array(other.position), abs=1e-13)
        assert misfits(one, single)[0] < 1e-13


def test_a_mechanism_moves_as_if_its_neighbours_were_not_there():
    def pendulums(spins):
        bob = body("bob", 1.0, [0.1, 0.2, 0.25], [0.5, 0, 0])
        bob |= {"count": len(spins), "position": [[0.5, 0.0, 0.0]] * len(spins)}
        bob["angular_velocity"] = [[0.0, spin, 0.0] for spin in spins]
        bob["velocity"] = [[0.0, 0.0, -0.5 * spin] for spin in spins]
        at = {"body": [-0.5, 0.0, 0.0]}
        return case([bob], [joint("hinge", "bob", None, [0, 0, 0], Y) | {"at": at}])

    single = moved(pendulums([0.0]), 0.3, 0.01)
    with moved(pendulums([0.0, 9.0, 0.0]), 0.3, 0.01) as many, single as alone:
        x = np.array(many.position)[-1]
        assert (x[2] == x[0]).all()
        assert (x[0] == np.array(alone.position)[-1, 0]).all()
        assert np.abs(x[1] - x[0]).max() > 0.1


def test_a_lost_joint_ends_the_run_with_its_name_and_keeps_the_frames_before(tmp_path):
    scene = chain(4)
    scene["body"][0]["velocity"] = [[0.0, 60.0 * (k + 0.5), 0.0] for k in range(4)]
    scene["body"][0]["angular_velocity"] = [0.0, 0.0, 600.0]
    path = tmp_path / "lost.h5"
    with pytest.raises(RunError, match=r"by t = .* s .* for the tension of joint link\["):
        particlerb.run({"run": {"t_end": 1.0, "every": 0.1, "dt": 0.02}, **scene}, path)
    with particlerb.open(path) as trajectory:
        assert trajectory.n_frames >= 1
        assert np.isfinite(np.array(trajectory.position)).all()


def test_a_run_goes_on_bit_for_bit(tmp_path):
    scene, path = SCENES["bricard"](), tmp_path / "run.h5"
    times = {"every": 0.03, "dt": 0.01}
    particlerb.run({"run": {"t_end": 0.09, **times}, **scene}, path).close()
    particlerb.resume(path, 0.21).close()
    whole = particlerb.run({"run": {"t_end": 0.21, **times}, **scene})
    with particlerb.open(path) as resumed, whole:
        assert (np.array(resumed.position) == np.array(whole.position)).all()
        assert (np.array(resumed.angular_momentum) == np.array(whole.angular_momentum)).all()


def test_the_world_counts_what_it_gives_through_joints():
    with moved(SCENES["chain6"](), 0.2, 0.005, every=0.05) as trajectory:
        ledger = trajectory.ledger
        assert np.abs(ledger.linear_momentum_error).max() < 1e-13
        assert np.abs(ledger.angular_momentum_error).max() < 1e-13


def test_what_compiled_code_knows_of_mechanisms_is_the_same_with_springs_drives_and_coordinates():
    """Each type of its own would cost half a minute of compiling."""
    types = set()
    hinge = {"type": "hinge", "body": "b0", "axis": Y}
    fields = {"output": {"fields": ["position", "joint_coordinate"]}}
    driven = {"drive": {"position": [[0, 0], [0.5, 0.1], [1.0, 0.3]]}}
    sprung = {"spring": {"stiffness": 2.0}}
    for own, more in (({}, {}), (sprung, {}), ({}, fields), (driven, fields)):
        groups = prepared(rods(hinge | own, n=1) | more).plan.groups
        found = [group.segments[0].terms.joints for group in groups]
        types.update(typeof(joints) for joints in found if joints is not None)
    assert len(types) == 1
