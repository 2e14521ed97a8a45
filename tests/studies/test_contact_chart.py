"""Which parts of a scene the picture of force chains shows."""

import numpy as np

from particlerb.studies.charts.contacts import _apart


def test_what_is_empty_between_heaps_is_left_out():
    low = np.array([0.0, 5.0, 0.5, 5.2])
    (first, gap), (after, last) = _apart(low, low + 1.0)
    assert first < 0.0 < 1.5 < gap < after < 5.0
    assert last > 6.2
    assert len(_apart(np.array([0.0, 1.1, 2.2]), np.array([1.0, 2.1, 3.2]))) == 1
    many = np.arange(5.0)
    assert len(_apart(many, many + 0.1)) == 1
