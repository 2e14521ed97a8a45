"""Joints at the start, and what acts along their free coordinates, in MuJoCo's words.

Springs, dampers and friction are attributes of a joint, hard stops its limits, which MuJoCo keeps
softly. A motor is an actuator, and its `ctrl` comes on top: to a torque or force a torque or force,
to a speed a speed. A stop that is a spring is left out: in MuJoCo it gives accelerations.

Source: mujoco.readthedocs.io, XML reference, `body/joint` and `actuator/general`.
"""

from typing import Final, NamedTuple

import numpy as np

from particlerb.case.joints import JointMotor, JointTable
from particlerb.export.bodies import numbers
from particlerb.forces.links import WORLD
from particlerb.maths.vec3 import Floats, Ints
from particlerb.model import state
from particlerb.model.system import System
from particlerb.plan.joints import SystemJoints

_TYPES: Final = ("hinge", "slider", "ball")
_SLIP: Final = 1e-3  # rad/s or m/s, that a motor with a speed lacks where it gives its largest load


class Joint(NamedTuple):
    """A joint at the start, world frame."""

    name: str
    type: str
    first: int
    second: int
    at: Floats
    at_to: Floats
    axis: Floats
    axis_to: Floats
    radius: float  # k of a rack or a screw [m/rad], z_b/z_a of a gear: joints/wheels.py
    record: int  # its number in the case
    table: JointTable


def joint_at_start(system: System, setup: SystemJoints, j: int) -> Joint:
    """A joint of a system at its start."""
    ends: Ints = np.array([setup.body_a[j], setup.body_b[j]])
    points = []
    for b, k in zip(ends.tolist(), (0, 1), strict=True):
        vectors = setup.places[j, [k, k + 2]].T
        if b != WORLD:
            vectors = state.rotate(np.repeat(system.state.q[:, [b]], 2, axis=1), vectors)
            vectors = vectors + system.state.com[:, [b]] * np.array([1.0, 0.0])
        points.append(vectors.T)
    wheel = setup.rows.wheel[setup.start[j] : setup.start[j + 1]]
    radius = wheel[np.abs(wheel[:, 9]).argmax(), 10 if setup.types[j] == "gear" else 9]
    (at, axis), (at_to, axis_to) = points
    first, second = ends.tolist()
    kind, record = setup.types[j], int(setup.record[j])
    places = first, second, at, at_to, axis, axis_to
    return Joint(setup.names[j], kind, *places, float(radius), record, system.joint[record])


def freedoms(joint: Joint) -> list[tuple[str, Floats]]:
    """What a joint leaves free, the first next to the second body: kind and axis."""
    n, m = joint.axis, joint.axis_to
    if joint.type == "planar":
        e, f = state.axes_across(n)
        return [("slide", e), ("slide", f), ("hinge", n)]
    kinds: dict[str, list[tuple[str, Floats]]] = {
        "hinge": [("hinge", n)],
        "slider": [("slide", n)],
        "cylindrical": [("slide", n), ("hinge", n)],
        "screw": [("slide", n), ("hinge", n)],
        "universal": [("hinge", m), ("hinge", n)],
    }
    return kinds.get(joint.type, [])


def laws_of(table: JointTable, stop: str) -> dict[str, dict[str, str]]:
    """Attributes by the keys of the case that they stand for.

    Those of `motor` are for an actuator, the others for the joint. `stop` is the `solref` of stops.
    """
    if table.type not in _TYPES:
        return {}
    laws: dict[str, dict[str, str]] = {}
    if table.spring is not None:
        rest = {"springref": numbers(table.spring.rest)} if table.type != "ball" else {}
        laws["spring"] = {"stiffness": numbers(table.spring.stiffness), **rest}
    if table.damper:
        laws["damper"] = {"damping": numbers(table.damper)}
    if table.friction:
        laws["friction"] = {"frictionloss": numbers(table.friction)}
    if table.limit is not None and table.limit.stiffness is None and not table.limit.restitution:
        laws["limit"] = {"range": numbers(*table.limit.range), "solreflimit": stop}
    if isinstance(table.motor, JointMotor):
        gain, largest = table.motor.largest / _SLIP, table.motor.largest
        bias = {"gainprm": numbers(gain), "biasprm": numbers(gain * table.motor.speed, 0.0, -gain)}
        laws["motor"] = {"biastype": "affine", "forcerange": numbers(-largest, largest), **bias}
    elif table.motor:
        laws["motor"] = {"biastype": "affine", "biasprm": numbers(table.motor, 0.0, 0.0)}
    return laws
