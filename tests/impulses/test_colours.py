"""Contacts in colours: threads share a solve with the same bits, and it is as good as in order."""

import numpy as np
import pytest
from impulse_scenes import (
    DOWN,
    STATE,
    R,
    assert_alike,
    assert_goes_on_alike,
    clump,
    go,
    impulse,
    plane,
    sphere,
    weightless,
)
from test_going_on import heap
from test_impacts import converging

from particlerb.impulses import records
from particlerb.impulses.colours import put_in_colours
from particlerb.impulses.order import room_for_newton
from particlerb.impulses.records import CHUNK, TALLY, Impulses, room_for_partners, room_for_rows

plain = pytest.mark.plain


@pytest.fixture
def few(monkeypatch):
    """Colours from one contact on."""
    monkeypatch.setattr(records, "MIN_COLOURED", 1)


@plain
@pytest.mark.parametrize(("least", "hub"), [(1, 0), (300, 0), (1, 300), (10_000, 0)])
def test_contacts_of_a_colour_share_no_body_that_moves(monkeypatch, least, hub):
    """600 contacts of 100 bodies and one that is held; some of one body more than colours."""
    monkeypatch.setattr(records, "MIN_COLOURED", least)
    n, m, rng = 100, 600, np.random.default_rng(2)
    partners, rows = room_for_partners(n + 1), room_for_rows(m)
    partners.inverse[:n, 0] = 1.0
    first = rng.integers(0, n, m)
    second = (first + rng.integers(1, n + 1, m)) % (n + 1)
    first[:hub], second[:hub] = 7, np.where(second[:hub] == 7, 8, second[:hub])
    rows.partner_a[:], rows.partner_b[:], rows.entry[:] = first, second, np.arange(m)
    none = np.zeros(0, dtype=np.int64)
    newton = room_for_newton(np.zeros(0, dtype=np.bool_), none, none, 0)
    put_in_colours(Impulses(None, partners, rows, np.array([m, -1]), np.zeros(TALLY), newton))
    colours, count = rows.colours, rows.colours.counts[0]
    assert sorted(rows.entry) == list(range(m))
    assert (rows.partner_a == first[rows.entry]).all()
    assert (rows.partner_b == second[rows.entry]).all()
    chunk = colours.chunk[: count + 1]
    ends = colours.row[: chunk[-1] + 1]
    assert ends[[0, -1]].tolist() == [0, m]
    assert (np.diff(ends) > 0).all()
    for i in range(count):
        within = slice(ends[chunk[i]], ends[chunk[i + 1]])
        held = np.append(rows.partner_a[within], rows.partner_b[within])
        moving = held[held < n]
        if np.unique(moving).size < moving.size:  # the last one: one thread takes it
            assert (i, chunk[i + 1] - chunk[i]) == (count - 1, 1)
        else:
            assert np.diff(ends[chunk[i] : chunk[i + 1] + 1]).max() <= CHUNK
        assert i == count - 1 or 80 * (within.stop - within.start) >= least
    assert count == 1 if least == 10_000 else count > 10


MOVED = sphere("moved", radius=0.5, position=[3.4, 0, 0.6], motion={"velocity": [-1.0, 0, 0]})
KEYS = {"wall": [plane(motion={"angular_velocity": [0, 0, 0.5]})], "gravity": DOWN, "dt": 5e-3,
        "contact": impulse(0.2, 0.4, rolling_friction=0.05)}  # fmt: skip
SHOWN = "energy_error", "work", "push_out_work", "impulse_residual"


@pytest.mark.compiled
def test_any_number_of_threads_has_the_same_bits(monkeypatch):
    """A heap whose contacts have colours moves otherwise than by the order of its list.

    It falls and rolls on a plane that turns, and a ball is moved into it.
    """
    place = {"type": "grid", "spacing": 0.56, "n": [10, 10, 10], "origin": [0, 0, 3.1]}
    heap = clump("c", count=1000, place=place, orientation="random", velocity=[0, 0, -4.0])
    scene, keys = (heap, MOVED), KEYS | {"t_end": 0.5, "every": 0.25}
    in_order = go(*scene, threads=1, **keys)
    monkeypatch.setattr(records, "MIN_COLOURED", 500)
    one, *others = (go(*scene, threads=n, **keys) for n in (1, 2, 3, 4))
    for other in others:
        assert_alike(one, other)
        assert_alike(one, other, SHOWN)
    assert (one.position[-1] != in_order.position[-1]).any()
    assert one.observable("push_out_work")[-1] != 0.0


@pytest.mark.compiled
def test_threads_share_contacts_of_one_colour(monkeypatch):
    """Balls that slide until they roll, and do not touch each other."""
    monkeypatch.setattr(records, "MIN_COLOURED", 500)
    place = {"type": "grid", "spacing": 3 * R, "n": [30, 20, 1], "origin": [0, 0, R]}
    balls = sphere("b", count=600, place=place, velocity={"random": 1.0})
    scene = balls, MOVED | {"position": [99, 0, 0.6]}
    one, two = (go(*scene, threads=n, t_end=0.1, every=0.05, **KEYS) for n in (1, 2))
    assert_alike(one, two)
    assert_alike(one, two, SHOWN)


@plain
def test_a_run_with_colours_that_is_resumed_has_the_same_bits(few, tmp_path):
    assert_goes_on_alike(heap(), 0.2, tmp_path / "part.h5", (*STATE, "energy_error", "work"))


@plain
def test_clumps_that_meet_keep_their_momenta(few):
    contact = impulse(0.5, 0.5, push_out=0.0, tolerance=1e-6)
    t = weightless(*converging(), contact=contact, dt=2e-3, t_end=0.4, every=2e-3)
    P, L = t.observable("linear_momentum"), t.observable("angular_momentum")
    sizes = t.momentum_sizes()
    assert np.abs(P - P[0]).max() < 1e-13 * sizes[0]
    assert np.abs(L - L[0]).max() < 1e-13 * sizes[1]
    assert np.diff(t.energy).max() < 1e-13 * t.energy[0]


@plain
def test_sweeps_by_colours_come_as_near_as_by_the_order_of_the_list(monkeypatch):
    """A pyramid of 30 balls, from impulses of zero; friction and rolling friction."""
    balls, up = [], 2 * R / 2**0.5
    for layer in range(4):
        for i, j in np.ndindex(4 - layer, 4 - layer):
            at = [2 * R * (i + 0.5 * layer), 2 * R * (j + 0.5 * layer), R + up * layer]
            balls.append(sphere(f"b{len(balls)}", position=at))
    np.random.default_rng(5).shuffle(balls)  # none of a lucky order
    contact = impulse(0.0, 0.5, rolling_friction=0.1, tolerance=1e-13, solver="sweeps")
    keys = {"wall": [plane()], "gravity": DOWN, "dt": 5e-3, "t_end": 5e-3, "every": 5e-3}

    def left(sweeps):
        t = go(*balls, contact=contact | {"iterations": sweeps, "overlap": 1e-12}, **keys)
        return t.observable("impulse_residual")[-1]

    in_order = left(20), left(60)
    monkeypatch.setattr(records, "MIN_COLOURED", 1)
    by_colours = left(20), left(60)
    assert by_colours[0] < 1.5 * in_order[0]
    assert by_colours[1] < 1.5 * in_order[1] < 0.1 * in_order[0]
