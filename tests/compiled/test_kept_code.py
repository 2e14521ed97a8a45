"""Where compiled code is kept, and what is done where it cannot be, or is damaged."""

import errno
import importlib.util
import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import particlerb
from particlerb.compiled import jit as _jit

PACKAGE = Path(particlerb.__file__).parent


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


# A cache that is full, or damaged

MODULE = """
from particlerb.compiled.jit import kernel

@kernel
def double(x):
    return 2 * x

@kernel
def treble(x):
    return 3 * x
"""


@pytest.fixture
def fresh(tmp_path, monkeypatch):
    """Kernels as a new process has them, and the folder of their compiled code."""
    (tmp_path / "kernels.py").write_text(MODULE)
    (tmp_path / "cache").mkdir()
    monkeypatch.setattr(_jit, "CACHE_FOLDER", str(tmp_path / "cache"))
    _jit.warn_once.cache_clear()

    def load():
        spec = importlib.util.spec_from_file_location("kernels", tmp_path / "kernels.py")
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, "kernels", module)  # what is kept imports it by its name
        spec.loader.exec_module(module)
        return module

    yield load, tmp_path / "cache"
    _jit.warn_once.cache_clear()


def works(load, is_kept):
    """A kernel computes, and was kept or not."""
    kernel = load().double
    assert kernel(2.5) == 5.0
    assert sum(kernel.stats.cache_hits.values()) == int(is_kept)


def the_warning(load):
    """The only one of two kernels, which compute all the same."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        works(load, False)
        assert load().treble(1) == 3
    (one,) = told
    assert one.category is _jit.CacheWarning
    return str(one.message)


def files(folder):
    """Index and data of the kernel."""
    (index,) = folder.rglob("*double*.nbi")
    (data,) = folder.rglob("*double*.nbc")
    return index, data


@pytest.mark.compiled
def test_a_folder_that_is_pruned_while_code_is_kept_is_made_again(fresh, monkeypatch):
    """A process with other sources may take it for one that nobody uses, between any two files."""
    load, folder = fresh
    save, pruned = _jit._CheckedFiles._save_data, []

    def prune_once(self, name, data):
        if not pruned:
            pruned.append(name)
            shutil.rmtree(folder)
        save(self, name, data)

    monkeypatch.setattr(_jit._CheckedFiles, "_save_data", prune_once)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        works(load, False)
    assert pruned
    works(load, True)


@pytest.mark.compiled
def test_code_that_is_kept_makes_its_folder_one_in_use(fresh):
    """Folders are pruned by their times: one that is filled for long was the oldest."""
    load, folder = fresh
    works(load, False)
    os.utime(folder, (0.0, 0.0))
    assert load().treble(1) == 3
    assert folder.stat().st_mtime > 0.0


@pytest.mark.compiled
@pytest.mark.parametrize("which", [0, 1])
def test_what_is_damaged_is_thrown_away(fresh, which):
    """Emptied, cut and changed anywhere; the next start but one finds whole files again."""
    load, folder = fresh
    works(load, False)
    path = files(folder)[which]
    whole = path.read_bytes()
    places = sorted({0, 1, 20, 40, len(whole) // 2, len(whole) - 1})
    cut = [whole[:k] for k in places]
    changed = [whole[:k] + bytes([whole[k] ^ 4]) + whole[k + 1 :] for k in places]
    for content in (*cut, *changed, b"garbage" * 99, whole + b"x"):
        path.write_bytes(content)
        works(load, False)
        works(load, True)


@pytest.mark.compiled
def test_what_takes_so_long_is_said_once(fresh, monkeypatch, caplog):
    """Where a kernel is compiled, and not where its code is kept."""
    load, _ = fresh
    caplog.set_level("INFO", "particlerb")
    for is_kept in (False, True):
        monkeypatch.setattr(_jit, "WHEN_COMPILING", ["kernels, once, about 15 s"])
        works(load, is_kept)
        assert load().treble(1) == 3
        assert caplog.messages == ([] if is_kept else ["compiling kernels, once, about 15 s ..."])
        caplog.clear()


@pytest.mark.compiled
def test_data_of_another_signature_are_not_taken(fresh):
    """As two processes leave them that have chosen the same name at once."""
    load, folder = fresh
    kernel = load().double
    assert (kernel(2), kernel(2.5)) == (4, 5.0)
    one, two = sorted(folder.rglob("*.nbc"))
    shutil.copy(one, two)
    kernel = load().double
    assert (kernel(2), kernel(2.5)) == (4, 5.0)
    assert sum(kernel.stats.cache_hits.values()) == 1


def spoil(folder, how):
    """Make the folder of the compiled code useless."""
    if how == "file":
        folder.rmdir()
        folder.write_text("")
    elif how == "file within":
        for path in folder.iterdir():
            shutil.rmtree(path)
            path.write_text("")
    elif how == "folders":  # in place of files
        for path in files(folder):
            path.unlink()
            path.mkdir()


@pytest.mark.compiled
@pytest.mark.parametrize("how", ["file", "file within", "folders"])
def test_a_folder_that_cannot_be_used_is_one_warning(fresh, how):
    load, folder = fresh
    if how != "file":
        works(load, False)
    spoil(folder, how)
    assert "cannot be kept in" in the_warning(load)
    assert not list((Path(load().__file__).parent / "__pycache__").glob("*.nb?"))


@pytest.mark.compiled
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO])
def test_a_disk_that_is_full_is_one_warning(fresh, monkeypatch, code):
    """The write fails: nothing is left behind, and once there is room all is kept."""
    load, folder = fresh

    def fail(*names):
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr("os.replace", fail)
        assert os.strerror(code) in the_warning(load)
    assert not [path for path in folder.rglob("*") if path.is_file()]
    works(load, False)
    works(load, True)


@pytest.mark.compiled
def test_a_folder_that_is_removed_on_the_way_is_made_again(fresh):
    load, folder = fresh
    kernel = load().double
    shutil.rmtree(folder)
    assert kernel(2.5) == 5.0
    works(load, True)
    _, data = files(folder)
    data.unlink()
    works(load, False)
    works(load, True)


@pytest.mark.compiled
@pytest.mark.skipif(os.name == "nt", reason="no limits of files")
def test_a_process_that_may_write_no_file_says_so_in_one_line(fresh):
    """As the command line shows it."""
    from resource import RLIMIT_FSIZE, setrlimit

    load, folder = fresh
    code = f"""
import sys, warnings
from particlerb.compiled import jit as _jit
from particlerb.cli import warning_text
_jit.CACHE_FOLDER, warnings.formatwarning = {str(folder)!r}, warning_text
sys.path.insert(0, {str(folder.parent)!r})
import kernels
print(kernels.double(2.5), kernels.treble(1))
"""
    done = subprocess.run(
        [sys.executable, "-B", "-c", code],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: setrlimit(RLIMIT_FSIZE, (100, 100)),
    )
    assert (done.returncode, done.stdout) == (0, "5.0 3\n")
    assert done.stderr == (
        f"particlerb: warning: compiled code cannot be kept in {folder} (File too large): every"
        " start compiles again; NUMBA_CACHE_DIR names another folder\n"
    )
    assert not [path for path in folder.rglob("*") if path.is_file()]
    works(load, False)
    works(load, True)


def test_a_full_disk_is_not_blamed_on_the_case(make, monkeypatch):
    """Errors of files that the case does not name pass through as they are."""
    from particlerb.case import to_system

    def fail(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(to_system, "mass_properties", fail)
    with pytest.raises(OSError, match="No space left"):
        to_system.to_system(make.case(make.body()))


@pytest.mark.compiled
def test_code_from_disk_loads_nothing_that_only_the_compiler_needs(tmp_path):
    """Not even what it is linked with: of texts Numba's hash takes numbers of the process."""
    lines = """
import sys
import particlerb.compiled.lanes
from particlerb.compiled.jit import kernel

LATE = "numba.np.arraymath", "numba.np.arrayobj", "scipy.linalg"

@kernel
def is_ab(n):
    text = "ab" if n > 2 else "abc"
    return hash(text) == hash("ab")

def found():
    print(is_ab(3), is_ab(1), sum(is_ab.stats.cache_hits.values()))
    print(*[name for name in LATE if name in sys.modules])
"""
    (tmp_path / "hashed.py").write_text(lines)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(PACKAGE.parent)}
    told = [
        subprocess.run(
            [sys.executable, "-c", "import hashed; hashed.found()"],
            capture_output=True,
            text=True,
            check=True,
            cwd=tmp_path,
            env=environment,
        ).stdout
        for _ in range(2)
    ]
    assert told == [
        "True False 0\nnumba.np.arraymath numba.np.arrayobj scipy.linalg\n",
        "True False 1\n\n",
    ]
