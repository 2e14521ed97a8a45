"""Polynomials of angles, exponentials and logarithms against mpmath."""

import math

import mpmath
import numpy as np
import pytest

from particlerb.maths import trig

HALF_ULP = 2.0**-53


def sweep(lo, hi, n=400):
    return [float(x) for x in np.random.default_rng(5).uniform(lo, hi, n)]


@pytest.mark.parametrize("limit", [2.0, 100.0, 2.0**24])
def test_cosine_and_sine_lose_no_more_than_their_rounding(limit):
    for x in sweep(-limit, limit):
        cos, sin, sign = trig.cos_sin_half_turns(x)
        assert abs(float(mpmath.cos(x)) - sign * cos) <= 4 * HALF_ULP
        assert abs(float(mpmath.sin(x)) - sign * sin) <= 4 * HALF_ULP


def test_far_phases_err_like_the_rounding_of_the_phase():
    for x in sweep(1e9, 1e12):
        cos, sin, sign = trig.cos_sin_half_turns(x)
        error = math.hypot(float(mpmath.cos(x)) - sign * cos, float(mpmath.sin(x)) - sign * sin)
        assert error <= x * HALF_ULP


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("x", [1e17, -1e200, math.inf, -math.inf, math.nan])
def test_phases_without_an_angle_still_give_a_unit_vector(x):
    cos, sin, sign = trig.cos_sin_half_turns(x)
    assert cos * cos + sin * sin == pytest.approx(1, abs=1e-15)
    assert abs(sign) == 1


def test_angle_of_every_direction():
    for angle in [*sweep(-math.pi, math.pi), 0.0, math.pi, -math.pi / 2, math.pi / 2]:
        found = trig.angle_of(math.cos(angle), math.sin(angle))
        assert found == pytest.approx(angle, abs=1e-15)
    for angle in sweep(0, 1e-6, 50):
        assert trig.angle_of(1.0, angle) == pytest.approx(math.atan(angle), rel=3e-16)


def test_decay_is_exp():
    for x in [*sweep(-650, 0), *sweep(-1, 0), 0.0]:
        assert trig.decay(x) == pytest.approx(float(mpmath.exp(x)), rel=3 * HALF_ULP)
    assert 0 < trig.decay(-1e300) < 1e-300


def test_logarithm_is_log():
    for x in [*(10.0**y for y in sweep(-300, 300)), *sweep(0.5, 2), 1.0]:
        assert trig.logarithm(x) == pytest.approx(float(mpmath.log(x)), rel=5 * HALF_ULP)
