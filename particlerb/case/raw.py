"""The plain data of a case file, as rules read it: what is not of the right kind is passed over."""

import math
from collections.abc import Iterator
from typing import Any, TypeAlias, TypeVar

from particlerb.case.problems import Path
from particlerb.case.values import LARGEST_COUNT
from particlerb.model.names import REFERENCE, BodyNames

Finding: TypeAlias = tuple[Path, str, str]
_Kind = TypeVar("_Kind", dict[str, Any], list[Any], str)


def entry_at(raw: Any, key: str, kind: type[_Kind]) -> _Kind:
    """Entry of a table if it is of a kind: dict, list or str; else an empty one."""
    entry = raw.get(key) if isinstance(raw, dict) else None
    return entry if isinstance(entry, kind) else kind()


def tables(raw: Any, key: str) -> list[tuple[int, dict[str, Any]]]:
    """Tables of an array of tables with their index; what is none is left out."""
    entries = enumerate(entry_at(raw, key, list))
    return [(i, entry) for i, entry in entries if isinstance(entry, dict)]


def number(raw: Any, key: str) -> float | None:
    """Finite number at a key; None where there is none."""
    return finite(raw.get(key)) if isinstance(raw, dict) else None


def finite(value: Any) -> float | None:
    """A finite number as it is; None for all else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def has(table: dict[str, Any], key: str) -> bool:
    """Whether a table has a key that says something."""
    value = table.get(key)
    return value is not None and not (isinstance(value, list) and not value)


def members(raw: dict[str, Any]) -> BodyNames:
    """Names of the bodies of every block; none where a block says not how many it has."""
    records: list[tuple[str, int]] = []
    for _, body in tables(raw, "body"):
        name, count = body.get("name"), body.get("count", 1)
        is_count = isinstance(count, int) and 1 <= count <= LARGEST_COUNT
        if not isinstance(name, str) or not is_count:
            return BodyNames(())
        records.append((name, count))
    return BodyNames(records)


def bodies_named(value: Any, names: BodyNames) -> list[range] | None:
    """Bodies of one name, or of each of a list; None where one is not there."""
    listed = value if isinstance(value, list) else [value]
    try:
        return [names.span(name) for name in listed]
    except (KeyError, TypeError):  # no such body, or no name
        return None


def pair_rules(
    path: Path, raw: dict[str, Any], names: BodyNames, hint: str, either_way: bool = False
) -> Iterator[Finding]:
    """`body` and `to` make pairs: equal numbers, or one `to` for all; `either_way`: one `body`."""
    ends = (bodies_named(raw.get(key), names) or () for key in ("body", "to"))
    n, m = (sum(map(len, end)) for end in ends)
    if n and m and m not in {n, 1} and not (either_way and n == 1):
        yield (*path, "to"), f"names {m} bodies, `body` {n}: they make no pairs", hint


def is_origin(position: Any) -> bool:
    """Whether a position is the default, which a resolved case states beside `place`."""
    return isinstance(position, list) and position == [0, 0, 0]


def out_of_place(path: Path, table: dict[str, Any], key: str, what: str) -> Iterator[Finding]:
    """A point that something else excludes; a resolved case states its default there."""
    if has(table, key) and not is_origin(table[key]):
        yield (*path, key), f"cannot be given together with {what}", "leave it out"


def bases(names: Any) -> set[str]:
    """Names of the blocks of bodies that are named."""
    listed = names if isinstance(names, list) else [names]
    matches = (REFERENCE.fullmatch(name) for name in listed if isinstance(name, str))
    return {match["name"] for match in matches if match}
