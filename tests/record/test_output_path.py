"""Where files are written: behind links, and never in the place of what is not a regular file."""

import errno
import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import h5py
import pytest

import particlerb
from particlerb.cli import main
from particlerb.model.superblocks import Range
from particlerb.record import writer
from particlerb.record.output_file import waiting_in
from particlerb.record.output_path import appearing, output_path
from particlerb.record.parts import Parts, note_master, parts_in
from particlerb.record.trajectory import TrajectoryError
from particlerb.record.writer_lock import WriterLock
from particlerb.simulation import frame_times

pytestmark = pytest.mark.once

CASE = """run = { t_end = 0.2, every = 0.1 }
[[body]]
name = "b"
shape = { type = "moments", inertia = [1.0, 2.0, 2.5] }
mass = 2.0
"""
COMMANDS = {
    "run": (["run", "a.toml", "-q"], ".h5"),
    "export": (["export", "sound.h5", "--to", "csv"], ".csv"),
    "export of bodies": (["export", "a.toml", "--to", "mjcf"], ".xml"),
    "plot": (["plot", "sound.h5"], ".png"),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Folder with a case and its file."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "a.toml").write_text(CASE)
    particlerb.run(folder / "a.toml", folder / "sound.h5").close()
    return folder


@pytest.fixture
def place(made, tmp_path, monkeypatch):
    """Folder to write in, with one of each of what may stand in the way."""
    for name in ("a.toml", "sound.h5"):
        shutil.copy(made / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe")
    Path("folder").mkdir()
    Path("folder/target").write_text("precious")
    Path("circle").symlink_to("circle")
    Path("dangling").symlink_to("folder/new")
    Path("link").symlink_to("folder/target")
    Path("to_device").symlink_to("/dev/null")
    Path("to_pipe").symlink_to("pipe")
    return tmp_path


@pytest.mark.parametrize("name", COMMANDS)
def test_a_new_name_without_a_suffix_gets_the_usual_one(name, place):
    words, suffix = COMMANDS[name]
    assert main([*words, "-o", "fresh"]) == 0
    assert Path("fresh").with_suffix(suffix).is_file()
    assert not Path("fresh").exists()


STAYS = {
    "/dev/null": "is not a regular file",
    "to_device": "is not a regular file",
    "pipe": "is not a regular file",
    "to_pipe": "is not a regular file",
    "circle": "leads in a circle",
    "folder": "is a folder",
    "folder/target/new": "folder/target is not a folder",
}


@pytest.mark.parametrize("name", STAYS)
@pytest.mark.parametrize("overwrite", [True, False])
def test_what_is_no_regular_file_stays(place, name, overwrite):
    with pytest.raises((FileExistsError, NotADirectoryError), match=STAYS[name]):
        output_path(Path(name), overwrite)


@pytest.mark.parametrize("name", ["folder/new", "folder/none/new"])
def test_a_folder_that_may_not_be_written_is_told_before_a_run(place, capsys, monkeypatch, name):
    folder, may = str((place / "folder").resolve()), os.access
    monkeypatch.setattr(os, "access", lambda path, mode: str(path) != folder and may(path, mode))
    words, _ = COMMANDS["run"]
    assert main([*words, "-o", name]) == 2
    out, err = capsys.readouterr()
    assert err == f"particlerb: {name}.h5 cannot be made: its folder may not be written\n"
    assert out == ""


def test_links_are_followed(place):
    behind = (place / "folder").resolve()
    assert output_path(Path("link"), True) == behind / "target"
    assert output_path(Path("dangling"), True) == behind / "new"
    assert output_path(Path("folder/../new/er"), False) == place.resolve() / "new" / "er"
    with pytest.raises(FileExistsError, match="link exists"):
        output_path(Path("link"), False)
    with pytest.raises(FileExistsError, match="a link to folder/new, which is not there"):
        output_path(Path("dangling"), False)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_asks(place, name, capsys):
    """A pipe, a circle and a dangling link are refused, and a target is written in its folder."""
    words, suffix = COMMANDS[name]
    for which in ("pipe", "dangling", "link"):
        Path(which).rename(which + suffix)
    Path(f"circle{suffix}").symlink_to(f"circle{suffix}")
    words = [*words, "-o"]
    assert main([*words, f"pipe{suffix}", "--overwrite"]) == 2
    assert main([*words, f"circle{suffix}", "--overwrite"]) == 2
    assert main([*words, f"circle{suffix}"]) == 2
    assert main([*words, f"dangling{suffix}"]) == 2
    err = capsys.readouterr().err
    assert err.count("particlerb: ") == len(err.splitlines()) == 4
    assert stat.S_ISFIFO(os.lstat(f"pipe{suffix}").st_mode)
    assert main([*words, f"link{suffix}", "--overwrite"]) == 0
    assert main([*words, f"dangling{suffix}", "--overwrite"]) == 0
    assert Path(f"link{suffix}").is_symlink()
    assert sorted(os.listdir("folder")) == ["new", "target"]
    for written in ("new", "target"):
        assert b"precious" not in Path("folder", written).read_bytes()


def test_a_link_where_a_file_is_begun_leads_nowhere(place):
    """What is not finished lies beside its place; a link of that name is not written through."""
    Path("a.h5.new").symlink_to("folder/target")
    assert main(["run", "a.toml", "-q", "-o", "a.h5"]) == 0
    assert not Path("a.h5").is_symlink()
    assert b"precious" in Path("folder/target").read_bytes()


@pytest.mark.parametrize("name", COMMANDS)
def test_a_name_is_as_long_as_the_disk_takes(place, capsys, name):
    """What is added until a file is whole takes nothing of it; one byte more is refused first."""
    words, suffix = COMMANDS[name]
    longest = os.pathconf(".", "PC_NAME_MAX") - len(suffix)
    assert main([*words, "-o", "n" * longest + suffix]) == 0
    assert main([*words, "-o", "n" * (longest + 1) + suffix]) in (1, 2)
    assert "File name too long" in capsys.readouterr().err
    names = [one for one in os.listdir() if len(one) > 60]
    assert names == ["n" * longest + suffix]


@pytest.mark.parametrize("name", ["x." + "n" * 200, "é." + "é" * 100])
def test_a_name_without_an_ending_may_be_as_long(place, name):
    """What is behind its last point is none."""
    with appearing(Path(name)) as (new,):
        new.write_text("whole")
    assert len(os.fsencode(waiting_in(place, Path(name)).name)) <= 143
    assert Path(name).read_text() == "whole"


@pytest.mark.parametrize("before", ["old", ""])
def test_files_that_belong_together_are_so_at_every_moment(tmp_path, monkeypatch, before):
    """Where the first one is, a kill at any rename has left others of its own; a failure none."""
    paths = [tmp_path / name for name in ("a.in", "a.data", "a.rigid")]
    replace, seen = Path.replace, []

    def shown():
        return [path.read_text() if path.exists() else "" for path in paths]

    def failing(new, place, at):
        seen.append(shown())
        if len(seen) > at:
            raise OSError(errno.EIO, "failed")
        return replace(new, place)

    for at in range(4):
        for path in paths if before else ():
            path.write_text(before)
        seen.clear()
        monkeypatch.setattr(Path, "replace", lambda new, place, at=at: failing(new, place, at))
        raises = pytest.raises(OSError, match="failed") if at < 3 else nullcontext()
        with raises, appearing(*paths) as unfinished:
            for new in unfinished:
                new.write_text("new")
            assert shown() == [before] * 3
        assert not any(first and {first, *rest} != {first} for first, *rest in [*seen, shown()])
        assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []
        if at < 3:
            assert "new" not in shown()
    assert shown() == ["new"] * 3


def test_what_a_run_writes_is_not_replaced(tmp_path, monkeypatch, capsys):
    """Its frames would go into a file without a name, and it would not know."""
    monkeypatch.chdir(tmp_path)
    run = {"t_end": 0.2, "every": 0.1}
    body = {"name": "a", "shape": {"type": "points", "position": [[0, 0, 0]], "mass": [1.0]}}
    particlerb.run({"run": run, "body": [body]}, "a.h5").close()
    shutil.copy("a.h5", "b.h5")
    before = Path("b.h5").read_bytes()
    words = ["export", "a.h5", "--to", "h5", "-o", "b.h5", "--overwrite"]
    lock = WriterLock(Path("b.h5"))
    assert main(words) == 1
    assert "b.h5: is being written by another run" in capsys.readouterr().err
    assert Path("b.h5").read_bytes() == before
    lock.close()
    assert main(words) == 0


@pytest.mark.parametrize("is_replaced", [False, True])
@pytest.mark.parametrize("is_resumed", [False, True])
def test_a_file_that_is_removed_while_it_is_written_is_told(
    place, monkeypatch, capsys, is_resumed, is_replaced
):
    """Without a name nobody can read what a run would compute for days."""
    commit, commits = writer.Recorder.commit, []
    words = ["run", "a.toml", "-q", "-o", "folder/a.h5", "--set", "run.t_end=2.0"]
    if is_resumed:
        shutil.copy("sound.h5", "folder/a.h5")
        words = ["resume", "folder/a.h5", "-q", "--t-end", "2.0"]

    def later(recorder):
        commits.append(recorder.n_frames)
        if len(commits) == 2 and is_replaced:
            Path("folder/target").replace("folder/a.h5")
        elif len(commits) == 2:
            shutil.rmtree("folder")
        commit(recorder)

    monkeypatch.setattr(writer.Recorder, "commit", later)
    monkeypatch.setattr(writer, "SECONDS_BETWEEN_COMMITS", -1.0)
    monkeypatch.setattr(frame_times, "BATCH_FRAMES", 1)
    assert main(words) == 1
    told = "cannot write folder/a.h5: was removed or replaced meanwhile; "
    told += "what is in folder/a.h5 cannot be read" if is_replaced else "no file was written"
    assert told in capsys.readouterr().err
    assert len(commits) < 4
    if is_replaced:
        assert Path("folder/a.h5").read_text() == "precious"


@pytest.fixture
def disturbed(place, monkeypatch):
    """Commit each frame, and before the second one do something to the file."""
    commit, commits = writer.Recorder.commit, []

    def disturb(act):
        def later(recorder):
            commits.append(recorder.n_frames)
            if len(commits) == 2:
                act()
            commit(recorder)

        monkeypatch.setattr(writer.Recorder, "commit", later)
        return commits

    monkeypatch.setattr(writer, "SECONDS_BETWEEN_COMMITS", -1.0)
    monkeypatch.setattr(frame_times, "BATCH_FRAMES", 1)
    return disturb


@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_a_file_that_is_cut_while_it_is_written_is_told(disturbed, capsys, share):
    """Zeros would stand where frames were, or HDF5 would end in a traceback."""
    path = Path("folder/a.h5")
    commits = disturbed(lambda: os.truncate(path, int(share * path.stat().st_size)))
    assert main(["run", "a.toml", "-q", "-o", str(path), "--set", "run.t_end=2.0"]) == 1
    assert len(commits) == 2
    told = "the run failed: cannot write folder/a.h5: was cut by another program meanwhile; "
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("where", ["file", "folder", "unknown"])
def test_a_file_that_is_moved_while_it_is_written_is_told_at_the_end(
    disturbed, capsys, monkeypatch, where
):
    """All frames are in it, but not under the name that was asked for."""
    moved = ("folder", "other") if where == "folder" else ("folder/a.h5", "b.h5")
    commits = disturbed(lambda: os.rename(*moved))
    if where == "unknown":  # a system that does not tell
        monkeypatch.setattr(os, "readlink", failing_readlink)
    words = ["run", "a.toml", "-q", "-o", "folder/a.h5", "--set", "run.t_end=2.0"]
    assert main(words) == 1
    assert len(commits) > 2
    name = "other/a.h5" if where == "folder" else "b.h5"
    told = "all frames are kept under another name"
    told = told if where == "unknown" else f"21 frames are kept in {name}"
    assert f"cannot write folder/a.h5: was moved meanwhile; {told}" in capsys.readouterr().err
    assert main(["info", name, "--verify"]) == 0


def failing_readlink(path):
    raise OSError(errno.ENOENT, os.strerror(errno.ENOENT), path)


def test_a_process_that_goes_to_another_folder_has_not_moved_its_file(disturbed):
    """A name is relative to the folder at the beginning."""
    disturbed(lambda: os.chdir("folder"))
    assert main(["run", "a.toml", "-q", "-o", "a.h5", "--set", "run.t_end=2.0"]) == 0
    assert Path("../a.h5").is_file()


def test_a_file_system_without_syncs_is_written(tmp_path, monkeypatch):
    """Some have no such call for folders, some for none: there is nothing to wait for."""

    def none(descriptor):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))

    monkeypatch.setattr(os, "fsync", none)
    case = tmp_path / "a.toml"
    case.write_text(CASE)
    assert main(["run", str(case), "-q", "-o", str(tmp_path / "a.h5")]) == 0
    assert main(["info", str(tmp_path / "a.h5"), "--verify"]) == 0


def test_studies_and_sessions_ask(place, capsys):
    Path("pipe").rename("a.svg")
    words = ["chart", "tumbling_brick", "-o", "a", "--overwrite"]
    assert main(words) == 2
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = str(free.getsockname()[1])
    assert main(["view", "a.toml", "-o", "a.svg", "--port", port]) == 2
    assert capsys.readouterr().err.count("a.svg is not a regular file") == 2


def test_a_run_does_not_replace_its_case(place, capsys):
    assert main(["run", "a.toml", "-o", "a.toml", "--overwrite"]) == 2
    assert "a.toml is the input" in capsys.readouterr().err
    assert Path("a.toml").read_text() == CASE


@pytest.mark.parametrize("command", ["info", "resume", "plot", "export", "view"])
def test_a_pipe_is_no_file_to_read(place, command, capsys):
    """To open one would wait for ever."""
    os.mkfifo("pipe.h5")
    more = ["--to", "csv"] if command == "export" else []
    assert main([command, "pipe.h5", *more]) == 2
    assert "pipe.h5 is not a regular file" in capsys.readouterr().err
    with pytest.raises(TrajectoryError, match="not a regular file"):
        particlerb.open("pipe.h5")


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes there")
def test_a_name_that_is_no_text_is_as_any_other(place, capsys):
    """Files have names of bytes: a case with one is run, drawn and exported like others."""
    name = os.fsdecode(b"\xe9\xff")
    shutil.copy("a.toml", f"{name}.toml")
    moments = 'type = "moments", inertia = [1.0, 2.0, 2.5]'
    Path("ball.toml").write_text(CASE.replace(moments, 'type = "sphere", radius = 0.1'))
    for words in (
        ["run", f"{name}.toml", "-q", "-o", f"{name}.h5"],
        ["info", f"{name}.h5", "--verify"],
        ["plot", f"{name}.h5"],
        ["export", "ball.toml", "--to", "lammps", "-o", f"{name}.in"],
    ):
        assert main(words) == 0, words
    pytest.importorskip("gsd")
    assert main(["export", f"{name}.h5", "--to", "gsd"]) == 2
    assert "gsd takes only names" in capsys.readouterr().err
    assert b"read_data '\xe9\xff.data'" in Path(f"{name}.in").read_bytes().replace(b'"', b"'")
    with particlerb.open(f"{name}.h5") as trajectory:
        assert trajectory.parameter("case_path").endswith("\\udce9\\udcff.toml")
    parts = Parts(f"{name}.parts", (Range(0, 1),), "")
    with h5py.File("master.h5", "w") as file:
        note_master(file, parts)
        assert parts_in(file) == parts


def test_what_a_killed_process_had_begun_is_taken_away(tmp_path):
    """Not what one that lives writes, nor one of another machine, nor what begins a longer name."""
    here = Path(tmp_path / "a.csv")
    code = (
        "import os, sys, pathlib; from particlerb.record.output_path import appearing\n"
        "with appearing(pathlib.Path(sys.argv[1])) as (new,):\n"
        "    new.write_text('half'); print(new.name, flush=True); os.kill(os.getpid(), 9)\n"
    )
    command = [sys.executable, "-c", code, str(here)]
    killed = subprocess.run(command, capture_output=True, text=True, check=False)
    assert killed.returncode == -signal.SIGKILL
    left = killed.stdout.strip()
    _, number, machine, *_ = left.split(".")
    others = [f".1.{machine}.a.csv", f".{number}.zz.a.csv", f".{number}.{machine}.ba.csv"]
    for name in others:
        (tmp_path / name).write_text("half")
    assert sorted(os.listdir(tmp_path)) == sorted([left, *others])
    with appearing(here) as (new,):
        new.write_text("whole")
    assert sorted(os.listdir(tmp_path)) == sorted([*others, "a.csv"])
