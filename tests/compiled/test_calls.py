"""Arguments are handed on as they are, and variables that are assigned once have no place."""

from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core import codegen

from particlerb.compiled.jit import config, inline, kernel, unfused_kernel

pytestmark = [
    pytest.mark.compiled,
    pytest.mark.skipif(bool(config.DISABLE_JIT), reason="nothing is compiled in plain Python"),
]


class Rows(NamedTuple):
    """Arrays with numbers, something absent, and something empty."""

    first: np.ndarray
    second: np.ndarray
    is_first: bool
    absent: np.ndarray | None
    empty: tuple


class Nested(NamedTuple):
    """A tuple of tuples."""

    rows: Rows
    pair: tuple[Rows, Rows]
    scale: float


def rows(scale: float) -> Rows:
    return Rows(scale * np.arange(6.0), np.arange(12.0).reshape(3, 4), scale > 1.0, None, ())


def nested() -> Nested:
    return Nested(rows(1.0), (rows(2.0), rows(3.0)), 0.5)


@inline
def _of_one(one, nothing, is_on, at=1, empty=()):
    """What a call hands over: tuples, None, truth, a default, and nothing."""
    if one.absent is None and nothing is None and is_on and len(empty) == 0:
        return one.first[at] + one.second[at, 2] * (3.0 if one.is_first else 1.0)
    return -1.0


@kernel
def _of_all(many):
    """Sum over all rows."""
    return (
        _of_one(many.rows, None, True)
        + _of_one(many.pair[0], None, many.pair[0].is_first, 2)
        + _of_one(many.pair[1], many.rows.absent, True, at=2, empty=many.rows.empty)
    )


@inline
def _power(rows, n):
    """Calls itself."""
    if n == 0:
        return 1.0
    return rows.first[2] * _power(rows, n - 1)


@inline
def _in_branches(rows, n):
    """Variables that are assigned once and used behind a branch, in a loop, behind it, or never."""
    factor = rows.first[1]
    pair = (factor, rows.second[0, 1])
    total = 0.0
    for i in range(n):
        part = pair[i % 2] + i
        if i % 3 == 0:
            last = part
            continue
        while part > 2.0:
            part -= factor
        total += part
    if n > 0:
        total += last  # of the last turn that set it
    other = rows if total > 4.0 else Rows(rows.first[1:], rows.second, False, None, ())
    return total + other.first[2]


@kernel
def _computed(many, n):
    """Sum of these."""
    return _power(many.pair[0], n) + _in_branches(many.rows, n)


@pytest.mark.parametrize("made", [kernel, unfused_kernel])
def test_what_is_handed_over_arrives(made):
    function = made(_of_all.py_func)
    kind = (numba.typeof(nested()),)
    function.compile(kind)
    assert function.overloads[kind].entry_point(nested()) == (1 + 6) + (4 + 10 * 3) + (6 + 10 * 3)


@pytest.mark.parametrize("n", [0, 1, 2, 5, 8])
def test_variables_have_the_values_of_python(n):
    by_hand = _in_branches.py_func(nested().rows, n) + 4.0**n
    assert _computed(nested(), n) == by_hand


def test_a_function_of_others_may_call_a_helper():
    """Numba's own functions know nothing of how ours are called."""

    @numba.njit  # noqa: TID251 - a function of others
    def own(many):
        return _of_one(many.pair[0], None, True, 2)

    assert own(nested()) == 4 + 10 * 3


def test_a_call_hands_over_as_many_arguments_as_python(monkeypatch):
    """In the helper itself, and where it is called; their numbers would be 130."""
    written = []
    add = codegen.CPUCodeLibrary.add_ir_module

    def read(library, module):
        written.extend(one for one in module.functions if "whole" in one.name)
        add(library, module)

    monkeypatch.setattr(codegen.CPUCodeLibrary, "add_ir_module", read)

    @inline
    def whole(many, scale):
        if scale > 2.5:
            scale -= 1.0
        return many.pair[0].first[1] * scale

    @kernel
    def of_whole(many):
        return whole(many, 2.0) + whole(many, 3.0)

    of_whole._cache = numba.core.caching.NullCache()
    assert of_whole(nested()) == 8.0
    declared = [one for one in written if "of_whole" not in one.name]
    assert [len(one.args) for one in declared] == [4, 4]  # two for the result and for errors
    assert "alloca {{" not in str(declared[0])  # a place for a tuple of tuples
