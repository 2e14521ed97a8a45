"""Kills runs at random moments while they write; every file must open, and go on bit for bit.

Run as a script for many kills: `python tests/record/kills.py 200`. It prints what was found and
ends with 1 where a file was not as it should be.
"""

import contextlib
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from tqdm import tqdm

import particlerb
from particlerb.case.to_system import to_system
from particlerb.record import writer
from particlerb.record.checkpoint import read_checkpoint
from particlerb.record.trajectory import Trajectory, TrajectoryError
from particlerb.record.vtkhdf import is_finished
from particlerb.simulation import frame_times
from particlerb.simulation import run as simulate
from particlerb.simulation.resume import ResumeError, look_at, resume_pending

OTHERS = ("parameters/case_path", "parameters/plan", "parameters/accuracy", "checkpoint/")
SPIN = {"angular_velocity": [1.0, 0.4, -0.7], "velocity": [0.3, 0.1, -0.2]}


def contents(path: Path) -> dict[str, Any]:
    """Every dataset, but for texts that speak of the machine or of the time at the end."""
    found: dict[str, Any] = {}

    def note(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith(OTHERS):
            value = item[()]
            found[name] = value if isinstance(value, bytes) else (value.shape, value.tobytes())

    with h5py.File(path, "r", locking=False) as file:
        file.visititems(note)
        found["committed"] = int(file.attrs["n_frames"])
        found["state"] = {
            name: np.asarray(values).tobytes()
            for name, values in read_checkpoint(file).arrays.items()
        }
    return found


def differences(path: Path, straight: Path) -> list[str]:
    """Names of what is not the same in two files."""
    one, other = contents(path), contents(straight)
    return [name for name in sorted(one.keys() | other.keys()) if one.get(name) != other.get(name)]


def without_contact() -> dict[str, Any]:
    """Bodies on springs, some of them pushed for a while."""
    shape = {"type": "moments", "inertia": [1.0, 2.0, 2.5]}
    place = {"type": "grid", "spacing": 2.0}
    bodies = {"name": "b", "shape": shape, "mass": 2.0, "count": 30, "place": place} | SPIN
    spring = {"type": "spring", "body": "b", "anchor": [1, 1, 1], "stiffness": 5.0}
    push = {
        "type": "push",
        "body": "b",
        "force": [0, 1, 0],
        "at": [0.3, 0, 0],
        "during": [0.5, 1.2],
    }
    run = {"t_end": 2.05, "every": 0.01, "dt": 1e-3, "method": "strang", "threads": 1}
    return {"run": run, "body": [bodies], "force": [spring, push]}


def with_contact() -> dict[str, Any]:
    """Balls that fall into a box and on each other."""
    ball = {"name": "b", "shape": {"type": "sphere", "radius": 0.1}, "mass": 2.0, "count": 64}
    place = {"type": "grid", "spacing": 0.22, "origin": [0, 0, 0.44]}
    box = {"name": "box", "type": "box", "lower": [-0.5, -0.5, 0], "upper": [0.5, 0.5, 3]}
    contact = {"stiffness": 1e4, "restitution": 0.7, "friction": 0.5}
    run = {"t_end": 0.2005, "every": 1e-3, "dt": 5e-4, "threads": 1}
    gravity = {"acceleration": [0, 0, -9.81]}
    bodies = [ball | {"place": place} | SPIN]
    return {"run": run, "body": bodies, "contact": contact, "wall": [box], "gravity": gravity}


SCENES = {"without contact": without_contact, "with contact": with_contact}


class Found(NamedTuple):
    """What came of some kills."""

    kills: int
    wrong: list[str]
    committed: list[int]  # frames at each kill


@contextlib.contextmanager
def writing_all_the_time() -> Any:
    """Commits, and mostly checkpoints, after every few frames: a kill nearly always hits one."""
    before = writer.SECONDS_BETWEEN_COMMITS, writer.SHARE_OF_CHECKPOINTS, frame_times.BATCH_SECONDS
    writer.SECONDS_BETWEEN_COMMITS, writer.SHARE_OF_CHECKPOINTS = -1.0, 0.5
    frame_times.BATCH_SECONDS = 0.002
    try:
        yield
    finally:
        writer.SECONDS_BETWEEN_COMMITS, writer.SHARE_OF_CHECKPOINTS = before[:2]
        frame_times.BATCH_SECONDS = before[2]


def killed(work: Callable[[], object], after: float) -> bool:
    """Whether a process that does this work was killed after some time [s], and not done before."""
    child = os.fork()
    if not child:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def check(path: Path, straight: Trajectory) -> int:
    """Frames of a file, which must be those of the straight run."""
    with particlerb.open(path) as found:
        n = found.n_frames
        for name in (*straight.fields, "time"):
            values, right = getattr(found, name)[:n], getattr(straight, name)[:n]
            assert values.tobytes() == right.tobytes(), f"{name} of {n} frames"
        for name, values in found.ledger._asdict().items():
            right = getattr(straight.ledger, name)[:n]
            assert values.tobytes() == right.tobytes(), f"{name} of {n} frames"
    return n


def kill_runs(
    case: dict[str, Any], folder: Path, kills: int, seed: int, tick: Callable[[], object] = object
) -> Found:
    """Kill runs of a case, and half of the runs that go on with them; compare what is left."""
    rng, wrong, committed = random.Random(seed), [], []
    straight, path = folder / "straight.h5", folder / "killed.h5"
    prepared = simulate.prepare(to_system(case))
    with writing_all_the_time():
        simulate.run_prepared(prepared, straight)  # compiles
        start = time.monotonic()
        simulate.run_prepared(prepared, straight, overwrite=True)
        length = time.monotonic() - start
        with particlerb.open(straight) as right:
            while len(committed) < kills:
                path.unlink(missing_ok=True)
                work: Callable[[], object] = partial(simulate.run_prepared, prepared, path)
                while killed(work, rng.uniform(0.0, 1.0) * length):
                    if not path.exists():  # nothing was written yet
                        break
                    try:
                        committed.append(check(path, right))
                        tick()
                        with particlerb.open(path) as left:
                            is_done = is_finished(left.file, right.n_frames)
                        if committed[-1] == right.n_frames and is_done:
                            break  # killed behind the end
                        work = partial(resume_pending, look_at(path))
                    except (AssertionError, OSError, ResumeError, TrajectoryError) as error:
                        wrong.append(f"kill {len(committed)}: {error}")
                        break
                    if rng.random() < 0.5:
                        work()
                        break
                if path.exists():
                    wrong += [f"kill {len(committed)}: {d}" for d in differences(path, straight)]
    return Found(len(committed), wrong, committed)


def main() -> int:
    """Kill as often as the command line says."""
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    is_right = True
    for name, make in SCENES.items():
        with tempfile.TemporaryDirectory() as folder:
            count = kills // len(SCENES)
            with tqdm(total=count, desc=name, unit="kill", disable=None) as bar:
                found = kill_runs(make(), Path(folder), count, kills, bar.update)
        is_right &= not found.wrong
        spread = f"{min(found.committed)} to {max(found.committed)} frames committed"
        print(f"{name}: {found.kills} kills, {spread}, {len(found.wrong)} wrong", *found.wrong)
    return 0 if is_right else 1


if __name__ == "__main__":
    sys.exit(main())
