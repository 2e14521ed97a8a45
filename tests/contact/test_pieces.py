"""Balls on surfaces of triangles: one contact for each piece of it, and energy over edges."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

import particlerb
from particlerb.compiled.jit import kernel
from particlerb.contact.wall_shapes import surface
from particlerb.contact.walls import euler_count, gap_vector, primitive_at
from particlerb.simulation.whole_run import RunError

TURN = Rotation.from_rotvec([0.3, -0.8, 0.5])


def written(path, vertices, faces):
    """Wall of triangles from a file in which no digit is lost."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.export(path, file_type="obj", digits=17)
    return {"type": "mesh", "name": "wall", "file": str(path)}


def scene(make, wall, ball, g, law, t_end, dt, every, **keys):
    run = {"t_end": t_end, "every": every, "dt": dt, "method": "strang", "threads": 1}
    gravity = {"acceleration": list(g)}
    return {"run": run, "wall": [wall], "body": [ball], "contact": law, "gravity": gravity} | keys


# Energy of what counts


@kernel
def energies(walls, x, radius, energy, force):
    """½ (r - d)² of all points that count, and the force of it."""
    for i in range(x.shape[0]):
        at = x[i, 0], x[i, 1], x[i, 2]
        for p in range(walls.kind.size):
            one = primitive_at(walls.kind, walls.parameter, p)
            count, _ = euler_count(one, walls.around, at)
            away = gap_vector(one, at)
            d = np.sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2])
            if count != 0 and d < radius:
                energy[i] += count * 0.5 * (radius - d) * (radius - d)
                for k in range(3):
                    force[i, k] += count * (radius - d) * away[k] / d


def bumpy(rng, n=9):
    """Rough surface with edges and vertices of all kinds, and a fin that makes three faces meet."""
    k = np.linspace(-1.0, 1.0, n)
    x, y = (a.ravel() for a in np.meshgrid(k, k))
    points = np.column_stack([x, y, 0.1 * rng.standard_normal(n * n)])
    faces = Delaunay(points[:, :2] + 1e-3 * rng.standard_normal((n * n, 2))).simplices
    fin, top = np.array([[*faces[n][:2], n * n]]), points[faces[n][:2]].mean(axis=0)
    return np.vstack([points, top + np.array([0.01, 0.0, 0.1])]), faces, fin


@pytest.mark.slow
@pytest.mark.parametrize("has_fin", [False, True])
def test_the_energy_of_what_counts_has_a_continuous_slope(has_fin):
    """A jump of the energy by 1e-6 anywhere on the lines would be a slope of 0.1 too much."""
    rng, h = np.random.default_rng(3), 1e-5
    points, faces, fin = bumpy(rng)
    wall = surface(points, np.vstack([faces, fin]) if has_fin else faces)
    a, b = rng.uniform([-0.7, -0.7, 0.35], [0.7, 0.7, 0.6], (2, 6, 3))
    share = np.linspace(0.0, 1.0, 201)[:, None, None]
    x = (a + share * (b - a)).reshape(-1, 3)
    along = np.tile((b - a) / np.linalg.norm(b - a, axis=1)[:, None], (201, 1, 1)).reshape(-1, 3)
    energy, force = np.zeros((2, len(x))), np.zeros((2, len(x), 3))
    step = np.linalg.norm(b - a, axis=1)[None, :] / 200.0
    for k, shift in enumerate((0.0, h)):
        energies(wall, x + shift * along, 0.8, energy[k], force[k])
    mean = 0.5 * np.einsum("kij,ij->i", force, along)
    assert np.abs((energy[1] - energy[0]) / h + mean).max() < 20 * h
    slope = np.einsum("ij,ij->i", force[0], along).reshape(201, 6)
    gone = 0.5 * (slope[1:] + slope[:-1]) * step
    change = np.diff(energy[0].reshape(201, 6), axis=0)
    assert np.abs(change + gone).max() < 20 * step.max() ** 2
    assert np.ptp(energy[0]) > 0.03


def test_what_is_nearly_flat_counts_as_one_contact():
    """In the middle of a plane, of a ridge and of a shallow valley."""
    for bend in (0.0, 0.2, -1e-3):
        points = np.array([[0, -1, 0], [0, 1, 0], [1, 0, -bend], [-1, 0, -bend]], dtype=float)
        wall = surface(points, np.array([[0, 1, 2], [0, 1, 3]]))
        energy, force = np.zeros(1), np.zeros((1, 3))
        energies(wall, np.array([[0.0, 0.1, 0.3]]), 0.4, energy, force)
        assert energy[0] == pytest.approx(0.5 * 0.1**2, rel=1e-4)
        assert force[0] == pytest.approx([0, 0, 0.1], rel=1e-4, abs=1e-12)


# Seams of a plane


def cut_plane(seed):
    """Plane z = 0 in random triangles; vertices on the way of a ball along x, and slivers."""
    rng = np.random.default_rng(seed)
    way = np.column_stack([np.sort(rng.uniform(0.2, 5.0, 40)), np.zeros(40)])
    near = way[:15] + rng.uniform(-1, 1, (15, 2)) * 10.0 ** rng.uniform(-9, -3, (15, 1))
    ends = [[-1, -1], [6, -1], [6, 1], [-1, 1]]
    points = np.concatenate([rng.uniform([-1, -1], [6, 1], (300, 2)), way, near, ends])
    faces = Delaunay(points).simplices
    flip = rng.random(len(faces)) < 0.5
    faces[flip] = faces[flip][:, ::-1]
    return TURN.apply(np.column_stack([points, np.zeros(len(points))])), faces


@pytest.mark.compiled
@pytest.mark.parametrize(("friction", "e"), [(0.0, 0.5), (0.3, 0.5), (0.3, 1.0)])
def test_a_ball_rolls_over_seams_as_on_the_plane(make, tmp_path, friction, e):
    """Along vertices and across 100 seams and more; it slides at first, and is pulled along."""
    normal = TURN.apply([0, 0, 1])
    flat = {"type": "plane", "name": "wall", "normal": normal.tolist()}
    start = TURN.apply([[0, 0, 0.1 - 9.81e-5], [2.0, 0, 0]]).tolist()
    ball = make.sphere(position=start[0], velocity=start[1], mass=1.0)
    law = make.hooke(1e5, e, friction, overlap=1e-3)
    fields = ["position", "orientation", "contact_number"]
    found = []
    for wall in (flat, written(tmp_path / "cut.obj", *cut_plane(5))):
        g = TURN.apply([0.3, 0.05, -9.81])
        case = scene(make, wall, ball, g, law, 2.0, 2e-4, 0.01, output={"fields": fields})
        with particlerb.run(case) as t:
            found.append((t.position[:, 0], t.orientation[:, 0]))
            assert (t.contact_number[:, 0] == 1).all()
    path = np.linalg.norm(np.diff(found[0][0], axis=0), axis=1).sum()
    assert path > 3.0
    assert np.abs(found[1][0] - found[0][0]).max() < 1e-10 * path
    assert make.angle(found[0][1], found[1][1]).max() < 1e-10


# Edges at an angle


def tube(low, high, bottom, top, sides):
    """Frustum without ends, each side in two triangles."""
    turn = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
    points = np.concatenate([low * circle + [0, 0, bottom], high * circle + [0, 0, top]])
    k, after = np.arange(sides), np.roll(np.arange(sides), -1)
    one = np.column_stack([k, after, sides + after])
    return points, np.concatenate([one, np.column_stack([k, sides + after, sides + k])])


@pytest.mark.compiled
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_energy_in_a_cylinder_of_triangles_is_kept_to_order_two(make, tmp_path, friction):
    """A quarter of the step, 16 times less; the worst of three starts, which meet other edges."""
    wall = written(tmp_path / "tube.obj", *tube(1.0, 1.0, -1.0, 1.0, 48))
    law, off = make.hooke(1e4, 1.0, friction, allow_unstable=True), []
    for dt in (4e-4, 1e-4):
        worst = 0.0
        for k in (0.0, 0.03, 0.07):
            ball = make.sphere(radius=0.2, mass=1.0, position=[0.05 + k, -0.5, 0.1])
            ball["velocity"] = [1.5, 0.2, 0.1 + k]
            with particlerb.run(scene(make, wall, ball, [0, -9.81, 0], law, 1.5, dt, 0.03)) as t:
                error = np.abs(t.ledger.energy_error).max() / t.ledger.kinetic_energy.max()
            worst = max(worst, float(error))
        off.append(worst)
    assert np.log2(off[0] / off[1]) > 2 * 1.8
    assert off[1] < 1e-6


@pytest.mark.compiled
def test_energy_of_clumps_in_a_hopper_of_triangles_is_kept_to_order_two(make, tmp_path):
    wall = written(tmp_path / "hopper.obj", *tube(0.08, 0.5, 0.0, 0.6, 24))
    at = [[0, 0, 0], [0.04, 0, 0], [0, 0.04, 0], [0, 0, 0.04]]
    clumps = {
        "name": "clump",
        "shape": {"type": "points", "mass": 0.1, "radius": 0.03, "position": at},
    }
    clumps |= {"count": 12, "orientation": "random", "velocity": {"random": 0.5}}
    clumps["place"] = {"type": "grid", "spacing": 0.14, "n": [3, 2, 2], "origin": [0, 0, 0.6]}
    law, off = make.hooke(2e4, 0.6, 0.4), []
    for dt in (8e-5, 2e-5):
        with particlerb.run(scene(make, wall, clumps, [0, 0, -9.81], law, 0.4, dt, 0.02)) as t:
            off.append(np.abs(t.ledger.energy_error).max() / np.abs(t.ledger.work).max())
    assert np.log2(off[0] / off[1]) > 2 * 1.75
    assert off[1] < 1e-6


@pytest.mark.compiled
def test_a_fine_ring_that_gives_way_ends_the_run(make, tmp_path):
    """200 sides all around hold 0.8 k r 2π/200, eight times less than the ball weighs."""
    wall = written(tmp_path / "funnel.obj", *tube(0.05, 0.5, 0.0, 0.45, 200))
    ball = make.sphere(radius=0.2, position=[1e-3, 0, 0.45], mass=2.0)
    law = make.hooke(1e3, 0.3, 0.3, allow_unstable=True)
    with pytest.raises(RunError, match="too soft for its speed or load"):
        particlerb.run(scene(make, wall, ball, [0, 0, -9.81], law, 2.0, 2e-4, 0.1))
