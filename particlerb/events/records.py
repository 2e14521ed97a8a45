"""What collisions by events are made of: constants, bodies on their flights, cells, the queue.

Bodies have numbers of their own here: those that move first, sorted by cell so that neighbours are
near each other in memory, then those that are held. Times count from `sums[EPOCH]` after
the start of the segment, which moves along: late times would have fewer digits.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag
from particlerb.impulses import records as col
from particlerb.maths.vec3 import Floats, Indices, Ints, Vec3

# Columns of `EventScene.body`
BODY_MASS: Final = 0  # [kg]
BODY_INV_MASS: Final = 1  # [1/kg] 0 where held
BODY_INERTIA: Final = 2  # three [kg m²], rotor frame
BODY_INV_INERTIA: Final = 5  # three
BODY_CURVED: Final = 8  # `spin[BEND]` over the square of `spin[FASTEST]`
BODY_REACH: Final = 9  # [m] to the farthest centre of a sphere; 0: one ball about its centre
N_BODY: Final = 10

# Columns of `EventScene.kind`
FIRST_SPHERE: Final = 0  # of body b; its last one is before that of body b + 1
MATERIAL: Final = 1
IS_ASYMMETRIC: Final = 2  # 1: its principal moments differ
N_KIND: Final = 3

SPHERE_RADIUS: Final = 3  # column of `EventScene.sphere`, behind the arm

# Columns of `EventState.flight`
FLIGHT_X: Final = 0  # [m] centre of mass when the flight began,
FLIGHT_V: Final = 3  # [m/s]
SINCE: Final = 6  # [s]
BOUND: Final = 7  # [m] from the centre of mass to the farthest point that may touch
N_FLIGHT: Final = 8

# Columns of `EventState.spin`
SPIN_L: Final = 0  # [kg m²/s] world axes
TURNED: Final = 3  # [s] when the turn was set
FASTEST: Final = 4  # [rad/s] that it can turn
BEND: Final = 5  # [1/s²] largest acceleration of a point by turning, over its distance
N_SPIN: Final = 6

# Columns of `EventState.event`
CELL: Final = 0  # three numbers
PREVIOUS: Final = 3  # body before it in its cell: or -1 - the number of that
EXIT: Final = 4  # side by which it leaves its cell: 2 axis, + 1 along it
PARTNER: Final = 5  # which its next impact is with
STAMP: Final = 6  # HITS of the partner when that was found; AGAIN: it looks for its next event
OWN: Final = 7  # sphere of the body with the lower number
OTHER: Final = 8  # sphere of the other body, or primitive
HITS: Final = 9  # impacts so far
BEFORE: Final = 10  # body before it in its list of the queue,
FOUND: Final = 10  # or, in the heap, impacts of all before its event came there
PLACE: Final = 11  # in the heap; -1: in a list
N_EVENT: Final = 16  # a line of the cache

# Columns of `EventState.event_time`, behind the others of `EventState.event`
HIT: Final = 6  # [s] next impact
LEAVE: Final = 7  # [s] end of the stay in its cell

# Numbers of `EventState.sums`
INSTANT: Final = 0  # [s] start of an instant,
AT_ONCE: Final = 1  # impacts since then
EPOCH: Final = 2  # [s] from which times count
SUM_EXTERNAL: Final = 3  # seven: work, impulse, angular impulse
MOMENT: Final = 10  # three [kg m s] of all mass on the flights that have ended
SOON: Final = 13  # bodies in the heap
INTERVAL: Final = 14  # number of the first whose events are not in the heap
N_SUMS: Final = 15

# Values of PARTNER that are not bodies
NOBODY: Final = -1  # nothing is hit
WALL: Final = -2  # a primitive

AGAIN: Final = -1
REMEMBERED: Final = 8  # latest contacts of a body whose times are kept

# How a call of the kernel ends
DONE: Final = 0
MORE: Final = 1  # as many events as it may take, and time is left
ENDLESS: Final = 2  # impacts do not come to an end
OVERLAP: Final = 3  # spheres overlap by more than rounding
UNFOUND: Final = 4  # a search took too many steps
FAR: Final = 5  # a body is in the last cell that has a number

_CACHE_LINE_BYTES: Final = 64
_LISTS_PER_BODY: Final = 2  # at least, of the queue


class EventScene(NamedTuple):
    """What does not change, bodies by their own numbers; None: there is nothing of the kind.

    Few arrays: each that a kernel hands to its helpers is seven to nine values to the compiler.
    """

    gravity: Vec3  # [m/s²]
    n_moving: int  # bodies that move come first
    body: Floats  # (n, N_BODY)
    kind: Ints  # (n + 1, N_KIND)
    sphere: Floats  # (m, 4) [m] arm in the rotor frame, radius
    pair_of: Ints  # (k, k) pair of two materials
    rules: Floats  # (pairs, 2) restitution, friction
    wall_kind: Ints  # (w,) primitives that have a surface
    wall_parameter: Floats  # (w, 12)
    wall_material: Ints  # (w,)
    wall_first: Indices  # (n_cells + 2,) of those near each cell in `wall_near`; last: of all walls
    wall_near: Indices
    contact_time: float  # [s]
    period: float  # [s] after which times are counted anew
    around: Flag  # all cells around are looked at in each cell: not all are balls in free flight
    turns: Flag  # some body is asymmetric
    rubs: Flag  # some impact may change how a body turns
    box: tuple[Vec3, Vec3] | None  # [m, 1/m] sides of a periodic box, and inverse; 0: no end
    cell_width: Vec3  # [m]
    origin: Vec3  # [m] corner of a cell
    cells: tuple[int, int, int]  # along each axis


class EventState(NamedTuple):
    """What changes."""

    flight: Floats  # (n, N_FLIGHT)
    spin: Floats  # (n, N_SPIN)
    turn: Floats  # (n, ..) see rotors/single_turn.py
    event: Indices  # (n, N_EVENT) cell and next event of each
    event_time: Floats  # (n, N_EVENT / 2) [s] the same memory as `event`
    next: Indices  # (n,) body in the same cell; -1: there is none
    head: Indices  # (n_cells,) first body of each cell
    behind: Indices  # (n,) body in the same list of the queue; -1: there is none
    later: Indices  # (2^k,) first body of the list of each interval
    heap: Indices  # (n_moving,) bodies with an event soon, the one whose event is next first
    heap_time: Floats  # (n_moving,) [s] of their events
    contact: Ints  # (n, REMEMBERED) latest contacts of each body with those of higher number
    contact_at: Floats  # (n, REMEMBERED) [s] when
    sums: Floats  # (N_SUMS,)
    tally: Floats  # (TALLY,)


class EventData(NamedTuple):
    """What kernels write beside the state: `centre` in a search, the others in an impact."""

    centre: Floats  # (most spheres of a body, 8) centre, velocity, bend, unused
    velocity: Floats  # (2, 6) of the two, as `Partners` and `ImpulseRows` have them
    inverse: Floats  # (2, 7)
    position: Floats  # (2, 3)
    frame: Floats  # (1, ..)


def empty_data(most: int) -> EventData:
    """Space for bodies of so many spheres at most."""
    widths = ((most, 8), (2, 6), (2, 7), (2, 3), (1, col.N_COLUMNS))
    return EventData(*(np.zeros(shape) for shape in widths))


def _rows(n: int, columns: int, dtype: Any) -> Any:
    """Array (n, columns) of zeros that begins with a line of the cache."""
    size = n * columns * np.dtype(dtype).itemsize
    space = np.zeros(size + _CACHE_LINE_BYTES, dtype=np.uint8)
    start = -space.ctypes.data % _CACHE_LINE_BYTES
    return space[start : start + size].view(dtype).reshape(n, columns)


def empty_state(n: int, n_moving: int, n_cells: int, columns: int) -> EventState:
    """State of n bodies at time 0: each that moves looks for its next event."""
    bodies = np.arange(n, dtype=np.int32)
    event = _rows(n, N_EVENT, np.int32)
    sums = np.zeros(N_SUMS)
    event[:, PARTNER], event[:, STAMP], event[:, PLACE] = bodies, AGAIN, bodies
    event_time = event.view(float)
    event_time[:, HIT:] = np.inf
    sums[SOON], sums[INTERVAL] = n_moving, 1.0 if n_moving else np.inf
    lists = 1 << (_LISTS_PER_BODY * n_moving).bit_length()
    sizes = n, n_cells, n, lists
    following, head, behind, later = (np.full(size, -1, dtype=np.int32) for size in sizes)
    return EventState(
        _rows(n, N_FLIGHT, float), np.zeros((n, N_SPIN)), np.zeros((n, columns)), event, event_time,
        following, head, behind, later, bodies[:n_moving].copy(), np.zeros(n_moving),
        np.full((n, REMEMBERED), -1), np.full((n, REMEMBERED), -np.inf), sums, np.zeros(col.TALLY),
    )  # fmt: skip
