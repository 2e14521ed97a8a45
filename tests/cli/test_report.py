"""What a run says on its way, where there is no terminal, and in a log."""

import os
import re
import sys
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

import particlerb
from particlerb.cli import main, report
from particlerb.cli.common import fitted
from particlerb.cli.exit_codes import Ending
from particlerb.cli.run import _notes, ask_to_stop
from particlerb.compiled.threads import THREADS
from particlerb.simulation.outcome import Reached
from particlerb.tables import Ball, ContactTable, Output, PlaneWall, RunTable


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the report sees."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_no_share_is_told_where_no_step_was_saved():
    """«0 % of the body-steps were taken in closed form» told nobody anything."""
    few = {"drift": (0.0, 0.0, 0.0), "broken": (), "tree": None, "tally": None, "contact_turn": 0.0}
    for flown, n in ((None, 1), (0.0, 1), (0.25, 2)):
        assert len(_notes(SimpleNamespace(flown=flown, **few))) == n


def test_lines_come_every_ten_seconds_after_the_first_frames(clock, capsys, tmp_path):
    with report.Report(100, 0, False, str(tmp_path / "a.log")) as one:
        clock[0] += 60.0  # compiling
        one.add(Reached(1, 0.0, 5.0, 0.0))
        clock[0] += 60.0  # what moves on is compiled after the first frame
        for k in range(1, 25):
            clock[0] += 1.0
            one.add(Reached(2, 0.1 * k, 5.0, 1e-9 * k))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].split()[:4] == ["time", "[s]", "frames", "steps"]
    rows = [line.split() for line in lines[1:]]
    assert [row[0] for row in rows] == ["1.1", "2.1"]
    assert [row[1] for row in rows] == ["23/100", "43/100"]
    assert rows[0][2:] == ["-", "5", "1.1e-08", "-", "-", "38"]  # 77 frames left at 2 a second
    logged = (tmp_path / "a.log").read_text().splitlines()
    assert len(logged) == 1 + 25 + 1
    assert logged[-1].split()[:2] == ["2.4", "49/100"]


def test_a_line_has_steps_contacts_and_speed(clock, capsys):
    """Of a run with 1000 steps a second of the scene, which takes 20 s for its 2 s."""
    with report.Report(21, 0, False, None, lambda time: round(1000 * time)) as one:
        for k in range(21):
            one.add(Reached(1, 0.1 * k, 5.0, 0.0, 7))
            clock[0] += 1.0
    head, row = capsys.readouterr().err.splitlines()
    assert re.sub(r" \[.*?\]", "", head).split()[5:7] == ["contacts", "steps/s"]
    assert row.split() == ["1.1", "12/21", "1100", "5", "0.0e+00", "7", "100", "9"]


@pytest.mark.plain
def test_the_log_of_a_run_counts_its_steps_and_contacts(tmp_path, monkeypatch):
    """Of `[output] log`: of three balls two touch a floor."""
    monkeypatch.chdir(tmp_path)
    scene = particlerb.Scene(RunTable(t_end=0.01, every=0.005, dt=1e-3), gravity=(0, 0, -9.81))
    at = [[0, 0, 0.0999], [1, 0, 0.0999], [2, 0, 5]]
    scene.add_body(name="ball", count=3, shape=Ball(radius=0.1), mass=1.0, position=at)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1)))
    scene.contact = ContactTable(stiffness=1e4, restitution=0.5, friction=0.5, overlap=1e-3)
    scene.output = Output(fields=("position", "contact_number"), log=str(tmp_path / "run.log"))
    (tmp_path / "a.toml").write_text(scene.to_toml())
    for words in (["-o", str(tmp_path / "a.h5")], ["-o", "b.h5", "--log", "b.log"]):
        assert main(["run", str(tmp_path / "a.toml"), "-q", *words]) == 0
    assert Path("b.log").exists()
    row = (tmp_path / "run.log").read_text().splitlines()[-1].split()
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert int(row[5]) == trajectory.contact_number[-1].sum() == 2
        known = trajectory.parameter("identity")
    assert row[2] == "10"
    scene.output = Output(fields=scene.output.fields)
    with particlerb.run(scene, tmp_path / "c.h5") as trajectory:
        assert trajectory.parameter("identity") == known  # it has no say in what moves


@pytest.mark.plain
def test_the_log_counts_what_presses_by_impulses_and_not_what_is_near(tmp_path):
    """Four balls on a floor, beside each other with gaps of 0.5 mm that a step could close."""
    scene = particlerb.Scene(RunTable(t_end=0.1, every=0.05, dt=0.01), gravity=(0, 0, -9.81))
    at = [[0.2005 * i, 0, 0.1] for i in range(4)]
    scene.add_body(name="ball", count=4, shape=Ball(radius=0.1), mass=1.0, position=at)
    scene.add_wall(PlaneWall(name="floor", normal=(0, 0, 1)))
    scene.contact = ContactTable(law="impulse", restitution=0.0, friction=0.5)
    (tmp_path / "a.toml").write_text(scene.to_toml())
    log = tmp_path / "a.log"
    words = ["-q", "-o", str(tmp_path / "a.h5"), "--log", str(log)]
    assert main(["run", str(tmp_path / "a.toml"), *words]) == 0
    assert log.read_text().splitlines()[-1].split()[5] == "4"


def test_a_quiet_or_short_run_says_nothing(clock, capsys):
    for is_quiet, seconds in ((True, 100.0), (False, 9.0)):
        with report.Report(10, 0, is_quiet, None) as one:
            one.add(Reached(1, 0.0, 5.0, 0.0))
            clock[0] += seconds
            one.add(Reached(9, 1.0, 5.0, 0.0))
    assert capsys.readouterr().err == ""


def test_a_log_replaces_a_log_and_nothing_else(tmp_path):
    path = tmp_path / "a.log"
    report.Report(10, 0, True, str(path)).close()
    report.Report(10, 0, True, str(path)).close()
    (tmp_path / "case.toml").write_text("title = 'mine'")
    with pytest.raises(Ending, match="exists and is not a log"):
        report.Report(10, 0, True, str(tmp_path / "case.toml"))
    assert (tmp_path / "case.toml").read_text() == "title = 'mine'"
    with pytest.raises(Ending, match="cannot be written") as info:
        report.Report(10, 0, True, str(tmp_path / "no" / "a.log"))
    assert info.value.code == 2


def test_the_command_writes_a_log(tmp_path, capsys):
    path = tmp_path / "run.log"
    command = ["run", "paper_cube", "-o", str(tmp_path / "a.h5"), "--log", str(path)]
    assert main(command) == 0
    assert capsys.readouterr().err == ""
    last = path.read_text().splitlines()[-1].split()
    assert last[:2] == ["5", "101/101"]


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="pipes have no names here")
def test_a_log_may_be_a_pipe_which_is_not_read(monkeypatch):
    """It would wait for ever: `--log /dev/stdout | tee log.txt`."""
    monkeypatch.setattr(Path, "read_bytes", raising(AssertionError))
    reader, writer = os.pipe()
    report.Report(10, 0, True, f"/dev/fd/{writer}").close()
    assert os.read(reader, 1000).startswith(report._LOG_HEAD.encode())
    os.close(reader)
    os.close(writer)


def test_a_log_that_takes_nothing_more_is_named(tmp_path, capsys, monkeypatch):
    """And not `None`; the frames so far are kept."""
    path, log = tmp_path / "a.toml", SimpleNamespace(name="a.log", close=lambda: None)
    log.write = raising(partial(OSError, 28, "No space left on device"))
    path.write_text(SPINNING)
    monkeypatch.setattr(report, "_new_log", lambda path: log)
    assert main(["run", str(path), "-q", "-o", str(tmp_path / "a.h5"), "--log", "a.log"]) == 1
    assert "cannot write a.log: No space left on device" in capsys.readouterr().err
    with particlerb.open(tmp_path / "a.h5") as trajectory:
        assert trajectory.n_frames > 0


def test_a_stream_without_a_name_that_takes_nothing_is_told_as_such(monkeypatch, clock):
    stream = SimpleNamespace(isatty=lambda: False, write=raising(partial(OSError, 28, "full")))
    monkeypatch.setattr("sys.stderr", stream)
    one = report.Report(10, 0, False, None)
    one.last = Reached(1, 0.0, 5.0, 0.0)
    with pytest.raises(OSError, match="full") as info:
        one._write("lines", stream)
    assert info.value.filename == "stderr"


def test_a_log_that_takes_no_head_is_closed(monkeypatch, tmp_path):
    opened = []

    def full(*_: object, **_keys: object) -> SimpleNamespace:
        stream = SimpleNamespace(write=raising(partial(OSError, 28, "full")))
        stream.close = lambda: opened.append("closed")
        return stream

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(Ending, match="cannot be written: full") as info:
        report._new_log(tmp_path / "a.log")
    assert info.value.code == 1  # of a disk that fails, and not of wrong usage
    assert opened == ["closed"]


SPINNING = """run = { t_end = 1.0, every = 0.5 }
[[body]]
name = "a"
shape = { type = "moments", inertia = [1.0, 2.0, 2.5] }
mass = 1.0
"""


def test_an_interrupt_is_heeded_where_no_message_can_be_written(monkeypatch):
    """As behind `| head`, or where it comes between two halves of a line."""
    for error in (BrokenPipeError, RuntimeError):  # the second: in the middle of another one
        monkeypatch.setattr("sys.stderr", SimpleNamespace(write=raising(error)))
        monkeypatch.setattr(THREADS, "is_ending", False)
        ask_to_stop(2, None)
        assert THREADS.is_ending


def raising(error):
    """A function that only raises."""

    def raises(*_: object) -> None:
        raise error()

    return raises


def test_a_plan_fits_a_narrow_terminal(monkeypatch):
    """It goes on below its second column, with the same words; a pipe gets it as it is."""
    words = "summed once to mass, centre of mass and inertia tensor " * 3
    plan = f"  bodies     1 spherical top\n  particles  {words.strip()}"
    assert fitted(plan) == plan
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr("sys.stdout", SimpleNamespace(isatty=lambda: True))
    first, second, *more = fitted(plan).split("\n")
    assert (first, second[:40]) == tuple(line[:40] for line in plan.split("\n"))
    assert more
    assert all(line.startswith(" " * 13 + line.strip()) for line in more)
    assert max(map(len, (second, *more))) <= 80
    assert " ".join((second, *more)).split() == plan.split("\n")[1].split()


@pytest.mark.parametrize("words", [["check", "--ranks", "1"], ["run", "-o", "a.h5"]])
def test_all_lines_of_a_plan_fit(monkeypatch, capsys, tmp_path, words):
    """Also those below the plan: of the run, of its ranks, of its file."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "50")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main([words[0], "paper_cube", *words[1:]]) == 0
    plan = capsys.readouterr().out.split("\nplan\n")[1].split("\n\n")[0]
    assert "frames, about" in " ".join(plan.split())
    assert max(map(len, plan.split("\n"))) <= 50


def test_a_log_is_not_the_file(tmp_path, capsys):
    path = str(tmp_path / "a.h5")
    assert main(["run", "paper_cube", "-q", "-o", path, "--log", path]) == 2
    assert "both the file and the log" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
