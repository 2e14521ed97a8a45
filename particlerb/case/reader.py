"""From a file, a text or a dict to a `Case`: overrides, schema, rules, all problems at once.

`load` is the way in. A case can neither run code nor bring the program down: whatever the input,
the outcome is a `Case` or a `CaseError`.
"""

import re
import tomllib
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path as FilePath
from typing import Any, TypeAlias

from pydantic import ValidationError

from particlerb.case.case_names import case_path, nearest_names
from particlerb.case.messages import Message, decides_on_others, messages_of, without_typos
from particlerb.case.overrides import overridden
from particlerb.case.problems import (
    CaseError,
    Locator,
    Problem,
    Source,
    file_problem,
    key_of,
    nearest,
)
from particlerb.case.rules import findings
from particlerb.case.schema import Case
from particlerb.case.values import plain
from particlerb.files import Files, is_file

__all__ = ["CaseError", "Problem", "load", "parse"]

CaseSource: TypeAlias = str | PathLike[str] | Mapping[str, Any] | Case
"""What `load` makes a case of."""
_MAX_FILE_BYTES = 64 * 2**20
_MAX_PROBLEMS_LISTED = 100
_PLAIN_WORDS = {
    "Invalid value": "this is not a TOML value: text needs quotes, numbers none",
    "Expected '=' after a key": "a key needs a `=` and a value",
    "Expected newline or end": "more on this line than one `key = value`: a unit, a comma?",
    "Expected ']": "a header is not closed: `]` or `]]` is missing",
    "Expected": "a text is not closed: its quotes are missing",
    "Found invalid character": "this character is not allowed here",
    **dict.fromkeys(("Unescaped", "Invalid hex"), "a backslash is written twice; paths may have /"),
    "Unclosed array": "a list is not closed: `]` is missing",
    "Unclosed inline table": "a table is not closed: `}` is missing",
    "Cannot overwrite": "this key has been given before",
    "Duplicate inline table key": "this key has been given before",
    "Cannot declare": "this table has been opened before",
    "Cannot mutate immutable": "this table has been given before as a whole",
    "Unterminated string": "a text is not closed: its quotes are missing",
    "Invalid date": "there is no such date or time",
    "Illegal character": "this character is not allowed here",
    "Invalid initial character for a key": "a key must begin with a letter, a digit, - or _",
    "Invalid statement": "this is neither `key = value` nor a [table]",
}


def load(source: CaseSource, overrides: Sequence[str] = (), allow_code: bool = False) -> Case:
    """Case from a file, from a dict with the same keys, or from another case.

    Parameters
    ----------
    source : str, path, Mapping or Case
        A path of a TOML file, or as text the name of a case in ./cases or among the examples; a
        dict may hold arrays, one row per body, for initial values.
    overrides : sequence of str
        `"run.dt=1e-4"`, `"body.0.mass=2"`: set before the case is checked. The value is read as
        TOML, else taken as text.
    allow_code : bool
        Whether Python code that it names may be run, later, with the rights of this program.

    Returns
    -------
    Case
        Checked and frozen.

    Raises
    ------
    CaseError
        With all problems of the case, each with file, line, key and value where there are any.
    TypeError
        If the source, or an override, is none of these.
    """
    if not isinstance(overrides, (list, tuple)) or not all(isinstance(o, str) for o in overrides):
        raise TypeError(f'overrides must be a list of texts like "run.dt=1e-4", got {overrides!r}')
    case = _loaded(source, overrides)
    if allow_code:
        case = case.model_copy()
        case._source = case.source._replace(files=case.source.files.copied(True))
    return case


def _loaded(source: CaseSource, overrides: Sequence[str]) -> Case:
    """Do the work of `load`."""
    if isinstance(source, Case):
        origin = source.source
        return build(origin, overrides) if overrides else source
    if isinstance(source, Mapping):
        try:
            raw = plain(source)
        except RecursionError:
            raise CaseError([file_problem(None, "is nested too deeply")]) from None
        files = getattr(source, "files", None) or Files(FilePath())  # those of a scene
        return build(Source(raw=raw, files=files.copied(files.allows_code)), overrides)
    if not isinstance(source, (str, PathLike)):
        kinds = "a path, the name of an example, a mapping or a Case"
        raise TypeError(f"a case must be {kinds}, got {type(source).__name__}")
    if isinstance(source, str) and "\n" in source:
        reason = "is given as a text, not as the path of a file"
        raise CaseError([file_problem(None, reason, "give tomllib.loads(text)")])
    path = case_path(source) if isinstance(source, str) else FilePath(source)
    if path is None:
        wrong = file_problem(FilePath(source), "there is no such file or case")
        raise CaseError([wrong._replace(hint=nearest_names(str(source)))])
    return parse(read_text(path), path, overrides)


def parse(text: str, path: FilePath | None = None, overrides: Sequence[str] = ()) -> Case:
    """Case from a TOML text; `path` is named in messages and is where its files lie.

    Raises
    ------
    CaseError
        As in `load`.
    """
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise CaseError([_syntax_problem(text, path, str(error))]) from None
    except RecursionError:
        raise CaseError([file_problem(path, "is nested too deeply")]) from None
    except ValueError as error:  # a number of thousands of digits, an impossible date
        raise CaseError([file_problem(path, f"has a value out of range: {error}")]) from None
    if not text.strip():
        raise CaseError([file_problem(path, "is empty", "a case needs [run] and [[body]]")])
    files = Files(path.parent if path else FilePath())
    return build(Source(text, path, raw, files=files), overrides)


def read_text(path: FilePath) -> str:
    """Text of a file, UTF-8 with or without a byte order mark."""
    try:
        if path.is_dir():
            raise CaseError([file_problem(path, "is a folder, not a case file")])
        if not path.is_file():
            raise CaseError([_missing_file(path)])
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise CaseError([file_problem(path, "is larger than 64 MiB", "put particles in CSV")])
        raw = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise CaseError([file_problem(path, f"cannot be read: {reason}")]) from None
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        column = error.start - raw.rfind(b"\n", 0, error.start)
        reason = f"byte 0x{raw[error.start]:02x} is not UTF-8"
        problem = file_problem(path, reason, "save the file as UTF-8")
        raise CaseError([problem._replace(line=line, column=column)]) from None


def _missing_file(path: FilePath) -> Problem:
    """A file that is not there, with the nearest name that is."""
    if path.exists():
        return file_problem(path, "is not a regular file")
    if not path.parent.is_dir():
        return file_problem(path, "there is no such folder")
    example = case_path(path.stem)
    if path.parent == FilePath() and example is not None and is_file(example):
        return file_problem(path, "there is no such file", f"the example is called {path.stem}")
    files = sorted(entry.name for entry in path.parent.glob("*.toml"))
    return file_problem(path, "there is no such file", nearest(path.name, files))


def _syntax_problem(text: str, path: FilePath | None, message: str) -> Problem:
    """Broken TOML, with tomllib's position and plain words."""
    lines = text.replace("\r\n", "\n").split("\n")
    match = re.search(r"\(at line (\d+), column (\d+)\)", message)
    line, column = (int(match[1]), int(match[2])) if match else (len(lines), len(lines[-1]) + 1)
    words = re.sub(r" \(at .*\)$", "", message, flags=re.DOTALL)
    plain_words = next((v for k, v in _PLAIN_WORDS.items() if words.startswith(k)), None)
    problem = file_problem(path, f"broken TOML: {plain_words or words}")
    return problem._replace(line=line, column=column, source=lines[line - 1])


def build(source: Source, overrides: Sequence[str]) -> Case:
    """Check the data of a case and make it a `Case`."""
    source = overridden(source, overrides)
    raw = dict(source.raw)
    try:
        messages = [Message(*finding) for finding in findings(raw, source.files)]
        try:
            case = Case.model_validate(raw)
        except ValidationError as error:
            errors = messages_of(raw, error.errors(include_url=False))
            messages = errors if any(map(decides_on_others, errors)) else errors + messages
        if messages:
            raise CaseError(_located(source, without_typos(messages)))
    except RecursionError:
        raise CaseError([file_problem(source.path, "is nested too deeply")]) from None
    case._source = source
    return case


def _located(source: Source, messages: Sequence[Message]) -> list[Problem]:
    """Messages with their places in the file, each once, and not more than can be read."""
    distinct = list({(key_of(m.path), m.reason): m for m in messages}.values())
    locator = Locator(source)
    problems = [locator.problem(*m) for m in distinct[:_MAX_PROBLEMS_LISTED]]
    if len(distinct) > _MAX_PROBLEMS_LISTED:
        reason = f"{len(distinct) - _MAX_PROBLEMS_LISTED} more problems are not shown"
        problems.append(file_problem(source.path, reason))
    return problems
