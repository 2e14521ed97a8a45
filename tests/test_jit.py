"""Compiled code follows the sources: an edit anywhere in the package, or a flag, recompiles."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import particlerb
from particlerb import _jit

PACKAGE = Path(particlerb.__file__).parent
SCRIPT = """
import numpy as np
from particlerb._jit import CACHE_FOLDER
from particlerb.bodies.bodies import Bodies
from particlerb.bodies.state import room_for
from particlerb.ledger import totals
one, three = np.ones(1), np.ones((3, 1))
bodies = Bodies(one, one, three, three, np.array([[1.0], [0], [0], [0]]), np.full(1, 4))
frames = room_for(1, 1, np.zeros((1, 4)))
for array in frames[:4]:
    array[:] = 0.0
frames.linear_momentum[0, 0, 0] = 2.0
print(totals(frames, bodies, np.zeros(3)).kinetic_energy[0], CACHE_FOLDER)
"""


def run_copy(folder, cache, **flags):
    """Kinetic energy of one body, p²/2M = 2, and the cache folder, by a copy of the package."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(cache), **flags}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        check=True,
        env=environment,
        cwd=folder,
    )
    value, where = done.stdout.split()
    return float(value), Path(where)


@pytest.fixture
def copy(tmp_path):
    """A copy of the package that may be edited."""
    ignore = shutil.ignore_patterns("__pycache__")
    shutil.copytree(PACKAGE, tmp_path / "particlerb", ignore=ignore)
    return tmp_path


@pytest.mark.compiled
def test_an_edit_in_another_file_never_leaves_stale_code_in_use(copy):
    cache = copy / "cache"
    value, first = run_copy(copy, cache)
    assert value == 2.0
    compiled = {path: path.stat().st_mtime_ns for path in first.rglob("*.nbc")}
    assert compiled
    assert run_copy(copy, cache) == (2.0, first)
    assert {path: path.stat().st_mtime_ns for path in first.rglob("*.nbc")} == compiled

    helper = copy / "particlerb" / "maths" / "vec3.py"
    text = helper.read_text()
    assert "return x[0] * y[0] +" in text
    helper.write_text(text.replace("return x[0] * y[0] +", "return 5.0 * x[0] * y[0] +"))
    assert run_copy(copy, cache)[0] == 10.0


@pytest.mark.compiled
def test_a_flag_of_the_compiler_has_its_own_cache(copy):
    _, first = run_copy(copy, copy / "cache")
    _, second = run_copy(copy, copy / "cache", NUMBA_BOUNDSCHECK="1")
    assert first != second


def test_old_folders_are_pruned(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for k in range(9):
        old = tmp_path / "particlerb" / f"old{k}"
        old.mkdir(parents=True)
        os.utime(old, (1000 + k, 1000 + k))
    folder = _jit.cache_folder()
    left = {path.name for path in (tmp_path / "particlerb").iterdir()}
    assert left == {folder.name, *(f"old{k}" for k in range(9 - _jit.FOLDERS_KEPT + 1, 9))}


@pytest.mark.skipif(os.name == "nt" or os.getuid() == 0, reason="root may write anywhere")
def test_a_home_that_cannot_be_written_falls_back_to_a_private_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    monkeypatch.setenv("XDG_CACHE_HOME", str(locked))
    assert not _jit.cache_root().is_relative_to(locked)


def test_a_cache_that_is_a_file_falls_back_to_a_private_folder(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    root = _jit.cache_root()
    assert root.is_dir()
    if os.name != "nt":
        assert not root.stat().st_mode & 0o022
