"""A copy of the process compiles beside it: what it makes is found, and nothing hangs on it."""

import os
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(sys.platform != "linux", reason="a copy is made by fork"),
]

PROGRAM = """
import os, sys
from functools import partial
import numba
import numpy as np
from numba.core.event import Listener, register
from particlerb.compiled import beside
from particlerb.compiled.threads import THREADS
from particlerb.stepping.loop import copy_blocks

class Here(Listener):
    def on_start(self, event):
        print("here", event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass

THREADS.use(2)
arguments = np.ones((1, 3000)), np.zeros((1, 3000)), np.ones(1, dtype=np.int64), 0, 1
signature = tuple(map(numba.typeof, arguments))
function = copy_blocks.copied
work = partial(function.compile, signature)
register("numba:compile", Here())
forks = []
fork = os.fork
os.fork = lambda: forks.append(fork()) or forks[-1]
{jobs}
beside.wait_for(function)
work()
print("forks", len(forks), "compiled", len(function.overloads))
try:
    os.waitpid(-1, 0)
except ChildProcessError:
    print("none left")
"""
ONE = "beside.compile_beside([(function, work)])"
DIES = "beside.compile_beside([(function, lambda: os._exit(1))])"
FAILS = "beside.compile_beside([(function, lambda: 1 / 0)])"
SOME = (
    "beside.compile_beside([(copy_blocks, partial(copy_blocks.compile, signature)), "
    "(function, lambda: os._exit(1))])"
)
ALONE = "THREADS.use(1)\n" + ONE


def said(jobs, cache):
    """Lines of the program with these jobs."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment |= {"NUMBA_CACHE_DIR": str(cache)}
    words = [sys.executable, "-c", PROGRAM.replace("{jobs}", jobs)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    assert not done.stderr
    return done.stdout.splitlines()


def test_what_the_copy_compiles_is_found_and_not_made_again(tmp_path):
    assert said(ONE, tmp_path) == ["forks 1 compiled 1", "none left"]
    assert said(ONE, tmp_path) == ["forks 0 compiled 1", "none left"]  # it is on disk


def test_behind_the_first_what_is_on_disk_is_left_out(tmp_path):
    said(ONE, tmp_path)
    assert said(SOME, tmp_path) == ["forks 1 compiled 1"]
    assert said(SOME, tmp_path) == ["forks 0 compiled 1", "none left"]


@pytest.mark.parametrize("jobs", [DIES, FAILS])
def test_where_the_copy_ends_early_the_process_compiles_itself(jobs, tmp_path):
    lines = said(jobs, tmp_path)
    assert "here copy_blocks" in lines
    assert lines[-2:] == ["forks 1 compiled 1", "none left"]


def test_one_thread_makes_no_copy(tmp_path):
    lines = said(ALONE, tmp_path)
    assert "here copy_blocks" in lines
    assert lines[-2:] == ["forks 0 compiled 1", "none left"]


SHARED = """
import time
def note():
    with open("notes", "a") as notes:
        print(os.getpid(), file=notes)
    start = time.monotonic()
    while len(forks) and len(set(open("notes").read().split())) < 2:
        assert time.monotonic() < start + 60.0
        time.sleep(0.01)
forks.clear()
beside.share([note] * 2)
print("forks", len(forks))
forks.append(0)
beside.share([note] * 3)
forks.remove(0)
"""


def test_whoever_is_free_takes_what_nobody_has_begun(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = said(SHARED, tmp_path)
    assert [line for line in lines if "forks" in line] == ["forks 0", "forks 1 compiled 1"]
    done = (tmp_path / "notes").read_text().split()
    assert len(done) == 5
    assert len(set(done)) == 2
