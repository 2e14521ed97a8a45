"""What a case says about contact: its law, materials and pairs of them, and the walls.

Bodies touch with their particles of positive radius. A number that is given in [contact] holds for
every pair of materials that does not give its own in [[contact.pair]]. Which pairs can meet, and
so which numbers must be there, is the business of `particlerb.plan.contact_setup`.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, Strict, model_validator

from particlerb.case.values import (
    Name,
    NonNegative,
    OneOrientation,
    Positive,
    Real,
    Table,
    Vector,
    broken,
    entries,
)

Yes = Annotated[bool, Strict()]
_Share = Annotated[NonNegative, Field(le=1.0)]
_Face = Literal["-x", "+x", "-y", "+y", "-z", "+z"]
_End = Literal["-", "+"]
_ORIGIN = (0.0, 0.0, 0.0)
KIND = "Kind of wall. [-]"
NAME = "Unique name. [-]"
_INSIDE = "Whether all bodies are inside at t = 0, or anywhere. [-]"


class Material(Table):
    """A material that bodies and walls are made of."""

    name: Name = Field(description=NAME)
    young: Positive | None = Field(None, description="Young's modulus, for hertz. [Pa]")
    poisson: Annotated[Real, Field(gt=-1.0, le=0.5)] | None = Field(
        None, description="Poisson's ratio, for hertz. [-]"
    )


class ContactNumbers(Table):
    """Numbers of a contact, of one pair of materials or of all."""

    stiffness: Positive | None = Field(None, description="Normal stiffness, hooke. [N/m]")
    tangential_stiffness: NonNegative | None = Field(
        None, description="Tangential stiffness, hooke; default: 2/7 of the normal one. [N/m]"
    )
    restitution: _Share | None = Field(
        None, description="Speed after over speed before a central impact, 0 to 1. [-]"
    )
    friction: NonNegative | None = Field(None, description="Coefficient of sliding friction. [-]")
    rolling_friction: NonNegative | None = Field(
        None, description="Coefficient of rolling friction; default: 0. [-]"
    )


class Pair(ContactNumbers):
    """Numbers of the contact between two materials, or of one with itself."""

    materials: Annotated[tuple[Name, Name], entries(2, "names")] = Field(
        description="Names of the two. [-]"
    )


class ContactTable(ContactNumbers):
    """Contact between bodies and with walls; without this table nothing touches."""

    law: Literal["hooke", "hertz", "impulse", "events"] = Field(
        "hooke", description="Force by overlap, impulses in steps, or at the instants of hits. [-]"
    )
    attract: Yes = Field(False, description="Whether damping may pull. [-]")
    skin: Positive | None = Field(
        None, description="Distance up to which pairs are kept; default: chosen. [m]"
    )
    overlap: NonNegative = Field(
        0.0, description="Overlap at t = 0 that is allowed; rounding always is. [m]"
    )
    relax: Yes = Field(False, description="Whether to push apart what overlaps at t = 0. [-]")
    allow_unstable: Yes = Field(
        False, description="Whether a step above the stability limit is taken. [-]"
    )
    tolerance: Positive = Field(1e-3, description="Residual at which sweeps end, impulse. [-]")
    iterations: Annotated[int, Strict(), Field(ge=1)] = Field(
        20, description="Sweeps over all contacts in a step at most, impulse. [-]"
    )
    solver: Literal["auto", "sweeps", "newton"] = Field(
        "auto", description="Whether Newton's method follows where sweeps do not end, impulse. [-]"
    )
    push_out: _Share = Field(
        0.3, description="Share of an overlap that a step takes away, impulse. [-]"
    )
    slop: NonNegative = Field(
        1e-4, description="Overlap that stays, over the smallest radius, impulse. [-]"
    )
    contact_time: NonNegative | None = Field(
        None,
        description="What hits again within it bounces elastically, events; default: by speed. [s]",
    )
    periodic: Annotated[tuple[NonNegative, ...], entries(3, "numbers")] | None = Field(
        None, description="Sides of the box that repeats in space, 0: without end, events. [m]"
    )
    pair: tuple[Pair, ...] = Field((), description="Pairs of materials, [[contact.pair]]. [-]")

    @property
    def has_stiffness(self) -> bool:
        """Whether contacts are forces, and not impulses."""
        return self.law in ("hooke", "hertz")


# Walls


def _with_a_square(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Require a vector whose length can be found."""
    if not math.isfinite(math.fsum(component * component for component in value)):
        raise broken("is too large: its square overflows")
    return value


class Oscillation(Table):
    """Displacement A sin(2π f t + φ)."""

    amplitude: Vector = Field(description="Amplitude A, world frame. [m]")
    frequency: Positive = Field(description="Frequency f. [1/s]")
    phase: Real = Field(0.0, description="Phase φ. [rad]")


class Prescribed(Table):
    """Motion of a wall or a body, whatever touches it: it turns about a centre that moves."""

    velocity: Vector = Field(_ORIGIN, description="Of the centre, world frame. [m/s]")
    angular_velocity: Annotated[Vector, AfterValidator(_with_a_square)] = Field(
        _ORIGIN, description="World frame. [rad/s]"
    )
    centre: Vector | None = Field(
        None, description="Point of the axis at t = 0, world frame; default: its own. [m]"
    )
    oscillation: Oscillation | None = Field(
        None, description="Added to the motion of the centre; default: none. [-]"
    )

    @property
    def shift(self) -> tuple[float, float, float]:
        """Displacement at t = 0 by the phase of the oscillation, world frame [m]."""
        if self.oscillation is None:
            return _ORIGIN
        x, y, z = self.oscillation.amplitude
        phase = math.sin(self.oscillation.phase)
        return phase * x, phase * y, phase * z


def direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Require a vector that points somewhere."""
    if not any(value):
        raise broken("must not be zero: it is not a direction")
    return value


def once(faces: tuple[str, ...]) -> tuple[str, ...]:
    """Require each face once."""
    if len(set(faces)) < len(faces):
        raise broken("must not repeat a face")
    return faces


_Direction = Annotated[Vector, AfterValidator(direction)]


class Piston(Table):
    """A wall with a mass that slides along an axis: under a load, its weight and contacts."""

    mass: Positive = Field(description="Mass, which is pulled by [gravity] as well. [kg]")
    axis: _Direction = Field(description="Along which it slides, world frame, of any length. [-]")
    load: Real = Field(0.0, description="Constant force along the axis. [N]")
    velocity: Real = Field(0.0, description="Along the axis, at t = 0. [m/s]")
    limits: Annotated[tuple[Real, Real], entries(2)] | None = Field(
        None, description="Least and largest displacement; default: none. [m]"
    )

    @model_validator(mode="after")
    def has_room(self) -> Self:
        """Require limits around 0, where it starts."""
        low, high = self.limits or (-1.0, 1.0)
        if not low <= 0.0 <= high or low == high:
            raise broken(f"must be below and above 0, got [{low!r}, {high!r}]", "limits")
        return self


class WallTable(Table):
    """What all walls share."""

    type: str = Field(description=KIND)
    name: Name = Field(description=NAME)
    material: Name | None = Field(
        None, description="Name of a [[material]]; default: the only one. [-]"
    )
    motion: Prescribed | None = Field(None, description="How it moves; default: not at all. [-]")
    piston: Piston | None = Field(
        None, description="How it slides under a load; default: it does not. [-]"
    )


class PlaneWall(WallTable):
    """A plane; bodies are on the side to which its normal points."""

    type: Literal["plane"] = Field(init=False, description=KIND)
    point: Vector = Field(_ORIGIN, description="Any of its points, world frame. [m]")
    normal: _Direction = Field(description="Towards the bodies, of any length. [-]")


class BoxWall(WallTable):
    """A box along the axes of the world, thin faces of which some may be open."""

    type: Literal["box"] = Field(init=False, description=KIND)
    lower: Vector = Field(description="Lower corner, world frame. [m]")
    upper: Vector = Field(description="Upper corner, world frame. [m]")
    open: Annotated[tuple[_Face, ...], AfterValidator(once)] = Field(
        (), description="Faces that are not there. [-]"
    )
    inside: Yes = Field(True, description=_INSIDE)

    @model_validator(mode="after")
    def is_box(self) -> Self:
        """Require lower < upper on each axis, and a face."""
        for axis, (a, b) in enumerate(zip(self.lower, self.upper, strict=True)):
            if a >= b:
                raise broken(
                    f"must be above lower on each axis, is {b!r} on {'xyz'[axis]}", "upper"
                )
        if len(self.open) == 6:
            raise broken("leaves no face of the box", "open")
        return self


class CylinderWall(WallTable):
    """A cylinder, a thin tube with ends of which some may be open."""

    type: Literal["cylinder"] = Field(init=False, description=KIND)
    centre: Vector = Field(_ORIGIN, description="Middle of its axis, world frame. [m]")
    axis: _Direction = Field((0.0, 0.0, 1.0), description="Along the axis, of any length. [-]")
    radius: Positive = Field(description="Inner radius. [m]")
    length: Positive = Field(description="Between the ends. [m]")
    open: Annotated[tuple[_End, ...], AfterValidator(once)] = Field(
        (), description="Ends that are not there: against the axis (-), along it (+). [-]"
    )
    inside: Yes = Field(True, description=_INSIDE)


class MeshWall(WallTable):
    """A thin surface of triangles from a file, which trimesh reads."""

    type: Literal["mesh"] = Field(init=False, description=KIND)
    file: Name = Field(description="STL file, relative to the folder of the case. [-]")
    scale: Positive = Field(1.0, description="Length of the unit of the file: 0.001 for mm. [m]")
    position: Vector = Field(_ORIGIN, description="Of the file's origin, world frame. [m]")
    orientation: OneOrientation = Field(
        (1.0, 0.0, 0.0, 0.0),
        description="File to world axes: quaternion or { euler_deg = [..] }. [-]",
    )


AnyWall = PlaneWall | BoxWall | CylinderWall | MeshWall
Wall = Annotated[AnyWall, Field(discriminator="type")]
