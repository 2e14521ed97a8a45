"""Order in which joints of a cluster are eliminated, and the block operations that this takes.

Two joints couple where they share a body that moves. The order of the joints (minimum degree) and
the list of block operations are made once. Chains and trees have two blocks a joint.
"""

import heapq
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from particlerb.joints.records import Program
from particlerb.maths.vec3 import Bools, Floats, Ints


class _Elimination(NamedTuple):
    """Joints in the order in which they are eliminated, and those that each leaves coupled."""

    order: list[int]
    coupled: list[list[int]]


def _eliminated(near: list[set[int]], is_tree: bool) -> _Elimination:
    """Elimination of joints of which these are near each other, fewest neighbours first.

    Of a tree the branches take turns: no joint then waits for numbers of the one just before it.
    """
    heap = [(len(neighbours), 0, k) for k, neighbours in enumerate(near)]
    heapq.heapify(heap)
    remaining, elimination = set(range(len(near))), _Elimination([], [])
    while heap:
        degree, _, k = heapq.heappop(heap)
        if k not in remaining or degree != len(near[k]):
            continue
        remaining.remove(k)
        elimination.order.append(k)
        elimination.coupled.append(sorted(near[k]))
        for i in near[k]:
            near[i] |= near[k]
            near[i] -= {i, k}
            heapq.heappush(heap, (len(near[i]), is_tree * len(elimination.order), i))
    return elimination


def _neighbours(a: Ints, b: Ints, moves: Bools) -> list[set[int]]:
    """Joints that share a body that moves with each joint."""
    at: defaultdict[int, list[int]] = defaultdict(list)
    for j, ends in enumerate(zip(a.tolist(), b.tolist(), strict=True)):
        for body in ends:
            if moves[body]:
                at[body].append(j)
    near: list[set[int]] = [set() for _ in range(a.size)]
    for joints in at.values():
        for j in joints:
            near[j].update(joints)
    for j, neighbours in enumerate(near):
        neighbours.discard(j)
    return near


def _closing(order: Sequence[int], a: Ints, b: Ints, inv_mass: Floats, holds: Bools) -> Bools:
    """Which joints that hold close a loop with others before them in an order.

    All that stands still is one body, the last.
    """
    closes, tree = np.zeros(a.size, dtype=np.bool_), list(range(inv_mass.size))

    def root(body: int) -> int:
        while tree[body] != body:
            tree[body] = body = tree[tree[body]]
        return body if inv_mass[body] > 0.0 else inv_mass.size - 1

    for j in order:
        first, other = root(a[j]), root(b[j])
        closes[j] = holds[j] and first == other
        if holds[j]:
            tree[min(first, other)] = max(first, other)
    return closes


def program_of(a: Ints, b: Ints, start: Ints, inv_mass: Floats, holds: Bools) -> Program:
    """Program for joints of one cluster.

    Parameters
    ----------
    a, b : ndarray, shape (j,)
        Bodies of each joint.
    start : ndarray, shape (j + 1,)
        First row of each joint.
    inv_mass : ndarray, shape (n + 1,) [1/kg]
    holds : ndarray, shape (j,)
        Whether any row of a joint is a constraint.
    """
    moves = inv_mass > 0.0
    is_tree = not _closing(range(a.size), a, b, inv_mass, holds).any()
    elimination = _eliminated(_neighbours(a, b, moves), is_tree)
    place = np.empty(a.size, dtype=np.int64)
    place[elimination.order] = np.arange(a.size)
    pairs = [(j, j) for j in range(a.size)]
    numbers = {pair: k for k, pair in enumerate(pairs)}

    def block(i: int, j: int) -> int:
        """Number of the block of two joints, the later one first."""
        pair = (i, j) if place[i] >= place[j] else (j, i)
        if pair not in numbers:
            numbers[pair] = len(pairs)
            pairs.append(pair)
        return numbers[pair]

    column, update = [0], [0]
    below: list[int] = []
    below_joint: list[int] = []
    updates: list[tuple[int, ...]] = []
    rows = np.diff(start).tolist()
    for k, coupled in zip(elimination.order, elimination.coupled, strict=True):
        coupled.sort(key=lambda j: int(place[j]))
        below += [block(i, k) for i in coupled]
        below_joint += coupled
        for n, i in enumerate(coupled):
            updates += [
                (block(i, k), block(j, k), block(i, j), rows[i], rows[j]) for j in coupled[: n + 1]
            ]
        column.append(len(below))
        update.append(len(updates))
    pair = _ints(pairs).reshape(-1, 2)
    return Program(
        start,
        pair,
        _shared(a, b, pair, inv_mass),
        _ints(elimination.order),
        _ints(column),
        _ints(below),
        _ints(below_joint),
        _ints(update),
        _ints(updates).reshape(-1, 5),
        _closing(elimination.order, a, b, inv_mass, holds),
    )


def _ints(values: Sequence[Any]) -> Ints:
    """Numbers as an array."""
    return np.array(values, dtype=np.int64)


def _shared(a: Ints, b: Ints, pair: Ints, inv_mass: Floats) -> Bools:
    """Which bodies that move the joints of each block share: aa, ab, ba, bb."""
    i, j = pair.T
    ends = (a, a), (a, b), (b, a), (b, b)
    return np.stack([(p[i] == q[j]) & (inv_mass[p[i]] > 0.0) for p, q in ends], axis=1)
