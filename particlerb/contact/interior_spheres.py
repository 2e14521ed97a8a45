"""Spheres of a body that nothing from outside can touch, because others of the body are around."""

import math
from typing import Final

import numpy as np

from particlerb.compiled.jit import inline, kernel
from particlerb.contact.neighbour_list import incidence
from particlerb.contact.sphere_search import SphereSearch
from particlerb.maths.vec3 import Bools, Floats, Ints, Vec3, add_scaled, subtract

_MIN_PATCH_HALF_SIDE: Final = 1.0 / 64  # on a cube of side 2


@inline
def _on_unit_sphere(face: int, u: float, v: float) -> Vec3:
    """Direction of a point of the cube's face: (±1, u, v) in turn, of length 1."""
    w = 1.0 if face < 3 else -1.0
    f = 1.0 / math.sqrt(1.0 + u * u + v * v)
    if face % 3 == 0:
        return f * w, f * u, f * v
    if face % 3 == 1:
        return f * v, f * w, f * u
    return f * u, f * v, f * w


@inline
def _largest_cover(x: Vec3, spheres: Floats, near: Ints, lo: int, hi: int, depth: float) -> float:
    """How deep x is inside the deepest of some balls that are smaller by `depth` [m]."""
    best = -math.inf
    for k in range(lo, hi):
        j = near[k]
        d = subtract(x, (spheres[j, 0], spheres[j, 1], spheres[j, 2]))
        best = max(best, spheres[j, 3] - depth - math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]))
    return best


@kernel
def _find_outer(
    spheres: Floats, offset: Ints, near: Ints, depth: float, stack: Floats, is_outer: Bools
) -> None:
    """Write which spheres are not covered: see `outer_spheres`.

    The sphere is seen as a cube, whose faces are halved in both directions until a patch is inside
    one ball altogether, its middle is in none, or the patch is small.

    Parameters
    ----------
    spheres : ndarray, shape (n, 4) [m]
        Centre, and radius with that of the smallest ball from outside.
    offset, near : ndarray, shapes (n + 1,) and (n_near,)
        Balls that reach into ball i are near[offset[i]] to near[offset[i + 1]].
    depth : float
        [m]
    stack : ndarray, shape (room, 4)
        Face, first corner and size of patches that are not decided.
    is_outer : ndarray, shape (n,)
    """
    for i in range(offset.size - 1):
        lo, hi, left = offset[i], offset[i + 1], 6
        x, R = (spheres[i, 0], spheres[i, 1], spheres[i, 2]), spheres[i, 3]
        for face in range(6):
            stack[face, 0], stack[face, 1], stack[face, 2], stack[face, 3] = face, -1.0, -1.0, 2.0
        is_outer[i] = False
        while left > 0 and not is_outer[i]:
            left -= 1
            face, u, v = int(stack[left, 0]), stack[left, 1], stack[left, 2]
            half = 0.5 * stack[left, 3]
            middle, size = _on_unit_sphere(face, u + half, v + half), 0.0
            for corner in range(4):
                end = _on_unit_sphere(
                    face, u + 2.0 * half * (corner // 2), v + 2.0 * half * (corner % 2)
                )
                d = subtract(end, middle)
                size = max(size, math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]))
            at = add_scaled(R - 0.5 * depth, middle, x)
            cover = _largest_cover(at, spheres, near, lo, hi, depth)
            if cover >= R * size + 0.5 * depth:
                continue
            if half < _MIN_PATCH_HALF_SIDE or cover < -0.5 * depth:
                is_outer[i] = True
                continue
            for quarter in range(4):
                stack[left, 0], stack[left, 3] = face, half
                stack[left, 1], stack[left, 2] = u + half * (quarter // 2), v + half * (quarter % 2)
                left += 1


def outer_spheres(position: Floats, radius: Floats, smallest: float, depth: float = 0.0) -> Bools:
    """Whether something from outside can touch each sphere of a body, (n,); true if in doubt.

    A ball of radius ρ touches sphere i where its centre is within r_i + ρ of x_i. The others keep
    it out of a place that is deeper than r_j + ρ - δ in ball j; if these cover the shell from r_i
    + ρ - δ to r_i + ρ around x_i, nothing gets there. A larger ball that touches contains one of
    radius ρ that touches there too, so that the smallest decides. Spheres that are left out rely on
    others which are left out too, but the first to be touched would have to be one of them.

    Parameters
    ----------
    position : ndarray, shape (3, n) [m]
        In any frame.
    radius : ndarray, shape (n,) [m]
    smallest : float
        ρ: radius of the smallest ball that may come [m]; 0 for edges and vertices of walls.
    depth : float
        δ: largest overlap of a contact [m].
    """
    n, contact_distance = radius.size, radius + smallest
    first, second, _ = SphereSearch(contact_distance, np.arange(n)).pairs(position, 0.0)
    offset, entry = incidence(first, second, n)
    near = np.where(entry >= 0, second[entry], first[~entry])
    spheres = np.column_stack([position.T, contact_distance])
    is_outer, stack = np.ones(n, dtype=np.bool_), np.empty((6 + 3 * 32, 4))
    _find_outer(spheres, offset, near, depth, stack, is_outer)
    return is_outer
