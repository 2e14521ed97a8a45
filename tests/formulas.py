"""Small formulas that several files of tests judge by."""

import numpy as np


def derivative(f, h=1e-3):
    """f'(0) by a difference of order 6: errors of h⁶ f⁽⁷⁾ / 140 and 1e-16 f / h."""
    weights = np.array([-1, 9, -45, 45, -9, 1]) / 60
    return sum(c * f(k * h) for c, k in zip(weights, (-3, -2, -1, 1, 2, 3), strict=True)) / h


def product(a, b):
    """Product of two quaternions, scalar first."""
    vector = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *vector])


def unit_quaternion(seed):
    """A quaternion in a random direction."""
    q = np.random.default_rng(seed).standard_normal(4)
    return q / np.linalg.norm(q)
