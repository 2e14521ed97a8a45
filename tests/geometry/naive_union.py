"""Moments of a union of balls by slices: nothing in common with particlerb.geometry.union.

Each slice is a union of discs, integrated along the exposed arcs of its circles by Green's theorem.
Between critical heights (poles, highest and lowest points of circles of intersection, points where
three spheres meet) the slice is an analytic function of z but for square roots at the ends, which
z = middle − half cos θ removes; so Gauss-Legendre in θ converges exponentially.
"""

import itertools
import math

import numpy as np

NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)
ARC_NODES, ARC_WEIGHTS = np.polynomial.legendre.leggauss(24)


def union_by_slices(centre, radius, extra=()):
    """(V, first moments, ∫ x xᵀ) of the union about the origin."""
    centre, radius = np.asarray(centre, float), np.asarray(radius, float)
    heights = np.unique(np.concatenate([critical_heights(centre, radius), extra]))
    total = np.zeros((4, 4))  # of (1, x, y, z) (1, x, y, z)ᵀ
    for low, high in itertools.pairwise(heights):
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        for node, weight in zip(NODES, WEIGHTS, strict=True):
            angle = 0.5 * math.pi * (1.0 + node)
            z = middle - half * math.cos(angle)
            plane = disc_moments(centre, radius, z)
            lift = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [z, 0, 0]])
            total += 0.5 * math.pi * weight * half * math.sin(angle) * (lift @ plane @ lift.T)
    return total[0, 0], total[0, 1:], total[1:, 1:]


def critical_heights(centre, radius):
    heights = [*(centre[:, 2] - radius), *(centre[:, 2] + radius)]
    for i, j in itertools.combinations(range(len(radius)), 2):
        d = centre[j] - centre[i]
        distance = np.linalg.norm(d)
        if distance == 0.0:
            continue
        u = d / distance
        h = (distance**2 + radius[i] ** 2 - radius[j] ** 2) / (2 * distance)
        if abs(h) < radius[i]:
            s = math.sqrt(radius[i] ** 2 - h * h) * math.sqrt(max(0.0, 1 - u[2] ** 2))
            middle = centre[i, 2] + h * u[2]
            heights += [middle - s, middle + s]
    for i, j, k in itertools.combinations(range(len(radius)), 3):
        A = 2 * np.array([centre[j] - centre[i], centre[k] - centre[i]])
        b = np.array(
            [
                (centre[m] ** 2).sum() - (centre[i] ** 2).sum() - radius[m] ** 2 + radius[i] ** 2
                for m in (j, k)
            ]
        )
        normal = np.cross(A[0], A[1])
        if np.linalg.norm(normal) < 1e-9:
            continue
        foot = np.linalg.lstsq(A, b - A @ centre[i], rcond=None)[0]
        reach = radius[i] ** 2 - foot @ foot
        if reach > 0:
            step = math.sqrt(reach) * normal[2] / np.linalg.norm(normal)
            heights += [centre[i, 2] + foot[2] - step, centre[i, 2] + foot[2] + step]
    return np.array(heights)


def disc_moments(centre, radius, z):
    """∫ (1, x, y) (1, x, y)ᵀ dA of a slice, (3, 3)."""
    cut = radius**2 - (centre[:, 2] - z) ** 2
    discs = {
        (float(x), float(y), math.sqrt(rr))
        for (x, y), rr in zip(centre[cut > 0, :2], cut[cut > 0], strict=True)
    }
    discs = sorted(discs)
    result = np.zeros((3, 3))
    for own in discs:
        for a, b in exposed(own, [disc for disc in discs if disc != own]):
            result += arc_moments(own, a, b)
    return result


def exposed(own, others):
    """Intervals of angles of a circle outside other discs; of equal circles the first counts."""
    x, y, r = own
    cuts = {0.0, 2 * math.pi}
    for X, Y, R in others:
        d = math.hypot(X - x, Y - y)
        if abs(R - r) < d < R + r:
            towards = math.atan2(Y - y, X - x)
            half = math.acos(min(1.0, max(-1.0, (d * d + r * r - R * R) / (2 * d * r))))
            cuts |= {(towards - half) % (2 * math.pi), (towards + half) % (2 * math.pi)}
    for a, b in itertools.pairwise(sorted(cuts)):
        t = 0.5 * (a + b)
        px, py = x + r * math.cos(t), y + r * math.sin(t)
        if all(math.hypot(px - X, py - Y) > R for X, Y, R in others):
            yield a, b


def arc_moments(own, a, b):
    """∮ along an arc for each of the six moments, ∫ f dA = ∮ (∫ f dx) dy."""
    x0, y0, r = own
    t = 0.5 * (a + b) + 0.5 * (b - a) * ARC_NODES
    x, y = x0 + r * np.cos(t), y0 + r * np.sin(t)
    dy = 0.5 * (b - a) * ARC_WEIGHTS * r * np.cos(t)
    m = {
        (0, 0): (x * dy).sum(),
        (0, 1): (0.5 * x * x * dy).sum(),
        (0, 2): (x * y * dy).sum(),
        (1, 1): (x**3 / 3 * dy).sum(),
        (1, 2): (0.5 * x * x * y * dy).sum(),
        (2, 2): (x * y * y * dy).sum(),
    }
    return np.array([[m[min(i, j), max(i, j)] for j in range(3)] for i in range(3)])
