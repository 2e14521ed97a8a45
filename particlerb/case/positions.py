"""Where each key and value of a TOML text stands; `tomllib` keeps no positions.

The text has been read by tomllib before, hence is valid: this scanner only keeps track of tables,
arrays and nesting, and never judges.
"""

import re
import tomllib
from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

from particlerb.case.problems import Path

_TOKEN = re.compile(
    r"""(?P<skip>[ \t\r]+|\#[^\n]*)
      | (?P<newline>\n)
      | (?P<string>\"{3}(?:\\.|[^\\])*?\"{3}(?!\") | '{3}.*?'{3}(?!')
                 | \"(?:\\.|[^\"\\\n])*\" | '[^'\n]*')
      | (?P<mark>[\[\]{}=,.])
      | (?P<bare>[^\s\[\]{}=,.\#"']+|.)""",
    re.VERBOSE | re.DOTALL,
)
_AFTER_VALUE = {",", "]", "}"}
_BRACKETS = {"[": "]", "{": "}"}


class _Token(NamedTuple):
    """Piece of the text, from `start` to `end`."""

    kind: str
    text: str
    start: int
    end: int


_Range: TypeAlias = tuple[int, int]


class Extent(NamedTuple):
    """Where an entry stands: start and end of its key, start and end of its value."""

    key: _Range
    value: _Range


class _Scanner:
    """Walks through the tokens once and fills `extents`."""

    def __init__(self, text: str) -> None:
        self.extents: dict[Path, Extent] = {}
        self.lengths: dict[Path, int] = {}
        self.tokens = [*tokens(text), _Token("end", "", len(text), len(text))]
        self.at = 0

    def scan(self) -> dict[Path, Extent]:
        """Positions of all entries of the text."""
        table: Path = ()
        while (token := self.peek()).kind != "end":
            if token.kind == "newline":
                self.at += 1
            elif token.text == "[":
                table = self.header()
            else:
                self.entry(table)
        return self.extents

    def peek(self) -> _Token:
        """Next token."""
        return self.tokens[self.at]

    def take(self) -> _Token:
        """Next token, consumed; the end is never passed."""
        token = self.tokens[self.at]
        self.at = min(self.at + 1, len(self.tokens) - 1)
        return token

    def header(self) -> Path:
        """`[table]` or `[[array of tables]]`; returns the path of the table."""
        start = self.take().start
        is_array = self.peek().text == "["
        if is_array:
            self.take()
        parts = self.key("]")
        end = self.take().end
        if is_array:
            end = self.take().end
        extent = (start, end)
        table = self.resolve(parts[:-1], extent)
        if not is_array:
            return self.resolve(parts, extent)
        array = (*table, parts[-1])
        index = self.lengths.get(array, 0)
        self.lengths[array] = index + 1
        self.note(array, extent, extent)
        self.note((*array, index), extent, extent)
        return (*array, index)

    def resolve(self, parts: Path, extent: _Range) -> Path:
        """Path of a dotted name, with the index of the latest table where it is an array."""
        path: Path = ()
        for part in parts:
            path = (*path, part)
            self.note(path, extent, extent)
            if isinstance(part, str) and path in self.lengths:
                path = (*path, self.lengths[path] - 1)
        return path

    def key(self, stop: str) -> Path:
        """Dotted key up to, and not with, the mark `stop`."""
        parts: list[str] = []
        while self.peek().kind != "end" and self.peek().text != stop:
            token = self.take()
            if token.kind == "string":
                parts += tomllib.loads(f"{token.text} = 0")
            elif token.kind == "bare":
                parts.append(token.text)
        return tuple(parts)

    def entry(self, table: Path) -> None:
        """`key = value` within a table."""
        start = self.peek().start
        parts = self.key("=")
        end = self.tokens[self.at - 1].end
        self.take()
        for i in range(1, len(parts)):
            self.note((*table, *parts[:i]), (start, end), (start, end))
        path = (*table, *parts)
        self.note(path, (start, end), self.value(path))

    def value(self, path: Path) -> _Range:
        """Extent of a value; those inside it are noted on the way."""
        token = self.peek()
        if token.text in _BRACKETS:
            return self.container(path)
        end = token.end
        while self.peek().kind not in {"end", "newline"} and self.peek().text not in _AFTER_VALUE:
            end = self.take().end
        return token.start, end

    def container(self, path: Path) -> _Range:
        """`[a, b, ...]`, each entry noted with its index, or `{ key = value, ... }`."""
        opening, index = self.take(), 0
        while (token := self.peek()).text != _BRACKETS[opening.text] and token.kind != "end":
            if token.text == "," or token.kind == "newline":
                self.take()
            elif opening.text == "{":
                self.entry(path)
            else:
                extent = self.value((*path, index))
                self.note((*path, index), extent, extent)
                index += 1
        return opening.start, self.take().end

    def note(self, path: Path, key: _Range, value: _Range) -> None:
        """Keep the first position of a path."""
        self.extents.setdefault(path, Extent(key, value))


def tokens(text: str) -> Iterator[_Token]:
    """Tokens of the text without blanks and comments."""
    for match in _TOKEN.finditer(text):
        if match.lastgroup != "skip":
            yield _Token(match.lastgroup or "", match.group(), match.start(), match.end())


def extents(text: str) -> dict[Path, Extent]:
    """Positions of all keys and values of a valid TOML text, as offsets into it.

    Parameters
    ----------
    text : str
        What tomllib has read without an error.

    Returns
    -------
    dict
        Path -> Extent. A `[table]` has its header as key and value, and so has an implicit one.
    """
    try:
        return _Scanner(text).scan()
    except (RecursionError, IndexError, ValueError):  # nested too deeply: messages without lines
        return {}
