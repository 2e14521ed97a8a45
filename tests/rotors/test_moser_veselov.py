"""The preprocessed Moser-Veselov map alone: order, constants of motion, steady spins, extremes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from particlerb.maths.quaternion import multiply, normalised, to_body, to_world
from particlerb.rotors.exact import orientation, turns_of
from particlerb.rotors.moser_veselov import (
    LONGEST_PIECE,
    MOST_PIECES,
    first_guess,
    iterations_of,
    modified_inertia,
    newton,
    pieces_of,
    polynomial,
)
from particlerb.rotors.rotor_class import ASYMMETRIC

EPS = 2.0**-52
START = (0.8, 0.0, 0.6, 0.0)
BODIES = {
    "generic": ((1.0, 2.0, 2.5), (1.0, 0.4, -0.7)),
    "near the intermediate axis": ((1.0, 2.0, 3.0), (0.3, 1.0, 0.2)),
    "nearly flat": ((1.0, 1.5, 2.4999), (0.5, 0.5, 0.5)),
    "long": ((1.0, 1.2, 0.25), (0.3, 0.6, 1.2)),
}


def column(*x):
    return np.array(x, dtype=float)[:, np.newaxis]


def constants(inertia):
    """1/I, its unit, and the coefficients of s and d, as the map takes them."""
    c = [float(x) for x in modified_inertia(1.0 / column(*inertia))[:, 0]]
    cubics = [tuple(tuple(c[k + 3 * j : k + 3 * j + 3]) for j in range(3)) for k in (4, 13)]
    return tuple(c[:3]), c[3], *cubics


def turned(inertia, q, L, h, more=0):
    """Orientation after one map."""
    a, unit, s, d = constants(inertia)
    m = to_body(q, L)
    turn = abs(h) * float(np.linalg.norm(np.divide(m, inertia)))
    u, f, v = first_guess(tuple(h * unit * x for x in m), a, s, d)
    for _ in range(iterations_of(turn) + more):
        v = newton(u, f, v)
    return normalised(multiply(q, (1.0, *v)))


def flown(inertia, q, L, h, n):
    """Orientation after n maps, and the energy after each."""
    energy = []
    for _ in range(n):
        q = turned(inertia, q, L, h)
        energy.append(0.5 * np.sum(np.square(to_body(q, L)) / inertia))
    return q, np.array(energy)


def exact(inertia, q, L, t):
    ((_, turn),) = turns_of(column(*inertia), np.array([ASYMMETRIC]), column(*q), column(*L))
    return orientation(turn, t)[:, 0]


def angle(a, b):
    a, b = np.asarray(a), np.asarray(b)
    return 2 * np.linalg.norm(a * np.sign(a @ b) - b)


def momentum(inertia, w):
    """L in the world of a body that starts with the rates w in its own axes."""
    return to_world(START, tuple(float(x) for x in np.multiply(inertia, w)))


# The map


@pytest.mark.parametrize("name", BODIES)
def test_order_is_eight_and_energy_is_kept_to_rounding(name):
    inertia, w = BODIES[name]
    L, t = momentum(inertia, w), 8.0
    first, errors = 0.36 / np.linalg.norm(w), []  # rad in the longest step
    counts = np.ceil(t / first * 2.0 ** np.array([0, 0.5, 1, 1.5])).astype(int)
    for n in counts:
        q, energy = flown(inertia, START, L, t / n, n)
        errors.append(angle(q, exact(inertia, START, L, t)))
        # of the turn that each map takes up: some EPS, of a random walk of n of them
        start = 0.5 * np.sum(np.multiply(inertia, np.square(w)))
        assert np.abs(energy / start - 1).max() < 3 * EPS * (2 + np.sqrt(n))
    assert errors[-1] > 1e-13
    slope = np.polyfit(np.log(1.0 / counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(8, abs=0.15)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_a_step_back_undoes_a_step(seed):
    rng = np.random.default_rng(seed)
    squares = rng.uniform(0.02, 1, 3)
    inertia, w = squares.sum() - squares, rng.standard_normal(3)
    h = 0.5 * rng.uniform() / np.linalg.norm(w)
    q = tuple(float(x) for x in normalised(tuple(rng.standard_normal(4))))
    L = to_world(q, tuple(float(x) for x in inertia * w))
    assert angle(turned(inertia, turned(inertia, q, L, h), L, -h), q) < 1e-15 + 8 * EPS


@given(seed=st.integers(0, 2**32 - 1), thin=st.floats(0, 6))
@settings(max_examples=60)
def test_iterations_are_enough_for_any_shape_of_body(seed, thin):
    """Five more change nothing, for pieces of up to 0.8 rad; moments up to 1 : 10⁶."""
    rng = np.random.default_rng(seed)
    squares = rng.uniform(0.02, 1, 3) * [1.0, 10.0**-thin, 1.0]
    inertia, w = squares.sum() - squares, rng.standard_normal(3)
    h = LONGEST_PIECE * rng.uniform(0.01, 1) / np.linalg.norm(w)
    L = momentum(inertia, w)
    some, more = (turned(inertia, START, L, h, more=k) for k in (0, 5))
    assert angle(some, more) < 8 * EPS


def test_pieces_are_a_small_share_of_a_step():
    """However short it is: with a bound in radians alone the error grows where a cut falls away."""
    for share in (0.1, 0.2, 0.29):
        assert pieces_of(0.01, share) == pieces_of(0.0, share) == 1
    for share in (0.31, 0.36, 0.59):
        assert pieces_of(0.01, share) == pieces_of(0.0, share) == 2
    assert pieces_of(1.7, 0.36) == 3


def test_pieces_are_short_enough_and_not_more_than_needed():
    for turn in (0.0, 0.1, 0.499, 0.8, 3.0, 17.3, 51.0):
        pieces = pieces_of(turn, 0.1)
        assert turn / pieces <= LONGEST_PIECE
        assert (pieces - 1) * LONGEST_PIECE <= turn
    assert pieces_of(1e9, 0.1) == MOST_PIECES
    counts = [iterations_of(turn) for turn in (0.0, 0.01, 0.1, 0.3, LONGEST_PIECE)]
    assert counts == sorted(counts)
    assert counts[0] >= 1


# The modified inertia


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_steady_spins_turn_by_the_true_angle_up_to_the_eighth_power(seed):
    """About axis k, H = a_k N, the map turns by arcsin m b_k; it must be θ = a_k m, so

    b_k = s a_k + d = a_k sin θ / θ = a_k (1 - θ²/6 + θ⁴/120 - θ⁶/5040), θ² = 2 a_k² N.
    """
    squares = np.random.default_rng(seed).uniform(0.05, 1, 3)
    a, _, s, d = constants(squares.sum() - squares)
    for a_k in a:
        for theta in (0.1, 0.3, 0.5):
            N = 0.5 * (theta / a_k) ** 2
            b = (1.0 + polynomial(s, N, a_k * N)) * a_k + polynomial(d, N, a_k * N)
            series = 1 - theta**2 / 6 + theta**4 / 120 - theta**6 / 5040
            # cancellation of terms that are some tens of times larger
            assert b / a_k == pytest.approx(series, abs=1e-14 * max(a) ** 3)


@pytest.mark.parametrize("unit", [1e-100, 1e-45, 1e100])
def test_size_of_the_body_does_not_matter(unit):
    inertia = np.array([1.0, 2.0, 2.5])
    one, other = (modified_inertia(1.0 / (column(*inertia) * c)) for c in (1.0, unit))
    assert np.isfinite(other).all()
    rest = np.arange(22) != 3
    assert other[rest] == pytest.approx(one[rest], rel=1e-12)
    assert other[3] * unit == pytest.approx(one[3], rel=1e-15)
    w = (1.0, 0.4, -0.7)
    small = turned(inertia * unit, START, momentum(inertia * unit, w), 0.3)
    assert angle(small, turned(inertia, START, momentum(inertia, w), 0.3)) < 8 * EPS


@pytest.mark.parametrize(("thin", "limit"), [(1e-2, 4e-9), (1e-4, 4e-9), (1e-6, 2e-3)])
def test_what_a_needle_loses_to_rounding(thin, limit):
    """I₃/I₁ = thin: the coefficients are 1/thin³, and their sum is of order one.

    Energy and momentum do not suffer, the order does: what is left is EPS (h |ω|)⁶ / thin³.
    """
    inertia = np.array([1.0, 1.0 + 0.3 * thin, thin])
    w, t = np.array([0.8, 0.5, 0.4]), 8.0
    L, h = momentum(inertia, w), 0.25
    q, energy = flown(inertia, START, L, h, int(t / h))
    assert np.abs(energy / (0.5 * np.sum(inertia * w * w)) - 1).max() < 20 * EPS
    assert angle(q, exact(inertia, START, L, t)) < limit


@pytest.mark.plain
def test_constants_of_bodies_of_one_kind_are_those_among_others():
    """They are found from numbers, and among others from arrays: to the same bits."""
    inverse = 1.0 / np.random.default_rng(5).uniform(0.1, 5.0, (3, 50))
    among = modified_inertia(inverse)
    for k in range(50):
        alone = modified_inertia(inverse[:, [k, k]])
        assert alone.tobytes() == among[:, [k, k]].tobytes()
    assert modified_inertia(inverse[:, :0]).shape == (22, 0)
