"""What a kill, a power cut or a failing disk leaves of a run, at any of its file operations.

A process with `shim.c` preloaded runs commands of particlerb; each run is a fork of it, so that
nothing is imported or compiled twice, and ends like any other process:

    with Session(build(scratch)) as session:
        session.warm(["run", "a.toml", "-o", "warm/a.h5", "-q"])
        done = session.run(["run", "a.toml", "-o", "watched/a.h5", "-q"], watched)
        disk = Disk()
        for operation in done.operations:
            disk.apply(operation)
            place(disk.killed(), elsewhere)                   # what a kill leaves here
            place(disk.power_cut(random.Random(7)), elsewhere)  # what a power cut may leave
        session.run(argv, watched, Fault(k, errno.EIO, "always"))  # operation k fails
        said = in_child(lambda: look_at_the_file(elsewhere))  # a crash of HDF5 is a text

A power cut keeps what was fsynced: of a file its bytes, of a folder its names. Of each page that
was written since, any version may be there, of the size any; of the changes of names any that do
not need one that is missing. A new file has no name before its folder was fsynced.
"""

import contextlib
import ctypes
import importlib
import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Self

from particlerb.cli import guard

OPEN, WRITE, TRUNCATE, ALLOCATE, RENAME, UNLINK, SYNC, LINK, MARK = range(1, 10)
NAMES = ("", "open", "write", "truncate", "allocate", "rename", "unlink", "sync", "link")
HOWS = ("once", "always", "short", "full")
HEAD = struct.Struct("<IIqqiIII")
PAGE = 4096
SECONDS = 900.0  # for one run, or one look at a state, on a busy machine
OFTEN = {  # a commit with a checkpoint behind every three frames
    "particlerb.simulation.frame_times.BATCH_FRAMES": 3,
    "particlerb.simulation.frame_times.BATCH_SECONDS": 1e9,
    "particlerb.record.writer.SECONDS_BETWEEN_COMMITS": -1.0,
    "particlerb.record.writer.SHARE_OF_CHECKPOINTS": 1e9,
    "particlerb.stepping.sparse_contact.LEAST_BODIES": 10,
}


class Operation(NamedTuple):
    """One call that changed a file or a name, or that was to."""

    kind: int
    path: str  # from the watched folder; "." is the folder
    other: str  # new name
    flags: int  # of open
    offset: int
    size: int  # that was asked for
    error: int  # errno; 0: it was done
    data: bytes  # that was written

    def __str__(self) -> str:
        words = f"{NAMES[self.kind]} {self.path} {self.other}".rstrip()
        if self.kind in (WRITE, TRUNCATE, ALLOCATE):
            words += f" {self.offset}+{self.size}"
        return words + (f" [{os.strerror(self.error)}]" if self.error else "")


class Fault(NamedTuple):
    """Operation `at` fails: once, always from there on; or writes half (and then fails: full)."""

    at: int
    error: int
    how: str


class Done(NamedTuple):
    """A run that has ended."""

    code: int  # exit code; negative: the signal
    out: str
    err: str
    operations: list[Operation]
    promised: list[int]  # frames, when so many operations were done as is the index


def build(folder: Path) -> Path:
    """Compile the shim into a folder; fails where there is no C compiler."""
    target = folder / "shim.so"
    source = Path(__file__).with_name("shim.c")
    words = [os.environ.get("CC", "cc"), "-shared", "-fPIC", "-O2", "-o", target, source, "-ldl"]
    subprocess.run(words, check=True)
    return target


def read_log(log: Path, folder: Path) -> tuple[list[Operation], list[int]]:
    """Operations of a log, with names from the watched folder; and frames promised at each."""
    data, at, found, promised = log.read_bytes(), 0, [], [0]
    top = os.path.realpath(folder)
    while at < len(data):
        kind, flags, offset, size, error, *lengths = HEAD.unpack_from(data, at)
        at += HEAD.size
        parts = []
        for n in lengths:
            parts.append(data[at : at + n])
            at += n
        if kind == MARK:
            promised[-1] = size
            continue
        path, other = (os.path.relpath(os.fsdecode(p), top) if p else "" for p in parts[:2])
        found.append(Operation(kind, path, other, flags, offset, size, error, parts[2]))
        promised.append(promised[-1])
    return found, promised


# States


class File:
    """Bytes of a file, those that are on the disk for certain, and what was done since."""

    def __init__(self, data: bytes = b"") -> None:
        self.now = bytearray(data)
        self.safe = data
        self.since: list[tuple[int, bytes, int]] = []  # offset, bytes, size behind it

    def change(self, offset: int, data: bytes, size: int) -> None:
        """Write bytes; the file has a size then."""
        self.since.append((offset, data, size))
        self.now[:] = resized(self.now, max(size, offset + len(data)))
        self.now[offset : offset + len(data)] = data
        del self.now[size:]

    def sync(self) -> None:
        """Bring it to the disk."""
        self.safe, self.since = bytes(self.now), []

    def torn(self, dice: random.Random, share: float) -> bytes:
        """What a power cut may leave, with a share of the pages brought to the disk."""
        n = len(self.since)
        longest = max([len(self.safe), *(size for _, _, size in self.since)])
        sizes = [len(self.safe), *(size for _, _, size in self.since)]
        until: dict[int, int] = {}  # of each page: how many changes it has seen
        found = bytearray(resized(self.safe, longest))
        before = len(self.safe)
        for k, (offset, data, size) in enumerate(self.since):
            parts = [(offset, data)] if data else []
            if size < before:  # what is cut off reads as zeros later
                parts.append((size, bytes(before - size)))
            before = size
            for start, part in parts:
                at = start
                while at < start + len(part):
                    page = at // PAGE
                    stop = min((page + 1) * PAGE, start + len(part))
                    if page not in until:
                        until[page] = n if dice.random() < share else dice.randint(0, n)
                    if k < until[page]:
                        found[at:stop] = part[at - start : stop - start]
                    at = stop
        size = sizes[-1] if dice.random() < share else dice.choice(sizes)
        return bytes(found[:size])


def resized(data: bytes | bytearray, size: int) -> bytes | bytearray:
    """Bytes with zeros behind them, at least so many."""
    return data + bytes(size - len(data)) if size > len(data) else data


class Disk:
    """Files under one folder, as operations change them.

    Parameters
    ----------
    state : mapping
        Files that are on the disk before, and their bytes.
    """

    def __init__(self, state: Mapping[str, bytes] = MappingProxyType({})) -> None:
        self.files = {name: File(data) for name, data in state.items()}
        self.safe = dict(self.files)  # names that are on the disk for certain
        self.since: list[dict[str, File | None]] = []  # changes of names, each of them one thing

    def apply(self, one: Operation) -> None:
        """Do what was done."""
        if one.error:
            return
        if one.kind == OPEN:
            if one.path not in self.files:
                self.rename({one.path: File()})
            if one.flags & os.O_TRUNC and self.files[one.path].now:
                self.files[one.path].change(0, b"", 0)
        elif one.kind == RENAME:
            self.rename({one.path: None, one.other: self.files[one.path]})
        elif one.kind == LINK:
            self.rename({one.other: self.files[one.path]})
        elif one.kind == UNLINK:
            self.rename({one.path: None})
        elif one.kind == SYNC and one.path == ".":
            self.safe, self.since = dict(self.files), []
        elif one.path in self.files:  # it may have lost its name
            file = self.files[one.path]
            size = len(file.now)
            if one.kind == SYNC:
                file.sync()
            elif one.kind == WRITE:
                file.change(one.offset, one.data, max(size, one.offset + len(one.data)))
            elif one.kind == TRUNCATE:
                file.change(0, b"", one.size)
            elif one.kind == ALLOCATE:
                file.change(0, b"", max(size, one.offset + one.size))

    def rename(self, change: dict[str, File | None]) -> None:
        """Change names, all or none."""
        self.since.append(change)
        for name, file in change.items():
            self.files.pop(name, None)
            if file is not None:
                self.files[name] = file

    def killed(self) -> dict[str, bytes]:
        """Files that a kill leaves: all that was done."""
        return {name: bytes(file.now) for name, file in self.files.items()}

    def power_cut(self, dice: random.Random) -> dict[str, bytes]:
        """Files that a power cut may leave."""
        share = dice.choice((0.0, 0.3, 0.6, 0.9, 1.0))
        names, lost = dict(self.safe), set()
        is_kept = dice.random() < 0.5
        for change in self.since:
            involved = {*change, *(id(file) for file in change.values() if file)}
            involved |= {id(names[name]) for name in change if name in names}
            if involved & lost or not (is_kept or dice.random() < share):
                lost |= involved
                continue
            for name, file in change.items():
                names.pop(name, None)
                if file is not None:
                    names[name] = file
        torn = {id(file): file.torn(dice, share) for file in names.values()}
        return {name: torn[id(file)] for name, file in names.items()}


def place(state: Mapping[str, bytes], folder: Path) -> None:
    """Make a folder hold these files and no others."""
    if folder.exists():
        shutil.rmtree(folder)
    folder.mkdir()
    for name, data in state.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with (folder / name).open("wb") as file:
            file.write(data.rstrip(b"\0"))
            file.truncate(len(data))


def in_folder(folder: Path) -> dict[str, bytes]:
    """Files under a folder."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def in_child(work: Callable[[], object], seconds: float = SECONDS) -> str:
    """What a forked process that does this work says: "" where it returns, else what went wrong."""
    ours, theirs = os.pipe()
    child = os.fork()
    if not child:
        text = "left"
        try:
            os.close(ours)
            work()
            text = ""
        except BaseException as error:
            text = f"{type(error).__name__}: {error}"
            if isinstance(error, AssertionError) and not error.args:
                text = traceback.format_exc()
        finally:
            os.write(theirs, text.encode()[:60_000])
            os._exit(1 if text else 0)
    os.close(theirs)
    status = wait_for(child, seconds)
    with os.fdopen(ours, "rb") as pipe:
        text = pipe.read().decode()
    if os.WIFSIGNALED(status):
        return f"killed by {signal.Signals(os.WTERMSIG(status)).name}"
    return text


def wait_for(child: int, seconds: float) -> int:
    """Status of a child, which is killed when its time is up."""
    stop, pause = time.monotonic() + seconds, 1e-4
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status
        if time.monotonic() > stop:
            os.kill(child, signal.SIGKILL)
            return os.waitpid(child, 0)[1]
        time.sleep(pause)
        pause = min(2 * pause, 0.01)


# Runs


class Session:
    """A process with the shim preloaded, whose forks run commands of particlerb.

    Parameters
    ----------
    shim : Path
        From `build`.
    settings : mapping
        Values of module attributes, by dotted names.
    script : str
        What is run with `--serve`.
    """

    def __init__(
        self, shim: Path, settings: Mapping[str, Any] = OFTEN, script: str = __file__
    ) -> None:
        words = [sys.executable, script, "--serve", str(shim), json.dumps(dict(settings))]
        self.server = subprocess.Popen(
            words,
            env=os.environ | {"LD_PRELOAD": str(shim), guard.GUARD_MARK: "1"},  # one process
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.scratch = tempfile.TemporaryDirectory()

    def ask(self, **job: Any) -> dict[str, Any]:
        """Answer of the server."""
        assert self.server.stdin is not None
        assert self.server.stdout is not None
        self.server.stdin.write(json.dumps(job) + "\n")
        self.server.stdin.flush()
        return json.loads(self.server.stdout.readline())

    def warm(self, argv: Sequence[str], cwd: Path | None = None) -> None:
        """Run a command in the server itself: what it compiles and loads is there for all."""
        answer = self.ask(argv=list(argv), cwd=str(cwd or Path.cwd()), output=self.scratch.name)
        err = (Path(self.scratch.name) / "err").read_text()
        assert answer["code"] == 0, err

    def run(
        self,
        argv: Sequence[str],
        watched: Path,
        fault: Fault | None = None,
        cwd: Path | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> Done:
        """Run a command; what it does to the watched folder is noted, or made to fail."""
        log = Path(self.scratch.name) / "log"
        at, error, how = fault or Fault(-1, 0, "once")
        answer = self.ask(
            argv=list(argv),
            cwd=str(cwd or Path.cwd()),
            output=self.scratch.name,
            watch=[os.path.realpath(watched), str(log), at, error, HOWS.index(how)],
            settings=dict(settings or {}),
        )
        texts = [(Path(self.scratch.name) / name).read_text() for name in ("out", "err")]
        return Done(answer["code"], *texts, *read_log(log, watched))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        assert self.server.stdin is not None
        self.server.stdin.close()
        self.server.wait()
        if self.server.stdout is not None:
            self.server.stdout.close()
        self.scratch.cleanup()


def change(settings: Mapping[str, Any]) -> None:
    """Set attributes of modules."""
    for name, value in settings.items():
        module, _, attribute = name.rpartition(".")
        found = importlib.import_module(module)
        assert hasattr(found, attribute), name
        setattr(found, attribute, value)


@contextlib.contextmanager
def printing_to(folder: str) -> Iterator[None]:
    """Let stdout and stderr go to files."""
    sys.stdout.flush()
    kept = [os.dup(1), os.dup(2)]
    for number, name in ((1, "out"), (2, "err")):
        target = os.open(f"{folder}/{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(target, number)
        os.close(target)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, copy in zip((1, 2), kept, strict=True):
            os.dup2(copy, number)
            os.close(copy)


def serve(shim: str, settings: str) -> None:
    """Do jobs until there are no more; a fork returns, and ends as a process does."""
    from particlerb import cli
    from particlerb.record.writer import Recorder

    change(json.loads(settings))
    library = ctypes.CDLL(shim)
    commit = Recorder.commit

    def marked(recorder: Recorder) -> None:
        commit(recorder)
        library.mark(ctypes.c_long(recorder.n_frames))

    Recorder.commit = marked
    answers = os.fdopen(os.dup(1), "w")
    for line in iter(sys.stdin.readline, ""):
        job = json.loads(line)
        os.chdir(job["cwd"])
        sys.argv[1:] = job["argv"]
        if "watch" not in job:
            with printing_to(job["output"]):
                code = cli.main(job["argv"])
            answers.write(json.dumps({"code": code}) + "\n")
            answers.flush()
            continue
        child = os.fork()
        if not child:
            folder, log, at, error, how = job["watch"]
            change(job["settings"])
            printing = printing_to(job["output"])
            printing.__enter__()
            long = ctypes.c_long(at)
            library.watch(folder.encode(), log.encode(), long, error, how)
            cli.entry()
            return
        status = wait_for(child, SECONDS)
        code = os.waitstatus_to_exitcode(status)
        answers.write(json.dumps({"code": code}) + "\n")
        answers.flush()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        serve(*sys.argv[2:4])
