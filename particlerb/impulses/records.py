"""Contacts as rows of numbers, and the bodies and walls that meet in them: what a solve works on.

A partner is a body or a wall, in this order. A row keeps the frame of a contact: the normal n
from the second partner to the first, and tangents t₁, t₂ for which the Schur complement
S = W_tt - W_tn W_nt / W_nn of its 3 x 3 inverse mass W is diagonal.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import Flag
from particlerb.maths.vec3 import Bools, Floats, Ints

# Columns of `ImpulseRows.frame`
NORMAL: Final = 0
TANGENT: Final = 3  # and the other one at + 3
ARM: Final = 9  # [m] from the first partner to the point, and from the second one at + 3
INVERSE: Final = 15  # [1/kg] W_nn,
COUPLING: Final = 16  # W_n1, W_n2,
SCHUR: Final = 18  # S_11, S_22
LEAST_VELOCITY: Final = 20  # [m/s] least normal velocity after the solve
FRICTION: Final = 21  # [-] μ
SHARE: Final = 22  # [kg] of velocities in a sweep: 1/W_nn,
RUBBING: Final = 23  # 1/(max S + |W_nt|²/W_nn)
N_COLUMNS: Final = 24  # three lines of a cache

# Columns of `ImpulseRows.limits`
GAP: Final = 0  # [m] at the middle of the step; negative: an overlap
RESTITUTION: Final = 1
SLOW: Final = 2  # [m/s] what approaches no faster does not bounce
RADIUS: Final = 3  # [m] the smaller one
LEAN: Final = 4  # [m/s] what velocities along n, t₁, t₂ change by until the end: `rows.lean`
_N_LIMITS: Final = 7

LOCKED_SHARE: Final = 1e-9  # of an inverse mass or inertia without joints: below it these hold all
REST_KICKS: Final = 4.0  # half kicks: what comes no faster than two whole ones does not bounce

STOP, MOTOR, RUBS = 0, 1, 2  # kinds of rows of `Bounded`
# Columns of `Bounded.values`; impulses, and so what they belong to, along the coordinate
B_INVERSE: Final = 0  # W of the mechanism
B_WEIGHT: Final = 1  # of its square among those of contacts
B_LEAST: Final = 2  # rate without an impulse; -inf: any
B_MOST: Final = 3  # and inf
B_LARGEST: Final = 4  # impulse
B_GAP: Final = 5  # to the lower stop, and to the upper one at + 1
B_RESTITUTION: Final = 7
B_SLOW: Final = 8  # what comes no faster to a stop does not bounce
B_FORCE: Final = 9  # impulse of the last whole step over its length
B_IMPULSE: Final = 10
B_IMPACT: Final = 11
B_OLD: Final = 12  # before a sweep, or push-out so far
B_DIRECTION: Final = 13  # of the conjugate gradients
B_CHANGE: Final = 14  # c and
B_SLOPE: Final = 15  # K of Newton's method; then on which side a stop is overrun, and by how much
B_BEST: Final = 16  # impulse of the best solution so far
B_SHOWN: Final = 17  # impulse and impact of the last step over its length
B_LEAN: Final = 18  # what the rate changes by until the end: `bounded.lean_along`
_N_BOUNDED: Final = 19

# Numbers of a tally
STEPS: Final = 0  # steps in which something was near
SWEEPS: Final = 1
CONTACTS: Final = 2  # that were solved, of all steps together
UNMET: Final = 3  # steps that ended above the tolerance
RESIDUAL: Final = 4  # of the last step
WORST: Final = 5  # residual since the last frame
WORST_EVER: Final = 6
IMPACTS: Final = 7
IMPACT_WORK: Final = 8  # [J] of restitution and of friction in impacts
PRESSING_WORK: Final = 9  # [J] of normal impulses without restitution
FRICTION_WORK: Final = 10  # [J] of tangential ones
PUSH_OUT_WORK: Final = 11  # [J]
BOUNDARY_WORK: Final = 12  # [J] of walls and bodies that move as prescribed
DEEPEST: Final = 13  # [m] largest overlap
UNENDED: Final = 14  # steps whose impacts had not come to an end
DEEPEST_NOW: Final = 15  # [m] largest overlap since the last frame
NEWTON_STEPS: Final = 16
WALL_IMPACTS: Final = 17  # of events, as what follows
ELASTIC: Final = 18  # impacts made elastic by the contact time
GRAZING: Final = 19  # impacts that approached so slowly that they might as well not have happened
SMALLEST_GAP: Final = 20  # at an impact, over the smaller radius, where it is negative
LARGEST_GAP: Final = 21  # the same, where it is positive
CROSSINGS: Final = 22  # of bodies into other cells
RENEWED: Final = 23  # events whose partner had hit another body before
GROSS_WORK: Final = 24  # [J]
MOTOR_WORK: Final = 25  # [J] of motors with a largest torque or force
WORST_TIME: Final = 26  # [s] of WORST_EVER
TALLY: Final = 27

MIN_COLOURED: Final = 10_000  # contacts of a step from which on they have colours
_COLOURS: Final = 63  # at most: bits of a number
CHUNK: Final = 32  # contacts of a colour that one thread takes at once
LEAST_CELLS: Final = 4  # along a side of a periodic box: two bodies meet in one image alone
NEVER: Final = -1e300  # [m/s] least velocity of a contact that is left out of a solve


class ImpulseRules(NamedTuple):
    """How contacts are solved that have no stiffness."""

    restitution: Floats  # (n_pairs,) of materials
    torsion: Floats  # (n_pairs,) μ_t
    tolerance: float  # of the residual
    iterations: int  # sweeps at most
    push_out: float  # share of an overlap that is taken away in a step
    slop: float  # [m] overlap or gap that stays
    allowed: float  # [m] overlap that the case allows at t = 0
    newton: bool  # whether Newton's method goes on where sweeps do not end


class EventRules(NamedTuple):
    """How bodies collide at the instants of their impacts."""

    restitution: Floats  # (n_pairs,) of materials
    contact_time: float  # [s] a contact that hits again within it bounces elastically
    box: Floats  # (3,) [m] sides of the periodic box, inf: it has no end


class Mechanisms(NamedTuple):
    """Partners that joints hold together: what an impulse on one does to the velocities of all.

    The velocities keep the joints, whatever the impulse: (M⁻¹ - M⁻¹ Gᵀ A⁻¹ G M⁻¹) p with the rows G
    of the joints and A = G M⁻¹ Gᵀ. `joints.responses` fills the matrices.
    """

    number: Ints  # (partners,) which mechanism; -1: no joint holds it, or nothing moves it
    local: Ints  # (partners,) number among the members of its mechanism
    member: Ints  # (n,) partners of all mechanisms, one after the other
    first: Ints  # (k + 1,) where each begins there,
    start: Ints  # (k,) and its matrix in `response`, six rows and columns for each member
    response: Floats  # [1/kg, 1/(kg m), 1/(kg m²)]
    is_known: Bools  # (partners,) whether its rows are those of this step


class Partners(NamedTuple):
    """Bodies and walls, (n + n_walls, ..)."""

    velocity: Floats  # (.., 6) [m/s, rad/s] of the centre of mass, and angular; world axes
    before: Floats  # (.., 18) before the kick; v̇ [m/s²], ω̇ [rad/s²] without forces; by drives
    free: Floats  # (.., 6) after it, without impulses of the solve
    inverse: Floats  # (.., 7) [1/kg, 1/(kg m²)] mass; xx, xy, xz, yy, yz, zz of the inertia
    move: Floats  # (.., 6) [m, rad] by which they are pushed out
    has_moved: Bools  # (..,) whether anything has
    position: Floats  # (.., 3) [m] centre of mass, or origin of the wall's frame
    reach: Floats  # (.., 1) [m] that any point comes in a step, at most
    speeds: Floats  # (.., 4) |v|, |ω|, and by how much half a kick has changed both
    impulse: Floats  # (.., 6) [N s, N m s] not yet in the momenta; impulse and angular impulse
    external: Floats  # (.., 8) work, impulse, angular impulse of a step, gross work
    used: Ints  # (..,) colours of its contacts so far, a bit each
    mechanisms: Mechanisms | None  # None: no joint holds any
    keeps_kick: Flag  # whether forces without potential act where there are no joints


class Bounded(NamedTuple):
    """Rows along coordinates of joints: see `bounded`; the world is `partner_a`, no gradient."""

    kind: Ints  # (k,) STOP, MOTOR or RUBS
    partner_a: Ints  # (k,) partners
    partner_b: Ints  # (k,)
    start: Ints  # (k + 1,) where what each moves begins in the next two
    member: Ints  # partners of its mechanism, and
    response: Floats  # (.., 6) [m/s, rad/s] what a unit impulse does to their velocities
    gradient: Floats  # (k, 12) by the velocities of both
    values: Floats  # (k, 19)


class Rolling(NamedTuple):
    """Resistance of contacts to rolling and spinning, see `rolling`: room as in `ImpulseRows`."""

    # (.., 7) μ_r R* [m], λ [1/(kg m²)] across the normal; about it; [rad/s] of drives
    limit: Floats
    impulse: Floats  # (.., 3) [N m s] along n, t₁, t₂, on the first; world axes until the solve
    impact: Floats  # (.., 3) [N m s] the same of impacts
    old: Floats  # (.., 3) before a sweep
    direction: Floats  # (.., 3) of the conjugate gradients
    slopes: Floats  # (.., 10) of Newton's method, see `rolling_newton`


class Colours(NamedTuple):
    """Which contacts threads may solve side by side, see `colours`: room as in `ImpulseRows`."""

    counts: Ints  # (2,) colours of this step; from how many contacts on there are several
    size: Ints  # (COLOURS,) contacts of each
    chunk: Ints  # (COLOURS + 1,) where chunks of each begin
    row: Ints  # (..,) where contacts of each chunk begin
    sums: Floats  # (.., 4) of chunks; a column is free again behind the next meeting
    listed: Ints  # (.., 4) first, second, entry and colour in the order of the lists


class ImpulseRows(NamedTuple):
    """Contacts of a step: room for `partner_a.size`."""

    partner_a: Ints  # partner
    partner_b: Ints
    entry: Ints  # k of the list of spheres, ~k of the list of walls
    frame: Floats  # (.., 24)
    limits: Floats  # (.., 7)
    impulse: Floats  # (.., 3) [N s] along n, t₁, t₂, on `partner_a`
    impact: Floats  # (.., 3) [N s] the same of impacts
    old: Floats  # (.., 3) before a sweep, and shares of the push-out
    direction: Floats  # (.., 3) of the conjugate gradients
    order: Floats  # (.., 2) of impacts: since when [s], and which
    colours: Colours
    bounded: Bounded | None = None  # None: nothing acts in joints within bounds
    rolling: Rolling | None = None  # None: nothing resists rolling or spinning


class Newton(NamedTuple):
    """Bodies that move as unknowns of Newton's method: nothing where it is not taken."""

    first_row: Ints  # (partners,) of its six in the matrix; -1: it does not move
    cluster: Ints  # (partners,) those of one number may act on each other; -1
    bandwidth: Ints  # (1,) columns beside the diagonal
    matrix: Floats  # (6 n, 3 bandwidth + 1) band
    change: Floats  # (6 n,) [N s, N m s] what bodies get of contacts
    slopes: Floats  # (rows, 12) step of an impulse, c and the rows of K, see `newton`
    clusters: Floats  # (n_clusters, 4) |F|², |F| that was best, share of a step, state
    best: Floats  # (rows, 6) [N s, N m s] impulses of the best solution so far


class Impulses(NamedTuple):
    """All that a solve needs."""

    rules: ImpulseRules
    partners: Partners
    rows: ImpulseRows
    # (2,) contacts of this step; k that is going to be too deep, -2 - k that bears too much, or -1
    counts: Ints
    tally: Floats  # (TALLY,) sums since the segment began
    newton: Newton


def room_for_partners(
    n: int, mechanisms: Mechanisms | None = None, keeps_kick: Flag = None
) -> Partners:
    """Room for n bodies and walls."""
    velocity, before, free, inverse, move = (np.zeros((n, width)) for width in (6, 18, 6, 7, 6))
    position, reach, speeds, impulse, external = (np.zeros((n, width)) for width in (3, 1, 4, 6, 8))
    has_moved, used = np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.int64)
    arrays = velocity, before, free, inverse, move, has_moved, position, reach, speeds
    return Partners(*arrays, impulse, external, used, mechanisms, keeps_kick)


def _room_for_colours(n: int) -> Colours:
    """Room for the colours of n contacts; at first all are one chunk."""
    size, chunk = np.zeros(_COLOURS, dtype=np.int64), np.zeros(_COLOURS + 1, dtype=np.int64)
    row, listed = np.zeros(n + 2, dtype=np.int64), np.zeros((n, 4), dtype=np.int64)
    chunk[1], row[1] = 1, n
    return Colours(np.array([1, MIN_COLOURED]), size, chunk, row, np.zeros((n + 1, 4)), listed)


def room_for_rows(
    n: int, bounded: Bounded | None = None, with_rolling: bool = False
) -> ImpulseRows:
    """Room for n contacts."""
    first, second, entry = np.zeros((3, n), dtype=np.int64)
    frame, limits = np.zeros((n, N_COLUMNS)), np.zeros((n, _N_LIMITS))
    impulse, impact, old, direction = np.zeros((4, n, 3))
    order = np.zeros((n + (1 if bounded is None else 1 + bounded.kind.size), 2))
    arrays = first, second, entry, frame, limits, impulse, impact, old, direction, order
    widths = (7, 3, 3, 3, 3, 10) if with_rolling else ()
    rolling = Rolling(*(np.zeros((n, width)) for width in widths)) if widths else None
    return ImpulseRows(*arrays, _room_for_colours(n), bounded, rolling)


def room_for_bounded(kind: Ints, first: Ints, second: Ints, members: list[Ints]) -> Bounded:
    """Room for rows between two partners each, that move these."""
    start = np.cumsum([0, *(bodies.size for bodies in members)])
    response, k = np.zeros((start[-1], 6)), kind.size
    gradient, values = np.zeros((k, 12)), np.zeros((k, _N_BOUNDED))
    return Bounded(kind, first, second, start, np.concatenate(members), response, gradient, values)
