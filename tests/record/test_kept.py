"""Files of releases, made by `make_kept.py`: what they hold is read for ever."""

import lzma
from pathlib import Path

import h5py
import numpy as np
import pytest

import particlerb
from particlerb.cli import main
from particlerb.record import provenance
from particlerb.record.schema import SCHEMA_VERSION
from particlerb.record.trajectory import TrajectoryError
from particlerb.record.verify import verify
from particlerb.view.replay import system_of

KEPT = sorted(Path(__file__).with_name("kept").glob("*.h5.xz"))


@pytest.fixture(params=KEPT, ids=lambda path: path.name)
def kept(request, tmp_path):
    """A kept file, unpacked, and what was exported from it then."""
    path = tmp_path / request.param.name.removesuffix(".xz")
    path.write_bytes(lzma.decompress(request.param.read_bytes()))
    return path, request.param.with_name(path.name).with_suffix(".csv").read_text()


def test_one_of_this_schema_is_kept():
    assert any(path.name == "schema_{}.{}.h5.xz".format(*SCHEMA_VERSION) for path in KEPT)


def test_a_kept_file_is_read(kept, tmp_path, capsys):
    path, table = kept
    with particlerb.open(path) as t:
        assert all(finding.is_whole for finding in verify(t))
        for name in (*t.fields, *t.other_fields):
            if name != "contacts":
                assert len(getattr(t, name)) == t.n_frames
        assert t.contacts(0).force.shape[1] == 3
        assert system_of(t).n_bodies == t.n_bodies
        every = []
        t.file.visititems(lambda name, item: every.append(name) or is_read(item))
        assert len(every) > 50
    assert main(["info", str(path), "--verify"]) == 0
    assert main(["export", str(path), "--to", "csv", "-o", str(tmp_path / "new.csv")]) == 0
    assert (tmp_path / "new.csv").read_text() == table


def is_read(item):
    """Read a dataset, or go on."""
    if isinstance(item, h5py.Dataset):
        item[()]


def test_a_kept_file_that_cannot_go_on_says_so(kept, capsys):
    """Its sources are no longer these; the message says which they were, and what to do."""
    path, _ = kept
    with h5py.File(path, "r+") as file:
        text = file["parameters/versions"][()].decode()
        assert '"sources"' in text
        provenance.write_text(file, "versions", text.replace('"sources": "', '"sources": "0'))
    assert main(["resume", str(path), "--t-end", "1"]) == 2
    err = capsys.readouterr().err
    assert "was made with other sources of particlerb" in err
    assert "run the case anew" in err
    assert len(err.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("version", "words"),
    [((3, 0), "a newer particlerb has written it"), ((1, 4), "an older particlerb has written it")],
)
def test_another_major_version_says_so(kept, version, words, capsys):
    path, _ = kept
    with h5py.File(path, "r+") as file:
        file.attrs["schema"] = np.array(version, dtype=np.int32)
    with pytest.raises(TrajectoryError, match=words):
        particlerb.open(path)
    for command in (["info"], ["resume"], ["view"], ["plot"], ["export", "--to", "csv"]):
        assert main([command[0], str(path), *command[1:]]) == 2
    err = capsys.readouterr().err
    assert err.count(words) == len(err.strip().splitlines()) == 5
