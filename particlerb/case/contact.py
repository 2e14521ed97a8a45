"""What a case says about contact: its law, materials and pairs of them, and the walls.

Bodies touch with their particles of positive radius. A number that is given in [contact] holds for
every pair of materials that does not give its own in [[contact.pair]]. Which pairs can meet, and
so which numbers must be there, is the business of `particlerb.plan.contact_setup`.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, Strict, model_validator

from particlerb.case.values import (
    ORIGIN,
    Direction,
    Label,
    Name,
    NonNegative,
    OneOrientation,
    Positive,
    Real,
    Table,
    Vector,
    Yes,
    broken,
    distinct,
    entries,
    require,
)

_Share = Annotated[NonNegative, Field(le=1.0)]
_Face = Literal["-x", "+x", "-y", "+y", "-z", "+z"]
_End = Literal["-", "+"]


class Material(Table):
    """A material that bodies and walls are made of."""

    name: Label
    """Unique name. [-]"""
    young: Positive | None = None
    """Young's modulus, for hertz. [Pa]"""
    poisson: Annotated[Real, Field(gt=-1.0, le=0.5)] | None = None
    """Poisson's ratio, for hertz. [-]"""


class ContactNumbers(Table):
    """Numbers of a contact, of one pair of materials or of all."""

    stiffness: Positive | None = None
    """Normal stiffness, hooke. [N/m]"""
    tangential_stiffness: NonNegative | None = None
    """Tangential stiffness, hooke; default: 2/7 of the normal one. [N/m]"""
    restitution: _Share | None = None
    """Speed after over speed before a central impact, 0 to 1. [-]"""
    friction: NonNegative | None = None
    """Coefficient of sliding friction. [-]"""
    rolling_friction: NonNegative | None = None
    """Coefficient of rolling friction; default: 0. [-]"""
    torsional_friction: NonNegative | None = None
    """Coefficient of friction against spinning about the normal, impulse; default: 0. [-]"""


class Pair(ContactNumbers):
    """Numbers of the contact between two materials, or of one with itself."""

    materials: Annotated[tuple[Name, Name], entries(2, "names")]
    """Names of the two. [-]"""


class ContactTable(ContactNumbers):
    """Contact between bodies and with walls; without this table nothing touches."""

    law: Literal["hooke", "hertz", "impulse", "events"] = "hooke"
    """Force by overlap, impulses in steps, or at the instants of hits. [-]"""
    attract: Yes = False
    """Whether damping may pull. [-]"""
    skin: Positive | None = None
    """Distance up to which pairs are kept; default: chosen. [m]"""
    overlap: NonNegative = 0.0
    """Overlap at t = 0 that is allowed; rounding always is. [m]"""
    relax: Yes = False
    """Whether to push apart what overlaps at t = 0. [-]"""
    allow_unstable: Yes = False
    """Whether a step above the stability limit is taken. [-]"""
    tolerance: Positive = 1e-3
    """Residual at which sweeps end, impulse. [-]"""
    iterations: Annotated[int, Strict(), Field(ge=1)] = 20
    """Sweeps over all contacts in a step at most, impulse. [-]"""
    solver: Literal["auto", "sweeps", "newton"] = "auto"
    """Whether Newton's method follows where sweeps do not end, impulse. [-]"""
    push_out: _Share = 0.3
    """Share of an overlap that a step takes away, impulse. [-]"""
    slop: NonNegative = 1e-4
    """Overlap or gap that stays, over the smallest radius, impulse. [-]"""
    contact_time: NonNegative | None = None
    """What hits again within it bounces elastically, events; default: by speed. [s]"""
    periodic: Annotated[tuple[NonNegative, ...], entries(3, "numbers")] | None = None
    """Sides of the box that repeats in space, 0: without end, events. [m]"""
    pair: tuple[Pair, ...] = ()
    """Pairs of materials, [[contact.pair]]. [-]"""

    @property
    def has_stiffness(self) -> bool:
        """Whether contacts are forces, and not impulses."""
        return self.law in ("hooke", "hertz")


# Walls


_WITH_A_SQUARE = require(
    lambda vector: math.isfinite(math.fsum(component * component for component in vector)),
    "is too large: its square overflows",
)


class Oscillation(Table):
    """Displacement A sin(2π f t + φ)."""

    amplitude: Vector
    """Amplitude A, world frame. [m]"""
    frequency: Positive
    """Frequency f. [1/s]"""
    phase: Real = 0.0
    """Phase φ. [rad]"""


class Prescribed(Table):
    """Motion of a wall or a body, whatever touches it: it turns about a centre that moves."""

    velocity: Vector = ORIGIN
    """Of the centre, world frame. [m/s]"""
    angular_velocity: Annotated[Vector, _WITH_A_SQUARE] = ORIGIN
    """World frame. [rad/s]"""
    centre: Vector | None = None
    """Point of the axis at t = 0, world frame; default: its own. [m]"""
    oscillation: Oscillation | None = None
    """Added to the motion of the centre; default: none. [-]"""

    @property
    def shift(self) -> tuple[float, float, float]:
        """Displacement at t = 0 by the phase of the oscillation, world frame [m]."""
        if self.oscillation is None:
            return ORIGIN
        x, y, z = self.oscillation.amplitude
        phase = math.sin(self.oscillation.phase)
        return phase * x, phase * y, phase * z


class Piston(Table):
    """A wall with a mass that slides along an axis: under a load, its weight and contacts."""

    mass: Positive
    """Mass, which is pulled by [gravity] as well. [kg]"""
    axis: Direction
    """Along which it slides, world frame, of any length. [-]"""
    load: Real = 0.0
    """Constant force along the axis. [N]"""
    velocity: Real = 0.0
    """Along the axis, at t = 0. [m/s]"""
    limits: Annotated[tuple[Real, Real], entries(2)] | None = None
    """Least and largest displacement; default: none. [m]"""

    @model_validator(mode="after")
    def has_room(self) -> Self:
        """Require limits around 0, where it starts."""
        low, high = self.limits or (-1.0, 1.0)
        if not low <= 0.0 <= high or low == high:
            raise broken(f"must be below and above 0, got [{low!r}, {high!r}]", "limits")
        return self


class WallTable(Table):
    """What all walls share."""

    type: str
    """Kind of wall. [-]"""
    name: Label
    """Unique name. [-]"""
    material: Name | None = None
    """Name of a [[material]]; default: the only one. [-]"""
    motion: Prescribed | None = None
    """How it moves; default: not at all. [-]"""
    piston: Piston | None = None
    """How it slides under a load; default: it does not. [-]"""


class PlaneWall(WallTable):
    """A plane; bodies are on the side to which its normal points."""

    type: Literal["plane"] = Field(init=False)
    point: Vector = ORIGIN
    """Any of its points, world frame. [m]"""
    normal: Direction
    """Towards the bodies, of any length. [-]"""


class BoxWall(WallTable):
    """A box along the axes of the world, thin faces of which some may be open."""

    type: Literal["box"] = Field(init=False)
    lower: Vector
    """Lower corner, world frame. [m]"""
    upper: Vector
    """Upper corner, world frame. [m]"""
    open: Annotated[tuple[_Face, ...], distinct("face")] = ()
    """Faces that are not there. [-]"""
    inside: Yes = True
    """Whether all bodies are inside at t = 0, or anywhere. [-]"""

    @model_validator(mode="after")
    def is_box(self) -> Self:
        """Require lower < upper on each axis, and a face."""
        for axis, low, high in zip("xyz", self.lower, self.upper, strict=True):
            if low >= high:
                raise broken(f"must be above lower on each axis, is {high!r} on {axis}", "upper")
        if len(self.open) == 6:
            raise broken("leaves no face of the box", "open")
        return self


class CylinderWall(WallTable):
    """A cylinder, a thin tube with ends of which some may be open."""

    type: Literal["cylinder"] = Field(init=False)
    centre: Vector = ORIGIN
    """Middle of its axis, world frame. [m]"""
    axis: Direction = (0.0, 0.0, 1.0)
    """Along the axis, of any length. [-]"""
    radius: Positive
    """Inner radius. [m]"""
    length: Positive
    """Between the ends. [m]"""
    open: Annotated[tuple[_End, ...], distinct("face")] = ()
    """Ends that are not there: against the axis (-), along it (+). [-]"""
    inside: Yes = True
    """Whether all bodies are inside at t = 0, or anywhere. [-]"""


class MeshWall(WallTable):
    """A thin surface of triangles from a file, which trimesh reads."""

    type: Literal["mesh"] = Field(init=False)
    file: Name
    """STL file, relative to the folder of the case. [-]"""
    scale: Positive = 1.0
    """Length of the unit of the file: 0.001 for mm. [m]"""
    position: Vector = ORIGIN
    """Of the file's origin, world frame. [m]"""
    orientation: OneOrientation = (1.0, 0.0, 0.0, 0.0)
    """File to world axes: quaternion or { euler_deg = [..] }. [-]"""


AnyWall = PlaneWall | BoxWall | CylinderWall | MeshWall
Wall = Annotated[AnyWall, Field(discriminator="type")]
