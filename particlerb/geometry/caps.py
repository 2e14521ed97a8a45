"""The exposed part of one sphere among others: caps that cover it, and the arcs of its edge.

On a sphere of radius 1 another ball covers a cap, n · u > h. The edge of what no cap covers
consists of arcs of the circles that bound caps. Positions of circles are decided for two of them
at a time, once, so that both learn the same; caps and crossings closer than `same` count as one,
which keeps three of them from contradicting each other by rounding.
"""

import math
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import (
    Floats,
    Ints,
    Vec3,
    add,
    add_scaled,
    cross,
    divide,
    dot,
    norm,
    scale,
    subtract,
)

SAME: Final = 1e-14  # caps this close are one; circles that overlap by so little only touch
_WHOLE_TURN: Final = 2.0 * math.pi

_Circle: TypeAlias = tuple[Vec3, Vec3, Vec3, float, float, float]  # u, e1, e2, h, 1 − h, radius


class Caps(NamedTuple):
    """Parts of one sphere, of radius 1, that others cover: n · u > h."""

    axis: Floats  # (k, 3) unit vectors u
    height: Floats  # (k,) h
    depth: Floats  # (k,) 1 − h, with all its digits
    radius: Floats  # (k,) of the circle that bounds the cap, √(1 − h²)
    e1: Floats  # (k, 3) with e2 right-handed about u
    e2: Floats


@kernel
def caps_of(centre: Floats, radius: Floats, others: Ints, i: int, same: float) -> Caps:
    """Caps of other balls on sphere i; of those that agree within `same` only the first.

    Balls have centres (n, 3) and radii (n,); `others` (k,) are those that overlap it.
    """
    most = len(others)
    axis, e1, e2 = np.empty((most, 3)), np.empty((most, 3)), np.empty((most, 3))
    height, depth, rim = np.empty(most), np.empty(most), np.empty(most)
    k, R = 0, radius[i]
    for j in others:
        r, v = radius[j], subtract(row3(centre, j), row3(centre, i))
        d = norm(v)
        deep = (r + R - d) * (d + (r - R)) / (2.0 * d * R)
        high = (d + (R - r)) * (d + R + r) / (2.0 * d * R)
        if deep <= 0.0 or deep * high <= same:
            continue
        u = divide(v, d)
        h = 0.5 * (high - deep)
        is_new = True
        for m in range(k):
            apart = max(abs(axis[m, 0] - u[0]), abs(axis[m, 1] - u[1]), abs(axis[m, 2] - u[2]))
            if max(apart, abs(height[m] - h)) <= same:
                is_new = False
                break
        if not is_new:
            continue
        a = (1.0, 0.0, 0.0) if abs(u[0]) < 0.6 else (0.0, 1.0, 0.0)
        p = cross(u, a)
        p = divide(p, norm(p))
        q = cross(u, p)
        axis[k, 0], axis[k, 1], axis[k, 2] = u
        e1[k, 0], e1[k, 1], e1[k, 2] = p
        e2[k, 0], e2[k, 1], e2[k, 2] = q
        height[k], depth[k], rim[k] = h, deep, math.sqrt(deep * high)
        k += 1
    return Caps(axis[:k], height[:k], depth[:k], rim[:k], e1[:k], e2[:k])


@inline
def _meeting(caps: Caps, a: int, b: int, same: float) -> tuple[int, Vec3, Vec3]:
    """How the circles of two caps a < b lie: 0 they cross, in two points; else bits who is covered.

    1: circle a lies in cap b; 2: circle b lies in cap a; 4 neither; 3 both. With v the part of u_b
    across u_a the points are h_a u_a + ρ v ± γ u_a × v, ρ = (h_b − h_a cos) / sin, ρ² + γ² = s_a²:
    they lie on both circles to rounding, however small the angle between u_a and u_b. The heights
    of each circle below the other's plane use 1 ∓ cos = sin² / (1 ± cos).
    """
    ua, ub = row3(caps.axis, a), row3(caps.axis, b)
    ha, hb = caps.height[a], caps.height[b]
    w = cross(ua, ub)
    sine, cosine = norm(w), dot(ua, ub)
    if cosine > 0.0:
        rest = sine * sine / (1.0 + cosine)
        ga, gb = (hb - ha) + rest * ha, (ha - hb) + rest * hb
    else:
        rest = sine * sine / (1.0 - cosine)
        ga, gb = (ha + hb) - rest * ha, (ha + hb) - rest * hb
    s = caps.radius[a]
    chord = (sine * s - ga) * (sine * s + ga)
    if chord > same * (sine * s) ** 2:
        w = divide(w, sine)
        v = cross(w, ua)
        along, across = ga / sine, math.sqrt(chord) / sine
        middle = add_scaled(along, v, scale(ha, ua))
        return 0, add_scaled(-across, w, middle), add_scaled(across, w, middle)
    nowhere = (0.0, 0.0, 0.0)
    code = (1 if ga < 0.0 or (ga == 0.0 and cosine <= 0.0) else 0) + (2 if gb <= 0.0 else 0)
    return (4 if code == 0 else code), nowhere, nowhere


@inline
def _azimuth(caps: Caps, k: int, p: Vec3) -> float:
    """Angle of a point on circle k, from 0 to 2π."""
    t = math.atan2(dot(row3(caps.e2, k), p), dot(row3(caps.e1, k), p))
    return t if t >= 0.0 else t + _WHOLE_TURN


@kernel
def _covered(caps: Caps, k: int, begin: Floats, end: Floats, same: float) -> int:
    """Write the angles of circle k that other caps cover; their number, −1 for all of the circle.

    Intervals do not go across the angle 0, and are in no order.
    """
    count = 0
    for j in range(len(caps.height)):
        if j == k:
            continue
        code, p, q = _meeting(caps, min(j, k), max(j, k), same)
        if code & (1 if k < j else 2):
            return -1
        if code != 0:
            continue
        if k > j:
            p, q = q, p
        t0, t1 = _azimuth(caps, k, p), _azimuth(caps, k, q)
        begin[count], end[count] = t0, t1
        if t0 > t1:
            end[count] = _WHOLE_TURN
            count += 1
            begin[count], end[count] = 0.0, t1
        count += 1
    return count


@kernel
def exposed_arcs(caps: Caps, same: float) -> Floats:
    """Arcs (m, 3) of circles that no other cap covers: number of the circle, angles from and to."""
    n = len(caps.height)
    arcs, m = np.empty((8 * n + 8, 3)), 0
    begin, end = np.empty(2 * n + 2), np.empty(2 * n + 2)
    for k in range(n):
        count = _covered(caps, k, begin, end, same)
        if count < 0:
            continue
        order, reached = np.argsort(begin[:count]), 0.0
        for at in range(count + 1):
            stop = begin[order[at]] if at < count else _WHOLE_TURN
            if stop > reached:
                if m == len(arcs):
                    arcs = np.concatenate((arcs, np.empty_like(arcs)))
                arcs[m, 0], arcs[m, 1], arcs[m, 2] = k, reached, stop
                m += 1
            if at < count:
                reached = max(reached, end[order[at]])
    return arcs[:m]


@inline
def circle(caps: Caps, k: int) -> _Circle:
    """Circle k."""
    frame = row3(caps.axis, k), row3(caps.e1, k), row3(caps.e2, k)
    return (*frame, caps.height[k], caps.depth[k], caps.radius[k])


@inline
def point(c: _Circle, t: float) -> Vec3:
    """Point of a circle, h u + s (e1 cos t + e2 sin t)."""
    u, e1, e2, h, _, s = c
    return add_scaled(s * math.sin(t), e2, add_scaled(s * math.cos(t), e1, scale(h, u)))


@kernel
def open_by(caps: Caps, arcs: Floats) -> float:
    """Length of Σ (end − beginning) of all arcs: 0 where they close."""
    gap = (0.0, 0.0, 0.0)
    for m in range(len(arcs)):
        c = circle(caps, int(arcs[m, 0]))
        gap = subtract(add(gap, point(c, arcs[m, 2])), point(c, arcs[m, 1]))
    return norm(gap)
