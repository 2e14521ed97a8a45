"""Commands whose file does not fit leave what was there, and nothing that is torn."""

import contextlib
import os
import resource
import sys

import pytest

from particlerb.cli import main
from particlerb.cli.exit_codes import Ending
from particlerb.cli.report import _LOG_HEAD, _new_log
from particlerb.record.output_path import appearing

pytestmark = pytest.mark.once

CASE = """
[run]
t_end = 0.2
every = 0.1
[[body]]
name = "a"
shape = { type = "points", position = [[0, 0, 0], [0, 1, 0], [1, 0, 0]], mass = 1.0, radius = 0.1 }
angular_velocity = [1.0, 0.4, -0.7]
"""
OLD = "what was there before"
ENOUGH_FOR_NO_FILE = 100


@contextlib.contextmanager
def full_disk(most=ENOUGH_FOR_NO_FILE):
    """Files of this process cannot get longer than some bytes.

    Python 3.11 takes no note of bytecode that was cut, and could import it no more.
    """
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        sys.dont_write_bytecode = bytecode


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """A folder with a case and its trajectory."""
    folder = tmp_path_factory.mktemp("read")
    (folder / "a.toml").write_text(CASE)
    assert main(["run", str(folder / "a.toml"), "-q", "-o", str(folder / "a.h5")]) == 0
    return folder


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("export a.h5 --to npz", ["out.npz"]),
        ("export a.toml --bodies a --to mjcf", ["out.xml"]),
        ("export a.toml --bodies a --to lammps", ["out.mol", "out.rigid"]),
        ("export a.toml --bodies a --to gsd", ["out.gsd"]),
        ("export a.toml --to mjcf", ["out.xml"]),
        ("export a.toml --to lammps", ["out.in", "out.data"]),
        ("plot a.h5", ["out.png"]),
    ],
)
def test_a_file_that_does_not_fit_leaves_that_from_before(
    read, tmp_path, monkeypatch, capsys, words, names
):
    monkeypatch.chdir(read)
    argv = [*words.split(), "-o", str(tmp_path / names[0]), "--overwrite"]
    for name in names:
        (tmp_path / name).write_text(OLD)
    with full_disk():
        assert main(argv) == 1
    err = capsys.readouterr().err
    assert f"cannot write {tmp_path / names[0]}: {os.strerror(27)}" in err
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(names, OLD)
    assert main(argv) == 0
    assert {*names} <= {path.name for path in tmp_path.iterdir()}
    assert all(OLD.encode() not in (tmp_path / name).read_bytes() for name in names)


def test_a_file_that_is_whole_is_said_to_be_written(tmp_path, monkeypatch):
    """A disk that fails behind that, where there is nothing to remove, is not asked."""
    monkeypatch.setattr(os, "unlink", lambda *_: pytest.fail("removed"))
    with appearing(tmp_path / "a.txt") as (new,):
        new.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_log_whose_first_line_did_not_fit_is_begun_anew(tmp_path):
    log = tmp_path / "a.log"
    with full_disk(50), pytest.raises(Ending, match="File too large"):
        _new_log(log)
    assert log.stat().st_size == 50
    _new_log(log).close()
    assert log.read_text() == f"{_LOG_HEAD}\n"
