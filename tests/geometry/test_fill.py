"""Cells weighted by their share, spheres in meshes, and the rule how many suffice."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_examples import box, icosahedron, inside_out, joined, octahedron, sphere, torus

from particlerb.geometry import shapes
from particlerb.geometry.analytic import ANALYTIC
from particlerb.geometry.cells import Lattice, cut_mesh, grid_over, pieces
from particlerb.geometry.fill import coarsest_within, errors, mesh_particles, table
from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.mesh import checked, mesh_solid
from particlerb.geometry.overlapping_spheres import union_solid
from particlerb.geometry.packing import cover, packing
from particlerb.geometry.sections import BALL, cut_sections, part_of_disc

FULL = np.array([1, 1 / 2, 1 / 2, 1 / 2, 1 / 3, 1 / 3, 1 / 3, 1 / 4, 1 / 4, 1 / 4])

ROUND = {
    "ball": {"radius": 0.5},
    "ellipsoid": {"semi_axes": (0.5, 0.35, 0.25)},
    "shell": {"radius": 0.5, "inner_radius": 0.3},
    "cylinder": {"radius": 0.25, "height": 0.75, "inner_radius": 0.15},
    "cone": {"radius": 0.25, "height": 0.75},
    "torus": {"major_radius": 0.5, "minor_radius": 0.2},
}


def turned(mesh, seed=1):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return mesh[0] @ (q * np.linalg.det(q)).T, mesh[1]


def grid_of(mesh, n):
    return grid_over(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), n)


# Cells of meshes


@pytest.mark.parametrize("n", [2, 3, 6])
@pytest.mark.parametrize(
    "mesh",
    [box((1.0, 1.3, 0.7)), octahedron(), turned(box()), turned(icosahedron()), torus(2, 1, 9, 7)],
)
def test_cells_add_up_to_the_mesh(mesh, n):
    """Volume, com and tensor of all cells are those of the tetrahedra, for every n."""
    mesh = checked(*mesh)
    solid, grid = mesh_solid(mesh), grid_of(mesh, n)
    held = pieces(cut_mesh(mesh.vertices, mesh.faces, grid), grid)
    assert held.share.max() <= 1.0 + 1e-13
    assert held.share.sum() * np.prod(grid.spacing) == pytest.approx(solid.volume, rel=1e-13)
    particles = mesh_particles(mesh, mass=2.0, arrangement="cells", n=n).particles
    found = mass_properties(particles)
    expected = solid.inertia / solid.volume * 2.0
    assert found.mass[0] == pytest.approx(2.0, rel=1e-14)
    assert found.com[0] == pytest.approx(solid.com, abs=1e-13)
    assert found.inertia_tensor[0] == pytest.approx(expected, abs=1e-13 * np.trace(expected))


def test_share_of_a_cell_against_points_inside():
    """Each cell of a turned box by a fine lattice of points in it."""
    mesh = checked(*turned(box((1.0, 0.8, 0.6)), seed=4))
    grid = grid_of(mesh, 4)
    normals = np.cross(
        mesh.vertices[mesh.faces[:, 1]] - mesh.vertices[mesh.faces[:, 0]],
        mesh.vertices[mesh.faces[:, 2]] - mesh.vertices[mesh.faces[:, 0]],
    )
    foot = mesh.vertices[mesh.faces[:, 0]]
    u = (np.arange(24) + 0.5) / 24
    points = np.stack(np.meshgrid(u, u, u, indexing="ij"), axis=-1).reshape(-1, 3)
    for i, sums in cut_mesh(mesh.vertices, mesh.faces, grid):
        for j, k in np.ndindex(*sums.shape[:2]):
            x = grid.lower + (np.array([i, j, k]) + points) * grid.spacing
            inside = ((x[:, None] - foot) * normals).sum(axis=2).max(axis=1) < 0.0
            p = points[inside]
            squares = [
                p[:, a] * p[:, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
            ]
            found = np.array([len(p), *p.sum(axis=0), *(s.sum() for s in squares)]) / len(points)
            assert sums[j, k] == pytest.approx(found, abs=0.012)


def test_cells_of_a_box_on_its_grid_are_full():
    """Faces on the planes between cells: no cell is lost, none counts twice."""
    v, faces = box((4.0, 3.0, 2.0))
    for _, sums in cut_mesh(v, faces, Lattice(v.min(axis=0), np.ones(3), (4, 3, 2))):
        assert sums == pytest.approx(np.broadcast_to(FULL, sums.shape), abs=1e-14)


def test_faces_that_rounding_lifts_over_the_grid_count():
    """0.5 / (0.5 / 49) is above 49."""
    vertices, faces = box((1 / 49, 1 / 49, 0.5))
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    grid = Lattice(lower, (upper - lower) / [2, 2, 49], (2, 2, 49))
    assert ((upper - lower) / grid.spacing)[2] > 49.0
    layers = cut_mesh(vertices, faces, grid)
    assert sum(sums[:, :, 0].sum() for _, sums in layers) == pytest.approx(2 * 2 * 49, rel=1e-12)


def test_cells_in_a_cavity_are_empty():
    mesh = checked(*joined(box((6.0, 6.0, 6.0)), inside_out(box((2.0, 2.0, 2.0)))))
    share = np.stack([s[:, :, 0] for _, s in cut_mesh(mesh.vertices, mesh.faces, grid_of(mesh, 6))])
    hole = np.zeros((6, 6, 6), dtype=bool)
    hole[2:4, 2:4, 2:4] = True
    assert share[hole] == pytest.approx(np.zeros(8), abs=1e-14)
    assert share[~hole] == pytest.approx(np.ones(208), abs=1e-14)


def test_particles_stay_in_the_box_of_the_mesh_and_near_their_cells():
    """They move outward by less than a cell, and less and less: as 1/n² of the size."""
    mesh = checked(*turned(icosahedron()))
    moved = []
    for n in (4, 8, 16):
        grid = grid_of(mesh, n)
        held = pieces(cut_mesh(mesh.vertices, mesh.faces, grid), grid)
        made = mesh_particles(mesh, mass=1.0, arrangement="cells", n=n).particles
        assert (made.position >= mesh.vertices.min(axis=0)).all()
        assert (made.position <= mesh.vertices.max(axis=0)).all()
        moved.append(np.abs(made.position - held.centroid).max())
        assert moved[-1] < 0.5 * grid.spacing.max()
    assert moved[0] / moved[1] == pytest.approx(4.0, rel=0.35)
    assert moved[1] / moved[2] == pytest.approx(4.0, rel=0.35)


# Cells of round solids


@pytest.mark.parametrize("name", ROUND)
@pytest.mark.parametrize("n", [3, 4, 7])
def test_cells_of_round_solids_have_the_analytic_tensor(name, n):
    particles = getattr(shapes, name)(**ROUND[name], mass=3.0, n=n, arrangement="cells")
    assert math.fsum(particles.mass) == pytest.approx(3.0, rel=1e-14)
    assert max(errors(particles, ANALYTIC[name](**ROUND[name]))) < 1e-13


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["ball", "torus", "cone"])
def test_weighted_cells_are_better_than_plain_ones_at_64(name):
    """The figure asked for is ten times; what is left here is rounding."""
    analytic = ANALYTIC[name](**ROUND[name])

    def error(arrangement):
        made = getattr(shapes, name)(**ROUND[name], mass=1.0, n=64, arrangement=arrangement)
        return max(errors(made, analytic))

    assert error("cells") < 1e-12 < 1e-4 * error("lattice")


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_part_of_a_disc_against_slices(seed):
    """Moments of disc and rectangle, by exact strips of a thousand slices."""
    rng = np.random.default_rng(seed)
    x1, y1 = rng.uniform(-1.5, 1.0, 2)
    x2, y2 = np.array([x1, y1]) + rng.uniform(0.1, 1.5, 2)
    x = x1 + (x2 - x1) * (np.arange(4000) + 0.5) / 4000
    half = np.sqrt(np.maximum(1.0 - x * x, 0.0))
    low, high = np.maximum(y1, -half), np.minimum(y2, half)
    high = np.maximum(low, high)
    u, v, w = (x - x1) / (x2 - x1), (low - y1) / (y2 - y1), (high - y1) / (y2 - y1)
    h1, h2, h3 = w - v, (w**2 - v**2) / 2, (w**3 - v**3) / 3
    expected = [np.mean(t) for t in (h1, u * h1, h2, u * u * h1, h3, u * h2)]
    assert part_of_disc(x1, x2, y1, y2, 1.0) == pytest.approx(expected, abs=2e-5)


def test_sections_of_a_ball_are_symmetric():
    """Each layer is its mirror image, and the layer opposite is the same."""
    layers = np.stack([sums[:, :, 0] for _, sums in cut_sections(BALL, (5, 5, 5))])
    for axis in range(3):
        assert np.flip(layers, axis=axis) == pytest.approx(layers, abs=1e-14)
    assert np.swapaxes(layers, 0, 2) == pytest.approx(layers, abs=1e-3)  # kinks in z
    assert layers.sum() * 8 / 125 == pytest.approx(4 / 3 * math.pi, rel=1e-13)


# Spheres in meshes


def check_inscribed(mesh, found):
    """No centre is nearer to a face of a convex mesh than its radius, and some face touches."""
    corner = mesh.vertices[mesh.faces]
    n = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    room = ((corner[:, 0] - found.centre[:, None]) * n).sum(axis=2).min(axis=1)
    assert room == pytest.approx(found.radius, rel=1e-12)


@pytest.mark.compiled
def test_spheres_are_inscribed_and_more_of_them_hold_more():
    mesh = checked(*turned(box((1.0, 1.3, 0.7))))
    solid = mesh_solid(mesh)
    found = packing(mesh, 60)
    check_inscribed(mesh, found)
    assert found.radius[0] == pytest.approx(0.35, rel=0.05)  # as large as any
    share = [
        union_solid(found.centre[:k], found.radius[:k]).volume / solid.volume
        for k in (1, 8, 30, 60)
    ]
    assert (np.diff(share) > 0.05).all()
    assert 0.8 < share[-1] < 1.0


@pytest.mark.compiled
def test_first_spheres_of_a_packing_are_the_packing_of_fewer():
    mesh = checked(*torus(3.0, 1.0, 40, 20))
    few, many = packing(mesh, 5), packing(mesh, 12)
    assert (many.centre[:5] == few.centre).all()
    assert (many.radius[:5] == few.radius).all()
    off_axis = np.hypot(few.centre[:, 0], few.centre[:, 1])
    assert off_axis == pytest.approx(np.full(5, 3.0), abs=0.15)  # inside the ring


def test_a_centre_outside_or_a_distance_too_long_is_not_believed():
    """Cells with a gap have their centroid in it; distances are upper bounds before they count."""
    vertices, faces = box((1.0, 1.0, 1.0))
    point = np.array([[0.0, 0.7, 0.4], [0, 0, 0.4], [0, 0, 0], [1, 1, 1]])
    centre, radius = np.empty((3, 3)), np.empty(3)
    squared = np.array([0.25, 0.04, 1.0])
    assert cover(vertices[faces], point, squared, 0.01, centre, radius) == 2
    assert np.abs(centre[:2, 0] - [0.0, 0.4]).max() < 0.02
    assert radius[:2] == pytest.approx([0.5, 0.1], abs=0.02)


@pytest.mark.compiled
def test_one_sphere_of_a_ball_is_the_ball():
    found = packing(checked(*sphere(3)), 1)
    assert np.abs(found.centre).max() < 0.01
    assert 0.985 < found.radius[0] <= 0.999


@pytest.mark.compiled
def test_a_plate_thinner_than_a_cell_has_spheres_too():
    mesh = checked(*box((1.0, 1.0, 0.02)))
    found = packing(mesh, 3)
    check_inscribed(mesh, found)
    assert found.radius == pytest.approx(np.full(3, 0.01), rel=1e-6)


@pytest.mark.compiled
def test_a_body_of_spheres_has_the_mass_of_the_mesh():
    """The spheres touch, six particles carry what is exact."""
    mesh = checked(*turned(box((1.0, 1.3, 0.7))))
    solid = mesh_solid(mesh)
    filled = mesh_particles(mesh, density=2.0, arrangement="spheres", n=20)
    particles = filled.particles
    assert (particles.mass[:20] == 0.0).all()
    assert (particles.radius[:20] > 0.0).all()
    assert (particles.radius[20:] == 0.0).all()
    found = mass_properties(particles)
    assert found.mass[0] == pytest.approx(2.0 * 0.91, rel=1e-14)
    assert found.inertia_tensor[0] == pytest.approx(2.0 * solid.inertia, abs=1e-14)


# How many suffice


def test_stop_rule_takes_the_first_that_is_good_enough():
    size = {"radius": 1.0}
    filled = coarsest_within(ANALYTIC["ball"](**size), 0.02, lambda n: shapes.ball(1.0, 5.0, n))
    errors_found = [trial.error for trial in filled.trials]
    assert errors_found[-1] <= 0.02 < min(errors_found[:-1])
    last = filled.trials[-1]
    assert last.particles == len(filled.particles.mass)
    assert max(errors(filled.particles, ANALYTIC["ball"](**size))) == last.error
    assert filled.lines[0].startswith(f"inertia error {last.error:.3g} with n = {last.n}")
    assert len(filled.lines) == len(filled.trials) + 2
    assert filled.lines[1].split() == ["n", "particles", "inertia", "com"]


def test_stop_rule_that_is_not_met_shows_what_was_tried(monkeypatch):
    monkeypatch.setattr("particlerb.geometry.fill.MAX_PARTICLES", 500)
    with pytest.raises(
        ValueError, match=r"inertia_error = 1e-09 is not met; the best .*\n +n"
    ) as e:
        coarsest_within(ANALYTIC["ball"](1.0), 1e-9, lambda n: shapes.ball(1.0, 1.0, n))
    assert len(str(e.value).splitlines()) > 5


def test_cells_need_few():
    """Two cells along each edge: eight particles with the tensor of the mesh."""
    mesh = checked(*turned(icosahedron()))
    filled = mesh_particles(mesh, mass=1.0, arrangement="cells", inertia_error=1e-6)
    assert [trial.n for trial in filled.trials] == [2]
    assert len(filled.particles.mass) == 8


@pytest.mark.compiled
def test_as_many_spheres_as_the_error_needs():
    mesh = checked(*torus(3.0, 1.0, 40, 20))
    solid = mesh_solid(mesh)
    filled = mesh_particles(mesh, mass=1.0, arrangement="spheres", inertia_error=0.02)
    last = filled.trials[-1]
    spheres = filled.particles.radius > 0.0
    assert spheres.sum() == last.n
    union = union_solid(filled.particles.position[spheres], filled.particles.radius[spheres])
    off = union.inertia / union.volume - solid.inertia / solid.volume
    own = np.linalg.norm(solid.inertia / solid.volume, 2)
    assert np.linalg.norm(off, 2) / own == pytest.approx(last.inertia_error, rel=1e-9)
    assert last.inertia_error <= 0.02
    assert union.volume / solid.volume - 1.0 == pytest.approx(last.volume_error, rel=1e-9)
    assert all(trial.error > 0.02 for trial in filled.trials[:-1])
    assert "volume" in table(filled.trials)[0]
    with pytest.raises(ValueError, match="inertia_error = 1e-08 is not met"):
        mesh_particles(mesh, mass=1.0, arrangement="spheres", inertia_error=1e-8)


def test_arguments_of_a_body_from_a_mesh():
    mesh = checked(*box())
    for how, message in (
        ({"mass": 0.0}, "mass is 0.0: positive"),
        ({"mass": 1.0, "arrangement": "cells", "n": 1}, "n is 1: 2 or more"),
    ):
        with pytest.raises(ValueError, match=message):
            mesh_particles(mesh, **how)
