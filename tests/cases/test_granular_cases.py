"""Cases of many bodies that touch: what their opening comments say of the whole.

Where each body ends is chaotic, so a change of rounding changes it; what is tested are sums over
all bodies, with tolerances of several times what they changed by between seeds.
"""

import numpy as np
import pytest
from commands import has_met_its_checks

import particlerb
from particlerb.contact.sphere_search import neighbours

pytestmark = [pytest.mark.compiled, pytest.mark.slow]

CUBE = 0.1 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)  # spheres of clump_drop [m]
FREE_FALL = 15_300.0  # J, 1000 clumps by 1.56 m


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """File of a case of cases/, run as a user does, on one thread: tests run side by side."""

    def run_once(case: str) -> particlerb.Trajectory:
        folder = tmp_path_factory.mktemp(case)
        has_met_its_checks(case, folder, "run.threads=1")
        return particlerb.open(folder / "run.h5")

    return run_once


def centres(x: np.ndarray, q: np.ndarray, arms: np.ndarray) -> np.ndarray:
    """Centres (3, n) of spheres at arms (k, 3) of bodies at x (m, 3) with orientations q (m, 4)."""
    w, u = q[:, None, :1], q[:, None, 1:]
    turned = arms + 2.0 * np.cross(u, np.cross(u, arms) + w * arms)
    return np.ascontiguousarray((x[:, None] + turned).reshape(-1, 3).T)


def overlaps(points: np.ndarray, radius: float, of_each: int) -> np.ndarray:
    """Overlaps of spheres of different bodies, in radii."""
    n = points.shape[1]
    i, j, _ = neighbours(points, np.full(n, radius), np.arange(n) // of_each, 0.0)
    return 2.0 - np.linalg.norm(points[:, j] - points[:, i], axis=0) / radius


@pytest.fixture(scope="module")
def drop(run):
    with run("clump_drop") as found:
        yield found


def test_all_clumps_stay_in_the_box_and_make_a_heap_half_as_high_as_the_lattice(drop):
    points = centres(drop.position[-1], drop.orientation[-1], CUBE)
    assert np.abs(points[:2]).max() < 2.91  # 2.9 without overlap with the wall
    assert points[2].min() > 0.09
    assert drop.position[-1][:, 2].mean() == pytest.approx(1.44, abs=0.05)
    assert points[2].max() + 0.1 == pytest.approx(3.4, abs=0.5)


def test_overlaps_of_clumps_are_as_small_as_the_case_says(drop):
    frames = zip(drop.position, drop.orientation, strict=True)
    found = [overlaps(centres(x, q, CUBE), 0.1, 8) for x, q in frames]
    assert max(depth.max(initial=0.0) for depth in found) < 0.09
    last = found[-1]
    assert last.max() < 0.04
    assert last.mean() == pytest.approx(0.0016, abs=4e-4)
    assert last.size / 1000 == pytest.approx(3.2, abs=0.3)


def test_what_falling_clumps_lose_is_counted(drop):
    ledger = drop.ledger
    assert ledger.kinetic_energy[-1] < 20.0
    assert -ledger.work[-1] == pytest.approx(FREE_FALL, rel=0.05)
    assert np.abs(ledger.energy_error).max() < 2e-3 * FREE_FALL


def slope(x: np.ndarray) -> float:
    """Slope of a heap of bodies at x (n, 3) [°], as of a cone on a layer of balls."""
    away = np.linalg.norm(x[:, :2] - x[:, :2].mean(axis=0), axis=1)
    return float(np.degrees(np.arctan2(2.0 * (x[:, 2].mean() - 0.04), away.mean())))


def test_clumps_make_a_steeper_heap_than_balls_and_both_come_to_rest(run):
    """What falls where is chaotic: over 18 runs balls have 14.4 to 16.5°, clumps 17.1 to 23.4°."""
    with run("heap") as found:
        balls, clumps = (slope(found.position[-1][own]) for own in (slice(270), slice(270, 540)))
        ledger = found.ledger
    assert 13.0 < balls < 19.5
    assert 16.0 < clumps < 26.0
    assert clumps > balls
    assert ledger.kinetic_energy[-1] < 0.05
    assert -ledger.work[-1] == pytest.approx(900.0, rel=0.05)
    assert np.abs(ledger.energy_error).max() < 1.5e-3 * 900.0


def test_a_drum_lifts_its_balls_steadily_and_mixes_them(run):
    with run("mixer") as found:
        x, time, ledger = found.position, found.time, found.ledger
    middle = x.mean(axis=1)
    steady = time > 3.0
    behind = np.degrees(np.arctan2(-middle[steady, 0], -middle[steady, 2]))
    assert behind.mean() == pytest.approx(45.0, abs=2.0)
    assert behind.std() < 4.0
    assert np.hypot(middle[steady, 0], middle[steady, 2]).mean() == pytest.approx(0.21, abs=0.01)
    assert -18.0 * 9.81 * 1.5 * middle[steady, 0].mean() == pytest.approx(40.0, abs=2.0)  # W
    apart = np.linalg.norm(x[:, :90].mean(axis=1) - x[:, 90:].mean(axis=1), axis=1)
    part = [apart[(time >= t) & (time < t + 4.0)].mean() for t in (0.0, 4.0, 8.0, 12.0, 16.0)]
    assert part[0] == pytest.approx(0.31, abs=0.03)
    assert part[2] < 0.29
    assert part[4] < 0.21
    assert np.hypot(x[..., 0], x[..., 2]).max() < 0.475
    assert np.abs(x[..., 1]).max() < 0.095
    assert np.abs(ledger.energy_error).max() < 1.5e-3 * 800.0
