"""Joints of one table of a case, resolved: rows between bodies that move, what acts along them."""

from typing import NamedTuple

import numpy as np

from particlerb.case.joints import JointLoad, JointTable
from particlerb.forces.links import Links
from particlerb.joints.coordinates import coordinates_of
from particlerb.joints.records import AT_REST, STRETCH, Actions, Breaks, ConstraintRows, Coordinates
from particlerb.joints.setup import action, both_actions
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


def action_of(table: JointTable) -> Actions:
    """What acts along the coordinate of a joint."""
    spring, limit = table.spring, table.limit
    return action(
        *((spring.stiffness, spring.rest) if spring else (0.0, 0.0)),
        table.damper,
        *((*limit.range, limit.stiffness, limit.damping) if limit else (-np.inf, np.inf, 0.0, 0.0)),
        table.motor,
    )


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
    )
    none = np.zeros((8, m))
    damping = Actions(*none)._replace(
        damping=links.damping, lower=none[3] - np.inf, upper=none[4] + np.inf
    )
    both = ConstraintRows(*(np.concatenate(pair) for pair in zip(rows, own, strict=True)))
    return both, both_actions(actions, damping)
