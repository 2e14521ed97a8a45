"""The next event of a body: an impact with what is around it, or the end of its cell.

A body looks at all bodies in its own cell and the 26 around it, and at walls, until it leaves its
cell. Two bodies touch only from neighbouring cells: who of them was the last to enter such a cell,
or to change its flight, has seen the other then. So each body needs a single event; where its
partner has hit another one before, the body looks again at that time, and finds what comes next.
Where all are balls in free flight, a body that enters a cell looks at the new ones around it alone.
"""

import math

from particlerb.compiled.jit import lean, lean_kernel
from particlerb.events.flight import place, pull
from particlerb.events.queue import put
from particlerb.events.records import (
    CELL,
    EXIT,
    HIT,
    HITS,
    LEAVE,
    NEXT,
    NOBODY,
    OTHER,
    OWN,
    PARTNER,
    PREVIOUS,
    STAMP,
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
    c = cell_of(scene, state, state.info[b, CELL], state.info[b, CELL + 1], state.info[b, CELL + 2])
    first = state.head[c]
    state.info[b, NEXT], state.info[b, PREVIOUS] = first, -1 - c
    if first >= 0:
        state.info[first, PREVIOUS] = b
    state.head[c] = b


@lean
def _leave_cell(state: EventState, b: int) -> None:
    """Take a body out of the list of its cell."""
    before, after = state.info[b, PREVIOUS], state.info[b, NEXT]
    if before >= 0:
        state.info[before, NEXT] = after
    else:
        state.head[-1 - before] = after
    if after >= 0:
        state.info[after, PREVIOUS] = before


@lean
def cross(scene: EventScene, state: EventState, b: int) -> None:
    """Let a body go into the next cell."""
    _leave_cell(state, b)
    state.info[b, CELL + state.info[b, EXIT] // 2] += 2 * (state.info[b, EXIT] % 2) - 1
    enter_cell(scene, state, b)
    state.tally[CROSSINGS] += 1.0


@lean
def _until_crossing(
    scene: EventScene, state: EventState, b: int, x: Vec3, v: Vec3
) -> tuple[float, int]:
    """Time in which a body stays in its cell [s]; the side by which it leaves."""
    g, w = pull(scene, b), scene.cell_width
    best, leaves = math.inf, 0
    for k in range(3):
        low = x[k] - (scene.origin[k] + w * state.info[b, CELL + k])
        s = soonest(low, v[k], -g[k], 0.0, w)
        if s < best:
            best, leaves = s, 2 * k
        s = soonest(w - low, -v[k], g[k], 0.0, w)
        if s < best:
            best, leaves = s, 2 * k + 1
    return best, leaves


@lean
def _earlier(t: float, s: float) -> float:
    """t + s, rounded down."""
    time = t + s
    return max(time - 1.2e-16 * abs(time), t) if time - t > s else time


@lean
def _note(state: EventState, b: int, t: float, s: float, hit: tuple[int, int, int]) -> None:
    """Make an impact after a time s that of body b, if it comes earlier than what it has."""
    time = _earlier(t, s)
    if time < state.at[b, HIT]:
        state.at[b, HIT] = time
        state.info[b, PARTNER], state.info[b, OWN], state.info[b, OTHER] = hit
        state.info[b, STAMP] = state.info[hit[0], HITS] if hit[0] >= 0 else 0


@lean
def _bounds(state: EventState, b: int, side: int, axis: int) -> tuple[int, int]:
    """First and last row of cells to look at along an axis: of a side alone, the new ones."""
    at = state.info[b, CELL + axis]
    if side < 0 or side // 2 != axis:
        return at - 1, at + 1
    new = at + 2 * (side % 2) - 1
    return new, new


@lean_kernel
def predict(
    scene: EventScene, state: EventState, work: Workspace, b: int, t: float, side: int
) -> bool:
    """Find the next event of body b after t [s] and queue it; false: a search did not end.

    `side` is that by which the body has come into its cell; where it is not negative, only cells
    beyond are new. Balls in free flight are looked at for all time, all else until the body leaves.
    """
    x, v = place(scene, state, b, t)
    one, found = Flying(b, t, x, v), True
    stays, state.info[b, EXIT] = _until_crossing(scene, state, b, x, v)
    state.at[b, LEAVE] = t + stays
    if side < 0 or scene.looks_around:
        side = -1
        state.at[b, HIT], state.info[b, PARTNER] = math.inf, NOBODY
    (i0, i1), (j0, j1) = _bounds(state, b, side, 0), _bounds(state, b, side, 1)
    k0, k1 = _bounds(state, b, side, 2)
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            for k in range(k0, k1 + 1):
                c = state.head[cell_of(scene, state, i, j, k)]
                while c >= 0:
                    if c != b:
                        until = state.at[b, HIT] - t
                        if scene.looks_around:
                            until = min(until, stays)
                        s, own, other = bodies_meet(scene, state, work, one, c, until)
                        found = found and s != LOST
                        _note(state, b, t, s, (c, own, other))
                    c = state.info[c, NEXT]
    for p in range(scene.wall_kind.size):
        until = min(state.at[b, HIT] - t, stays)
        s, own = wall_meets(scene, state, work, one, p, until)
        found = found and s != LOST
        _note(state, b, t, s, (WALL, own, p))
    put(state, b, min(state.at[b, HIT], state.at[b, LEAVE]))
    return found


@lean_kernel
def predict_all(scene: EventScene, state: EventState, work: Workspace) -> bool:
    """Put all bodies into their cells, and find their events; false: a search did not end."""
    for b in range(scene.mass.size - 1, -1, -1):
        x, _ = place(scene, state, b, 0.0)
        for k in range(3):
            state.info[b, CELL + k] = math.floor((x[k] - scene.origin[k]) / scene.cell_width)
        enter_cell(scene, state, b)
    found = True
    for b in range(scene.n_moving):
        found = predict(scene, state, work, b, 0.0, -1) and found
    return found
