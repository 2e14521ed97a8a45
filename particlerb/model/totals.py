"""Sums over all bodies of a frame: energies and momenta, and how large these are.

They run over fixed blocks of bodies in a fixed order, and over superblocks of these: the same bits
for any number of threads and ranks. Bodies in closed form are summed block by block while they are
written (`sum_block`), others from their frames.
"""

from collections.abc import Sequence
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, unfused_kernel
from particlerb.compiled.threads import BLOCK, THREADS
from particlerb.maths.quaternion import Rows4, to_body
from particlerb.maths.rows import column3, column4, put_column3, rows3, rows4
from particlerb.maths.vec3 import Floats, Ints, Rows3, Vec3, add_scaled, cross, dot, scale
from particlerb.model.bodies import Bodies
from particlerb.model.state import Frames
from particlerb.model.superblocks import Range, summed, superblocks
from particlerb.ranks import ALONE, Ranks

N_TOTALS: Final = 10
_REACH_SHARE = 1e-6  # of |x| |p| that angular momenta are never judged below: x × p rounds
_HUGE_SQUARE, _HUGE_SCALE = 2.0**1000, 2.0**-520  # of what is far, and what makes it smaller


@inline
def _load_rows(frames: Frames, f: int, lo: int, mass: Floats, local: Floats, n: int) -> None:
    """Copy x, p, L, q of n bodies of a frame into rows, so that what follows fills SIMD lanes.

    Momenta of bodies without mass, which are held, do not count.
    """
    position, orientation, linear, angular, _, _ = frames
    for b in range(n):
        is_free = mass[lo + b] > 0.0
        for c in range(3):
            local[c, b] = position[f, lo + b, c]
            local[3 + c, b] = linear[f, lo + b, c] if is_free else 0.0
            local[6 + c, b] = angular[f, lo + b, c] if is_free else 0.0
        for c in range(4):
            local[9 + c, b] = orientation[f, lo + b, c]


@inline
def far_norm(v: Vec3) -> float:
    """|v|, also where its square is too large for float64."""
    small, large = (_HUGE_SCALE, 1.0 / _HUGE_SCALE) if dot(v, v) > _HUGE_SQUARE else (1.0, 1.0)
    near = scale(small, v)
    return large * np.sqrt(dot(near, near))


@inline
def _momenta_rows(
    x: Rows3, p: Rows3, L: Rows3, mass: Floats, inv_mass: Floats, g: Vec3, out: Floats
) -> None:
    """½ p²/M, -M g·x, x × p + L, |p|, |x × p| + |L| of each body, into rows 0, 1, 5..9."""
    n = mass.size
    kinetic, potential, H = out[0, :n], out[1, :n], rows3(out[5:8], 0, n)
    size, spin = out[8, :n], out[9, :n]
    for b in range(n):
        x_b, p_b, L_b = column3(x, b), column3(p, b), column3(L, b)
        orbit = cross(x_b, p_b)
        kinetic[b] = 0.5 * dot(p_b, scale(inv_mass[b], p_b))
        potential[b] = -mass[b] * dot(g, x_b)
        put_column3(H, b, add_scaled(1.0, orbit, L_b))
        size[b] = far_norm(p_b)
        reach = _REACH_SHARE * far_norm(x_b) * size[b]  # straight through the origin
        spin[b] = far_norm(L_b) + far_norm(orbit) + reach


@inline
def _add_turning(m: Vec3, w: Vec3, kinetic: Floats, b: int) -> None:
    """Add ½ Σ m_k² w_k of a body, with m = L in the rotor frame and w = 1/I."""
    kinetic[b] += 0.5 * (m[0] * (w[0] * m[0]) + m[1] * (w[1] * m[1]) + m[2] * (w[2] * m[2]))


@inline
def _add_up(p: Rows3, out: Floats, first: int, end: int, sums: Floats) -> None:
    """Add neighbours to their sums, body after body; in registers, as ten chains side by side."""
    kinetic, potential, p1, p2, p3 = sums[0], sums[1], sums[2], sums[3], sums[4]
    H1, H2, H3, size, spin = sums[5], sums[6], sums[7], sums[8], sums[9]
    for b in range(first, end):
        kinetic, potential = kinetic + out[0, b], potential + out[1, b]
        p1, p2, p3 = p1 + p[0][b], p2 + p[1][b], p3 + p[2][b]
        H1, H2, H3 = H1 + out[5, b], H2 + out[6, b], H3 + out[7, b]
        size, spin = size + out[8, b], spin + out[9, b]
    for c, value in enumerate((kinetic, potential, p1, p2, p3, H1, H2, H3, size, spin)):
        sums[c] = value


@inline
def _add_to_bins(p: Rows3, out: Floats, bins: Ints | None, k: int, sums: Floats) -> None:
    """Add block k to the sums (bins, 10) of the bins of its bodies; without bins it is one."""
    if bins is None:
        _add_up(p, out, 0, p[0].size, sums[k])
    else:
        first = 0
        while first < bins.size:
            end = first + 1
            while end < bins.size and bins[end] == bins[first]:
                end += 1
            _add_up(p, out, first, end, sums[bins[first]])
            first = end


class FrameTotals(NamedTuple):
    """Sums over the bodies of frames, for those who write them."""

    sums: Floats  # (T, bins, 10), see `totals`; (0, bins, 10): nobody asks for them
    mass: Floats  # (n,)
    gravity: Floats  # (3,) [m/s²]


def no_totals(bodies: Bodies) -> FrameTotals:
    """Where nobody asks for them."""
    return FrameTotals(np.zeros((0, 0, N_TOTALS)), bodies.mass, np.zeros(3))


class BlockRows(NamedTuple):
    """Rows of a block of bodies that are summed."""

    x: Rows3
    q: Rows4  # of the rotor frames
    p: Rows3
    L: Rows3
    mass: Floats
    inv_mass: Floats
    inv_inertia: Rows3


@inline
def sum_block(of: BlockRows, g: Vec3, bins: Ints | None, k: int, sums: Floats, out: Floats) -> None:
    """Add block k to sums (bins, 10) of the bins of its bodies, or to its own; `out` is room."""
    _momenta_rows(of.x, of.p, of.L, of.mass, of.inv_mass, g, out)
    for b in range(of.mass.size):
        m = to_body(column4(of.q, b), column3(of.L, b))
        _add_turning(m, column3(of.inv_inertia, b), out[0], b)
    _add_to_bins(of.p, out, bins, k, sums)


@unfused_kernel
def sum_blocks(
    frames: Frames,
    bodies: Bodies,
    gravity: Floats,
    bins: Ints | None,
    sums: Floats,
    first: int,
    end: int,
) -> None:
    """Add some blocks of bodies, for all frames, to sums (T, bins, 10): those of the bodies' bins.

    Without bins each block is one.
    """
    mass, inv_mass, _, inv_inertia, rotor_frame, _ = bodies
    g = (gravity[0], gravity[1], gravity[2])
    local, out = np.empty((13, BLOCK)), np.empty((N_TOTALS, BLOCK))
    for k in range(first, end):
        lo, hi = k * BLOCK, min(k * BLOCK + BLOCK, mass.size)
        n = hi - lo
        x, p, L = rows3(local[0:3], 0, n), rows3(local[3:6], 0, n), rows3(local[6:9], 0, n)
        q, frame = rows4(local[9:13], 0, n), rows4(rotor_frame, lo, hi)
        inverse = rows3(inv_inertia, lo, hi)
        for f in range(sums.shape[0]):
            _load_rows(frames, f, lo, mass, local, n)
            _momenta_rows(x, p, L, mass[lo:hi], inv_mass[lo:hi], g, out)
            for b in range(n):
                m = to_body(column4(frame, b), to_body(column4(q, b), column3(L, b)))
                _add_turning(m, column3(inverse, b), out[0], b)
            _add_to_bins(p, out, None if bins is None else bins[lo:hi], k, sums[f])


def sums_over(
    frames: Frames, bodies: Bodies, gravity: Floats, n_worlds: int = 1, of: Range | None = None
) -> Floats:
    """Sums (T, 10) or (T, n_worlds, 10) of frames over a superblock of bodies, or over all."""
    n, n_frames = bodies.mass.size, len(frames.position)
    if n_worlds == 1:
        first, stop = of or (0, n)
        k, end = first // BLOCK, -(-stop // BLOCK)
        blocks = np.zeros((n_frames, end, N_TOTALS))
        add_up = partial(sum_blocks, frames, bodies, gravity, None, blocks)
        THREADS.share(lambda lo, hi: add_up(k + lo, k + hi), end - k, (stop - first) * n_frames)
        return blocks[:, k] if end == k + 1 else np.asarray(np.add.reduce(blocks[:, k:], axis=1))
    in_each = -(-(n // n_worlds) // BLOCK)
    blocks = np.zeros((n_frames, n_worlds * in_each, N_TOTALS))
    world, b = np.divmod(np.arange(n), n // n_worlds)
    sum_blocks(frames, bodies, gravity, in_each * world + b // BLOCK, blocks, 0, -(-n // BLOCK))
    sums = blocks.reshape(n_frames, n_worlds, in_each, N_TOTALS)
    return np.asarray(sums[:, :, 0] if in_each == 1 else sums.sum(axis=2))


def totals(
    frames: Frames,
    bodies: Bodies,
    gravity: Floats,
    potential: Floats | float = 0.0,
    kinetic: Floats | float = 0.0,
    n_worlds: int = 1,
    ranks: Ranks = ALONE,
    known: Sequence[Floats | None] = (),
) -> Floats:
    """Sums over all bodies, (T, 10), or (T, n_worlds, 10) of scenes in a batch.

    Columns: kinetic energy [J]; potential energy [J] of gravity, attraction, springs, contacts,
    piston loads; momentum (3) [kg m/s]; angular momentum about the origin of the world (3)
    [kg m²/s]; Σ|p| [kg m/s]; Σ|L| of the bodies and of their centres of mass [kg m²/s].

    Parameters
    ----------
    frames, bodies : Frames, Bodies
        States and constants.
    gravity : ndarray, shape (3,)
        Its acceleration [m/s²].
    potential : ndarray, shape (T,)
        Potential energy of springs, of forces between bodies, and of loads on pistons [J].
    kinetic : ndarray, shape (T,)
        Kinetic energy of pistons [J].
    n_worlds : int
        Scenes that the bodies are of, one after the other, with as many each; on one thread.
    ranks : Ranks
        Each with bodies of its own.
    known : sequence of ndarray
        What `sums_over` gives of superblocks, where it is known.
    """
    sums = known[0] if len(known) == 1 and ranks is ALONE else None  # the plain case
    if sums is None:
        blocks = superblocks(bodies.mass.size) if n_worlds == 1 else [None]
        known = known if len(known) == len(blocks) else [None] * len(blocks)  # one: bodies touch
        block_sums = [
            sums_over(frames, bodies, gravity, n_worlds, of) if one is None else one
            for of, one in zip(blocks, known, strict=True)
        ]
        sums = summed(block_sums, ranks)
    sums[..., 0] += kinetic
    sums[..., 1] += potential
    return sums
