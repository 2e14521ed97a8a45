"""Break trajectory files at random and read them: a value or one clear error, every time.

    python tests/fuzz/fuzz_files.py --runs 20000 --jobs 2

Number k always gives the same broken file: `--only K -o FILE` writes it. Forks with limits of
memory and CPU time do what the commands do, so that a crash or a hang of HDF5 is seen too: exit
codes are 0, 1, 2, 3 or 130, and no exception gets out. What escapes is printed with its number.
Files lie in memory (/dev/shm) where there is one.
"""

import argparse
import contextlib
import io
import os
import random
import resource
import select
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

os.environ["NUMBA_DISABLE_JIT"] = "1"  # nothing here is worth compiling

SECONDS_FOR_ONE = 100.0  # of CPU time, for one command
SECONDS_OF_SILENCE = 3600.0  # of a child that waits for something, on a busy machine
MEMORY = 4 * 2**30
BODY = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0}
FREE = {
    "run": {"t_end": 0.3, "every": 0.1},
    "body": [
        {"name": "a", "angular_velocity": [1.0, 0.4, -0.7], **BODY},
        {"name": "b", "position": [1, 0, 0], **BODY},
    ],
}
BALL = {"name": "a", "shape": {"type": "sphere", "radius": 0.1}, "mass": 2.0, "count": 2}
TOUCHING = {
    "run": {"t_end": 0.3, "every": 0.1, "dt": 0.02},
    "body": [BALL | {"place": {"type": "grid", "spacing": 0.19, "origin": [0, 0, 0.09]}}],
    "contact": {"stiffness": 1e3, "restitution": 0.5, "friction": 0.5, "overlap": 0.5},
    "wall": [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}],
    "output": {"fields": ["position", "orientation", "contacts", "contact_number", "wall_force"]},
}
CASES = (FREE, TOUCHING)
LATER = "0.4"  # end of the runs that go on
CODES = (0, 1, 2, 3, 130)
WAYS = 4  # of `exercises`, of which each file sees one


def seed_files(folder: Path) -> list[bytes]:
    """Bytes of sound files."""
    import particlerb
    from particlerb.record import provenance, schema

    schema.FEWEST_IN_CHUNK = 4  # small chunks: few bytes that mean nothing
    provenance.git_revision = lambda: ""  # the same bytes in every checkout
    for k, case in enumerate(CASES):
        particlerb.run(case, folder / f"seed{k}.h5").close()
    return [(folder / f"seed{k}.h5").read_bytes() for k in range(len(CASES))]


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


def looked_at(path: Path) -> int:
    """Read what Python programs and the page of `view` read."""
    import particlerb
    from particlerb.record.trajectory import TrajectoryError
    from particlerb.view.replay import ReplayError, system_of

    with contextlib.suppress(TrajectoryError), particlerb.open(path) as trajectory:
        reads = [
            lambda: trajectory.particle_positions(-1) if trajectory.n_frames else None,
            lambda: trajectory.angular_velocity,
            lambda: trajectory.ledger,
            lambda: trajectory.contacts(0) if trajectory.n_frames else None,
            lambda: trajectory.wall_force,
            lambda: system_of(trajectory),
        ]
        for read in reads:
            with contextlib.suppress(TrajectoryError, ReplayError, KeyError, IndexError):
                read()
    return 0


def exercises(path: Path) -> dict[str, Callable[[], int]]:
    """What can be done with a file; each returns an exit code."""
    from particlerb.cli import main as command

    name, other = str(path), str(path.with_name("out.csv"))
    return {
        "info": lambda: command(["info", name, "--verify"]),
        "export": lambda: command(["export", name, "--to", "csv", "-o", other, "--overwrite"]),
        "open": lambda: looked_at(path),
        "resume": lambda: command(["resume", name, "-q", "--t-end", LATER]),
    }


def work(numbers: Sequence[int], seeds: Sequence[bytes], folder: Path, pipe: int) -> None:
    """Try some broken files; say which, and what comes of it."""
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silent, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    path = folder / f"broken{os.getpid()}.h5"
    for k in numbers:
        path.write_bytes(broken(seeds[k % len(seeds)], k))
        name, exercise = list(exercises(path).items())[k // len(seeds) % WAYS]
        os.write(pipe, f"{k} {name}\n".encode())
        signal.setitimer(signal.ITIMER_PROF, SECONDS_FOR_ONE)  # ends this process
        try:
            code = exercise()
            said = "" if code in CODES else f"exit code {code}"
        except BaseException as error:
            said = f"{type(error).__name__} {' '.join(str(error).split())[:150]}"
        if said:
            os.write(pipe, f"{k} {name} escape {said}\n".encode())
    os.write(pipe, b"done\n")


class Worker:
    """A fork that tries files, and another one where it has crashed or hangs."""

    def __init__(self, numbers: Sequence[int], seeds: Sequence[bytes], folder: Path) -> None:
        self.numbers, self.seeds, self.folder = numbers, seeds, folder
        self.found: list[str] = []  # escapes
        self.crashes = 0  # of HDF5, in commands that have a process of their own
        self.is_done = False
        self.fork()

    def fork(self) -> None:
        """Begin with the numbers that are left."""
        self.pipe, theirs = os.pipe()
        self.child = os.fork()
        if not self.child:
            with contextlib.suppress(BaseException):
                work(self.numbers, self.seeds, self.folder, theirs)
            os._exit(0)
        os.close(theirs)
        self.rest, self.at = b"", (self.numbers[0], "start")
        self.heard = time.monotonic()

    def fileno(self) -> int:
        """Where it says what it does."""
        return self.pipe

    def listen(self) -> None:
        """Take what the child says, or take leave of it."""
        said = os.read(self.pipe, 65536)
        self.heard = time.monotonic()
        *lines, self.rest = (self.rest + said).split(b"\n")
        for line in lines:
            words = line.decode().split(" ", 3)
            if words == ["done"]:
                self.numbers = ()
                continue
            self.at = int(words[0]), words[1]
            if words[2:]:
                self.note(words[3])
        if not said:
            self.bury("")

    def note(self, what: str) -> None:
        """Note and print an escape."""
        self.found.append(f"{self.at[0]} {self.at[1]}: {what}")
        print(self.found[-1], flush=True)

    def bury(self, what: str) -> None:
        """Go on behind a file that has ended the child."""
        from particlerb.cli.guard import GUARDED

        os.close(self.pipe)
        code = os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])
        if self.numbers:
            if code == -signal.SIGPROF:
                self.note("hang")
            elif what == "" and self.at[1] in GUARDED and code < 0:
                self.crashes += 1  # the guard makes it exit code 1
            else:
                self.note(what or f"crash {code}")
            self.numbers = [k for k in self.numbers if k > self.at[0]]
        if self.numbers:
            self.fork()
        else:
            self.is_done = True

    def end_hang(self) -> None:
        """Kill a child that waits for ever."""
        if time.monotonic() - self.heard > SECONDS_OF_SILENCE:
            os.kill(self.child, signal.SIGKILL)
            self.bury("hang")


def run(numbers: range, jobs: int, folder: Path) -> tuple[list[str], int]:
    """All escapes of some numbers, and how often HDF5 has crashed in a guarded command."""
    import warnings

    from particlerb.record import checked_reading as checked

    checked.SECONDS_OF_PATIENCE = 0.0
    warnings.simplefilter("ignore")
    seeds = seed_files(folder)
    sound = folder / "sound.h5"
    for seed in seeds:  # loads what forks would load again
        sound.write_bytes(seed)
        with contextlib.redirect_stdout(io.StringIO()):
            assert all(exercise() == 0 for exercise in exercises(sound).values())
    workers = [Worker(numbers[k::jobs], seeds, folder) for k in range(jobs)]
    everyone = list(workers)
    while workers:
        for worker in select.select(workers, [], [], 1.0)[0]:
            worker.listen()
        workers = [worker for worker in workers if not worker.is_done]
        for worker in workers:
            worker.end_hang()
    return [one for w in everyone for one in w.found], sum(w.crashes for w in everyone)


def main() -> None:
    """Fuzz, or write one broken file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", type=int, help="write this broken file, and no more")
    parser.add_argument("-o", "--output", type=Path, default=Path("broken.h5"))
    options = parser.parse_args()
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        if options.only is not None:
            seeds = seed_files(Path(name))
            options.output.write_bytes(broken(seeds[options.only % len(seeds)], options.only))
            return
        start = time.monotonic()
        numbers = range(options.first, options.first + options.runs)
        escapes, crashes = run(numbers, options.jobs, Path(name))
        rate = options.runs / (time.monotonic() - start)
        print(
            f"{options.runs} files, {rate:.1f} a second, {len(escapes)} escapes;"
            f" {crashes} crashes of HDF5 that become exit code 1"
        )


if __name__ == "__main__":
    main()
