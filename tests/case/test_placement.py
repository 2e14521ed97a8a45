"""Initial values of many bodies: reproducible, independent streams, right distributions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from particlerb.case.placement import Placement, grid_size, placement_of, random_stream
from particlerb.case.reader import load

RANDOM = {
    "place": {"type": "random", "lower": [-1, 0, 2], "upper": [1, 0, 5]},
    "orientation": "random",
    "velocity": {"random": 2.0},
    "angular_velocity": {"random": 0.5},
}


def block(name: str, count: int = 1, **keys) -> dict:
    return {
        "name": name,
        "shape": {"type": "ball", "radius": 1},
        "mass": 1,
        "count": count,
        **keys,
    }


def scene(*bodies: dict, seed: int = 0):
    return load({"run": {"t_end": 1, "every": 1, "seed": seed}, "body": list(bodies)})


def placed(*bodies: dict, seed: int = 0) -> Placement:
    return placement_of(scene(*bodies, seed=seed))


def matrices(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix()


def test_order_shapes_and_names():
    grid = {"place": {"type": "grid", "spacing": 1}}
    p = placed(block("a", position=[1, 2, 3]), block("b", 3, **grid), block("c"))
    assert_array_equal(p.block, [0, 1, 1, 1, 2])
    assert list(p.names) == ["a", "b[0]", "b[1]", "b[2]", "c"]
    assert [p.names[b] for b in range(5)] == list(p.names)
    assert p.names[-1] == "c"
    assert p.names[1:3] == ["b[0]", "b[1]"]
    with pytest.raises(IndexError):
        p.names[5]
    assert p.position.shape == p.velocity.shape == p.angular_velocity.shape == (5, 3)
    assert_array_equal(p.orientation, [[1, 0, 0, 0]] * 5)
    assert_array_equal(p.position[0], [1, 2, 3])


# Random numbers


def test_same_seed_same_bits_other_seed_other_values():
    first, again = (placed(block("a", 5, **RANDOM), seed=3) for _ in range(2))
    other = placed(block("a", 5, **RANDOM), seed=4)
    for one, two, three in zip(first[1:5], again[1:5], other[1:5], strict=True):
        assert_array_equal(one, two)
        assert np.any(one != three)


def test_another_block_after_it_changes_nothing():
    alone = placed(block("a", 5, **RANDOM))
    beside = placed(block("a", 5, **RANDOM), block("b", 7, **RANDOM))
    for one, both in zip(alone[1:5], beside[1:5], strict=True):
        assert_array_equal(one, both[:5])
    assert np.any(beside.velocity[:5] != beside.velocity[5:10])


@pytest.mark.parametrize("key", list(RANDOM))
def test_each_purpose_has_a_stream_of_its_own(key):
    """Leaving out one of the random values changes none of the others."""
    rest = {k: v for k, v in RANDOM.items() if k != key}
    rest |= {"place": {"type": "grid", "spacing": 1}} if key == "place" else {}
    names = ["position" if k == "place" else k for k in RANDOM if k != key]
    all_random, without = placed(block("a", 5, **RANDOM)), placed(block("a", 5, **rest))
    for name in names:
        assert_array_equal(getattr(all_random, name), getattr(without, name))


def test_streams_of_purposes_and_blocks_differ():
    purposes = ["place", "orientation", "velocity", "angular_velocity", "shape"]
    first = {random_stream(0, b, p).integers(2**63) for b in (0, 1) for p in purposes}
    assert len(first) == 10
    assert random_stream(7, 0, "shape").random() == random_stream(7, 0, "shape").random()


def test_first_bodies_do_not_depend_on_how_many_follow():
    few, many = placed(block("a", 5, **RANDOM)), placed(block("a", 50, **RANDOM))
    for one, more in zip(few[1:5], many[1:5], strict=True):
        assert_array_equal(one, more[:5])


def test_random_rotations_are_uniform():
    """Haar measure: E R = 0, E R_ij² = 1/3, and the angle has density (1 − cos θ)/π.

    Each mean of n values of variance s² is within 5 s/√n.
    """
    n = 20_000
    q = placed(block("a", n, **RANDOM)).orientation
    assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=4e-16)
    R = matrices(q)
    assert_allclose(R.mean(axis=0), 0.0, atol=5 / np.sqrt(3 * n))
    assert_allclose((R**2).mean(axis=0), 1 / 3, atol=5 * np.sqrt((1 / 5 - 1 / 9) / n))
    angle = np.sort(2 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), np.abs(q[:, 0])))
    exact = (angle - np.sin(angle)) / np.pi
    assert np.max(np.abs(exact - np.arange(n) / n)) < 2.0 / np.sqrt(n)


def test_random_velocities_and_places_have_the_asked_spread():
    n = 20_000
    p = placed(block("a", n, **RANDOM))
    assert_allclose(p.velocity.std(axis=0), 2.0, rtol=5 / np.sqrt(2 * n))
    assert_allclose(p.velocity.mean(axis=0), 0.0, atol=5 * 2.0 / np.sqrt(n))
    assert_allclose(p.angular_velocity.std(axis=0), 0.5, rtol=5 / np.sqrt(2 * n))
    assert_allclose(p.position.mean(axis=0), [0, 0, 3.5], atol=5 * 3 / np.sqrt(12 * n))
    assert_allclose(p.position.min(axis=0), [-1, 0, 2], atol=1e-2)
    assert_allclose(p.position.max(axis=0), [1, 0, 5], atol=1e-2)
    assert np.all((p.position >= [-1, 0, 2]) & (p.position <= [1, 0, 5]))


# Grid


def test_grid_runs_along_x_first_and_is_centred():
    keys = {"type": "grid", "spacing": [1, 2, 3], "n": [2, 2, 2], "origin": [10, 0, 0]}
    p = placed(block("a", 8, place=keys))
    assert_allclose(p.position.mean(axis=0), [10, 0, 0])
    assert_array_equal(p.position[1] - p.position[0], [1, 0, 0])
    assert_array_equal(p.position[2] - p.position[0], [0, 2, 0])
    assert_array_equal(p.position[4] - p.position[0], [0, 0, 3])


def test_grid_has_as_many_places_per_axis_as_asked():
    keys = {"type": "grid", "spacing": [1, 2, 3], "n": [2, 3, 4]}
    p = placed(block("a", 24, place=keys))
    i = [[x, 2 * y, 3 * z] for z in range(4) for y in range(3) for x in range(2)]
    assert_allclose(p.position, np.array(i) - np.array([0.5, 2.0, 4.5]))


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 27, 28, 1000, 1001, 10**6, 10**9 + 1])
def test_grid_of_its_own_choice_is_nearly_a_cube_with_room_for_all(count):
    n = grid_size(count)
    assert np.prod(n, dtype=object) >= count
    assert n[0] >= n[1] >= n[2] >= 1
    assert (n[0] - 1) ** 3 < count
    assert np.prod(n, dtype=object) - count < n[0] * n[1]  # the last layer is not empty


def test_bodies_of_a_grid_keep_their_distance():
    p = placed(block("a", 30, place={"type": "grid", "spacing": 2.0}))
    distance = np.linalg.norm(p.position[:, None] - p.position[None], axis=2)
    assert distance[~np.eye(30, dtype=bool)].min() == 2.0


# Orientation and axes


@pytest.mark.parametrize(
    "angles", [(0, 0, 0), (90, 0, 0), (0, 90, 0), (0, 0, 90), (10, -20, 150), (400, 370, -725)]
)
def test_euler_angles_are_intrinsic_zyx_given_as_roll_pitch_yaw(angles):
    roll, pitch, yaw = angles
    q = placed(block("a", orientation={"euler_deg": list(angles)})).orientation
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()
    assert_allclose(matrices(q)[0], expected, atol=4e-16)


def test_quarter_roll_turns_y_to_z():
    q = placed(block("a", orientation={"euler_deg": [90, 0, 0]})).orientation
    assert_allclose(matrices(q)[0] @ [0, 1, 0], [0, 0, 1], atol=4e-16)


@pytest.mark.parametrize("scale", [1.0, 3.0, 1e-160, 1e200, 5e-324])
def test_quaternions_are_normalised(scale):
    q = placed(block("a", orientation=[scale, -scale, scale, scale])).orientation
    assert_allclose(q[0], [0.5, -0.5, 0.5, 0.5], rtol=2e-16)


def test_body_axes_are_turned_into_the_world():
    keys = {"velocity": {"body": [1, 2, 3]}, "angular_velocity": {"body": [-1, 0, 2]}}
    p = placed(block("a", 4, **{**RANDOM, **keys}), block("b", orientation=[1, 1, 0, 0], **keys))
    R = matrices(p.orientation)
    assert_allclose(p.velocity, R @ [1, 2, 3], atol=4e-15)
    assert_allclose(p.angular_velocity, R @ [-1, 0, 2], atol=4e-15)
    assert_allclose(p.velocity[4], [1, -3, 2], atol=4e-15)


def test_rows_from_python_are_taken_as_they_are():
    rng = np.random.default_rng(1)
    x, v, w = (rng.random((3, 3)) for _ in range(3))
    q = rng.random((3, 4))
    keys = {"position": x, "velocity": v, "angular_velocity": w, "orientation": q}
    p = placed(block("a", 3, **keys))
    for name, rows in (("position", x), ("velocity", v), ("angular_velocity", w)):
        assert_array_equal(getattr(p, name), rows)
    assert_allclose(p.orientation, q / np.linalg.norm(q, axis=1, keepdims=True), rtol=4e-16)
    p.position[0] = 0.0  # arrays of its own


# Names


def test_names_of_forces_and_checks_are_found():
    names = placed(block("a"), block("b", 3, **RANDOM), block("c c", 2, **RANDOM)).names
    assert_array_equal(names.find("a"), [0])
    assert_array_equal(names.find("b"), [1, 2, 3])
    assert_array_equal(names.find("c c[1]"), [5])
    assert_array_equal(names.find(("c c", "b[2]", "b", "a[0]")), [0, 1, 2, 3, 4, 5])
    assert_array_equal(names.find_in_order(("b[2]", "a", "b[2]")), [3, 0, 3])
    for name in ("d", "b[3]", "b[-1]", "b[x]", ""):
        with pytest.raises(KeyError):
            names.find(name)
