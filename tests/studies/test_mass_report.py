"""What the `mass` command says of a body: every number in full, and what it is worth."""

import math

import numpy as np
import pytest

from particlerb.case.matter import Matter, matter_of_spheres
from particlerb.geometry import shapes
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.overlapping_spheres import spheres
from particlerb.geometry.particles import one_kind
from particlerb.studies.mass_report import record_of, text_of

CENTRE, RADIUS = np.array([[0.0, 0, 0], [0.5, 0, 0]]), np.array([1.0, 1.0])


def potato():
    rng = np.random.default_rng(9)
    return one_kind(rng.normal(size=(12, 3)), rng.random(12), rng.random(12))


def test_text_states_every_number_in_full():
    found = mass_properties(potato())
    text = text_of(record_of("potato", found, 0, 12, Matter()))
    numbers = [found.mass[0], *found.com[0], *found.inertia_tensor[0].flat, *found.moments[0]]
    assert all(repr(float(number)) in text for number in numbers)
    assert "potato: 12 particles" in text
    assert all(unit in text for unit in (" kg\n", " m\n", " kg m²"))
    assert "volume" not in text


def test_tensor_about_the_origin_is_the_sum_over_particles_there():
    particles = potato()
    record = record_of("potato", mass_properties(particles), 0, 12, Matter())
    x, m = particles.position, particles.mass
    solid = 0.4 * m @ particles.radius**2
    expected = (m @ (x * x).sum(axis=1) + solid) * np.eye(3) - (x.T * m) @ x
    assert np.abs(record["inertia_about_origin"] - expected).max() < 1e-14 * np.trace(expected)


def test_plain_sum_of_spheres_beside_their_union():
    """Two unit balls half a radius apart: the lens of height 3/2 counts twice."""
    properties = mass_properties(spheres(CENTRE, RADIUS, density=2.0))
    record = record_of("pair", properties, 0, 8, matter_of_spheres(CENTRE, RADIUS))
    lens = math.pi * (4 + 0.5) * (2 - 0.5) ** 2 / 12
    union = 8 * math.pi / 3 - lens
    assert record["volume"] == pytest.approx(union, rel=1e-14)
    assert record["density"] == pytest.approx(2.0, rel=1e-14)
    assert record["plain_sum"]["mass"] == pytest.approx(16 * math.pi / 3, rel=1e-14)
    assert record["plain_sum"]["mass_per_cent"] == pytest.approx(100 * lens / union, rel=1e-12)
    text = text_of(record)
    assert f"mass {100 * lens / union:+.3g} %" in text
    assert "overlaps counted twice" in text


def test_a_body_taken_as_a_sum_says_what_it_adds():
    properties = mass_properties(spheres(CENTRE, RADIUS, density=2.0, overlap="sum"))
    record = record_of("pair", properties, 0, 2, matter_of_spheres(CENTRE, RADIUS, as_sum=True))
    assert record["mass"] == pytest.approx(record["plain_sum"]["mass"], rel=1e-14)
    assert record["plain_sum"]["mass_per_cent"] > 10.0


def test_the_step_follows_the_spin():
    found = mass_properties(shapes.box([1, 2, 3], 1.0, 2))
    record = record_of("box", found, 0, 8, Matter(6.0), spin=20.0, radians_per_step=0.05)
    assert record["advised_step"] == 0.05 / 20.0
    assert "0.0025 s for 20 rad/s" in text_of(record)
    assert record_of("box", found, 0, 8, Matter(6.0))["advised_step"] is None


def test_the_error_grows_with_the_offset_as_coordinates_lose_digits():
    near = shapes.box([1, 2, 3], 1.0, 4)
    far = near._replace(position=near.position + 1e6)
    errors = [record_of("b", mass_properties(p), 0, 64, Matter())["error"] for p in (near, far)]
    lost = np.abs(
        mass_properties(far).inertia_tensor - mass_properties(near).inertia_tensor
    ).max() / np.trace(mass_properties(near).inertia_tensor[0])
    assert errors[0] < 1e-15
    assert lost < errors[1] < 1e-8


def test_a_point_has_no_extent_and_a_small_error():
    record = record_of("p", mass_properties(one_kind([[1, 2, 3]], 2.0)), 0, 1, Matter())
    assert "no extent" in text_of(record)
    assert record["error"] < 1e-15


@pytest.mark.parametrize(
    ("moments", "message"),
    [
        ([1.0, 2.0, 3.5], r"egg: principal moments 1\.0, 2\.0, 3\.5 kg m²: I1 \+ I2 − I3 = -0\.5"),
        ([-0.25, 2.0, 3.5], r"egg: principal moments -0\.25, 2\.0, 3\.5 kg m²: one is negative"),
    ],
)
def test_a_body_that_cannot_exist_is_refused_in_full_precision(moments, message):
    found = mass_properties(shapes.box([1, 2, 3], 1.0, 2))._replace(moments=np.array([moments]))
    with pytest.raises(ValueError, match=message):
        record_of("egg", found, 0, 6, Matter())
