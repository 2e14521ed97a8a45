"""Neighbours against all pairs, lists of contacts, and how far a body may move before a new list.

Units are of 1024 spheres; in plain Python of 16, so that a few spheres cover several.
"""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import particlerb
from particlerb.case.problems import CaseError
from particlerb.compiled.jit import config
from particlerb.compiled.threads import THREADS
from particlerb.contact import cell_grid, sphere_search
from particlerb.contact.interior_spheres import outer_spheres
from particlerb.contact.neighbour_list import (
    N_SHELLS,
    SHELL_GAPS,
    ContactHistory,
    find_shells,
    has_moved,
    incidence,
    order_contacts,
)
from particlerb.contact.sphere_search import (
    PairList,
    SphereSearch,
    levels_of,
    modular_strides,
    neighbours,
)
from particlerb.plan import contact_rules
from particlerb.simulation.whole_run import RunError
from particlerb.stepping import contact_lists

PLAIN = bool(config.DISABLE_JIT)
N = 60 if PLAIN else 4000
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(autouse=True, scope="module")
def small_units():
    """In plain Python, where the size is no constant of the compiled code."""
    with pytest.MonkeyPatch.context() as patch:
        if PLAIN:
            for module in (cell_grid, sphere_search):
                patch.setattr(module, "UNIT", 16)
        yield


@pytest.fixture
def threads():
    """Threads that also take little work, as many as asked for; as before afterwards."""
    before = THREADS.count
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("particlerb.compiled.threads.LEAST_WORK", 0)
        yield THREADS.use
    THREADS.use(before)


def random_place(rng, n):
    return rng.uniform(0.0, n ** (1 / 3), (3, n))


def clustered_place(rng, n):
    """Dense heaps, empty space between: far more cells than spheres."""
    centre = 1e3 * rng.standard_normal((3, 10))
    return centre[:, rng.integers(0, 10, n)] + random_place(rng, n) / 3


def sheared_place(rng, n):
    """A thin slanted layer: its box is nearly empty."""
    u = rng.uniform(0.0, 1.5 * np.sqrt(n), (2, n))
    return np.stack([u[0], u[1], u[0] + 3 * u[1] + rng.uniform(0, 0.5, n)])


def one_lost_place(rng, n):
    place = random_place(rng, n)
    place[:, n // 2] = [1e9, -1e8, 3e9]
    return place


def lattice_place(rng, n):
    """Pairs of spheres on a sparse lattice with a step that is a power of two."""
    k = np.arange(n) // 2
    edge = int(np.ceil(n ** (1 / 3)))
    place = 64.0 * np.stack([k % edge, k // edge % edge, k // edge**2])
    return place + rng.uniform(0.0, 0.6, (3, n))


PLACES = [random_place, clustered_place, sheared_place, one_lost_place, lattice_place]


def equal_radius(rng, n):
    return np.full(n, 0.5)


def near_radius(rng, n):
    return rng.uniform(0.3, 0.6, n)


def unequal_radius(rng, n):
    """From points to spheres as large as a thousand others, few of them."""
    return 0.2 * np.minimum(rng.pareto(2.0, n), 40.0)


RADII = [equal_radius, near_radius, unequal_radius]


def bodies(rng, n, most=8):
    """Body of each sphere, ascending: runs of 1 to `most`."""
    return np.repeat(np.arange(n), rng.integers(1, most + 1, n))[:n]


def all_pairs(points, radius, body, skin):
    """Set of pairs (lower, higher) by the definition, a row at a time."""
    found = set()
    for i in range(radius.size):
        d = points[:, i + 1 :] - points[:, i, None]
        is_near = (d * d).sum(axis=0) < (radius[i] + radius[i + 1 :] + skin) ** 2
        j = i + 1 + np.flatnonzero(is_near & (body[i + 1 :] != body[i]))
        found |= {(i, int(k)) for k in j}
    return found


def as_set(pairs):
    lower, higher = np.minimum(pairs.sphere, pairs.other), np.maximum(pairs.sphere, pairs.other)
    found = set(zip(lower.tolist(), higher.tolist(), strict=True))
    assert len(found) == pairs.sphere.size, "a pair is there twice"
    return found


# Neighbours


@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("place", PLACES)
def test_neighbours_are_those_of_all_pairs(place, radius):
    rng = np.random.default_rng(5)
    x, r, body = place(rng, N), radius(rng, N), bodies(rng, N)
    expected = all_pairs(x, r, body, 0.1)
    assert expected
    assert as_set(neighbours(x, r, body, 0.1)) == expected


@settings(max_examples=20 if PLAIN else 200)
@given(seeds, st.sampled_from(PLACES), st.sampled_from(RADII), st.floats(0.0, 1.0))
def test_neighbours_of_few_are_those_of_all_pairs(seed, place, radius, skin):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    x, r, body = place(rng, n), radius(rng, n), bodies(rng, n)
    assert as_set(neighbours(x, r, body, skin)) == all_pairs(x, r, body, skin)


def test_pairs_are_sorted_and_the_finer_one_is_the_first():
    rng = np.random.default_rng(1)
    n = 400
    x, r, body = random_place(rng, n), unequal_radius(rng, n), bodies(rng, n)
    first, second, start = neighbours(x, r, body, 0.5)
    assert (np.diff(n * first + second) > 0).all()
    assert (start == np.searchsorted(first, np.arange(n + 1))).all()
    level = levels_of(r)
    finer = (level[first] < level[second]) | ((level[first] == level[second]) & (first < second))
    assert finer.all()


@given(st.lists(st.just(0.0) | st.floats(1e-9, 1e3), min_size=1, max_size=30))
def test_radii_on_a_level_are_within_a_factor_of_two(radii):
    r = np.array(radii)
    level = levels_of(r)
    assert np.unique(level).tolist() == list(range(level.max() + 1))
    assert (level[np.argsort(r)] == np.sort(level)).all()
    for k in range(1, level.max() + 1):
        assert r[level == k].max() <= 2.0 * r[level == k].min()


def test_spheres_of_nothing_but_points_have_neighbours():
    x = np.array([[0.0, 0.4, 5.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    assert as_set(neighbours(x, np.zeros(3), np.arange(3), 0.5)) == {(0, 1)}
    assert not as_set(neighbours(x, np.zeros(3), np.arange(3), 0.0))


@pytest.mark.parametrize(("far", "skin"), [(1.0, 0.1), (1e9, 0.1), (0.0, 0.0)])
def test_bodies_of_other_worlds_are_no_neighbours(far, skin):
    """Three worlds in one place, wherever that is: each has the pairs that it has alone."""
    rng = np.random.default_rng(4)
    x, world = np.tile(rng.uniform(-0.5, 0.5, (3, 30)) + far, 3), np.arange(30) // 10
    x[0] = x[0, 0] if far == 0.0 else x[0]
    r, body = np.tile(rng.uniform(0.05, 0.2, 30), 3), np.arange(90) // 3
    alone = as_set(neighbours(x[:, :30], r[:30], body[:30], skin))
    expected = {(i + 30 * w, j + 30 * w) for i, j in alone for w in range(3)}
    found = as_set(neighbours(x, r, body, skin, world=world))
    assert expected <= found if far > 1.0 else expected == found
    assert all(i // 30 == j // 30 for i, j in found)


def test_no_and_one_sphere_have_no_neighbours():
    for n in (0, 1):
        pairs = neighbours(np.ones((3, n)), np.ones(n), np.zeros(n, dtype=np.int64), 0.1)
        assert pairs.sphere.size == 0
        assert pairs.start.tolist() == [0] * (n + 1)


def test_all_spheres_in_one_place_are_all_neighbours():
    n = 40
    pairs = neighbours(np.zeros((3, n)), np.ones(n), np.arange(n) // 4, 0.0)
    assert pairs.sphere.size == n * (n - 4) // 2


def test_a_chosen_part_has_only_pairs_of_its_own():
    rng = np.random.default_rng(2)
    x, r, body = random_place(rng, N), near_radius(rng, N), bodies(rng, N)
    which = np.flatnonzero(rng.random(N) < 0.4)
    search = SphereSearch(r, body)
    search.pairs(x, 0.1)  # what is left in the room must not show
    expected = {(i, j) for i, j in all_pairs(x, r, body, 0.1) if {i, j} <= set(which.tolist())}
    assert as_set(search.pairs(x, 0.1, which)) == expected


def test_a_list_lasts_until_the_call_after_the_next_one():
    rng = np.random.default_rng(3)
    r, body = equal_radius(rng, N), bodies(rng, N)
    search = SphereSearch(r, body)
    search.pairs(random_place(rng, N), 0.3)
    old = search.pairs(random_place(rng, N), 0.3)
    kept = [part.copy() for part in old]
    search.pairs(random_place(rng, N), 0.3)
    assert all((a == b).all() for a, b in zip(old, kept, strict=True))


def test_pairs_are_the_same_for_any_number_of_threads(threads):
    rng = np.random.default_rng(4)
    x, r, body = random_place(rng, 5 * N), unequal_radius(rng, 5 * N), bodies(rng, 5 * N)
    found = []
    for count in (1, 2, 3):
        threads(count)
        found.append(neighbours(x, r, body, 0.1))
    for other in found[1:]:
        assert all((a == b).all() for a, b in zip(found[0], other, strict=True))


def test_a_place_that_is_not_finite_is_an_error():
    for wrong in (np.nan, np.inf):
        x = np.zeros((3, 5))
        x[1, 2] = wrong
        with pytest.raises(FloatingPointError, match="not finite"):
            neighbours(x, np.ones(5), np.arange(5), 0.1)


@pytest.mark.parametrize("least", [64, 65, 1000, 4 * 8000 + 64, 10**6])
def test_cells_around_a_sphere_have_different_numbers(least):
    a, b, n = modular_strides(least)
    steps = np.array(list(np.ndindex(3, 3, 3))) - 1
    assert np.unique(steps @ np.array([a, b, 1]) % n).size == 27
    assert n >= least


@pytest.mark.compiled
def test_room_and_time_do_not_grow_with_empty_space():
    """Every cell holds about as many spheres of a lattice as if it had been packed densely."""
    rng = np.random.default_rng(6)
    x, r = lattice_place(rng, N), equal_radius(rng, N)
    search = SphereSearch(r, np.arange(N))
    search.pairs(x, 0.1)
    begin = search.integers["begin"]
    assert begin.size < 8 * N
    assert np.diff(begin).max() <= 16


@settings(max_examples=20 if PLAIN else 200)
@given(seeds, st.floats(0.0, 2.0))
def test_a_list_misses_no_pair_before_a_body_has_moved(seed, size):
    """While nothing has moved by half the skin, all that touch are in the list."""
    rng = np.random.default_rng(seed)
    n, skin = 12, 0.2
    arm, body = rng.uniform(-0.5, 0.5, (3, 4 * n)), np.repeat(np.arange(n), 4)
    r, y = np.full(4 * n, 0.2), np.zeros((13, n))
    y[:3] = rng.uniform(0, 2.5, (3, n))
    y[3:7] = Rotation.random(n, rng).as_quat(scalar_first=True).T
    later = y.copy()
    later[:3] += size * skin * rng.uniform(-0.5, 0.5, (3, n))
    turn = Rotation.from_rotvec(size * skin * rng.uniform(-0.6, 0.6, (n, 3)))
    q = (turn * Rotation.from_quat(y[3:7].T, scalar_first=True)).as_quat(scalar_first=True)
    later[3:7] = (q * rng.choice([-1.0, 1.0], (n, 1))).T

    def placed(y):
        R = Rotation.from_quat(y[3:7].T[body], scalar_first=True)
        return y[:3, body] + R.apply(arm.T).T

    reach = np.zeros(n)
    np.maximum.at(reach, body, np.linalg.norm(arm, axis=0))
    way = np.linalg.norm(placed(later) - placed(y), axis=0)
    if not has_moved(y, later, reach, skin / 2):
        assert way.max() <= skin / 2 * (1 + 1e-9)
        listed = as_set(neighbours(placed(y), r, body, skin))
        assert all_pairs(placed(later), r, body, 0.0) <= listed
    assert not has_moved(y, later, reach, 3.0 * way.max() + 1.0)


@pytest.mark.parametrize(("angle", "expected"), [(0.1, False), (0.11, True)])
def test_motion_by_turning_is_that_of_the_farthest_point(angle, expected):
    """On a half circle around the axis: 2 sin(φ/2) reach, and no more."""
    then, now = np.zeros((13, 2)), np.zeros((13, 2))
    then[3], now[3, 0] = 1.0, 1.0
    now[3:7, 1] = -np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    assert has_moved(then, now, np.array([1.0, 2.0]), 4.0 * np.sin(0.105 / 2)) == expected


def test_what_is_not_a_number_has_moved():
    then = np.zeros((13, 1))
    then[3] = 1.0
    now = then.copy()
    now[0] = np.nan
    assert has_moved(then, now, np.ones(1), 1.0)
    assert not has_moved(then, then, np.ones(1), 0.0)


# Lists of contacts


@given(seeds)
@settings(max_examples=50)
def test_incidence_gives_each_body_its_contacts_with_their_side(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 20)), int(rng.integers(0, 60))
    first, second = rng.integers(0, n, m), rng.integers(-1, n, m)
    offset, entry = incidence(first, second, n)
    assert offset[0] == 0
    assert offset[-1] == entry.size == m + (second >= 0).sum()
    for b in range(n):
        own = entry[offset[b] : offset[b + 1]]
        contact = np.where(own < 0, ~own, own)
        assert (np.diff(contact) >= 0).all()
        assert contact[own >= 0].tolist() == np.flatnonzero(first == b).tolist()
        assert contact[own < 0].tolist() == np.flatnonzero(second == b).tolist()
    order = rng.permutation(m)
    ordered = incidence(first[order], second[order], n, np.argsort(order))
    assert np.array_equal(ordered.offset, offset)
    contact = np.where(ordered.entry < 0, ~order[~ordered.entry], order[ordered.entry])
    assert contact.tolist() == entry.tolist()


def kept_of(pairs, values, rng):
    """What pairs of the numbers keep, in rows of any order."""
    keys = np.array([(i << 32) | j for i, j in sorted(pairs)], dtype=np.int64)
    rows = rng.permutation(len(pairs))
    table = np.empty((len(pairs), 3))
    for row, pair in zip(rows, sorted(pairs), strict=True):
        table[row] = values[pair]
    return ContactHistory(keys, rows, table)


@given(seeds)
@settings(max_examples=20)
def test_shells_are_those_of_the_gaps(seed):
    rng = np.random.default_rng(seed)
    n, skin = 12, 0.8
    place = np.column_stack([rng.uniform(0, 2, (n, 3)), rng.uniform(0.1, 0.3, n)])
    first, second = np.triu_indices(n, 1)
    shell = np.empty(first.size, dtype=np.int64)
    find_shells((first, second), place, skin, shell)
    gap = np.linalg.norm(place[first, :3] - place[second, :3], axis=1)
    gap -= place[first, 3] + place[second, 3]
    expected = np.searchsorted(np.array(SHELL_GAPS) * skin, gap, side="right") - 1
    assert (shell == np.maximum(expected, 0)).all()


@given(seeds, st.booleans())
@settings(max_examples=50)
def test_a_new_list_stands_in_shells_and_has_what_the_same_pairs_kept(seed, are_walls):
    rng = np.random.default_rng(seed)
    n = 12
    number = np.sort(rng.choice(1000, n, replace=False))
    other = np.arange(n) if are_walls else number
    every = [(i, j) for i in range(n) for j in range(i + 1, n)]
    old, new = ([p for p in every if rng.random() < 0.5] for _ in range(2))
    values = {(int(number[i]), int(other[j])): rng.standard_normal(3) for i, j in old}
    before = kept_of(list(values), values, rng)
    first, second = np.array(new, dtype=np.int64).reshape(-1, 2).T.copy()
    m = len(new)
    shell = rng.integers(0, N_SHELLS, m)
    after = ContactHistory(*np.empty((2, m), dtype=np.int64), np.empty((m, 3)))
    listed = np.empty((2, m), dtype=np.int32)
    ends, keeps = np.empty(N_SHELLS, dtype=np.int64), [pair in old for pair in new]
    expected = np.where(keeps, 0, shell)
    none = np.zeros(0, dtype=np.int64)
    order_contacts((first, second), (number, other), none, shell, before, after, *listed, ends)
    order = np.argsort(expected, kind="stable")
    assert (ends == np.searchsorted(expected[order], np.arange(N_SHELLS), side="right")).all()
    assert (listed == np.array([first, second])[:, order]).all()
    assert (np.diff(after.keys) > 0).all()
    for row, (i, j) in enumerate(listed.T.tolist()):
        expected = values.get((int(number[i]), int(other[j])), np.zeros(3))
        assert (after.values[row] == expected).all()
    assert (after.values[after.rows] == after.values[np.argsort(order)]).all()


def test_contacts_of_a_sphere_and_a_wall_stand_together_in_the_nearest_shell():
    first, second = np.array([[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 3, 0]])
    shell, wall = np.array([3, 1, 2, 4, 2, 3]), np.array([0, 0, 1, 1])
    none = np.zeros(0, dtype=np.int64)
    before = ContactHistory(none, none, np.zeros((0, 3)))
    after = ContactHistory(*np.empty((2, 6), dtype=np.int64), np.empty((6, 3)))
    listed, ends = np.empty((2, 6), dtype=np.int32), np.empty(N_SHELLS, dtype=np.int64)
    number = np.arange(4)
    order_contacts((first, second), (number, number), wall, shell, before, after, *listed, ends)
    assert listed.T.tolist() == [[0, 0], [0, 1], [0, 2], [1, 3], [2, 0], [1, 1]]
    assert ends.tolist() == [0, 2, 4, 5, 6]


# Spheres that nothing can reach


def lattice(edge, spacing=1.0):
    return spacing * np.stack([k.ravel() for k in np.indices((edge,) * 3)]).astype(float)


@pytest.mark.parametrize(("radius", "smallest"), [(0.6, 0.5), (0.9, 0.0), (0.5, 0.5)])
def test_a_lattice_loses_its_interior_and_keeps_its_outside(radius, smallest):
    edge = 4 if PLAIN else 6
    x = lattice(edge)
    is_inside = ((x > 0.5) & (x < edge - 1.5)).all(axis=0)
    found = outer_spheres(x, np.full(edge**3, radius), smallest, 0.01)
    assert (found == ~is_inside).all()


def test_gaps_that_a_small_ball_passes_keep_the_interior():
    """Through the gap between four touching spheres goes a ball of (√2 - 1) r, into a lattice."""
    x, r = lattice(4), np.full(64, 0.5)
    assert outer_spheres(x, r, 0.2).all()
    assert not outer_spheres(x, r, 0.5).all()


def test_doubled_spheres_do_not_hide_each_other():
    x = np.zeros((3, 3))
    x[0, 2] = 0.1
    assert outer_spheres(x, np.array([0.5, 0.5, 0.3]), 0.1).tolist() == [True, True, False]


@settings(max_examples=10 if PLAIN else 100)
@given(seeds)
def test_no_contact_with_a_ball_from_outside_is_lost(seed):
    """Balls anywhere that are nowhere too deep: what they touch is kept."""
    rng = np.random.default_rng(seed)
    n, smallest = int(rng.integers(2, 30)), 0.1 * rng.random()
    depth = 0.2 * smallest * rng.random() + 0.005
    x, r = rng.uniform(-0.6, 0.6, (3, n)), rng.uniform(0.2, 0.6, n)
    kept = outer_spheres(x, r, smallest, depth)
    c, rho = rng.uniform(-1.5, 1.5, (3, 3000)), smallest * rng.choice([1.0, 1.5, 10.0], 3000)
    gap = np.linalg.norm(x[:, :, None] - c[:, None], axis=0) - r[:, None] - rho
    i = gap.argmin(axis=0)
    c += (rng.uniform(-1.0, 0.0, 3000) * depth - gap.min(axis=0)) * (
        (c - x[:, i]) / np.linalg.norm(c - x[:, i], axis=0)
    )
    gap = np.linalg.norm(x[:, :, None] - c[:, None], axis=0) - r[:, None] - rho
    gap = gap[:, gap.min(axis=0) >= -depth]
    assert gap.size
    assert kept[(gap < 0.0).any(axis=1)].all()


@pytest.mark.parametrize("seed", range(3))
def test_spheres_in_a_large_one_are_left_out(seed):
    rng = np.random.default_rng(seed)
    x, r = 0.5 * rng.uniform(-0.5, 0.5, (3, 30)), np.full(30, 0.2)
    x[:, 7], r[7] = 0.0, 1.0
    assert outer_spheres(x, r, 0.1, 0.01).tolist() == [k == 7 for k in range(30)]


@pytest.mark.plain
@pytest.mark.parametrize(("module", "most"), [(contact_rules, 2), (contact_lists, 3)])
def test_numbers_that_lists_cannot_hold_are_refused(make, monkeypatch, module, most):
    monkeypatch.setattr(module, "LARGEST_NUMBER", most)
    balls = make.sphere(count=3, place={"type": "grid", "spacing": 0.19})
    contact = make.hooke(1e3) | {"overlap": 0.5}
    with pytest.raises((CaseError, RunError), match="lists number"):
        particlerb.run(make.case(balls, contact=contact, dt=1e-3, t_end=2e-3, every=1e-3))


@pytest.mark.parametrize("case", ["alone", "apart", "worlds", "one that is large", "in a plane"])
def test_layers_find_the_pairs_of_all_space(monkeypatch, case):
    """In the same order: of spheres of three sizes, seven in each body."""
    rng = np.random.default_rng(3)
    n = 700
    points, radius = rng.uniform(-2.0, 2.0, (3, n)), rng.choice([0.05, 0.1, 0.2], n)
    body, apart, world = np.repeat(np.arange(n // 7), 7), np.zeros(0, dtype=np.int64), None
    if case == "apart":
        apart = np.unique(sphere_search.pair_keys(rng.integers(0, 100, 400), np.arange(400) % 100))
    if case == "worlds":
        world = np.arange(n // 7) % 3
    if case == "one that is large":
        radius[5] = 3.0
    if case == "in a plane":
        points[0] = 1.0
    expected = sphere_search.neighbours(points, radius, body, 0.07, apart, world)
    assert expected.sphere.size > 100
    monkeypatch.setattr(sphere_search, "_AT_ONCE", 64)
    found = sphere_search.neighbours(points, radius, body, 0.07, apart, world)
    for name in PairList._fields:
        assert (getattr(found, name) == getattr(expected, name)).all(), name


@pytest.mark.compiled
def test_a_search_takes_little_memory_of_many_spheres(monkeypatch):
    """At most 100 bytes a sphere beside the pairs, where one of all at once takes 216."""
    rng, n = np.random.default_rng(1), 80_000
    points = np.ascontiguousarray(rng.uniform(0.0, 20.0, (3, n)))
    radius, body = np.full(n, 0.1), np.repeat(np.arange(n // 4), 4)
    sphere_search.neighbours(points[:, :64].copy(), radius[:64], body[:64], 0.0)  # compiles
    monkeypatch.setattr(sphere_search, "_AT_ONCE", 8192)
    tracemalloc.start()
    try:
        found = sphere_search.neighbours(points, radius, body, 0.0)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 100 * n + 3 * 16 * found.sphere.size
