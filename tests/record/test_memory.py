"""A run that is kept in memory reads as the same run in a file."""

import numpy as np
import pytest

import particlerb
from particlerb.record import schema, writer
from particlerb.record.trajectory import TrajectoryError

OF_CONTACT = (*schema.CONTACT_FIELDS, *schema.WALLS, schema.CONTACTS)


def scene(make, dtype):
    """Two spheres that fall on a floor, with everything that can be recorded."""
    bodies = [
        make.sphere(position=[0.0, 0.0, z], name=name) for name, z in (("a", 0.09), ("b", 3.0))
    ]
    return make.case(
        *bodies,
        t_end=0.05,
        every=0.01,
        dt=0.005,
        gravity={"acceleration": [0.0, 0.0, -9.81]},
        contact={"stiffness": 1e3, "restitution": 0.5, "friction": 0.5, "overlap": 0.5},
        wall=[{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
        output={"fields": [*schema.FIELDS, *OF_CONTACT], "dtype": dtype},
    )


@pytest.mark.parametrize(("dtype", "waiting"), [("float64", 0), ("float32", 4_000_000)])
def test_memory_reads_as_a_file(make, tmp_path, monkeypatch, dtype, waiting):
    """Whether small arrays wait for the next commit or not."""
    monkeypatch.setattr(writer, "MOST_WAITING", waiting)
    case = scene(make, dtype)
    with particlerb.run(case) as kept, particlerb.run(case, tmp_path / "run.h5") as written:
        assert kept.n_frames == written.n_frames == 6
        assert kept.contacts(0).wall.tolist() == [0]  # something is recorded of contacts
        with pytest.raises(KeyError, match=r"it is in `trajectory.contacts\(frame\)`"):
            kept.read("contacts")
        for name in (*kept.fields, *OF_CONTACT[:-1], "time", "mass"):
            mine, theirs = getattr(kept, name), getattr(written, name)
            assert mine.dtype == theirs.dtype, name
            assert mine.tobytes() == theirs.tobytes(), name
        for table in ("ledger", "bodies", "particles"):
            for mine, theirs in zip(getattr(kept, table), getattr(written, table), strict=True):
                assert np.array_equal(mine, theirs)
        for frame in range(6):
            for mine, theirs in zip(kept.contacts(frame), written.contacts(frame), strict=True):
                assert mine.dtype == theirs.dtype
                assert np.array_equal(mine, theirs)
        for name in ("names", "wall_names", "fields", "other_fields", "n_contacts", "file_names"):
            assert getattr(kept, name) == getattr(written, name)
        for text in ("case", "plan", "identity", "versions", "machine", "case_resolved"):
            assert kept.parameter(text) == written.parameter(text)
        assert kept.parameter("seed") == written.parameter("seed")
        assert kept.case.model_dump() == written.case.model_dump()


def test_what_is_read_from_memory_is_a_copy(make):
    with particlerb.run(make.case(make.body())) as t:
        before = t.position[0, 0, 0]
        t.position[:] = 7.0
        t.read("position", slice(0, 1), 0)[:] = 7.0
        assert t.position[0, 0, 0] == before


def test_a_closed_run_in_memory_says_so(make):
    t = particlerb.run(make.case(make.body()))
    t.close()
    assert not t.file
    with pytest.raises(TrajectoryError, match="the trajectory is closed"):
        t.time  # noqa: B018
