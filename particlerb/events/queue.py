"""The next event of each body: of those that come soon a heap, of later ones lists by their time.

A heap of all events is deep, and each of its levels one more line of the cache. So a period is cut
into as many intervals as there are lists. A body whose event comes in a later interval is in the
list of that, or of the last one that has a list. When those before are over, the events of a list
come into the heap of four branches, earliest first; of events at one instant those first that came
there first, by the number of impacts before, then by the number of the body.

G. Paul, A complexity O(1) priority queue for event driven molecular dynamics simulations, J.
Comput. Phys. 221, 615 (2007). Why it is so: docs/decisions/0034.
"""

from typing import Final

import numpy as np

from particlerb.compiled.jit import inline
from particlerb.events import records as col
from particlerb.events.records import EventScene, EventState
from particlerb.impulses import records as impulses
from particlerb.maths.vec3 import Indices

_HEAP_BRANCHES: Final = 4
_MAX_FOUND: Final = 2**31 - 1  # that a number of a body holds


@inline
def enter_list(
    first: Indices, behind: Indices, event: Indices, before: int, k: int, b: int
) -> None:
    """Let body b be the first of list k; column `before` of `event` is the body before each."""
    after = first[k]
    behind[b], event[b, before], first[k] = after, -1 - k, b
    if after >= 0:
        event[after, before] = b


@inline
def leave_list(first: Indices, behind: Indices, event: Indices, before: int, b: int) -> None:
    """Take body b out of its list."""
    previous, after = event[b, before], behind[b]
    if previous >= 0:
        behind[previous] = after
    else:
        first[-1 - np.int64(previous)] = after
    if after >= 0:
        event[after, before] = previous


@inline
def _is_behind(state: EventState, t: float, b: int, s: float, c: int) -> bool:
    """Whether the event of body b at t comes after that of body c at s; both are in the heap."""
    if t != s:
        return t > s
    before, other = state.event[b, col.FOUND], state.event[c, col.FOUND]
    return before > other or (before == other and b > c)


@inline
def _sift_up(state: EventState, k: int, t: float, b: int) -> int:
    """Let the free place at k rise until body b belongs there; where that is."""
    heap, time = state.heap, state.heap_time
    while k > 0:
        parent = (k - 1) // _HEAP_BRANCHES
        if _is_behind(state, t, b, time[parent], int(np.int64(heap[parent]))):
            break
        time[k], heap[k], state.event[heap[parent], col.PLACE] = time[parent], heap[parent], k
        k = parent
    return k


@inline
def _sift_down(state: EventState, n: int, k: int, t: float, b: int) -> int:
    """Let the free place at k, of n, sink until body b belongs there; where that is."""
    heap, time = state.heap, state.heap_time
    while True:
        low = _HEAP_BRANCHES * k + 1
        if low >= n:
            break
        best = low
        for child in range(low + 1, min(low + _HEAP_BRANCHES, n)):
            c = int(np.int64(heap[child]))
            if _is_behind(state, time[best], int(np.int64(heap[best])), time[child], c):
                best = child
        if _is_behind(state, time[best], int(np.int64(heap[best])), t, b):
            break
        time[k], heap[k], state.event[heap[best], col.PLACE] = time[best], heap[best], k
        k = best
    return k


@inline
def _settle(state: EventState, n: int, k: int, t: float, b: int) -> None:
    """Let body b, with an event at t, take the free place at k of a heap of n, or a better one."""
    k = _sift_down(state, n, _sift_up(state, k, t, b), t, b)
    state.heap_time[k], state.heap[k], state.event[b, col.PLACE] = t, b, k


@inline
def take_out(state: EventState, b: int) -> None:
    """Take body b out of the heap or its list."""
    k = int(np.int64(state.event[b, col.PLACE]))
    if k < 0:
        leave_list(state.later, state.behind, state.event, col.BEFORE, b)
        return
    state.sums[col.SOON] -= 1.0
    n = int(state.sums[col.SOON])
    if k < n:
        _settle(state, n, k, state.heap_time[n], int(np.int64(state.heap[n])))


@inline
def insert(scene: EventScene, state: EventState, b: int) -> None:
    """Queue the next event of body b, which is not in the queue."""
    t = min(state.event_time[b, col.HIT], state.event_time[b, col.LEAVE])
    lists, interval = state.later.size, state.sums[col.INTERVAL]
    due = t * (lists / scene.period)
    if due < interval:
        state.event[b, col.FOUND] = np.int64(state.tally[impulses.IMPACTS]) & _MAX_FOUND
        state.sums[col.SOON] += 1.0
        n = int(state.sums[col.SOON])
        _settle(state, n, n - 1, t, b)
    else:
        k = int(min(due, interval + (lists - 1))) & (lists - 1)
        enter_list(state.later, state.behind, state.event, col.BEFORE, k, b)
        state.event[b, col.PLACE] = -1


@inline
def comes(scene: EventScene, state: EventState, until: float) -> bool:
    """Whether an event comes until a time; it is the first of the heap then."""
    lists = state.later.size
    while state.sums[col.SOON] == 0.0:
        interval = state.sums[col.INTERVAL]
        if interval * (scene.period / lists) + state.sums[col.EPOCH] > until:
            return False
        k, state.sums[col.INTERVAL] = int(interval) & (lists - 1), interval + 1.0
        b, state.later[k] = int(np.int64(state.later[k])), -1
        while b >= 0:
            after = int(np.int64(state.behind[b]))
            insert(scene, state, b)
            b = after
    return state.heap_time[0] + state.sums[col.EPOCH] <= until
