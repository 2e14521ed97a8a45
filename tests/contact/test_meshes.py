"""Containers from STL files, binary and ASCII, as trimesh writes and reads them."""

import numpy as np
import pytest
import trimesh

import particlerb
from particlerb.case.problems import CaseError

G = 9.81
KINDS = ("stl", "stl_ascii")


def written(path, mesh, kind="stl"):
    """File of a mesh."""
    mesh.export(path, file_type=kind)
    return {"type": "mesh", "name": "container", "file": str(path)}


def scene(make, *bodies, wall, t_end=0.5, every=0.05, dt=5e-4, **keys):
    contact = make.hooke(1e4, 0.7, 0.4)
    gravity = {"acceleration": [0, 0, -G]}
    run = {"t_end": t_end, "every": every, "dt": dt, "threads": 1}
    return {"run": run, "body": list(bodies), "wall": wall, "contact": contact,
            "gravity": gravity} | keys  # fmt: skip


def cup(radius=0.5, height=1.0, sections=24):
    """Beaker with a floor and no lid, normals to both sides as they come."""
    mesh = trimesh.creation.cylinder(radius, height, sections=sections)
    is_lid = np.isclose(mesh.triangles[:, :, 2], 0.5 * height).all(axis=1)
    mesh.update_faces(~is_lid)
    return mesh


@pytest.mark.compiled
@pytest.mark.parametrize("kind", KINDS)
def test_a_ball_moves_in_a_box_from_a_file_as_in_a_box(make, tmp_path, kind):
    """All six faces, edges between their triangles, sizes that single precision has exactly."""
    ball = make.sphere(position=[0.1, -0.2, 0.0], velocity=[1.7, 2.3, 0.4], mass=0.5)
    ball["angular_velocity"] = [3.0, -2.0, 1.0]
    wall = written(tmp_path / "box.stl", trimesh.creation.box((1, 1.5, 2)), kind)
    box = {"type": "box", "name": "box", "lower": [-0.5, -0.75, -1], "upper": [0.5, 0.75, 1]}
    runs = []
    for one in (wall, box):
        with particlerb.run(scene(make, ball, wall=[one], t_end=1.5)) as t:
            runs.append((t.position[:, 0], t.angular_momentum[:, 0]))
    assert runs[0][0] == pytest.approx(runs[1][0], abs=1e-9)
    assert runs[0][1] == pytest.approx(runs[1][1], abs=1e-9)
    assert np.ptp(runs[0][0][:, 1]) > 1.2  # it met both sides


@pytest.mark.compiled
@pytest.mark.parametrize("kind", KINDS)
def test_balls_settle_in_a_beaker_in_millimetres(make, tmp_path, kind):
    mesh = cup()
    mesh.apply_scale(1000.0)
    wall = written(tmp_path / "beaker.stl", mesh, kind) | {"scale": 1e-3, "position": [2, 0, 0.5]}
    balls = make.sphere("ball", 0.08, count=24, mass=0.5, velocity={"random": 0.2})
    balls["place"] = {"type": "grid", "spacing": 0.2, "n": [3, 3, 3], "origin": [2, 0, 0.6]}
    fields = ["position", "orientation", "linear_momentum", "angular_momentum", "wall_force"]
    case = scene(make, balls, wall=[wall], t_end=3.0, every=0.5, output={"fields": fields})
    with particlerb.run(case) as t:
        x = t.position - [2, 0, 0]
        assert x[..., 2].min() > 0.07
        assert np.hypot(x[..., 0], x[..., 1]).max() < 0.43
        assert x[-1, :, 2].max() < 0.5
        assert t.wall_force[-1, 0] == pytest.approx([0, 0, -12.0 * G], abs=6.0)


@pytest.mark.compiled
def test_a_hopper_holds_what_is_wider_than_its_outlet_and_lets_others_through(make, tmp_path):
    """A cone without bottom, 45° steep, 12 cm wide at its outlet."""
    turn = np.linspace(0.0, 2.0 * np.pi, 33)[:-1]
    rings = [
        np.stack([r * np.cos(turn), r * np.sin(turn), np.full(32, z)], axis=1)
        for r, z in ((0.06, 0.0), (0.5, 0.44))
    ]
    k, after = np.arange(32), np.roll(np.arange(32), -1)
    faces = np.concatenate(
        [np.stack([k, after, 32 + k], axis=1), np.stack([after, 32 + after, 32 + k], axis=1)]
    )
    wall = written(tmp_path / "hopper.stl", trimesh.Trimesh(np.concatenate(rings), faces))
    wide = make.sphere("wide", 0.09, position=[0.2, 0.05, 0.6], mass=0.5)
    small = make.sphere("small", 0.03, position=[-0.2, 0.0, 0.5], mass=0.5, contact=True)
    for ball, passes in ((wide, False), (small, True)):
        with particlerb.run(scene(make, ball, wall=[wall], t_end=3.0, every=0.5)) as t:
            assert (t.position[-1, 0, 2] < -1.0) == passes


def test_a_file_that_is_bad_is_named_with_what_is_wrong(make, tmp_path):
    good = tmp_path / "good.stl"
    wall = written(good, trimesh.creation.box((1, 1, 1)))
    flat = "solid flat\nfacet normal 0 0 1\nouter loop\n"
    flat += "vertex 0 0 0\nvertex 1 1 1\nvertex 2 2 2\nendloop\nendfacet\nendsolid flat\n"
    bad = {
        "empty.stl": (b"", "has no triangle: it is empty, cut off, or no STL file"),
        "cut.stl": (good.read_bytes()[:300], "has no triangle: it is empty, cut off"),
        "words.stl": (b"solid but not so\nno facet here\n", "has no triangle: it is empty"),
        "noise.stl": (np.random.default_rng(1).bytes(900), "has no triangle: it is empty"),
        "flat.stl": (flat.encode(), "has no triangle with an area"),
        "mesh.xyzzy": (b"hello", "trimesh cannot read it"),
    }
    for name, (content, reason) in bad.items():
        (tmp_path / name).write_bytes(content)
        wall["file"] = str(tmp_path / name)
        with pytest.raises(CaseError, match=rf"wall\[0\]\.file: {reason}"):
            particlerb.run(scene(make, make.sphere(), wall=[wall]))
