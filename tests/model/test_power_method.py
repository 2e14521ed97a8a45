"""The fastest frequency by power iteration, beside oscillators whose frequencies are known."""

import numpy as np
import pytest

from particlerb.model import power_method
from particlerb.model.power_method import fastest_frequency
from particlerb.model.state import rotate

MASS = np.array([2.0, 0.5, 3.0])
X = np.array([[1.0], [0.0], [0.0]])


def frequency(first: int, second: int, inv_mass: np.ndarray, arm: float = 0.0) -> float:
    """ω [rad/s] of one spring of 8 N/m along x, which pulls `arm` [m] beside the first body."""
    ends = [(np.array([first]), np.array([[0.0], [arm], [0.0]]))]
    ends.append((np.array([second]), np.zeros((3, 1))))
    q = np.tile([[1.0], [0.0], [0.0], [0.0]], (1, inv_mass.size))
    springs = X, np.array([8.0]), np.zeros(1)
    return fastest_frequency((inv_mass, np.full((3, inv_mass.size), 0.25)), q, ends, springs, 20)


@pytest.mark.parametrize(
    ("first", "second", "inverse"),
    [(0, 1, 1 / 2.0 + 1 / 0.5), (1, 3, 1 / 0.5), (2, 0, 1 / 3.0 + 1 / 2.0)],
)
def test_it_is_that_of_the_reduced_mass_and_the_world_does_not_move(first, second, inverse):
    assert frequency(first, second, 1.0 / MASS) == pytest.approx(np.sqrt(8.0 * inverse), rel=1e-12)


def test_an_arm_adds_what_turns_to_what_moves():
    """ω² = k (1/M + a²/I), I = 4 kg m²."""
    expected = np.sqrt(8.0 * (1 / 2.0 + 0.3**2 / 4.0))
    assert frequency(0, 3, 1.0 / MASS, arm=0.3) == pytest.approx(expected, rel=1e-12)


def of_chain(anchor: int, inv_mass: np.ndarray) -> float:
    """ω [rad/s] of anchor - 0 - 1 on springs of 8 N/m."""
    ends = [(np.array([anchor, 0]), np.zeros((3, 2))), (np.array([0, 1]), np.zeros((3, 2)))]
    q = np.tile([[1.0], [0.0], [0.0], [0.0]], (1, inv_mass.size))
    springs = np.tile(X, (1, 2)), np.full(2, 8.0), np.zeros(2)
    return fastest_frequency((inv_mass, np.ones((3, inv_mass.size))), q, ends, springs, 20)


@pytest.mark.parametrize(("anchor", "inv_mass"), [(2, [1.0, 1.0]), (2, [1.0, 1.0, 0.0])])
def test_neither_the_world_nor_what_is_held_moves(anchor, inv_mass):
    """Two masses of 1 kg: ω² = k (3 + √5)/2; 20 iterations leave ((3 - √5)/(3 + √5))^40."""
    expected = np.sqrt(8.0 * (3.0 + np.sqrt(5.0)) / 2.0)
    assert of_chain(anchor, np.array(inv_mass)) == pytest.approx(expected, rel=1e-12)


def test_without_springs_nothing_oscillates():
    none = np.zeros(0, dtype=np.int64)
    ends, springs = [(none, np.zeros((3, 0)))] * 2, (np.zeros((3, 0)), np.zeros(0), np.zeros(0))
    q = np.array([[1.0], [0.0], [0.0], [0.0]])
    assert fastest_frequency((np.ones(1), np.ones((3, 1))), q, ends, springs, 20) == 0.0


@pytest.mark.plain
def test_bodies_without_springs_are_left_out(monkeypatch):
    """Of three, one spring ties two: rows of two are turned."""
    widths = []

    def noted(q, v):
        widths.append(v.shape[1])
        return rotate(q, v)

    monkeypatch.setattr(power_method, "rotate", noted)
    frequency(0, 1, 1.0 / MASS)
    assert set(widths) == {2}
