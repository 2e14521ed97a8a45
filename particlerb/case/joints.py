"""The table of [[joint]]: which bodies it ties, where, and about which axes."""

import math
from typing import Annotated, Literal, Self, get_args

import numpy as np
from pydantic import Field, Strict, model_validator

from particlerb.case.forces import During
from particlerb.case.values import (
    LARGEST_COUNT,
    Array2,
    Forms,
    Label,
    Name,
    Names,
    NonNegative,
    Positive,
    Real,
    Table,
    Vector,
    Yes,
    ascending,
    broken,
    entries,
    nonzero,
    require,
)

JointType = Literal[
    "ball", "hinge", "slider", "universal", "cylindrical", "planar", "fixed", "distance", "screw",
    "rack", "gear",
]  # fmt: skip
TYPES_WITH_COORDINATES = ("hinge", "slider", "universal", "cylindrical", "planar", "screw")
ALONG = {
    "ball": ("turn",),
    "hinge": ("angle",),
    "universal": ("angle about axis", "angle about axis_to"),
    "slider": ("displacement",),
    "cylindrical": ("displacement", "angle"),
    "screw": ("displacement", "angle"),
    "planar": ("first displacement", "second displacement", "angle"),
}
"""Names of coordinates along which something may act."""
ACTIONS = ("spring", "damper", "limit", "motor", "friction")
"""What acts along a coordinate."""
ROLLING = ("screw", "rack", "gear")
WITHOUT_AXIS = ("ball", "fixed", "distance")


_Speed = Annotated[Real | Array2, Forms("number", "rows")]


class InFrame(Table):
    """Vector in the frame of a body; points from its centre of mass."""

    body: Vector
    """Components in the body frame. [m or -]"""


_Point = Annotated[Vector | InFrame, Forms("list", "table")]
_Direction = Annotated[_Point, nonzero("a direction")]


def _mesh(teeth: tuple[int, int]) -> bool:
    """Whether these are teeth, of one ring at most, which has more of them than the other."""
    is_large = max(map(abs, teeth)) > LARGEST_COUNT
    return not (0 in teeth or sum(teeth) == 0 or max(teeth) < 0 or is_large)


_MESHES = require(
    _mesh, "must be numbers of teeth; negative one at most, of a ring, which has more"
)
_Number = Annotated[int, Strict()]
_TEETH_HINT = "give those of `body` and of the other side: teeth = [20, 40]"
_Teeth = Annotated[tuple[_Number, _Number], entries(2, hint=_TEETH_HINT), _MESHES]
_Lead = Annotated[Real, require(bool, "must not be 0")]


class JointSpring(Table):
    """A spring along the free coordinate of a joint, which is 0 at the start."""

    stiffness: Positive
    """Over the coordinate. [N m/rad or N/m]"""
    rest: Real = 0.0
    """Coordinate at which it does nothing. [rad or m]"""


class JointLimit(Table):
    """Stops of the free coordinate: springs beyond a range, or impulses at its ends."""

    range: tuple[Real, Real]
    """Least and largest coordinate. [rad or m]"""
    stiffness: Positive | None = None
    """Beyond them; default: hard stops, for contact.law = "impulse". [N m/rad or N/m]"""
    damping: NonNegative = 0.0
    """Beyond them. [N m s/rad or N s/m]"""
    restitution: Annotated[NonNegative, Field(le=1.0)] = 0.0
    """Of hard stops. [-]"""


class JointMotor(Table):
    """A motor that keeps a speed with no more than a largest torque or force."""

    speed: Real
    """Of the coordinate. [rad/s or m/s]"""
    largest: Positive
    """Size of its torque or force at most. [N m or N]"""


_Motor = Annotated[Real | JointMotor, Forms("number", "table")]


class JointLoad(Table):
    """The load at which a joint breaks: any of these."""

    force: Positive | None = None
    """Size of its force. [N]"""
    torque: Positive | None = None
    """Size of its torque, at its point. [N m]"""

    @model_validator(mode="after")
    def has_one(self) -> Self:
        """Require one of both."""
        if self.force is None and self.torque is None:
            raise broken("names neither force nor torque")
        return self


class JointDrive(Table):
    """What the free coordinate of a joint is prescribed to be; it starts at 0."""

    position: Array2 | None = None
    """Knots [t, coordinate] of a cubic spline, from [0, 0] on. [s, rad or m]"""
    end_speeds: tuple[Real, Real] = (0.0, 0.0)
    """At its first and last knot, and after it. [rad/s or m/s]"""
    speed: _Speed | None = None
    """Constant, or knots [t, speed] between which it is linear, and after which it stays. [rad/s or
    m/s]"""
    amplitude: Real | None = None
    """A of A (sin(2π f t + φ) - sin φ). [rad or m]"""
    frequency: Positive | None = None
    """Frequency f. [1/s]"""
    phase: Real = 0.0
    """Phase φ. [rad]"""

    @model_validator(mode="after")
    def has_one_course(self) -> Self:
        """Require one way to prescribe it, with knots that ascend from 0 on."""
        ways = "position", "speed", "amplitude"
        given_ways = [name for name in ways if getattr(self, name) is not None]
        if len(given_ways) != 1:
            raise broken("takes one of position, speed and amplitude")
        if (self.amplitude is None) != (self.frequency is None):
            raise broken("goes with amplitude: give both", "frequency")
        way = given_ways[0]
        knots = getattr(self, way)
        if isinstance(knots, np.ndarray):
            hint = "a jump of speed takes an infinite force: let it rise" if way == "speed" else ""
            ascending(knots[:, 0].tolist(), way, hint)
        return self


class JointTable(Table):
    """A joint between a body and another one, or the world; or many of the same kind."""

    type: JointType
    """What it leaves free: see docs/joints.md. [-]"""
    name: Label | None = None
    """Of the joint; default: arm-base. [-]"""
    body: Names
    """Name of a [[body]] block, of one body, or a list. [-]"""
    to: Names | None = None
    """Bodies at the other side: one for each, or one for all; default: the world. [-]"""
    chain: Yes = False
    """Whether each of `body` is tied to the one before. [-]"""
    at: _Point | None = None
    """Point of the joint: world frame at the start, or { body = [..] }; default: the centre of
    mass. [m]"""
    at_to: _Point | None = None
    """Point of the other side, given alike; default: where `at` is, of a distance and a gear the
    centre of mass. Of a rack a point of its pitch line. [m]"""
    axis: _Direction | None = None
    """Axis of the joint, of planar the normal, of universal the axis of `body`: world frame at the
    start, or { body = [..] }. [-]"""
    axis_to: _Direction | None = None
    """Of universal: the axis of the other side, across `axis`. Of rack: its direction. [-]"""
    teeth: _Teeth | None = None
    """Of gear: teeth of `body` and of the other side; of a ring with teeth inside, negative. [-]"""
    lead: _Lead | None = None
    """Of screw: the shift in a turn; of a left-handed one, negative. [m]"""
    along: Name | None = None
    """Coordinate along which spring, damper, limit, motor, friction and drive act: see
    docs/joints.md; default: the only one. [-]"""
    spring: JointSpring | None = None
    """Along the free coordinate. [-]"""
    damper: NonNegative = 0.0
    """Torque or force over the speed. [N m s/rad or N s/m]"""
    limit: JointLimit | None = None
    """Stops of the free coordinate. [-]"""
    motor: _Motor | None = None
    """Constant torque about, or force along it, on `body`; or a speed that it keeps. [N m or N]"""
    friction: NonNegative = 0.0
    """Coulomb's: torque or force at most. [N m or N]"""
    drive: JointDrive | None = None
    """Prescribes the free coordinate. [-]"""
    during: During | None = None
    """Start, which is 0, and time of release; default: always. [s]"""
    breaks_at: JointLoad | None = None
    """Load at which it is released; default: none. [-]"""
    merge: Yes = True
    """Of fixed: whether the two become one body, where that is exact. [-]"""
    collide: Yes = False
    """Whether the two bodies may touch each other. [-]"""
    assemble: Yes = False
    """Whether bodies may be moved at the start until it fits. [-]"""

    @property
    def until(self) -> float:
        """When it is released [s]; inf: never."""
        return math.inf if self.during is None else self.during[1]


JOINT_TYPES: tuple[str, ...] = get_args(JointType)
