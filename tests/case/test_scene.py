"""Scenes in Python: the same tables, defaults and words as in case files, and back again."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from particlerb import CaseError, Scene
from particlerb.case.reader import load
from particlerb.tables import (
    AttractionTable,
    Ball,
    Body,
    Box,
    BoxWall,
    CentralTable,
    ContactTable,
    CylinderWall,
    DragTable,
    ImpulseTable,
    JointTable,
    MagnusTable,
    PlaneWall,
    PointsShape,
    PushTable,
    RandomBox,
    RunTable,
    ShapePart,
    SpheresShape,
    Spread,
    SpringTable,
    SweepTable,
    TimedLoad,
    TorqueTable,
    Torus,
    UniformField,
)

CASES = sorted((Path(__file__).parents[2] / "cases").glob("*.toml"))


def pushed_cubes() -> Scene:
    """Two cubes on a floor; both are pushed."""
    scene = Scene(RunTable(t_end=1.0, every=0.5), title="Cubes", gravity=np.array([0, 0, -9.81]))
    cube = scene.add_body(
        name="cube",
        shape=Box(size=np.ones(3), n=4),
        mass=np.float64(2.0),
        count=2,
        position=np.array([[0.0, 0.0, 0.5], [3.0, 0.0, 0.5]]),
    )
    scene.add_force(PushTable(body=cube, force=(0, 0, 5), during=(0, 0.2)))
    return scene


def text_of(source) -> str:
    """All keys of a case, defaults too."""
    return load(source).model_dump_json()


TEXT = """title = "Cubes"

[run]
t_end = 1.0
every = 0.5

[gravity]
acceleration = [0.0, 0.0, -9.81]

[[body]]
name = "cube"
mass = 2.0
count = 2
position = [[0.0, 0.0, 0.5], [3.0, 0.0, 0.5]]

[body.shape]
type = "box"
size = [1.0, 1.0, 1.0]
n = [4, 4, 4]

[[force]]
type = "push"
body = ["cube"]
during = [0.0, 0.2]
force = [0.0, 0.0, 5.0]
"""


def test_a_scene_has_the_text_of_its_case():
    assert pushed_cubes().to_toml() == TEXT
    assert text_of(pushed_cubes()) == text_of(tomllib.loads(TEXT))


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_every_case_becomes_a_scene_and_a_text_again(path):
    case, scene = load(path), Scene.from_case(path)
    assert text_of(scene) == text_of(case)
    again = Scene.from_case(
        tomllib.loads(scene.to_toml()) if not case.source.files.contents else scene
    )
    assert text_of(again) == text_of(case)


def two_boxes(**tables):
    """Two boxes with other tables."""
    scene = Scene(RunTable(t_end=1.0, every=0.1))
    for name, x in (("a", 0.0), ("b", 2.0)):
        scene.add_body(name=name, shape=Box(size=(1, 1, 1), n=2), mass=1.0, position=(x, 0, 0))
    for name, value in tables.items():
        setattr(scene, name, value)
    return scene


AXES = {"axis": (0, 0, 1)}
AT = {"at": (1, 0, 0), **AXES}
JOINTS = {
    "ball": {"at": (1, 0, 0)}, "hinge": AT, "slider": AXES, "cylindrical": AT,
    "universal": AT | {"axis_to": (0, 1, 0)}, "planar": AXES, "fixed": {},
    "distance": {"at": (0, 0, 0)}, "screw": AT | {"lead": 0.1},
}  # fmt: skip
FORCES = [
    PushTable(body="a", force=TimedLoad(times=[0, 1], values=[[0, 0, 0], [0, 0, 1]])),
    TorqueTable(body="a", torque=(0, 0, 1)), ImpulseTable(body="a", impulse=(0, 0, 1), time=0.5),
    SpringTable(body="a", to="b", stiffness=1.0, damping=0.1), DragTable(body="a", translation=0.1),
    UniformField(body="a", field=(0, 0, 1)), CentralTable(body="a", mu=1.0),
    MagnusTable(body="a", coefficient=1.0),
]  # fmt: skip
WALLS = [
    PlaneWall(name="w", normal=(0, 0, 1)), BoxWall(name="w", lower=(-9, -9, -9), upper=(9, 9, 9)),
    CylinderWall(name="w", radius=9.0, axis=(0, 0, 1), length=9.0),
]  # fmt: skip


@pytest.mark.parametrize(
    "scene",
    [
        *(two_boxes(force=[force]) for force in FORCES),
        *(two_boxes(contact=ContactTable(stiffness=1e5), wall=[wall]) for wall in WALLS),
        *(two_boxes(contact=ContactTable(law=law)) for law in ("impulse", "events")),
        *(two_boxes(joint=[JointTable(name="j", type=kind, body="a", to="b", **keys)])
          for kind, keys in JOINTS.items()),
        two_boxes(attraction=AttractionTable(G=1.0), gravity=(0, 0, -1)),
        two_boxes(sweep=SweepTable(axes={"run.dt": Spread(low=0.1, high=1, n=2), "run.seed": [1]})),
        two_boxes(sweep=SweepTable(axes={"wall.0": [{"type": "plane"}], "run.seed": [1]})),
    ],
)  # fmt: skip
def test_tables_of_all_kinds_are_those_of_their_text(scene):
    text = scene.to_toml()
    again = Scene.from_case(tomllib.loads(text))
    assert again.to_toml() == text
    assert load(again).model_dump_json() == load(scene).model_dump_json()


def test_bodies_stand_for_their_names():
    ball = Body(name="ball", shape=Ball(radius=0.1), mass=1.0)
    spring = SpringTable(body=ball, to=[ball, "other[1]"], stiffness=1.0)
    assert (spring.body, spring.to) == (("ball",), ("ball", "other[1]"))


def test_parts_and_tables_within_tables_are_kept():
    scene = pushed_cubes()
    part = ShapePart(shape=Ball(radius=0.1), mass=1.0)
    scene.add_body(name="two", part=[part, part.model_copy(update={"position": (1.0, 0.0, 0.0)})])
    scene.contact = ContactTable(stiffness=1e4)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1)))
    case = load(scene)
    assert [len(body.part) for body in case.body] == [0, 2]
    assert case.body[1].part[1].position == (1.0, 0.0, 0.0)
    assert (case.contact.stiffness, case.wall[0].type) == (1e4, "plane")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Box(sice=3), ["Box: error: sice: unknown key", 'did you mean "size"?']),
        (lambda: Box(size=[1, 2]), ["Box: error: size: must have 3 entries, has 2"]),
        (lambda: Box(size=[1, -1, 2]), ["size[1]: must be > 0, got -1"]),
        (lambda: Body(name="x", shape={"type": "bax"}), ["type: unknown type 'bax'", '"box"']),
        (lambda: Body(shape=3), ["name: missing", "shape: must be a table"]),
        (lambda: PushTable(body="x", force=[np.nan, 0, 0]), ["force[0]: must be finite"]),
        (lambda: PushTable(type="torque", body="x", force=[1, 0, 0]), ["type: unknown: 'torque'"]),
        (
            lambda: Body(name="x", position=np.zeros((2, 2))),
            ["position: must be rows of 3 numbers"],
        ),
        (lambda: RandomBox(lower=(1, 0, 0), upper=(0, 0, 0)), ["RandomBox: error: upper"]),
        (lambda: BoxWall(name="w", lower=(1, 0, 0), upper=(0, 0, 0)), ["BoxWall: error: upper"]),
        (lambda: Torus(major_radius=1.0, minor_radius=2.0), ["Torus: error: minor_radius"]),
        (lambda: SweepTable(axes={}), ["SweepTable: error: axes"]),
        (lambda: PointsShape(mass=(1.0,)), ["PointsShape: error: "]),
        (TimedLoad, ["TimedLoad: error: ", "give `times` and `values`"]),
    ],
)
def test_a_wrong_key_is_refused_with_the_words_of_a_case(make, words):
    with pytest.raises(CaseError) as found:
        make()
    for word in words:
        assert word in str(found.value)


def test_arrays_stand_for_lists_of_points():
    """In shapes too, where they are not rows for many bodies."""
    corners, radii = np.eye(3), np.array([0.5, 0.25, 0.5])
    for shape in (PointsShape(position=corners, mass=1.0, radius=radii),
                  SpheresShape(position=corners, radius=radii)):  # fmt: skip
        assert shape.position == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        assert shape.radius == (0.5, 0.25, 0.5)
    assert isinstance(Body(name="b", shape=shape, mass=1.0, position=corners).position, np.ndarray)


def test_a_name_is_no_force_and_no_wall():
    words = "is one of particlerb.tables, or a mapping, got"
    with pytest.raises(TypeError, match=f"force {words} 'push'"):
        pushed_cubes().add_force("push")
    with pytest.raises(TypeError, match=f"wall {words} 'plane'"):
        pushed_cubes().add_wall("plane")


def test_what_involves_several_tables_shows_when_the_scene_is_read():
    scene = pushed_cubes()
    scene.add_force(PushTable(body="cub", force=(0, 0, 1)))
    with pytest.raises(CaseError, match=r"force\[1\].body"):
        load(scene)


def test_a_file_is_read_anew_with_each_case_of_a_scene(tmp_path, monkeypatch):
    """A file that was changed between two runs; the case of the first one keeps what it had."""
    monkeypatch.chdir(tmp_path)
    scene = pushed_cubes()
    scene.force[0] = PushTable(body="cube", force=TimedLoad(table="load.csv"))
    cases = []
    for force in (b"1", b"3"):
        Path("load.csv").write_bytes(b"0 0 0 0\n1 0 0 " + force)
        cases.append(load(scene))
    assert [case.source.files.read("load.csv").data[-1:] for case in cases] == [b"1", b"3"]


def test_a_scene_says_what_it_holds():
    scene = pushed_cubes()
    assert repr(scene) == "<Scene 'Cubes': 1 body, 1 force>"
    assert list(scene) == ["title", "run", "gravity", "body", "force"]
    assert len(scene) == 5
    with pytest.raises(KeyError):
        scene["wall"]


def test_gravity_is_assigned_as_it_is_given():
    run = RunTable(t_end=1.0, every=0.5)
    given, assigned = Scene(run, gravity=(0, 0, -9.81)), Scene(run)
    assigned.gravity = np.array([0.0, 0.0, -9.81])
    assert assigned.gravity == given.gravity
    assigned.gravity = given.gravity
    assert assigned.to_toml() == given.to_toml()
    with pytest.raises(CaseError, match="acceleration: must have 3"):
        assigned.gravity = (0, 0)
    assigned.gravity = None
    assert "gravity" not in assigned.to_toml()


@pytest.mark.parametrize("name", ["body", "wall"])
def test_tables_may_come_one_by_one(name):
    """From a generator, as a view of a dict, in a scene and in a mapping: rules read them first."""
    tables = {"body": Body(name="a", shape=Ball(radius=0.5), mass=1.0)}
    tables["wall"] = PlaneWall(name="floor", normal=(0, 0, 1))
    scene = pushed_cubes()
    setattr(scene, name, (table for table in [tables[name]]))
    assert getattr(scene, name) == [tables[name]]
    run = {"t_end": 1.0, "every": 0.5}
    for given in ((table for table in [tables[name]]), {1: tables[name]}.values()):
        keys = {"run": run, "body": [tables["body"]], "contact": {"stiffness": 1e3}} | {name: given}
        assert getattr(load(keys), name) == (tables[name],)


def test_lists_of_a_scene_may_be_emptied():
    scene = pushed_cubes()
    scene.force = ()
    assert "force" not in scene
    assert "force" not in scene.to_toml()


def test_half_a_character_is_no_title():
    """Which no file can hold."""
    scene = pushed_cubes()
    scene.title = "\ud800"
    with pytest.raises(CaseError, match="title: must be a text that UTF-8 can hold"):
        load(scene)


def test_a_misspelt_key_of_a_copied_table_is_no_silence():
    """`model_copy` takes any key: who reads the table says which is wrong, in a table in it too."""
    scene = pushed_cubes()
    scene.run = scene.run.model_copy(update={"tend": 9.0})
    with pytest.raises(CaseError, match=r"run\.tend: unknown key"):
        load(scene)
    scene = pushed_cubes()
    box = Box(size=(1, 1, 1)).model_copy(update={"sice": 2})
    scene.body[0] = scene.body[0].model_copy(update={"shape": box})
    with pytest.raises(CaseError, match=r"body\[0\]\.shape\.sice: unknown key"):
        load(scene)
    assert "sice = 2" in scene.to_toml()


@pytest.mark.parametrize("name", ["run", "body", "wall", "contact", "title", "files", "chart"])
@pytest.mark.parametrize("value", [3, b"a", [1, 2], np.zeros(3), Path("a")])
def test_what_is_no_table_is_set_nowhere(name, value):
    with pytest.raises(TypeError, match=f"{name} "):
        setattr(pushed_cubes(), name, value)


def test_what_a_scene_has_not_cannot_be_set():
    scene = Scene(RunTable(t_end=1.0, every=0.5))
    with pytest.raises(AttributeError, match="no gravitation; it has: title, run, gravity"):
        scene.gravitation = (0, 0, -9.81)
    with pytest.raises(AttributeError, match=r"RunTable\.dt cannot be set: take a model_copy"):
        scene.run.dt = 1e-3
    with pytest.raises(TypeError, match=r"^add_body takes keys by name, such as add_body"):
        scene.add_body("ball")
