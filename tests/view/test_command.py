"""The command `view`: what it takes, where it listens, what it leaves behind."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("viser")

import particlerb
import particlerb.cli.view as command
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.compiled.jit import config
from particlerb.view.live import Live
from particlerb.view.session import UserPush


@pytest.fixture
def served(monkeypatch, tmp_path):
    """Pages that would be served, each ended at once; in an empty folder."""
    monkeypatch.chdir(tmp_path)
    pages, doors, real = [], [], command.open_to

    def watched(access, no_browser):
        doors.append(access)
        return real(access, no_browser)

    monkeypatch.setattr(command, "open_to", watched)
    monkeypatch.setattr(Live, "go", lambda page: pages.append((page, doors[-1])))
    return pages


def test_without_arguments_it_shows_the_cube_of_the_paper(served, capsys):
    assert main(["view", "--port", "8400"]) == 0
    ((page, access),) = served
    assert page.server.get_host() == access.host == "127.0.0.1"
    assert access.token
    (cube,) = page.session.system.body
    assert (cube.mass, cube.shape.size) == (2.0, (1.0, 1.0, 1.0))
    assert not page.session.has_gravity
    assert not page.session.frame.position.any()
    assert "warning" not in capsys.readouterr().err


def test_another_address_is_warned_of(served, capsys):
    assert main(["view", "--host", "0.0.0.0", "--port", "8410"]) == 0
    assert "open to the network" in capsys.readouterr().err
    assert served[0][0].server.get_host() == "0.0.0.0"
    assert main(["view", "--no-token", "--port", "8410"]) == 0
    assert "--no-token lets every user of this machine push" in capsys.readouterr().err
    assert not served[1][1].token


def test_the_address_stands_alone_on_its_line(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Live, "go", lambda page: None)
    assert main(["view", "--port", "8415", "--host", "::1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (address,) = [line for line in lines if "http" in line]
    assert re.fullmatch(r"http://\[::1\]:\d+/\?token=[0-9a-f]{48}", address)


def test_the_first_scene_is_compiled_before_a_server_has_threads(served, monkeypatch):
    """Beside them no copy of the process compiles, and a heap took a third longer."""
    before, new = set(threading.enumerate()), []
    rehearse = lambda system: new.append(set(threading.enumerate()) - before)  # noqa: E731
    monkeypatch.setattr("particlerb.view.live.rehearse", rehearse)
    assert main(["view", "--port", "8418"]) == 0
    assert new == [set()]


LONG_SESSION = """
import json
import particlerb.cli
from particlerb.compiled import plain
from particlerb.compiled.jit import compiling
from particlerb.view.live import Live
from particlerb.view.session import UserPush

def used(page):
    plain._Time.left -= 1.0  # [s], as after some thousand updates
    page.session.advance(0.25)
    page.session.apply(UserPush(0, (0.2, 0.2, -0.5), (0.0, 0.0, 1.0), 0.0))
    page.session.advance(0.5)

Live.go = used
with compiling() as spent:
    assert particlerb.cli.main(["view", "--port", "8425", "-o", {path!r}]) == 0
print()
print(json.dumps(len(spent)))
"""


@pytest.mark.compiled
@pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled in plain Python")
def test_no_push_waits_for_the_compiler_however_long_a_page_is_open(make, tmp_path):
    """Where little moves, Python goes on to do it: a page that compiles stands still."""
    code = LONG_SESSION.format(path=str(tmp_path / "session.toml"))
    printed = make.python(code, NUMBA_CACHE_DIR=str(tmp_path / "kept"))
    assert printed.splitlines()[-1] == "0"


def test_a_session_is_saved_at_the_end(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)

    def pushed(page):
        page.session.advance(0.25)
        page.session.apply(UserPush(0, (0.2, 0.2, -0.5), (0.0, 0.0, 1.0), 0.0))

    monkeypatch.setattr(Live, "go", pushed)
    for name in ("cube_at_rest_session", "cube_at_rest_session_2"):  # nothing is written over
        assert main(["view", "--port", "8420"]) == 0
        case = load(tmp_path / "output" / f"{name}.toml")
        assert case.force[0].time == 0.25
        assert f"{name}.toml" in capsys.readouterr().out


@pytest.fixture
def hears_interrupts():
    """A shell lets what it starts in the background ignore Ctrl-C; the program keeps to that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("hears_interrupts")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_gravity_that_was_switched_is_saved_at_a_signal(monkeypatch, tmp_path, capsys, number):
    monkeypatch.chdir(tmp_path)

    def switched(page):
        page.session.advance(0.25)
        page.session.switch_gravity(True)
        page.session.advance(0.5)
        os.kill(os.getpid(), number)
        time.sleep(5.0)
        raise AssertionError("the signal did not end the page")

    monkeypatch.setattr(Live, "go", switched)
    assert main(["view", "--port", "8430"]) == 0
    (weight,) = load(tmp_path / "output" / "cube_at_rest_session.toml").force
    assert weight.during[0] == 0.25
    assert "cube_at_rest_session.toml" in capsys.readouterr().out


def test_a_scene_that_is_chosen_takes_the_place_of_the_first(monkeypatch, tmp_path, capsys):
    """What was pushed before is saved; the address stays."""
    monkeypatch.chdir(tmp_path)
    seen = []

    def go(page):
        seen.append([str(name) for name in page.session.system.names])
        if len(seen) == 1:
            page.session.advance(0.25)
            page.session.apply(UserPush(0, (0.2, 0.2, -0.5), (0.0, 0.0, 1.0), 0.0))
            page.controls.scene.value = "T-handle"
            page.change_scene(None)

    monkeypatch.setattr(Live, "go", go)
    assert main(["view", "--port", "8460"]) == 0
    told = capsys.readouterr().out
    assert seen[0] == ["cube"]
    assert seen[1] == [str(name) for name in system_of_example("t_handle").names]
    assert told.count("token=") == 1
    assert [path.name for path in (tmp_path / "output").iterdir()] == ["cube_at_rest_session.toml"]


@pytest.mark.parametrize("name", command.SCENES)
def test_every_scene_of_the_page_is_an_example(name):
    assert system_of_example(command.SCENES[name]).n_bodies


def system_of_example(name):
    """System of an example by its name."""
    return to_system(load(name))


def test_the_browser_opens_the_page_where_there_is_a_display(served, monkeypatch):
    """The address, which lets in whoever knows it, lies in a file that nobody else reads."""
    doors = []

    def opened(address):
        file = Path(address.removeprefix("file://"))
        doors.append((file.read_text(), file.parent.stat().st_mode & 0o077, file))

    monkeypatch.setattr("webbrowser.open", opened)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert main(["view", "--port", "8470"]) == 0
    assert not doors
    monkeypatch.setenv("DISPLAY", ":0")
    assert main(["view", "--port", "8470", "--no-browser"]) == 0
    assert not doors
    assert main(["view", "--port", "8470"]) == 0
    ((text, others, file),) = doors
    assert served[-1][1].addresses()[0] in text
    assert not others
    assert not file.exists()


def test_a_session_without_changes_is_not_saved(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Live, "go", lambda page: page.session.advance(0.25))
    assert main(["view", "--port", "8440"]) == 0
    assert not (tmp_path / "output").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing_like_this"], "no such file or case"),
        (["nothing.h5"], "no such file"),
        (["--port", "0"], "must be between 1 and 65535"),
        (["cube_at_rest", "--set", "run.dtt=1"], "unknown key"),
    ],
)
def test_wrong_use_is_said_in_one_message(served, capsys, arguments, message):
    assert main(["view", *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not served


def test_an_address_that_is_not_ours_is_an_error(served, capsys):
    assert main(["view", "--host", "no.such.host.invalid"]) == 1
    assert capsys.readouterr().err
    assert main(["view", "--host", "203.0.113.5"]) == 1  # of no machine: RFC 5737
    assert not served


def test_without_viser_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["view"]) == 1
    assert 'pip install "particlerb[view]"' in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="finds a child as Linux tells it")
@pytest.mark.parametrize(
    ("crashes", "number", "code", "said"),
    [
        (True, signal.SIGSEGV, 1, "run.h5 is damaged: HDF5 crashed on it (signal 11)"),
        (False, signal.SIGINT, 0, ""),
        (False, signal.SIGTERM, 0, ""),
    ],
)
def test_a_file_is_played_in_a_process_of_its_own(make, tmp_path, crashes, number, code, said):
    """HDF5 may crash on a frame of a damaged file, long behind the first look at it."""
    particlerb.run(make.case(make.body()), tmp_path / "run.h5").close()
    words = [sys.executable, "-m", "particlerb", "view", "run.h5", "--port", "8450"]
    signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs of a shell ignore it
    with subprocess.Popen(
        words, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as page:
        while "token" not in page.stdout.readline():
            assert page.poll() is None, page.stderr.read()
        child = int(Path(f"/proc/{page.pid}/task/{page.pid}/children").read_text())
        os.kill(child if crashes else page.pid, number)
        try:
            err = page.communicate(timeout=60)[1]
        finally:
            page.kill()
        assert page.returncode == code, err
        assert said in err
        assert not Path(f"/proc/{child}").exists()
