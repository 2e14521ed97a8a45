"""Break trajectory files at random and read them: a value or one clear error, every time.

    python tests/fuzz/fuzz_files.py --runs 100000 --first 0

Number k always gives the same broken file: `--only K -o FILE` writes it. A worker process does the
reading, so that a crash or a hang of HDF5 is seen too; each escape is printed with its number.
Files lie in memory (/dev/shm) where there is one.
"""

import argparse
import contextlib
import os
import random
import resource
import selectors
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # nothing here is worth compiling

SECONDS_FOR_ONE = 30.0
SECONDS_TO_START = 600.0  # of a worker, on a machine that has other work
MEMORY = 4 * 2**30
BODY = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0}
CASE = {
    "run": {"t_end": 0.3, "every": 0.1},
    "body": [
        {"name": "a", "angular_velocity": [1.0, 0.4, -0.7], **BODY},
        {"name": "b", "position": [1, 0, 0], **BODY},
    ],
}


def seed_file(path: Path) -> bytes:
    """Bytes of a sound file."""
    import particlerb
    from particlerb.record import provenance, schema

    schema.FEWEST_IN_CHUNK = 4  # small chunks: few bytes that mean nothing
    provenance.git_revision = lambda: ""  # the same bytes in every checkout
    particlerb.run(CASE, path, overwrite=True).close()
    return path.read_bytes()


@cache
def telling(seed: bytes) -> list[int]:
    """Places of the bytes that are not zero."""
    return [i for i, byte in enumerate(seed) if byte]


def broken(seed: bytes, k: int) -> bytes:
    """The k-th broken file: some bits turned, blocks zeroed, moved or made extreme, or cut off."""
    dice = random.Random(k)
    data = bytearray(seed)
    told = telling(seed)
    for _ in range(dice.choice((1, 1, 1, 2, 3, 8, 40))):
        at = dice.choice(told) if dice.random() < 0.8 else dice.randrange(len(data))
        at = min(at, len(data) - 1)
        match dice.randrange(8):
            case 0 | 1 | 2:
                data[at] ^= 1 << dice.randrange(8)
            case 3:
                data[at] = dice.choice((0, 1, 2, 0x7F, 0x80, 0xFE, 0xFF))
            case 4:
                size = dice.choice((2, 4, 8))
                value = dice.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1, len(data)))
                at -= at % size
                data[at : at + size] = (value % 2 ** (8 * size)).to_bytes(size, "little")
            case 5:
                size = dice.choice((8, 64, 512))
                data[at : at + size] = bytes(len(data[at : at + size]))
            case 6:
                size, other = dice.choice((8, 64, 512)), dice.randrange(len(data))
                data[at : at + size] = data[other : other + size]
            case 7:
                if dice.random() < 0.1:
                    del data[dice.randrange(1, len(data)) :]
    return bytes(data)


def exercise(path: Path) -> None:
    """Read everything that the commands read; errors of the right kind are what is wanted."""
    from particlerb.cli.show import facts_of, findings_text, texts_of
    from particlerb.trajectory import TrajectoryError, open_trajectory
    from particlerb.verification import verify

    with contextlib.suppress(TrajectoryError), open_trajectory(path) as trajectory:
        reads = [
            lambda: facts_of(trajectory),
            lambda: texts_of(trajectory),
            lambda: findings_text(verify(trajectory)),
            lambda: trajectory.particle_positions(-1) if trajectory.n_frames else None,
            lambda: trajectory.angular_velocity,
            lambda: trajectory.ledger,
            lambda: trajectory.omega_body(0),
        ]
        for read in reads:
            with contextlib.suppress(TrajectoryError, KeyError):
                read()


def work(first: int, stop: int, folder: Path) -> None:
    """Worker: say each number, then try it."""
    import warnings

    from particlerb.record import checked

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    checked.SECONDS_OF_PATIENCE = 0.0
    warnings.simplefilter("ignore")
    seed, path = seed_file(folder / "seed.h5"), folder / "broken.h5"
    for k in range(first, stop):
        path.write_bytes(broken(seed, k))
        print(k, flush=True)
        try:
            exercise(path)
        except Exception as error:
            print("escape", type(error).__name__, " ".join(str(error).split())[:150], flush=True)


def run(first: int, stop: int, folder: Path) -> list[tuple[int, str]]:
    """All escapes of some numbers."""
    escapes: list[tuple[int, str]] = []
    while first < stop:
        words = [sys.executable, __file__, "--worker", str(first), str(stop), str(folder)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as worker:
            assert worker.stdout is not None
            watch = selectors.DefaultSelector()
            watch.register(worker.stdout, selectors.EVENT_READ)
            patience = SECONDS_TO_START
            while True:
                if not watch.select(patience):
                    worker.kill()
                    escapes.append((first - 1, "hang"))
                    print(first - 1, "hang", flush=True)
                    break
                patience = SECONDS_FOR_ONE
                line = worker.stdout.readline()
                if not line:
                    break
                if line.startswith("escape"):
                    escapes.append((first - 1, line.strip()))
                    print(first - 1, line.strip(), flush=True)
                else:
                    first = int(line) + 1
            code = worker.wait()
        if code and not (escapes and escapes[-1] == (first - 1, "hang")):
            escapes.append((first - 1, f"crash {code}"))
            print(first - 1, f"crash {code}", flush=True)
            if code > 0 and first == 0:
                raise SystemExit("the worker does not start")
    return escapes


def main() -> None:
    """Fuzz, or write one broken file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, help="write this broken file, and read it here")
    parser.add_argument("-o", "--output", type=Path, default=Path("broken.h5"))
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        work(int(options.worker[0]), int(options.worker[1]), Path(options.worker[2]))
        return
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        folder = Path(name)
        if options.only is not None:
            options.output.write_bytes(broken(seed_file(folder / "seed.h5"), options.only))
            exercise(options.output)
            return
        start = time.monotonic()
        escapes = run(options.first, options.first + options.runs, folder)
        rate = options.runs / (time.monotonic() - start)
        print(f"{options.runs} files, {rate:.0f} a second, {len(escapes)} escapes")


if __name__ == "__main__":
    main()
