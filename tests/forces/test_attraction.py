"""Attraction between particles: a plain double sum, symmetries, its potential, limits, tiles.

Tiles are of 256 targets; in plain Python of 8, so that a few particles cover several.
"""

import math
import platform
import re
from itertools import pairwise

import mpmath
import numba
import numpy as np
import pytest
from formulas import derivative
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from particlerb.compiled.jit import config, kernel
from particlerb.compiled.threads import THREADS
from particlerb.forces import attraction as module
from particlerb.forces.attraction import (
    Attraction,
    add_attraction,
    attract,
    attraction_loads,
    attraction_potential,
    fields_of,
    inverse_cube,
    inverse_root,
    place_points,
    potential_energy,
    spread_loads,
)
from particlerb.forces.attraction_rates import fastest_rates
from particlerb.forces.central import Central, central_work

T = 8 if config.DISABLE_JIT else module.TILE
G = 0.7
seeds = st.integers(0, 2**32 - 1)
MANY = {
    "one body": [T + 3],
    "two points": [1, 1],
    "points in one tile": [1] * T,
    "one point more": [1] * (T + 1),
    "tiles of one body each": [T, T],
    "bodies across tiles": [5] * (T // 2),
    "a large body between small ones": [1, 2, 2 * T, 3, 1],
    "bodies without particles": [0, 3, 0, 0, T - 3, 4, 0],
}


@pytest.fixture(autouse=True, scope="module")
def small_tiles():
    """In plain Python, where the size is no constant of the compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "TILE", T)
        yield


def random_scene(counts, seed=1, softening=0.0):
    """Bodies of so many particles at random places, and their state."""
    rng = np.random.default_rng(seed)
    n, n_bodies = sum(counts), len(counts)
    mass = rng.uniform(0.5, 2.0, n)
    arm, at = 0.3 * rng.standard_normal((3, n)), np.zeros(n_bodies + 1, dtype=np.int64)
    at[1:] = np.cumsum(counts)
    for lo, hi in pairwise(at):
        if hi > lo:
            arm[:, lo:hi] -= (arm[:, lo:hi] @ mass[lo:hi] / mass[lo:hi].sum())[:, None]
    y = np.zeros((13, n_bodies))
    y[:3] = 3.0 * rng.standard_normal((3, n_bodies))
    y[3:7] = rng.standard_normal((4, n_bodies))
    y[3:7] /= np.linalg.norm(y[3:7], axis=0)
    return Attraction(arm, mass, G * mass, at, softening), y


def found_loads(attraction, y):
    """Force and torque, (3, n_bodies) each."""
    load = np.zeros((6, y.shape[1]))
    attraction_loads(attraction, fields_of(attraction), y, load)
    return load[:3], load[3:]


def points_of(attraction, y):
    """World arms and points, (n, 3) each, and the body of each particle."""
    body = np.repeat(np.arange(y.shape[1]), np.diff(attraction.offset))
    R = Rotation.from_quat(y[3:7].T, scalar_first=True)
    arm = R[body].apply(attraction.arm.T)
    return arm, y[:3].T[body] + arm, body


def plain_sum(attraction, y):
    """Force, torque and potential energy: particle by particle, with √ and division."""
    arm, x, body = points_of(attraction, y)
    F, tau, U = np.zeros((3, y.shape[1])), np.zeros((3, y.shape[1])), 0.0
    for i in range(len(x)):
        others = body != body[i]
        d = x[others] - x[i]
        m = attraction.mass[i] * attraction.mass[others]
        distance = np.sqrt((d * d).sum(axis=1) + attraction.softening)
        force = (G * m / distance**3) @ d
        F[:, body[i]] += force
        tau[:, body[i]] += np.cross(arm[i], force)
        U -= 0.5 * (G * m / distance).sum()
    return F, tau, U


def rounding(attraction, y):
    """Some roundings of the sum of the sizes of all forces, times the largest distance."""
    _, x, body = points_of(attraction, y)
    far = body[:, None] != body
    d = np.linalg.norm(x[:, None] - x, axis=2)
    d = np.sqrt(np.where(far, d * d + attraction.softening, 1.0))
    pairs = np.where(far, attraction.mass[:, None] * attraction.gm / d**2, 0.0).sum()
    return 1e-14 * (1.0 + np.abs(x).max()) * (1e-3 + pairs)


# Powers


@kernel
def powers(x, roots, cubes):
    for i in range(x.size):
        roots[i], cubes[i] = inverse_root(x[i]), inverse_cube(0.7, x[i])


def test_inverse_roots_and_cubes_are_good_to_the_last_bits():
    """0.9 and 2.2 units of the last place; without fused operations 1.2 and 3.2."""
    rng = np.random.default_rng(3)
    some = 200 if config.DISABLE_JIT else 4000
    x = np.concatenate([2.0 ** rng.uniform(-640, 640, some), rng.uniform(1, 4, some), [1.0, 2.0]])
    roots, cubes = np.empty_like(x), np.empty_like(x)
    powers(x, roots, cubes)
    with mpmath.workprec(120):
        true = [1 / mpmath.sqrt(v) for v in map(mpmath.mpf, x)]
        size = mpmath.mpf(0.7)
        wrong = [
            (float(abs(a - r) / np.spacing(a)), float(abs(b - size * r**3) / np.spacing(b)))
            for a, b, r in zip(roots, cubes, true, strict=True)
        ]
    most = (1.3, 3.3) if config.DISABLE_JIT else (1.0, 2.5)
    assert max(root for root, _ in wrong) < most[0]
    assert max(cube for _, cube in wrong) < most[1]


# Sums


@pytest.mark.parametrize("softening", [0.0, 0.2])
@pytest.mark.parametrize("counts", MANY.values(), ids=MANY)
def test_loads_and_energy_are_the_plain_sum(counts, softening):
    attraction, y = random_scene(counts, 2, softening)
    F, tau, U = plain_sum(attraction, y)
    limit = rounding(attraction, y)
    found_F, found_tau = found_loads(attraction, y)
    assert pytest.approx(F, abs=limit) == found_F
    assert found_tau == pytest.approx(tau, abs=limit)
    assert potential_energy(attraction, fields_of(attraction), y) == pytest.approx(U, rel=1e-14)


def test_loads_are_added_to_what_is_there():
    attraction, y = random_scene([2, 1, 3])
    load = np.arange(24.0).reshape(8, 3)
    attraction_loads(attraction, fields_of(attraction), y, load)
    F, tau = found_loads(attraction, y)
    expected = np.arange(24.0).reshape(8, 3) + np.vstack([F, tau, np.zeros((2, 3))])
    assert (load == expected).all()


def test_two_points_by_the_formula():
    """F = G m M d/(d² + ε²)^{3/2} along the line, U = -G m M/√(d² + ε²), no torque."""
    mass, offset = np.array([2.0, 3.0]), np.array([0, 1, 2])
    y = np.zeros((13, 2))
    y[3] = 1.0
    y[:3, 1] = [3.0, 4.0, 12.0]
    for square in (0.0, 27.0):
        attraction = Attraction(np.zeros((3, 2)), mass, G * mass, offset, square)
        F, tau = found_loads(attraction, y)
        pull = G * 6.0 * np.array([3.0, 4.0, 12.0]) / (169.0 + square) ** 1.5
        assert pytest.approx(np.array([pull, -pull]).T, rel=1e-15) == F
        assert not tau.any()
        energy = potential_energy(attraction, fields_of(attraction), y)
        assert energy == pytest.approx(-G * 6.0 / math.sqrt(169.0 + square), rel=1e-15)


def test_softened_particles_in_one_place_do_not_pull():
    attraction, y = random_scene([1, 1, 1], softening=0.25)
    y[:3] = 1.0
    F, _ = found_loads(attraction, y)
    assert not F.any()
    energy = potential_energy(attraction, fields_of(attraction), y)
    m = attraction.mass
    assert energy == pytest.approx(-2.0 * G * (m[0] * m[1] + m[1] * m[2] + m[2] * m[0]))


@pytest.mark.compiled
def test_what_is_in_one_place_unsoftened_is_not_taken_for_a_number():
    """A run finds that its state is no longer finite, and says so."""
    attraction, y = random_scene([1, 1, 1])
    y[:3, 0] = y[:3, 1]
    F, _ = found_loads(attraction, y)
    assert not np.isfinite(F[:, :2]).any()
    assert np.isfinite(F[:, 2]).all()
    assert not np.isfinite(potential_energy(attraction, fields_of(attraction), y))


@pytest.mark.parametrize("counts", MANY.values(), ids=MANY)
def test_particles_of_one_body_do_not_act_on_each_other(counts):
    """Not even where they coincide; what they weigh changes no bit of their own field."""
    attraction, y = random_scene(counts, 5)
    b = int(np.argmax(counts))
    own = slice(*attraction.offset[b : b + 2])
    attraction.arm[:, own] = 0.1
    fields = fields_of(attraction)
    accelerations = []
    for _ in range(2):
        attraction_loads(attraction, fields, y, np.zeros((6, len(counts))))
        accelerations.append(fields.field[:, own].copy())
        attraction.gm[own] *= 3.0
    assert np.isfinite(accelerations[0]).all()
    assert (accelerations[0] == accelerations[1]).all()
    assert accelerations[0].any() == (np.count_nonzero(counts) > 1)


# Symmetries and the potential


@given(seed=seeds, softening=st.sampled_from([0.0, 0.3]))
@settings(max_examples=40)
def test_attraction_neither_pushes_nor_turns_the_whole(seed, softening):
    """Σ F = 0 and Σ x × F + τ = 0."""
    attraction, y = random_scene([1, 4, 2, 7, 3], seed, softening)
    F, tau = found_loads(attraction, y)
    limit = rounding(attraction, y)
    assert np.abs(tau).max() > 1e-4
    assert F.sum(axis=1) == pytest.approx(np.zeros(3), abs=limit)
    whole = (np.cross(y[:3], F, axis=0) + tau).sum(axis=1)
    assert whole == pytest.approx(np.zeros(3), abs=limit)


@given(seed=seeds, turn=seeds)
@settings(max_examples=40)
def test_a_scene_turned_and_moved_as_a_whole_has_turned_loads(seed, turn):
    attraction, y = random_scene([1, 4, 2, 3], seed)
    R, by = Rotation.random(None, np.random.default_rng(turn)), np.array([[1.0], [-2.0], [0.5]])
    turned = y.copy()
    turned[:3] = R.as_matrix() @ y[:3] + by
    own = Rotation.from_quat(y[3:7].T, scalar_first=True)
    turned[3:7] = (R * own).as_quat(scalar_first=True).T
    limit = rounding(attraction, y) + rounding(attraction, turned)
    for one, other in zip(found_loads(attraction, y), found_loads(attraction, turned), strict=True):
        assert other == pytest.approx(R.as_matrix() @ one, abs=10 * limit)


@given(seed=seeds, softening=st.sampled_from([0.0, 0.3]))
@settings(max_examples=20)
def test_loads_are_the_gradient_of_the_potential(seed, softening):
    """F = -∂U/∂x and τ·e = -dU/dφ for a turn by φ about the world axis e."""
    attraction, y = random_scene([4, 3, 1], seed, softening)
    y[:3] = 2.0 * np.eye(3) + 0.1 * y[:3]  # some 2.8 m apart
    F, tau = found_loads(attraction, y)
    fields, own = fields_of(attraction), Rotation.from_quat(y[3:7, 0], scalar_first=True)
    for k, axis in enumerate(np.eye(3)):

        def energy(s, axis=axis):
            moved = y.copy()
            moved[:3, 0] += s * axis
            return potential_energy(attraction, fields, moved)

        def energy_turned(s, axis=axis):
            turned = y.copy()
            turned[3:7, 0] = (Rotation.from_rotvec(s * axis) * own).as_quat(scalar_first=True)
            return potential_energy(attraction, fields, turned)

        assert derivative(energy) == pytest.approx(-F[k, 0], abs=1e-10)
        assert derivative(energy_turned) == pytest.approx(-tau[k, 0], abs=1e-10)


# Limits


def icosahedron():
    """Its corners, (12, 3) on the unit sphere: sums over them see harmonics from degree 6 on."""
    golden = 0.5 * (1.0 + math.sqrt(5.0))
    square = np.array([[0, a, b * golden] for a in (-1, 1) for b in (-1, 1)])
    corners = np.vstack([np.roll(square, k, axis=1) for k in range(3)])
    return corners / np.linalg.norm(corners, axis=1)[:, None]


def shell_and_point(x):
    """Force on a point of 1 kg at x by a shell of 12 kg and radius 1 m about the origin."""
    arm, mass = np.zeros((3, 13)), np.ones(13)
    arm[:, :12] = icosahedron().T
    y = np.zeros((13, 2))
    y[3], y[:3, 1] = 1.0, x
    attraction = Attraction(arm, mass, G * mass, np.array([0, 12, 13]), 0.0)
    return found_loads(attraction, y)[0][:, 1]


def test_a_shell_pulls_like_its_mass_outside_and_not_at_all_inside():
    """Up to harmonics of degree 6: (1/d)⁶ relative outside, r⁵ inside."""
    n = np.array([0.6, 0.0, 0.8])
    outside, inside = 4.0 * 2.0 ** np.arange(4), 0.25 * 2.0 ** -np.arange(4.0)
    relative = [np.linalg.norm(shell_and_point(d * n) * d * d / (12 * G) + n) for d in outside]
    forces = [np.linalg.norm(shell_and_point(r * n)) for r in inside]
    assert relative[0] > 1e-6
    assert -np.diff(np.log2(relative))[:2] == pytest.approx(6.0, abs=0.1)
    assert forces[0] > 1e-4
    assert -np.diff(np.log2(forces))[:2] == pytest.approx(5.0, abs=0.1)


def test_far_away_it_is_a_central_field_of_a_point():
    """MacCullagh's formula of `central` is cut after (size/distance)²; order 3 is left."""
    rng = np.random.default_rng(5)
    r, m, far = rng.standard_normal((3, 10)), rng.uniform(0.5, 2.0, 10), np.array([2.0, -1.0, 2.0])
    r -= (r @ m / m.sum())[:, None]
    moments, axes = np.linalg.eigh((m * r * r).sum() * np.eye(3) - (m * r) @ r.T)
    r = axes.T @ r
    y, mass = np.zeros((13, 2)), np.append(m, 3.0)
    y[3], y[:3, 0] = 1.0, far
    errors = []
    for size in 0.2 / 2.0 ** np.arange(5):
        arm = np.zeros((3, 11))
        arm[:, :10] = size * r
        cloud = Attraction(arm, mass, G * mass, np.array([0, 10, 11]), 0.0)
        inertia = (size**2 * moments).reshape(3, 1)
        centre = Central(np.zeros((3, 1)), np.full(1, 3 * G), np.full(1, m.sum()), inertia)
        expected = -central_work(centre, y[:3, :1], y[3:7, :1])[0]
        errors.append(abs(potential_energy(cloud, fields_of(cloud), y) - expected))
    assert errors[0] > 1e-6
    assert -np.diff(np.log2(errors))[2:] == pytest.approx(3.0, abs=0.1)


# Ranges and threads


@pytest.fixture
def threads():
    """Give the threads back as they were."""
    before = THREADS.count
    yield THREADS
    THREADS.use(before)


@given(cuts=st.lists(st.integers(0, 40), max_size=5), name=st.sampled_from(sorted(MANY)))
@settings(max_examples=20 if config.DISABLE_JIT else 60)
def test_ranges_change_no_bit(cuts, name):
    """Bodies and tiles one range after another, cut anywhere and the last first."""
    attraction, y = random_scene(MANY[name], 7)
    whole, parts = fields_of(attraction), fields_of(attraction)
    n_bodies, n_tiles = y.shape[1], len(whole.tile)
    load, other = np.zeros((6, n_bodies)), np.zeros((6, n_bodies))
    sums, others = np.zeros(n_tiles), np.zeros(n_tiles)
    attraction_loads(attraction, whole, y, load)
    attraction_potential(attraction, whole, 0, n_tiles, sums)
    for lo, hi in ranges(cuts, n_bodies):
        place_points(attraction, parts, y, lo, hi)
    for lo, hi in ranges(cuts, n_tiles):
        attract(attraction, parts, lo, hi)
        attraction_potential(attraction, parts, lo, hi, others)
    for lo, hi in ranges(cuts, n_bodies):
        add_attraction(attraction, parts, other, lo, hi)
    for one, another in zip(whole, parts, strict=True):
        assert (one == another).all()
    assert (load == other).all()
    assert (sums == others).all()


def test_a_range_writes_what_is_its_own_alone():
    """So that no thread writes what another one does."""
    attraction, y = random_scene([T, 3, T, 2], 8)
    fields, load, sums = fields_of(attraction), np.full((6, 4), np.nan), np.full(3, np.nan)
    for array in (fields.arm, fields.point, fields.field, fields.depth):
        array[:] = np.nan
    place_points(attraction, fields, y, 1, 3)
    own = slice(T, 2 * T + 3)
    assert written(fields.arm) == written(fields.point) == list(range(T, 2 * T + 3))
    place_points(attraction, fields, y, 0, 4)
    attract(attraction, fields, 1, 2)
    attraction_potential(attraction, fields, 1, 2, sums)
    assert written(fields.field) == written(fields.depth) == list(range(T, 2 * T))
    assert written(sums) == [1]
    load[:, 1] = fields.field[:, own] = 0.0
    add_attraction(attraction, fields, load, 1, 2)
    assert written(load) == [1]


def written(array):
    """Columns that are no longer NaN."""
    return list(np.flatnonzero(~np.isnan(array).reshape(-1, array.shape[-1]).any(axis=0)))


def ranges(cuts, n):
    """Ranges that cover 0 to n, the last one first."""
    ends = sorted({0, n, *(cut % (n + 1) for cut in cuts)})
    return list(pairwise(ends))[::-1]


@pytest.mark.compiled
def test_threads_change_no_bit(threads):
    attraction, y = random_scene([1] * 1500 + [400] * 2, 9)
    loads = [np.zeros((6, y.shape[1])) for _ in range(3)]
    attraction_loads(attraction, fields_of(attraction), y, loads[0])
    energies = []
    for count in (1, 2):
        threads.use(count)
        fields = fields_of(attraction)
        spread_loads(attraction, fields, y, loads[count])
        energies.append(potential_energy(attraction, fields, y))
    assert (loads[0] == loads[1]).all()
    assert (loads[0] == loads[2]).all()
    assert energies[0] == energies[1]


@pytest.mark.compiled
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="reads x86-64 code")
def test_targets_fill_lanes_and_meet_no_slow_instruction(make):
    """Each of three loops stands there once for lanes and twice for what is left over."""
    one = np.ones(2)
    scene = Attraction(np.zeros((3, 2)), one, one, np.array([0, 1, 2]), 1.0)
    arguments = scene, fields_of(scene), 0, 1
    attract(*arguments)
    code = make.assembly(attract, tuple(map(numba.typeof, arguments)))
    packed, single = make.arithmetic(code)
    assert packed > 0.25 * (packed + single)
    assert not re.findall(r"\bv?(?:sqrt|div)[ps]d\b", code)


# Rates


def test_two_points_go_round_each_other_at_the_fastest_rate():
    """Kepler: n² d³ = G (M_a + M_b); the nearest one decides, of equal masses."""
    gm, com = np.array([2.0, 3.0, 3.0]), np.array([[0.0, 2.0, -5.0], [0, 0, 0], [0, 0, 0]])
    rates = fastest_rates(gm, com, 0.0, np.array([0, 2]))
    assert rates == pytest.approx(np.sqrt([5.0 / 8.0, 5.0 / 125.0]), rel=1e-14)


@pytest.mark.parametrize("softening", [0.0, 0.5])
def test_fastest_rates_are_those_of_a_plain_search(softening):
    rng = np.random.default_rng(11)
    gm, com = rng.uniform(0, 9, 40), rng.standard_normal((3, 40))
    which = rng.integers(0, 40, T + 5)
    expected = []
    for a in which:
        others = np.arange(40) != a
        square = ((com[:, others] - com[:, [a]]) ** 2).sum(axis=0) + softening
        expected.append(np.sqrt((gm[a] + gm[others]) / square**1.5).max())
    rates = fastest_rates(gm, com, softening, which)
    assert rates == pytest.approx(np.array(expected), rel=1e-14)


def test_a_body_alone_has_no_rate():
    com = np.zeros((3, 1))
    assert fastest_rates(np.ones(1), com, 0.0, np.array([0])) == [0.0]
    assert fastest_rates(np.ones(1), com, 0.0, np.zeros(0, dtype=np.int64)).size == 0


@pytest.mark.compiled
def test_a_body_in_the_same_place_leaves_the_others_rate():
    """Unsoftened there is no rate at no distance: concentric shells, for instance."""
    com = np.zeros((3, 3))
    com[0, 1] = 2.0
    rates = fastest_rates(np.ones(3), com, 0.0, np.arange(3))
    assert rates == pytest.approx(np.full(3, 0.5), rel=1e-14)
