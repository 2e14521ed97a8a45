"""Numbers of several lanes as Numba knows them."""

import operator

import numpy as np
import pytest

from particlerb.compiled import lanes

pytestmark = pytest.mark.once


def test_functions_of_old_numpy_may_be_those_of_packs():
    """Numba asks what it is to know for its module; ufuncs have one since NumPy 2.1 only."""
    nameless = np.frompyfunc(operator.neg, 1, 1)
    lanes._operator(nameless, lanes.PACK, lanes.PACK, 1, lanes.ir.IRBuilder.fneg)
