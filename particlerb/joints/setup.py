"""Joints of a group of bodies, from rows and the constants of the bodies."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from particlerb.compiled.jit import flag
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.elimination import program_of
from particlerb.joints.records import (
    Actions,
    Clusters,
    ConstraintRows,
    Coordinates,
    Drives,
    Joints,
    Program,
)
from particlerb.maths.components import labels
from particlerb.maths.vec3 import Bools, Floats, Ints
from particlerb.model.bodies import Bodies

_LOOP_PIVOT = 1e-8  # over its diagonal: below it a row of a closed loop depends on those before
_MOST_EVEN_RATIO = 1e2  # of masses of a cluster; beyond it see `Clusters.is_uneven`

NO_ACTIONS: Final = Actions(*np.zeros((9, 0)))
_NO_INDEX: Final = np.zeros(0, dtype=np.int64)
_NO_COORDINATES: Final = Coordinates(
    _NO_INDEX, _NO_INDEX, _NO_INDEX, _NO_INDEX, np.zeros(0, dtype=np.bool_), np.zeros((0, 4, 3))
)
_NO_DRIVES: Final = Drives(np.zeros((0, 4)), np.zeros((0, 3)))


def joints_among(
    number: Ints, start: Ints, rows: ConstraintRows, bodies: Bodies, actions: Actions,
    coordinates: Coordinates = _NO_COORDINATES, drives: Drives = _NO_DRIVES,
    prescribed: Bools | None = None,
) -> Joints:  # fmt: skip
    """Joints of a group.

    Parameters
    ----------
    number : ndarray, shape (j,)
        Which joints of the system these are.
    start : ndarray, shape (j + 1,)
        First row of each.
    rows : ConstraintRows
        With bodies as members of the group, the world behind the last.
    bodies : Bodies
        The n members.
    actions : Actions
        What acts along coordinates.
    coordinates : Coordinates, optional
        To be kept track of, with bodies likewise.
    drives : Drives, optional
        What is prescribed.
    prescribed : ndarray, shape (n,), optional
        Which members move as prescribed.
    """
    n = bodies.mass.size
    a, b = rows.a[start[:-1]], rows.b[start[:-1]]
    label = labels(n + 1, a, np.where(b < n, b, a))[:n]  # the world ties nothing
    order = np.argsort(label, kind="stable")
    place = np.empty(n + 1, dtype=np.int64)
    place[order], place[n] = np.arange(n), n
    index = np.argsort(label[a], kind="stable")  # joints, cluster by cluster
    count = np.diff(start)[index]
    taken = np.repeat(start[index] - (np.cumsum(count) - count), count) + np.arange(count.sum())
    rows = ConstraintRows(*(array[taken] for array in rows))
    rows = rows._replace(a=place[rows.a], b=place[rows.b])
    inv_mass = np.append(bodies.inv_mass[order], 0.0)
    inv_inertia = np.vstack([bodies.inv_inertia.T[order], np.zeros(3)])
    ends = np.flatnonzero(np.diff(label[order], append=-1)) + 1
    coordinates = coordinates._replace(a=place[coordinates.a], b=place[coordinates.b])
    prescribed = np.append(
        np.zeros(n, dtype=np.bool_) if prescribed is None else prescribed[order], False
    )
    first, rank = np.r_[0, ends], np.r_[0, np.cumsum(count)]
    holds = np.logical_or.reduceat(rows.action == col.HOLDS, rank[:-1])
    clusters, program = programs_of(
        first, label[a[index]], label[order], rows, rank, inv_mass, holds
    )
    acts = any(values.any() for values in (actions.stiffness, actions.stop, actions.motor))
    damps = actions.damping.any() or actions.stop_damping.any()
    return Joints(
        order, inv_mass, inv_inertia, rows, clusters, program, number[index], actions,
        np.zeros((n + 1, 2)), _beside(rows), acts, bool(damps), coordinates, drives, prescribed,
        bool((rows.drive != col.AT_REST).any() or prescribed.any()),
        rolls=flag(bool(np.isin(rows.kind, (kinds.RACK, kinds.GEAR)).any())),
    )  # fmt: skip


def with_drag(joints: Joints, linear: Floats, angular: Floats) -> Joints:
    """Joints of bodies with drag, (n,) [N s/m] and [N m s/rad]."""
    drag = np.zeros_like(joints.drag)
    drag[:-1] = np.stack([linear, angular], axis=1)[joints.order]
    return joints._replace(drag=drag, damps=joints.damps or bool(drag.any()))


def _beside(rows: ConstraintRows) -> Bools:
    """Which rows differ from those before by their axis alone, of those along axes of the world."""
    columns = np.column_stack([rows.kind, rows.a, rows.b, rows.vector_a, rows.vector_b])
    is_equal = np.append(False, (columns[1:] == columns[:-1]).all(axis=1))
    return np.asarray(is_equal & (rows.kind == kinds.WORLD_ALONG))


def programs_of(
    first: Ints,
    of_joint: Ints,
    of_body: Ints,
    rows: ConstraintRows,
    start: Ints,
    inv_mass: Floats,
    holds: Bools,
) -> tuple[Clusters, Program]:
    """Programs of all clusters, one behind the other; equal ones are made once."""
    labels = of_body[first[:-1]]
    joint = np.append(np.searchsorted(of_joint, labels), of_joint.size)
    made: dict[bytes, tuple[Program, float, bool]] = {}
    parts = list[tuple[Program, float, bool]]()
    for c, (lo, hi) in enumerate(pairwise(joint)):
        n = first[c + 1] - first[c]
        a, b = rows.a[start[lo:hi]], rows.b[start[lo:hi]]
        a, b = a - first[c], np.where(b == inv_mass.size - 1, n, b - first[c])
        masses = np.append(inv_mass[first[c] : first[c + 1]], 0.0)
        own_start = start[lo : hi + 1] - start[lo]
        sign = b"".join(values.tobytes() for values in (a, b, own_start, masses, holds[lo:hi]))
        if sign not in made:
            program = program_of(a, b, own_start, masses, holds[lo:hi])
            pivot = _LOOP_PIVOT if program.closes.any() else 0.0
            moving = masses[masses > 0.0]
            ratio = moving.max(initial=0.0) / moving.min(initial=np.inf)
            made[sign] = program, pivot, bool(ratio > _MOST_EVEN_RATIO)
        parts.append(made[sign])
    programs, pivots, are_uneven = zip(*parts, strict=True)
    block = _offsets([len(program.pair) for program in programs])
    even = 2.0 * np.frexp(inv_mass)[0]
    clusters = Clusters(first, joint, block, np.array(pivots), np.array(are_uneven), even)
    return clusters, _joined(programs, joint, block, start)


def _offsets(sizes: list[int]) -> Ints:
    """Where each of some parts begins, and where the last one ends."""
    return np.cumsum([0, *sizes], dtype=np.int64)


def _joined(parts: Sequence[Program], joint: Ints, block: Ints, start: Ints) -> Program:
    """One program of those of all clusters."""
    below = _offsets([part.below.size for part in parts])
    update = _offsets([len(part.updates) for part in parts])

    def shifted(name: str, by: Ints) -> Ints:
        """Numbers of all parts, counted through."""
        arrays = [getattr(p, name) + k for p, k in zip(parts, by[:-1], strict=True)]
        return np.concatenate(arrays)

    column = [p.column[:-1] + k for p, k in zip(parts, below[:-1], strict=True)]
    updated = [p.update[:-1] + k for p, k in zip(parts, update[:-1], strict=True)]
    updates = np.concatenate([part.updates for part in parts])
    updates[:, :3] += np.repeat(block[:-1], np.diff(update))[:, None]
    return Program(
        start,
        shifted("pair", joint),
        np.concatenate([part.shares for part in parts]),
        shifted("order", joint),
        np.append(np.concatenate(column), below[-1]),
        shifted("below", block),
        shifted("below_joint", joint),
        np.append(np.concatenate(updated), update[-1]),
        updates,
        np.concatenate([part.closes for part in parts]),
    )
