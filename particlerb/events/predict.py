"""The next event of a body: an impact with what is around it, or the end of its cell.

A body looks at all bodies in its own cell and the 26 around it, and at walls, until it leaves its
cell. Two bodies touch only from neighbouring cells: who of them was the last to enter such a cell,
or to change its flight, has seen the other then. So each body needs a single event; where its
partner has hit another one before, the body looks again at that time, and finds what comes next.
"""

import math

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.events.flight import place, pull
from particlerb.events.queue import put
from particlerb.events.records import (
    CROSSING,
    NEVER,
    WALL,
    EventScene,
    EventState,
    Workspace,
)
from particlerb.events.search import LOST, Flying, bodies_meet, soonest, wall_meets
from particlerb.impulses.records import CROSSINGS
from particlerb.maths.vec3 import Vec3


@lean
def cell_of(scene: EventScene, state: EventState, i: int, j: int, k: int) -> int:
    """Number of a cell, (i, j, k) modulo the numbers of cells."""
    x, y, z = i % scene.cells[0], j % scene.cells[1], k % scene.cells[2]
    return int((x * scene.cells[1] + y) * scene.cells[2] + z)


@lean
def enter_cell(scene: EventScene, state: EventState, b: int) -> None:
    """Add a body to the list of its cell."""
    c = cell_of(scene, state, state.cell[b, 0], state.cell[b, 1], state.cell[b, 2])
    first = state.head[c]
    state.next[b], state.previous[b] = first, -1 - c
    if first >= 0:
        state.previous[first] = b
    state.head[c] = b


@lean
def _leave_cell(state: EventState, b: int) -> None:
    """Take a body out of the list of its cell."""
    before, after = state.previous[b], state.next[b]
    if before >= 0:
        state.next[before] = after
    else:
        state.head[-1 - before] = after
    if after >= 0:
        state.previous[after] = before


@lean
def cross(scene: EventScene, state: EventState, b: int) -> None:
    """Let a body go into the next cell."""
    _leave_cell(state, b)
    state.cell[b, state.own[b]] += state.other[b]
    enter_cell(scene, state, b)
    state.tally[CROSSINGS] += 1.0


@lean
def _until_crossing(
    scene: EventScene, state: EventState, b: int, x: Vec3, v: Vec3
) -> tuple[float, int, int]:
    """Time in which a body stays in its cell [s]; axis and direction in which it leaves."""
    g, w = pull(scene, b), scene.cell_width
    best, axis, direction = math.inf, 0, 0
    for k in range(3):
        low = x[k] - (scene.origin[k] + w * state.cell[b, k])
        s = soonest(low, v[k], -g[k], 0.0, w)
        if s < best:
            best, axis, direction = s, k, -1
        s = soonest(w - low, -v[k], g[k], 0.0, w)
        if s < best:
            best, axis, direction = s, k, 1
    return best, axis, direction


@lean
def _note(
    state: EventState, b: int, best: float, s: float, partner: int, own: int, other: int
) -> float:
    """Make an event that of body b, if it comes earlier than the best so far; the best then."""
    if s >= best:
        return best
    state.partner[b], state.own[b], state.other[b] = partner, own, other
    return s


@lean_kernel
def predict(scene: EventScene, state: EventState, work: Workspace, b: int, t: float) -> bool:
    """Find the next event of body b after t [s] and queue it; false: a search did not end."""
    x, v = place(scene, state, b, t)
    one = Flying(b, t, x, v)
    best, axis, direction = _until_crossing(scene, state, b, x, v)
    state.partner[b], state.own[b], state.other[b] = CROSSING, axis, direction
    if best == math.inf:
        state.partner[b] = NEVER
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                i, j, k = state.cell[b, 0] + di, state.cell[b, 1] + dj, state.cell[b, 2] + dk
                c = state.head[cell_of(scene, state, i, j, k)]
                while c >= 0:
                    if c != b:
                        s, own, other = bodies_meet(scene, state, work, one, c, best)
                        if s == LOST:
                            return False
                        best = _note(state, b, best, s, c, own, other)
                    c = state.next[c]
    for p in range(scene.wall_kind.size):
        s, own = wall_meets(scene, state, work, one, p, best)
        if s == LOST:
            return False
        best = _note(state, b, best, s, WALL, own, p)
    time = t + best
    if time - t > best:
        time -= 1.2e-16 * abs(time)
    state.time[b] = max(time, t)
    if state.partner[b] >= 0:
        state.stamp[b] = state.hits[state.partner[b]]
    put(state, b)
    return True


@lean_kernel
def predict_all(scene: EventScene, state: EventState, work: Workspace) -> bool:
    """Put all bodies into their cells, and find their events; false: a search did not end."""
    for b in range(scene.mass.size - 1, -1, -1):
        x, _ = place(scene, state, b, 0.0)
        for k in range(3):
            state.cell[b, k] = math.floor((x[k] - scene.origin[k]) / scene.cell_width)
        enter_cell(scene, state, b)
    found = True
    for b in range(scene.n_moving):
        found = predict(scene, state, work, b, 0.0) and found
    return found
