"""Pydantic's errors in the words of a case: (path, reason, hint, whether the key is to blame)."""

import re
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher
from functools import reduce
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from particlerb.case.forces import ForceTable
from particlerb.case.problems import CaseError, Locator, Path, Source, is_meant, nearest, shown
from particlerb.case.schema import Case
from particlerb.case.values import FloatArray, Table, is_rows, plain

_WORDS_OF_KINDS = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text",
    "string_unicode": "must be a text that UTF-8 can hold",
    "tuple_type": "must be a list",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
}
_CLOSE = 0.7  # likeness of a key and of the one that is guessed, as length and rest_length
_GUESS = r'did you mean "(.*?)"|\S+ is a key of (\w+)$'
_SHARED = "bodies of a [[force]] share it: write a [[force]] for each that differs"
_EMPTY_KINDS = ("string_too_short", "too_short")
_BOUND_KINDS = {"greater_than": (">", "gt"), "greater_than_equal": (">=", "ge"),
          "less_than": ("<", "lt"), "less_than_equal": ("<=", "le")}  # fmt: skip
_WORDS_OF_TYPES: dict[type, str] = {
    bool: "true or false", str: "a text", list: "a list", tuple: "a list", dict: "a table",
    int: "a whole number", float: "a number", type(None): "nothing",
}  # fmt: skip


class Message(NamedTuple):
    """What the schema says against an entry."""

    path: Path
    reason: str
    hint: str = ""
    at_key: bool = False


def messages_of(
    raw: Any, errors: Sequence[ErrorDetails], root: type[Table] = Case
) -> list[Message]:
    """All errors of a validation of a case, or of one of its tables."""
    return [_message(raw, error, root) for error in errors if not _is_follow_up(error)]


def without_typos(messages: Sequence[Message]) -> list[Message]:
    """Messages without missing keys that are there with a typing mistake, or in another form."""
    meant = {
        (*one.path[:-1], guess[1] or guess[2])
        for one in messages
        if one.reason == "unknown key" and (guess := re.match(_GUESS, one.hint))
    }
    meant |= {
        (*one.path[:-1], guess[2], one.path[-1])
        for one in messages
        if (guess := re.match(_GUESS, one.hint)) and guess[2]
    }
    others = [one.path[:-1] for one in messages if one.at_key and forms(one.path[:-1])]
    meant |= {(*path, key) for path in others for key in ("euler_deg", "body", "random")}
    return _one_of_a_form([m for m in messages if m.reason != "missing" or m.path not in meant])


def _one_of_a_form(messages: Sequence[Message]) -> list[Message]:
    """Messages in which the unknown keys of what may have another form are one message."""
    unknown: dict[Path, list[Message]] = {}
    for m in messages:
        if m.reason == "unknown key" and forms(m.path[:-1]):
            unknown.setdefault(m.path[:-1], []).append(m)
    several = {path: group for path, group in unknown.items() if len(group) > 1}
    told = []
    for path, group in several.items():
        keys = [str(m.path[-1]) for m in group]
        turn = "; by an angle a about the unit vector n: [cos(a/2), sin(a/2) n]"
        hint = forms(path) + (turn if "axis" in keys else "")
        told.append(Message(path, f"unknown keys: {', '.join(keys)}", hint))
    left = [m for m in messages if m.path[:-1] not in several or m.reason != "unknown key"]
    return left + told


def decides_on_others(message: Message) -> bool:
    """Whether rules of other tables cannot be judged before this is mended."""
    is_no_table = len(message.path) == 1 and message.reason.startswith("must be")
    return is_no_table or message.path == ("contact", "law")


def _is_follow_up(error: ErrorDetails) -> bool:
    """Whether a list is called too short only because its entries are wrong."""
    return error["type"] == "too_short" and bool(error["input"])


def _message(raw: Any, error: ErrorDetails, root: type[Table]) -> Message:
    """One error of pydantic."""
    path = _path_in(raw, error["loc"], root)
    kind, context, value = error["type"], error.get("ctx", {}), error["input"]
    alike = _SHARED if _is_shared(raw, path, root, kind, value) else ""
    if kind == "extra_forbidden":
        keys = _table_keys(raw, path[:-1], root)
        hint, where = nearest(str(path[-1]), keys, "keys here"), _elsewhere(path, root)
        if path[-1] == "bodies" and "to" in keys:  # each of `body` alone would be tied to the world
            hint = hint.replace('"body"?', '"body" and "to"?')
        if where and not forms(path[:-1]) and not _is_close(str(path[-1]), hint):
            hint = f"{where}; {hint[hint.find('keys here') :]}"
        elif not hint.startswith("did you mean"):
            hint = forms(path[:-1]) or hint
        return Message(path, "unknown key", _home_of(raw, path, root) or hint, True)
    if kind == "missing":
        is_header = len(path) == 1 and root is Case
        keys = _table_keys(raw, path[:-1], root)
        listed = f"keys here: {', '.join(keys)}" if keys else ""
        return Message(path, "missing", _header_of(raw, path, root) if is_header else listed)
    if kind == "rule":
        path = (*path, context["key"]) if context["key"] else path
        return Message(path, error["msg"], context["hint"] or forms(path) or alike)
    if kind in {"union_tag_invalid", "union_tag_not_found"}:
        return _type_message(path, context, _table_keys(raw, path, root))
    if kind in {"literal_error", "choice"}:
        choices = re.findall(r"'([^']*)'", context["expected"])
        hint = forms(path) or nearest(str(value), choices)
        return Message(path, f"unknown: {shown(value)}", hint)
    reason = _reason_of(kind, context, value) or error["msg"]
    if kind == "float_type" and _tables(_types_at(raw, path, root), None):
        reason = reason.replace("a number", "a number or a table", 1)
    hint = f"write [[{path[0]}]]" if kind == "tuple_type" and len(path) == 1 else alike
    if kind in {"float_type", "int_type"} and isinstance(value, str) and re.match(r"\W*\d", value):
        hint = "numbers stand without quotes and without a unit, in SI units"
    if kind in {"model_type", "model_attributes_type"}:
        are = "keys" if kind == "model_type" else "{ type = .. } with one of the types"
        is_header = len(path) == 1 and root is Case
        kinds = f"{are}: {', '.join(_table_keys(raw, path, root))}"
        hint = _header_of(raw, path, root) if is_header else kinds
    return Message(path, reason, hint)


def _is_shared(raw: Any, path: Path, root: type[Table], kind: str, value: Any) -> bool:
    """Whether rows for bodies of a [[force]] are given for a key that is the same for all."""
    if not (path[:1] == ("force",) or issubclass(root, ForceTable)):
        return False
    if path[-1:] == ("values",):  # of knots, which have rows of their own
        return is_rows(value) and is_rows(value[0])
    is_list = kind == "float_type" and isinstance(value, list)
    has_rows = is_list or (is_rows(value) and len(value) > 1)
    return has_rows and FloatArray not in _types_at(raw, path, root)


def _header_of(raw: Any, path: Path, root: type[Table]) -> str:
    """How a table of a case begins, and its keys."""
    header = _header(str(path[0]), root)
    return f"write {header} with its keys: {', '.join(_table_keys(raw, path, root))}"


def _header(name: str, root: type[Table]) -> str:
    """How a table of a case, or one of several, begins."""
    is_list = get_origin(root.model_fields[name].annotation) is tuple
    return f"[[{name}]]" if is_list else f"[{name}]"


def _is_close(key: str, hint: str) -> bool:
    """Whether the key that a hint guesses is nearly the same, or means it."""
    guess = re.match(_GUESS, hint)
    if guess is None or is_meant(key, guess[1] or ""):
        return guess is not None
    return SequenceMatcher(None, key, guess[1] or "").ratio() >= _CLOSE


def _elsewhere(path: Path, root: type[Table]) -> str:
    """Other tables of the case that take an unknown key; empty where none does, or many do."""
    homes, key, is_deep = [], str(path[-1]), sum(isinstance(part, str) for part in path) > 2
    for name, field in root.model_fields.items() if root is Case else ():
        tables = _tables(_alternatives(field.annotation), None)
        is_own = name == path[0]
        if tables and name == key and not is_own:
            return f"{key} is a table of its own: {_header(name, root)}"
        if any(key in table.model_fields for table in tables):
            if is_own and not is_deep:  # that of another type
                return ""
            if is_own == is_deep:
                homes.append(_header(name, root))
    return f"{key} is a key of {' or '.join(homes)}" if 0 < len(homes) < 4 else ""


def _home_of(raw: Any, path: Path, root: type[Table]) -> str:
    """The table, within the one that has an unknown key, that takes it; empty where none does."""
    types = _types_at(raw, path[:-1], root)
    homes = [
        name
        for table in _tables(types, reduce(child, path[:-1], raw))
        for name, field in table.model_fields.items()
        for inner in _tables(_alternatives(field.annotation), None)
        if path[-1] in inner.model_fields
    ]
    names = list(dict.fromkeys(homes))
    return f"{path[-1]} is a key of {' or '.join(names)}" if 0 < len(names) < 3 else ""


def forms(path: Path) -> str:
    """What may stand for an orientation or a velocity."""
    if path[-1:] == ("orientation",):
        random = "" if path[0] == "wall" or "part" in path else ', or "random"'
        return f"[w, x, y, z], {{ euler_deg = [roll, pitch, yaw] }}{random}"
    if path[:1] == ("body",) and path[-1] in {"velocity", "angular_velocity"}:
        return "[x, y, z], { body = [x, y, z] }, or { random = v }"
    return ""


def _type_message(path: Path, context: dict[str, Any], keys: Sequence[str]) -> Message:
    """A `type` that is missing or that no shape, force, placement or wall has."""
    if "tag" not in context:
        return Message((*path, "type"), "missing", f"known: {', '.join(keys)}")
    tags = re.findall(r"'([^']*)'", context["expected_tags"])
    tag = str(context["tag"])
    if tag in Case.model_fields:
        hint = f"{tag} is a table of its own: {_header(tag, Case)}"
        return Message((*path, "type"), f"unknown type {shown(tag)}", hint)
    return Message((*path, "type"), f"unknown type {shown(tag)}", nearest(tag, tags))


def _reason_of(kind: str, context: dict[str, Any], value: Any) -> str:
    """Reason for the kinds of error that numbers and texts have."""
    if kind in _BOUND_KINDS:
        sign, bound = _BOUND_KINDS[kind]
        limit = f"{context[bound]:g}" if isinstance(context[bound], float) else context[bound]
        return f"must be {sign} {limit}, got {shown(value)}"
    if kind == "finite_number":
        return f"must be finite, got {shown(value)}"
    if kind in _EMPTY_KINDS:
        return "must not be empty"
    return f"{_WORDS_OF_KINDS[kind]}, got {_described(value)}" if kind in _WORDS_OF_KINDS else ""


def _described(value: Any) -> str:
    """Kind of a value, and the value itself where it is short."""
    word = _WORDS_OF_TYPES.get(type(value), type(value).__name__)
    return word if isinstance(value, (list, tuple, dict, type(None))) else f"{word}: {shown(value)}"


def _path_in(raw: Any, loc: tuple[int | str, ...], root: type[Table]) -> Path:
    """Path in the data: pydantic's location without the tags of unions and invented indices."""
    path: Path = ()
    node, was_tag = raw, False
    for key in loc:
        is_tag = isinstance(key, str) and not was_tag and len(_types_at(raw, path, root)) > 1
        was_tag = is_tag
        if is_tag:
            continue
        if isinstance(key, int) and not isinstance(node, (list, tuple)):
            break
        node = child(node, key)
        path = (*path, key)
    return path


def child(node: Any, key: int | str) -> Any:
    """Entry of a table or list; None where there is none."""
    if isinstance(node, dict):
        return node.get(key)
    is_there = isinstance(node, list) and isinstance(key, int) and key < len(node)
    return node[key] if is_there else None


def _alternatives(annotation: Any) -> list[Any]:
    """Types that a value may have, or each entry of it where it is a list of any length."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin in (Union, UnionType):
        return [one for part in parts if part is not NoneType for one in _alternatives(part)]
    is_list = origin is tuple and parts[1:] == (...,)
    return _alternatives(parts[0]) if is_list or origin is Annotated else [annotation]


def _types_at(raw: Any, path: Path, root: type[Table]) -> list[Any]:
    """Types that the entry at a path may have."""
    types: list[Any] = [root]
    node = raw
    for key in path:
        if isinstance(key, str):
            tables = _tables(types, node)
            annotations = [t.model_fields[key].annotation for t in tables if key in t.model_fields]
            annotations += [get_args(t)[1] for t in types if get_origin(t) is dict]
            types = _alternatives(annotations[0]) if annotations else []
        node = child(node, key)
    return types


def _tables(types: Sequence[Any], node: Any) -> list[type[Table]]:
    """Tables among some types; the one that the `type` of the data names, where it names one."""
    tables = [t for t in types if isinstance(t, type) and issubclass(t, Table)]
    kind = node.get("type") if isinstance(node, dict) else None
    return [table for table in tables if kind in names_of(table)] or tables


def names_of(table: type[Table]) -> tuple[str, ...]:
    """What a table may be called by its `type`; nothing where it has none."""
    return get_args(table.model_fields["type"].annotation) if "type" in table.model_fields else ()


def _table_keys(raw: Any, path: Path, root: type[Table]) -> tuple[str, ...]:
    """Keys of the table at a path; names of tables where it may be several."""
    tables = _tables(_types_at(raw, path, root), reduce(child, path, raw))
    names = [names_of(table)[0] for table in tables if names_of(table)]
    keys = names if len(names) > 1 else [key for table in tables for key in table.model_fields]
    return tuple(keys)


def fill(record: Table, keys: Mapping[str, Any]) -> None:
    """Give a new table its keys; `type` is known where the class says it.

    Raises
    ------
    CaseError
        With all that is wrong with the table alone. What involves others shows when it is run.
    """
    table = type(record)
    kind = table.model_fields.get("type")
    known = {"type": names_of(table)[0]} if kind is not None and kind.init is False else {}
    raw = plain(known | dict(keys), keeps_tables=True)
    try:
        table.__pydantic_validator__.validate_python(raw, self_instance=record)
    except ValidationError as error:
        messages = without_typos(messages_of(raw, error.errors(include_url=False), table))
        locator = Locator(Source(raw=raw))
        problems = [locator.problem(*one) for one in messages]
        raise CaseError(one._replace(file=table.__name__) for one in problems) from None
