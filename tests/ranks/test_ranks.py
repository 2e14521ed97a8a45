"""Scenes that ranks share: the bits of one process, whatever their number; what is wrong said."""

import argparse
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from stops import HERE, PLAIN, command, digests, line, needs_mpi, run_words, whole
from threads_as_ranks import over_ranks

import particlerb
from particlerb import ranks as of_package
from particlerb.cli import main
from particlerb.cli import ranks as of_commands
from particlerb.cli import run as of_runs
from particlerb.cli.report import Report
from particlerb.model import superblocks
from particlerb.model.names import BodyNames
from particlerb.model.superblocks import SUPERBLOCK, own_parts, parts_of
from particlerb.plan.segments import Plan
from particlerb.ranks import Ranks, as_agreed, end_all, launched
from particlerb.record import atomic
from particlerb.record.checkpoint import put, read_checkpoint, slots_in
from particlerb.record.checksums import frame_checksums
from particlerb.record.part_recorder import PartRecorder
from particlerb.record.trajectory import TrajectoryError
from particlerb.simulation import shares
from particlerb.simulation.resume import ResumeError, look_at


def run(path: Path, *more: str, ranks: int = 0) -> subprocess.CompletedProcess[str]:
    """The scene of the tests."""
    return command(*run_words(path, *more), ranks=ranks)


def state_in(path: Path) -> dict[str, bytes]:
    """The last state in a file, by names of its arrays."""
    with h5py.File(path, "r") as file:
        return {k: np.asarray(v).tobytes() for k, v in read_checkpoint(file).arrays.items()}


@pytest.fixture(scope="module")
def two(tmp_path_factory) -> Path:
    """A run of two ranks: four parts."""
    path = tmp_path_factory.mktemp("two") / "run.h5"
    done = run(path, ranks=2)
    assert done.returncode == 0, done.stderr
    return path


@needs_mpi
@pytest.mark.slow
def test_any_number_of_ranks_writes_what_one_process_writes(tmp_path, two):
    alone = run(tmp_path / "alone.h5", "--json")
    assert alone.returncode == 0, alone.stderr
    expected = digests(tmp_path / "alone.h5")
    assert "particles/trajectory/position/value" in expected
    assert digests(two) == expected
    done = command("export", two, "--to", "h5", "-o", tmp_path / "merged.h5")
    assert done.returncode == 0, done.stderr
    assert digests(tmp_path / "merged.h5") == expected
    assert state_in(tmp_path / "merged.h5") == state_in(tmp_path / "alone.h5")
    done = command("export", two, "--to", "h5", "--frames", "1:", "-o", tmp_path / "a.h5")
    assert done.returncode == 2
    assert "h5 is a whole trajectory" in done.stderr
    for ranks in (1, 3, 4):
        path = tmp_path / f"{ranks}.h5"
        done = run(path, "--json", ranks=ranks)
        assert done.returncode == 0, done.stderr
        assert digests(path) == expected, ranks
        assert done.stdout.replace(path.name, "alone.h5") == alone.stdout, ranks


@needs_mpi
@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "first", "last"), [("mechanisms.toml", 0.12, 0.16), ("stars.toml", 0.015, 0.02)]
)
def test_bodies_that_act_on_others_have_the_same_bits_on_any_number_of_ranks(
    tmp_path, case, first, last
):
    """Also where others go on: what joints carry, their coordinates, breaks, merged bodies."""
    scene = HERE / case
    done = command(scene, "-o", tmp_path / "0.h5", "--threads", "1", "--json")
    assert done.returncode == 0, done.stderr
    expected = digests(tmp_path / "0.h5")
    told = json.loads(done.stdout)
    assert [check["holds"] for check in told["checks"]] == [True] * len(told["checks"])
    for ranks, others in ((1, 4), (2, 3)):
        path = tmp_path / f"{ranks}.h5"
        end = "--set", f"run.t_end={first}", "--threads", "1", "-q"
        assert command(scene, "-o", path, *end, ranks=ranks).returncode == 0
        done = command("resume", path, "--t-end", str(last), "--json", ranks=others)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["checks"] == told["checks"]
        assert digests(path) == expected, ranks
    assert whole(path) == whole(tmp_path / "1.h5")
    if "observables/joint_force/value" not in expected:
        return
    with particlerb.open(path) as trajectory:
        names = [name.decode() for name in trajectory.file["joints/names"][:]]
        assert (trajectory.joint_break_time[-1] > 0.0).sum() == 1
        for name in ("pin[0]", "axle[2]", "weld[0]", "hub"):
            assert np.abs(trajectory.joint_force[-1, names.index(name)]).max() > 0.1, name


@pytest.mark.plain
def test_a_mechanism_over_two_superblocks_is_refused_by_name(monkeypatch, capsys):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    words = ["check", str(HERE / "mechanisms.toml"), "--ranks", "3"]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["ranks"]
    assert found["ranks_at_most"] == 4
    assert found["run_bytes"] == 512 * shares.BYTES_MOVED + 5 * shares.BYTES_TIED
    assert found["set_up_bytes"] == 785 * shares.BYTES_SET_UP + 11 * shares.BYTES_JOINT
    for change, name in (
        ("force.0.to=dust[0]", "force[0] and others tie 2, from dust[0], body 5 of the scene, to"),
        ("joint.5.to=link[0]", "joint[0] (pin[0]) and others tie 4, from link[0], body 0 of the"),
        ("joint.2.to=['cross[1]','door[1]']", "joint[2] (weld[0]) and others tie 5, from cross[0]"),
    ):
        assert main([*words, "--set", change]) == 2
        assert name in capsys.readouterr().err


@pytest.mark.plain
def test_check_says_who_may_share_an_attraction(monkeypatch, capsys):
    """Ranks have 256 targets or more; a tree, and too many particles, are refused."""
    words = ["check", str(HERE / "stars.toml"), "--set", "body.1.count=100", "--ranks"]
    assert main([*words, "2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["ranks"]
    names = "ranks_at_most", "parts", "bodies_of_rank", "copies_of_rank", "bytes_of_step"
    assert [found[name] for name in names] == [2, 1, 500, 0, 24 * 300]
    assert main([*words, "3"]) == 2
    assert "of 300 particles: a rank sums over the pairs of 256 or more" in capsys.readouterr().err
    assert main([*words, "2", "--set", "attraction.sum=tree"]) == 2
    assert 'attraction.sum = "direct"' in capsys.readouterr().err
    monkeypatch.setattr(shares, "MOST_ATTRACTED", 299)
    assert main([*words, "2"]) == 2
    assert "shares the attraction of 299 particles at most" in capsys.readouterr().err


@needs_mpi
@pytest.mark.compiled
def test_compiled_kernels_give_the_same_bits_on_three_ranks(monkeypatch, tmp_path):
    """Of free bodies alone: the other runs of ranks are plain Python."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    paths = tmp_path / "0.h5", tmp_path / "3.h5"
    alone, shared = (run_words(path, "-q", scene="free.toml") for path in paths)
    assert main([*map(str, alone)]) == 0
    done = command(*shared, ranks=3, NUMBA_DISABLE_JIT="0")
    assert done.returncode == 0, done.stderr
    assert digests(paths[1]) == digests(paths[0])


@needs_mpi
@pytest.mark.slow
def test_a_master_opens_as_one_and_is_whole(two):
    assert sorted(p.name for p in (two.parent / "run.parts").iterdir()) == [
        f"{k:04d}.h5" for k in range(4)
    ]
    found = command("info", two, "--json")
    sizes = [p.stat().st_size for p in (two, *two.with_suffix(".parts").iterdir())]
    assert json.loads(found.stdout)["size"] == sum(sizes)
    found = command("info", two, "--verify")
    assert found.returncode == 0, found.stdout + found.stderr
    xarray = pytest.importorskip("xarray")
    with particlerb.open(two) as trajectory:
        position = trajectory.position
    group = "particles/trajectory/position"
    with xarray.open_dataset(two, engine="h5netcdf", group=group) as data:
        assert np.array_equal(data["value"].values, position)
    reader = pytest.importorskip("vtkmodules.vtkIOHDF").vtkHDFReader()
    reader.SetFileName(str(two))
    reader.UpdateInformation()
    reader.SetStep(3)
    reader.Update()
    from vtkmodules.util.numpy_support import vtk_to_numpy

    points = vtk_to_numpy(reader.GetOutput().GetPoints().GetData())
    assert np.array_equal(points, position[3])


@needs_mpi
@pytest.mark.slow
@pytest.mark.parametrize("fault", ["missing", "short", "another"])
def test_a_part_that_does_not_fit_is_named(two, tmp_path, fault):
    shutil.copytree(two.parent, tmp_path, dirs_exist_ok=True)
    part = tmp_path / "run.parts" / "0002.h5"
    if fault == "missing":
        part.unlink()
    elif fault == "another":
        shutil.copy(part.with_name("0001.h5"), part)
    else:
        with h5py.File(part, "r+") as file:
            file.attrs["n_frames"] = np.int64(1)
    short = r" has 1 frame, and \d+ were committed" if fault == "short" else ""
    with pytest.raises(TrajectoryError, match=rf"run\.parts/0002\.h5{short}"):
        particlerb.open(tmp_path / "run.h5")
    done = command("info", tmp_path / "run.h5", "--verify")
    assert done.returncode == 2
    assert "0002.h5" in done.stderr


@pytest.mark.plain
def test_checkpoints_of_parts_that_do_not_fit_are_refused_on_all_ranks(monkeypatch, tmp_path):
    """Though the parts that cannot be joined are those of the second rank."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    path = tmp_path / "run.h5"
    words = ["--set", "body.0.count=1000", "-q", "--mpi"]  # four parts
    assert main([*map(str, run_words(path, scene="free.toml")), *words]) == 0
    with h5py.File(tmp_path / "run.parts/0003.h5", "r+") as part:
        for n, state in slots_in(part).items():
            content = io.BytesIO()
            np.savez(content, **state | {"last": state["last"][:, :3]})
            slots = part["checkpoint"].values()
            put(next(s.id for s in slots if s.attrs["frames"] == n), n, content.getvalue())
    for n in (1, 2):
        for told in over_ranks(n, lambda ranks: look_at(path, 0.4, ranks=ranks))[1]:
            assert isinstance(told, ResumeError), told
            assert "checkpoints of its parts do not fit" in str(told)


@pytest.mark.plain
def test_a_scene_of_parts_is_hashed_once_where_it_goes_on(monkeypatch, tmp_path):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    path = tmp_path / "run.h5"
    words = ["--set", "body.0.count=1000", "-q", "--mpi"]
    assert main([*map(str, run_words(path, scene="free.toml")), *words]) == 0
    hashed, digest = [], particlerb.simulation.run._digest
    counted = lambda prepared, of: hashed.append(of) or digest(prepared, of)  # noqa: E731
    monkeypatch.setattr("particlerb.simulation.run._digest", counted)
    ((told,),) = over_ranks(1, lambda ranks: look_at(path, 0.4, ranks=ranks))[1:]
    assert told.prepared.hash_of_scene
    assert len(hashed) == len(set(hashed)) > 1


@needs_mpi
@pytest.mark.slow
def test_what_cannot_be_shared_is_refused_once(tmp_path):
    done = command("pyramid", "-q", "-o", tmp_path / "a.h5", ranks=2)
    assert done.returncode == 2
    assert done.stderr.count('the law "impulse"') == 1, done.stderr
    done = run(tmp_path / "b.h5", "-q", ranks=5)
    assert done.returncode == 2
    assert done.stderr.count("5 ranks are too many for 1000 bodies") == 1, done.stderr
    assert not list(tmp_path.iterdir())


@needs_mpi
@pytest.mark.slow
def test_a_log_is_one_for_all_ranks(tmp_path):
    """The first rank alone writes it; where it must not, no rank waits for another."""
    second, options = Ranks(), argparse.Namespace(quiet=True, log=str(tmp_path / "c.log"))
    for second.number in (1, 0):
        assert not (tmp_path / "c.log").exists()
        none = Plan((), "", ())
        of_runs._execute(lambda _: None, tmp_path / "c.h5", none, options, 1, ranks=second)
    assert (tmp_path / "c.log").exists()
    done = run(tmp_path / "a.h5", "-q", "--log", str(tmp_path / "a.log"), ranks=2)
    assert done.returncode == 0, done.stderr
    lines = (tmp_path / "a.log").read_text().splitlines()
    assert sum("energy [J]" in line for line in lines) == 1
    (tmp_path / "b.log").write_text("mine\n")
    done = run(tmp_path / "b.h5", "-q", "--log", str(tmp_path / "b.log"), ranks=2)
    assert done.returncode == 2
    assert "is not a log" in done.stderr


@needs_mpi
@pytest.mark.slow
def test_several_processes_without_the_option_are_refused(tmp_path):
    words = [w for w in line(*run_words(tmp_path / "a.h5", "-q"), ranks=2) if w != "--mpi"]
    done = subprocess.run(words, env=PLAIN, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "2 processes were started to run the same case" in done.stderr


LARGEST = """
import sys
import numpy as np
from particlerb.ranks import ranks_of_mpi
ranks = ranks_of_mpi()
found = ranks.largest(np.array([np.nan if ranks.number == 1 else 1.0, 2.0 - ranks.number]))
sys.__stdout__.write("{} {}\\n".format(*found.tolist()))  # at once: others write too
"""


@needs_mpi
@pytest.mark.plain
def test_what_is_not_a_number_is_the_largest_on_all_ranks():
    """MPI gave it to some of four ranks, and a run in which a body had it did not end."""
    words = [*line(ranks=4)[:4], "-c", LARGEST]
    done = subprocess.run(words, env=PLAIN, capture_output=True, text=True, check=False)
    assert sorted(done.stdout.splitlines()) == ["inf 2.0"] * 4, done.stderr


@pytest.mark.plain
def test_a_rank_without_memory_is_named(monkeypatch, tmp_path, capsys):
    """The error of NumPy has numbers in place of words."""
    found = over_ranks(2, lambda of: of.together(lambda: np.zeros(of.number << 59)))[1]

    def fails(*_):
        raise found[0]

    monkeypatch.setattr(of_runs, "to_system", fails)
    assert main([str(HERE / "gas.toml"), "-o", str(tmp_path / "a.h5")]) == 1
    assert capsys.readouterr().err.endswith("particles would fit (rank 1)\n")


@pytest.mark.plain
def test_who_fails_alone_goes_no_further(monkeypatch, capfd):
    """MPI_Abort of MPICH may return; others would take what is sent next for an answer."""
    ranks, codes = of_package._RanksOfMPI.__new__(of_package._RanksOfMPI), []
    ranks.number, ranks.count, ranks.communicator = 1, 2, SimpleNamespace(Abort=codes.append)
    monkeypatch.setattr(os, "dup2", lambda *_: None)
    monkeypatch.setattr(os, "_exit", codes.append)
    end_all(ranks, OSError("no room"))
    end_all(ranks, KeyboardInterrupt())
    end_all(ranks, as_agreed(OSError("of all")))
    end_all(ranks, MemoryError())
    assert codes == [1, 1, 130, 130, 1, 1]
    assert capfd.readouterr().err.endswith("out of memory (rank 1)\n")


@pytest.mark.plain
@pytest.mark.parametrize(("owner", "name"), [(PartRecorder, "finish"), (Report, "close")])
def test_a_file_that_one_rank_cannot_finish_ends_all(monkeypatch, tmp_path, owner, name):
    """The others would wait for it: a part or the master, or the log of the first rank."""
    ended = set()
    for module in (of_package, of_commands):
        monkeypatch.setattr(module, "end_all", lambda _, error, *told: ended.add(str(error)))

    def fails(_):
        raise OSError("no room")

    monkeypatch.setattr(owner, name, fails)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    assert main([str(HERE / "gas.toml"), "--mpi", "-o", str(tmp_path / "a.h5")]) == 1
    assert any("no room" in words for words in ended)


def test_launchers_say_how_many_they_started():
    assert launched({}) == 1
    assert launched({"PMI_SIZE": "3"}) == 3
    assert launched({"OMPI_COMM_WORLD_SIZE": "4", "PMI_SIZE": ""}) == 4


def test_parts_are_whole_superblocks_and_depend_on_no_rank():
    parts = parts_of(3 * SUPERBLOCK + 1)
    assert [of.first for of in parts] == [k * SUPERBLOCK for k in range(4)]
    assert parts[-1].stop == 3 * SUPERBLOCK + 1
    assert len(parts_of(10**9)) <= 1024
    assert all(of.first % SUPERBLOCK == 0 for of in parts_of(10**9))
    ranks = Ranks()
    ranks.count = 3
    own = []
    for ranks.number in range(3):
        own += own_parts(7, ranks)
    assert own == list(range(7))


@pytest.mark.plain
def test_check_says_how_ranks_would_share_a_case(monkeypatch, capsys):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    case = str(HERE / "mix.toml")
    assert main(["check", case, "--ranks", "3", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["ranks"]
    names = "ranks_at_most", "parts", "bodies_of_part", "bodies_of_rank", "bytes_of_step"
    assert [found[name] for name in names] == [4, 4, 256, 512, 0]
    assert found["set_up_bytes"] == 512 * shares.BYTES_SET_UP  # each its own bodies
    words = "--set", "run.method=strang"
    assert main(["check", case, "--ranks", "3", "--json", *words]) == 0
    found = json.loads(capsys.readouterr().out)["ranks"]
    assert found["set_up_bytes"] == 1000 * shares.BYTES_SET_UP
    assert main(["check", case, "--ranks", "5"]) == 2
    assert "so 4 may share them" in capsys.readouterr().err


@pytest.mark.plain
def test_check_counts_the_bodies_that_a_rank_writes_and_others_move(monkeypatch, capsys):
    """The rank with the only part has all of them in memory, however few it moves."""
    found = []
    for n_bytes in (shares.BYTES_WRITTEN, 0):
        monkeypatch.setattr(shares, "BYTES_WRITTEN", n_bytes)
        assert main(["check", str(HERE / "heap.toml"), "--ranks", "4", "--json"]) == 0
        found.append(json.loads(capsys.readouterr().out)["ranks"]["run_bytes"])
    assert found[0] - found[1] >= 35 * 1400  # count = 20 and 15, and obstacles


@pytest.mark.plain
def test_old_parts_stay_until_new_ones_are_committed(monkeypatch, tmp_path):
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    path = tmp_path / "run.h5"
    words = [*map(str, run_words(path, "-q", "--mpi"))]
    assert main(words) == 0
    before = digests(path)
    assert main(words) == 2  # without --overwrite
    with monkeypatch.context() as patch:
        patch.setattr(atomic, "put", fails)
        assert main([*words, "--overwrite"]) == 1
    assert digests(path) == before
    assert main([*words, "--overwrite"]) == 0
    assert digests(path) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.2.parts", "run.h5"]
    other = tmp_path / "run.2.parts" / "0002.h5"  # of another run
    with h5py.File(other, "r+") as file:
        file.attrs["run"] = np.bytes_("another")
    plain = [word for word in words if word != "--mpi"]
    assert main([*plain, "--overwrite"]) == 0
    assert sorted(p.name for p in tmp_path.rglob("*.h5")) == ["0002.h5", "run.h5"]
    other.unlink()


@pytest.mark.plain
def test_a_copied_master_keeps_its_parts(monkeypatch, tmp_path, capsys):
    """Names of parts are relative: a copy beside its original has the same ones."""
    monkeypatch.setattr(superblocks, "SUPERBLOCK", 256)
    monkeypatch.setattr(of_commands, "ranks_of_mpi", Ranks)
    path, copy = tmp_path / "run.h5", tmp_path / "copy.bak"
    words = [*map(str, run_words(path, "-q", "--mpi"))]
    assert main(words) == 0
    copy.write_bytes(path.read_bytes())
    before = digests(path)
    plain = [word for word in words if word != "--mpi"]
    for again in (words, words, plain):
        assert main([*again, "--overwrite"]) == 0
        assert digests(copy) == before
    said = f"{tmp_path}/run.parts stays: {copy} has its parts there too"
    assert capsys.readouterr().err.splitlines() == [said]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy.bak", "run.h5", "run.parts"]


def fails(*_: object) -> None:
    """Fail as a disk does."""
    raise OSError(28, "No space left on device", "part")


def test_names_of_a_range_are_those_of_the_scene():
    records = [("a", 1), ("b", 5), ("c", 1)]
    whole, part = BodyNames(records), BodyNames(records, range(2, 7))
    assert list(part) == list(whole)[2:7] == part[:]
    assert part.find("b").tolist() == [0, 1, 2, 3]
    assert part.find("a").size == 0
    with pytest.raises(KeyError):
        part.find("d")


def test_checksums_of_parts_add_up():
    values = np.random.default_rng(1).random((3, 10, 4))
    whole = frame_checksums(3, [values, np.zeros((3, 0))])
    cut = [(values[:, lo:hi], lo) for lo, hi in ((0, 4), (4, 10))]
    shares = [frame_checksums(3, [own, np.zeros((3, 0))], lo) for own, lo in cut]
    assert np.array_equal(shares[0] + shares[1], whole)


def test_a_plain_run_imports_no_mpi():
    code = "import particlerb, particlerb.cli.run, sys; print('mpi4py' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], env=PLAIN, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"
