"""Shapes of bodies: one table per `shape.type`, lengths in metres, axes of the body.

Each class also says what its mass may be given by (`weighed_by`): `mass`, `density`, or neither.
Solids are centred at the origin of their axes unless said otherwise; those with an axis have it
along z. How a shape becomes particles is the business of `geometry.shapes`.
"""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from particlerb.case.values import (
    Count,
    Lengths,
    Name,
    NonNegative,
    Positive,
    Resolution,
    Table,
    Vector,
    broken,
    by_type,
    entries,
)

_Arrangement = Literal["lattice", "exact"]
_BallName = Annotated[Literal["ball", "sphere"], AfterValidator(lambda word: "ball")]
_RoundArrangement = Literal["lattice", "cells", "exact"]
_Share = Annotated[Positive, Field(lt=1.0)]
Vertices = Annotated[tuple[Vector, Vector, Vector, Vector], entries(4, "corners")]


class ShapeTable(Table):
    """What all shapes share."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass", "density")
    type: str
    """Kind of shape. [-]"""


class FilledTable(ShapeTable):
    """A shape that cells fill: how finely is said once."""

    inertia_error: _Share | None = None
    """Chooses n: largest relative error of tensor and centre of mass. [-]"""

    @model_validator(mode="after")
    def says_once_how_fine(self) -> Self:
        """Require n or inertia_error, and neither of them beside an exact set that has no n."""
        wanted = getattr(self, "inertia_error", None)
        default = type(self).model_fields["n"].default
        if wanted is not None and getattr(self, "n", default) != default:
            raise broken("given beside n, which it chooses", "inertia_error", "give one of them")
        if wanted is not None and getattr(self, "arrangement", "lattice") == "exact":
            raise broken("has nothing to choose: this arrangement is exact", "inertia_error")
        return self


class CurvedTable(FilledTable):
    """A curved shape without an exact set."""

    n: Count = 10
    """Particles along the largest extent of the lattice. [-]"""
    arrangement: Literal["lattice", "cells"] = "lattice"
    """Whole cells, or cells weighted by their share inside. [-]"""


class Box(FilledTable):
    """Solid box."""

    type: Literal["box"] = Field(init=False)
    size: Lengths
    """Edge lengths. [m]"""
    n: Resolution = (10, 10, 10)
    """Particles per edge. [-]"""
    arrangement: _Arrangement = "lattice"
    """A lattice, or the smallest exact set of particles. [-]"""


class Ball(FilledTable):
    """Solid ball, a single particle with its radius unless cells fill it; also called a sphere."""

    type: _BallName = Field(init=False)
    radius: Positive
    """Radius, of its matter and of its surface. [m]"""
    n: Count = 10
    """Particles along the largest extent of the lattice. [-]"""
    arrangement: _RoundArrangement = "exact"
    """One particle with the radius, whole cells, or cells weighted by their share inside. [-]"""

    @model_validator(mode="before")
    @classmethod
    def is_filled_where_it_says_how_finely(cls, raw: Any) -> Any:
        """A lattice where there is an n, or an error that chooses it."""
        return {**raw, "arrangement": filling(raw)} if isinstance(raw, Mapping) else raw


def filling(ball: Mapping[str, Any]) -> Any:
    """Arrangement of a ball in the data of a case."""
    is_fine = any(ball.get(key) is not None for key in ("n", "inertia_error"))
    return ball.get("arrangement", "lattice" if is_fine else "exact")


class Shell(CurvedTable):
    """Hollow ball; without `inner_radius` an infinitely thin one, which has no density."""

    type: Literal["shell"] = Field(init=False)
    radius: Positive
    """Outer radius. [m]"""
    inner_radius: Positive | None = None
    """Inner radius; left out: a thin shell. [m]"""
    n: Count = 10
    """As for a ball; on a thin shell per quarter of a great circle. [-]"""

    @model_validator(mode="after")
    def is_hollow(self) -> Self:
        """Require the inner radius below the outer one."""
        if self.inner_radius is not None:
            _require_smaller(self.inner_radius, self.radius)
        elif self.arrangement == "cells":
            raise broken("a thin shell has no cells", "arrangement", "leave it out: it is exact")
        return self


class Cylinder(CurvedTable):
    """Solid or hollow cylinder about z."""

    type: Literal["cylinder"] = Field(init=False)
    radius: Positive
    """Outer radius. [m]"""
    height: Positive
    """Height along z. [m]"""
    inner_radius: NonNegative = 0.0
    """Radius of the bore. [m]"""

    @model_validator(mode="after")
    def has_wall(self) -> Self:
        """Require the bore below the outer radius."""
        _require_smaller(self.inner_radius, self.radius)
        return self


class Cone(CurvedTable):
    """Solid cone about z, base at z = 0, apex at z = height."""

    type: Literal["cone"] = Field(init=False)
    radius: Positive
    """Radius of the base. [m]"""
    height: Positive
    """Height along z. [m]"""


class Torus(CurvedTable):
    """Solid torus about z."""

    type: Literal["torus"] = Field(init=False)
    major_radius: Positive
    """Distance of the tube's centre from the axis. [m]"""
    minor_radius: Positive
    """Radius of the tube. [m]"""

    @model_validator(mode="after")
    def does_not_overlap(self) -> Self:
        """Require a tube that does not cross the axis."""
        if self.minor_radius > self.major_radius:
            reason = f"must be <= major_radius = {self.major_radius!r}, got {self.minor_radius!r}"
            raise broken(reason, "minor_radius")
        return self


class Ellipsoid(FilledTable):
    """Solid ellipsoid."""

    type: Literal["ellipsoid"] = Field(init=False)
    semi_axes: Lengths
    """Half of the lengths along x, y, z. [m]"""
    n: Count = 10
    """Particles along the largest extent of the lattice. [-]"""
    arrangement: _RoundArrangement = "lattice"
    """Whole cells, cells weighted by their share inside, or the smallest exact set. [-]"""


class Tetrahedron(ShapeTable):
    """Solid tetrahedron."""

    type: Literal["tetrahedron"] = Field(init=False)
    vertices: Vertices
    """The four corners. [m]"""
    n: Count = 10
    """Particles per edge. [-]"""
    arrangement: _Arrangement = "lattice"
    """A lattice, or the smallest exact set of particles. [-]"""


class Rod(FilledTable):
    """Thin straight rod along z: it has no volume, hence no density."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["rod"] = Field(init=False)
    length: Positive
    """Length along z. [m]"""
    n: Count = 10
    """Particles along the rod. [-]"""
    arrangement: _Arrangement = "lattice"
    """A lattice, or the smallest exact set of particles. [-]"""


def _for_each(value: Any) -> Any:
    """One number, or a number for each particle; `ListedTable` makes a list of both."""
    return value


_Each = Annotated[
    tuple[NonNegative, ...], BeforeValidator(_for_each, NonNegative | tuple[NonNegative, ...])
]


_PositiveEach = Annotated[
    tuple[Positive, ...], BeforeValidator(_for_each, Positive | tuple[Positive, ...])
]


class ListedTable(ShapeTable):
    """Particles given one by one, in lists or in a file."""

    noun: ClassVar[str]
    """What they are called."""
    lists: ClassVar[tuple[str, ...]]
    """Keys with a number for each, or one for all; the first must be there."""
    position: tuple[Vector, ...] | None = None
    """Centres in the body's axes. [m]"""
    file: Name | None

    @model_validator(mode="before")
    @classmethod
    def repeats_numbers(cls, raw: Any) -> Any:
        """One number for all particles, as a list."""
        position = raw.get("position") if isinstance(raw, Mapping) else None
        if not isinstance(position, (list, tuple)):
            return raw
        single = [key for key in cls.lists if isinstance(raw.get(key), (int, float, str))]
        return {**raw, **{key: [raw[key]] * len(position) for key in single}}

    @model_validator(mode="after")
    def has_one_source(self) -> Self:
        """Require either lists of equal length, or a file."""
        columns = {key: getattr(self, key) for key in ("position", *self.lists)}
        if self.file is not None:
            for key in (key for key, values in columns.items() if values is not None):
                raise broken("particles come from `file` or from lists, not both", key)
            return self
        first = self.lists[0]
        if not self.position:
            hint = f"give `position` and `{first}`, or a `file`"
            raise broken(f"has no {self.noun}", "position", hint)
        if columns[first] is None:
            raise broken(f"{self.noun} need a {first} each", first)
        n = len(self.position)
        for key, values in columns.items():
            if values is not None and len(values) != n:
                raise broken(f"must have {n} entries like position, has {len(values)}", key)
        self.check_lists()
        return self

    def check_lists(self) -> None:
        """Require more of lists of equal length."""


class PointsShape(ListedTable):
    """Particles given one by one, here or in a CSV file; their masses are the body's."""

    noun: ClassVar[str] = "particles"
    lists: ClassVar[tuple[str, ...]] = ("mass", "radius")
    weighed_by: ClassVar[tuple[str, ...]] = ()
    type: Literal["points"] = Field(init=False)
    file: Name | None = None
    """Text or CSV file with columns x, y, z, m and optionally r. [m, kg]"""
    mass: _Each | None = None
    """Masses, or that of every particle. [kg]"""
    radius: _Each | None = None
    """Radii, or that of every particle; 0 is a point mass. [m]"""

    def check_lists(self) -> None:
        """Require a mass or a radius of each, and different places of all masses and all balls."""
        place, mass = self.position or (), self.mass or ()
        radius = self.radius or (0.0,) * len(mass)
        for i, (m, r) in enumerate(zip(mass, radius, strict=True)):
            if m == 0 and r == 0:
                raise broken(f"particle {i} has neither mass nor radius", "mass")
        for values in (mass, radius):
            first: dict[Any, int] = {}
            for i, value in enumerate(values):
                if value > 0 and first.setdefault(place[i], i) != i:
                    raise broken(
                        f"particles {first[place[i]]} and {i} are both at {list(place[i])}",
                        "position",
                        "leave one out, or give one the mass of both",
                    )


class SpheresShape(ListedTable):
    """Union of overlapping spheres of uniform matter, given here or in a file."""

    noun: ClassVar[str] = "spheres"
    lists: ClassVar[tuple[str, ...]] = ("radius",)
    type: Literal["spheres"] = Field(init=False)
    file: Name | None = None
    """Text or CSV file with columns x, y, z, r. [m / scale]"""
    radius: _PositiveEach | None = None
    """Radii, or that of every sphere. [m]"""
    scale: Positive = 1.0
    """Length of the unit of the file: 0.001 for mm. [m]"""
    overlap: Literal["exact", "sum", "error"] = "exact"
    """Matter in several spheres counts once, in each, or is an error. [-]"""

    def check_lists(self) -> None:
        """Require that what scales a file is not given beside lists."""
        if self.scale != 1.0:
            raise broken("is for spheres from a `file`", "scale", "positions and radii are in m")


class MeshShape(FilledTable):
    """Uniform matter inside a closed surface of triangles from a file, which trimesh reads."""

    type: Literal["mesh"] = Field(init=False)
    file: Name
    """STL, OBJ or PLY file, relative to the folder of the case. [-]"""
    scale: Positive = 1.0
    """Length of the unit of the file: 0.001 for mm. [m]"""
    arrangement: Literal["exact", "cells", "spheres"] = "exact"
    """Six particles, weighted cells, or spheres inside to touch with. [-]"""
    n: Count = 10
    """Cells along the largest extent, or spheres. [-]"""


class Moments(ShapeTable):
    """Six equal particles with exactly these principal moments about the body's axes."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["moments"] = Field(init=False)
    inertia: Annotated[tuple[NonNegative, NonNegative, NonNegative], entries(3)]
    """Moments about x, y, z; none above the sum of the others. [kg m²]"""


class Cloud(ShapeTable):
    """Equal particles at random in a ball, drawn anew for every body."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["cloud"] = Field(init=False)
    n: Count
    """Number of particles. [-]"""
    radius: Positive
    """Radius of the ball. [m]"""


def _require_smaller(inner_radius: float, radius: float) -> None:
    """Require inner_radius < radius."""
    if inner_radius >= radius:
        raise broken(f"must be < radius = {radius!r}, got {inner_radius!r}", "inner_radius")


AnyShape = (
    Box | Ball | Shell | Cylinder | Cone | Torus | Ellipsoid | Tetrahedron | Rod
    | PointsShape | SpheresShape | MeshShape | Moments | Cloud
)  # fmt: skip
Shape = Annotated[AnyShape, Field(discriminator="type")]
SHAPES = by_type(AnyShape)
ALIASES = {"sphere": "ball"}  # other words for them
