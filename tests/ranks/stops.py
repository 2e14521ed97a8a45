"""Ends runs of ranks, and goes on with them on other ranks; the files must be those of a whole run.

As a script for many kills: `python tests/ranks/stops.py 20 [heap.toml]`; it ends with 1 where one
was not. LONGEST=2: seconds until a kill, at most. NUMBA_DISABLE_JIT=0: compiled.
"""

import hashlib
import importlib.util
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest

from particlerb.record.checkpoint import slots_in
from particlerb.record.parts import parts_in

HERE = Path(__file__).parent
BESIDE = Path(sys.executable).with_name("mpiexec")
MPIEXEC = str(BESIDE) if BESIDE.exists() else shutil.which("mpiexec")
PLAIN = {
    **os.environ,
    "NUMBA_DISABLE_JIT": os.environ.get("NUMBA_DISABLE_JIT", "1"),
    "MPICH_INTERFACE_HOSTNAME": "localhost",
    "PYTHONPATH": str(HERE.parents[1]),
    "PARTICLERB_IS_GUARDED": "1",  # one process, with these superblocks
    "PYTHONDONTWRITEBYTECODE": "",  # each of many processes would compile all sources
}
SECONDS = 300.0
LONG = ("--set", "run.t_end=0.31", "--set", "run.every=0.02")  # 17 frames, the last between two
needs_mpi = pytest.mark.skipif(
    MPIEXEC is None or importlib.util.find_spec("mpi4py") is None, reason="there is no mpiexec"
)


def line(*words: str | Path, ranks: int = 0) -> list[str]:
    """A command line with superblocks of 256 bodies, on ranks of one thread."""
    before = [MPIEXEC, "-n", str(ranks)] if ranks else []
    after = ["--mpi"] if ranks else []
    return [*map(str, [*before, sys.executable, HERE / "small_superblocks.py", *words, *after])]


def command(
    *words: str | Path, ranks: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """What a command does."""
    return subprocess.run(
        line(*words, ranks=ranks), env=PLAIN | environment, capture_output=True, text=True,
        timeout=SECONDS, check=False,
    )  # fmt: skip


def run_words(path: Path, *more: str, scene: str = "mix.toml") -> list[str | Path]:
    """Words that run a scene of the tests."""
    return [HERE / scene, "-o", path, "--threads", "1", *more]


def digests(path: Path) -> dict[str, str]:
    """SHA-256 of all arrays of a file that are numbers, checkpoints aside."""
    found = {}

    def look(name: str, item: object) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith(("checkpoint", "parameters/")):
            found[name] = hashlib.sha256(np.ascontiguousarray(item[()]).tobytes()).hexdigest()

    with h5py.File(path, "r") as file:
        file.visititems(look)
    return found


def whole(path: Path) -> dict[str, str]:
    """The same of a master, and the last state in each of its parts, which must not be longer."""
    found = digests(path)
    with h5py.File(path, "r") as file:
        parts, n = parts_in(file), int(file.attrs["n_frames"])
    assert parts is not None
    for name in parts.names:
        with h5py.File(path.parent / name, "r") as part:
            assert part.attrs["n_frames"] == len(part["particles/trajectory/time"]) == n
            states = slots_in(part)
        for key, values in states[max(states)].items():
            found[f"{Path(name).name} {key}"] = np.asarray(values).tobytes().hex()
    return found


def stopped(
    words: Sequence[str | Path], ranks: int, number: int, to_all: bool, after: float, path: Path
) -> tuple[int, str]:
    """Exit code and stderr of a run that gets a signal, so long after its folder was there [s]."""
    mark, folder = uuid.uuid4().hex, path.with_suffix(".parts")
    with subprocess.Popen(
        line(*words, ranks=ranks), env=PLAIN | {"OFTEN": "1", "MARK": mark}, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        deadline = time.monotonic() + SECONDS
        while process.poll() is None and time.monotonic() < deadline:
            if any(folder.glob("*")) and (path.exists() or after < 0.3):
                break
            time.sleep(0.02)
        time.sleep(after)
        own = own_ranks(mark)
        for pid in own if to_all else own[-1:]:
            with suppress(ProcessLookupError):  # it may just have ended
                os.kill(pid, number)
        _, err = process.communicate(timeout=SECONDS)
        return process.returncode, err


def own_ranks(mark: str) -> list[int]:
    """Processes that run Python and have a mark in their environment."""
    found = []
    for place in Path("/proc").glob("[0-9]*"):
        try:
            is_own = f"MARK={mark}".encode() in (place / "environ").read_bytes().split(b"\0")
            if is_own and b"small_superblocks" in (place / "cmdline").read_bytes().split(b"\0")[1]:
                found.append(int(place.name))
        except (OSError, IndexError):
            continue
    return sorted(found)


def frames_in(path: Path) -> int:
    """Committed frames of a file, which must be whole; 0 where there is none."""
    if not path.exists():
        return 0
    done = command("info", path, "--verify")
    assert done.returncode == 0, done.stdout + done.stderr
    with h5py.File(path, "r") as file:
        return int(file.attrs["n_frames"])


def next_words(path: Path, scene: str = "mix.toml") -> list[str | Path]:
    """Words that go on with a run, or that run it anew where nothing was committed."""
    anew = run_words(path, *LONG, scene=scene)
    return ["resume", path, "--threads", "1"] if path.exists() else anew


def main() -> int:
    """Kill all ranks as often as the command line says, on 1 to 4 of them in turn."""
    n, dice, wrong, frames = int(sys.argv[1]), random.Random(1), 0, []
    scene = (*sys.argv[2:], "mix.toml")[0]
    with tempfile.TemporaryDirectory() as folder:
        straight, path = Path(folder) / "straight.h5", Path(folder) / "run.h5"
        assert command(*run_words(straight, *LONG, scene=scene), ranks=1).returncode == 0
        expected = whole(straight)
        for k in range(n):
            words, after = (
                next_words(path, scene),
                dice.uniform(0, float(os.environ.get("LONGEST", "2"))),
            )
            stopped(words, k % 4 + 1, signal.SIGKILL, True, after, path)
            frames.append(frames_in(path))
            wrong += frames[-1] < (frames[-2] if frames[:-1] else 0)
            print(k + 1, "kills, frames", frames[-1], "wrong", wrong, flush=True)
            if k % 3 == 2 or k == n - 1:
                done = command(*next_words(path, scene), ranks=(0, 2, 3)[k // 3 % 3])
                is_done = "nothing left to do" in done.stderr
                wrong += (done.returncode != 0 and not is_done) or whole(path) != expected
                path.unlink()
                shutil.rmtree(path.with_suffix(".parts"))
                frames.append(0)
    return wrong > 0


if __name__ == "__main__":
    sys.exit(main())
