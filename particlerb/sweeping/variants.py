"""Which variants a sweep has, and their cases: all are checked before the first one runs."""

import hashlib
import itertools
import json
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from particlerb.case.overrides import with_value
from particlerb.case.problems import CaseError, Problem, key_of, path_of
from particlerb.case.reader import build
from particlerb.case.schema import Case
from particlerb.case.source import problem_at
from particlerb.case.sweep import Spread, SweepTable
from particlerb.compiled.jit import source_hash

_MOST_PROBLEMS = 20


class Variant(NamedTuple):
    """One run of a sweep."""

    number: int
    values: tuple[Any, ...]  # of the axes
    case: Case
    hash: str  # of all that decides its row


def variants(case: Case, sweep: SweepTable) -> list[Variant]:
    """All variants of a case.

    Raises
    ------
    CaseError
        If a key leads nowhere, or a variant is not a case: all that is wrong.
    """
    found: list[Variant] = []
    problems: dict[tuple[str, str], Problem] = {}
    raw = {key: value for key, value in case.source.raw.items() if key != "sweep"}
    for number, row in enumerate(_rows(sweep)):
        changed: Any = raw
        try:
            for key, value in zip(sweep.axes, row, strict=True):
                changed = with_value(changed, path_of(key), value)
            one = build(case.source._replace(raw=changed, text=""), ())
        except LookupError as error:
            raise CaseError([problem_at(case, "sweep.axes", str(error.args[0]))]) from None
        except CaseError as error:
            values = ", ".join(f"{k} = {v!r}" for k, v in zip(sweep.axes, row, strict=True))
            for one_problem in error.problems:
                named = one_problem._replace(reason=f"{one_problem.reason} (with {values})")
                problems.setdefault((one_problem.key, one_problem.reason), named)
            if len(problems) >= _MOST_PROBLEMS:
                break
            continue
        found.append(Variant(number, row, one, _hash_of(one, sweep)))
    if problems:
        raise CaseError(problems.values())
    return found


def _rows(sweep: SweepTable) -> Iterator[tuple[Any, ...]]:
    """Values of the axes, a row for each run."""
    axes, n = list(sweep.axes.values()), sweep.runs or 0
    if sweep.design == "grid":
        yield from itertools.product(*map(_listed, axes))
    elif sweep.design == "zip":
        yield from zip(*map(_listed, axes), strict=True)
    else:
        yield from zip(*(_drawn(sweep, k, axis, n) for k, axis in enumerate(axes)), strict=True)


def _listed(axis: tuple[Any, ...] | Spread) -> tuple[Any, ...]:
    """Values of an axis in their order."""
    if not isinstance(axis, Spread):
        return axis
    n = axis.n or 1
    return tuple(axis.at(k / max(n - 1, 1)) for k in range(n))


def _drawn(sweep: SweepTable, k: int, axis: tuple[Any, ...] | Spread, n: int) -> list[Any]:
    """Values of axis k for n runs: in a Latin hypercube each n-th of it has one of them."""
    stream = np.random.default_rng([sweep.seed, k])
    shares = stream.uniform(size=n)
    if sweep.design == "latin":
        shares = (stream.permutation(n) + shares) / n
    if isinstance(axis, Spread):
        return [axis.at(share) for share in shares.tolist()]
    return [axis[int(share * len(axis))] for share in shares.tolist()]


def _hash_of(case: Case, sweep: SweepTable) -> str:
    """Hash of a resolved case, the files it names, what is asked, and the sources."""
    own = case.model_dump(mode="json", exclude={"title": True, "sweep": True, "run": {"threads"}})
    files = {
        name: hashlib.sha256(data).hexdigest() for name, data in case.source.files.contents.items()
    }
    asked = [value.model_dump(mode="json") for value in sweep.value]
    text = json.dumps([own, files, asked, source_hash()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def label(sweep_key: str) -> str:
    """Name of the column of an axis."""
    return key_of(path_of(sweep_key))
