"""The next event of a body: an impact with what is around it, or the end of its cell.

A body looks at all bodies in its own cell and the 26 around it, and at walls, until it leaves its
cell. Two bodies touch only from neighbouring cells: who of them was the last to enter such a cell,
or to change its flight, has seen the other then. So each body needs a single event; where its
partner has hit another one before, the body looks again at that time, and finds what comes next.
Where all are balls in free flight, a body that enters a cell looks at the new ones around it alone.
"""

import math

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.events import records as col
from particlerb.events.flight import flight_at, pull, set_flight
from particlerb.events.queue import enter_list, insert, leave_list, take_out
from particlerb.events.records import EventScene, EventState
from particlerb.events.search import LOST, Flying, balls_meet, bodies_meet, soonest, wall_meets
from particlerb.impulses import records as impulses
from particlerb.maths.vec3 import Floats, Ints, Vec3
from particlerb.model.state import State


@inline
def _cell(scene: EventScene, i: int, j: int, k: int) -> int:
    """Number of a cell, of whose three numbers each is in its range."""
    _, ny, nz = scene.cells
    return (i * ny + j) * nz + k


@inline
def _within(i: int, n: int) -> int:
    """I modulo n, of a neighbour of a number from 0 to n - 1."""
    return i - n if i >= n else i + n if i < 0 else i


@inline
def _home(scene: EventScene, state: EventState, b: int) -> tuple[int, int, int]:
    """Cell that a body is in, its numbers modulo the numbers of cells."""
    nx, ny, nz = scene.cells
    i, j, k = state.event[b, col.CELL], state.event[b, col.CELL + 1], state.event[b, col.CELL + 2]
    return int(np.int64(i) % nx), int(np.int64(j) % ny), int(np.int64(k) % nz)


@inline
def _enter_cell(scene: EventScene, state: EventState, b: int) -> None:
    """Add a body to the list of its cell."""
    i, j, k = _home(scene, state, b)
    enter_list(state.head, state.next, state.event, col.PREVIOUS, _cell(scene, i, j, k), b)


@inline
def cross(scene: EventScene, state: EventState, b: int) -> None:
    """Let a body go into the next cell."""
    leave_list(state.head, state.next, state.event, col.PREVIOUS, b)
    state.event[b, col.CELL + state.event[b, col.EXIT] // 2] += (
        2 * (state.event[b, col.EXIT] % 2) - 1
    )
    _enter_cell(scene, state, b)
    state.tally[impulses.CROSSINGS] += 1.0


@inline
def _until_crossing(
    scene: EventScene, state: EventState, b: int, x: Vec3, v: Vec3
) -> tuple[float, int]:
    """Time in which a body stays in its cell [s]; the side by which it leaves."""
    g, best, leaves = pull(scene, b), math.inf, 0
    for k in range(3):
        w = scene.cell_width[k]
        low = x[k] - (scene.origin[k] + w * state.event[b, col.CELL + k])
        if g[k] == 0.0:
            ahead = w - low if v[k] > 0.0 else low
            s = max(ahead, 0.0) / abs(v[k]) if v[k] != 0.0 else math.inf
            if s < best:
                best, leaves = s, 2 * k + (1 if v[k] > 0.0 else 0)
            continue
        s = soonest(low, v[k], -g[k], 0.0, w)
        if s < best:
            best, leaves = s, 2 * k
        s = soonest(w - low, -v[k], g[k], 0.0, w)
        if s < best:
            best, leaves = s, 2 * k + 1
    return best, leaves


@inline
def _earlier(t: float, s: float) -> float:
    """t + s, rounded down."""
    time = t + s
    return max(time - 1.2e-16 * abs(time), t) if time - t > s else time


@inline
def _note(state: EventState, b: int, t: float, s: float, hit: tuple[int, int, int]) -> None:
    """Make an impact after a time s that of body b, if it comes earlier than what it has.

    Where the search for it has not come to an end, the body looks again then.
    """
    time = _earlier(t, s)
    if time < state.event_time[b, col.HIT]:
        state.event_time[b, col.HIT] = time
        state.event[b, col.PARTNER], state.event[b, col.OWN], state.event[b, col.OTHER] = hit
        if hit[1] == LOST:
            state.event[b, col.PARTNER], state.event[b, col.STAMP] = b, col.AGAIN
        elif hit[0] >= 0:
            state.event[b, col.STAMP] = state.event[hit[0], col.HITS]


@inline
def _goes_on(scene: EventScene, state: EventState, b: int, c: int, s: float, sphere: int) -> bool:
    """Whether a search has come to an end, or as far as clumps that turn by a radian."""
    turning = state.spin[b, col.FASTEST] if scene.body[b, col.BODY_REACH] > 0.0 else 0.0
    if c >= 0 and scene.body[c, col.BODY_REACH] > 0.0:
        turning += state.spin[c, col.FASTEST]
    return sphere != LOST or s * turning >= 1.0


@inline
def _look(
    scene: EventScene, state: EventState, data: Floats, flying: Flying, c: int, stays: float
) -> bool:
    """Note the impact of a body with body c, if it is the next; false: a search did not end."""
    b = flying.body
    if scene.around is None:
        _note(state, b, flying.t, balls_meet(scene, state, flying, c), (c, min(b, c), max(b, c)))
        return True
    until = min(state.event_time[b, col.HIT] - flying.t, stays)
    s, sphere, other = bodies_meet(scene, state, data, flying, c, until)
    _note(state, b, flying.t, s, (c, sphere, other))
    return _goes_on(scene, state, b, c, s, sphere)


@inline
def _look_at_walls(
    scene: EventScene, state: EventState, data: Floats, flying: Flying, home: int, stays: float
) -> bool:
    """`_look` at all walls near a cell."""
    ended, b = True, flying.body
    for n in range(scene.wall_first[home], scene.wall_first[home + 1]):
        p = int(np.int64(scene.wall_near[n]))
        until = min(state.event_time[b, col.HIT] - flying.t, stays)
        s, i = wall_meets(scene, state, data, flying, p, until)
        ended = _goes_on(scene, state, b, col.WALL, s, i) and ended
        _note(state, b, flying.t, s, (col.WALL, i, p))
    return ended


@inline
def _first_and_last(side: int, axis: int) -> tuple[int, int]:
    """First and last row of cells to look at along an axis: of a side alone, the new ones."""
    if side < 0 or side // 2 != axis:
        return -1, 1
    new = 2 * (side % 2) - 1
    return new, new


@inline
def predict(
    scene: EventScene, state: EventState, data: Floats, b: int, t: float, side: int
) -> bool:
    """Find the next event of body b after t [s] and queue it; false: a search did not end.

    `side` is that by which the body has come into its cell; where it is not negative, only cells
    beyond are new. Balls in free flight are looked at for all time, all else until the body leaves.
    """
    x, v = flight_at(scene, state, b, t)
    flying, ended = Flying(b, t, x, v), True
    stays, state.event[b, col.EXIT] = _until_crossing(scene, state, b, x, v)
    state.event_time[b, col.LEAVE] = t + stays
    if side < 0 or scene.around is not None:
        side = -1
        state.event_time[b, col.HIT], state.event[b, col.PARTNER] = math.inf, col.NOBODY
    nx, ny, nz = scene.cells
    i0, j0, k0 = _home(scene, state, b)
    (i1, i2), (j1, j2) = _first_and_last(side, 0), _first_and_last(side, 1)
    k1, k2 = _first_and_last(side, 2)
    for i in range(i0 + i1, i0 + i2 + 1):
        for j in range(j0 + j1, j0 + j2 + 1):
            for k in range(k0 + k1, k0 + k2 + 1):
                at = _cell(scene, _within(i, nx), _within(j, ny), _within(k, nz))
                c = int(np.int64(state.head[at]))
                while c >= 0:
                    if c != b:
                        ended = _look(scene, state, data, flying, c, stays) and ended
                    c = int(np.int64(state.next[c]))
    home = _cell(scene, i0, j0, k0)
    i, j, k = state.event[b, col.CELL], state.event[b, col.CELL + 1], state.event[b, col.CELL + 2]
    if i != i0 or j != j0 or k != k0:
        home = state.head.size
    ended = _look_at_walls(scene, state, data, flying, home, stays) and ended
    take_out(state, b)
    insert(scene, state, b)
    return ended


@kernel
def set_all(scene: EventScene, state: EventState, columns: Ints, initial: State) -> None:
    """Flights and cells of all bodies at time 0; of b from column columns[b] of `initial`."""
    for b in range(state.event.shape[0] - 1, -1, -1):
        set_flight(scene, state, b, initial, columns[b])
        for k in range(3):
            along = state.flight[b, k] - scene.origin[k]
            state.event[b, col.CELL + k] = math.floor(along / scene.cell_width[k])
        _enter_cell(scene, state, b)
