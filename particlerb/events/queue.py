"""The next event of each body: a heap of four branches, earliest first, then by number."""

from typing import Final

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.events.records import EventState
from particlerb.maths.vec3 import Floats, Ints

_BRANCHES: Final = 4


@lean
def _is_before(time: Floats, a: int, b: int) -> bool:
    """Whether the event of body a comes before that of b."""
    return bool(time[a] < time[b] or (time[a] == time[b] and a < b))


@lean
def _sift_up(heap: Ints, place: Ints, time: Floats, k: int) -> int:
    """Let the body at k rise; where it is then."""
    b = heap[k]
    while k > 0:
        parent = (k - 1) // _BRANCHES
        if not _is_before(time, b, heap[parent]):
            break
        heap[k] = heap[parent]
        place[heap[k]] = k
        k = parent
    heap[k] = b
    place[b] = k
    return k


@lean
def _sift_down(heap: Ints, place: Ints, time: Floats, k: int) -> None:
    """Let the body at k sink."""
    n, b = heap.size, heap[k]
    while True:
        low = _BRANCHES * k + 1
        if low >= n:
            break
        best = low
        for child in range(low + 1, min(low + _BRANCHES, n)):
            if _is_before(time, heap[child], heap[best]):
                best = child
        if not _is_before(time, heap[best], b):
            break
        heap[k] = heap[best]
        place[heap[k]] = k
        k = best
    heap[k] = b
    place[b] = k


@lean
def put(state: EventState, b: int) -> None:
    """Bring body b, whose time has changed, to its place in the heap."""
    k = _sift_up(state.heap, state.place, state.time, state.place[b])
    _sift_down(state.heap, state.place, state.time, k)


@lean_kernel
def build(state: EventState) -> None:
    """Order the whole heap."""
    for k in range(state.heap.size - 1, -1, -1):
        _sift_down(state.heap, state.place, state.time, k)
