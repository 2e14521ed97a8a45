"""Exported files, read by the programs they are for, beside the trajectory they come from."""

import csv
import json
import os
import stat
import time

import h5py
import numpy as np
import pytest
from formulas import product
from numba import config

import particlerb
from particlerb.case.output import FIELDS_OF_CONTACT
from particlerb.cli import main
from particlerb.export import FORMATS, ExportError, export
from particlerb.export.surfaces import equal_ellipsoid
from particlerb.record.schema import SERIES
from particlerb.record.trajectory import Trajectory


@pytest.fixture(scope="module")
def path(make, tmp_path_factory):
    """A file with principal axes that are not the body's, spheres, a rod; 11 frames."""
    r = np.random.default_rng(3)
    points = {"position": r.standard_normal((5, 3)).tolist(), "mass": r.uniform(1, 2, 5).tolist()}
    motion = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}
    dumbbell = {"type": "points", "position": [[0, 0, 0], [0, 1, 0]], "mass": [1, 2]}
    bodies = [
        {"name": "odd", "shape": {"type": "points"} | points, "orientation": [0.8, 0, 0.6, 0]},
        make.body("brick", count=2, place={"type": "grid", "spacing": 3.0}, **motion),
        {"name": "Hantel ü", "shape": dumbbell | {"radius": [0.2, 0.3]}, "position": [5, 0, 0]},
    ]
    bodies[0].update(motion)
    bodies[2].update(motion)
    path = tmp_path_factory.mktemp("export") / "run.h5"
    particlerb.run(make.case(*bodies), path).close()
    return path


@pytest.fixture
def trajectory(path):
    with particlerb.open(path) as opened:
        yield opened


def test_gsd_has_the_principal_frame(path, tmp_path, make):
    """Q diag(moments) Qᵀ is the tensor in the world, p gives the angular momentum back."""
    import gsd.hoomd

    with particlerb.open(path) as t:
        assert export(t, tmp_path / "a.gsd", "gsd") == 11
        frames = gsd.hoomd.open(tmp_path / "a.gsd")
        assert len(frames) == 11
        for k, frame in enumerate(frames):
            assert frame.configuration.step == k
            assert frame.particles.position == pytest.approx(t.position[k], rel=1e-6, abs=1e-6)
            assert frame.particles.velocity == pytest.approx(t.velocity[k], rel=1e-6, abs=1e-6)
            assert frame.log["time"] == t.time[k]
            assert frame.log["energy"] == pytest.approx(t.energy[k])
            for b in range(4):
                q, moments = frame.particles.orientation[b], frame.particles.moment_inertia[b]
                Q = make.rotation(q).as_matrix()
                expected = tensor_from_particles(t, make, k, b)
                assert pytest.approx(expected, abs=2e-5) == Q @ np.diag(moments) @ Q.T
                S = 0.5 * product([1, -1, -1, -1] * q, frame.particles.angmom[b])
                assert S[0] == pytest.approx(0.0, abs=1e-5)
                assert pytest.approx(t.angular_momentum[k, b], abs=2e-5) == Q @ S[1:]
        assert frames[0].particles.types == ["odd", "brick", "Hantel ü"]
        assert frames[0].particles.typeid.tolist() == [0, 1, 1, 2]
        assert (frames[0].configuration.box[:3] / 2 >= np.abs(t.position).max(axis=(0, 1))).all()


def tensor_from_particles(t, make, k, b):
    """Inertia tensor of a body in the world, summed from its particles."""
    offset, kind = t.particles.offset, t.kind[b]
    own = slice(offset[kind], offset[kind + 1])
    m, radius = t.particles.mass[own], t.particles.radius[own]
    r = make.rotation(t.orientation[k, b]).apply(t.particles.position[own])
    tensor = 0.4 * (m * radius**2).sum() * np.eye(3)
    return tensor + (m * (r * r).sum(axis=1)).sum() * np.eye(3) - np.einsum("i,ij,ik", m, r, r)


def test_gsd_shapes_are_what_the_bodies_are(trajectory, tmp_path, make):
    import gsd.hoomd

    export(trajectory, tmp_path / "a.gsd", "gsd", frames=slice(3, 4))
    particles = gsd.hoomd.open(tmp_path / "a.gsd")[0].particles
    odd, _, dumbbell = particles.type_shapes
    assert odd["type"] == "Ellipsoid"
    squares = np.array([odd[axis] for axis in "abc"]) ** 2
    moments = trajectory.mass[0] / 5.0 * (squares.sum() - squares)
    assert moments == pytest.approx(particles.moment_inertia[0], rel=1e-5)
    assert dumbbell["type"] == "SphereUnion"
    assert dumbbell["diameters"] == [0.4, 0.6]
    Q = make.rotation(particles.orientation[3])
    found = particles.position[3] + Q.apply(np.array(dumbbell["centers"]))
    assert found == pytest.approx(trajectory.particle_positions(3)[-2:], abs=1e-5)


def test_an_ellipsoid_of_a_rod_can_be_seen():
    rod = equal_ellipsoid(np.array([2.0, 2.0, 0.0]), 2.0)
    assert rod[:2] == pytest.approx([0.02 * 5**0.5] * 2)
    assert equal_ellipsoid(np.zeros(3), 2.0).tolist() == [0.02] * 3


def test_particles_are_those_of_all_bodies(path, tmp_path):
    """H5MD and VTKHDF, positions and velocities, also of a selection."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    out = tmp_path / "p.vtkhdf"
    with particlerb.open(path) as t:
        export(t, out, "particles", frames=slice(0, None, 2))
        expected = np.array([t.particle_positions(k) for k in range(0, 11, 2)])
        with h5py.File(out) as file:
            group = file["particles/trajectory"]
            assert (group["position/value"][:] == expected).all()
            assert group["position/step"][:].tolist() == list(range(0, 11, 2))
            assert (group["time"][:] == t.time[::2]).all()
            assert group["body"][:].tolist() == [0] * 5 + [1] * 6 + [2] * 6 + [3] * 2
            assert group["diameter"][-2:].tolist() == [0.4, 0.6]
            mass, momentum = group["mass"][:], t.linear_momentum[::2].sum(axis=1)
            total = np.einsum("p,tpc->tc", mass, group["velocity/value"][:])
            assert total == pytest.approx(momentum, abs=1e-13)
        export(t, tmp_path / "one.h5", "particles", ["Hantel ü"], slice(4, 5), ["position"])
        with h5py.File(tmp_path / "one.h5") as file:
            assert (
                file["particles/trajectory/position/value"][0] == t.particle_positions(4)[-2:]
            ).all()
            assert "velocity" not in file["particles/trajectory"]
    reader = vtkHDFReader()
    reader.SetFileName(str(out))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 6
    reader.SetStep(5)
    reader.Update()
    points = reader.GetOutput().GetPoints().GetData()
    assert (vtk_to_numpy(points) == expected[5]).all()


def test_csv_has_all_digits(trajectory, tmp_path):
    export(trajectory, tmp_path / "a.csv", "csv", ["brick"], slice(2, 9, 3))
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [(int(row["frame"]), row["name"]) for row in rows] == [
        (frame, name) for frame in (2, 5, 8) for name in ("brick[0]", "brick[1]")
    ]
    for row in rows:
        frame, body = int(row["frame"]), int(row["body"])
        assert float(row["time"]) == trajectory.time[frame]
        for name, letters in (("position", "xyz"), ("orientation", "wxyz")):
            found = [float(row[f"{name}_{letter}"]) for letter in letters]
            assert found == getattr(trajectory, name)[frame, body].tolist()


def test_npz_holds_the_arrays(trajectory, tmp_path, monkeypatch):
    """Also where the frames come in many portions."""
    monkeypatch.setattr("particlerb.record.frame_reader.PORTION", 8)
    fields = ["orientation", "angular_velocity"]
    export(trajectory, tmp_path / "a.npz", "npz", ["odd", "brick[1]"], fields=fields)
    found = np.load(tmp_path / "a.npz")
    assert set(found) == {"frame", "time", "body", "name", "mass", *fields}
    assert found["body"].tolist() == [0, 2]
    assert found["name"].tolist() == ["odd", "brick[1]"]
    assert (found["time"] == trajectory.time).all()
    assert (found["orientation"] == trajectory.orientation[:, [0, 2]]).all()
    assert (found["angular_velocity"] == trajectory.angular_velocity[:, [0, 2]]).all()


@pytest.fixture(scope="module")
def pile(make, tmp_path_factory):
    """A file of three balls that touch the floor and each other, with all fields of contact."""
    if not config.DISABLE_JIT:
        pytest.skip("takes long to compile, and shows no more")
    path = tmp_path_factory.mktemp("pile") / "pile.h5"
    place = {"type": "grid", "spacing": 0.19, "n": [3, 1, 1], "origin": [0, 0, 0.09]}
    fields = ["position", *FIELDS_OF_CONTACT]
    keys = {"contact": make.hooke(1e3, overlap=0.5), "wall": [make.plane()], "dt": 0.01}
    balls = make.sphere("ball", count=3, place=place, velocity=[0, 0, -1])
    particlerb.run(make.case(balls, t_end=0.3, output={"fields": fields}, **keys), path).close()
    with particlerb.open(path) as opened:
        assert all(len(opened.contacts(k).wall) > 0 for k in range(2))
        yield opened


def rows_of(t, path, *fields, **keys):
    export(t, path, "csv", fields=fields, **keys)
    return list(csv.DictReader(path.read_text().splitlines()))


def test_csv_of_contacts_has_a_row_each(pile, tmp_path):
    rows = rows_of(pile, tmp_path / "a.csv", "contacts", frames=slice(1, 3))
    expected = [(k, pile.contacts(k)) for k in (1, 2)]
    assert len(rows) == sum(len(one.wall) for _, one in expected) > 2
    places = [(k, one, j) for k, one in expected for j in range(len(one.wall))]
    for row, (k, one, j) in zip(rows, places, strict=True):
        assert (int(row["frame"]), float(row["time"])) == (k, pile.time[k])
        assert [int(row["body"]), int(row["other"])] == one.body[j].tolist()
        assert int(row["wall"]) == one.wall[j]
        assert [float(row[f"force_{c}"]) for c in "xyz"] == one.force[j].tolist()
        assert [float(row[f"point_{c}"]) for c in "xyz"] == one.point[j].tolist()
        assert float(row["overlap"]) == one.overlap[j]
    own = rows_of(pile, tmp_path / "b.csv", "contacts", bodies=["ball[0]"])
    assert own
    assert all("0" in (row["body"], row["other"]) for row in own)


def test_csv_of_walls_and_of_bodies_that_touch(pile, tmp_path):
    rows = rows_of(pile, tmp_path / "a.csv", "wall_force", "wall_position")
    assert [row["name"] for row in rows] == ["floor"] * pile.n_frames
    found = [[float(row[f"wall_force_{c}"]) for c in "xyz"] for row in rows]
    assert found == pile.wall_force[:, 0].tolist()
    with pytest.raises(ExportError, match="energy: npz cannot hold it"):
        export(pile, tmp_path / "c", "npz", fields=["energy"])
    rows = rows_of(pile, tmp_path / "b.csv")  # of bodies, where nothing is said
    assert [int(row["contact_number"]) for row in rows] == pile.contact_number.ravel().tolist()
    assert [float(row["contact_overlap"]) for row in rows] == pile.contact_overlap.ravel().tolist()
    for pair in (["position", "contacts"], ["position", "energy"], ["wall_force", "energy"]):
        with pytest.raises(ExportError, match="ask for one sort"):
            export(pile, tmp_path / "c.csv", "csv", fields=pair)
    with pytest.raises(ExportError, match="lammps cannot hold it"):
        export(pile, tmp_path / "c", "lammps", fields=["contact_number"])


def test_csv_of_momenta_is_of_bodies_though_there_are_sums(trajectory, tmp_path):
    rows = rows_of(trajectory, tmp_path / "a.csv", "linear_momentum", bodies=["brick"])
    assert "name" in rows[0]


def test_csv_of_sums_has_the_momenta_of_all_bodies(pile, tmp_path):
    rows = rows_of(pile, tmp_path / "a.csv", "energy", "total_angular_momentum")
    names = [f"total_angular_momentum_{k}" for k in "xyz"]
    assert list(rows[0]) == ["frame", "time", "energy", *names]
    found = [[float(row[name]) for name in names] for row in rows]
    assert found == pile.observable("angular_momentum").tolist()


def test_csv_of_sums_over_all_bodies_has_a_row_per_frame(pile, tmp_path):
    rows = rows_of(pile, tmp_path / "a.csv", "energy", "linear_momentum_error", frames=slice(1, 9))
    momenta = [f"linear_momentum_error_{c}" for c in "xyz"]
    assert list(rows[0]) == ["frame", "time", "energy", *momenta]
    assert [int(row["frame"]) for row in rows] == list(range(1, pile.n_frames))[:8]
    assert [float(row["energy"]) for row in rows] == pile.energy[1:9].tolist()
    found = [[float(row[f"linear_momentum_error_{c}"]) for c in "xyz"] for row in rows]
    assert found == pile.ledger.linear_momentum_error[1:9].tolist()


def test_npz_holds_contacts_and_walls(pile, tmp_path):
    export(pile, tmp_path / "a.npz", "npz", frames=slice(0, None, 2))
    found = np.load(tmp_path / "a.npz")
    assert (found["contact_number"] == pile.contact_number[::2]).all()
    assert found["wall_name"].tolist() == ["floor"]
    assert (found["wall_torque"] == pile.wall_torque[::2]).all()
    offset = found["contacts_offset"]
    for row, k in enumerate(range(0, pile.n_frames, 2)):
        for name, values in pile.contacts(k)._asdict().items():
            assert (found[f"contacts_{name}"][offset[row] : offset[row + 1]] == values).all()


def test_what_impacts_did_goes_into_all_formats_that_hold_sums(make, tmp_path):
    """Also where the file is copied whole."""
    contact = {"law": "events", "restitution": 0.5, "friction": 0.3}
    fall = {"contact": contact, "wall": [make.plane()], "gravity": {"acceleration": [0, 0, -9.81]}}
    ball = make.sphere(position=[0, 0, 0.105], velocity=[0, 0, -1.0])
    case = make.case(ball, t_end=0.1, every=0.02, **fall)
    with particlerb.run(case, tmp_path / "a.h5") as t:
        for to in ("h5", "npz"):
            export(t, tmp_path / f"made.{to}", to)
        export(t, tmp_path / "made.csv", "csv", fields=["impacts", "energy"])
        impacts, energy = t.observed("impacts"), t.energy
    assert impacts[-1] > impacts[0]
    with particlerb.open(tmp_path / "made.h5") as whole:
        assert np.array_equal(whole.observed("impacts"), impacts)
    assert np.array_equal(np.load(tmp_path / "made.npz")["impacts"], impacts)
    with (tmp_path / "made.csv").open() as file:
        rows = [(float(row["impacts"]), float(row["energy"])) for row in csv.DictReader(file)]
    assert rows == list(zip(impacts.tolist(), energy.tolist(), strict=True))


@pytest.mark.filterwarnings("ignore:Guessed all Masses")  # MDAnalysis 2.8
def test_lammps_dump_is_read_by_mdanalysis(trajectory, tmp_path):
    import MDAnalysis

    out = tmp_path / "a.lammpstrj"
    export(trajectory, out, "lammps")
    universe = MDAnalysis.Universe(
        str(out), format="LAMMPSDUMP", topology_format="LAMMPSDUMP", dt=0.1, convert_units=False
    )
    assert len(universe.trajectory) == 11
    lines = out.read_text().splitlines()
    corner = np.array([float(line.split()[0]) for line in lines[5:8]])
    for k, _ in enumerate(universe.trajectory):  # MDAnalysis counts from the corner of the box
        x = trajectory.position[k] - corner
        assert universe.atoms.positions == pytest.approx(x, rel=1e-6, abs=1e-6)
    first = dict(zip(lines[8].split()[2:], lines[9].split(), strict=True))
    q = [float(first[c]) for c in ("quatw", "quati", "quatj", "quatk")]
    assert q == trajectory.orientation[0, 0].tolist()
    assert [float(first[c]) for c in ("vx", "vy", "vz")] == trajectory.velocity[0, 0].tolist()
    assert (first["id"], first["type"]) == ("1", "1")


def test_a_long_trajectory_is_not_loaded_whole(path, tmp_path, monkeypatch):
    """No read of a field spans more states than a portion."""
    largest = []
    read = Trajectory.series

    def spy(self, path, *which):
        found = read(self, path, *which)
        if SERIES[path].per == "body":
            largest.append(found.shape[0] * found.shape[1])
        return found

    monkeypatch.setattr(Trajectory, "series", spy)
    monkeypatch.setattr("particlerb.record.frame_reader.PORTION", 8)
    with particlerb.open(path) as t:
        for to in ("gsd", "csv", "npz", "lammps", "particles"):
            export(t, tmp_path / f"out_{to}", to)
    assert 0 < max(largest) <= 8


@pytest.mark.parametrize("to", ["particles", "h5"])
def test_a_file_of_the_same_run_has_the_same_bytes(path, tmp_path, to):
    """HDF5 notes in whole seconds when it made a dataset, unless it is told not to."""
    with particlerb.open(path) as t:
        for name in ("first", "second"):
            export(t, tmp_path / name, to)
            time.sleep(1.1)
    assert (tmp_path / "first").read_bytes() == (tmp_path / "second").read_bytes()


@pytest.mark.parametrize("to", FORMATS)
def test_the_umask_alone_says_who_may_read_an_export(trajectory, pile, tmp_path, to):
    before = os.umask(0o002)
    try:
        export(pile if to == "contacts" else trajectory, tmp_path / "file", to)
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "file").stat().st_mode) == 0o664


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"bodies": ["brik"]}, 'brik: no such body; did you mean "brick"?'),
        ({"fields": ["colour"]}, "colour: no such field here; known: position"),
        ({"frames": slice(20, 30)}, "no frame is left: there are 11"),
        ({"frames": slice(None, None, -1)}, "frames must go forward"),
        ({"to": "xyz"}, "xyz: no such format; there are gsd, csv"),
    ],
)
def test_what_cannot_be_exported(trajectory, tmp_path, keys, words):
    with pytest.raises(ExportError, match=words):
        export(trajectory, tmp_path / "a", **({"to": "npz"} | keys))
    assert not list(tmp_path.iterdir())


def test_a_field_that_the_format_needs(make, tmp_path):
    case = make.case(make.body(), output={"fields": ["position"]})
    with particlerb.run(case, tmp_path / "run.h5") as t:
        for to in ("gsd", "particles"):
            with pytest.raises(ExportError, match=f"{to} needs orientation, not recorded"):
                export(t, tmp_path / "a", to)
        with pytest.raises(ExportError, match="velocity: no such field here"):
            export(t, tmp_path / "a", "npz", fields=["velocity"])
        for to in ("npz", "csv"):
            with pytest.raises(ExportError, match="linear_momentum: no such field here"):
                export(t, tmp_path / "a", to, fields=["linear_momentum"])
        export(t, tmp_path / "a.csv", "csv")


def test_a_failed_export_leaves_the_old_file(trajectory, tmp_path, monkeypatch):
    (tmp_path / "a.csv").write_text("precious")

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("particlerb.export.csv.csv.writer", fail)
    with pytest.raises(OSError, match="No space"):
        export(trajectory, tmp_path / "a.csv", "csv")
    assert [entry.read_text() for entry in tmp_path.iterdir()] == ["precious"]


# Command


def test_command_exports_beside_the_input(path, tmp_path, capsys):
    source = tmp_path / "run.h5"
    source.write_bytes(path.read_bytes())
    assert main(["export", str(source), "--to", "csv", "--frames", "-1", "--bodies", "odd"]) == 0
    assert capsys.readouterr().out == f"written: {tmp_path / 'run.csv'} (1 frame)\n"
    assert len((tmp_path / "run.csv").read_text().splitlines()) == 2
    assert main(["export", str(source), "--to", "particles"]) == 0
    assert (tmp_path / "run_particles.vtkhdf").exists()
    assert main(["export", str(source), "--to", "h5", "-o", str(tmp_path / "asked.h5")]) == 0
    assert main(["export", str(source), "--merge"]) == 0
    assert (tmp_path / "run_whole.h5").read_bytes() == (tmp_path / "asked.h5").read_bytes()
    capsys.readouterr()
    assert main(["export", str(source)]) == 2
    assert "give --to FORMAT: trajectories become gsd, csv" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "vtk"], "lammps, npz, h5; ParaView opens them as they are"),
        (["--to", "csv", "--bodies", "nobody"], "nobody: no such body"),
        (["--to", "csv", "-o", "."], ". is a folder: name a file with -o"),
        (["--to", "npz", "-o", "INPUT", "--overwrite"], "is the input: give another name with -o"),
        (["--to", "npz", "-o", "THERE"], "exists: give another name with -o, or --overwrite"),
    ],
)
def test_wrong_usage(path, tmp_path, capsys, words, message):
    there = tmp_path / "there.npz"
    there.write_text("precious")
    words = [{"INPUT": str(path), "THERE": str(there)}.get(word, word) for word in words]
    assert main(["export", str(path), *words]) == 2
    assert message in capsys.readouterr().err
    assert there.read_text() == "precious"


@pytest.mark.parametrize("frames", ["a", "1:2:3:4", "::-1", "::0", ""])
def test_wrong_frames(path, frames, capsys):
    assert main(["export", str(path), "--to", "csv", f"--frames={frames}"]) == 2
    assert "must" in capsys.readouterr().err


def test_info_and_export_agree_on_what_is_there(path, tmp_path, capsys):
    assert main(["info", str(path), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    main(["export", str(path), "--to", "npz", "-o", str(tmp_path / "a.npz")])
    found = np.load(tmp_path / "a.npz")
    assert set(facts["fields"]) < set(found)
    with h5py.File(path) as file:
        assert {name.removeprefix("total_") for name in facts["sums"]} == set(file["observables"])
    assert found["position"].shape[:2] == (facts["frames"], facts["bodies"])
