"""Threads that run one compiled loop together, each on its share of it, and meet in between.

`THREADS.share` hands work over from Python, which takes some 50 µs: too long for a loop whose steps
take not much longer. So every thread enters such a loop once, and they wait for each other inside
it; a meeting of two takes 0.3 µs. Who waits asks again and again, and soon lets others run in
between, so that with more threads than free cores the one that is waited for gets on.

A kernel that shares its work in this way must come to the same meetings on every thread: it
branches by what all know, or by what `largest` told all of them. Without the compiler, and while
another call has the threads, it runs on this thread alone.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import wait
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from particlerb.compiled.jit import config, inline, kernel
from particlerb.compiled.threads import THREADS

_TWO_LINES: Final = 16  # numbers of the cache: nobody writes beside what others look at
_ARRIVED: Final = 0  # place of how often somebody has come to a meeting
_OVER: Final = _TWO_LINES  # place of whether nobody waits any more
_TURN_AT: Final = 6  # 1 in every other call of `largest`, behind two places of three numbers
_SPINS_BEFORE_YIELD: Final = 1000
Result = TypeVar("Result")


class Team(NamedTuple):
    """Threads that run a kernel together, as one of them sees it."""

    size: int
    thread: int  # number of this one, from 0
    arrivals: NDArray[np.int64]  # (2 CACHE_LINE,) see _ARRIVED and _OVER
    values: NDArray[np.float64]  # (size, CACHE_LINE) of which `largest` finds the largest


# What Numba lacks

_lowered: Callable[[Any], Any] = intrinsic  # its stub counts one parameter too many


@_lowered
def _add_atomically(context: Any, array: Any, at: Any, value: Any) -> Any:
    """array[at] += value in one go, in an order that is the same for all; the value before."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer_to(target, builder, signature, arguments)
        return builder.atomic_rmw("add", pointer, arguments[2], "seq_cst")

    return types.int64(array, types.int64, types.int64), generate


@_lowered
def _read_atomically(context: Any, array: Any, at: Any) -> Any:
    """array[at], with all that was written before it was."""

    def generate(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer_to(target, builder, signature, arguments)
        return builder.load_atomic(pointer, "seq_cst", 8)

    return types.int64(array, types.int64), generate


def _pointer_to(target: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Pointer to an element of an array, the first two arguments."""
    proxy: Any = cgutils.create_struct_proxy
    array = proxy(signature.args[0])(target, builder, arguments[0])
    return builder.gep(array.data, [arguments[1]])


_give_way: Any = types.ExternalFunction(
    "SwitchToThread" if os.name == "nt" else "sched_yield", types.int32()
)


# Meetings


@kernel
def meet(team: Team) -> None:
    """Wait until all have come here; what they wrote before is then seen by all."""
    size, _, arrivals, _ = team
    if size == 1:
        return
    due, asked = (_add_atomically(arrivals, _ARRIVED, 1) // size + 1) * size, 0
    while _read_atomically(arrivals, _ARRIVED) < due and _read_atomically(arrivals, _OVER) == 0:
        asked += 1
        if asked > _SPINS_BEFORE_YIELD:
            _give_way()


@kernel
def largest(team: Team, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Meet, and tell all the largest x, y and z that anybody has brought; inf once all is over.

    Calls write in turn into two places: who is late still looks at what was brought to this call
    while others bring something to the next one, and nobody comes to the one behind it before.
    """
    values, thread = team.values, team.thread
    if team.size == 1:
        return x, y, z
    at = 0 if values[thread, _TURN_AT] == 0.0 else 3
    values[thread, _TURN_AT] = 1.0 - values[thread, _TURN_AT]
    values[thread, at], values[thread, at + 1], values[thread, at + 2] = x, y, z
    meet(team)
    if _read_atomically(team.arrivals, _OVER) != 0:
        return np.inf, np.inf, np.inf
    for k in range(team.size):
        x = max(x, values[k, at])
        y = max(y, values[k, at + 1])
        z = max(z, values[k, at + 2])
    return x, y, z


@inline
def share_of(team: Team, first: int, end: int) -> tuple[int, int]:
    """What this thread does of the units first to end, end excluded."""
    n = end - first
    return first + n * team.thread // team.size, first + n * (team.thread + 1) // team.size


# Who runs


ONE_THREAD: Final = Team(1, 0, np.zeros(2 * _TWO_LINES, dtype=np.int64), np.zeros((1, _TWO_LINES)))
TOGETHER: Final = threading.Lock()


def together(kernel: Callable[[Team], Result], most: int) -> Result:
    """Enter a kernel with all threads, at most so many; what it returned on this one.

    Only one team runs at a time: parts of several could wait for the rest of theirs without end.

    Raises
    ------
    KeyboardInterrupt
        See `THREADS.share`.
    """
    THREADS.heed()
    size = 1 if config.DISABLE_JIT else min(THREADS.count, most)
    has_lock = size > 1 and TOGETHER.acquire(blocking=False)
    start = THREADS.local.clock()
    try:
        return _enter_all(kernel, size) if has_lock else kernel(ONE_THREAD)
    finally:
        THREADS.local.busy += THREADS.local.clock() - start
        if has_lock:
            TOGETHER.release()


def _enter_all(kernel: Callable[[Team], Result], size: int) -> Result:
    """Do the work of `together`."""
    arrivals, values = np.zeros(2 * _TWO_LINES, dtype=np.int64), np.zeros((size, _TWO_LINES))

    def enter(thread: int) -> Result:
        try:
            return kernel(Team(size, thread, arrivals, values))
        except BaseException:
            arrivals[_OVER] = 1
            raise

    others = []
    try:
        others += [THREADS.workers.submit(enter, thread) for thread in range(1, size)]
        result = enter(0)
    except BaseException:  # perhaps an interrupt before this thread has entered
        arrivals[_OVER] = 1
        raise
    finally:
        wait(others)
    for other in others:
        other.result()
    return result
