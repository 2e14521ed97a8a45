"""Where a ray meets what is shown, and the numbers as they are shown."""

import numpy as np
import pytest

from particlerb.case.to_system import to_system
from particlerb.export.surfaces import Surfaces, equal_ellipsoid, walls_of
from particlerb.model.state import as_frame
from particlerb.view.number_tables import NumberGroup, NumberRow, euler_deg, shown, table

BOX = {"name": "box", "shape": {"type": "box", "size": [1.0, 2.0, 3.0]}, "mass": 1.0}
HALF = np.sqrt(0.5)
PLACE = {"place": {"type": "grid", "spacing": 3.0}}


def surfaces(*bodies):
    return Surfaces(to_system({"run": {"t_end": 1.0, "every": 0.1}, "body": list(bodies)}))


def hit(which, origin, direction, position=(0.0, 0.0, 0.0), q=(1.0, 0.0, 0.0, 0.0)):
    place, turn = np.array([position], dtype=float), np.array([q], dtype=float)
    return which.hit(place, turn, np.array(origin, dtype=float), np.array(direction, dtype=float))


def test_box_is_met_on_its_faces():
    box = surfaces(BOX)
    found = hit(box, [5.0, 0.3, -0.7], [-2.0, 0.0, 0.0])
    assert found.at == pytest.approx([0.5, 0.3, -0.7], abs=1e-15)
    assert found.normal == pytest.approx([1.0, 0.0, 0.0])
    assert found.distance == pytest.approx(4.5)
    assert hit(box, [5.0, 1.3, 0.0], [-1.0, 0.0, 0.0]) is None
    assert hit(box, [5.0, 0.0, 0.0], [1.0, 0.0, 0.0]) is None  # it lies behind


def test_the_point_is_in_the_body_frame():
    """A quarter turn about z brings the long edge y to -x; the box stands at (10, 0, 0)."""
    found = hit(
        surfaces(BOX), [0.0, 0.2, 0.1], [1.0, 0.0, 0.0], (10.0, 0.0, 0.0), (HALF, 0, 0, HALF)
    )
    assert found.distance == pytest.approx(9.0)
    assert found.at == pytest.approx([0.2, 1.0, 0.1], abs=1e-14)
    assert found.normal == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


def test_balls_and_ellipsoids_are_round(make):
    ball = surfaces(make.sphere(radius=2.0))
    found = hit(ball, [5.0, 1.2, 0.0], [-1.0, 0.0, 0.0])
    assert found.at == pytest.approx([1.6, 1.2, 0.0], abs=1e-15)
    assert found.normal == pytest.approx([0.8, 0.6, 0.0], abs=1e-15)
    shape = {"type": "ellipsoid", "semi_axes": [1.0, 2.0, 3.0]}
    egg = surfaces({"name": "egg", "shape": shape, "mass": 1.0})
    found = hit(egg, [0.5, 0.0, 9.0], [0.0, 0.0, -1.0])
    assert found.at == pytest.approx([0.5, 0.0, 3.0 * np.sqrt(0.75)], abs=1e-12)
    slope = np.array([0.5, 0.0, np.sqrt(0.75) / 3.0])
    assert found.normal == pytest.approx(slope / np.linalg.norm(slope), abs=1e-12)


def test_the_nearest_body_is_met(make):
    pair = surfaces(make.sphere("a"), make.sphere("b"))
    place = np.array([[1.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    assert pair.hit(place, turn, np.zeros(3), np.array([1.0, 0.0, 0.0])).body == 0
    assert pair.hit(place, turn, np.array([9.0, 0, 0]), np.array([-1.0, 0.0, 0.0])).body == 1


@pytest.mark.parametrize("ray", [([np.nan, 0, 0], [1, 0, 0]), ([0, 0, 9], [0, 0, 0])])
def test_a_ray_that_is_none_meets_nothing(ray):
    assert hit(surfaces(BOX), *ray) is None


SHAPES = [
    {"type": "cylinder", "radius": 0.5, "height": 2.0},
    {"type": "cylinder", "radius": 0.5, "inner_radius": 0.2, "height": 2.0},
    {"type": "cone", "radius": 0.5, "height": 2.0},
    {"type": "torus", "major_radius": 1.0, "minor_radius": 0.2},
    {"type": "shell", "radius": 0.5},
    {"type": "tetrahedron", "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    {"type": "rod", "length": 2.0},
    {"type": "moments", "inertia": [1.0, 2.0, 2.5]},
    {"type": "cloud", "n": 8, "radius": 0.3},
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape["type"])
def test_every_shape_has_a_surface_around_its_centre_of_mass(shape):
    """Rays from all sides at corners of what is shown meet it there or before."""
    which = surfaces({"name": "b", "shape": shape, "mass": 1.0})
    form = which.of_kind(0)
    reach = which.reach[0]
    corners = form.mesh.vertices
    assert np.linalg.norm(corners, axis=1).max() == pytest.approx(reach, rel=0.05)
    assert np.abs(corners.mean(axis=0)).max() < reach
    met = []
    for corner in corners[:: max(1, len(corners) // 20)]:
        inside = 0.999 * corner + 0.001 * corners.mean(axis=0)
        start = inside * 10.0 * reach / max(np.linalg.norm(inside), 1e-3 * reach)
        found = hit(which, start, inside - start)
        met.append(found is not None)
    assert np.mean(met) > 0.8  # a corner may be missed by rounding


SOLIDS = [
    (SHAPES[0], np.pi * 0.25 * 2.0),
    (SHAPES[1], np.pi * (0.25 - 0.04) * 2.0),
    (SHAPES[2], np.pi * 0.25 * 2.0 / 3.0),
    (SHAPES[3], 2.0 * np.pi**2 * 0.2**2),
    (SHAPES[4], 4.0 / 3.0 * np.pi * 0.5**3),
    (SHAPES[5], 1.0 / 6.0),
    (SHAPES[5] | {"vertices": [[1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 0, 1]]}, 1.0 / 6.0),
]


@pytest.mark.parametrize(("shape", "volume"), SOLIDS)
def test_a_surface_is_closed_looks_outward_and_holds_the_volume_of_its_solid(shape, volume):
    """By the divergence theorem over its triangles; 48 facets take off less than 1 %."""
    mesh = surfaces({"name": "b", "shape": shape, "mass": 1.0}).of_kind(0).mesh
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1], corners[:, 2])
    assert np.einsum("ij,ij->", corners[:, 0], normals) / 6.0 == pytest.approx(volume, rel=0.01)
    _, vertex = np.unique(mesh.vertices.round(12), axis=0, return_inverse=True)
    faces = vertex.reshape(-1)[mesh.faces]
    edges = [(int(f[k]), int(f[k - 1])) for f in faces for k in range(3)]
    assert len(set(edges)) == len(edges)  # each one once, and once the other way round
    assert {(b, a) for a, b in edges} == set(edges)


def test_corners_of_what_is_round_lie_on_its_axes():
    """The page proposed to push a top at 8.48e-18 m."""
    for shape in (SHAPES[0], SHAPES[3], SHAPES[4]):
        corners = surfaces({"name": "b", "shape": shape, "mass": 1.0}).of_kind(0).mesh.vertices
        assert (corners[np.abs(corners) < 1e-12] == 0.0).all()


def test_a_mesh_and_spheres_are_shown_as_they_are(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.box(extents=[2000.0, 1000.0, 500.0]).export(tmp_path / "b.stl")
    shape = {"type": "mesh", "file": str(tmp_path / "b.stl"), "scale": 1e-3}
    found = hit(surfaces({"name": "b", "shape": shape, "mass": 1.0}), [9, 0.2, 0.1], [-1, 0, 0])
    assert found.at == pytest.approx([1.0, 0.2, 0.1], abs=1e-12)
    shape = {"type": "spheres", "position": [[-0.4, 0, 0], [0.4, 0, 0]], "radius": 0.5}
    found = hit(surfaces({"name": "b", "shape": shape, "mass": 1.0}), [9, 0, 0], [-1, 0, 0])
    assert found.at == pytest.approx([0.9, 0.0, 0.0], abs=1e-12)


def test_a_cloud_of_many_kinds_is_shown_by_ellipsoids_with_its_moments(make):
    shape = {"type": "cloud", "n": 9, "radius": 1.0}
    body = {"name": "c", "shape": shape, "mass": 3.0, "count": 4}
    system = to_system(make.case(body | PLACE))
    axes = equal_ellipsoid(system.bodies.inertia[:, 2], 3.0)
    moments = 3.0 / 5.0 * (np.sum(axes**2) - axes**2)
    assert moments == pytest.approx(system.bodies.inertia[:, 2], rel=1e-12)
    assert len(Surfaces(system).layers) == 1


def test_walls_lie_where_the_case_says(make):
    wall = [
        {"type": "plane", "name": "floor", "normal": [0, 0, 2], "point": [0, 0, -1]},
        {"type": "box", "name": "room", "lower": [0, 0, 0], "upper": [1, 2, 3]},
        {"type": "cylinder", "name": "drum", "axis": [1, 0, 0], "radius": 0.5, "length": 4.0},
    ]
    contact = {"stiffness": 1e4, "restitution": 0.5, "friction": 0.1}
    made = to_system(
        make.case(make.sphere(position=[0.5, 1.0, 1.0]), wall=wall, contact=contact, dt=1e-3)
    )
    floor, room, drum = walls_of(made, 1.0)
    assert floor.vertices[:, 2] == pytest.approx([-1.0] * 4)
    assert room.vertices.max(axis=0) == pytest.approx([1.0, 2.0, 3.0])
    assert np.ptp(drum.vertices, axis=0) == pytest.approx([4.0, 1.0, 1.0], rel=1e-3)


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.1, 3, "0.1"), (1.0 / 3.0, 4, "0.3333…"), (1.0 / 3.0, 17, "0.3333333333333333"),
        (-0.0, 3, "0"), (0.6000000000000001, 17, "0.6000000000000001"), (12345.0, 3, "1.23e+04…"),
        (5e-324, 5, "5e-324"), (np.nan, 5, "nan…"),
    ],
)  # fmt: skip
def test_a_number_is_whole_or_says_that_it_is_not(value, digits, text):
    assert shown(float(value), digits) == text


def test_seventeen_digits_bring_back_every_float():
    rng = np.random.default_rng(1)
    for value in rng.normal(size=1000) * 10.0 ** rng.integers(-300, 300, 1000):
        assert float(shown(float(value), 17)) == value


def test_euler_angles_are_those_of_a_case(make):
    turned = BOX | {"orientation": {"euler_deg": [10.0, -20.0, 130.0]}}
    system = to_system(make.case(turned))
    q = as_frame(system.bodies, system.state).orientation[0, 0]
    assert euler_deg(q) == pytest.approx([10.0, -20.0, 130.0], abs=1e-12)


def test_the_table_escapes_what_a_case_calls_its_bodies():
    text = table("<script>", [NumberGroup("a & b", (NumberRow("k", "<i>", (1.0,), 1.0),))], 5)
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
