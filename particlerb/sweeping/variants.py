"""Which variants a sweep has, and their cases: all are checked before the first one runs."""

import contextlib
import hashlib
import json
from collections.abc import Sequence
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.changes import likeness, wrong_among
from particlerb.case.overrides import with_values
from particlerb.case.problems import CaseError, Path, Problem, key_of, path_of, problem_at, refuse
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.case.sweep import SweepTable
from particlerb.compiled.helper import no_collection
from particlerb.compiled.jit import source_hash
from particlerb.sweeping.designs import rows_of

_MAX_PROBLEMS = 20
_encoded = json.JSONEncoder(default=np.ndarray.tolist).encode


def _encoded_row(row: Sequence[Any]) -> str:
    """JSON of values of axes; numbers, of which there are many, without the encoder."""
    if all(type(value) is float and isfinite(value) for value in row):
        return f"[{', '.join(map(repr, row))}]"
    return _encoded(row)


class Variant(NamedTuple):
    """One run of a sweep."""

    number: int
    values: tuple[Any, ...]  # of the axes
    hash: str  # of all that decides its row
    like: tuple[object, ...]  # equal to that of others which differ in numbers alone


@no_collection()
def variants(case: Case, sweep: SweepTable) -> list[Variant]:
    """All variants of a case.

    Of variants that differ in numbers alone the first is judged as a whole, of the others what
    changes.

    Raises
    ------
    CaseError
        If a key leads nowhere, or a variant is not a case: all that is wrong.
    """
    paths, rows = list(map(path_of, sweep.axes)), list(rows_of(sweep))
    alike: dict[Any, list[int]] = {}
    for number, row in enumerate(rows):
        alike.setdefault(likeness(paths, row), []).append(number)
    all_variants: list[Variant] = []
    problems: dict[tuple[str, str], Problem] = {}
    for like, numbers in alike.items():
        start, suspects = None, set(numbers)
        for number in numbers:
            if number in suspects:
                try:
                    variant = built(case, paths, rows[number])
                except CaseError as error:
                    _tell(error, sweep, rows[number], problems)
                    if len(problems) >= _MAX_PROBLEMS:
                        raise CaseError(problems.values()) from None
                    continue
                if start is None:
                    start = _hash_start(variant, sweep, paths)
                    others = [rows[k] for k in numbers[1:]]
                    suspects = {numbers[1 + k] for k in wrong_among(variant, paths, others)}
            assert start is not None
            hashed = start.copy()
            hashed.update(_encoded_row(rows[number]).encode())
            all_variants.append(Variant(number, rows[number], hashed.hexdigest()[:16], like))
    refuse(problems.values())
    return sorted(all_variants, key=lambda one: one.number)


def built(case: Case, paths: Sequence[Path], row: Sequence[Any]) -> Case:
    """A variant as a case.

    Raises
    ------
    CaseError
        If it is none.
    """
    raw: Any = {key: value for key, value in case.source.raw.items() if key != "sweep"}
    try:
        raw = with_values(raw, paths, row)
    except LookupError as error:
        raise CaseError([problem_at(case, "sweep.axes", str(error.args[0]))]) from None
    return build(case.source._replace(raw=raw, text=""), ())


def _tell(
    error: CaseError,
    sweep: SweepTable,
    row: Sequence[Any],
    problems: dict[tuple[str, str], Problem],
) -> None:
    """Add what is wrong with a variant to what is known, with its values."""
    values = ", ".join(f"{key} = {value!r}" for key, value in zip(sweep.axes, row, strict=True))
    for problem in error.problems:
        named = problem._replace(reason=f"{problem.reason} (with {values})")
        problems.setdefault((problem.key, problem.reason), named)


def _hash_start(case: Case, sweep: SweepTable, paths: Sequence[Path]) -> Any:
    """Hash of a resolved case but for the keys of axes, of its files, what is asked, the sources.

    With the values of the axes it is that of a variant.
    """
    exclude: Any = {"title": True, "sweep": True, "run": {"threads"}, "output": {"log"}}
    dump = case.model_dump(mode="json", exclude=exclude)
    for path in paths:
        _forget(dump, path)
    contents = case.source.files.contents.items()
    files = {name: hashlib.sha256(data).hexdigest() for name, data in contents}
    asked: list[Any] = [value.model_dump(mode="json") for value in sweep.value]
    asked += [] if sweep.valid_within is None else [sweep.valid_within]
    text = json.dumps([dump, list(sweep.axes), files, asked, source_hash()], sort_keys=True)
    return hashlib.sha256(text.encode())


def _forget(data: Any, path: Path) -> None:
    """Leave out what stands at a path, if it has the form there that was given."""
    *parts, last = path
    with contextlib.suppress(LookupError, TypeError):
        for key in parts:
            data = data[key]
        data[last] = None


def label(sweep_key: str) -> str:
    """Name of the column of an axis."""
    return key_of(path_of(sweep_key))
