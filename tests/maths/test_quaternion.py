"""Algebra of rotations."""

import math

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from particlerb.maths.quaternion import conjugate, multiply, to_body, to_world

part = st.floats(-1, 1)
vectors = st.tuples(*[st.floats(-10, 10)] * 3)


@st.composite
def units(draw):
    q = np.array(draw(st.tuples(*[part] * 4)))
    assume(np.linalg.norm(q) > 0.1)
    return tuple(float(x) for x in q / np.linalg.norm(q))


@given(units(), vectors)
@settings(deadline=None)
def test_to_world_agrees_with_scipy_and_keeps_length(q, v):
    world = to_world(q, v)
    np.testing.assert_allclose(world, Rotation.from_quat(q, scalar_first=True).apply(v), atol=2e-14)
    assert math.isclose(math.hypot(*world), math.hypot(*v), rel_tol=1e-14, abs_tol=1e-14)


@given(units(), vectors)
@settings(deadline=None)
def test_to_body_is_the_inverse(q, v):
    np.testing.assert_allclose(to_body(q, to_world(q, v)), v, atol=2e-14)


@given(units(), units(), vectors)
@settings(deadline=None)
def test_product_turns_by_the_right_factor_first(a, b, v):
    one_by_one = to_world(a, to_world(b, v))
    np.testing.assert_allclose(to_world(multiply(a, b), v), one_by_one, atol=4e-14)


@given(units())
@settings(deadline=None)
def test_conjugate_undoes_the_rotation(q):
    np.testing.assert_allclose(multiply(q, conjugate(q)), (1, 0, 0, 0), atol=1e-15)
