"""Text of a case file from its data."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import tomlkit

from particlerb.user_force import UserForce


def toml_text(raw: Mapping[str, Any], comments: Iterable[str] = ()) -> str:
    """Text of a case, with comments above it.

    Every number has as many digits as bring back the same float.
    """
    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line) if line else tomlkit.nl())
    tables = _without_none(raw)
    first = [key for key in ("title", "run") if key in tables]
    for key in (*first, *(key for key in tables if key not in first)):
        document.add(key, tomlkit.item(tables[key]))
    return tomlkit.dumps(document)


def _without_none(value: Any) -> Any:
    """Data as TOML has them: rows as lists, and nothing for what is None."""
    if isinstance(value, Mapping):
        entries = {k: _without_none(entry) for k, entry in value.items() if entry is not None}
        return _axes(entries) if any("." in key for key in entries) else entries
    if isinstance(value, list):
        return [_without_none(entry) for entry in value]
    if isinstance(value, UserForce):  # its text is to be a file beside the case
        return value.name
    return value.tolist() if isinstance(value, np.ndarray) else value


def _axes(entries: dict[str, Any]) -> Any:
    """Axes of a sweep in their order, which is that of its rows: tables would come last."""
    axes = tomlkit.table()
    for key, entry in entries.items():
        axes.append(key, tomlkit.item(entry, tomlkit.inline_table()))  # on one line
    return axes
