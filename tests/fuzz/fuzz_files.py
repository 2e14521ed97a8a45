"""Break files of runs at random and read them: a value or one clear error, every time.

    python tests/fuzz/fuzz_files.py --runs 20000 --jobs 2

Number k always gives the same broken file: `--only K -o FOLDER` writes it. Every second one has
other bytes, the others have objects that are harmed by HDF5's own calls (`harmed_objects.py`);
kinds of run take turns. Forks with limits of memory and CPU time do what the commands do, so that a
crash or a hang of HDF5 is seen too: exit codes are 0, 1, 2, 3 or 130, and no exception gets out.
What escapes is printed with its number. Files lie in memory (/dev/shm) where there is one.
"""

import argparse
import contextlib
import io
import os
import random
import resource
import select
import shutil
import signal
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from unittest.mock import MagicMock

os.environ["NUMBA_DISABLE_JIT"] = "1"  # nothing here is worth compiling

from harmed_objects import harm

SECONDS_FOR_ONE = 100.0  # of CPU time, for one command
SECONDS_OF_SILENCE = 3600.0  # of a child that waits for something, on a busy machine
MEMORY = 4 * 2**30
BODY = {"shape": {"type": "moments", "inertia": [1.0, 2.0, 2.5]}, "mass": 2.0}
RUN = {"t_end": 0.3, "every": 0.1, "threads": 1}
DOWN = {"acceleration": [0.0, 0.0, -9.81]}
FLOOR = [{"type": "plane", "name": "floor", "normal": [0, 0, 1]}]
FREE = {
    "run": RUN,
    "body": [
        {"name": "a", "angular_velocity": [1.0, 0.4, -0.7], **BODY},
        {"name": "b", "position": [1, 0, 0], **BODY},
    ],
}
BALL = {"name": "a", "shape": {"type": "sphere", "radius": 0.1}, "mass": 2.0, "count": 2}
STATE = ["position", "orientation", "linear_momentum", "angular_momentum"]
TOUCHING = {
    "run": RUN | {"dt": 0.02},
    "body": [BALL | {"place": {"type": "grid", "spacing": 0.19, "origin": [0, 0, 0.09]}}],
    "contact": {"stiffness": 1e3, "restitution": 0.5, "friction": 0.5, "overlap": 0.5},
    "wall": FLOOR,
    "output": {"fields": [*STATE, "contacts", "contact_number", "wall_force"]},
}
FALLING = {
    "run": RUN | {"dt": 0.02},
    "gravity": DOWN,
    "body": [BALL | {"place": {"type": "grid", "spacing": 0.25, "origin": [0, 0, 0.11]}}],
    "wall": FLOOR,
}
HINGE = {"type": "hinge", "axis": [0, 1, 0]}
CASES = {
    "free": FREE,
    "contact": TOUCHING,
    "joints": {
        "run": RUN | {"dt": 0.02},
        "gravity": DOWN,
        "body": [BODY | {"name": name, "position": [x, 0, 0]} for name, x in (("a", 1), ("b", 3))],
        "joint": [
            HINGE | {"body": "a", "at": [0, 0, 0], "breaks_at": {"force": 1e9}},
            HINGE | {"body": "b", "to": "a", "at": [2, 0, 0]},
        ],
        "output": {"fields": [*STATE, "joint_force", "joint_coordinate", "joint_break_time"]},
    },
    "impulses": FALLING | {
        "contact": {"law": "impulse", "restitution": 0.5, "friction": 0.5},
        "output": {"fields": [*STATE, "contacts", "impulse_residual", "push_out_work"]},
    },
    "events": FALLING | {
        "run": RUN,
        "contact": {"law": "events", "restitution": 0.9, "friction": 0.2},
        "output": {"fields": [*STATE, "impacts", "smallest_gap"]},
    },
    "parts": {
        "run": RUN | {"dt": 0.1},
        "body": [BODY | {"name": "a", "count": 257, "place": {"type": "grid", "spacing": 1.0}}],
        "force": [{"type": "push", "body": "a[256]", "force": [0.0, 1.0, 0.0]}],
        "output": {"fields": [*STATE, "velocity"]},
    },
}  # fmt: skip
"""Of each kind of run; that in parts has 256 bodies in the first."""
NAME = "a.h5"
TRACE = bool(os.environ.get("TRACE"))
LATER = "0.4"  # end of the runs that go on
CODES = (0, 1, 2, 3, 130)
UNGUARDED = ("open", "replace")  # in the process of the user
WAYS = 10  # of `exercises`, of which each file sees one
Files = Mapping[str, bytes]  # of a run, by their names from its folder


def seed_files(folder: Path) -> list[Files]:
    """Sound files of each kind of run."""
    import tomlkit

    from particlerb.cli import main as command
    from particlerb.cli import ranks
    from particlerb.model import superblocks
    from particlerb.ranks import Ranks
    from particlerb.record import provenance, schema

    schema.FEWEST_IN_CHUNK = 4  # small chunks: few bytes that mean nothing
    provenance.git_revision = lambda: ""  # the same bytes in every checkout
    superblocks.SUPERBLOCK = 256
    ranks.ranks_of_mpi = Ranks  # one rank, without MPI
    here, found = Path.cwd(), []
    for kind, case in CASES.items():
        (folder / kind).mkdir()
        os.chdir(folder / kind)
        Path("a.toml").write_text(tomlkit.dumps(case))
        assert command(["run", "a.toml", "-q", "-o", NAME, *["--mpi"] * (kind == "parts")]) == 0
        os.remove("a.toml")
        files = (path for path in Path().rglob("*.h5"))
        found.append({str(path): path.read_bytes() for path in sorted(files)})
    os.chdir(here)
    return found


def place(files: Files, folder: Path) -> None:
    """Write the files of a run into a folder where nothing else is."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def break_files(seeds: Sequence[Files], k: int, folder: Path) -> str:
    """Write the k-th broken run; say how objects were harmed."""
    dice = random.Random(k)
    files = seeds[k // 2 % len(seeds)]
    place(files, folder)
    name = dice.choice((NAME, *files))
    if k % 2:
        return f"{name}: {harm(folder / name, dice)}"
    (folder / name).write_bytes(broken(files[name], k))
    return name


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
    """Read what Python programs read."""
    import particlerb
    from particlerb.record.trajectory import TrajectoryError

    with contextlib.suppress(TrajectoryError), particlerb.open(path) as trajectory:
        reads = [
            lambda: trajectory.particle_positions(-1) if trajectory.n_frames else None,
            lambda: trajectory.angular_velocity,
            lambda: trajectory.ledger,
            lambda: trajectory.contacts(0) if trajectory.n_frames else None,
            lambda: trajectory.wall_force,
            lambda: trajectory.joint_coordinate,
            lambda: trajectory.case,
            lambda: repr(trajectory),
            trajectory.to_xarray,
            trajectory.momentum_sizes,
        ]
        for read in reads:
            with contextlib.suppress(TrajectoryError, KeyError):
                read()
    return 0


def played(path: Path) -> int:
    """Do what the page of `view` does, without a browser."""
    from particlerb.cli.exit_codes import Ending
    from particlerb.cli.guard import probe
    from particlerb.record.trajectory import TrajectoryError, open_trajectory
    from particlerb.view.replay import Replay, ReplayError

    with contextlib.suppress(TrajectoryError, ReplayError, Ending):
        probe(path)
        with open_trajectory(path) as trajectory:
            replay = Replay(trajectory, MagicMock(), path)
            for by in ("body", "speed", "energy"):
                replay.coloured.value = by
                for k in range(len(replay.times)):
                    replay.look_at_frame(k)
                    replay.stage.show(replay.state[0], replay.state[1], None)
                replay.write()
    return 0


def replaced(path: Path) -> int:
    """Put another run in the place of a file, and of its parts."""
    import particlerb

    particlerb.run(FREE, path, overwrite=True).close()
    return 0


def exercises(path: Path) -> dict[str, Callable[[], int]]:
    """What can be done with a file; each returns an exit code."""
    from particlerb.cli import main as command

    name = str(path)
    is_master = any(path.parent.glob("*.parts"))

    def export(form: str, *more: str) -> Callable[[], int]:
        words = ["export", name, "--to", form, "-o", str(path.with_name("out")), "--overwrite"]
        return lambda: command([*words, *more])

    resume = ["resume", name, "-q", "--t-end", LATER, *["--mpi"] * is_master]
    picture = ["plot", name, "-o", str(path.with_name("a.png")), "--overwrite"]
    forms = ("csv", "particles", "lammps", "npz", "contacts", "gsd")
    return {
        "info": lambda: command(["info", name]),
        "verify": lambda: command(["info", name, "--verify", "--json"]),
        "export": lambda: max(export(form)() for form in forms),
        "merge": export("h5"),
        "open": lambda: looked_at(path),
        "view": lambda: played(path),
        "plot": lambda: command(picture),
        "chains": lambda: command([*picture, "--contacts"]),
        "resume": lambda: command(resume),
        "replace": lambda: replaced(path),
    }


def work(numbers: Sequence[int], seeds: Sequence[Files], folder: Path, pipe: int) -> None:
    """Try some broken files; say which, and what comes of it."""
    silent = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(silent, stream)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    here = folder / f"broken{os.getpid()}"
    for k in numbers:
        os.write(pipe, f"{k} breaking\n".encode())
        how = break_files(seeds, k, here)
        name, exercise = list(exercises(here / NAME).items())[k // 2 // len(seeds) % WAYS]
        os.write(pipe, f"{k} {name}\n".encode())
        signal.setitimer(signal.ITIMER_PROF, SECONDS_FOR_ONE)  # ends this process
        try:
            code = exercise()
            said = "" if code in CODES else f"exit code {code}"
        except BaseException as error:
            said = f"{type(error).__name__} {' '.join(str(error).split())[:150]}; {how}"
            if TRACE:
                said += "".join(traceback.format_tb(error.__traceback__)[-4:]).replace("\n", " ")
        if said:
            os.write(pipe, f"{k} {name} escape {said}\n".encode())
    os.write(pipe, b"done\n")


class Worker:
    """A fork that tries files, and another one where it has crashed or hangs."""

    def __init__(self, numbers: Sequence[int], seeds: Sequence[Files], folder: Path) -> None:
        self.numbers, self.seeds, self.folder = numbers, seeds, folder
        self.found: list[str] = []  # escapes
        self.crashes = 0  # of HDF5, in commands that have a process of their own
        self.tried = 0
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
            elif words[1] == "breaking":
                self.tried += 1
                if self.tried % 500 == 0:
                    print(f"{self.at[0]} is the {self.tried}th", flush=True)
        if not said:
            self.bury("")

    def note(self, what: str) -> None:
        """Note and print an escape."""
        self.found.append(f"{self.at[0]} {self.at[1]}: {what}")
        print(self.found[-1], flush=True)

    def bury(self, what: str) -> None:
        """Go on behind a file that has ended the child."""
        os.close(self.pipe)
        code = os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1])
        if self.numbers:
            if code == -signal.SIGPROF:
                self.note("hang")
            elif what == "" and self.at[1] not in UNGUARDED and code < 0:
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
    for seed in seeds:  # loads what forks would load again
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            for name, exercise in exercises(folder / "sound" / NAME).items():
                place(seed, folder / "sound")
                lacks = name in ("export", "chains")  # what not every kind records
                assert exercise() in ((0, 2) if lacks else (0,)), (name, list(seed))
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
    parser.add_argument("--objects", action="store_true", help="odd numbers alone")
    parser.add_argument("--only", type=int, help="write this broken run, and no more")
    parser.add_argument("-o", "--output", type=Path, default=Path("broken"))
    options = parser.parse_args()
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        if options.only is not None:
            print(break_files(seed_files(Path(name)), options.only, options.output))
            return
        start = time.monotonic()
        step = 2 if options.objects else 1
        first = options.first | 1 if options.objects else options.first
        numbers = range(first, first + step * options.runs, step)
        escapes, crashes = run(numbers, options.jobs, Path(name))
        rate = options.runs / (time.monotonic() - start)
        print(
            f"{options.runs} files, {rate:.1f} a second, {len(escapes)} escapes;"
            f" {crashes} crashes of HDF5 that become exit code 1"
        )


if __name__ == "__main__":
    main()
