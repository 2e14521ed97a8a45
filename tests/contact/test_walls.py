"""Walls: distances by other formulas, one contact where a surface is smooth, prescribed motion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from particlerb.compiled.jit import config, kernel
from particlerb.contact import wall_search as module
from particlerb.contact.records import to_floats
from particlerb.contact.wall_motion import PrescribedMotion, continued, poses_at, wall_displacement
from particlerb.contact.wall_search import WallSearch, bounding_boxes
from particlerb.contact.wall_shapes import box, cylinder, joined, plane, surface
from particlerb.contact.walls import (
    EDGE,
    FACE,
    FAR,
    NEAR,
    VERTEX,
    gap_and_velocity,
    nearest,
    nearest_on_triangle,
    primitive_at,
)

PLAIN = bool(config.DISABLE_JIT)
seeds = st.integers(0, 2**32 - 1)
REST = PrescribedMotion()


@kernel
def gaps_and_velocities(walls, poses, p, x, gap, velocity):
    for k in range(p.size):
        gap[k], velocity[k] = gap_and_velocity(walls, poses, p[k], (x[k, 0], x[k, 1], x[k, 2]))


@kernel
def nearest_points(walls, p, x, found):
    for k in range(p.size):
        one = primitive_at(walls.kind, walls.parameter, p[k])
        found[k] = nearest(one, (x[k, 0], x[k, 1], x[k, 2]))


@kernel
def on_triangle(a, b, c, x, found):
    found[0], found[1], found[2] = nearest_on_triangle(a, b, c, x)


def touched(walls, x, motions=None, t=0.0):
    """Gaps (n, n_primitives, 3) of centres (n, 3), and velocities; FAR gaps are NaN."""
    n, m = len(x), walls.kind.size
    p, each = np.tile(np.arange(m), n), np.repeat(x, m, axis=0)
    gap, velocity = np.empty((n * m, 3)), np.empty((n * m, 3))
    poses = poses_at(motions or [REST] * (walls.wall.max() + 1), t)
    gaps_and_velocities(walls, poses, p, each, gap, velocity)
    gap[np.abs(gap).max(axis=1) > 0.1 * FAR] = np.nan
    return gap.reshape(n, m, 3), velocity.reshape(n, m, 3)


def distances(walls, x):
    """Distances at which each centre touches, sorted, NaN last."""
    return np.sort(np.linalg.norm(touched(walls, np.atleast_2d(x))[0], axis=2), axis=1)


def contacts(walls, x):
    """Gap vectors of one centre."""
    gap = touched(walls, np.array([x], dtype=float))[0][0]
    return gap[~np.isnan(gap[:, 0])]


# Nearest points


@settings(max_examples=30 if PLAIN else 100)
@given(seeds)
def test_nearest_points_are_those_of_a_search(seed):
    """Of a convex set: the projection x* has (x - x*)·(y - x*) <= 0 for all y of the set."""
    rng = np.random.default_rng(seed)
    a, b, c, x = rng.standard_normal((4, 3))
    b = b if seed % 3 else a + 1e-3 * b
    found = np.empty(3)
    on_triangle(tuple(a), tuple(b), tuple(c), tuple(x), found)
    corners = np.array([a, b, c])
    assert ((corners - found) @ (x - found)).max() <= 1e-12 * (1 + x @ x)
    weight = np.linalg.lstsq(np.vstack([corners.T, np.ones(3)]), [*found, 1.0], rcond=None)[0]
    assert weight.min() > -1e-9


def test_a_body_behind_a_plane_is_pushed_to_its_front():
    wall = plane([0, 0, 1.0], [0, 0, 2.0])
    assert contacts(wall, [5.0, -3.0, 4.0]).tolist() == [[0.0, 0.0, 3.0]]
    assert contacts(wall, [5.0, -3.0, 0.5]).tolist() == [[0.0, 0.0, NEAR]]


@pytest.mark.parametrize("axis", [[0, 0, 1.0], [1.0, -2.0, 0.5]])
@pytest.mark.parametrize("caps", [(False, False), (True, False), (True, True)])
def test_cylinder_is_as_far_as_its_meridian(axis, caps):
    """In the half plane through the axis a cylinder is three segments."""
    rng = np.random.default_rng(1)
    R, half, centre = 1.5, 1.0, np.array([0.3, -0.2, 0.7])
    wall = cylinder(centre, axis, R, 2 * half, caps)
    turn = Rotation.align_vectors([axis], [[0, 0, 1.0]])[0]
    z, rho = rng.uniform(-2, 2, 300), rng.uniform(1e-3, 3, 300)
    angle = rng.uniform(0, 2 * np.pi, 300)
    x = centre + turn.apply(np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=1))
    expected = np.hypot(rho - R, np.maximum(np.abs(z) - half, 0.0))
    for sign, is_closed in zip((-1, 1), caps, strict=True):
        if is_closed:
            to_cap = np.hypot(np.maximum(rho - R, 0.0), z - sign * half)
            expected = np.minimum(expected, to_cap)
    assert np.allclose(distances(wall, x)[:, 0], expected, rtol=0, atol=1e-14)


def test_a_ball_inside_a_cylinder_touches_side_and_bottom_once_each():
    wall = cylinder([0, 0, 1.0], [0, 0, 1.0], 1.0, 2.0, (True, False))
    found = contacts(wall, [0.8, 0.0, 0.3])
    assert np.allclose(found[np.argsort(found[:, 2])], [[-0.2, 0, 0], [0, 0, 0.3]], atol=1e-15)
    rim = contacts(wall, [0.9, 0.0, 2.2])  # the open end is no disc
    assert np.allclose(rim, [[0, 0, 2.2], [-0.1, 0.0, 0.2]], atol=1e-15)


def test_outside_a_closed_end_there_is_one_contact_with_disc_or_rim():
    wall = cylinder([0, 0, 1.0], [0, 0, 1.0], 1.0, 2.0)
    for rho, expected in ((0.9, [0, 0, 0.2]), (1.1, [0.1, 0, 0.2])):
        gap = contacts(wall, [rho, 0.0, 2.2])
        near = gap[np.linalg.norm(gap, axis=1) < 1.0]
        assert len(near) == 1
        assert np.allclose(near[0], expected, atol=1e-15)


def test_on_the_axis_of_a_cylinder_some_point_of_the_side_is_nearest():
    for axis in ([0, 0, 1.0], [1.0, 0, 0], [1.0, 1.0, 1.0]):
        gap = contacts(cylinder([0, 0, 0], axis, 1.0, 4.0, (False, False)), [0, 0, 0.0])
        assert np.linalg.norm(gap, axis=1) == pytest.approx(1.0, abs=1e-15)


# Surfaces


def test_a_ball_in_the_corner_of_a_box_touches_three_faces():
    wall = box([0, 0, 0], [1, 2, 3], ["+z"])
    found = contacts(wall, [0.1, 0.2, 0.3])
    near = found[np.linalg.norm(found, axis=1) < 0.5]
    assert sorted(near.tolist()) == [[0, 0, 0.3], [0, 0.2, 0], [0.1, 0, 0]]


def test_nothing_closes_an_open_face_but_its_rim():
    wall = box([0, 0, 0], [1, 1, 1], ["+z"])
    assert np.nanmin(distances(wall, [0.5, 0.5, 1.2])) == pytest.approx(math.hypot(0.5, 0.2))
    rim = contacts(wall, [0.02, 0.5, 1.05])
    near = rim[np.linalg.norm(rim, axis=1) < 0.3]
    assert np.allclose(near, [[0.02, 0.0, 0.05]], atol=1e-15)
    corner = contacts(wall, [-0.1, -0.2, 1.2])
    near = corner[np.linalg.norm(corner, axis=1) < 0.5]
    assert np.allclose(near, [[-0.1, -0.2, 0.2]], atol=1e-15)


@pytest.mark.plain
@settings(max_examples=30 if PLAIN else 200)
@given(seeds)
def test_a_convex_body_of_triangles_is_touched_once_from_outside(seed):
    """At the projection of the centre, which a quadratic program finds too."""
    rng = np.random.default_rng(seed)
    vertices = rng.standard_normal((12, 3))
    hull = Delaunay(vertices).convex_hull
    wall = surface(vertices, hull)
    x = 3.0 * rng.standard_normal(3)
    if Delaunay(vertices).find_simplex(x) >= 0:
        return
    gap = contacts(wall, x)
    assert len(gap) >= 1
    inner = vertices.mean(axis=0)
    length = np.linalg.norm(gap, axis=1)
    best = gap[np.argmin(length)]
    assert ((vertices - (x - best)) @ best).max() <= 1e-10 * (x @ x + 1)
    outward = gap[np.einsum("ij,ij->i", gap, x - gap - inner) > 0]
    facing = [g for g in outward if ((vertices - (x - g)) @ g).max() <= 1e-10 * (x @ x + 1)]
    assert len(facing) == 1


def triangulated(rng, n, turn):
    """Plane z = 0 as an irregular mesh, turned."""
    points = np.concatenate([rng.uniform(-1, 1, (n, 2)), [[-1, -1], [-1, 1], [1, -1], [1, 1.0]]])
    mesh = Delaunay(points).simplices
    flip = rng.random(len(mesh)) < 0.5
    mesh[flip] = mesh[flip][:, ::-1]
    return turn.apply(np.column_stack([points, np.zeros(len(points))])), mesh


@pytest.mark.parametrize("turn", [Rotation.identity(), Rotation.from_rotvec([0.3, -0.8, 0.5])])
def test_a_ball_that_slides_over_triangles_feels_a_plane(turn):
    rng = np.random.default_rng(2)
    vertices, mesh = triangulated(rng, 40, turn)
    wall = surface(vertices, mesh)
    x = np.column_stack([rng.uniform(-0.9, 0.9, (2000, 2)), rng.uniform(-0.3, 0.3, 2000)])
    gap = touched(wall, turn.apply(x))[0]
    near = np.nan_to_num(np.linalg.norm(gap, axis=2), nan=np.inf) < 2.0
    assert (near.sum(axis=1) == 1).all()
    expected = turn.apply(np.column_stack([np.zeros((2000, 2)), x[:, 2]]))
    assert np.abs(gap[near] - expected).max() < 1e-15


def test_a_ball_exactly_above_edges_and_vertices_touches_once():
    """A square lattice with diagonals: all sums are exact, and all places are on the lattice."""
    k = np.arange(-3, 4)
    x, y = (a.ravel() for a in np.meshgrid(k, k, indexing="ij"))
    vertices = np.column_stack([x, y, np.zeros(49)]) / 4.0
    at = np.arange(49).reshape(7, 7)
    mesh = [
        three
        for i in range(6)
        for j in range(6)
        for three in (
            (at[i, j], at[i + 1, j], at[i + 1, j + 1]),
            (at[i, j + 1], at[i, j], at[i + 1, j + 1]),
        )
    ]
    wall = surface(vertices, np.array(mesh))
    assert not ((wall.kind == VERTEX) & (np.abs(wall.parameter[:, :2]).max(axis=1) < 0.7)).any()
    fine = np.arange(-10, 11) / 16.0
    a, b = (u.ravel() for u in np.meshgrid(fine, fine))
    for height in (0.125, -0.125):
        gap = touched(wall, np.column_stack([a, b, np.full(a.size, height)]))[0]
        assert ((~np.isnan(gap[:, :, 0])).sum(axis=1) == 1).all()
        assert (gap[~np.isnan(gap[:, :, 0])] == [0.0, 0.0, height]).all()


def test_faces_of_a_turned_plane_share_their_edges_without_gap():
    """Above edges the sides differ by roundings only: the normals have to be the very same."""
    rng = np.random.default_rng(4)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5])
    vertices, mesh = triangulated(rng, 30, turn)
    wall = surface(vertices, mesh)
    ends = vertices[mesh[:, :2]][np.abs(turn.inv().apply(vertices))[mesh[:, :2]].max((1, 2)) < 1]
    share = rng.uniform(0.1, 0.9, (5, len(ends), 1))
    x = (share * ends[:, 0] + (1 - share) * ends[:, 1]).reshape(-1, 3) + turn.apply([0, 0, 0.2])
    gap = touched(wall, x)[0][:, (wall.kind == FACE)]
    assert ((~np.isnan(gap[:, :, 0])).sum(axis=1) == 1).all()


def test_a_surface_that_is_folded_back_keeps_its_edge():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.5, 0]])
    wall = surface(vertices, np.array([[0, 1, 2], [0, 1, 3]]))
    assert (wall.kind == EDGE).sum() == 5


def test_over_a_ridge_there_is_one_contact_and_in_a_valley_there_are_two():
    vertices = np.array([[0, -1, 0], [0, 1, 0], [1, 0, -0.5], [-1, 0, -0.5]], dtype=float)
    ridge = surface(vertices, np.array([[0, 1, 2], [0, 1, 3]]))
    count = [len(contacts(ridge, [s, 0.0, 0.3])) for s in np.linspace(-0.4, 0.4, 33)]
    assert count == [1] * 33
    assert np.allclose(contacts(ridge, [0.0, 0.1, 0.3]), [[0, 0, 0.3]], atol=1e-15)
    assert len(contacts(ridge, [0.01, 0.0, -0.2])) == 2  # from below


def test_the_force_over_a_ridge_is_continuous():
    """Distances and directions to the one contact go on without a jump from face to edge."""
    vertices = np.array([[0, -1, 0], [0, 1, 0], [1, 0, -0.5], [-1, 0, -0.5]], dtype=float)
    wall = surface(vertices, np.array([[0, 1, 2], [0, 1, 3]]))
    gap = np.array([contacts(wall, [s, 0.1, 0.3])[0] for s in np.linspace(-0.4, 0.4, 801)])
    assert np.abs(np.diff(gap, axis=0)).max() < 1.01e-3


def test_boundary_edges_and_lone_triangles_can_be_touched():
    wall = surface(np.eye(3), np.array([[0, 1, 2]]))
    assert (wall.kind == FACE).sum() == 1
    assert (wall.kind == EDGE).sum() == (wall.kind == VERTEX).sum() == 3
    x = np.random.default_rng(3).uniform(-2, 2, (200, 3))
    expected = [
        minimize(
            lambda w, y=y: ((np.array([w[0], w[1], 1 - w[0] - w[1]]) - y) ** 2).sum(),
            [0.3, 0.3],
            bounds=[(0, 1), (0, 1)],
            constraints={"type": "ineq", "fun": lambda w: 1 - w[0] - w[1]},
            method="SLSQP",
            options={"ftol": 1e-14},
        ).fun
        ** 0.5
        for y in x[:20]
    ]
    found = distances(wall, x)
    assert (~np.isnan(found)).sum(axis=1).tolist() == [1] * 200
    assert np.allclose(found[:20, 0], expected, atol=1e-6)


def test_triangles_without_area_and_doubled_vertices_are_harmless():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    wall = surface(vertices, np.array([[0, 1, 2], [3, 4, 5], [1, 3, 5], [0, 0, 1]]))
    assert (wall.kind == FACE).sum() == 2
    assert (wall.kind == EDGE).sum() == 4


# Motion


def test_motion_is_a_closed_form_and_velocity_its_derivative():
    motion = PrescribedMotion(
        (1.0, 2.0, 3.0), (0.1, 0, 0.2), (0.3, -0.5, 0.7), (0, 0.4, 0.1), 1.7, 0.3
    )
    wall, p = plane([1.0, 2.0, 3.0], [0.2, 0.3, 1.0]), np.array([[0.5, 0.6, 0.7]])

    def place(t):
        X, q = np.split(to_floats(poses_at([motion], t))[0, :7], [3])
        return X + Rotation.from_quat(q, scalar_first=True).apply(p[0])

    t, h = 0.9, 1e-5
    pose = poses_at([motion], t)
    X, v, omega = pose.position[0], pose.velocity[0], pose.angular_velocity[0]
    speed = v + np.cross(omega, place(t) - X)
    assert np.allclose(speed, (place(t + h) - place(t - h)) / (2 * h), atol=1e-8)
    turn = Rotation.from_rotvec(t * np.array(motion.angular_velocity))
    way = t * np.array(motion.velocity) + np.array(motion.amplitude) * np.sin(3.4 * np.pi * t + 0.3)
    assert np.allclose(place(t), motion.centre + way + turn.apply(p[0] - motion.centre), atol=1e-14)
    gap, velocity = (u[0, 0] for u in touched(wall, place(t)[None], [motion], t))
    at = place(t) - gap - X
    assert np.allclose(velocity, v + np.cross(omega, at), atol=1e-14)


def test_a_motion_goes_on_from_where_another_has_led_to():
    """Twice: by turns R₃(t - t₂) R₂(t₂ - t₁) R₁(t₁) about a centre that goes along."""
    centre, w = (1.0, 2.0, 3.0), np.array([(0.3, -0.5, 0.7), (-1.0, 0.2, 0.4), (0.1, 2.0, 0.0)])
    v, times = np.array([(0.1, 0, 0.2), (0.3, 0.2, 0.0), (0.0, 0.0, -0.4)]), (0.0, 0.9, 1.6, 2.2)
    waves = [((0, 0.4, 0.1), 1.7, 0.3), ((0.2, 0, 0), 0.5, 1.0), ((0.0, 0.1, 0), 1.0, -0.4)]
    motions = [
        PrescribedMotion(centre, *map(tuple, vw), *wave)
        for *vw, wave in zip(v, w, waves, strict=True)
    ]
    now = motions[0]
    for t, motion in zip(times[1:], motions[1:], strict=False):
        now = continued(now, motion, t)
    turn, at = Rotation.identity(), np.array(centre) + np.sin(0.3) * np.array(waves[0][0])
    for k, (amplitude, frequency, phase) in enumerate(waves):
        lasted, rate = times[k + 1] - times[k], 2.0 * np.pi * frequency
        ends = np.sin(rate * np.array(times[k : k + 2]) + phase)
        at = at + lasted * v[k] + np.diff(ends) * np.array(amplitude)
        turn = Rotation.from_rotvec(lasted * w[k]) * turn
    X, q = np.split(to_floats(poses_at([now], times[-1]))[0, :7], [3])
    found = Rotation.from_quat(q, scalar_first=True)
    p = np.array([0.5, 0.6, 0.7])
    assert np.allclose(X + found.apply(p), at + turn.apply(p - centre), atol=1e-14)
    h, t = 1e-5, times[-1]
    before, after = (to_floats(poses_at([now], s))[0, :3] for s in (t - h, t + h))
    assert np.allclose(poses_at([now], t).velocity[0], (after - before) / (2 * h), atol=1e-8)


@settings(max_examples=20 if PLAIN else 100)
@given(seeds)
def test_gap_moves_with_the_wall_and_the_bound_holds(seed):
    rng = np.random.default_rng(seed)
    wall = box([-1, -1, -1], [1, 1, 1], ["+z"])
    v, w, a = 0.3 * rng.standard_normal((3, 3))
    motion = PrescribedMotion((0.1, 0.2, 0.0), tuple(v), tuple(w), tuple(a), 2.0, 0.4)
    x, t = rng.uniform(-1.5, 1.5, 3), 3.0 * rng.random()
    X, q = np.split(to_floats(poses_at([motion], t))[0, :7], [3])
    R = Rotation.from_quat(q, scalar_first=True)
    moved = touched(wall, (X + R.apply(x))[None], [motion], t)[0][0]
    rest = touched(wall, x[None])[0][0]
    both = ~np.isnan(rest[:, 0]) & ~np.isnan(moved[:, 0])
    assert np.allclose(moved[both], R.apply(rest)[both], atol=1e-12)
    dt = 0.2 * rng.random()
    X1, q1 = np.split(to_floats(poses_at([motion], t + dt))[0, :7], [3])
    R1 = Rotation.from_quat(q1, scalar_first=True)
    way = np.linalg.norm(X1 + R1.apply(x) - X - R.apply(x))
    reach = np.linalg.norm(x - motion.centre)
    assert way <= wall_displacement([motion], dt, [reach]) * (1 + 1e-12)


# Candidates


def all_walls(rng):
    vertices, mesh = triangulated(rng, 10 if PLAIN else 60, Rotation.from_rotvec([0.3, 0.8, 0.1]))
    return joined(
        [
            plane([0, 0, -1], [0.1, 0, 1]),
            box([-1, -1, -1], [1, 1, 1], ["+z"]),
            surface(vertices, mesh),
            cylinder([0.5, 0, 0], [1, 1, 0], 0.8, 1.5, (True, False)),
        ]
    )


@pytest.mark.parametrize("skin", [0.02, 0.5])
def test_candidates_are_all_that_are_near(skin):
    rng = np.random.default_rng(7)
    walls, n = all_walls(rng), 40 if PLAIN else 1500
    x, r = rng.uniform(-2, 2, (n, 3)), rng.uniform(0.0, 0.2, n)
    motions = [
        REST,
        PrescribedMotion((0, 0, 0), (0.1, 0, 0), (1, 2, 3), (0, 0.1, 0), 1.0, 0.0),
        REST,
        REST,
    ]
    poses = poses_at(motions, 0.7)
    first, second, start = WallSearch(walls, r).pairs(np.ascontiguousarray(x.T), poses, skin)
    m = walls.kind.size
    own = poses[np.tile(walls.wall, n)]
    local = Rotation.from_quat(own.orientation, scalar_first=True)
    each = local.inv().apply(np.repeat(x, m, axis=0) - own.position)
    found = np.empty((n * m, 3))
    nearest_points(walls, np.tile(np.arange(m), n), each, found)
    d = np.linalg.norm(each - found, axis=1).reshape(n, m)
    d[:, walls.kind == 0] *= ((each - found) @ walls.parameter[0, 3:6] > 0).reshape(n, m)[
        :, walls.kind == 0
    ]
    assert np.argwhere(d < r[:, None] + skin).tolist() == np.stack([first, second], 1).tolist()
    assert (start == np.searchsorted(first, np.arange(n + 1))).all()


def test_a_search_fits_its_cells_to_a_skin_that_widens_and_narrows():
    rng = np.random.default_rng(10)
    walls, r = all_walls(rng), np.full(30, 0.1)
    x, poses = rng.uniform(-1.5, 1.5, (3, 30)), poses_at([REST] * 4, 0.0)
    search, cells = WallSearch(walls, r), []
    for skin in (0.01, 0.5, 0.01):
        found, fresh = search.pairs(x, poses, skin), WallSearch(walls, r).pairs(x, poses, skin)
        assert (found.sphere == fresh.sphere).all()
        assert (found.other == fresh.other).all()
        cells.append(search.cutoff)
    assert cells == pytest.approx([0.11, 0.6, 0.11])


def test_candidates_of_a_chosen_part_and_of_nothing():
    rng = np.random.default_rng(8)
    walls, n = all_walls(rng), 50
    x, r, which = rng.uniform(-1, 1, (3, n)), np.full(n, 0.1), np.arange(0, n, 3)
    poses, search = poses_at([REST] * 4, 0.0), WallSearch(walls, r)
    pairs, some = search.pairs(x, poses, 0.1), search.pairs(x, poses, 0.1, which)
    keep = np.isin(pairs.sphere, which)
    assert (some.sphere == pairs.sphere[keep]).all()
    assert (some.other == pairs.other[keep]).all()
    assert not search.pairs(x, poses, 0.1, which[:0]).sphere.size
    assert not WallSearch(joined([]), r).pairs(x, poses_at([], 0.0), 0.1).sphere.size


def test_lists_of_a_fine_surface_are_short():
    """The number of candidates that a cell has does not grow with the surface."""
    longest = []
    for n in (6, 12) if PLAIN else (20, 80):
        k = np.linspace(0, n / 20, n)
        a, b = (u.ravel() for u in np.meshgrid(k, k))
        mesh = Delaunay(np.column_stack([a, b])).simplices
        wall = surface(np.column_stack([a, b, 0.02 * np.sin(a) * b]), mesh)
        lists = module.lists_of(wall, 0.03)
        longest.append(np.diff(lists.begin).max())
    assert longest[1] < 3 * longest[0] + 20


def test_bounds_hold_the_whole_primitive():
    rng = np.random.default_rng(9)
    walls = all_walls(rng)
    lower, upper = bounding_boxes(walls)
    m, n = walls.kind.size, 200
    x = np.repeat(rng.uniform(-3, 3, (n, 3)), m, axis=0)
    found = np.empty((n * m, 3))
    nearest_points(walls, np.tile(np.arange(m), n), x, found)
    found = found.reshape(n, m, 3)[:, walls.kind != 0]
    assert (found >= lower[walls.kind != 0] - 1e-12).all()
    assert (found <= upper[walls.kind != 0] + 1e-12).all()
