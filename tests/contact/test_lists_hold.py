"""Lists of contacts hold in long runs: the skin is bounded, a watch sees pairs that are lost."""

import numpy as np
import pytest

import particlerb
from particlerb.case.to_system import to_system
from particlerb.contact import missed_pairs as watch
from particlerb.contact.cell_grid import PairList
from particlerb.contact.missed_pairs import Watch
from particlerb.contact.sphere_search import SphereSearch
from particlerb.contact.wall_motion import PrescribedMotion, farthest_distances
from particlerb.contact.wall_search import WallSearch
from particlerb.integrators import METHODS
from particlerb.plan import group_terms
from particlerb.simulation.run import prepare
from particlerb.simulation.whole_run import RunError
from particlerb.stepping import sparse_contact as dilute
from particlerb.stepping.contact_lists import ContactLists
from particlerb.stepping.contact_motion import ContactMotion

WEIGHT = {"gravity": {"acceleration": [0.0, 0.0, -9.81]}}
NOTHING = {"gravity": {"acceleration": [0.0, 0.0, 0.0]}}


@pytest.fixture
def seen(monkeypatch):
    """Skin, and length of the list of spheres, at every new list."""
    found, make_lists = [], ContactMotion.make_lists

    def noted(motion):
        make_lists(motion)
        found.append((motion.lists.skin, motion.contact.lists.spheres.sphere.size))

    monkeypatch.setattr(ContactMotion, "make_lists", noted)
    return found


def ball_at_rest(make, steps, **motion) -> dict:
    """A ball of 1 kg on a plane, at its equilibrium within 2e-6 m."""
    ball = make.sphere(position=[0, 0, 0.0999]) | {"mass": 1.0}
    floor = make.plane() | ({"motion": motion} if motion else {})
    contact = make.hooke(1e5, 0.5, 0.5, overlap=1e-3)
    run = {"t_end": steps * 1e-4, "every": steps * 1e-4, "dt": 1e-4, "method": "strang"}
    return make.case(ball, contact=contact, wall=[floor], **WEIGHT) | {"run": run}


# How long they last


@pytest.mark.plain
@pytest.mark.parametrize("n", [1, 1000])
def test_lists_of_a_scene_at_rest_take_little_of_its_time(make, n):
    """By the table of costs no more than 2 %, or as much as 4096 steps bring with them."""
    case = ball_at_rest(make, 10)
    place = [[0.3 * k, 0, 0.0999] for k in range(n)]
    case["body"][0] |= {"count": n, "position": place}
    prepared = prepare(to_system(case))
    (group,), state = prepared.plan.groups, prepared.system.state
    motion = ContactMotion(METHODS["strang"], group.group(group.segments[0]), state, 0.0, 1e-4)
    steps = round(motion.contact.memory.valid_until / 1e-4)
    assert motion.lists.cost < 0.0201 * steps * motion.step_cost
    assert (steps > 4096) == (n == 1)


# Order


def test_no_bit_depends_on_when_lists_are_made(seen):
    """Three balls hit a fourth one after the other, the last in number first."""
    ways = np.array([[1.0, 0.1, 0.0], [-0.5, 0.8, 0.2], [-0.3, -0.9, 0.4]])
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    gaps, shape = (0.06, 0.04, 0.02), {"type": "sphere", "radius": 0.1}
    bodies = [{"name": "target", "shape": shape, "mass": 1.0, "angular_velocity": [3, 1, 2]}] + [
        {"name": f"ball{k}", "shape": shape, "mass": 1.0, "position": ((0.2 + gap) * way).tolist(),
         "velocity": (-2.0 * way).tolist()}
        for k, (gap, way) in enumerate(zip(gaps, ways, strict=True))
    ]  # fmt: skip
    law = {"law": "hooke", "stiffness": 1e4, "restitution": 0.8, "friction": 0.3}
    run = {"t_end": 0.04, "every": 0.02, "dt": 5e-4, "method": "strang"}
    ends, lists = [], []
    for skin in (0.012, 0.1):
        case = {"run": run, "contact": law | {"skin": skin}, "body": bodies}
        with particlerb.run(case) as t:
            ends.append(np.hstack([t.position[-1], t.orientation[-1], t.velocity[-1]]))
        lists.append(len(seen))
    assert lists[0] > 2 * (lists[1] - lists[0])
    assert np.array_equal(*ends)


# The skin


@pytest.mark.compiled
def test_a_ball_stays_on_a_wall_that_turns(make, seen):
    """As long as lists end because time is up, and not because something has moved."""
    case = ball_at_rest(make, 250_000, angular_velocity=[0, 0, 1.0])
    with particlerb.run(case) as t:
        assert t.position[-1, 0] == pytest.approx([0, 0, 0.1 - 9.81e-5], abs=1e-12)
    assert {skin for skin, _ in seen} == {0.06}


@pytest.mark.compiled
def test_a_skin_without_bounds_is_one_that_holds_all_pairs(make, monkeypatch, seen):
    monkeypatch.setattr(group_terms, "SKIN", 1e307)
    with particlerb.run(ball_at_rest(make, 60_000)) as t:
        assert t.position[-1, 0] == pytest.approx([0, 0, 0.1 - 9.81e-5], abs=1e-12)
    assert 0.1 < max(skin for skin, _ in seen) < 10.0


@pytest.mark.compiled
def test_the_skin_grows_while_a_ball_moves_and_stops_where_lists_last(make, seen):
    """10 m/s in steps of 1e-3 s are 41 m in the longest list, 0.4 skins."""
    case = ball_at_rest(make, 100_000)
    case["body"][0] |= {"position": [0, 0, 1.0], "velocity": [10.0, 0, 0]}
    case["run"] |= {"t_end": 100.0, "every": 100.0, "dt": 1e-3}
    case |= NOTHING
    particlerb.run(case).close()
    skins = [skin for skin, _ in seen]
    assert 0.06 < max(skins) < 1.25 * 41.0 / 0.4
    assert len(skins) < 80


@pytest.mark.compiled
def test_lists_of_two_that_come_from_far_stay_short(make, seen):
    """Of 296 spheres each: lists of all pairs would be 400 times as long as those in reach."""
    places = 0.02 * np.stack(np.meshgrid(*[np.arange(14)] * 3), axis=-1).reshape(-1, 3)
    cube = {"type": "points", "mass": 1e-3, "radius": 0.01, "position": places.tolist()}
    ends = [
        {"name": f"at {x}", "shape": cube, "position": [x, 0, 0], "velocity": [v, 0, 0]}
        for x, v in ((0.0, 1.0), (3.0, -1.0))
    ]
    case = make.case(*ends, contact=make.hooke(1e4), dt=1e-4, t_end=1.36, every=1.36, **NOTHING)
    case["run"]["method"] = "strang"
    with particlerb.run(case) as t:
        assert t.linear_momentum[-1, 0, 0] < 2.744  # they have met
    assert 0 < max(pairs for _, pairs in seen) < 1e5  # of 1.1e6


# Walls


@pytest.mark.compiled
def test_a_wall_that_turns_about_a_far_centre_is_not_missed(make):
    """At the ball it moves with 10 m/s; so an elastic ball leaves with 20 m/s."""
    ball = make.sphere(position=[0.5, 0, 0]) | {"mass": 1.0}
    arm = make.plane([1, 0, 0], "arm")
    arm["motion"] = {"angular_velocity": [0, 0, 0.1], "centre": [0, 100.0, 0]}
    contact = make.hooke(1e5, 1.0, 0.0)
    case = make.case(ball, contact=contact, wall=[arm], t_end=0.35, dt=1e-3, **NOTHING)
    case["run"]["method"] = "strang"
    with particlerb.run(case) as t:
        assert t.velocity[-1, 0] == pytest.approx([20.0, 0.0, 0.0], abs=0.2)


def test_distance_is_that_of_the_centre_at_the_time():
    motion = PrescribedMotion((3.0, 0, 0), (1.0, 0, 0), (0, 0, 2.0))
    points = np.array([[5.0, 5.5], [0.0, 0.5], [0.0, 0.0]])
    (far,) = farthest_distances([motion], 2.0, points)
    assert far == pytest.approx(np.hypot(0.5, 0.5))  # the centre is at 5


# The watch


def lose_all(monkeypatch, cls):
    """Let a search find nothing from now on."""
    none = np.zeros(0, dtype=np.int64)

    def pairs(search, points, *_):
        return PairList(none, none, np.zeros(points.shape[1] + 1, dtype=np.int64))

    monkeypatch.setattr(cls, "pairs", pairs)


@pytest.mark.compiled
@pytest.mark.parametrize("moves", [False, True])
def test_a_ball_that_no_list_holds_ends_the_run(make, monkeypatch, moves):
    lose_all(monkeypatch, WallSearch)
    case = ball_at_rest(make, 200_000, **({"angular_velocity": [0, 0, 1.0]} if moves else {}))
    with pytest.raises(RunError, match=r"body ball and wall floor overlap by .* lost this pair"):
        particlerb.run(case)


def two_that_meet(make) -> dict:
    balls = [
        make.sphere("a", position=[0, 0, 0], velocity=[1.0, 0, 0]),
        make.sphere("b", position=[0.25, 0, 0], velocity=[-1.0, 0, 0]),
    ]
    case = make.case(*balls, contact=make.hooke(1e4), t_end=0.1, dt=1e-3, **NOTHING)
    case["run"]["method"] = "strang"
    return case


def test_a_pair_that_no_list_holds_ends_the_run(make, monkeypatch):
    monkeypatch.setattr(watch, "MAX_SHARE", 1e9)
    particlerb.run(two_that_meet(make)).close()
    lose_all(monkeypatch, SphereSearch)
    with pytest.raises(RunError, match=r"at t = 0\.0\d+ s body a and body b overlap by"):
        particlerb.run(two_that_meet(make))


@pytest.mark.compiled
def test_a_list_that_is_kept_too_long_ends_the_run(make, monkeypatch):
    """The wall moves farther than is known; later lists do hold the pair."""
    monkeypatch.setattr(watch, "MAX_SHARE", 1e9)
    monkeypatch.setattr(ContactLists, "walls_ahead", lambda motion, *_: (0.05, 0.0))
    ball = make.sphere(position=[0, 0, 0.3])
    lift = make.plane(motion={"velocity": [0, 0, 5.0]})
    case = make.case(ball, contact=make.hooke(1e5), wall=[lift], t_end=0.2, dt=1e-3, **NOTHING)
    case["run"]["method"] = "strang"
    with pytest.raises(RunError, match=r"t = 0\.05 s body ball and wall floor overlap by 0\.05"):
        particlerb.run(case)


@pytest.mark.compiled
def test_a_body_that_flies_into_another_ends_the_run(make, monkeypatch):
    """One whose neighbours are not seen when the interval begins."""
    monkeypatch.setattr(watch, "MAX_SHARE", 1e9)
    monkeypatch.setattr(dilute, "LEAST_BODIES", 2)

    def nobody(motion, *_):
        return np.arange(motion.bound.size) == 2

    monkeypatch.setattr(dilute.DiluteMotion, "within_skin", nobody)
    case = two_that_meet(make)
    case["body"].append(make.sphere("far", position=[0, 9.0, 0]))
    with pytest.raises(RunError, match="body a and body b overlap by"):
        particlerb.run(case)


@pytest.mark.compiled
def test_nothing_is_lost_where_nothing_is_wrong(make, monkeypatch):
    """Clumps, edges, a wall that shakes, one that turns and a stirrer, looked at with each list."""
    monkeypatch.setattr(watch, "MAX_SHARE", 1e9)
    looks, look = [], Watch.look

    def counted(*given):
        looks.append(look(*given))
        return looks[-1]

    monkeypatch.setattr(Watch, "look", counted)
    corners = 0.05 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
    clump = {"type": "points", "mass": 0.2, "radius": 0.05, "position": corners.tolist()}
    place = {"type": "grid", "spacing": 0.28}
    swing = {"amplitude": [0, 0, 0.02], "frequency": 20.0}
    bodies = [
        {"name": "clump", "shape": clump, "count": 27, "place": place, "orientation": "random"},
        make.sphere("stirrer", 0.1, position=[0.0, 0.0, -0.55])
        | {"motion": {"angular_velocity": [0, 0, 3.0], "centre": [0.2, 0, -0.55]}},
    ]
    walls = [
        {"name": "bin", "type": "box", "lower": [-0.5] * 3, "upper": [0.5] * 3, "open": ["-z"]},
        make.plane(name="floor", point=[0, 0, -0.75], motion={"oscillation": swing}),
        {
            "name": "drum", "type": "cylinder", "centre": [0, 0, 0], "axis": [0, 0, 1],
            "radius": 0.8, "length": 1.8, "motion": {"angular_velocity": [0, 0, 2.0]},
        },
    ]  # fmt: skip
    case = make.case(*bodies, contact=make.hooke(1e4), wall=walls, t_end=0.5, dt=5e-4, **WEIGHT)
    case["run"] |= {"method": "strang", "seed": 4}
    particlerb.run(case).close()
    assert len(looks) > 20
    assert sum(one.compared for one in looks) > 1000


def test_the_watch_takes_its_share_by_counts(monkeypatch):
    rng, one, spent, work = np.random.default_rng(0), Watch(), 0.0, 0.0
    looks = 0
    for _ in range(3000):
        each = rng.uniform(1e5, 1e7)
        work += each
        if one.is_due(1000, 6, each):
            one.price = watch.price_of(1000, 6, int(rng.integers(10**6)))
            one.credit -= one.price
            spent, looks = spent + one.price, looks + 1
    assert looks > 50
    assert spent < watch.MAX_SHARE * work
    other = Watch()
    other.restore(one.saved())
    assert vars(other) == vars(one)
