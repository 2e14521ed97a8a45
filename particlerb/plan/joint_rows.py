"""Joints of one table of a case, resolved between the bodies that move."""

from typing import NamedTuple

import numpy as np

from particlerb.joints.coordinates import coordinates_of
from particlerb.joints.records import ConstraintRows, Coordinates
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
