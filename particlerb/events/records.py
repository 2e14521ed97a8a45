"""What collisions by events are made of: constants, bodies on their flights, cells, the queue.

Bodies have numbers of their own here: those that move first, sorted by cell so that neighbours are
near each other in memory, then those that are held. Times count from `clock[2]` after
the start of the segment, which moves along: late times would have fewer digits.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.impulses.records import TALLY, ImpulseRows, Partners
from particlerb.maths.vec3 import Bools, Floats, Ints

# Columns of `EventState.flight`
X: Final = 0  # [m] centre of mass when the flight began,
V: Final = 3  # [m/s]
SINCE: Final = 6  # [s]
BOUND: Final = 7  # [m] from the centre of mass to the farthest point that may touch
N_FLIGHT: Final = 8

# Columns of `EventState.spin`
L: Final = 0  # [kg m²/s] world axes
TURNED: Final = 3  # [s] when the turn was set
FASTEST: Final = 4  # [rad/s] that it can turn
BEND: Final = 5  # [1/s²] largest acceleration of a point by turning, over its distance
N_SPIN: Final = 6

# Columns of `EventState.info`
CELL: Final = 0  # three numbers
NEXT: Final = 3  # body in the same cell, and
PREVIOUS: Final = 4  # the one before; -1 - its number where it is the first of a cell
EXIT: Final = 5  # side by which it leaves its cell: 2 axis, + 1 along it
PARTNER: Final = 6  # which its next impact is with
STAMP: Final = 7  # HITS of the partner when that was found
OWN: Final = 8  # sphere of the body with the lower number
OTHER: Final = 9  # sphere of the other body, or primitive
HITS: Final = 10  # impacts so far
N_INFO: Final = 12

# Columns of `EventState.at`
HIT: Final = 0  # [s] next impact
LEAVE: Final = 1  # [s] end of the stay in its cell

# Values of PARTNER that are not bodies
NOBODY: Final = -1  # nothing is hit
WALL: Final = -2  # a primitive

REMEMBERED: Final = 8  # latest contacts of a body whose times are kept

# How a call of the kernel ends
DONE: Final = 0
MORE: Final = 1  # as many events as it may take, and time is left
ENDLESS: Final = 2  # impacts do not come to an end
OVERLAP: Final = 3  # spheres overlap by more than rounding
UNFOUND: Final = 4  # a search took too many steps


class EventScene(NamedTuple):
    """What does not change, bodies by their own numbers."""

    gravity: Floats  # (3,) [m/s²]
    n_moving: int  # bodies that move come first
    mass: Floats  # (n,) [kg]
    inv_mass: Floats  # (n,) 0 where held
    inertia: Floats  # (n, 3) [kg m²] rotor frame
    inv_inertia: Floats  # (n, 3)
    is_asymmetric: Bools  # (n,)
    bend: Floats  # (n,) `spin[BEND]` over the square of `spin[FASTEST]`
    reach: Floats  # (n,) [m] to the farthest centre of a sphere; 0: one ball about its centre
    first: Ints  # (n + 1,) spheres of body b are first[b] to first[b + 1]
    arm: Floats  # (m, 3) [m] rotor frame
    radius: Floats  # (m,) [m]
    material: Ints  # (n,)
    pair_of: Ints  # (k, k) pair of two materials
    restitution: Floats  # (n_pairs,)
    friction: Floats  # (n_pairs,)
    wall_kind: Ints  # (n_primitives,) those that have points of their own
    wall_parameter: Floats  # (n_primitives, 12)
    wall_material: Ints  # (n_primitives,)
    contact_time: float  # [s]
    period: float  # [s] after which times are counted anew, so that they keep their digits
    looks_around: bool  # whether a body that enters a cell looks at all bodies around it again
    cell_width: float  # [m]
    origin: Floats  # (3,) [m] corner of cell 0, 0, 0
    cells: Ints  # (3,) how many; those beyond share


class EventState(NamedTuple):
    """What changes."""

    flight: Floats  # (n, N_FLIGHT)
    spin: Floats  # (n, N_SPIN)
    turn: Floats  # (n, ..) see rotors/single_turn.py
    info: Ints  # (n, N_INFO)
    at: Floats  # (n, 2) [s]
    head: Ints  # (n_cells,) first body of each cell, -1: none
    heap: Ints  # (n_moving,) bodies, the one whose event is next first
    heap_time: Floats  # (n_moving,) [s] of their events
    place: Ints  # (n,) in the heap
    contact: Ints  # (n, REMEMBERED) latest contacts of each body with those of higher number
    contact_at: Floats  # (n, REMEMBERED) [s] when
    clock: Floats  # (3,) [s] start of an instant; impacts since then; [s] where 0 is
    sums: Floats  # (7,) work, impulse, angular impulse
    moment: Floats  # (3,) [kg m s] of all mass on the flights that have ended
    tally: Floats  # (TALLY,)


class Workspace(NamedTuple):
    """Space to work in."""

    centre: Floats  # (most spheres of a body, 8) centre, velocity, bend, unused
    partners: Partners  # 2
    rows: ImpulseRows  # 1


def empty_state(n: int, n_moving: int, n_cells: int, columns: int) -> EventState:
    """State of n bodies, with nothing in it."""
    place = np.zeros(n, dtype=np.int64)
    place[:n_moving] = np.arange(n_moving)
    return EventState(
        np.zeros((n, N_FLIGHT)), np.zeros((n, N_SPIN)), np.zeros((n, columns)),
        np.zeros((n, N_INFO), dtype=np.int64), np.full((n, 2), np.inf), np.full(n_cells, -1),
        np.arange(n_moving), np.full(n_moving, -np.inf), place,
        np.full((n, REMEMBERED), -1), np.full((n, REMEMBERED), -np.inf),
        np.zeros(3), np.zeros(7), np.zeros(3), np.zeros(TALLY),
    )  # fmt: skip
