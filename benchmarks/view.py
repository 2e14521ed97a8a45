"""How long `view` takes to its page, and how many times a second it is brought up to date.

A start is the command until it prints its address, with an empty cache and again: wall and
processor seconds; goals 15 and 2. One update advances the motion, puts every body in its place,
points the arrows and writes the numbers; messages are made and queued. The browser's share is in
none of the figures.
usage: python benchmarks/view.py [SECONDS]
"""

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import particlerb
from particlerb.case.to_system import to_system
from particlerb.record.trajectory import open_trajectory
from particlerb.view.access import Access
from particlerb.view.live import Live, rehearse
from particlerb.view.replay import Replay
from particlerb.view.server import listening

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 3.0
PORT = 8500
CASES = Path(__file__).parents[1] / "cases"


def cubes(n: int) -> dict:
    """Cubes on a grid, tumbling."""
    shape = {"type": "box", "size": [0.2, 0.3, 0.4], "arrangement": "exact"}
    spin = {"random": 2.0}
    grid = {"type": "grid", "spacing": 0.6}
    body = {"name": "cube", "shape": shape, "mass": 1.0, "count": n, "angular_velocity": spin}
    place = {"place": grid} if n > 1 else {}
    return {"run": {"t_end": 5.0, "every": 0.05}, "body": [body | place]}


def updates(page) -> float:
    """Updates per second of a page, as fast as they go; each shows another state."""
    page.update(1.0 / 60.0)
    start, count = time.perf_counter(), 0
    while time.perf_counter() - start < SECONDS:
        if isinstance(page, Replay):
            page.look_at_frame((page.frame + 1) % len(page.times))
        page.update(1.0 / 60.0)
        count += 1
    return count / (time.perf_counter() - start)


def start(cache: str) -> tuple[float, float]:
    """Wall and processor seconds of the command until it says where its page is."""
    words = [sys.executable, "-m", "particlerb", "view", "--no-browser", "--port", str(PORT + 10)]
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    with subprocess.Popen(
        words,
        env={**os.environ, "NUMBA_CACHE_DIR": cache},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        next(line for line in process.stdout if line.startswith("http"))
        wall = time.perf_counter() - begin
        process.send_signal(signal.SIGINT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the tables."""
    print("start                       wall s   processor s")
    with tempfile.TemporaryDirectory() as cache:
        for name in ("empty cache", "again", "again"):
            wall, used = start(cache)
            print(f"{name:<24}{wall:>10.1f}{used:>14.1f}", flush=True)
    print("page                                     updates/s")
    for n in (1, 500, 10_000):
        system = to_system(cubes(n))
        rehearse(system)
        with listening(Access(), PORT) as server:
            live = Live(system, server, Path("session.toml"))
            print(f"live, {n} bodies{'':<{28 - len(str(n))}}{updates(live):>10.0f}", flush=True)
    for n in (500, 10_000):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.h5"
            particlerb.run(cubes(n), path).close()
            with open_trajectory(path) as trajectory, listening(Access(), PORT) as server:
                replay = Replay(trajectory, server, path)
                rate = updates(replay)
                print(f"replay, {n} bodies{'':<{26 - len(str(n))}}{rate:>10.0f}", flush=True)


if __name__ == "__main__":
    main()
