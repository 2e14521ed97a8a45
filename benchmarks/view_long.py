"""Whether a page of `view` stays as it was: 1000 pushes and 1000 browsers that come and go.

A row is written after each part: seconds of the processor for a push (the mean of the last ten),
updates for such a second, and memory. Nobody draws; one motion goes
on throughout, from a first push on.
usage: python benchmarks/view_long.py [PUSHES] [BROWSERS] > view_long.csv
"""

import sys
import time
from pathlib import Path

import msgspec
import viser
from websockets.sync.client import connect

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.view.access import Access
from particlerb.view.live import Live, rehearse
from particlerb.view.server import listening
from particlerb.view.session import UserPush

PUSHES, BROWSERS = (int(word) for word in (*sys.argv[1:], "1000", "1000")[:2])
PUSH = UserPush(0, (0.2, 0.2, -0.5), (0.0, 0.0, 5.0), 0.0)
PORT, PARTS, SECONDS = 8520, 5, 2.0
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (3.0, 3.0, 3.0),
    "fov": 1.0,
    "image_height": 600,
    "image_width": 800,
    "near": 0.01,
    "far": 1000.0,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}


def memory() -> float:
    """Of this process [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def updates(page: Live) -> float:
    """Updates of the page for a second of the processor."""
    start, count, end = time.process_time(), 0, time.perf_counter() + SECONDS
    while time.perf_counter() < end:
        page.update(1.0 / 60.0)
        count += 1
    return count / (time.process_time() - start)


def write(what: str, page: Live, cost: float) -> None:
    """A row of the table."""
    print(f"{what},{1e3 * cost:.2f},{updates(page):.0f},{memory():.0f}", flush=True)


def main() -> None:
    """Print the table."""
    system = to_system(load("cube_at_rest"))
    rehearse(system)
    access = Access()
    with listening(access, PORT) as server:
        page = Live(system, server, Path("session.toml"))
        page.is_running, page.waits = True, False
        print("after,push_cpu_ms,updates_per_cpu_s,memory_MiB")
        page.session.apply(PUSH)
        write("the first push", page, 0.0)
        costs = []
        for k in range(1, PUSHES + 1):
            page.session.advance(page.session.time + 0.05)
            start = time.process_time()
            page.session.apply(PUSH)
            costs.append(time.process_time() - start)
            page.clock = page.session.time
            page.update(1.0 / 60.0)
            if k % max(PUSHES // PARTS, 1) == 0:
                write(f"{k} pushes", page, sum(costs[-10:]) / len(costs[-10:]))
        url = access.addresses()[0].replace("http", "ws", 1)
        for k in range(1, BROWSERS + 1):
            protocol = [f"viser-v{viser.__version__}"]
            with connect(url, subprotocols=protocol, max_size=None) as client:
                client.send(msgspec.msgpack.encode(CAMERA))
                page.update(1.0 / 60.0)
            if k % max(BROWSERS // PARTS, 1) == 0:
                write(f"{k} browsers", page, 0.0)


if __name__ == "__main__":
    main()
