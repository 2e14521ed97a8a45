"""How many times a second the page of `view` is brought up to date, without the browser's share.

One update advances the motion, puts every body in its place, points the arrows and writes the
numbers; messages are made and queued, as no browser is there to draw them.
usage: python benchmarks/view.py [SECONDS]
"""

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


def main() -> None:
    """Print the table."""
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
