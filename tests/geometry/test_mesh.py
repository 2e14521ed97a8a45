"""Meshes: exact integrals, what is refused and where, what is turned round, files."""

import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_examples import (
    PHI,
    box,
    icosahedron,
    inside_out,
    joined,
    octahedron,
    sphere,
    subdivided,
    torus,
)  # fmt: skip

from particlerb.geometry.mass_properties import mass_properties
from particlerb.geometry.mesh import checked, mesh_solid, read_mesh, refuse_miscounted
from particlerb.geometry.solid import equimomental_points
from particlerb.rotors.rotor_class import ASYMMETRIC, SPHERE, SYMMETRIC

REFERENCE = json.loads(
    (Path(__file__).parents[1] / "reference" / "clump_mesh_mass.json").read_text()
)


def solid(mesh):
    return mesh_solid(checked(*mesh))


def turn(seed):
    """A rotation matrix."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


# Integrals


@pytest.mark.parametrize("offset", [0.0, 1.0, 1e3])
@pytest.mark.parametrize("levels", [0, 1])
def test_box_octahedron_icosahedron_to_rounding(levels, offset):
    """I/M = (b² + c²)/12; s²/10 for the octahedron of edge s; φ² s²/10 for the icosahedron."""
    a, b, c = 1.0, 2.0, 3.5
    cases = [
        (box((a, b, c)), a * b * c, np.array([b * b + c * c, a * a + c * c, a * a + b * b]) / 12),
        (octahedron(), 4 / 3, np.full(3, 0.2)),
        (icosahedron(), 5 / 12 * (3 + math.sqrt(5)) * 8, np.full(3, 0.4 * PHI**2)),
    ]
    for (v, faces), volume, moments in cases:
        corners, triangles = subdivided(v, faces) if levels else (v, faces)
        found = solid((corners + offset, triangles))
        lost = 1e-14 + 1e-15 * offset  # what the vertices themselves have lost
        assert found.volume == pytest.approx(volume, rel=lost)
        assert found.com == pytest.approx(np.full(3, offset), abs=lost)
        expected = np.diag(moments) * volume
        assert found.inertia == pytest.approx(expected, abs=lost * expected.max())


def test_far_from_the_origin_no_digits_are_lost_but_those_of_the_vertices():
    """A box whose corners are float64 numbers at 1e6 is exactly the box at the origin."""
    v, faces = box((1.0, 2.0, 4.0))
    near, far = solid((v, faces)), solid((v + 2.0**20, faces))
    assert far.volume == near.volume
    assert (far.com - 2.0**20 == near.com).all()
    assert (far.inertia == near.inertia).all()


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_any_size(scale):
    v, faces = octahedron()
    found = solid((v * scale, faces))
    assert found.volume == pytest.approx(4 / 3 * scale**3, rel=1e-14)
    assert np.diag(found.inertia) == pytest.approx(np.full(3, 4 / 15 * scale**5), rel=1e-14)


@pytest.mark.compiled
def test_torus_of_clump():
    """57 600 faces, major radius 3, minor 1; the file has single precision."""
    found, row = solid(torus(3.0, 1.0, 240, 120)), REFERENCE["Torus"]
    assert row["ntri"] == 57600
    assert found.volume == pytest.approx(row["volume"], rel=3e-8)
    moments = np.sort(np.diag(found.inertia)) / found.volume
    assert moments == pytest.approx(row["principal_over_V"], rel=3e-8)


@pytest.mark.compiled
def test_ellipsoid_of_clump():
    """20 480 faces: an icosahedron cut five times, on the unit sphere, stretched to 2 : 1 : 1."""
    v, faces = sphere(5)
    found, row = solid((v * [2.0, 1.0, 1.0], faces)), REFERENCE["Ellipsoid_R_2.0_1.0_1.0"]
    assert len(faces) == row["ntri"]
    assert found.volume == pytest.approx(row["volume"], rel=1e-7)
    moments = np.sort(np.diag(found.inertia)) / found.volume
    assert moments == pytest.approx(row["principal_over_V"], rel=1e-7)


def test_cut_polyhedra_of_clump():
    for mesh, name in ((box(), "Hexahedron"), (octahedron(), "Octahedron")):
        finer = subdivided(*subdivided(*mesh))
        found, row = solid(finer), REFERENCE[name]
        assert found.volume == pytest.approx(row["volume"], rel=1e-14)
        moments = np.diag(found.inertia) / found.volume
        assert moments == pytest.approx(row["principal_over_V"], rel=1e-14)


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_turned_and_moved(seed):
    """V stays, com and tensor go along."""
    rng = np.random.default_rng(seed)
    v, faces = box(rng.uniform(0.1, 3.0, 3))
    R, t = turn(seed), rng.normal(size=3)
    plain, moved = solid((v, faces)), solid((v @ R.T + t, faces))
    assert moved.volume == pytest.approx(plain.volume, rel=1e-13)
    assert moved.com == pytest.approx(t, abs=1e-13)
    expected = R @ plain.inertia @ R.T
    assert moved.inertia == pytest.approx(expected, abs=1e-13 * np.trace(expected))


def test_a_cavity_is_left_out_and_parts_add_up():
    outer, inner = box((4.0, 4.0, 4.0)), inside_out(box())
    found = solid(joined(outer, inner))
    assert found.volume == pytest.approx(63.0, rel=1e-14)
    moment = 64 * 16 / 6 - 1 / 6
    assert np.diag(found.inertia) == pytest.approx(np.full(3, moment), rel=1e-14)
    v, faces = box()
    beside = solid(joined((v, faces), (v + np.array([1.0, 0.0, 0.0]), faces)))  # they touch
    assert beside.volume == pytest.approx(2.0, rel=1e-14)
    assert beside.com == pytest.approx([0.5, 0.0, 0.0], abs=1e-15)


def test_rotor_classes_of_meshes():
    for mesh, expected in (
        (box(), SPHERE),
        (octahedron(), SPHERE),
        (icosahedron(), SPHERE),
        (box((1.0, 1.0, 2.0)), SYMMETRIC),
        (box((1.0, 2.0, 3.0)), ASYMMETRIC),
    ):
        assert mass_properties(equimomental_points(solid(mesh), 3.0)).rotor_class[0] == expected


# What is changed


def test_soup_of_triangles_is_merged():
    v, faces = icosahedron()
    mesh = checked(v[faces].reshape(-1, 3), np.arange(60).reshape(20, 3))
    assert len(mesh.vertices) == 12
    assert mesh.notes == ()
    assert mesh_solid(mesh).volume == pytest.approx(solid((v, faces)).volume, rel=1e-14)


def test_faces_with_two_equal_corners_and_unused_vertices_go():
    v, faces = box()
    more = np.concatenate([v, v[:1], [[9.0, 9.0, 9.0]]])
    mesh = checked(more, np.concatenate([faces, [[0, 8, 1]]]))
    assert len(mesh.faces) == 12
    assert mesh.vertices.max() == 0.5
    assert mesh.notes == ("left out face 12 with two equal corners",)


def test_what_looks_inward_is_turned_round():
    v, faces = box()
    for chosen, note in (
        ([3], "turned round face 3"),
        ([0, 1, 2, 5, 7], "turned round faces 0, 1, 2, ... (5 in all)"),
        (range(12), "turned round all faces: the mesh was inside out"),
    ):
        wrong = faces.copy()
        wrong[list(chosen)] = wrong[list(chosen), ::-1]
        mesh = checked(v, wrong)
        assert mesh.notes == (note,)
        assert mesh_solid(mesh).volume == pytest.approx(1.0, rel=1e-14)


def test_one_part_that_looks_inward_is_turned_round():
    v, faces = box()
    mesh = checked(*joined((v, faces), (v + 3.0, faces[:, ::-1])))
    assert mesh.notes == ("turned round faces 12, 13, 14, ... (12 in all)",)
    assert mesh_solid(mesh).volume == pytest.approx(2.0, rel=1e-14)


# What is refused


def refusal(vertices, faces):
    try:
        checked(vertices, faces)
    except ValueError as error:
        return str(error)
    pytest.fail("not refused")


def test_open_mesh_says_where():
    v, faces = box()
    text = refusal(v, faces[1:])
    assert text.startswith("it is open: edge (-0.5, -0.5, -0.5) m to")
    assert "has 1 face;" in text
    assert text.endswith(
        "two faces are needed at each: close the hole where the mesh was made, or"
        " try trimesh.repair.fill_holes"
    )
    assert "... 4 edges in all" in refusal(v, faces[2:])
    corner = v[faces]
    corner[3, 1] += 1e-6
    text = refusal(corner.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert "are 1.73e-06 m apart, and only equal ones are one: join such vertices" in text
    fin = np.concatenate([faces, [[0, 7, 1]]])
    assert "has 3 faces" in refusal(v, fin)


def moved(mesh, by, scale=1.0):
    return mesh[0] * scale + by, mesh[1]


@pytest.mark.parametrize(
    ("name", "mesh"),
    {
        "corner in the other": joined(box(), moved(box(), 0.5)),
        "in general position": joined(box(), moved(box(), [0.31, 0.27, 0.13])),
        "turned": joined(box(), (box()[0] @ turn(3).T + 0.4, box()[1])),
        "edges through edges": joined(box((4.0, 2.0, 2.0)), box((2.0, 4.0, 2.0))),
        "needle through a side": joined(box(), box((0.01, 0.01, 9.0))),
        "the same twice": joined(box(), box()),
        "sides of one plane": joined(box(), moved(box(), 0.25, 0.5)),
    }.items(),
)
def test_crossings_are_found(name, mesh):
    del name
    text = refusal(*mesh)
    assert text.startswith("it intersects itself: face ")
    assert " and face " in text


def test_place_of_a_crossing():
    """A spike of a pyramid through the top of a box: the only place is where it comes out."""
    v, faces = box()
    spike = np.array([[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.1, 0.0], [0.02, 0.01, 2.0]])
    pyramid = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])
    text = refusal(*joined((v, faces), (spike, pyramid)))
    number, place = text.split(" at (")[0], text.split(" at (")[1].split(")")[0]
    x, y, z = map(float, place.split(","))
    assert z == pytest.approx(0.5, abs=1e-9)
    assert math.hypot(x, y) < 0.12
    assert number.endswith(("face 13", "face 14", "face 15"))


def test_a_vertex_pushed_through_the_far_side():
    """One mesh in one piece that crosses itself, faces with common corners among them."""
    v, faces = subdivided(*box())
    top = np.argmax(np.all(v == [0.0, 0.0, 0.5], axis=1))
    v[top, 2] = -0.8
    assert refusal(v, faces).startswith("it intersects itself")


def test_what_touches_does_not_cross():
    unit = box()
    checked(*joined(unit, moved(unit, [1.0, 0.0, 0.0])))  # side on side
    checked(*joined(unit, moved(unit, [0.75, 0.1, 0.1], 0.5)))  # a part of a side
    checked(*joined(unit, moved(unit, [1.0, 1.0, 0.0])))  # edge on edge
    checked(*joined(unit, moved(unit, 1.0)))  # corner on corner
    v, faces = octahedron()
    checked(*joined(unit, (v * 0.5 + [1.0, 0.0, 0.0], faces)))  # corner on side


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_crossings_as_brute_force_finds_them(seed):
    """Two octahedra: faces cross where an edge of one goes through a face of the other."""
    rng = np.random.default_rng(seed)
    v, faces = octahedron()
    other = v @ turn(seed).T + rng.uniform(-1.4, 1.4, 3)
    crossing = pierces(v, faces, other) or pierces(other, faces, v)
    if crossing:
        assert refusal(*joined((v, faces), (other, faces))).startswith("it intersects itself")
    elif np.linalg.norm(other.mean(axis=0)) > 1.0:
        checked(*joined((v, faces), (other, faces)))


def pierces(v, faces, other):
    """Whether an edge of the second mesh goes through a face of the first."""
    edges = {tuple(sorted((f[k], f[k - 1]))) for f in faces for k in range(3)}
    for a, b in edges:
        for f in faces:
            p, d = other[a], other[b] - other[a]
            rows = np.stack([v[f[1]] - v[f[0]], v[f[2]] - v[f[0]], -d], axis=1)
            s, t, u = np.linalg.solve(rows, p - v[f[0]])
            if min(s, t, 1 - s - t, u, 1 - u) > 0:
                return True
    return False


def test_a_part_that_would_count_twice():
    text = refusal(*joined(box((4.0, 4.0, 4.0)), box()))
    assert text.startswith("the part of face 12 at (")
    assert "would count twice; a cavity is oriented the other way" in text


def test_one_part_of_two_that_share_an_edge_looks_the_other_way():
    v, faces = box()
    mesh = checked(*joined((v, faces), (v + np.array([1.0, 1.0, 0.0]), faces[:, ::-1])))
    assert mesh.notes == ("turned round faces 12, 13, 14, ... (12 in all)",)
    assert mesh_solid(mesh).volume == pytest.approx(2.0, rel=1e-14)


def test_matter_that_counts_twice_or_less_than_never_is_seen():
    """The last guard: every cell of a coarse grid is empty, full, or between."""
    beside = joined(box(), inside_out((box()[0] + np.array([1.0, 0.0, 0.0]), box()[1])))
    for mesh, times in ((joined(box((3.0, 3.0, 3.0)), box()), r"1\.33"), (beside, "-1")):
        with pytest.raises(ValueError, match=rf"matter near \(.*\) m counts {times} times"):
            refuse_miscounted(*mesh)
    refuse_miscounted(*torus(2.0, 1.0, 8, 5))


def test_a_surface_with_one_side():
    """A strip with half a turn, closed to a surface without inside: no two sides.

    The real projective plane in six vertices, a known triangulation of ten faces.
    """
    faces = [
        (0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5), (0, 5, 1),
        (1, 2, 4), (2, 3, 5), (3, 4, 1), (4, 5, 2), (5, 1, 3),
    ]  # fmt: skip
    from particlerb.geometry.winding import oriented

    assert oriented(np.array(faces))[2] >= 0
    assert oriented(icosahedron()[1])[2] == -1


def test_no_volume():
    v = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.3, 1.0, 0.2]])
    said = refusal(v, [[0, 1, 2], [0, 2, 1]])
    centre = ", ".join(f"{x:.9g}" for x in np.mean(v, axis=0)[:3])
    assert said == f"it has zero volume, in the part of face 0 at ({centre}) m"
    assert "every face has two equal corners" in refusal(v, [[0, 0, 1]])


def test_flat_and_impossible_faces():
    line = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    text = refusal(line, [[0, 1, 2], [0, 2, 1]])
    assert text.startswith("faces 0, 1: the corners lie on one line, the first at (0, 0, 0) m, (1")
    v, faces = box()
    assert refusal(v, np.zeros((0, 3))) == "it has no triangles"
    assert refusal(v, faces + 1) == "a face names vertex 8 of 8"
    assert "no vertices in three" in refusal(v, faces - 1)
    v[7, 0] = math.nan
    assert refusal(v, faces) == "face 2 has a vertex that is not finite"


# Files


def written(path, mesh):
    trimesh = pytest.importorskip("trimesh")
    trimesh.Trimesh(*mesh, process=False).export(path)
    return path


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".STL"])
def test_files_of_every_kind(tmp_path, suffix):
    path = written(tmp_path / f"a{suffix}", icosahedron())
    found = mesh_solid(read_mesh(path, 0.5))
    assert found.volume == pytest.approx(solid(icosahedron()).volume / 8, rel=1e-6)


def test_ascii_stl(tmp_path):
    v, faces = octahedron()
    lines = ["solid octahedron"]
    for f in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += ["vertex " + " ".join(map(str, v[k])) for k in f] + ["endloop", "endfacet"]
    path = tmp_path / "a.stl"
    path.write_text("\n".join([*lines, "endsolid octahedron"]))
    pytest.importorskip("trimesh")
    assert mesh_solid(read_mesh(path)).volume == pytest.approx(4 / 3, rel=1e-14)


def test_files_that_are_none(tmp_path, monkeypatch):
    with pytest.raises(
        ValueError, match=r"a\.step is not a mesh: its name must end with \.stl, \.obj"
    ):
        read_mesh(tmp_path / "a.step")
    with pytest.raises(FileNotFoundError, match=r"No such file .*a\.stl"):
        read_mesh(tmp_path / "a.stl")
    (tmp_path / "a.obj").write_text("not a mesh\n")
    with pytest.raises(ValueError, match=r"a\.obj: "):
        read_mesh(tmp_path / "a.obj")
    path = written(tmp_path / "open.stl", (box()[0], box()[1][:-1]))
    with pytest.raises(ValueError, match=r"open\.stl: it is open: edge .* of face \d+ has 1 face"):
        read_mesh(path)
    monkeypatch.setitem(sys.modules, "trimesh", None)  # as if it were not installed
    with pytest.raises(ValueError, match=r'needs trimesh: pip install "particlerb\[mesh\]"'):
        read_mesh(path)
