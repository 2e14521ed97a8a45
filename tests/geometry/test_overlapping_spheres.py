"""Unions of spheres beside closed forms, slices, and each other under rotation."""

import math

import mpmath
import numpy as np
import pytest
from naive_union import union_by_slices

from particlerb.geometry import union as union_module
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.overlapping_spheres import overlaps, plain_solid, spheres, union_solid
from particlerb.geometry.solid import UniformSolid, equimomental_points

GENERIC = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
AXIS = np.array([0.36, 0.48, 0.8])
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
GRID = np.array([[x, y, z] for x in range(3) for y in range(3) for z in range(3)], dtype=float)
HEXAGON = np.array([[math.cos(a), math.sin(a), 0] for a in np.arange(6) * math.pi / 3])
ALONG = np.array([-1, -0.5, -0.2, 0, 0.1, 0.3, 0.7, 1])
DEGENERATE = {
    "all through one circle": (np.outer(ALONG, AXIS), np.sqrt(1 + ALONG**2)),
    "collinear chain": (np.outer(np.arange(5), AXIS), np.full(5, 0.8)),
    "touching chain": (np.outer(np.arange(4), AXIS), np.full(4, 0.5)),
    "cube, all through its middle": (CUBE, np.full(8, math.sqrt(0.75))),
    "cube, through middles of faces": (CUBE, np.full(8, math.sqrt(0.5))),
    "grid, through middles of cells": (GRID, np.full(27, math.sqrt(0.75))),
    "cocircular, through the centre": (HEXAGON, np.ones(6)),
    "cocircular and its centre": (np.vstack([HEXAGON, np.zeros(3)]), np.ones(7)),
    "plane quadruple": (CUBE[CUBE[:, 2] == 0], np.full(4, 0.8)),
    "plane through a centre": (np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0.0]]), np.array([3, 5, 5])),
    "twice the same": (np.repeat(CUBE, 2, axis=0), np.full(16, 0.8)),
    "twins by one rounding": (
        np.repeat(CUBE, 3, axis=0) * (1 + 2.0**-52 * np.tile([0, 1, -1], 8)[:, None]),
        np.full(24, 0.8),
    ),
    "inside, touching": (np.outer([0, 0.5, 0.2], AXIS), np.array([1, 0.5, 0.8])),
}


def two_spheres(R, r, d):
    """Volume, com from the first along the axis, moments about axis and across: 40 digits."""
    R, r, d = mpmath.mpf(R), mpmath.mpf(r), mpmath.mpf(d)
    pieces = [(R, mpmath.mpf(0), -R, R), (r, d, d - r, d + r)]
    if abs(R - r) < d < R + r:
        cut = (d * d + R * R - r * r) / (2 * d)
        pieces = [(R, mpmath.mpf(0), -R, cut), (r, d, cut, d + r)]
    elif d <= abs(R - r):
        pieces = [max(pieces)]
    total = [mpmath.mpf(0)] * 4
    for radius, centre, low, high in pieces:
        square = [radius**2 - centre**2, 2 * centre, mpmath.mpf(-1)]  # of the disc at x
        fourth = [
            sum(square[i] * square[k - i] for i in range(3) if 0 <= k - i < 3) for k in range(5)
        ]
        for n, (polynomial, shift, factor) in enumerate(
            ((square, 0, 1), (square, 1, 1), (square, 2, 1), (fourth, 0, mpmath.mpf(1) / 4))
        ):
            for k, a in enumerate(polynomial):
                power = k + shift + 1
                total[n] += factor * mpmath.pi * a * (high**power - low**power) / power
    V, first, along, across = total
    return V, first / V, 2 * across, across + along - first**2 / V


@pytest.mark.parametrize(("R", "r"), [(1.0, 1.0), (1.0, 0.5), (0.3, 2.0)])
def test_two_spheres_at_every_distance(R, r):
    u = AXIS / np.linalg.norm(AXIS)
    special = [0.0, abs(R - r), R + r, math.sqrt(abs(R * R - r * r)), 1e-9, R + r - 1e-9]
    special.append(abs(R - r) + 1e-8)  # of one sphere almost nothing is exposed
    for d in [*np.linspace(0, 1.1 * (R + r), 23), *special]:
        with mpmath.workdps(40):
            volume, com, axial, across = two_spheres(R, r, d)
        found = union_solid([[0, 0, 0], u * d], [R, r])
        tensor = float(across) * np.eye(3) + float(axial - across) * np.outer(u, u)
        assert found.volume == pytest.approx(float(volume), rel=1e-14)
        assert np.abs(found.com - u * float(com)).max() <= 4e-15 * (R + r)
        assert np.abs(found.inertia - tensor).max() <= 1e-14 * float(across)
        assert found.error < 1e-14


@pytest.mark.parametrize("seed", range(4))
def test_spheres_in_general_position(seed):
    rng = np.random.default_rng(seed)
    n = 3 + seed
    agree(rng.uniform(-0.5, 0.5, (n, 3)), rng.uniform(0.3, 0.8, n))


@pytest.mark.compiled
@pytest.mark.parametrize("name", [name for name, (_, R) in DEGENERATE.items() if len(R) < 7])
def test_degenerate_spheres_beside_slices(name):
    centre, radius = DEGENERATE[name]
    agree(centre @ GENERIC.T, radius)


def agree(centre, radius):
    """Demand the volume, com and tensor of the slices to 1e-12."""
    V, first, second = union_by_slices(centre, radius)
    found = union_solid(centre, radius)
    com = first / V
    second = second - V * np.outer(com, com)
    tensor = np.trace(second) * np.eye(3) - second
    assert found.volume == pytest.approx(V, rel=1e-12)
    assert np.abs(found.com - com).max() < 1e-12 * np.ptp(centre)
    assert np.abs(found.inertia - tensor).max() < 1e-12 * np.trace(tensor)
    assert found.error < 1e-13


@pytest.mark.compiled
@pytest.mark.parametrize("name", DEGENERATE)
def test_degenerate_spheres_are_the_same_however_turned(name):
    centre, radius = DEGENERATE[name]
    rng = np.random.default_rng(1)
    found = []
    for _ in range(30):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        solid = union_solid(centre @ turn.T, radius)
        found.append((solid.volume, *np.linalg.eigvalsh(solid.inertia), solid.error))
    volume, *moments, error = np.array(found).T
    assert np.ptp(volume) < 1e-13 * volume[0]
    assert all(np.ptp(moment) < 2e-13 * moments[-1].max() for moment in moments)
    assert error.max() < 1e-13


def test_order_copies_and_hidden_spheres_change_nothing():
    rng = np.random.default_rng(2)
    centre, radius = rng.uniform(-0.5, 0.5, (6, 3)), rng.uniform(0.3, 0.6, 6)
    expected = union_solid(centre, radius)
    order = [3, 0, 5, 1, 1, 4, 2]
    inside = np.concatenate([centre[order], centre[:1]])
    found = union_solid(inside, np.concatenate([radius[order], [0.1]]))
    assert found.volume == pytest.approx(expected.volume, rel=1e-14)
    assert np.abs(found.inertia - expected.inertia).max() < 1e-14


@pytest.mark.parametrize("exponent", [-80, 60])
def test_any_unit_of_length(exponent):
    centre, radius = np.array([[0.0, 0, 0], [0.7, 0.1, 0.2]]), np.array([1.0, 0.6])
    one = union_solid(centre, radius)
    scaled = union_solid(np.ldexp(centre, exponent), np.ldexp(radius, exponent))
    assert scaled.volume == pytest.approx(math.ldexp(one.volume, 3 * exponent), rel=1e-15)
    assert scaled.inertia == pytest.approx(np.ldexp(one.inertia, 5 * exponent), rel=1e-14)


def test_offset_loses_no_more_than_the_coordinates():
    rng = np.random.default_rng(3)
    centre, radius = rng.uniform(-0.5, 0.5, (5, 3)), rng.uniform(0.3, 0.6, 5)
    far = centre + np.array([1e6, -2e6, 5e5])
    expected, found = union_solid(far - far[0], radius), union_solid(far, radius)
    assert found.volume == pytest.approx(expected.volume, rel=1e-14)
    assert np.abs(found.inertia - expected.inertia).max() < 1e-14 * np.trace(expected.inertia)


@pytest.mark.compiled
def test_a_thousand_spheres_close_to_rounding():
    rng = np.random.default_rng(0)
    found = union_solid(rng.random((1000, 3)), rng.uniform(0.03, 0.12, 1000))
    assert found.error < 1e-14
    # 4·10⁶ random points in the box around the same spheres give 1.0602 ± 0.0004.
    assert found.volume == pytest.approx(1.0602, abs=0.0013)


@pytest.mark.compiled
def test_threads_do_not_change_a_bit():
    rng = np.random.default_rng(0)
    centre, radius = rng.random((400, 3)), rng.uniform(0.03, 0.12, 400)
    before = union_module.THREADS.count
    found = []
    try:
        for count in (1, 2, 3):
            union_module.THREADS.use(count)
            solid = union_solid(centre, radius)
            found.append((solid.volume, solid.inertia.tobytes(), solid.com.tobytes()))
    finally:
        union_module.THREADS.use(before)
    assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("lost", [[0], [10, 11, 12], [14]])
def test_a_surface_that_does_not_close_is_part_of_the_error(monkeypatch, lost):
    """The vector area, and gaps in edges, tell of a wrong patch; its volume alone cannot."""
    patches = union_module.patches

    def spoilt(*arguments):
        patches(*arguments)
        rows = arguments[3]
        rows[0, lost] += 1e-3

    centre, radius = np.array([[0.0, 0, 0], [0.7, 0.1, 0.2]]), np.array([1.0, 0.6])
    monkeypatch.setattr(union_module, "patches", spoilt)
    error = union_solid(centre, radius).error
    assert (error > 1e-5) == (lost != [0])


# Particles


def test_particles_have_the_mass_properties_of_the_union():
    centre, radius = np.array([[0.0, 0, 0], [0.9, 0.2, -0.1], [0.3, 0.8, 0.4]]), [0.6, 0.5, 0.7]
    solid = union_solid(centre, radius)
    particles = spheres(centre, radius, density=2500.0)
    found = mass_properties(particles)
    assert found.mass[0] == pytest.approx(2500.0 * solid.volume, rel=1e-15)
    assert np.abs(found.com[0] - solid.com).max() < 1e-15
    assert np.abs(found.inertia_tensor[0] - 2500.0 * solid.inertia).max() < 1e-15 * 2500.0
    assert particles.radius[:3].tolist() == radius
    assert not particles.mass[:3].any()
    assert not particles.radius[3:].any()
    plain = plain_solid(centre, radius)
    assert plain.volume > 1.05 * solid.volume  # what the exact union corrects


def test_spheres_that_do_not_overlap_carry_their_matter():
    particles = spheres([[0, 0, 0], [1, 0, 0]], [0.25, 0.75], mass=28.0, overlap="exact")
    assert particles.mass == pytest.approx([1.0, 27.0], rel=1e-15)
    assert particles.radius.tolist() == [0.25, 0.75]


def test_sum_counts_overlaps_twice_as_other_codes_do():
    particles = spheres([[0, 0, 0], [0.5, 0, 0]], 1.0, density=3.0, overlap="sum")
    assert particles.mass == pytest.approx([4 * math.pi] * 2, rel=1e-15)
    found, plain = mass_properties(particles), plain_solid([[0, 0, 0], [0.5, 0, 0]], 1.0)
    assert found.inertia_tensor[0] == pytest.approx(3.0 * plain.inertia, rel=1e-14)


def test_mass_zero_is_surface_without_matter():
    assert not spheres([[0, 0, 0], [0.5, 0, 0]], 1.0, mass=0.0).mass.any()


@pytest.mark.parametrize(
    ("centre", "radius", "message"),
    [
        ([[0, 0, 0], [1, 0, 0], [1.8, 0, 0]], 0.5, "1 pairs .* most of all 1 and 2, by 0.2 m"),
        ([[0, 0, 0], [0.1, 0, 0]], [1.0, 0.5], "sphere 1 lies inside sphere 0"),
        ([[0, 0, 0], [0, 0, 0]], 1.0, "sphere 1 lies inside sphere 0"),
    ],
)
def test_overlap_can_be_an_error(centre, radius, message):
    with pytest.raises(ValueError, match=message):
        spheres(centre, radius, mass=1.0, overlap="error")


def test_touching_spheres_do_not_overlap():
    for radius in np.linspace(0.1, 1.0, 40):  # some overlap by rounding
        centre = np.outer(np.arange(4), AXIS) * 2.0 * radius
        assert overlaps(centre, np.full(4, radius)).pairs == 0
        spheres(centre, radius, mass=1.0, overlap="error")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mass": 1.0, "radius": [1.0, -1.0]}, "radius of particle 1 is -1.0"),
        ({"mass": 1.0, "radius": 1e-200}, "largest radius is 1e-200 m: 1e-50 to 1e.50 is needed"),
        ({"mass": 1.0, "radius": 1e200}, "largest radius is 1e.200 m"),
        ({"mass": 1.0, "position": np.empty((0, 3))}, "n of 1 or more"),
        ({"mass": 1.0, "position": [[0, 0, 0], [0, math.nan, 0]]}, "particle 1 not finite"),
    ],
)
def test_what_is_no_body_of_spheres(arguments, message):
    with pytest.raises(ValueError, match=message):
        spheres(**{"position": [[0, 0, 0], [1, 0, 0]], "radius": 1.0} | arguments)


def test_no_points_stand_in_for_what_no_matter_has():
    solid = UniformSolid(1.0, np.zeros(3), np.diag([1.0, 2.0, 3.5]), 1e-15)
    with pytest.raises(ValueError, match=r"1\.0, 2\.0, 3\.5 kg m²: I1 \+ I2 − I3 = -0\.5"):
        equimomental_points(solid, 1.0)
