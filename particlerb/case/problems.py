"""What is wrong with a case, and how it is shown: file, line, key, reason, source line, hint."""

import difflib
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, TypeAlias

Path: TypeAlias = tuple[str | int, ...]
"""Keys and indices from the root of the case, e.g. ("body", 0, "shape", "radius")."""

_LONGEST_VALUE = 60
_LONGEST_LINE = 96
_LONGEST_MESSAGE = 1000
_MOST_LISTED = 20  # names in a hint
_MOST_COMPARED = 1000


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
        first = max(0, start - _LONGEST_LINE // 2) if len(self.source) > _LONGEST_LINE else 0
        shown = self.source[first : first + _LONGEST_LINE]
        shown = "".join(c if c.isprintable() else " " for c in shown).rstrip()
        width = max(1, min(self.length, len(shown) - (start - first)))
        return [f"{self.line:>5} | {shown}", f"      | {' ' * (start - first)}{'^' * width}"]


class CaseError(Exception):
    """A case that cannot be run; `problems` has all that is wrong with it, by line."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(
            sorted(problems, key=lambda p: (p.line or sys.maxsize, p.column or 0))
        )
        super().__init__(self.problems)

    def __str__(self) -> str:
        """One block per problem."""
        return "\n".join(str(problem) for problem in self.problems)


def _printable(text: str) -> str:
    """Text that a terminal can show as it is: control characters and the like escaped, and cut."""
    cut = text if len(text) <= _LONGEST_MESSAGE else f"{text[:_LONGEST_MESSAGE]}..."
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in cut
    )


def key_of(path: Path) -> str:
    """Path as people write it: body[0].shape.radius."""
    key = ""
    for part in path:
        key += f"[{part}]" if isinstance(part, int) else f".{part}" if key else part
    return key


def path_of(key: str) -> Path:
    """Path of a key, body[0].mass or body.0.mass."""
    parts = re.findall(r"[^.\[\]]+", key)
    return tuple(int(part) if part.isdecimal() and part.isascii() else part for part in parts)


def shown(value: Any) -> str:
    """Value for a message, shortened."""
    if isinstance(value, list) and len(value) > _LONGEST_VALUE:
        value = value[:_LONGEST_VALUE]
    try:
        text = repr(value).replace("\n", " ")
    except (ValueError, RecursionError):  # an integer of more than 4300 digits
        text = "..."
    return text if len(text) <= _LONGEST_VALUE else text[: _LONGEST_VALUE - 3] + "..."


def nearest(word: str, known: Sequence[str], label: str = "known") -> str:
    """Hint with the known word that is meant, in double quotes, and all that are known."""
    if not known:
        return ""
    close = difflib.get_close_matches(word[:100], known[:_MOST_COMPARED], n=1, cutoff=0.5)
    guess = f'did you mean "{close[0]}"? ' if close else ""
    rest = f", ... ({len(known)} in all)" if len(known) > _MOST_LISTED else ""
    return f"{guess}{label}: {', '.join(known[:_MOST_LISTED])}{rest}"
