"""Connected components: which of n things belong together, from pairs that are tied."""

import numpy as np

from particlerb.maths.vec3 import Ints


def labels(n: int, first: Ints, second: Ints) -> Ints:
    """Label of each of n things, (n,): the first of all those that pairs tie to it.

    Parameters
    ----------
    n : int
    first, second : ndarray, shape (k,)
        Both ends of each pair.

    References
    ----------
    Shiloach and Vishkin, J. Algorithms 3, 57 (1982): roots are hooked to smaller ones, then each
    thing is made to point to its root; the number of rounds grows with the logarithm of n.
    """
    label = np.arange(n)
    while True:
        a, b = label[first], label[second]
        apart = a != b
        if not apart.any():
            return label
        first, second, a, b = first[apart], second[apart], a[apart], b[apart]
        np.minimum.at(label, np.maximum(a, b), np.minimum(a, b))
        while (label[label] != label).any():
            label = label[label]
