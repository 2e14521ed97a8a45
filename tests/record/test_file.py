"""The written file: its layout as other readers need it, and that a kill leaves it whole."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import h5py
import numpy as np
import pytest

import particlerb
from particlerb.record import layout
from particlerb.record.schema import FIELDS, LEDGER, STATIC, frames_per_chunk

SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
DEFAULT = ("position", "orientation", "linear_momentum", "angular_momentum")
DERIVED = ("velocity", "angular_velocity")


def scene(make, **keys):
    """Three bodies of two kinds, 24 frames."""
    ball = {"type": "points", "position": [[0, 0, 0], [1, 0, 0]], "mass": [1, 2], "radius": [1, 0]}
    place = {"type": "grid", "spacing": 2.0}
    bodies = [make.body("pair", count=2, place=place, **SPIN), make.body("ball", shape=ball)]
    del bodies[1]["mass"]
    return make.case(*bodies, t_end=2.25, **keys)


@pytest.fixture
def written(make, tmp_path):
    """Maker of a written file, open for reading."""
    files = []

    def write(**keys):
        path = tmp_path / f"{len(files)}.h5"
        particlerb.run(scene(make, **keys), path).close()
        files.append(h5py.File(path, "r"))
        return files[-1]

    yield write
    for file in files:
        file.close()


# Layout


def test_texts_of_other_lengths_go_into_the_same_empty_file(make, tmp_path, monkeypatch):
    """HDF5 makes neither the file nor the texts anew; nothing is left of a longer text."""
    titles, cases = ("a title of many words, and of \u00e4", "b"), []
    layout._empty_file.cache_clear()
    with monkeypatch.context() as patch:
        patch.setattr(layout.hdf5, "put", lambda file, path, values: pytest.fail(path))
        for k, title in enumerate(titles):
            with particlerb.run(scene(make) | {"title": title}, tmp_path / f"{k}.h5") as t:
                cases.append(t.parameter("case_resolved"))
    assert [case["title"] for case in cases] == list(titles)
    assert layout._empty_file.cache_info().misses == 1


def test_files_are_begun_in_several_threads_at_once(make, tmp_path, monkeypatch):
    """Each is laid out in memory, under a name that HDF5 wants for itself."""
    both_are_here, lay_out = Barrier(2, timeout=10.0), layout._lay_out

    def together(*arguments):
        both_are_here.wait()
        return lay_out(*arguments)

    layout._empty_file.cache_clear()
    monkeypatch.setattr(layout, "_lay_out", together)
    cases = [scene(make, output={"dtype": dtype}) for dtype in ("float32", "float64")]
    paths = [tmp_path / "a.h5", tmp_path / "b.h5"]
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(particlerb.run, cases, paths))
    assert [one.n_frames for one in found] == [24, 24]
    for one in found:
        one.close()


def test_header_is_h5md(written):
    file = written()
    assert file["h5md"].attrs["version"].tolist() == [1, 1]
    for group, names in (("author", ["name"]), ("creator", ["name", "version"])):
        for name in names:
            assert isinstance(file[f"h5md/{group}"].attrs[name], np.bytes_)  # fixed length
    assert file.attrs["schema"].tolist() == [2, 0]
    assert file.attrs["n_frames"] == 24
    box = file["particles/trajectory/box"]
    assert box.attrs["dimension"] == 3
    assert box.attrs["boundary"].tolist() == [b"none"] * 3
    assert "edges" not in box
    assert list(file["particles"]) == ["trajectory"]


@pytest.mark.parametrize("root", ["particles/trajectory", "observables"])
def test_elements_have_step_time_value(written, root):
    """Step and time are the same two datasets everywhere, by hard links."""
    file = written(output={"fields": [*DEFAULT, *DERIVED]})
    step, clock = file["particles/trajectory/step"], file["particles/trajectory/time"]
    assert step[:].tolist() == list(range(24))
    assert clock[:].tolist() == [k / 10 for k in range(23)] + [2.25]
    assert clock.attrs["units"] == "s"
    known = FIELDS if root.startswith("particles") else LEDGER
    for name, element in known.items():
        group = file[root][name]
        assert sorted(group) == ["step", "time", "value"]
        assert group["step"] == step
        assert group["time"] == clock
        assert group.get("time", getlink=True).__class__ is h5py.HardLink
        value = group["value"]
        bodies = (3,) if known is FIELDS else ()
        width = (len(element.components),) if element.components else ()
        assert value.shape == (24, *bodies, *width)
        assert value.dtype == np.float64
        assert value.attrs["units"] == element.units
        assert "unit" not in value.attrs
        assert np.isfinite(value[:]).all()


def test_observables_are_one_level_deep_and_as_long_as_the_run(written):
    file = written()
    assert set(file["observables"]) == set(LEDGER)
    for group in file["observables"].values():
        assert all(isinstance(entry, h5py.Dataset) for entry in group.values())
        assert {len(entry) for entry in group.values()} == {24}


def test_dimension_scales_are_on_all_dimensions(written):
    file = written()
    trajectory = file["particles/trajectory"]
    for scale in (trajectory["time"], trajectory["body"], file["xyz"], file["wxyz"], file["123"]):
        assert scale.is_scale
    assert file["xyz"][:].tolist() == [b"x", b"y", b"z"]
    assert file["wxyz"][:].tolist() == [b"w", b"x", b"y", b"z"]

    def scales(dataset):
        return [[scale.name.rsplit("/", 1)[1] for scale in d.values()] for d in dataset.dims]

    assert scales(trajectory["position/value"]) == [["time"], ["body"], ["xyz"]]
    assert scales(trajectory["moment_inertia"]) == [["body"], ["123"]]
    assert scales(trajectory["orientation/value"]) == [["time"], ["body"], ["wxyz"]]
    assert scales(file["observables/energy/value"]) == [["time"]]
    assert scales(file["observables/angular_momentum/value"]) == [["time"], ["xyz"]]


def test_what_does_not_change_is_stored_once(written):
    file = written()
    trajectory, bodies = file["particles/trajectory"], file["bodies"]
    for path, table in STATIC.items():
        assert file[path].attrs["units"] == table.units
        assert file[path].attrs["meaning"] == table.meaning
    assert trajectory["id"][:].tolist() == [0, 1, 2]
    assert trajectory["mass"][:].tolist() == [2.0, 2.0, 3.0]
    assert trajectory["moment_inertia"].shape == (3, 3)
    assert np.sort(trajectory["moment_inertia"][0]) == pytest.approx([1.0, 2.0, 2.5])
    assert bodies["names"][:].tolist() == [b"pair[0]", b"pair[1]", b"ball"]
    assert bodies["kind"][:].tolist() == [0, 0, 1]
    assert bodies["rotor_class"][:].tolist() == [4, 4, 3]
    offset = bodies["particles/offset"][:].tolist()
    assert offset == [0, 6, 8]
    assert bodies["particles/mass"][:].sum() == pytest.approx(5.0)
    assert bodies["particles/radius"][6:].tolist() == [1.0, 0.0]
    com = bodies["particles/mass"][6:] @ bodies["particles/position"][6:]
    assert com == pytest.approx(np.zeros(3), abs=1e-15)


def test_parameters_are_enough_to_run_it_again(written, make):
    file = written(seed=7)
    parameters = file["parameters"]
    again = json.loads(parameters["case_resolved"][()])
    assert again["run"]["seed"] == parameters["seed"][()] == 7
    assert {"particlerb", "python", "numpy", "h5py"} <= set(json.loads(parameters["versions"][()]))
    assert b"closed form" in parameters["plan"][()]
    assert set(parameters) >= {"case", "machine", "git_revision"}
    with particlerb.run(again) as t:
        assert (t.position == file["particles/trajectory/position/value"][:]).all()
        assert (t.orientation == file["particles/trajectory/orientation/value"][:]).all()


def test_text_of_a_case_file_is_kept(tmp_path):
    text = """# a comment that stays
run = { t_end = 1.0, every = 0.5 }
[[body]]
name = "a"
mass = 1.0
shape = { type = "rod", length = 1.0 }
"""
    (tmp_path / "a.toml").write_text(text)
    with particlerb.run(tmp_path / "a.toml", tmp_path / "a.h5") as t:
        assert t.parameter("case") == text


def test_fields_and_precision_are_those_asked_for(written):
    full = written(output={"fields": [*DEFAULT, *DERIVED]})["particles/trajectory"]
    part = written(output={"fields": ["angular_velocity", "position"], "dtype": "float32"})
    trajectory = part["particles/trajectory"]
    assert [name for name in FIELDS if name in trajectory] == ["position", "angular_velocity"]
    for name in ("position", "angular_velocity"):
        value = trajectory[f"{name}/value"]
        assert value.dtype == np.float32
        assert (value[:] == full[f"{name}/value"][:].astype(np.float32)).all()
    assert trajectory["time"].dtype == np.float64
    assert part["observables/energy/value"].dtype == np.float64
    mass = full["mass"][:][:, None]
    momentum = full["linear_momentum/value"][:]
    assert full["velocity/value"][:] == pytest.approx(momentum / mass, rel=1e-15)


@pytest.mark.parametrize("name", DERIVED)
def test_what_was_recorded_is_read_without_what_it_would_be_found_from(make, name):
    with particlerb.run(scene(make, output={"fields": [name]})) as t:
        assert (getattr(t, name) == t.read(name)).all()
        assert getattr(t, name).any()
        (other,) = set(DERIVED) - {name}
        with pytest.raises(KeyError, match=f"{other} was not recorded"):
            getattr(t, other)


@pytest.mark.parametrize(
    "move", [particlerb.run, lambda *made: list(particlerb.Simulation(*made).frames(0.1))]
)
def test_numbers_beyond_float32_end_a_run_before_them(make, tmp_path, move):
    path, words = tmp_path / "a.h5", "position is too large for float32: take output.dtype"
    body = make.body("far", velocity=[1e38, 0, 0], position=[3e38, 0, 0])
    case = make.case(body, t_end=1.0, every=0.1, output={"dtype": "float32"})
    with pytest.raises(particlerb.RunError, match=words):
        move(case, path)
    with particlerb.open(path) as t:  # x is 3.4e38 m at 0.4 s, as large as float32 can be
        assert 0 < t.n_frames <= 5
        assert t.position[:, 0, 0] == pytest.approx(3e38 + 1e38 * t.time, rel=1e-6)
    case["output"] = {}
    with particlerb.run(case) as t:
        assert t.n_frames == 11


def test_chunks_are_about_a_quarter_of_a_megabyte():
    assert frames_per_chunk(1, 3, 8, 10**6) == 1024
    assert frames_per_chunk(1000, 3, 8, 10**6) == 10
    assert frames_per_chunk(1000, 3, 4, 10**6) == 21
    assert frames_per_chunk(10**6, 3, 8, 10**6) == 1


def test_chunks_of_a_short_run_are_short():
    """Else a file of ten frames had the size of one of a thousand."""
    assert frames_per_chunk(1, 3, 8, 700) == 700
    assert frames_per_chunk(1, 3, 8, 10) == 64  # the run may be prolonged
    assert frames_per_chunk(1000, 3, 8, 64) == 10


def test_chunks_in_the_file(written):
    file = written()
    assert file["particles/trajectory/position/value"].chunks == (64, 3, 3)
    assert file["observables/energy/value"].chunks == (64,)
    assert file["observables/linear_momentum/value"].chunks == (64, 3)
    assert file["particles/trajectory/position/value"].compression is None


@pytest.mark.slow
def test_frames_larger_than_a_chunk_are_whole(make, tmp_path):
    """One frame is one chunk where there are many bodies; rows between probes as well."""
    n = 12_000
    cloud = make.body(count=n, place={"type": "random", "lower": [0, 0, 0], "upper": [1, 1, 1]})
    cloud |= {"velocity": {"random": 1.0}, "angular_velocity": {"random": 1.0}}
    check = {"body": "body[0]", "quantity": "position", "value": [0, 0, 0], "tolerance": 1e9}
    case = make.case(cloud, t_end=0.5, check={"value": [check | {"time": 0.25}]})
    with particlerb.run(case, tmp_path / "many.h5") as t, particlerb.run(case) as memory:
        assert t.file["particles/trajectory/position/value"].chunks == (1, n, 3)
        assert t.time.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
        for name in DEFAULT:
            assert (getattr(t, name) == getattr(memory, name)).all()
        expected = t.position[0] + t.time[:, None, None] * t.velocity[0]
        assert t.position == pytest.approx(expected, abs=1e-13)


# Overwriting, committing, killing


def test_an_existing_file_is_not_overwritten(make, tmp_path):
    path = tmp_path / "run.h5"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError, match="exists: give another name"):
        particlerb.run(scene(make), path)
    assert path.read_bytes() == b"precious"
    with particlerb.run(scene(make), path, overwrite=True) as t:
        assert t.n_frames == 24


def test_folders_of_the_output_are_made(make, tmp_path):
    with particlerb.run(scene(make), tmp_path / "a" / "b" / "run.vtkhdf") as t:
        assert t.n_frames == 24


WRITE = """
import sys, particlerb
from particlerb.record import writer
from particlerb.simulation import frame_times
writer.SECONDS_BETWEEN_COMMITS = 0.0
frame_times.FIRST_BATCH = frame_times.BATCH_FRAMES = 40
frame_times.BATCH_SECONDS = 1e9
shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
body = {"name": "b", "shape": shape, "mass": 2.0, "count": 50, "velocity": [0.5, 0.0, -1.0],
    "place": {"type": "grid", "spacing": 1.0}, "angular_velocity": [1.0, 0.4, -0.7]}
print("starts", flush=True)
particlerb.run({"run": {"t_end": 1e5, "every": 1.0}, "body": [body]}, sys.argv[1])
"""


def frames_in(path):
    """Frames that are committed."""
    with particlerb.open(path) as t:
        return t.n_frames


@pytest.mark.slow
@pytest.mark.compiled
def test_a_kill_leaves_all_committed_frames(tmp_path):
    """A process that commits as fast as it can, killed at any moment."""
    rng = random.Random(5)
    counts = []
    for k in range(8):
        path = tmp_path / f"{k}.h5"
        command = [sys.executable, "-c", WRITE, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
            process.stdout.readline()
            while not path.exists() or frames_in(path) == 0:
                assert process.poll() is None
                time.sleep(0.01)
            time.sleep(rng.uniform(0.0, 0.5))
            assert process.poll() is None
            os.kill(process.pid, signal.SIGKILL)
        with particlerb.open(path) as t:
            n = t.n_frames
            assert n % 40 == 0
            assert (t.time == np.arange(n)).all()
            assert len(t.energy) == n
            position, start = t.position, t.position[:1]
            moved = start + t.time[:, None, None] * [0.5, 0.0, -1.0]
            np.testing.assert_allclose(position, moved, rtol=1e-14, atol=1e-12)
            size = np.linalg.norm(t.orientation, axis=-1)
            np.testing.assert_allclose(size, 1.0, rtol=1e-14)
            counts.append(n)
        with h5py.File(path, "a") as file:  # and it can be opened for writing
            assert file.attrs["n_frames"] == n
    assert min(counts) > 0
    assert len(set(counts)) > 1
