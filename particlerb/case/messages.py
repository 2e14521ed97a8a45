"""Pydantic's errors in the words of a case: (path, reason, hint, whether the key is to blame)."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pydantic_core import ErrorDetails

from particlerb.case.bodies import PLACES, Body, ShapePart
from particlerb.case.contact import (
    WALLS,
    ContactTable,
    Material,
    Oscillation,
    Pair,
    Piston,
    Prescribed,
)
from particlerb.case.forces import FORCES
from particlerb.case.output import Check, CheckValue, Output
from particlerb.case.problems import Path, nearest, shown
from particlerb.case.run import AttractionTable, Gravity, RunTable
from particlerb.case.schema import Case
from particlerb.case.shapes import ALIASES, SHAPES
from particlerb.case.values import Euler, Table

_TAGGED = {
    "body": {"shape", "place", "position", "orientation", "velocity", "angular_velocity"},
    "force": {"rest_length", "charge"},
    "wall": {"orientation"},
}
_KINDS = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text",
    "string_unicode": "must be a text that UTF-8 can hold",
    "tuple_type": "must be a list",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
}
_EMPTY = ("string_too_short", "too_short")
_BOUNDS = {"greater_than": (">", "gt"), "greater_than_equal": (">=", "ge"),
          "less_than": ("<", "lt"), "less_than_equal": ("<=", "le")}  # fmt: skip
_WORDS: dict[type, str] = {
    bool: "true or false", str: "a text", list: "a list", tuple: "a list", dict: "a table",
    int: "a whole number", float: "a number", type(None): "nothing",
}  # fmt: skip


class Complaint(NamedTuple):
    """What the schema says against an entry."""

    path: Path
    reason: str
    hint: str = ""
    at_key: bool = False


def complaints(raw: Any, errors: Sequence[ErrorDetails]) -> list[Complaint]:
    """All errors of a validation."""
    return [_complaint(raw, error) for error in errors if not _is_follow_up(error)]


def without_typos(found: Sequence[Complaint]) -> list[Complaint]:
    """Complaints without missing keys that are there with a typing mistake."""
    meant = {
        (*one.path[:-1], guess[1])
        for one in found
        if one.reason == "unknown key" and (guess := re.match(r'did you mean "(.*?)"', one.hint))
    }
    return [one for one in found if one.reason != "missing" or one.path not in meant]


def _is_follow_up(error: ErrorDetails) -> bool:
    """Whether a list is called too short only because its entries are wrong."""
    return error["type"] == "too_short" and bool(error["input"])


def _complaint(raw: Any, error: ErrorDetails) -> Complaint:
    """One error of pydantic."""
    path = _path_in(raw, error["loc"])
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    if kind == "extra_forbidden":
        keys = _table_keys(path[:-1], _type_of(raw, path[:-1]))
        return Complaint(path, "unknown key", nearest(str(path[-1]), keys, "keys here"), True)
    if kind == "missing":
        keys = _table_keys(path[:-1], _type_of(raw, path[:-1]))
        return Complaint(path, "missing", f"keys here: {', '.join(keys)}" if keys else "")
    if kind == "rule":
        path = (*path, context["key"]) if context["key"] else path
        return Complaint(path, error["msg"], context["hint"] or forms(path))
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        return _type_complaint(path, context)
    if kind in {"literal_error", "choice"}:
        known = re.findall(r"'([^']*)'", context["expected"])
        hint = forms(path) or nearest(str(value), known)
        return Complaint(path, f"unknown: {shown(value)}", hint)
    return Complaint(path, _reason_of(kind, context, value) or error["msg"])


def forms(path: Path) -> str:
    """What may stand for an orientation or a velocity."""
    if path[-1:] == ("orientation",):
        random = "" if path[0] == "wall" or "part" in path else ', or "random"'
        return f"[w, x, y, z], {{ euler_deg = [roll, pitch, yaw] }}{random}"
    if path[0] == "body" and path[-1] in {"velocity", "angular_velocity"}:
        return "[x, y, z], { body = [x, y, z] }, or { random = v }"
    return ""


def _type_complaint(path: Path, context: dict[str, Any]) -> Complaint:
    """A `type` that is missing or that no shape, force, placement or wall has."""
    keys = _table_keys(path)
    if "tag" not in context:
        return Complaint((*path, "type"), "missing", f"known: {', '.join(keys)}")
    known = re.findall(r"'([^']*)'", context["expected_tags"])
    tag = str(context["tag"])
    return Complaint((*path, "type"), f"unknown type {shown(tag)}", nearest(tag, known))


def _reason_of(kind: str, context: dict[str, Any], value: Any) -> str:
    """Reason for the kinds of error that numbers and texts have."""
    if kind in _BOUNDS:
        sign, bound = _BOUNDS[kind]
        limit = f"{context[bound]:g}" if isinstance(context[bound], float) else context[bound]
        return f"must be {sign} {limit}, got {shown(value)}"
    if kind == "finite_number":
        return f"must be finite, got {shown(value)}"
    if kind in _EMPTY:
        return "must not be empty"
    return f"{_KINDS[kind]}, got {_described(value)}" if kind in _KINDS else ""


def _described(value: Any) -> str:
    """Kind of a value, and the value itself where it is short."""
    word = _WORDS.get(type(value), type(value).__name__)
    return word if isinstance(value, (list, tuple, dict, type(None))) else f"{word}: {shown(value)}"


def _path_in(raw: Any, loc: tuple[int | str, ...]) -> Path:
    """Path in the data: pydantic's location without the tags of unions and invented indices."""
    path: list[int | str] = []
    node, was_tag = raw, False
    for part in loc:
        if isinstance(part, str) and not was_tag and path and _is_tagged(path):
            was_tag = True
            continue
        was_tag = False
        if isinstance(part, int) and not isinstance(node, (list, tuple)):
            break
        node = child(node, part)
        path.append(part)
    return tuple(path)


def _is_tagged(path: list[int | str]) -> bool:
    """Whether pydantic puts the tag of a union after this path."""
    is_kind = len(path) == 2 and path[0] in {"force", "wall"} and isinstance(path[1], int)
    return is_kind or path[-1] in _TAGGED.get(str(path[0]), ())


def child(node: Any, part: int | str) -> Any:
    """Entry of a table or list; None where there is none."""
    if isinstance(node, dict):
        return node.get(part)
    is_there = isinstance(node, list) and isinstance(part, int) and part < len(node)
    return node[part] if is_there else None


def _type_of(raw: Any, path: Path) -> Any:
    """The `type` of a table; None where it has none."""
    for part in path:
        raw = child(raw, part)
    kind = raw.get("type") if isinstance(raw, dict) else None
    return kind if isinstance(kind, str) else None


_FAMILIES: dict[str, Mapping[str, type[Table]]] = {
    "shape": SHAPES,
    "place": PLACES,
    "force": FORCES,
    "wall": WALLS,
}
_TABLES: dict[str, type[Table]] = {
    "": Case, "run": RunTable, "gravity": Gravity, "attraction": AttractionTable, "body": Body,
    "part": ShapePart,
    "output": Output, "check": Check, "value": CheckValue, "orientation": Euler,
    "contact": ContactTable, "pair": Pair, "material": Material, "motion": Prescribed,
    "piston": Piston,
    "oscillation": Oscillation,
}  # fmt: skip


def _table_keys(path: Path, kind: str | None = None) -> tuple[str, ...]:
    """Keys of the table at a path; `kind` is its `type` where it has one."""
    name = next((part for part in reversed(path) if isinstance(part, str)), "")
    if name in _FAMILIES:
        family, kind = _FAMILIES[name], ALIASES.get(kind or "", kind)
        return tuple(family[kind].model_fields) if kind and kind in family else tuple(family)
    if name in {"velocity", "angular_velocity"}:
        return ("body", "random")
    return tuple(_TABLES[name].model_fields) if name in _TABLES else ()
