"""Joints of one table of a case, resolved: rows between bodies that move, what acts along them."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from particlerb.case.joints import JointLoad, JointMotor, JointTable
from particlerb.forces.links import WORLD, Links
from particlerb.impulses import records as impulses
from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.coordinates import coordinates_of
from particlerb.joints.records import (
    Actions,
    Bounds,
    Breaks,
    ConstraintRows,
    Coordinates,
    JointData,
    Joints,
)
from particlerb.joints.rows import arms_at, by_inverse_inertia, orientation, rotations
from particlerb.joints.solver import factorise_cluster, keep_rates
from particlerb.joints.types import Ends, rows_of
from particlerb.maths.rows import row3
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.merging import Merging
from particlerb.model.system import System
from particlerb.plan.joint_ends import in_hosts, joint_name
from particlerb.plan.merging import merges

_LOOSE_RATE_SHARE: Final = 1e-6  # what holds leaves less


class TableJoints(NamedTuple):
    """Joints of one table, with bodies that move."""

    names: list[str]
    coordinates: Coordinates
    rows: ConstraintRows
    record: Ints
    body_a: Ints
    body_b: Ints
    places: Floats
    n_rows: Ints  # of each
    until: Floats


def joints_of_table(
    system: System, number: int, ends: Ends, merging: Merging | None, rows: tuple[int, int]
) -> TableJoints:
    """Joints of a table, with the numbers of an action and of a drive."""
    table, first, second = system.joint[number], ends.a, ends.b
    names = [joint_name(system, table, first, second, k) for k in range(first.size)]
    until = np.full(first.size, table.until)
    if merging is not None:
        ends = in_hosts(ends, merging)
        if merges(table):
            second_merged = (second != WORLD) & merging.is_merged[second]
            until[merging.is_merged[first] | second_merged] = -np.inf
    table_rows = rows_of(table.type, ends, *rows, table.along)
    axes = ends.directions_a["n"], ends.directions_b.get("m", ends.directions_b["n"])
    return TableJoints(
        names,
        coordinates_of(table.type, ends),
        table_rows,
        np.full(first.size, number),
        ends.a,
        ends.b,
        np.stack([ends.at_a, ends.at_b, *axes], axis=1),
        np.full(first.size, table_rows.kind.size // first.size),
        until,
    )


def actions_of(tables: Sequence[JointTable]) -> Actions:
    """What acts along the coordinates of joints."""
    numbers: list[tuple[float, ...]] = []
    for table in tables:
        spring, limit, stops = table.spring, table.limit, (-np.inf, np.inf, 0.0, 0.0)
        if limit is not None:
            stops = (*limit.range, limit.stiffness or 0.0, limit.damping)
        own = (spring.stiffness, spring.rest) if spring else (0.0, 0.0)
        motor = None if isinstance(table.motor, JointMotor) else table.motor
        numbers.append((*own, table.damper, *stops, motor or 0.0, motor is not None))
    return Actions(*np.array(numbers).reshape(-1, 9).T.copy())


def bounds_of(tables: Sequence[JointTable]) -> Bounds:
    """What acts within bounds in joints of these tables; rows are numbers of the tables."""
    records: list[tuple[float, ...]] = []
    for k, table in enumerate(tables):
        limit, motor = table.limit, table.motor
        if limit is not None and limit.stiffness is None:
            records.append((k, impulses.STOP, *limit.range, limit.restitution, 0.0, np.inf))
        if isinstance(motor, JointMotor):
            records.append((k, impulses.MOTOR, -np.inf, np.inf, 0.0, motor.speed, motor.largest))
        if table.friction > 0.0:
            records.append((k, impulses.RUBS, -np.inf, np.inf, 0.0, 0.0, table.friction))
    row, kind, *numbers = np.array(records).reshape(-1, 7).T
    return Bounds(row.astype(np.int64), kind.astype(np.int64), *map(np.ascontiguousarray, numbers))


def bounds_among(bounds: Bounds, rows: ConstraintRows) -> Bounds | None:
    """Those in rows of joints of a group, whose actions they name; None where there are none."""
    row, index = np.nonzero(rows.action[:, None] == bounds.row)
    return Bounds._make([row, *(values[index] for values in bounds[1:])]) if row.size else None


def loose_wheels(joints: Joints, data: JointData) -> dict[int, str]:
    """Rows that roll and whose axes the joints do not hold, to first order: how they may move.

    Of momenta along each such way, what the joints leave is to be nothing.
    """
    rows, y, loose = joints.rows, data.y, dict[int, str]()
    for c, (lo, hi) in enumerate(pairwise(joints.program.start[joints.clusters.joint].tolist())):
        rolling = lo + np.flatnonzero(np.isin(rows.kind[lo:hi], (kinds.GEAR, kinds.RACK)))
        if rolling.size:
            factorise_cluster(joints, data, c, 0.0, 0.0)
            data.dg_dt[:] = 0.0
        for r in rolling.tolist():
            for words, way in _ways_of(joints, data, r):
                y[:, col.P :] = 0.0
                for k, gradient in ((rows.a[r], way[:6]), (rows.b[r], way[6:])):
                    y[k, col.P :] += gradient * (joints.inv_mass[k] > 0.0)
                before = _along(joints, y, r, way)
                keep_rates(joints, data, c, lo, hi)
                if _along(joints, y, r, way) > _LOOSE_RATE_SHARE * before:
                    loose.setdefault(r, words)
    return loose


def _ways_of(joints: Joints, data: JointData, r: int) -> list[tuple[str, Floats]]:
    """How the axes of row r must not move: gradients by x and θ of a, and of b, (12,)."""
    rows, R = joints.rows, rotations(joints.rows, data.y, r)
    ra, rb, u, d = map(np.array, arms_at(rows, data.y, r, R))
    n, none = np.array(R[1]) @ rows.wheel[r, :3], np.zeros(3)
    across, arm = np.cross(n, u), rb + d
    if rows.kind[r] == kinds.GEAR:
        across, arm = d - n * (n @ d), rb
    tilts = [np.cross(n, axis) for axis in np.eye(3)]
    ways = [("may tilt against each other", np.r_[none, v, none, -v]) for v in tilts]
    if across.any():
        way = np.r_[across, np.cross(ra, across), -across, -np.cross(arm, across)]
        ways.append(("may move apart", way))
    return ways


def _along(joints: Joints, y: Floats, r: int, way: Floats) -> float:
    """Rate of what has a gradient, by the momenta of the bodies of row r."""
    rate = 0.0
    for k, gradient in ((joints.rows.a[r], way[:6]), (joints.rows.b[r], way[6:])):
        spin = by_inverse_inertia(joints.inv_inertia, orientation(y, k), k, row3(y, k, col.L))
        along = joints.inv_mass[k] * float(gradient[:3] @ y[k, col.P : col.L])
        rate += along + float(gradient[3:] @ spin)
    return rate


def breaks_of(system: System, record: Ints) -> Breaks:
    """Loads at which joints break, of these records."""
    loads = [table.breaks_at or JointLoad.model_construct() for table in system.joint]
    limits = [(load.force or np.inf, load.torque or np.inf) for load in loads]
    return Breaks(*np.ascontiguousarray(np.array(limits)[record].T))


def with_dashpots(
    rows: ConstraintRows, actions: Actions, links: Links, n: int
) -> tuple[ConstraintRows, Actions]:
    """Rows and actions of joints of n bodies, with the dashpots among them."""
    assert links.damping is not None
    m = links.body_a.size
    dashpots = ConstraintRows(
        np.full(m, kinds.STRETCH),
        links.body_a,
        np.where(links.body_b == WORLD, n, links.body_b),
        np.ascontiguousarray(links.at_a.T),
        np.ascontiguousarray(links.at_b.T),
        np.zeros((m, 3)),
        np.ones(m),
        np.ones(m),
        actions.motor.size + np.arange(m),
        np.full(m, col.AT_REST),
        np.zeros((m, col.WHEEL)),
    )
    endless = np.full(m, np.inf)
    damping = Actions(*np.zeros((9, m)))._replace(
        damping=links.damping, lower=-endless, upper=endless
    )
    all_rows = ConstraintRows(*(np.concatenate(pair) for pair in zip(rows, dashpots, strict=True)))
    return all_rows, Actions(*map(np.concatenate, zip(actions, damping, strict=True)))
