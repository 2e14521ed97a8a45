"""Fields of tuples that are None: what asks for them is left out, as for arguments."""

from typing import NamedTuple

import numpy as np
import pytest

from particlerb.compiled.jit import inline, kernel, splice

pytestmark = pytest.mark.compiled


class Inner(NamedTuple):
    """Something that may not act."""

    rows: np.ndarray | None
    size: int


class Outer(NamedTuple):
    """What has it, or not."""

    inner: Inner | None
    size: int


@inline
def first_row(outer):
    """In a helper."""
    if outer.inner.rows is None:
        return 1.0
    return outer.inner.rows[0]


@splice
def second_row(outer):
    """In what is copied into its callers."""
    return outer.inner.rows[1] if outer.inner.rows is not None else 2.0


@kernel
def summed(outer, least):
    """By a chain of fields, by names for them, by their numbers, and among other conditions."""
    inner, size = outer
    if outer[0] is None:
        return -1.0
    rows = inner.rows
    total = first_row(outer) + second_row(outer)
    has_rows = rows is not None
    if has_rows and size > least:
        total += rows[2]
    return total


@pytest.mark.parametrize(
    ("inner", "expected"), [(Inner(np.arange(3.0), 1), 3.0), (Inner(None, 1), 3.0), (None, -1.0)]
)
def test_what_asks_for_a_field_that_is_none_is_left_out(inner, expected):
    assert summed(Outer(inner, 5), 4) == expected
