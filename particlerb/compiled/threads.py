"""Spreads a kernel over threads, by blocks of bodies.

A kernel that takes a range of blocks and touches only these gives the same bits however the blocks
are shared out. Python's own threads serve, because kernels run without the interpreter's lock:
Numba's parallel loops would double the time to compile, and stop a fork of the process.

How many threads a run uses is a setting of the thread that runs it: several runs side by side, each
in a thread of its own, have their own numbers, and share the threads of those with the same one.

Why it is so: docs/decisions/0002.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Final, TypeAlias, TypeVar

Result = TypeVar("Result")
Clock: TypeAlias = Callable[[], float]

BLOCK: Final = 256  # bodies a kernel takes at a time: its rows fit into the first levels of cache
LEAST_WORK: Final = 20_000  # body-steps or body-frames below which a second thread does not pay
POOL: Final = "particlerb"  # how names of its threads begin
_MAX_RANGES_PER_THREAD: Final = 4  # so that a slow thread is made up for
_MIN_RANGE_WORK: Final = 50_000  # body-steps or body-frames: well above what a call costs


class _ThreadState(threading.local):
    """What is a matter of one Python thread."""

    count: int | None = None  # threads that it uses; None: all cores
    heeds = False  # whether it ends where the main thread is asked to
    busy = 0.0  # [s] in kernels so far, by
    clock: Clock = time.perf_counter  # this: what studies compare


class _Threads:
    """The threads of this process."""

    def __init__(self) -> None:
        self.local = _ThreadState()
        self.cores = _available()
        self.is_ending = False  # set by a signal: the run ends behind the frame it is at
        self.is_stopping = False  # set by a second one: the next call raises KeyboardInterrupt
        self.forget()

    def forget(self) -> None:
        """Let the next call make its own threads: a child has none of its parent's."""
        self.lock = threading.Lock()
        self.pools: dict[int, ThreadPoolExecutor] = {}  # by their numbers of threads

    @property
    def count(self) -> int:
        """Threads that calls from this one use."""
        return self.local.count or self.cores

    @property
    def busy(self) -> float:
        """Time [s] in kernels that this thread has called."""
        return self.local.busy

    def use(self, count: int | None, heeds: bool = False) -> None:
        """Let calls from this thread use so many from now on; None for all cores.

        Where it `heeds`, they raise KeyboardInterrupt as those from the main thread do.
        """
        self.local.count, self.local.heeds = count, heeds

    @contextmanager
    def using(self, count: int | None, clock: Clock = time.perf_counter) -> Iterator[None]:
        """Let calls from this thread use so many meanwhile, None for all cores, timed so."""
        before = self.local.count, self.local.clock
        self.local.count, self.local.clock = count, clock
        try:
            yield
        finally:
            self.local.count, self.local.clock = before

    @property
    def workers(self) -> ThreadPoolExecutor:
        """Threads that wait for work, as many as calls from this one use."""
        with self.lock:
            if self.count not in self.pools:
                self.pools[self.count] = ThreadPoolExecutor(self.count, POOL)
            return self.pools[self.count]

    def spread(self, kernel: Callable[[int, int], object], bodies: int, work: int) -> None:
        """Call kernel(first, last) for ranges of blocks that cover all bodies; see `share`."""
        self.share(kernel, -(-bodies // BLOCK), work)

    def share(self, kernel: Callable[[int, int], object], units: int, work: int) -> None:
        """Call kernel(first, last) for ranges of units of work that cover all.

        Parameters
        ----------
        kernel : callable
            Works on the units first to end, end excluded.
        units : int
            Number of units, for instance blocks.
        work : int
            Body-steps or body-frames of the whole call; few are done by this thread alone.

        Raises
        ------
        KeyboardInterrupt
            If a signal has asked for the end. Raised here, between kernels, because an exception
            that a signal handler raises is lost where it meets a destructor of HDF5.
        """
        if units == 1 or work < LEAST_WORK or self.count == 1:
            self.alone(kernel, 0, units)
        else:
            self.alone(self.share_out, kernel, units, work)

    def heed(self) -> None:
        """Raise KeyboardInterrupt if a signal has asked for the end: they reach the main thread."""
        is_main = threading.current_thread() is threading.main_thread()
        if self.is_stopping and (is_main or self.local.heeds):
            self.is_stopping = not is_main
            raise KeyboardInterrupt

    def alone(self, kernel: Callable[..., Result], *arguments: object) -> Result:
        """Call a kernel on this thread for what it returns; KeyboardInterrupt as in `share`."""
        if self.is_stopping:
            self.heed()
        local = self.local
        start = local.clock()
        try:
            return kernel(*arguments)
        finally:
            local.busy += local.clock() - start

    def share_out(self, kernel: Callable[[int, int], object], units: int, work: int) -> None:
        """Do the work of `share` on several threads."""
        pieces = min(_MAX_RANGES_PER_THREAD * self.count, max(self.count, work // _MIN_RANGE_WORK))
        size = -(-units // pieces)
        ranges = [(lo, min(lo + size, units)) for lo in range(0, units, size)]
        workers = self.workers
        futures = [workers.submit(kernel, *bounds) for bounds in ranges]
        try:
            for future in futures:
                future.result()
        finally:  # after an interrupt no kernel may go on writing into what others use
            for future in futures:
                future.cancel()
            wait(futures)


def _available() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


THREADS: Final = _Threads()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=THREADS.forget)
