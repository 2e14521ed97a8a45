"""Double-double arithmetic against exact fractions."""

from fractions import Fraction

from hypothesis import given, settings
from hypothesis import strategies as st

from particlerb.maths import double_double as dd

numbers = st.floats(-1e30, 1e30).filter(lambda x: x == 0 or abs(x) > 1e-30)
components = st.floats(-1, 1).filter(lambda x: x == 0 or abs(x) > 1e-9)


def exact(x):
    return Fraction(x[0]) + Fraction(x[1])


@given(numbers, numbers)
@settings(deadline=None)
def test_sum_and_product_of_doubles_are_exact(a, b):
    assert exact(dd.two_sum(a, b)) == Fraction(a) + Fraction(b)
    assert exact(dd.two_product(a, b)) == Fraction(a) * Fraction(b)


@given(numbers, numbers, numbers, numbers)
@settings(deadline=None)
def test_sum_and_product_have_a_hundred_bits(a, b, c, d):
    x, y = dd.two_sum(a, b * 2.0**-60), dd.two_sum(c, d * 2.0**-60)
    for operation, result in ((dd.multiply, exact(x) * exact(y)), (dd.add, exact(x) + exact(y))):
        assert abs(exact(operation(x, y)) - result) <= abs(result) * Fraction(1, 2**100)


@given(numbers, numbers)
@settings(deadline=None)
def test_reciprocal_has_ninety_eight_bits(a, b):
    x = dd.two_sum(a if a else 1.0, b * 2.0**-80)
    if x[0]:
        assert abs(exact(dd.reciprocal(x)) * exact(x) - 1) < Fraction(1, 2**98)


@given(st.tuples(*[components] * 4), st.tuples(*[components] * 3))
@settings(deadline=None)
def test_to_body_turns_by_the_normalised_quaternion(q, v):
    w, x, y, z = (Fraction(c) for c in q)
    norm = w * w + x * x + y * y + z * z
    if norm < Fraction(1, 10**6):
        return
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z),
    )
    for row, found in zip(rows, dd.to_body(q, v), strict=True):
        wanted = sum(r * Fraction(c) for r, c in zip(row, v, strict=True)) / norm
        assert abs(exact(found) - wanted) < Fraction(40, 2**104)
