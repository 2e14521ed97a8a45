"""One file, many readers: each tool opens a written file as it is, and reads the same numbers."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest

import particlerb
from particlerb.case.output import FIELDS_OF_CONTACT, FIELDS_OF_JOINTS
from particlerb.record.schema import FIELDS, SERIES

ALL = list(FIELDS)
CORE = ("position", "orientation", "linear_momentum", "angular_momentum")


def scene(make, n=3, **keys):
    """Bodies that move and turn, and a rod beside them; 12 frames."""
    spin = {"angular_velocity": {"random": 1.0}, "velocity": {"random": 1.0}}
    place = {"type": "grid", "spacing": 2.0}
    many = make.body("brick", count=n, place=place, **spin)
    rod = make.body("rod", shape={"type": "rod", "length": 3.0}, position=[9, 0, 0])
    return make.case(many, rod, t_end=1.1, **keys)


@pytest.fixture(scope="module", params=[".h5", ".vtkhdf"])
def written(make, tmp_path_factory, request):
    """Path of a file, and its numbers as plain h5py reads them."""
    path = tmp_path_factory.mktemp("readers") / f"run{request.param}"
    particlerb.run(scene(make), path).close()
    return path, numbers(path)


def numbers(path):
    with h5py.File(path, locking=False) as file:
        group = file["particles/trajectory"]
        found = {name: group[f"{name}/value"][:] for name in CORE if name in group}
        observables = {name: entry["value"][:] for name, entry in file["observables"].items()}
        mass = group["mass"][:]
        return SimpleNamespace(
            time=group["time"][:], mass=mass, extent=group["extent"][:], **found
        ), observables


def vtk_frames(path):
    """Output of VTK's reader for each of its steps."""
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    for step in range(reader.GetNumberOfSteps()):
        reader.SetStep(step)
        reader.Update()
        yield reader.GetTimeValue(), reader.GetOutput()


def test_vtk(written):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    path, (file, _) = written
    times = []
    for step, (time, output) in enumerate(vtk_frames(path)):
        data = output.GetPointData()
        names = {data.GetArrayName(k) for k in range(data.GetNumberOfArrays())}
        assert names == {*CORE[1:], "id", "mass", "extent", "kind"}
        assert (vtk_to_numpy(output.GetPoints().GetData()) == file.position[step]).all()
        for name in CORE[1:]:
            assert (vtk_to_numpy(data.GetArray(name)) == getattr(file, name)[step]).all()
        assert (vtk_to_numpy(data.GetArray("mass")) == file.mass).all()
        assert (vtk_to_numpy(data.GetArray("extent")) == file.extent).all()
        assert output.GetNumberOfVerts() == output.GetNumberOfPoints() == 4
        times.append(time)
    assert times == file.time.tolist()
    assert len(times) == 12


def test_vtk_reads_what_is_recorded(make, tmp_path):
    """Single precision, other fields; without positions the file has nothing for VTK."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    path = tmp_path / "run.vtkhdf"
    output = {"fields": ["position", "angular_velocity"], "dtype": "float32"}
    with particlerb.run(scene(make, output=output), path) as t:
        omega = t.read("angular_velocity")
    frames = [output for _, output in vtk_frames(path)]
    assert len(frames) == 12
    found = vtk_to_numpy(frames[-1].GetPointData().GetArray("angular_velocity"))
    assert found.dtype == np.float32
    assert (found == omega[-1]).all()
    particlerb.run(scene(make, output={"fields": ["orientation"]}), tmp_path / "no.h5").close()
    with h5py.File(tmp_path / "no.h5") as file:
        assert "VTKHDF" not in file


def test_nothing_is_stored_twice(written):
    path, (file, _) = written
    with h5py.File(path) as root:
        views = [root["VTKHDF/Points"], *root["VTKHDF/PointData"].values()]
        assert all(view.is_virtual for view in views)
        assert {source.file_name for view in views for source in view.virtual_sources()} == {"."}
        assert (root["VTKHDF/Points"][:] == file.position.reshape(-1, 3)).all()
        steps = root["VTKHDF/Steps"]
        assert steps.attrs["NSteps"] == root.attrs["n_frames"] == len(steps["Values"]) == 12
        constants = ("PartOffsets", "NumberOfParts", "CellOffsets", "ConnectivityIdOffsets")
        assert all(steps[name].id.get_storage_size() == 0 for name in constants)


def test_the_extent_holds_all_particles(make, tmp_path):
    """Edges of a box about the centre of mass; none so thin that it cannot be seen."""
    shape = {"type": "points", "position": [[0, 0, 0], [3, 0, 1]], "mass": [2, 1]}
    bodies = [
        {"name": "pair", "shape": shape | {"radius": [0.5, 0.0]}},
        make.body("rod", shape={"type": "rod", "length": 3.0, "n": 2}),
        make.body("point", [0, 0, 0]),
    ]
    with particlerb.run(make.case(*bodies), tmp_path / "run.h5") as t:
        extent = t.file["particles/trajectory/extent"][:]
        length = 2 * np.abs(t.particles.position[2:4]).max()
    assert extent[0] == pytest.approx([2 * 2.0, 2 * 0.5, 2 * (1 / 3 + 0.5)])
    assert extent[1] == pytest.approx([0.02 * length, 0.02 * length, length])
    assert extent[2] == pytest.approx(3 * [0.02 * 4.0])


def test_mdanalysis(written):
    import MDAnalysis

    path, (file, observables) = written
    universe = MDAnalysis.Universe.empty(4, trajectory=False)
    universe.load_new(str(path), format="H5MD", convert_units=False)
    assert len(universe.trajectory) == 12
    for step, frame in enumerate(universe.trajectory):
        assert (frame.positions == file.position[step].astype(np.float32)).all()
        assert frame.time == file.time[step]
        for name, values in observables.items():
            assert (frame.data[name] == values[step]).all()


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_xarray(written, engine):
    import xarray

    path, (file, observables) = written
    for name in CORE:
        group = f"particles/trajectory/{name}"
        with xarray.open_dataset(path, group=group, engine=engine) as found:
            axis = "wxyz" if name == "orientation" else "xyz"
            assert found["value"].dims == ("time", "body", axis)
            assert (found["value"].values == getattr(file, name)).all()
            assert (found["time"].values == file.time).all()
            assert found["value"].attrs["units"] == FIELDS[name].units
    with xarray.open_dataset(path, group="particles/trajectory", engine=engine) as found:
        assert found["mass"].dims == ("body",)
        assert (found["mass"].values == file.mass).all()
    with xarray.open_dataset(path, group="observables/angular_momentum", engine=engine) as found:
        assert (found["value"].values == observables["angular_momentum"]).all()


def test_xarray_opens_the_tree(written):
    import xarray

    path, (file, observables) = written
    with xarray.open_datatree(path, engine="netcdf4") as tree:
        assert (tree["particles/trajectory/position/value"].values == file.position).all()
        assert (tree["observables/energy/value"].values == observables["energy"]).all()
    with xarray.open_datatree(path, engine="h5netcdf", phony_dims="sort") as tree:
        assert (tree["particles/trajectory/position/value"].values == file.position).all()


OPTIONAL = {name: [name] for name in (*FIELDS_OF_CONTACT, *FIELDS_OF_JOINTS)} | {
    "joints": list(FIELDS_OF_JOINTS),
    "velocities": ["velocity", "angular_velocity"],
    "all": [*ALL[4:], *FIELDS_OF_CONTACT],
}


plain = pytest.mark.plain
EACH = [pytest.param(name, marks=plain) for name in OPTIONAL]


@pytest.fixture(scope="module", params=[*EACH, "all, float32"])
def optional(make, tmp_path_factory, request):
    """A file with an optional output, or all, with two walls and a table; or joints."""
    folder = tmp_path_factory.mktemp("optional")
    (folder / "points.csv").write_text("x y z m\n0 0 0 1\n1 0 0 1\n0 1 0 1\n")
    points = {"type": "points", "file": str(folder / "points.csv")}
    bodies = [
        make.sphere(
            count=2,
            place={"type": "grid", "spacing": 1.0, "origin": [0, 0, 0.1005]},
            velocity=[0, 0, -1],
        ),
        {"name": "points", "shape": points, "contact": False, "position": [0, 0, 9]},
    ]
    name, _, dtype = request.param.partition(", ")
    output = {"fields": [*CORE, *OPTIONAL[name]], "dtype": dtype or "float64"}
    if name.startswith("joint"):
        return jointed(make, folder / "run.h5", output)
    walls = [make.plane(), make.plane(name="side", normal=[0, 1, 0], point=[0, -1, 0])]
    numbers = {"contact": make.hooke(), "wall": walls, "output": output, "dt": 1e-3}
    path = folder / "run.h5"
    particlerb.run(make.case(*bodies, t_end=0.004, every=1e-3, **numbers), path).close()
    return path


def jointed(make, path, output):
    """A file of two doors, one on two hinges, and a body apart."""
    bodies = [
        make.body(name, position=[0.5, k, 0]) for k, name in enumerate(("one", "two", "three"))
    ]
    tables = [("one", 0, 0.0), ("two", 1, 0.0), ("two", 1, 0.5)]
    joints = [
        {"type": "hinge", "body": name, "at": [0.0, k, z], "axis": [0.0, 0.0, 1.0]}
        for name, k, z in tables
    ]
    keys = {"joint": joints, "gravity": {"acceleration": [0.0, 1.0, 0.0]}, "dt": 1e-3}
    scene = make.case(*bodies, t_end=0.004, every=1e-3, output=output, **keys)
    particlerb.run(scene, path).close()
    return path


def part_of(name):
    """What an observable of a file has entries of; empty where it is one for all."""
    kind = name.split("/")[1]
    return SERIES[f"observables/{kind}/value"].per if name.startswith("observables/") else ""


def datasets(path):
    """All numbers of a file that are no views, as plain h5py reads them."""
    found = {}

    def look_at(name, entry):
        if isinstance(entry, h5py.Dataset) and entry.dtype.kind in "iuf" and not entry.is_virtual:
            found[name] = entry[()]

    with h5py.File(path, locking=False) as file:
        file.visititems(look_at)
    return found


def test_every_optional_output_is_read_by_netcdf(optional):
    """Each variable of the file, by both libraries."""
    import h5netcdf
    import netCDF4

    expected = datasets(optional)
    assert len(expected.get("contacts/body", [0])) > 0
    with netCDF4.Dataset(optional) as whole, h5netcdf.File(optional, phony_dims="sort") as other:
        whole.set_auto_mask(False)
        for name, values in expected.items():
            for tree in (whole, other):
                assert np.array_equal(tree[name][...], values, equal_nan=True), name
        for name in filter(part_of, expected):
            part = part_of(name)
            assert whole[name].dimensions[:2] == ("time", part) or not name.endswith("/value")


TREES = [pytest.param("joints", marks=plain), pytest.param("all", marks=plain), "all, float32"]


@pytest.mark.parametrize("optional", TREES, indirect=True)
@pytest.mark.parametrize("engine", [{"engine": "netcdf4"}, {"engine": "h5netcdf"}])
def test_xarray_opens_the_tree_with_every_optional_output(optional, engine):
    import xarray

    names = {"phony_dims": "sort"} if engine["engine"] == "h5netcdf" else {}
    expected = datasets(optional)
    with xarray.open_datatree(optional, **engine, **names) as tree:
        for name, values in expected.items():
            assert np.array_equal(tree[name].values, values, equal_nan=True), name


def test_vtk_and_mdanalysis_read_every_optional_output(optional):
    import MDAnalysis
    from vtkmodules.util.numpy_support import vtk_to_numpy

    expected = datasets(optional)
    universe = MDAnalysis.Universe.empty(3, trajectory=False)
    universe.load_new(str(optional), format="H5MD", convert_units=False)
    parts = [name for name in expected if part_of(name) and name.endswith("/value")]
    for frame, (_, output) in zip(universe.trajectory, vtk_frames(optional), strict=True):
        place = expected["particles/trajectory/position/value"][frame.frame]
        assert (frame.positions == place.astype(np.float32)).all()
        assert (vtk_to_numpy(output.GetPoints().GetData()) == place).all()
        for name in parts:
            own = frame.data[name.split("/")[1]]
            assert (own == expected[name][frame.frame]).all()
        data = output.GetPointData()
        shown = {data.GetArrayName(k) for k in range(data.GetNumberOfArrays())}
        for name in shown - {"id", "mass", "extent", "kind"}:
            values = expected[f"particles/trajectory/{name}/value"][frame.frame]
            assert (vtk_to_numpy(data.GetArray(name)) == values).all()


def test_pyh5md(written):
    import pyh5md

    path, (file, observables) = written
    with pyh5md.File(str(path), "r") as root:
        group = root.particles_group("trajectory")
        for name in CORE:
            element = pyh5md.element(group, name)
            assert (element.value[:] == getattr(file, name)).all()
            assert (element.time[:] == file.time).all()
            assert element.step[:].tolist() == list(range(12))
        energy = pyh5md.element(root["observables"], "energy")
        assert (energy.value[:] == observables["energy"]).all()


def test_every_reader_reads_a_file_that_has_not_ended(make, tmp_path, monkeypatch):
    """As a kill, or a run that still goes on, leaves it: copied while the writer has it open."""
    import MDAnalysis
    from vtkmodules.util.numpy_support import vtk_to_numpy

    from particlerb.record import writer
    from particlerb.simulation import frame_times

    path, copy = tmp_path / "run.vtkhdf", tmp_path / "copy.vtkhdf"
    commit = writer.Recorder.commit

    def commit_and_copy(self):
        commit(self)
        if 4 <= self.n_frames < 12:
            shutil.copy(path, copy)

    monkeypatch.setattr(frame_times, "FIRST_BATCH", 4)
    monkeypatch.setattr(frame_times, "BATCH_FRAMES", 4)
    monkeypatch.setattr(writer, "SECONDS_BETWEEN_COMMITS", 0.0)
    monkeypatch.setattr(writer.Recorder, "commit", commit_and_copy)
    with particlerb.run(scene(make), path) as whole:
        position = whole.position
    with particlerb.open(copy) as part:
        n = part.n_frames
        assert 4 <= n < 12
        assert (part.position == position[:n]).all()
    found = [vtk_to_numpy(output.GetPoints().GetData()) for _, output in vtk_frames(copy)]
    assert len(found) == n
    assert (np.array(found) == position[:n]).all()
    universe = MDAnalysis.Universe.empty(4, trajectory=False)
    universe.load_new(str(copy), format="H5MD", convert_units=False)
    for step in range(n):
        universe.trajectory[step]
        assert (universe.atoms.positions == position[step].astype(np.float32)).all()


def rendered(path, step):
    """Where the picture is not black; by a process of its own, since OpenGL brings an LLVM."""
    out = path.with_suffix(".npy")
    words = [sys.executable, str(Path(__file__).with_name("render.py")), path, str(step), out]
    subprocess.run(words, check=True, capture_output=True, timeout=120)
    return np.load(out)


def test_a_rendered_body_has_its_place_size_and_orientation(make, tmp_path):
    """A 2 x 0.4 plank at x = 0.5 that turns about z: the picture is that of the turned plank."""
    shape = {"type": "points", "position": [[1, 0, 0], [-1, 0, 0], [0, 0.2, 0], [0, -0.2, 0]]}
    plank = make.body(
        "plank",
        shape=shape | {"mass": [1, 1, 1, 1]},
        position=[0.5, 0, 0],
        angular_velocity=[0, 0, 1.0],
    )
    del plank["mass"]
    path = tmp_path / "run.vtkhdf"
    particlerb.run(make.case(plank, t_end=1.0, every=0.5), path).close()
    pixel = 4.0 / 100
    y, x = (np.mgrid[:100, :100] - 49.5) * pixel
    for step, angle in enumerate((0.0, 0.5, 1.0)):
        c, s = np.cos(angle), np.sin(angle)
        along, across = c * (x - 0.5) + s * y, -s * (x - 0.5) + c * y
        expected = (np.abs(along) < 1.0) & (np.abs(across) < 0.2)
        differ = np.count_nonzero(rendered(path, step) != expected)
        assert differ < 0.05 * np.count_nonzero(expected)
