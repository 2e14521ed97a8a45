"""What the `mass` command says of a body: every number in full, and what it is worth."""

import math

import numpy as np
import pytest

from particlerb.case.matter import Matter, matter_of_spheres
from particlerb.export.bodies import NamedBody
from particlerb.geometry import shapes
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.overlapping_spheres import spheres
from particlerb.geometry.particles import one_kind
from particlerb.studies.mass_report import record_of, text_of

CENTRE, RADIUS = np.array([[0.0, 0, 0], [0.5, 0, 0]]), np.array([1.0, 1.0])


def record(name, particles, matter=None, **known):
    """Of a body, with its own mass properties unless said otherwise."""
    properties = known.pop("properties", None) or mass_properties(particles)
    return record_of(NamedBody(name, particles, properties, matter or Matter(), **known))


def potato():
    rng = np.random.default_rng(9)
    return one_kind(rng.normal(size=(12, 3)), rng.random(12), rng.random(12))


def test_text_states_every_number_in_full():
    found = mass_properties(potato())
    text = text_of(record("potato", potato()))
    numbers = [found.mass[0], *found.com[0], *found.inertia_tensor[0].flat, *found.moments[0]]
    assert all(repr(float(number)) in text for number in numbers)
    assert "potato: 12 particles" in text
    assert all(unit in text for unit in (" kg\n", " m\n", " kg m²"))
    assert "volume" not in text


def test_tensor_about_the_origin_is_the_sum_over_particles_there():
    particles = potato()
    found = record("potato", particles)
    x, m = particles.position, particles.mass
    solid = 0.4 * m @ particles.radius**2
    expected = (m @ (x * x).sum(axis=1) + solid) * np.eye(3) - (x.T * m) @ x
    assert np.abs(found["inertia_about_origin"] - expected).max() < 1e-14 * np.trace(expected)


def test_plain_sum_of_spheres_beside_their_union():
    """Two unit balls half a radius apart: the lens of height 3/2 counts twice."""
    pair = spheres(CENTRE, RADIUS, density=2.0)
    found = record("pair", pair, matter_of_spheres(CENTRE, RADIUS))
    lens = math.pi * (4 + 0.5) * (2 - 0.5) ** 2 / 12
    union = 8 * math.pi / 3 - lens
    assert found["volume"] == pytest.approx(union, rel=1e-14)
    assert found["density"] == pytest.approx(2.0, rel=1e-14)
    assert found["plain_sum"]["mass"] == pytest.approx(16 * math.pi / 3, rel=1e-14)
    assert found["plain_sum"]["mass_per_cent"] == pytest.approx(100 * lens / union, rel=1e-12)
    text = text_of(found)
    assert f"mass {100 * lens / union:+.3g} %" in text
    assert "overlaps counted twice" in text


def test_a_body_taken_as_a_sum_says_what_it_adds():
    pair = spheres(CENTRE, RADIUS, density=2.0, overlap="sum")
    found = record("pair", pair, matter_of_spheres(CENTRE, RADIUS, as_sum=True))
    assert found["mass"] == pytest.approx(found["plain_sum"]["mass"], rel=1e-14)
    assert found["plain_sum"]["mass_per_cent"] > 10.0


def test_the_step_follows_the_spin():
    box = shapes.box([1, 2, 3], 1.0, 2)
    found = record("box", box, Matter(6.0), spin=20.0)
    assert found["advised_step"] == 0.05 / 20.0
    assert "0.0025 s for 20 rad/s" in text_of(found)
    assert record("box", box, Matter(6.0))["advised_step"] is None


def test_the_error_grows_with_the_offset_as_coordinates_lose_digits():
    near = shapes.box([1, 2, 3], 1.0, 4)
    far = near._replace(position=near.position + 1e6)
    errors = [record("b", p)["error"] for p in (near, far)]
    lost = np.abs(
        mass_properties(far).inertia_tensor - mass_properties(near).inertia_tensor
    ).max() / np.trace(mass_properties(near).inertia_tensor[0])
    assert errors[0] < 1e-15
    assert lost < errors[1] < 1e-8


def test_a_point_has_no_extent_and_a_small_error():
    found = record("p", one_kind([[1, 2, 3]], 2.0))
    assert "no extent" in text_of(found)
    assert found["error"] < 1e-15


@pytest.mark.parametrize(
    ("moments", "message"),
    [
        ([1.0, 2.0, 3.5], r"egg: principal moments 1\.0, 2\.0, 3\.5 kg m²: I1 \+ I2 − I3 = -0\.5"),
        ([-0.25, 2.0, 3.5], r"egg: principal moments -0\.25, 2\.0, 3\.5 kg m²: one is negative"),
    ],
)
def test_a_body_that_cannot_exist_is_refused_in_full_precision(moments, message):
    box = shapes.box([1, 2, 3], 1.0, 2)
    properties = mass_properties(box)._replace(moments=np.array([moments]))
    with pytest.raises(ValueError, match=message):
        record("egg", box, properties=properties)
