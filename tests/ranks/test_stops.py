"""Runs of ranks that are stopped, killed, or find no room: no committed frame is lost."""

import random
import signal
import subprocess

import pytest
from stops import (
    HERE,
    LONG,
    PLAIN,
    command,
    frames_in,
    line,
    needs_mpi,
    next_words,
    run_words,
    stopped,
    whole,
)

pytestmark = [needs_mpi, pytest.mark.plain]


def test_a_run_goes_on_on_another_number_of_ranks(tmp_path):
    """A signal to one rank ends all behind a frame; kills take nothing; the bits are those."""
    straight, path, dice = tmp_path / "straight.h5", tmp_path / "run.h5", random.Random(7)
    done = command(*run_words(straight, *LONG), ranks=1)
    assert done.returncode == 0, done.stderr
    begin = run_words(path, *LONG)
    code, err = stopped(begin, 2, signal.SIGTERM, False, dice.uniform(0.3, 0.6), path)
    assert code == 130, err
    assert err.count("interrupted") == 1, err
    assert f"continue with: mpiexec -n 2 python -m particlerb resume {path} --mpi\n" in err
    frames = [frames_in(path)]
    assert 0 < frames[0] < 17
    stopped(next_words(path), 3, signal.SIGKILL, True, dice.uniform(0.0, 1.0), path)
    frames.append(frames_in(path))
    assert frames[1] >= frames[0]
    done = command(*next_words(path))
    assert done.returncode == 0, done.stderr
    assert whole(path) == whole(straight)
    done = command("resume", path, "--t-end", "0.35", ranks=2)
    assert done.returncode == 0, done.stderr
    assert frames_in(path) == 19


@pytest.mark.parametrize("module", ["particlerb.cli", "particlerb.cli.run", "mpi4py.MPI"])
def test_an_interrupt_of_one_rank_that_is_still_imported_ends_all(tmp_path, module):
    """The others are about to wait for it in MPI, and launchers let them."""
    words = run_words(tmp_path / "run.h5", "-q", scene="free.toml")
    words = [*line(ranks=3)[:4], str(HERE / "interrupted.py"), *map(str, words), "--mpi"]
    done = subprocess.run(
        words,
        env=PLAIN | {"MODULE": module},
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr == "particlerb: interrupted\n"
    assert not list(tmp_path.iterdir())


ALONE = """
import argparse
from particlerb.cli.exit_codes import Ending
from particlerb.cli.ranks import ranks_of
with ranks_of(argparse.Namespace(quiet=True, mpi=True)) as ranks:
    if ranks.number == 1:
        raise Ending("interrupted; 3 frames are kept", 130)
    ranks.gathered(0)
"""


def test_a_command_that_ends_on_one_rank_ends_all():
    """The others would wait for it: an interrupt of the set-up, or a case wrong there alone."""
    done = subprocess.run(
        [*line(ranks=3)[:4], "-c", ALONE],
        env=PLAIN, capture_output=True, text=True, timeout=60.0, check=False,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stderr == "particlerb: interrupted; 3 frames are kept (rank 1)\n"


@pytest.mark.parametrize("scene", ["mix.toml", "heap.toml"])
def test_a_disk_that_is_full_from_the_start_keeps_nothing(tmp_path, scene):
    """Not the folder of the parts either, whichever rank leaves it last."""
    words = run_words(tmp_path / "run.h5", *LONG, "-q", scene=scene)
    done = command(*words, ranks=2, LIMITED="50000", OFTEN="1")
    assert done.returncode == 1, done.stderr
    assert "no file was written" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_full_disk_of_one_rank_ends_all(tmp_path):
    path = tmp_path / "run.h5"
    done = command(*run_words(path, *LONG, "-q"), ranks=2, LIMITED="1150000", OFTEN="1")
    assert done.returncode == 1, done.stderr
    assert done.stderr.count("the run failed") == 1, done.stderr
    assert "run.parts/000" in done.stderr
    assert "(rank 1)" in done.stderr
    n = frames_in(path)
    assert n > 0
    assert f"{n} frame" in done.stderr
    done = command(*next_words(path))
    assert done.returncode == 0, done.stderr
    assert frames_in(path) == 17
