"""Pairs of bodies: which a spring ties, where and how long; who attracts, who belongs together."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.forces.links import WORLD
from particlerb.forces.spring import places
from particlerb.plan import links as pairs
from particlerb.plan import near_pairs
from particlerb.plan.case_forces import loads_of
from particlerb.plan.links import (
    Link,
    attracted,
    coincident,
    components,
    is_link,
    links_of,
    particles_of,
    tree_accuracy,
)

ROD, POINT = [1.3, 1.3, 0.0], [0.0, 0.0, 0.0]
NOBODY = np.zeros(0, dtype=np.int64)


def links(case):
    return links_of(to_system(case))


def pairs_of(link):
    return list(zip(link.body_a.tolist(), link.body_b.tolist(), strict=True))


def problems(case):
    with pytest.raises(CaseError) as caught:
        links(case)
    return [(p.key, p.reason, p.hint) for p in caught.value.problems]


def row(make, n, name="bead", spacing=1.0, **keys):
    """Bodies along x from the origin."""
    position = np.outer(np.arange(n) * spacing, [1.0, 0, 0])
    return make.body(name, count=n, position=position, **keys)


# Pairs as they are named


def test_bodies_are_paired_in_the_order_in_which_they_are_named(make):
    bodies = [row(make, 4), make.body("hub", position=[0, 5, 0])]
    ties = [
        make.tie(["bead[1]", "bead[0]"], body=["bead[2]", "bead[3]"]),
        make.tie("bead", body="hub"),
        make.tie("hub", body=["bead[3]", "bead[0]"]),
        make.tie(["bead[1]", "bead[2]", "bead[3]"], body=["bead[0]", "bead[1]", "bead[2]"]),
    ]
    found = links(make.case(*bodies, force=ties))
    assert [link.number for link in found] == [0, 1, 2, 3]
    assert pairs_of(found[0]) == [(2, 1), (3, 0)]
    assert pairs_of(found[1]) == [(4, 0), (4, 1), (4, 2), (4, 3)]
    assert pairs_of(found[2]) == [(3, 4), (0, 4)]
    assert pairs_of(found[3]) == [(0, 1), (1, 2), (2, 3)]


def test_ends_and_lengths_of_a_link_are_what_the_case_says(make):
    tie = make.tie("b", 2.5, body="a", at=[0.1, 0.2, 0.3], to_at=[0, 0, 1], rest_length=0.7)
    (link,) = links(make.case(make.body("a"), make.body("b"), force=[tie]))
    assert (link.force.stiffness, link.force.damping) == (2.5, 0.0)
    assert link.at_a.T.tolist() == [[0.1, 0.2, 0.3]]
    assert link.at_b.T.tolist() == [[0.0, 0.0, 1.0]]
    assert link.rest_length.tolist() == [0.7]


def test_only_springs_between_bodies_and_damped_ones_are_links_and_others_loads(make):
    system = to_system(
        make.case(
            make.body("a"),
            make.body("b"),
            force=[
                make.spring([0, 0, 1], 1.0, body="a"),
                make.spring([0, 0, 1], 1.0, body="a", damping=0.1),
                make.tie("b", body="a"),
                make.push([1, 0, 0], body="a"),
                make.tie(body=["a", "b"], reach=1.0),
            ],
        )
    )
    assert [is_link(force) for force in system.force] == [False, True, True, False, True]
    assert [link.number for link in links_of(system)] == [1, 2, 4]
    assert [one.number for one in loads_of(system)] == [0, 3]


def test_a_damped_spring_to_the_world_has_its_anchor_at_the_other_end(make):
    spring = make.spring([0, 3.0, 4.0], 1.0, "initial", damping=0.2, body="bead")
    (link,) = links(make.case(row(make, 2), force=[spring]))
    assert link.body_a.tolist() == [0, 1]
    assert link.body_b.tolist() == [WORLD, WORLD]
    assert link.at_b.T.tolist() == [[0, 3, 4], [0, 3, 4]]
    assert link.rest_length == pytest.approx([5.0, np.sqrt(26)], abs=1e-15)


def test_an_initial_length_is_the_distance_of_the_points_as_the_bodies_lie(make):
    """|x_b + R_b r_b - x_a - R_a r_a|, in a body frame that is not the rotor frame."""
    rng = np.random.default_rng(1)
    x, q = rng.standard_normal((2, 3)), rng.standard_normal((2, 4))
    shape = {"type": "points", "position": rng.standard_normal((5, 3)), "mass": [1, 2, 3, 4, 5]}
    bodies = [
        {"name": name, "shape": shape, "position": x[k], "orientation": q[k]}
        for k, name in enumerate("ab")
    ]
    at, to_at = [0.3, -0.2, 0.5], [1.0, 0.1, 0.0]
    tie = make.tie("b", body="a", at=at, to_at=to_at, rest_length="initial")
    (link,) = links(make.case(*bodies, force=[tie]))
    there = x[1] + make.rotation(q[1]).apply(to_at)
    here = x[0] + make.rotation(q[0]).apply(at)
    assert link.rest_length == pytest.approx([np.linalg.norm(there - here)], rel=1e-15)


def test_a_body_is_not_tied_to_itself_nor_a_pair_twice(make):
    bodies = [row(make, 3), make.body("hub", position=[0, 5, 0])]
    ties = [
        make.tie("bead", body="bead"),
        make.tie(["hub", "bead"], body="hub"),
        make.tie(["hub", "hub"], body=["bead[1]", "bead[1]"]),
        make.tie(["bead[1]", "bead[0]"], body=["bead[0]", "bead[1]"]),
        make.tie("hub", body="bead", at=[1, 0, 0]),
    ]
    found = problems(make.case(*bodies, force=ties))
    assert [(key, reason) for key, reason, _ in found] == [
        ("force[0].to", "ties bead[0] to itself, and 2 more"),
        ("force[1].to", "ties hub to itself"),
        ("force[2].to", "ties bead[1] to hub twice"),
        ("force[3].to", "ties bead[1] to bead[0] twice"),
    ]
    assert "reach" in found[0][2]


def test_two_bodies_may_be_tied_both_ways_between_different_points(make):
    tie = make.tie(["b", "a"], body=["a", "b"], at=[0, 0, 0.1], to_at=[0, 0, 0.2])
    (link,) = links(make.case(make.body("a"), make.body("b", position=[1, 0, 0]), force=[tie]))
    assert pairs_of(link) == [(0, 1), (1, 0)]


# Pairs in reach


def brute(here, there, reach):
    """All pairs, one by one."""
    return {
        (i, j)
        for i, a in enumerate(here.T)
        for j, b in enumerate(there.T)
        if np.linalg.norm(a - b) <= reach
    }


@given(
    seed=st.integers(0, 2**32 - 1),
    sizes=st.tuples(st.integers(1, 30), st.integers(1, 30)),
    reach=st.floats(-3, 2),
    spread=st.sampled_from([1.0, 1e9, 1e60]),
    at_once=st.sampled_from([1, 7, 1000]),
)
@settings(max_examples=80)
def test_near_pairs_are_those_that_are_near(seed, sizes, reach, spread, at_once):
    """Also of points some of which are so far away that their cells cannot be counted."""
    rng = np.random.default_rng(seed)
    here, there = (rng.standard_normal((3, n)) for n in sizes)
    here[rng.random(here.shape) < 0.1] *= spread
    there[:, 0] = here[:, 0]
    reach = 10.0**reach
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(near_pairs, "MOST_AT_ONCE", at_once)
        found = list(near_pairs.near(here, there, reach))
    pair = [(int(i), int(j)) for some, others, _ in found for i, j in zip(some, others)]  # noqa: B905
    assert len(pair) == len(set(pair))
    assert set(pair) == brute(here, there, reach)
    for i, j, distance in found:
        true = np.linalg.norm(here[:, i] - there[:, j], axis=0)
        assert distance == pytest.approx(true, rel=1e-14)


def test_cells_are_neighbours_by_number_only_if_they_are():
    """With -1e300 to 1e300 cells between them there are as few numbers as cells, or twice that."""
    cells = np.array([6.0, 0, 0, 1, 5, -1e300, 1e300])
    assert near_pairs.numbered_cells(cells).tolist() == [7, 3, 3, 4, 6, 1, 9]


def test_reach_ties_the_neighbours_of_a_grid_at_exactly_its_spacing(make):
    """3 n² (n - 1) edges, whatever the rounding of places such as 0.1 · 3."""
    grid = {"type": "grid", "spacing": 0.1, "n": [5, 5, 5], "origin": [0.7, -0.3, 11.1]}
    tie = make.tie(body="bead", reach=0.1, rest_length="initial")
    (link,) = links(make.case(make.body("bead", count=125, place=grid), force=[tie]))
    assert link.body_a.size == 300
    assert (link.body_a < link.body_b).all()
    assert link.rest_length == pytest.approx(0.1, abs=1e-14)
    assert pairs_of(link) == sorted(set(pairs_of(link)))


def test_reach_without_to_ties_each_two_once_if_their_points_are_equal(make):
    def found(**keys):
        (link,) = links(make.case(row(make, 4), force=[make.tie(body="bead", **keys)]))
        return pairs_of(link)

    assert found(reach=1.5) == [(0, 1), (1, 2), (2, 3)]
    assert found(reach=1.5, at=[0, 0, 1], to_at=[0, 0, 1]) == [(0, 1), (1, 2), (2, 3)]
    # from 0.5 before one to 0.5 behind another: 0 for the body to the left, 2 for that to the right
    assert found(reach=0.5, at=[-0.5, 0, 0], to_at=[0.5, 0, 0]) == [(1, 0), (2, 1), (3, 2)]
    both = [(0, 1), (1, 0), (1, 2), (2, 1), (2, 3), (3, 2)]
    assert found(reach=1.5, at=[0, 0, 1], to_at=[0, 0, 0.5]) == both


def test_reach_with_to_ties_bodies_of_both_sides(make):
    ends = [["bead", "hub"], ["hub", "bead[0]"]]
    bodies = [row(make, 4), make.body("hub", position=[2.5, 0.5, 0])]
    (link,) = links(make.case(*bodies, force=[make.tie(ends[1], body=ends[0], reach=1.2)]))
    assert pairs_of(link) == [(1, 0), (2, 4), (3, 4)]


@pytest.mark.parametrize(("spacing", "shown"), [(1.0, "1"), (3e7, "3e+07")])
def test_a_reach_in_which_there_is_nothing_says_how_near_the_nearest_are(make, spacing, shown):
    tie = make.tie(body="bead", reach=0.25, at=[0, 0, 1], to_at=[0, 0, 1])
    found = problems(make.case(row(make, 5, spacing=spacing), force=[tie]))
    reason = f"no two points are that near: the nearest are {shown} m apart"
    assert found == [("force[0].reach", reason, "give a longer reach")]


def test_a_reach_has_another_body_to_look_for(make):
    found = problems(make.case(make.body("a"), force=[make.tie(body="a", reach=1.0)]))
    assert found[0][:2] == ("force[0].reach", "there is no other body than a to tie it to")


def test_a_reach_that_ties_everything_to_everything_is_refused_in_time(make, monkeypatch):
    monkeypatch.setattr(pairs, "MOST_SPRINGS", 100)
    found = problems(make.case(row(make, 50), force=[make.tie(body="bead", reach=99.0)]))
    assert found[0][:2] == ("force[0].reach", "ties more than 1e+02 pairs")


def test_many_bodies_have_their_neighbours_without_all_pairs(make):
    """20 000 bodies at random: each pair once, and as many as n²/2 times the volume of a ball."""
    n, reach = 20_000, 0.03
    box = {"type": "random", "lower": [0, 0, 0], "upper": [1, 1, 1]}
    tie = make.tie(body="bead", reach=reach)
    (link,) = links(make.case(make.body("bead", count=n, place=box), force=[tie]))
    expected = n * n / 2 * 4 / 3 * np.pi * reach**3 * (1 - 9 / 8 * reach)  # the walls cut it short
    assert link.body_a.size == pytest.approx(expected, rel=0.02)
    assert len(set(pairs_of(link))) == link.body_a.size


# Bodies that cannot turn


@pytest.mark.parametrize(
    ("inertia", "hint"),
    [(ROD, "act at a point of the rod's axis"), (POINT, "act at the centre of mass")],
)
def test_ends_that_would_turn_what_cannot_turn_are_errors(make, inertia, hint):
    bodies = [make.body("a"), make.body("thing", inertia, position=[1, 0, 0])]
    ties = [
        make.tie("thing", body="a", to_at=[0.1, 0, 0]),
        make.tie("a", body="thing", at=[0.1, 0, 0]),
        make.spring([0, 0, 1.0], 2.0, 0.0, [0.1, 0, 0], body="thing", damping=1.0),
        make.tie("thing", body="a", at=[0.1, 0, 0]),
    ]
    found = problems(make.case(*bodies, force=ties))
    keys = ["force[0].to_at", "force[1].at", "force[2].at"]
    assert [(key, words) for key, _, words in found] == [(key, hint) for key in keys]
    assert all(
        "thing is a" in reason and reason.endswith("this spring would") for _, reason, _ in found
    )


def test_a_spring_may_act_on_the_axis_of_a_rod(make):
    bodies = [make.body("a"), make.body("thing", ROD, position=[1, 0, 0])]
    ties = [make.tie("thing", body="a", to_at=[0, 0, 0.3])]
    assert len(links(make.case(*bodies, force=ties))) == 1


# Attraction


def test_all_bodies_attract_each_other_or_those_that_are_named(make):
    bodies = [row(make, 3), make.body("hub", position=[0, 5, 0])]
    assert attracted(to_system(make.case(*bodies))).tolist() == []
    assert attracted(to_system(make.case(*bodies, attraction={}))).tolist() == [0, 1, 2, 3]
    some = {"body": ["hub", "bead[1]"]}
    assert attracted(to_system(make.case(*bodies, attraction=some))).tolist() == [1, 3]


def test_a_tree_is_as_accurate_as_asked_or_ten_times_as_the_run(make):
    def accuracy(attraction, **run):
        return tree_accuracy(to_system(make.case(row(make, 2), attraction=attraction, **run)))

    assert accuracy({}) == 1e-4
    assert accuracy({}, accuracy=1e-3) == pytest.approx(1e-4)
    assert accuracy({"accuracy": 1e-2}, accuracy=1e-3) == 1e-2


def test_particles_of_bodies_are_where_their_bodies_have_put_them(make):
    shapes = [{"type": "box", "size": [1, 2, 3], "n": [1, 2, 3]}, {"type": "rod", "length": 2}]
    q = [0.5, 0.5, -0.5, 0.5]
    bodies = [
        {"name": "a", "shape": shapes[0], "mass": 1, "position": [9, 0, 0]},
        {"name": "b", "shape": shapes[1], "mass": 1, "position": [0, 9, 0], "orientation": q},
        {"name": "c", "shape": shapes[0], "mass": 1, "position": [0, 0, 9], "orientation": q},
    ]
    system = to_system(make.case(*bodies))
    index, owner = particles_of(system, np.array([1, 2]))
    assert owner.tolist() == [0] * 10 + [1] * 6
    own = system.particles.position[index]
    expected = make.rotation(q).apply(own) + np.array([[0, 9, 0]] * 10 + [[0, 0, 9]] * 6)
    found = places(system, owner + 1, own.T).T
    assert found == pytest.approx(expected, abs=1e-14)


def meeting(make, **attraction):
    """Two boxes of which one corner is at one place, and a massless particle at another."""
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    shape = {"type": "points", "position": corners, "mass": [1] * 8}
    first = {"name": "a", "shape": shape}
    second = {"name": "b", "shape": shape, "position": [2, 2, -2]}
    contact = {"type": "points", "position": [[0, 0, 0]] * 2, "mass": [0, 1], "radius": [1, 0]}
    third = {"name": "c", "shape": contact, "position": [9, 9, 9]}
    return make.case(first, second, third, attraction=attraction)


def test_particles_of_two_bodies_at_one_place_need_a_softening(make):
    system = to_system(meeting(make))
    (problem,) = coincident(system)
    assert problem.key == "attraction"
    assert "a and b each have a particle at [1, 1, -1] m" in problem.reason
    assert "softening" in problem.hint
    for attraction in ({"softening": 0.1}, {"body": ["a", "c"]}):
        assert coincident(to_system(meeting(make, **attraction))) == []
    assert coincident(to_system(make.case(make.body()))) == []


def test_particles_of_one_body_and_those_without_mass_may_be_at_one_place(make):
    shape = {"type": "points", "position": [[0, 0, 0]] * 2, "mass": [1, 0], "radius": [0, 1]}
    shell = {"type": "points", "position": [[0, 0, 0], [1, 0, 0]], "mass": [0, 1], "radius": [1, 0]}
    bodies = [
        {"name": "a", "shape": shape},
        {"name": "b", "shape": shell, "position": [1, 0, 0]},
    ]
    assert coincident(to_system(make.case(*bodies, attraction={}))) == []


# Who belongs together


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 60),
    springs=st.integers(0, 60),
    heavy=st.integers(0, 5),
)
@settings(max_examples=80)
def test_components_are_those_of_the_graph(seed, n, springs, heavy):
    rng = np.random.default_rng(seed)
    first, second = rng.integers(0, n, (2, springs))
    second = np.where(rng.random(springs) < 0.2, WORLD, second)
    heavy = np.unique(rng.integers(0, n, heavy))
    parts = [
        (first[: springs // 2], second[: springs // 2]),
        (first[springs // 2 :], second[springs // 2 :]),
    ]
    made_of = [Link(k, None, a, b, None, None, None) for k, (a, b) in enumerate(parts)]
    label = components(n, made_of, heavy)
    a, b = first[second != WORLD], second[second != WORLD]
    a, b = np.concatenate([a, heavy[1:]]), np.concatenate([b, np.full(heavy[1:].size, heavy[:1])])
    _, true = connected_components(coo_matrix((np.ones(a.size), (a, b)), (n, n)), directed=False)
    smallest = np.array([np.flatnonzero(true == k)[0] for k in true])
    assert (label == smallest).all()


@pytest.mark.parametrize("order", ["along", "against", "at random", "a star"])
def test_components_of_a_long_chain_need_few_rounds(order):
    """100 000 bodies; labels that went from neighbour to neighbour would take as many rounds."""
    n = 100_000
    link = np.arange(n - 1)
    if order == "a star":
        first, second = np.full(n - 1, n - 1), link
    else:
        first, second = (link, link + 1) if order == "along" else (link[::-1] + 1, link[::-1])
    if order == "at random":
        number = np.random.default_rng(2).permutation(n)
        first, second = number[first], number[second]
    assert not components(n, [Link(0, None, first, second, None, None, None)], NOBODY).any()
