"""The Python entry: what `run` and `open` take, and that importing the package is cheap."""

import logging
import math
import sys
from subprocess import run

import numba
import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.model.balance import ConservationError
from particlerb.simulation.run import prepare
from particlerb.simulation.run_warnings import lost_energy, remedy_of
from particlerb.tables import Cylinder, RunTable

DOT = {"type": "points", "position": [[0, 0, 0]], "mass": 1.0}
TOML = """
[run]
t_end = 1.0
every = 0.25
[[body]]
name = "cube"
mass = 2.0
shape = { type = "box", size = [1, 1, 1], n = 2 }
angular_velocity = [0.3, 0.2, 0.1]
velocity = [1.0, 0.0, 0.0]
"""


@pytest.fixture
def case_file(tmp_path):
    path = tmp_path / "cube.toml"
    path.write_text(TOML)
    return path


def test_public_names():
    assert {"run", "open", "Case", "CaseError", "Trajectory"} <= set(particlerb.__all__)
    assert set(particlerb.__all__) == {"__version__", *particlerb._HOMES}
    for name in particlerb.__all__:
        assert getattr(particlerb, name) is not None
    assert particlerb.System is particlerb.Scene
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = particlerb.nothing


@pytest.mark.once
def test_a_console_completes_public_names_before_they_are_used():
    code = "import particlerb; print(*dir(particlerb)); print(particlerb.tables.Box.__name__)"
    told = run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    names, box = told.splitlines()
    assert set(names.split()) == {*particlerb.__all__, "tables"}
    assert box == "Box"


@pytest.mark.plain
def test_warnings_of_a_plan_reach_those_who_run_it_from_python(caplog):
    """A cylinder one cell across has no moment about its axis: it is a rod."""
    scene = particlerb.Scene(RunTable(t_end=1.0, every=1.0))
    scene.add_body(name="pin", shape=Cylinder(radius=0.1, height=0.8, n=4), mass=1.0)
    for start in (particlerb.run, particlerb.Simulation):
        caplog.clear()
        start(scene)
        assert [record.levelname for record in caplog.records] == ["WARNING"]
        assert "as 4 particles it is a rod, which the solid is not" in caplog.text


def two_points(**run):
    """An orbit of eccentricity 0.99 from its farthest point on, where steps are chosen."""
    scene = particlerb.Scene(RunTable(t_end=2.4, every=0.2, **run), attraction={"G": 1.0})
    for name, side in (("a", 1.0), ("b", -1.0)):
        place, velocity = (side, 0, 0), (0, side * 0.05, 0)
        scene.add_body(name=name, shape=DOT, position=place, velocity=velocity)
    return scene


@pytest.mark.plain
def test_a_run_that_loses_energy_says_so_to_those_who_run_it_from_python(caplog, tmp_path):
    """It passes by at a hundredth of the distance at which its step was chosen."""
    path = tmp_path / "a.h5"
    lost = abs(particlerb.run(two_points(method="strang"), path).ledger.energy_error).max()
    assert lost > 0.1
    ((_, level, told),) = caplog.record_tuples
    assert level == logging.WARNING
    assert told.startswith("particlerb: warning: the energy errs by")
    assert "take run.dt below 0.1 s" in told
    assert 'run.method = "dop853"' in told
    caplog.clear()
    particlerb.resume(path, 2.6)
    assert "the energy errs by" in caplog.text
    caplog.clear()
    simulation = particlerb.Simulation(two_points(method="strang"))
    simulation.advance(2.3)
    assert caplog.text == ""
    simulation.advance(2.4)
    assert "particlerb: warning: the energy errs by" in caplog.text
    caplog.clear()
    kept = particlerb.run(two_points(method="dop853", tolerance=1e-10))
    assert abs(kept.ledger.energy_error).max() < 1e-6
    assert caplog.text == ""


@pytest.mark.plain
def test_frames_that_meet_a_body_at_rest_are_no_lost_energy(make, caplog):
    """A spring of one radian a second, let go: after a period it is at rest again."""
    spring = {"type": "spring", "body": "body", "anchor": [0, 0, 0], "stiffness": 2.0}
    period, body = 2.0 * math.pi, make.body(position=[1.0, 0.0, 0.0])
    keys = {"t_end": period, "every": period, "dt": 0.05, "method": "strang"}
    case = make.case(body, force=[spring], **keys)
    with particlerb.run(case) as trajectory:
        assert trajectory.position[-1, 0, 0] == pytest.approx(1.0, abs=1e-6)
    particlerb.Simulation(case).advance(period)
    assert caplog.text == ""


def remedy(case, **run):
    """What helps against energy that errs by much."""
    prepared = prepare(to_system(load(case | {"run": case["run"] | run})))
    _, helps = remedy_of(prepared.system.run, prepared.plan.groups)
    (told,) = lost_energy(helps, ConservationError(1.0, 0.0, 0.0))
    return told.partition("wrong too")[2].rpartition("; ")[2]


def test_what_helps_against_lost_energy_is_what_the_run_can_take(make):
    balls = [make.sphere(f"ball{k}", position=[k, 0.0, 0.0]) for k in range(2)]
    events = {"law": "events", "restitution": 0.5, "friction": 0.5}
    assert remedy(make.case(*balls, contact=events)) == ""
    attracted = make.case(*balls, attraction={"G": 1e-3}, dt=0.01, method="strang")
    assert remedy(attracted).endswith('"dop853", whose steps follow the motion')
    assert remedy(attracted | {"contact": make.hooke(1e3)}) == "take run.dt below 0.01 s"
    assert remedy(make.case(*balls, attraction={"G": 1e-3}, method="dop853", tolerance=1e-6)) == (
        "lower run.tolerance"
    )
    third = make.sphere("third", position=[0.0, 5.0, 0.0])
    by_accuracy = make.case(*balls, third, attraction={"G": 1e-3})
    assert remedy(by_accuracy, accuracy=1e-3) == "take a smaller run.accuracy"


def test_importing_loads_nothing_heavy(make):
    code = """
import sys, particlerb
heavy = {"numba", "h5py", "numpy", "pydantic", "matplotlib"} & set(sys.modules)
print(particlerb.__version__, sorted(heavy))
"""
    assert make.python(code).strip() == f"{particlerb.__version__} []"


def test_run_takes_a_path_a_text_a_dict_and_a_case(case_file):
    import tomllib

    given = [case_file, str(case_file), tomllib.loads(TOML), load(case_file)]
    results = []
    for case in given:
        with particlerb.run(case) as t:
            results.append((t.position, t.orientation))
    for position, orientation in results[1:]:
        assert (position == results[0][0]).all()
        assert (orientation == results[0][1]).all()


def test_run_in_memory_and_into_a_file_agree(case_file, tmp_path):
    with particlerb.run(case_file) as memory, particlerb.run(case_file, tmp_path / "a.h5") as t:
        assert (t.position == memory.position).all()
        assert (t.energy == memory.energy).all()
        assert t.file.filename == str(tmp_path / "a.h5")
    with particlerb.open(str(tmp_path / "a.h5")) as again:
        assert again.n_frames == 5


def test_several_runs_in_memory_at_once(case_file):
    first, second = particlerb.run(case_file), particlerb.run(case_file, overrides=["run.every=1"])
    assert (first.n_frames, second.n_frames) == (5, 2)
    assert (first.position[-1] == second.position[-1]).all()
    first.close()
    assert second.n_frames == len(second.time)
    second.close()


def test_a_run_in_memory_leaves_no_file(case_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    particlerb.run(case_file).close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cube.toml"]


def test_arrays_are_initial_states(make):
    """A row per body, of any array type; they are not changed and not kept."""
    rng = np.random.default_rng(4)
    n = 7
    q = rng.standard_normal((n, 4))
    given = {
        "position": rng.standard_normal((n, 3)),
        "orientation": q,
        "velocity": rng.standard_normal((n, 3)).astype(np.float32),
        "angular_velocity": np.asfortranarray(rng.standard_normal((n, 3))),
    }
    before = {name: array.copy() for name, array in given.items()}
    case = make.case(make.body(count=n, **given))
    case["run"] |= {"t_end": np.float64(1.0)}
    found = make.arrays(case)
    for name, array in before.items():
        assert (given[name] == array).all()
    assert (found.position[0] == before["position"]).all()
    assert found.velocity[0] == pytest.approx(before["velocity"].astype(float), rel=1e-15)
    assert found.angular_velocity[0] == pytest.approx(before["angular_velocity"], abs=1e-14)
    size = np.linalg.norm(q, axis=1, keepdims=True)
    assert found.orientation[0] == pytest.approx(q / size, abs=1e-15)


def test_overrides(case_file):
    with particlerb.run(case_file, overrides=["run.t_end=0.5", "body.0.mass=4"]) as t:
        assert t.time[-1] == 0.5
        assert t.mass[0] == 4.0


def test_problems_of_a_case_come_all_at_once(make):
    case = make.case(make.body(mas=3.0), t_end=-1.0)
    with pytest.raises(CaseError) as caught:
        particlerb.run(case)
    assert "mas" in str(caught.value)
    assert "t_end" in str(caught.value)


def test_a_wrong_case_makes_no_file(make, tmp_path):
    point = make.body("p", [0, 0, 0])
    with pytest.raises(CaseError):
        particlerb.run(make.case(point, force=[make.torque([1, 0, 0], "p")]), tmp_path / "a.h5")
    assert not list(tmp_path.iterdir())


def test_an_interrupted_run_keeps_its_frames(make, tmp_path):
    """Ctrl-C between two batches: the file holds what was appended."""
    from particlerb.simulation import run as simulate
    from particlerb.simulation.frame_times import FIRST_BATCH

    prepared = simulate.prepare(to_system(make.case(make.body(), t_end=200.0)))

    def interrupt(frames):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate.run_prepared(prepared, tmp_path / "a.h5", progress=interrupt)
    with particlerb.open(tmp_path / "a.h5") as t:
        assert t.n_frames == FIRST_BATCH
        assert t.time[-1] == (FIRST_BATCH - 1) / 10


# What is given wrongly

ANY = [3, 3.5, None, [1], b"cube.toml", object()]


@pytest.mark.parametrize("given", ANY)
def test_what_is_no_case_and_no_path_is_a_type_error(given, case_file):
    kind = type(given).__name__
    with pytest.raises(TypeError, match=f"^a case must be a path, the name .* got {kind}$"):
        particlerb.run(given)
    with pytest.raises(TypeError, match=f"^what is opened must be a path, got {kind}$"):
        particlerb.open(given)
    for function in (particlerb.joint_loads, particlerb.plot):
        with pytest.raises(TypeError, match=f"^a Trajectory is needed, .* got {kind}$"):
            function(given)
    with pytest.raises(TypeError, match=f"^what is resumed must be a path, got {kind}$"):
        particlerb.resume(given)
    if given is not None:
        with pytest.raises(TypeError, match=f"^output must be a path, got {kind}$"):
            particlerb.run(case_file, given)


@pytest.mark.parametrize(
    "overrides", ["run.dt=1", [3], [b"run.dt=1"], {"run.dt": 1}.items(), 3, iter([])]
)
def test_overrides_are_texts(case_file, overrides):
    with pytest.raises(TypeError, match="overrides must be a list of texts"):
        particlerb.run(case_file, overrides=overrides)


def test_an_end_that_is_no_float_is_a_value_error(case_file, tmp_path):
    particlerb.run(case_file, tmp_path / "a.h5").close()
    with pytest.raises(ValueError, match="t_end must be a number of float64"):
        particlerb.resume(tmp_path / "a.h5", 10**400)


def test_a_picture_of_no_body_or_at_no_path_is_refused(case_file):
    with particlerb.run(case_file) as trajectory:
        with pytest.raises(ValueError, match=r"'cub': no such body; did you mean .cube"):
            particlerb.plot(trajectory, body="cub")
        with pytest.raises(TypeError, match="the picture must be a path, got int"):
            particlerb.plot(trajectory, 3)


@pytest.mark.parametrize("t_end", ["2", True, [2.0]])
def test_an_end_is_a_number(case_file, tmp_path, t_end):
    particlerb.run(case_file, tmp_path / "a.h5").close()
    with pytest.raises(TypeError, match="t_end must be a number"):
        particlerb.resume(tmp_path / "a.h5", t_end)


def test_examples_are_found_by_the_names_of_the_command_line(tmp_path, monkeypatch, capsys):
    from particlerb.case.case_names import case_folders
    from particlerb.cli import main

    monkeypatch.chdir(tmp_path)
    assert main(["cases"]) == 0
    names = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert "tumbling_brick" in names
    for name in names:
        assert load(name).path.stem == name
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "tumbling_brick.toml").write_text(TOML)
    assert load("tumbling_brick").path == case_folders()[0] / "tumbling_brick.toml"
    with particlerb.run("tumbling_brick") as t:
        assert list(t.names) == ["cube"]
    with pytest.raises(CaseError) as caught:
        particlerb.run("tumbling_brik")
    assert str(caught.value) == (
        "tumbling_brik: error: there is no such file or case\n"
        "      hint: did you mean tumbling_brick?"
    )


def test_files_that_are_none(tmp_path):
    for name, reason in [("none.toml", "there is no such file"), ("", "is a folder")]:
        with pytest.raises(CaseError, match=reason):
            particlerb.run(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"none\.h5: no such file"):
        particlerb.open(tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError, match=r"none\.h5: no such file"):
        particlerb.resume(tmp_path / "none.h5")
    (tmp_path / "text.h5").write_text("text")
    folder, text = (
        (tmp_path, "is not a regular file"),
        (tmp_path / "text.h5", "is not a readable HDF5"),
    )
    for path, reason in (folder, text):
        with pytest.raises(particlerb.TrajectoryError, match=reason):
            particlerb.open(path)
        with pytest.raises(particlerb.TrajectoryError, match=reason):
            particlerb.resume(path)


@pytest.mark.parametrize(
    "case", [{}, {"run": 3}, {"bodies": []}, {3: 4}, {"run": {3: 4}}, {"body": [{None: 1}]}]
)
def test_dicts_with_wrong_keys_are_case_errors(case):
    with pytest.raises(CaseError):
        particlerb.run(case)


def test_show_versions_prints_what_a_report_of_an_error_needs(capsys):
    particlerb.show_versions()
    printed = capsys.readouterr().out
    assert [line.split(":")[0] for line in printed.splitlines()] == [
        "machine", "versions", "compiled code",
    ]  # fmt: skip
    assert f"'numba': '{numba.__version__}'" in printed
