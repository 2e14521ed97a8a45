"""A trajectory needs nothing but itself: it has the files of its case, and names are no paths.

Every file of the case is deleted, or changed, before the trajectory is used.
"""

import hashlib
import json
import shutil

import h5py
import numpy as np
import pytest

import particlerb
from particlerb.case.reader import load
from particlerb.cli import main
from particlerb.files import File, Files
from particlerb.record import provenance
from particlerb.record.checksums import seal
from particlerb.record.schema import FILE_NAMES, FILES, PARAMETERS
from particlerb.record.trajectory import TrajectoryError

pytestmark = pytest.mark.once

CASE = """
run = { t_end = 0.02, every = 0.005, dt = 1e-3 }
contact = { stiffness = 1e3, restitution = 0.5, friction = 0.1 }
wall = [{ type = "mesh", name = "floor", file = "floor.stl", position = [0, 0, -0.5] }]
force = [{ type = "push", body = "points", force = { table = "thrust.txt" } }]

[[body]]
name = "points"
shape = { type = "points", file = "of_points/a.csv" }
angular_velocity = [0, 1, 0.5]
contact = false

[[body]]
name = "clump"
shape = { type = "spheres", file = "clump.xyzr", overlap = "sum" }
mass = 1.0
velocity = [0, 0, -1]
position = [0, 0, 3]

[[body]]
name = "corner"
part = [{ shape = { type = "mesh", file = "corner.obj" }, mass = 1.0 }]
position = [9, 0, 0]
contact = false
"""
CORNER = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
FLOOR = """solid floor
facet normal 0 0 1
outer loop
vertex -9 -9 0
vertex 9 -9 0
vertex 0 9 0
endloop
endfacet
endsolid floor
"""
DATA = {
    "floor.stl": FLOOR,
    "of_points/a.csv": "x,y,z,m\n0,0,0,1\n1,0,0,1\n0,2,0,1\n",
    "clump.xyzr": "x y z r\n0 0 0 0.1\n0.1 0 0 0.1\n",
    "thrust.txt": "t,x,y,z\n0.001,0,0,0\n0.012,0,0,3\n0.04,1,0,0\n",
    "corner.obj": f"mtllib corner.mtl\n{CORNER}",
}


@pytest.fixture
def moved(tmp_path, monkeypatch):
    """A trajectory in a folder where nothing else is, and its last positions."""
    source, elsewhere = tmp_path / "source", tmp_path / "elsewhere"
    (source / "of_points").mkdir(parents=True)
    elsewhere.mkdir()
    for name, text in DATA.items():
        (source / name).write_text(text)
    (source / "a.toml").write_text(CASE)
    with particlerb.run(source / "a.toml", elsewhere / "a.h5") as t:
        last = t.position[-1]
    shutil.rmtree(source)
    monkeypatch.chdir(elsewhere)
    return elsewhere / "a.h5", last


def test_contents_lie_in_the_file(moved):
    path, _ = moved
    with h5py.File(path) as file:
        names = json.loads(file[f"{PARAMETERS}/{FILE_NAMES}"][()])
        kept = {name: file[f"{FILES}/{key}"][:].tobytes() for name, key in names.items()}
    assert kept == {name: text.encode() for name, text in DATA.items()}
    assert main(["info", str(path), "--verify"]) == 0


def test_one_content_is_kept_once(tmp_path, make):
    for name in "ab":
        (tmp_path / f"{name}.csv").write_text(DATA["of_points/a.csv"])
    bodies = [
        {"name": name, "shape": {"type": "points", "file": str(tmp_path / f"{name}.csv")}}
        for name in "ab"
    ]
    with particlerb.run(make.case(*bodies), tmp_path / "run.h5") as t:
        assert len(t.file[FILES]) == 1
        assert len(t.case.source.files.contents) == 2
    with particlerb.run(make.case(make.body()), tmp_path / "none.h5") as t:
        assert FILES not in t.file


def test_what_was_read_with_the_case_is_what_is_kept(tmp_path, make):
    """A file that is changed while a case is worked on does not mix with what was read."""
    path = tmp_path / "a.csv"
    path.write_text(DATA["of_points/a.csv"])
    shape = {"type": "points", "file": str(path)}
    case = load(make.case({"name": "a", "shape": shape}))
    path.write_text("x,y,z,m\n0,0,0,5\n")
    with particlerb.run(case) as t:
        assert t.mass.tolist() == [3.0]
        kept = t.case.source.files.read(str(path))
        assert kept == File(str(path), DATA["of_points/a.csv"].encode())


def test_the_run_goes_on_and_repeats(moved):
    path, last = moved
    with particlerb.open(path) as t:
        again = particlerb.run(t.case)
    assert np.array_equal(again.position[-1], last)
    whole = particlerb.run(again.case, overrides=["run.t_end=0.03"]).position[-1]
    with particlerb.resume(path, 0.03) as t:
        assert np.array_equal(t.position[-1], whole)
        assert t.n_frames == 7


def test_it_is_shown_and_exported(moved):
    from particlerb.export.surfaces import surface_of, walls_of
    from particlerb.view.replay import system_of

    path, last = moved
    with particlerb.open(path) as t:
        system = system_of(t)
    forms = [surface_of(system, body, k, 1) for k, body in enumerate(system.body)]
    assert all(len(form.mesh.faces) for form in forms)
    assert len(walls_of(system, 1.0)[0].faces) == 1
    assert np.array_equal(system.state.com.T[1:], [[0, 0, 3], [9, 0, 0]])
    assert main(["export", str(path), "--to", "particles", "-o", "p.csv"]) == 0
    assert np.isfinite(last).all()


# Files that are not to be trusted


def name_other(path, old, new, kept=None):
    """Let the case of a file name another one, and perhaps keep a content of that name."""
    with h5py.File(path, "r+") as file:
        case = file[f"{PARAMETERS}/case_resolved"][()].decode()
        assert old in case
        provenance.write_text(file, "case_resolved", case.replace(old, new))
        names = json.loads(file[f"{PARAMETERS}/{FILE_NAMES}"][()])
        key = names.pop(old)
        names |= {} if kept is None else {new: key}
        provenance.write_text(file, FILE_NAMES, json.dumps(names))
        seal(file)


@pytest.mark.parametrize("name", ["/etc/passwd", "secret.csv", "../elsewhere/secret.csv", ""])
def test_a_name_is_never_a_path(moved, name, capsys):
    """Also where such a file is there, and is just what the case would need."""
    from particlerb.view.replay import ReplayError, system_of

    path, _ = moved
    path.with_name("secret.csv").write_text(DATA["of_points/a.csv"])
    name_other(path, "of_points/a.csv", name)
    assert main(["resume", str(path), "--t-end", "1", "-q"]) == 2
    assert main(["info", str(path)]) == 0
    assert ("with the case" if name else "empty") in capsys.readouterr().err
    with particlerb.open(path) as t:
        with pytest.raises(ReplayError):
            system_of(t)
        with pytest.raises(TrajectoryError, match="its case is wrong"):
            _ = t.case


@pytest.mark.slow
def test_nothing_but_the_file_is_opened(moved, make):
    """Audited by Python itself: names lead to existing files, the case's own path to a FIFO."""
    path, _ = moved
    trap = path.with_name("trap.csv")
    trap.write_text("not for you")
    for old in list(DATA):
        name_other(path, old, f"{trap}.{old.rpartition('.')[2]}", kept=True)
        trap.with_name(f"trap.csv.{old.rpartition('.')[2]}").write_text("not for you")
    with h5py.File(path, "r+") as file:
        provenance.write_text(file, "case_path", str(trap))
        seal(file)
    code = f"""
import sys
import particlerb
from particlerb.simulation.resume import ResumeError
from particlerb.view.replay import system_of
opened = []
sys.addaudithook(lambda event, data: opened.append(str(data[0])) if event == "open" else None)
with particlerb.open({str(path)!r}) as t:
    assert system_of(t).n_bodies == 3
try:
    particlerb.resume({str(path)!r}, 0.03).close()
except ResumeError as error:
    assert "other bodies or another plan" in str(error)  # the names are part of the case
else:
    raise AssertionError
print([name for name in opened if "trap" in name or "of_points" in name])
"""
    assert make.python(code).strip() == "[]"


def test_a_changed_content_is_damage(moved, capsys):
    path, _ = moved
    key = hashlib.sha256(DATA["clump.xyzr"].encode()).hexdigest()
    with h5py.File(path, "r+") as file:
        file[f"{FILES}/{key}"][0] ^= 1
    assert main(["resume", str(path), "--t-end", "1"]) == 2
    assert "is damaged" in capsys.readouterr().err
    assert main(["info", str(path), "--verify"]) == 1


@pytest.mark.parametrize(
    "names", ["[]", "3", '{"clump.xyzr": 3}', '{"clump.xyzr": "../case"}', '{"a": ".."}', "{"]
)
def test_a_wrong_table_of_names_is_one_message(moved, names, capsys):
    path, _ = moved
    with h5py.File(path, "r+") as file:
        provenance.write_text(file, FILE_NAMES, names)
    assert main(["resume", str(path), "--t-end", "1"]) == 2
    message = capsys.readouterr().err
    assert message.startswith(f"particlerb: {path} is not a trajectory")
    assert message.count("\n") == 1


def test_contents_lead_nowhere_else(moved, capsys):
    """A link, or numbers outside the file, are not followed."""
    path, _ = moved
    key = hashlib.sha256(DATA["clump.xyzr"].encode()).hexdigest()
    for bad in (h5py.ExternalLink("other.h5", "/x"), h5py.SoftLink("/parameters/case")):
        with h5py.File(path, "r+") as file:
            del file[f"{FILES}/{key}"]
            file[f"{FILES}/{key}"] = bad
        assert main(["resume", str(path), "--t-end", "1"]) == 2
        assert "link to elsewhere" in capsys.readouterr().err


def test_files_of_a_case_without_a_folder_are_those_that_it_has():
    files = Files(contents={"a.csv": b"1"})
    assert files.read("a.csv") == File("a.csv", b"1")
    with pytest.raises(ValueError, match='there is no file "/etc/passwd" with the case'):
        files.read("/etc/passwd")
