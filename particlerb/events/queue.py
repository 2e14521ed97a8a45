"""The next event of each body: a heap of four branches, earliest first, then by number."""

from typing import Final

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.events.records import EventState

_HEAP_BRANCHES: Final = 4


@inline
def _sift_up(state: EventState, k: int, t: float, b: int) -> int:
    """Let the free place at k rise until body b belongs there; where that is."""
    heap, time = state.heap, state.heap_time
    while k > 0:
        parent = (k - 1) // _HEAP_BRANCHES
        if t > time[parent] or (t == time[parent] and b > heap[parent]):
            break
        time[k], heap[k], state.place[heap[parent]] = time[parent], heap[parent], k
        k = parent
    return k


@inline
def _sift_down(state: EventState, k: int, t: float, b: int) -> int:
    """Let the free place at k sink until body b belongs there; where that is."""
    heap, time = state.heap, state.heap_time
    n = heap.size
    while True:
        low = _HEAP_BRANCHES * k + 1
        if low >= n:
            break
        best = low
        for child in range(low + 1, min(low + _HEAP_BRANCHES, n)):
            s, least = time[child], time[best]
            if s < least or (s == least and heap[child] < heap[best]):
                best = child
        if time[best] > t or (time[best] == t and heap[best] > b):
            break
        time[k], heap[k], state.place[heap[best]] = time[best], heap[best], k
        k = best
    return k


@inline
def put(state: EventState, b: int, t: float) -> None:
    """Queue the event of body b at a time, in place of the one before."""
    k = _sift_up(state, int(np.int64(state.place[b])), t, b)
    k = _sift_down(state, k, t, b)
    state.heap_time[k], state.heap[k], state.place[b] = t, b, k
