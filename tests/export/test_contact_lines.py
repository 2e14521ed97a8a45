"""Contacts as lines of a VTKHDF file, read back by VTK."""

import numpy as np
import pytest

import particlerb
from particlerb.export import ExportError, export

vtk = pytest.importorskip("vtkmodules.vtkIOHDF")

BALL = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 1.0}
CASE = {
    "run": {"t_end": 0.3, "every": 0.05, "dt": 1e-3, "method": "strang"},
    "gravity": {"acceleration": [0.0, 0.0, -9.81]},
    "contact": {"stiffness": 1e4, "restitution": 0.5, "friction": 0.3},
    "wall": [{"name": "floor", "type": "plane", "normal": [0.0, 0.0, 1.0]}],
    "body": [
        BALL | {"name": "low", "position": [0.0, 0.0, 0.1]},
        BALL | {"name": "high", "position": [0.02, 0.0, 0.35]},
        BALL | {"name": "beside", "position": [1.0, 0.0, 0.1]},
    ],
    "output": {"fields": ["position", "orientation", "linear_momentum", "contacts"]},
}


def test_lines_join_what_touches_with_its_force_in_every_frame(tmp_path):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    path = tmp_path / "chains.vtkhdf"
    with particlerb.run(CASE) as t:
        assert export(t, path, "contacts") == t.n_frames == 7
        frames = [t.contacts(k) for k in range(7)]
        x, times = t.position, t.time
    assert len({one.wall.size for one in frames}) > 1
    assert any((one.wall < 0).any() for one in frames)
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 7
    for k, contacts in enumerate(frames):
        reader.SetStep(k)
        reader.Update()
        lines, m = reader.GetOutput(), contacts.wall.size
        assert lines.GetNumberOfCells() == lines.GetNumberOfLines() == m
        assert reader.GetTimeValue() == times[k]
        if not m:
            continue
        joined = vtk_to_numpy(lines.GetLines().GetConnectivityArray())
        assert np.array_equal(joined, np.arange(2 * m))
        ends = vtk_to_numpy(lines.GetPoints().GetData()).reshape(m, 2, 3)
        assert np.array_equal(ends[:, 0], x[k, contacts.body[:, 0]])
        is_wall = contacts.wall >= 0
        assert np.array_equal(ends[is_wall, 1], contacts.point[is_wall])
        assert np.array_equal(ends[~is_wall, 1], x[k, contacts.body[~is_wall, 1]])
        data = lines.GetCellData()
        assert np.array_equal(vtk_to_numpy(data.GetArray("force")), contacts.force)
        sizes = np.linalg.norm(contacts.force, axis=1)
        assert vtk_to_numpy(data.GetArray("size")) == pytest.approx(sizes, rel=1e-15)


def test_contacts_that_were_not_recorded_are_asked_for(tmp_path):
    case = CASE | {"output": {"fields": ["position", "orientation"]}}
    with particlerb.run(case) as t, pytest.raises(ExportError, match="contacts"):
        export(t, tmp_path / "a.vtkhdf", "contacts")
