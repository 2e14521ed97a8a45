"""The types of joints: one row of the table each, as rows of constraints between two bodies.

n is the axis of a joint, e and f stand across it, m is the second axis of a universal joint; all
are fixed in both bodies and the same at the start, but for m, which is fixed in the second alone.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from particlerb.joints.records import (
    ALONG,
    AT_REST,
    DISTANCE,
    DOT,
    HOLDS,
    TURN,
    WORLD_ALONG,
    ConstraintRows,
)
from particlerb.maths.vec3 import Floats, Ints


class Row(NamedTuple):
    """One constraint: its kind, and the names of the directions that it takes."""

    kind: int
    axis: str = ""  # u, fixed in the second body, or in the world
    first: str = ""  # n of DOT, fixed in the first body


POINT: Final = tuple(Row(WORLD_ALONG, axis) for axis in "xyz")
PARALLEL: Final = Row(DOT, "e", "n"), Row(DOT, "f", "n")
ON_AXIS: Final = Row(ALONG, "e"), Row(ALONG, "f")
NO_TURN: Final = Row(DOT, "f", "e")

TYPES: Final[Mapping[str, tuple[Row, ...]]] = {
    "ball": POINT,
    "hinge": (*POINT, *PARALLEL),
    "universal": (*POINT, Row(DOT, "m", "n")),
    "slider": (*ON_AXIS, *PARALLEL, NO_TURN),
    "cylindrical": (*ON_AXIS, *PARALLEL),
    "planar": (Row(ALONG, "n"), *PARALLEL),
    "fixed": (*POINT, *PARALLEL, NO_TURN),
    "distance": (Row(DISTANCE),),
}

_ANGLE: Final = Row(TURN, "n", "e")
COORDINATES: Final[Mapping[str, Mapping[str, Row]]] = {
    "hinge": {"angle": _ANGLE},
    "slider": {"displacement": Row(ALONG, "n")},
    "cylindrical": {"displacement": Row(ALONG, "n"), "angle": _ANGLE},
    "planar": {
        "first displacement": Row(ALONG, "e"),
        "second displacement": Row(ALONG, "f"),
        "angle": _ANGLE,
    },
}
"""Free coordinates of joints, along which springs, stops, motors, dampers and drives act."""


class Ends(NamedTuple):
    """Equal joints between pairs of bodies; vectors (k, 3) in rotor frames, or of the world."""

    a: Ints  # (k,)
    b: Ints  # (k,)
    first_at: Floats  # [m] point of the first body
    second_at: Floats  # [m] point of the second
    first: Mapping[str, Floats]  # directions in the first body
    second: Mapping[str, Floats]  # in the second; x, y, z of the world; `at`: where first_at is
    length: Floats  # (k,) [m]
    size: Floats  # (k,) [m]


def rows_of(
    kind: str, ends: Ends, action: int = HOLDS, drive: int = AT_REST, along: str | None = None
) -> ConstraintRows:
    """Rows of joints of a type, joint after joint; the last ones of an action and of a drive.

    These are along the coordinate of that name, or the only one.
    """
    parts = [_row_of(row, ends) for row in TYPES[kind]]
    if action != HOLDS:
        own = _coordinate_of(kind, ends, along)
        parts.append(own._replace(action=np.full(ends.a.size, action)))
    if drive != AT_REST:
        own = _coordinate_of(kind, ends, along)
        parts.append(own._replace(drive=np.full(ends.a.size, drive)))
    stacked = (np.stack(arrays, axis=1) for arrays in zip(*parts, strict=True))
    return ConstraintRows(*(array.reshape(-1, *array.shape[2:]) for array in stacked))


def _coordinate_of(kind: str, ends: Ends, along: str | None) -> ConstraintRows:
    """A free coordinate of each of the joints, 0 at the start."""
    row = COORDINATES[kind][along or next(iter(COORDINATES[kind]))]
    own = _row_of(row, ends)
    return own if row.kind == TURN else own._replace(second=ends.second["at"])


def _row_of(row: Row, ends: Ends) -> ConstraintRows:
    """One row of each of the joints."""
    k = ends.a.size
    none, one = np.zeros((k, 3)), np.ones(k)
    is_dot, is_turn = row.kind == DOT, row.kind == TURN
    return ConstraintRows(
        np.full(k, row.kind),
        ends.a,
        ends.b,
        ends.first[row.first] if is_dot or is_turn else ends.first_at,
        none if is_dot else ends.second[row.first] if is_turn else ends.second_at,
        ends.second[row.axis] if row.axis else none,
        ends.length if row.kind == DISTANCE else one,
        one if is_dot or is_turn else ends.size,
        np.full(k, HOLDS),
        np.full(k, AT_REST),
    )
