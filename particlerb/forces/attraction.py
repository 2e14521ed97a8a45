"""Newton's attraction between the particles of different bodies, summed pair by pair.

Particle i of body a, at x_i, is attracted by all particles j that are not of a; ε softens:

    g_i = Σ_j G m_j d/(d² + ε²)^{3/2},  d = x_j - x_i,
    F_a = Σ_i m_i g_i,  τ_a = Σ_i (R r_i) × m_i g_i,  U = -½ Σ_i Σ_j G m_i m_j/√(d² + ε²).

F and τ are the exact derivatives of U. An evaluation has three parts: `place_points` turns bodies
into points, `attract` finds the field at these, `add_attraction` collects the loads. Targets of the
field lie in the lanes of SIMD registers and meet one source after another; tiles of targets can be
spread over threads, and a target meets its sources in the same order however they are. Source of
the softened potential: Plummer, Monthly Notices of the RAS 71, 460 (1911).
"""

import math
import struct
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, Final, NamedTuple, cast

import numpy as np

from particlerb.compiled.instructions import BITS, instruction
from particlerb.compiled.jit import inline, kernel
from particlerb.compiled.threads import THREADS
from particlerb.maths.quaternion import matrix, turn
from particlerb.maths.rows import column3, column4, put_column3, rows3, rows4
from particlerb.maths.vec3 import Floats, Ints, Rows3, Vec3, add_scaled, cross, scale, subtract
from particlerb.model.block import CACHE_LINE, aligned_zeros
from particlerb.model.superblocks import Range
from particlerb.model.worlds import Worlds
from particlerb.ranks import ALONE, Ranks, ending_all

TILE: Final = 256  # targets at a time: their places and fields stay in the first level of cache
_PAIRS_PER_BODY_STEP: Final = 64  # of work, the unit of it in `threads`
_INVERSE_ROOT_MAGIC: Final = 0x5FE2220000000000  # less half the bits of x: those of about x^{-1/2}


class Attraction(NamedTuple):
    """Particles of a group of bodies that attract those of other bodies."""

    arm: Floats  # (3, n_points) [m], rotor frame of the particle's body, from its centre of mass
    mass: Floats  # (n_points,) [kg]
    gm: Floats  # (n_points,) [m³/s²], G times the mass
    offset: Ints  # (n_bodies + 1,), particles of body b are offset[b] to offset[b + 1]
    softening: float  # [m²] ε², added to every squared distance


class Fields(NamedTuple):
    """What an evaluation writes; rows are padded to whole lines of the cache."""

    arm: Floats  # (3, n_padded) [m], from the centre of mass of the particle's body, world axes
    point: Floats  # (3, n_padded) [m], world frame
    field: Floats  # (3, n_padded) [m/s²], acceleration by all other bodies, world axes
    depth: Floats  # (n_padded,) [m²/s²], minus the potential of all other bodies
    body: Ints  # (n_padded,) body of each particle, -1 beyond the last; is not written
    order: Ints  # (n_bodies,) which of the group each body is, likewise
    tile: Ints  # (n_tiles, 4) targets and sources, each from first to end, likewise
    first_tile: Ints  # (n_worlds,) of each world, likewise


def fields_of(attraction: Attraction, worlds: Worlds | None = None) -> Fields:
    """Room for evaluations of these particles; of worlds, whose bodies stand one after the other.

    Targets meet the sources of their world alone.
    """
    n, offset = attraction.mass.size, attraction.offset
    order = np.arange(offset.size - 1) if worlds is None else worlds.bodies.ravel()
    ends = offset[:: order.size if worlds is None else worlds.bodies.shape[1]].tolist()
    tiles = [
        (lo, min(lo + TILE, end), first, end)
        for first, end in pairwise(ends)
        for lo in range(first, end, TILE)
    ]
    # An odd number: rows that a power of two parts collide.
    padded = (-(-n // CACHE_LINE) | 1) * CACHE_LINE
    arm, point, field = (aligned_zeros(3 * padded).reshape(3, padded) for _ in range(3))
    body = np.full(padded, -1)
    body[:n] = np.repeat(np.arange(offset.size - 1), np.diff(offset))
    of_tiles = np.array(tiles, dtype=np.int64).reshape(-1, 4)
    first_tile = np.searchsorted(of_tiles[:, 0], ends[:-1])
    depth = aligned_zeros(padded)
    return Fields(arm, point, field, depth, body, order, of_tiles, first_tile)


# Powers of a squared distance


def _plain_seed(x: float) -> float:
    """About x^{-1/2}."""
    bits = _INVERSE_ROOT_MAGIC - (struct.unpack("<q", struct.pack("<d", x))[0] >> 1)
    return cast(float, struct.unpack("<d", struct.pack("<q", bits))[0])


@instruction(_plain_seed)
def seed(builder: Any, x: Any) -> Any:
    """About x^{-1/2} of a normal x > 0: the bits of a double are, roughly, its logarithm."""
    bits = builder.lshr(builder.bitcast(x, BITS), BITS(1))
    return builder.bitcast(builder.sub(BITS(_INVERSE_ROOT_MAGIC), bits), x.type)


@inline
def _rough_inverse_root(x: float) -> float:
    """x^{-1/2} to 2.1e-5, of a normal x > 0, without the slow instructions √ and /.

    With y = seed(x) the product z = x y² is within [0.633, 0.720] for every x; there z² - 2.2533 z
    + 2.2825 is the best polynomial for z^{-1/2} of those whose square has no factor, which holds
    for this seed alone.
    """
    y = seed(x)
    z = x * (y * y) - 1.12665326
    return y * (z * z + 1.01317212)


@inline
def inverse_root(x: float) -> float:
    """x^{-1/2}: with 1 - e = x y² it is y (1 - e)^{-1/2}, by the series in e, |e| < 4.1e-5."""
    y = _rough_inverse_root(x)
    e = 1.0 - x * (y * y)
    return y + y * (e * (0.5 + e * (0.375 + e * 0.3125)))


@inline
def inverse_cube(size: float, x: float) -> float:
    """size x^{-3/2}: with 1 - e = x y² it is y³ size (1 - e)^{-3/2}.

    The factors with `size` are those of a source, computed once for all its targets.
    """
    y = _rough_inverse_root(x)
    square = y * y
    e = 1.0 - x * square
    return y * square * (size + e * (1.5 * size + e * (1.875 * size + e * (2.1875 * size))))


@inline
def squared(d: Vec3, softening: float) -> float:
    """d² + ε²."""
    return d[0] * d[0] + (d[1] * d[1] + (d[2] * d[2] + softening))


# Bodies to points


def _place(attraction: Attraction, fields: Fields, y: Floats, first: int, end: int) -> None:
    """Place the particles of bodies first to end: x = com + R r.

    Parameters
    ----------
    attraction, fields : Attraction, Fields
        Particles, and the arrays whose arms and points are written.
    y : ndarray, shape (13, n_bodies)
        Centre of mass [m], unit quaternion from rotor frame to world; the rest is not used.
    first, end : int
        Bodies, end excluded.
    """
    local, _, _, offset, _ = attraction
    arm, point = fields.arm, fields.point
    com, q = rows3(y, 0, y.shape[1]), rows4(y[3:7], 0, y.shape[1])
    for k in range(first, end):
        b, lo, hi = fields.order[k], offset[k], offset[k + 1]
        r, arms, points = rows3(local, lo, hi), rows3(arm, lo, hi), rows3(point, lo, hi)
        x, R = column3(com, b), matrix(column4(q, b))
        for i in range(hi - lo):
            turned = turn(R, column3(r, i))
            put_column3(arms, i, turned)
            put_column3(points, i, add_scaled(1.0, turned, x))


place_particles, place_points = inline(_place), kernel(_place)


# Field at the points


@inline
def _add_field(x: Vec3, gm: float, softening: float, targets: Rows3, fields: Rows3, n: int) -> None:
    """Add the field of a source at x to that at n targets."""
    for i in range(n):
        d = subtract(x, column3(targets, i))
        w = inverse_cube(gm, squared(d, softening))
        put_column3(fields, i, add_scaled(w, d, column3(fields, i)))


@inline
def add_near_source(
    x: Vec3, gm: float, owner: float, softening: float, targets: Rows3, fields: Rows3,
    bodies: Floats | Ints,
) -> None:  # fmt: skip
    """Add the field of a source at x to that at targets, except those of its own body."""
    for i in range(bodies.size):
        is_own = bodies[i] == owner
        d = subtract(x, column3(targets, i))
        w = inverse_cube(gm, 1.0 if is_own else squared(d, softening))
        put_column3(fields, i, add_scaled(0.0 if is_own else w, d, column3(fields, i)))


@inline
def _tile_of(fields: Fields, tile: int) -> tuple[int, int, int, int]:
    """Targets and sources of a tile, each from first to end."""
    bounds = fields.tile[tile]
    return bounds[0], bounds[1], bounds[2], bounds[3]


def _find_fields(attraction: Attraction, fields: Fields, first: int, end: int) -> None:
    """Write the field at the particles of tiles first to end, end excluded.

    Sources are cut into those before the bodies that a tile touches, those of these bodies, where
    each target leaves out its own, and those after.
    """
    _, _, gm, offset, softening = attraction
    point, field, body = fields.point, fields.field, fields.body
    sources = rows3(point, 0, gm.size)
    for tile in range(first, end):
        lo, hi, first_source, end_source = _tile_of(fields, tile)
        targets, accelerations, bodies = rows3(point, lo, hi), rows3(field, lo, hi), body[lo:hi]
        for i in range(hi - lo):
            accelerations[0][i], accelerations[1][i], accelerations[2][i] = 0.0, 0.0, 0.0
        before, after = offset[body[lo]], offset[body[hi - 1] + 1]
        for j in range(first_source, before):
            _add_field(column3(sources, j), gm[j], softening, targets, accelerations, hi - lo)
        if body[lo] != body[hi - 1]:
            for j in range(before, after):
                x = column3(sources, j)
                add_near_source(x, gm[j], body[j], softening, targets, accelerations, bodies)
        for j in range(after, end_source):
            _add_field(column3(sources, j), gm[j], softening, targets, accelerations, hi - lo)


pull, attract = inline(_find_fields), kernel(_find_fields)


# Loads on the bodies


def _collect(attraction: Attraction, fields: Fields, load: Floats, first: int, end: int) -> None:
    """Add force and torque of bodies first to end: Σ m g and Σ R r × m g.

    Parameters
    ----------
    attraction, fields : Attraction, Fields
        Particles, with arms and field.
    load : ndarray, shape (rows, n_bodies) [N, N m]
        Force in rows 0 to 2, torque about the centre of mass in rows 3 to 5, world axes.
    first, end : int
        Bodies, end excluded.
    """
    _, mass, _, offset, _ = attraction
    arms, accelerations = rows3(fields.arm, 0, mass.size), rows3(fields.field, 0, mass.size)
    forces, torques = rows3(load, 0, load.shape[1]), rows3(load[3:6], 0, load.shape[1])
    for k in range(first, end):
        b, F, tau = fields.order[k], (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for i in range(offset[k], offset[k + 1]):
            force = scale(mass[i], column3(accelerations, i))
            F = add_scaled(1.0, force, F)
            tau = add_scaled(1.0, cross(column3(arms, i), force), tau)
        put_column3(forces, b, add_scaled(1.0, F, column3(forces, b)))
        put_column3(torques, b, add_scaled(1.0, tau, column3(torques, b)))


collect, add_attraction = inline(_collect), kernel(_collect)


@kernel
def attraction_loads(
    attraction: Attraction | None, fields: Fields | None, y: Floats, load: Floats
) -> None:
    """Add the loads on n bodies at y (13, n), if any attract: all parts, by this thread alone.

    The parts stand in this kernel themselves: a call with so many arrays takes as long as two pairs
    of points.
    """
    if attraction is None or fields is None:
        return
    n_bodies = attraction.offset.size - 1
    place_particles(attraction, fields, y, 0, n_bodies)
    pull(attraction, fields, 0, len(fields.tile))
    collect(attraction, fields, load, 0, n_bodies)


def spread_loads(
    attraction: Attraction, fields: Fields, y: Floats, load: Floats, ranks: Ranks = ALONE
) -> None:
    """Add the loads on n bodies at y (13, n), tiles spread over ranks and threads; same bits."""
    n_bodies = attraction.offset.size - 1
    with ending_all(ranks):
        THREADS.alone(place_points, attraction, fields, y, 0, n_bodies)
        first, stop = _spread_tiles(partial(attract, attraction, fields), fields, ranks)
        _share(fields.field, int(fields.tile[first, 0]), int(fields.tile[stop - 1, 1]), ranks)
        THREADS.alone(add_attraction, attraction, fields, load, 0, n_bodies)


def _spread_tiles(part: Callable[[int, int], object], fields: Fields, ranks: Ranks) -> Range:
    """Call part(first, end) for ranges of tiles that cover those of this rank; which these are."""
    n = len(fields.tile)
    tiles = Range(n * ranks.number // ranks.count, n * (ranks.number + 1) // ranks.count)
    lo, hi, first, end = fields.tile[slice(*tiles)].T
    n_pairs = int((hi - lo) @ (end - first))
    shifted = (lambda lo, hi: part(tiles.first + lo, tiles.first + hi)) if tiles.first else part
    THREADS.share(shifted, tiles.stop - tiles.first, n_pairs // _PAIRS_PER_BODY_STEP)
    return tiles


def _share(values: Floats, first: int, stop: int, ranks: Ranks) -> None:
    """Fill in the columns of other ranks, where this one has found those of a range."""
    if ranks.count > 1:
        columns = np.ascontiguousarray(values[..., first:stop].T)
        gathered = np.concatenate(ranks.sent([columns] * ranks.count))
        values[..., : len(gathered)] = gathered.T


# Energy


@kernel
def attraction_potential(
    attraction: Attraction, fields: Fields, first: int, end: int, sums: Floats
) -> None:
    """Write the potential energy of tiles first to end: -½ Σ_i m_i Σ_j G m_j/√(d² + ε²).

    Parameters
    ----------
    attraction, fields : Attraction, Fields
        Particles, with points; the depth of the potential is written.
    first, end : int
        Tiles, end excluded.
    sums : ndarray, shape (n_tiles,) [J]
        One for each tile is written; their sum is U, every pair in halves.
    """
    _, mass, gm, _, softening = attraction
    point, depth, body = fields.point, fields.depth, fields.body
    sources = rows3(point, 0, gm.size)
    for tile in range(first, end):
        lo, hi, first_source, end_source = _tile_of(fields, tile)
        targets, depths, bodies = rows3(point, lo, hi), depth[lo:hi], body[lo:hi]
        depths[:] = 0.0
        for j in range(first_source, end_source):
            x = column3(sources, j)
            for i in range(hi - lo):
                is_own = bodies[i] == body[j]
                square = squared(subtract(x, column3(targets, i)), softening)
                inverse = inverse_root(1.0 if is_own else square)
                depths[i] += gm[j] * (0.0 if is_own else inverse)
        total = 0.0
        for i in range(lo, hi):
            total += mass[i] * depth[i]
        sums[tile] = -0.5 * total


def potential_energy(
    attraction: Attraction, fields: Fields, y: Floats, worlds: Worlds | None = None,
    ranks: Ranks = ALONE,
) -> Floats | float:  # fmt: skip
    """U of all pairs of different bodies [J] at y, (13, n_bodies); tiles spread as for loads.

    In each world, (n_worlds,), if there are several.
    """
    sums = np.zeros(len(fields.tile))
    with ending_all(ranks):
        THREADS.alone(place_points, attraction, fields, y, 0, attraction.offset.size - 1)

        def part(first: int, end: int) -> None:
            attraction_potential(attraction, fields, first, end, sums)

        tiles = _spread_tiles(part, fields, ranks)
        _share(sums, tiles.first, tiles.stop, ranks)
    if worlds is None:
        return math.fsum(sums)
    return np.array([math.fsum(world) for world in np.split(sums, fields.first_tile[1:])])
