"""Shapes against closed forms of the solids and of their lattices; sets of particles; CSV files.

u = 2^-53 is the unit roundoff. Formulas: tests/reference/mass_properties.json, docs/bodies.md.
"""

import json
import math
from pathlib import Path

import naive
import numpy as np
import pytest

from particlerb.compiled.jit import CACHE_FOLDER
from particlerb.geometry import shapes
from particlerb.geometry.analytic import ANALYTIC
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.particle_files import read_points
from particlerb.geometry.particles import concatenate, one_kind, scaled_to_mass, transformed, united
from particlerb.rotors.rotor_class import SPHERE

U = 2.0**-53
REFERENCE = json.loads(
    (Path(__file__).parents[1] / "reference" / "mass_properties.json").read_text()
)
EDGE = 2.0 * math.sqrt(2.0)  # of the regular tetrahedron in alternate corners of [-1, 1]^3
REGULAR = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
SKEW = [[0.1, 0.2, 0.3], [2.0, 0.1, -0.4], [-0.3, 1.7, 0.2], [0.4, 0.6, 3.1]]


def tensor_of(particles):
    return mass_properties(particles).inertia_tensor[0]


def box_moments(a, b, c, m):
    return [m * (b**2 + c**2) / 12, m * (a**2 + c**2) / 12, m * (a**2 + b**2) / 12]


# name, parameters and moments about the com (x, y, z) of solids that only a lattice fills
R, r, H = 1.3, 0.7, 2.1
SOLIDS = {
    "ball": ({"radius": R}, [0.4 * R**2] * 3),
    "shell": ({"radius": R, "inner_radius": r}, [0.4 * (R**5 - r**5) / (R**3 - r**3)] * 3),
    "cylinder": (
        {"radius": R, "height": H},
        [(3 * R**2 + H**2) / 12, (3 * R**2 + H**2) / 12, R**2 / 2],
    ),
    "cone": (
        {"radius": R, "height": H},
        [3 / 80 * (4 * R**2 + H**2), 3 / 80 * (4 * R**2 + H**2), 0.3 * R**2],
    ),
    "torus": (
        {"major_radius": R, "minor_radius": r},
        [R**2 / 2 + 5 / 8 * r**2, R**2 / 2 + 5 / 8 * r**2, R**2 + 3 / 4 * r**2],
    ),
    "ellipsoid": (
        {"semi_axes": [R, r, H]},
        [(r**2 + H**2) / 5, (R**2 + H**2) / 5, (R**2 + r**2) / 5],
    ),
}
TUBE = {"radius": R, "height": H, "inner_radius": r}
TUBE_MOMENTS = [(3 * (R**2 + r**2) + H**2) / 12] * 2 + [(R**2 + r**2) / 2]
LATTICES = [(name, *solid) for name, solid in SOLIDS.items()] + [("cylinder", TUBE, TUBE_MOMENTS)]
EXACT = {
    "box": ({"size": [1.0, 2.2, 0.3]}, box_moments(1.0, 2.2, 0.3, 1.0)),
    "ball": SOLIDS["ball"],
    "ellipsoid": SOLIDS["ellipsoid"],
    "rod": ({"length": H}, [H**2 / 12, H**2 / 12, 0.0]),
    "tetrahedron": ({"vertices": REGULAR}, [EDGE**2 / 20] * 3),
}


COMPILED = [pytest.mark.compiled, pytest.mark.skipif(CACHE_FOLDER is None, reason="many particles")]
VOXEL_BALLS = [
    pytest.param(row, marks=COMPILED if row["n"] > 16 else [], id=f"n={row['n']}")
    for row in REFERENCE["voxel_ball"]
]


# Exact sets and closed forms


@pytest.mark.parametrize("name", EXACT)
def test_exact_set_has_the_tensor_of_the_solid(name):
    """Each factor of Σ m x² is rounded: a few u."""
    parameters, moments = EXACT[name]
    particles = getattr(shapes, name)(**parameters, mass=3.7, arrangement="exact")
    difference = tensor_of(particles) - 3.7 * np.diag(moments)
    assert np.abs(difference).max() <= 6 * U * 3.7 * max(moments)
    assert len(particles.mass) == {"box": 8, "ball": 1, "ellipsoid": 6, "rod": 3}.get(name, 5)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 10, 20])
def test_cube_lattice_is_its_closed_form(n):
    """I = (M L²/6)(1 − 1/n²), exactly; equal on all axes."""
    m, L = 2.0, 1.3
    tensor = tensor_of(shapes.box([L, L, L], m, n))
    expected = m * L**2 / 6 * (1 - 1 / n**2)
    assert np.abs(tensor - expected * np.eye(3)).max() <= 1e-15 * expected


def test_box_lattice_takes_three_numbers_of_cells():
    a, b, c = 1.0, 2.0, 3.0
    tensor = tensor_of(shapes.box([a, b, c], 1.0, (2, 3, 5)))
    squares = [a**2 * (1 - 1 / 4), b**2 * (1 - 1 / 9), c**2 * (1 - 1 / 25)]
    assert np.allclose(np.diagonal(tensor), (sum(squares) - np.array(squares)) / 12, rtol=1e-15)
    assert np.count_nonzero(tensor) == 3


@pytest.mark.parametrize("n", [1, 2, 9])
def test_rod_lattice_is_its_closed_form(n):
    expected = 2.0 * 9.0 / 12 * (1 - 1 / n**2)
    tensor = tensor_of(shapes.rod(3.0, 2.0, n))
    assert np.abs(tensor - np.diag([expected, expected, 0])).max() <= 1e-15 * expected


@pytest.mark.parametrize("row", VOXEL_BALLS)
def test_ball_lattice_is_the_table_of_voxel_balls(row):
    particles = shapes.ball(1.0, 1.0, row["n"])
    assert len(particles.mass) == row["N"]
    assert np.diagonal(tensor_of(particles)) == pytest.approx([row["I"]] * 3, rel=2e-15)
    cell = (2.0 / row["n"]) ** 3
    ratio = len(particles.mass) * cell / ANALYTIC["ball"](1.0).volume
    assert ratio - 1 == pytest.approx(row["vol_err"], abs=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 10])
def test_thin_shell_has_the_exact_tensor_for_every_n(n):
    particles = shapes.shell(1.7, 3.0, n=n)
    expected = 2 / 3 * 3.0 * 1.7**2
    assert len(particles.mass) == 6 * n**2
    assert np.abs(tensor_of(particles) - expected * np.eye(3)).max() <= 6 * U * expected
    assert mass_properties(particles).rotor_class == SPHERE


def test_thin_shell_is_well_distributed():
    """Cells of equal angle: neighbours are π/(2n) apart at most, and 0.7 of that at least."""
    n = 12
    p = shapes.shell(1.0, 1.0, n=n).position
    cosine = p @ p.T
    np.fill_diagonal(cosine, -1.0)
    nearest = np.arccos(cosine.max(axis=1))
    assert 0.7 * math.pi / (2 * n) < nearest.min() < nearest.max() < 1.001 * math.pi / (2 * n)


@pytest.mark.parametrize("vertices", [REGULAR, SKEW])
@pytest.mark.parametrize("n", [2, 3, 10, None])
def test_tetrahedron_has_the_exact_tensor_for_every_n(vertices, n):
    particles = shapes.tetrahedron(vertices, 2.0, n or 10, arrangement="lattice" if n else "exact")
    expected = naive.tetrahedron_tensor(vertices, 2.0)
    found = mass_properties(particles)
    trace = np.trace(found.inertia_tensor[0])
    assert naive.largest_difference(expected, found.inertia_tensor[0]) <= 16 * U * trace
    assert np.abs(found.com[0] - np.mean(vertices, axis=0)).max() <= 8 * U
    corners = np.vstack([np.transpose(vertices), np.ones(4)])
    barycentric = np.vstack([particles.position.T, np.ones(len(particles.mass))])
    inside = np.linalg.solve(corners, barycentric)
    assert inside.min() > -8 * U


@pytest.mark.parametrize("inertia", [[1, 2, 3], [2, 2, 2], [1e-10, 1, 1], [0, 5, 5], [5, 4, 3]])
def test_moments_are_given_back(inertia):
    tensor = tensor_of(shapes.moments(inertia, 0.3))
    assert np.abs(tensor - np.diag(inertia)).max() <= 6 * U * max(inertia)


def test_moments_that_break_the_triangle_inequality_are_refused_beyond_rounding():
    beyond = [0.1, 0.2, math.nextafter(0.1 + 0.2, 1.0)]
    assert tensor_of(shapes.moments(beyond, 1.0))[2, 2] == pytest.approx(0.3, rel=4 * U)
    with pytest.raises(ValueError, match=r"moment 3 = 3\.0000000000001 exceeds .* 3\.0, by"):
        shapes.moments([1, 2, 3.0000000000001], 1.0)


# Lattices of curved solids


@pytest.mark.parametrize(("name", "parameters", "moments"), LATTICES)
def test_lattice_approaches_the_solid(name, parameters, moments):
    """Staircases: no clean order, but n = 40 is within 2 % and better than n = 6."""
    errors = []
    for n in (6, 40):
        found = mass_properties(getattr(shapes, name)(**parameters, mass=1.0, n=n))
        errors.append(np.abs(np.diagonal(found.inertia_tensor[0]) / moments - 1).max())
    assert errors[1] < min(errors[0], 0.02)
    apex_up = [0, 0, parameters["height"] / 4] if name == "cone" else [0, 0, 0]
    assert np.abs(found.com[0] - apex_up).max() < 0.005


@pytest.mark.parametrize(("name", "parameters", "moments"), LATTICES)
def test_volume_is_that_of_the_cells(name, parameters, moments):
    """Cells inside times volume of a cell; cells are nearly cubes of the distance of neighbours."""
    p = getattr(shapes, name)(**parameters, mass=1.0, n=40).position
    cell = math.prod(np.diff(np.unique(np.round(axis, 9))).min() for axis in p.T)
    volume = ANALYTIC[name](**parameters).volume
    assert len(p) * cell == pytest.approx(volume, rel=0.03)
    spacing = [np.diff(np.unique(np.round(axis, 9))).min() for axis in p.T]
    assert max(spacing) / min(spacing) < 1.04


@pytest.mark.parametrize(
    ("name", "parameters", "volume"),
    [
        ("box", {"size": [1.0, 2.0, 3.0]}, 6.0),
        ("ball", {"radius": 2.0}, 32 / 3 * math.pi),
        ("tetrahedron", {"vertices": REGULAR}, EDGE**3 / (6 * math.sqrt(2.0))),
        ("cylinder", {"radius": 2.0, "height": 0.5}, 2 * math.pi),
        ("torus", {"major_radius": 2.0, "minor_radius": 1.0}, 4 * math.pi**2),
    ],
)
def test_volume_of_solids(name, parameters, volume):
    assert ANALYTIC[name](**parameters).volume == pytest.approx(volume, rel=1e-15)


@pytest.mark.parametrize("name", ["rod", "shell"])
def test_lines_and_surfaces_have_no_volume(name):
    assert math.isnan(ANALYTIC[name](1.0).volume)


# Every shape

EVERY = {
    "box": {"size": [1, 2, 3], "n": 4},
    "ball": {"radius": 2, "n": 5},
    "shell": {"radius": 2, "n": 4},
    "cylinder": {"radius": 1, "height": 3, "n": 6},
    "cone": {"radius": 1, "height": 3, "n": 6},
    "torus": {"major_radius": 2, "minor_radius": 1, "n": 8},
    "ellipsoid": {"semi_axes": [1, 2, 3], "n": 6},
    "rod": {"length": 2, "n": 7},
    "tetrahedron": {"vertices": SKEW, "n": 5},
    "moments": {"inertia": [1, 2, 2.5]},
    "cloud": {"n": 50, "radius": 2.0, "rng": np.random.default_rng(1)},
}


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("mass", [0.1 + 0.2, 1e-27, 3e40])
def test_total_mass_is_the_argument_to_rounding(name, mass):
    particles = getattr(shapes, name)(**EVERY[name], mass=mass)
    assert math.fsum(particles.mass) == pytest.approx(mass, rel=2 * U)
    assert particles.position.flags.c_contiguous
    assert particles.offset.tolist() == [0, len(particles.mass)]
    assert not particles.radius.any()


@pytest.mark.parametrize("name", ["ball", "shell", "cylinder", "torus", "ellipsoid", "box", "rod"])
def test_centred_shapes_have_the_com_at_the_origin_to_the_bit(name):
    assert (mass_properties(getattr(shapes, name)(**EVERY[name], mass=0.3)).com == 0.0).all()


@pytest.mark.parametrize(
    ("name", "parameters", "message"),
    [
        ("shell", {"radius": 1.0, "inner_radius": 0.99, "n": 4}, "none of the cell centres"),
        ("tetrahedron", {"vertices": np.eye(4, 3), "n": 1}, "n is 1: 2 or more"),
        ("ball", {"radius": 1.0, "n": 1, "arrangement": "cells"}, "n is 1: 2 or more"),
        ("moments", {"inertia": [1, -1, 1]}, "exceeds the sum"),
    ],
)
def test_impossible_shapes_are_refused(name, parameters, message):
    with pytest.raises(ValueError, match=message):
        getattr(shapes, name)(**parameters, mass=1.0)


@pytest.mark.parametrize("mass", [0.0, -1.0, math.inf])
def test_impossible_masses_are_refused(mass):
    with pytest.raises(ValueError, match="mass is"):
        shapes.ball(1.0, mass)


def test_cloud_is_uniform_in_the_ball():
    """E r² = (3/5) R² with variance (3/7 − 9/25) R⁴; five standard errors."""
    n, radius = 20_000, 2.0
    distance = np.linalg.norm(
        shapes.cloud(n, radius, 1.0, np.random.default_rng(2)).position, axis=1
    )
    assert distance.max() <= radius
    error = radius**2 * math.sqrt((3 / 7 - 9 / 25) / n)
    assert np.mean(distance**2) == pytest.approx(0.6 * radius**2, abs=5 * error)


# Sets of particles


def test_concatenate_and_of_kind_are_inverse():
    sets = [shapes.rod(1.0, 1.0, n=k + 1) for k in range(3)]
    together = concatenate([concatenate(sets[:2]), sets[2]])
    assert together.offset.tolist() == [0, 1, 3, 6]
    for k, alone in enumerate(sets):
        assert all((a == b).all() for a, b in zip(naive.of_kind(together, k), alone, strict=True))
    assert united(together).offset.tolist() == [0, 6]
    for k in (-1, 3):
        with pytest.raises(IndexError, match=f"kind {k} of 3"):
            naive.of_kind(together, k)


def test_transformed_turns_then_moves():
    quarter = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
    moved = transformed(one_kind([[1.0, 0.0, 0.0]], 1.0), quarter, [0, 0, 5])
    assert moved.position.tolist() == [[0.0, 1.0, 5.0]]


def test_scaled_to_mass_keeps_proportions():
    pair = one_kind([[0, 0, 0], [1, 0, 0]], [1, 3])
    assert scaled_to_mass(pair, 2.0).mass.tolist() == [0.5, 1.5]
    with pytest.raises(ValueError, match="no mass to scale"):
        scaled_to_mass(pair._replace(mass=np.zeros(2)), 2.0)


# CSV files


def test_csv_columns_come_in_any_order(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# made by hand\n\n M, z ,x,y, r\n1,3,1,2,0.5 # first\n\n2e-3, 6,4,5,0\n")
    particles = read_points(path)
    assert particles.position.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert particles.mass.tolist() == [1, 2e-3]
    assert particles.radius.tolist() == [0.5, 0]


def test_csv_without_radius_holds_points(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,m\n1,2,3,4", encoding="utf-8-sig")
    assert read_points(str(path)).radius.tolist() == [0.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: empty"),
        ("# only a comment\n", "a.csv: empty"),
        ("x,y,z,m\n", "a.csv:1: no rows below the header"),
        ("\nx,y,m\n1,2,3\n", "a.csv:2: column z is missing"),
        ("x,y,z,m,q\n1,2,3,4,5\n", "a.csv:1: unknown column 'q'"),
        ("x,y,z,m,x\n1,2,3,4,5\n", "a.csv:1: a column is given twice"),
        ("x,y,z,m\n1,2,3\n", "a.csv:2: 3 values for the 4 columns"),
        ("x,y,z,m\n1,2,3,4\n# c\n1,2,a,4\n", "a.csv:4: z = 'a' is not a number"),
        ("x,y,z,m\n1,2,,4\n", "a.csv:2: z = '' is not a number"),
        ("x,y,z,m\n1,nan,3,4\n", "a.csv:2: y = nan is not finite"),
        ("x,y,z,m\n1,2,3,inf\n", "a.csv:2: m = inf is not finite"),
        ("x,y,z,m\n1,2,3,-4\n", "a.csv:2: m = -4 is negative"),
        ("x,y,z,m,r\n1,2,3,4,-1\n", "a.csv:2: r = -1 is negative"),
    ],
)
def test_csv_errors_say_file_line_and_reason(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_points(path)


def test_csv_that_does_not_exist(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_points(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[1, 2]], [1]), "position has shape"),
        (([1, 2, 3], [1]), "position has shape"),
        ((np.empty((0, 3)), []), "position has shape"),
        (([[1, 2, 3]], [1, 2]), "mass has shape"),
        (([[1, 2, 3], [1, 2, math.inf]], 1), "position of particle 1"),
        (([[1, 2, 3]], [-1]), "mass of particle 0 is -1"),
        (([[1, 2, 3]], [1], [math.nan]), "radius of particle 0 is nan"),
    ],
)
def test_points_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        one_kind(*arguments)
