"""Joints of one table of a case, resolved: rows between bodies that move, what acts along them."""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from particlerb.case.joints import JointLoad, JointMotor, JointTable
from particlerb.forces.links import Links
from particlerb.impulses.records import MOTOR, RUBS, STOP
from particlerb.joints.coordinates import coordinates_of
from particlerb.joints.records import (
    AT_REST,
    STRETCH,
    WHEEL,
    Actions,
    Bounds,
    Breaks,
    ConstraintRows,
    Coordinates,
)
from particlerb.joints.setup import NO_ACTIONS, action, both_actions
from particlerb.joints.types import Ends, rows_of
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.merging import Merging
from particlerb.model.system import System
from particlerb.plan.joint_ends import WORLD, in_hosts, joint_name
from particlerb.plan.merging import merges


class TableJoints(NamedTuple):
    """Joints of one table, with bodies that move."""

    names: list[str]
    coordinates: Coordinates
    rows: ConstraintRows
    record: Ints
    first: Ints
    second: Ints
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
            other = (second != WORLD) & merging.is_merged[second]
            until[merging.is_merged[first] | other] = -np.inf
    own = rows_of(table.type, ends, *rows, table.along)
    axes = ends.first["n"], ends.second.get("m", ends.second["n"])
    return TableJoints(
        names,
        coordinates_of(table.type, ends),
        own,
        np.full(first.size, number),
        ends.a,
        ends.b,
        np.stack([ends.first_at, ends.second_at, *axes], axis=1),
        np.full(first.size, own.kind.size // first.size),
        until,
    )


def actions_of(tables: Sequence[JointTable]) -> Actions:
    """What acts along the coordinates of joints."""
    return reduce(both_actions, map(_action_of, tables), NO_ACTIONS)


def _action_of(table: JointTable) -> Actions:
    """What acts along the coordinate of a joint."""
    spring, limit, stops = table.spring, table.limit, (-np.inf, np.inf, 0.0, 0.0)
    if limit is not None and limit.stiffness is not None:
        stops = (*limit.range, limit.stiffness, limit.damping)
    return action(
        *((spring.stiffness, spring.rest) if spring else (0.0, 0.0)),
        table.damper,
        *stops,
        0.0 if isinstance(table.motor, JointMotor) else table.motor,
    )


def bounds_of(tables: Sequence[JointTable]) -> Bounds:
    """What acts within bounds in joints of these tables; rows are numbers of the tables."""
    found: list[tuple[float, ...]] = []
    for k, table in enumerate(tables):
        limit, motor = table.limit, table.motor
        if limit is not None and limit.stiffness is None:
            found.append((k, STOP, *limit.range, limit.restitution, 0.0, np.inf))
        if isinstance(motor, JointMotor):
            found.append((k, MOTOR, -np.inf, np.inf, 0.0, motor.speed, motor.largest))
        if table.friction > 0.0:
            found.append((k, RUBS, -np.inf, np.inf, 0.0, 0.0, table.friction))
    row, kind, *numbers = np.array(found).reshape(-1, 7).T
    return Bounds(row.astype(np.int64), kind.astype(np.int64), *map(np.ascontiguousarray, numbers))


def bounds_among(bounds: Bounds, rows: ConstraintRows) -> Bounds | None:
    """Those in rows of joints of a group, whose actions they name; None where there are none."""
    row, which = np.nonzero(rows.action[:, None] == bounds.row)
    return Bounds._make([row, *(values[which] for values in bounds[1:])]) if row.size else None


def breaks_of(system: System, record: Ints) -> Breaks:
    """Loads at which joints break, of these records."""
    loads = [table.breaks_at or JointLoad.model_construct() for table in system.joint]
    each = [(load.force or np.inf, load.torque or np.inf) for load in loads]
    return Breaks(*np.ascontiguousarray(np.array(each)[record].T))


def with_dashpots(
    rows: ConstraintRows, actions: Actions, links: Links, n: int
) -> tuple[ConstraintRows, Actions]:
    """Rows and actions of joints of n bodies, with the dashpots among them."""
    assert links.damping is not None
    m = links.first.size
    own = ConstraintRows(
        np.full(m, STRETCH),
        links.first,
        np.where(links.second == WORLD, n, links.second),
        np.ascontiguousarray(links.first_at.T),
        np.ascontiguousarray(links.second_at.T),
        np.zeros((m, 3)),
        np.ones(m),
        np.ones(m),
        actions.motor.size + np.arange(m),
        np.full(m, AT_REST),
        np.zeros((m, WHEEL)),
    )
    none = np.zeros((8, m))
    damping = Actions(*none)._replace(
        damping=links.damping, lower=none[3] - np.inf, upper=none[4] + np.inf
    )
    both = ConstraintRows(*(np.concatenate(pair) for pair in zip(rows, own, strict=True)))
    return both, both_actions(actions, damping)
