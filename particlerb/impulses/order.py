"""The order of bodies in Newton's method: neighbours near each other, so that the band is narrow.

Source: Cuthill and McKee, Proc. 24th ACM National Conference, 157 (1969).
"""

import numpy as np

from particlerb.impulses.records import Newton
from particlerb.maths.vec3 import Bools, Ints


def _layers(near: list[set[int]], first: int) -> list[int]:
    """All that can be reached from a body, the nearest first, few neighbours before many."""
    reached, seen = [first], {first}
    for k in reached:
        new = sorted(near[k] - seen, key=lambda other: (len(near[other]), other))
        reached += new
        seen.update(new)
    return reached


def room_for_newton(moves: Bools, a: Ints, b: Ints, rows: int) -> Newton:
    """Room for bodies that may act on each other.

    Parameters
    ----------
    moves : ndarray, shape (partners,)
        Which partners impulses move.
    a, b : ndarray, shape (m,)
        Pairs of partners that may touch.
    rows : int
        Contacts at most.
    """
    near: list[set[int]] = [set() for _ in moves]
    inner = moves[a] & moves[b]
    for one, two in set(zip(a[inner].tolist(), b[inner].tolist(), strict=True)):
        near[one].add(two)
        near[two].add(one)
    place, cluster = np.full((2, moves.size), -1)
    order: list[int] = []
    n_clusters = 0
    for k in sorted(np.flatnonzero(moves).tolist(), key=lambda k: len(near[k])):
        if cluster[k] < 0:
            members = _layers(near, _layers(near, k)[-1])
            cluster[members] = n_clusters
            n_clusters += 1
            order += members
    place[order] = 6 * np.arange(len(order))
    away = np.abs(place[a[inner]] - place[b[inner]]).max(initial=0)
    n, bandwidth = 6 * len(order), int(away) + 5
    return Newton(
        place, cluster, np.array([bandwidth]), np.zeros((n, 3 * bandwidth + 1)), np.zeros(n),
        np.zeros((rows, 12)), np.zeros((n_clusters, 4)), np.zeros((rows, 6)),
    )  # fmt: skip
