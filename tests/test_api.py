"""The Python entry: what `run` and `open` take, and that importing the package is cheap."""

import numpy as np
import pytest

import particlerb
from particlerb.case.problems import CaseError
from particlerb.case.reader import load

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
    for name in particlerb.__all__:
        assert getattr(particlerb, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = particlerb.nothing


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
    from particlerb import simulate

    prepared = simulate.prepare(load(make.case(make.body(), t_end=200.0)))

    def interrupt(frames):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate.run_prepared(prepared, tmp_path / "a.h5", progress=interrupt)
    with particlerb.open(tmp_path / "a.h5") as t:
        assert t.n_frames == simulate.FIRST_BATCH
        assert t.time[-1] == (simulate.FIRST_BATCH - 1) / 10
