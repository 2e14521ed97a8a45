"""Bodies as types: what they are made of, how many there are, where, and how they move at first."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from particlerb.case.contact import Prescribed
from particlerb.case.shapes import Cloud, Shape
from particlerb.case.values import (
    ORIGIN,
    Array3,
    Array4,
    Count,
    Counts,
    EachPositive,
    Euler,
    FloatArray,
    Forms,
    IntArray,
    Name,
    NonNegative,
    OneOrientation,
    Positive,
    Quaternion,
    Spacing,
    Table,
    Vector,
    Yes,
    broken,
    require,
)

_IDENTITY = (1.0, 0.0, 0.0, 0.0)


class InBody(Table):
    """Vector in the body's own axes."""

    body: Vector
    """Components in the body frame. [m/s or rad/s]"""


class NormalDistribution(Table):
    """Normally distributed components, drawn for every body."""

    random: NonNegative
    """Standard deviation per component. [m/s or rad/s]"""


class GridPlacement(Table):
    """Bodies on a grid, x fastest, centred at `origin`."""

    type: Literal["grid"] = Field(init=False)
    """Kind of force or placement. [-]"""
    spacing: Spacing
    """Distance between neighbours, one or per axis. [m]"""
    n: Counts | None = None
    """Bodies per axis; default: nearly a cube. [-]"""
    origin: Vector = (0.0, 0.0, 0.0)
    """Centre of the grid, world frame. [m]"""


class RandomBox(Table):
    """Bodies anywhere in a box, uniformly."""

    type: Literal["random"] = Field(init=False)
    """Kind of force or placement. [-]"""
    lower: Vector
    """Lower corner, world frame. [m]"""
    upper: Vector
    """Upper corner, world frame. [m]"""

    @model_validator(mode="after")
    def is_ordered(self) -> Self:
        """Require lower <= upper on each axis."""
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise broken("must not be below lower on any axis", "upper")
        return self


_Position = Annotated[Vector | Array3, Forms("list", "rows")]
_Orientation = Annotated[
    Quaternion | Euler | Literal["random"] | Array4, Forms("list", "table", "word", "rows")
]
Motion = Annotated[
    Vector | InBody | NormalDistribution | Array3, Forms("list", "table", "random", "rows")
]
AnyPlace = GridPlacement | RandomBox
_Place = Annotated[AnyPlace, Field(discriminator="type")]


_Matter = Annotated[Positive | EachPositive, Forms("number", "list")]

_WITHOUT_BRACKETS = require(
    lambda name: name.isprintable() and not {"[", "]"} & set(name),
    "must be printable and without brackets",
)  # so that it does not look like a reference


class ShapePart(Table):
    """One shape of a body that is put together from several."""

    shape: Shape
    """Table with `type` and the shape's keys. [-]"""
    mass: NonNegative | None = None
    """Mass; this or density; 0 for spheres that only touch. [kg]"""
    density: Positive | None = None
    """Density; this or mass. [kg/m³]"""
    position: Vector = ORIGIN
    """Of the shape's origin, in the body's axes. [m]"""
    orientation: OneOrientation = _IDENTITY
    """Shape to body axes: quaternion or { euler_deg = [..] }. [-]"""


class Body(Table):
    """A body, or `count` bodies of the same kind."""

    name: Annotated[Name, _WITHOUT_BRACKETS]
    """Unique name. [-]"""
    shape: Shape | None = None
    """Table with `type`; this or [[body.part]]. [-]"""
    part: tuple[ShapePart, ...] = ()
    """Parts of the body; these or shape. [-]"""
    mass: _Matter | None = None
    """Mass of each body, or one per body; this or density. [kg]"""
    density: _Matter | None = None
    """Density, or one per body; this or mass. [kg/m³]"""
    count: Count = 1
    """Number of bodies. [-]"""
    place: _Place | None = None
    """Where many bodies are: grid or random. [-]"""
    position: _Position = ORIGIN
    """Of the centre of mass, world frame; or a row per body. [m]"""
    orientation: _Orientation = _IDENTITY
    """Quaternion w x y z, normalised when read; { euler_deg = [..] }; "random"; or a row per body.
    [-]"""
    velocity: Motion = ORIGIN
    """World frame, { body = [..] }, { random = v }; or rows. [m/s]"""
    angular_velocity: Motion = ORIGIN
    """World frame, { body = [..] }, { random = v }; or rows. [rad/s]"""
    material: Name | None = None
    """Name of a [[material]]; default: the only one. [-]"""
    contact: Yes = True
    """Whether it touches others where [contact] is. [-]"""
    fixed: Yes = False
    """Whether it stays where it is: an obstacle. [-]"""
    motion: Prescribed | None = None
    """How it moves, whatever touches it; default: freely. [-]"""

    @property
    def is_held(self) -> bool:
        """Whether nothing can push it: it is fixed, or moves as prescribed."""
        return self.fixed or self.motion is not None

    @property
    def is_drawn(self) -> bool:
        """Whether its particles are drawn at random: then they are like no others."""
        shapes = self.shape, *(part.shape for part in self.part)
        return any(isinstance(shape, Cloud) for shape in shapes)

    @property
    def matter(self) -> tuple[Any, Any]:
        """Mass [kg] and density [kg/m³], one of them for all bodies, or for each."""
        return self.mass, self.density

    @property
    def is_varied(self) -> bool:
        """Whether its bodies are not copies of one."""
        return self.is_drawn or self.weights is not None

    @property
    def weights(self) -> FloatArray | None:
        """Mass [kg] or density [kg/m³] of each body, if they are given one by one."""
        return next((value for value in self.matter if isinstance(value, np.ndarray)), None)

    @property
    def kinds(self) -> IntArray:
        """Kind of each body, counted from the first of the record; others are copies of it."""
        if self.is_drawn:
            return np.arange(self.count)
        if self.weights is None:
            return np.zeros(self.count, dtype=np.int64)
        return np.unique(self.weights, return_inverse=True)[1]

    @property
    def matter_of_kinds(self) -> list[tuple[Any, Any]]:
        """Matter of each draw; else one entry, a column (k, 1) where there are k kinds."""
        if self.weights is None:
            return [self.matter] * (self.count if self.is_drawn else 1)
        of_kinds = list(self.weights) if self.is_drawn else [np.unique(self.weights)[:, None]]
        return [(None, one) if self.mass is None else (one, None) for one in of_kinds]
