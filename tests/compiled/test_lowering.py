"""Owners of arrays: none is freed too early, none is kept, and those of lent ones uncounted."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import typeof, types
from numba.core.runtime import _nrt_python as _nrt
from numba.core.runtime import rtsys
from numba.core.runtime.context import NRTContext

from particlerb.compiled.instructions import rows_of
from particlerb.compiled.jit import compile_with, inline
from particlerb.compiled.lowering import _Lower

pytestmark = pytest.mark.compiled
compiled = compile_with()


class Pair(NamedTuple):
    """Arrays that are handed on together."""

    first: np.ndarray
    second: np.ndarray


@inline
def lent(pair, scale):
    """Names for arrays, a tuple of them, one tuple behind another, views."""
    swapped = Pair(pair.second, pair.first)
    both = (swapped.first,) + (pair.first,)  # noqa: RUF005 - the operation is tried
    row = both[0][1:]
    row = both[1][:-1]
    return scale * row[0]


@inline
def reshaped(pair, scale):
    """Another view of an array of its caller."""
    rows = pair.first.reshape(1, -1)
    return scale * rows[0, 1]


as_row = rows_of(1, 5)


@inline
def in_rows(pair, scale):
    """A view whose shape the compiler knows."""
    rows = as_row(pair.second)
    return scale * rows[0, 4] + rows[0:1].T[3, 0]


@inline
def given_back(pair):
    """An array of its caller."""
    return pair.second


@inline
def chosen(array, at):
    """Elements that indices name: a new array."""
    return array[at].sum()


@inline
def filled(n):
    """An array that is made here."""
    return np.full(n, 2.0)


@compiled
def borrows(pair):
    return lent(pair, 3.0)


@compiled
def reshapes(pair):
    return reshaped(pair, 2.0) + pair.second.reshape(5, 1)[2, 0]


@compiled
def takes_rows(pair):
    return in_rows(pair, 2.0)


@compiled
def passes_back(pair):
    total = 0.0
    for _ in range(10):
        total += given_back(pair)[0]
    return total


@compiled
def makes(pair):
    total = 0.0
    for n in range(2, 11):
        made = Pair(filled(n), pair.first)
        total += lent(made, 1.0) + chosen(made.first, np.array([0, 0])) + (made.first + 1.0)[0]
    return total


@compiled
def walks(pair):
    total = 0.0
    for array in (pair.first, pair.second):
        total += array[0]
    return total


@compiled
def stores(pair):
    """Numba copies an array before it is stored where it may come from."""
    pair.first[1:] = pair.first[:-1]
    return pair.first[-1] + pair.second[0]


@pytest.fixture(autouse=True)
def counted():
    """Let Numba say how much is made and freed."""
    _nrt.memsys_enable_stats()
    yield
    _nrt.memsys_disable_stats()


@pytest.mark.parametrize(
    ("function", "value"),
    [
        (borrows, 3.0),
        (reshapes, 4.0),
        (takes_rows, 6.0),
        (passes_back, 20.0),
        (makes, 9 * (2.0 + 4.0 + 3.0)),
        (walks, 3.0),
        (stores, 3.0),
    ],
)
def test_arrays_live_as_long_as_needed(function, value):
    """As many arrays are freed as made, and those of the caller are as they were."""
    pair = Pair(np.full(5, 1.0), np.full(5, 2.0))
    function(pair)
    before = rtsys.get_allocation_stats()
    for _ in range(100):
        assert function(pair) == value
    after = rtsys.get_allocation_stats()
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
    assert after.alloc - before.alloc == after.free - before.free
    assert pair.first.tolist() == [1.0] * 5
    assert pair.second.tolist() == [2.0] * 5


@pytest.mark.parametrize(
    ("function", "counts"), [(lent, False), (reshaped, False), (in_rows, False), (given_back, True)]
)
def test_what_is_lent_is_not_counted(function, counts, monkeypatch):
    """A function that returns no array and makes none has no code that counts owners."""
    calls = []
    count = NRTContext._call_incref_decref
    monkeypatch.setattr(
        NRTContext, "_call_incref_decref", lambda *args: calls.append(1) or count(*args)
    )
    pair = typeof(Pair(np.ones(5), np.ones(5)))
    scale = (types.float64,) if function is not given_back else ()
    compile_with()(function.py_func).compile((pair, *scale))
    assert bool(calls) == counts


def test_what_the_types_do_not_tell_is_asked_for(monkeypatch):
    """Numba says where it makes an array: the code is written again, with owners counted."""
    monkeypatch.setattr(_Lower, "_can_own", lambda self: False)

    @compiled
    def shifted(array):
        array[1:] = array[:-1]
        return array.sum()

    assert shifted(np.array([1.0, 2.0, 3.0])) == 4.0
