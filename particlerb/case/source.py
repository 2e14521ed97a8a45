"""Where a case comes from, and where in its file an entry stands."""

from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any, NamedTuple, Protocol

from particlerb.case.positions import Extent, extents
from particlerb.case.problems import Path, Problem, key_of, path_of, shown
from particlerb.files import Files

LONGEST_SCANNED = 8 * 2**20  # characters; messages of longer files have no lines


class Source(NamedTuple):
    """Text, file and data of a case: kept so that later stages can point into the file."""

    text: str = ""
    path: FilePath | None = None
    raw: Mapping[str, Any] = {}
    overridden: tuple[Path, ...] = ()
    files: Files = Files()
    """That the case names."""


class _HasSource(Protocol):
    """A case, or the system that was made of it."""

    @property
    def source(self) -> Source:
        """Where it comes from."""


def problem_at(described: _HasSource, key: str, reason: str, hint: str = "") -> Problem:
    """Problem that a later stage has found; with its place in the file, if there is one.

    Parameters
    ----------
    described : Case or System
        What has the problem.
    key : str
        Path of a record, as in messages: `body[0].shape.radius`.
    reason, hint : str
        What is wrong, and what to do about it.
    """
    return Locator(described.source).problem(path_of(key), reason, hint)


class Locator:
    """Turns a path of a case into file, line, column and source line; scans when first asked."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.extents: dict[Path, Extent] | None = None

    def problem(self, path: Path, reason: str, hint: str = "", at_key: bool = False) -> Problem:
        """Problem at a path: its value, or its key, or the table where it is missing."""
        value = _value_at(self.source.raw, path)
        for override in self.source.overridden:
            if path[: len(override)] == override:
                name = "--set " + ".".join(map(str, override))
                return Problem(name, None, None, key_of(path), value, reason, hint)
        found = file_problem(self.source.path, reason, hint)
        found = found._replace(key=key_of(path), value=value)
        return found._replace(**self.position(path, at_key)) if self.source.text else found

    def position(self, path: Path, at_key: bool) -> dict[str, Any]:
        """Line, column, source line and length of the nearest entry that the text has."""
        if self.extents is None:
            is_short = len(self.source.text) <= LONGEST_SCANNED
            self.extents = extents(self.source.text) if is_short else {}
        if not self.extents:
            return {}
        known = path
        while known and known not in self.extents:
            known = known[:-1]
        if not known:
            return {"line": 1, "column": 1}
        extent = self.extents[known]
        start, end = extent.value if known == path and not at_key else extent.key
        text = self.source.text
        first = text.rfind("\n", 0, start) + 1
        last = text.find("\n", start)
        last = len(text) if last < 0 else last
        return {
            "line": text.count("\n", 0, start) + 1,
            "column": start - first + 1,
            "source": text[first:last].rstrip("\r"),
            "length": max(1, min(end, last) - start),
        }


def file_problem(path: FilePath | None, reason: str, hint: str = "") -> Problem:
    """Problem of the file as a whole."""
    return Problem(str(path) if path else "case", None, None, "", "", reason, hint)


def _value_at(raw: Any, path: Path) -> str:
    """Value at a path, shortened; empty where there is none."""
    for part in path:
        try:
            raw = raw[part]
        except (LookupError, TypeError):
            return ""
    return shown(raw)
