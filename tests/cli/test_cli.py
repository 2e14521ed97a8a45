"""The command line: exit codes, messages, what goes to which stream, what is left on disk."""

import argparse
import errno
import json
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from collections import namedtuple
from pathlib import Path

import h5py
import pytest
import tomlkit

import particlerb
from particlerb import cli
from particlerb.cli import main
from particlerb.cli.guard import guarded
from particlerb.cli.ranks import ranks_of
from particlerb.compiled.jit import WHEN_COMPILING
from particlerb.record.verify import verify

CASES = Path(__file__).parents[2] / "cases"
CUBE = """
title = "a cube"
[run]
t_end = 1.0
every = 0.25
[[body]]
name = "cube"
mass = 2.0
shape = { type = "box", size = [1.0, 1.0, 1.0], arrangement = "exact" }
angular_velocity = [0.0, 0.0, 1.0]
"""
BRICK = CUBE.replace("[1.0, 1.0, 1.0]", "[1.0, 1.5, 2.0]")  # pushed it has no closed form,
BRICK = BRICK.replace("[0.0, 0.0, 1.0]", "[0.1, 0.0, 1.0]")  # as it turns about no one axis
PUSH = """
[[force]]
type = "push"
body = "cube"
at = [0.0, 0.5, 0.0]
force = [1.0, 0.0, 0.0]
"""
CHECK = """
[[check.value]]
body = "cube"
quantity = "position"
value = [{x}, 0.0, 0.0]
tolerance = 1e-12
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty current folder with a case in it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cube.toml").write_text(CUBE)
    return tmp_path


def command(*words, **options):
    return subprocess.run(
        [sys.executable, "-m", "particlerb", *words],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )


def test_a_case_runs_into_a_file_named_after_it(here, capsys):
    assert main(["cube.toml"]) == 0
    out, err = capsys.readouterr()
    assert "free, closed form, no step" in out
    assert "written: output/cube.h5" in out
    assert err == ""
    with h5py.File("output/cube.h5") as file:
        assert file["particles/trajectory/position/value"].shape == (5, 1, 3)


def test_an_existing_file_is_replaced_only_when_asked_to(here, capsys):
    Path("old.h5").write_text("precious")
    assert main(["run", "cube.toml", "-o", "old.h5"]) == 2
    assert "old.h5 exists" in capsys.readouterr().err
    assert Path("old.h5").read_text() == "precious"
    assert main(["run", "cube.toml", "-o", "old.h5", "--overwrite"]) == 0
    assert h5py.is_hdf5("old.h5")


@pytest.mark.parametrize(("x", "code", "verdict"), [(0.0, 0, "ok  "), (0.1, 3, "MISS")])
def test_a_missed_check_is_exit_code_3_and_shows_its_figure(here, capsys, x, code, verdict):
    Path("cube.toml").write_text(CUBE + CHECK.format(x=x))
    assert main(["cube.toml"]) == code
    out = capsys.readouterr().out
    assert f"{verdict} position of cube at 1 s" in out
    told = f"expected [{x}, 0.0, 0.0], found [0.0, 0.0, 0.0]" in out
    assert told == (verdict == "MISS")


def test_quiet_prints_the_checks_alone(here, capsys):
    Path("cube.toml").write_text(CUBE + CHECK.format(x=0.0))
    assert main(["cube.toml", "-q"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("checks\n")
    assert "plan" not in out


def test_json_is_the_only_thing_on_stdout(here, capsys):
    Path("cube.toml").write_text(CUBE + CHECK.format(x=0.5))
    assert main(["cube.toml", "--json"]) == 3
    result = json.loads(capsys.readouterr().out)
    assert result["file"] == "output/cube.h5"
    assert result["checks"][0]["error"] == 0.5
    assert not result["checks"][0]["holds"]
    assert result["drift"]["energy"] < 1e-14


def test_all_problems_of_a_case_are_told_at_once(here, capsys):
    Path("cube.toml").write_text(CUBE.replace("t_end = 1.0", "t_ned = 1.0").replace("2.0", "-2.0"))
    assert main(["cube.toml"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "cube.toml:4:1: error: run.t_ned: unknown key" in err
    assert 'did you mean "t_end"' in err
    assert "body[0].mass" in err
    assert not Path("output").exists()


@pytest.mark.parametrize(
    ("change", "key", "reason"),
    [
        (('{ type = "box", size = [1.0, 1.0, 1.0], arrangement = "exact" }',
          '{ type = "moments", inertia = [1.0, 1.0, 3.0] }'), "body[0].shape", "exceeds the sum"),
        (('{ type = "box", size = [1.0, 1.0, 1.0], arrangement = "exact" }',
          '{ type = "rod", length = 1.0 }'), "body[0].angular_velocity", "about its own axis"),
        (('{ type = "box", size = [1.0, 1.0, 1.0], arrangement = "exact" }',
          '{ type = "points", position = [[0, 0, 0]], mass = [1] }'),
         "body[0].angular_velocity", "it cannot spin"),
            ],
)  # fmt: skip
def test_what_only_the_bodies_show_is_told_with_its_line(here, capsys, change, key, reason):
    Path("cube.toml").write_text(CUBE.replace(*change) + PUSH)
    assert main(["check", "cube.toml"]) == 2
    err = capsys.readouterr().err
    assert f"error: {key}: " in err
    assert reason in err
    assert err.startswith("cube.toml:")


def test_exact_says_what_it_does_not_accept(here, capsys):
    text = BRICK.replace("every = 0.25", 'every = 0.25\nmethod = "exact"')
    Path("cube.toml").write_text(text + PUSH)
    assert main(["check", "cube.toml"]) == 2
    assert "error: run.method: exact does not accept" in capsys.readouterr().err


def test_a_malformed_csv_names_the_file_and_the_line(here, capsys):
    Path("p.csv").write_text("x,y,z,m\n0,0,0,1\n1,0,zero,1\n")
    shape = '{ type = "points", file = "p.csv" }'
    text = CUBE.replace('{ type = "box", size = [1.0, 1.0, 1.0], arrangement = "exact" }', shape)
    Path("cube.toml").write_text(text.replace("mass = 2.0\n", ""))
    assert main(["check", "cube.toml"]) == 2
    err = capsys.readouterr().err
    assert "p.csv" in err
    assert "line 3" in err or ":3" in err
    assert "zero" in err


def test_a_run_that_fails_is_exit_code_1_and_keeps_its_frames(here, capsys):
    far = PUSH.replace("force = [1.0", "force = [1e308")
    Path("cube.toml").write_text(BRICK.replace("every = 0.25", "every = 0.25\ndt = 0.1") + far)
    assert main(["cube.toml"]) == 1
    err = capsys.readouterr().err
    assert "the run failed" in err
    assert "1 frame is kept in output/cube.h5" in err


def test_a_step_that_is_too_long_is_warned_of_and_strict_refuses_it(here, capsys):
    text = BRICK.replace("every = 0.25", "every = 0.25\ndt = 0.9") + PUSH
    Path("cube.toml").write_text(text)
    assert main(["cube.toml"]) == 0
    err = capsys.readouterr().err
    assert "cube.toml:6:6: warning: run.dt" in err
    assert "advised" in err
    assert main(["cube.toml", "--strict", "--overwrite"]) == 2


def test_a_disk_that_is_too_small_is_warned_of_with_the_size(here, capsys, monkeypatch):
    usage = namedtuple("usage", "total used free")(1000, 999, 1)
    monkeypatch.setattr("shutil.disk_usage", lambda folder: usage)
    main(["cube.toml"])
    err = capsys.readouterr().err
    assert "cube.h5 would take 261 kB, the disk has 0.001 kB free" in err
    assert main(["cube.toml", "--overwrite", "--strict"]) == 2


def filling(monkeypatch, room):
    """Let no file grow beyond so many bytes."""
    write = os.pwrite

    def limited(descriptor, data, place):
        if place + len(data) > room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(descriptor, data, place)

    monkeypatch.setattr("os.pwrite", limited)


def test_a_disk_that_fills_up_ends_the_run_and_keeps_the_frames(here, capsys, monkeypatch):
    Path("cube.toml").write_text(CUBE.replace("every = 0.25", "every = 1e-4"))
    monkeypatch.setattr("particlerb.record.writer.SECONDS_BETWEEN_COMMITS", -1.0)
    filling(monkeypatch, 2_000_000)
    assert main(["cube.toml"]) == 1
    err = capsys.readouterr().err
    with h5py.File("output/cube.h5") as file:
        n = int(file.attrs["n_frames"])
        assert 0 < n < 10_001
        assert len(file["particles/trajectory/position/value"]) == n
    assert err.splitlines() == [
        "particlerb: the run failed: cannot write output/cube.h5: No space left on device;"
        f" {n} frames are kept in output/cube.h5",
        "continue with: python -m particlerb resume output/cube.h5",
    ]


def test_a_disk_without_any_room_leaves_no_file_and_keeps_the_one_before(here, capsys, monkeypatch):
    filling(monkeypatch, 20_000)
    assert main(["cube.toml"]) == 1
    assert "No space left on device; no file was written" in capsys.readouterr().err
    assert not list(Path("output").iterdir())
    monkeypatch.undo()
    monkeypatch.chdir(here)
    assert main(["cube.toml"]) == 0
    before = Path("output/cube.h5").read_bytes()
    filling(monkeypatch, 20_000)
    assert main(["cube.toml", "--overwrite"]) == 1
    err = capsys.readouterr().err
    assert "No space left on device; no file was written" in err
    assert "resume" not in err
    assert Path("output/cube.h5").read_bytes() == before


def test_set_and_threads_change_the_case(here, capsys):
    assert main(["cube.toml", "--set", "run.t_end=0.5", "--threads", "1", "--json"]) == 0
    with h5py.File("output/cube.h5") as file:
        assert len(file["particles/trajectory/time"]) == 3
    capsys.readouterr()
    assert main(["check", "cube.toml", "--threads", "0"]) == 2
    must = "check: --threads: must be a whole number, 1 or more, got 0; `check --help` lists what"
    assert capsys.readouterr().err == f"particlerb: {must} it takes\n"


def test_check_prints_the_plan_and_writes_nothing(here, capsys):
    Path("cube.toml").write_text(BRICK + PUSH)
    assert main(["check", "cube.toml"]) == 0
    out = capsys.readouterr().out
    assert "driven by push, strang" in out
    assert re.search(r"contact \(no particle has a radius\)", out)
    assert not Path("output").exists()


def test_the_whole_plan_is_printed_where_it_is_asked_for(here, capsys):
    Path("cube.toml").write_text(BRICK + PUSH)
    for words in (["run", "cube.toml", "--plan"], ["check", "cube.toml", "--plan"]):
        assert main(words) == 0
        assert re.search(r"^  attraction +off: no \[attraction\]$", capsys.readouterr().out, re.M)
    assert main(["check", "cube.toml", "--plan", "--json"]) == 0
    assert "off: no [attraction]" in json.loads(capsys.readouterr().out)["plan"]
    with particlerb.open("output/cube.h5") as trajectory:
        assert "left out" in trajectory.parameter("plan")


def test_mass_reports_tensor_class_and_digits(here, capsys):
    Path("cube.toml").write_text(CUBE.replace('arrangement = "exact"', "n = 2"))
    assert main(["mass", "cube.toml"]) == 0
    out = capsys.readouterr().out
    assert "cube: 8 particles" in out
    assert "0.25, 0.25, 0.25 kg m²" in out
    assert main(["mass", "cube.toml", "cube", "--json"]) == 0
    (record,) = json.loads(capsys.readouterr().out)
    assert record["rotor_class"] == "sphere"
    assert record["mass"] == 2.0
    assert main(["mass", "cube.toml", "ball"]) == 2
    assert "known: cube" in capsys.readouterr().err


def test_mass_of_tables(here, capsys):
    Path("clump.txt").write_text("0 0 0 1\n0.5 0 0 1\n")
    assert main(["mass", "clump.txt", "--density", "2", "--spin", "10"]) == 0
    out = capsys.readouterr().out
    assert "plain sum            mass +" in out
    assert "0.005 s for 10 rad/s" in out
    assert main(["mass", "clump.txt", "--json", "--mass", "3", "--scale", "0.001"]) == 0
    (record,) = json.loads(capsys.readouterr().out)
    assert record["mass"] == pytest.approx(3.0, rel=1e-15)
    assert 5e-9 < record["volume"] < 8e-9
    Path("points.csv").write_text("x,y,z,m\n1,0,0,1\n-1,0,0,1\n")
    assert main(["mass", "points.csv"]) == 0
    assert "points: 2 particles" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", [], "body.txt: empty"),
        ("0 0 0 1\n1 0 zero 1\n", [], "body.txt:2: z = 'zero' is not a number"),
        ("0 0 0 -1\n", [], "body.txt:1: r = -1 is negative"),
        ("x,y,z,m\n0,0,0,-1\n", [], "body.txt:2: m = -1 is negative"),
        ("x,y,z,m\n0,0,0,1\n0,0,0,1\n", [], "body.txt:3: at [0.0, 0.0, 0.0]"),
        ("x,y,z,m\n0,0,0,1\n", ["--density", "2"], "points bring their masses"),
        ("0 0 0 1\n", ["nose"], "nose: body.txt is one body"),
        ("0 0 0 1\n", ["--set", "run.dt=1"], "only a case has keys"),
    ],
)
def test_mass_refuses_what_is_no_body(here, capsys, text, options, message):
    Path("body.txt").write_text(text)
    assert main(["mass", "body.txt", *options]) == 2
    assert message in capsys.readouterr().err


def test_mass_of_a_mesh(here, capsys):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box([1, 2, 3]).export("brick.stl")
    assert main(["mass", "brick.stl", "--json", "--density", "2"]) == 0
    (record,) = json.loads(capsys.readouterr().out)
    assert record["volume"] == pytest.approx(6.0, rel=1e-14)
    assert record["moments"] == pytest.approx([5.0, 10.0, 13.0], rel=1e-13)
    assert record["solid"]["inertia_error"] < 1e-14


def test_mass_of_a_file_that_is_not_there(here, capsys):
    assert main(["mass", "none.csv"]) == 2
    assert "none.csv: No such file" in capsys.readouterr().err


def test_mass_says_which_body_cannot_exist(here, capsys):
    Path("egg.toml").write_text(
        "[run]\nt_end = 1.0\nevery = 1.0\n[[body]]\nname = 'egg'\nmass = 1.0\n"
        "shape = { type = 'moments', inertia = [1.0, 2.0, 3.5] }\n"
    )
    assert main(["mass", "egg.toml"]) == 2
    assert "egg: inertia [1.0, 2.0, 3.5]: moment 3 = 3.5 exceeds" in capsys.readouterr().err
    assert main(["mass", "egg.toml", "--mass", "2"]) == 2
    assert "change it with --set" in capsys.readouterr().err


def test_no_text_of_a_file_gives_orders_to_the_terminal(here, capsys):
    """ESC ] 0 ; sets the title of a window; other sequences type into it."""
    order = "\x1b]0;hacked\x07\x9b31m"
    body = {"name": "a", "shape": {"type": "moments", "inertia": [1, 2, 2]}, "mass": 1.0}
    case = {"title": order, "run": {"t_end": 1.0, "every": 0.5}, "body": [body]}
    particlerb.run(case, here / "a.h5").close()
    with h5py.File(here / "a.h5", "r+") as file:
        del file["parameters/plan"]
        file["parameters/plan"] = order
    (here / "a.toml").write_text(f"run = {json.dumps(order)}\ntitle = {json.dumps(order)}\n")
    for words in (["info", "a.h5"], ["check", "a.toml"], ["info", "a.h5", "--json"], [order]):
        main(words)
        said = capsys.readouterr()
        assert not {"\x1b", "\x07", "\x9b"} & set(said.out + said.err), words


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["chek", "cube.toml"], "did you mean check"),
        (["cube"], "did you mean cube.toml"),
        (["--json", "cub.tml"], "cub.tml"),
    ],
)
def test_a_word_that_is_neither_command_nor_case_gets_a_hint(words, hint, here, capsys):
    assert main(words) == 2
    assert hint in capsys.readouterr().err


def test_info_and_plot_of_a_file(here, capsys):
    main(["cube.toml"])
    capsys.readouterr()
    assert main(["info", "output/cube.h5"]) == 0
    out = capsys.readouterr().out
    assert "bodies        1" in out
    assert "frames        5" in out
    assert main(["info", "output/cube.h5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["time"] == [0.0, 1.0]
    assert main(["plot", "output/cube.h5"]) == 0
    assert Path("output/cube.png").read_bytes().startswith(b"\x89PNG")
    assert main(["plot", "output/cube.h5"]) == 2
    assert main(["plot", "output/cube.h5", "--body", "cub", "-o", "x.png"]) == 2
    assert 'did you mean "cube"' in capsys.readouterr().err


@pytest.mark.plain
def test_a_trajectory_and_its_contacts_are_two_pictures(make, here):
    """One does not stand in the way of the other."""
    scene = {"contact": make.hooke(), "wall": [make.plane()]}
    scene["output"] = {"fields": ["position", "orientation", "linear_momentum", "angular_momentum",
                                  "contacts"]}  # fmt: skip
    ball = make.sphere(position=[0, 0, 0.1])
    particlerb.run(make.case(ball, t_end=0.02, every=0.01, **scene), "fall.h5").close()
    assert main(["plot", "fall.h5"]) == 0
    assert main(["plot", "fall.h5", "--contacts"]) == 0
    assert Path("fall.png").read_bytes() != Path("fall_contacts.png").read_bytes()


@pytest.mark.parametrize("words", [["info", "no.h5"], ["plot", "no.h5"], ["info", "."],
                                   ["info", "cube.toml"], ["plot", "cube.toml"]])  # fmt: skip
def test_a_file_that_is_no_trajectory_is_wrong_usage(here, capsys, words):
    assert main(words) == 2
    err = capsys.readouterr().err
    assert err.startswith("particlerb: ")
    assert "Traceback" not in err


@pytest.mark.parametrize(
    "words",
    [
        ["."],
        ["no.toml"],
        ["nocase"],
        ["run", "cubes"],
        ["cube.toml", "-o", "."],
        ["cube.toml", "-o", "cube.toml/x.h5"],
    ],
)
def test_wrong_words_get_one_message(here, capsys, words):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) <= 3


def test_examples_are_found_by_name_from_anywhere(here, capsys):
    assert main(["check", "paper_cube"]) == 0
    assert main(["paper_cub"]) == 2
    assert "did you mean paper_cube" in capsys.readouterr().err


def test_cases_lists_every_example_with_its_title(here, capsys):
    assert main(["cases"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = {path.stem for path in CASES.glob("*.toml")}
    assert {line.split()[0] for line in lines} == names
    assert all(len(line.split()) > 2 for line in lines)


def test_methods_and_schema(here, capsys):
    assert main(["methods"]) == 0
    out = capsys.readouterr().out
    names = [line.split()[0] for line in out.splitlines()]
    assert names[:4] == ["auto", "exact", "strang", "rattle"]
    assert {"rkn6", "dop853", "explicit_euler"} < set(names)
    assert "order 6" in out
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["$schema"].endswith("2020-12/schema")
    assert "body" in schema["properties"]


def test_no_garbage_is_looked_for_among_what_is_imported(here):
    """Which takes a fifth of a start; in what a command makes it is looked for as ever."""
    code = (
        "import gc; from particlerb.cli import main; looks = [];"
        "gc.callbacks.append(lambda phase, about: looks.append(about['generation']));"
        "main(['check', 'cube.toml']);"
        "print(gc.isenabled(), gc.get_freeze_count() > 10_000, len(looks))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    *kept, looks = done.stdout.splitlines()[-1].split()
    assert kept == ["True", "True"]
    assert int(looks) < 200


def test_help_needs_no_heavy_library():
    code = (
        "import sys; from particlerb.cli import parser; parser().format_help();"
        "heavy = ('numba', 'numpy', 'h5py', 'pydantic', 'matplotlib');"
        "print([m for m in heavy if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    shown = command("--help")
    assert shown.returncode == 0
    assert "exit codes" in shown.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["cube.toml", "-o", "a.png"], "a.png: a trajectory is an HDF5 file, as a.h5"),
        (["run", "cube.toml", "--sett", "x"], "run does not take --sett; did you mean --set?"),
        (["run", "cube.toml", "more.toml"], "run does not take more.toml"),
        (["chart", "tumbling_brik"], "no such file or case; did you mean tumbling_brick?"),
        (["info", "cube.toml"], "cube.toml is a case, not a trajectory: run it, and give output/"),
        (["plot", "heavy_top"], "heavy_top is a case, not a trajectory: run it, and give output/"),
        (["info", "slab"], "slab: no such file; did you mean output/slab.h5?"),
        (["plot", "slab.h5"], "slab.h5: no such file; did you mean output/slab.h5?"),
        (["resume", "output/slab"], "output/slab: no such file; did you mean output/slab.h5?"),
        (["info", "press"], "press is a case, not a trajectory: give output/press.h5"),
        (["export", "cube.toml"], "give --to FORMAT: bodies become lammps, mjcf, yade, gsd"),
        (["--hlep"], "there is no --hlep; did you mean --help?"),
        (["-"], "a case is read from a file, not from standard input: give its path"),
        (["sweep", "cube.toml"], "hint: give it a table [sweep], or --axis 'run.t_end=[1, 2]'"),
        (["run", "pyramid.toml"], "hint: the example is called pyramid"),
        (["cube.toml", "--set", 'run.t_end="1 ms"'], "hint: numbers stand without quotes"),
        (["sweep", "cube.toml", "--axis", "run.t_end=1"], "--axis run.t_end=1: must be KEY=[a, b]"),
        (["sweep", "cube.toml", "--axis", "run.t_end"], "--axis run.t_end: must be KEY=[a, b]"),
        (["info", 256 * "n"], "n: File name too long"),
        (["resume", 256 * "n"], "n: File name too long"),
    ],
)
def test_common_mistakes_are_told_what_would_be_right(here, capsys, words, message):
    Path("output").mkdir()
    for name in ("slab.h5", "press.h5"):
        Path("output", name).touch()
    assert main(words) == 2
    assert message in capsys.readouterr().err
    assert not Path("a.png").exists()


@pytest.mark.parametrize("number", ["x", "0", "1.5"])
def test_a_number_of_threads_is_whole(here, capsys, number):
    assert main(["run", "cube.toml", "--threads", number]) == 2
    assert f"must be a whole number, 1 or more, got {number}" in capsys.readouterr().err


def test_no_word_at_all_shows_the_commands(capsys):
    with pytest.raises(SystemExit, match="0"):
        main([])
    assert "run a case into an HDF5 file" in capsys.readouterr().out


def test_what_is_missing_is_said_in_one_line(capsys):
    assert main(["plot"]) == 2
    expected = "particlerb: plot: required: FILE; `plot --help` lists what it takes\n"
    assert capsys.readouterr().err == expected


def test_an_unknown_option_is_exit_code_2():
    done = command("run", "paper_cube", "--fast")
    assert done.returncode == 2
    assert "run does not take --fast; `run --help` lists what it takes" in done.stderr


def frames_in(path):
    """Frames that are committed."""
    with particlerb.open(path) as t:
        return t.n_frames


@pytest.mark.compiled
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_keeps_the_frames_and_is_exit_code_130(here, number):
    long = CUBE.replace("t_end = 1.0", "t_end = 1e4").replace("every = 0.25", "every = 1e-3")
    Path("cube.toml").write_text(long)
    first, err = interrupted(number, "cube.toml", "-o", "long.h5")
    assert "frames are kept in long.h5" in err
    more, err = interrupted(number, "resume", "long.h5", above=first)
    assert f"{more} frames are kept in long.h5" in err
    with h5py.File("long.h5") as file:
        assert file.attrs["n_frames"] == more
        assert len(file["particles/trajectory/time"]) == more


def interrupted(number, *words, above=1):
    """Frames of long.h5, and what a command says that gets a signal when there are more of them."""
    run = subprocess.Popen(
        [sys.executable, "-m", "particlerb", *words],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # noqa: PLW1509
    )
    try:
        deadline = time.monotonic() + 60
        while not Path("long.h5").exists() or frames_in("long.h5") <= above:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        run.send_signal(number)
        _, err = run.communicate(timeout=60)
    finally:
        run.kill()
    assert run.returncode == 130
    assert "interrupted" in err
    assert "Traceback" not in err
    return frames_in("long.h5"), err


def test_sigterm_ends_every_command_with_130(monkeypatch, capsys):
    """Where a run is not yet, or nothing runs."""

    def wait(options):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)

    monkeypatch.setattr("particlerb.cli.lists.cases_command", wait)
    monkeypatch.setattr("sys.argv", ["particlerb", "cases"])
    # as a process of its own begins
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as ended:
            cli.entry()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert ended.value.code == 130
    assert capsys.readouterr().err == "particlerb: interrupted\n"


def test_an_interrupt_while_a_command_begins_is_one_message(monkeypatch, capsys):
    """While options are made, and while the command line is imported or left."""

    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "parser", interrupt)
    assert main(["cases"]) == 130
    monkeypatch.setattr(cli, "entry", interrupt)
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with pytest.raises(SystemExit) as ended:
            runpy.run_module("particlerb", run_name="__main__")
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert ended.value.code == 130
    assert capsys.readouterr().err == 2 * "particlerb: interrupted\n"


def test_an_interrupt_while_a_class_is_made_of_text_ends_with_its_code_too(tmp_path):
    """As named tuples and dataclasses are: CPython keeps in mind that it left `exec`."""
    patch = "import particlerb.cli as c\nc.entry = lambda: exec('raise KeyboardInterrupt')\n"
    (tmp_path / "sitecustomize.py").write_text(patch)
    env = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-m", "particlerb"]
    done = subprocess.run(command, env=env, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (130, b"particlerb: interrupted\n")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_python_ends_changes_nothing(tmp_path, number):
    """The second of two that come close, or one behind the end of a command."""
    patch = (
        "import atexit, os\natexit.register(lambda: os.kill(os.getpid(), int(os.environ['N'])))\n"
    )
    (tmp_path / "sitecustomize.py").write_text(patch)
    path = os.pathsep.join([str(tmp_path), *sys.path])
    env = os.environ | {"PYTHONPATH": path, "N": str(int(number))}
    command = [sys.executable, "-m", "particlerb", "--version"]
    done = subprocess.run(command, env=env, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_guard_takes_its_process_along(tmp_path, monkeypatch):
    other, note = tmp_path / "python", tmp_path / "pid"
    other.write_text(f"#!/bin/sh\necho $$ > {note}\nsleep 0.5\nkill -TERM $PPID\nexec sleep 60\n")
    other.chmod(0o700)
    monkeypatch.setattr("sys.executable", str(other))
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        assert guarded(["info", "a.h5"]) == 130
    finally:
        signal.signal(signal.SIGTERM, before)
    with pytest.raises(ProcessLookupError):
        os.kill(int(note.read_text()), 0)


@pytest.mark.parametrize(
    ("force", "at", "key", "reason"),
    [
        ("1e300", "1e10", "force[0].at", "beyond the range of float64"),
        ("1e300", "1e7", "run", "no step can be chosen"),
    ],
)
def test_a_force_that_overflows_is_refused(here, capsys, force, at, key, reason):
    text = CUBE.replace("mass = 2.0", "mass = 1e-290")
    push = PUSH.replace("[1.0,", f"[{force},").replace("0.5,", f"{at},")
    Path("cube.toml").write_text(text + push)
    assert main(["check", "cube.toml"]) == 2
    err = capsys.readouterr().err
    assert f"error: {key}: " in err
    assert reason in err


def test_a_file_without_what_a_picture_needs_is_refused(here, capsys):
    Path("cube.toml").write_text(CUBE + '[output]\nfields = ["position"]\n')
    assert main(["cube.toml", "-q"]) == 0
    assert main(["plot", "output/cube.h5"]) == 2
    assert "lacks orientation" in capsys.readouterr().err


def test_a_picture_of_an_unknown_kind_is_refused(here, capsys):
    main(["cube.toml", "-q"])
    assert main(["plot", "output/cube.h5", "-o", "cube.foo"]) == 2
    assert ".png, .svg, .pdf" in capsys.readouterr().err


def test_a_file_without_frames_has_no_picture(here, capsys):
    main(["cube.toml", "-q"])
    with h5py.File("output/cube.h5", "r+") as file:
        file.attrs["n_frames"] = 0
    assert main(["plot", "output/cube.h5"]) == 2
    assert main(["info", "output/cube.h5"]) == 0
    assert "has no frames" in capsys.readouterr().err


def test_options_may_stand_before_the_case(here):
    assert main(["--set", "run.t_end=0.5", "cube.toml", "-q"]) == 0


def test_a_terminal_without_greek_letters_gets_an_answer(here):
    done = command("mass", "cube.toml", env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0
    assert "kg m?" in done.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("methods > /dev/full", "stdout cannot be written: No space left on device"),
        ("cases > /dev/full", "stdout cannot be written: No space left on device"),
        ("run --help > /dev/full", "stdout cannot be written: No space left on device"),
        ("run tumbling_brick -q", "the current folder is gone: change to one that is there"),
    ],
)
def test_a_refusal_of_the_system_names_its_place(here, words, message):
    """Stdout on a full disk, and a folder that was removed, have no name in the system's error."""
    gone = here / "gone"
    gone.mkdir()
    at = f'cd gone && rmdir "{gone}" && ' if "full" not in words else ""
    buffered = os.environ | {"PYTHONPATH": str(Path(particlerb.__file__).parents[1])}
    buffered.pop("PYTHONUNBUFFERED", None)
    done = subprocess.run(
        ["sh", "-c", f'{at}"$0" -m particlerb {words}', sys.executable],
        env=buffered, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr == f"particlerb: {message}\n"


def test_where_no_message_can_be_written_the_exit_code_tells(here):
    words = '"$0" -m particlerb run no_such_case 2> /dev/full'
    root = str(Path(particlerb.__file__).parents[1])
    env = os.environ | {"PYTHONPATH": root}
    assert subprocess.run(["sh", "-c", words, sys.executable], env=env, check=False).returncode == 2


def test_a_file_does_not_take_the_place_of_a_closed_stream(here):
    """As a service may be started: what goes to stderr must not end up in the file."""
    words = '"$0" -m particlerb cube.toml -o a.h5 --set run.threads=1 <&- >&- 2>&-'
    assert subprocess.run(["sh", "-c", words, sys.executable], check=False).returncode == 0
    with particlerb.open(here / "a.h5") as trajectory:
        assert all(found.is_whole for found in verify(trajectory))


@pytest.mark.compiled
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_child_process_makes_its_own_threads():
    code = (
        "import os, particlerb\n"
        "shape = {'type': 'moments', 'inertia': [1, 2, 2.5]}\n"
        "body = {'name': 'b', 'shape': shape, 'mass': 1, 'count': 3000,\n"
        "        'place': {'type': 'grid', 'spacing': 1.0}, 'angular_velocity': [1, 2, 3]}\n"
        "case = {'run': {'t_end': 1.0, 'every': 0.1, 'threads': 2}, 'body': [body]}\n"
        "particlerb.run(case).close()\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    particlerb.run(case).close()\n"
        "    os._exit(7)\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.strip() == "7"


@pytest.mark.parametrize(("dtype", "each"), [("float64", 68), ("float32", 40)])
def test_the_size_that_is_told_and_what_info_tells(make, tmp_path, capsys, dtype, each):
    """Contacts, walls and kept files are listed; the file is as large as was said, or smaller."""
    from particlerb.case.output import FIELDS_OF_CONTACT
    from particlerb.case.to_system import to_system
    from particlerb.cli.run import size_text

    (tmp_path / "points.csv").write_text("0 0 0 1\n1 0 0 1\n0 1 0 1\n" + 200_000 * "#")
    points = {"type": "points", "file": str(tmp_path / "points.csv")}
    place = {"type": "grid", "spacing": 1.0, "origin": [0, 0, 0.1]}
    fields = ["position", "orientation", *FIELDS_OF_CONTACT]
    case = make.case(
        make.sphere(count=4, place=place),
        {"name": "points", "shape": points, "contact": False, "position": [0, 0, 9]},
        t_end=0.1,
        every=1e-3,
        dt=1e-3,
        gravity={"acceleration": [0, 0, -9.81]},
        contact=make.hooke(),
        wall=[make.plane()],
        output={"fields": fields, "dtype": dtype},
    )
    told = size_text(to_system(case))
    number, unit = re.search(r"about ([\d.]+) ([kM])B", told).groups()
    most = float(number) * {"k": 1e3, "M": 1e6}[unit]
    assert f" and {each} bytes for each contact in a frame, whose number is not known in" in told
    with particlerb.run(case, tmp_path / "run.h5") as t:
        n = sum(len(t.contacts(k).wall) for k in range(t.n_frames))
    capsys.readouterr()
    assert main(["info", str(tmp_path / "run.h5"), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert set(facts["fields"]) == set(fields)
    assert facts["contacts"] == n > 300
    assert facts["files"] == [points["file"]]
    assert facts["size"] == (tmp_path / "run.h5").stat().st_size
    assert 0.3 < facts["size"] / (most + each * n) < 1.0
    assert main(["info", str(tmp_path / "run.h5")]) == 0
    assert re.search(r"^size +[\d.]+ [kM]B$", capsys.readouterr().out, re.MULTILINE)


def test_the_stiffest_contact_is_told_with_its_steps():
    from particlerb.cli.run import contact_text

    assert contact_text(0.065) == "stiffest contact: ω dt = 0.065, 48.3 steps in a contact"
    assert contact_text(0.5).endswith(", 6.28 steps in a contact; 20 are accurate")


@pytest.mark.parametrize(("turn", "warns"), [(0.5, False), (2.5, True)])
def test_contacts_beyond_their_limit_are_a_warning(monkeypatch, turn, warns):
    """The limit of `strang` is ω dt = 2."""
    from types import SimpleNamespace

    from particlerb.simulation.run_warnings import run_warnings

    monkeypatch.setattr("particlerb.simulation.run_warnings.stable_turn", lambda plan: 2.0)
    system = SimpleNamespace(check=SimpleNamespace(value=()))
    drift = SimpleNamespace(energy=0.0)
    seen = {"tree": None, "tally": None, "passed": 0.0, "drift": drift, "tension": ""}
    outcome = SimpleNamespace(contact_turn=turn, **seen)
    told = run_warnings(SimpleNamespace(plan=None, system=system, remedy="none"), outcome)
    assert bool(told) == warns
    assert all("ω dt = 2.5: above 2 " in text and "divide run.dt by 1.2" in text for text in told)


@pytest.mark.compiled
@pytest.mark.parametrize(("factor", "warns"), [(1.0, False), (30.0, True)])
def test_what_the_tree_errs_is_told(make, tmp_path, capsys, monkeypatch, factor, warns):
    """The angle is fitted at the start; what frames err later may be more than was asked for."""
    from particlerb.simulation import group_run

    before = group_run.sampled_error
    monkeypatch.setattr(group_run, "sampled_error", lambda tree: factor * before(tree))
    place = {"type": "random", "lower": [-3, -3, -3], "upper": [3, 3, 3]}
    stars = make.body("s", count=70, place=place)
    pull = {"G": 1e-3, "sum": "tree", "accuracy": 1e-4}
    case = make.case(stars, attraction=pull, t_end=0.1, every=0.1, dt=0.1)
    (tmp_path / "stars.toml").write_text(tomlkit.dumps(case))
    assert main([str(tmp_path / "stars.toml"), "-o", str(tmp_path / "a.h5")]) == 0
    said = capsys.readouterr()
    assert "opening angle 0.316, where no scene errs by more than 0.0001, or wider" in said.out
    assert re.search(r"opening angle 0\.[3-9]\d*, accelerations erred by .* of 0\.0001", said.out)
    assert ("the scene has changed since" in said.err) == warns
    assert ("attraction.opening_angle = 0." in said.err) == warns


@pytest.mark.slow
def test_check_tells_the_size_and_the_time_of_a_run(make, tmp_path, capsys):
    """Bytes within a factor of 2; seconds of 1e5 times as many steps are 1e4 to 1e6 times more."""
    from particlerb.case.reader import load
    from particlerb.case.to_system import to_system
    from particlerb.simulation.estimate import estimated_seconds
    from particlerb.simulation.run import prepare

    times = {"dt": 1e-3, "t_end": 10.0, "every": 0.01}
    case = make.case(make.body(), force=[make.torque([0.1, 0.2, 0.3])], method="strang", **times)
    (tmp_path / "case.toml").write_text(tomlkit.dumps(case))
    assert main(["check", str(tmp_path / "case.toml"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    particlerb.run(case, tmp_path / "run.h5").close()
    assert 0.5 < told["bytes"] / (tmp_path / "run.h5").stat().st_size < 2.0
    assert told["seconds"] > 0.0

    case["run"] |= {"t_end": 1e4, "every": 1e4}
    few = estimated_seconds(prepare(to_system(load(case))))
    case["run"] |= {"dt": 1e-8}
    many = estimated_seconds(prepare(to_system(load(case))))
    assert 1e4 < many / few < 1e6


@pytest.mark.parametrize(("quiet", "left"), [(False, ["kernels"]), (True, [])])
def test_all_but_quiet_runs_say_that_kernels_compile(quiet, left):
    """On terminals and in logs, as a run without a word for minutes seems to hang."""
    kept, WHEN_COMPILING[:] = WHEN_COMPILING[:], ["kernels"]
    try:
        with ranks_of(argparse.Namespace(mpi=False, quiet=quiet)):
            assert left == WHEN_COMPILING
    finally:
        WHEN_COMPILING[:] = kept
    code = "from particlerb.compiled.jit import WHEN_COMPILING as w; print(*w)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.startswith("kernels, once: ")


def test_check_leaves_compilation_out_of_the_time_of_a_run(make, monkeypatch):
    """A kernel that is compiled in the third piece of a trial is not 2^22 times in the estimate."""
    from numba.core.event import trigger_event

    from particlerb.case.reader import load
    from particlerb.case.to_system import to_system
    from particlerb.simulation.estimate import Run, estimated_seconds
    from particlerb.simulation.run import prepare

    calls, frames_at = [], Run.frames_at

    def compiling(run, *arguments):
        calls.append(1)
        if len(calls) == 3:
            with trigger_event("numba:compile"):
                time.sleep(0.4)
        return frames_at(run, *arguments)

    monkeypatch.setattr(Run, "frames_at", compiling)
    assert estimated_seconds(prepare(to_system(load(make.case(make.body()))))) < 1000.0


@pytest.mark.plain
def test_check_does_not_take_a_part_of_a_step_for_the_speed_of_a_run(make, monkeypatch):
    """A call costs 0.5 s or more, however little it covers: 2e-7 of a run is no measure."""
    from types import SimpleNamespace

    from particlerb.case.reader import load
    from particlerb.case.to_system import to_system
    from particlerb.simulation import estimate
    from particlerb.simulation.run import prepare

    clock, reached, step, frames_at = [0.0], [0.0], 0.01, estimate.Run.frames_at

    def slow(run, times, *arguments):
        clock[0] += 0.5 * max(1.0, round((times[-1] - reached[0]) / step))  # s, a step
        reached[0] = times[-1]
        return frames_at(run, times, *arguments)

    monkeypatch.setattr(estimate.Run, "frames_at", slow)
    monkeypatch.setattr(estimate, "time", SimpleNamespace(perf_counter=lambda: clock[0]))
    times = {"dt": step, "t_end": 2.0, "every": 0.1, "method": "strang"}
    case = make.case(make.body(), force=[make.torque([0.1, 0.2, 0.3])], **times)
    assert 50.0 < estimate.estimated_seconds(prepare(to_system(load(case)))) < 200.0  # of 100
