"""The plan tells of lattices that are another body than the solid that they stand for."""

import re

import numpy as np
import pytest

from particlerb.case.coarse_lattice import coarse
from particlerb.case.problems import CaseError
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.simulation.run import prepare

LONG = {"type": "cylinder", "radius": 0.1, "height": 0.8}
SHAPES = {
    "box": {"size": [1.0, 0.5, 0.2]},
    "ball": {"radius": 1.0},
    "shell": {"radius": 1.0, "inner_radius": 0.7},
    "cylinder": {"radius": 0.3, "height": 0.8},
    "cone": {"radius": 0.4, "height": 1.0},
    "torus": {"major_radius": 1.0, "minor_radius": 0.3},
    "ellipsoid": {"semi_axes": [1.0, 0.8, 0.5]},
    "rod": {"length": 1.0},
}
SHARE = {  # moments per mass of the solids, from docs/bodies.md
    "box": [0.29 / 12, 1.04 / 12, 1.25 / 12],
    "ball": [0.4] * 3,
    "shell": [0.4 * (1 - 0.7**5) / (1 - 0.7**3)] * 3,
    "cylinder": [0.09 / 2, (3 * 0.09 + 0.64) / 12, (3 * 0.09 + 0.64) / 12],
    "cone": [0.3 * 0.16, 3 / 80 * (4 * 0.16 + 1), 3 / 80 * (4 * 0.16 + 1)],
    "torus": [0.5 + 0.625 * 0.09, 0.5 + 0.625 * 0.09, 1 + 0.75 * 0.09],
    "ellipsoid": [0.89 / 5, 1.25 / 5, 1.64 / 5],
    "rod": [0.0, 1 / 12, 1 / 12],
}


def told(case):
    """Warnings of a case."""
    return list(coarse(to_system(case)))


def errors(case):
    """Errors of the principal moments of a body of 2 kg, of those that are not zero."""
    shape = case["body"][0]["shape"]
    moments = np.sort(to_system(case).properties.moments[0]) / 2.0
    ideal = np.array(SHARE[shape["type"]])
    return np.abs(moments / np.where(ideal > 0, ideal, 1.0) - 1.0)[ideal > 0]


def test_the_plan_says_how_far_a_lattice_is_from_its_solid(make):
    """Also where it is near enough for no warning, as a box of 10³ cells, which is off by 1/n²."""
    for n, words in ((10, "1 %"), (20, "0.25 %")):
        box = make.body("a", shape={"type": "box", "size": [1, 1, 1], "n": n})
        line = f"tensor; moments up to {words} from those of solids: see `mass`\n"
        assert line in prepare(to_system(make.case(box))).text
    for shape in (
        {"type": "box", "size": [1, 2, 3], "arrangement": "exact"},
        {"type": "ball", "radius": 1},
    ):
        text = prepare(to_system(make.case(make.body("a", shape=shape)))).text
        assert "from those of solids" not in text


@pytest.mark.parametrize("kind", SHAPES)
def test_one_per_cent_decides(make, kind):
    """What is off by more is told, what is not is not, and the advice is right."""
    is_checked = False
    for n in (2, 3, 5, 10):
        shape = {"type": kind, **SHAPES[kind], "n": n}
        case = make.case(make.body("a", shape=shape))
        try:
            off = errors(case).max()
        except CaseError:
            continue  # too few cells: refused
        found = told(case)
        assert len(found) == (off > 0.01 * (1 + 1e-9)), (n, off)
        if found and not is_checked:
            assert found[0].key == "body[0].shape"
            better = re.search(r"n = (\d+) is within 1 %", found[0].hint)
            shape["n"] = int(better[1])
            assert errors(case).max() <= 0.01 * (1 + 1e-9)
            named = re.search(r'arrangement = "(\w+)"', found[0].hint)
            exact = {"type": kind, **SHAPES[kind], "arrangement": named[1]}
            assert errors(make.case(make.body("a", shape=exact))).max() < 1e-12
            is_checked = True
    assert is_checked


def test_a_solid_that_has_become_a_rod_or_a_point_is_told_so(make):
    (rod,) = told(make.case(make.body("a", shape=LONG | {"n": 4})))
    assert rod.reason.startswith("a: as 4 particles it is a rod, which the solid is not")
    (point,) = told(make.case(make.body("a", shape=LONG | {"n": 1})))
    assert point.reason.startswith("a: as 1 particle it is a point, which the solid is not")
    assert not told(make.case(make.body("a", shape={"type": "rod", "length": 1.0})))


def test_an_error_that_is_asked_for_is_not_told_but_a_change_of_class_is(make):
    ball = {"type": "ball", "radius": 1.0}
    assert told(make.case(make.body("a", shape=ball | {"n": 4})))
    assert not told(make.case(make.body("a", shape=ball | {"inertia_error": 0.2})))
    needle = {"type": "ellipsoid", "semi_axes": [0.01, 0.01, 1.0], "inertia_error": 0.5}
    (found,) = told(make.case(make.body("a", shape=needle)))
    assert "is a rod" in found.reason


def test_the_whole_body_is_compared(make):
    """Parts: what is off by much may matter little; parts without mass do not matter."""
    hub = {"shape": {"type": "box", "size": [2, 2, 2], "arrangement": "exact"}, "mass": 9.0}
    knob = {"shape": {"type": "ball", "radius": 0.1, "n": 2}, "mass": 0.1, "position": [0, 0, 1]}
    through = {"shape": LONG | {"n": 4}, "mass": 3.0, "orientation": {"euler_deg": [0, 90, 0]}}
    skin = {"shape": {"type": "sphere", "radius": 0.1}, "mass": 0.0}
    assert not told(make.case({"name": "a", "part": [hub, knob]}))
    assert not told(make.case({"name": "a", "part": [hub, skin]}))
    (found,) = told(make.case({"name": "a", "part": [knob, through]}))
    assert found.key == "body[0].part[1].shape"


def test_the_sum_over_parts_is_that_of_the_solids(make):
    """Turned and moved parts of fine lattices come to the moments of the solids."""
    shape = {"type": "box", "size": [1.0, 0.6, 0.4], "n": 12}
    place = {"position": [0.3, -2.0, 0.5], "orientation": {"euler_deg": [20, 40, 60]}}
    parts = [{"shape": shape, "mass": 2.0}, {"shape": shape, "mass": 1.0, **place}]
    assert not told(make.case({"name": "a", "part": parts}))


def test_strict_makes_it_an_error(tmp_path, capsys):
    text = 'run = { t_end = 1, every = 1 }\n[[body]]\nname = "a"\nmass = 1\nshape = '
    (tmp_path / "a.toml").write_text(
        text + '{ type = "cylinder", radius = 0.1, height = 0.8, n = 4 }\n'
    )
    assert main(["check", str(tmp_path / "a.toml")]) == 0
    message = capsys.readouterr().err
    assert message.startswith(f"{tmp_path}/a.toml:5:9: warning: body[0].shape: a: as 4 particles")
    assert 'hint: n = 10 is within 1 %; arrangement = "cells" has exactly' in message
    assert main(["check", "--strict", str(tmp_path / "a.toml")]) == 2


@pytest.mark.parametrize(
    "shape",
    [
        {"type": "cylinder", "radius": 2.0, "height": 2.5e187, "n": 1},
        {"type": "ellipsoid", "semi_axes": [1e5, 1.1e186, 1e-3], "n": 1},
        {"type": "ball", "radius": 6.6e-246, "n": 1},
    ],
)
def test_sizes_whose_powers_are_no_numbers_are_passed_over(make, shape):
    """Found by the fuzz of case texts: they ended in a traceback."""
    body = {"name": "b", "shape": shape, "mass": 2.0}
    told(make.case(body))
