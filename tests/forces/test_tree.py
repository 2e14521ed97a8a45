"""The tree: its error falls as it says, and its forces have one potential, so nothing is lost."""

import itertools
import platform

import numba
import numpy as np
import pytest

from particlerb.compiled.threads import THREADS
from particlerb.forces.attraction import Attraction
from particlerb.forces.gravity_tree.cells import grow, room_for_nodes
from particlerb.forces.gravity_tree.lanes import BUCKET
from particlerb.forces.gravity_tree.multipole import MOMENT, ORDER, indices
from particlerb.forces.gravity_tree.opening_angle import (
    SAMPLE,
    fitting_angle,
    other_angle,
    safe_angle,
    sampled_error,
)
from particlerb.forces.gravity_tree.tree import Tree
from particlerb.forces.gravity_tree.walk import RANGES, _pull_by
from particlerb.maths.vec3 import Floats

G = 0.7
SHAPES = ("ball", "plummer", "disk", "clusters")


def centres(shape: str, n: int, rng: np.random.Generator) -> Floats:
    """Places of bodies, (3, n) [m]."""
    direction = rng.normal(size=(3, n))
    direction /= np.linalg.norm(direction, axis=0)
    if shape == "ball":
        return direction * rng.random(n) ** (1 / 3)
    if shape == "plummer":
        return direction / np.sqrt(rng.uniform(0.01, 0.99, n) ** (-2 / 3) - 1)
    if shape == "disk":
        return direction * np.array([[1.0], [1.0], [0.02]])
    if shape == "clusters":
        return 3.0 * rng.normal(size=(3, 4))[:, rng.integers(0, 4, n)] + 0.2 * direction
    return np.outer([1.0, 2.0, 3.0], np.sort(rng.random(n)))


def scene(shape, counts, size=0.03, softening=0.0, seed=1) -> tuple[Attraction, Floats]:
    """Bodies of so many particles, some `size` large, anywhere turned."""
    rng = np.random.default_rng(seed)
    offset = np.concatenate([[0], np.cumsum(counts)])
    mass = rng.uniform(0.5, 2.0, offset[-1])
    arm = size * rng.normal(size=(3, offset[-1]))
    for lo, hi in itertools.pairwise(offset):
        arm[:, lo:hi] -= arm[:, lo:hi] @ mass[lo:hi, None] / mass[lo:hi].sum()
    y = np.zeros((13, len(counts)))
    y[:3], y[3:7] = centres(shape, len(counts), rng), rng.normal(size=(4, len(counts)))
    y[3:7] /= np.linalg.norm(y[3:7], axis=0)
    return Attraction(arm, mass, G * mass, offset, softening), y


def rotation(q: Floats) -> Floats:
    """Rotation matrix of a unit quaternion, scalar first."""
    w, (x, y, z) = q[0], q[1:]
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * across + 2 * across @ across


def direct(attraction: Attraction, y: Floats) -> tuple[Floats, float]:
    """Loads, (6, n), and energy, from the definitions."""
    own = np.repeat(np.arange(y.shape[1]), np.diff(attraction.offset))
    turns = [rotation(q) for q in y[3:7].T]
    arm = np.array([turns[b] @ r for b, r in zip(own, attraction.arm.T, strict=True)])
    x, m, load, energy = y[:3].T[own] + arm, attraction.mass, np.zeros((6, y.shape[1])), 0.0
    for i in range(m.size):
        d, others = x - x[i], own != own[i]
        square = (d * d).sum(axis=1)[others] + attraction.softening
        weight = G * m[i] * m[others]
        force = (weight / square**1.5) @ d[others]
        load[:3, own[i]] += force
        load[3:, own[i]] += np.cross(arm[i], force)
        energy -= 0.5 * (weight / np.sqrt(square)).sum()
    return load, energy


def loads(attraction: Attraction, y: Floats, angle: float) -> Floats:
    """Loads by a tree, (6, n)."""
    load = np.zeros((13, y.shape[1]))
    Tree(attraction, angle).loads(y, load)
    assert not load[6:].any()
    return load[:6]


def error(attraction: Attraction, load: Floats, exact: Floats) -> float:
    """Relative error of accelerations, √(Σ |Δa|²/Σ |a|²) over bodies."""
    mass = np.add.reduceat(attraction.mass, attraction.offset[:-1])
    return float(np.linalg.norm((load - exact)[:3] / mass) / np.linalg.norm(exact[:3] / mass))


def lost(y: Floats, load: Floats) -> tuple[float, float]:
    """|Σ F|/Σ |F| and |Σ (x × F + τ)|/Σ |x × F + τ|."""
    torque = np.cross(y[:3].T, load[:3].T).T + load[3:]
    return tuple(
        float(np.linalg.norm(v.sum(axis=1)) / np.linalg.norm(v, axis=0).sum())
        for v in (load[:3], torque)
    )


MANY = [pytest.param([1] * 1500, id="points"), pytest.param([3, 40, 1, 90] * 10, id="mascons")]


@pytest.mark.compiled
@pytest.mark.parametrize("counts", MANY)
@pytest.mark.parametrize("shape", SHAPES)
def test_error_stays_below_what_was_asked(shape, counts):
    attraction, y = scene(shape, counts)
    exact, _ = direct(attraction, y)
    for accuracy in (1e-2, 1e-3, 1e-4, 1e-5):
        assert error(attraction, loads(attraction, y, safe_angle(accuracy)), exact) < accuracy


@pytest.mark.compiled
@pytest.mark.parametrize("counts", MANY)
@pytest.mark.parametrize("shape", SHAPES)
def test_fitted_angle_is_wider_and_keeps_to_what_was_asked(shape, counts):
    """The sample has a third of the points, and takes close pairs for usual ones."""
    attraction, y = scene(shape, counts)
    exact, _ = direct(attraction, y)
    for accuracy in (1e-3, 1e-4, 1e-5):
        angle = fitting_angle(attraction, y, accuracy)
        assert safe_angle(accuracy) < angle <= 1.0
        assert error(attraction, loads(attraction, y, angle), exact) < accuracy


@pytest.mark.compiled
@pytest.mark.parametrize("n", [300, 3000])
def test_sampled_error_is_that_of_all(n):
    """Softened, so that no pair hides the others; of few points all are in the sample."""
    attraction, y = scene("ball", [1] * n, softening=0.01)
    exact, _ = direct(attraction, y)
    tree, load = Tree(attraction, 0.6), np.zeros((6, n))
    tree.loads(y, load)
    true = error(attraction, load, exact)
    assert sampled_error(tree) == pytest.approx(true, rel=0.02 if n < SAMPLE else 0.2)


def test_another_angle_follows_the_order():
    """At half of what is asked for the angle stays about what it is."""
    assert other_angle(0.5, 0.55e-4, 1e-4) == pytest.approx(0.5)
    wider = other_angle(0.5, 0.55e-4 / 2 ** (ORDER + 1), 1e-4)
    assert wider == pytest.approx(1.0)


@pytest.mark.compiled
@pytest.mark.parametrize("size", [0.001, 0.01])
def test_error_falls_with_the_angle_as_its_order_says(size):
    attraction, y = scene("ball", [17] * 400, size=size)
    exact, _ = direct(attraction, y)
    angles = np.array([0.4, 0.55, 0.75])
    errors = [error(attraction, loads(attraction, y, angle), exact) for angle in angles]
    slope = np.polyfit(np.log(angles), np.log(errors), 1)[0]
    assert abs(slope - (ORDER + 1)) < 0.8
    assert errors[-1] > 1e-4


@pytest.mark.parametrize("counts", [[1] * 60, [3, 1, 20, 2] * 4])
def test_angle_of_nothing_is_the_direct_sum(counts):
    attraction, y = scene("ball", counts, softening=0.01)
    exact, energy = direct(attraction, y)
    load = loads(attraction, y, 0.0)
    assert np.abs(load - exact).max() < 1e-13 * np.abs(exact).max()
    assert Tree(attraction, 0.0).potential_energy(y) == pytest.approx(energy, rel=1e-14)


@pytest.mark.parametrize("softening", [0.0, 0.04])
@pytest.mark.parametrize("angle", [0.5, 0.95])
@pytest.mark.parametrize("shape", SHAPES)
def test_momenta_stay_at_any_angle(shape, angle, softening):
    attraction, y = scene(shape, [1, 2, 19, 1] * 8, softening=softening)
    load = loads(attraction, y, angle)
    assert max(lost(y, load)) < 2e-15
    exact, _ = direct(attraction, y)
    assert error(attraction, load, exact) > 1e-9  # some have met as a whole


@pytest.mark.compiled
def test_momenta_stay_where_buckets_are_split_into_particles():
    rng = np.random.default_rng(2)
    attraction, y = scene("ball", [1] * 3000)
    y[:3, :40] *= 10.0 ** rng.uniform(0.0, 2.0, 40)
    load = loads(attraction, y, 0.7)
    assert max(lost(y, load)) < 2e-15
    assert error(attraction, load, direct(attraction, y)[0]) < 0.1 * 0.7**6


def moved(y: Floats, b: int, axis: int, h: float, is_turn: bool) -> Floats:
    """State in which body b is shifted, or turned about its centre of mass, along a world axis."""
    z = y.copy()
    if not is_turn:
        z[axis, b] += h
        return z
    u, v, w = np.sin(0.5 * h) * np.eye(3)[axis], y[4:7, b], y[3, b]
    c = np.cos(0.5 * h)
    z[3, b], z[4:7, b] = c * w - u @ v, c * v + w * u + np.cross(u, v)
    return z


@pytest.mark.slow
@pytest.mark.parametrize("softening", [0.0, 0.2])
@pytest.mark.parametrize("counts", [[12, 7], [40, 1], [40, 35]])
def test_loads_are_the_derivatives_of_the_potential(counts, softening):
    attraction, y = scene("ball", counts, size=0.2, softening=softening)
    y[:3] = np.array([[0.0, 0.3, 1.0], [2.4, 1.9, -0.1]]).T
    tree, h = Tree(attraction, 1.0), 1e-3
    load = loads(attraction, y, 1.0)
    off = np.abs(load - direct(attraction, y)[0]).max() / np.abs(load).max()
    assert 1e-6 < off < 1e-2  # they have met as a whole, softened
    for b, is_turn, axis in np.ndindex(2, 2, 3):

        def slope(h, b=b, is_turn=is_turn, axis=axis):
            ends = [tree.potential_energy(moved(y, b, axis, s, is_turn)) for s in (h, -h)]
            return (ends[0] - ends[1]) / (2.0 * h)

        expected = -(4.0 * slope(h) - slope(2.0 * h)) / 3.0
        assert load[3 * is_turn + axis, b] == pytest.approx(expected, abs=1e-9 * np.abs(load).max())


@pytest.mark.compiled
def test_work_of_the_loads_is_that_of_the_energy():
    """A tree that is grown anew has another potential; it differs by the error of the tree."""
    attraction, y = scene("plummer", [2, 1] * 200, softening=0.01)
    _, energy = direct(attraction, y)
    found = Tree(attraction, 0.5).potential_energy(y)
    assert 0.0 < abs(found / energy - 1.0) < 1e-5


@pytest.mark.compiled
@pytest.mark.parametrize("counts", [[1] * 9000, [30, 1, 100] * 80])
def test_any_number_of_threads_finds_the_same_bits(counts):
    attraction, y = scene("plummer", counts)
    before, found, energies = THREADS.count, [], []
    for count in (1, 2, 3):
        THREADS.use(count)
        found.append(loads(attraction, y, 0.6))
        energies.append(Tree(attraction, 0.6).potential_energy(y))
    THREADS.use(before)
    assert (found[0] == found[1]).all()
    assert (found[0] == found[2]).all()
    assert energies[0] == energies[1] == energies[2]


@pytest.mark.compiled
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 code")
def test_particles_of_a_bucket_fill_lanes(make):
    """Beside the loop in lanes stands the same one for what is left over."""
    ranges, near = np.zeros(2 * RANGES, dtype=np.int64), np.zeros(MOMENT * BUCKET)
    arguments = np.zeros((3, 2)), np.zeros(2), ranges, 1, 0.0, near
    code = make.assembly(_pull_by, tuple(map(numba.typeof, arguments)))
    packed, single = make.arithmetic(code)
    assert packed > 0.25 * (packed + single)


def test_evaluations_do_not_depend_on_those_before():
    attraction, y = scene("clusters", [1, 20] * 10)
    z = np.roll(y, 5, axis=1)
    tree, load = Tree(attraction, 0.7), np.zeros((13, 20))
    tree.loads(z, np.zeros((13, 20)))
    tree.loads(y, load)
    assert (load[:6] == loads(attraction, y, 0.7)).all()
    tree.loads(y, load)
    assert (load[:6] == 2.0 * loads(attraction, y, 0.7)).all()


@pytest.mark.parametrize("counts", [[1], [1, 1], [50], [1, 50], [33] * 3])
@pytest.mark.parametrize("angle", [0.0, 0.9])
def test_few_bodies(counts, angle):
    attraction, y = scene("ball", counts)
    y[:3] *= 3.0
    exact, _ = direct(attraction, y)
    load = loads(attraction, y, angle)
    assert np.abs(load[:3] - exact[:3]).max() <= 0.1 * max(angle, 1e-2) ** 6 * np.abs(exact).max()
    assert np.isfinite(load).all()


@pytest.mark.parametrize("shape", ["line", "ball"])
def test_bodies_in_each_other_at_one_place_or_on_one_line(shape):
    attraction, y = scene(shape, [1, 3, 40] * 12, size=0.5, softening=0.1)
    if shape == "ball":
        y[:3] = 1.0
    exact, _ = direct(attraction, y)
    load = loads(attraction, y, 0.6)
    assert error(attraction, load, exact) < 0.1 * 0.6**6
    assert max(lost(y, load)) < 1e-15


def test_particles_without_mass_change_nothing():
    attraction, y = scene("ball", [80, 3] * 6)
    mass = attraction.mass.copy()
    mass[:80][attraction.arm[0, :80] > -0.01] = 0.0  # whole buckets of it
    light = attraction._replace(mass=mass, gm=G * mass)
    exact, _ = direct(light, y)
    load = loads(light, y, 0.5)
    assert np.isfinite(load).all()
    assert error(light, load, exact) < 0.1 * 0.5**6


@pytest.mark.parametrize("n", [1, 16, 17, 33, 100, 257])
def test_buckets_are_full_and_each_body_is_in_one(n):
    place = np.random.default_rng(n).normal(size=(3, n))
    order, nodes = np.arange(n), room_for_nodes(2 * n)
    items = (place.copy(), order, np.ones(n, dtype=np.int64))
    stack, none = np.zeros((5, 256), dtype=np.int64), np.zeros(n + 1, dtype=np.int64)
    count = grow(items, room_for_nodes(0), none, nodes, stack)
    ends = [k for k in range(count) if nodes.second[k] == 0]
    assert len(ends) == -(-n // BUCKET)
    assert sorted(order) == list(range(n))
    assert (items[0] == place[:, order]).all()
    assert [nodes.first[k] for k in ends[1:]] == [nodes.stop[k] for k in ends[:-1]]


def test_indices_are_all_of_an_order():
    assert indices(1) == [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    assert len(indices(5)) == 56


def test_angle_grows_with_the_accuracy_that_may_be_lost():
    assert safe_angle(1e-6) < safe_angle(1e-4) < safe_angle(1e-2) <= safe_angle(1.0) == 1.0
