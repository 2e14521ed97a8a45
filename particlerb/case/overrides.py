"""Values set from outside a case: `--set run.dt=1e-4`, applied before the case is checked."""

import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, Final

from particlerb.case.problems import Path, Problem, Source, key_of, path_of, refuse, shown

_NUMBER: Final = re.compile(r"[+-]?(?:0|[1-9][0-9]*)(\.[0-9]+)?([eE][+-]?[0-9]+)?")


def overridden(source: Source, overrides: Sequence[str]) -> Source:
    """Data with the overrides in it.

    Parameters
    ----------
    source : Source
        Left as it is.
    overrides : sequence of str
        `key=value` with keys as `run.dt` or `body.0.mass`.

    Raises
    ------
    CaseError
        If an override is not of this form or leads nowhere; names `--set KEY`.
    """
    raw, paths, problems = source.raw, list(source.overridden), []
    for override in overrides:
        key, equals, text = override.partition("=")
        path = path_of(key.strip())
        try:
            if not equals or not path:
                raise LookupError("must have the form key=value, such as run.dt=1e-4")
            raw = with_value(raw, path, toml_value(text.strip()))
        except LookupError as error:
            file, reason = f"--set {key}", str(error.args[0])
            problems.append(Problem(file, None, None, key_of(path), text, reason))
        paths.append(path)
    refuse(problems)
    return source._replace(raw=raw, overridden=tuple(paths))


def toml_value(text: str) -> Any:
    """Value of a TOML text; the text itself where it is none. Tables of runs are mostly numbers."""
    try:
        if number := _NUMBER.fullmatch(text):
            return float(text) if number.lastindex else int(text)
        values = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return values["value"] if len(values) == 1 else text


def with_values(raw: Any, paths: Sequence[Path], values: Sequence[Any]) -> Any:
    """Data of a case with values at some paths."""
    for path, value in zip(paths, values, strict=True):
        raw = with_value(raw, path, value)
    return raw


def with_value(node: Any, path: Path, value: Any) -> Any:
    """Copy of nested tables and lists with one entry set; tables missing, or None, are made.

    Raises
    ------
    LookupError
        Where the path runs through a value, or past the end of a list.
    """
    if not path:
        return value
    head, rest = path[0], path[1:]
    if not isinstance(node, list):
        if not isinstance(node, (dict, Mapping)):  # dict is quick to see
            raise LookupError(f"there is no {shown(head)} in {shown(node)}")
        inner = node.get(str(head))
        if inner is None:
            inner = [] if rest and isinstance(rest[0], int) else {}
        return {**node, str(head): with_value(inner, rest, value)}
    if not isinstance(head, int) or not 0 <= head < len(node):
        n = len(node)
        raise LookupError(f"there is no entry {shown(head)} of {n}, counted from 0 as in body.0")
    return [*node[:head], with_value(node[head], rest, value), *node[head + 1 :]]
