"""Tables of spheres and points: what is read, and what is refused with its line."""

import numpy as np
import pytest

from particlerb.geometry.particle_files import (
    POINTS,
    SPHERES,
    columns_of,
    read_points,
    read_spheres,
)


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3 0.5\n4 5 6 0.25\n",
        "% a clump\n\n1\t2  3 0.5 # first\n4 5 6 2.5e-1\n",
        "1, 2, 3, 0.5\n4,5,6,0.25\n",
        "1; 2; 3; 0.5\n4;5;6;0.25\n",
        "X,Y,Z,Radius\n1,2,3,.5\n4,5,6,.25\n",
        '"x","y","z","r"\n"1","2","3","0.5"\n4,5,6,.25\n',  # of R
        '"X" "Y" "Z" "r"\n"1" "2" 3 0.5\n "4" 5 "6" ".25"\n',
        "r z y x\n0.5 3 2 1\n.25 6 5 4\n",
    ],
)
def test_spheres_as_generators_write_them(tmp_path, text):
    path = tmp_path / "clump.txt"
    path.write_text(text)
    centre, radius = read_spheres(path)
    assert centre.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert radius.tolist() == [0.5, 0.25]
    assert columns_of(path) is SPHERES


def test_points_without_a_header(tmp_path):
    path = tmp_path / "points.txt"
    path.write_text("1 2 3 4\n5 6 7 0\n")
    assert read_points(path).mass.tolist() == [4, 0]
    path.write_text("1 2 3 4 0.5\n5 6 7 0 2\n")
    assert read_points(path).radius.tolist() == [0.5, 2]
    assert columns_of(path) is POINTS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.txt: empty"),
        ("% nothing\n\n", "a.txt: empty"),
        ("x y z r\n", "a.txt:1: no rows below the header"),
        ("x y z m\n1 2 3 4\n", "a.txt:1: column r is missing"),
        ("1 2 3 4\n1 2 3\n", "a.txt:2: 3 values for the 4 columns"),
        ("1 2 3\n", "a.txt:1: 3 values for the 4 columns"),
        ("1 2 3 4 5\n", "a.txt:1: 5 values for the 4 columns"),
        ("# c\n1 2 3 4\n1 2 three 4\n", "a.txt:3: z = 'three' is not a number"),
        ("1 2 3 x\n", "a.txt:1: r = 'x' is not a number"),
        ("1 2 3 -4\n", "a.txt:1: r = -4 is negative"),
        ("1 2 3 1\n1 2 3 0\n", "a.txt:2: r = 0.0: a sphere has a positive radius"),
        ("1 2 inf 1\n", "a.txt:1: z = inf is not finite"),
        ('"1,5","2","3"\n', "a.txt:1: x = '\"1' is not a number"),
        ('1 2 3 1\n1"2 3 1 4\n', "a.txt:2: x = '1\"2' is not a number"),
        ('1 2 3 "4\n', "a.txt:1: r = '\"4' is not a number"),
        ('1 2 3 ""4""\n', 'a.txt:1: r = \'""4""\' is not a number'),
        ('1 "" 2 3 4\n', "a.txt:1: 5 values for the 4 columns"),
    ],
)
def test_spheres_that_are_refused(tmp_path, text, message):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_spheres(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,y,z,m\n1,2,3,4\n0,0,0,1\n1,2,3,1\n", "a.csv:4: at .1.0, 2.0, 3.0., .* of line 2 is"),
        ("x,y,z,m,r\n1,2,3,0,1\n1,2,3,0,2\n", "a.csv:3: at .* of line 2 is"),
        ("x,y,z,m\n1,2,3,0\n", "a.csv: no mass"),
    ],
)
def test_points_that_are_refused(tmp_path, text, message):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_points(path)


def test_a_mass_may_sit_in_the_centre_of_a_surface(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,z,m,r\n1,2,3,1,0\n1,2,3,0,0.5\n")
    assert np.array_equal(read_points(path).mass, [1, 0])


def test_a_picture_is_no_table(tmp_path):
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(ValueError, match="not a text file"):
        read_spheres(path)
