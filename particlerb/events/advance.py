"""The loop over events: the earliest of the queue, what it does, and what comes next."""

from typing import Final

import numpy as np

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.events.collide import collide
from particlerb.events.predict import cross, predict
from particlerb.events.records import (
    DONE,
    ENDLESS,
    EXIT,
    HIT,
    HITS,
    LEAVE,
    MORE,
    OTHER,
    OVERLAP,
    OWN,
    PARTNER,
    REMEMBERED,
    SINCE,
    STAMP,
    TURNED,
    UNFOUND,
    WALL,
    EventScene,
    EventState,
    Workspace,
)
from particlerb.impulses.records import RENEWED

_AT_ONCE: Final = 1000  # impacts of a body in an instant, on average, that are taken for endless
_INSTANT: Final = 1e-5  # share of the period


@lean
def _hit(scene: EventScene, state: EventState, work: Workspace, b: int, t: float) -> int:
    """Let the impact of body b happen; how that ends."""
    c = state.info[b, PARTNER]
    instant = _INSTANT * scene.period if scene.period < np.inf else 0.0
    if t - state.clock[0] > instant:
        state.clock[0], state.clock[1] = t, 0.0
    state.clock[1] += 1.0
    if state.clock[1] > _AT_ONCE * scene.n_moving:
        return ENDLESS
    first, second = (b, c) if c < 0 else (min(b, c), max(b, c))
    if not collide(scene, state, work, first, second, state.info[b, OWN], state.info[b, OTHER], t):
        return OVERLAP
    if not predict(scene, state, work, b, t, -1):
        return UNFOUND
    if 0 <= c < scene.n_moving and not predict(scene, state, work, c, t, -1):
        return UNFOUND
    return DONE


@lean
def _count_anew(scene: EventScene, state: EventState) -> None:
    """Count times from a period later on."""
    for b in range(scene.mass.size):
        state.flight[b, SINCE] -= scene.period
        state.spin[b, TURNED] -= scene.period
        state.at[b, HIT] -= scene.period
        state.at[b, LEAVE] -= scene.period
        for k in range(REMEMBERED):
            state.contact_at[b, k] -= scene.period
    for k in range(state.heap.size):
        state.heap_time[k] -= scene.period
    state.clock[0] -= scene.period
    state.clock[2] += scene.period


@lean_kernel
def advance(
    scene: EventScene, state: EventState, work: Workspace, until: float, most: int
) -> tuple[int, int]:
    """Take all events until a time [s], but no more than so many; how that ends, and whose."""
    for _ in range(most):
        if state.heap.size == 0:
            return DONE, -1
        if state.heap_time[0] + state.clock[2] > until:
            return DONE, -1
        if state.heap_time[0] > 2.0 * scene.period:
            _count_anew(scene, state)
        b, t, result = state.heap[0], state.heap_time[0], DONE
        c = state.info[b, PARTNER]
        if state.at[b, LEAVE] < state.at[b, HIT]:
            cross(scene, state, b)
            if not predict(scene, state, work, b, t, state.info[b, EXIT]):
                result = UNFOUND
        elif c == WALL or state.info[b, STAMP] == state.info[c, HITS]:
            result = _hit(scene, state, work, b, t)
        else:
            state.tally[RENEWED] += 1.0
            if not predict(scene, state, work, b, t, -1):
                result = UNFOUND
        if result != DONE:
            return result, b
    return MORE, -1
