"""Cases that are one but for the values of some keys: what changes is judged, the rest is not.

Most numbers cannot break a rule that involves other keys, unless they become zero, or have another
form: of such variants one is judged as a whole, and of the others what changes.
"""

from collections.abc import Sequence
from functools import cache
from math import isfinite
from typing import Annotated, Any, Final

from pydantic import TypeAdapter, ValidationError

from particlerb.case.bodies import Body
from particlerb.case.overrides import with_value
from particlerb.case.problems import Path
from particlerb.case.schema import Case

_BODY_KEYS: Final = frozenset(
    ("shape", "mass", "density", "position", "orientation", "velocity", "angular_velocity")
)
_VECTOR_KEYS: Final = frozenset(("position", "velocity", "angular_velocity"))
_TIME_KEYS: Final = frozenset(("during", "time", "times", "table", "file", "body", "to", "type"))
_CONTACT_KEYS: Final = frozenset(
    ("friction", "restitution", "rolling_friction", "stiffness", "torsional_friction")
)
_SEED_PATH: Final = ("run", "seed")
_PAIR_PATH_LENGTH: Final = 4  # parts of a key like contact.pair.0.friction


def likeness(paths: Sequence[Path], values: Sequence[Any]) -> tuple[object, ...]:
    """What variants have in common that differ in nothing but numbers, none of them zero in one."""
    return tuple(
        value != 0.0 if type(value) is float and _is_number(path) else _likeness(path, value)
        for path, value in zip(paths, values, strict=True)
    )


def _likeness(path: Path, value: Any) -> object:
    """The same of one value that is no float."""
    return repr(value) if not _is_number(path) else "" if path == _SEED_PATH else _pattern(value)


@cache
def _is_number(path: Path) -> bool:
    """Whether no rule compares the numbers at a key with other keys."""
    if path[0] == "contact":
        is_own = len(path) == 2 or (path[1] == "pair" and len(path) == _PAIR_PATH_LENGTH)
        return is_own and path[-1] in _CONTACT_KEYS
    if path == _SEED_PATH:
        return True
    if len(path) < 3 or path[0] not in ("body", "force"):
        return False
    return path[2] in _BODY_KEYS if path[0] == "body" else _TIME_KEYS.isdisjoint(path)


def _pattern(value: Any) -> object:
    """A value without its numbers, but for which of them are zero."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return value != 0
    if isinstance(value, (list, tuple)):
        return tuple(map(_pattern, value))
    if isinstance(value, dict):
        return tuple((key, _pattern(entry)) for key, entry in sorted(value.items()))
    return repr(value)


def wrong_among(case: Case, paths: Sequence[Path], rows: Sequence[Sequence[Any]]) -> set[int]:
    """Numbers of variants that are wrong, as `changed` finds them.

    A finite component of an initial position or velocity breaks no rule: it is not read.
    """
    judged = [
        k
        for k, path in enumerate(paths)
        if not (_is_component(path) and all(type(r[k]) is float and isfinite(r[k]) for r in rows))
    ]
    return changed(case, [paths[k] for k in judged], [[r[k] for k in judged] for r in rows])[1]


def _is_component(path: Path) -> bool:
    """Whether a key is a component of a vector of an initial position or velocity."""
    is_vector = path[0] == "body" and not _VECTOR_KEYS.isdisjoint(path[2:3])
    return is_vector and isinstance(path[-1], int) and set(path[3:-1]) <= {"body"}


def changed(
    case: Case, paths: Sequence[Path], rows: Sequence[Sequence[Any]]
) -> tuple[dict[Path, list[Any]], set[int]]:
    """Records, or entries of bodies, in which variants of a case differ.

    Parameters
    ----------
    case : Case
        One of them.
    paths : sequence of Path
        Keys that are given.
    rows : sequence
        Values of these keys, for each variant, of the same `likeness`.

    Returns
    -------
    dict of Path to list
        By paths as ("force", 0), or ("body", 0, "mass"): what each variant has there.
    set of int
        Numbers of variants that are wrong. If there are some, the dict lacks what is wrong.
    """
    changes, wrong = dict[Path, list[Any]](), set[int]()
    numbers = [(k, path, _place_of(path)) for k, path in enumerate(paths) if _is_number(path)]
    for place in dict.fromkeys(place for _, _, place in numbers):
        keys = [(k, path[len(place) :]) for k, path, there in numbers if there == place]
        start: Any = case.source.raw
        for key in place:
            start = start.get(key) if isinstance(start, dict) else start[key]
        start = {} if start is None else start
        values = []
        for row in rows:
            value = start
            for k, rest in keys:
                value = with_value(value, rest, row[k])
            values.append(value)
        try:
            changes[place] = _adapter(case, place).validate_python(values)
        except ValidationError as error:
            wrong |= {int(fault["loc"][0]) for fault in error.errors(include_url=False)}
    return changes, wrong


def _place_of(path: Path) -> Path:
    """Record of a key; of a body its entry, as no rule of the schema involves two of them."""
    return path[: {"body": 3, "force": 2}.get(str(path[0]), 1)]


def _adapter(case: Case, place: Path) -> TypeAdapter[list[Any]]:
    """What reads a list of records, or of entries."""
    if place[0] == "body":
        return _reader_of(str(place[2]))
    record: Any = getattr(case, str(place[0]))
    kind: Any = type(record if len(place) == 1 else record[place[1]])
    return _reader_of(kind)


@cache
def _reader_of(what: Any) -> TypeAdapter[list[Any]]:
    """The same of an entry of bodies by its name, or of a kind of record."""
    if isinstance(what, str):
        entry = Body.model_fields[what]
        each: Any = list[Annotated[entry.annotation, entry]]  # type: ignore[name-defined]
        return TypeAdapter(each, config=Body.model_config)
    return TypeAdapter(list[what])
