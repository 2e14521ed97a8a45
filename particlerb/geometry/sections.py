"""Cell sums of solids whose sections across z are discs or rings: ball, cone, torus and so on.

At each height the matter is a disc without a smaller one about z. What of a disc lies in a cell is
known in closed form; along z Gauss's rule adds up, piece by piece between the heights where
sections change their kind. Everything is in the coordinates of `geometry.cells`, after the bounding
box has been made the cube from -1 to 1: an ellipsoid is then a ball.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.geometry.cells import Layer, cell_particles, grid_over
from particlerb.geometry.particles import Mass, Particles
from particlerb.maths.vec3 import Bools, Floats

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)

_Moments = tuple[float, float, float, float, float, float]


class Profile(NamedTuple):
    """Rings about z in the cube from -1 to 1: a solid of revolution, or one squeezed along axes.

    Radii of the ring at height z are sums of 1, √(1 − z²) and z.
    """

    outer: Floats
    """Coefficients of the outer radius, shape (3,)."""
    inner: Floats
    """Coefficients of the inner radius, shape (3,)."""
    hole: float
    """Radius of a ball about the origin that is left out."""
    is_round: bool
    """Whether √(1 − z²) occurs: heights are then integrated over arcsin z."""

    def radii(self, z: Floats, cosine: Floats) -> tuple[Floats, Floats]:
        """Inner and outer radius of the sections at heights z, with cos θ = √(1 − z²)."""
        inner, outer = (a + b * cosine + c * z for a, b, c in (self.inner, self.outer))
        ball = np.sqrt(np.maximum(self.hole**2 - z * z, 0.0))
        return np.maximum(inner, ball), outer

    def inside(self, x: Floats, y: Floats, z: Floats) -> Bools:
        """Whether points of the cube are inside."""
        inner, outer = self.radii(z, np.sqrt(1.0 - z * z))
        square = x * x + y * y
        return (inner * inner <= square) & (square <= outer * outer)


BALL: Final = Profile(np.array([0.0, 1.0, 0.0]), np.zeros(3), 0.0, True)
CONE: Final = Profile(np.array([0.5, 0.0, -0.5]), np.zeros(3), 0.0, False)


def hollow(hole: float) -> Profile:
    """A ball with a spherical hole of this share of its radius."""
    return BALL._replace(hole=hole)


def tube(bore: float) -> Profile:
    """A cylinder with a bore of this share of its radius."""
    return Profile(np.array([1.0, 0.0, 0.0]), np.array([bore, 0.0, 0.0]), 0.0, False)


def ring(slenderness: float) -> Profile:
    """A torus; minor over major radius."""
    c, a = 1.0 / (1.0 + slenderness), slenderness / (1.0 + slenderness)
    return Profile(np.array([c, a, 0.0]), np.array([c, -a, 0.0]), 0.0, True)


def section_particles(profile: Profile, half_size: Floats, mass: Mass, n: int) -> Particles:
    """Particles of cells, n along the largest extent, of a solid about the origin.

    Parameters
    ----------
    profile : Profile
        The solid in its bounding box.
    half_size : ndarray, shape (3,) [m]
        Of that box.
    mass : float, or ndarray of shape (k, 1) [kg]
    n : int

    Raises
    ------
    ValueError
        If n is below 2.
    """
    order = [2, 0, 1]  # layers across z come first
    grid = grid_over(-half_size[order], half_size[order], n)
    nz, nx, ny = grid.counts
    made = cell_particles(cut_sections(profile, (nx, ny, nz)), grid, mass)
    return made._replace(position=np.ascontiguousarray(np.roll(made.position, -1, axis=1)))


def cut_sections(profile: Profile, counts: tuple[int, int, int]) -> Iterator[Layer]:
    """Cell sums of a solid in its bounding box, layer by layer along z: (k, (n_x, n_y, 10)).

    Sums are those of `geometry.cells`, where layers follow the first axis: their order is z, x, y.
    """
    nx, ny, nz = counts
    breaks = np.array([-profile.hole, profile.hole]) if profile.hole else np.empty(0)
    for k in range(nz):
        low, high = (2.0 * k - nz) / nz, (2.0 * k + 2.0 - nz) / nz
        ends = np.unique([low, *breaks[(breaks > low) & (breaks < high)], high])
        sums = np.zeros((nx, ny, 10))
        z, weight, cosine = _nodes_between(ends, profile.is_round)
        inner, outer = profile.radii(z, cosine)
        _add_sections(outer, inner, 0.5 * nz * (z - low), 0.5 * nz * weight, sums)
        yield k, sums


def _nodes_between(ends: Floats, is_round: bool) -> tuple[Floats, Floats, Floats]:
    """Heights, weights and cos θ of Gauss's rule between ascending heights."""
    if is_round:
        ends = np.arcsin(ends)
    middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * (ends[1:] - ends[:-1])
    z = (middle[:, None] + half[:, None] * _NODES).ravel()
    weight = np.outer(half, _WEIGHTS).ravel()
    if is_round:
        cosine = np.cos(z)
        return np.sin(z), weight * cosine, cosine
    return z, weight, np.sqrt(1.0 - z * z)


@kernel
def _add_sections(
    outer: Floats, inner: Floats, height: Floats, weight: Floats, sums: Floats
) -> None:
    """Add sections of a layer at heights in it from 0 to 1, with weights that sum to 1."""
    nx, ny = sums.shape[0], sums.shape[1]
    for i in range(nx):
        x1, x2 = (2.0 * i - nx) / nx, (2.0 * i + 2.0 - nx) / nx
        for j in range(ny):
            y1, y2 = (2.0 * j - ny) / ny, (2.0 * j + 2.0 - ny) / ny
            cell = sums[i, j]
            for s in range(len(outer)):
                a, ax, ay, axx, ayy, axy = _disc_in(x1, x2, y1, y2, outer[s])
                if inner[s] > 0.0:
                    b, bx, by, bxx, byy, bxy = _disc_in(x1, x2, y1, y2, inner[s])
                    a, ax, ay = a - b, ax - bx, ay - by
                    axx, ayy, axy = axx - bxx, ayy - byy, axy - bxy
                if a == 0.0:
                    continue
                p, h = weight[s], height[s]
                cell[0] += p * a
                cell[1] += p * h * a
                cell[2] += p * ax
                cell[3] += p * ay
                cell[4] += p * h * h * a
                cell[5] += p * axx
                cell[6] += p * ayy
                cell[7] += p * h * ax
                cell[8] += p * h * ay
                cell[9] += p * axy


@inline
def _disc_in(x1: float, x2: float, y1: float, y2: float, r: float) -> _Moments:
    """Moments 1, u, v, uu, vv, uv of a disc about the origin over a cell, in its coordinates."""
    near_x, near_y = max(x1, -x2, 0.0), max(y1, -y2, 0.0)
    if near_x * near_x + near_y * near_y >= r * r:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    far_x, far_y = max(-x1, x2), max(-y1, y2)
    if far_x * far_x + far_y * far_y <= r * r:
        return 1.0, 0.5, 0.5, 1 / 3, 1 / 3, 0.25
    return part_of_disc(x1, x2, y1, y2, r)


@kernel
def part_of_disc(x1: float, x2: float, y1: float, y2: float, r: float) -> _Moments:
    """The same for a cell that the circle cuts: strips between its crossings with the sides."""
    dx, dy = x2 - x1, y2 - y1
    left, right = max(x1, -r), min(x2, r)
    p1 = math.sqrt(max(r * r - y1 * y1, 0.0)) if abs(y1) < r else r
    p2 = math.sqrt(max(r * r - y2 * y2, 0.0)) if abs(y2) < r else r
    small, large = min(p1, p2), max(p1, p2)
    a = ax = ay = axx = ayy = axy = 0.0
    start = left
    for end in (-large, -small, small, large, right):
        stop = min(max(end, start), right)
        if stop <= start:
            continue
        middle = 0.5 * (start + stop)
        half = math.sqrt(max(r * r - middle * middle, 0.0))
        if min(y2, half) > max(y1, -half):
            top = strip(start, stop, y2, 1.0 if half < y2 or r <= y2 else 0.0, r, x1, y1)
            floor = strip(start, stop, y1, -1.0 if -half > y1 or -r >= y1 else 0.0, r, x1, y1)
            a, ax, ay = a + (top[0] - floor[0]), ax + (top[1] - floor[1]), ay + (top[2] - floor[2])
            axx, ayy = axx + (top[3] - floor[3]), ayy + (top[4] - floor[4])
            axy += top[5] - floor[5]
        start = stop
    unit = dx * dy
    return (
        a / unit,
        ax / (unit * dx),
        ay / (unit * dy),
        axx / (unit * dx * dx),
        ayy / (unit * dy * dy),
        axy / (unit * dx * dy),
    )


@kernel
def strip(
    p: float, q: float, level: float, side: float, r: float, x0: float, y0: float
) -> _Moments:
    """Moments about (x0, y0) of the matter above y0, from x = p to q, below a level or an arc.

    Below the level where `side` is 0, else below y = ±√(r² − x²); integrands 1, x, y, xx, yy, xy.
    Gauss's rule in the angle, of twelve nodes: rounding for a quarter of a turn.
    """
    a = ax = ay = axx = ayy = axy = 0.0
    first, last = p, q
    if side != 0.0:
        first, last = math.asin(max(p / r, -1.0)), math.asin(min(q / r, 1.0))
    middle, half = 0.5 * (first + last), 0.5 * (last - first)
    for s in range(len(_NODES)):
        at, weight = middle + half * _NODES[s], half * _WEIGHTS[s]
        x, h = at - x0, level - y0
        if side != 0.0:
            cosine = math.cos(at)
            x, h, weight = r * math.sin(at) - x0, side * r * cosine - y0, weight * r * cosine
        a, ax, ay = a + weight * h, ax + weight * h * x, ay + weight * h * h * 0.5
        axx, axy = axx + weight * h * x * x, axy + weight * h * h * x * 0.5
        ayy += weight * h * h * h * (1 / 3)
    return a, ax, ay, axx, ayy, axy
