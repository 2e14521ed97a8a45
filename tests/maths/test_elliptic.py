"""Landen's transformation against mpmath's elliptic functions."""

import math

import mpmath
import numpy as np
import pytest

from particlerb.maths import elliptic

MODULI = [1e-150, 1e-20, 1e-8, 1e-3, 0.3, 0.8, 0.95, 0.985]


@pytest.fixture(autouse=True)
def digits():
    with mpmath.workdps(40):
        yield


def chain_of(k):
    kc = mpmath.sqrt(1 - mpmath.mpf(k) ** 2)
    return elliptic.landen(k, float(kc)), mpmath.ellipk(mpmath.mpf(k) ** 2)


@pytest.mark.parametrize("k", MODULI)
def test_quarter_period(k):
    chain, K = chain_of(k)
    assert chain.period == pytest.approx(float(2 * K / mpmath.pi), rel=6e-16)


@pytest.mark.parametrize("k", MODULI[1:])
def test_nome_is_exp_of_the_ratio_of_periods(k):
    chain, K = chain_of(k)
    q = mpmath.exp(-mpmath.pi * mpmath.ellipk(1 - mpmath.mpf(k) ** 2) / K)
    assert chain.nome_squared == pytest.approx(float(q * q), rel=2e-15)
    if k < 0.7:
        assert elliptic.nome(k, math.sqrt(1 - k * k)) == pytest.approx(float(q), rel=2e-15)


@pytest.mark.parametrize("k", MODULI)
def test_phase_is_the_fraction_of_the_period(k):
    chain, K = chain_of(k)
    for fraction in np.random.default_rng(3).uniform(-2, 2, 12):
        u = fraction * K
        sn, cn = (float(mpmath.ellipfun(f, u, mpmath.mpf(k) ** 2)) for f in ("sn", "cn"))
        sin, cos = elliptic.phase(chain, sn, cn)
        assert sin == pytest.approx(float(mpmath.sin(mpmath.pi * fraction / 2)), abs=3e-15)
        assert cos == pytest.approx(float(mpmath.cos(mpmath.pi * fraction / 2)), abs=3e-15)


@pytest.mark.parametrize("k", [1e-8, 1e-3, 0.3, 0.8, 0.985])
def test_imaginary_phase_is_relatively_exact(k):
    chain, K = chain_of(k)
    Kc = mpmath.ellipk(1 - mpmath.mpf(k) ** 2)
    for fraction in (1e-9, 1e-3, 0.5, 0.99, 0.9999):
        v = fraction * Kc
        sn, cn = (mpmath.ellipfun(f, v, 1 - mpmath.mpf(k) ** 2) for f in ("sn", "cn"))
        found = elliptic.imaginary_phase(chain, float(sn / cn))
        wanted = float(mpmath.sinh(mpmath.pi * v / (2 * K)))
        assert found == pytest.approx(wanted, rel=2e-15)
