"""What ranks keep of bodies that touch: kinds of bodies, and a few numbers of each."""

import tracemalloc

import numpy as np
import pytest

from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.ranks import Ranks
from particlerb.record.layout import tables_of
from particlerb.simulation.run import prepare, share_of_rank
from particlerb.stepping.contact_part import contact_part
from particlerb.stepping.exchange import Exchange

pytestmark = pytest.mark.plain
POINTS = [[0.05, 0.05, 0.05], [0.05, -0.05, -0.05], [-0.05, 0.05, -0.05], [-0.06, -0.05, 0.05]]
CONTACT = {"law": "hooke", "stiffness": 1e3, "restitution": 0.5, "friction": 0.5}


def clumps(n, height=0.0, **more):
    """Bodies of four spheres on a grid."""
    shape = {"type": "points", "mass": 0.1, "radius": 0.1, "position": POINTS}
    place = {"type": "grid", "spacing": 0.4, "n": [n, 1, 1], "origin": [0.0, 0.0, height]}
    body = {"name": f"at{height:.0f}", "shape": shape, "count": n, "place": place}
    return body | {"orientation": "random", **more}


def prepared_scene(*body):
    run = {"t_end": 1e-3, "every": 1e-3, "dt": 1e-4, "method": "strang"}
    return prepare(to_system(load({"run": run, "body": list(body), "contact": CONTACT})))


def rank_of(number, count):
    ranks = Ranks()
    ranks.number, ranks.count = number, count
    return ranks


def flat(values):
    """All arrays of nested records."""
    if isinstance(values, tuple):
        return [array for value in values for array in flat(value)]
    return [np.asarray(values)]


def test_a_rank_keeps_little_of_bodies_that_others_show():
    """The first of two, where the second has the only part: the scene has 450 bytes a body."""
    n = 1000
    prepared_scene(clumps(8))
    tracemalloc.start()
    prepared = prepared_scene(clumps(n))
    prepared = share_of_rank(prepared, rank_of(0, 2))
    exchange = Exchange(prepared.plan.groups[0].group(prepared.plan.groups[0].segments[0]))
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert exchange.is_free.size == n
    assert kept < 40.0 * n + 60e3


def test_bodies_made_of_their_kinds_are_those_of_the_scene():
    """Of two tables with the same shape, one held, and one in which each has its own mass."""
    masses = {"mass": [0.1, 0.2, 0.1, 0.3, 0.2]}
    whole = prepared_scene(clumps(4), clumps(3, 1.0, fixed=True), clumps(5, 2.0, **masses))
    group = whole.plan.groups[0]
    shown = share_of_rank(whole, rank_of(1, 2)).plan.groups[0]
    exchange = Exchange(shown.group(shown.segments[0]))
    assert exchange.group.bodies.mass.size == 5
    for chosen in (np.arange(12), np.array([1, 5, 8, 9, 11])):
        expected, numbers = contact_part(group.group(group.segments[0]), chosen)
        found, _ = contact_part(exchange.group, chosen, exchange.kind)
        assert all(
            a.tobytes() == b.tobytes()
            for a, b in zip(flat(found[:3]), flat(expected[:3]), strict=True)
            if a.dtype != object
        )
        rows = np.concatenate([np.arange(*exchange.offset[b : b + 2]) for b in chosen])
        assert np.array_equal(rows, numbers)


def test_tables_of_the_scene_are_made_on_a_rank_that_shows_none():
    whole = prepared_scene(clumps(4), clumps(5, 2.0, mass=[0.1, 0.2, 0.1, 0.3, 0.2]))
    share = share_of_rank(whole, rank_of(0, 2))
    assert not share.system.n_bodies
    expected = tables_of(whole.system)
    for path, values in tables_of(share.system).items():
        assert np.array_equal(values, expected[path]), path
