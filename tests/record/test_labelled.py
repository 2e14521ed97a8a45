"""Trajectories with labels: xarray, pandas, and what notebooks show."""

import numpy as np
import pytest

import particlerb
from particlerb.record import schema

CASE = {
    "run": {"t_end": 1.0, "every": 0.25, "dt": 1e-3},
    "gravity": {"acceleration": [0, 0, -9.81]},
    "contact": {"stiffness": 1e4, "restitution": 0.5, "friction": 0.1},
    "body": [
        {"name": "a", "shape": {"type": "ball", "radius": 0.1}, "mass": 1.0, "count": 2,
         "position": [[0, 0, 0.2], [1, 0, 0.3]]},
        {"name": "b <i>", "shape": {"type": "ball", "radius": 0.1}, "mass": 2.0,
         "position": [2, 0, 0.2]},
    ],
    "wall": [{"name": "floor", "type": "plane", "normal": [0, 0, 1]}],
    "output": {"fields": ["position", "orientation", "velocity", "contact_number", "wall_force"]},
}  # fmt: skip


@pytest.fixture(scope="module")
def fallen():
    with particlerb.run(CASE) as trajectory:
        yield trajectory


def test_all_that_was_recorded_is_in_the_dataset(fallen):
    found = fallen.to_xarray()
    assert found.sizes == {"time": 5, "body": 3, "xyz": 3, "wxyz": 4, "wall": 1}
    assert found.indexes["body"].tolist() == ["a[0]", "a[1]", "b <i>"]
    assert found.indexes["wall"].tolist() == ["floor"]
    one = found.position.sel(body="b <i>", xyz="z", time=0.5)
    assert one.item() == fallen.position[2, 2, 2]
    assert np.array_equal(found.wall_force, fallen.wall_force)
    assert found.velocity.attrs == {"units": "m s-1", "long_name": "of the centre of mass"}
    totals = {name for name in found if "body" not in found[name].dims} - {"wall_force"}
    assert totals == {f"total_{name}" if name in schema.FIELDS else name for name in schema.LEDGER}
    assert np.array_equal(found.energy, fallen.energy)


def test_a_table_has_a_row_per_frame_and_body(fallen):
    table = fallen.to_pandas()
    assert table.shape == (15, 3 + 4 + 3 + 1)
    assert table.loc[(0.75, "a[1]"), "position_z"] == fallen.position[3, 1, 2]
    assert table["contact_number"].tolist() == fallen.contact_number.ravel().tolist()
    assert table.index.names == ["time", "body"]


def test_a_trajectory_says_what_it_holds(fallen):
    assert repr(fallen).startswith(
        "<Trajectory: frames: 5 from 0 to 1 s; bodies: a[0], a[1], b <i>; fields: position, "
    )
    assert "b &lt;i&gt;" in fallen._repr_html_()
    assert "<i>" not in fallen._repr_html_()


def test_a_library_that_is_not_there_is_named(fallen, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(ImportError, match="to_xarray needs xarray: pip install xarray"):
        fallen.to_xarray()
