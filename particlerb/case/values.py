"""Kinds of value in a case: numbers, vectors, rows of vectors, names; all strict and finite.

A string is no number and a bool is no number; an int is a fine float. What a value may be is a
type here, so that the schema reads like the format. The docstring of a key ends with [unit].
"""

import ast
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from inspect import getsource
from itertools import chain, pairwise
from textwrap import dedent
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    PlainSerializer,
    PlainValidator,
    Strict,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from particlerb.case.problems import shown

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
LARGEST_COUNT = 2**31 - 1
_PLAIN_TYPES: Final = frozenset((float, int, str, bool))  # what is as a case has it
_KEYS_WITH_ROWS: Final = ("position", "orientation", "velocity", "angular_velocity")
_MIN_KNOT_INTERVAL = 1e-300  # [s]: its inverse is finite


class Table(BaseModel):
    """A table of the case: frozen, unknown keys are errors, every number is finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    if not TYPE_CHECKING:  # type checkers know the names

        def __setattr__(self, name: str, value: object) -> None:
            """Refuse to change what is public."""
            if not name.startswith("_"):
                told = f"{type(self).__name__}.{name} cannot be set"
                raise AttributeError(f"{told}: take a model_copy(update={{..}}) in its place")
            super().__setattr__(name, value)

        def __delattr__(self, name: str) -> None:
            """Refuse likewise."""
            raise AttributeError(f"{type(self).__name__}.{name} cannot be deleted")

    def __init__(self, **keys: Any) -> None:
        """Make one in Python: from arrays too, with the words of a case."""
        from particlerb.case.messages import fill

        fill(self, keys)

    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]  # readers do not call it

    @classmethod
    def __get_pydantic_json_schema__(
        cls, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """JSON schema in which what stands below a key describes it.

        Pydantic's own `use_attribute_docstrings` would read the sources at every import.
        """
        json_schema = handler(schema)
        for key, entry in handler.resolve_ref_schema(json_schema)["properties"].items():
            entry["description"] = descriptions(cls)[key]
        return json_schema


@cache
def descriptions(table: type[BaseModel]) -> dict[str, str]:
    """Docstrings of the keys of a table, its own and those that it inherits."""
    texts: dict[str, str] = {}
    for base in reversed(table.__mro__[: table.__mro__.index(Table)]):
        (described,) = ast.parse(dedent(getsource(base))).body
        for key, below in pairwise(getattr(described, "body", [])):
            match key, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(text))):
                    texts[name] = " ".join(text.split())
    return texts


def by_type(union: Any) -> dict[str, Any]:
    """Tables of a union by their `type`; of several words by the first."""
    return {get_args(table.model_fields["type"].annotation)[0]: table for table in get_args(union)}


def broken(reason: str, key: str = "", hint: str = "") -> PydanticCustomError:
    """Error that a validator raises; `key` names the key of the table that is to blame."""
    escaped = reason.replace("{", "(").replace("}", ")")
    return PydanticCustomError("rule", cast(Any, escaped), {"key": key, "hint": hint})


def entries(length: int, of: str = "numbers", hint: str = "") -> BeforeValidator:
    """Length of a list, checked before its entries so that a wrong one is a single error."""

    def check(value: Any) -> Any:
        if isinstance(value, (list, tuple)) and len(value) != length:
            raise broken(f"must have {length} entries, has {len(value)}", hint=hint)
        if not isinstance(value, (list, tuple)):
            got = "" if isinstance(value, Mapping) else f", got {shown(value)}"
            raise broken(f"must be a list of {length} {of}{got}", hint=hint)
        return value

    return BeforeValidator(check)


def require(holds: Callable[[Any], bool], reason: str, hint: str = "") -> AfterValidator:
    """Value of which something holds; else the reason says what does not."""

    def check(value: Any) -> Any:
        if not holds(value):
            raise broken(reason, hint=hint)
        return value

    return AfterValidator(check)


def distinct(of: str) -> AfterValidator:
    """List that repeats none of its entries."""
    return require(lambda value: len(set(value)) == len(value), f"must not repeat a {of}")


def nonzero(of: str, hint: str = "") -> AfterValidator:
    """Vector or quaternion that has a length; a vector may be a table, in the frame of a body."""
    reason = f"must not be zero: it is not {of}"
    return require(lambda value: any(getattr(value, "body", value)), reason, hint)


def one_of(*choices: str) -> PlainValidator:
    """Word out of a list that is kept as a constant rather than as a type."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            expected = ", ".join(f"'{choice}'" for choice in choices)
            raise PydanticCustomError("choice", "unknown", {"expected": expected})
        return value

    return PlainValidator(check, json_schema_input_type=Literal[choices])


def _repeated(value: Any) -> Any:
    """Three times the same number where one is given."""
    return [value] * 3 if isinstance(value, (int, float, str)) else value


def alone(value: Any) -> Any:
    """List with one name where a name is given; for a table that has a name, this."""
    values = value if isinstance(value, (list, tuple)) else (value,)
    names = tuple(getattr(entry, "name", entry) for entry in values)
    return names if all(isinstance(name, str) for name in names) else value


def rows(width: int) -> PlainValidator:
    """One row per body: a read-only array, shape (count, width), float64 and finite."""

    def check(value: Any) -> FloatArray:
        try:
            array = np.asarray(value)
        except (ValueError, OverflowError):
            raise broken(f"must be rows of {width} numbers each") from None
        if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in "iuf":
            raise broken(f"must be rows of {width} numbers each")
        if isinstance(value, list) and bool in map(type, chain.from_iterable(value)):
            raise broken("must be numbers, true and false are none")
        array = _read_only(array)
        if not np.isfinite(array).all():
            row = int(np.argmin(np.isfinite(array).all(axis=1)))
            raise broken(f"must be finite, row {row} is not")
        if width == 4 and not array.any(axis=1).all():
            row = int(np.argmin(array.any(axis=1)))
            raise broken(f"must not be zero: row {row} is not an orientation")
        return array

    return PlainValidator(check, json_schema_input_type=list[list[float]])


def _entry_per_body(value: Any) -> FloatArray:
    """Read-only array with an entry per body, each a number or a list of the same length."""
    try:
        array = _read_only(_nested_numbers(value))
    except ValueError:
        array = np.zeros(())
    if array.ndim not in (1, 2) or not array.size:
        raise broken("must be a list with an entry per body: numbers, or lists of one length")
    return array


def _read_only(values: Any) -> FloatArray:
    """Numbers in an array of their own."""
    array = np.array(values, dtype=np.float64, order="C")
    array.setflags(write=False)
    return array


def is_rows(value: Any) -> bool:
    """Whether a value has one row per body rather than one for all."""
    if isinstance(value, np.ndarray):
        return value.ndim == 2
    return isinstance(value, list) and bool(value) and isinstance(value[0], (list, tuple))


def ascending(times: Sequence[float], key: str = "", hint: str = "") -> Sequence[float]:
    """Two times or more, each later than the one before; what to do about others."""
    if len(times) < 2:
        raise broken(f"needs two knots at least, has {len(times)}", key)
    if (k := first_out_of_order(times)) is not None:
        told = f"times must ascend, knot {k} is at {times[k]!r} s after {times[k - 1]!r} s"
        raise broken(told, key, hint)
    return times


def first_out_of_order(times: Sequence[float]) -> int | None:
    """Number of the first time that is not later than the one before it; None: there is none."""
    pairs = enumerate(pairwise(times), 1)
    return next((k for k, (before, after) in pairs if after - before <= _MIN_KNOT_INTERVAL), None)


def _nested_numbers(value: Any) -> Any:
    """A number, a list of numbers or a list of such lists; lists become tuples."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(_nested_numbers(entry) for entry in value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise broken("must be a number or a list of numbers")
    try:
        number = float(value)
    except OverflowError:
        raise broken("must be finite") from None
    if not math.isfinite(number):
        raise broken(f"must be finite, got {number}")
    return number


def plain(value: Any, keeps_rows: bool = False, keeps_tables: bool = False) -> Any:
    """Plain dicts, lists and numbers of what Python callers pass.

    Two-dimensional arrays stay where they may be rows for many bodies, and nowhere else: rules read
    plain data. What can be gone through once, as a generator, is gone through here. Keys that
    `model_copy` gave a table stay, right or wrong: who reads it says so.
    """
    if type(value) in _PLAIN_TYPES:
        return value
    if isinstance(value, BaseModel):
        given = {key: v for key, v in vars(value).items() if key in value.model_fields_set}
        return value if keeps_tables else plain(given)
    if isinstance(value, Mapping):
        rows_at = () if "type" in value else _KEYS_WITH_ROWS
        return {str(k): plain(entry, k in rows_at, keeps_tables) for k, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        is_kept = keeps_rows and value.ndim == 2 and not np.ma.is_masked(value)
        return value if is_kept else value.tolist()
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        return [plain(entry, keeps_tables=keeps_tables) for entry in value]
    return value


class Forms:
    """Tells the types of a union apart by the form of a value, which is named for each of them.

    Forms are `table`, `random` (a table with such a key), `word`, `rows`, `list` and `number`;
    a value of another form is judged as the first.
    """

    def __init__(self, *names: str) -> None:
        self.names = names

    def __get_pydantic_core_schema__(self, union: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Union of which pydantic tries the one type that a value has the form of."""
        named = zip(self.names, get_args(union), strict=True)
        choices = {name: handler.generate_schema(one) for name, one in named}
        return core_schema.tagged_union_schema(choices, self.form)

    def form(self, value: Any) -> str:
        """Form of a value among those that there are."""
        if not isinstance(value, (list, tuple)) and isinstance(value, (dict, Mapping, BaseModel)):
            keys = type(value).model_fields if isinstance(value, BaseModel) else value
            form = "random" if "random" in keys and "random" in self.names else "table"
        elif isinstance(value, str):
            form = "word"
        elif "rows" in self.names and is_rows(value):
            form = "rows"
        else:
            form = "list" if isinstance(value, (list, tuple, np.ndarray)) else "number"
        return form if form in self.names else self.names[0]


class _Each:
    """A list of numbers of a kind, one per body, as a read-only array."""

    def __init__(self, number: Any) -> None:
        self.number = number

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Tuple of such numbers, of which an array is made."""
        each = handler.generate_schema(
            Annotated[tuple[self.number, ...], Field(min_length=1)]  # type: ignore[name-defined]
        )
        as_list = core_schema.plain_serializer_function_ser_schema(np.ndarray.tolist)
        return core_schema.no_info_after_validator_function(_read_only, each, serialization=as_list)


Real = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
NonNegative = Annotated[float, Strict(), Field(ge=0)]
Count = Annotated[int, Strict(), Field(ge=1, le=LARGEST_COUNT)]
Yes = Annotated[bool, Strict()]
Name = Annotated[str, Strict(), Field(min_length=1)]
Label = Annotated[Name, require(str.isprintable, "must be printable")]
Names = Annotated[tuple[Name, ...], Field(min_length=1), BeforeValidator(alone, Name | list[Name])]

Knots = Annotated[tuple[NonNegative, ...], AfterValidator(ascending)]
Vector = Annotated[tuple[Real, Real, Real], entries(3)]
ORIGIN = (0.0, 0.0, 0.0)
Direction = Annotated[Vector, nonzero("a direction")]
Lengths = Annotated[tuple[Positive, Positive, Positive], entries(3)]
Spacing = Annotated[Lengths, BeforeValidator(_repeated, Positive | Lengths)]
Counts = Annotated[tuple[Count, Count, Count], entries(3)]
Resolution = Annotated[Counts, BeforeValidator(_repeated, Count | Counts)]
Quaternion = Annotated[
    tuple[Real, Real, Real, Real], entries(4), nonzero("an orientation", "no turn is [1, 0, 0, 0]")
]
Numbers = Annotated[
    Any,
    PlainValidator(_nested_numbers, json_schema_input_type=float | list[float] | list[list[float]]),
]
_AS_LISTS = PlainSerializer(lambda array: array.tolist(), return_type=list, when_used="json")
Array2 = Annotated[FloatArray, rows(2), _AS_LISTS]
Array3 = Annotated[FloatArray, rows(3), _AS_LISTS]
Array4 = Annotated[FloatArray, rows(4), _AS_LISTS]
_ENTRIES = PlainValidator(_entry_per_body, json_schema_input_type=list[float] | list[list[float]])
_ROWS = PlainValidator(_entry_per_body, json_schema_input_type=list[list[float]])
ArrayPerBody = Annotated[FloatArray, _ENTRIES, _AS_LISTS]
RowPerBody = Annotated[FloatArray, _ROWS, _AS_LISTS]
EachNumber = Annotated[FloatArray, _Each(Real)]
EachNonNegative = Annotated[FloatArray, _Each(NonNegative)]
EachPositive = Annotated[FloatArray, _Each(Positive)]
Vectors = Annotated[Vector | Array3, Forms("list", "rows")]
Frame = Literal["world", "body"]


class Euler(Table):
    """Orientation from angles: intrinsic z-y-x, given as [roll, pitch, yaw]."""

    euler_deg: Vector
    """Roll, pitch, yaw; intrinsic z-y-x. [°]"""


OneOrientation = Annotated[Quaternion | Euler, Forms("list", "table")]
