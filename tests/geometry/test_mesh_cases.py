"""Bodies from meshes in cases: keys, wrong ones, and what is said of a mesh that is none."""

import json
import sys

import numpy as np
import pytest
from mesh_examples import box, icosahedron, joined

from particlerb.case.problems import CaseError
from particlerb.case.reader import load
from particlerb.case.to_system import to_system
from particlerb.cli import main
from particlerb.geometry.mesh import checked, mesh_solid
from particlerb.plan.describe import describe
from particlerb.plan.make_plan import make_plan

trimesh = pytest.importorskip("trimesh")

SHAPES = {
    "box": box(),
    "open": (box()[0], box()[1][:-1]),
    "crossing": joined(box(), (box()[0] + 0.3, box()[1])),
    "flat": (box()[0] * [1.0, 1.0, 0.0], box()[1]),
    "mixed": (box()[0], np.concatenate([box()[1][:1, ::-1], box()[1][1:]])),
    "icosahedron": icosahedron(),
}


@pytest.fixture(autouse=True)
def files(tmp_path, monkeypatch):
    """Meshes beside the case, and a folder to run in."""
    for name, (vertices, faces) in SHAPES.items():
        trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / f"{name}.ply")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def case_of(**shape):
    body = {"name": "part", "shape": shape, "density": 2.0}
    return {"run": {"t_end": 1.0, "every": 1.0}, "body": [body]}


def refusal(**shape):
    with pytest.raises(CaseError) as caught:
        to_system(case_of(**shape))
    return [(problem.key, problem.reason) for problem in caught.value.problems]


def test_every_arrangement_has_the_mass_of_the_mesh():
    solid = mesh_solid(checked(*icosahedron()))
    for how in ({}, {"arrangement": "cells", "n": 4}):
        scene = to_system(case_of(type="mesh", file="icosahedron.ply", scale=0.5, **how))
        assert scene.properties.mass[0] == pytest.approx(2.0 * solid.volume / 8, rel=1e-6)
        moment = 2.0 * solid.inertia[0, 0] / 32
        assert scene.properties.moments[0] == pytest.approx(np.full(3, moment), rel=1e-6)


def test_a_path_is_relative_to_the_case(files, monkeypatch):
    text = '[run]\nt_end = 1\nevery = 1\n[[body]]\nname = "b"\nmass = 1.0\n'
    (files / "a.toml").write_text(text + 'shape = { type = "mesh", file = "box.ply" }\n')
    monkeypatch.chdir("/")
    assert to_system(files / "a.toml").properties.mass[0] == 1.0


def test_a_part_may_be_a_mesh():
    part = {"shape": {"type": "mesh", "file": "box.ply"}, "mass": 3.0, "position": [1.0, 0.0, 0.0]}
    case = case_of() | {"body": [{"name": "b", "part": [part, {**part, "position": [-1, 0, 0]}]}]}
    properties = to_system(case).properties
    assert properties.mass[0] == pytest.approx(6.0, rel=1e-14)
    assert properties.moments[0] == pytest.approx([1.0, 7.0, 7.0], rel=1e-14)


def test_the_plan_tells_what_was_tried_and_changed():
    system = to_system(case_of(type="ball", radius=1.0, inertia_error=0.1))
    lines = describe(system, make_plan(system)).splitlines()
    own = [line for line in lines if line.startswith("  part ")]
    assert "as requested; tried:" in own[0]
    assert own[1].split()[1:] == ["n", "particles", "inertia", "com"]
    tried = [line.split() for line in own if line.split()[1].isdigit() and len(line.split()) == 5]
    assert float(tried[-1][3]) <= 0.1 < float(tried[-2][3])
    case = load(case_of(type="mesh", file="mixed.ply"))
    assert to_system(case).notes == (("part", "turned round face 0"),)


def test_mass_tells_what_was_tried_and_changed(files, capsys):
    head = '[run]\nt_end = 1\nevery = 1\n[[body]]\nname = "b"\nmass = 1.0\n'
    shape = 'shape = { type = "mesh", file = "mixed.ply", arrangement = "cells"'
    (files / "a.toml").write_text(f"{head}{shape}, inertia_error = 0.01 }}\n")
    assert main(["mass", "a.toml"]) == 0
    text = capsys.readouterr().out
    assert "  particles            turned round face 0\n" in text
    assert " with n = 2, as requested; tried:" in text
    assert text.splitlines()[-1].split()[:2] == ["2", "8"]
    assert main(["mass", "mixed.ply", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["notes"] == ["turned round face 0"]


WRONG = {
    "open": ({"file": "open.ply"}, "open.ply: it is open: edge (-0.5, "),
    "crossing": ({"file": "crossing.ply"}, "crossing.ply: it intersects itself: face "),
    "no volume": ({"file": "flat.ply"}, "flat.ply: it has zero volume, in the part of face "),
    "no mesh": ({"file": "case.toml"}, "case.toml is not a mesh: its name must end with .stl"),
    "empty": ({"file": "empty.ply"}, "empty.ply: trimesh cannot read it"),
    "too few cells": ({"file": "box.ply", "arrangement": "cells", "n": 1}, "n is 1: 2 or more"),
}


@pytest.mark.parametrize("name", WRONG)
def test_meshes_that_are_none(files, name):
    (files / "case.toml").touch()
    (files / "empty.ply").touch()
    shape, reason = WRONG[name]
    [(key, found)] = refusal(type="mesh", **shape)
    assert key == "body[0].shape"
    assert found.startswith("part: ")
    assert reason in found


def test_without_trimesh(monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)  # as if it were not installed
    [(_, reason)] = refusal(type="mesh", file="box.ply")
    assert 'reading it needs trimesh: pip install "particlerb[mesh]"' in reason


KEYS = {
    "missing file": ({"type": "mesh", "file": "no.stl"}, "file", 'there is no file "no.stl" in .'),
    "no file": ({"type": "mesh"}, "file", "missing"),
    "arrangement": (
        {"type": "mesh", "file": "box.ply", "arrangement": "lattice"},
        "arrangement",
        "unknown: 'lattice'",
    ),
    "scale": ({"type": "mesh", "file": "box.ply", "scale": 0}, "scale", "must be > 0, got 0"),
    "n and error": (
        {"type": "ball", "radius": 1, "n": 5, "inertia_error": 0.1},
        "inertia_error",
        "given beside n, which it chooses",
    ),
    "exact and error": (
        {"type": "mesh", "file": "box.ply", "inertia_error": 0.1},
        "inertia_error",
        "has nothing to choose: this arrangement is exact",
    ),
    "large error": (
        {"type": "ball", "radius": 1, "inertia_error": 1.5},
        "inertia_error",
        "must be < 1, got 1.5",
    ),
    "thin cells": ({"type": "shell", "radius": 1, "arrangement": "cells"}, "arrangement", "a thin"),
}


@pytest.mark.parametrize("name", KEYS)
def test_wrong_keys(name):
    shape, key, reason = KEYS[name]
    case = case_of(**shape)
    case["body"][0]["mass"] = case["body"][0].pop("density")
    with pytest.raises(CaseError) as caught:
        load(case)
    [problem] = caught.value.problems
    assert problem.key == f"body[0].shape.{key}"
    assert problem.reason.startswith(reason)


@pytest.mark.parametrize("command", ["check", "mass"])
@pytest.mark.parametrize("name", ["open", "crossing"])
def test_commands_end_with_two_and_no_traceback(files, capsys, command, name):
    text = '[run]\nt_end = 1\nevery = 1\n[[body]]\nname = "b"\nmass = 1.0\n'
    (files / "a.toml").write_text(f'{text}shape = {{ type = "mesh", file = "{name}.ply" }}\n')
    assert main([command, "a.toml"]) == 2
    error = capsys.readouterr().err
    assert "a.toml:7:" in error
    assert "shape: b: " in error
    assert "Traceback" not in error
