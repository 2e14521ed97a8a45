"""Angles and distances between poses, beside rotations of which they are known."""

import numpy as np
import pytest

from particlerb.model.bodies import made_of
from particlerb.model.comparison import angles, misfits
from particlerb.rotors.rotor_class import ASYMMETRIC, POINT, ROD

ANGLES = (0.0, 1e-12, 1e-3, 1.0, 3.0, np.pi)


def quaternion(axis, angle):
    """Unit quaternion of a rotation about an axis."""
    unit = np.array(axis) / np.linalg.norm(axis)
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * unit)])


def bodies_of(*classes):
    """Bodies of these rotor classes, whose axes are those of the body frame."""
    n = len(classes)
    frame = np.tile([[1.0], [0.0], [0.0], [0.0]], (1, n))
    return made_of(np.ones(n), np.ones((3, n)), frame, np.array(classes))


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_angle_is_that_of_the_rotation_between(angle, sign):
    a = np.array([0.5, 0.5, -0.5, 0.5])
    turn = quaternion([1.0, 2.0, -0.5], angle)
    w, v = turn[0], turn[1:]
    b = sign * np.array([w * a[0] - v @ a[1:], *(w * a[1:] + a[0] * v + np.cross(v, a[1:]))])
    found = angles(bodies_of(ASYMMETRIC), a[None], b[None])[0]
    assert found == pytest.approx(angle, rel=1e-3 if angle == 1e-12 else 1e-12, abs=1e-15)


def test_a_rod_has_an_axis_and_a_point_nothing():
    bodies, start = bodies_of(ROD, ROD, POINT), np.tile([1.0, 0, 0, 0], (3, 1))
    along, across = quaternion([0, 0, 1], 2.0), quaternion([1, 0, 0], 2.0)
    found = angles(bodies, start, np.array([along, across, across]))
    assert found == pytest.approx([0.0, 2.0, 0.0], abs=1e-15)


def test_distances_are_those_of_each_row_and_body():
    bodies, q = bodies_of(POINT, POINT), np.tile([1.0, 0, 0, 0], (2, 2, 1))
    x = np.zeros((2, 2, 3))
    y = np.array([[[3.0, 4.0, 0.0], [0, 0, 0]], [[0, 0, 2.0], [np.nan, 0, 0]]])
    assert misfits(bodies, x, q, y, q)[1] == pytest.approx(
        np.array([[5.0, 0.0], [2.0, np.nan]]), nan_ok=True
    )
