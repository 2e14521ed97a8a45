"""The table [sweep]: variants of a case, and what is asked of each."""

from itertools import pairwise
from math import isfinite
from typing import Annotated, Any, Literal, Self

from pydantic import Field, Strict, model_validator

from particlerb.case.output import SweepValue
from particlerb.case.problems import path_of
from particlerb.case.values import Count, Forms, Name, Positive, Real, Table, Yes, broken

_RANDOM_DESIGNS = ("latin", "random")
SEED = "run.seed"


class Spread(Table):
    """Numbers between two: evenly on a grid, anywhere between them where runs are drawn."""

    low: Real
    """Least value. [unit of the key]"""
    high: Real
    """Largest value. [unit of the key]"""
    n: Count | None = None
    """How many, for grid and zip. [-]"""
    log: Yes = False
    """Whether ratios are even, not differences. [-]"""

    @model_validator(mode="after")
    def ascends(self) -> Self:
        """Require low < high, above 0 for ratios."""
        if self.low >= self.high:
            raise broken(f"must be below high = {self.high!r}", "low")
        if self.log and self.low <= 0.0:
            raise broken("must be above 0 where log is true", "low")
        if not isfinite(self.high / self.low if self.log else self.high - self.low):
            what = "ratio" if self.log else "difference"
            raise broken(f"its {what} to high = {self.high!r} is too large for float64", "low")
        return self

    def at(self, share: float) -> float:
        """Value at a share of the distance from low to high."""
        if share == 1.0:  # which may round beside it
            return self.high
        if self.log:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


_List = Annotated[tuple[Any, ...], Field(min_length=1)]
_Axis = Annotated[_List | Spread, Forms("list", "table")]


class SweepTable(Table):
    """Variants of the case."""

    axes: dict[Name, _Axis] = Field({})
    """Values of keys: "run.dt" = [..], or { low, high, n }. [-]"""
    file: Name | None = None
    """In place of axes: CSV file, columns are keys, a row for each run. [-]"""
    design: Literal["grid", "zip", "latin", "random"] = "grid"
    """All combinations, values side by side, or drawn runs. [-]"""
    runs: Count | None = None
    """Of latin and random. [-]"""
    seed: Annotated[int, Strict(), Field(ge=0, le=2**63 - 1)] = 0
    """Of what is drawn. [-]"""
    replicates: Count = 1
    """Of each run, with seeds from run.seed on. [-]"""
    value: tuple[SweepValue, ...] = ()
    """Columns, [[sweep.value]]. [-]"""
    valid_within: Positive | None = None
    """Share of a value's largest change: adds until when it outlasts rounding, valid_until. [-]"""

    @model_validator(mode="after")
    def says_what_changes(self) -> Self:
        """Require axes, a file or replicates, and axes of which none holds another."""
        if self.file is not None and self.axes:
            raise broken("says which runs there are: leave the axes out", "file")
        if not self.axes and self.design != "grid":
            raise broken(f"a {self.design} design is one of axes", "design")
        if not self.axes and self.file is None and self.replicates == 1:
            raise broken("missing: what changes", "axes", "give axes, a file or replicates")
        if self.valid_within is not None and not self.value:
            raise broken("missing: whose validity is asked for", "value", "give [[sweep.value]]")
        keys = [*self.axes, *((SEED,) if self.replicates > 1 else ())]
        paths = sorted((tuple(map(str, path_of(key))), key) for key in keys)
        for (path, key), (other, inner) in pairwise(paths):
            if other[: len(path)] == path:
                hint = "give each key one axis"
                raise broken(f'"{inner}" is a part of "{key}": both are axes', "axes", hint)
        return self

    @model_validator(mode="after")
    def says_how_many(self) -> Self:
        """Require a number of runs where they are drawn, else of values on each axis."""
        is_drawn = self.design in _RANDOM_DESIGNS
        if is_drawn and self.runs is None:
            raise broken(f"missing: how many a {self.design} design has", "runs")
        if not is_drawn and self.runs is not None:
            raise broken(f"a {self.design} has as many as its axes say", "runs", "leave it out")
        for key, axis in self.axes.items():
            if isinstance(axis, Spread) and is_drawn == (axis.n is not None):
                hint = "leave n out" if is_drawn else "give n"
                raise broken(f"{key}: a {self.design} design needs another form", "axes", hint)
        sizes = {key: _size(axis) for key, axis in self.axes.items()}
        if self.design == "zip" and len(set(sizes.values())) > 1:
            raise broken(f"must have as many values each, have {sizes}", "axes")
        return self


def _size(axis: tuple[Any, ...] | Spread) -> int:
    """Number of values of an axis."""
    return (axis.n or 0) if isinstance(axis, Spread) else len(axis)
