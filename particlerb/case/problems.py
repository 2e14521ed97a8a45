"""What is wrong with a case, where in its file, and how it is shown.

A message has file, line, key, reason, source line and hint.
"""

import difflib
import re
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

from particlerb.files import Files

if TYPE_CHECKING:
    from particlerb.case.positions import Extent

Path: TypeAlias = tuple[str | int, ...]
"""Keys and indices from the root of the case, e.g. ("body", 0, "shape", "radius")."""

_MAX_VALUE_LENGTH = 60
_MAX_LINE_LENGTH = 96
_MAX_MESSAGE_LENGTH = 1000
_MAX_NAMES_LISTED = 20  # in a hint
_MAX_NAMES_COMPARED = 1000
_LEAST_FOLDED = 2  # other problems that are like a first one
_SYNONYMS = {
    "box": ("cube", "cuboid", "brick", "block", "plate"), "mesh": ("stl", "obj"),
    "drag": ("wind", "friction", "damping"), "spring": ("damper", "dashpot"),
    "hinge": ("pin", "revolute"), "slider": ("prismatic", "piston"), "fixed": ("weld", "glue"),
    "strang": ("verlet", "leapfrog", "velocity_verlet"), "hooke": ("linear", "penalty", "spring"),
    "semi_implicit_euler": ("euler", "symplectic_euler"), "plane": ("floor", "ground"),
    "angular_velocity": ("omega", "spin", "w"), "acceleration": ("g", "gravity"),
    "lower": ("low", "min", "minimum"), "upper": ("high", "max", "maximum"), "friction": ("mu",),
    "method": ("integrator", "solver", "scheme"), "stiffness": ("k",), "radius": ("r",),
    "dt": ("step", "timestep", "time_step"), "t_end": ("duration", "tmax", "t_max", "time"),
    "translation": ("linear", "coefficient"), "at": ("point",), "during": ("time", "interval"),
    "origin": ("position", "at", "center", "centre", "middle"), "position": ("center", "centre"),
}  # fmt: skip
"""Names of cases, and what other programs and books call the same."""
LONGEST_SCANNED = 8 * 2**20  # characters; messages of longer files have no lines


class Problem(NamedTuple):
    """One mistake in a case; lines and columns count from 1."""

    file: str
    line: int | None
    column: int | None
    key: str
    value: str
    reason: str
    hint: str = ""
    source: str = ""
    length: int = 1

    def __str__(self) -> str:
        """Text as compilers print it: place, reason, source line, underline, hint."""
        place = self.file if self.line is None else f"{self.file}:{self.line}:{self.column}"
        key = f"{self.key}: " if self.key else ""
        lines = [_printable(f"{place}: error: {key}{self.reason}")]
        if self.line is not None and self.source.strip():
            lines += self.excerpt()
        if self.hint:
            lines.append(_printable(f"      hint: {self.hint}"))
        return "\n".join(lines)

    def excerpt(self) -> list[str]:
        """Source line with an underline, cut to a window where it is long."""
        start = (self.column or 1) - 1
        first = max(0, start - _MAX_LINE_LENGTH // 2) if len(self.source) > _MAX_LINE_LENGTH else 0
        shown = self.source[first : first + _MAX_LINE_LENGTH]
        shown = "".join(c if c.isprintable() else " " for c in shown).rstrip()
        width = max(1, min(self.length, len(shown) - (start - first)))
        return [f"{self.line:>5} | {shown}", f"      | {' ' * (start - first)}{'^' * width}"]


class CaseError(Exception):
    """A case that cannot be run; `problems` has all that is wrong with it, by line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        in_order = sorted(problems, key=lambda p: (p.line or sys.maxsize, p.column or 0))
        self.problems = tuple(in_order)
        super().__init__(self.problems)

    def __str__(self) -> str:
        """One block per problem; of three and more alike, the first, then where the others are."""
        alike: dict[tuple[str, ...], list[Problem]] = {}
        for p in self.problems:
            kind = p.file, re.sub(r"\[\d+\]", "", p.key), p.reason, p.hint
            alike.setdefault(kind, []).append(p)
        blocks: list[str] = []
        for first, *others in alike.values():
            is_folded = len(others) >= _LEAST_FOLDED
            blocks += map(str, (first, *(() if is_folded else others)))
            if is_folded:
                keys = ", ".join(map(_named, others[:_MAX_NAMES_LISTED]))
                rest = f", ... ({len(others)} in all)" if len(others) > _MAX_NAMES_LISTED else ""
                blocks.append(_printable(f"      likewise: {keys}{rest}"))
        return "\n".join(blocks)


def refuse(problems: Collection[Problem]) -> None:
    """Raise CaseError if there are problems."""
    if problems:
        raise CaseError(problems)


def _named(problem: Problem) -> str:
    """Key and line of a problem that is like another one."""
    return f"{problem.key} (line {problem.line})" if problem.line else problem.key


def _printable(text: str) -> str:
    """Text that a terminal can show as it is: control characters and the like escaped, and cut."""
    cut = text if len(text) <= _MAX_MESSAGE_LENGTH else f"{text[:_MAX_MESSAGE_LENGTH]}..."
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in cut)


def key_of(path: Path) -> str:
    """Path as people write it: body[0].shape.radius."""
    key = ""
    for entry in path:
        key += f"[{entry}]" if isinstance(entry, int) else f".{entry}" if key else entry
    return key


def path_of(key: str) -> Path:
    """Path of a key, body[0].mass or body.0.mass; what has another form is a part by itself."""
    is_key = re.fullmatch(r"[^.\[\]]+(\.[^.\[\]]+|\[-?\d+\])*", key)
    parts = re.findall(r"[^.\[\]]+", key) if is_key else [key] * bool(key)
    return tuple(int(part) if re.fullmatch("-?[0-9]{1,10}", part) else part for part in parts)


def shown(value: Any) -> str:
    """Value for a message, shortened."""
    if isinstance(value, list) and len(value) > _MAX_VALUE_LENGTH:
        value = value[:_MAX_VALUE_LENGTH]
    try:
        text = repr(value).replace("\n", " ")
    except (ValueError, RecursionError):  # an integer of more than 4300 digits
        text = "..."
    return text if len(text) <= _MAX_VALUE_LENGTH else text[: _MAX_VALUE_LENGTH - 3] + "..."


def is_meant(word: str, name: str) -> bool:
    """Whether a word is a name of cases, or what others call it."""
    return word.lower() in (name, *_SYNONYMS.get(name, ()))


def nearest(word: str, names: Sequence[str], label: str = "known") -> str:
    """Hint with the known word that is meant, in double quotes, and all that are known."""
    if not names:
        return ""
    meant = [name for name in names if is_meant(word, name)]
    block, bracket, number = word[:100].partition("[")  # of bodies: many, of a few blocks
    blocks = dict.fromkeys(name.partition("[")[0] for name in names)
    near = difflib.get_close_matches(block, [*blocks][:_MAX_NAMES_COMPARED], 1, 0.5)
    whole = list({f"{other}{bracket}{number}" for other in near}.intersection(names))
    others = names[:_MAX_NAMES_COMPARED]
    close = meant or whole or difflib.get_close_matches(word[:100], others, 1, 0.5)
    guess = f'did you mean "{close[0]}"? ' if close else ""
    rest = f", ... ({len(names)} in all)" if len(names) > _MAX_NAMES_LISTED else ""
    return f"{guess}{label}: {', '.join(names[:_MAX_NAMES_LISTED])}{rest}"


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
        problem = file_problem(self.source.path, reason, hint)
        problem = problem._replace(key=key_of(path), value=value)
        return problem._replace(**self.position(path, at_key)) if self.source.text else problem

    def position(self, path: Path, at_key: bool) -> dict[str, Any]:
        """Line, column, source line and length of the nearest entry that the text has."""
        if self.extents is None:
            from particlerb.case.positions import extents  # only where something is wrong

            is_short = len(self.source.text) <= LONGEST_SCANNED
            self.extents = extents(self.source.text) if is_short else {}
        if not self.extents:
            return {}
        nearest = path
        while nearest and nearest not in self.extents:
            nearest = nearest[:-1]
        if not nearest:
            return {"line": 1, "column": 1}
        extent = self.extents[nearest]
        start, end = extent.value if nearest == path and not at_key else extent.key
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
    for key in path:
        try:
            raw = raw[key]
        except (LookupError, TypeError):
            return ""
    return shown(raw)
