"""Shapes of bodies: one table per `shape.type`, lengths in metres, axes of the body.

Each class also says what its mass may be given by (`weighed_by`): `mass`, `density`, or neither.
Solids are centred at the origin of their axes unless said otherwise; those with an axis have it
along z. How a shape becomes particles is the business of `particlerb.bodies`.
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
_RoundArrangement = Literal["lattice", "cells", "exact"]
KIND = "Kind of shape. [-]"
_ACROSS = "Particles along the largest extent of the lattice. [-]"
_SHELL_N = "As for a ball; on a thin shell per quarter of a great circle. [-]"
_ARRANGEMENT = "A lattice, or the smallest exact set of particles. [-]"
_ROUND = "Whole cells, cells weighted by their share inside, or the smallest exact set. [-]"
_BALL = "One particle with the radius, whole cells, or cells weighted by their share inside. [-]"
_Share = Annotated[Positive, Field(lt=1.0)]
Vertices = Annotated[tuple[Vector, Vector, Vector, Vector], entries(4, "corners")]


class ShapeTable(Table):
    """What all shapes share."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass", "density")
    type: str = Field(description=KIND)


class FilledTable(ShapeTable):
    """A shape that cells fill: how finely is said once."""

    inertia_error: _Share | None = Field(
        None, description="Chooses n: largest relative error of tensor and centre of mass. [-]"
    )

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

    n: Count = Field(10, description=_ACROSS)
    arrangement: Literal["lattice", "cells"] = Field(
        "lattice", description="Whole cells, or cells weighted by their share inside. [-]"
    )


class Box(FilledTable):
    """Solid box."""

    type: Literal["box"] = Field(description=KIND)
    size: Lengths = Field(description="Edge lengths. [m]")
    n: Resolution = Field((10, 10, 10), description="Particles per edge. [-]")
    arrangement: _Arrangement = Field("lattice", description=_ARRANGEMENT)


class Ball(FilledTable):
    """Solid ball, a single particle with its radius unless cells fill it; also called a sphere."""

    type: Annotated[Literal["ball", "sphere"], AfterValidator(lambda word: "ball")] = Field(
        description=KIND
    )
    radius: Positive = Field(description="Radius, of its matter and of its surface. [m]")
    n: Count = Field(10, description=_ACROSS)
    arrangement: _RoundArrangement = Field("exact", description=_BALL)

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

    type: Literal["shell"] = Field(description=KIND)
    radius: Positive = Field(description="Outer radius. [m]")
    inner_radius: Positive | None = Field(
        None, description="Inner radius; left out: a thin shell. [m]"
    )
    n: Count = Field(10, description=_SHELL_N)

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

    type: Literal["cylinder"] = Field(description=KIND)
    radius: Positive = Field(description="Outer radius. [m]")
    height: Positive = Field(description="Height along z. [m]")
    inner_radius: NonNegative = Field(0.0, description="Radius of the bore. [m]")

    @model_validator(mode="after")
    def has_wall(self) -> Self:
        """Require the bore below the outer radius."""
        _require_smaller(self.inner_radius, self.radius)
        return self


class Cone(CurvedTable):
    """Solid cone about z, base at z = 0, apex at z = height."""

    type: Literal["cone"] = Field(description=KIND)
    radius: Positive = Field(description="Radius of the base. [m]")
    height: Positive = Field(description="Height along z. [m]")


class Torus(CurvedTable):
    """Solid torus about z."""

    type: Literal["torus"] = Field(description=KIND)
    major_radius: Positive = Field(description="Distance of the tube's centre from the axis. [m]")
    minor_radius: Positive = Field(description="Radius of the tube. [m]")

    @model_validator(mode="after")
    def does_not_overlap(self) -> Self:
        """Require a tube that does not cross the axis."""
        if self.minor_radius > self.major_radius:
            raise broken(
                f"must be <= major_radius = {self.major_radius!r}, got {self.minor_radius!r}",
                "minor_radius",
            )
        return self


class Ellipsoid(FilledTable):
    """Solid ellipsoid."""

    type: Literal["ellipsoid"] = Field(description=KIND)
    semi_axes: Lengths = Field(description="Half of the lengths along x, y, z. [m]")
    n: Count = Field(10, description=_ACROSS)
    arrangement: _RoundArrangement = Field("lattice", description=_ROUND)


class Tetrahedron(ShapeTable):
    """Solid tetrahedron."""

    type: Literal["tetrahedron"] = Field(description=KIND)
    vertices: Vertices = Field(description="The four corners. [m]")
    n: Count = Field(10, description="Particles per edge. [-]")
    arrangement: _Arrangement = Field("lattice", description=_ARRANGEMENT)


class Rod(FilledTable):
    """Thin straight rod along z: it has no volume, hence no density."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["rod"] = Field(description=KIND)
    length: Positive = Field(description="Length along z. [m]")
    n: Count = Field(10, description="Particles along the rod. [-]")
    arrangement: _Arrangement = Field("lattice", description=_ARRANGEMENT)


def _for_each(value: Any) -> Any:
    """One number, or a number for each particle; `PointsShape` makes a list of both."""
    return value


_Each = Annotated[
    tuple[NonNegative, ...],
    BeforeValidator(_for_each, NonNegative | tuple[NonNegative, ...]),
]


_PositiveEach = Annotated[
    tuple[Positive, ...],
    BeforeValidator(_for_each, Positive | tuple[Positive, ...]),
]


def _repeated_for_each(raw: Any, keys: tuple[str, ...]) -> Any:
    """Data of a shape in which a single number has become one for each position."""
    position = raw.get("position") if isinstance(raw, Mapping) else None
    if not isinstance(position, (list, tuple)):
        return raw
    single = {
        key: [raw[key]] * len(position)
        for key in keys
        if isinstance(raw.get(key), (int, float, str))
    }
    return {**raw, **single}


def _is_in_file(shape: "PointsShape | SpheresShape", lists: tuple[str, ...]) -> bool:
    """Whether particles come from a file; then no list is given beside it."""
    if shape.file is None:
        return False
    for key in lists:
        if getattr(shape, key) is not None:
            raise broken("particles come from `file` or from lists, not both", key)
    return True


def _require_length(shape: "PointsShape | SpheresShape", key: str, length: int) -> None:
    """Require as many entries as there are positions."""
    entries = getattr(shape, key)
    if entries is not None and len(entries) != length:
        raise broken(f"must have {length} entries like position, has {len(entries)}", key)


class PointsShape(ShapeTable):
    """Particles given one by one, here or in a CSV file; their masses are the body's."""

    weighed_by: ClassVar[tuple[str, ...]] = ()
    type: Literal["points"] = Field(description=KIND)
    position: tuple[Vector, ...] | None = Field(
        None, description="Positions in the body's axes. [m]"
    )
    mass: _Each | None = Field(None, description="Masses, or that of every particle. [kg]")
    radius: _Each | None = Field(
        None, description="Radii, or that of every particle; 0 is a point mass. [m]"
    )
    file: Name | None = Field(
        None, description="Text or CSV file with columns x, y, z, m and optionally r. [m, kg]"
    )

    @model_validator(mode="before")
    @classmethod
    def repeats_numbers(cls, raw: Any) -> Any:
        """One mass or radius for all particles, as a list."""
        return _repeated_for_each(raw, ("mass", "radius"))

    @model_validator(mode="after")
    def has_one_source(self) -> Self:
        """Require either lists of equal length with a positive total mass, or a file."""
        if _is_in_file(self, ("position", "mass", "radius")):
            return self
        if not self.position:
            raise broken("has no particles", "position", "give `position` and `mass`, or a `file`")
        if self.mass is None:
            raise broken("particles need a mass each", "mass")
        for key in ("mass", "radius"):
            _require_length(self, key, len(self.position))
        self.check_masses()
        self.check_places()
        return self

    def check_places(self) -> None:
        """Require different places of all masses, and of all balls."""
        n = len(self.position or ())
        for values in (self.mass or (), self.radius or ()):
            first: dict[Any, int] = {}
            for i in range(n):
                place = (self.position or ())[i]
                if i < len(values) and values[i] > 0 and first.setdefault(place, i) != i:
                    raise broken(
                        f"particles {first[place]} and {i} are both at {list(place)}",
                        "position",
                        "leave one out, or give one the mass of both",
                    )

    def check_masses(self) -> None:
        """Require of a particle without mass that it has a radius."""
        mass = self.mass or ()
        radius = self.radius or (0.0,) * len(mass)
        for i, (m, r) in enumerate(zip(mass, radius, strict=True)):
            if m == 0 and r == 0:
                raise broken(f"particle {i} has neither mass nor radius", "mass")


class SpheresShape(ShapeTable):
    """Union of overlapping spheres of uniform matter, given here or in a file."""

    type: Literal["spheres"] = Field(description=KIND)
    position: tuple[Vector, ...] | None = Field(None, description="Centres in the body's axes. [m]")
    radius: _PositiveEach | None = Field(None, description="Radii, or that of every sphere. [m]")
    file: Name | None = Field(
        None, description="Text or CSV file with columns x, y, z, r. [m / scale]"
    )
    scale: Positive = Field(1.0, description="Length of the unit of the file: 0.001 for mm. [m]")
    overlap: Literal["exact", "sum", "error"] = Field(
        "exact", description="Matter in several spheres counts once, in each, or is an error. [-]"
    )

    @model_validator(mode="before")
    @classmethod
    def repeats_numbers(cls, raw: Any) -> Any:
        """One radius for all spheres, as a list."""
        return _repeated_for_each(raw, ("radius",))

    @model_validator(mode="after")
    def has_one_source(self) -> Self:
        """Require either lists of equal length, or a file."""
        if _is_in_file(self, ("position", "radius")):
            return self
        if not self.position:
            raise broken("has no spheres", "position", "give `position` and `radius`, or a `file`")
        if self.radius is None:
            raise broken("spheres need a radius each", "radius")
        if "scale" in self.model_fields_set:
            raise broken("is for spheres from a `file`", "scale", "positions and radii are in m")
        _require_length(self, "radius", len(self.position))
        return self


class MeshShape(FilledTable):
    """Uniform matter inside a closed surface of triangles from a file, which trimesh reads."""

    type: Literal["mesh"] = Field(description=KIND)
    file: Name = Field(description="STL, OBJ or PLY file, relative to the folder of the case. [-]")
    scale: Positive = Field(1.0, description="Length of the unit of the file: 0.001 for mm. [m]")
    arrangement: Literal["exact", "cells", "spheres"] = Field(
        "exact", description="Six particles, weighted cells, or spheres inside to touch with. [-]"
    )
    n: Count = Field(10, description="Cells along the largest extent, or spheres. [-]")


class Moments(ShapeTable):
    """Six equal particles with exactly these principal moments about the body's axes."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["moments"] = Field(description=KIND)
    inertia: Annotated[tuple[NonNegative, NonNegative, NonNegative], entries(3)] = Field(
        description="Moments about x, y, z; none above the sum of the others. [kg m²]"
    )


class Cloud(ShapeTable):
    """Equal particles at random in a ball, drawn anew for every body."""

    weighed_by: ClassVar[tuple[str, ...]] = ("mass",)
    type: Literal["cloud"] = Field(description=KIND)
    n: Count = Field(description="Number of particles. [-]")
    radius: Positive = Field(description="Radius of the ball. [m]")


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
