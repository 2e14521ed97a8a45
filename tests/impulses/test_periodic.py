"""A box that repeats in space, for collisions by events: closed form, conservation, refusals."""

import numpy as np
import pytest
from impulse_scenes import R, case, clump, errors, events, go, impulse, plane, sphere

import particlerb
from particlerb.case.problems import CaseError

plain = pytest.mark.plain  # compiling takes long, and shows no more


@plain
def test_two_balls_on_a_ring_exchange_their_velocities_in_closed_form():
    side, u, start = 1.5, 3.0, 0.7
    balls = [sphere("a", velocity=[1.0, 0, 0]), sphere("b", position=[start, 0, 0],
                                                        velocity=[1.0 - u, 0, 0])]  # fmt: skip
    t = go(*balls, contact=events(periodic=[side, 0.0, 0.0]), t_end=20.0, every=0.3)
    room = side - 4 * R  # of their distance, from 2 R to side - 2 R
    path = (start - 2 * R - u * t.time) % (2 * room)
    apart = np.minimum(path, 2 * room - path) + 2 * R
    middle = 0.5 * start + (1.0 - 0.5 * u) * t.time
    assert t.observable("impacts")[-1] == np.floor((20.0 * u - start + 2 * R) / room) + 1
    assert np.abs(t.position[:, 1, 0] - t.position[:, 0, 0] - apart).max() < 1e-12
    assert np.abs(t.position[:, :, 0].mean(axis=1) - middle).max() < 1e-12


def gas(n=3, side=1.7, shift=0.0, seed=4, **keys):
    """Clumps and balls in a box that repeats, of which some may be given in other images."""
    rng = np.random.default_rng(seed)
    bodies = []
    for i in range(n**3):
        x = side / n * np.array(np.unravel_index(i, (n,) * 3)) + shift * (i % 3) * side
        state = {"position": x.tolist(), "velocity": (5.0 * rng.normal(size=3)).tolist()}
        if i % 2:
            bodies.append(sphere(f"b{i}", **state))
        else:
            spin = {"angular_velocity": (2.0 * rng.normal(size=3)).tolist()}
            at = [[0.06, 0, 0], [-0.06, 0, 0], [0, 0.06, 0]]
            shape = {"type": "points", "mass": 0.5, "radius": R, "position": at}
            bodies.append({"name": f"c{i}", "shape": shape} | state | spin)
    return go(*bodies, contact=events(0.8, 0.3, periodic=[side] * 3), **keys)


@plain
def test_a_gas_in_a_box_that_repeats_keeps_its_momentum_and_counts_the_rest():
    t = gas(t_end=0.4, every=0.1)
    size = np.abs(t.linear_momentum[0]).sum()
    total = t.linear_momentum.sum(axis=1)
    assert t.observable("impacts")[-1] > 40
    assert np.abs(total - total[0]).max() < 1e-13 * size
    energy, _, angular = errors(t)
    assert energy < 1e-12 * t.energy[0]
    assert angular < 1e-13 * size * np.abs(t.position).max()
    assert t.observable("smallest_gap").min() >= -1e-14


@plain
def test_in_which_image_a_body_is_given_changes_nothing():
    one, other = (gas(shift=shift, t_end=0.15, every=0.15) for shift in (0.0, 2.0))
    assert one.observable("impacts")[-1] == other.observable("impacts")[-1] > 10
    assert np.abs(one.velocity[-1] - other.velocity[-1]).max() < 1e-9
    moved = one.position[-1] - one.position[0] - (other.position[-1] - other.position[0])
    assert np.abs(moved).max() < 1e-9


BALL = sphere(position=[0, 0, 0])
REFUSED = [
    ({"contact": impulse(periodic=[1, 1, 1])}, "contact.periodic: is for events"),
    ({"contact": events(periodic=[1, 1])}, "contact.periodic: must have 3 entries, has 2"),
    ({"contact": events(periodic=[1, 1, 1])}, "wall[0]: a box that repeats has no walls but"),
    ({"contact": events(periodic=[0.79, 0, 0])}, "each side must be 0, or 0.8 m at least"),
]


@pytest.mark.parametrize(("keys", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_what_a_box_that_repeats_cannot_be_is_refused(keys, words):
    with pytest.raises(CaseError) as error:
        go(BALL, **({"wall": [plane(point=[0, 0, -1])]} | keys))
    assert words in str(error.value)


def test_bodies_that_overlap_in_an_image_are_refused():
    balls = [clump("a", position=[0.05, 0, 0]), sphere("b", position=[5.83, 0.0, 0.1])]
    with pytest.raises(CaseError) as error:
        particlerb.run(case(*balls, contact=events(periodic=[3.0, 0, 0])))
    assert "bodies overlap at t = 0: a and b by" in str(error.value)
    assert "hint: move them apart" in str(error.value)
    assert "contact.overlap" not in str(error.value)  # which is refused for this law
