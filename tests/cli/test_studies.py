"""The commands of the studies: what they print, what they write, what they refuse."""

import csv
import errno
import re
from pathlib import Path

import pytest

from particlerb.cli import main
from particlerb.studies.charts import convergence as convergence_chart

TOP = """
title = "a top"
[run]
t_end = 1.0
every = 0.5
dt = 1e-3
[[body]]
name = "top"
mass = 1.0
shape = { type = "moments", inertia = [1.0, 1.2, 0.5] }
angular_velocity = [0.5, 0.0, 3.0]
[[force]]
type = "push"
body = "top"
at = [0.0, 0.0, 1.0]
force = [0.0, 0.0, -1.0]
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty current folder with a case in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "top.toml").write_text(TOP)
    return tmp_path


@pytest.mark.compiled
def test_chart_prints_a_table_and_writes_three_files(here, capsys):
    words = ["chart", "top.toml", "--methods", "strang,rk4", "--budget", "1.5", "--error", "1e-4"]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "a top: 1 body to t = 1 s, time on one thread" in out
    assert "for an error of 0.0001 take " in out
    written = [Path("output") / f"chart_top.{suffix}" for suffix in ("csv", "png", "svg")]
    assert all(path.stat().st_size > 500 for path in written)
    with written[0].open() as file:
        assert {row["method"] for row in csv.DictReader(file)} == {"strang", "rk4"}
    assert main(words) == 2
    assert "output/chart_top.csv exists" in capsys.readouterr().err
    assert main([*words, "-o", "other/name.png", "--processor-time"]) == 0
    assert "time of the processor on one thread" in capsys.readouterr().out
    assert Path("other/name.svg").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "verlet"], "verlet: no such method; there are exact, strang"),
        (["--peers", "unity"], "unity: no such peer; there are all, mujoco"),
        (["--set", "run.t_end=-1"], "run.t_end"),
    ],
)
def test_chart_refuses_what_is_not_there(here, capsys, words, message):
    assert main(["chart", "top.toml", *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize("words", [["--budget", "0"], ["--error", "-1"], ["--budget", "nan"]])
def test_numbers_of_a_study_must_be_positive(here, capsys, words):
    assert main(["chart", "top.toml", *words]) == 2
    assert "must be a positive number" in capsys.readouterr().err


def test_pictures_are_those_of_the_table_beside_them(here, monkeypatch, capsys):
    """An end while pictures are drawn leaves the new rows, which may have taken hours, alone."""
    words = ["converge", "box", "--most", "1000", "--overwrite", "-o", "a"]
    assert main(words) == 0
    old = Path("a.csv").read_bytes()
    drawing = convergence_chart.draw_convergence

    def stopped(results, path):
        drawing(results, path)
        raise KeyboardInterrupt

    monkeypatch.setattr(convergence_chart, "draw_convergence", stopped)
    assert main([*words, "--most", "2000"]) == 130
    assert Path("a.csv").read_bytes() != old
    assert sorted(path.name for path in here.iterdir()) == ["a.csv", "top.toml"]


def test_an_old_picture_is_taken_away_behind_its_link(here):
    Path("far").mkdir()
    Path("far/p.png").write_bytes(b"old")
    Path("a.png").symlink_to("far/p.png")
    assert main(["converge", "box", "--most", "1000", "--overwrite", "-o", "a"]) == 0
    assert Path("a.png").is_symlink()
    assert Path("far/p.png").read_bytes().startswith(b"\x89PNG")


def test_a_picture_that_may_not_be_taken_away_is_named(here, monkeypatch, capsys):
    Path("a.png").write_bytes(b"old")
    unlink = Path.unlink

    def refused(path, missing_ok=False):
        if path.name == "a.png":
            raise PermissionError(errno.EACCES, "refused", str(path))
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refused)
    assert main(["converge", "box", "--most", "1000", "--overwrite", "-o", "a"]) == 1
    assert "cannot write a.png: refused" in capsys.readouterr().err
    assert sorted(path.name for path in here.iterdir()) == ["a.png", "top.toml"]


def test_converge_shows_the_clean_order_of_a_box(here, capsys):
    assert main(["converge", "box", "--most", "4000"]) == 0
    out = capsys.readouterr().out
    assert "box" in out
    assert Path("output/converge.png").exists()
    assert main(["converge", "sphere", "-o", "other"]) == 2
    assert "sphere" in capsys.readouterr().err


@pytest.mark.compiled
def test_accuracy_takes_the_place_of_the_step_of_the_case(here, capsys):
    assert main(["top.toml", "--set", "run.accuracy=1e-6"]) == 0
    out = capsys.readouterr().out
    assert re.search(r" 1e-06 requested, .*; in place of run.dt\n", out)
    assert "0.001 s, as the case says" not in out


@pytest.mark.compiled
def test_accuracy_beyond_reach_is_a_warning_and_an_error_where_strict(here, capsys):
    words = ["check", "top.toml", "--set", "run.accuracy=1e-17"]
    assert main(words) == 0
    assert "warning: run.accuracy: 1e-17 is not reached: " in capsys.readouterr().err
    assert main([*words, "--strict"]) == 2


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (".", ". is a folder: name files with -o"),
        ("top.toml/chart", "top.toml is not a folder"),
        ("a" * 300 + "/chart", "cannot be made"),
    ],
)
def test_an_output_that_cannot_be_written_is_told_before_the_study(here, capsys, output, message):
    assert main(["chart", "top.toml", "--budget", "1000", "-o", output]) == 2
    out, err = capsys.readouterr()
    assert message in err
    assert out == ""
