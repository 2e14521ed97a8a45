"""The types of joints: one row of the table each, as rows of constraints between two bodies.

n is the axis of a joint, e and f stand across it, m is the second axis of a universal joint; all
are fixed in both bodies and the same at the start, but for m, which is fixed in the second alone.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from particlerb.joints import kinds
from particlerb.joints import records as col
from particlerb.joints.records import ConstraintRows
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model.bodies import quaternions


class _Constraint(NamedTuple):
    """One constraint: its kind, and the names of the directions that it takes."""

    kind: int
    axis: str = ""  # u, fixed in the second body, or in the world; of OWN_TURN in the first
    first: str = ""  # n of DOT, fixed in the first body


POINT: Final = tuple(_Constraint(kinds.WORLD_ALONG, axis) for axis in "xyz")
PARALLEL: Final = _Constraint(kinds.DOT, "e", "n"), _Constraint(kinds.DOT, "f", "n")
ON_AXIS: Final = _Constraint(kinds.ALONG, "e"), _Constraint(kinds.ALONG, "f")
NO_TURN: Final = _Constraint(kinds.DOT, "f", "e")

TYPES: Final[Mapping[str, tuple[_Constraint, ...]]] = {
    "ball": POINT,
    "hinge": (*POINT, *PARALLEL),
    "universal": (*POINT, _Constraint(kinds.DOT, "m", "n")),
    "slider": (*ON_AXIS, *PARALLEL, NO_TURN),
    "cylindrical": (*ON_AXIS, *PARALLEL),
    "planar": (_Constraint(kinds.ALONG, "n"), *PARALLEL),
    "fixed": (*POINT, *PARALLEL, NO_TURN),
    "distance": (_Constraint(kinds.DISTANCE),),
    "screw": (*ON_AXIS, *PARALLEL, _Constraint(kinds.RACK, "n")),
    "rack": (_Constraint(kinds.RACK, "m"),),
    "gear": (_Constraint(kinds.GEAR, "n"),),
}

_ANGLE_CONSTRAINTS: Final = (_Constraint(kinds.TURN, "n", "e"),)
_SHIFT_CONSTRAINTS: Final = (_Constraint(kinds.ALONG, "n"),)
COORDINATES: Final[Mapping[str, Mapping[str, tuple[_Constraint, ...]]]] = {
    "ball": {"turn": tuple(_Constraint(kinds.ROTATION, axis) for axis in "xyz")},
    "hinge": {"angle": _ANGLE_CONSTRAINTS},
    "universal": {
        "angle about axis": (_Constraint(kinds.OWN_TURN, "n", "m"),),
        "angle about axis_to": (_Constraint(kinds.TURN, "m", "n"),),
    },
    "slider": {"displacement": _SHIFT_CONSTRAINTS},
    "cylindrical": {"displacement": _SHIFT_CONSTRAINTS, "angle": _ANGLE_CONSTRAINTS},
    "screw": {"displacement": _SHIFT_CONSTRAINTS, "angle": _ANGLE_CONSTRAINTS},
    "planar": {
        "first displacement": (_Constraint(kinds.ALONG, "e"),),
        "second displacement": (_Constraint(kinds.ALONG, "f"),),
        "angle": _ANGLE_CONSTRAINTS,
    },
}
"""Free coordinates, along which springs, stops, motors, dampers and drives act; in their order."""


class Ends(NamedTuple):
    """Equal joints between pairs of bodies; vectors (k, 3) in rotor frames, or of the world."""

    a: Ints  # (k,)
    b: Ints  # (k,)
    at_a: Floats  # [m] point of the first body
    at_b: Floats  # [m] point of the second
    directions_a: Mapping[str, Floats]  # directions in the first body
    # in the second; x, y, z of the world; `at`: where at_a is
    directions_b: Mapping[str, Floats]
    length: Floats  # (k,) [m]
    size: Floats  # (k,) [m]
    roll: Floats  # (k, 3) k [m/rad], z_b/z_a and pitch [m] of what rolls: wheels.py


def rows_of(
    kind: str,
    ends: Ends,
    action: int = col.HOLDS,
    drive: int = col.AT_REST,
    along: str | None = None,
) -> ConstraintRows:
    """Rows of joints of a type, joint after joint; the last ones of an action and of a drive.

    These are along the coordinate of that name, or the only one.
    """
    parts = [_row_of(row, ends) for row in TYPES[kind]]
    if action != col.HOLDS:
        for constraint in coordinate_rows(kind, ends, along):
            parts.append(constraint._replace(action=np.full(ends.a.size, action)))
    if drive != col.AT_REST:
        for constraint in coordinate_rows(kind, ends, along):
            parts.append(constraint._replace(drive=np.full(ends.a.size, drive)))
    stacked = (np.stack(arrays, axis=1) for arrays in zip(*parts, strict=True))
    return ConstraintRows(*(array.reshape(-1, *array.shape[2:]) for array in stacked))


def coordinate_rows(kind: str, ends: Ends, along: str | None) -> list[ConstraintRows]:
    """Rows along a free coordinate of each of the joints, 0 at the start."""
    rows = COORDINATES[kind][along or next(iter(COORDINATES[kind]))]
    if kind == "ball":
        return [_rotation_of(row, ends) for row in rows]
    constraints = [_row_of(row, ends) for row in rows]
    shifted = [constraint._replace(vector_b=ends.directions_b["at"]) for constraint in constraints]
    return shifted if rows[0].kind == kinds.ALONG else constraints


def _rotation_of(row: _Constraint, ends: Ends) -> ConstraintRows:
    """A component of rotation vectors; c, from frames of b to those of a at the start, is held."""
    pairs = [(ends.directions_a[axis], ends.directions_b[axis]) for axis in "nef"]
    turn = quaternions(sum(np.einsum("ki,kj->kij", *pair) for pair in pairs))
    second = np.pad(turn[:, :1], ((0, 0), (0, 2)))
    return _row_of(row, ends)._replace(vector_a=turn[:, 1:].copy(), vector_b=second)


def _row_of(row: _Constraint, ends: Ends) -> ConstraintRows:
    """One row of each of the joints."""
    k = ends.a.size
    none, one = np.zeros((k, 3)), np.ones(k)
    is_dot, is_turn = row.kind == kinds.DOT, row.kind in (kinds.TURN, kinds.OWN_TURN)
    axes = ends.directions_a if row.kind == kinds.OWN_TURN else ends.directions_b
    second = ends.directions_b["at"] if row.kind == kinds.RACK else ends.at_b
    marks = ends.directions_b["n"], ends.directions_a["mark"], ends.directions_b["mark"], ends.roll
    return ConstraintRows(
        np.full(k, row.kind),
        ends.a,
        ends.b,
        ends.directions_a[row.first] if is_dot or is_turn else ends.at_a,
        none if is_dot else ends.directions_b[row.first] if is_turn else second,
        axes[row.axis] if row.axis else none,
        ends.length if row.kind == kinds.DISTANCE else one,
        one if is_dot or is_turn or row.kind == kinds.ROTATION else ends.size,
        np.full(k, col.HOLDS),
        np.full(k, col.AT_REST),
        np.hstack(marks) if row.kind in (kinds.RACK, kinds.GEAR) else np.zeros((k, col.WHEEL)),
    )
