"""The system between cases and plans: what it holds, and that nothing behind it knows a case."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import particlerb
from particlerb.case.problems import problem_at
from particlerb.case.reader import load, parse
from particlerb.case.to_system import records, to_case, to_system, with_records
from particlerb.model.names import BodyNames

PACKAGE = Path(particlerb.__file__).parent
CASES = sorted((PACKAGE.parent / "cases").glob("*.toml"))
GRID = {"place": {"type": "grid", "spacing": 9.0}}
AUTHORS = {  # of cases: they read one, or write one
    "__init__.py", "cli/bodies.py", "cli/common.py", "cli/export.py", "record/provenance.py",
    "record/trajectory.py", "simulation/resume.py", "simulation/set_up_apart.py",
    "sweeping/designs.py", "sweeping/driver.py", "sweeping/variants.py",
}  # fmt: skip


def test_nothing_behind_the_system_knows_a_case():
    behind = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "case"]
    knowing = {
        path.relative_to(PACKAGE).as_posix()
        for path in behind
        if re.search(r"^ *from particlerb\.case\.schema import .*\bCase\b", path.read_text(), re.M)
    }
    assert knowing == AUTHORS


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_a_system_states_the_case_that_it_was_made_of(path):
    case = load(path)
    again = to_case(SimpleNamespace(**records(case)))  # without particles, which may take long
    own = again.output.fields[: len(case.output.fields)]  # before what is recorded in any case
    assert again.output.model_copy(update={"fields": own}) == case.output
    known = case.model_copy(update={"sweep": None, "output": again.output})  # without other cases
    assert again.model_dump_json() == known.model_dump_json()
    assert again.source.text == case.source.text


def test_a_problem_is_found_in_the_file_of_its_record():
    text = """[run]
t_end = 1
every = 1
[[body]]
name = "a"
shape = { type = "sphere", radius = 0.1 }
mass = 1
"""
    system = to_system(parse(text, Path("a.toml")))
    problem = problem_at(system, "body[0].shape.radius", "is too large", "give less")
    assert (problem.line, problem.column, problem.value) == (6, 37, "0.1")
    assert str(problem).startswith("a.toml:6:37: error: body[0].shape.radius: is too large")


def test_other_records_leave_bodies_where_they_are(make):
    system = to_system(make.case(make.body("a", position=[1, 2, 3])))
    moved = system._replace(state=system.state._replace(com=system.state.com + 1.0))
    push = make.push([1, 0, 0], body="a")
    other = with_records(moved, load(make.case(make.body("a", position=[1, 2, 3]), force=[push])))
    assert len(other.force) == 1
    assert other.state.com[:, 0].tolist() == [2.0, 3.0, 4.0]


def test_a_driven_body_begins_where_its_oscillation_has_it(make):
    swing = {"amplitude": [0.0, 0.0, 0.2], "frequency": 1.0, "phase": 0.5}
    body = make.sphere("bat", position=[1, 2, 3], motion={"oscillation": swing})
    system = to_system(make.case(body, make.sphere("b"), contact=make.hooke()))
    assert system.state.com[:, 0] == pytest.approx([1, 2, 3 + 0.2 * np.sin(0.5)], rel=1e-15)


def test_another_way_to_run_changes_nothing_else(make):
    system = to_system(make.case(make.body(), gravity={"acceleration": [0, 0, -9]}))
    other = system.with_run(method="rk4", dt=0.5)
    assert (other.run.method, other.run.dt, system.run.method) == ("rk4", 0.5, "auto")
    assert other.body == system.body
    assert other.acceleration.tolist() == [0.0, 0.0, -9.0]


def test_names_stand_for_bodies_in_the_order_in_which_they_are_given():
    names = BodyNames([("a", 1), ("b", 3)])
    assert list(names) == ["a", "b[0]", "b[1]", "b[2]"]
    assert_array_equal(names.find(["b[1]", "a", "b[1]"]), [0, 2])
    assert_array_equal(names.find_in_order(["b[1]", "a", "b[1]"]), [2, 0, 2])
    with pytest.raises(KeyError):
        names.find("b[3]")


def test_bodies_of_the_same_shape_and_mass_are_of_one_kind_in_whatever_block(make):
    box = {"type": "box", "size": [1, 2, 3], "n": [1, 2, 3]}
    cloud = {"type": "cloud", "n": 3, "radius": 1.0}
    bodies = [
        {
            "name": "a",
            "shape": box,
            "mass": 1.0,
            "count": 2,
            "place": {"type": "grid", "spacing": 9},
        },
        {"name": "heavy", "shape": box, "mass": 2.0, "position": [0, 9, 0]},
        {"name": "b", "shape": box, "mass": 1.0, "position": [0, 0, 9], "contact": False},
        {"name": "part", "part": [{"shape": box, "mass": 1.0}], "position": [0, 0, 18]},
        {"name": "again", "part": [{"shape": box, "mass": 1.0}], "position": [0, 0, 27]},
        {"name": "c", "shape": cloud, "mass": 1.0, "position": [0, 0, 36]},
        {"name": "d", "shape": cloud, "mass": 1.0, "position": [0, 0, 45]},
    ]
    system = to_system(make.case(*bodies))
    assert system.kind.tolist() == [0, 0, 1, 0, 2, 2, 3, 4]
    assert np.diff(system.particles.offset).tolist() == [6, 6, 6, 3, 3]
    assert system.summed.tolist() == [6, 6, 6, 3, 3]


def test_clouds_are_drawn_anew_for_every_body_and_for_each_of_its_parts(make):
    cloud = {"type": "cloud", "n": 5, "radius": 1.0}
    box = {"type": "box", "size": [1, 2, 3], "n": 1}
    parts = [
        {"shape": cloud, "mass": 1.0},
        {"shape": box, "mass": 1.0},
        {"shape": cloud, "mass": 1},
    ]
    alone = to_system(make.case({"name": "a", "shape": cloud, "mass": 1.0}), keeps_all=True)
    system = to_system(make.case({"name": "a", "part": parts, "count": 2} | GRID), keeps_all=True)
    assert system.kind.tolist() == [0, 1]
    com = np.repeat(system.properties.com, np.diff(system.particles.offset), axis=0)
    drawn = (system.particles.position + com).reshape(2, 11, 3)[:, [*range(5), *range(6, 11)]]
    assert_allclose(drawn[0, :5], alone.particles.position + alone.properties.com, rtol=1e-14)
    assert len(np.unique(drawn.reshape(20, 3).round(9), axis=0)) == 20


def test_all_bodies_of_a_kind_are_told_what_was_done_to_their_shape(make):
    shape = {"type": "ball", "radius": 1.0, "inertia_error": 0.1}
    system = to_system(make.case(*({"name": k, "shape": shape, "mass": 1.0} for k in "ab")))
    lines = [[line for name, line in system.notes if name == k] for k in "ab"]
    assert lines[0] == lines[1] != []
