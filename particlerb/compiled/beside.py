"""Functions compiled beside: by a copy of this process, while this one compiles others.

Numba compiles one function after the other. Of some it is known for what they will be compiled long
before they are reached: a copy of the process does these, and what it makes comes back by the disk.
Who reaches one of them waits until it is there; if the copy ends without it, it is compiled here.
What a loop calls is shared: the process and a copy each take the next that nobody has begun.
Nothing is done so where a copy is no use or no good: on one core, beside other threads, in a
process of a sweep or of MPI, or where there is code on disk already.

Why it is so: docs/decisions/0029.
"""

import contextlib
import logging
import os
import select
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from multiprocessing import parent_process
from typing import Any, Final, TypeAlias

import numba

from particlerb.compiled.threads import POOL, THREADS

config: Any = numba.config
Job: TypeAlias = tuple[Any, Callable[[], object]]  # a function, and a call that compiles it

_LONGEST: Final = 120.0  # [s] for one job: the copy hangs
_MIN_SHARED: Final = 3  # jobs that are worth a copy
_FILES: Final = 1024  # of which a copy has no need
_THREADS: Final = ("MainThread", POOL, "tqdm_monitor")  # which hold no lock that a copy needs
_COPIES: Final[dict[int, tuple["_Copy", int]]] = {}  # by the id of a function; count of its job
_AFTERWARDS: Final[dict[int, Job]] = {}  # by the id of a function


class _Copy:
    """A copy of this process, which says by a byte that it has done a job."""

    def __init__(self, child: int, words: int, jobs: int) -> None:
        self.child, self.words, self.jobs, self.done = child, words, jobs, 0

    def wait_for(self, count: int) -> None:
        """Wait until so many jobs are done, or the copy has ended."""
        while self.done < count:
            if not select.select([self.words], [], [], _LONGEST)[0]:
                os.kill(self.child, signal.SIGKILL)
            said = os.read(self.words, self.jobs)
            self.done = self.done + len(said) if said else self.jobs
            if self.done == self.jobs:
                os.close(self.words)
                with contextlib.suppress(ChildProcessError):  # who waits for all has waited for it
                    os.waitpid(self.child, 0)


def may_copy() -> bool:
    """Whether a copy of this process can compile something beside it."""
    return (
        sys.platform == "linux"
        and not config.DISABLE_JIT
        and THREADS.count > 1
        and threading.current_thread() is threading.main_thread()
        and all(one.name.startswith(_THREADS) for one in threading.enumerate())
        and parent_process() is None
        and "mpi4py" not in sys.modules
    )


def compile_afterwards(function: Any, *arguments: Any) -> None:
    """Have a copy compile a function for the types of these arguments, once a loop is `share`d."""
    if may_copy():
        work = partial(function.compile, tuple(map(numba.typeof, arguments)))
        _AFTERWARDS[id(function)] = function, work


def compile_beside(jobs: Sequence[Job]) -> None:
    """Have a copy of this process do jobs, in the order in which functions will be reached.

    Nothing is done where there is code of the first of these on disk; others that have some are
    left out.
    """
    if not jobs or not may_copy() or not jobs[0][0].is_new():
        return
    jobs = [job for job in jobs if job[0].is_new()]
    if (copy := _copy_for([work for _, work in jobs], len(jobs))) is not None:
        for count, (function, _) in enumerate(jobs, 1):
            _COPIES[id(function)] = copy, count


def share(works: Sequence[Callable[[], object]]) -> None:
    """Do what is to be done, beside a copy: who is free takes the next that nobody has begun.

    What the copy compiles is on the disk then, and not here.
    """
    claims, begin = os.pipe()
    os.write(begin, bytes(range(len(works))))
    os.close(begin)
    mine = (works[number[0]] for number in iter(partial(os.read, claims, 1), b""))
    is_shared = len(works) >= _MIN_SHARED and may_copy()
    copy = _copy_for(mine, len(works), claims) if is_shared else None
    for work in mine:
        work()
    os.close(claims)
    if copy is not None:
        copy.wait_for(len(works))
        compile_beside(list(_AFTERWARDS.values()))
        _AFTERWARDS.clear()


def _copy_for(works: Iterable[Callable[[], object]], count: int, *open_: int) -> _Copy | None:
    """A copy of this process for so many jobs, at most, that reads these files."""
    words, say = os.pipe()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of threads of libraries, none of which is needed
            child = os.fork()
    except OSError:  # no room for another process
        os.close(words)
        os.close(say)
        return None
    if not child:
        try:
            _do(works, say, *open_)
        finally:
            os._exit(0)
    os.close(say)
    return _Copy(child, words, count)


def _do(works: Iterable[Callable[[], object]], say: int, *open_: int) -> None:
    """Do all jobs, and no more: what is open is the other process's."""
    _COPIES.clear()
    THREADS.use(1)
    logging.disable()
    warnings.simplefilter("ignore")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    nothing = os.open(os.devnull, os.O_RDWR)
    for file in range(_FILES):
        if file < 3:
            os.dup2(nothing, file)
        elif file not in (say, *open_):
            with contextlib.suppress(OSError):
                os.close(file)
    for work in works:
        work()
        os.write(say, b".")


def wait_for(function: object) -> None:
    """Wait for what a copy compiles, if this is one of those functions."""
    if (job := _COPIES.pop(id(function), None)) is not None:
        job[0].wait_for(job[1])
