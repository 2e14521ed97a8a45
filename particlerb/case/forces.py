"""The tables of [[force]], one class for each type; the physics of type "x" is in forces/x.py.

They stand here and not beside the physics because whoever reads a case must not wait for the
compiler. A new one is a class, and a member of `AnyForce`.
"""

from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, PlainValidator, model_validator

from particlerb.case.values import (
    ORIGIN,
    Array3,
    ArrayPerBody,
    EachNonNegative,
    EachNumber,
    EachPositive,
    FloatArray,
    Forms,
    Frame,
    IntArray,
    Knots,
    Name,
    Names,
    NonNegative,
    Positive,
    Real,
    RowPerBody,
    Table,
    Vector,
    Vectors,
    broken,
    by_type,
    entries,
    first_out_of_order,
)
from particlerb.files import File
from particlerb.text_tables import Columns, read_table
from particlerb.user_force import UserForce


class ForceTable(Table):
    """What all tables of [[force]] share."""

    type: str
    """Kind of force or placement. [-]"""
    body: Names
    """Name of a [[body]] block, of one body as name[3], or a list of such names. [-]"""

    names_bodies: ClassVar[tuple[str, ...]] = ("body",)
    load_key: ClassVar[str] = ""
    """Of a load that may change with time."""

    @property
    def timed(self) -> "TimedLoad | None":
        """The load, if it changes with time."""
        return None

    @property
    def entries(self) -> dict[str, FloatArray]:
        """By their keys, values that have an entry for each body, in the order of `body`."""
        return {key: value for key, value in self if isinstance(value, np.ndarray)}

    def of_bodies(self, rows: IntArray) -> Self:
        """The same force with these of the entries."""
        return self.model_copy(update={key: value[rows] for key, value in self.entries.items()})

    @property
    def needs_particles(self) -> bool:
        """Whether it acts on the particles of a body, and not on its mass and tensor alone."""
        return False

    @property
    def likeness(self) -> tuple[object, ...]:
        """What, beside the type, forces have in common that act on bodies of one group."""
        return ()

    @property
    def edges(self) -> tuple[float, ...]:
        """Times [s] at which it begins, bends, stops, or acts at one instant; none: always."""
        return ()


def _is_interval(value: tuple[float, float]) -> tuple[float, float]:
    """Require t0 < t1."""
    if value[0] >= value[1]:
        raise broken(f"must start before it ends, got [{value[0]!r}, {value[1]!r}]")
    return value


During = Annotated[tuple[NonNegative, NonNegative], entries(2), AfterValidator(_is_interval)]


class LastingForceTable(ForceTable):
    """What all share that act for a time."""

    during: During | None = None
    """Start and end; default: always. [s]"""

    @property
    def edges(self) -> tuple[float, ...]:
        """Times [s] at which it begins and stops; none: always."""
        return self.during or ()


class TimedLoad(Table):
    """A force or torque that changes with time: linear between knots, zero outside of them."""

    table: Name | None = None
    """Text or CSV file with columns t, x, y, z. [s, and the unit of the load]"""
    times: Knots | None = None
    """Knots, ascending; instead of a file. [s]"""
    values: Array3 | None = None
    """Load at each of them. [N; N m]"""

    @model_validator(mode="after")
    def has_one_source(self) -> Self:
        """Require either a file or knots with a value each."""
        hint = 'give `times` and `values`, or { table = "load.csv" }'
        lists = self.times, self.values
        if self.table is not None:
            if lists != (None, None):
                raise broken("comes from a file or from lists, not both", "table", hint)
        elif self.times is None or self.values is None:
            raise broken("has no knots", hint=hint)
        elif len(self.times) != len(self.values):
            n, m = len(self.times), len(self.values)
            raise broken(f"must have {n} rows like times, has {m}", "values")
        return self


_KNOTS = Columns(("t", "x", "y", "z"))


def read_load(file: File) -> TimedLoad:
    """Knots of a file.

    Raises
    ------
    ValueError
        With file, line and reason: as `read_table`, or if it has one row, or times do not ascend.
    """
    table = read_table(file, _KNOTS)
    t = table.column["t"].tolist()
    if len(t) < 2:
        raise ValueError(f"{table.path}:{table.line[0]}: one row; a load needs two knots at least")
    k = first_out_of_order(t)
    if k is not None:
        where = f"{table.path}:{table.line[k]}"
        raise ValueError(f"{where}: t = {t[k]} after {t[k - 1]}: times must ascend")
    return TimedLoad(times=tuple(t), values=table.vectors)


_Load = Annotated[Vector | TimedLoad | Array3, Forms("list", "table", "rows")]


class LoadTable(LastingForceTable):
    """What pushes and torques share: a load that is constant, or changes with time."""

    @property
    def timed(self) -> TimedLoad | None:
        """The load, if it changes with time."""
        load = getattr(self, self.load_key)
        return load if isinstance(load, TimedLoad) else None

    @property
    def edges(self) -> tuple[float, ...]:
        """Times [s] of all knots, or at which it begins and stops."""
        return super().edges if self.timed is None else self.timed.times or ()


class PushTable(LoadTable):
    """A force at a point of the body that stays on that point while the body turns."""

    type: Literal["push"] = Field(init=False)
    at: Vectors = ORIGIN
    """Point, body frame, from the centre of mass; or a row per body. [m]"""
    force: _Load
    """Force, constant or by knots; or a row per body. [N]"""
    frame: Frame = "world"
    """Axes of the vector: world or body. [-]"""

    load_key: ClassVar[str] = "force"


class TorqueTable(LoadTable):
    """A torque."""

    type: Literal["torque"] = Field(init=False)
    torque: _Load
    """Torque, constant or by knots; or a row per body. [N m]"""
    frame: Frame = "world"
    """Axes of the vector: world or body. [-]"""

    load_key: ClassVar[str] = "torque"


class ImpulseTable(ForceTable):
    """A jump of the momenta at one instant: P += J, L += r × J."""

    type: Literal["impulse"] = Field(init=False)
    at: Vectors = ORIGIN
    """Point, body frame, from the centre of mass; or a row per body. [m]"""
    impulse: Vectors
    """Impulse; or a row per body. [N s]"""
    frame: Frame = "world"
    """Axes of the vector: world or body. [-]"""
    time: NonNegative
    """When, at most t_end. [s]"""

    @property
    def edges(self) -> tuple[float, ...]:
        """When it acts [s]."""
        return (self.time,)


_Coefficient = Annotated[NonNegative | EachNonNegative, Forms("number", "list")]


class DragTable(LastingForceTable):
    """Linear drag: F = -c v and τ = -c_r ω."""

    type: Literal["drag"] = Field(init=False)
    translation: _Coefficient = 0.0
    """Coefficient c; or one per body. [N s/m]"""
    rotation: _Coefficient = 0.0
    """Coefficient c_r; or one per body. [N m s/rad]"""


_RestLength = Annotated[NonNegative | Literal["initial"], Forms("number", "word")]
_List = Annotated[tuple[Real, ...], Field(min_length=1)]
_NumberOrList = Annotated[Real | _List, Forms("number", "list")]


class SpringTable(LastingForceTable):
    """A spring from a point of the body to the world or another body: F = k (l - l₀) + c dl/dt."""

    type: Literal["spring"] = Field(init=False)
    at: Vector = ORIGIN
    """Point, body frame, from the centre of mass. [m]"""
    anchor: Vector | None = None
    """The other end, world frame; this, or to or reach. [m]"""
    to: Names | None = None
    """Bodies at the other end: one for each, one for all, or by reach. [-]"""
    to_at: Vector = ORIGIN
    """Point of the other body, in its body frame. [m]"""
    reach: Positive | None = None
    """Ties every pair of points that are at most this far apart at t = 0. [m]"""
    stiffness: Positive
    """Stiffness k. [N/m]"""
    damping: NonNegative = 0.0
    """Damping c along the spring. [N s/m]"""
    rest_length: _RestLength = 0.0
    """Length l₀ without force; "initial": as long as it is at t = 0. [m]"""

    names_bodies: ClassVar[tuple[str, ...]] = ("body", "to")


_Charge = Annotated[Real | _List | RowPerBody, Forms("number", "list", "rows")]


class UniformField(LastingForceTable):
    """A uniform field that acts on charges and on a dipole of the body: Σ q E and d × E."""

    type: Literal["field"] = Field(init=False)
    field: Vector
    """Field E, world frame. [V/m; T for a magnetic dipole]"""
    charge: _Charge = 0.0
    """Charge q of the body, or a list with one per particle; or a row of these per body. [C]"""
    at: Vectors = ORIGIN
    """Where a single charge sits, body frame; or a row per body. [m]"""
    dipole: Vectors = ORIGIN
    """Dipole d, body frame; or a row per body. [C m; A m²]"""
    angular_velocity: Vector = ORIGIN
    """Rate at which E turns from t = 0 on, world frame. [rad/s]"""

    @property
    def needs_particles(self) -> bool:
        """Whether each particle has a charge of its own."""
        return len(np.atleast_1d(self.charge).T) > 1 or isinstance(self.charge, tuple)


class CentralTable(LastingForceTable):
    """Attraction by a fixed centre, inverse-square, with its gravity-gradient torque."""

    type: Literal["central"] = Field(init=False)
    centre: Vectors = ORIGIN
    """Where the centre is, world frame; or a row per body. [m]"""
    mu: Annotated[Positive | EachPositive, Forms("number", "list")]
    """G times the mass of the centre; or one per body. [m³/s²]"""


class MagnusTable(LastingForceTable):
    """Magnus lift of a spinning body: F = c ω × v."""

    type: Literal["magnus"] = Field(init=False)
    coefficient: Annotated[Real | EachNumber, Forms("number", "list")]
    """Coefficient c; or one per body. [kg/rad]"""


def _is_function(value: Any) -> "str | UserForce":
    """Require a name, or a force that `particlerb.force` has made."""
    if isinstance(value, UserForce) or (isinstance(value, str) and value):
        return value
    hint = 'write @particlerb.force above its `def`, or give its name: function = "magnet"'
    raise broken("must be a force of yours", hint=hint)


Function = Annotated[
    Any,
    PlainValidator(_is_function, json_schema_input_type=str),
    PlainSerializer(
        lambda f: f if isinstance(f, str) else f.name, return_type=str, when_used="json"
    ),
]


class PythonTable(LastingForceTable):
    """A force written in Python, on one body or between two; see docs/forces.md."""

    type: Literal["python"] = Field(init=False)
    to: Names | None = None
    """Bodies at the other end: one for each, one for all, or by reach. [-]"""
    reach: Positive | None = None
    """Of two bodies: on every pair at most this far apart at t = 0. [m]"""
    function: Function
    """Name of the function; from Python the function itself. [-]"""
    file: Name | None = None
    """File with it; default: its name with .py. Needs --allow-code. [-]"""
    parameters: dict[Name, _NumberOrList] = Field({})
    """Its parameters, the same for all bodies: numbers or lists. [any]"""
    per_body: dict[Name, ArrayPerBody] = Field({})
    """Others: for each an entry per body, a number or a list. [any]"""

    names_bodies: ClassVar[tuple[str, ...]] = ("body", "to")
    at: ClassVar[tuple[float, float, float]] = ORIGIN  # where pairs are looked for
    to_at: ClassVar[tuple[float, float, float]] = ORIGIN

    @property
    def is_pairwise(self) -> bool:
        """Whether it acts between two bodies."""
        return self.to is not None or self.reach is not None

    @property
    def entries(self) -> dict[str, FloatArray]:
        """Parameters that have an entry for each body; of pairs both ends have some."""
        each = {} if self.is_pairwise else self.per_body
        return {f"per_body.{name}": value for name, value in each.items()}

    def of_bodies(self, rows: IntArray) -> Self:
        """The same force with these of the entries."""
        each = {name: value[rows] for name, value in self.per_body.items()}
        return self.model_copy(update={"per_body": each})

    @property
    def likeness(self) -> tuple[object, ...]:
        """Forces of the same function share kernels, with parameters of the same lengths."""
        alike = {k: np.shape(value) for k, value in self.parameters.items()}
        alike |= {k: value.shape[1:] for k, value in self.per_body.items()}
        return (self.file, self.function, tuple(sorted(alike.items())))


AnyForce = (
    PushTable | TorqueTable | ImpulseTable | DragTable | SpringTable
    | UniformField | CentralTable | MagnusTable | PythonTable
)  # fmt: skip
FORCE_TABLES: dict[str, type[ForceTable]] = by_type(AnyForce)
