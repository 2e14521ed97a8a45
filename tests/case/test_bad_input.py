"""Every mistake has one message: where, which key, why, what to do; never a traceback."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from particlerb.case.problems import nearest
from particlerb.case.reader import CaseError, Problem, load, parse
from particlerb.case.to_system import to_system
from particlerb.simulation.run import prepare

pytestmark = pytest.mark.once

GOOD = """\
title = "a cube and a clump"
[run]
t_end = 5.0
every = 0.1
[[body]]
name = "cube"
shape = { type = "box", size = [1.0, 1.0, 1.0] }
mass = 2.0
[[body]]
name = "clump"
shape = { type = "ball", radius = 0.5 }
density = 1000.0
count = 4
place = { type = "grid", spacing = 2.0 }
[[force]]
type = "push"
body = "cube"
force = [0, 0, 50]
during = [0.0, 0.02]
[[check.value]]
body = "clump[3]"
quantity = "position"
value = [0, 0, 0]
tolerance = 1e-9
"""


def problems(text: str, path: Path | None = None) -> tuple[Problem, ...]:
    with pytest.raises(CaseError) as caught:
        parse(text, path or Path("cases/x.toml"))
    return caught.value.problems


def edited(old: str, new: str) -> str:
    assert GOOD.count(old) == 1
    return GOOD.replace(old, new)


def test_the_case_that_the_tests_break_is_good():
    assert sum(body.count for body in parse(GOOD).body) == 5


_FLOOR = '[[wall]]\nname = "floor"\ntype = "plane"\npoint = [0, 0, -1]\nnormal = [0, 0, 1]'

MISTAKES = [
    # old text, new text, line, key, reason, part of the hint
    (
        "mass = 2.0",
        "mass = 2.0\nomega = [0, 0, 1]",
        9,
        "body[0].omega",
        "unknown key",
        'did you mean "angular_velocity"? keys here',
    ),
    (
        "every = 0.1",
        'every = 0.1\nmethod = "RK4"',
        5,
        "run.method",
        "unknown: 'RK4'",
        'did you mean "rk4"? known',
    ),
    ('"box"', '"cube"', 7, "body[0].shape.type", "unknown type 'cube'", 'did you mean "box"?'),
    (
        "mass = 2.0",
        "mass = 2.0\nsize = 2",
        9,
        "body[0].size",
        "unknown key",
        "is a key of shape",
    ),
    (
        "every = 0.1",
        "every = 0.1\ngravity = [0, 0, -9.81]",
        5,
        "run.gravity",
        "unknown key",
        "gravity is a table of its own: [gravity]; keys here: t_end",
    ),
    (
        "every = 0.1",
        "every = 0.1\nrestitution = 0.5",
        5,
        "run.restitution",
        "unknown key",
        "restitution is a key of [contact]; keys here: t_end",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\nfriction = 0.5",
        9,
        "body[0].friction",
        "unknown key",
        "friction is a key of [[joint]] or [contact]; keys here: name",
    ),
    (
        '"box"',
        '"box", mass = 2.0',
        7,
        "body[0].shape.mass",
        "unknown key",
        "mass is a key of [[body]]; keys here: type",
    ),
    (
        "every = 0.1",
        "every = 0.1\n[output]\nfield = ['position']",
        6,
        "output.field",
        "unknown key",
        'did you mean "fields"?',
    ),
    ("[run]\nt_end = 5.0", "t_end = 5.0\n[run]", 2, "t_end", "unknown key", "is a key of run"),
    ("[[force]]", f"{_FLOOR}\n[contacts]\n[[force]]", 20, "contacts", "unknown key", '"contact"?'),
    (
        "[[force]]",
        f'{_FLOOR}\n[output]\nfields = ["contact_number", "contacts"]\n[[force]]',
        15,
        "wall[0]",
        "nothing touches a wall without [contact]",
        "add [contact]",
    ),
    (
        "during = [0.0, 0.02]",
        "during = [9.0, 8.0]",
        19,
        "force[0].during",
        "must start before it ends, got [9.0, 8.0]",
        "",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\norientation = { axis = [0, 0, 1], angle_deg = 30 }",
        9,
        "body[0].orientation",
        "unknown keys: axis, angle_deg",
        "by an angle a about the unit vector n: [cos(a/2), sin(a/2) n]",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\nvelocity = { x = 1, y = 2 }",
        9,
        "body[0].velocity",
        "unknown keys: x, y",
        "[x, y, z], { body = [x, y, z] }, or { random = v }",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\norientation = { axis = [0, 0, 1] }",
        9,
        "body[0].orientation.axis",
        "unknown key",
        "euler_deg = [roll, pitch, yaw]",
    ),
    (
        "[run]",
        '[output]\ndurable = "no"\n[run]',
        3,
        "output.durable",
        "must be true or false, got a text: 'no'",
        "",
    ),
    ("every = 0.1", "evry = 0.1", 4, "run.evry", "unknown key", 'did you mean "every"? keys here'),
    ("t_end = 5.0", "t_end = 0", 3, "run.t_end", "must be > 0, got 0", ""),
    ("t_end = 5.0", "t_end = -5.0", 3, "run.t_end", "must be > 0, got -5.0", ""),
    ("t_end = 5.0", 't_end = "5"', 3, "run.t_end", "must be a number, got a text: '5'", ""),
    (
        "t_end = 5.0",
        "t_end = true",
        3,
        "run.t_end",
        "must be a number, got true or false: True",
        "",
    ),
    (
        "[run]",
        "gravity = -9.81\n[run]",
        2,
        "gravity",
        "must be a table, got a number: -9.81",
        "keys: acceleration",
    ),
    ("every = 0.1", "", 2, "run.every", "missing", "keys here: t_end, every, method"),
    ("every = 0.1", "every = 6", 4, "run.every", "must be <= run.t_end = 5.0, got 6.0", ""),
    ("every = 0.1", "every = 1e-300", 4, "run.every", "makes more than 1e+09 frames", "longer"),
    (
        "every = 0.1",
        'every = 0.1\nmethod = "exat"',
        5,
        "run.method",
        "unknown: 'exat'",
        'did you mean "exact"? known: auto, exact, strang',
    ),
    ("every = 0.1", "every = 0.1\nthreads = 0", 5, "run.threads", "must be >= 1, got 0", ""),
    (
        "every = 0.1",
        "every = 0.1\nseed = 1.5",
        5,
        "run.seed",
        "must be a whole number, got a number: 1.5",
        "",
    ),
    ("mass = 2.0", "mass = 0", 8, "body[0].mass", "must be > 0, got 0", ""),
    ("mass = 2.0", "mass = -2", 8, "body[0].mass", "must be > 0, got -2", ""),
    ("mass = 2.0", "", 5, "body[0].mass", "missing", "give `mass` or `density`"),
    ("mass = 2.0", "mass = 2\ndensity = 1", 9, "body[0].density", "given beside mass", "give one"),
    ('name = "cube"\n', "", 5, "body[0].name", "missing", "keys here: name, shape"),
    ('"cube"\nshape', '""\nshape', 6, "body[0].name", "must not be empty", ""),
    (
        '"clump"\nshape',
        '"cube"\nshape',
        10,
        "body[1].name",
        '"cube" is the name of body[0] already',
        "rename one",
    ),
    (
        '"clump"\nshape',
        '"a[1]"\nshape',
        10,
        "body[1].name",
        "must be printable and without brackets",
        "",
    ),
    (
        'type = "box"',
        'type = "bxo"',
        7,
        "body[0].shape.type",
        "unknown type 'bxo'",
        'did you mean "box"? known: box, ball, sphere, shell, cylinder, cone, torus',
    ),
    ('type = "box", ', "", 7, "body[0].shape.type", "missing", "known: box, ball"),
    (
        "size = [1.0, 1.0, 1.0]",
        "sizes = [1.0, 1.0, 1.0]",
        7,
        "body[0].shape.sizes",
        "unknown key",
        'did you mean "size"? keys here: type, inertia_error, size, n',
    ),
    (
        "size = [1.0, 1.0, 1.0]",
        "size = [1.0, 1.0]",
        7,
        "body[0].shape.size",
        "must have 3 entries, has 2",
        "",
    ),
    (
        "size = [1.0, 1.0, 1.0]",
        "size = 1.0",
        7,
        "body[0].shape.size",
        "must be a list of 3 numbers, got 1.0",
        "",
    ),
    (
        "size = [1.0, 1.0, 1.0]",
        "size = [1.0, -1.0, 1.0]",
        7,
        "body[0].shape.size[1]",
        "must be > 0, got -1.0",
        "",
    ),
    ("1.0, 1.0] }", "1.0, 1.0], n = 0 }", 7, "body[0].shape.n", "must be >= 1, got 0", ""),
    ("count = 4", "count = 0", 13, "body[1].count", "must be >= 1, got 0", ""),
    (
        'place = { type = "grid", spacing = 2.0 }',
        "",
        9,
        "body[1].place",
        "missing: count = 4 bodies need different positions",
        'place = { type = "grid", spacing = 1.0 }',
    ),
    (
        "spacing = 2.0",
        "spacing = 2.0, position = [0, 0, 2]",
        14,
        "body[1].place.position",
        "unknown key",
        'did you mean "origin"? keys here: type, spacing, n, origin',
    ),
    (
        "spacing = 2.0",
        "spacing = 2.0, n = [1, 1, 2]",
        14,
        "body[1].place.n",
        "holds 2 of 4 bodies",
        "give larger numbers",
    ),
    (
        "spacing = 2.0 }",
        "spacing = 2.0 }\nposition = [0, 0, 1]",
        15,
        "body[1].position",
        "given beside place",
        "",
    ),
    (
        "count = 4",
        "count = 4\nvelocity = [[0, 0, 0]]",
        14,
        "body[1].velocity",
        "must have count = 4 rows, has 1",
        "give a row for each",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\norientation = [0, 0, 0, 0]",
        9,
        "body[0].orientation",
        "must not be zero: it is not an orientation",
        "no turn is [1, 0, 0, 0]",
    ),
    (
        "mass = 2.0",
        'mass = 2.0\norientation = "rnd"',
        9,
        "body[0].orientation",
        "unknown: 'rnd'",
        '[w, x, y, z], { euler_deg = [roll, pitch, yaw] }, or "random"',
    ),
    (
        "mass = 2.0",
        'mass = 2.0\nvelocity = "random"',
        9,
        "body[0].velocity",
        "must be a list of 3 numbers, got 'random'",
        "[x, y, z], { body = [x, y, z] }, or { random = v }",
    ),
    (
        "mass = 2.0",
        "mass = 2.0\norientation = { euler = [0, 0, 0] }",
        9,
        "body[0].orientation.euler",
        "unknown key",
        'did you mean "euler_deg"?',
    ),
    (
        "mass = 2.0",
        "mass = 2.0\nvelocity = { bdy = [0, 0, 0] }",
        9,
        "body[0].velocity.bdy",
        "unknown key",
        'did you mean "body"? keys here: body, random',
    ),
    (
        'type = "push"\nbody = "cube"\nforce = [0, 0, 50]\nduring = [0.0, 0.02]',
        'type = "spring"\nbodies = ["cube", "clump[0]"]\nstiffness = 1.0',
        17,
        "force[0].bodies",
        "unknown key",
        'did you mean "body" and "to"? keys here',
    ),
    (
        'type = "push"',
        'type = "gravity"',
        16,
        "force[0].type",
        "unknown type 'gravity'",
        "gravity is a table of its own: [gravity]",
    ),
    (
        'type = "push"',
        'type = "psh"',
        16,
        "force[0].type",
        "unknown type 'psh'",
        'did you mean "push"? known: push, torque, impulse',
    ),
    (
        'body = "cube"\n',
        'body = "cub"\n',
        17,
        "force[0].body",
        'there is no body "cub"',
        'did you mean "cube"? known: cube, clump',
    ),
    (
        'body = "cube"\n',
        'body = ["cube", "clump[4]"]\n',
        17,
        "force[0].body[1]",
        'there is no body "clump[4]"',
        "clump[0] to [3] exist",
    ),
    (
        'body = "cube"\n',
        'body = "cube[1]"\n',
        17,
        "force[0].body",
        'there is no body "cube[1]"',
        "it is one body, cube",
    ),
    ('body = "cube"\n', "body = []\n", 17, "force[0].body", "must not be empty", ""),
    (
        "force = [0, 0, 50]",
        'force = [0, 0, 50]\nframe = "wrld"',
        19,
        "force[0].frame",
        "unknown: 'wrld'",
        'did you mean "world"? known: world, body',
    ),
    (
        "[0.0, 0.02]",
        "[0.02, 0.02]",
        19,
        "force[0].during",
        "must start before it ends, got [0.02, 0.02]",
        "",
    ),
    ("[0.0, 0.02]", "[-1, 0.02]", 19, "force[0].during[0]", "must be >= 0, got -1", ""),
    ("[0.0, 0.02]", "[5, 6]", 19, "force[0].during", "must start before run.t_end = 5.0", ""),
    (
        'body = "clump[3]"',
        'body = "clmp"',
        21,
        "check.value[0].body",
        'there is no body "clmp"',
        'did you mean "clump"?',
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"position"\nvalue = [0, 0]',
        23,
        "check.value[0].value",
        "position needs 3 numbers",
        "",
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"inertia"\nvalue = 1',
        23,
        "check.value[0].value",
        "inertia needs 3 numbers or 3 x 3 numbers",
        "",
    ),
    (
        '"position"\n',
        '"position"\nframe = "body"\n',
        23,
        "check.value[0].frame",
        "position is not given in the body frame",
        "",
    ),
    ('"position"', '"positon"', 22, "check.value[0].quantity", "unknown: 'positon'", "position"),
    (
        "tolerance = 1e-9",
        "tolerance = 1e-9\ntime = 9.0",
        25,
        "check.value[0].time",
        "must be <= run.t_end = 5.0, got 9.0",
        "",
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"inertia"\nvalue = [[1, 0, 0], [0, 1, 0], [0, 1]]',
        23,
        "check.value[0].value",
        "inertia needs 3 numbers or 3 x 3 numbers",
        "",
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"inertia"\nvalue = [1, [2], 3]',
        23,
        "check.value[0].value",
        "inertia needs 3 numbers or 3 x 3 numbers",
        "",
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"kinetic_energy"\nvalue = []',
        23,
        "check.value[0].value",
        "kinetic_energy needs one number",
        "",
    ),
    (
        '"position"\nvalue = [0, 0, 0]',
        '"orientation"\nvalue = [0, 0, 0, 0]',
        23,
        "check.value[0].value",
        "must not be zero: it is not an orientation",
        "",
    ),
    (
        "[[force]]",
        '[output]\nfields = ["position", "position"]\n[[force]]',
        16,
        "output.fields",
        "must not repeat a name",
        "",
    ),
    ("[[force]]", "[output]\nfields = []\n[[force]]", 16, "output.fields", "must not be empty", ""),
    (
        "[[force]]",
        '[output]\ndtype = "f4"\n[[force]]',
        16,
        "output.dtype",
        "unknown: 'f4'",
        "known: float64, float32",
    ),
    (
        "[[force]]",
        '[[force]]\ntype = "impulse"\nbody = "cube"\nimpulse = [0, 0, 1]\ntime = 6\n[[force]]',
        19,
        "force[0].time",
        "must be <= run.t_end = 5.0, got 6.0",
        "",
    ),
    (
        'type = "grid", spacing = 2.0',
        'type = "random", lower = [0, 0, 0], upper = [1, -1, 1]',
        14,
        "body[1].place.upper",
        "must not be below lower on any axis",
        "",
    ),
    (
        "spacing = 2.0",
        "spacing = 2.0, n = [0, 1, 4]",
        14,
        "body[1].place.n[0]",
        "must be >= 1, got 0",
        "",
    ),
    ("spacing = 2.0", "spacing = -2", 14, "body[1].place.spacing", "must be > 0, got -2", ""),
    (
        "count = 4",
        "count = 2147483648",
        13,
        "body[1].count",
        "must be <= 2147483647, got 2147483648",
        "",
    ),
    (
        "every = 0.1",
        "every = 0.1\nseed = -1",
        5,
        "run.seed",
        "must be >= 0, got -1",
        "",
    ),
    ("[[force]]", "[gravity]\n[[force]]", 15, "gravity.acceleration", "missing", "acceleration"),
    (
        'shape = { type = "ball", radius = 0.5 }',
        'shape = "ball"',
        11,
        "body[1].shape",
        "must be a table, got a text: 'ball'",
        "{ type = .. } with one of the types: box, ball, ",
    ),
    (
        'title = "a cube and a clump"',
        "output = 5",
        1,
        "output",
        "must be a table, got a whole number: 5",
        "",
    ),
    (
        "tolerance = 1e-9",
        "tolerance = -1e-9",
        24,
        "check.value[0].tolerance",
        "must be >= 0, got -1e-09",
        "",
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "line", "key", "reason", "hint"), MISTAKES, ids=[m[1][:40] for m in MISTAKES]
)
def test_mistake_has_one_message(old, new, line, key, reason, hint):
    found = problems(edited(old, new))
    problem = found[0] if "name" in key else found[-1]  # what names the body misses it, too
    assert (problem.line, problem.key, problem.reason) == (line, key, reason)
    assert hint in problem.hint
    assert len(found) == 1 or (key.endswith("name") and len(found) == 2)
    assert problem.file == str(Path("cases/x.toml"))


BETWEEN = [
    # table before [[force]] of the good case, key, reason, part of the hint
    ("spring", 'to = "clmp"', "to", 'there is no body "clmp"', 'did you mean "clump"?'),
    ("spring", 'to = ["clump", "clump[4]"]', "to[1]", 'there is no body "clump[4]"', "[3] exist"),
    ("spring", 'to = "world"', "to", 'there is no body "world"', "and a spring `anchor`"),
    ("spring", 'to = ["world"]', "to[0]", 'there is no body "world"', "and a spring `anchor`"),
    ("spring", "to = 5", "to", "must be a list, got a whole number: 5", ""),
    ("spring", "", "anchor", "missing", "give `anchor` for the world, `to` or `reach` for other"),
    ("spring", "anchr = [0, 0, 1]", "anchr", "unknown key", 'did you mean "anchor"?'),
    ("spring", 'too = "clump"', "too", "unknown key", 'did you mean "to"?'),
    ("spring", "length = 1", "length", "unknown key", 'did you mean "rest_length"?'),
    ("spring", "dampng = 1\nreach = 1", "dampng", "unknown key", 'did you mean "damping"?'),
    ("spring", 'anchor = [0, 0, 1]\nto = "clump"', "to", "given beside anchor", "one other end"),
    ("spring", "anchor = [0, 0, 1]\nreach = 1", "reach", "given beside anchor", "one other end"),
    (
        "spring",
        "anchor = [0, 0, 1]\nto_at = [0, 0, 1]",
        "to_at",
        "cannot be given together with an anchor",
        "",
    ),
    ("spring", "reach = 0", "reach", "must be > 0, got 0", ""),
    ("spring", "reach = -1.0", "reach", "must be > 0, got -1.0", ""),
    ("spring", "reach = 1\ndamping = -1", "damping", "must be >= 0, got -1", ""),
    ("spring", "reach = 1\nrest_length = -1", "rest_length", "must be >= 0, got -1", ""),
    (
        "spring",
        'reach = 1\nrest_length = "inital"',
        "rest_length",
        "unknown: 'inital'",
        'did you mean "initial"?',
    ),
    (
        "spring",
        "reach = 1\nrest_length = true",
        "rest_length",
        "must be a number, got true or false: True",
        "",
    ),
    (
        "spring",
        "reach = 1\nrest_length = [1]",
        "rest_length",
        "must be a number, got a list",
        "",
    ),
    (
        "spring",
        'to = ["clump[0]", "clump[1]", "cube"]',
        "to",
        "names 3 bodies, `body` 4: they make no pairs",
        "name equal numbers, or one for all; or give `reach`",
    ),
    ("field", "", "field", "missing", "keys here: type, body, during, field, charge, at, dipole"),
    ("field", "fild = [0, 0, 1]", "fild", "unknown key", 'did you mean "field"?'),
    ("field", "field = [0, 1]", "field", "must have 3 entries, has 2", ""),
    ("field", "field = [0, 0, 1]\ndipole = 2", "dipole", "must be a list of 3 numbers, got 2", ""),
    (
        "field",
        'field = [0, 0, 1]\ncharge = "much"',
        "charge",
        "must be a number, got a text: 'much'",
        "",
    ),
    ("field", "field = [0, 0, 1]\ncharge = []", "charge", "must not be empty", ""),
    (
        "field",
        "field = [0, 0, 1]\ncharge = [1, inf]",
        "charge[1]",
        "must be finite, got inf",
        "",
    ),
    (
        "field",
        "field = [0, 0, 1]\ncharge = [1, 2]\nat = [0, 0, 1]",
        "at",
        "cannot be given together with a charge for each particle",
        "",
    ),
]


@pytest.mark.parametrize(
    ("kind", "keys", "key", "reason", "hint"), BETWEEN, ids=[m[1][-40:] or m[0] for m in BETWEEN]
)
def test_mistake_in_a_force_between_bodies_has_one_message(kind, keys, key, reason, hint):
    stiffness = "stiffness = 1\n" if kind == "spring" else ""
    table = f'[[force]]\ntype = "{kind}"\nbody = "clump"\n{stiffness}{keys}\n[[force]]'
    (problem,) = problems(edited("[[force]]", table))
    assert (problem.key, problem.reason) == (f"force[0].{key}", reason)
    assert hint in problem.hint
    assert problem.line


@pytest.mark.parametrize(
    ("keys", "key", "reason", "hint"),
    [
        ("softening = -0.1", ".softening", "must be >= 0, got -0.1", ""),
        ("G = 0", ".G", "must be > 0, got 0", ""),
        ("softning = 0.1", ".softning", "unknown key", 'did you mean "softening"?'),
        ("during = [0, 1]", ".during", "unknown key", "keys here: G, softening, body, sum"),
        ('sum = "tre"', ".sum", "unknown: 'tre'", 'did you mean "tree"? known: auto, direct'),
        ("opening_angle = 1.0", ".opening_angle", "must be < 1, got 1.0", ""),
        ("opening_angle = 0", ".opening_angle", "must be > 0, got 0", ""),
        ("accuracy = 0.2", ".accuracy", "must be <= 0.1, got 0.2", ""),
        (
            "accuracy = 1e-3\nopening_angle = 0.5",
            ".accuracy",
            "given beside opening_angle",
            "give one",
        ),
        ('body = "cub"', ".body", 'there is no body "cub"', 'did you mean "cube"?'),
        ('body = ["clump", "cub"]', ".body[1]", 'there is no body "cub"', ""),
        ('body = "world"', ".body", 'there is no body "world"', "known: cube, clump"),
        ('body = "cube"', ".body", "needs two bodies at least, has one", "name more"),
        ('body = ["clump[1]", "clump[1]"]', ".body", "needs two bodies at least, has one", ""),
    ],
)
def test_mistake_in_attraction_has_one_message(keys, key, reason, hint):
    (problem,) = problems(edited("[[force]]", f"[attraction]\n{keys}\n[[force]]"))
    assert (problem.key, problem.reason) == (f"attraction{key}", reason)
    assert hint in problem.hint
    assert problem.line == 16


GRANULAR = """\
[run]
t_end = 1
every = 1
[contact]
stiffness = 1e5
restitution = 0.8
friction = 0.5
[[contact.pair]]
materials = ["steel", "glass"]
friction = 0.3
[[material]]
name = "steel"
[[material]]
name = "glass"
[[body]]
name = "ball"
shape = { type = "sphere", radius = 0.1 }
mass = 1.0
material = "glass"
[[body]]
name = "post"
shape = { type = "sphere", radius = 0.1 }
mass = 1.0
material = "glass"
fixed = true
[[wall]]
type = "plane"
name = "floor"
normal = [0, 0, 1]
material = "steel"
[[wall]]
type = "box"
name = "bin"
lower = [0, 0, 0]
upper = [1, 1, 1]
material = "steel"
[[wall]]
type = "cylinder"
name = "drum"
radius = 1
length = 1
material = "steel"
"""


def test_the_granular_case_that_the_tests_break_is_good():
    assert len(parse(GRANULAR).wall) == 3


OF_CONTACT = [
    # old text, new text, key, reason, part of the hint
    ("restitution = 0.8", "restitution = 1.5", "contact.restitution", "must be <= 1, got 1.5", ""),
    ("restitution = 0.8", "restitution = -1", "contact.restitution", "must be >= 0, got -1", ""),
    (
        "restitution = 0.8",
        "restitution = 0",
        "contact.restitution",
        "0 takes a dashpot that pulls, which contacts here do not",
        "contact.attract = true",
    ),
    ("friction = 0.5", "friction = -0.5", "contact.friction", "must be >= 0, got -0.5", ""),
    ("stiffness = 1e5", "stiffness = -1e5", "contact.stiffness", "must be > 0, got -100000.0", ""),
    ("stiffness = 1e5", "stifness = 1e5", "contact.stifness", "unknown key", '"stiffness"?'),
    ("stiffness = 1e5", 'law = "hertzz"', "contact.law", "unknown: 'hertzz'", '"hertz"?'),
    ("stiffness = 1e5", "law = []", "contact.law", "unknown: []", "known: hooke, hertz"),
    (
        "stiffness = 1e5",
        'law = "hertz"\nstiffness = 1e5',
        "contact.stiffness",
        "hertz takes its stiffness from the materials",
        "give `young` and `poisson` of each [[material]]",
    ),
    ("stiffness = 1e5", "skin = 0", "contact.skin", "must be > 0, got 0", ""),
    ("stiffness = 1e5", "overlap = -1e-3", "contact.overlap", "must be >= 0, got -0.001", ""),
    (
        "stiffness = 1e5",
        "relax = 1",
        "contact.relax",
        "must be true or false, got a whole number: 1",
        "",
    ),
    ("friction = 0.3", "friction = -1", "contact.pair[0].friction", "must be >= 0, got -1", ""),
    (
        "friction = 0.3",
        "fricton = 0.3",
        "contact.pair[0].fricton",
        "unknown key",
        'did you mean "friction"? keys here: stiffness, tangential_stiffness',
    ),
    (
        "friction = 0.3",
        "restitution = 0",
        "contact.pair[0].restitution",
        "0 takes a dashpot that pulls, which contacts here do not",
        "contact.attract = true",
    ),
    (
        '"steel", "glass"]',
        '"steel", "glas"]',
        "contact.pair[0].materials[1]",
        'there is no material "glas"',
        'did you mean "glass"? known: steel, glass',
    ),
    (
        '"steel", "glass"]',
        '"steel"]',
        "contact.pair[0].materials",
        "must have 2 entries, has 1",
        "",
    ),
    (
        '[[material]]\nname = "steel"',
        '[[contact.pair]]\nmaterials = ["glass", "steel"]\n[[material]]\nname = "steel"',
        "contact.pair[1].materials",
        "this pair is contact.pair[0] already",
        "name every pair once",
    ),
    (
        '[[material]]\nname = "glass"',
        '[[material]]\nname = "glass"\n[[material]]\nname = "glass"',
        "material[2].name",
        '"glass" is the name of material[1] already',
        "rename one",
    ),
    ('"steel"\n[[m', '"steel"\nyoung = 0\n[[m', "material[0].young", "must be > 0, got 0", ""),
    (
        '"steel"\n[[m',
        '"steel"\npoisson = 0.6\n[[m',
        "material[0].poisson",
        "must be <= 0.5, got 0.6",
        "",
    ),
    (
        'material = "glass"\n[[body]]',
        'material = "gold"\n[[body]]',
        "body[0].material",
        'there is no material "gold"',
        "known: steel, glass",
    ),
    ("fixed = true", "fixed = 1", "body[1].fixed", "must be true or false, got a whole", ""),
    (
        "fixed = true",
        "fixed = true\nvelocity = [0, 0, 1]",
        "body[1].velocity",
        "a fixed body does not move",
        "leave it out",
    ),
    (
        "fixed = true",
        "fixed = true\nangular_velocity = { random = 1.0 }",
        "body[1].angular_velocity",
        "a fixed body does not move",
        "leave it out",
    ),
    (
        "fixed = true",
        "fixed = true\ncontact = false",
        "body[1].contact",
        "a fixed body that nothing touches has no effect",
        "leave it out",
    ),
    (
        "fixed = true",
        'fixed = true\n[[force]]\ntype = "push"\nforce = [0, 0, 1]\nbody = ["ball", "post[0]"]',
        "force[0].body",
        "post is fixed: no force acts on it",
        "leave the fixed body out",
    ),
    (
        "fixed = true",
        'fixed = true\n[[force]]\ntype = "spring"\nstiffness = 1\nbody = "ball"\nto = "post"',
        "force[0].to",
        "post is fixed: no force acts on it",
        "a spring has `anchor` for the world",
    ),
    (
        "fixed = true",
        "fixed = true\n[attraction]",
        "attraction.body",
        "post is fixed: it takes no part in attraction",
        "name the others",
    ),
    (
        "fixed = true",
        'fixed = true\n[attraction]\nbody = ["ball", "post"]',
        "attraction.body",
        "post is fixed: it takes no part in attraction",
        "name the others",
    ),
    (
        'type = "plane"',
        'type = "plan"',
        "wall[0].type",
        "unknown type 'plan'",
        'did you mean "plane"? known: plane, box, cylinder, mesh',
    ),
    ('type = "plane"\n', "", "wall[0].type", "missing", "known: plane, box, cylinder, mesh"),
    (
        "normal = [0, 0, 1]",
        "nrmal = [0, 0, 1]",
        "wall[0].nrmal",
        "unknown key",
        'did you mean "normal"? keys here: type, name, material, motion, piston, point, normal',
    ),
    (
        "normal = [0, 0, 1]",
        "normal = [0, 0, 0]",
        "wall[0].normal",
        "must not be zero: it is not a direction",
        "",
    ),
    (
        'name = "floor"',
        'name = "bin"',
        "wall[1].name",
        '"bin" is the name of wall[0] already',
        "rename one",
    ),
    (
        'name = "floor"',
        'name = "ball"',
        "wall[0].name",
        '"ball" is the name of body[0] already',
        "rename one",
    ),
    (
        'normal = [0, 0, 1]\nmaterial = "steel"',
        'normal = [0, 0, 1]\nmaterial = "stel"',
        "wall[0].material",
        'there is no material "stel"',
        'did you mean "steel"?',
    ),
    (
        "upper = [1, 1, 1]",
        "upper = [1, 0, 1]",
        "wall[1].upper",
        "must be above lower on each axis, is 0.0 on y",
        "",
    ),
    (
        "upper = [1, 1, 1]",
        'upper = [1, 1, 1]\nopen = ["+w"]',
        "wall[1].open[0]",
        "unknown: '+w'",
        "known: -x, +x, -y, +y, -z, +z",
    ),
    (
        "upper = [1, 1, 1]",
        'upper = [1, 1, 1]\nopen = ["+z", "+z"]',
        "wall[1].open",
        "must not repeat a face",
        "",
    ),
    (
        "upper = [1, 1, 1]",
        'upper = [1, 1, 1]\nopen = ["+z", "-z", "+x", "-x", "+y", "-y"]',
        "wall[1].open",
        "leaves no face of the box",
        "",
    ),
    ("radius = 1\n", "radius = 0\n", "wall[2].radius", "must be > 0, got 0", ""),
    (
        "radius = 1\n",
        "radius = 1\naxis = [0, 0, 0]\n",
        "wall[2].axis",
        "must not be zero: it is not a direction",
        "",
    ),
    ("length = 1\n", "length = -1\n", "wall[2].length", "must be > 0, got -1", ""),
    (
        "length = 1\n",
        'length = 1\nopen = ["+z"]\n',
        "wall[2].open[0]",
        "unknown: '+z'",
        "known: -, +",
    ),
    (
        "length = 1\n",
        "",
        "wall[2].length",
        "missing",
        "keys here: type, name, material, motion, piston, centre, axis",
    ),
    ("length = 1\n", "length = 1\ninside = 1\n", "wall[2].inside", "must be true or false", ""),
    (
        "radius = 1\n",
        "radius = 1\nmotion = { velocty = [0, 0, 1] }\n",
        "wall[2].motion.velocty",
        "unknown key",
        'did you mean "velocity"? keys here: velocity, angular_velocity, centre',
    ),
    (
        "radius = 1\n",
        "radius = 1\nmotion = { velocity = { body = [0, 0, 1] } }\n",
        "wall[2].motion.velocity",
        "must be a list of 3 numbers",
        "",
    ),
    (
        "radius = 1\n",
        "radius = 1\nmotion = { oscillation = { amplitude = [0, 0, 1], frequency = 0 } }\n",
        "wall[2].motion.oscillation.frequency",
        "must be > 0, got 0",
        "",
    ),
    (
        "radius = 1\n",
        "radius = 1\nmotion = { oscillation = { amplitude = [0, 0, 1] } }\n",
        "wall[2].motion.oscillation.frequency",
        "missing",
        "keys here: amplitude, frequency, phase",
    ),
    (
        'type = "cylinder"\nname = "drum"\nradius = 1\nlength = 1\n',
        'type = "mesh"\nname = "drum"\nfile = "no.stl"\n',
        "wall[2].file",
        'there is no file "no.stl" in cases',
        "",
    ),
]


@pytest.mark.parametrize(
    ("old", "new", "key", "reason", "hint"),
    OF_CONTACT,
    ids=[f"{m[2]}-{m[1][-30:]}" for m in OF_CONTACT],
)
def test_mistake_in_contact_has_one_message(old, new, key, reason, hint):
    assert GRANULAR.count(old) == 1
    (problem,) = problems(GRANULAR.replace(old, new))
    assert problem.key == key
    assert problem.reason.startswith(reason)
    assert hint in problem.hint
    assert bool(hint) == bool(problem.hint)
    assert problem.line


def test_walls_and_fixed_bodies_need_contact():
    start = GRANULAR.index("[contact]")
    text = GRANULAR[:start] + GRANULAR[GRANULAR.index("[[material]]") :]
    assert [(p.key, p.reason) for p in problems(text)] == [
        ("body[1].fixed", "a fixed body is an obstacle of [contact], which is not there"),
        ("wall[0]", "nothing touches a wall without [contact]"),
    ]


def test_material_without_any():
    text = GRANULAR.replace('[[material]]\nname = "steel"\n[[material]]\nname = "glass"\n', "")
    found = problems(text)
    assert {p.reason for p in found} == {f'there is no material "{m}"' for m in ("steel", "glass")}
    assert all(p.hint == "there is no [[material]]" for p in found)
    assert len(found) == 7


def test_restitution_of_nothing_needs_damping_that_pulls():
    text = GRANULAR.replace("restitution = 0.8", "restitution = 0\nattract = true")
    assert parse(text).contact.restitution == 0.0


def test_one_body_attracts_nothing():
    one = '[run]\nt_end = 1\nevery = 1\n[attraction]\n[[body]]\nname = "a"\nmass = 1\n'
    one += 'shape = { type = "ball", radius = 1 }\n'
    (problem,) = problems(one)
    assert (problem.line, problem.key) == (4, "attraction")
    assert problem.reason == "needs two bodies at least, has one"


def test_equal_numbers_one_for_all_and_reach_make_pairs():
    for body, keys in (
        ("clump", 'to = "cube"'),
        ("cube", 'to = "clump"'),
        (["clump[0]", "clump[1]"], 'to = ["clump[2]", "cube"]'),
        ("clump", 'to = ["cube", "clump[0]"]\nreach = 1'),
        ("clump", "reach = 1"),
    ):
        table = f'[[force]]\ntype = "spring"\nbody = {body!r}\nstiffness = 1\n{keys}\n'
        assert parse(edited("[[force]]", table + "[[force]]")).force[0].body


SHAPES = [
    # shape, key after "shape.", reason
    ('type = "cone", radius = 1, height = 0', "height", "must be > 0, got 0"),
    (
        'type = "cylinder", radius = 1, height = 1, inner_radius = 1',
        "inner_radius",
        "must be < radius = 1.0, got 1.0",
    ),
    (
        'type = "shell", radius = 1, inner_radius = 2',
        "inner_radius",
        "must be < radius = 1.0, got 2.0",
    ),
    (
        'type = "torus", major_radius = 1, minor_radius = 2',
        "minor_radius",
        "must be <= major_radius = 1.0, got 2.0",
    ),
    ('type = "ellipsoid", semi_axes = [1, 2]', "semi_axes", "must have 3 entries, has 2"),
    ('type = "tetrahedron", vertices = [[0, 0, 0]]', "vertices", "must have 4 entries, has 1"),
    ('type = "moments", inertia = [1, 1, -1]', "inertia[2]", "must be >= 0, got -1"),
    ('type = "cloud", radius = 1', "n", "missing"),
    ('type = "rod", length = 1, n = 0', "n", "must be >= 1, got 0"),
    ('type = "points"', "position", "has no particles"),
    ('type = "points", position = [], mass = []', "position", "has no particles"),
    ('type = "points", position = [[0, 0, 0]]', "mass", "particles need a mass each"),
    (
        'type = "points", position = [[0, 0, 0]], mass = [1, 2]',
        "mass",
        "must have 1 entries like position, has 2",
    ),
    (
        'type = "points", position = [[0, 0, 0]], mass = [1], radius = [1, 2]',
        "radius",
        "must have 1 entries like position, has 2",
    ),
    (
        'type = "points", position = [[0, 0, 0]], mass = [-1]',
        "mass[0]",
        "must be >= 0, got -1",
    ),
    (
        'type = "points", position = [[0, 0, 0]], mass = [0], radius = [1]',
        "mass",
        "must not all be zero",
    ),
    (
        'type = "points", position = [[0, 0, 0], [0, 0, 1]], mass = [1, 0]',
        "mass",
        "particle 1 has neither mass nor radius",
    ),
    (
        'type = "points", position = [[0, 0]], mass = [1]',
        "position[0]",
        "must have 3 entries, has 2",
    ),
]


@pytest.mark.parametrize(("shape", "key", "reason"), SHAPES)
def test_mistake_in_a_shape(shape, key, reason):
    (problem,) = problems(edited('type = "box", size = [1.0, 1.0, 1.0]', shape))
    assert (problem.line, problem.key, problem.reason) == (7, f"body[0].shape.{key}", reason)


@pytest.mark.parametrize(
    "shape",
    [
        'type = "rod", length = 1',
        'type = "shell", radius = 1',
        'type = "cloud", n = 3, radius = 1',
        'type = "moments", inertia = [1, 1, 1]',
        'type = "points", position = [[0, 0, 0]], mass = [1]',
    ],
)
def test_density_needs_a_volume(shape):
    text = edited('type = "box", size = [1.0, 1.0, 1.0]', shape)
    (problem,) = problems(text.replace("mass = 2.0", "density = 2.0"))
    assert (problem.line, problem.key) == (8, "body[0].density")
    assert problem.reason.endswith("has no volume of its own")


def test_points_need_no_mass_beside_their_own():
    shape = 'type = "points", position = [[0, 0, 0]], mass = [1]'
    text = edited('type = "box", size = [1.0, 1.0, 1.0]', shape)
    assert parse(text.replace("mass = 2.0\n", "")).body[0].mass is None


def test_points_come_from_a_file_or_from_lists(tmp_path):
    (tmp_path / "p.csv").write_text("x,y,z,m\n0,0,0,1\n")
    shape = 'type = "points", file = "p.csv", mass = [1]'
    text = edited('type = "box", size = [1.0, 1.0, 1.0]', shape)
    (problem,) = problems(text, tmp_path / "c.toml")
    assert problem.reason == "particles come from `file` or from lists, not both"


def test_missing_csv_is_shown_at_its_key(tmp_path):
    text = edited('type = "box", size = [1.0, 1.0, 1.0]', 'type = "points", file = "no.csv"')
    (problem,) = problems(text, tmp_path / "c.toml")
    assert (problem.line, problem.column, problem.key) == (7, 35, "body[0].shape.file")
    assert problem.reason == f'there is no file "no.csv" in {tmp_path.as_posix()}'


def test_body_is_a_shape_or_parts():
    part = '[[body.part]]\nshape = { type = "rod", length = 1 }\nmass = 1\n'
    found = problems(edited("[[force]]", part + "[[force]]").replace("mass = 2.0\n", ""))
    assert [(p.key, p.reason) for p in found if p.key.startswith("body[1]")] == [
        ("body[1].shape", "cannot be given together with [[body.part]]"),
        ("body[1].density", "cannot be given together with [[body.part]]"),
    ]


def test_body_without_shape_and_part_without_mass():
    part = '[[body]]\nname = "a"\n[[body]]\nname = "b"\n[[body.part]]\n'
    part += 'shape = { type = "rod", length = 1 }\n[[force]]'
    found = problems(edited("[[force]]", part))
    assert [(p.line, p.key, p.reason) for p in found] == [
        (15, "body[2].shape", "missing"),
        (19, "body[3].part[0].mass", "missing"),
    ]


MASSLESS = [
    # keys of the only part that has mass, key after "body[2].", reason, part of the hint
    (
        'shape = { type = "box", size = [1, 1, 1] }\nmass = 0',
        "part[1].mass",
        "must be > 0 for all but spheres, got 0",
        "",
    ),
    (
        'shape = { type = "points", position = [[0, 0, 0]], mass = 1 }\nmass = 0',
        "part[1].mass",
        "must be > 0 for all but spheres, got 0",
        "give `mass = 0` among the points",
    ),
    (
        'shape = { type = "sphere", radius = 1 }\nmass = 0',
        "part",
        "no part has mass",
        "one of them",
    ),
    (
        'shape = { type = "points", position = [[0, 0, 0]], mass = 0, radius = 1 }',
        "part",
        "no part has mass",
        "",
    ),
    ('shape = { type = "sphere", radius = 1 }', "part[1].mass", "missing", "`mass` or `density`"),
    ('shape = { type = "sphere", radius = 1 }\nmass = -1', "part[1].mass", "must be >= 0", ""),
    (
        'shape = { type = "sphere", radius = 0 }\nmass = 1',
        "part[1].shape.radius",
        "must be > 0",
        "",
    ),
]


@pytest.mark.parametrize(("keys", "key", "reason", "hint"), MASSLESS)
def test_only_surface_may_be_without_mass(keys, key, reason, hint):
    part = (
        '[[body]]\nname = "b"\n[[body.part]]\nshape = { type = "sphere", radius = 1 }\nmass = 0\n'
    )
    (problem,) = problems(edited("[[force]]", f"{part}[[body.part]]\n{keys}\n[[force]]"))
    assert problem.key == f"body[2].{key}"
    assert problem.reason.startswith(reason)
    assert hint in problem.hint


def test_a_whole_body_has_mass():
    sphere = edited('type = "box", size = [1.0, 1.0, 1.0]', 'type = "sphere", radius = 1')
    (problem,) = problems(sphere.replace("mass = 2.0", "mass = 0"))
    assert (problem.key, problem.reason) == ("body[0].mass", "must be > 0, got 0")


def test_one_number_for_all_points_is_checked_once():
    shape = 'type = "points", position = [[0, 0, 0], [0, 0, 1]], mass = 1, radius = -1'
    (problem,) = problems(edited('type = "box", size = [1.0, 1.0, 1.0]', shape))
    assert (problem.key, problem.reason) == ("body[0].shape.radius", "must be >= 0, got -1")


PER_BODY = "mass", "density", "translation", "rotation", "coefficient"
BAD_NUMBERS = [math.nan, math.inf, -math.inf, "1", None, True, np.nan, [1.0], 10**400]


def numeric_places(case: dict) -> list[tuple[str | int, ...]]:
    """Paths of all numbers of a case."""

    def numbers(node, path):
        if isinstance(node, dict):
            for key, entry in node.items():
                yield from numbers(entry, (*path, key))
        elif isinstance(node, list):
            for i, entry in enumerate(node):
                yield from numbers(entry, (*path, i))
        elif isinstance(node, (int, float)):
            yield path

    return list(numbers(case, ()))


def test_the_case_with_everything_is_good(everything):
    assert len(load(everything()).body) == 14


@pytest.mark.parametrize("bad", BAD_NUMBERS)
def test_no_number_may_be_anything_but_finite(bad, everything):
    """Each number of the case with everything in turn: exactly its key is reported."""
    for path in numeric_places(everything()):
        case = everything()
        node = case
        for part in path[:-1]:
            node = node[part]
        node[path[-1]] = bad
        if bad is None and isinstance(path[-1], str):
            continue  # None says that an optional key is not given
        if isinstance(bad, list) and path[-1] in PER_BODY:
            continue  # a list is one for each body
        with pytest.raises(CaseError) as caught:
            load(case)
        keys = [problem.key for problem in caught.value.problems]
        whole = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in path)[1:]
        assert any(whole.startswith(key) and key.count(".") == whole.count(".") for key in keys)
        assert all(p.reason and not p.line for p in caught.value.problems)


def test_all_problems_at_once_and_by_line():
    text = edited("t_end = 5.0", "t_end = -1").replace("mass = 2.0", "mass = nan")
    text = text.replace('body = "cube"', 'body = "cub"').replace("tolerance", "tolerence")
    assert [(p.line, p.key) for p in problems(text)] == [
        (3, "run.t_end"),
        (8, "body[0].mass"),
        (17, "force[0].body"),
        (24, "check.value[0].tolerence"),
    ]


@pytest.mark.parametrize(
    ("text", "line", "column", "reason"),
    [
        ("[run]\nt_end 5", 2, 7, "broken TOML: a key needs a `=` and a value"),
        ("[run]\nt_end = ", 2, 9, "broken TOML: this is not a TOML value"),
        ("[run]\nt_end = cube", 2, 9, "broken TOML: this is not a TOML value"),
        ("[run]\nt_end = 5\nt_end = 6", 3, 10, "broken TOML: this key has been given before"),
        ("[run]\n[run]", 2, 5, "broken TOML: this table has been opened before"),
        ("a = [1, 2", 1, 10, "broken TOML: a list is not closed: `]` is missing"),
        ('a = "x\n', 1, 7, "broken TOML: this character is not allowed here"),
        ('a = "x', 1, 7, "broken TOML: a text is not closed: its quotes are missing"),
        ("a = 1 b = 2", 1, 7, "broken TOML: more on this line than one `key = value`"),
        (
            "mass = 2,0",
            1,
            9,
            "broken TOML: more on this line than one `key = value`: a unit, a comma?",
        ),
        ("?", 1, 1, "broken TOML: this is neither `key = value` nor a [table]"),
        ("a = 'x\n", 2, 1, "broken TOML: a text is not closed: its quotes are missing"),
        ("[body", 1, 6, "broken TOML: a header is not closed"),
        ('a = "C:\\data"', 1, 10, "broken TOML: a backslash is written twice"),
        ('a = "C:\\Users"', 1, 10, "broken TOML: a backslash is written twice"),
    ],
)
def test_broken_toml(text, line, column, reason):
    (problem,) = problems(text)
    assert (problem.line, problem.column) == (line, column)
    assert problem.reason.startswith(reason)


def test_particles_beyond_the_memory_are_refused_where_they_are_asked_for():
    """What 10^15 particles take no machine gives; the message named no body."""
    text = edited("size = [1.0, 1.0, 1.0]", "size = [1.0, 1.0, 1.0], n = 100_000")
    with pytest.raises(CaseError) as caught:
        to_system(parse(text, Path("cases/x.toml")))
    assert "x.toml:7:9: error: body[0].shape: cube: its particles do not fit" in str(caught.value)


def test_numbers_and_nesting_out_of_range():
    assert "out of range" in problems("a = " + "9" * 5000)[0].reason
    assert "no such date" in problems("a = 2001-02-30")[0].reason
    assert problems("a = " + "[" * 5000)[0].reason == "is nested too deeply"
    deep = "[" * 300 + "]" * 300
    assert problems(edited("value = [0, 0, 0]", f"value = {deep}"))


@pytest.mark.parametrize("size", ["1e110", "1e160", "1e300", "1e-110", "1e-300"])
@pytest.mark.parametrize("weight", ["mass = 1.0", "density = 1.0"])
@pytest.mark.parametrize(
    "shape",
    [
        'type = "sphere", radius = S',
        'type = "ball", radius = S, n = 3',
        'type = "shell", radius = S, n = 4',
        'type = "shell", radius = S, inner_radius = 1e-301, n = 4',
        'type = "shell", radius = S, inner_radius = 1e-301, inertia_error = 0.1',
        'type = "cylinder", radius = S, height = S, n = 3',
        'type = "cone", radius = S, height = S, n = 3',
        'type = "torus", major_radius = S, minor_radius = 1e-301, n = 4',
        'type = "ellipsoid", semi_axes = [S, S, S], n = 3',
        'type = "box", size = [S, S, S], n = 2',
        'type = "rod", length = S, n = 3',
    ],
)
def test_sizes_out_of_range_are_refused_or_run(shape, weight, size):
    """Volumes and tensors overflow long before a length does: a case or one message, always."""
    table = f"{{ {shape.replace('S', size)} }}"
    text = f'run = {{t_end = 1, every = 1}}\n[[body]]\nname = "a"\nshape = {table}\n{weight}\n'
    found: list[str] = []
    try:
        prepare(to_system(parse(text)))
    except CaseError as error:
        found = [problem.reason for problem in error.problems]
    assert not [why for why in found if "Numerical result" in why or "division" in why]


@pytest.mark.parametrize(
    "more",
    ["[attraction]", '[[force]]\ntype = "push"\nbody = "a[9999999999]"\nforce = [1, 0, 0]'],
)
def test_a_count_beyond_all_machines(more):
    text = f"""run = {{t_end = 1, every = 1}}
[[body]]
name = "a"
shape = {{ type = "moments", inertia = [1, 2, 2] }}
mass = 1
count = 1{"0" * 60}
{more}
"""
    assert any("count" in problem.key for problem in problems(text))


def test_a_softening_whose_square_overflows_is_no_attraction():
    body = '[[body]]\nshape = { type = "moments", inertia = [1, 2, 2] }\nmass = 1.0\n'
    a, b = f'{body}name = "a"\n', f'{body}name = "b"\nposition = [3, 0, 0]\n'
    text = f"run = {{t_end = 1, every = 1}}\nattraction = {{ softening = 1e200 }}\n{a}{b}"
    prepare(to_system(parse(text)))


def test_a_restitution_that_is_almost_nothing_is_a_large_damping():
    """The square of its damping ratio overflows."""
    text = """
run = { t_end = 1.0, every = 0.5 }
contact = { stiffness = 1e4, restitution = 1e-320, friction = 0.3 }
[[body]]
name = "a"
count = 2
shape = { type = "sphere", radius = 0.2 }
mass = 1.0
place = { type = "grid", spacing = 3.0 }
"""
    with pytest.raises(CaseError, match="dt"):
        prepare(to_system(parse(text)))


def test_a_rate_without_bound_is_a_step_of_nothing():
    """The moment of the push overflows as it is squared."""
    text = """
run = { t_end = 3.0, every = 0.5, method = "dop853", dt = 0.01 }
body = [{ name = "a", shape = { type = "moments", inertia = [1, 2, 2] }, mass = 1.0 }]
force = [{ type = "push", body = "a", at = [-1e174, 1e5, 0.0], force = [-0.5, 0.1, 1.0] }]
"""
    with pytest.raises(CaseError, match="would be taken inf times"):
        prepare(to_system(parse(text)))


@pytest.mark.parametrize("keys", ["velocity = [1e200, 0, 0]", "angular_velocity = [0, 1e160, 0]"])
@pytest.mark.parametrize("law", ["", "stiffness = 1e4", 'law = "impulse"'])
@pytest.mark.filterwarnings("error")
def test_a_body_whose_energy_overflows_is_refused_before_it_is_planned(keys, law):
    """With contact the plan squared the speed, with a warning of NumPy; the run ended later."""
    text = f"""
run = {{ t_end = 1.0, every = 0.5 }}
{"contact = {" * bool(law)} {law} {"}" * bool(law)}
[[body]]
name = "still"
shape = {{ type = "sphere", radius = 0.1 }}
mass = 1.0
[[body]]
name = "fast"
count = 2
place = {{ type = "grid", spacing = 3.0 }}
shape = {{ type = "sphere", radius = 0.1 }}
mass = 1.0
{keys}
"""
    with pytest.raises(CaseError) as caught:
        prepare(to_system(parse(text)))
    (problem,) = caught.value.problems
    assert problem.key == "body[1]"
    assert "fast[0] moves or spins so fast that its kinetic energy" in problem.reason


def test_a_wall_that_turns_beyond_all_numbers_is_refused():
    """Its pose would be NaN, also at t = 0."""
    text = """
run = { t_end = 1.0, every = 0.5 }
contact = { stiffness = 1e4 }
body = [{ name = "a", shape = { type = "sphere", radius = 0.2 }, mass = 1.0, position = [0, 0, 1] }]
[[wall]]
type = "plane"
motion = { angular_velocity = [0.1, 3.0, 3e162] }
"""
    found = {problem.key: problem.reason for problem in problems(text)}
    assert "its square overflows" in found["wall[0].motion.angular_velocity"]


def message_of_file(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        load(path)
    return str(caught.value)


def test_file_that_cannot_be_a_case(tmp_path):
    (tmp_path / "cube.toml").write_text(GOOD)
    (tmp_path / "empty.toml").write_text(" \n")
    (tmp_path / "latin.toml").write_bytes(b"[run]\nt_end = 5 # \xe9t\xe9")
    (tmp_path / "big.toml").write_bytes(b"")
    with (tmp_path / "big.toml").open("r+b") as file:
        file.truncate(65 * 2**20)
    assert message_of_file(tmp_path / "cbe.toml") == (
        f"{tmp_path / 'cbe.toml'}: error: there is no such file\n"
        '      hint: did you mean "cube.toml"? known: big.toml, cube.toml, empty.toml, latin.toml'
    )
    assert "is a folder, not a case file" in message_of_file(tmp_path)
    assert "there is no such folder" in message_of_file(tmp_path / "no" / "cube.toml")
    assert "is empty" in message_of_file(tmp_path / "empty.toml")
    assert "larger than 64 MiB" in message_of_file(tmp_path / "big.toml")
    assert "latin.toml:2:13: error: byte 0xe9 is not UTF-8" in message_of_file(
        tmp_path / "latin.toml"
    )
    assert "cannot be read" in message_of_file(tmp_path / ("x" * 300))
    assert "error" in message_of_file(Path("a\0b"))


def test_names_that_no_file_can_have(tmp_path, monkeypatch):
    """A text in place of a path, a name that is too long, and one that no example has."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CaseError, match=r"given as a text.*\n.*tomllib\.loads"):
        load(GOOD)
    with pytest.raises(CaseError, match="there is no such file or case"):
        load("x" * 300)
    with pytest.raises(CaseError) as caught:
        load("pyramid.v2.toml")
    assert "example is called" not in str(caught.value)


def test_an_index_that_is_too_long_for_a_number():
    with pytest.raises(CaseError) as caught:
        parse(GOOD, overrides=[f"body.{'9' * 5000}.mass=2"])
    assert caught.value.problems[0].reason.startswith("there is no entry '999")


def test_dict_has_keys_and_no_lines(everything):
    case = everything()
    case["run"]["t_end"] = -1.0
    case["body"][0]["shpe"] = case["body"][0].pop("shape")
    with pytest.raises(CaseError) as caught:
        load(case)
    text = str(caught.value)
    assert "case: error: run.t_end: must be > 0, got -1.0" in text
    assert "case: error: body[0].shpe: unknown key" in text
    assert all(problem.line is None for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (np.zeros((3, 3)), "must have count = 4 rows, has 3"),
        (np.zeros((4, 2)), "must be rows of 3 numbers each"),
        (np.full((4, 3), np.nan), "must be finite, row 0 is not"),
        (np.array([["a"] * 3] * 4), "must be rows of 3 numbers each"),
        (np.zeros((4, 3), dtype=complex), "must be rows of 3 numbers each"),
        (np.ma.array(np.zeros((4, 3)), mask=np.eye(4, 3)), "must be rows of 3 numbers each"),
    ],
)
def test_rows_from_python_are_checked(rows, reason, everything):
    case = everything()
    case["body"][0] |= {"count": 4, "position": rows}
    with pytest.raises(CaseError) as caught:
        load(case)
    assert [(p.key, p.reason) for p in caught.value.problems] == [("body[0].position", reason)]


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (("contact", "tolerance"), "must be a number, got a list"),
        (("check", "energy_drift"), "must be a number, got a list"),
        (("joint",), "must be a table, got a list"),
        (("material",), "must be a table, got a list"),
        (("body", 0, "name"), "must be a text, got a list"),
    ],
)
def test_an_array_where_there_are_no_rows_is_a_list(path, reason, everything):
    case = table = everything()
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = np.ones((2, 3))
    with pytest.raises(CaseError) as caught:
        load(case)
    assert reason in [p.reason for p in caught.value.problems]


@pytest.mark.parametrize(
    ("key", "others", "reason"),
    [
        ("velocity", {"fixed": True}, "a fixed body does not move"),
        ("position", {"place": {"type": "grid", "spacing": 1.0}}, "given beside place"),
    ],
)
def test_arrays_of_rows_are_judged_beside_other_keys(key, others, reason, everything):
    case = everything()
    case["body"][0] |= {"count": 4, key: np.ones((4, 3)), **others}
    with pytest.raises(CaseError) as caught:
        load(case)
    assert reason in [p.reason for p in caught.value.problems]


def test_rows_of_orientations_are_not_zero(everything):
    case = everything()
    case["body"][3]["orientation"] = np.array([[1.0, 0, 0, 0], [0, 0, 0, 0]])
    with pytest.raises(CaseError, match="row 1 is not an orientation"):
        load(case)


@pytest.mark.slow
def test_mutated_cases_end_in_a_plan_or_one_message():
    """A few of the texts of which `tests/fuzz/results.md` counts a million."""
    script = Path(__file__).parents[1] / "fuzz" / "fuzz_cases.py"
    words = [sys.executable, script, "--runs", "500"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 escapes" in done.stdout
    assert "planned" in done.stdout


def test_a_very_long_wall_has_no_more_cells_than_memory():
    """The cube root of its volume would ask for 1e68 of them."""
    text = """
run = { t_end = 1.0, every = 0.5, dt = 1e-3 }
contact = { stiffness = 1e4, restitution = 0.8, friction = 0.3 }
wall = [{ type = "cylinder", name = "w", radius = 1.0, length = 2.4e101, open = ["+"] }]
body = [{ name = "a", shape = { type = "sphere", radius = 0.2 }, mass = 1.0 }]
"""
    prepare(to_system(parse(text)))


def test_a_plan_is_told_under_gravity_whose_square_overflows(make):
    """The longest step of impulses, which contacts by springs are compared with, came out as 0."""
    gravity = {"acceleration": [0, 0, -1.4e193]}
    case = make.case(
        make.sphere(position=[0.5, 0, 1]),
        t_end=1e-99, every=1e-99, gravity=gravity, contact=make.hooke(), wall=[make.plane()],
    )  # fmt: skip
    assert "springs" in prepare(to_system(load(case))).text


@pytest.mark.parametrize("motor", ["fast", [1.0]])
def test_a_motor_is_a_number_or_a_table(make, motor):
    hinge = {"type": "hinge", "name": "h", "body": "body", "at": [0, 0, 0], "axis": [0, 0, 1]}
    with pytest.raises(CaseError) as caught:
        load(make.case(make.body(), joint=[hinge | {"motor": motor}]))
    (problem,) = caught.value.problems
    assert problem.reason.startswith("must be a number or a table, got a")


@pytest.mark.parametrize(
    "wrong", [{"contact": {"law": "impulses", "tolerance": 1e-6}}, {"material": {"name": "steel"}}]
)
def test_what_others_depend_on_is_mended_before_they_are_judged(make, wrong):
    """An unknown law made its own keys wrong, and one [material] all that name it."""
    case = make.case(make.sphere(material="steel"), contact={"law": "impulse"}, wall=[make.plane()])
    case["check"] = {
        "value": [{"quantity": "impulse_residual", "time": 1.0, "value": 0.0, "tolerance": 1.0}]
    }
    with pytest.raises(CaseError) as caught:
        load(case | wrong)
    assert len(caught.value.problems) == 1


def test_mistakes_that_are_alike_are_shown_once_with_the_keys_of_the_others():
    """Six links of an arm with one mistake each filled two screens."""
    bodies = "".join(
        f'[[body]]\nname = "{k}"\nshape = {{ type = "ball", radus = 1.0 }}\nmass = 1.0\n'
        for k in range(30)
    )
    with pytest.raises(CaseError) as caught:
        parse(f"[run]\nt_end = 1.0\nevery = -1.0\n{bodies}", Path("x.toml"))
    text = str(caught.value)
    assert len(caught.value.problems) > 30
    assert text.count("unknown key") == 1
    assert 'hint: did you mean "radius"?' in text
    assert "likewise: body[1].shape.radus (line 10), body[2].shape.radus (line 14), " in text
    assert "body[20].shape.radus (line 86), ... (29 in all)\n" in text + "\n"
    two = [p for p in caught.value.problems if "radus" in p.key][:2]
    assert str(CaseError(two)).count("unknown key") == 2


def test_the_nearest_of_many_bodies_is_of_the_block_that_is_meant():
    """Of 5000 the first thousand were compared: ball[432] was said to be meant by bal[4321]."""
    names = [f"ball[{k}]" for k in range(5000)]
    assert nearest("bal[4321]", names).startswith('did you mean "ball[4321]"? known: ball[0], ')
    assert nearest("bal", [*names, "ball"]).startswith('did you mean "ball"?')
