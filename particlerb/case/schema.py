"""The case as types: every table, key, default and unit of the format, in the order of the file.

Models are frozen and refuse unknown keys. What involves several tables (names that must exist,
times within the run) is in `rules`, which reads the file's own data, so that one reading reports
all mistakes. Keys keep the names they have in TOML: `case.body` is the tuple of [[body]] tables.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    Discriminator,
    Field,
    PrivateAttr,
    Strict,
    Tag,
    model_validator,
)

from particlerb.case.contact import ContactTable, Material, Prescribed, Wall, Yes
from particlerb.case.forces import KIND, ORIGIN, AnyForce
from particlerb.case.output import ChartTable, Check, CheckValue, Output
from particlerb.case.shapes import Shape
from particlerb.case.source import Source
from particlerb.case.values import (
    Count,
    Counts,
    Euler,
    Name,
    Names,
    NonNegative,
    OneOrientation,
    Positive,
    Quaternion,
    Rows3,
    Rows4,
    Spacing,
    Table,
    Vector,
    broken,
    is_rows,
    one_of,
)
from particlerb.files import File
from particlerb.model.method_names import METHOD_NAMES

__all__ = [
    "METHODS",
    "PLACES",
    "AttractionTable",
    "Body",
    "Case",
    "Check",
    "CheckValue",
    "Euler",
    "Gravity",
    "GridPlacement",
    "InBody",
    "Motion",
    "NormalDistribution",
    "Output",
    "RandomBox",
    "RunTable",
    "ShapePart",
    "case_json_schema",
]

METHODS = ("auto", *METHOD_NAMES)
NEWTON = 6.67430e-11  # G [m³/(kg s²)], CODATA 2018


class RunTable(Table):
    """How long, how often, and how."""

    t_end: Positive = Field(description="Time at the end. [s]")
    every: Positive = Field(description="Time between frames, at most t_end. [s]")
    method: Annotated[str, Strict(), one_of(METHODS)] = Field(
        "auto",
        description="auto, or a name from `particlerb methods`. [-]",
        json_schema_extra={"enum": list(METHODS)},
    )
    dt: Positive | None = Field(None, description="Step of stepping methods; default: chosen. [s]")
    tolerance: Annotated[Positive, Field(ge=1e-14, le=0.1)] = Field(
        1e-10, description="Error of one step of adaptive methods, relative. [-]"
    )
    accuracy: Annotated[Positive, Field(le=1.0)] | None = Field(
        None,
        description="Largest error at t_end; chooses method and step, in place of method and dt."
        " [rad, and position relative to size or path]",
    )
    seed: Annotated[int, Strict(), Field(ge=0, le=2**63 - 1)] = Field(
        0, description="Seed of all random numbers. [-]"
    )
    threads: Count | None = Field(None, description="Threads; default: all cores. [-]")


class Gravity(Table):
    """Uniform gravity."""

    acceleration: Vector = Field(description="Acceleration, world frame. [m/s²]")


class AttractionTable(Table):
    """Newton's attraction between the particles of different bodies."""

    G: Positive = Field(NEWTON, description="Constant of gravitation; CODATA 2018. [m³/(kg s²)]")
    softening: NonNegative = Field(
        0.0, description="Length ε of the potential -G m m' / √(d² + ε²). [m]"
    )
    body: Names | None = Field(
        None, description="Bodies that attract each other, named as in forces; default: all. [-]"
    )
    sum: Literal["auto", "direct", "tree"] = Field(
        "auto", description="Every pair, or distant ones together; auto: the faster. [-]"
    )
    opening_angle: Annotated[Positive, Field(lt=1.0)] | None = Field(
        None, description="Size over distance of what a tree sums as one; default: by accuracy. [-]"
    )
    accuracy: Annotated[Positive, Field(le=0.1)] | None = Field(
        None,
        description="Error of accelerations that a tree may make, rms, relative;"
        " default: a tenth of run.accuracy, else 1e-4. [-]",
    )


class InBody(Table):
    """Vector in the body's own axes."""

    body: Vector = Field(description="Components in the body frame. [m/s or rad/s]")


class NormalDistribution(Table):
    """Normally distributed components, drawn for every body."""

    random: NonNegative = Field(description="Standard deviation per component. [m/s or rad/s]")


class GridPlacement(Table):
    """Bodies on a grid, x fastest, centred at `origin`."""

    type: Literal["grid"] = Field(description=KIND)
    spacing: Spacing = Field(description="Distance between neighbours, one or per axis. [m]")
    n: Counts | None = Field(None, description="Bodies per axis; default: nearly a cube. [-]")
    origin: Vector = Field((0.0, 0.0, 0.0), description="Centre of the grid, world frame. [m]")


class RandomBox(Table):
    """Bodies anywhere in a box, uniformly."""

    type: Literal["random"] = Field(description=KIND)
    lower: Vector = Field(description="Lower corner, world frame. [m]")
    upper: Vector = Field(description="Upper corner, world frame. [m]")

    @model_validator(mode="after")
    def is_ordered(self) -> Self:
        """Require lower <= upper on each axis."""
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise broken("must not be below lower on any axis", "upper")
        return self


def place_form(value: Any) -> str:
    """Tag of a position: one for all bodies of the block, or rows."""
    return "rows" if is_rows(value) else "vector"


def orientation_form(value: Any) -> str:
    """Tag of an orientation."""
    if isinstance(value, (Mapping, BaseModel)):
        return "euler"
    if isinstance(value, str):
        return "random"
    return "rows" if is_rows(value) else "vector"


def motion_form(value: Any) -> str:
    """Tag of a velocity or angular velocity."""
    if isinstance(value, (Mapping, BaseModel)):
        is_spread = isinstance(value, NormalDistribution) or (
            isinstance(value, Mapping) and "random" in value
        )
        return "random" if is_spread else "body"
    return "rows" if is_rows(value) else "vector"


Position = Annotated[
    Annotated[Vector, Tag("vector")] | Annotated[Rows3, Tag("rows")],
    Discriminator(place_form),
]
Orientation = Annotated[
    Annotated[Quaternion, Tag("vector")]
    | Annotated[Euler, Tag("euler")]
    | Annotated[Literal["random"], Tag("random")]
    | Annotated[Rows4, Tag("rows")],
    Discriminator(orientation_form),
]
Motion = Annotated[
    Annotated[Vector, Tag("vector")]
    | Annotated[InBody, Tag("body")]
    | Annotated[NormalDistribution, Tag("random")]
    | Annotated[Rows3, Tag("rows")],
    Discriminator(motion_form),
]
Place = Annotated[GridPlacement | RandomBox, Field(discriminator="type")]
PLACES: dict[str, type[Table]] = {"grid": GridPlacement, "random": RandomBox}
IDENTITY = (1.0, 0.0, 0.0, 0.0)


class ShapePart(Table):
    """One shape of a body that is put together from several."""

    shape: Shape = Field(description="Table with `type` and the shape's keys. [-]")
    mass: NonNegative | None = Field(
        None, description="Mass; this or density; 0 for spheres that only touch. [kg]"
    )
    density: Positive | None = Field(None, description="Density; this or mass. [kg/m³]")
    position: Vector = Field(ORIGIN, description="Of the shape's origin, in the body's axes. [m]")
    orientation: OneOrientation = Field(
        IDENTITY, description="Shape to body axes: quaternion or { euler_deg = [..] }. [-]"
    )


def plain_name(name: str) -> str:
    """Name that can be written in a file and does not look like a reference."""
    if not name.isprintable() or "[" in name or "]" in name:
        raise broken("must be printable and without brackets")
    return name


class Body(Table):
    """A body, or `count` bodies of the same kind."""

    name: Annotated[Name, AfterValidator(plain_name)] = Field(description="Unique name. [-]")
    shape: Shape | None = Field(None, description="Table with `type`; this or [[body.part]]. [-]")
    part: tuple[ShapePart, ...] = Field((), description="Parts of the body; these or shape. [-]")
    mass: Positive | None = Field(None, description="Mass of each body; this or density. [kg]")
    density: Positive | None = Field(None, description="Density; this or mass. [kg/m³]")
    count: Count = Field(1, description="Number of bodies. [-]")
    place: Place | None = Field(None, description="Where many bodies are: grid or random. [-]")
    position: Position = Field(
        ORIGIN, description="Of the centre of mass, world frame; or a row per body. [m]"
    )
    orientation: Orientation = Field(
        IDENTITY,
        description="Quaternion w x y z, normalised when read; { euler_deg = [..] }; "
        '"random"; or a row per body. [-]',
    )
    velocity: Motion = Field(
        ORIGIN, description="World frame, { body = [..] }, { random = v }; or rows. [m/s]"
    )
    angular_velocity: Motion = Field(
        ORIGIN, description="World frame, { body = [..] }, { random = v }; or rows. [rad/s]"
    )
    material: Name | None = Field(
        None, description="Name of a [[material]]; default: the only one. [-]"
    )
    contact: Yes = Field(True, description="Whether it touches others where [contact] is. [-]")
    fixed: Yes = Field(False, description="Whether it stays where it is: an obstacle. [-]")
    motion: Prescribed | None = Field(
        None, description="How it moves, whatever touches it; default: freely. [-]"
    )

    @property
    def is_held(self) -> bool:
        """Whether nothing can push it: it is fixed, or moves as prescribed."""
        return self.fixed or self.motion is not None


class Case(Table):
    """A whole scene; made by `particlerb.case.reader.load`."""

    title: Annotated[str, Strict()] = Field("", description="What the case shows. [-]")
    run: RunTable = Field(description="How long, how often, and how. [-]")
    gravity: Gravity | None = Field(None, description="Uniform gravity; default: none. [-]")
    attraction: AttractionTable | None = Field(
        None, description="Attraction between bodies; default: none. [-]"
    )
    body: Annotated[tuple[Body, ...], Field(min_length=1)] = Field(description="The bodies. [-]")
    force: tuple[Annotated[AnyForce, Field(discriminator="type")], ...] = Field(
        (), description="What acts on them. [-]"
    )
    contact: ContactTable | None = Field(None, description="How bodies touch; default: not. [-]")
    material: tuple[Material, ...] = Field((), description="Of bodies and walls. [-]")
    wall: tuple[Wall, ...] = Field((), description="Walls that bodies touch. [-]")
    output: Output = Field(default_factory=Output, description="What is recorded. [-]")
    check: Check = Field(default_factory=Check, description="What must hold. [-]")
    chart: ChartTable = Field(
        default_factory=ChartTable, description="Beside the methods on a chart. [-]"
    )
    _source: Source = PrivateAttr(default_factory=Source)

    @property
    def source(self) -> Source:
        """Text, path and data that the case was read from."""
        return self._source

    @property
    def text(self) -> str:
        """TOML text as read; empty for a case from Python."""
        return self._source.text

    @property
    def path(self) -> Path | None:
        """File of the case; None for a case from Python."""
        return self._source.path

    def file(self, name: str) -> File:
        """Content of a file that the case names, relative to the folder of the case."""
        return self._source.files.read(name)

    @property
    def n_bodies(self) -> int:
        """Number of bodies of all blocks."""
        return sum(body.count for body in self.body)


def case_json_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a case file, for editors."""
    schema = Case.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
