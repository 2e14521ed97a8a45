"""Mechanisms as models of MuJoCo: loaded by it, they move as here."""

import numpy as np
import pytest
from scenes import SCENES, X, Y, Z, bar, body, case, joint, moved
from test_wheels import planetary

from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.export import ExportError
from particlerb.export.mjcf_scene import mjcf_scene
from particlerb.simulation.run import prepare

OF_BALLS = 2e-7  # [m] before release 4, MuJoCo's RK4 turned balls and free bodies to order 2
STATE = ["position", "orientation", "linear_momentum", "angular_momentum"]


def in_mujoco(scene, t, dt):
    """Model, and its data after t, from the speeds at the start."""
    mujoco = pytest.importorskip("mujoco")
    times = {"t_end": t, "every": t, "dt": dt, "method": "rattle"}
    system = prepare(to_system({"run": times, **scene})).system
    model = mujoco.MjModel.from_xml_string(mjcf_scene(system, dt))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(round(t / dt)):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    names = list(system.names)
    return model, data, np.array([data.body(name).xpos for name in names])


def tree(kind, flipped, **keys):
    """A heavy base on a hinge, and a second body on a joint of a kind, from either side."""
    base = bar("base", [0, 0, 0], [0.7, 0.1, 0], 2.0, 0.2, velocity=[0, 0, 0])
    arm = body("arm", 0.8, [0.02, 0.03, 0.04], [1.0, 0.3, 0.2])
    ends = ("base", "arm") if flipped else ("arm", "base")
    return case(
        [base, arm],
        [joint("hinge", "base", None, [0, 0, 0], Y), joint(kind, *ends, [0.7, 0.1, 0.1], **keys)],
    )


TREES = {
    "ball": {},
    "hinge": {"axis": [0, 1, 0.5]},
    "slider": {"axis": [1, 0, -1]},
    "cylindrical": {"axis": [1, 0.2, -1]},
    "universal": {"axis": X, "axis_to": Z},
    "planar": {"axis": [1, 0.3, 0]},
    "fixed": {},
}


@pytest.mark.slow
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("kind", TREES)
def test_a_tree_moves_in_mujoco_as_here(kind, flipped):
    """MuJoCo's RK4 in reduced coordinates beside order 6 here."""
    scene = tree(kind, flipped, **TREES[kind])
    with moved(scene, 0.4, 0.01, "rattle6") as t:
        first, expected = np.array(t.position)[[0, -1]]
    assert np.abs(expected - first).max() > 0.3  # [m]
    model, _, found = in_mujoco(scene, 0.4, 1e-3)
    assert model.nv == 1 + {"ball": 3, "cylindrical": 2, "universal": 2, "planar": 3,
                            "fixed": 0}.get(kind, 1)  # fmt: skip
    assert model.neq == 0
    assert found == pytest.approx(expected, abs=OF_BALLS if kind == "ball" else 1e-8)


def test_coordinates_of_mujoco_are_those_of_the_file():
    scene = SCENES["chain6"]() | {"output": {"fields": [*STATE, "joint_coordinate"]}}
    with moved(scene, 0.1, 0.005, "rattle6") as t:
        angles, names, x = t.joint_coordinate[-1], t.coordinate_names, np.array(t.position)[-1]
    model, data, found = in_mujoco(scene, 0.1, 1e-3)
    assert found == pytest.approx(x, abs=1e-8)
    for name, angle in zip(names, angles, strict=True):
        assert data.joint(name.removesuffix(", angle")).qpos[0] == pytest.approx(angle, abs=1e-7)
    assert model.nbody == 7


@pytest.mark.plain
def test_speeds_at_the_start_and_free_bodies_go_along():
    bodies = [
        body("free", 1.0, [0.1, 0.2, 0.25], [0, 0, 2], [0.3, 0, 1], [1, 2, 3]),
        body("tip", 0.5, [0.1, 0.2, 0.25], [1, 0, 2], [0.3, -3.0, 3.0], [1, 2, 3]),
        body("spun", 1.0, [0.1, 0.1, 0.15], [5, 0.5, 0], [-1.0, 0, 0.7], [0, 0, 2.0]),
    ]
    joints = [
        joint("ball", "tip", "free", [0.5, 0, 2], assemble=True),
        joint("cylindrical", "spun", None, [5, 0, 0], Z),
    ]
    scene = case(bodies, joints)
    scene["body"][1]["velocity"] = [0.3, 3.0, -1.0]
    with moved(scene, 0.2, 0.01, "rattle6") as t:
        expected = np.array(t.position)[-1]
    model, _, found = in_mujoco(scene, 0.2, 1e-3)
    assert model.nv == 6 + 3 + 2
    assert found == pytest.approx(expected, abs=OF_BALLS)


@pytest.mark.parametrize(("name", "n_equalities"), [("bricard", 2), ("mixed_chain", 1)])
def test_loops_are_closed_by_equalities(name, n_equalities):
    """MuJoCo keeps them softly: 2e-3 m is what its `connect` is good for."""
    scene = SCENES[name]()
    with moved(scene, 0.2, 0.01, "rattle6") as t:
        expected = np.array(t.position)[-1]
    model, _, found = in_mujoco(scene, 0.2, 5e-4)
    assert model.neq == n_equalities
    assert np.abs(expected - np.array([b["position"] for b in scene["body"]])).max() > 0.02
    assert found == pytest.approx(expected, abs=2e-3)


def on_wheels(kind):
    """Weights out of balance on two gears, a weight that pulls a rack, a nut beside its screw."""
    if kind == "screw":
        nut = body("nut", 2, [0.2, 0.2, 0.3], [0.1, 0, 1])
        return case([nut], [joint("screw", "nut", None, [0, 0, 1], Z, lead=1.2)])
    first = body("a", 1, [0.1, 0.1, 0.2], [0.2, 0, 0])
    hinge = joint("hinge", "a", None, [0, 0, 0], Y)
    if kind == "gear":
        bodies = [first, body("b", 2, [0.2, 0.2, 0.3], [0.5, 0, 0.1])]
        flipped = joint("hinge", "b", None, [0.5, 0, 0], [0, -1, 0])
        gear = joint("gear", "a", "b", [0, 0, 0], Y, at_to=[0.5, 0, 0], teeth=[20, 30])
        return case(bodies, [hinge, flipped, gear])
    bodies = [first, body("b", 2, [0.2, 0.2, 0.3], [-0.2, 0, 0])]
    slider = joint("slider", "b", None, [-0.2, 0, 0], Z)
    rack = joint("rack", "a", "b", [0, 0, 0], Y, axis_to=[0, 0, -1], at_to=[-0.2, 0, 0])
    return case(bodies, [hinge, slider, rack])


@pytest.mark.plain
@pytest.mark.parametrize("kind", ["gear", "rack", "screw"])
def test_what_rolls_is_an_equality_of_two_coordinates(kind):
    """MuJoCo keeps it softly; without it bodies would be more than 0.1 m elsewhere."""
    scene = on_wheels(kind)
    with moved(scene, 0.3, 0.01, "rattle6") as t:
        expected = np.array(t.position)[-1]
    model, _, found = in_mujoco(scene, 0.3, 2e-4)
    assert (model.nv, model.neq) == (2, 1)
    assert found == pytest.approx(expected, abs=1e-3)
    start = np.array([b["position"] for b in scene["body"]])
    assert np.abs(expected - start).max() > 0.05


def test_a_planetary_gear_turns_in_mujoco_by_the_equation_of_willis():
    """Coordinates of hinges on a carrier that turns: of the planet, the sun and the ring."""
    mujoco = pytest.importorskip("mujoco")
    scene = planetary(sun_on_carrier=True)
    model, data, _ = in_mujoco(scene, 0.5, 2e-4)
    assert (model.nv, model.neq) == (3, 2)
    spins = np.zeros((3, 6))
    for k, name in enumerate(("sun", "carrier", "planet")):
        which = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, which, spins[k], 0)
    assert spins[:, 2] == pytest.approx([7, 2, 2 - 60 / 18 * 2], abs=1e-3)


def test_what_mujoco_cannot_hold_is_named():
    two = [bar("a", [0, 0, 0], [1, 0, 0]), bar("b", [1, 0, 0], [2, 0, 0])]
    joints = [joint("slider", "a", None, [0, 0, 0], Z), joint("slider", "b", "a", [1, 0, 0], Z),
              joint("slider", "b", None, [2, 0, 0], Z)]  # fmt: skip
    with pytest.raises(ExportError, match="b-world closes a loop: MuJoCo has no slider"):
        mjcf_scene(
            prepare(to_system({"run": {"t_end": 1, "every": 1}, **case(two, joints)})).system
        )
    with pytest.raises(ExportError, match="sun-planet is a gear, and no third body has both"):
        mjcf_scene(prepare(to_system({"run": {"t_end": 1, "every": 1}, **planetary()})).system)
    point = {"name": "p", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    table = {"type": "distance", "body": "p", "at_to": [0, 0, 1]}
    with pytest.raises(ExportError, match="p is a point"):
        mjcf_scene(prepare(to_system({"run": {"t_end": 1, "every": 1}, **case([point], [table])}))
                  .system)  # fmt: skip


def test_the_command_writes_the_mechanism_of_a_case(tmp_path, capsys):
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "a.xml"
    assert main(["export", "door", "--to", "mjcf", "-o", str(path)]) == 0
    assert "written" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nv, model.neq) == (1, 2)
    assert (
        main(["export", "door", "--to", "mjcf", "--bodies", "door", "-o", str(path), "--overwrite"])
        == 0
    )
    assert mujoco.MjModel.from_xml_path(str(path)).nv == 6
