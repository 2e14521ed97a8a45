"""The table of [[joint]]: which bodies it ties, where, and about which axes."""

import math
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, Field, Strict, model_validator

from particlerb.case.forces import During
from particlerb.case.problems import Path, nearest
from particlerb.case.raw import Finding, bodies_named, entry_at, given
from particlerb.case.values import (
    LARGEST_COUNT,
    Array2,
    FloatArray,
    Forms,
    Name,
    Names,
    NonNegative,
    Positive,
    Real,
    Table,
    Vector,
    Yes,
    broken,
    entries,
    first_out_of_order,
    nonzero,
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
_LARGEST_BOUNCE = 2.6  # rad: a step of a fast body may pass what is nearer to half a turn
ROLLING = ("screw", "rack", "gear")
WITHOUT_AXIS = ("ball", "fixed", "distance")


_Speed = Annotated[Real | Array2, Forms("number", "rows")]


class InFrame(Table):
    """Vector in the frame of a body; points from its centre of mass."""

    body: Vector
    """Components in the body frame. [m or -]"""


_Point = Annotated[Vector | InFrame, Forms("list", "table")]
_Direction = Annotated[_Point, nonzero("a direction")]


def _mesh(teeth: tuple[int, int]) -> tuple[int, int]:
    """Require teeth, of one ring at most, which has more of them than the other."""
    if 0 in teeth or sum(teeth) == 0 or max(teeth) < 0 or max(map(abs, teeth)) > LARGEST_COUNT:
        raise broken("must be numbers of teeth; negative one at most, of a ring, which has more")
    return teeth


def _is_not_zero(value: float) -> float:
    """Require a number that is not 0."""
    if value == 0.0:
        raise broken("must not be 0")
    return value


_Number = Annotated[int, Strict()]
_TEETH = "give those of `body` and of the other side: teeth = [20, 40]"
_Teeth = Annotated[tuple[_Number, _Number], entries(2, hint=_TEETH), AfterValidator(_mesh)]
_Lead = Annotated[Real, AfterValidator(_is_not_zero)]


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
        knots = getattr(self, given_ways[0])
        if isinstance(knots, np.ndarray):
            _check_knots(knots, given_ways[0])
        return self


def _check_knots(knots: FloatArray, key: str) -> None:
    """Require knots of a drive that begin at 0 and ascend."""
    if len(knots) < 2:
        raise broken(f"needs two knots at least, has {len(knots)}", key)
    k = first_out_of_order(knots[:, 0].tolist())
    if k is not None:
        hint = "a jump of speed takes an infinite force: let it rise" if key == "speed" else ""
        raise broken(f"must ascend in time, knot {k} is at {knots[k, 0]} s", key, hint)
    if knots[0, 0] != 0.0 or (key == "position" and knots[0, 1] != 0.0):
        start = "[0, 0]: where the bodies stand" if key == "position" else "the time 0"
        raise broken(f"must begin at {start}", key)


class JointTable(Table):
    """A joint between a body and another one, or the world; or many of the same kind."""

    type: JointType
    """What it leaves free: see docs/joints.md. [-]"""
    name: Name | None = None
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
    motor: _Motor = 0.0
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


def joint_rules(
    path: Path, raw: dict[str, Any], known: dict[str, range], law: str
) -> Iterator[Finding]:
    """A joint has the axes that it needs, and two ends; `law` is that of [contact], if any."""
    kind = raw.get("type")
    if kind in JOINT_TYPES:
        needed = {"axis": kind not in WITHOUT_AXIS, "axis_to": kind in ("universal", "rack")}
        needed |= {"teeth": kind == "gear", "lead": kind == "screw"}
        for key, is_needed in needed.items():
            if is_needed and not given(raw, key):
                yield (*path, key), "missing", f"a {kind} joint needs one"
            elif given(raw, key) and not is_needed:
                yield (*path, key), f"a {kind} joint has none", "leave it out"
    yield from _action_rules(path, raw)
    yield from _bound_rules(path, raw, law)
    if entry_at(raw, "during", list)[:1] not in ([], [0.0]):
        hint = "a body cannot be caught by a joint: give [0, time of release]"
        yield (*path, "during"), "a joint acts from the start on", hint
    yield from _other_end_rules(path, raw)
    first = bodies_named(raw.get("body"), known)
    if raw.get("chain") is True:
        yield from _chain_rules(path, raw, first)
    elif given(raw, "to"):
        second = bodies_named(raw["to"], known)
        if first and second:
            n, m = sum(map(len, first)), sum(map(len, second))
            if m not in {n, 1}:
                hint = "name equal numbers, or one for all"
                yield (*path, "to"), f"names {m} bodies, `body` {n}: they make no pairs", hint


def _other_end_rules(path: Path, raw: dict[str, Any]) -> Iterator[Finding]:
    """The other end is somewhere, and in a frame that there is."""
    kind = raw.get("type")
    if kind in ("distance", "gear") and not any(given(raw, x) for x in ("to", "at_to", "chain")):
        yield (*path, "at_to"), "missing", "give the other end, of a body with `to`"
    if kind == "rack" and not given(raw, "at_to"):
        yield (*path, "at_to"), "missing", "give a point of the pitch line of the rack"
    if isinstance(raw.get("at_to"), dict) and not given(raw, "to") and not raw.get("chain"):
        yield (*path, "at_to"), "the world has no body frame", "give three numbers"


def _chain_rules(path: Path, raw: dict[str, Any], bodies: list[range] | None) -> Iterator[Finding]:
    """A chain has links, and says where each is tied in its own frame."""
    if given(raw, "to"):
        yield (*path, "to"), "given beside chain", "a second [[joint]] ties an end of the chain"
    if bodies and sum(map(len, bodies)) < 2:
        yield (*path, "body"), "a chain needs two bodies at least", "give a `count`, or a list"
    for key in ("at", "at_to"):
        if isinstance(raw.get(key), list):
            hint = f"give {key} = {{ body = [..] }}"
            yield (*path, key), "each link of a chain is tied in its own frame", hint


def within_bounds(raw: dict[str, Any]) -> dict[str, str]:
    """Keys of a joint that are impulses within bounds, and what to take in their place."""
    limit = raw.get("limit")
    is_hard = isinstance(limit, dict) and not given(limit, "stiffness")
    found = {"limit": "give a stiffness"} if is_hard else {}
    found |= {"motor": "give a number"} if isinstance(raw.get("motor"), dict) else {}
    return found | ({"friction": "take a damper"} if raw.get("friction") else {})


def _bound_rules(path: Path, raw: dict[str, Any], law: str) -> Iterator[Finding]:
    """Hard stops, friction, and motors with a largest torque are impulses within bounds."""
    limit, kind = raw.get("limit"), raw.get("type")
    if isinstance(limit, dict) and not given(limit, "stiffness"):
        ends = entry_at(limit, "range", list)
        known = len(ends) == 2 and all(isinstance(x, int | float) for x in ends)
        if known and ends[0] < ends[1] and not ends[0] <= 0.0 <= ends[1]:
            reason = "the bodies stand at 0 at the start, beyond a hard stop"
            yield (*path, "limit", "range"), reason, "let the range hold 0"
        is_angle = kind in ("hinge", "universal") or raw.get("along") == "angle"
        bounces = known and is_angle and bool(limit.get("restitution"))
        if bounces and max(map(abs, ends)) > _LARGEST_BOUNCE:
            reason = "a stop this near to half a turn may be passed before the bounce is seen"
            hint = f"keep it within {_LARGEST_BOUNCE} rad, or leave `restitution` out"
            yield (*path, "limit", "range"), reason, hint
        if limit.get("damping"):
            yield (*path, "limit", "damping"), "hard stops have none", "give `restitution`"
    elif isinstance(limit, dict) and limit.get("restitution"):
        yield (*path, "limit", "restitution"), "springs have none", "give `damping`"
    for key, other in within_bounds(raw).items():
        if law in ("", "hooke", "hertz"):
            reason = "is solved by impulses alone"
            yield (*path, key), reason, f'take contact.law = "impulse", or {other}'
        elif given(raw, "drive"):
            yield (*path, key), "given beside drive, which leaves nothing free", "leave one out"


def _action_rules(path: Path, raw: dict[str, Any]) -> Iterator[Finding]:
    """What acts along a coordinate needs one, and stops a range."""
    kind = entry_at(raw, "type", str)
    for key in (*ACTIONS, "drive"):
        if raw.get(key) and kind in JOINT_TYPES and kind not in ALONG:
            reason = f"nothing acts along a {kind} joint yet"
            yield (*path, key), reason, f"take one of {', '.join(ALONG)}"
        elif raw.get(key) and kind == "ball" and key not in ("spring", "damper"):
            yield (*path, key), "along a ball joint act springs and dampers alone", "leave it out"
        elif raw.get(key) and len(ALONG.get(kind, "")) > 1 and not given(raw, "along"):
            yield (*path, "along"), f"missing: a {kind} joint has several coordinates", ""
        if raw.get(key) and given(raw, "breaks_at"):
            yield (*path, "breaks_at"), f"given beside {key}", "let a second joint have one of them"
    if kind == "ball" and entry_at(raw, "spring", dict).get("rest"):
        hint = "place the bodies where the spring does nothing"
        yield (*path, "spring", "rest"), "the spring of a ball joint rests at the start", hint
    names, along = ALONG.get(kind, ()), entry_at(raw, "along", str)
    if along and along not in names:
        yield (*path, "along"), f"a {kind} joint has no {along}", nearest(along, list(names))
    ends = entry_at(raw.get("limit"), "range", list)
    if len(ends) == 2 and all(isinstance(x, int | float) for x in ends):
        if not ends[0] < ends[1]:
            yield (*path, "limit", "range"), "must ascend", "give the least coordinate first"
        elif "angle" in str(along or names[:1]) and max(map(abs, ends)) >= math.pi:
            yield (*path, "limit", "range"), "beyond half a turn", "give angles between -π and π"
