"""The loop over events: the earliest of the queue, what it does, and what comes next."""

from typing import Final

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.sphere_search import LARGEST_NUMBER
from particlerb.events import records as col
from particlerb.events.collide import collide
from particlerb.events.predict import cross, predict
from particlerb.events.queue import comes
from particlerb.events.records import EventData, EventScene, EventState
from particlerb.impulses import records as impulses

_MAX_IMPACTS: Final = 1000  # of a body in an instant, on average: more are taken for endless
_INSTANT_SHARE: Final = 1e-5  # of the period


@inline
def _hit(scene: EventScene, state: EventState, data: EventData, b: int, c: int, t: float) -> int:
    """Let the impact of body b with c happen; how that ends."""
    if t - state.sums[col.INSTANT] > _INSTANT_SHARE * scene.period:
        state.sums[col.INSTANT], state.sums[col.AT_ONCE] = t, 0.0
    state.sums[col.AT_ONCE] += 1.0
    if state.sums[col.AT_ONCE] > _MAX_IMPACTS * scene.n_moving:
        return col.ENDLESS
    first, second = (b, c) if c < 0 else (min(b, c), max(b, c))
    sphere, other = int(np.int64(state.event[b, col.OWN])), int(np.int64(state.event[b, col.OTHER]))
    return col.DONE if collide(scene, state, data, first, second, sphere, other, t) else col.OVERLAP


@inline
def _count_anew(scene: EventScene, state: EventState) -> None:
    """Count times from a period later on."""
    for b in range(state.event.shape[0]):
        state.flight[b, col.SINCE] -= scene.period
        state.spin[b, col.TURNED] -= scene.period
        state.event_time[b, col.HIT] -= scene.period
        state.event_time[b, col.LEAVE] -= scene.period
        for k in range(col.REMEMBERED):
            state.contact_at[b, k] -= scene.period
    for k in range(int(state.sums[col.SOON])):
        state.heap_time[k] -= scene.period
    state.sums[col.INTERVAL] -= state.later.size
    state.sums[col.INSTANT] -= scene.period
    state.sums[col.EPOCH] += scene.period


@kernel
def advance(
    scene: EventScene, state: EventState, data: EventData, until: float, most: int
) -> tuple[int, int]:
    """Take all events until a time [s], but no more than so many; how that ends, and whose."""
    for _ in range(most):
        if not comes(scene, state, until):
            return col.DONE, -1
        if state.heap_time[0] > 2.0 * scene.period:
            _count_anew(scene, state)
        b, t = int(np.int64(state.heap[0])), state.heap_time[0]
        c, partner, side = int(np.int64(state.event[b, col.PARTNER])), -1, -1
        if state.event_time[b, col.LEAVE] < state.event_time[b, col.HIT]:
            side = int(np.int64(state.event[b, col.EXIT]))
            if abs(np.int64(state.event[b, col.CELL + side // 2])) >= LARGEST_NUMBER:
                return col.FAR, b
            cross(scene, state, b)
        elif c == col.WALL or state.event[b, col.STAMP] == state.event[c, col.HITS]:
            result = _hit(scene, state, data, b, c, t)
            if result != col.DONE:
                return result, b
            partner = c if c < scene.n_moving else -1
        else:
            state.tally[impulses.RENEWED] += 1.0
        for body in (b, partner):
            if body >= 0 and not predict(scene, state, data.centre, body, t, side):
                return col.UNFOUND, body
    return col.MORE, -1
