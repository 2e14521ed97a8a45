"""Compensated sums over particles at the speed of memory: mass, first and second moments.

Each particle is read once. Sums run in LANES lanes, each with its own rounding error carried along,
so that neighbouring particles fill SIMD registers; lanes, then chunks of a fixed size are joined in
a fixed order, so that any number of threads gives the same bits. Second moments need an origin
near the centre of mass: it is guessed from a sample, the parallel axis theorem removes what it is
off, and where that would cost digits, the kind is summed again from the com so found. So the cost
is one reading for almost all sets and the accuracy that of two.
"""

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline, unfused_kernel, unsigned
from particlerb.compiled.threads import THREADS
from particlerb.geometry.particles import Particles, check, refuse
from particlerb.maths.vec3 import Bools, Floats, Ints, add_scaled, dot

_Sum: TypeAlias = tuple[float, float]

_LANES: Final = 16
_CHUNK_PARTICLES: Final = 16384  # that are summed by one thread without a stop
_SAMPLE_PARTICLES: Final = 128  # of a kind from which origin and scale are guessed
_MAX_OFFSET: Final = 1 / 4  # |com|² over the square of the size, to which the origin stays
_GOLDEN_RATIO_INVERSE: Final = 0.6180339887498949
_MAX_PASSES: Final = 3  # readings of a kind
_SPARE: Final = 200  # powers of two that the guessed scale may be off the largest value
_N_SUMS: Final = 11  # M, Σ m r (3), Σ m r rᵀ (xx yy zz xy xz yz), Σ (2/5) m radius²
_LOW: Final = _N_SUMS  # rows of rounding errors
_EXTENT_ROW: Final = 2 * _N_SUMS  # largest coordinate or radius of what has mass
_HEAVIEST_ROW: Final = _EXTENT_ROW + 1
SMALLEST: Final = _EXTENT_ROW + 2  # smallest mass or radius: below 0 is an error
_BAD: Final = _EXTENT_ROW + 3  # 0, or NaN where a number is not finite
_N_ROWS: Final = _EXTENT_ROW + 4
X: Final = _N_ROWS  # rows of the group at hand: r, mass, radius
_BUFFER_SIZE: Final = (_N_ROWS + 5) * _LANES


class _Sums(NamedTuple):
    """Scaled sums of kinds: lengths in units of 2^exponent[:, 0], masses of 2^exponent[:, 1]."""

    moments: Floats  # (n, SUMS) about the com but for column 1 to 3, which are the com
    exponent: Ints  # (n, 2)


def sums_of(particles: Particles) -> _Sums:
    """Sums of every kind.

    Raises
    ------
    ValueError
        If a kind has no particles, a negative mass or radius, a number that is not finite, or no
        mass; the message names the kind.
    """
    position, mass, radius, offset = particles
    count = np.diff(offset)
    refuse(count < 1, "no particles")
    n = len(count)
    origin, exponent = np.empty((n, 3)), np.empty((n, 2), dtype=np.int64)
    arrays = (np.ascontiguousarray(position).reshape(-1), mass, radius)
    _guess(*arrays, offset, origin, exponent)
    moments, kinds = np.empty((n, _N_SUMS)), np.arange(n)
    for remaining in range(_MAX_PASSES - 1, -1, -1):
        chunks = _chunks_of(offset, kinds)
        rows = np.empty((len(chunks), _N_ROWS))

        def work(first: int, end: int, chunks: Ints = chunks, rows: Floats = rows) -> None:
            _sum_chunks(*arrays, chunks, origin, exponent, rows, first, end)

        THREADS.share(work, len(chunks), int(count[kinds].sum()) // 16)
        has_mass = np.bincount(chunks[:, 0], rows[:, _HEAVIEST_ROW], n)[kinds] > 0.0
        is_right = (rows[:, SMALLEST] >= 0.0) & (rows[:, _BAD] == 0.0)
        if not (has_mass.all() and is_right.all()):
            check(particles)
        again = np.zeros(n, dtype=np.bool_)
        join(chunks, rows, origin, exponent, moments, again)
        kinds = np.flatnonzero(again)
        if remaining == 0 or kinds.size == 0:
            break
    return _Sums(moments, exponent)


def _chunks_of(offset: Ints, kinds: Ints) -> Ints:
    """Kind, first and last particle (excluded) of chunks of the given kinds, (n, 3)."""
    count = -(-(offset[kinds + 1] - offset[kinds]) // _CHUNK_PARTICLES)
    kind = np.repeat(kinds, count)
    first = np.arange(len(kind)) - np.repeat(np.cumsum(count) - count, count)
    low = offset[kind] + first * _CHUNK_PARTICLES
    return np.stack([kind, low, np.minimum(low + _CHUNK_PARTICLES, offset[kind + 1])], axis=1)


@inline
def _sampled(lo: int, n: int, s: int) -> int:
    """Number s of a sample that follows no period of the list; all of a short list, in order."""
    if n <= _SAMPLE_PARTICLES:
        return lo + s
    return lo + int(n * ((s * _GOLDEN_RATIO_INVERSE) % 1.0))


@unfused_kernel
def _guess(
    place: Floats, mass: Floats, radius: Floats, offset: Ints, origin: Floats, exponent: Ints
) -> None:
    """Origin (scaled) and scales of every kind from a sample.

    The origin is that of the coordinates where the com is not far from it by the size of the set:
    sums of symmetric sets about their centre are then 0 to the bit.
    """
    for k in range(len(offset) - 1):
        lo, n = offset[k], offset[k + 1] - offset[k]
        taken = min(n, _SAMPLE_PARTICLES)
        extent = heaviest = 0.0
        for s in range(taken):
            i = _sampled(lo, n, s)
            if mass[i] > 0.0:
                heaviest = max(heaviest, mass[i])
                extent = max(extent, abs(place[3 * i]), abs(place[3 * i + 1]))
                extent = max(extent, abs(place[3 * i + 2]), radius[i])
        exponent[k, 0], exponent[k, 1] = _power_above(extent), _power_above(heaviest)
        per_length = math.ldexp(1.0, -int(exponent[k, 0]))
        per_mass = math.ldexp(1.0, -int(exponent[k, 1]))
        M = far = 0.0
        c = (0.0, 0.0, 0.0)
        for s in range(taken):
            i = _sampled(lo, n, s)
            m = mass[i] * per_mass
            p = (place[3 * i], place[3 * i + 1], place[3 * i + 2])
            p = (p[0] * per_length, p[1] * per_length, p[2] * per_length)
            M += m
            far += m * dot(p, p)
            c = add_scaled(m, p, c)
        per_mass = 1.0 / M if M > 0.0 else 0.0
        c = (c[0] * per_mass, c[1] * per_mass, c[2] * per_mass)
        offset_squared = dot(c, c)
        is_off = offset_squared > _MAX_OFFSET * (far * per_mass - offset_squared)
        for axis in range(3):
            origin[k, axis] = c[axis] if is_off and offset_squared < math.inf else 0.0


@inline
def _power_above(value: float) -> int:
    """Power of two above a number, −1000 at least; 0 of what is no number."""
    return max(math.frexp(value)[1], -1000) if value < math.inf else 0


# Lanes


@inline
def at(row: int, lane: int) -> int:
    """Index of a lane in a row: unsigned, so that Numba asks not whether it is negative."""
    return unsigned(row * _LANES + lane)


@inline
def add(total: _Sum, term: float) -> _Sum:
    """total + term with the rounding error carried along, whichever of the two is larger.

    Source: two-sum, Knuth, The Art of Computer Programming 2, 3rd ed., 4.2.2, theorem B.
    """
    high, low = total
    s = high + term
    z = s - high
    return s, low + ((high - (s - z)) + (term - z))


@inline
def put(lanes: Floats, row: int, lane: int, term: float) -> None:
    """Add a term to a sum of one lane."""
    high, low = add((lanes[at(row, lane)], lanes[at(_LOW + row, lane)]), term)
    lanes[at(row, lane)], lanes[at(_LOW + row, lane)] = high, low


@inline
def load(
    lanes: Floats, lane: int, x: float, y: float, z: float, m: float, r: float, units: Floats
) -> None:
    """Write one particle into its lane: scaled, from the origin; note its size and faults."""
    lanes[at(_BAD, lane)] += ((x - x) + (y - y)) + ((z - z) + (m - m)) + (r - r)
    lanes[at(SMALLEST, lane)] = min(lanes[at(SMALLEST, lane)], m, r)
    lanes[at(_HEAVIEST_ROW, lane)] = max(lanes[at(_HEAVIEST_ROW, lane)], m)
    size = max(abs(x), abs(y), abs(z), r) if m > 0.0 else 0.0
    lanes[at(_EXTENT_ROW, lane)] = max(lanes[at(_EXTENT_ROW, lane)], size)
    lanes[at(X, lane)] = x * units[0] - units[2]
    lanes[at(X + 1, lane)] = y * units[0] - units[3]
    lanes[at(X + 2, lane)] = z * units[0] - units[4]
    lanes[at(X + 3, lane)] = m * units[1]
    lanes[at(X + 4, lane)] = r * units[0]


@inline
def _add_group(lanes: Floats) -> None:
    """Add the particles of all lanes to the sums."""
    for lane in range(_LANES):
        m, x = lanes[at(X + 3, lane)], lanes[at(X, lane)]
        y, z, r = lanes[at(X + 1, lane)], lanes[at(X + 2, lane)], lanes[at(X + 4, lane)]
        mx, my, mz = m * x, m * y, m * z
        put(lanes, 0, lane, m)
        put(lanes, 1, lane, mx)
        put(lanes, 2, lane, my)
        put(lanes, 3, lane, mz)
        put(lanes, 4, lane, mx * x)
        put(lanes, 5, lane, my * y)
        put(lanes, 6, lane, mz * z)
        put(lanes, 7, lane, mx * y)
        put(lanes, 8, lane, mx * z)
        put(lanes, 9, lane, my * z)
        put(lanes, 10, lane, 0.4 * m * r * r)


@unfused_kernel
def _sum_chunks(
    place: Floats,
    mass: Floats,
    radius: Floats,
    chunks: Ints,
    origin: Floats,
    exponent: Ints,
    rows: Floats,
    first: int,
    end: int,
) -> None:
    """Sums of the chunks first to end, high parts, then low parts, and what was noted."""
    lanes, units = np.empty(_BUFFER_SIZE), np.empty(5)
    for c in range(first, end):
        k, lo, hi = chunks[c]
        units[0] = math.ldexp(1.0, -int(exponent[k, 0]))
        units[1] = math.ldexp(1.0, -int(exponent[k, 1]))
        units[2], units[3], units[4] = origin[k, 0], origin[k, 1], origin[k, 2]
        lanes[:] = 0.0
        full = lo + (hi - lo) // _LANES * _LANES
        for start in range(lo, full, _LANES):
            x = place[3 * start : 3 * (start + _LANES)]
            m, r = mass[start : start + _LANES], radius[start : start + _LANES]
            for lane in range(_LANES):
                i = unsigned(3 * lane)
                j = unsigned(lane)
                load(lanes, lane, x[i], x[i + unsigned(1)], x[i + unsigned(2)], m[j], r[j], units)
            _add_group(lanes)
        if full < hi:
            lanes[X * _LANES :] = 0.0
            for lane in range(hi - full):
                i = full + lane
                x0, y0, z0 = place[3 * i], place[3 * i + 1], place[3 * i + 2]
                load(lanes, lane, x0, y0, z0, mass[i], radius[i], units)
            _add_group(lanes)
        rows[c, :_EXTENT_ROW] = 0.0
        for lane in range(_LANES):  # rows inside: additions that need not wait for each other
            for row in range(_N_SUMS):
                total = add((rows[c, row], rows[c, _LOW + row]), lanes[row * _LANES + lane])
                rows[c, row], rows[c, _LOW + row] = add(total, lanes[(_LOW + row) * _LANES + lane])
        for row in range(_EXTENT_ROW, _N_ROWS):
            value = 0.0
            for lane in range(_LANES):
                of_lane = lanes[row * _LANES + lane]
                if row == _BAD:
                    value += of_lane
                else:
                    value = min(value, of_lane) if row == SMALLEST else max(value, of_lane)
            rows[c, row] = value


@unfused_kernel
def join(
    chunks: Ints, rows: Floats, origin: Floats, exponent: Ints, moments: Floats, again: Bools
) -> None:
    """Sums of kinds about their com from those of their chunks; say which to sum again, from where.

    With d = Σ m r / M the com is origin + d, and Σ m r rᵀ loses M d dᵀ. The sums stand unless they
    were larger than what is left of them, or their scale was far off.
    """
    c = 0
    while c < len(chunks):
        k, total, extent, heaviest = chunks[c, 0], np.zeros((_N_SUMS, 2)), 0.0, 0.0
        while c < len(chunks) and chunks[c, 0] == k:
            for row in range(_N_SUMS):
                high, low = add((total[row, 0], total[row, 1]), rows[c, row])
                total[row, 0], total[row, 1] = add((high, low), rows[c, _LOW + row])
            extent = max(extent, rows[c, _EXTENT_ROW])
            heaviest = max(heaviest, rows[c, _HEAVIEST_ROW])
            c += 1
        M = total[0, 0] + total[0, 1]
        x, y, z = total[1, 0] + total[1, 1], total[2, 0] + total[2, 1], total[3, 0] + total[3, 1]
        d = (x / M, y / M, z / M)
        moments[k, 0] = M
        for axis in range(3):  # slices would be compiled with the words of their errors: 2 s
            moments[k, 1 + axis] = origin[k, axis] + d[axis]
        for row, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
            moments[k, 4 + row] = total[4 + row, 0] + (total[4 + row, 1] - M * d[a] * d[b])
        moments[k, 10] = total[10, 0] + total[10, 1]
        e_length, e_mass = _power_above(extent), _power_above(heaviest)
        is_far = abs(e_length - exponent[k, 0]) > _SPARE or abs(e_mass - exponent[k, 1]) > _SPARE
        spread = moments[k, 4] + moments[k, 5] + moments[k, 6]
        off = M * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        if is_far:
            exponent[k, 0], exponent[k, 1] = e_length, e_mass
            origin[k, 0] = origin[k, 1] = origin[k, 2] = 0.0
        elif off > spread:
            for axis in range(3):
                origin[k, axis] = moments[k, 1 + axis]
        again[k] = is_far or off > spread
