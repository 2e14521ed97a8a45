"""Whole scenes as inputs of LAMMPS and models of MuJoCo: run there, they move as here."""

import math
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import tomlkit

import particlerb
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.export import ExportError
from particlerb.export.bodies import possible
from particlerb.export.lammps_scene import lammps_scene
from particlerb.export.mjcf_scene import mjcf_scene
from particlerb.export.scene import step_of
from particlerb.simulation.run import prepare

WEIGHT = {"acceleration": [0.3, 0.0, -9.81]}
CLUMP = {
    "type": "points",
    "mass": [1.0, 1.0, 0.5],
    "radius": 0.1,
    "position": [[-0.1, -0.1, -0.1], [0.1, 0.1, -0.05], [0, 0.05, 0.15]],
}
FREE = {
    "run": {"t_end": 1.0, "every": 0.5, "dt": 5e-4},
    "gravity": WEIGHT,
    "body": [
        {
            "name": "clump", "shape": CLUMP, "count": 2, "position": [[0, 0, 1], [1, 0, 1]],
            "velocity": [0.1, 0.2, 3.0], "angular_velocity": [1.0, 2.0, 3.0],
            "orientation": [0.5, 0.1, -0.7, 0.3],
        },
        {
            "name": "ball", "shape": {"type": "ball", "radius": 0.1}, "mass": 1.0,
            "position": [0, 3, 1], "velocity": [0.0, 1.0, 0.0], "angular_velocity": [4.0, 0, 1.0],
        },
    ],
}  # fmt: skip
FALL, SPEED, STIFFNESS = 0.002, 1.3, 1e5
HIT = {
    "run": {"t_end": 0.02, "every": 5e-5, "dt": 5e-6},
    "contact": {"law": "hooke", "stiffness": STIFFNESS, "restitution": 0.6, "friction": 0.4},
    "body": [
        {
            "name": "ball", "shape": {"type": "ball", "radius": 0.1}, "mass": 2.0,
            "position": [0, 0, 0.1 + FALL], "velocity": [0, 0, -SPEED],
        },
        {
            "name": "post", "shape": {"type": "ball", "radius": 0.1}, "mass": 1.0,
            "position": [0.5, 0, 0.1], "fixed": True,
        },
    ],
    "wall": [{"name": "bin", "type": "box", "lower": [-1, -1, 0], "upper": [1, 1, 1],
              "open": ["+z"]}],
}  # fmt: skip
CORNERS = (0.1 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)).tolist()
REST = {
    "run": {"t_end": 2.0, "every": 2.0, "dt": 1e-3},
    "gravity": {"acceleration": [0, 0, -9.81]},
    "contact": {"law": "hooke", "stiffness": 1e4, "restitution": 0.3, "friction": 0.4},
    "body": [{"name": "brick", "position": [0, 0, 0.21],
              "shape": {"type": "points", "mass": 1.0, "radius": 0.1, "position": CORNERS}}],
    "wall": [{"name": "floor", "type": "plane", "normal": [0, 0, 1]}],
}  # fmt: skip


def made(scene):
    """A scene made ready, and its step."""
    prepared = prepare(to_system(scene))
    return prepared.system, step_of(prepared)


def set_up(engine, scene, folder, monkeypatch):
    """Give LAMMPS all commands of a scene but the run; its number of steps."""
    texts = lammps_scene(*made(scene), "scene")
    for suffix, text in texts.items():
        (folder / f"scene{suffix}").write_text(text)
    monkeypatch.chdir(folder)
    *commands, run = texts[".in"].splitlines()
    for line in commands:
        engine.command(line)
    return int(run.split()[1])


def atoms(engine, name):
    """A property of all atoms, in the order of the file."""
    order = np.argsort(engine.numpy.extract_atom("id")[: engine.extract_setting("nlocal")])
    return np.array(engine.numpy.extract_atom(name)[: order.size])[order]


def test_free_bodies_move_in_lammps_as_here(lammps, tmp_path, monkeypatch):
    steps = set_up(lammps, FREE, tmp_path, monkeypatch)
    lammps.command(f"run {steps}")
    expected = particlerb.run(FREE).particle_positions(-1)
    assert np.abs(atoms(lammps, "x") - expected).max() < 1e-6
    assert (tmp_path / "scene.lammpstrj").exists()
    assert (tmp_path / "scene.bodies").read_text().count("ITEM: TIMESTEP") == 3


THIN = [
    {"name": "rod", "shape": {"type": "rod", "length": 1.0, "arrangement": "exact"}, "mass": 1.0,
     "velocity": [0, 1.0, 0], "angular_velocity": [1.0, 2.0, 0]},
    {"name": "plate", "position": [9, 0, 0], "angular_velocity": [1.0, 2.0, 3.0],
     "shape": {"type": "points", "position": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "mass": 1.0}},
    {"name": "point", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": 1.0},
     "position": [0, 5, 0], "velocity": [1.0, 0, 0]},
]  # fmt: skip


@pytest.mark.parametrize("bodies", [*([body] for body in THIN), THIN], ids=lambda b: str(len(b)))
def test_bodies_without_a_radius_move_in_lammps_as_here(lammps, tmp_path, monkeypatch, bodies):
    """Its lists of neighbours are cut to the room that there is."""
    scene = {"run": FREE["run"] | {"t_end": 0.1, "every": 0.1}, "gravity": WEIGHT, "body": bodies}
    steps = set_up(lammps, scene, tmp_path, monkeypatch)
    lammps.command(f"run {steps}")
    expected = particlerb.run(scene).particle_positions(-1)
    assert np.abs(atoms(lammps, "x") - expected).max() < 1e-6


@pytest.mark.parametrize("stem", ["a brick", "brick's $x", 'a "brick" # 1'])
def test_an_input_runs_in_lammps_whatever_things_are_called(lammps, tmp_path, monkeypatch, stem):
    """A line that ends in `&` goes on in the next one: the floor would hold nothing."""
    run = REST["run"] | {"t_end": 0.5, "every": 0.5}
    scene = REST | {"title": "a brick &\nits floor &", "run": run}
    scene |= {"wall": [REST["wall"][0] | {"name": "floor &"}]}
    monkeypatch.chdir(tmp_path)
    for suffix, text in lammps_scene(*made(scene), stem).items():
        Path(f"{stem}{suffix}").write_text(text)
    lammps.file(f"{stem}.in")
    assert atoms(lammps, "x")[:, 2].min() > 0.09
    assert Path(f"{stem}.lammpstrj").exists()


@pytest.mark.parametrize("stem", ["a*", "100%", "two\nlines", 'brick\'s "a"'])
def test_a_name_that_lammps_would_read_as_another_is_refused(stem):
    with pytest.raises(ExportError, match="give another name"):
        lammps_scene(*made(REST), stem)


def test_the_first_impact_in_lammps_has_the_same_largest_force(lammps, tmp_path, monkeypatch):
    """Against the closed form of the damped spring that starts with SPEED."""
    steps = set_up(lammps, HIT, tmp_path, monkeypatch)
    forces = []
    for _ in range(steps // 10):
        lammps.command("run 10 post no")
        forces.append(atoms(lammps, "f")[0, 2])
    rate = math.sqrt(STIFFNESS / 2.0)
    fields = [*particlerb.run(FREE).fields, "wall_force"]
    here = particlerb.run(HIT | {"output": {"fields": fields}})
    largest = float(-here.wall_force[:, 0, 2].min())
    assert largest == pytest.approx(2.0 * rate * SPEED, rel=0.25)
    assert max(forces) == pytest.approx(largest, rel=0.01)
    assert atoms(lammps, "v")[0, 2] == pytest.approx(0.6 * SPEED, rel=0.01)
    assert atoms(lammps, "x")[1].tolist() == [0.5, 0.0, 0.1]


def in_mujoco(scene):
    """Positions and orientations of bodies at the end."""
    mujoco = pytest.importorskip("mujoco")
    system, step = made(scene)
    model = mujoco.MjModel.from_xml_string(mjcf_scene(system, step))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    for _ in range(round(system.run.t_end / step)):
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    bodies = [data.body(name) for name in system.names]
    return np.array([b.xpos for b in bodies]), np.array([b.xquat for b in bodies])


def test_free_bodies_move_in_mujoco_as_here():
    position, orientation = in_mujoco(FREE)
    here = particlerb.run(FREE)
    assert np.abs(position - here.position[-1]).max() < 1e-12
    there = orientation * np.sign((orientation * here.orientation[-1]).sum(axis=1))[:, None]
    angle = 2.0 * np.linalg.norm(there - here.orientation[-1], axis=1)
    assert angle.max() < 5e-7  # 2.1e-7 in MuJoCo 3.2, whose RK4 turns bodies by the second order


def test_mujoco_takes_plates_whose_moments_are_a_sum():
    """A + B = C, but for rounding, on whatever axis C comes."""
    for turn in ([1, 0, 0, 0], [1, 1, 0, 0], [0.5, 0.1, -0.7, 0.3]):
        plate = {"name": "plate", "orientation": turn, "angular_velocity": [1.0, 2.0, 3.0]}
        points = [[0.1, 0.2, 0.3], [1.1, 0.3, 0.1], [0.4, 1.2, -0.3]]
        plate["shape"] = {"type": "points", "position": points, "mass": 1.0}
        scene = {"run": FREE["run"] | {"t_end": 0.1, "every": 0.1}, "body": [plate]}
        _, orientation = in_mujoco(scene)
        there = particlerb.run(scene).orientation[-1]
        assert abs(abs(float((orientation * there).sum())) - 1.0) < 1e-12


def test_no_moment_is_above_the_sum_of_the_others():
    """Eigenvalues of a plate may be, by a rounding that differs from processor to processor."""
    for k in range(3):
        moments = np.roll([0.3, 0.2, np.nextafter(0.3 + 0.2, 1.0)], k)
        assert possible(moments).tolist() == np.roll([0.3, 0.2, 0.3 + 0.2], k).tolist()


def test_a_brick_rests_in_mujoco_at_the_height_of_its_springs():
    position, _ = in_mujoco(REST)
    sinks = 8.0 * 9.81 / (4 * 1e4)
    assert position[0, 2] == pytest.approx(0.2 - sinks, abs=0.015 * sinks)
    assert np.abs(position[0, :2]).max() < 1e-4


ANCHOR = {"type": "spring", "body": "ball", "anchor": [0.1, 3.0, 2.0], "stiffness": 40.0,
          "rest_length": 0.8}  # fmt: skip
TIE = {"type": "spring", "body": "clump[0]", "to": "clump[1]", "at": [0, 0, 0.15],
       "to_at": [0.1, 0, 0], "stiffness": 30.0, "damping": 1.0, "rest_length": 0.9}  # fmt: skip


@pytest.mark.plain
def test_springs_pull_in_mujoco_as_here():
    scene = FREE | {"force": [ANCHOR, TIE], "run": FREE["run"] | {"method": "rk4"}}
    position, _ = in_mujoco(scene)
    here = particlerb.run(scene).position[-1]
    assert np.abs(here - particlerb.run(FREE).position[-1]).min(axis=1).max() > 0.01
    assert np.abs(position - here).max() < 1e-6


def test_a_tether_pulls_in_lammps_and_a_hollow_ball_falls(lammps, tmp_path, monkeypatch):
    matter = {"shape": {"type": "shell", "radius": 0.1}, "mass": 2.0}
    surface = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 0.0}
    hollow = {"name": "hollow", "position": [0, 5, 1], "part": [matter, surface]}
    scene = FREE | {"force": [ANCHOR], "body": [*FREE["body"][1:], hollow]}
    assert "left out" not in lammps_scene(*made(scene), "scene")[".in"]
    steps = set_up(lammps, scene, tmp_path, monkeypatch)
    lammps.command(f"run {steps}")
    here = particlerb.run(scene)
    assert np.abs(atoms(lammps, "x")[:2] - here.position[-1]).max() < 1e-6
    both = FREE | {"force": [ANCHOR, TIE]}
    assert "# left out: force[1], spring" in lammps_scene(*made(both), "scene")[".in"]


def test_a_joint_may_have_the_name_of_a_body_in_mujoco():
    """There a free body has a joint too."""
    shape = {"type": "ball", "radius": 0.1}
    bar = {"name": "bar", "shape": shape, "mass": 1.0, "position": [9, 0, 0]}
    hinge = {"name": "ball", "type": "hinge", "body": "bar", "at": [9, 0, 1], "axis": [0, 1, 0]}
    position, _ = in_mujoco(FREE | {"body": [*FREE["body"], bar], "joint": [hinge]})
    assert np.linalg.norm(position[3] - [9, 0, 1]) == pytest.approx(1.0, abs=1e-9)


BLOCK = {"type": "box", "size": [0.3, 0.1, 0.2], "arrangement": "exact"}
ACTED = [
    {"type": "hinge", "body": "a", "at": [0, 0, 0], "axis": [0, 1, 0], "damper": 0.05,
     "spring": {"stiffness": 3.0, "rest": 0.4}},
    {"type": "slider", "body": "a", "to": "b", "axis": [1, 0, 0], "motor": 2.0, "damper": 0.3,
     "spring": {"stiffness": 40.0, "rest": -0.05}},
    {"type": "ball", "body": "c", "to": "b", "at": [0.6, 0, 0], "damper": 0.02,
     "spring": {"stiffness": 1.5}},
]  # fmt: skip


@pytest.mark.plain
def test_what_acts_in_joints_acts_in_mujoco_as_here():
    """A slider whose first body is the inner one: its coordinate turns round in MuJoCo's tree."""
    bodies = [{"name": n, "shape": BLOCK, "mass": 1.0, "position": [x, 0, 0]}
              for n, x in (("a", 0.15), ("b", 0.45), ("c", 0.75))]  # fmt: skip
    run = {"t_end": 0.2, "every": 0.2, "dt": 5e-4}
    scene = {"run": run, "gravity": WEIGHT, "body": bodies, "joint": ACTED}
    assert "left out" not in mjcf_scene(*made(scene))
    position, _ = in_mujoco(scene)
    by_dop853 = {"t_end": 0.2, "every": 0.2, "method": "dop853", "tolerance": 1e-10}
    here = particlerb.run(scene | {"run": by_dop853}).position[-1]
    bare = [{k: v for k, v in j.items() if k not in ("spring", "damper", "motor")} for j in ACTED]
    assert np.abs(in_mujoco(scene | {"joint": bare})[0] - here).max() > 0.01
    assert np.abs(position - here).max() < 1e-6


def test_a_motor_a_stop_and_friction_act_in_mujoco():
    """0.5 N m bring a block of moment I to 2 rad/s, which it keeps; it ends at its stop."""
    inertia = (0.3**2 + 0.2**2) / 12.0 + 0.15**2  # kg m², about the hinge
    block = {"name": "a", "shape": BLOCK, "mass": 1.0, "position": [0.15, 0, 0], "contact": False}
    hinge = {"name": "knee", "type": "hinge", "body": "a", "at": [0, 0, 0], "axis": [0, 1, 0]}
    scene = {
        "run": {"t_end": 0.4, "every": 0.4, "dt": 1e-3},
        "contact": {"law": "impulse", "restitution": 0.0, "friction": 0.0},
        "body": [block],
        "wall": REST["wall"],
    }

    def angle(**acting):
        (x, _, z), *_ = in_mujoco(scene | {"joint": [hinge | acting]})[0]
        return math.atan2(-z, x)

    motor = {"speed": 2.0, "largest": 0.5}
    faster = 0.5 / inertia  # rad/s²
    assert angle(motor=motor) == pytest.approx(2.0 * 0.4 - 2.0**2 / (2.0 * faster), rel=3e-3)
    assert angle(motor=motor, limit={"range": [-0.1, 0.3]}) == pytest.approx(0.3, abs=2e-3)
    slower = (0.5 - 0.2) / inertia
    turned = 2.0 * 0.4 - 2.0**2 / (2.0 * slower)
    assert angle(motor=motor, friction=0.2) == pytest.approx(turned, rel=0.01)
    bouncy = hinge | {"limit": {"range": [-1, 1], "restitution": 0.5}}
    assert "left out: limit of knee " in mjcf_scene(*made(scene | {"joint": [bouncy]}))
    dashes = mjcf_scene(*made(scene | {"joint": [bouncy | {"name": "a---b"}]}))
    assert ET.fromstring(dashes).tag == "mujoco"


def test_fixed_bodies_and_boxes_stand_in_mujoco():
    position, _ = in_mujoco(HIT | {"gravity": WEIGHT, "run": {"t_end": 1.0, "every": 1.0,
                                                              "dt": 1e-3}})  # fmt: skip
    assert position[1] == pytest.approx([0.5, 0.0, 0.1])
    assert 0.095 < position[0, 2] < 0.11
    outside = {"name": "block", "type": "box", "lower": [-1, -1, -1], "upper": [1, 1, 0],
               "inside": False}  # fmt: skip
    position, _ = in_mujoco(REST | {"wall": [outside]})
    assert position[0, 2] == pytest.approx(0.198, abs=1e-3)


def test_jointed_bodies_beside_contact_do_not_touch_each_other_in_mujoco():
    """A bar of two overlapping bricks, hinged together, falls freely: nothing pushes them apart."""
    other = REST["body"][0] | {"name": "other", "position": [0.05, 0, 3.0]}
    bricks = [REST["body"][0] | {"position": [0, 0, 3.0]}, other]
    hinge = {"type": "hinge", "body": "other", "to": "brick", "at": [0, 0, 3.0], "axis": [0, 1, 0]}
    scene = REST | {"body": bricks, "joint": [hinge], "run": {"t_end": 0.2, "every": 0.2}}
    assert '<exclude body1="brick" body2="other"' in mjcf_scene(*made(scene))
    position, _ = in_mujoco(scene)
    assert position[1] - position[0] == pytest.approx([0.05, 0.0, 0.0], abs=1e-9)


MOVING = {"angular_velocity": [0, 0, 1.0]}
TUBE = {"name": "tube", "type": "cylinder", "radius": 1.0, "length": 3.0}
LINK = {"type": "ball", "body": "brick", "at": [0, 0, 0.5]}
REFUSED = [
    ("lammps", {"contact": {"law": "impulse", "restitution": 0.5, "friction": 0.1}},
     "has hooke and hertz"),
    ("lammps", {"contact": HIT["contact"] | {"restitution": 0.1}}, "below e"),
    ("lammps", {"wall": [REST["wall"][0] | {"motion": MOVING}]}, "floor moves as prescribed"),
    ("lammps", {"wall": [TUBE | {"axis": [1, 0, 1]}]}, "lies along x, y or z"),
    ("lammps", {"joint": [LINK]}, "no joints"),
    ("lammps", {"body": [FREE["body"][1] | {"name": "ball", "count": 40,
                                            "position": [[k, 3.0, 1.0] for k in range(40)]}],
                "contact": None, "wall": [], "force": [ANCHOR]}, "LAMMPS has 31"),
    ("mjcf", {"wall": [TUBE]}, "tube is hollow"),
    ("mjcf", {"wall": [REST["wall"][0] | {"motion": MOVING}]}, "floor moves"),
    ("mjcf", {"body": [REST["body"][0] | {"shape": {"type": "ball", "radius": 0.1},
                                         "motion": MOVING, "mass": 1.0},
                       REST["body"][0] | {"name": "b", "position": [0, 0, 0.6]}]},
     "brick moves as prescribed"),
]  # fmt: skip


@pytest.mark.parametrize(("to", "changed", "message"), REFUSED)
def test_what_a_program_does_not_have_is_named(to, changed, message):
    system, step = made(REST | changed)
    with pytest.raises(ExportError, match=message):
        lammps_scene(system, step, "scene") if to == "lammps" else mjcf_scene(system, step)


def test_regions_have_the_faces_that_are_closed():
    walls = [
        TUBE | {"axis": [0, -2, 0], "open": ["+"], "centre": [0, 0, 1.0]},
        HIT["wall"][0] | {"upper": [1, 1, 3]},
    ]
    text = lammps_scene(*made(REST | {"wall": walls}), "scene")[".in"]
    assert "cylinder y 0.0 1.0 1.0 -1.5 1.5 side in units box open 1  # tube" in text
    assert "block -1.0 1.0 -1.0 1.0 0.0 3.0 side in units box open 6  # bin" in text


def test_the_command_writes_whole_scenes_and_says_what_they_lack(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    push = {"type": "push", "body": "ball", "force": [1, 0, 0]}
    Path("three.toml").write_text(tomlkit.dumps(FREE | {"force": [push]}))
    assert main(["export", "three.toml", "--to", "lammps"]) == 0
    out = capsys.readouterr().out
    assert "written: three.in, three.data, three.rigid\nleft out: force[0], push\n" in out
    assert "# left out: force[0], push" in Path("three.in").read_text()
    assert main(["export", "three.toml", "--to", "lammps"]) == 2
    assert main(["export", "three.toml", "--to", "lammps", "-o", "other.data"]) == 2
    assert (
        main(["export", "three.toml", "--to", "lammps", "--bodies", "ball", "-o", "b.rigid"]) == 2
    )
    assert not [*Path().glob("other.*"), *Path().glob("b.*")]
    assert main(["export", "three.toml", "--to", "mjcf"]) == 0
    assert "<!-- left out: force[0], push -->" in Path("three.xml").read_text()
    assert main(["export", "three.toml", "--to", "lammps", "--bodies", "clump[0]"]) == 0
    assert Path("clump_0_.mol").exists()
