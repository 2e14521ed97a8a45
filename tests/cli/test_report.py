"""What a run says on its way, where there is no terminal, and in a log."""

import time

import pytest

from particlerb.cli import main, report
from particlerb.cli.exit_codes import Ending
from particlerb.simulation.outcome import Reached


@pytest.fixture
def clock(monkeypatch):
    """Seconds that the report sees."""
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    return now


def test_lines_come_every_ten_seconds_after_the_first_frames(clock, capsys, tmp_path):
    with report.Report(100, 0, False, str(tmp_path / "a.log")) as one:
        clock[0] += 60.0  # compiling
        one.add(Reached(1, 0.0, 5.0, 0.0))
        clock[0] += 60.0  # what moves on is compiled after the first frame
        for k in range(1, 25):
            clock[0] += 1.0
            one.add(Reached(2, 0.1 * k, 5.0, 1e-9 * k))
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].split()[:4] == ["time", "[s]", "frames", "energy"]
    rows = [line.split() for line in lines[1:]]
    assert [row[0] for row in rows] == ["1.1", "2.1"]
    assert [row[1] for row in rows] == ["23/100", "43/100"]
    assert rows[0][3:] == ["1.10e-08", "10.0", "38"]  # 77 frames left at 2 a second
    logged = (tmp_path / "a.log").read_text().splitlines()
    assert len(logged) == 1 + 25 + 1
    assert logged[-1].split()[:2] == ["2.4", "49/100"]


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
    with pytest.raises(Ending, match="cannot be written"):
        report.Report(10, 0, True, str(tmp_path / "no" / "a.log"))


def test_the_command_writes_a_log(tmp_path, capsys):
    path = tmp_path / "run.log"
    command = ["run", "paper_cube", "-o", str(tmp_path / "a.h5"), "--log", str(path)]
    assert main(command) == 0
    assert capsys.readouterr().err == ""
    last = path.read_text().splitlines()[-1].split()
    assert last[:2] == ["5", "101/101"]
